//! Long, vigorous session with injected faults.

use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::sync::{Arc, Mutex, PoisonError};

use palpate::device::{
    DeviceError, DeviceState, EmulatedDevice, Emulation, HapticDevice, IntendedPath, Specification,
};
use palpate::glam::{DQuat, DVec3};
use palpate::settings::{ContactSettings, TimingSettings};
use palpate::{
    ContactLoop, ContactUpdate, HapticLoop, HapticRenderer, Object, Pose, Scene, Settings, Twist, Wrench,
};
use palpate_report::{CellAxis, HeatMap};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

use super::grid::Plan;
use super::meshes;
use super::page::{Picture, Section, Table, Verdict, row};

/// Number of steps between faults, and of faults in a part. Each part starts a new session.
const SEGMENT: u64 = 1000;
const SEGMENTS: u64 = 10;
/// Steps of a segment in which its fault can begin, the fault's longest duration in steps, and the step from
/// which everything has to be normal again.
const FAULT_START: std::ops::Range<u64> = 200..300;
const MAX_FAULT_STEPS: u64 = 400;
const RECOVERED: u64 = 850;
/// Period of the haptic loop, s, and number of haptic steps per contact query.
const PERIOD: f64 = 1e-3;
const QUERY: u64 = 4;
/// Age of contact models from which the wrench fades, s: it is zero at twice this age.
const TIMEOUT: f64 = 0.05;
/// Largest change of the force from step to step, relative to the device's peak.
const SLEW: f64 = 0.1;
/// Half extents of the held block and of the table that it is thrown against, m.
const HELD: DVec3 = DVec3::new(0.012, 0.010, 0.008);
const TABLE: DVec3 = DVec3::new(0.06, 0.06, 0.02);

/// Injected faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    Stalled,
    Jumped,
    NotFinite,
    Late,
    Lost,
    /// The part starts with the object inside the table; its first segment has no other fault.
    Inside,
}

impl Fault {
    const ALL: [Self; 6] =
        [Self::Stalled, Self::Jumped, Self::NotFinite, Self::Late, Self::Lost, Self::Inside];

    fn name(self) -> &'static str {
        match self {
            Self::Stalled => "contact thread stalled",
            Self::Jumped => "pose jumped",
            Self::NotFinite => "pose not finite",
            Self::Late => "ticks late",
            Self::Lost => "device lost",
            Self::Inside => "started inside",
        }
    }
}

/// Counts under one fault.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Count {
    segments: u64,
    /// Steps with a wrench or pose that is not finite, and with a wrench above the device's limits.
    not_finite: u64,
    beyond: u64,
    /// Steps in which the force grew or turned by more than [`SLEW`] of the peak a period, or grew by as
    /// much in one step however late; and the fastest growth, N a period.
    too_fast: u64,
    fastest: f64,
    /// Steps with a wrench that should have been zero: contact models twice overdue, or the device lost.
    not_zero: u64,
    /// Steps in which the wrench should have been zero.
    silent: u64,
    /// Segments at the end of which events were still counted.
    not_normal: u64,
}

impl Count {
    fn add(&mut self, other: &Self) {
        self.segments += other.segments;
        self.not_finite += other.not_finite;
        self.beyond += other.beyond;
        self.too_fast += other.too_fast;
        self.fastest = self.fastest.max(other.fastest);
        self.not_zero += other.not_zero;
        self.silent += other.silent;
        self.not_normal += other.not_normal;
    }
}

