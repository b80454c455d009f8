//! How the force that a session sends depends on how its contacts are found: by levels of detail or as representatives.
//!
//! `search_forces PROBE SCENE [--scale S] [--seconds N] [--clusters K] [--task NAME] [--press M] [--path T.csv] [--height M --screw PITCH]
//! [--no-levels]` records the path of an emulated device whose hand does a task in the scene, or takes one, or that of a nut, lowers it by a length along z, and replays it in
//! sessions whose haptic loops run at 4 kHz. For each way to find contacts it compares the coupling force, with contacts found 1000
//! times a second, to that of the same session with contacts found 4000 times a second, and to that of the reference: representative
//! contacts as fine as fields are true (EPS of 0.02 % of the radius), 4000 times a second. |ΔF| / max(|F|, 0.5 N) while either is in
//! contact, and the angle between forces above 0.5 N. `--no-levels` leaves levels of detail out, which take long where surfaces fit
//! closely.

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
/// How far up paths begin, in radii, and how long it takes to come down, s.
const APPROACH: f64 = 0.1;
const RAMP: f64 = 0.5;
/// Below this, N, forces are compared with it.
const LEAST: f64 = 0.5;

struct Given {
    probe: Object,
    scene: Scene,
    path: MotionPath,
    seconds: f64,
}

/// What a session showed.
struct Shown {
    forces: Vec<DVec3>,
    /// Of contact steps, µs.
    took: Vec<f64>,
    planes: Vec<f64>,
    unsound: u64,
    energy_min: f64,
    roughness: f64,
    /// m, by the contacts.
    deepest: f64,
}

fn main() -> Result<(), Failure> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [probe, scene] = [0, 1].map(|at| words.get(at).cloned().unwrap_or_default());
    let option = |name: &str| words.iter().position(|word| word == name).and_then(|at| words.get(at + 1));
    let number = |name: &str, usual: f64| option(name).map_or(Ok(usual), |word| word.parse());
    let scale = number("--scale", 1.0)?;
    let clusters = number("--clusters", 5.0)? as usize;
    let seconds = number("--seconds", 3.0)?;
    let open = |name: &str| {
        let options = OpenOptions { scale, ..OpenOptions::default() };
        Object::open(name, &options, &mut clod_build::unwatched)
    };
    let (probe, object) = (open(&probe)?, open(&scene)?);
    let scene = Scene::new().with(object, Pose::IDENTITY);
    let usual = Settings {
        timing: TimingSettings { rate: RATE, ..TimingSettings::default() },
        search: SearchSettings { clusters, ..SearchSettings::default() },
        tool: ToolSettings { unusual_size: true, ..ToolSettings::default() },
        ..Settings::default()
    };
    let radius = probe.bounding_radius();
    let representatives = Settings {
        search: SearchSettings { method: ContactSearch::Representatives, ..usual.search },
        ..usual
    };
    let by_levels =
        Settings { search: SearchSettings { method: ContactSearch::Levels, ..usual.search }, ..usual };
    let coarse =
        Settings { detail: DetailSettings { error: 0.025 * radius, ..by_levels.detail }, ..by_levels };
    let with_levels = !words.iter().any(|word| word == "--no-levels");
    let recorded_with = if with_levels { coarse } else { representatives };
    let press = number("--press", 0.0)?;
    let path = match (option("--path"), option("--screw")) {
        (Some(file), _) => MotionPath::load(std::path::Path::new(file), Interpolation::Smooth)?,
        (None, Some(pitch)) => screwing([number("--height", 0.0)?, pitch.parse()?, press], seconds)?,
        (None, None) => {
            let task = option("--task")
                .map_or(Some(Task::Explore), |name| Task::named(name))
                .ok_or("no such task")?;
            let hand = Emulation::default().open(explore::path(task, &probe, &scene)?)?;
            record(&probe, &scene, Box::new(hand), recorded_with, seconds)?
        }
    };
    let path = if press > 0.0 && option("--screw").is_none() {
        pressed(&path, press, APPROACH * radius)?
    } else {
        path
    };
    let given = Given { probe, scene, path, seconds };
    let finest = Settings {
        search: SearchSettings {
            representative_error: Some(FINEST_ERROR * radius),
            ..representatives.search
        },
        ..representatives
    };
    println!("R = {radius:.4} m; {clusters} clusters; planes, µs: medians and 99th percentile");
    println!(
        "| contacts | planes | µs | p99 | deepest, mm | rms force, N | jumps, N | above 20 Hz, N | energy min, mJ | held back | 1 kHz to 4 kHz median, % | p95 | ° | to reference median, % | p95 | ° |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|");
    let mut rows = vec![("EPS = 0.02 %", finest), ("representatives", representatives)];
    if with_levels {
        rows.extend([
            (
                "s₀ = 0.4 %",
                Settings {
                    detail: DetailSettings { error: 0.004 * radius, ..by_levels.detail },
                    ..by_levels
                },
            ),
            ("s₀ = 2.5 %", coarse),
        ]);
    }
    if words.iter().any(|word| word == "--exact") {
        rows.push(("exact", by_levels));
    }
    let mut reference: Option<Vec<DVec3>> = None;
    for (name, settings) in rows {
        let slow = render(&given, settings, 4)?;
        let fast = render(&given, settings, 1)?;
        let (middle, off, angle) = compared(&slow.forces, &fast.forces);
        let wanted = reference.get_or_insert(fast.forces);
        let (usual, far, turned) = compared(&slow.forces, wanted);
        let rms =
            (slow.forces.iter().map(|f| f.length_squared()).sum::<f64>() / slow.forces.len() as f64).sqrt();
        println!(
            "| {name} | {:.0} | {:.0} | {:.0} | {:.3} | {rms:.3} | {:.4} | {:.4} | {:.3} | {} | {middle:.1} | {off:.1} | {angle:.1} | {usual:.1} | {far:.1} | {turned:.1} |",
            quantile(&slow.planes, 0.5),
            quantile(&slow.took, 0.5),
            quantile(&slow.took, 0.99),
            1e3 * slow.deepest,
            slow.roughness,
            above(20.0, &slow.forces),
            1e3 * slow.energy_min,
            slow.unsound,
        );
    }
    Ok(())
}

