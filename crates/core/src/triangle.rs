//! The point of a triangle nearest to another point.

use glam::DVec3;

/// What a point of a triangle is on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TriangleFeature {
    /// Its inside.
    Face,
    /// The side from corner i to i + 1.
    Side(usize),
    /// Corner i.
    Corner(usize),
}

/// Squared sine of the angle between two sides up to which a triangle is taken for a line. With less,
/// rounding puts points on the wrong side of a sliver; with more, points over narrow triangles are off.
const LINE: f64 = 1e-8;

/// The point of a triangle nearest to a point, and what it is on (Ericson 2005, §5.1.5). Triangles may have
/// no area, and corners in common.
pub fn nearest_on_triangle(p: DVec3, &[a, b, c]: &[DVec3; 3]) -> (DVec3, TriangleFeature) {
    // Voronoi regions of the corners and sides in turn; va, vb, vc are barycentric coordinates times their
    // sum. A side without length is none.
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return (a, TriangleFeature::Corner(0));
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return (b, TriangleFeature::Corner(1));
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 && d1 > d3 {
        return (a + ab * (d1 / (d1 - d3)), TriangleFeature::Side(0));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return (c, TriangleFeature::Corner(2));
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 && d2 > d6 {
        return (a + ac * (d2 / (d2 - d6)), TriangleFeature::Side(2));
    }
    let va = d3 * d6 - d5 * d4;
    let (from_b, to_c) = (d4 - d3, d5 - d6);
    if va <= 0.0 && from_b >= 0.0 && to_c >= 0.0 && from_b + to_c > 0.0 {
        return (b + (c - b) * (from_b / (from_b + to_c)), TriangleFeature::Side(1));
    }
    let sum = va + vb + vc;
    if sum > LINE * ab.length_squared() * ac.length_squared() {
        (a + ab * (vb / sum) + ac * (vc / sum), TriangleFeature::Face)
    } else {
        nearest_side(p, [a, b, c])
    }
}

/// The point of the sides nearest to a point.
#[cold]
fn nearest_side(p: DVec3, corners: [DVec3; 3]) -> (DVec3, TriangleFeature) {
    let on_side = |side: usize| {
        let (from, to) = (corners[side], corners[(side + 1) % 3]);
        let along = to - from;
        let at = along.dot(p - from) / along.length_squared();
        match at {
            at if at >= 1.0 => (to, TriangleFeature::Corner((side + 1) % 3)),
            at if at > 0.0 => (from + along * at, TriangleFeature::Side(side)),
            _ => (from, TriangleFeature::Corner(side)),
        }
    };
    let away = |found: &(DVec3, TriangleFeature)| found.0.distance_squared(p);
    let [first, second, third] = [0, 1, 2].map(on_side);
    let nearer = |a, b| if away(&b) < away(&a) { b } else { a };
    nearer(nearer(first, second), third)
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt as _, SeedableRng as _};

    use super::*;

    /// Against a grid of points of triangles, a third of which are segments or points.
    #[test]
    fn nearest_points_against_a_grid() {
        let mut rng = StdRng::seed_from_u64(0xE8AD);
        for round in 0..900 {
            let mut random = || DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
            let (p, a, b) = (2.0 * random(), random(), random());
            let c = [random(), random(), random(), a + 0.3 * (b - a), a, b][round % 6];
            let b = if round % 18 == 4 { a } else { b };
            let mut corners = [a, b, c];
            corners.rotate_left(round % 3);
            let (point, feature) = nearest_on_triangle(p, &corners);
            let [a, b, c] = corners;
            let n = 60;
            let mut least = f64::INFINITY;
            for i in 0..=n {
                for j in 0..=n - i {
                    let (u, v) = (f64::from(i) / f64::from(n), f64::from(j) / f64::from(n));
                    least = least.min(p.distance(a + (b - a) * u + (c - a) * v));
                }
            }
            let found = point.distance(p);
            assert!(found <= least + 1e-12 && found >= least - 0.05, "round {round}: {found} {least}");
            let off = match feature {
                TriangleFeature::Corner(corner) => point.distance(corners[corner]),
                TriangleFeature::Side(side) => {
                    let (from, to) = (corners[side], corners[(side + 1) % 3]);
                    point.distance(from) + point.distance(to) - from.distance(to)
                }
                TriangleFeature::Face => (b - a).cross(c - a).dot(point - a),
            };
            assert!(off.abs() < 1e-9, "round {round}: {feature:?} is {off} off");
        }
    }

    /// In slivers rounding leaves the distance right.
    #[test]
    fn slivers() {
        let mut rng = StdRng::seed_from_u64(0xE8AE);
        for round in 0..3000 {
            let height = 10f64.powi(-(round % 18));
            let corners = [DVec3::ZERO, DVec3::X, DVec3::new(rng.random_range(0.0..1.0), height, 0.0)];
            let p = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..2.0)));
            let found = nearest_on_triangle(p, &corners).0.distance(p);
            let side = nearest_side(p, corners).0.distance(p);
            // The nearest point is within the height of a side.
            assert!(found <= side * (1.0 + 1e-9) + 1e-12 && found >= side - height - 1e-9, "round {round}");
        }
    }
}
