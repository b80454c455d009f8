//! Free flight: ballistic, and turning freely (Eq. 2.2 without torque).
//!
//! The centre of mass follows its parabola exactly. A free turn is split into turns about the principal axes one after the
//! other, each of which is solved exactly: L_i stays, and the body turns by L_i/I_i τ about its axis i (symmetric, and three
//! such steps make one of fourth order: Yoshida 1990). The splitting is symplectic: whatever the step, angular momentum
//! stays the same to rounding, and the energy errs within bounds instead of drifting. A gyroscopic term integrated
//! explicitly would gain energy.

use glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist};

use crate::body::{BodyState, RigidBody};

/// Largest turn in one step of the splitting, rad.
const TURN: f64 = 0.05;

/// Most steps that a flight is divided into: a body that spins faster still keeps its momentum.
const STEPS: f64 = 4096.0;

/// A state after a flight of a duration (s) under gravity (m/s², world axes).
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
    let steps = (angular.length() * duration.abs() / TURN).ceil().clamp(1.0, STEPS);
    let step = duration / steps;
    // Yoshida's weights.
    let outer = 1.0 / (2.0 - 2f64.cbrt());
    let parts = [outer, 1.0 - 2.0 * outer, outer].map(|weight| weight * step);
    for _ in 0..steps as usize {
        for part in parts {
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

    /// Turning about the middle axis, which is unstable, and about any other.
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
            // Over a hundred seconds of fall energies would cancel that are a hundred thousand times as large.
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
    fn a_fall_is_a_parabola_however_it_is_divided() {
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

    /// With the gyroscopic term left out, as if ω stayed the same, angular momentum does not.
    #[test]
    fn a_constant_angular_velocity_would_not_do() {
        let (body, start) = tumbling()[1];
        let pose = (0..1000).fold(start.pose, |pose, _| pose.moved(&start.twist, 1e-3));
        let momentum = body.angular_momentum(&start);
        let off = (body.angular_momentum(&BodyState { pose, ..start }) - momentum).length();
        assert!(off > 0.1 * momentum.length(), "{off:e}");
    }

    #[test]
    fn a_symmetric_top_precesses_as_it_should() {
        let (flat, tall) = (2e-5, 1e-5);
        let inertia = DMat3::from_diagonal(DVec3::new(flat, flat, tall));
        let body = RigidBody::new(0.1, DVec3::ZERO, inertia).unwrap();
        let spin = DVec3::new(3.0, 0.0, 25.0);
        let start = BodyState { pose: Pose::IDENTITY, twist: Twist::new(DVec3::ZERO, spin) };
        let time = 0.7;
        let end = (0..700).fold(start, |state, _| fly(&body, &state, DVec3::ZERO, time / 700.0));
        // In body axes ω turns about the top's own at (I_z − I_x)/I_x ω_z.
        let local = end.pose.rotation.conjugate() * end.twist.angular;
        let expected = DQuat::from_rotation_z((tall - flat) / flat * spin.z * time) * spin;
        assert!((local - expected).length() < 1e-6, "{local} for {expected}");
    }
}
