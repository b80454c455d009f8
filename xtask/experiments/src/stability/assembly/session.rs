//! Sessions in lockstep whose poses and wrenches are kept.

use std::convert::Infallible;
use std::sync::atomic::AtomicBool;

use palpate::device::{Emulation, IntendedPath};
use palpate::{ContactTiming, HapticRenderer, Pose, Record, Scene, Settings};

use super::super::metered::Metered;
use super::{Part, RATE};

/// What a session left behind.
pub struct Recorded {
    pub records: Vec<Record>,
    pub port_energy: f64,
    pub refused: u64,
}

impl Recorded {
    /// Largest force (N) and torque (N·m) sent to the hand.
    pub fn largest(&self) -> (f64, f64) {
        self.records.iter().fold((0.0, 0.0), |(force, torque): (f64, f64), record| {
            (force.max(record.coupling.force.length()), torque.max(record.coupling.torque.length()))
        })
    }

    pub fn poses(&self) -> Vec<Pose> {
        self.records.iter().map(|record| record.object).collect()
    }
}

/// Runs a session for some time (s), in which a device holds one part, and the other is at the origin.
///
/// # Errors
/// If the session cannot start.
pub fn run(
    (held, fixed): (&Part, &Part),
    (emulation, path): (Emulation, IntendedPath),
    settings: Settings,
    seconds: f64,
) -> Result<Recorded, String> {
    let device = emulation.open(path).map_err(|error| error.to_string())?;
    let (device, meter) = Metered::new(device);
    let scene = Scene::new().with(fixed.object.clone(), Pose::IDENTITY);
    let renderer = HapticRenderer::new(held.object.clone(), scene, Box::new(device), settings)
        .map_err(|error| error.to_string())?;
    let mut records = Vec::new();
    let stop = AtomicBool::new(false);
    let run = renderer.run_lockstep(seconds, ContactTiming::busy(RATE), &stop, |record| {
        records.push(*record);
        Ok::<_, Infallible>(())
    });
    let Ok(session) = run;
    let refused = session.summary().events.step_refused;
    Ok(Recorded { records, port_energy: -meter.seen().most_work, refused })
}
