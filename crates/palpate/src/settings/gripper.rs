//! Settings of a gripper, the seventh degree of freedom.

use palpate_dynamics::PortAxes;

use super::SettingsError;

/// A gripper and its coupling to the hinge. Angles are those of the hinge that the hand asks for: a gripper that is geared otherwise
/// is scaled by the host.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GripperSettings {
    /// Abilities of the gripper about its axis, N·m and rad; by default as its driver states them.
    pub port: Option<PortAxes>,
    /// Stiffness of the coupling, N·m/rad; by default what the port renders passively with a margin
    /// ([`GripperCoupling::auto`](palpate_dynamics::GripperCoupling::auto)), 0.5 N·m/rad where nothing limits it.
    pub stiffness: Option<f64>,
    /// Damping of the coupling, N·m·s/rad; by default critical for the second body about the hinge.
    pub damping: Option<f64>,
    /// Largest change of the torque, N·m/s; by default the peak in 10 ms.
    pub torque_slew: Option<f64>,
}

/// Stiffness of the coupling where nothing limits it, N·m/rad.
pub(crate) const USUAL_STIFFNESS: f64 = 0.5;

impl GripperSettings {
    /// Refuses values that no gripper can have.
    ///
    /// # Errors
    /// Names the first setting out of range.
    pub fn check(&self) -> Result<(), SettingsError> {
        let ranges = [
            ("gripper stiffness", self.stiffness, "N·m/rad from 0 to 1e6", 0.0..=1e6),
            ("gripper damping", self.damping, "N·m·s/rad from 0 to 1e6", 0.0..=1e6),
            ("gripper torque slew", self.torque_slew, "N·m/s above 0", f64::MIN_POSITIVE..=f64::INFINITY),
            ("gripper peak torque", self.port.map(|port| port.peak), "N·m, 0 or more", 0.0..=f64::INFINITY),
            ("gripper encoder step", self.port.map(|port| port.step), "rad, 0 or more", 0.0..=f64::MAX),
        ];
        for (name, value, expected, range) in ranges {
            if let Some(value) = value.filter(|value| !range.contains(value)) {
                return Err(SettingsError { name, value, expected });
            }
        }
        Ok(())
    }
}
