//! The coupling of the seventh coordinate: a spring and damper between a tool's hinge and the gripper's
//! angle.

use super::{ArticulatedBody, ArticulatedState};
use crate::port::{PortAxes, Sampling};
use crate::saturation::{spring_energy, spring_force};

/// Angle and rate of the gripper, which commands the tool's hinge.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GripperMotion {
    /// Angle, rad.
    pub angle: f64,
    /// Rate of the angle, rad/s.
    pub rate: f64,
}

impl GripperMotion {
    /// A gripper at rest.
    pub const fn at_rest(angle: f64) -> Self {
        Self { angle, rate: 0.0 }
    }

    /// Whether every number is finite.
    pub fn is_valid(&self) -> bool {
        self.angle.is_finite() && self.rate.is_finite()
    }
}

/// Gains of the coupling between gripper and hinge. The torque on the hinge is k (q_h − q) + b (q̇_h − q̇),
/// with its spring limited like those of the virtual coupling ([`spring_force`](crate::spring_force), Eq.
/// 5.30); the gripper gets the opposite torque.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GripperCoupling {
    /// k, N·m/rad.
    pub stiffness: f64,
    /// b, N·m·s/rad.
    pub damping: f64,
    /// Limit of the spring's torque, N·m; infinite for a linear spring.
    pub max_torque: f64,
}

/// The coupling at one state.
pub(super) struct Held {
    /// Torque on the hinge, N·m.
    pub torque: f64,
    /// Slope of the spring, 0 to k, N·m/rad.
    pub slope: f64,
}

impl GripperCoupling {
    /// A coupling that exerts no torque.
    pub const NONE: Self = Self { stiffness: 0.0, damping: 0.0, max_torque: f64::INFINITY };

    /// Makes a coupling with a stiffness (N·m/rad), damped critically for the second body about the hinge
    /// while the first is held. Its spring does not saturate.
    pub fn critically_damped(tool: &ArticulatedBody, stiffness: f64) -> Self {
        let damping = 2.0 * (stiffness * tool.second_about_hinge()).sqrt();
        Self { stiffness, damping, max_torque: f64::INFINITY }
    }

    /// Makes a coupling for a gripper with given limits and sampling. It is as stiff as the gripper renders
    /// passively with a margin ([`PortAxes::largest_stiffness`]), or has the stiffness `otherwise` (N·m/rad)
    /// if nothing limits it or nothing is rendered. It is no stronger than the gripper and damped critically.
    pub fn auto(tool: &ArticulatedBody, limits: &PortAxes, otherwise: f64, sampling: &Sampling) -> Self {
        let largest = limits.largest_stiffness(sampling);
        let rendered = limits.peak > 0.0;
        let chosen = if rendered && largest > 0.0 && largest.is_finite() { largest } else { otherwise };
        let max_torque = if rendered { limits.peak } else { f64::INFINITY };
        Self { max_torque, ..Self::critically_damped(tool, chosen) }
    }

    /// The torque on the hinge, N·m; the gripper gets the opposite.
    pub fn torque(&self, state: &ArticulatedState, gripper: &GripperMotion) -> f64 {
        self.at(state, gripper).torque
    }

    /// Energy stored in the spring, J.
    pub fn potential_energy(&self, state: &ArticulatedState, gripper: &GripperMotion) -> f64 {
        spring_energy(self.stiffness, (gripper.angle - state.angle).abs(), self.max_torque)
    }

    pub(super) fn at(&self, state: &ArticulatedState, gripper: &GripperMotion) -> Held {
        let deviation = gripper.angle - state.angle;
        let (size, slope) = spring_force(self.stiffness, deviation.abs(), self.max_torque);
        let torque = size.copysign(deviation) + self.damping * (gripper.rate - state.rate);
        Held { torque, slope }
    }
}
