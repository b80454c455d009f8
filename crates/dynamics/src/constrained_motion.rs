//! Motion of a body that contacts constrain, by Gauss' principle of least constraint. The proxy of six
//! degrees of freedom follows the body by it (§5.6.1; Ortega, Redon and Coquillart, "A six degree-of-freedom
//! god-object method for haptic display of rigid bodies", 2007).

use glam::{DMat3, DVec3};
use palpate_core::Twist;

use crate::body::Body;

/// Limit of the displacement of a point of the body along a direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionLimit {
    /// Unit direction, world axes.
    pub direction: DVec3,
    /// The point, from the centre of mass, world axes, m.
    pub arm: DVec3,
    /// Largest displacement, m; below 0 if the point has to move back by as much.
    pub room: f64,
}

impl MotionLimit {
    /// Displacement of the point along the direction by a motion, to first order in its angle, m.
    pub fn displacement(&self, motion: &Twist) -> f64 {
        motion.velocity_at(self.arm).dot(self.direction)
    }
}

/// Largest number of sweeps over the limits. With fewer, motions along many planes exceed them.
const MAX_SWEEPS: usize = 256;

/// Largest change of the displacement along a limit in the last sweep, relative to the wanted motion. With
/// more, limits are exceeded by about as much.
const SWEEP_TOLERANCE: f64 = 1e-6;

