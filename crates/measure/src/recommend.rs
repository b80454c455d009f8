//! Recommendation of settings that keep contact steps within a time, from trials on the objects themselves.
//!
//! An emulated hand moves the probe in the scene at full resolution, in a session in which each contact step
//! takes a haptic period, and does the same with each [`Choice`]. Contact steps are timed along the path of
//! the probe in that session. If they take longer than the haptic period, the session is repeated at the
//! contact rate that they permit. The wrenches sent to the device are compared with those at full resolution;
//! for representative contacts, which have another force law, with those of the finest representative
//! contacts. Contact wrenches at the same states of the object are compared as well, but the hand does not
//! feel that difference: an object with a slightly different surface is held at a slightly different place by
//! nearly the same force. Of the choices whose 99th percentile keeps within the time, the one closest to its
//! reference is picked.

use palpate::device::{IntendedPath, MotionPath, Task};
use palpate::dynamics::IntegratorKind;
use palpate::representative::FINEST_ERROR;
use palpate::settings::{ContactSearch, ContactSettings, DetailSettings, Response, SearchSettings};
use palpate::{Object, Scene, Settings, explore};
use serde::Serialize;

use crate::difference::Difference;
use crate::error::MeasureError;
use crate::experiment::{Experiment, Trace};
use crate::margin::{pressed, stability_margin};
use crate::profile::{BodyPath, Profile, penetration};
use crate::statistics::quantile;

/// Error thresholds s₀ that are tried, as parts of the probe's bounding radius.
const ERROR_RATIOS: [f64; 7] = [0.0, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1];
/// Query budgets of time-critical queries that are tried, as parts of the time for a contact step, whose
/// other work also takes time.
const BUDGET_SHARES: [f64; 2] = [0.4, 0.7];
/// Error threshold of time-critical queries, as a part of the probe's bounding radius.
const BUDGET_ERROR_RATIO: f64 = ERROR_RATIOS[1];
/// Smallest query budget, s.
const MIN_BUDGET: f64 = 1e-6;
/// Sides of textured contacts' grids that are tried, texels.
const GRID_SIDES: [u32; 4] = [100, 50, 25, 12];
/// Rate of states of the path along which contact steps are timed, Hz.
const PATH_RATE: f64 = 500.0;
/// Number of times that each choice is timed along it.
const TIMING_ROUNDS: usize = 2;

/// Request for a recommendation.
#[derive(Clone, Debug)]
pub struct Request<'a> {
    /// Grasped object.
    pub probe: &'a Object,
    /// Scene that it touches.
    pub scene: &'a Scene,
    /// Settings that are not chosen, including the haptic rate.
    pub settings: Settings,
    /// Time that a contact step may take, s.
    pub budget: f64,
    /// Duration of the hand's motion, s.
    pub seconds: f64,
    /// Motion of the hand.
    pub hand: Hand,
}

/// Motion of the hand that holds the probe.
#[derive(Clone, Debug, PartialEq)]
pub enum Hand {
    /// A task at the place where the probe first touches the scene.
    Task(Task),
    /// Intended poses of the probe's mesh frame.
    Path(MotionPath),
}

impl Hand {
    fn intended(&self, probe: &Object, scene: &Scene) -> Result<IntendedPath, MeasureError> {
        Ok(match self {
            Self::Task(task) => explore::path(*task, probe, scene)?,
            Self::Path(path) => path.clone().into(),
        })
    }
}

/// Session with which others are compared.
struct Reference {
    trace: Trace,
    /// States at its contact queries, at most [`PATH_RATE`] per second.
    path: BodyPath,
    /// Contact steps along that path.
    profile: Profile,
}

/// Settings that are chosen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Choice {
    /// Method of contact search.
    pub search: ContactSearch,
    /// Error threshold s₀, m.
    pub error: f64,
    /// Whether forces are interpolated between levels of detail.
    pub interpolation: bool,
    /// Time limit of a contact query, s.
    pub query_budget: Option<f64>,
    /// Number of texels along a side of a textured contact's grid; `None` if no object is textured.
    pub grid: Option<u32>,
}

