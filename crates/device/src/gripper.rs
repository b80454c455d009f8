//! Grippers of haptic devices: a handle that turns about one axis, closed and opened by the fingers.

use serde::{Deserialize, Serialize};

use crate::specification::or_infinite;
use crate::{DeviceError, Status};

/// The gripper of a device, which is read and driven beside the device's own handle.
///
/// Angles grow as the gripper opens. A torque written to the gripper is the torque that it applies to the
/// user's fingers: a positive one opens them. Closing the device writes a zero torque. Between opening and
/// closing, `read` and `write` neither allocate, lock, log nor panic.
pub trait Gripper: Send {
    /// Limits and abilities of the gripper.
    fn specification(&self) -> &GripperSpecification;

    /// State of the gripper at the driver's time `now` (s; from 0, never running back).
    ///
    /// The angle is always finite. A time that is not finite or lies before an earlier one gives the state of
    /// the earlier one with [`Status::CLOCK`] set. Fails once the device is closed or lost.
    fn read(&mut self, now: f64) -> Result<GripperState, DeviceError>;

    /// Commands `torque` (N·m) on the fingers until the next write.
    ///
    /// A torque beyond the gripper's peak is clipped; one that is not finite is refused and zero is written
    /// in its place. Either sets a flag in the next state read. Fails once the device is closed or lost.
    fn write(&mut self, torque: f64) -> Result<(), DeviceError>;
}

/// State of a gripper at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GripperState {
    /// Driver's time for which the state holds, s: at most the time asked for.
    pub time: f64,
    /// Angle of the gripper, rad; finite.
    pub angle: f64,
    /// Present conditions, and events since the previous read.
    pub status: Status,
}

/// Limits and abilities of a gripper. A limit that it does not have is infinite (`null` in JSON); an ability
/// that it lacks is zero.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GripperSpecification {
    /// Peak torque, N·m; 0 for a gripper that is only sensed.
    #[serde(deserialize_with = "or_infinite")]
    pub peak_torque: f64,
    /// Largest stiffness that the gripper renders stably at 1 kHz, N·m/rad.
    #[serde(deserialize_with = "or_infinite")]
    pub stiffness: f64,
    /// Largest virtual damping that the gripper renders stably together with `stiffness`, N·m·s/rad.
    #[serde(deserialize_with = "or_infinite")]
    pub damping: f64,
    /// Smallest change of angle that is sensed, rad; 0 if sensing is not quantised.
    pub encoder_step: f64,
    /// Mechanics of the gripper, if known: its damping and friction bound what it renders passively.
    pub handle: Option<GripperHandle>,
}

impl GripperSpecification {
    /// A gripper that is only sensed, without quantisation.
    pub const SENSED: Self =
        Self { peak_torque: 0.0, stiffness: 0.0, damping: 0.0, encoder_step: 0.0, handle: None };
}

/// Inertia, damping and friction of a gripper about its axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GripperHandle {
    /// Inertia, kg·m².
    pub inertia: f64,
    /// Viscous damping, N·m·s/rad.
    pub damping: f64,
    /// Coulomb friction torque, N·m.
    pub friction: f64,
}
