//! Whether the detail that a pair of nodes leaves out would be felt (§3.4.3).
//!
//! What is left out of a node is as large as φ = s/r² (Eq. 3.6), a volume: its deviation from the mesh, times the area
//! that one of its samples stands for. It is averaged over the area of contact, for which the support area D of the
//! nearest points stands: s* = max(φ_a, φ_b) / max(D_a, D_b) (Eq. 3.7). Where s* is above the threshold s₀ the pair has
//! to be refined.
//!
//! D is interpolated at the nearest points (§3.4.3), which are only searched for where the least and the largest D of
//! the nodes' vertices do not decide already. Patches that overlap have no nearest points, and where they are further apart
//! than d these are no contact: there it is the mean D of each patch, and it goes over to that before either happens. (With the
//! mean everywhere, jaws took three quarters of the time at s₀ = 2.5 %, and forces between cusps, where D is small, came
//! out twice as far off: the same error takes the same time.)

use palpate_core::Clod;
use palpate_core::clod::Node;
use palpate_core::glam::DVec3;

use crate::convex::{Distance, Hull, Placement};
use crate::tolerances::NOMINAL_ERROR;

/// D goes over from that of the nearest points to the patches' mean over this part of d, at either end.
const GOING_OVER: f64 = 0.25;

/// What the test reads of a node.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Detail {
    /// φ, m³: 0 at full resolution, infinite on free levels, which always have to be refined.
    pub missing: f64,
    /// Resolution of the children's level, 1/m: 0 if that is free, infinite without children.
    pub below: f64,
    /// Least and largest D of the extreme points of the patch, m².
    areas: (f64, f64),
    /// Their mean, m².
    mean_area: f64,
}

/// Least, largest and mean D of the extreme points of a patch, in units: bounds, and the mean to 2⁻²⁴.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SupportAreas([f32; 3]);

impl SupportAreas {
    /// Of a node; `unit`, m².
    pub fn of(clod: &Clod, node: &Node, unit: f64) -> Self {
        let areas = || clod.support_areas(node).iter().take(node.extreme as usize);
        let least = areas().fold(f64::INFINITY, f64::min) / unit;
        let largest = areas().fold(0.0, f64::max) / unit;
        let mean = areas().sum::<f64>() / f64::from(node.extreme.max(1)) / unit;
        let (low, high) = (least as f32, largest as f32);
        let low = if f64::from(low) > least { low.next_down() } else { low };
        let high = if f64::from(high) < largest { high.next_up() } else { high };
        Self([low, high, mean as f32].map(|area| area.min(f32::MAX)))
    }
}

impl Detail {
    /// Of a node; `unit` is that of its areas, m².
    pub fn of(clod: &Clod, node: &Node, areas: &SupportAreas, unit: f64) -> Self {
        let level = &clod.levels[node.level as usize];
        let missing = if level.free {
            f64::INFINITY
        } else if node.children.is_empty() || node.deviation == 0.0 {
            0.0
        } else {
            node.deviation / (level.resolution * level.resolution)
        };
        let below = if node.children.is_empty() {
            f64::INFINITY
        } else {
            let level = &clod.levels[node.level as usize - 1];
            if level.free { 0.0 } else { level.resolution }
        };
        let [least, largest, mean_area] = areas.0.map(|area| unit * f64::from(area));
        Self { missing, below, areas: (least, largest), mean_area }
    }

