//! Contact steps along a path of the grasped object, with their durations and wrenches.

use std::time::Instant;

use palpate::device::{Interpolation, Keyframe, MotionPath, ReplayDevice};
use palpate::dynamics::BodyState;
use palpate::settings::SearchSettings;
use palpate::{ContactLoop, HapticRenderer, Object, Pose, Scene, Settings, Wrench};

use crate::error::MeasureError;
use crate::experiment::Trace;
use crate::statistics::quantile;

/// States of the grasped object, one for each contact step.
#[derive(Clone, Debug, PartialEq)]
pub struct BodyPath {
    /// States about the centre of mass, world axes.
    pub states: Vec<BodyState>,
    /// Time between states, s.
    pub period: f64,
}

impl BodyPath {
    /// Returns the states at the contact queries of an experiment.
    pub fn of(trace: &Trace) -> Self {
        Self {
            states: trace.queries.iter().map(|query| query.body).collect(),
            period: 1.0 / trace.contact_rate,
        }
    }

    /// Returns a part of the states, at most `rate` per second (Hz).
    #[must_use]
    pub fn thinned_to(&self, rate: f64) -> Self {
        let every = (1.0 / (rate * self.period)).ceil().max(1.0);
        let states = self.states.iter().step_by(every as usize).copied().collect();
        Self { states, period: every * self.period }
    }
}

/// Results and durations of contact steps along a path, one value per state.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// Contact wrenches on the object, about its centre of mass, N and N·m.
    pub wrenches: Vec<Wrench>,
    /// Deepest penetrations, m; 0 without penetration.
    pub depths: Vec<f64>,
    /// Numbers of contacts before clustering.
    pub contacts: Vec<u32>,
    /// Durations of the contact steps, s: the smallest of all rounds.
    pub times: Vec<f64>,
    /// Memory of the objects' hierarchies and of the queries' workspaces, bytes.
    pub bytes: usize,
}

impl Profile {
    /// Makes contact steps along the path `rounds` times, each with a new contact loop. Wrenches are from the
    /// first round.
    ///
    /// # Errors
    /// If a setting is refused.
    pub fn along(
        path: &BodyPath,
        probe: &Object,
        scene: &Scene,
        settings: &Settings,
        rounds: usize,
    ) -> Result<Self, MeasureError> {
        let count = path.states.len();
        let mut profile = Self {
            wrenches: Vec::with_capacity(count),
            depths: Vec::with_capacity(count),
            contacts: Vec::with_capacity(count),
            times: vec![f64::INFINITY; count],
            bytes: 0,
        };
        for round in 0..rounds.max(1) {
            let mut contact = contact_loop(probe, scene, settings)?;
            for (index, state) in path.states.iter().enumerate() {
                let begun = Instant::now();
                let update = contact.step(state, index as f64 * path.period);
                let took = begun.elapsed().as_secs_f64();
                let least = &mut profile.times[index];
                *least = least.min(took);
                if round == 0 {
                    profile.wrenches.push(update.model.wrench(state));
                    profile.depths.push(update.depth);
                    profile.contacts.push(update.contacts);
                }
            }
            profile.bytes = object_bytes(probe, scene) + contact.workspace_bytes();
        }
        Ok(profile)
    }

    /// Returns a quantile of the durations of steps with contact, s.
    pub fn time(&self, fraction: f64) -> f64 {
        let touching: Vec<f64> = self.touching().filter_map(|index| self.times.get(index).copied()).collect();
        quantile(&touching, fraction)
    }

    /// Iterates over the indices of states with contact.
    pub fn touching(&self) -> impl Iterator<Item = usize> {
        self.contacts.iter().enumerate().filter(|(_, contacts)| **contacts > 0).map(|(index, _)| index)
    }
}

/// Rate of states at which the depth of a trace is evaluated, Hz.
const DEPTH_RATE: f64 = 100.0;

/// Returns the deepest penetration in a trace, with contacts found with the settings `exact`, m.
///
/// # Errors
/// If a setting is refused.
pub fn penetration(
    trace: &Trace,
    probe: &Object,
    scene: &Scene,
    exact: &Settings,
) -> Result<f64, MeasureError> {
    let path = BodyPath::of(trace).thinned_to(DEPTH_RATE);
    // Without the proxy, which would not follow the object through surfaces.
    let exact = Settings { search: SearchSettings { proxy: false, ..exact.search }, ..*exact };
    Ok(Profile::along(&path, probe, scene, &exact, 1)?.depths.into_iter().fold(0.0, f64::max))
}

/// Creates the contact loop of a session with these settings.
///
/// # Errors
/// If a setting is refused.
pub fn contact_loop(probe: &Object, scene: &Scene, settings: &Settings) -> Result<ContactLoop, MeasureError> {
    let here = Keyframe { time: 0.0, pose: Pose::IDENTITY };
    let still = ReplayDevice::new("still", MotionPath::new(vec![here], Interpolation::Linear)?);
    let renderer = HapticRenderer::new(probe.clone(), scene.clone(), Box::new(still), *settings)?;
    Ok(renderer.into_loops().1)
}

/// Returns the memory of hierarchies prepared for queries, bytes. One that objects share counts for each of
/// them.
fn object_bytes(probe: &Object, scene: &Scene) -> usize {
    let objects = scene.objects().iter().map(|placed| &placed.object);
    std::iter::once(probe)
        .chain(objects)
        .map(|object| object.clod.total_bytes() + object.shape().bytes())
        .sum()
}
