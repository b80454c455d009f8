//! Interfaces that a driver implements: the codec of its device's reports, and the motion that they describe.

use palpate_core::{Pose, Twist, Wrench};

use super::transport::{LONGEST_REPORT, Transport, TransportError};

/// The error for a report that is not one of the device's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Malformed;

/// A report to write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Report {
    bytes: [u8; LONGEST_REPORT],
    length: usize,
}

impl Report {
    /// A report of `length` bytes, at most [`LONGEST_REPORT`]: these bytes, followed by zeros.
    pub fn new(bytes: &[u8], length: usize) -> Self {
        let mut report = Self { bytes: [0; LONGEST_REPORT], length: length.min(LONGEST_REPORT) };
        report.bytes.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
        report
    }

    /// Its bytes.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[..self.length]
    }
}

/// Codec of one kind of device: decodes its reports and encodes wrenches.
pub trait Codec: Send + 'static {
    /// State that the reports give.
    type Sample: Copy + Default + Send + std::fmt::Debug + 'static;

    /// Begins a round of the pump at its time `now` (s), which never runs back; the calls that follow belong
    /// to this round. For devices that need reports at regular times.
    fn begin_round(&mut self, now: f64) {
        let _ = now;
    }

    /// Updates the state by a report.
    ///
    /// # Errors
    /// If the report is not one of the device's; the state is then unchanged.
    fn decode(&mut self, report: &[u8], sample: &mut Self::Sample) -> Result<(), Malformed>;

    /// Whether the device accepts a wrench in this state. A device does not before it is calibrated or its
    /// power is on, nor while it reports that its own watchdog has switched the force off: otherwise the hand
    /// would get the full force at once when it is switched on again. A device that does not accept a wrench
    /// gets zero, and [`NOT_ENABLED`](crate::Status::NOT_ENABLED) is set.
    fn is_enabled(&self, sample: &Self::Sample) -> bool {
        let _ = sample;
        true
    }

    /// Encodes the reports that command a wrench on the hand (device axes) in this state, and passes each to
    /// `say`; none if nothing needs to be sent.
    fn encode(&mut self, wrench: &Wrench, sample: &Self::Sample, say: &mut dyn FnMut(Report));

    /// Sets the device up, at first and whenever it has come back.
    ///
    /// # Errors
    /// If the device does not respond; it is tried again later.
    fn start(&mut self, transport: &mut dyn Transport) -> Result<(), TransportError> {
        let _ = transport;
        Ok(())
    }

    /// Ends the use of the device, after a wrench of zero.
    ///
    /// # Errors
    /// If the device does not respond.
    fn stop(&mut self, transport: &mut dyn Transport) -> Result<(), TransportError> {
        let _ = transport;
        Ok(())
    }
}

/// Motion of the handle, from a device's reports.
pub trait Motion: Send {
    /// State that the reports give.
    type Sample: Copy + Default + Send + 'static;

    /// Pose and twist of the handle (device axes) and the buttons at the driver's time `now` (s). `came` is
    /// the arrival time (s) of the newest report, at most `now`, if one came since the last call: velocities
    /// are based on these times, not on those of the calls.
    fn advance(&mut self, sample: &Self::Sample, came: Option<f64>, now: f64) -> (Pose, Twist, u32);

    /// Forgets the motion so far, after the device was gone.
    fn restart(&mut self) {}
}
