//! Forceps of two jaws and a hinge (§6.2.3 of the dissertation): an emulated hand moves them over an
//! ellipsoid, closes them on it, pulls, opens, draws them back and closes them without an object.
//!
//! `cargo run --release --example forceps`, on a simulated clock; `-- --real-time` runs it in real time. A
//! row per step goes to `target/forceps/recording.csv`.

use std::convert::Infallible;
use std::error::Error;
use std::f64::consts::{FRAC_PI_2, PI};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use palpate::device::{Emulation, GripperEmulation, GripperPath};
use palpate::glam::{DQuat, DVec3};
use palpate::settings::{ContactSettings, GripperSettings, SearchSettings, ToolSettings};
use palpate::tool::{HingedRecord, HingedTool};
use palpate::{ContactTiming, HapticRenderer, Pose, RecordWriter, Scene, Settings};
use palpate_examples::{CommandLine, open, path, say, smooth};

/// Length of the session, and times at which the jaws are closed on the ellipsoid, are pulled, and are closed
/// without an object, s.
const SECONDS: f64 = 10.0;
const CLOSED: f64 = 3.0;
const PULLED: f64 = 5.0;
const EMPTY: f64 = 9.2;
/// Angle to which the hand opens the jaws, rad.
const OPEN: f64 = 0.6;
/// Intended angle beyond closed when squeezing, rad.
const SQUEEZE: f64 = 0.1;
/// Displacement of the pull, m.
const PULL: f64 = 4e-3;

const HELP: [&str; 2] =
    ["--real-time    Run in real time", "--output DIR   Write the recording there [default: target/forceps]"];

fn main() -> Result<(), Box<dyn Error>> {
    let mut line = CommandLine::new("Closes forceps on an ellipsoid, and prints what is felt", &HELP);
    let (real_time, output) =
        (line.flag("--real-time"), line.value("--output", PathBuf::from("target/forceps"))?);
    line.finish()?;
    let jaw = open("forceps-jaw")?;
    let tool = HingedTool {
        first: jaw.clone(),
        second: jaw,
        // Both jaws have the same shape; the second is turned over.
        hinge: [Pose::IDENTITY, Pose::new(DVec3::ZERO, DQuat::from_rotation_x(PI))],
        limits: [0.0, 0.8],
        masses: [0.05; 2],
        stop_stiffness: 100.0,
    };
    // The shortest axis of the ellipsoid is across the jaws.
    let across = Pose::new(DVec3::X * 0.045, DQuat::from_rotation_x(FRAC_PI_2));
    let scene = Scene::new().with(open("ellipsoid")?, across);
    let device = Emulation::default().open(path(SECONDS, hand)?)?;
    let device = device.with_gripper(GripperEmulation::default(), GripperPath::function(fingers))?;
    let settings = Settings {
        contact: ContactSettings { stiffness: 10_000.0, friction: 0.5, ..ContactSettings::default() },
        search: SearchSettings { tolerance: Some(2e-4), ..SearchSettings::default() },
        tool: ToolSettings { grasp: Some(Pose::IDENTITY), ..ToolSettings::default() },
        ..Settings::default()
    };
    let gripping = GripperSettings::default();
    let renderer = HapticRenderer::hinged(&tool, scene, Box::new(device), settings, &gripping)?;
    let stop = AtomicBool::new(false);
    let mut records = Vec::new();
    let sink = |record: &HingedRecord| {
        records.push(*record);
        Ok::<(), Infallible>(())
    };
    if real_time {
        renderer.run_realtime(SECONDS, &stop, sink)?;
    } else {
        renderer.run_lockstep(SECONDS, ContactTiming::busy(500.0), &stop, sink)?;
    }
    report(&records)?;
    let file = write(&output, &records)?;
    say("written", file.display())?;
    Ok(())
}

/// Returns a smooth step from 0 to 1 between two times (s).
fn ramp(from: f64, to: f64, time: f64) -> f64 {
    smooth((time - from) / (to - from))
}

/// Returns the intended closing of the gripper at a time (s), 0 to 1.
fn closing(time: f64) -> f64 {
    ramp(1.2, 2.5, time) - ramp(5.5, 6.5, time) + ramp(7.8, 8.8, time) - ramp(9.3, SECONDS, time)
}

/// Returns the intended pose of the first jaw at a time (s): turned back by half the opening, so that the
/// jaws open to both sides.
fn hand(time: f64) -> Pose {
    let back = 0.07 * (1.0 - ramp(0.2, 1.2, time) + ramp(6.5, 7.6, time));
    let pull = PULL * (ramp(CLOSED, PULLED - 0.5, time) - ramp(PULLED, 5.5, time));
    let half = 0.5 * OPEN * (1.0 - closing(time));
    Pose::new(DVec3::new(-back, 0.0, pull), DQuat::from_rotation_z(-half))
}

/// Returns the intended angle of the gripper (rad) and its rate (rad/s) at a time (s).
fn fingers(time: f64) -> (f64, f64) {
    let angle = |time: f64| OPEN - (OPEN + SQUEEZE) * closing(time);
    // A central difference is close enough for the fingers' damper.
    let h = 1e-4;
    (angle(time), (angle(time + h) - angle(time - h)) / (2.0 * h))
}

/// Prints forces and angles at the three times, and the largest ones.
fn report(records: &[HingedRecord]) -> std::io::Result<()> {
    let at = |time: f64| records.iter().find(|record| record.time >= time);
    let milli = |value: f64| 1e3 * value;
    for (name, time) in
        [("closed on the ellipsoid", CLOSED), ("pulled", PULLED), ("closed on nothing", EMPTY)]
    {
        let Some(record) = at(time) else { continue };
        let [first, second] = record.contact.map(|wrench| wrench.force.length());
        let about = format_args!(
            "hinge at {:.1}°, gripper asks for {:.1}° and feels {:.0} mN·m, jaws press with {first:.2} and {second:.2} N, hand feels {:.2} N",
            record.angle.to_degrees(),
            record.gripper.to_degrees(),
            milli(record.torque),
            record.coupling.force.length(),
        );
        say(name, format_args!("{about}"))?;
    }
    if let (Some(held), Some(pulled)) = (at(CLOSED), at(PULLED)) {
        let along = held.coupling.force.z - pulled.coupling.force.z;
        say("force against the pull", format_args!("{along:.2} N at {:.0} mm", milli(PULL)))?;
    }
    let most = |of: fn(&HingedRecord) -> f64| records.iter().map(of).fold(0.0, f64::max);
    let depth = most(|record| record.depth[0].max(record.depth[1]));
    say("deepest penetration", format_args!("{:.3} mm", milli(depth)))?;
    say("largest gripping torque", format_args!("{:.0} mN·m", milli(most(|record| record.torque))))?;
    say("largest force on the hand", format_args!("{:.2} N", most(|record| record.coupling.force.length())))
}

/// Writes the recording and returns its path.
fn write(folder: &Path, records: &[HingedRecord]) -> Result<PathBuf, Box<dyn Error>> {
    std::fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let file = folder.join("recording.csv");
    let mut out = RecordWriter::create(&file).map_err(|error| format!("{}: {error}", file.display()))?;
    for record in records {
        out.write(record)?;
    }
    out.finish()?;
    Ok(file)
}
