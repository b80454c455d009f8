//! Replay of a recording as a device.

use palpate_core::{Pose, Wrench};

use super::{Reading, Recording};
use crate::clip::finite;
use crate::{DeviceError, DeviceState, HapticDevice, Specification, Status};

/// A device that replays the readings of another one, whatever wrench is written, as if a hand of infinite
/// impedance held it.
///
/// Replayed from the beginning at the original speed and read at the recorded times, it gives the recorded
/// readings bit for bit; between two readings, poses and twists are interpolated. After the end it holds the
/// last pose, with [`Status::ENDED`] set. It is lost wherever the recorded device was lost.
#[derive(Clone, Debug)]
pub struct RecordedDevice {
    recording: Recording,
    /// Recorded seconds per second, and the recorded time at which replay starts, s.
    speed: f64,
    start: f64,
    /// Index of the latest reading.
    index: usize,
    now: f64,
    wrench: Wrench,
    events: Status,
    lost: Status,
    closed: bool,
}

impl RecordedDevice {
    /// Replays a recording from the beginning.
    pub fn new(recording: Recording) -> Self {
        Self {
            recording,
            speed: 1.0,
            start: 0.0,
            index: 0,
            now: 0.0,
            wrench: Wrench::ZERO,
            events: Status::OK,
            lost: Status::OK,
            closed: false,
        }
    }

    /// Replays at `speed` recorded seconds per second, starting `start` (s) after the recording's time 0.
    ///
    /// # Errors
    /// If the speed is not from 0.001 to 1000, or the start is not finite.
    pub fn at(self, speed: f64, start: f64) -> Result<Self, DeviceError> {
        let refuse = |parameter, value, expected: &str| {
            Err(DeviceError::Parameter { parameter, value, expected: expected.into() })
        };
        if !(1e-3..=1e3).contains(&speed) {
            return refuse("speed", speed, "0.001 to 1000");
        }
        if !start.is_finite() {
            return refuse("start (s)", start, "a finite time");
        }
        Ok(Self { speed, start, ..self })
    }

    /// The wrench written last, N and N·m.
    pub fn applied_wrench(&self) -> Wrench {
        self.wrench
    }

    /// The recorded state at a recorded time (s).
    fn recorded(&mut self, time: f64) -> DeviceState {
        let readings = self.recording.readings();
        while self.index + 1 < readings.len() && readings[self.index + 1].now <= time {
            self.index += 1;
        }
        let Reading { now, mut state } = readings[self.index];
        let Some(next) = readings.get(self.index + 1) else {
            if time > now {
                state.twist = palpate_core::Twist::ZERO;
                state.status |= Status::ENDED;
            }
            return state;
        };
        if time > now {
            let part = (time - now) / (next.now - now);
            let (from, to) = (&state.pose, &next.state.pose);
            let between = Pose {
                translation: from.translation.lerp(to.translation, part),
                rotation: from.rotation.slerp(to.rotation, part).normalize(),
            };
            if between.is_valid() {
                state.pose = between;
            }
            state.twist.linear = state.twist.linear.lerp(next.state.twist.linear, part);
            state.twist.angular = state.twist.angular.lerp(next.state.twist.angular, part);
            state.time = time;
        }
        state
    }
}

impl HapticDevice for RecordedDevice {
    fn specification(&self) -> &Specification {
        &self.recording.specification
    }

    fn read(&mut self, now: f64) -> Result<DeviceState, DeviceError> {
        if self.closed {
            return Err(DeviceError::Closed);
        }
        if now.is_finite() && now >= self.now {
            self.now = now;
        } else {
            self.events |= Status::CLOCK;
        }
        let mut state = self.recorded(self.start + self.now * self.speed);
        if (self.speed, self.start) != (1.0, 0.0) {
            state.time = ((state.time - self.start) / self.speed).min(self.now);
            state.twist.linear *= self.speed;
            state.twist.angular *= self.speed;
        }
        let gone = [Status::DISCONNECTED, Status::SILENT];
        self.lost = gone.into_iter().find(|gone| state.status.contains(*gone)).unwrap_or(Status::OK);
        if !self.lost.is_ok() {
            return Err(DeviceError::Lost { status: self.lost });
        }
        state.status |= std::mem::take(&mut self.events);
        Ok(state)
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceError> {
        if self.closed {
            return Err(DeviceError::Closed);
        }
        if !self.lost.is_ok() {
            self.wrench = Wrench::ZERO;
            return Err(DeviceError::Lost { status: self.lost });
        }
        let (wrench, events) = finite(wrench);
        self.wrench = wrench;
        self.events |= events;
        Ok(())
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        self.wrench = Wrench::ZERO;
        self.closed = true;
        Ok(())
    }
}
