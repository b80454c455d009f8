//! Free flight: a ballistic path and torque-free rotation (Eq. 2.2 without torque).
//!
//! The centre of mass follows its parabola exactly. The rotation is split into rotations about the principal
//! axes one after the other, each of which is solved exactly: L_i stays constant, and the body rotates by
//! L_i/I_i τ about its axis i. The sequence is symmetric, and three such steps make one of fourth order
//! (Yoshida 1990). The splitting is symplectic: for any step, angular momentum is constant to rounding, and
//! the error of the energy is bounded instead of drifting. A gyroscopic term integrated explicitly would gain
//! energy.

use glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist};

use crate::body::{BodyState, RigidBody};

/// Largest rotation in one step of the splitting, rad. Larger values cost accuracy of the energy.
const MAX_ROTATION: f64 = 0.05;

/// Maximum number of steps of a flight. A body that spins faster still conserves its momentum.
const MAX_STEPS: f64 = 4096.0;

/// Returns the state after a flight of a duration (s) under gravity (m/s², world axes).
pub fn fly(body: &RigidBody, state: &BodyState, gravity: DVec3, duration: f64) -> BodyState {
    let Twist { linear, angular } = state.twist;
    let translation = state.pose.translation + duration * (linear + 0.5 * duration * gravity);
    let linear = linear + duration * gravity;
    if angular == DVec3::ZERO {
        return BodyState {
            pose: Pose { translation, ..state.pose },
            twist: Twist { linear, ..state.twist },
        };
    }
    let (moments, axes) = body.principal_moments();
    let momentum = body.angular_momentum(state);
    let mut rotation = body.principal_rotation(state);
    let mut local = rotation.conjugate() * momentum;
    let steps = (angular.length() * duration.abs() / MAX_ROTATION).ceil().clamp(1.0, MAX_STEPS);
    let step = duration / steps;
    // Yoshida's weights of the three symmetric steps: w, 1 − 2 w, w with w = 1 / (2 − ∛2).
    let outer = 1.0 / (2.0 - 2f64.cbrt());
    let parts = [outer, 1.0 - 2.0 * outer, outer].map(|weight| weight * step);
    for _ in 0..steps as usize {
        for part in parts {
            // Strang splitting: axes x, y by half, z in full, then back.
            for (axis, time) in
                [(0, 0.5 * part), (1, 0.5 * part), (2, part), (1, 0.5 * part), (0, 0.5 * part)]
            {
                let turn = DQuat::from_scaled_axis(DVec3::AXES[axis] * (local[axis] / moments[axis] * time));
                local = turn.conjugate() * local;
                rotation *= turn;
            }
        }
        rotation = rotation.normalize();
    }
    let angular = rotation * (rotation.conjugate() * momentum / moments);
    let rotation = (rotation * axes.conjugate()).normalize();
    BodyState { pose: Pose { translation, rotation }, twist: Twist { linear, angular } }
}

#[cfg(test)]
mod tests {
    use glam::DMat3;

    use super::*;

    /// Bodies rotating about the middle axis, which is unstable, about a general one, and about a stable one.
    fn tumbling() -> [(RigidBody, BodyState); 3] {
        let inertia = DMat3::from_diagonal(DVec3::new(1e-5, 2e-5, 2.5e-5));
        let body = RigidBody::new(0.1, DVec3::new(0.01, 0.0, 0.02), inertia).unwrap();
        [DVec3::new(1e-3, 20.0, 1e-3), DVec3::new(30.0, 5.0, -12.0), DVec3::new(0.0, 0.0, 40.0)].map(
            |angular| {
                let pose = Pose::new(DVec3::ONE, DQuat::from_rotation_x(0.4));
                (body, BodyState { pose, twist: Twist::new(DVec3::new(0.5, -1.0, 2.0), angular) })
            },
        )
    }

    #[test]
    fn free_flight_keeps_energy_and_angular_momentum() {
        for (body, start) in tumbling() {
            // Without gravity: in a fall of 100 s, energies 1e5 times as large would cancel.
            let gravity = DVec3::ZERO;
            let (energy, momentum) = (body.kinetic_energy(&start), body.angular_momentum(&start));
            let mut state = start;
            for step in 0..100_000 {
                state = fly(&body, &state, gravity, 1e-3);
                if step % 1000 == 0 {
                    let gained = body.kinetic_energy(&state) / energy - 1.0;
                    assert!(gained.abs() < 1e-9, "step {step}: energy by {gained:e}");
                    let off = (body.angular_momentum(&state) - momentum).length() / momentum.length();
                    assert!(
                        off < 1e-15 * f64::from(step + 10),
                        "step {step}: momentum by {off:e}, more than rounds"
                    );
                    assert!(state.is_valid());
                }
            }
        }
    }

    #[test]
    fn fall_is_a_parabola_for_any_division() {
        let gravity = DVec3::new(0.0, 0.0, -9.81);
        for (body, start) in tumbling() {
            let whole = fly(&body, &start, gravity, 0.5);
            let parts = (0..500).fold(start, |state, _| fly(&body, &state, gravity, 1e-3));
            let total =
                |state: &BodyState| body.kinetic_energy(state) + body.potential_energy(state, gravity);
            assert!((total(&whole) / total(&start) - 1.0).abs() < 1e-9);
            let expected = start.pose.translation + 0.5 * start.twist.linear + 0.125 * gravity;
            for state in [whole, parts] {
                assert!((state.pose.translation - expected).length() < 1e-12);
            }
        }
    }

    /// Without the gyroscopic term, with ω constant, angular momentum is not conserved.
    #[test]
    fn constant_angular_velocity_violates_conservation() {
        let (body, start) = tumbling()[1];
        let pose = (0..1000).fold(start.pose, |pose, _| pose.moved(&start.twist, 1e-3));
        let momentum = body.angular_momentum(&start);
        let off = (body.angular_momentum(&BodyState { pose, ..start }) - momentum).length();
        assert!(off > 0.1 * momentum.length(), "{off:e}");
    }

    #[test]
    fn symmetric_top_precesses_at_the_known_rate() {
        let (flat, tall) = (2e-5, 1e-5);
        let inertia = DMat3::from_diagonal(DVec3::new(flat, flat, tall));
        let body = RigidBody::new(0.1, DVec3::ZERO, inertia).unwrap();
        let spin = DVec3::new(3.0, 0.0, 25.0);
        let start = BodyState { pose: Pose::IDENTITY, twist: Twist::new(DVec3::ZERO, spin) };
        let time = 0.7;
        let end = (0..700).fold(start, |state, _| fly(&body, &state, DVec3::ZERO, time / 700.0));
        // In body axes ω rotates about the top's axis at (I_z − I_x)/I_x ω_z.
        let local = end.pose.rotation.conjugate() * end.twist.angular;
        let expected = DQuat::from_rotation_z((tall - flat) / flat * spin.z * time) * spin;
        assert!((local - expected).length() < 1e-6, "{local} for {expected}");
    }
}
