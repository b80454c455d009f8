//! Picks settings that keep contact steps within a time, by trying them on the objects themselves.
//!
//! An emulated hand moves the probe in the scene at full resolution, in a session in which no contact step takes longer than the
//! haptic period, and does the same with each [`Choice`]. Contact steps are timed along the path that the probe then took; where
//! they take longer than the haptic period, the session is repeated with as few of them as there is time for. The wrenches sent to
//! the device are compared with those at full resolution; those of representative contacts, which push by another law, with those
//! of the finest. So, besides, are contact wrenches at the same states of the object, but that is not what is felt: an object whose
//! surface is a little off is held a little elsewhere, by nearly the same force. Of the choices whose 99th percentile keeps within
//! the time, the one is picked that feels most like its reference.

use palpate::device::{IntendedPath, MotionPath, Task};
use palpate::dynamics::IntegratorKind;
use palpate::representative::FINEST_ERROR;
use palpate::settings::{ContactSearch, DetailSettings, SearchSettings};
use palpate::{Object, Scene, Settings, explore};
use serde::Serialize;

use crate::difference::Difference;
use crate::error::MeasureError;
use crate::experiment::{Experiment, Trace};
use crate::margin::{pressed, stability_margin};
use crate::profile::{BodyPath, Profile, penetration};
use crate::statistics::quantile;

/// Thresholds s₀ that are tried, as parts of the probe's bounding radius.
const ERRORS: [f64; 7] = [0.0, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1];
/// Parts of the time that queries are given when they are to stop by themselves, the rest of the step taking some as well, and the
/// threshold that they stop at in any case.
const BUDGETS: [f64; 2] = [0.4, 0.7];
const BUDGET_ERROR: f64 = ERRORS[1];
/// The least that they are given, s.
const LEAST_BUDGET: f64 = 1e-6;
/// Sides of grids that textured contacts are looked at on, texels.
const GRIDS: [u32; 4] = [100, 50, 25, 12];
/// States a second of the path that contact steps are timed along, Hz, and how often each choice goes along it.
const PATH_RATE: f64 = 500.0;
const ROUNDS: usize = 2;

/// What is asked for.
#[derive(Clone, Debug)]
pub struct Request<'a> {
    /// The object in the hand.
    pub probe: &'a Object,
    /// What it touches.
    pub scene: &'a Scene,
    /// All that is not up for choice, the haptic rate among it.
    pub settings: Settings,
    /// Time that a contact step may take, s.
    pub budget: f64,
    /// How long the hand moves the probe, s.
    pub seconds: f64,
    /// What the hand does.
    pub hand: Hand,
}

/// What a hand does with the probe.
#[derive(Clone, Debug, PartialEq)]
pub enum Hand {
    /// A task where the probe first touches the scene.
    Task(Task),
    /// It means the probe's mesh frame to be there.
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

/// A session that others are compared with.
struct Reference {
    trace: Trace,
    /// The states that its contact queries saw, at most [`PATH_RATE`] a second.
    path: BodyPath,
    /// Contact steps along it.
    profile: Profile,
}

/// What is up for choice.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Choice {
    /// How contacts are found.
    pub search: ContactSearch,
    /// s₀, m.
    pub error: f64,
    /// Whether forces go over smoothly between levels of detail.
    pub interpolation: bool,
    /// Time that a contact query may take, s.
    pub query_budget: Option<f64>,
    /// Texels along a side of a textured contact's grid, where an object is textured.
    pub grid: Option<u32>,
}

/// Full resolution.
const FULL: Choice =
    Choice { search: ContactSearch::Levels, error: 0.0, interpolation: true, query_budget: None, grid: None };

/// What a choice costs and buys.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Measured {
    /// The choice.
    pub choice: Choice,
    /// Median time of a contact step in contact, s.
    pub median: f64,
    /// 99th percentile of the same, s.
    pub p99: f64,
    /// Hierarchies and workspaces.
    pub bytes: usize,
    /// Of the contact wrench from that at full resolution, or of the finest representative contacts, at the same states of the object.
    pub rendered: Difference,
    /// Of the wrench at the device from that of a session at full resolution, or with the finest representative contacts, with the
    /// same hand.
    pub felt: Difference,
    /// Deepest penetration in the session, at full resolution, m.
    pub penetration: f64,
    /// Contact steps a second in the session, Hz: as many as the 99th percentile allows, at most the haptic rate.
    pub contact_rate: f64,
    /// Whether the 99th percentile keeps within the time.
    pub fits: bool,
}

/// What is recommended, and what it rests on.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Recommendation {
    /// The choice of those that fit that feels most like full resolution; if none fits, the fastest.
    pub chosen: Measured,
    /// All that were tried.
    pub tried: Vec<Measured>,
    /// 99.9th percentile of the haptic step with reading and writing the emulated device, s.
    pub haptic_step: f64,
    /// Whether that keeps within the haptic period.
    pub haptic_fits: bool,
    /// By which power of two contacts could be stiffer ([`stability_margin`]).
    pub stability_margin: f64,
}

