//! A device behind a wire that is cruel to what it carries, and a hand with mass behind the device: for tests of the whole way from a
//! report's bytes to the force on the hand.
//!
//! The device samples the hand by a clock of its own and sends its place in bytes with a counter and a checksum; the host answers with
//! a force in bytes. Both ways a report may be late, lost, doubled, overtaken, cut in half or have bits flipped, by a [`Cruelty`]. The
//! device lets go where it has heard of no report for [`DEVICE_TIMEOUT`], as real ones do. What reaches the hand is watched
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

/// How long the device keeps a force without a report from the host, s.
pub const DEVICE_TIMEOUT: f64 = 0.05;
/// Period of the device's reports by its own clock, and step of the hand, s.
const REPORT_PERIOD: f64 = 1e-3;
const STEP: f64 = 1e-4;
/// From so long after the hand begins to press on, nothing is lost: what comes back is to be seen, s.
const CALM: f64 = 0.6;
/// Reports that wait for the host, at most: the newest are lost beyond.
const WAITING: usize = 64;
/// Bytes of a report to the host: counter, device's time, place, whether it has let go, checksum; and to the device: counter, force,
/// checksum.
const REPORT: usize = 21;
const COMMAND: usize = 16;
/// How far a figure may be above its bound: forces are carried as f32.
const ROUNDING: f64 = 1e-5;

/// Something that goes on for a while, again and again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trouble {
    /// The device sends nothing.
    Silent,
    /// It hears nothing.
    Deaf,
    /// It sends its place in mm.
    Millimetres,
    /// It sends any bits as its place, with a checksum that is right.
    Nonsense,
    /// It is unplugged.
    Unplugged,
    /// The hand lets go of the handle.
    LetsGo,
    /// The host's haptic thread does nothing.
    LoopStalls,
    /// The host's pump does nothing.
    PumpStalls,
}

/// What the wire does to what it carries. Shares are from 0 to 1, times in s.
#[derive(Clone, Debug, Default)]
pub struct Cruelty {
    /// What each way takes: to the host, and to the device.
    pub latency: (f64, f64),
    /// What it takes longer at most, at random.
    pub jitter: f64,
    /// Share that is lost.
    pub lost: f64,
    /// Share that comes twice.
    pub doubled: f64,
    /// Share of reports that take up to 8 ms longer, so that others overtake them.
    pub overtaken: f64,
    /// Share that is cut in half.
    pub cut: f64,
    /// Share that has one to three bits flipped.
    pub flipped: f64,
    /// Share of writes that fail.
    pub failing: f64,
    /// By how much the device's clock is fast, as a share.
    pub clock_rate: f64,
    /// How often the device's clock jumps by up to 20 ms, 1/s.
    pub clock_jumps: f64,
    /// Troubles of 5 to 120 ms, about three times a second.
    pub troubles: Vec<Trouble>,
    /// The host does not check what the device sends.
    pub unchecked: bool,
    /// The device tells where it has let go by itself, and then takes nothing before it is sent zero.
    pub latches: bool,
    /// Steps of the host's haptic loop that are left out after each.
    pub left_out: u32,
}

impl Cruelty {
    /// Milliseconds from one step of the host's haptic loop to the next.
    pub fn every(&self) -> u32 {
        1 + self.left_out
    }

    /// The longest that the wire's way to the device takes, s.
    fn longest_way(&self) -> f64 {
        self.latency.1 + self.jitter + if self.overtaken > 0.0 { LONGEST_DETOUR } else { 0.0 }
    }
}

/// What a report that is overtaken takes longer at most, s.
const LONGEST_DETOUR: f64 = 8e-3;

/// Faults of host and device that the watch must see: to show that it can.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sabotage {
    /// The host's codec repeats the last force in place of zero.
    pub stubborn: bool,
    /// The host's codec sends a hundred times the force that it is asked for.
    pub hundredfold: bool,
    /// The device keeps a force for ever.
    pub keeps: bool,
}

