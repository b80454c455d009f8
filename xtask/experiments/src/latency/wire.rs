//! A device behind a simulated wire: an emulated one with its hand that exchanges reports, keeps a clock of
//! its own, and notes the age of the wrenches written to it.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use palpate::device::link::{
    Codec, LONGEST_REPORT, Link, LinkedDevice, Malformed, Motion, Report, Transport, TransportError,
};
use palpate::device::{Axes, DeviceError, DeviceState, HapticDevice, Specification};
use palpate::glam::{DQuat, DVec3};
use palpate::telemetry::Times;
use palpate::threads::{Role, ThreadSetup, set_up};
use palpate::{Pose, Twist, Wrench};

/// Period of the device's reports, s: 1.0007 ms, so that they pass through all phases of the haptic loop
/// within seconds.
const PERIOD: f64 = 1.0007e-3;
/// Time for which the pump waits for a report, and silence (s) after which the device counts as lost.
const REPORT_TIMEOUT: Duration = Duration::from_millis(2);
const SILENCE: f64 = 10e-3;
/// Count of numbers in a report (pose and twist), and in a written one (wrench).
const REPORT_NUMBERS: usize = 13;
const WRENCH_NUMBERS: usize = 6;

/// Ages of the wrenches written to the device, counted from the time at which the haptic thread handed a
/// wrench over.
#[derive(Clone, Debug, Default)]
pub struct Noted {
    /// Age of each wrench when it was written.
    pub written: Times,
    /// Age of each wrench when the next one replaced it: the oldest that the hand has felt.
    pub replaced: Times,
    /// Time between writes.
    pub between: Times,
    /// Count of zero wrenches that the pump wrote and the haptic thread had not asked for.
    pub dropouts: u64,
    /// Time of the last write, and time at which its wrench was handed over, ns since the start; `None`
    /// before the first wrench of the haptic thread.
    last: Option<(u64, u64)>,
}

/// State shared by the haptic thread and the device.
#[derive(Debug)]
pub struct Shared {
    start: Instant,
    noted: Mutex<Noted>,
    /// Whether the session has ended, so that writing zero is correct.
    closed: AtomicBool,
}

impl Shared {
    fn now(&self) -> u64 {
        // Overflows after five centuries.
        self.start.elapsed().as_nanos() as u64
    }

    pub fn noted(&self) -> MutexGuard<'_, Noted> {
        self.noted.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The device as a session drives it.
pub struct Wired {
    specification: Specification,
    inner: LinkedDevice<AsReported>,
    shared: Arc<Shared>,
}

/// Puts `device` behind a wire that carries forces alone. With `normal_pump`, the pump's thread gives up its
/// priority.
///
/// # Errors
/// If the system cannot start a thread.
pub fn wired(device: Box<dyn HapticDevice>, normal_pump: bool) -> std::io::Result<(Wired, Arc<Shared>)> {
    let shared = Arc::new(Shared {
        start: Instant::now(),
        noted: Mutex::new(Noted::default()),
        closed: AtomicBool::new(false),
    });
    let specification =
        Specification { actuated: Axes::TRANSLATION, delay: PERIOD, ..device.specification().clone() };
    // The torque of a report carries the time, so it must not be limited.
    let roomy = Specification { actuated: Axes::ALL, peak_torque: f64::INFINITY, ..specification.clone() };
    let mut wire =
        Some(Wire { device, shared: shared.clone(), reported: 0, latest: None, normal: normal_pump });
    let link = Link {
        codec: Numbers,
        motion: AsReported,
        specification: roomy,
        read_timeout: REPORT_TIMEOUT,
        silence: SILENCE,
    };
    let inner = link.spawn(move || wire.take().map(|wire| Box::new(wire) as Box<dyn Transport>))?;
    Ok((Wired { specification, inner, shared: shared.clone() }, shared))
}

impl HapticDevice for Wired {
    fn specification(&self) -> &Specification {
        &self.specification
    }

