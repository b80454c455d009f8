//! Simulated device behind a wire with faults, and a hand with mass that holds it: for tests from the bytes
//! of a report to the force on the hand.
//!
//! The device samples the hand by its own clock and sends its position in bytes with a counter and a
//! checksum; the host answers with a force in bytes. In both directions a report may be late, lost,
//! duplicated, overtaken, truncated or have bits flipped, by [`Impairments`]. The device drops its force when
//! no report arrives for [`DEVICE_TIMEOUT`], as real ones do. The force that reaches the hand is checked
//! ([`Findings`]).

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use palpate::device::link::{
    Codec, LONGEST_REPORT, Link, Malformed, Motion, Report, Transport, TransportError,
};
use palpate::device::{Axes, Emulation, Specification};
use palpate::glam::DVec3;
use palpate::promises::FAULT_TIME;
use palpate::telemetry::Times;
use palpate::{Pose, Twist, Wrench};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

/// Time for which the device never_drops a force without a report from the host, s.
pub const DEVICE_TIMEOUT: f64 = 0.05;
/// Period of the device's reports by its own clock, and time step of the hand, s.
const REPORT_PERIOD: f64 = 1e-3;
const STEP: f64 = 1e-4;
/// Time after the hand begins to press from which no report is lost, so that the force comes back, s.
const FAULT_FREE_AFTER: f64 = 0.6;
/// Largest number of reports that wait for the host; newer ones are lost.
const MAX_PENDING: usize = 64;
/// Bytes of a report to the host (counter, device's time, position, whether it has dropped its force,
/// checksum), and of a command to the device (counter, force, checksum).
const REPORT: usize = 21;
const COMMAND: usize = 16;
/// Relative error by which a value may exceed its bound: forces are transmitted as f32.
const ROUNDING: f64 = 1e-5;

/// Fault that lasts for a while, repeatedly.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The device sends nothing.
    Silent,
    /// The device receives nothing.
    Deaf,
    /// The device sends its position in mm.
    Millimetres,
    /// The device sends random bits as its position, with a correct checksum.
    Nonsense,
    /// The device is unplugged.
    Unplugged,
    /// The hand lets go of the handle.
    LetsGo,
    /// The host's haptic thread stalls.
    LoopStalls,
    /// The host's pump stalls.
    PumpStalls,
}

/// Impairments of the wire. Shares are from 0 to 1, times in s.
#[derive(Clone, Debug, Default)]
pub struct Impairments {
    /// Latencies to the host and to the device.
    pub latency: (f64, f64),
    /// Largest random addition to the latency.
    pub jitter: f64,
    /// Share of reports that are lost.
    pub lost: f64,
    /// Share of reports that arrive twice.
    pub duplicated: f64,
    /// Share of reports that take up to 8 ms longer, so that others overtake them.
    pub overtaken: f64,
    /// Share of reports that are truncated in half.
    pub truncated: f64,
    /// Share of reports that have one to three bits flipped.
    pub flipped: f64,
    /// Share of writes that fail.
    pub failing: f64,
    /// Relative error of the device's clock; positive if it is fast.
    pub clock_rate: f64,
    /// Rate at which the device's clock jumps by up to 20 ms, 1/s.
    pub clock_jumps: f64,
    /// Faults of 5 to 120 ms, about three times a second.
    pub faults: Vec<Fault>,
    /// Whether the host does not check what the device sends.
    pub unchecked: bool,
    /// Whether the device reports that it has dropped its force, and then accepts only zero next.
    pub latches: bool,
    /// Number of the host's haptic steps that are skipped after each.
    pub skipped: u32,
}

impl Impairments {
    /// Returns the time between steps of the host's haptic loop, ms.
    pub fn every(&self) -> u32 {
        1 + self.skipped
    }

    /// Returns the longest latency to the device, s.
    fn max_latency(&self) -> f64 {
        self.latency.1 + self.jitter + if self.overtaken > 0.0 { MAX_OVERTAKEN_DELAY } else { 0.0 }
    }
}

/// Largest additional latency of a report that is overtaken, s.
const MAX_OVERTAKEN_DELAY: f64 = 8e-3;

/// Faults of host and device that the checks must detect.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sabotage {
    /// The host's codec repeats the last force in place of zero.
    pub repeats: bool,
    /// The host's codec sends a hundred times the requested force.
    pub hundredfold: bool,
    /// The device never drops a force.
    pub never_drops: bool,
}