/// Makes the map.
///
/// # Errors
/// If a session cannot start.
pub fn map(plan: &Plan) -> Result<Section, String> {
    let held = meshes::block("block", HELD)?;
    let table = meshes::block("table", TABLE)?;
    let parts: Vec<u64> = (0..plan.steps.div_ceil(SEGMENT * SEGMENTS)).collect();
    let counted = plan.each("session", &parts, |&part| Part::start(part, &held, &table)?.run())?;
    let mut counts = [Count::default(); Fault::ALL.len()];
    for part in &counted {
        for (sum, count) in counts.iter_mut().zip(part) {
            sum.add(count);
        }
    }
    let mut all = Count::default();
    counts.iter().for_each(|count| all.add(count));
    let rows = Fault::ALL.iter().zip(&counts).map(|(fault, count)| {
        row![
            fault.name(),
            count.segments,
            count.not_finite,
            count.beyond,
            count.too_fast,
            count.fastest,
            count.silent,
            count.not_zero,
            count.not_normal,
        ]
    });
    let columns = vec![
        "fault",
        "segments",
        "steps_not_finite",
        "steps_beyond_peak",
        "steps_too_fast",
        "fastest_growth_n_ms",
        "steps_to_be_silent",
        "steps_not_silent",
        "segments_not_normal_after",
    ];
    let peak = Emulation::default().specification.peak_force;
    let steps = all.segments * SEGMENT;
    let events: Vec<String> = Fault::ALL
        .iter()
        .zip(&counts)
        .map(|(fault, count)| format!("{} {}", fault.name(), count.segments))
        .collect();
    Ok(Section {
        title: "Session: vigorous, with faults",
        paragraphs: vec![format!(
            "A block is thrown against a table and about by a random hand for {steps} steps of 1 ms, in parts of {} steps, \
             through the two loops that a host of its own runs. In each {SEGMENT} steps something goes wrong for up to \
             {MAX_FAULT_STEPS} of them: {}. Contact models are overdue after {} ms.",
            SEGMENT * SEGMENTS,
            events.join(", "),
            1e3 * TIMEOUT
        )],
        pictures: vec![picture(&counts, peak)],
        tables: vec![Table { name: "session".to_owned(), columns, rows: rows.collect() }],
        verdicts: vec![
            Verdict::new(
                "no wrench and no pose is ever not finite",
                all.not_finite == 0 && steps > 0,
                format!("{} of {steps} steps", all.not_finite),
            ),
            Verdict::new(
                "the wrench is always within what the device renders",
                all.beyond == 0 && steps > 0,
                format!("{} of {steps} steps", all.beyond),
            ),
            Verdict::new(
                format!(
                    "the force never grows or turns by more than {0:.2} N a millisecond, a tenth of the peak, and never grows \
                     by more than {0:.2} N a step, however late",
                    SLEW * peak
                ),
                all.too_fast == 0,
                format!("{} of {steps} steps; the fastest is {:.2} N/ms", all.too_fast, all.fastest),
            ),
            Verdict::new(
                "nothing is sent while contact models are overdue by twice the timeout or the device is lost",
                all.not_zero == 0 && all.silent > 0,
                format!("{} of {} steps", all.not_zero, all.silent),
            ),
            Verdict::new(
                "after each fault all is normal again: no step refused, no pose refused, no wrench faded",
                all.not_normal == 0 && steps > 0,
                format!("{} of {} segments", all.not_normal, all.segments),
            ),
        ],
    })
}

/// Draws the fastest growth of the force under each fault.
fn picture(counts: &[Count], peak: f64) -> Picture {
    let map = HeatMap {
        title: "fastest growth of the force a millisecond, of the peak".to_owned(),
        x: CellAxis {
            name: "fault, in the order of the table".to_owned(),
            values: (1..=counts.len()).map(|index| index as f64).collect(),
        },
        y: CellAxis { name: "".to_owned(), values: vec![1.0] },
        cells: counts.iter().map(|count| count.fastest / peak).collect(),
        legend: vec![
            (0.0, "none".to_owned()),
            (0.5, "half the peak".to_owned()),
            (1.0, "the peak or more".to_owned()),
        ],
        boundaries: Vec::new(),
    };
    Picture {
        name: "session".to_owned(),
        caption: "How fast the force grows under each fault.".to_owned(),
        maps: vec![map],
        columns: 1,
    }
}

