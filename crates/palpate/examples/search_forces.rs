//! Comparison of the forces of sessions that find contacts by levels of detail and as representatives.
//!
//! `search_forces PROBE SCENE [--scale S] [--seconds N] [--clusters K] [--task NAME] [--press M] [--path
//! T.csv] [--height M --screw PITCH] [--no-levels] [--exact]`
//!
//! It records the path of an emulated device whose hand does a task in the scene, reads a path from a file,
//! or makes the path of a nut on a thread; lowers the path by a length along z; and replays it in sessions
//! whose haptic loops run at 4 kHz. For each method to find contacts it compares the coupling force with
//! contacts found at 1 kHz to that of the same session with contacts found at 4 kHz, and to that of the
//! reference: representative contacts with the smallest error of fields (EPS of 0.02 % of the radius) at 4
//! kHz. It prints |ΔF| / max(|F|, 0.5 N) while either session is in contact, and the angle between forces
//! above 0.5 N. `--no-levels` leaves out levels of detail, which take long where surfaces fit closely;
//! `--exact` adds contacts at full resolution.

#![allow(clippy::print_stdout, reason = "a table is what it is for")]

use std::error::Error;
use std::time::Instant;

use palpate::device::{Emulation, HapticDevice, Interpolation, Keyframe, MotionPath, ReplayDevice, Task};
use palpate::glam::{DQuat, DVec3};
use palpate::representative::FINEST_ERROR;
use palpate::settings::{ContactSearch, DetailSettings, SearchSettings, TimingSettings, ToolSettings};
use palpate::{HapticRenderer, Object, OpenOptions, Pose, Scene, Settings, clod_build, explore};

type Failure = Box<dyn Error>;

/// Rate of the haptic loops, Hz.
const RATE: f64 = 4000.0;
/// Height above a pressed path at which it begins, in radii.
const APPROACH: f64 = 0.1;
/// Duration of the descent to the pressed path, s.
const DESCENT_TIME: f64 = 0.5;
/// Smallest force that differences are relative to, N.
const MIN_FORCE: f64 = 0.5;

/// Objects and path of all sessions.
struct Scenario {
    probe: Object,
    scene: Scene,
    path: MotionPath,
    seconds: f64,
}

/// Measurements of a session.
struct Measured {
    forces: Vec<DVec3>,
    /// Durations of contact steps, µs.
    durations: Vec<f64>,
    /// Numbers of planes in the contact models.
    planes: Vec<f64>,
    proxy_engaged: u64,
    /// Smallest energy at the port, J.
    energy_min: f64,
    /// 99.9th percentile of the change of force in a step, N.
    jump: f64,
    /// Deepest penetration, m.
    depth_max: f64,
}

/// Words of the command line.
struct Words(Vec<String>);

impl Words {
    fn option(&self, name: &str) -> Option<&String> {
        self.0.iter().position(|word| word == name).and_then(|at| self.0.get(at + 1))
    }

    fn number(&self, name: &str, default: f64) -> Result<f64, Failure> {
        Ok(self.option(name).map_or(Ok(default), |word| word.parse())?)
    }

    fn has(&self, name: &str) -> bool {
        self.0.iter().any(|word| word == name)
    }
}

fn main() -> Result<(), Failure> {
    let words = Words(std::env::args().skip(1).collect());
    let scale = words.number("--scale", 1.0)?;
    let clusters = words.number("--clusters", 5.0)? as usize;
    let open = |at: usize| {
        let options = OpenOptions { scale, ..OpenOptions::default() };
        Object::open(words.0.get(at).map_or("", String::as_str), &options, &mut clod_build::unwatched)
    };
    let (probe, object) = (open(0)?, open(1)?);
    let radius = probe.bounding_radius();
    let rows = rows(&words, clusters, radius);
    let scenario = scenario(&words, probe, Scene::new().with(object, Pose::IDENTITY), &rows)?;
    println!("R = {radius:.4} m; {clusters} clusters; planes, µs: medians and 99th percentile");
    println!(
        "| contacts | planes | µs | p99 | deepest, mm | rms force, N | jumps, N | above 20 Hz, N | energy min, mJ | held back | 1 kHz to 4 kHz median, % | p95 | ° | to reference median, % | p95 | ° |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|");
    let mut reference: Option<Vec<DVec3>> = None;
    for (name, settings) in rows {
        let slow = render(&scenario, settings, 4)?;
        let fast = render(&scenario, settings, 1)?;
        let to_fast = differences(&slow.forces, &fast.forces);
        let to_reference = differences(&slow.forces, reference.get_or_insert(fast.forces));
        print_row(name, &slow, to_fast, to_reference);
    }
    Ok(())
}