/// Returns the device's specification: an emulated one's forces along the axes, with the wire's latency as
/// its delay.
pub fn specification(impairments: &Impairments) -> Specification {
    let emulated = Emulation::default().specification;
    Specification {
        name: "faulty wire".into(),
        sensed: Axes::TRANSLATION,
        actuated: Axes::TRANSLATION,
        peak_torque: 0.0,
        continuous_torque: 0.0,
        angular_stiffness: 0.0,
        angular_damping: 0.0,
        encoder_step: 1e-6,
        velocity_delay: 1e-3,
        delay: 1e-3 + impairments.latency.0 + impairments.latency.1 + impairments.jitter,
        handle: None,
        ..emulated
    }
}

/// Returns the CRC-16 (CCITT), which detects up to three flipped bits.
fn checksum(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0xffff, |sum, byte| {
        (0..8)
            .fold(sum ^ u16::from(*byte) << 8, |sum, _| sum << 1 ^ if sum & 0x8000 == 0 { 0 } else { 0x1021 })
    })
}

fn sealed(mut bytes: Vec<u8>) -> Vec<u8> {
    let sum = checksum(&bytes);
    bytes.extend(sum.to_le_bytes());
    bytes
}

fn is_sealed(bytes: &[u8]) -> bool {
    bytes.split_last_chunk().is_some_and(|(body, sum)| checksum(body) == u16::from_le_bytes(*sum))
}

/// Decodes three numbers from an offset on.
fn vector(bytes: &[u8], at: usize) -> DVec3 {
    let number = |axis: usize| {
        let first = at + 4 * axis;
        f64::from(f32::from_le_bytes([bytes[first], bytes[first + 1], bytes[first + 2], bytes[first + 3]]))
    };
    DVec3::new(number(0), number(1), number(2))
}

fn put(bytes: &mut Vec<u8>, vector: DVec3) {
    bytes.extend(vector.to_array().into_iter().flat_map(|x| (x as f32).to_le_bytes()));
}

/// Returns whether a counter is ahead of another.
fn is_ahead(counter: u16, of: u16) -> bool {
    counter.wrapping_sub(of) as i16 > 0
}

/// Report of the device.
#[derive(Clone, Copy, Debug, Default)]
pub struct HandSample {
    known: bool,
    counter: u16,
    /// Time by the device's clock, µs.
    time: u32,
    place: DVec3,
    /// Whether the device has dropped its force.
    dropped: bool,
}

/// Codec of the device.
#[derive(Clone, Debug)]
pub struct HandCodec {
    checks: bool,
    sabotage: Sabotage,
    counter: u16,
    last: DVec3,
}

impl Codec for HandCodec {
    type Sample = HandSample;

    fn decode(&mut self, report: &[u8], sample: &mut HandSample) -> Result<(), Malformed> {
        if report.len() != REPORT || self.checks && !is_sealed(report) {
            return Err(Malformed);
        }
        let counter = u16::from_le_bytes([report[0], report[1]]);
        if self.checks && sample.known && !is_ahead(counter, sample.counter) {
            return Err(Malformed);
        }
        let time = u32::from_le_bytes([report[2], report[3], report[4], report[5]]);
        *sample =
            HandSample { known: true, counter, time, place: vector(report, 6), dropped: report[18] == 1 };
        Ok(())
    }

    fn is_enabled(&self, sample: &HandSample) -> bool {
        !sample.dropped
    }

    fn encode(&mut self, wrench: &Wrench, _: &HandSample, say: &mut dyn FnMut(Report)) {
        let Sabotage { repeats, hundredfold, .. } = self.sabotage;
        let force = if repeats && wrench.force == DVec3::ZERO { self.last } else { wrench.force };
        self.last = force;
        self.counter = self.counter.wrapping_add(1);
        let mut bytes = self.counter.to_le_bytes().to_vec();
        put(&mut bytes, if hundredfold { 100.0 * force } else { force });
        say(Report::new(&sealed(bytes), COMMAND));
    }
}

/// Motion of the handle by the device's clock.
#[derive(Clone, Debug, Default)]
pub struct HandMotion {
    /// Time (µs) and position of the last report.
    last: Option<(u32, DVec3)>,
    twist: Twist,
}

