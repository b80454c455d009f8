//! What a driver says of its device: the language of its reports, and the motion that they tell.

use palpate_core::{Pose, Twist, Wrench};

use super::transport::{LONGEST_REPORT, Transport, TransportError};

/// A report that is not one of the device's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Malformed;

/// A report to write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Report {
    bytes: [u8; LONGEST_REPORT],
    length: usize,
}

impl Report {
    /// A report that begins with these bytes and goes on with zeros up to a length, of at most [`LONGEST_REPORT`].
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

/// The language of a kind of device.
pub trait Codec: Send + 'static {
    /// What its reports tell.
    type Sample: Copy + Default + Send + std::fmt::Debug + 'static;

    /// A round of the pump begins at its time `now` (s), which never runs back: what follows is of this round. For devices that are to
    /// be told something from time to time.
    fn begin_round(&mut self, now: f64) {
        let _ = now;
    }

    /// Adds a report to what is known.
    ///
    /// # Errors
    /// If it is none of the device's; nothing is changed then.
    fn decode(&mut self, report: &[u8], sample: &mut Self::Sample) -> Result<(), Malformed>;

    /// Whether the device takes a wrench, by what is known: not before it is calibrated, say, or its power is switched on, nor where
    /// it tells that its own watchdog has let go, or the hand would be given the whole force at once when it takes one again. Where it
    /// does not, it is asked for zero, and [`NOT_ENABLED`](crate::Status::NOT_ENABLED) is told.
    fn is_enabled(&self, sample: &Self::Sample) -> bool {
        let _ = sample;
        true
    }

    /// Says the reports that ask for a wrench on the hand (device axes), by what is known; none where there is nothing to say.
    fn encode(&mut self, wrench: &Wrench, sample: &Self::Sample, say: &mut dyn FnMut(Report));

    /// What is said first, and first after the device has come back.
    ///
    /// # Errors
    /// If the device does not take part: it is tried anew later.
    fn start(&mut self, transport: &mut dyn Transport) -> Result<(), TransportError> {
        let _ = transport;
        Ok(())
    }

    /// What is said last, after a wrench of zero.
    ///
    /// # Errors
    /// If the device does not take it.
    fn stop(&mut self, transport: &mut dyn Transport) -> Result<(), TransportError> {
        let _ = transport;
        Ok(())
    }
}

/// How the handle moves, by what a device's reports tell.
pub trait Motion: Send {
    /// What the reports tell.
    type Sample: Copy + Default + Send + 'static;

    /// Pose and twist of the handle (device axes) and the buttons at the driver's time `now` (s). `came` is the time (s) that the
    /// newest report came at, at most `now`, where one came since the last call: velocities are by these, not by the times of calls.
    fn advance(&mut self, sample: &Self::Sample, came: Option<f64>, now: f64) -> (Pose, Twist, u32);

    /// The device was gone: what was known of its motion says nothing now.
    fn restart(&mut self) {}
}
