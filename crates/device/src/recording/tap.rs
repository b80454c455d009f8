//! Keeps a device's readings while it is used.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use palpate_core::{Pose, Twist, Wrench};
use palpate_realtime::ThreadSetup;
use rtrb::{Consumer, Producer, RingBuffer};

use super::Reading;
use crate::{DeviceError, DeviceState, Gripper, HapticDevice, Specification, Status};

/// Capacity of the queue, in readings: four seconds at 1 kHz.
const QUEUE_CAPACITY: usize = 4096;

/// A device whose readings are also queued for a recorder; those of its gripper are not. It neither waits nor
/// allocates: readings that are not taken in time are lost and counted.
pub struct Tap<D> {
    device: D,
    latest: DeviceState,
    readings: Producer<Reading>,
    lost: Arc<AtomicU64>,
}

/// Receiving end of a [`Tap`].
#[derive(Debug)]
pub struct Taps {
    readings: Consumer<Reading>,
    lost: Arc<AtomicU64>,
}

impl<D: HapticDevice> Tap<D> {
    /// Wraps a device; gives the tapped device and the receiving end.
    pub fn new(device: D) -> (Self, Taps) {
        let (producer, consumer) = RingBuffer::new(QUEUE_CAPACITY);
        let lost = Arc::new(AtomicU64::new(0));
        let latest = DeviceState {
            time: 0.0,
            pose: Pose::IDENTITY,
            twist: Twist::ZERO,
            buttons: 0,
            status: Status::OK,
        };
        (Self { device, latest, readings: producer, lost: lost.clone() }, Taps { readings: consumer, lost })
    }
}

impl Taps {
    /// The oldest reading in the queue.
    pub fn take(&mut self) -> Option<Reading> {
        self.readings.pop().ok()
    }

    /// Number of readings lost.
    pub fn lost(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }
}

impl<D: HapticDevice> HapticDevice for Tap<D> {
    fn specification(&self) -> &Specification {
        self.device.specification()
    }

    fn read(&mut self, now: f64) -> Result<DeviceState, DeviceError> {
        let result = self.device.read(now);
        match &result {
            Ok(state) => self.latest = *state,
            Err(DeviceError::Lost { status }) => self.latest.status = *status,
            Err(_) => return result,
        }
        if now.is_finite() && self.readings.push(Reading { now, state: self.latest }).is_err() {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
        result
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceError> {
        self.device.write(wrench)
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        self.device.close()
    }

    fn thread_setup(&self) -> Option<&ThreadSetup> {
        self.device.thread_setup()
    }

    fn gripper(&mut self) -> Option<&mut dyn Gripper> {
        self.device.gripper()
    }
}

impl<D: std::fmt::Debug> std::fmt::Debug for Tap<D> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Tap").field("device", &self.device).finish_non_exhaustive()
    }
}
