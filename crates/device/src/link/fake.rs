//! A simulated transport for tests of drivers, with the faults of real ones.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::transport::{LONGEST_REPORT, Transport, TransportError};

/// Largest number of reports that wait to be read: further ones are lost, as in Linux' hidraw.
pub const QUEUE: usize = 63;

/// The device's end of the simulated connection; its [`FakeTransport`]s show what it does.
#[derive(Clone, Debug, Default)]
pub struct FakeWire(Arc<Mutex<Wire>>);

#[derive(Debug, Default)]
struct Wire {
    waiting: VecDeque<Vec<u8>>,
    written: Vec<Vec<u8>>,
    unplugged: bool,
    interrupted: u32,
    stalled: bool,
    features_stalled: bool,
    features: Vec<Vec<u8>>,
    features_set: Vec<Vec<u8>>,
    write_takes: Duration,
    generation: u32,
}

/// The host's end of the simulated connection. It does not wait: if no report is there, none comes in time.
#[derive(Clone, Debug)]
pub struct FakeTransport {
    wire: FakeWire,
    generation: u32,
}

impl FakeWire {
    /// A device that is plugged in and has sent nothing.
    pub fn new() -> Self {
        Self::default()
    }

    fn lock(&self) -> MutexGuard<'_, Wire> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Opens the device, unless it is unplugged.
    pub fn open(&self) -> Option<FakeTransport> {
        let wire = self.lock();
        (!wire.unplugged).then(|| FakeTransport { wire: self.clone(), generation: wire.generation })
    }

    /// Sends a report to the host; lost if [`QUEUE`] reports wait already.
    pub fn send(&self, report: &[u8]) {
        let mut wire = self.lock();
        if wire.waiting.len() < QUEUE {
            wire.waiting.push_back(report.to_vec());
        }
    }

    /// Reports that the host has written since the last call.
    pub fn written(&self) -> Vec<Vec<u8>> {
        std::mem::take(&mut self.lock().written)
    }

    /// Unplugs the device: transports that are open fail from then on.
    pub fn unplug(&self) {
        let mut wire = self.lock();
        wire.unplugged = true;
        wire.generation += 1;
        wire.waiting.clear();
    }

    /// Plugs it in again.
    pub fn plug_in(&self) {
        self.lock().unplugged = false;
    }

    /// Lets the next `times` reads fail, as when a signal comes.
    pub fn interrupt(&self, times: u32) {
        self.lock().interrupted = times;
    }

    /// Makes writes fail, or work again.
    pub fn stall(&self, stalled: bool) {
        self.lock().stalled = stalled;
    }

    /// Queues the answer to one request for the feature report with the same number.
    pub fn answer(&self, report: &[u8]) {
        self.lock().features.push(report.to_vec());
    }

    /// Feature reports that the host has set since the last call.
    pub fn features_set(&self) -> Vec<Vec<u8>> {
        std::mem::take(&mut self.lock().features_set)
    }

    /// Makes feature reports fail, or work again.
    pub fn stall_features(&self, stalled: bool) {
        self.lock().features_stalled = stalled;
    }

    /// Makes each write take this long.
    pub fn delay_writes(&self, time: Duration) {
        self.lock().write_takes = time;
    }
}

impl FakeTransport {
    fn live(&self) -> Result<MutexGuard<'_, Wire>, TransportError> {
        let wire = self.wire.lock();
        if wire.unplugged || wire.generation != self.generation {
            return Err(TransportError::Disconnected);
        }
        Ok(wire)
    }
}

impl Transport for FakeTransport {
    fn read(&mut self, report: &mut [u8; LONGEST_REPORT], _: Duration) -> Result<usize, TransportError> {
        let mut wire = self.live()?;
        if wire.interrupted > 0 {
            wire.interrupted -= 1;
            return Err(TransportError::Failed);
        }
        let Some(next) = wire.waiting.pop_front() else { return Ok(0) };
        let length = next.len().min(LONGEST_REPORT);
        report[..length].copy_from_slice(&next[..length]);
        Ok(length)
    }

    fn write(&mut self, report: &[u8]) -> Result<(), TransportError> {
        let mut wire = self.live()?;
        let takes = wire.write_takes;
        if wire.stalled {
            return Err(TransportError::Failed);
        }
        wire.written.push(report.to_vec());
        drop(wire);
        if takes > Duration::ZERO {
            std::thread::sleep(takes);
        }
        Ok(())
    }

    fn set_feature(&mut self, report: &[u8]) -> Result<(), TransportError> {
        let mut wire = self.live()?;
        if wire.features_stalled {
            return Err(TransportError::Failed);
        }
        wire.features_set.push(report.to_vec());
        Ok(())
    }

    fn get_feature(&mut self, report: &mut [u8; LONGEST_REPORT]) -> Result<usize, TransportError> {
        let mut wire = self.live()?;
        let known = wire.features.iter().position(|known| known.first() == report.first());
        let Some(known) = known.filter(|_| !wire.features_stalled) else {
            return Err(TransportError::Failed);
        };
        let answer = wire.features.remove(known);
        let length = answer.len().min(LONGEST_REPORT);
        report[..length].copy_from_slice(&answer[..length]);
        Ok(length)
    }
}
