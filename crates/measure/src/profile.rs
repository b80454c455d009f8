//! Contact steps along a path of the grasped object, with the time and the wrench of each.

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
    /// About the centre of mass, world axes.
    pub states: Vec<BodyState>,
    /// Time from one to the next, s.
    pub period: f64,
}

impl BodyPath {
    /// The states that the contact queries of an experiment saw.
    pub fn of(trace: &Trace) -> Self {
        Self {
            states: trace.queries.iter().map(|query| query.body).collect(),
            period: 1.0 / trace.contact_rate,
        }
    }

    /// Only so many of the states that there are no more than `rate` (Hz) a second.
    #[must_use]
    pub fn thinned_to(&self, rate: f64) -> Self {
        let every = (1.0 / (rate * self.period)).ceil().max(1.0);
        let states = self.states.iter().step_by(every as usize).copied().collect();
        Self { states, period: every * self.period }
    }
}

/// What contact steps along a path gave and took, a value a state.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// The contact wrench on the object, about its centre of mass: N, N·m.
    pub wrenches: Vec<Wrench>,
    /// Deepest penetration, m; 0 when disjoint.
    pub depths: Vec<f64>,
    /// Contacts before clustering.
    pub contacts: Vec<u32>,
    /// Time of the contact step, the least of all rounds, s.
    pub times: Vec<f64>,
    /// Memory: of the objects' hierarchies, and of the workspaces of queries.
    pub bytes: usize,
}

impl Profile {
    /// Goes along the path `rounds` times, each time from a fresh start; wrenches are those of the first.
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

    /// A quantile of the times where there is contact, s.
    pub fn time(&self, fraction: f64) -> f64 {
        let touching: Vec<f64> = self.touching().filter_map(|index| self.times.get(index).copied()).collect();
        quantile(&touching, fraction)
    }

    /// Where there is contact.
    pub fn touching(&self) -> impl Iterator<Item = usize> {
        self.contacts.iter().enumerate().filter(|(_, contacts)| **contacts > 0).map(|(index, _)| index)
    }
}

/// States a second at which the depth of a trace is looked at, Hz.
const DEPTH_RATE: f64 = 100.0;

/// The deepest penetration in a trace with contacts as `exact` finds them, m.
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
    // Where the object was held back, the proxy is not where it was.
    let exact = Settings { search: SearchSettings { proxy: false, ..exact.search }, ..*exact };
    Ok(Profile::along(&path, probe, scene, &exact, 1)?.depths.into_iter().fold(0.0, f64::max))
}

/// The contact loop of a session with these settings.
///
/// # Errors
/// If a setting is refused.
pub fn contact_loop(probe: &Object, scene: &Scene, settings: &Settings) -> Result<ContactLoop, MeasureError> {
    let here = Keyframe { time: 0.0, pose: Pose::IDENTITY };
    let still = ReplayDevice::new("still", MotionPath::new(vec![here], Interpolation::Linear)?);
    let renderer = HapticRenderer::new(probe.clone(), scene.clone(), Box::new(still), *settings)?;
    Ok(renderer.into_loops().1)
}

/// Memory of hierarchies prepared for queries; of objects that share one, once each.
fn object_bytes(probe: &Object, scene: &Scene) -> usize {
    let objects = scene.objects().iter().map(|placed| &placed.object);
    std::iter::once(probe)
        .chain(objects)
        .map(|object| object.clod.total_bytes() + object.shape().bytes())
        .sum()
}
