//! Bounds of the broad phase: a lower bound on an object's gap to the reach, and an upper bound on its
//! motion.
//!
//! All are rounded to the safe side: an object may be tested needlessly, but none in reach is missed.

use palpate_core::Pose;
use palpate_core::glam::{DQuat, DVec3};

use super::kinds::Kind;
use crate::tolerances::{COORDINATE_ROUNDING, ROUNDING_SLACK, UNIT_QUATERNION_SLACK};

/// Pose of an object with the centre of its sphere.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placed {
    pub pose: Pose,
    /// Centre of its bounding sphere, in the world, m.
    pub center: DVec3,
}

impl Placed {
    pub fn new(pose: &Pose, kind: &Kind) -> Self {
        Self { pose: *pose, center: pose.transform_point(kind.ball.center) }
    }

    /// Lower bound on the distance of the object's sphere and box from a point in the world, minus `reach`,
    /// m.
    pub fn gap(&self, kind: &Kind, point: DVec3, reach: f64) -> f64 {
        let distance = point.distance(self.center);
        let to_sphere = distance - kind.ball.radius;
        let local = self.pose.inverse().transform_point(point);
        let to_box = local.distance(local.clamp(kind.low, kind.high));
        let slack = UNIT_QUATERNION_SLACK * (distance + reach + kind.ball.radius + kind.shape.coordinates());
        to_sphere.max(to_box) - reach - slack - rounding(point) - rounding(self.center)
    }

    /// Motion bound, m, at which an object is due for a recheck after it has been moved: earlier than before
    /// by a bound on the motion of any point of its sphere or box, |Δ**c**| + turn · distance of the furthest
    /// corner.
    pub fn recheck_after_move(&self, recheck_at: f64, moved: &Self, kind: &Kind) -> f64 {
        let length =
            moved.center.distance(self.center) + turn(self.pose.rotation, moved.pose.rotation) * kind.corner;
        let rounding = rounding(moved.center) + rounding(self.center);
        recheck_at - length * (1.0 + ROUNDING_SLACK) - rounding
    }
}

/// Bound on the decrease of the gap of an object at rest, m, by the motion of the probe's centre and a change
/// of the tolerance.
pub(crate) fn probe_motion((last, before): (DVec3, f64), (center, tolerance): (DVec3, f64)) -> f64 {
    if last == center && before == tolerance {
        return 0.0;
    }
    let length = center.distance(last) + (tolerance - before).abs();
    length * (1.0 + ROUNDING_SLACK) + rounding(center) + rounding(last)
}

/// Bound on the motion of a point of the unit sphere from one orientation to another: 2 sin(θ/2) ≤ 4
/// sin(θ/4), and the chord between the quaternions, which are θ/2 apart, is 2 sin(θ/4).
fn turn(from: DQuat, to: DQuat) -> f64 {
    2.0 * (from - to).length().min((from + to).length())
}

/// Rounding of a point's coordinates, m.
fn rounding(point: DVec3) -> f64 {
    COORDINATE_ROUNDING * point.abs().max_element()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    #[test]
    fn no_point_of_the_unit_sphere_moves_further_than_the_turn() {
        let mut rng = StdRng::seed_from_u64(0x0070_4211);
        let mut vector = || DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
        for round in 0..2000 {
            let [from, to] = [0, 1].map(|_| DQuat::from_scaled_axis(4.0 * vector()));
            // A rotation is the same with its quaternion negated.
            let to = if round % 2 == 0 { to } else { -to };
            let point = vector().normalize();
            let moved = (from * point).distance(to * point);
            assert!(moved <= turn(from, to) + 1e-12, "round {round}: {moved} m, {}", turn(from, to));
        }
    }
}
