//! Exchange with the device: readings in, limited wrenches and torques out.

use std::sync::{Arc, OnceLock};

use palpate_core::Wrench;
use palpate_device::{DeviceError, HapticDevice};

use super::HapticLoop;
use super::gripper::Gripper;
use super::invariants::Moment;
use crate::tool::Tool;

impl<T: Tool> HapticLoop<T> {
    /// Takes one step of `dt` seconds up to time `now` (s) on a device: reads it, steps and writes the
    /// wrench. A device that does not answer is assumed to stand still, and is sent no wrench.
    pub fn step_device(&mut self, device: &mut dyn HapticDevice, now: f64, dt: f64) -> T::Record {
        let state = device.read(now).map_err(|error| self.keep_device_error(error)).ok();
        let angle = self.gripper.is_some().then(|| self.read_gripper(device, now));
        let (record, sent) = self.advance(state.as_ref(), angle, now, dt);
        self.write_gripper(device);
        if let Err(error) = device.write(&sent) {
            self.telemetry.events.device_refused += u64::from(state.is_some());
            self.keep_device_error(error);
            // The wrench that it now renders is unknown; when it accepts wrenches again they come up from
            // zero.
            self.presence.release();
            self.output.forget();
        }
        record
    }

    /// Reads the angle of the device's gripper at `now` (s), rad; NaN, a bad reading, where it does not
    /// answer.
    fn read_gripper(&self, device: &mut dyn HapticDevice, now: f64) -> f64 {
        let read = device.gripper().map(|gripper| gripper.read(now));
        match read {
            Some(Ok(state)) => state.angle,
            Some(Err(error)) => {
                self.keep_device_error(error);
                f64::NAN
            }
            None => f64::NAN,
        }
    }

    /// Writes the torque of this step to the device's gripper.
    fn write_gripper(&mut self, device: &mut dyn HapticDevice) {
        let Some(torque) = self.gripper.as_ref().map(Gripper::torque) else { return };
        if let Some(Err(error)) = device.gripper().map(|gripper| gripper.write(torque)) {
            self.telemetry.events.device_refused += 1;
            self.keep_device_error(error);
        }
    }

    /// Limits a wanted wrench (device axes) and the gripper's torque (N·m, world) to what may be sent. Both
    /// are dropped if none may be sent, and let go if none is wanted. Returns the wrench to send.
    pub(super) fn limit(
        &mut self,
        wanted: (&Wrench, f64),
        dropped: bool,
        sends: bool,
        at: &Moment,
    ) -> Wrench {
        self.send_torque(wanted.1, sends, at);
        if dropped {
            self.output.drop(&self.tracking, at)
        } else if sends {
            self.output.send(wanted.0, &self.tracking, at, &mut self.telemetry.events)
        } else {
            self.output.let_go(&self.tracking, at)
        }
    }

    /// Sends the gripper a wanted torque (N·m, world), or releases it.
    fn send_torque(&mut self, wanted: f64, sends: bool, at: &Moment) {
        let Some(gripper) = &mut self.gripper else { return };
        if sends {
            // Torques at the device are those of the world divided by the square of the scale (§5.3.3).
            let scale = self.workspace.mapping().scale;
            gripper.send(wanted * at.share / (scale * scale), at, &mut self.telemetry.events);
        } else {
            gripper.release(at.elapsed);
        }
    }

    /// The first error that the device gave, if any.
    pub fn device_error(&self) -> Option<&DeviceError> {
        self.channels.device_error.get()
    }

    /// The first error that the device gave, shared with other threads while the loop runs.
    pub(crate) fn shared_device_error(&self) -> Arc<OnceLock<DeviceError>> {
        Arc::clone(&self.channels.device_error)
    }

    /// Keeps an error of the device if it is the first. It is only moved; other threads format it.
    pub(crate) fn keep_device_error(&self, error: DeviceError) {
        let _ = self.channels.device_error.set(error);
    }
}
