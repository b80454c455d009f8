//! The classical Runge–Kutta method on the rotation group (Munthe-Kaas).

use glam::{DMat3, DVec3};
use palpate_core::{Twist, Wrench};

use crate::algebra::rotation::inverse_right_jacobian;
use crate::body::BodyState;
use crate::integrators::Integrator;
use crate::step::{Frame, Step, StepStatus};

/// The classical Runge–Kutta method of fourth order.
///
/// In the step the orientation is exp(θ*) R₀ with θ′ = J_l⁻¹(θ) ω, so that the method works on vectors only
/// and the rotation stays one (Munthe-Kaas); the other unknowns are x, v and the angular momentum. Contacts
/// are evaluated in each stage; in a step in which one opens or closes the order is lower. It diverges with
/// stiff springs and light bodies, if later than [`ForwardEuler`](crate::ForwardEuler).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct RungeKutta4;

/// Rates of change in one stage.
#[derive(Clone, Copy)]
struct Rates {
    /// Derivative of x and θ.
    motion: Twist,
    /// Derivative of the momenta.
    load: Wrench,
}

impl Rates {
    fn plus(&self, other: &Self, factor: f64) -> Self {
        Self {
            motion: Twist {
                linear: self.motion.linear + other.motion.linear * factor,
                angular: self.motion.angular + other.motion.angular * factor,
            },
            load: self.load + other.load * factor,
        }
    }
}

/// J_l⁻¹(u) = J_r⁻¹(−u).
fn inverse_left_jacobian(u: DVec3) -> DMat3 {
    inverse_right_jacobian(-u)
}

impl Integrator for RungeKutta4 {
    fn name(&self) -> &'static str {
        "runge-kutta-4"
    }

    fn step(&self, frame: &Frame<'_>, state: &BodyState, dt: f64) -> Step {
        if let Some(refused) = frame.refused(state, dt) {
            return refused;
        }
        let inverse = frame.body.inertia.inverse();
        let advanced = |rates: &Rates, time: f64| {
            let pose = state.pose.moved(&rates.motion, time);
            let twist = frame.pushed(state, &(rates.load * time), &inverse, &pose);
            BodyState { pose, twist }
        };

        let (load, mut active) = frame.load(state);
        let first = Rates { motion: state.twist, load };
        let (mut sum, mut last) = (first, first);
        for (part, weight) in [(0.5, 2.0), (0.5, 2.0), (1.0, 1.0)] {
            let at = advanced(&last, part * dt);
            let (load, pushing) = frame.load(&at);
            active |= pushing;
            let turned = last.motion.angular * (part * dt);
            let angular = inverse_left_jacobian(turned) * at.twist.angular;
            last = Rates { motion: Twist { linear: at.twist.linear, angular }, load };
            sum = sum.plus(&last, weight);
        }
        frame.ended(state, &advanced(&sum, dt / 6.0), active, StepStatus::default())
    }
}