/// Finds the motion **u** (m and rad: a twist over a time of 1) that exceeds no limit, to first order in its
/// angle, and is nearest to a wanted one for a body at `rotation`:
///
/// min ½ (**u** − **u**_w)ᵀ M (**u** − **u**_w) with Jᵢ **u** ≤ roomᵢ, Jᵢ = (**n**ᵢ, **a**ᵢ × **n**ᵢ).
///
/// Its conditions are **u** = **u**_w − M⁻¹ Σ Jᵢᵀ λᵢ with λᵢ ≥ 0, and λᵢ = 0 unless limit i binds. They are
/// solved by projected Gauss–Seidel sweeps over the multipliers λ, of which there must be as many as limits.
/// If the sweeps run out, limits are kept approximately.
pub fn constrained_motion(
    body: &Body,
    rotation: &DMat3,
    wanted: &Twist,
    limits: &[MotionLimit],
    multipliers: &mut [f64],
) -> Twist {
    let mobility = *rotation * body.inertia.inverse() * rotation.transpose();
    let mut motion = *wanted;
    multipliers.fill(0.0);
    let size = limits.iter().fold(wanted.linear.length(), |most, limit| {
        most.max(limit.displacement(wanted).abs()).max(-limit.room)
    });
    for _ in 0..MAX_SWEEPS {
        let mut change: f64 = 0.0;
        for (limit, multiplier) in limits.iter().zip(&mut *multipliers) {
            let excess = limit.displacement(&motion) - limit.room;
            if excess <= 0.0 && *multiplier == 0.0 {
                continue;
            }
            // Δλ = max(excess / (J M⁻¹ Jᵀ), −λ) and **u** −= M⁻¹ Jᵀ Δλ.
            let moment = limit.arm.cross(limit.direction);
            let turn = mobility * moment;
            let compliance = 1.0 / body.mass + moment.dot(turn);
            let step = (excess / compliance).max(-*multiplier);
            *multiplier += step;
            motion.linear -= limit.direction * (step / body.mass);
            motion.angular -= turn * step;
            change = change.max((step * compliance).abs());
        }
        if change <= SWEEP_TOLERANCE * size {
            break;
        }
    }
    motion
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

    use super::*;
    use crate::differences::{random_direction, random_pose, random_twist, random_vector};

    fn block(mass: f64) -> Body {
        Body::new(mass, DMat3::from_diagonal(DVec3::new(2e-5, 3e-5, 4e-5))).expect("a block")
    }

    #[test]
    fn free_motion_is_as_wanted() {
        let mut rng = StdRng::seed_from_u64(11);
        let wanted = random_twist(&mut rng, 0.01, 0.3);
        let limit = MotionLimit { direction: DVec3::X, arm: DVec3::Y, room: 1.0 };
        let mut multipliers = [7.0];
        let motion = constrained_motion(&block(0.1), &DMat3::IDENTITY, &wanted, &[limit], &mut multipliers);
        assert_eq!(motion, wanted);
        assert_eq!(multipliers, [0.0]);
    }

    #[test]
    fn body_slides_along_a_floor() {
        let limits = [-1.0, 1.0].map(|x| MotionLimit {
            direction: DVec3::NEG_Z,
            arm: DVec3::new(0.02 * x, 0.0, -0.01),
            room: 1e-3,
        });
        let wanted = Twist::new(DVec3::new(0.004, 0.0, -0.005), DVec3::ZERO);
        let mut multipliers = [0.0; 2];
        let motion = constrained_motion(&block(0.1), &DMat3::IDENTITY, &wanted, &limits, &mut multipliers);
        // The points lie ahead of and behind the centre of mass alike, which goes down as far as there is
        // room.
        assert!((motion.linear - DVec3::new(0.004, 0.0, -0.001)).length() < 1e-8, "{motion:?}");
        assert!(motion.angular.length() < 1e-6);
    }

    #[test]
    fn body_moves_back_behind_a_limit_that_it_has_passed() {
        let limits = [(DVec3::NEG_Z, -2e-3), (DVec3::X, 1e-3)].map(|(direction, room)| MotionLimit {
            direction,
            arm: DVec3::ZERO,
            room,
        });
        let mut multipliers = [0.0; 2];
        let motion =
            constrained_motion(&block(0.1), &DMat3::IDENTITY, &Twist::ZERO, &limits, &mut multipliers);
        assert!((motion.linear - DVec3::Z * 2e-3).length() < 1e-8, "{motion:?}");
        assert!(multipliers[0] > 0.0 && multipliers[1] == 0.0);
    }

    /// The optimality conditions: limits are kept, multipliers are positive for limits that bind and zero for
    /// others, and M (u_w − u) = Σ Jᵀ λ.
    #[test]
    fn optimality_conditions_hold() {
        let seed = 12;
        let mut rng = StdRng::seed_from_u64(seed);
        let mut binding = 0;
        for case in 0..300 {
            let body = block(rng.random_range(0.01..1.0));
            let rotation = DMat3::from_quat(random_pose(&mut rng, 1.0).rotation);
            let wanted = random_twist(&mut rng, 0.01, 0.2);
            let limits: Vec<MotionLimit> = (0..rng.random_range(1..4))
                .map(|_| MotionLimit {
                    direction: random_direction(&mut rng),
                    arm: random_vector(&mut rng, 0.05),
                    room: rng.random_range(-1e-3..5e-3),
                })
                .collect();
            let mut multipliers = vec![0.0; limits.len()];
            let motion = constrained_motion(&body, &rotation, &wanted, &limits, &mut multipliers);
            let mut momentum = (DVec3::ZERO, DVec3::ZERO);
            for (limit, &multiplier) in limits.iter().zip(&multipliers) {
                let left = limit.room - limit.displacement(&motion);
                assert!(left > -2e-5, "seed {seed}, case {case}: {left} m past a limit");
                assert!(multiplier >= 0.0);
                assert!(multiplier == 0.0 || left < 2e-5, "seed {seed}, case {case}: pushed {left} m early");
                binding += usize::from(multiplier > 0.0);
                momentum.0 += limit.direction * multiplier;
                momentum.1 += limit.arm.cross(limit.direction) * multiplier;
            }
            let linear = (wanted.linear - motion.linear) * body.mass - momentum.0;
            let inertia = rotation * body.inertia * rotation.transpose();
            let angular = inertia * (wanted.angular - motion.angular) - momentum.1;
            assert!(linear.length() < 1e-12 && angular.length() < 1e-12, "seed {seed}, case {case}");
        }
        assert!(binding > 200, "only {binding} limits bind");
    }
}
