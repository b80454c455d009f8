//! One step of a held handle in six degrees of freedom: inertia, viscous damping, Coulomb friction, and the
//! hand's spring and damper.
//!
//! Translation and rotation are each m v̇ = f − b v − f_c v/‖v‖ + k_h (x_h − x) + b_h (v_h − v), with the
//! hand's mass added to the handle's. The step is backward Euler: spring, dampers and friction are taken at
//! the end of the step, so that it is stable for every step size and every parameter that is not negative.
//! Because the friction's magnitude is the same in all directions, the implicit equation has a closed form:
//! with p the momentum at the end of a step without friction and damping, the handle sticks (v = 0) if ‖p‖ ≤
//! h f_c, and friction takes h f_c off ‖p‖ otherwise. Backward Euler adds damping of its own, a ratio of
//! about h ω/2 at the natural frequency ω: 0.3 % for a firm hand at h = 0.1 ms.
//!
//! The rotational inertia is the same about every axis, so there is no gyroscopic torque. Gravity is absent,
//! as if the device compensated it.

use glam::DVec3;
use palpate_core::{Pose, Twist, Wrench};
use serde::{Deserialize, Serialize};

use crate::hand::Hand;

/// Inertia, damping and friction of a device's handle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Handle {
    /// Apparent mass, kg.
    pub mass: f64,
    /// Viscous damping, N·s/m.
    pub damping: f64,
    /// Coulomb friction, N.
    pub friction: f64,
    /// Rotational inertia, kg·m², the same about every axis.
    pub inertia: f64,
    /// Viscous angular damping, N·m·s/rad.
    pub angular_damping: f64,
    /// Coulomb friction torque, N·m.
    pub angular_friction: f64,
}

/// Pose and twist at the end of a step of `dt` (s) under `wrench`. `intended` is the hand's pose and twist at
/// the end of the step.
pub(crate) fn step(
    handle: &Handle,
    hand: &Hand,
    (pose, twist): (&Pose, &Twist),
    wrench: &Wrench,
    (intended, intended_twist): (&Pose, &Twist),
    dt: f64,
) -> (Pose, Twist) {
    let linear = Impedance {
        inertia: handle.mass + hand.mass,
        damping: handle.damping,
        friction: handle.friction,
        hand_damping: hand.damping,
        hand_stiffness: hand.stiffness,
    };
    let angular = Impedance {
        inertia: handle.inertia + hand.inertia,
        damping: handle.angular_damping,
        friction: handle.angular_friction,
        hand_damping: hand.angular_damping,
        hand_stiffness: hand.angular_stiffness,
    };
    let twist = Twist::new(
        linear.velocity_after(
            twist.linear,
            wrench.force,
            intended.translation - pose.translation,
            intended_twist.linear,
            dt,
        ),
        angular.velocity_after(
            twist.angular,
            wrench.torque,
            pose.rotation_vector_to(intended),
            intended_twist.angular,
            dt,
        ),
    );
    (pose.moved(&twist, dt), twist)
}

/// Handle and hand in one kind of motion, translation or rotation, or about a gripper's axis (along x).
pub(crate) struct Impedance {
    pub inertia: f64,
    pub damping: f64,
    pub friction: f64,
    pub hand_damping: f64,
    pub hand_stiffness: f64,
}

impl Impedance {
    /// Velocity at the end of a step of `dt` (s) under a load (N or N·m). `offset` is the intended position
    /// less the present one; `intended` is the intended velocity at the end of the step.
    pub fn velocity_after(
        &self,
        velocity: DVec3,
        load: DVec3,
        offset: DVec3,
        intended: DVec3,
        dt: f64,
    ) -> DVec3 {
        // Backward Euler, with h = dt and the friction's direction that of v⁺:
        // (m + h (b + b_h + h k_h)) v⁺ = m v + h (f + k_h (x_h − x) + b_h v_h) − h f_c v⁺/‖v⁺‖ = p − h f_c
        // v⁺/‖v⁺‖
        let momentum = velocity * self.inertia
            + (load + offset * self.hand_stiffness + intended * self.hand_damping) * dt;
        let magnitude = momentum.length();
        let lost = self.friction * dt;
        // A NaN is passed on to the caller's check.
        if magnitude <= lost {
            return DVec3::ZERO;
        }
        let resistance = self.inertia + dt * (self.damping + self.hand_damping + dt * self.hand_stiffness);
        momentum * ((1.0 - lost / magnitude) / resistance)
    }
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    const BARE: Handle = Handle {
        mass: 0.1,
        damping: 0.0,
        friction: 0.0,
        inertia: 1e-3,
        angular_damping: 0.0,
        angular_friction: 0.0,
    };

