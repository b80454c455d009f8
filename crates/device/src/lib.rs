//! Haptic devices for palpate: the [`HapticDevice`] trait, an emulated device held by an emulated hand
//! ([`EmulatedDevice`]), replay of a recorded motion ([`ReplayDevice`]), and devices reached by reports
//! ([`link`]): HID devices ([`hid`]), Haply's ([`haply`]), and those of the makers' SDKs ([`sdk`]).
//!
//! SI units throughout. Poses, twists and wrenches are those of the handle's reference point, in the device's
//! own axes, whose origin is the centre of the workspace. A wrench written to a device is the wrench that the
//! device applies to the user's hand.
//!
//! Between opening and closing, `read` and `write` neither allocate, lock, log nor panic.

#![cfg_attr(docsrs, feature(doc_cfg))]

mod angle_path;
mod clip;
mod emulated;
mod enable;
mod error;
mod gripper;
mod hand;
pub mod haply;
pub mod hid;
pub mod link;
mod mechanics;
mod path;
mod path_file;
mod presets;
mod recording;
mod registry;
mod replay;
mod sample_time;
pub mod sdk;
mod sensing;
mod specification;
mod state;
mod steering;
mod task;
mod velocity;

pub use angle_path::{ANGLE_PATH_HEADER, AnglePath};
pub use emulated::{
    EmulatedDevice, EmulatedGripper, EmulatedHand, Emulation, Fingers, GripperEmulation, GripperPath,
};
pub use enable::HoldToEnable;
pub use error::{DeviceError, PathError};
pub use gripper::{Gripper, GripperHandle, GripperSpecification, GripperState};
pub use hand::{Hand, IntendedPath};
pub use mechanics::Handle;
use palpate_core::Wrench;
use palpate_realtime::ThreadSetup;
pub use path::{Interpolation, Keyframe, MotionPath, PathPoint};
pub use path_file::PATH_HEADER;
pub use recording::{Reading, RecordedDevice, Recording, RecordingWriter, Tap, Taps};
pub use registry::{DeviceKind, Listing, Opened, Registry, list, open};
pub use replay::ReplayDevice;
pub use specification::{Axes, Specification};
pub use state::{DeviceState, Status};
pub use steering::Steering;
pub use task::{Task, TaskParameters, TaskSite};
pub use velocity::{AdaptiveWindow, LONGEST_WINDOW, LowPass};

/// A device that reports how its handle moves and applies a wrench to the hand that holds it.
///
/// A device is driven by one thread: read, compute, write, once a period. Implementations write a zero wrench
/// when they are closed and when they are dropped.
pub trait HapticDevice: Send {
    /// Name, limits and abilities of the device.
    fn specification(&self) -> &Specification;

    /// The handle's motion at the driver's time `now` (s; from 0, never running back).
    ///
    /// The pose and the twist are always finite. A time that is not finite or lies before an earlier one
    /// gives the state of the earlier one with [`Status::CLOCK`] set. Events since the previous read are
    /// in [`DeviceState::status`]. Fails once the device is closed or lost.
    fn read(&mut self, now: f64) -> Result<DeviceState, DeviceError>;

    /// Commands `wrench` (N, N·m, about the handle's reference point) on the hand until the next write.
    ///
    /// A wrench beyond the device's peaks is clipped; a wrench that is not finite is refused and zero is
    /// written in its place. Either sets a flag in the next state read. Fails once the device is closed or
    /// lost.
    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceError>;

    /// Writes a zero wrench and releases the device. Closing twice is not an error.
    fn close(&mut self) -> Result<(), DeviceError>;

    /// Scheduling that the operating system granted to the thread that exchanges reports with the device;
    /// `None` if there is no such thread or it has not started.
    fn thread_setup(&self) -> Option<&ThreadSetup> {
        None
    }

    /// The device's gripper, if it has one.
    fn gripper(&mut self) -> Option<&mut dyn Gripper> {
        None
    }
}

impl<D: HapticDevice + ?Sized> HapticDevice for Box<D> {
    fn specification(&self) -> &Specification {
        (**self).specification()
    }

    fn read(&mut self, now: f64) -> Result<DeviceState, DeviceError> {
        (**self).read(now)
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceError> {
        (**self).write(wrench)
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        (**self).close()
    }

    fn thread_setup(&self) -> Option<&ThreadSetup> {
        (**self).thread_setup()
    }

    fn gripper(&mut self) -> Option<&mut dyn Gripper> {
        (**self).gripper()
    }
}