/// Names and settings of the rows of the table. The first row is the reference.
fn rows(words: &Words, clusters: usize, radius: f64) -> Vec<(&'static str, Settings)> {
    let by = |method, representative_error, error| Settings {
        timing: TimingSettings { rate: RATE, ..TimingSettings::default() },
        search: SearchSettings { clusters, method, representative_error, ..SearchSettings::default() },
        tool: ToolSettings { unusual_size: true, ..ToolSettings::default() },
        detail: DetailSettings { error, ..DetailSettings::default() },
        ..Settings::default()
    };
    let representatives = |error| by(ContactSearch::Representatives, error, 0.0);
    let levels = |error| by(ContactSearch::Levels, None, error);
    let mut rows = vec![
        ("EPS = 0.02 %", representatives(Some(FINEST_ERROR * radius))),
        ("representatives", representatives(None)),
    ];
    if !words.has("--no-levels") {
        rows.extend([("s₀ = 0.4 %", levels(0.004 * radius)), ("s₀ = 2.5 %", levels(0.025 * radius))]);
    }
    if words.has("--exact") {
        rows.push(("exact", levels(0.0)));
    }
    rows
}

/// Path from a file, of a nut, or of a hand that does a task. The task is recorded with the coarsest levels,
/// or with default representatives without levels.
fn scenario(
    words: &Words,
    probe: Object,
    scene: Scene,
    rows: &[(&str, Settings)],
) -> Result<Scenario, Failure> {
    let seconds = words.number("--seconds", 3.0)?;
    let press = words.number("--press", 0.0)?;
    let path = match (words.option("--path"), words.option("--screw")) {
        (Some(file), _) => MotionPath::load(std::path::Path::new(file), Interpolation::Smooth)?,
        (None, Some(pitch)) => screwing([words.number("--height", 0.0)?, pitch.parse()?, press], seconds)?,
        (None, None) => {
            let task = words.option("--task").map_or(Some(Task::Explore), |name| Task::named(name));
            let path = explore::path(task.ok_or("no such task")?, &probe, &scene)?;
            let hand = Box::new(Emulation::default().open(path)?);
            let (_, settings) = rows.get(3).unwrap_or(&rows[1]);
            record(&probe, &scene, hand, *settings, seconds)?
        }
    };
    let path = if press > 0.0 && words.option("--screw").is_none() {
        pressed(&path, press, APPROACH * probe.bounding_radius())?
    } else {
        path
    };
    Ok(Scenario { probe, scene, path, seconds })
}

/// Prints the row of a session, with its force differences to the session at 4 kHz and to the reference.
fn print_row(name: &str, slow: &Measured, to_fast: [f64; 3], to_reference: [f64; 3]) {
    let square = slow.forces.iter().map(|f| f.length_squared()).sum::<f64>() / slow.forces.len() as f64;
    let rms = square.sqrt();
    let [median, p95, angle] = to_fast;
    let [reference_median, reference_p95, reference_angle] = to_reference;
    println!(
        "| {name} | {:.0} | {:.0} | {:.0} | {:.3} | {rms:.3} | {:.4} | {:.4} | {:.3} | {} | {median:.1} | {p95:.1} | {angle:.1} | {reference_median:.1} | {reference_p95:.1} | {reference_angle:.1} |",
        quantile(&slow.planes, 0.5),
        quantile(&slow.durations, 0.5),
        quantile(&slow.durations, 0.99),
        1e3 * slow.depth_max,
        slow.jump,
        rms_above(20.0, &slow.forces),
        1e3 * slow.energy_min,
        slow.proxy_engaged,
    );
}

/// Root mean square of forces above a frequency (Hz), N: of their difference from the mean over a period of
/// that frequency.
fn rms_above(frequency: f64, forces: &[DVec3]) -> f64 {
    let half = (0.5 * RATE / frequency) as usize;
    let (mut sum, mut count) = (0.0, 0);
    for window in forces.windows(2 * half + 1).step_by(8) {
        let mean = window.iter().sum::<DVec3>() / window.len() as f64;
        sum += window[half].distance_squared(mean);
        count += 1;
    }
    (sum / f64::from(count.max(1))).sqrt()
}

/// Path of a nut that rotates about z once a second, clockwise seen from above. It starts at a height (m),
/// descends by the thread's pitch (m) per turn, and is pressed down by a length (m).
fn screwing([height, pitch, press]: [f64; 3], seconds: f64) -> Result<MotionPath, Failure> {
    let keyframe = |step: usize| {
        let time = 0.01 * step as f64;
        let turn = DQuat::from_rotation_z(-std::f64::consts::TAU * time);
        let height = height - pitch * time - press * (time / DESCENT_TIME).min(1.0);
        Keyframe { time, pose: Pose::new(DVec3::Z * height, turn) }
    };
    Ok(MotionPath::new((0..=(100.0 * seconds) as usize).map(keyframe).collect(), Interpolation::Smooth)?)
}

