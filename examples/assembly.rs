//! Shared by the examples of assembly: a session whose records are kept, how deep parts penetrate, and the
//! recording.

use std::convert::Infallible;
use std::error::Error;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use palpate::collide::{ContactQuery, ContactSet, ContactSetSettings, QuerySettings};
use palpate::device::{Emulation, IntendedPath};
use palpate::settings::{ContactSettings, ToolSettings};
use palpate::{ContactTiming, HapticRenderer, Object, Pose, Record, RecordWriter, Scene, Settings};

use crate::say;

/// Density of steel, kg/m³.
const STEEL: f64 = 7850.0;
/// Rate at which contacts are found, Hz.
const CONTACT_RATE: f64 = 500.0;
/// Steps between two poses of which the penetration is measured.
const STRIDE: usize = 5;

/// Settings of a session with friction in which a part of steel is held; the rest is as by default.
pub fn steel(part: &Object, friction: f64) -> Settings {
    Settings {
        contact: ContactSettings { friction, ..ContactSettings::default() },
        tool: ToolSettings { mass: STEEL * part.clod.source.volume, ..ToolSettings::default() },
        ..Settings::default()
    }
}

/// Renders a held part against a fixed one at the origin for some time (s), on a simulated clock, and
/// returns the records.
///
/// # Errors
/// If the session cannot start.
pub fn render(
    (held, fixed): (&Object, &Object),
    (emulation, path): (Emulation, IntendedPath),
    settings: Settings,
    seconds: f64,
) -> Result<Vec<Record>, Box<dyn Error>> {
    let device = emulation.open(path)?;
    let scene = Scene::new().with(fixed.clone(), Pose::IDENTITY);
    let renderer = HapticRenderer::new(held.clone(), scene, Box::new(device), settings)?;
    let mut records = Vec::new();
    renderer.run_lockstep(seconds, ContactTiming::busy(CONTACT_RATE), &AtomicBool::new(false), |record| {
        records.push(*record);
        Ok::<(), Infallible>(())
    })?;
    Ok(records)
}

/// Prints how deep the parts penetrate, at full resolution at every fifth recorded pose, and what was felt.
///
/// # Errors
/// If a pose is not valid, or the terminal is closed.
pub fn report(held: &Object, fixed: &Object, records: &[Record]) -> Result<(), Box<dyn Error>> {
    let settings = QuerySettings::new(1e-6);
    let merged = ContactSetSettings::new(1e-6);
    let mut query = ContactQuery::new(held.shape(), fixed.shape());
    let mut set = ContactSet::new(held.shape(), fixed.shape());
    let (mut deepest, mut at) = (0.0, 0.0);
    for record in records.iter().step_by(STRIDE) {
        query.run(&record.object, &Pose::IDENTITY, &settings)?;
        let contacts = set.run(query.contacts(), &record.object, &Pose::IDENTITY, &merged)?;
        let depth = contacts.iter().map(|found| found.contact.depth).fold(0.0, f64::max);
        if depth > deepest {
            (deepest, at) = (depth, record.time);
        }
    }
    say("deepest penetration", format_args!("{:.3} mm, at {at:.2} s", 1e3 * deepest))?;
    let most = |of: fn(&Record) -> f64| records.iter().map(of).fold(0.0, f64::max);
    let (force, torque) =
        (most(|record| record.coupling.force.length()), most(|record| record.coupling.torque.length()));
    say("largest force on the hand", format_args!("{force:.2} N"))?;
    Ok(say("largest torque on the hand", format_args!("{:.1} mN·m", 1e3 * torque))?)
}

/// Writes a recording into a folder and prints its name.
///
/// # Errors
/// If it cannot be written.
pub fn write(folder: &Path, records: &[Record]) -> Result<(), Box<dyn Error>> {
    std::fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let file = folder.join("recording.csv");
    let mut out = RecordWriter::create(&file).map_err(|error| format!("{}: {error}", file.display()))?;
    for record in records {
        out.write(record)?;
    }
    out.finish()?;
    Ok(say("written", file.display())?)
}
