//! Sessions on a simulated clock of which everything is kept.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Instant;

use palpate::device::{
    Emulation, HapticDevice, IntendedPath, Interpolation, Keyframe, MotionPath, ReplayDevice,
};
use palpate::dynamics::{BodyState, IntegratorKind};
use palpate::{HapticRenderer, Object, Pose, Record, Scene, Settings};

use crate::error::MeasureError;

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
    /// The state of the grasped object that it saw.
    pub body: BodyState,
    /// How many clustered contacts it found.
    pub clusters: usize,
    /// How long it took, s: another time each time.
    pub took: f64,
}

/// What a session is to be.
#[derive(Clone, Debug)]
pub struct Experiment<'a> {
    /// The object in the hand.
    pub probe: &'a Object,
    /// What it touches.
    pub scene: &'a Scene,
    /// What to render with.
    pub settings: Settings,
    /// Integrator of the object's motion.
    pub integrator: IntegratorKind,
    /// Contact queries a second, Hz, each taking its whole period.
    pub contact_rate: f64,
    /// Whether the contact force stays what it was at the state that a query saw, in place of its linear model.
    pub frozen: bool,
    /// How long it lasts, s.
    pub seconds: f64,
}

/// What a session showed.
#[derive(Clone, Debug, PartialEq)]
pub struct Trace {
    /// One a haptic step.
    pub samples: Vec<Sample>,
    /// One a contact step.
    pub queries: Vec<Query>,
    /// Haptic steps a second, Hz.
    pub rate: f64,
    /// Contact steps a second, Hz.
    pub contact_rate: f64,
    /// How long each haptic step took with reading and writing the emulated device, s: other times each time.
    pub step_times: Vec<f64>,
    /// Stiffness of the virtual coupling, N/m.
    pub coupling_stiffness: f64,
    /// Motion of the object up to which it counts as at rest, m: two encoder steps of the device.
    pub floor: f64,
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

impl Experiment<'_> {
    /// With an emulated device whose hand means to follow a path.
    ///
    /// # Errors
    /// If the session cannot be started.
    pub fn emulate(&self, intended: impl Into<IntendedPath>) -> Result<Trace, MeasureError> {
        self.run(Box::new(Emulation::default().open(intended)?))
    }

    /// With the device that moves along a path, whatever force it is sent.
    ///
    /// # Errors
    /// If the session cannot be started.
    pub fn replay(&self, path: MotionPath) -> Result<Trace, MeasureError> {
        self.run(Box::new(ReplayDevice::new("recorded", path)))
    }

    /// The path of an emulated device's handle whose hand means to follow a path.
    ///
    /// # Errors
    /// If the session cannot be started.
    pub fn record(&self, intended: MotionPath) -> Result<MotionPath, MeasureError> {
        // A hundred a second, as recordings on file are.
        let kept = |sample: &&Sample| ((sample.time * 1000.0).round() as u64).is_multiple_of(10);
        let trace = self.emulate(intended)?;
        let keyframe = |sample: &Sample| Keyframe { time: sample.time, pose: sample.record.device };
        let keyframes = trace.samples.iter().filter(kept).map(keyframe).collect();
        Ok(MotionPath::new(keyframes, Interpolation::Smooth)?)
    }

    fn run(&self, device: Box<dyn HapticDevice>) -> Result<Trace, MeasureError> {
        let Self { probe, scene, settings, integrator, contact_rate, frozen, seconds } = self;
        let grasp = settings.tool.grasp.unwrap_or(Pose::from_translation(probe.clod.source.center_of_mass));
        let mut renderer = HapticRenderer::new((*probe).clone(), (*scene).clone(), device, *settings)?;
        renderer.set_integrator(Arc::new(*integrator));
        let (mut haptic, mut contact, mut device) = renderer.into_loops();
        let coupling_stiffness = haptic.coupling().linear_stiffness;
        let floor = 2.0 * settings.device.workspace_scale * device.specification().encoder_step;
        let period = 1.0 / settings.timing.rate;
        let every = (settings.timing.rate / contact_rate).round().max(1.0) as usize;
        let mut waiting = VecDeque::new();
        let (mut samples, mut queries, mut step_times) = (Vec::new(), Vec::new(), Vec::new());
        for step in 0..(seconds * settings.timing.rate).round() as usize {
            let now = step as f64 * period;
            if step % every == 0 {
                if let Some(update) = waiting.pop_front() {
                    haptic.update_contacts(&update);
                }
                let begun = Instant::now();
                let body = *haptic.body_state();
                let mut update = contact.step(&body, now);
                let took = begun.elapsed().as_secs_f64();
                queries.push(Query { time: now, body, clusters: update.model.constraints().len(), took });
                if *frozen {
                    update.model = crate::frozen::frozen(&update.model, haptic.body_state());
                }
                waiting.push_back(update);
            }
            let begun = Instant::now();
            let record = haptic.step_device(device.as_mut(), now + period, period);
            step_times.push(begun.elapsed().as_secs_f64());
            // The device's frame stands for the mesh's.
            let (held, handle) = (record.object * grasp, record.handle * grasp);
            samples.push(Sample {
                record,
                time: record.time,
                deviation: held.translation.distance(handle.translation),
                turn: held.rotation_vector_to(&handle).length(),
                // At the object it is larger by the scale.
                coupling: record.coupling.force.length() * settings.device.workspace_scale,
                contact: record.contact.force.length(),
                depth: record.depth,
            });
        }
        let refused = haptic.telemetry().events.step_refused;
        Ok(Trace {
            samples,
            queries,
            rate: settings.timing.rate,
            contact_rate: settings.timing.rate / every as f64,
            step_times,
            coupling_stiffness,
            floor,
            refused,
        })
    }
}
