//! Walls that are too thin for a distance field: two sides of them are nearer to one another than the field's lattice tells apart.

use palpate_core::TriMesh;
use palpate_core::glam::DVec3;
use palpate_field::ExactDistance;

/// Places of the surface that are looked at.
const PLACES: usize = 4096;

/// Two surfaces bound a wall if the cosine of the angle between one's normal and the reverse of the other's is above this: sharper
/// edges than 45° are thin walls near their ends, blunter ones are not.
const OPPOSITE: f64 = 0.7;

/// The nearest of what is as far away as the place itself may be a little nearer by rounding, or because the surface is curved.
const NEARER: f64 = 0.95;

/// The part of a surface, by its area, that bounds walls thinner than a thickness (m).
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
    for place in 0..PLACES {
        let at = (place as f64 + 0.5) / PLACES as f64 * whole;
        while triangle + 1 < areas.len() && before + areas[triangle] <= at {
            before += areas[triangle];
            triangle += 1;
        }
        let corners = mesh.corners(triangle);
        let Some((point, normal)) = inside(&corners, place) else { continue };
        let middle = point - 0.5 * thickness * normal;
        let nearest = exact.nearest(middle, hint);
        hint = nearest.hint;
        let way = nearest.point - middle;
        let distance = way.length();
        // The other side is before it, or behind it already.
        let ahead = if nearest.distance < 0.0 { -way.dot(normal) } else { way.dot(normal) };
        thin += usize::from(distance < NEARER * 0.5 * thickness && ahead >= OPPOSITE * distance);
    }
    thin as f64 / PLACES as f64
}

/// A point of a triangle, another one for each number, with the normal there; none without area.
fn inside([a, b, c]: &[DVec3; 3], number: usize) -> Option<(DVec3, DVec3)> {
    let normal = (b - a).cross(c - a).try_normalize()?;
    // Roberts' additive recurrence fills a square evenly, folded on to the triangle.
    let part = |step: f64| (0.5 + step * number as f64).fract();
    let (u, v) = (part(0.754_877_666_246_692_7), part(0.569_840_290_998_053_2));
    let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
    Some((a + u * (b - a) + v * (c - a), normal))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::field::welded;

    /// A box about the origin.
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
    fn what_is_rounded_has_no_walls() {
        for name in ["torus@2000", "golf-ball@5000", "spoon@2000"] {
            let object = crate::Object::model(name).expect("a model");
            let mesh = welded(object.triangles()).expect("triangles");
            let share = thin_share(&mesh, 0.01 * object.bounding_radius());
            assert!(share < 0.005, "{name}: {share}");
        }
    }
}
