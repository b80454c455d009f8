//! The refinement test: whether the detail that a pair of nodes leaves out would be felt (§3.4.3).
//!
//! The missing detail of a node has the volume φ = s/r² (Eq. 3.6): its deviation from the mesh times
//! the area of one of its samples. It is averaged over the area of contact, which is estimated by the
//! support area D of the nearest points: s* = max(φ_a, φ_b) / max(D_a, D_b) (Eq. 3.7). If s* is
//! above the threshold s₀, the pair has to be refined.
//!
//! D is interpolated at the nearest points (§3.4.3), which are searched only if the least and the largest D
//! of the nodes' vertices do not decide already. Patches that overlap have no nearest points, and nearest
//! points further apart than d are no contact: in both cases D is the mean of each patch, into which it
//! blends beforehand. (With the mean everywhere, jaws took three quarters of the time at s₀ = 2.5 %, and
//! forces between cusps, where D is small, had twice the error: the same error takes the same time.)

use palpate_core::glam::DVec3;

use crate::convex::{Distance, Hull, Placement};
use crate::detail::Detail;
use crate::tolerances::NOMINAL_ERROR;

/// Fraction of d, at either end, over which D blends from that of the nearest points to the patches' mean.
/// With less, patches split and join more suddenly.
const AREA_BLEND: f64 = 0.25;

/// Answer of the refinement test without the nearest points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Refine {
    Yes,
    No,
    /// The nearest points decide.
    Depends,
}

/// Refinement test without the nearest points, by Eq. 3.7 with the least and the largest D. `error` is s₀, m.
/// With a `band`, pairs are partly refined from (1 − band) s₀ on.
pub(crate) fn refine(a: &Detail, b: &Detail, error: f64, band: f64) -> Refine {
    let missing = a.missing.max(b.missing);
    if missing > error * a.largest_area.max(b.largest_area) {
        Refine::Yes
    } else if missing <= (1.0 - band) * error * a.least_area.max(b.least_area) {
        Refine::No
    } else {
        Refine::Depends
    }
}

/// s*/s₀ at the contact between two patches, given the distance between their hulls and D at the points of
/// each; infinite if s₀ is 0. `tolerance` is d, `error` is s₀, m.
pub(crate) fn weighted_deviation(
    found: &Distance,
    (detail_a, area_a): (&Detail, impl Fn(u32) -> f64),
    (detail_b, area_b): (&Detail, impl Fn(u32) -> f64),
    tolerance: f64,
    error: f64,
) -> f64 {
    // D of the nearest points, by their barycentric weights.
    let (mut on_a, mut on_b) = (0.0, 0.0);
    for (vertex, weight) in found.simplex.vertices().iter().zip(found.simplex.weights()) {
        on_a += weight * area_a(vertex.a);
        on_b += weight * area_b(vertex.b);
    }
    // 0 at distance 0 and at d, 1 well in between.
    let part = if tolerance > 0.0 { (found.distance / tolerance).min(1.0) } else { 1.0 };
    let nearest_share = (part.min(1.0 - part) / AREA_BLEND).min(1.0);
    let area = |detail: &Detail, nearest: f64| {
        if nearest_share > 0.0 {
            detail.mean_area + nearest_share * (nearest - detail.mean_area)
        } else {
            detail.mean_area
        }
    };
    ratio(
        detail_a.missing.max(detail_b.missing),
        error * f64::max(area(detail_a, on_a), area(detail_b, on_b)),
    )
}

/// Motion, m, for which s* stays above s₀ at the contact between two patches; 0 if it is not known. For each
/// patch: its detail, its hull, and D at the hull's points. `error` is s₀, `rounding` that of coordinates, m.
///
/// After the bodies have moved by m, the new nearest points were at most 2m further apart before the motion
/// than the nearest points then. So along the separating direction they lay at most that far above the
/// supporting planes: m = (rise − slack) / 2.
pub(crate) fn refined_for(
    found: &Distance,
    (detail_a, hull_a, area_a): (&Detail, &Hull, impl Fn(u32) -> f64),
    (detail_b, hull_b, area_b): (&Detail, &Hull, impl Fn(u32) -> f64),
    placement: &Placement,
    error: f64,
    rounding: f64,
) -> f64 {
    // s* > s₀ as long as both D are below this.
    let allowed = detail_a.missing.max(detail_b.missing) / error;
    let slack = found.distance - found.lower + rounding;
    let rise_a = rise(detail_a, hull_a, area_a, found.direction, allowed);
    if rise_a <= slack {
        return 0.0;
    }
    let in_b = -placement.direction_to_b(found.direction);
    let rise_b = rise(detail_b, hull_b, area_b, in_b, allowed);
    (0.5 * (rise_a.min(rise_b) - slack)).max(0.0)
}