/// Choice of full resolution.
const FULL: Choice =
    Choice { search: ContactSearch::Levels, error: 0.0, interpolation: true, query_budget: None, grid: None };

/// Cost and accuracy of a choice.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Measured {
    /// The choice.
    pub choice: Choice,
    /// Median time of a contact step in contact, s.
    pub median: f64,
    /// 99th percentile of that time, s.
    pub p99: f64,
    /// Memory of hierarchies and workspaces, bytes.
    pub bytes: usize,
    /// Difference of the contact wrench from that of the reference at the same states of the object. The
    /// reference is full resolution, or the finest representative contacts.
    pub rendered: Difference,
    /// Difference of the wrench at the device from that of the reference session with the same hand.
    pub felt: Difference,
    /// Deepest penetration in the session, at full resolution, m.
    pub penetration: f64,
    /// Contact rate of the session, Hz: as high as the 99th percentile allows, at most the haptic rate.
    pub contact_rate: f64,
    /// Whether the 99th percentile is within the time.
    pub fits: bool,
}

/// A recommendation with the measurements behind it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Recommendation {
    /// Recommended choice: of those that fit, the one whose felt error is smallest; if none fits, the
    /// fastest.
    pub chosen: Measured,
    /// All choices that were tried.
    pub tried: Vec<Measured>,
    /// 99.9th percentile of the haptic step, including reading and writing the emulated device, s.
    pub haptic_step: f64,
    /// Whether that is within the haptic period.
    pub haptic_fits: bool,
    /// Factor by which contacts could be stiffer ([`stability_margin`]).
    pub stability_margin: f64,
}

impl Choice {
    /// Returns settings with this choice, for penalty contacts: constraints have one resolution.
    pub fn applied_to(&self, settings: &Settings) -> Settings {
        let mut chosen = Settings {
            contact: ContactSettings { response: Response::Penalty, ..settings.contact },
            search: SearchSettings { method: self.search, ..settings.search },
            detail: DetailSettings {
                error: self.error,
                interpolation: self.interpolation,
                query_budget: self.query_budget,
            },
            ..*settings
        };
        chosen.textures.grid = self.grid.unwrap_or(settings.textures.grid);
        chosen
    }
}

impl Measured {
    /// Returns the relative error of the wrench at the device: the largest of the mean differences and
    /// additional vibrations of force and torque, as parts of the reference's root mean square.
    pub fn felt_error(&self) -> f64 {
        let Difference { force, torque } = self.felt;
        force.relative().max(torque.relative())
    }
}

/// Returns the choices for objects. If an object has levels of detail: thresholds s₀ with and without
/// interpolation, and time-critical queries. If one is textured: grids. If none is, and all are closed:
/// representative contacts.
pub fn choices(probe: &Object, scene: &Scene, budget: f64) -> Vec<Choice> {
    let objects = || std::iter::once(probe).chain(scene.objects().iter().map(|placed| &placed.object));
    let full = FULL;
    let mut choices = Vec::new();
    if objects().any(|object| object.clod.levels.len() > 1) {
        let radius = probe.bounding_radius();
        for error in ERROR_RATIOS {
            let smooth = Choice { error: error * radius, ..full };
            choices.push(smooth);
            if error > 0.0 {
                choices.push(Choice { interpolation: false, ..smooth });
            }
        }
        let error = BUDGET_ERROR_RATIO * radius;
        let within =
            |share: f64| Choice { error, query_budget: Some((share * budget).max(MIN_BUDGET)), ..full };
        choices.extend(BUDGET_SHARES.map(within));
    } else {
        choices.push(full);
    }
    if objects().any(|object| object.texture().is_some()) {
        choices = choices
            .into_iter()
            .flat_map(|choice| GRID_SIDES.map(|grid| Choice { grid: Some(grid), ..choice }))
            .collect();
    } else if objects().all(|object| object.clod.source.solid) {
        choices.push(Choice { search: ContactSearch::Representatives, ..full });
    }
    choices
}