/// Largest time between readings from which a velocity is computed, µs.
const MAX_VELOCITY_STEP: i32 = 50_000;

impl Motion for HandMotion {
    type Sample = HandSample;

    fn advance(&mut self, sample: &HandSample, came: Option<f64>, _: f64) -> (Pose, Twist, u32) {
        if came.is_some() {
            let last = self.last.replace((sample.time, sample.place));
            let velocity = last.and_then(|(time, place)| {
                let passed = sample.time.wrapping_sub(time) as i32;
                (1..=MAX_VELOCITY_STEP)
                    .contains(&passed)
                    .then(|| (sample.place - place) / (1e-6 * f64::from(passed)))
            });
            self.twist = Twist::new(velocity.unwrap_or(DVec3::ZERO), DVec3::ZERO);
        }
        (Pose::from_translation(sample.place), self.twist, 0)
    }

    fn restart(&mut self) {
        *self = Self::default();
    }
}

/// Hand that follows an intended path, on a handle that the device pushes.
#[derive(Clone, Copy, Debug)]
struct Hand {
    /// Mass (kg), stiffness (N/m) and damping (N·s/m).
    mass: f64,
    stiffness: f64,
    damping: f64,
    place: DVec3,
    velocity: DVec3,
}

impl Hand {
    /// Returns the intended position: to and fro along x, and up and down through z = −10 mm each second; 25
    /// mm down from `press` (s) on.
    fn intended(time: f64, press: f64) -> DVec3 {
        let x = 0.01 * (0.7 * TAU * time).sin();
        let down = ((time - press) / 0.5).clamp(0.0, 1.0);
        let z = -0.005 * (1.0 - (TAU * time).cos()) * (1.0 - down) - 0.025 * down;
        DVec3::new(x, 0.0, z)
    }

    /// Takes a time step with a share of the grip.
    fn step(&mut self, intended: DVec3, grip: f64, force: DVec3) {
        let held = self.stiffness * (intended - self.place) - self.damping * self.velocity;
        self.velocity += (grip * held + force) / self.mass * STEP;
        self.place += self.velocity * STEP;
    }
}

/// Report in transit.
#[derive(Clone, Debug)]
struct Flight {
    sent: f64,
    arrives: f64,
    /// Whether the report is correct.
    right: bool,
    bytes: Vec<u8>,
}

/// Observations at the hand.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    /// Violated conditions, with their number and the worst value.
    pub broken: BTreeMap<&'static str, (u64, f64)>,
    /// Largest force, N.
    pub most: f64,
    /// Largest speed of the hand, m/s.
    pub fastest: f64,
    /// Force at the end, N.
    pub force: DVec3,
    /// Number of forces that reached the device.
    pub taken: u64,
    /// Number of times that a force of more than 0.2 N became zero at once.
    pub dropouts: u64,
    /// Largest force that the device accepted first after it had dropped its force, N. The host may not know
    /// that it did.
    pub regained: f64,
    /// Times from the haptic loop's last step to the write of a force, ns.
    pub ages: Times,
    /// Times between forces that reached the device, ns.
    pub gaps: Times,
}

impl Findings {
    fn note(&mut self, what: &'static str, figure: f64) {
        let (count, worst) = self.broken.entry(what).or_default();
        *count += 1;
        *worst = worst.max(figure);
    }
}

/// Force that the device has accepted.
#[derive(Clone, Copy, Debug)]
struct Taken {
    counter: u16,
    sent: f64,
    arrived: f64,
    force: DVec3,
    /// Whether the device has dropped it.
    dropped: bool,
}

/// Everything beyond the host's end of the wire.
struct World {
    impairments: Impairments,
    sabotage: Sabotage,
    rng: StdRng,
    /// Peak force (N) and slew rate (N/s).
    peak: f64,
    slew: f64,
    /// Present time, and time from which the hand presses, s.
    now: f64,
    press: f64,
    hand: Hand,
    /// Device's time and time of its next report, s; number of reports sent.
    clock: f64,
    due: f64,
    counter: u16,
    taken: Option<Taken>,
    /// Force that the hand feels, N.
    force: DVec3,
    to_host: Vec<Flight>,
    to_device: Vec<Flight>,
    faults: Vec<(Fault, f64, f64)>,
    /// Times of the host's last correct report and of its haptic loop's last step, s.
    heard: f64,
    stepped: f64,
    findings: Findings,
}