impl Choice {
    /// The settings with this choice.
    pub fn applied_to(&self, settings: &Settings) -> Settings {
        let mut chosen = Settings {
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
    /// How far the wrench at the device is off, as a part of its reference's root mean square: the largest of the mean differences
    /// of force and of torque, and of the vibration that there is more of.
    pub fn felt_error(&self) -> f64 {
        let Difference { force, torque } = self.felt;
        force.relative().max(torque.relative())
    }
}

/// What can be chosen between for objects: thresholds s₀ with and without interpolation, and queries that stop in time, where an
/// object has levels of detail; grids where one is textured, and representative contacts where none is and all are closed.
pub fn choices(probe: &Object, scene: &Scene, budget: f64) -> Vec<Choice> {
    let objects = || std::iter::once(probe).chain(scene.objects().iter().map(|placed| &placed.object));
    let full = FULL;
    let mut choices = Vec::new();
    if objects().any(|object| object.clod.levels.len() > 1) {
        let radius = probe.bounding_radius();
        for error in ERRORS {
            let smooth = Choice { error: error * radius, ..full };
            choices.push(smooth);
            if error > 0.0 {
                choices.push(Choice { interpolation: false, ..smooth });
            }
        }
        let error = BUDGET_ERROR * radius;
        let within =
            |part: f64| Choice { error, query_budget: Some((part * budget).max(LEAST_BUDGET)), ..full };
        choices.extend(BUDGETS.map(within));
    } else {
        choices.push(full);
    }
    if objects().any(|object| object.texture().is_some()) {
        choices = choices
            .into_iter()
            .flat_map(|choice| GRIDS.map(|grid| Choice { grid: Some(grid), ..choice }))
            .collect();
    } else if objects().all(|object| object.clod.source.solid) {
        choices.push(Choice { search: ContactSearch::Representatives, ..full });
    }
    choices
}

/// Tries the [`choices`] and picks one; `progress` is told how much is done, from 0 to 1.
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
        let own = BodyPath::of(&trace).thinned_to(PATH_RATE);
        let timed = Profile::along(&own, probe, scene, &chosen, ROUNDS)?;
        let p99 = timed.time(0.99);
        let contact_rate = (1.0 / p99).min(settings.timing.rate);
        let trace = if contact_rate < settings.timing.rate { render(chosen, contact_rate)? } else { trace };
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

/// Of those that fit the one that feels most like full resolution, of two that feel alike the first, which leaves out less; the
/// fastest where none fits.
fn pick(tried: &[Measured]) -> Measured {
    let mut fitting = tried.iter().filter(|measured| measured.fits).peekable();
    let best = if fitting.peek().is_some() {
        fitting.min_by(|x, y| x.felt_error().total_cmp(&y.felt_error()))
    } else {
        tried.iter().min_by(|x, y| x.p99.total_cmp(&y.p99))
    };
    // There is one: a choice at least is always tried.
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
            // Steps that are preempted now and then, by other tests, keep within such a period all the same.
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
    fn with_time_enough_full_resolution_is_recommended() {
        let found = recommended(0.1);
        assert_eq!(found.chosen.felt_error(), 0.0, "{:?}", found.chosen);
        assert_eq!(found.chosen.choice.error, 0.0, "{:?}", found.chosen);
        assert!(found.chosen.fits && found.haptic_step > 0.0, "{:?}", found.chosen);
        assert!(found.stability_margin >= 1.0, "{found:?}");
        let by_fields = |measured: &&Measured| measured.choice.search == ContactSearch::Representatives;
        let represented = found.tried.iter().find(by_fields).expect("both are closed");
        assert!(represented.felt.force.correlation > 0.9, "{represented:?}");
        // Not everything is as good.
        assert!(found.tried.iter().any(|measured| measured.felt_error() > 0.0), "{:?}", found.tried);
    }

    #[test]
    fn where_nothing_fits_the_fastest_is_told_with_that() {
        let found = recommended(1e-9);
        assert!(!found.chosen.fits && found.tried.iter().all(|measured| !measured.fits));
        let fastest = found.tried.iter().map(|measured| measured.p99).fold(f64::INFINITY, f64::min);
        assert_eq!(found.chosen.p99, fastest);
    }

    #[test]
    fn of_those_that_fit_the_nearest_is_picked() {
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
    fn a_hull_on_a_hull_leaves_no_choice() {
        let probe = Object::model("ellipsoid@100").expect("a model");
        let scene = Scene::new().with(probe.clone(), Pose::IDENTITY);
        let levels = probe.clod.levels.len();
        let by_levels = choices(&probe, &scene, 1e-3);
        let by_levels = by_levels.iter().filter(|choice| choice.search == ContactSearch::Levels);
        assert_eq!(by_levels.count() == 1, levels == 1, "{levels} levels");
    }
}
