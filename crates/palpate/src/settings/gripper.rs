//! Settings of a gripper, the seventh degree of freedom.

use palpate_dynamics::PortAxes;

use super::{ABOVE_ZERO_OR_UNLIMITED, SettingsError, check_ranges};

/// A gripper and its coupling to the hinge. The gripper's angle is the hinge angle that the hand asks for;
/// the host scales a gripper with another gear ratio.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GripperSettings {
    /// Limits of the gripper about its axis, N·m and rad; by default as its driver states them.
    pub port: Option<PortAxes>,
    /// Stiffness of the coupling, N·m/rad; by default the stiffness that the port renders passively with a
    /// margin ([`GripperCoupling::auto`](palpate_dynamics::GripperCoupling::auto)), 0.5 N·m/rad where the
    /// port sets no limit.
    pub stiffness: Option<f64>,
    /// Damping of the coupling, N·m·s/rad; by default critical for the second body about the hinge.
    pub damping: Option<f64>,
    /// Largest rate of change of the torque, N·m/s; by default the peak torque in 10 ms.
    pub torque_slew: Option<f64>,
}

/// Stiffness of the coupling where the port sets no limit, N·m/rad. With a larger one the hinge follows the
/// gripper more closely; with a smaller one the object between the blades feels softer.
pub(crate) const DEFAULT_STIFFNESS: f64 = 0.5;

impl GripperSettings {
    /// Refuses values that no gripper can have.
    ///
    /// # Errors
    /// If a setting is out of range: names the first one.
    pub fn check(&self) -> Result<(), SettingsError> {
        check_ranges([
            ("gripper stiffness", self.stiffness, "N·m/rad from 0 to 1e6", 0.0..=1e6),
            ("gripper damping", self.damping, "N·m·s/rad from 0 to 1e6", 0.0..=1e6),
            ("gripper torque slew", self.torque_slew, "N·m/s above 0", ABOVE_ZERO_OR_UNLIMITED),
            ("gripper peak torque", self.port.map(|port| port.peak), "N·m, 0 or more", 0.0..=f64::INFINITY),
            ("gripper encoder step", self.port.map(|port| port.step), "rad, 0 or more", 0.0..=f64::MAX),
        ])
    }
}
