//! Detection of walls that are too thin for a distance field: their two sides are closer than the field's
//! lattice resolves.

use palpate_core::TriMesh;
use palpate_core::glam::DVec3;
use palpate_field::ExactDistance;

/// Number of sample points on the surface. With fewer, small thin walls are missed.
const SAMPLES: usize = 4096;

/// Smallest cosine of the angle between the normal of one side and the reversed normal of the other at which
/// the two bound a wall. At this value edges sharper than 45° count as thin walls near their ends, and
/// blunter ones do not.
const MIN_OPPOSITION: f64 = 0.7;

/// Largest distance to the other side of a thin wall, in units of the distance to the sample itself. Rounding
/// and curvature may bring the sample's own side a little nearer, which must not count as another side.
const MAX_DISTANCE_RATIO: f64 = 0.95;

/// Fraction of a surface's area that bounds walls thinner than a thickness (m).
pub(crate) fn thin_share(mesh: &TriMesh, thickness: f64) -> f64 {
    let exact = ExactDistance::new(mesh);
    let areas: Vec<f64> = (0..mesh.triangles().len())
        .map(|triangle| {
            let [a, b, c] = mesh.corners(triangle);
            (b - a).cross(c - a).length() / 2.0
        })
        .collect();
    let whole: f64 = areas.iter().sum();
    let (mut triangle, mut before, mut thin, mut hint) = (0, 0.0, 0, 0);
    for sample in 0..SAMPLES {
        // Samples are equally spaced in the running sum of the triangles' areas.
        let at = (sample as f64 + 0.5) / SAMPLES as f64 * whole;
        while triangle + 1 < areas.len() && before + areas[triangle] <= at {
            before += areas[triangle];
            triangle += 1;
        }
        let corners = mesh.corners(triangle);
        let Some((point, normal)) = sample_point(&corners, sample) else { continue };
        // Half the thickness below the sample, the other side of a thinner wall is nearer than the sample.
        let middle = point - 0.5 * thickness * normal;
        let nearest = exact.nearest(middle, hint);
        hint = nearest.hint;
        let to_nearest = nearest.point - middle;
        let distance = to_nearest.length();
        // The point is still inside the wall, with the other side ahead; or outside, with the other side
        // behind it.
        let ahead = if nearest.distance < 0.0 { -to_nearest.dot(normal) } else { to_nearest.dot(normal) };
        thin += usize::from(
            distance < MAX_DISTANCE_RATIO * 0.5 * thickness && ahead >= MIN_OPPOSITION * distance,
        );
    }
    thin as f64 / SAMPLES as f64
}

/// Point of a triangle, a different one for each number, with the normal there; `None` without area.
fn sample_point([a, b, c]: &[DVec3; 3], number: usize) -> Option<(DVec3, DVec3)> {
    let normal = (b - a).cross(c - a).try_normalize()?;
    // Roberts' additive recurrence fills the unit square evenly; the upper half is folded on to the triangle.
    let part = |step: f64| (0.5 + step * number as f64).fract();
    let (u, v) = (part(0.754_877_666_246_692_7), part(0.569_840_290_998_053_2));
    let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
    Some((a + u * (b - a) + v * (c - a), normal))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::field::welded;

    /// Box centred at the origin.
    fn plate(size: DVec3) -> TriMesh {
        let corner = |i: u32| {
            let part = DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2));
            size * (part - 0.5)
        };
        #[rustfmt::skip]
        let triangles: [[u32; 3]; 12] = [
            [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
            [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
        ];
        welded(triangles.into_iter().map(|triangle| triangle.map(corner))).expect("a box")
    }

    #[test]
    fn the_sides_of_a_plate_bound_a_wall() {
        let plate = plate(DVec3::new(1.0, 1.0, 0.01));
        let sides = 2.0 / 2.04;
        for (thickness, wanted) in [(0.005, 0.0), (0.0095, 0.0), (0.011, sides), (0.05, sides), (0.3, sides)]
        {
            let share = thin_share(&plate, thickness);
            assert!((share - wanted).abs() < 0.03, "{thickness}: {share} for {wanted}");
        }
        assert_eq!(thin_share(&self::plate(DVec3::ONE), 0.5), 0.0, "right angles are no walls");
    }

    #[cfg(feature = "models")]
    #[test]
    fn rounded_solids_have_no_thin_walls() {
        for name in ["torus@2000", "golf-ball@5000", "spoon@2000"] {
            let object = crate::Object::model(name).expect("a model");
            let mesh = welded(object.triangles()).expect("triangles");
            let share = thin_share(&mesh, 0.01 * object.bounding_radius());
            assert!(share < 0.005, "{name}: {share}");
        }
    }
}
