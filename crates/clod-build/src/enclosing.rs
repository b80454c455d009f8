//! The smallest enclosing sphere of a point set.
//!
//! Basis exchange in the manner of Welzl (1991) and Gärtner (1999): the farthest point outside of the current
//! sphere enters the set of at most four points that determine it, and the smallest sphere of those five or
//! fewer is found by trying their subsets. The radius grows with each exchange, so that the search ends. The
//! number of exchanges is limited nevertheless, and the final radius is measured, so that every point is
//! inside in spite of rounding.

use glam::{DMat3, DVec3};

/// Largest number of exchanges. Some ten were the most seen.
const MAX_EXCHANGES: usize = 100;

/// Centre and radius of the smallest sphere around finite points; for an empty set, a radius of 0 at the
/// origin.
pub(crate) fn smallest_sphere(points: &[DVec3]) -> (DVec3, f64) {
    let Some(first) = points.first() else { return (DVec3::ZERO, 0.0) };
    let mut basis = vec![*first];
    let (mut center, mut radius) = (*first, 0.0);
    for _ in 0..MAX_EXCHANGES {
        let (farthest, distance) = farthest_from(points, center);
        if distance <= radius * (1.0 + 1e-12) || basis.contains(&farthest) {
            break;
        }
        basis.push(farthest);
        let Some(next) = smallest_of_subsets(&mut basis) else { break };
        if next.1 <= radius {
            break;
        }
        (center, radius) = next;
    }
    (center, farthest_from(points, center).1)
}

fn farthest_from(points: &[DVec3], center: DVec3) -> (DVec3, f64) {
    let mut best = (center, 0.0);
    for &p in points {
        let distance = p.distance_squared(center);
        if distance > best.1 {
            best = (p, distance);
        }
    }
    (best.0, best.1.sqrt())
}

/// The smallest sphere around at most five points. Removes the points that do not determine it.
fn smallest_of_subsets(points: &mut Vec<DVec3>) -> Option<(DVec3, f64)> {
    let mut best: Option<(DVec3, f64, u32)> = None;
    for subset in 1u32..1 << points.len() {
        if subset.count_ones() > 4 {
            continue;
        }
        let chosen: Vec<DVec3> =
            (0..points.len()).filter(|k| subset >> k & 1 == 1).map(|k| points[k]).collect();
        let Some((center, radius)) = circumsphere(&chosen) else { continue };
        let inside = points.iter().all(|p| p.distance(center) <= radius * (1.0 + 1e-12));
        if inside && best.is_none_or(|b| radius < b.1) {
            best = Some((center, radius, subset));
        }
    }
    let (center, radius, subset) = best?;
    let mut k = 0;
    points.retain(|_| {
        k += 1;
        subset >> (k - 1) & 1 == 1
    });
    Some((center, radius))
}

/// The smallest sphere that passes through all of one to four points.
fn circumsphere(points: &[DVec3]) -> Option<(DVec3, f64)> {
    let origin = points[0];
    let center = match *points {
        [_] => DVec3::ZERO,
        [_, b] => 0.5 * (b - origin),
        [_, b, c] => {
            let (b, c) = (b - origin, c - origin);
            let normal = b.cross(c);
            (normal.cross(b) * c.length_squared() + c.cross(normal) * b.length_squared())
                / (2.0 * normal.length_squared())
        }
        [_, b, c, d] => {
            let rows = DMat3::from_cols(b - origin, c - origin, d - origin).transpose();
            let squares = DVec3::new(
                (b - origin).length_squared(),
                (c - origin).length_squared(),
                (d - origin).length_squared(),
            );
            0.5 * (rows.inverse() * squares)
        }
        _ => return None,
    };
    let center = center + origin;
    center.is_finite().then(|| (center, points.iter().map(|p| p.distance(center)).fold(0.0, f64::max)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn known_spheres() {
        let tetrahedron = [
            DVec3::new(1.0, 1.0, 1.0),
            DVec3::new(1.0, -1.0, -1.0),
            DVec3::new(-1.0, 1.0, -1.0),
            DVec3::new(-1.0, -1.0, 1.0),
        ];
        let (center, radius) = smallest_sphere(&tetrahedron);
        assert!(center.length() < 1e-14 && (radius - 3f64.sqrt()).abs() < 1e-14);
        // An obtuse triangle is held by its longest side.
        let (center, radius) = smallest_sphere(&[DVec3::ZERO, DVec3::X * 4.0, DVec3::new(2.0, 0.5, 0.0)]);
        assert_eq!((center, radius), (DVec3::X * 2.0, 2.0));
        assert_eq!(smallest_sphere(&[DVec3::Y; 3]), (DVec3::Y, 0.0));
    }

    #[test]
    fn random_sets_against_every_subset() {
        let seed = 3;
        println!("seed {seed}");
        let mut rng = StdRng::seed_from_u64(seed);
        for round in 0..500 {
            let flat = if round % 3 == 0 { 0.0 } else { 1.0 };
            let points: Vec<DVec3> = (0..2 + round % 14)
                .map(|_| {
                    DVec3::new(
                        rng.random_range(-1.0..1.0),
                        rng.random_range(-1.0..1.0),
                        flat * rng.random_range(-1.0..1.0),
                    )
                })
                .collect();
            let (center, radius) = smallest_sphere(&points);
            assert!(points.iter().all(|p| p.distance(center) <= radius));
            let mut best = f64::INFINITY;
            for subset in 1u32..1 << points.len() {
                if subset.count_ones() > 4 {
                    continue;
                }
                let chosen: Vec<DVec3> =
                    (0..points.len()).filter(|k| subset >> k & 1 == 1).map(|k| points[k]).collect();
                if let Some((c, r)) = circumsphere(&chosen)
                    && points.iter().all(|p| p.distance(c) <= r * (1.0 + 1e-9))
                {
                    best = best.min(r);
                }
            }
            assert!((radius - best).abs() <= 1e-9 * best, "round {round}: {radius} {best}");
        }
    }
}
