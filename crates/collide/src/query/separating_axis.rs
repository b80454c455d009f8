//! The cached separating axis of two hulls.
//!
//! The motion bound counts motion in all directions alike, so bodies that slide along one another exceed it
//! quickly. Along an axis that separated two hulls, only the motion in its direction counts: that of the
//! smaller hull's centre, which is known, and that of its points about the centre, which is at most its
//! radius times the angle that the bodies have turned.

use palpate_core::glam::DVec3;

use crate::convex::{Distance, Placement};
use crate::shape::Packed;
use crate::tolerances::TURN_SLACK;

/// A direction along which two hulls were apart, with their separation.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SeparatingAxis {
    /// Unit vector in the frame of the larger node's body; it points from the smaller hull to the larger
    /// one.
    direction: DVec3,
    /// Separation of the hulls then, plus the smaller node's centre along the direction then, m.
    offset: f64,
    /// Bound on the rotation of the bodies then, rad.
    turn: f64,
    /// Whether the hulls are those of the patches, rather than the bounding ones.
    pub of_patches: bool,
}

impl SeparatingAxis {
    /// The axis along which a distance query found the hulls of two nodes to be apart; `None` if they are
    /// not.
    pub fn from_distance(
        found: &Distance,
        [a, b]: &[Packed; 2],
        placement: &Placement,
        turn: f64,
        of_patches: bool,
    ) -> Option<Self> {
        let direction =
            if moves_b(a, b) { found.direction } else { -placement.direction_to_b(found.direction) };
        let offset = found.lower + direction.dot(center(a, b, placement));
        (found.lower > 0.0).then_some(Self { direction, offset, turn, of_patches })
    }

    /// Lower bound on the present separation of the hulls, m. `turn`: bound on the rotation of the bodies
    /// by now, rad; `rounding`: that of coordinates, m.
    ///
    /// With the direction **u**, the smaller node's centre **c** and its radius r, it is
    /// separation then + **u** · (**c** then − **c** now) − r (turn now − turn then).
    pub fn separation(&self, [a, b]: &[Packed; 2], placement: &Placement, turn: f64, rounding: f64) -> f64 {
        let turned = (turn - self.turn) * a.radius.min(b.radius) * (1.0 + TURN_SLACK);
        self.offset - self.direction.dot(center(a, b, placement)) - turned - rounding
    }
}

/// Whether b's node is the smaller one.
fn moves_b(a: &Packed, b: &Packed) -> bool {
    b.radius <= a.radius
}

/// The smaller node's centre, in the frame of the larger one's body, m.
fn center(a: &Packed, b: &Packed, placement: &Placement) -> DVec3 {
    if moves_b(a, b) {
        placement.point(b.center)
    } else {
        placement.direction_to_b(a.center - placement.translation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ball::Ball;
    use crate::convex::{Hull, Limits, Start, gjk};
    use crate::motion::Motion;
    use palpate_core::Pose;
    use palpate_core::glam::DQuat;
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    #[test]
    fn hulls_are_never_closer_than_the_bound_of_their_axis() {
        let mut rng = StdRng::seed_from_u64(0x9A27);
        let mut vector =
            |size: f64| DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0))) * size;
        let mut kept = 0;
        for round in 0..2000 {
            let size = [[1.0, 0.2], [0.2, 1.0], [0.7, 0.7]][round % 3];
            let centers = [vector(1.0), vector(1.0)];
            let points = [0, 1].map(|side| {
                let point = |_| centers[side] + vector(1.0).clamp_length_max(1.0) * size[side];
                (0..12).map(point).collect::<Vec<_>>()
            });
            let nodes = [0, 1].map(|side| Packed::sphere(centers[side], size[side]));
            let (hull_a, hull_b) = (Hull::new(&points[0]), Hull::new(&points[1]));
            let limits = Limits { beyond: 0.0, share: 0.5, enough: -1.0, precision: 1e-12 };
            let distance = |placement: &Placement| {
                gjk::distance(&hull_a, &hull_b, placement, Start::Axis(DVec3::X), &limits)
            };
            let mut pose = Pose::new(vector(3.0), DQuat::from_scaled_axis(vector(3.0)));
            let balls = [0, 1].map(|side| Ball { center: centers[side], radius: size[side] });
            let mut motion = Motion::default();
            let mut placement = Placement::between(&pose, &Pose::IDENTITY);
            motion.step(&balls[0], &balls[1], &placement, 0.0);
            let Some(axis) =
                SeparatingAxis::from_distance(&distance(&placement), &nodes, &placement, motion.turn(), true)
            else {
                continue;
            };
            for _ in 0..5 {
                pose = Pose::new(
                    pose.translation + vector(0.1),
                    DQuat::from_scaled_axis(vector(0.1)) * pose.rotation,
                );
                placement = Placement::between(&pose, &Pose::IDENTITY);
                motion.step(&balls[0], &balls[1], &placement, 0.0);
                let lower = axis.separation(&nodes, &placement, motion.turn(), 1e-15);
                let found = gjk::distance(
                    &hull_a,
                    &hull_b,
                    &placement,
                    Start::Axis(DVec3::X),
                    &Limits { beyond: 1e9, ..limits },
                );
                assert!(lower <= found.distance + 1e-12, "round {round}: {lower} m, {} m", found.distance);
                kept += usize::from(lower > 0.0);
            }
        }
        assert!(kept > 1000, "{kept}");
    }
}