/// The device's specification: an emulated one's forces along the axes, with what the wire takes as its delay.
pub fn specification(cruelty: &Cruelty) -> Specification {
    let emulated = Emulation::default().specification;
    Specification {
        name: "cruel".into(),
        sensed: Axes::TRANSLATION,
        actuated: Axes::TRANSLATION,
        peak_torque: 0.0,
        continuous_torque: 0.0,
        angular_stiffness: 0.0,
        angular_damping: 0.0,
        encoder_step: 1e-6,
        velocity_delay: 1e-3,
        delay: 1e-3 + cruelty.latency.0 + cruelty.latency.1 + cruelty.jitter,
        handle: None,
        ..emulated
    }
}

/// CRC-16 (CCITT): sees up to three flipped bits.
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

/// Three numbers from a place on.
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

/// Whether a counter is ahead of another one.
fn is_ahead(counter: u16, of: u16) -> bool {
    counter.wrapping_sub(of) as i16 > 0
}

/// What the device says of itself.
#[derive(Clone, Copy, Debug, Default)]
pub struct HandSample {
    known: bool,
    counter: u16,
    /// By the device's clock, µs.
    time: u32,
    place: DVec3,
    /// Whether it has let go by itself.
    let_go: bool,
}

/// The device's language.
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
            HandSample { known: true, counter, time, place: vector(report, 6), let_go: report[18] == 1 };
        Ok(())
    }

    fn is_enabled(&self, sample: &HandSample) -> bool {
        !sample.let_go
    }

    fn encode(&mut self, wrench: &Wrench, _: &HandSample, say: &mut dyn FnMut(Report)) {
        let Sabotage { stubborn, hundredfold, .. } = self.sabotage;
        let force = if stubborn && wrench.force == DVec3::ZERO { self.last } else { wrench.force };
        self.last = force;
        self.counter = self.counter.wrapping_add(1);
        let mut bytes = self.counter.to_le_bytes().to_vec();
        put(&mut bytes, if hundredfold { 100.0 * force } else { force });
        say(Report::new(&sealed(bytes), COMMAND));
    }
}

/// The handle's motion by the device's clock.
#[derive(Clone, Debug, Default)]
pub struct HandMotion {
    /// The last report's time, µs, and place.
    last: Option<(u32, DVec3)>,
    twist: Twist,
}

/// Readings further apart tell nothing of the velocity, µs.
const LONGEST_STEP: i32 = 50_000;

impl Motion for HandMotion {
    type Sample = HandSample;

