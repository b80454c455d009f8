//! Relative motion of two bodies: a bound on any change of distance between their parts, and a bound on their
//! rotation.
//!
//! An answer such as "these hulls are 3 mm out of reach" stays valid until the motion bound has grown by 3
//! mm. So an answer is stored with the value of the motion bound up to which it is valid.

use palpate_core::glam::DVec3;

use crate::ball::Ball;
use crate::convex::Placement;
use crate::tolerances::ROUNDING_SLACK;

/// The relative motion of two bodies, summed over all steps.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Motion {
    last: Option<Placement>,
    bound: f64,
    turn: f64,
}

impl Motion {
    /// Discards the bodies' placement.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// Restarts the bound from zero at the present placement.
    pub fn restart(&mut self) {
        self.bound = 0.0;
    }

    /// The motion bound, m: the distance of any two points of the bodies has changed by at most the growth of
    /// the bound.
    pub fn bound(&self) -> f64 {
        self.bound
    }

    /// Bound on the relative rotation of the bodies, rad: Σ 2 sin(θ/2) over all steps.
    pub fn turn(&self) -> f64 {
        self.turn
    }

    /// Adds to the bound, as if all distances had shrunk by a length, m.
    pub fn add(&mut self, length: f64) {
        self.bound += length;
    }

    /// Adds a step of the bodies a and b, which are within these spheres. `rounding`: that of coordinates, m.
    ///
    /// A point of b moves in a's frame by at most |c' − c| + r · turn, with the motion of b's centre and the
    /// rotation about it, and a point of a in b's frame likewise. Either bounds the change of the distance of
    /// two points, so the smaller one counts.
    pub fn step(&mut self, a: &Ball, b: &Ball, placement: &Placement, rounding: f64) {
        if let Some(last) = self.last.filter(|last| last != placement) {
            let turned = placement.rotation - last.rotation;
            // ‖R' − R‖_F = 2√2 sin(θ/2): √2 times the largest displacement on the unit sphere, 2 sin(θ/2).
            let [x, y, z] = [turned.x_axis, turned.y_axis, turned.z_axis].map(DVec3::length_squared);
            let turn = (0.5 * (x + y + z)).sqrt();
            let center = b.center;
            let of_b = placement.point(center).distance(last.point(center)) + turn * b.radius;
            let center = |placement: &Placement| placement.direction_to_b(a.center - placement.translation);
            let of_a = center(placement).distance(center(&last)) + turn * a.radius;
            self.turn += turn + ROUNDING_SLACK * turn + f64::EPSILON;
            self.bound += of_a.min(of_b) * (1.0 + ROUNDING_SLACK) + rounding;
        }
        self.last = Some(*placement);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_core::Pose;
    use palpate_core::glam::DQuat;
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    fn vector(rng: &mut StdRng, size: f64) -> DVec3 {
        DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0))) * size
    }

    #[test]
    fn no_two_points_come_closer_than_the_bound() {
        let mut rng = StdRng::seed_from_u64(0x0030_1107);
        let mut vector = |size: f64| vector(&mut rng, size);
        for round in 0..2000 {
            let size = [1e-4, 0.1, 3.0][round % 3];
            let a = Ball { center: vector(2.0), radius: 1.5 };
            let b = Ball { center: vector(2.0), radius: [0.1, 1.5, 8.0][round % 3] };
            let pose = Pose::new(vector(3.0), DQuat::from_scaled_axis(vector(1.0)));
            let moved = Pose::new(
                pose.translation + vector(size),
                DQuat::from_scaled_axis(vector(size)) * pose.rotation,
            );
            let (before, after) =
                (Placement::between(&pose, &Pose::IDENTITY), Placement::between(&moved, &Pose::IDENTITY));
            let mut motion = Motion::default();
            motion.step(&a, &b, &before, 0.0);
            assert_eq!(motion.bound(), 0.0);
            motion.step(&a, &b, &after, 0.0);
            for _ in 0..50 {
                let p = a.center + vector(1.0).normalize() * a.radius;
                let q = b.center + vector(1.0).normalize() * b.radius;
                let [from, to] = [before, after].map(|placement| p.distance(placement.point(q)));
                let change = (from - to).abs();
                assert!(change <= motion.bound(), "round {round}: {change} m, bound {}", motion.bound());
            }
        }
    }

    #[test]
    fn the_bound_is_zero_at_rest_and_never_decreases() {
        let mut rng = StdRng::seed_from_u64(0x0030_1108);
        let ball = Ball { center: DVec3::X, radius: 1.0 };
        let placement = |at: DVec3| Placement::between(&Pose::from_translation(at), &Pose::IDENTITY);
        let mut motion = Motion::default();
        let mut at = DVec3::ZERO;
        motion.step(&ball, &ball, &placement(at), 1e-15);
        for step in 0..100 {
            let before = (motion.bound(), motion.turn());
            motion.step(&ball, &ball, &placement(at), 1e-15);
            assert_eq!((motion.bound(), motion.turn()), before, "step {step}: at rest");
            // To and fro.
            at = if step % 2 == 0 { vector(&mut rng, 0.1) } else { DVec3::ZERO };
            motion.step(&ball, &ball, &placement(at), 1e-15);
            assert!(motion.bound() > before.0, "step {step}");
        }
        let turn = motion.turn();
        motion.restart();
        assert_eq!((motion.bound(), motion.turn()), (0.0, turn), "angles are counted on");
        motion.add(0.25);
        assert_eq!(motion.bound(), 0.25);
    }

    #[test]
    fn turns_are_bounded() {
        let mut rng = StdRng::seed_from_u64(0x0030_1109);
        let ball = Ball { center: DVec3::ZERO, radius: 1.0 };
        let mut motion = Motion::default();
        let (mut rotation, mut turned) = (DQuat::IDENTITY, 0.0);
        for _ in 0..200 {
            let pose = Pose::new(DVec3::ZERO, rotation);
            motion.step(&ball, &ball, &Placement::between(&pose, &Pose::IDENTITY), 0.0);
            assert!(motion.turn() >= turned - 1e-12, "{} of {turned} rad", motion.turn());
            let turn = vector(&mut rng, 0.5);
            turned += 2.0 * (0.5 * turn.length()).sin();
            rotation = DQuat::from_scaled_axis(turn) * rotation;
        }
    }
}