    /// Largest distance between the stepped motion and the analytic one of an underdamped oscillator, over
    /// 0.2 s.
    fn error_against_analytic(dt: f64) -> f64 {
        let hand = Hand { mass: 0.1, damping: 2.0, stiffness: 300.0, ..Hand::GRIP };
        let (mass, damping, stiffness, start) = (0.2, 2.0, 300.0_f64, 0.03);
        let decay = damping / (2.0 * mass);
        let frequency = (stiffness / mass - decay * decay).sqrt();
        let (mut pose, mut twist) = (Pose::from_translation(DVec3::X * start), Twist::ZERO);
        let mut worst = 0.0_f64;
        for i in 1..=(0.2 / dt).round() as usize {
            (pose, twist) =
                step(&BARE, &hand, (&pose, &twist), &Wrench::ZERO, (&Pose::IDENTITY, &Twist::ZERO), dt);
            let t = i as f64 * dt;
            let exact = start
                * (-decay * t).exp()
                * ((frequency * t).cos() + decay / frequency * (frequency * t).sin());
            worst = worst.max((pose.translation.x - exact).abs());
        }
        worst
    }

    #[test]
    fn oscillation_converges_to_the_analytic_one_at_first_order() {
        let (coarse, fine) = (error_against_analytic(1e-4), error_against_analytic(5e-5));
        assert!(coarse < 0.03 * 0.01, "{coarse} m of 0.03 m");
        assert!((1.8..2.2).contains(&(coarse / fine)), "{coarse} then {fine}");
    }

    /// The same about an axis: small or large, the angle obeys the scalar oscillator.
    #[test]
    fn turning_oscillates_as_the_scalar_equation() {
        let hand = Hand { inertia: 1e-3, angular_damping: 0.005, angular_stiffness: 1.0, ..Hand::GRIP };
        let axis = DVec3::new(1.0, -2.0, 0.5).normalize();
        let dt = 1e-4;
        let (mut angle, mut rate) = (2.5, 0.0);
        let mut pose = Pose::new(DVec3::ZERO, glam::DQuat::from_axis_angle(axis, angle));
        let mut twist = Twist::ZERO;
        for _ in 0..3000 {
            (pose, twist) =
                step(&BARE, &hand, (&pose, &twist), &Wrench::ZERO, (&Pose::IDENTITY, &Twist::ZERO), dt);
            rate = (2e-3 * rate - dt * angle) / (2e-3 + dt * 0.005 + dt * dt);
            angle += dt * rate;
            assert!((pose.rotation_vector_to(&Pose::IDENTITY) + axis * angle).length() < 1e-9);
            assert!((twist.angular - axis * rate).length() < 1e-9);
        }
    }

    /// The closed form of the friction solves the implicit equation: at the new velocity the forces balance,
    /// with the friction opposing the motion at full strength or, at rest, within its bound.
    #[test]
    fn friction_solves_the_implicit_equation() {
        let mut rng = StdRng::seed_from_u64(21);
        let (mut stuck, mut slid) = (0, 0);
        for _ in 0..10_000 {
            let mut vector = |size: f64| {
                DVec3::new(
                    rng.random_range(-size..size),
                    rng.random_range(-size..size),
                    rng.random_range(-size..size),
                )
            };
            let (velocity, load, offset, intended) = (vector(1e-3), vector(1.0), vector(1e-3), vector(0.1));
            let impedance = Impedance {
                inertia: rng.random_range(0.01..1.0),
                damping: rng.random_range(0.0..5.0),
                friction: rng.random_range(0.0..3.0),
                hand_damping: rng.random_range(0.0..5.0),
                hand_stiffness: rng.random_range(0.0..500.0),
            };
            let dt = 1e-3;
            let after = impedance.velocity_after(velocity, load, offset, intended, dt);
            let friction = impedance.inertia * (after - velocity) / dt - load + after * impedance.damping
                - (offset - after * dt) * impedance.hand_stiffness
                - (intended - after) * impedance.hand_damping;
            if after == DVec3::ZERO {
                stuck += 1;
                assert!(friction.length() <= impedance.friction * (1.0 + 1e-9));
            } else {
                slid += 1;
                assert!((friction + after.normalize() * impedance.friction).length() < 1e-9);
            }
        }
        assert!(stuck > 1000 && slid > 1000, "{stuck} stuck, {slid} slid");
    }

    #[test]
    fn every_step_size_is_stable() {
        for dt in [1e-5, 1e-3, 0.1, 10.0] {
            let hand = Hand {
                stiffness: 1e6,
                damping: 0.0,
                angular_stiffness: 1e6,
                angular_damping: 0.0,
                ..Hand::NONE
            };
            let mut pose = Pose::new(DVec3::splat(0.1), glam::DQuat::from_rotation_x(0.5));
            let mut twist = Twist::new(DVec3::Y, DVec3::Z);
            for _ in 0..1000 {
                (pose, twist) =
                    step(&BARE, &hand, (&pose, &twist), &Wrench::ZERO, (&Pose::IDENTITY, &Twist::ZERO), dt);
                assert!(pose.translation.length() < 0.2, "{dt}");
            }
        }
    }
}
