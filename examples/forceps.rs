//! Forceps of two jaws and a hinge (§6.2.3 of the dissertation): an emulated hand moves them over an ellipsoid, closes them on it,
//! pulls, opens, draws them back and closes them on nothing.
//!
//! `cargo run --release --example forceps`, on a simulated clock; `-- --real-time` steps it as a host does, with contacts found in
//! threads beside it. A row a step goes to `target/forceps/recording.csv`.

use std::error::Error;
use std::f64::consts::{FRAC_PI_2, PI};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use palpate::device::{EmulatedDevice, Emulation, HapticDevice as _};
use palpate::glam::{DQuat, DVec3};
use palpate::settings::{ContactSettings, GripperSettings, SearchSettings, ToolSettings};
use palpate::tool::{Hinged, HingedRecord, HingedTool};
use palpate::{
    ContactTiming, HapticRenderer, HostedSession, LockstepSession, Pose, RecordWriter, Scene, Settings,
};
use palpate_examples::{CommandLine, open, path, say, smooth};

/// Length of the session, and when the jaws are closed on the ellipsoid, are pulled, and are closed on nothing, s.
const SECONDS: f64 = 10.0;
const CLOSED: f64 = 3.0;
const PULLED: f64 = 5.0;
const EMPTY: f64 = 9.2;
const STEP: f64 = 1e-3;
/// How wide the hand opens the jaws, rad.
const OPEN: f64 = 0.6;
/// How far beyond closed it squeezes, rad.
const SQUEEZE: f64 = 0.1;
/// How far it pulls, m.
const PULL: f64 = 4e-3;

const HELP: [&str; 2] = [
    "--real-time    Step in real time, with contacts found in threads beside the loop",
    "--output DIR   Write the recording there [default: target/forceps]",
];

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
    // Its shortest axis lies across the jaws.
    let across = Pose::new(DVec3::X * 0.045, DQuat::from_rotation_x(FRAC_PI_2));
    let scene = Scene::new().with(open("ellipsoid")?, across);
    let mut device = Emulation::default().open(path(SECONDS, hand)?)?;
    let mut gripper = EmulatedGripper::new(OPEN);
    let settings = Settings {
        contact: ContactSettings { stiffness: 10_000.0, friction: 0.5, ..ContactSettings::default() },
        search: SearchSettings { tolerance: Some(2e-4), ..SearchSettings::default() },
        tool: ToolSettings { grasp: Some(Pose::IDENTITY), ..ToolSettings::default() },
        ..Settings::default()
    };
    let held = Emulation::default().open(path(SECONDS, hand)?)?;
    let gripping = GripperSettings::default();
    let renderer = HapticRenderer::hinged(&tool, scene, Box::new(held), gripper.angle, settings, &gripping)?;
    let mut session = if real_time {
        Running::Host(Box::new(renderer.host()?))
    } else {
        Running::Lockstep(Box::new(renderer.lockstep(ContactTiming::busy(500.0))))
    };

    let begun = Instant::now();
    let mut records = Vec::new();
    for step in 1..=(SECONDS / STEP) as u32 {
        let time = f64::from(step) * STEP;
        let record = session.step(&mut device, &gripper, time)?;
        device.write(&record.coupling)?;
        gripper.pass(time, record.torque);
        records.push(record);
        if real_time {
            let deadline = begun + Duration::from_secs_f64(time);
            std::thread::sleep(deadline.saturating_duration_since(Instant::now()));
        }
    }
    device.close()?;
    tell(&records)?;
    let file = write(&output, &records)?;
    say("written", file.display())?;
    Ok(())
}

/// From 0 to 1 between two times.
fn ramp(from: f64, to: f64, time: f64) -> f64 {
    smooth((time - from) / (to - from))
}

/// How far the hand means to have closed the gripper, 0 to 1.
fn closing(time: f64) -> f64 {
    ramp(1.2, 2.5, time) - ramp(5.5, 6.5, time) + ramp(7.8, 8.8, time) - ramp(9.3, SECONDS, time)
}

/// Where the hand means the first jaw to be: turned back by half the opening, so that the jaws open to both sides.
fn hand(time: f64) -> Pose {
    let back = 0.07 * (1.0 - ramp(0.2, 1.2, time) + ramp(6.5, 7.6, time));
    let pull = PULL * (ramp(CLOSED, PULLED - 0.5, time) - ramp(PULLED, 5.5, time));
    let half = 0.5 * OPEN * (1.0 - closing(time));
    Pose::new(DVec3::new(-back, 0.0, pull), DQuat::from_rotation_z(-half))
}

/// A gripper's handle, in the fingers of a hand that means it to be at an angle and gives way to its torque.
struct EmulatedGripper {
    /// rad.
    angle: f64,
    /// rad/s.
    rate: f64,
}

impl EmulatedGripper {
    /// Of the handle with the fingers, kg·m².
    const INERTIA: f64 = 2e-5;
    /// Of the fingers, N·m/rad and N·m·s/rad.
    const STIFFNESS: f64 = 1.5;
    const DAMPING: f64 = 0.01;

    fn new(angle: f64) -> Self {
        Self { angle, rate: 0.0 }
    }

    /// A step up to `time` under a torque (N·m), by backward Euler.
    fn pass(&mut self, time: f64, torque: f64) {
        let intended = OPEN - (OPEN + SQUEEZE) * closing(time);
        let force =
            torque + Self::STIFFNESS * (intended - self.angle - STEP * self.rate) - Self::DAMPING * self.rate;
        let mass = Self::INERTIA + STEP * (Self::DAMPING + STEP * Self::STIFFNESS);
        self.rate += STEP * force / mass;
        self.angle += STEP * self.rate;
    }
}

/// The session, by whichever clock.
enum Running {
    Lockstep(Box<LockstepSession<Hinged>>),
    Host(Box<HostedSession<Hinged>>),
}

impl Running {
    fn step(
        &mut self,
        device: &mut EmulatedDevice,
        gripper: &EmulatedGripper,
        time: f64,
    ) -> Result<HingedRecord, Box<dyn Error>> {
        let state = device.read(time)?;
        match self {
            Self::Lockstep(session) => Ok(session.step(&state, gripper.angle)),
            Self::Host(session) => {
                session.step(STEP, &state, gripper.angle);
                session.latest().copied().ok_or_else(|| "no step was taken".into())
            }
        }
    }
}

/// Prints what happened.
fn tell(records: &[HingedRecord]) -> std::io::Result<()> {
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

/// Writes the recording; where it is.
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
