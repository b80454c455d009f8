//! Reports that carry the results of a library's calls.
//!
//! A report that is read, little-endian: flags (32 bits: 1 if the device accepts forces, 2 and 4 if a linear
//! and an angular velocity are given), buttons (32 bits), then 13 numbers of 64 bits: position (m),
//! orientation (quaternion x, y, z, w), linear velocity (m/s), angular velocity (rad/s). A report that is
//! written: force (N) and torque (N·m), 6 numbers of 64 bits.

use glam::DVec3;
use palpate_core::Wrench;

use crate::link::{Codec, Malformed, Report};

/// Size of the two reports, bytes.
const READ_BYTES: usize = 8 + 13 * 8;
const WRITTEN_BYTES: usize = 6 * 8;
const READY: u32 = 1;
const LINEAR: u32 = 2;
const ANGULAR: u32 = 4;
/// Largest coordinate (m) and speeds (m/s, rad/s) that pass as a device's; beyond them a report is malformed.
const MAX_POSITION: f64 = 10.0;
const MAX_SPEED: f64 = 100.0;
const MAX_ANGULAR_SPEED: f64 = 1000.0;

/// State of a device as its maker's library reports it, in the device's axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SdkState {
    /// Position of the handle, m.
    pub position: [f64; 3],
    /// Orientation of the handle: unit quaternion x, y, z, w.
    pub orientation: [f64; 4],
    /// Linear velocity, m/s; `None` if the library does not report it.
    pub linear: Option<[f64; 3]>,
    /// Angular velocity, rad/s; `None` if the library does not report it.
    pub angular: Option<[f64; 3]>,
    /// Buttons held down, the first in bit 0.
    pub buttons: u32,
    /// Whether the device accepts forces.
    pub ready: bool,
}

impl Default for SdkState {
    fn default() -> Self {
        Self {
            position: [0.0; 3],
            orientation: [0.0, 0.0, 0.0, 1.0],
            linear: None,
            angular: None,
            buttons: 0,
            ready: false,
        }
    }
}

impl SdkState {
    /// The state as a report of 112 bytes.
    pub fn to_report(&self) -> [u8; READ_BYTES] {
        let flag = |set: bool, flag: u32| if set { flag } else { 0 };
        let flags = flag(self.ready, READY)
            | flag(self.linear.is_some(), LINEAR)
            | flag(self.angular.is_some(), ANGULAR);
        let (linear, angular) = (self.linear.unwrap_or_default(), self.angular.unwrap_or_default());
        let numbers = self.position.into_iter().chain(self.orientation).chain(linear).chain(angular);
        let mut report = [0; READ_BYTES];
        let (words, _) = report.as_chunks_mut::<8>();
        if let [head, tail @ ..] = words {
            *head = (u64::from(flags) | u64::from(self.buttons) << 32).to_le_bytes();
            tail.iter_mut().zip(numbers).for_each(|(to, number)| *to = number.to_le_bytes());
        }
        report
    }

    /// Decodes a report.
    ///
    /// # Errors
    /// If its length or flags are wrong, a number is not finite, the orientation is not a unit quaternion, or
    /// position or velocity are beyond those of any device.
    pub fn from_report(report: &[u8]) -> Result<Self, Malformed> {
        let report: &[u8; READ_BYTES] = report.try_into().map_err(|_| Malformed)?;
        let (words, _) = report.as_chunks::<8>();
        // Word 0: flags and buttons; 1 to 3: position; 4 to 7: orientation; 8 to 10 and 11 to 13: velocities.
        let head = u64::from_le_bytes(words[0]);
        let (flags, buttons) = (head as u32, (head >> 32) as u32);
        if flags & !(READY | LINEAR | ANGULAR) != 0 {
            return Err(Malformed);
        }
        let number = |index: usize| f64::from_le_bytes(words[index]);
        let vector = |first: usize| [first, first + 1, first + 2].map(number);
        let velocity = |flag: u32, first: usize| (flags & flag != 0).then(|| vector(first));
        let state = Self {
            position: vector(1),
            orientation: [4, 5, 6, 7].map(number),
            linear: velocity(LINEAR, 8),
            angular: velocity(ANGULAR, 11),
            buttons,
            ready: flags & READY != 0,
        };
        if state.is_sound() { Ok(state) } else { Err(Malformed) }
    }

    fn is_sound(&self) -> bool {
        // Comparisons with numbers that are not finite are false.
        let within = |numbers: [f64; 3], limit: f64| numbers.iter().all(|number| number.abs() <= limit);
        let square: f64 = self.orientation.iter().map(|part| part * part).sum();
        within(self.position, MAX_POSITION)
            && (0.9..1.1).contains(&square)
            && self.linear.is_none_or(|velocity| within(velocity, MAX_SPEED))
            && self.angular.is_none_or(|velocity| within(velocity, MAX_ANGULAR_SPEED))
    }
}

/// Decodes the wrench of a written report.
///
/// # Errors
/// If its length is wrong or a number is not finite.
pub fn wrench_of(report: &[u8]) -> Result<Wrench, Malformed> {
    let report: &[u8; WRITTEN_BYTES] = report.try_into().map_err(|_| Malformed)?;
    let (words, _) = report.as_chunks::<8>();
    let vector =
        |first: usize| DVec3::from_array([0, 1, 2].map(|axis| f64::from_le_bytes(words[first + axis])));
    let wrench = Wrench::new(vector(0), vector(3));
    if wrench.is_finite() { Ok(wrench) } else { Err(Malformed) }
}

/// Report format common to the makers' libraries.
#[derive(Clone, Copy, Debug, Default)]
pub struct SdkCodec;

impl Codec for SdkCodec {
    type Sample = SdkState;

    fn decode(&mut self, report: &[u8], sample: &mut SdkState) -> Result<(), Malformed> {
        *sample = SdkState::from_report(report)?;
        Ok(())
    }

    fn is_enabled(&self, sample: &SdkState) -> bool {
        sample.ready
    }

    fn encode(&mut self, wrench: &Wrench, sample: &SdkState, say: &mut dyn FnMut(Report)) {
        // A device that is not ready gets a zero wrench.
        let wrench = if sample.ready { *wrench } else { Wrench::ZERO };
        let numbers = wrench.force.to_array().into_iter().chain(wrench.torque.to_array());
        let mut bytes = [0; WRITTEN_BYTES];
        let (words, _) = bytes.as_chunks_mut::<8>();
        words.iter_mut().zip(numbers).for_each(|(to, number)| *to = number.to_le_bytes());
        say(Report::new(&bytes, WRITTEN_BYTES));
    }
}