    /// How far above the plane that supports the patch's hull across a direction a point of the hull lies at least, m, where
    /// D, or anything between it and the mean, is `allowed` (m²) or more. 0 if that is not known.
    ///
    /// A point is a mean of vertices: where none at a height h has a D above c + kh, nor has the point.
    fn rise(&self, hull: &Hull, area: impl Fn(u32) -> f64, direction: DVec3, allowed: f64) -> f64 {
        if self.mean_area >= allowed || direction == DVec3::ZERO {
            return 0.0;
        }
        if self.areas.1 < allowed {
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
}

/// What is known of whether a pair has to be refined.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Refine {
    Yes,
    No,
    /// That depends on where the nearest points are.
    Depends,
}

/// The test without the nearest points; `error` is s₀, m. With a `band`, pairs are refined in part from (1 − band) s₀ on.
pub(crate) fn refine(a: &Detail, b: &Detail, error: f64, band: f64) -> Refine {
    let missing = a.missing.max(b.missing);
    if missing > error * a.areas.1.max(b.areas.1) {
        Refine::Yes
    } else if missing <= (1.0 - band) * error * a.areas.0.max(b.areas.0) {
        Refine::No
    } else {
        Refine::Depends
    }
}

/// s*/s₀ at the contact between two patches, given the distance between their hulls, and D at the points of each; infinite
/// where s₀ is 0. `tolerance` is d, `error` is s₀, m.
pub(crate) fn weighted_deviation(
    found: &Distance,
    (detail_a, area_a): (&Detail, impl Fn(u32) -> f64),
    (detail_b, area_b): (&Detail, impl Fn(u32) -> f64),
    tolerance: f64,
    error: f64,
) -> f64 {
    let (mut on_a, mut on_b) = (0.0, 0.0);
    for (vertex, weight) in found.simplex.vertices().iter().zip(found.simplex.weights()) {
        on_a += weight * area_a(vertex.a);
        on_b += weight * area_b(vertex.b);
    }
    let part = if tolerance > 0.0 { (found.distance / tolerance).min(1.0) } else { 1.0 };
    let share = (part.min(1.0 - part) / GOING_OVER).min(1.0);
    let area = |detail: &Detail, nearest: f64| {
        if share > 0.0 { detail.mean_area + share * (nearest - detail.mean_area) } else { detail.mean_area }
    };
    over(detail_a.missing.max(detail_b.missing), error * f64::max(area(detail_a, on_a), area(detail_b, on_b)))
}

/// How far two bodies may move with s* above s₀ still at the contact between two patches, where it is, m; 0 if that is not
/// known. Of each patch: its hull, and D at the hull's points. `error` is s₀, `rounding` that of coordinates, m.
///
/// When the bodies have moved by m, the new nearest points were at most 2m further apart before than the nearest points
/// then. So along the direction that the hulls were apart in, they lay that far above the supporting planes at most.
pub(crate) fn refined_for(
    found: &Distance,
    (detail_a, hull_a, area_a): (&Detail, &Hull, impl Fn(u32) -> f64),
    (detail_b, hull_b, area_b): (&Detail, &Hull, impl Fn(u32) -> f64),
    placement: &Placement,
    error: f64,
    rounding: f64,
) -> f64 {
    let allowed = detail_a.missing.max(detail_b.missing) / error;
    let slack = found.distance - found.lower + rounding;
    let rise_a = detail_a.rise(hull_a, area_a, found.direction, allowed);
    if rise_a <= slack {
        return 0.0;
    }
    let in_b = -placement.direction_to_b(found.direction);
    let rise_b = detail_b.rise(hull_b, area_b, in_b, allowed);
    (0.5 * (rise_a.min(rise_b) - slack)).max(0.0)
}

/// s*/s₀ of a pair, with the mean D of its patches; infinite on free levels. Where s₀ is 0 it orders pairs by s* alone.
pub(crate) fn urgency(a: &Detail, b: &Detail, error: f64) -> f64 {
    let missing = a.missing.max(b.missing);
    let area = a.mean_area.max(b.mean_area);
    over(missing, area * if error > 0.0 { error } else { NOMINAL_ERROR })
}

/// A quotient where 0/0 is 0.
fn over(missing: f64, allowed: f64) -> f64 {
    if missing > 0.0 { missing / allowed } else { 0.0 }
}

/// How much of a contact is left to the children of its pair: all of it where s* is above s₀, and with a `band`, from
/// (1 − band) s₀ on, a part that grows smoothly.
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
    fn what_is_refined_stays_so_for_as_long_as_it_tells() {
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
                below: f64::INFINITY,
                areas: (0.01, areas.iter().copied().fold(0.0, f64::max)),
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
                if motion.way() > lasts {
                    break;
                }
                assert!(
                    is_refined(&find(&placement)),
                    "seed 0x0D1A, round {round}: {} of {lasts} m",
                    motion.way()
                );
                kept += 1;
            }
        }
        assert!(kept > 300, "{kept}");
    }
}
