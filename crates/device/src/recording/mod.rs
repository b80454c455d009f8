//! Recordings of a device's readings, and a device that replays them.
//!
//! A [`Tap`] on a device keeps every [`Reading`]. A [`Recording`] of them is a file, compact or text, with
//! the device's specification. A [`RecordedDevice`] gives the same readings at the same times, so that a
//! session with a simulated clock is reproduced bit for bit. (A [`MotionPath`](crate::MotionPath) is a motion
//! alone, in a format that can be written by hand.)

mod file;
mod play;
mod tap;

pub use file::RecordingWriter;
pub use play::RecordedDevice;
pub use tap::{Tap, Taps};

use crate::sample_time::is_stamp;
use crate::{DeviceState, Specification};

/// A device's state, with the time at which it was read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Driver's time of the call, s.
    pub now: f64,
    /// The state. If [`Status::DISCONNECTED`](crate::Status::DISCONNECTED) or
    /// [`Status::SILENT`](crate::Status::SILENT) is set, the call failed, and the motion is the one before.
    pub state: DeviceState,
}

/// A device's readings, in order of time, and its specification.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// Specification of the recorded device.
    pub specification: Specification,
    /// The readings, at least one.
    readings: Vec<Reading>,
}

impl Recording {
    /// A recording of readings; `None` if there is no reading, or a time runs back or is not finite. Times
    /// that begin more than 1e6 s from 0, as those of a host's clock since 1970, count from the first.
    pub fn new(specification: Specification, readings: Vec<Reading>) -> Option<Self> {
        let mut last = f64::NEG_INFINITY;
        let sound = readings.iter().all(|reading| check(reading, &mut last).is_none());
        (sound && !readings.is_empty()).then(|| Self::of_checked(specification, readings))
    }

    /// A recording of readings that have passed [`check`]. A replay begins at the time 0: where the driver's
    /// clock began elsewhere, it would hold the first reading until then.
    fn of_checked(specification: Specification, mut readings: Vec<Reading>) -> Self {
        if let Some(first) = readings.first().map(|reading| reading.now).filter(|first| is_stamp(*first)) {
            for reading in &mut readings {
                reading.now -= first;
                reading.state.time -= first;
            }
        }
        Self { specification, readings }
    }

    /// The readings.
    pub fn readings(&self) -> &[Reading] {
        &self.readings
    }
}

/// The fault of a reading that follows one at time `last`, if any; sets `last` to its time.
fn check(reading: &Reading, last: &mut f64) -> Option<&'static str> {
    let Reading { now, state } = reading;
    if !(now.is_finite() && now >= last) {
        return Some("a time that is not finite or runs back");
    }
    *last = *now;
    let moves = state.pose.is_valid() && state.twist.is_finite() && state.time.is_finite();
    (!moves).then_some("a motion that is not finite, or a quaternion that is not of unit length")
}