impl World {
    fn has(&self, fault: Fault) -> bool {
        self.faults.iter().any(|(kind, from, to)| *kind == fault && (*from..*to).contains(&self.now))
    }

    fn chance(&mut self, share: f64) -> bool {
        share > 0.0 && self.rng.random_range(0.0..1.0) < share
    }

    /// Returns the deliveries of bytes that are sent now.
    fn carry(&mut self, mut bytes: Vec<u8>, latency: f64) -> Vec<Flight> {
        let calm = self.now > self.press + FAULT_FREE_AFTER;
        let Impairments { jitter, lost, duplicated, overtaken, truncated, flipped, .. } =
            if calm { Impairments::default() } else { self.impairments.clone() };
        if self.chance(lost) {
            return Vec::new();
        }
        if self.chance(flipped) {
            for _ in 0..self.rng.random_range(1..=3) {
                let bit = self.rng.random_range(0..8 * bytes.len());
                bytes[bit / 8] ^= 1 << (bit % 8);
            }
        }
        if self.chance(truncated) {
            bytes.truncate(bytes.len() / 2);
        }
        let wrong = self.has(Fault::Millimetres) || self.has(Fault::Nonsense);
        let copies = 1 + usize::from(self.chance(duplicated));
        (0..copies)
            .map(|_| {
                let detour = if self.chance(overtaken) { MAX_OVERTAKEN_DELAY } else { 0.0 };
                let longer = self.rng.random_range(0.0..=1.0);
                let arrives = self.now + latency + longer * (jitter + detour);
                Flight { sent: self.now, arrives, right: !wrong, bytes: bytes.clone() }
            })
            .collect()
    }

    /// Returns the earliest of the reports that have arrived.
    fn arrived(flights: &mut Vec<Flight>, now: f64) -> Option<Flight> {
        let first = (0..flights.len()).min_by(|a, b| flights[*a].arrives.total_cmp(&flights[*b].arrives))?;
        (flights[first].arrives <= now).then(|| flights.swap_remove(first))
    }

    fn advance(&mut self, to: f64) {
        while self.now + STEP <= to {
            self.now += STEP;
            while let Some(flight) = Self::arrived(&mut self.to_device, self.now) {
                self.take(&flight);
            }
            self.drop_force();
            let grip = if self.has(Fault::LetsGo) { 0.0 } else { 1.0 };
            self.hand.step(Hand::intended(self.now, self.press), grip, self.force);
            self.report();
            self.watch();
        }
    }

    /// Returns whether the device has dropped its force and reports it.
    fn has_latched(&self) -> bool {
        self.impairments.latches && self.taken.is_some_and(|last| last.dropped)
    }

    /// Passes a report of the host to the device, which accepts it if it is intact and newer.
    fn take(&mut self, flight: &Flight) {
        if self.has(Fault::Deaf) || self.has(Fault::Unplugged) {
            return;
        }
        let Flight { sent, ref bytes, .. } = *flight;
        if bytes.len() != COMMAND || !is_sealed(bytes) {
            return;
        }
        let counter = u16::from_le_bytes([bytes[0], bytes[1]]);
        let force = vector(bytes, 2);
        if self.has_latched() && force != DVec3::ZERO {
            return;
        }
        let findings = &mut self.findings;
        if let Some(last) = &self.taken {
            if !is_ahead(counter, last.counter) {
                return;
            }
            // A force was computed up to a step before it was sent, and may grow by one step's share at once.
            let step = 1e-3 * f64::from(self.impairments.every());
            let allowed = self.slew * (sent - last.sent + step);
            let grown = grown(force, last.force);
            if grown > allowed + ROUNDING {
                findings.note("grows faster than the slew", grown / allowed);
            }
            if self.force != DVec3::ZERO {
                findings.gaps.record(((self.now - last.arrived) * 1e9) as u64);
            }
        }
        if !force.is_finite() {
            findings.note("not finite", 1.0);
        }
        if force.length() > self.peak * (1.0 + ROUNDING) {
            findings.note("above the peak", force.length());
        }
        if self.taken.is_some_and(|last| last.dropped) {
            findings.regained = findings.regained.max(force.length());
        }
        findings.taken += 1;
        self.feel(force);
        self.taken = Some(Taken { counter, sent, arrived: self.now, force, dropped: false });
    }