/// Tries the [`choices`] and picks one; `progress` gets the share that is done, from 0 to 1.
///
/// # Errors
/// If a setting is refused, or the probe does not touch the scene on the hand's path.
pub fn recommend(
    request: &Request<'_>,
    mut progress: impl FnMut(f64),
) -> Result<Recommendation, MeasureError> {
    let Request { probe, scene, settings, budget, seconds, hand } = request;
    let choices = choices(probe, scene, *budget);
    let stages = choices.len() as f64 + 2.0;
    let exact_choice = Choice { grid: choices[0].grid, ..FULL };
    let exact_settings = exact_choice.applied_to(settings);
    let render = |settings: Settings, contact_rate: f64| -> Result<Trace, MeasureError> {
        let seconds = *seconds;
        let integrator = IntegratorKind::default();
        Experiment { probe, scene, settings, integrator, contact_rate, frozen: false, seconds }
            .emulate(hand.intended(probe, scene)?)
    };
    let reference = |exact: &Settings| -> Result<Reference, MeasureError> {
        let trace = render(*exact, settings.timing.rate)?;
        let path = BodyPath::of(&trace).thinned_to(PATH_RATE);
        let profile = Profile::along(&path, probe, scene, exact, 1)?;
        Ok(Reference { trace, path, profile })
    };
    let by_levels = reference(&exact_settings)?;
    if by_levels.profile.touching().next().is_none() {
        let scene = scene.objects().first().map_or_else(String::new, |placed| placed.object.name.clone());
        return Err(MeasureError::NoContact { probe: probe.name.clone(), scene });
    }
    // Representative contacts are compared with the finest ones, not with contact levels of detail.
    let represented = choices.iter().find(|choice| choice.search == ContactSearch::Representatives);
    let finest = represented.map(|choice| Settings {
        search: SearchSettings {
            representative_error: Some(FINEST_ERROR * probe.bounding_radius()),
            ..choice.applied_to(settings).search
        },
        ..choice.applied_to(settings)
    });
    let by_fields = finest.map(|finest| reference(&finest)).transpose()?;
    progress(1.0 / stages);

    let mut tried = Vec::with_capacity(choices.len());
    for choice in choices {
        let chosen = choice.applied_to(settings);
        let trace = render(chosen, settings.timing.rate)?;
        // Time contact steps along the choice's own path; if they are too slow, repeat at the rate that they
        // permit.
        let own = BodyPath::of(&trace).thinned_to(PATH_RATE);
        let timed = Profile::along(&own, probe, scene, &chosen, TIMING_ROUNDS)?;
        let p99 = timed.time(0.99);
        let contact_rate = (1.0 / p99).min(settings.timing.rate);
        let trace = if contact_rate < settings.timing.rate { render(chosen, contact_rate)? } else { trace };
        // Compare with the reference at the same states, and what the hand feels over the session.
        let finest = by_fields.as_ref().filter(|_| choice.search == ContactSearch::Representatives);
        let Reference { trace: exact_trace, path, profile: exact } = finest.unwrap_or(&by_levels);
        let same = Profile::along(path, probe, scene, &chosen, 1)?;
        tried.push(Measured {
            choice,
            median: timed.time(0.5),
            p99,
            bytes: timed.bytes,
            rendered: Difference::of(&same, exact, 1.0 / path.period),
            felt: Difference::felt(&trace, exact_trace),
            penetration: penetration(&trace, probe, scene, &exact_settings)?,
            contact_rate,
            fits: p99 <= *budget,
        });
        progress((1 + tried.len()) as f64 / stages);
    }
    let chosen = pick(&tried);

    let settings = chosen.choice.applied_to(settings);
    let held = pressed(&by_levels.trace, &by_levels.path, &by_levels.profile, probe);
    let stability_margin =
        stability_margin(probe, scene, (&settings, IntegratorKind::default()), held, chosen.contact_rate)?;
    let haptic_step = quantile(&by_levels.trace.step_times, 0.999);
    progress(1.0);
    Ok(Recommendation {
        chosen,
        tried,
        haptic_step,
        haptic_fits: haptic_step <= 1.0 / settings.timing.rate,
        stability_margin,
    })
}