/// The root mean square of what of forces is above a frequency (Hz), N: the difference from their mean over a period of it.
fn above(frequency: f64, forces: &[DVec3]) -> f64 {
    let half = (0.5 * RATE / frequency) as usize;
    let (mut sum, mut count) = (0.0, 0);
    for window in forces.windows(2 * half + 1).step_by(8) {
        let mean = window.iter().sum::<DVec3>() / window.len() as f64;
        sum += window[half].distance_squared(mean);
        count += 1;
    }
    (sum / f64::from(count.max(1))).sqrt()
}

/// Turning about z once a second from a height (m), clockwise seen from above, down by the pitch (m) of a thread a turn, and lower by
/// what it is pressed by (m).
fn screwing([height, pitch, press]: [f64; 3], seconds: f64) -> Result<MotionPath, Failure> {
    let keyframe = |step: usize| {
        let time = 0.01 * step as f64;
        let turn = DQuat::from_rotation_z(-std::f64::consts::TAU * time);
        let height = height - pitch * time - press * (time / RAMP).min(1.0);
        Keyframe { time, pose: Pose::new(DVec3::Z * height, turn) }
    };
    Ok(MotionPath::new((0..=(100.0 * seconds) as usize).map(keyframe).collect(), Interpolation::Smooth)?)
}

/// A path that ends deeper by a length (m) than the hand would go, and begins higher by another (m): an object that begins inside has
/// no side to be kept on.
fn pressed(path: &MotionPath, press: f64, approach: f64) -> Result<MotionPath, Failure> {
    let lower = |frame: &Keyframe| {
        let done = (frame.time / RAMP).min(1.0);
        let lift = approach * (1.0 - done) - press * done;
        Keyframe { time: frame.time, pose: Pose::from_translation(DVec3::Z * lift) * frame.pose }
    };
    Ok(MotionPath::new(path.keyframes().iter().map(lower).collect(), Interpolation::Smooth)?)
}

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

/// With contacts found every so many haptic steps; what is found is in use one contact step later.
fn render(given: &Given, settings: Settings, every: usize) -> Result<Shown, Failure> {
    let device = Box::new(ReplayDevice::new("recorded", given.path.clone()));
    let (mut haptic, mut contact, mut device) =
        HapticRenderer::new(given.probe.clone(), given.scene.clone(), device, settings)?.into_loops();
    let (mut forces, mut took, mut planes) = (Vec::new(), Vec::new(), Vec::new());
    let mut waiting = None;
    let period = 1.0 / RATE;
    for step in 0..(given.seconds * RATE) as usize {
        let now = step as f64 * period;
        if step % every == 0 {
            if let Some(update) = waiting.take() {
                haptic.update_contacts(&update);
            }
            let begun = Instant::now();
            let update = contact.step(haptic.body_state(), now);
            if update.contacts > 0 {
                took.push(1e6 * begun.elapsed().as_secs_f64());
                planes.push(update.model.constraints().len() as f64);
            }
            waiting = Some(update);
        }
        forces.push(haptic.step_device(device.as_mut(), now + period, period).coupling.force);
    }
    let jumps: Vec<f64> = forces.windows(2).map(|two| two[0].distance(two[1])).collect();
    let roughness = quantile(&jumps, 0.999);
    let unsound = contact.telemetry().events.held_back;
    let telemetry = haptic.telemetry();
    let (energy_min, deepest) = (telemetry.energy_min, telemetry.depth_max);
    Ok(Shown { forces, took, planes, unsound, energy_min, roughness, deepest })
}

/// Median and 95th percentile of the relative difference, %, and 95th percentile of the angle, °.
fn compared(forces: &[DVec3], wanted: &[DVec3]) -> (f64, f64, f64) {
    let touching =
        || forces.iter().zip(wanted).filter(|(own, other)| own.length().max(other.length()) > 1e-3);
    let off: Vec<f64> =
        touching().map(|(own, other)| 100.0 * own.distance(*other) / other.length().max(LEAST)).collect();
    let angles: Vec<f64> = touching()
        .filter(|(own, other)| own.length().min(other.length()) > LEAST)
        .map(|(own, other)| own.angle_between(*other).to_degrees())
        .collect();
    (quantile(&off, 0.5), quantile(&off, 0.95), quantile(&angles, 0.95))
}

/// By the nearest rank; NaN where there are none.
fn quantile(values: &[f64], fraction: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (fraction * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied().unwrap_or(f64::NAN)
}
