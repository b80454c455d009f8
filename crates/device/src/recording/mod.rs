//! What a device told, reading by reading, and the device again that tells it.
//!
//! A [`Tap`] on a device keeps every [`Reading`]; a [`Recording`] of them is a file, compact or text, with the device's
//! specification; a [`RecordedDevice`] gives the same readings at the same times, so that a session with a simulated clock comes out the same,
//! bit for bit. (A [`MotionPath`](crate::MotionPath) is a motion alone, in figures that one may write by hand.)

mod file;
mod play;
mod tap;

pub use file::RecordingWriter;
pub use play::RecordedDevice;
pub use tap::{Tap, Taps};

use crate::{DeviceState, Specification};

/// A device's state as read at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// The driver's time of the call, s.
    pub now: f64,
    /// What came back. With [`Status::DISCONNECTED`](crate::Status::DISCONNECTED) or
    /// [`Status::SILENT`](crate::Status::SILENT) the call failed, and the motion is the one before.
    pub state: DeviceState,
}

/// A device's readings, times not running back, and what it could do.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// What the device could do.
    pub specification: Specification,
    /// At least one.
    readings: Vec<Reading>,
}

impl Recording {
    /// A recording of readings; `None` where there is none, or one is earlier than the one before or not finite.
    pub fn new(specification: Specification, readings: Vec<Reading>) -> Option<Self> {
        let mut last = f64::NEG_INFINITY;
        let sound = readings.iter().all(|reading| check(reading, &mut last).is_none());
        (sound && !readings.is_empty()).then_some(Self { specification, readings })
    }

    /// The readings.
    pub fn readings(&self) -> &[Reading] {
        &self.readings
    }
}

/// What is wrong with a reading that comes after a time, which moves on to its own.
fn check(reading: &Reading, last: &mut f64) -> Option<&'static str> {
    let Reading { now, state } = reading;
    if !(now.is_finite() && now >= last) {
        return Some("a time that is not finite or runs back");
    }
    *last = *now;
    let moves = state.pose.is_valid() && state.twist.is_finite() && state.time.is_finite();
    (!moves).then_some("a motion that is not finite, or a quaternion that is not of unit length")
}