/// Picks, of the choices that fit, the one with the smallest felt error; of equal ones the first, which
/// leaves out less. If none fits, the fastest.
fn pick(tried: &[Measured]) -> Measured {
    let mut fitting = tried.iter().filter(|measured| measured.fits).peekable();
    let best = if fitting.peek().is_some() {
        fitting.min_by(|x, y| x.felt_error().total_cmp(&y.felt_error()))
    } else {
        tried.iter().min_by(|x, y| x.p99.total_cmp(&y.p99))
    };
    // At least one choice is always tried.
    #[expect(clippy::expect_used, reason = "choices are never none")]
    *best.expect("a choice was tried")
}

#[cfg(test)]
mod tests {
    use palpate::Pose;

    use super::*;
    use palpate::settings::TimingSettings;

    fn pair() -> (Object, Scene) {
        let probe = Object::model("ellipsoid@500").expect("a model");
        let scene = Scene::new().with(Object::model("golf-ball@5000").expect("a model"), Pose::IDENTITY);
        (probe, scene)
    }

    fn recommended(budget: f64) -> Recommendation {
        let (probe, scene) = pair();
        let request = Request {
            probe: &probe,
            scene: &scene,
            // The period is so long that steps stay within it even if other tests preempt them.
            settings: Settings {
                timing: TimingSettings { rate: 200.0, ..TimingSettings::default() },
                ..Settings::default()
            },
            budget,
            seconds: 1.5,
            hand: Hand::Task(Task::default()),
        };
        let mut last = 0.0;
        let found = recommend(&request, |done| {
            assert!(done > last && done <= 1.0, "{last} {done}");
            last = done;
        });
        assert_eq!(last, 1.0);
        found.expect("they touch")
    }

    #[test]
    fn full_resolution_is_recommended_if_there_is_time() {
        let found = recommended(0.1);
        assert_eq!(found.chosen.felt_error(), 0.0, "{:?}", found.chosen);
        assert_eq!(found.chosen.choice.error, 0.0, "{:?}", found.chosen);
        assert!(found.chosen.fits && found.haptic_step > 0.0, "{:?}", found.chosen);
        assert!(found.stability_margin >= 1.0, "{found:?}");
        let by_fields = |measured: &&Measured| measured.choice.search == ContactSearch::Representatives;
        let represented = found.tried.iter().find(by_fields).expect("both are closed");
        assert!(represented.felt.force.correlation > 0.9, "{represented:?}");
        // Other choices are worse.
        assert!(found.tried.iter().any(|measured| measured.felt_error() > 0.0), "{:?}", found.tried);
    }

    #[test]
    fn fastest_choice_is_recommended_if_none_fits() {
        let found = recommended(1e-9);
        assert!(!found.chosen.fits && found.tried.iter().all(|measured| !measured.fits));
        let fastest = found.tried.iter().map(|measured| measured.p99).fold(f64::INFINITY, f64::min);
        assert_eq!(found.chosen.p99, fastest);
    }

    #[test]
    fn most_accurate_choice_that_fits_is_picked() {
        let measured = |p99: f64, mean: f64, fits: bool| {
            let force = crate::Deviation { exact_rms: 1.0, mean, ..crate::Deviation::default() };
            let felt = Difference { force, ..Difference::default() };
            let choice = Choice { error: mean, ..FULL };
            Measured {
                choice,
                median: p99,
                p99,
                bytes: 0,
                rendered: felt,
                felt,
                penetration: 0.0,
                contact_rate: 1000.0,
                fits,
            }
        };
        let tried = [
            measured(9.0, 0.0, false),
            measured(3.0, 0.1, true),
            measured(2.0, 0.1, true),
            measured(1.0, 0.5, true),
        ];
        assert_eq!(pick(&tried).p99, 3.0);
    }

    #[test]
    fn objects_without_levels_leave_no_choice() {
        let probe = Object::model("ellipsoid@100").expect("a model");
        let scene = Scene::new().with(probe.clone(), Pose::IDENTITY);
        let levels = probe.clod.levels.len();
        let by_levels = choices(&probe, &scene, 1e-3);
        let by_levels = by_levels.iter().filter(|choice| choice.search == ContactSearch::Levels);
        assert_eq!(by_levels.count() == 1, levels == 1, "{levels} levels");
    }
}