/// Smallest height, m, above the plane that supports the hull across `direction`, at which D of a point of
/// the hull, or a blend of it with the mean, can be `allowed` (m²) or more; 0 if it is not known.
///
/// A point is a weighted mean of vertices, and so are its height and its D. If every vertex at height h has D
/// ≤ c + k h, so has every point, and D = `allowed` needs at least the height h = (allowed − c) / k. Here
/// c is half of `allowed`, and k the smallest slope that holds for all vertices.
fn rise(detail: &Detail, hull: &Hull, area: impl Fn(u32) -> f64, direction: DVec3, allowed: f64) -> f64 {
    if detail.mean_area >= allowed || direction == DVec3::ZERO {
        return 0.0;
    }
    if detail.largest_area < allowed {
        return f64::INFINITY;
    }
    let bottom = -hull.end(-direction);
    let level = 0.5 * allowed;
    let (mut rise, mut vertex) = (f64::INFINITY, 0);
    hull.each_point(|point| {
        let area = area(vertex);
        vertex += 1;
        if area > level {
            rise = rise.min((point.dot(direction) - bottom) * (allowed - level) / (area - level));
        }
    });
    rise
}

/// s*/s₀ of a pair with the mean D of its patches; infinite on free levels. If s₀ is 0, it orders pairs by
/// s* alone.
pub(crate) fn urgency(a: &Detail, b: &Detail, error: f64) -> f64 {
    let missing = a.missing.max(b.missing);
    let area = a.mean_area.max(b.mean_area);
    ratio(missing, area * if error > 0.0 { error } else { NOMINAL_ERROR })
}

/// Quotient with 0/0 = 0.
fn ratio(missing: f64, allowed: f64) -> f64 {
    if missing > 0.0 { missing / allowed } else { 0.0 }
}

/// Share of a contact that is left to the children of its pair: 1 if s* is above s₀; with a
/// `band`, from (1 − band) s₀ on, it grows smoothly as 3x² − 2x³.
pub(crate) fn refined_share(deviation: f64, band: f64) -> f64 {
    if deviation > 1.0 {
        return 1.0;
    }
    let x = if band > 0.0 { ((deviation - (1.0 - band)) / band).max(0.0) } else { 0.0 };
    x * x * (3.0 - 2.0 * x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ball::Ball;
    use crate::convex::{Hull, Limits, Separation, Start, gjk};
    use crate::motion::Motion;
    use palpate_core::Pose;
    use palpate_core::glam::DQuat;
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    #[test]
    fn pairs_stay_refined_for_as_long_as_predicted() {
        const ERROR: f64 = 0.1;
        let mut rng = StdRng::seed_from_u64(0x0D1A);
        let mut kept = 0;
        for round in 0..4000 {
            let mut random = |size: f64| rng.random_range(-size..size);
            let mut vector = |size: f64| DVec3::new(random(size), random(size), random(size));
            let points = [0, 1].map(|_| (0..12).map(|_| vector(1.0).normalize()).collect::<Vec<_>>());
            let mut pose = Pose::new(vector(1.0).normalize() * 2.2, DQuat::from_scaled_axis(vector(3.0)));
            let moves = [0; 4].map(|_| (vector(0.03), vector(0.03)));
            // Most vertices have a small D, some a large one.
            let areas =
                [0, 1].map(|_| (0..12).map(|_| 0.01 + random(1.0).max(0.0).powi(3)).collect::<Vec<_>>());
            let details = areas.each_ref().map(|areas| Detail {
                missing: ERROR * 0.5,
                child_resolution: f64::INFINITY,
                least_area: 0.01,
                largest_area: areas.iter().copied().fold(0.0, f64::max),
                mean_area: areas.iter().sum::<f64>() / 12.0,
            });
            let hulls = points.each_ref().map(Hull::new);
            let limits = Limits { beyond: 1.0, share: 0.0, enough: -1.0, precision: 1e-12 };
            let find = |placement: &Placement| {
                gjk::distance(&hulls[0], &hulls[1], placement, Start::Axis(DVec3::X), &limits)
            };
            let is_refined = |found: &Distance| {
                let areas = &areas;
                let [side_a, side_b] =
                    [0, 1].map(|side| (&details[side], move |vertex: u32| areas[side][vertex as usize]));
                weighted_deviation(found, side_a, side_b, limits.beyond, ERROR) > 1.0
            };
            let ball = Ball { center: DVec3::ZERO, radius: 1.0 };
            let mut motion = Motion::default();
            let mut placement = Placement::between(&pose, &Pose::IDENTITY);
            motion.step(&ball, &ball, &placement, 0.0);
            let found = find(&placement);
            if found.separation != Separation::Within || !is_refined(&found) {
                continue;
            }
            let areas = &areas;
            let [side_a, side_b] = [0, 1]
                .map(|side| (&details[side], &hulls[side], move |vertex: u32| areas[side][vertex as usize]));
            let lasts = refined_for(&found, side_a, side_b, &placement, ERROR, 1e-15);
            for (shift, turn) in moves {
                pose = Pose::new(pose.translation + shift, DQuat::from_scaled_axis(turn) * pose.rotation);
                placement = Placement::between(&pose, &Pose::IDENTITY);
                motion.step(&ball, &ball, &placement, 0.0);
                if motion.bound() > lasts {
                    break;
                }
                assert!(
                    is_refined(&find(&placement)),
                    "seed 0x0D1A, round {round}: {} of {lasts} m",
                    motion.bound()
                );
                kept += 1;
            }
        }
        assert!(kept > 300, "{kept}");
    }
}