    fn feel(&mut self, force: DVec3) {
        self.findings.dropouts += u64::from(self.force.length() > 0.2 && force == DVec3::ZERO);
        self.findings.most = self.findings.most.max(force.length());
        self.force = force;
    }

    /// Makes the device drop its force if it receives nothing. The next force may have any size, since the
    /// device has reported that.
    fn drop_force(&mut self) {
        let waited = self.taken.map_or(0.0, |taken| self.now - taken.arrived);
        let unplugged = self.has(Fault::Unplugged);
        if (waited > DEVICE_TIMEOUT || unplugged) && !self.sabotage.never_drops {
            self.feel(DVec3::ZERO);
            if let Some(taken) = &mut self.taken {
                (taken.force, taken.dropped) = (DVec3::ZERO, true);
            }
        }
    }

    fn report(&mut self) {
        let Impairments { clock_rate, clock_jumps, latency, .. } = self.impairments;
        self.clock += STEP * (1.0 + clock_rate);
        if self.chance(clock_jumps * STEP) {
            self.clock += self.rng.random_range(-0.02..0.02);
            self.due = self.clock;
        }
        if self.clock < self.due {
            return;
        }
        self.due = self.clock.max(self.due + REPORT_PERIOD);
        if self.has(Fault::Silent) || self.has(Fault::Unplugged) {
            return;
        }
        let unit = if self.has(Fault::Millimetres) { 1e3 } else { 1.0 };
        self.counter = self.counter.wrapping_add(1);
        let mut bytes = self.counter.to_le_bytes().to_vec();
        bytes.extend(((self.clock * 1e6) as i64 as u32).to_le_bytes());
        if self.has(Fault::Nonsense) {
            bytes.extend((0..12).map(|_| self.rng.random_range(0..=u8::MAX)));
        } else {
            put(&mut bytes, unit * self.hand.place);
        }
        bytes.push(u8::from(self.has_latched()));
        let flights = self.carry(sealed(bytes), latency.0);
        let room = MAX_PENDING - self.to_host.len().min(MAX_PENDING);
        self.to_host.extend(flights.into_iter().take(room));
    }

    /// Checks the conditions on the force on the hand that hold at all times.
    fn watch(&mut self) {
        let speed = self.hand.velocity.length();
        self.findings.fastest = self.findings.fastest.max(speed);
        if !speed.is_finite() {
            self.findings.note("the hand's speed is not finite", 1.0);
        }
        if self.force == DVec3::ZERO {
            return;
        }
        // A device that receives nothing never_drops the last force until it drops it.
        let unheard = self.taken.map_or(0.0, |taken| self.now - taken.arrived);
        if unheard > DEVICE_TIMEOUT + STEP {
            self.findings.note("kept by the device", unheard);
        }
        for (what, since) in
            [("long after the last report", self.heard), ("long after the last step", self.stepped)]
        {
            let late = self.now - since - unheard - self.impairments.max_latency();
            if late > FAULT_TIME + STEP {
                self.findings.note(what, late);
            }
        }
    }
}

/// Returns the distance of a force from the nearest to which the last one may have shrunk along its
/// direction.
fn grown(now: DVec3, last: DVec3) -> f64 {
    let length = last.length_squared();
    let part = if length > 0.0 { (now.dot(last) / length).clamp(0.0, 1.0) } else { 0.0 };
    now.distance(last * part)
}

/// Device's end of the wire, and the hand behind it.
#[derive(Clone)]
pub struct FaultyWire {
    world: Arc<Mutex<World>>,
    /// Start of real time, if it runs in real time.
    start: Option<Instant>,
}

