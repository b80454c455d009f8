//! Sessions on a simulated clock, by the motion of a device that was recorded before.

use std::collections::VecDeque;
use std::time::Instant;

use palpate::device::{
    Emulation, HapticDevice, IntendedPath, Interpolation, Keyframe, MotionPath, ReplayDevice,
};
use palpate::{HapticRenderer, Object, Pose, Record, Scene, Settings};

/// One step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// What was recorded of it.
    pub record: Record,
    /// s.
    pub time: f64,
    /// ‖x_h − x_c‖: between the device's handle and the point of the object that it holds, m.
    pub deviation: f64,
    /// The angle between them, rad.
    pub turn: f64,
    /// ‖F_c‖, at the object, N.
    pub coupling: f64,
    /// N.
    pub contact: f64,
    /// Maximum local penetration depth, m.
    pub depth: f64,
}

/// One contact step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Query {
    /// When it was, s.
    pub time: f64,
    /// How many clustered contacts it found.
    pub clusters: usize,
    /// How long it took, s: another time each time.
    pub took: f64,
}

/// A session.
#[derive(Clone, Debug)]
pub struct Session<'a> {
    pub probe: &'a Object,
    pub scene: &'a Scene,
    pub settings: Settings,
    /// Contact queries a second, Hz, each taking its whole period.
    pub contact_rate: f64,
    /// Whether the contact force stays what it was at the state that a query saw, in place of its linear model.
    pub frozen: bool,
    pub seconds: f64,
}

/// What a session showed.
#[derive(Clone, Debug, PartialEq)]
pub struct Trace {
    pub samples: Vec<Sample>,
    pub queries: Vec<Query>,
    /// Steps without a finite solution.
    pub refused: u64,
}

/// Deeper than this, m, or turned or moved away by more, rad and m, an object is lost.
const LOST_DEPTH: f64 = 0.02;
const LOST: f64 = 1.0;

impl Trace {
    /// Whether every step had a solution, and the object stayed with the device.
    pub fn is_stable(&self) -> bool {
        let stays = |sample: &Sample| {
            sample.deviation < LOST
                && sample.turn < LOST
                && sample.depth < LOST_DEPTH
                && sample.coupling.is_finite()
        };
        self.refused == 0 && self.samples.iter().all(stays)
    }
}

impl Session<'_> {
    /// With an emulated device whose hand means to follow a path.
    ///
    /// # Errors
    /// If the session cannot be started.
    pub fn emulate(&self, intended: impl Into<IntendedPath>) -> Result<Trace, String> {
        let device = Emulation::default().open(intended).map_err(|error| error.to_string())?;
        self.run(Box::new(device))
    }

    /// With the device that moves along a path, whatever force it is sent.
    ///
    /// # Errors
    /// If the session cannot be started.
    pub fn replay(&self, path: MotionPath) -> Result<Trace, String> {
        self.run(Box::new(ReplayDevice::new("recorded", path)))
    }

    /// The path of an emulated device's handle whose hand means to follow a path.
    ///
    /// # Errors
    /// If the session cannot be started.
    pub fn record(&self, intended: MotionPath) -> Result<MotionPath, String> {
        // A hundred a second, as recordings on file are.
        let kept = |sample: &&Sample| ((sample.time * 1000.0).round() as u64).is_multiple_of(10);
        let trace = self.emulate(intended)?;
        let keyframe = |sample: &Sample| Keyframe { time: sample.time, pose: sample.record.device };
        let keyframes = trace.samples.iter().filter(kept).map(keyframe).collect();
        MotionPath::new(keyframes, Interpolation::Smooth).map_err(|error| error.to_string())
    }

    fn run(&self, device: Box<dyn HapticDevice>) -> Result<Trace, String> {
        let Self { probe, scene, settings, contact_rate, frozen, seconds } = self;
        let grasp = settings.grasp.unwrap_or(Pose::from_translation(probe.clod.source.center_of_mass));
        let renderer = HapticRenderer::new((*probe).clone(), (*scene).clone(), device, *settings);
        let (mut haptic, mut contact, mut device) = renderer.map_err(|error| error.to_string())?.into_loops();
        let period = 1.0 / settings.rate;
        let every = (settings.rate / contact_rate).round().max(1.0) as usize;
        let mut waiting = VecDeque::new();
        let (mut samples, mut queries) = (Vec::new(), Vec::new());
        for step in 0..(seconds * settings.rate).round() as usize {
            let now = step as f64 * period;
            if step % every == 0 {
                if let Some(update) = waiting.pop_front() {
                    haptic.update_contacts(&update);
                }
                let begun = Instant::now();
                let mut update = contact.step(haptic.body_state(), now);
                let took = begun.elapsed().as_secs_f64();
                queries.push(Query { time: now, clusters: update.model.constraints().len(), took });
                if *frozen {
                    update.model = update.model.frozen(haptic.body_state());
                }
                waiting.push_back(update);
            }
            let record = haptic.step_device(device.as_mut(), now + period, period);
            // The device's frame stands for the mesh's.
            let (held, handle) = (record.object * grasp, record.handle * grasp);
            samples.push(Sample {
                record,
                time: record.time,
                deviation: held.translation.distance(handle.translation),
                turn: held.rotation_vector_to(&handle).length(),
                // At the object it is larger by the scale.
                coupling: record.coupling.force.length() * settings.workspace_scale,
                contact: record.contact.force.length(),
                depth: record.depth,
            });
        }
        Ok(Trace { samples, queries, refused: haptic.telemetry().events.step_refused })
    }
}

/// A built-in model by its name, with its hierarchy.
///
/// # Errors
/// If there is no such model.
pub fn open(name: &str) -> Result<Object, String> {
    Object::model(name).map_err(|error| error.to_string())
}

/// A path of so many seconds, a hundred poses in each.
///
/// # Errors
/// If a pose is out of range.
pub fn path(seconds: f64, pose: impl Fn(f64) -> Pose) -> Result<MotionPath, String> {
    let keyframe = |sample: usize| {
        let time = sample as f64 / 100.0;
        Keyframe { time, pose: pose(time) }
    };
    let keyframes = (0..=(seconds * 100.0).ceil() as usize).map(keyframe).collect();
    MotionPath::new(keyframes, Interpolation::Smooth).map_err(|error| error.to_string())
}
