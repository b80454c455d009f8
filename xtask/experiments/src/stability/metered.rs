//! An emulated device in a session of the engine, seen from outside.

use std::sync::{Arc, Mutex, PoisonError};

use palpate::device::{DeviceError, DeviceState, EmulatedDevice, HapticDevice, Specification};
use palpate::{Pose, Twist, Wrench};

/// What is seen at the handle itself, which the session does not know.
#[derive(Clone, Copy, Debug, Default)]
pub struct Seen {
    pub pose: Pose,
    pub twist: Twist,
    /// The most work that the wrenches had done on handle and hand, J.
    pub most_work: f64,
}

/// Shows what is seen at a device that a session owns.
#[derive(Clone, Debug, Default)]
pub struct Meter(Arc<Mutex<Seen>>);

impl Meter {
    pub fn seen(&self) -> Seen {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The device, with its meter.
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