impl FaultyWire {
    /// Returns a wire for `seconds`: in the last second the hand presses and there are no faults, and in the
    /// last 0.4 s nothing is lost. The force may grow no faster than `slew`, N/s.
    pub fn new(impairments: Impairments, sabotage: Sabotage, seed: u64, seconds: f64, slew: f64) -> Self {
        let mut rng = StdRng::seed_from_u64(seed);
        let press = seconds - 1.0;
        let mut faults = Vec::new();
        for kind in &impairments.faults {
            let mut from = rng.random_range(0.3..0.6);
            while from < press {
                let to = from + rng.random_range(0.005..0.12);
                faults.push((*kind, from, to));
                from = to + rng.random_range(0.1..0.4);
            }
        }
        let mass = 0.1 * 10_f64.powf(rng.random_range(0.0..1.0));
        let stiffness = 300.0;
        let damping = 2.0 * 0.7 * (stiffness * mass).sqrt();
        let hand = Hand { mass, stiffness, damping, place: DVec3::ZERO, velocity: DVec3::ZERO };
        let clock = rng.random_range(0.0..5000.0);
        let world = World {
            peak: specification(&impairments).peak_force,
            impairments,
            sabotage,
            rng,
            slew,
            now: 0.0,
            press,
            hand,
            clock,
            due: clock,
            counter: 0,
            taken: None,
            force: DVec3::ZERO,
            to_host: Vec::new(),
            to_device: Vec::new(),
            faults,
            heard: 0.0,
            stepped: 0.0,
            findings: Findings::default(),
        };
        Self { world: Arc::new(Mutex::new(world)), start: None }
    }

    /// Runs in real time from now on.
    pub fn run(&mut self) {
        self.start = Some(Instant::now());
    }

    fn lock(&self) -> MutexGuard<'_, World> {
        let mut world = self.world.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(start) = self.start {
            world.advance(start.elapsed().as_secs_f64());
        }
        world
    }

    /// Advances to a time, s.
    pub fn advance(&self, to: f64) {
        self.lock().advance(to);
    }

    /// Returns whether a fault is present.
    pub fn has(&self, fault: Fault) -> bool {
        self.lock().has(fault)
    }

    /// Notes a step of the host's haptic loop.
    pub fn note_step(&self) {
        let mut world = self.lock();
        world.stepped = world.now;
    }

    /// Returns the host's end, with a codec sabotaged as requested.
    pub fn link(&self) -> Link<HandCodec, HandMotion> {
        let world = self.lock();
        Link {
            codec: HandCodec {
                checks: !world.impairments.unchecked,
                sabotage: world.sabotage,
                counter: 0,
                last: DVec3::ZERO,
            },
            motion: HandMotion::default(),
            specification: specification(&world.impairments),
            read_timeout: Duration::from_millis(5),
            silence: 0.01,
        }
    }

    /// Opens the wire, unless the device is unplugged.
    pub fn open(&self) -> Option<Box<dyn Transport>> {
        (!self.has(Fault::Unplugged)).then(|| Box::new(self.clone()) as Box<dyn Transport>)
    }

    /// Returns the observations so far.
    pub fn findings(&self) -> Findings {
        let world = self.lock();
        Findings { force: world.force, ..world.findings.clone() }
    }
}

impl Transport for FaultyWire {
    fn read(
        &mut self,
        report: &mut [u8; LONGEST_REPORT],
        patience: Duration,
    ) -> Result<usize, TransportError> {
        let begun = Instant::now();
        loop {
            let mut world = self.lock();
            if world.has(Fault::Unplugged) {
                return Err(TransportError::Disconnected);
            }
            let now = world.now;
            if let Some(Flight { bytes, right, .. }) = World::arrived(&mut world.to_host, now) {
                if right && bytes.len() == REPORT && is_sealed(&bytes) {
                    world.heard = now;
                }
                report[..bytes.len()].copy_from_slice(&bytes);
                return Ok(bytes.len());
            }
            drop(world);
            if self.start.is_none() || begun.elapsed() >= patience {
                return Ok(0);
            }
            std::thread::sleep(Duration::from_micros(100));
        }
    }

    fn write(&mut self, report: &[u8]) -> Result<(), TransportError> {
        let mut world = self.lock();
        if world.has(Fault::Unplugged) {
            return Err(TransportError::Disconnected);
        }
        let failing = world.impairments.failing;
        if world.chance(failing) {
            return Err(TransportError::Failed);
        }
        let age = world.now - world.stepped;
        if report.len() == COMMAND && vector(report, 2) != DVec3::ZERO {
            world.findings.ages.record((age * 1e9) as u64);
        }
        let latency = world.impairments.latency.1;
        let flights = world.carry(report.to_vec(), latency);
        world.to_device.extend(flights);
        Ok(())
    }
}
