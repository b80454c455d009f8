//! Emulated device in a session of the engine, observed from outside.

use std::sync::{Arc, Mutex, PoisonError};

use palpate::device::{DeviceError, DeviceState, EmulatedDevice, HapticDevice, Specification};
use palpate::{Pose, Twist, Wrench};

/// Observations at the handle itself, which the session cannot make.
#[derive(Clone, Copy, Debug, Default)]
pub struct Seen {
    pub pose: Pose,
    pub twist: Twist,
    /// Largest work that the wrenches had done on handle and hand, J.
    pub most_work: f64,
}

/// Access to the observations of a device that a session owns.
#[derive(Clone, Debug, Default)]
pub struct Meter(Arc<Mutex<Seen>>);

impl Meter {
    pub fn seen(&self) -> Seen {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Device with its meter.
pub struct Metered {
    device: EmulatedDevice,
    meter: Meter,
}

impl Metered {
    pub fn new(device: EmulatedDevice) -> (Self, Meter) {
        let meter = Meter::default();
        (Self { device, meter: meter.clone() }, meter)
    }
}

impl HapticDevice for Metered {
    fn specification(&self) -> &Specification {
        self.device.specification()
    }

    fn read(&mut self, now: f64) -> Result<DeviceState, DeviceError> {
        let state = self.device.read(now);
        let mut seen = self.meter.0.lock().unwrap_or_else(PoisonError::into_inner);
        (seen.pose, seen.twist) = self.device.handle();
        seen.most_work = seen.most_work.max(self.device.work());
        state
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceError> {
        self.device.write(wrench)
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        self.device.close()
    }
}