    fn advance(&mut self, sample: &HandSample, came: Option<f64>, _: f64) -> (Pose, Twist, u32) {
        if came.is_some() {
            let last = self.last.replace((sample.time, sample.place));
            let velocity = last.and_then(|(time, place)| {
                let passed = sample.time.wrapping_sub(time) as i32;
                (1..=LONGEST_STEP)
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

/// A hand that wants to follow a path, on a handle that the device pushes.
#[derive(Clone, Copy, Debug)]
struct Hand {
    /// kg, N/m, N·s/m.
    mass: f64,
    stiffness: f64,
    damping: f64,
    place: DVec3,
    velocity: DVec3,
}

impl Hand {
    /// Where it wants to be: to and fro along x and up and down through z = −10 mm, each second; from `press` (s) on, 25 mm down.
    fn wanted(time: f64, press: f64) -> DVec3 {
        let x = 0.01 * (0.7 * TAU * time).sin();
        let down = ((time - press) / 0.5).clamp(0.0, 1.0);
        let z = -0.005 * (1.0 - (TAU * time).cos()) * (1.0 - down) - 0.025 * down;
        DVec3::new(x, 0.0, z)
    }

    /// A step with a share of the grip.
    fn step(&mut self, wanted: DVec3, grip: f64, force: DVec3) {
        let held = self.stiffness * (wanted - self.place) - self.damping * self.velocity;
        self.velocity += (grip * held + force) / self.mass * STEP;
        self.place += self.velocity * STEP;
    }
}

/// What is on its way.
#[derive(Clone, Debug)]
struct Flight {
    sent: f64,
    arrives: f64,
    /// Whether it says what is so.
    right: bool,
    bytes: Vec<u8>,
}

/// What was seen at the hand.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    /// What was broken, how often, and the worst figure.
    pub broken: BTreeMap<&'static str, (u64, f64)>,
    /// The largest force, N.
    pub most: f64,
    /// The largest speed of the hand, m/s.
    pub fastest: f64,
    /// The force at the end, N.
    pub force: DVec3,
    /// Forces that reached the device.
    pub taken: u64,
    /// How often a force of more than 0.2 N became nothing at once.
    pub dropouts: u64,
    /// The largest force that the device took first after it had let go by itself, N: of that the host may know nothing.
    pub regained: f64,
    /// Times from the haptic loop's last step to the write of a force, ns.
    pub ages: Times,
    /// Times from a force that reached the device to the next, ns.
    pub gaps: Times,
}

impl Findings {
    fn note(&mut self, what: &'static str, figure: f64) {
        let (count, worst) = self.broken.entry(what).or_default();
        *count += 1;
        *worst = worst.max(figure);
    }
}

/// A force that the device has taken.
#[derive(Clone, Copy, Debug)]
struct Taken {
    counter: u16,
    sent: f64,
    arrived: f64,
    force: DVec3,
    /// Whether the device has let go of it by itself.
    let_go: bool,
}

/// Everything beyond the host's end of the wire.
struct World {
    cruelty: Cruelty,
    sabotage: Sabotage,
    rng: StdRng,
    /// N and N/s.
    peak: f64,
    slew: f64,
    /// The time (s), and from when on the hand presses.
    now: f64,
    press: f64,
    hand: Hand,
    /// The device's time, and when it reports next by that, s; reports sent.
    clock: f64,
    due: f64,
    counter: u16,
    taken: Option<Taken>,
    /// What the hand feels, N.
    force: DVec3,
    to_host: Vec<Flight>,
    to_device: Vec<Flight>,
    troubles: Vec<(Trouble, f64, f64)>,
    /// When the host last had a report that is whole and right, and when its haptic loop last stepped, s.
    heard: f64,
    stepped: f64,
    findings: Findings,
}

impl World {
    fn has(&self, trouble: Trouble) -> bool {
        self.troubles.iter().any(|(kind, from, to)| *kind == trouble && (*from..*to).contains(&self.now))
    }

    fn chance(&mut self, share: f64) -> bool {
        share > 0.0 && self.rng.random_range(0.0..1.0) < share
    }

    /// What comes of bytes that are sent now.
    fn carry(&mut self, mut bytes: Vec<u8>, latency: f64) -> Vec<Flight> {
        let calm = self.now > self.press + CALM;
        let Cruelty { jitter, lost, doubled, overtaken, cut, flipped, .. } =
            if calm { Cruelty::default() } else { self.cruelty.clone() };
        if self.chance(lost) {
            return Vec::new();
        }
        if self.chance(flipped) {
            for _ in 0..self.rng.random_range(1..=3) {
                let bit = self.rng.random_range(0..8 * bytes.len());
                bytes[bit / 8] ^= 1 << (bit % 8);
            }
        }
        if self.chance(cut) {
            bytes.truncate(bytes.len() / 2);
        }
        let wrong = self.has(Trouble::Millimetres) || self.has(Trouble::Nonsense);
        let copies = 1 + usize::from(self.chance(doubled));
        (0..copies)
            .map(|_| {
                let detour = if self.chance(overtaken) { LONGEST_DETOUR } else { 0.0 };
                let longer = self.rng.random_range(0.0..=1.0);
                let arrives = self.now + latency + longer * (jitter + detour);
                Flight { sent: self.now, arrives, right: !wrong, bytes: bytes.clone() }
            })
            .collect()
    }

    /// The earliest of what has arrived by now.
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
            self.let_go();
            let grip = if self.has(Trouble::LetsGo) { 0.0 } else { 1.0 };
            self.hand.step(Hand::wanted(self.now, self.press), grip, self.force);
            self.report();
            self.watch();
        }
    }

    /// Whether the device has let go, and tells it.
    fn has_latched(&self) -> bool {
        self.cruelty.latches && self.taken.is_some_and(|last| last.let_go)
    }

    /// The device takes what the host has sent, if it is whole and newer.
    fn take(&mut self, flight: &Flight) {
        if self.has(Trouble::Deaf) || self.has(Trouble::Unplugged) {
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
            // A force was computed up to a step before it was sent, and grows by a step's at once.
            let step = 1e-3 * f64::from(self.cruelty.every());
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
        if self.taken.is_some_and(|last| last.let_go) {
            findings.regained = findings.regained.max(force.length());
        }
        findings.taken += 1;
        self.feel(force);
        self.taken = Some(Taken { counter, sent, arrived: self.now, force, let_go: false });
    }

    fn feel(&mut self, force: DVec3) {
        self.findings.dropouts += u64::from(self.force.length() > 0.2 && force == DVec3::ZERO);
        self.findings.most = self.findings.most.max(force.length());
        self.force = force;
    }

    /// The device lets go where it hears nothing. What it takes next may be anything: it was told that way.
    fn let_go(&mut self) {
        let waited = self.taken.map_or(0.0, |taken| self.now - taken.arrived);
        let unplugged = self.has(Trouble::Unplugged);
        if (waited > DEVICE_TIMEOUT || unplugged) && !self.sabotage.keeps {
            self.feel(DVec3::ZERO);
            if let Some(taken) = &mut self.taken {
                (taken.force, taken.let_go) = (DVec3::ZERO, true);
            }
        }
    }

    fn report(&mut self) {
        let Cruelty { clock_rate, clock_jumps, latency, .. } = self.cruelty;
        self.clock += STEP * (1.0 + clock_rate);
        if self.chance(clock_jumps * STEP) {
            self.clock += self.rng.random_range(-0.02..0.02);
            self.due = self.clock;
        }
        if self.clock < self.due {
            return;
        }
        self.due = self.clock.max(self.due + REPORT_PERIOD);
        if self.has(Trouble::Silent) || self.has(Trouble::Unplugged) {
            return;
        }
        let unit = if self.has(Trouble::Millimetres) { 1e3 } else { 1.0 };
        self.counter = self.counter.wrapping_add(1);
        let mut bytes = self.counter.to_le_bytes().to_vec();
        bytes.extend(((self.clock * 1e6) as i64 as u32).to_le_bytes());
        if self.has(Trouble::Nonsense) {
            bytes.extend((0..12).map(|_| self.rng.random_range(0..=u8::MAX)));
        } else {
            put(&mut bytes, unit * self.hand.place);
        }
        bytes.push(u8::from(self.has_latched()));
        let flights = self.carry(sealed(bytes), latency.0);
        let room = WAITING - self.to_host.len().min(WAITING);
        self.to_host.extend(flights.into_iter().take(room));
    }

    /// What must hold of the force on the hand at any time.
    fn watch(&mut self) {
        let speed = self.hand.velocity.length();
        self.findings.fastest = self.findings.fastest.max(speed);
        if !speed.is_finite() {
            self.findings.note("a hand that is nowhere", 1.0);
        }
        if self.force == DVec3::ZERO {
            return;
        }
        // A device that hears nothing keeps the last force until it lets go by itself.
        let unheard = self.taken.map_or(0.0, |taken| self.now - taken.arrived);
        if unheard > DEVICE_TIMEOUT + STEP {
            self.findings.note("kept by the device", unheard);
        }
        for (what, since) in
            [("long after the last report", self.heard), ("long after the last step", self.stepped)]
        {
            let late = self.now - since - unheard - self.cruelty.longest_way();
            if late > FAULT_TIME + STEP {
                self.findings.note(what, late);
            }
        }
    }
}

/// How far a force is from what the last one may have shrunk to along itself.
fn grown(now: DVec3, last: DVec3) -> f64 {
    let length = last.length_squared();
    let part = if length > 0.0 { (now.dot(last) / length).clamp(0.0, 1.0) } else { 0.0 };
    now.distance(last * part)
}

/// The device's end of the wire, and the hand behind it.
#[derive(Clone)]
pub struct CruelWire {
    world: Arc<Mutex<World>>,
    /// The start of its time, where that is real.
    start: Option<Instant>,
}

impl CruelWire {
    /// One for `seconds`: in the last the hand presses and there are no troubles, and in the last 0.4 s nothing is lost. A force is to
    /// grow by no more than the slew, N/s.
    pub fn new(cruelty: Cruelty, sabotage: Sabotage, seed: u64, seconds: f64, slew: f64) -> Self {
        let mut rng = StdRng::seed_from_u64(seed);
        let press = seconds - 1.0;
        let mut troubles = Vec::new();
        for kind in &cruelty.troubles {
            let mut from = rng.random_range(0.3..0.6);
            while from < press {
                let to = from + rng.random_range(0.005..0.12);
                troubles.push((*kind, from, to));
                from = to + rng.random_range(0.1..0.4);
            }
        }
        let mass = 0.1 * 10_f64.powf(rng.random_range(0.0..1.0));
        let stiffness = 300.0;
        let damping = 2.0 * 0.7 * (stiffness * mass).sqrt();
        let hand = Hand { mass, stiffness, damping, place: DVec3::ZERO, velocity: DVec3::ZERO };
        let clock = rng.random_range(0.0..5000.0);
        let world = World {
            peak: specification(&cruelty).peak_force,
            cruelty,
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
            troubles,
            heard: 0.0,
            stepped: 0.0,
            findings: Findings::default(),
        };
        Self { world: Arc::new(Mutex::new(world)), start: None }
    }

    /// Its time is real from now on.
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

    /// Lets the time pass up to a time, s.
    pub fn advance(&self, to: f64) {
        self.lock().advance(to);
    }

    /// Whether there is a trouble now.
    pub fn has(&self, trouble: Trouble) -> bool {
        self.lock().has(trouble)
    }

    /// The host's haptic loop has made a step.
    pub fn note_step(&self) {
        let mut world = self.lock();
        world.stepped = world.now;
    }

    /// Its host's side, with a codec that is sabotaged as asked for.
    pub fn link(&self) -> Link<HandCodec, HandMotion> {
        let world = self.lock();
        Link {
            codec: HandCodec {
                checks: !world.cruelty.unchecked,
                sabotage: world.sabotage,
                counter: 0,
                last: DVec3::ZERO,
            },
            motion: HandMotion::default(),
            specification: specification(&world.cruelty),
            read_timeout: Duration::from_millis(5),
            silence: 0.01,
        }
    }

    /// Opens it, unless it is unplugged.
    pub fn open(&self) -> Option<Box<dyn Transport>> {
        (!self.has(Trouble::Unplugged)).then(|| Box::new(self.clone()) as Box<dyn Transport>)
    }

    /// What was seen up to now.
    pub fn findings(&self) -> Findings {
        let world = self.lock();
        Findings { force: world.force, ..world.findings.clone() }
    }
}

impl Transport for CruelWire {
    fn read(
        &mut self,
        report: &mut [u8; LONGEST_REPORT],
        patience: Duration,
    ) -> Result<usize, TransportError> {
        let begun = Instant::now();
        loop {
            let mut world = self.lock();
            if world.has(Trouble::Unplugged) {
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
        if world.has(Trouble::Unplugged) {
            return Err(TransportError::Disconnected);
        }
        let failing = world.cruelty.failing;
        if world.chance(failing) {
            return Err(TransportError::Failed);
        }
        let age = world.now - world.stepped;
        if report.len() == COMMAND && vector(report, 2) != DVec3::ZERO {
            world.findings.ages.record((age * 1e9) as u64);
        }
        let latency = world.cruelty.latency.1;
        let flights = world.carry(report.to_vec(), latency);
        world.to_device.extend(flights);
        Ok(())
    }
}
