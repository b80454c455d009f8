//! How far two bodies have moved relative to one another, as a bound on any change of distance between their parts, and
//! how far they have turned.

use palpate_core::glam::DVec3;

use crate::ball::Ball;
use crate::convex::Placement;
use crate::tolerances::ROUNDING_SLACK;

/// The way that the bodies have come, as the sum over all steps of a bound on the distance that any two of their points
/// may have come closer.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Motion {
    last: Option<Placement>,
    way: f64,
    turn: f64,
}

impl Motion {
    /// Forgets where the bodies were.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// Counts the way from where the bodies are.
    pub fn restart(&mut self) {
        self.way = 0.0;
    }

    /// The way so far, m.
    pub fn way(&self) -> f64 {
        self.way
    }

    /// A bound on the angle by which the bodies have turned so far, rad: that of each step, added up, or twice the sine of
    /// its half.
    pub fn turn(&self) -> f64 {
        self.turn
    }

    /// Adds to the way: as if all distances had shrunk by this much, m.
    pub fn add(&mut self, way: f64) {
        self.way += way;
    }

    /// The bodies a and b, within these spheres, have moved. `rounding`: that of coordinates, m.
    ///
    /// No point of b moves further in a's frame than its sphere's centre does and a point of that sphere may turn about
    /// the centre; and the other way round. Either bounds how much closer two points have come.
    pub fn step(&mut self, a: &Ball, b: &Ball, placement: &Placement, rounding: f64) {
        if let Some(last) = self.last.filter(|last| last != placement) {
            let turned = placement.rotation - last.rotation;
            // The Frobenius norm of the difference of two rotations is √2 times the largest way on the unit sphere.
            let [x, y, z] = [turned.x_axis, turned.y_axis, turned.z_axis].map(DVec3::length_squared);
            let turn = (0.5 * (x + y + z)).sqrt();
            let center = b.center;
            let of_b = placement.point(center).distance(last.point(center)) + turn * b.radius;
            let center = |placement: &Placement| placement.direction_to_b(a.center - placement.translation);
            let of_a = center(placement).distance(center(&last)) + turn * a.radius;
            self.turn += turn + ROUNDING_SLACK * turn + f64::EPSILON;
            self.way += of_a.min(of_b) * (1.0 + ROUNDING_SLACK) + rounding;
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

    #[test]
    fn no_two_points_come_closer_than_the_way() {
        let mut rng = StdRng::seed_from_u64(0x0030_1107);
        let mut vector =
            |size: f64| DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0))) * size;
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
            assert_eq!(motion.way(), 0.0);
            motion.step(&a, &b, &after, 0.0);
            let (mut closest, mut apart) = (0.0_f64, 0.0_f64);
            for _ in 0..50 {
                let p = a.center + vector(1.0).normalize() * a.radius;
                let q = b.center + vector(1.0).normalize() * b.radius;
                let [from, to] = [before, after].map(|placement| p.distance(placement.point(q)));
                closest = closest.max((from - to).abs());
                apart = apart.max(closest);
            }
            assert!(closest <= motion.way(), "round {round}: {closest} m on a way of {}", motion.way());
        }
    }
}