/// Present fault of a device, and the displacement of its pose if it jumps.
#[derive(Clone, Debug, Default)]
struct Control(Arc<Mutex<(Option<Fault>, Pose)>>);

impl Control {
    fn set(&self, fault: Option<Fault>, jump: Pose) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = (fault, jump);
    }

    fn get(&self) -> (Option<Fault>, Pose) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Device that fails on demand.
struct Faulty {
    device: EmulatedDevice,
    control: Control,
}

impl HapticDevice for Faulty {
    fn specification(&self) -> &Specification {
        self.device.specification()
    }

    fn read(&mut self, now: f64) -> Result<DeviceState, DeviceError> {
        let mut state = self.device.read(now)?;
        match self.control.get() {
            (Some(Fault::Lost), _) => return Err(DeviceError::Closed),
            (Some(Fault::NotFinite), _) => state.pose.translation.x = f64::NAN,
            (Some(Fault::Jumped), jump) => {
                state.pose.translation += jump.translation;
                state.pose.rotation = (jump.rotation * state.pose.rotation).normalize();
            }
            _ => {}
        }
        Ok(state)
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceError> {
        if self.control.get().0 == Some(Fault::Lost) {
            return Err(DeviceError::Closed);
        }
        self.device.write(wrench)
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        self.device.close()
    }
}

/// State of a part of the session.
struct Part {
    rng: StdRng,
    haptic: HapticLoop,
    contact: ContactLoop,
    device: Box<dyn HapticDevice>,
    control: Control,
    inside: bool,
    peak: (f64, f64),
    now: f64,
    /// Last force sent, N.
    last: DVec3,
    /// Number of steps, and pending contact models with the steps from which they are in use.
    steps: u64,
    pending: VecDeque<(u64, ContactUpdate)>,
    counts: Counts,
}

type Counts = [Count; Fault::ALL.len()];

impl Part {
    fn start(part: u64, held: &Object, table: &Object) -> Result<Self, String> {
        let mut rng = StdRng::seed_from_u64(part);
        let inside = part.is_multiple_of(3);
        let path = hand(&mut rng, if inside { 0.0 } else { HELD.z + 6e-3 });
        let emulation = Emulation::default();
        let peak = (emulation.specification.peak_force, emulation.specification.peak_torque);
        let device = emulation.open(path).map_err(|error| error.to_string())?;
        let control = Control::default();
        let device = Faulty { device, control: control.clone() };
        let scene = Scene::new().with(table.clone(), Pose::from_translation(DVec3::NEG_Z * TABLE.z));
        let settings = Settings {
            contact: ContactSettings::penalties(ContactSettings::default().stiffness),
            timing: TimingSettings { contact_timeout: TIMEOUT, ..TimingSettings::default() },
            ..Settings::default()
        };
        let renderer = HapticRenderer::new(held.clone(), scene, Box::new(device), settings)
            .map_err(|error| error.to_string())?;
        let (haptic, contact, device) = renderer.into_loops();
        Ok(Self {
            rng,
            haptic,
            contact,
            device,
            control,
            inside,
            peak,
            now: 0.0,
            last: DVec3::ZERO,
            steps: 0,
            pending: VecDeque::new(),
            counts: Counts::default(),
        })
    }

    fn run(mut self) -> Result<Counts, String> {
        for segment in 0..SEGMENTS {
            let fault = if segment == 0 && self.inside {
                Fault::Inside
            } else {
                Fault::ALL[self.rng.random_range(0..Fault::ALL.len() - 1)]
            };
            self.segment(fault);
        }
        self.device.close().map_err(|error| error.to_string())?;
        Ok(self.counts)
    }