    fn read(&mut self, now: f64) -> Result<DeviceState, DeviceError> {
        self.inner.read(now)
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceError> {
        let handed_over = self.shared.now() as f64;
        self.inner.write(&Wrench::new(wrench.force, DVec3::X * handed_over))
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        self.shared.closed.store(true, Ordering::Release);
        self.inner.close()
    }

    fn thread_setup(&self) -> Option<&ThreadSetup> {
        self.inner.thread_setup()
    }
}

/// The device's end of the wire.
struct Wire {
    device: Box<dyn HapticDevice>,
    shared: Arc<Shared>,
    /// Count of reports, without late ones.
    reported: u64,
    latest: Option<DeviceState>,
    /// Whether the pump has yet to give up its priority.
    normal: bool,
}

impl Transport for Wire {
    fn read(
        &mut self,
        report: &mut [u8; LONGEST_REPORT],
        patience: Duration,
    ) -> Result<usize, TransportError> {
        if std::mem::take(&mut self.normal) {
            set_up(Role::Contact);
        }
        let due = Duration::from_secs_f64((self.reported + 1) as f64 * PERIOD);
        let wait = due.saturating_sub(self.shared.start.elapsed());
        std::thread::sleep(wait.min(patience));
        if wait > patience {
            return Ok(0);
        }
        let now = self.shared.start.elapsed().as_secs_f64();
        self.reported = (now / PERIOD) as u64;
        self.latest = self.device.read(now).ok().or(self.latest);
        let Some(DeviceState { pose, twist, .. }) = self.latest else { return Ok(0) };
        let [x, y, z, w] = pose.rotation.to_array();
        let rest = [x, y, z, w].into_iter().chain(twist.linear.to_array()).chain(twist.angular.to_array());
        let numbers = pose.translation.to_array().into_iter().chain(rest);
        let bytes = numbers.flat_map(f64::to_le_bytes);
        report.iter_mut().zip(bytes).for_each(|(to, from)| *to = from);
        Ok(8 * REPORT_NUMBERS)
    }

    fn write(&mut self, report: &[u8]) -> Result<(), TransportError> {
        let [x, y, z, handed_over, ..] = numbers::<WRENCH_NUMBERS>(report).ok_or(TransportError::Failed)?;
        self.note(handed_over as u64);
        self.device.write(&Wrench::new(DVec3::new(x, y, z), DVec3::ZERO)).map_err(|_| TransportError::Failed)
    }
}

impl Wire {
    /// Notes that a wrench is written that was handed over at that time, ns; 0 if the pump made it itself.
    fn note(&self, handed_over: u64) {
        let now = self.shared.now();
        let mut noted = self.shared.noted();
        if let Some((before, then)) = noted.last {
            noted.between.record(now - before);
            noted.replaced.record(now - then);
        }
        if handed_over > 0 {
            noted.written.record(now.saturating_sub(handed_over));
            noted.last = Some((now, handed_over));
        } else if let Some((_, then)) = noted.last {
            noted.dropouts += u64::from(!self.shared.closed.load(Ordering::Acquire));
            noted.last = Some((now, then));
        }
    }
}

/// Codec of reports: plain numbers.
struct Numbers;

impl Codec for Numbers {
    type Sample = [f64; REPORT_NUMBERS];

    fn decode(&mut self, report: &[u8], sample: &mut Self::Sample) -> Result<(), Malformed> {
        *sample = numbers(report).ok_or(Malformed)?;
        Ok(())
    }

    fn encode(&mut self, wrench: &Wrench, _: &Self::Sample, say: &mut dyn FnMut(Report)) {
        let mut bytes = [0; 8 * WRENCH_NUMBERS];
        let numbers = wrench.force.to_array().into_iter().chain(wrench.torque.to_array());
        bytes.iter_mut().zip(numbers.flat_map(f64::to_le_bytes)).for_each(|(to, from)| *to = from);
        say(Report::new(&bytes, bytes.len()));
    }
}

/// Decodes a report of exactly `N` numbers.
fn numbers<const N: usize>(report: &[u8]) -> Option<[f64; N]> {
    let (words, rest) = report.as_chunks::<8>();
    let words: &[[u8; 8]; N] = words.try_into().ok().filter(|_| rest.is_empty())?;
    Some(words.map(f64::from_le_bytes))
}

/// Passes the reported motion on unchanged.
struct AsReported;

impl Motion for AsReported {
    type Sample = [f64; REPORT_NUMBERS];

    fn advance(&mut self, sample: &Self::Sample, _: Option<f64>, _: f64) -> (Pose, Twist, u32) {
        let at = |first: usize| DVec3::from_slice(&sample[first..]);
        let pose = Pose::new(at(0), DQuat::from_slice(&sample[3..]));
        (pose, Twist::new(at(7), at(10)), 0)
    }
}
