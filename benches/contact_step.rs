//! Contact steps of default sessions, along the paths of the scenarios that contact queries are compared on.
//!
//! `cargo bench -p palpate-benches --bench contact_step`. A hand follows each path, in a session with default
//! settings. For each number of contact steps a second, a row has the times of contact steps while the object
//! touches (median, 99th percentile and largest), of the first contact step, and of haptic steps; the guarded
//! points, and how far the object may move before other ones are needed (`room`); and by how much the object
//! was behind the hand. `-- --scenario golf` runs one scenario, `-- --rate 500` one rate, `-- --speed 5` a
//! hand that is five times as fast, `-- --start 300` a session that starts on the way, at a step of the path,
//! and `-- --probe A.obj --scene B.obj --trajectory T.csv` one's own files. Times of all rows of a run
//! compare, and no others.

#![allow(clippy::print_stdout, reason = "it prints a table")]

use std::error::Error;
use std::hint::black_box;
use std::path::PathBuf;
use std::time::Instant;

use clap::Parser;
use palpate::device::{DeviceState, Emulation, Interpolation, Keyframe, MotionPath, PathPoint, Status};
use palpate::telemetry::Times;
use palpate::{HandlePlacement, HapticRenderer, Pose, Scene, Settings};
use palpate_benches::scenarios::{self, Scenario};

#[derive(Parser)]
#[command(about = "Times of contact steps of default sessions")]
struct Arguments {
    /// Scenarios to run; all by default
    #[arg(long)]
    scenario: Vec<String>,
    /// Contact steps a second
    #[arg(long, default_values_t = [1000, 500, 200, 80], value_parser = clap::value_parser!(u32).range(1..=1000))]
    rate: Vec<u32>,
    /// Speed of the hand, in that of the path
    #[arg(long, default_value_t = 1.0)]
    speed: f64,
    /// Step of the path (ms) at which the session starts
    #[arg(long, default_value_t = 0)]
    start: usize,
    /// Mesh file of the object in the hand
    #[arg(long, requires_all = ["scene", "trajectory"])]
    probe: Option<String>,
    /// Mesh file of the scene object
    #[arg(long)]
    scene: Option<String>,
    /// File of poses at 1 kHz
    #[arg(long)]
    trajectory: Option<PathBuf>,
    /// Argument that cargo passes to every benchmark
    #[arg(long, hide = true)]
    bench: bool,
}

/// Period of the haptic loop, s.
const STEP: f64 = 1e-3;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments::parse();
    let run = |scenario: &Scenario| {
        println!("## {}\n", scenario.name);
        println!(
            "| contact steps a second | in touch | median µs | p99 | max | first | haptic median | p99 | points | \
             room mm | behind mm |\n|---|---|---|---|---|---|---|---|---|---|---|"
        );
        for &rate in &arguments.rate {
            session(scenario, rate, &arguments)?.print(rate);
        }
        println!();
        Ok(())
    };
    if let (Some(probe), Some(scene), Some(path)) =
        (&arguments.probe, &arguments.scene, &arguments.trajectory)
    {
        return run(&scenarios::own(probe, scene, path, "1%")?);
    }
    scenarios::each(&arguments.scenario, run)
}

/// What a session took.
struct Taken {
    contact: Times,
    haptic: Times,
    /// Time of the first contact step, µs.
    first: f64,
    /// Means while the object touches.
    points: f64,
    room: f64,
    /// Largest distance of the object from where the hand wants it, m.
    behind: f64,
}

/// Runs a session along a scenario's path, in lockstep: a contact step's answer arrives when the next one
/// begins.
fn session(scenario: &Scenario, rate: u32, arguments: &Arguments) -> Result<Taken, Box<dyn Error>> {
    let settings = Settings::default();
    let placement =
        HandlePlacement::new(&settings, &scenario.probe.object, &Emulation::default().specification);
    let from = scenario.poses.iter().skip(arguments.start).enumerate();
    let keyframes = from.map(|(step, pose)| Keyframe {
        time: STEP * step as f64 / arguments.speed,
        pose: placement.device_pose(pose),
    });
    let path = MotionPath::new(keyframes.collect(), Interpolation::Linear)?;
    let state = |time: f64| {
        let PathPoint { pose, twist, .. } = path.at(time);
        DeviceState { time, pose, twist, buttons: 0, status: Status::OK }
    };
    let device = Emulation::default().open(state(0.0).pose)?;
    let scene = Scene::new().with(scenario.scene.object.clone(), Pose::IDENTITY);
    let renderer = HapticRenderer::new(scenario.probe.object.clone(), scene, Box::new(device), settings)?;
    let (mut haptic, mut contact, _) = renderer.into_loops();
    let every = (1.0 / (STEP * f64::from(rate))).round().max(1.0) as usize;
    let steps = (path.duration() / STEP) as usize;
    let mut taken = Taken {
        contact: Times::new(),
        haptic: Times::new(),
        first: f64::NAN,
        points: 0.0,
        room: 0.0,
        behind: 0.0,
    };
    let (mut found, mut touching) = (None, 0.0);
    let mut is_touching = false;
    for step in 0..steps {
        // A step leads from the last one's state to that of the device's newest reading.
        let state = state(STEP * (step + 1) as f64);
        if step % every == 0 {
            if let Some(update) = found.take() {
                haptic.update_contacts(&update);
            }
            let begun = Instant::now();
            let (body, pull) = (*haptic.body_state(), haptic.pull());
            let update = contact.step_pulled(black_box(&body), &pull, STEP * step as f64);
            let time = begun.elapsed();
            if step == 0 {
                taken.first = 1e6 * time.as_secs_f64();
            } else if is_touching {
                taken.contact.record(time.as_nanos() as u64);
                touching += 1.0;
                if let Some(guarded) = update.guarded() {
                    taken.points += guarded.points as f64;
                    taken.room += guarded.room;
                }
            }
            found = Some(update);
        }
        let begun = Instant::now();
        let record = black_box(haptic.step(black_box(&state), state.time, STEP));
        let time = begun.elapsed();
        is_touching = record.contacts > 0;
        if is_touching {
            taken.haptic.record(time.as_nanos() as u64);
        }
        taken.behind = taken.behind.max(record.stretch(haptic.grasp().translation));
    }
    taken.points /= touching;
    taken.room /= touching;
    Ok(taken)
}

impl Taken {
    fn print(&self, rate: u32) {
        let Self { contact, haptic, first, points, room, behind } = self;
        let (steps, times) = (contact.count(), contact.percentiles(1e3));
        let haptic = haptic.percentiles(1e3);
        println!(
            "| {rate} | {steps} | {:.0} | {:.0} | {:.0} | {first:.0} | {:.1} | {:.1} | {points:.0} | {:.3} | {:.3} |",
            times.p50,
            times.p99,
            times.max,
            haptic.p50,
            haptic.p99,
            1e3 * room,
            1e3 * behind
        );
    }
}