    fn segment(&mut self, fault: Fault) {
        let begin = self.rng.random_range(FAULT_START);
        let end = begin + self.rng.random_range(1..=MAX_FAULT_STEPS);
        let jump =
            Pose::new(random(&mut self.rng, 0.03), DQuat::from_scaled_axis(random(&mut self.rng, 0.5)));
        let mut count = Count { segments: 1, ..Count::default() };
        let mut events = 0;
        for step in 0..SEGMENT {
            let faulty = (begin..end).contains(&step).then_some(fault);
            self.control.set(faulty, jump);
            self.step(faulty, &mut count);
            if step == RECOVERED {
                events = self.events();
            }
        }
        count.not_normal += u64::from(self.events() != events);
        self.counts[fault as usize].add(&count);
    }

    fn step(&mut self, fault: Option<Fault>, count: &mut Count) {
        let late = fault == Some(Fault::Late) && self.rng.random_bool(0.05);
        let seen = self.now;
        self.now += if late { self.rng.random_range(0.002..0.06) } else { PERIOD };
        self.steps += 1;
        if fault != Some(Fault::Stalled) && self.steps.is_multiple_of(QUERY) {
            let update = self.contact.step(self.haptic.body_state(), seen);
            self.pending.push_back((self.steps + QUERY, update));
        }
        while let Some((_, update)) = self.pending.pop_front_if(|(from, _)| *from <= self.steps) {
            self.haptic.update_contacts(&update);
        }
        let record = self.haptic.step_device(self.device.as_mut(), self.now, PERIOD);
        let sent = record.coupling;
        let finite = sent.is_finite() && record.object.is_valid() && record.contact.is_finite();
        count.not_finite += u64::from(!finite);
        let (force, torque) = (sent.force.length(), sent.torque.length());
        let within = force <= self.peak.0 * (1.0 + 1e-9) && torque <= self.peak.1 * (1.0 + 1e-9);
        count.beyond += u64::from(!within);
        let lost = fault == Some(Fault::Lost);
        // A wrench that is not sent because the device is lost is no change.
        if !lost {
            let limit = SLEW * self.peak.0 * (1.0 + 1e-9);
            // The force may shrink along its own direction at any rate.
            let part = (sent.force.dot(self.last) / self.last.length_squared()).clamp(0.0, 1.0);
            let kept = if part.is_finite() { self.last * part } else { DVec3::ZERO };
            let change = sent.force.distance(kept) / ((self.now - seen) / PERIOD);
            let grown = force - self.last.length();
            count.fastest = count.fastest.max(change);
            count.too_fast += u64::from(change > limit || grown > limit);
        }
        self.last = sent.force;
        if lost || record.model_age >= 2.0 * TIMEOUT {
            count.silent += 1;
            count.not_zero += u64::from(sent != Wrench::ZERO);
        }
    }

    /// Returns the number of events that a session without faults does not have.
    fn events(&self) -> u64 {
        let events = self.haptic.telemetry().events;
        events.step_refused + events.device_refused + events.faded
    }
}

/// Returns the path of a hand that moves at random above a height (m) over the table: sums of sines in all
/// six axes.
fn hand(rng: &mut StdRng, height: f64) -> IntendedPath {
    const SINES: usize = 3;
    let waves: [(DVec3, DVec3, f64); SINES] =
        std::array::from_fn(|_| (random(rng, 8e-3), random(rng, 0.2), TAU * rng.random_range(0.3..3.0)));
    IntendedPath::function(move |time| {
        let (mut offset, mut turn, mut velocity, mut spin) =
            (DVec3::Z * height, DVec3::ZERO, DVec3::ZERO, DVec3::ZERO);
        for (across, about, rate) in waves {
            let (sine, cosine) = (rate * time).sin_cos();
            offset += across * sine;
            velocity += across * (rate * cosine);
            turn += about * sine;
            spin += about * (rate * cosine);
        }
        // The derivative of the rotation vector approximates the angular velocity well for turns this small.
        (Pose::new(offset, DQuat::from_scaled_axis(turn)), Twist::new(velocity, spin))
    })
}

/// Returns a vector of random components up to `size`.
fn random(rng: &mut StdRng, size: f64) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| rng.random_range(-size..size)))
}
