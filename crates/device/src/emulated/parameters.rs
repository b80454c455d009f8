//! Parameters of an emulated device, and their ranges.

use serde::{Deserialize, Serialize};

use crate::hand::Hand;
use crate::mechanics::Handle;
use crate::{DeviceError, Specification};

/// Largest accepted value of a mechanical parameter, in its SI unit. A larger one is taken for a mistake in
/// units.
pub(super) const MAX_PARAMETER: f64 = 1e6;
/// Longest accepted delay of a wrench, s.
pub(super) const MAX_DELAY: f64 = 0.1;

/// Parameters of an emulated device and of the hand that holds it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Emulation {
    /// The device's specification; the emulation keeps to its peaks, encoder steps, delay and axes.
    pub specification: Specification,
    /// The handle's mechanics.
    pub handle: Handle,
    /// The hand that holds it.
    pub hand: Hand,
    /// Length of an integration step, s.
    pub substep: f64,
    /// The longest time that one read simulates, s.
    pub catch_up: f64,
}

impl Emulation {
    /// Refuses parameters that are out of range.
    pub(super) fn check(&self) -> Result<(), DeviceError> {
        let Self { specification: s, handle, hand, substep, catch_up } = self;
        let positive = [("handle mass (kg)", handle.mass), ("handle inertia (kg·m²)", handle.inertia)];
        let not_negative = [
            ("handle damping (N·s/m)", handle.damping),
            ("handle friction (N)", handle.friction),
            ("handle angular damping (N·m·s/rad)", handle.angular_damping),
            ("handle angular friction (N·m)", handle.angular_friction),
            ("hand mass (kg)", hand.mass),
            ("hand damping (N·s/m)", hand.damping),
            ("hand stiffness (N/m)", hand.stiffness),
            ("hand inertia (kg·m²)", hand.inertia),
            ("hand angular damping (N·m·s/rad)", hand.angular_damping),
            ("hand angular stiffness (N·m/rad)", hand.angular_stiffness),
        ];
        let tremor =
            [("hand tremor (m)", hand.tremor, 0.1), ("hand tremor (Hz)", hand.tremor_frequency, 100.0)];
        let steps =
            [("encoder step (m)", s.encoder_step), ("angular encoder step (rad)", s.angular_encoder_step)];
        let limits = [
            ("peak force (N)", s.peak_force),
            ("peak torque (N·m)", s.peak_torque),
            ("workspace radius (m)", s.workspace_radius),
        ];
        positive.into_iter().try_for_each(|(name, value)| within(name, value, 1e-9, MAX_PARAMETER, false))?;
        not_negative
            .into_iter()
            .try_for_each(|(name, value)| within(name, value, 0.0, MAX_PARAMETER, true))?;
        tremor.into_iter().try_for_each(|(name, value, high)| within(name, value, 0.0, high, true))?;
        steps.into_iter().try_for_each(|(name, value)| within(name, value, 1e-9, 1.0, true))?;
        limits.into_iter().try_for_each(|(name, value)| within(name, value, 0.0, f64::INFINITY, true))?;
        within("velocity delay (s)", s.velocity_delay, 0.0, 1.0, true)?;
        within("delay (s)", s.delay, 0.0, MAX_DELAY, true)?;
        within("substep (s)", *substep, 1e-6, 1e-2, false)?;
        within("catch-up (s)", *catch_up, *substep, 10.0, false)
    }
}

/// Refuses a parameter's value outside `low` to `high`, except for 0 if `zero`.
pub(super) fn within(
    parameter: &'static str,
    value: f64,
    low: f64,
    high: f64,
    zero: bool,
) -> Result<(), DeviceError> {
    if (low..=high).contains(&value) || (zero && value == 0.0) {
        return Ok(());
    }
    let or_zero = if zero && low > 0.0 { "0 or " } else { "" };
    let expected = format!("{or_zero}a number from {low:e} to {high:e}");
    Err(DeviceError::Parameter { parameter, value, expected })
}