/// Lowers a path by a length (m), after a descent from a height (m): the proxy of an object that starts
/// inside a surface would not know its side.
fn pressed(path: &MotionPath, press: f64, approach: f64) -> Result<MotionPath, Failure> {
    let lower = |frame: &Keyframe| {
        let done = (frame.time / DESCENT_TIME).min(1.0);
        let lift = approach * (1.0 - done) - press * done;
        Keyframe { time: frame.time, pose: Pose::from_translation(DVec3::Z * lift) * frame.pose }
    };
    Ok(MotionPath::new(path.keyframes().iter().map(lower).collect(), Interpolation::Smooth)?)
}

/// Records the path of a device in a session at 1 kHz.
fn record(
    probe: &Object,
    scene: &Scene,
    device: Box<dyn HapticDevice>,
    settings: Settings,
    seconds: f64,
) -> Result<MotionPath, Failure> {
    let settings = Settings { timing: TimingSettings { rate: 1000.0, ..settings.timing }, ..settings };
    let (mut haptic, mut contact, mut device) =
        HapticRenderer::new(probe.clone(), scene.clone(), device, settings)?.into_loops();
    let mut keyframes = Vec::new();
    for step in 0..(seconds * 1000.0) as usize {
        let now = step as f64 * 1e-3;
        if step % 2 == 0 {
            let update = contact.step(haptic.body_state(), now);
            haptic.update_contacts(&update);
        }
        let record = haptic.step_device(device.as_mut(), now + 1e-3, 1e-3);
        if step % 10 == 0 {
            keyframes.push(Keyframe { time: record.time, pose: record.device });
        }
    }
    Ok(MotionPath::new(keyframes, Interpolation::Smooth)?)
}

/// Replays the path with a contact step every `every` haptic steps; its result is in use one contact step
/// later.
fn render(scenario: &Scenario, settings: Settings, every: usize) -> Result<Measured, Failure> {
    let Scenario { probe, scene, path, seconds } = scenario;
    let device = Box::new(ReplayDevice::new("recorded", path.clone()));
    let (mut haptic, mut contact, mut device) =
        HapticRenderer::new(probe.clone(), scene.clone(), device, settings)?.into_loops();
    let (mut forces, mut durations, mut planes) = (Vec::new(), Vec::new(), Vec::new());
    let mut waiting = None;
    let period = 1.0 / RATE;
    for step in 0..(seconds * RATE) as usize {
        let now = step as f64 * period;
        if step % every == 0 {
            if let Some(update) = waiting.take() {
                haptic.update_contacts(&update);
            }
            let begun = Instant::now();
            let update = contact.step(haptic.body_state(), now);
            if update.contacts > 0 {
                durations.push(1e6 * begun.elapsed().as_secs_f64());
                planes.push(update.model.contacts().len() as f64);
            }
            waiting = Some(update);
        }
        forces.push(haptic.step_device(device.as_mut(), now + period, period).coupling.force);
    }
    let jumps: Vec<f64> = forces.windows(2).map(|two| two[0].distance(two[1])).collect();
    let jump = quantile(&jumps, 0.999);
    let proxy_engaged = contact.telemetry().events.proxy_engaged;
    let (energy_min, depth_max) = (haptic.telemetry().energy_min, haptic.telemetry().depth_max);
    Ok(Measured { forces, durations, planes, proxy_engaged, energy_min, jump, depth_max })
}

/// Median and 95th percentile of the relative difference, %, and 95th percentile of the angle, °.
fn differences(forces: &[DVec3], wanted: &[DVec3]) -> [f64; 3] {
    let touching =
        || forces.iter().zip(wanted).filter(|(own, other)| own.length().max(other.length()) > 1e-3);
    let off: Vec<f64> =
        touching().map(|(own, other)| 100.0 * own.distance(*other) / other.length().max(MIN_FORCE)).collect();
    let angles: Vec<f64> = touching()
        .filter(|(own, other)| own.length().min(other.length()) > MIN_FORCE)
        .map(|(own, other)| own.angle_between(*other).to_degrees())
        .collect();
    [quantile(&off, 0.5), quantile(&off, 0.95), quantile(&angles, 0.95)]
}

/// Quantile by the nearest rank; NaN without values.
fn quantile(values: &[f64], fraction: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (fraction * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied().unwrap_or(f64::NAN)
}
