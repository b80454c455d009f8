//! Sessions on a simulated clock with a full record.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Instant;

use palpate::device::{
    Emulation, HapticDevice, IntendedPath, Interpolation, Keyframe, MotionPath, ReplayDevice,
};
use palpate::dynamics::{BodyState, IntegratorKind};
use palpate::{HapticRenderer, Object, Pose, Record, Scene, Settings};

use crate::error::MeasureError;

/// A haptic step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Record of the step.
    pub record: Record,
    /// Time of the step, s.
    pub time: f64,
    /// Distance ‖x_h − x_c‖ between the device's handle and the point of the object that it holds, m.
    pub deviation: f64,
    /// Angle between handle and object, rad.
    pub turn: f64,
    /// Coupling force ‖F_c‖ at the object, N.
    pub coupling: f64,
    /// Contact force, N.
    pub contact: f64,
    /// Maximum local penetration depth, m.
    pub depth: f64,
}

/// A contact step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Query {
    /// Time of the step, s.
    pub time: f64,
    /// State of the grasped object for the query.
    pub body: BodyState,
    /// Number of clustered contacts.
    pub clusters: usize,
    /// Duration of the step, s. It varies from run to run.
    pub took: f64,
}

/// Description of a session.
#[derive(Clone, Debug)]
pub struct Experiment<'a> {
    /// Grasped object.
    pub probe: &'a Object,
    /// Scene that it touches.
    pub scene: &'a Scene,
    /// Settings of the session.
    pub settings: Settings,
    /// Integrator of the object's motion.
    pub integrator: IntegratorKind,
    /// Rate of contact queries, Hz; each takes its whole period.
    pub contact_rate: f64,
    /// Whether the contact force stays constant after a query, instead of following its linear model.
    pub frozen: bool,
    /// Duration of the session, s.
    pub seconds: f64,
}

/// Record of a session.
#[derive(Clone, Debug, PartialEq)]
pub struct Trace {
    /// Samples, one per haptic step.
    pub samples: Vec<Sample>,
    /// Queries, one per contact step.
    pub queries: Vec<Query>,
    /// Haptic rate, Hz.
    pub rate: f64,
    /// Contact rate, Hz.
    pub contact_rate: f64,
    /// Durations of haptic steps, including reading and writing the emulated device, s. They vary from run
    /// to run.
    pub step_times: Vec<f64>,
    /// Stiffness of the virtual coupling, N/m.
    pub coupling_stiffness: f64,
    /// Motion of the object up to which it counts as at rest, m: two encoder steps of the device.
    pub floor: f64,
    /// Number of steps without a finite solution.
    pub refused: u64,
}

/// Penetration depth above which a session counts as unstable, m.
const UNSTABLE_DEPTH: f64 = 0.02;
/// Distance (m) or angle (rad) between handle and object above which a session counts as unstable.
const UNSTABLE_DEVIATION: f64 = 1.0;

impl Trace {
    /// Returns whether every step had a solution, and the object stayed with the device.
    pub fn is_stable(&self) -> bool {
        let stays = |sample: &Sample| {
            sample.deviation < UNSTABLE_DEVIATION
                && sample.turn < UNSTABLE_DEVIATION
                && sample.depth < UNSTABLE_DEPTH
                && sample.coupling.is_finite()
        };
        self.refused == 0 && self.samples.iter().all(stays)
    }
}

impl Experiment<'_> {
    /// Runs the session with an emulated device whose hand intends to follow a path.
    ///
    /// # Errors
    /// If the session cannot be started.
    pub fn emulate(&self, intended: impl Into<IntendedPath>) -> Result<Trace, MeasureError> {
        self.run(Box::new(Emulation::default().open(intended)?))
    }

    /// Runs the session with a device that moves along a path, whatever force it is sent.
    ///
    /// # Errors
    /// If the session cannot be started.
    pub fn replay(&self, path: MotionPath) -> Result<Trace, MeasureError> {
        self.run(Box::new(ReplayDevice::new("recorded", path)))
    }

    /// Returns the path of the handle of an emulated device whose hand intends to follow a path.
    ///
    /// # Errors
    /// If the session cannot be started.
    pub fn record(&self, intended: MotionPath) -> Result<MotionPath, MeasureError> {
        // A hundred per second, as in recorded files.
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
                queries.push(Query { time: now, body, clusters: update.model.contacts().len(), took });
                if *frozen {
                    update.model = crate::frozen::frozen(&update.model, haptic.body_state());
                }
                waiting.push_back(update);
            }
            let begun = Instant::now();
            let record = haptic.step_device(device.as_mut(), now + period, period);
            step_times.push(begun.elapsed().as_secs_f64());
            // The handle's pose is that which the hand intends for the mesh's frame.
            let (held, handle) = (record.object * grasp, record.handle * grasp);
            samples.push(Sample {
                record,
                time: record.time,
                deviation: held.translation.distance(handle.translation),
                turn: held.rotation_vector_to(&handle).length(),
                // The force at the object is larger by the workspace scale.
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
