//! Contact queries along recorded paths, exact and with detail left out: force profile, query time, and the
//! front of the bounding volume test tree (§3.5.3, Figs. 3.15 and 3.16).
//!
//! As in the dissertation, a penalty force k (δ + d) acts at each cluster of the contacts, without a virtual
//! coupling.

use std::path::Path;
use std::time::Instant;

use palpate::collide::{Clustering, ContactQuery, QuerySettings};
use palpate::device::{Interpolation, MotionPath, Task};
use palpate::dynamics::IntegratorKind;
use palpate::glam::DVec3;
use palpate::settings::{ContactSettings, DetailSettings};
use palpate::{Object, Pose, Scene, Settings, explore};
use palpate_report::{Curve, Figure, draw};

use super::outcome::{Finding, Reproduction};
use super::rendering::open;
use crate::stability::page::{Table, row};
use palpate_benches::scenarios;
use palpate_measure::{Experiment, correlation};

/// Number of contact clusters (§5.5.1).
const CLUSTERS: usize = 5;
/// Number of timings of each path; the shortest time of each pose counts.
const TIMES: usize = 3;
/// Tolerance d relative to the probe's radius.
const TOLERANCE: f64 = 0.01;

/// Pair of objects with a path, and thresholds s₀ relative to a radius, the first 0.
struct Benchmark {
    title: &'static str,
    probe: &'static str,
    scene: &'static str,
    errors: [f64; 4],
    /// Whether the thresholds are relative to the scene object's radius, else the probe's.
    of_scene: bool,
    /// Claim, and the factors by which it says that query time and front shrink.
    claim: &'static str,
    faster: f64,
    smaller: f64,
    /// Remark for the page.
    note: &'static str,
}

/// Force, time and front of the queries at one threshold, by pose.
#[derive(Clone, Debug)]
struct Profile {
    /// Sum of the penalty forces for a stiffness of 1, m.
    force: Vec<f64>,
    /// Query times, s.
    time: Vec<f64>,
    front: Vec<f64>,
}

impl Profile {
    fn of(probe: &Object, scene: &Object, poses: &[Pose], error: f64) -> Self {
        let tolerance = TOLERANCE * probe.bounding_radius();
        let settings = QuerySettings { error: error.into(), ..QuerySettings::new(tolerance) };
        let (mut force, mut front) = (Vec::new(), Vec::new());
        let mut time = vec![f64::INFINITY; poses.len()];
        for round in 0..TIMES {
            let mut query = ContactQuery::new(probe.shape(), scene.shape());
            let mut clustering = Clustering::new(CLUSTERS);
            for (pose, least) in poses.iter().zip(&mut time) {
                let begun = Instant::now();
                let outcome = query.run(pose, &Pose::IDENTITY, &settings).expect("valid poses and settings");
                *least = least.min(begun.elapsed().as_secs_f64());
                if round == 0 {
                    let clusters = clustering.run(query.contacts(), tolerance, pose);
                    let push = clusters.iter().map(|cluster| {
                        -cluster.contact.normal * (cluster.contact.depth + tolerance).max(0.0)
                    });
                    force.push(push.sum::<DVec3>().length());
                    front.push(outcome.front as f64);
                }
            }
        }
        Self { force, time, front }
    }
}

/// Comparison of the largest threshold with exact queries, where there is contact.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Found {
    /// Correlation of the force profiles.
    correlation: f64,
    /// Ratios of the medians of time and front, exact to coarse.
    faster: f64,
    smaller: f64,
}

impl Found {
    fn of(exact: &Profile, coarse: &Profile) -> Self {
        let touching = |values: &[f64]| -> Vec<f64> {
            values
                .iter()
                .zip(&exact.force)
                .filter(|(_, force)| **force > 0.0)
                .map(|(value, _)| *value)
                .collect()
        };
        let ratio = |of: fn(&Profile) -> &[f64]| median(touching(of(exact))) / median(touching(of(coarse)));
        Self {
            correlation: correlation(&touching(&exact.force), &touching(&coarse.force)),
            faster: ratio(|profile| &profile.time),
            smaller: ratio(|profile| &profile.front),
        }
    }

    fn is_as_claimed(&self, benchmark: &Benchmark) -> bool {
        self.correlation > 0.9 && self.faster >= benchmark.faster && self.smaller >= benchmark.smaller
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

const JAWS: Benchmark = Benchmark {
    title: "Contact profile for moving jaws (Fig. 3.15)",
    probe: "upper-jaw",
    scene: "lower-jaw",
    errors: [0.0, 0.0025, 0.01, 0.025],
    of_scene: false,
    claim: "Force profiles are similar with thresholds up to 2.5 % of the jaws' radii, queries up to two orders of magnitude faster, and \
            the front is smaller by more than a factor of 10.",
    faster: 10.0,
    smaller: 10.0,
    note: ", where the dissertation's took more than 100 ms on a machine of 2004, so that there is less left to gain",
};

/// Benchmark on the dental casts of the scenario of the same name.
const CASTS: Benchmark = Benchmark {
    title: "Contact profile for dental casts, as that for jaws (Fig. 3.15)",
    probe: "dental_cast_upper.obj",
    scene: "dental_cast_lower.obj",
    claim: "The same of scanned dental casts.",
    note: "",
    ..JAWS
};

const GOLF: Benchmark = Benchmark {
    title: "Contact profile for the golf scene (Fig. 3.16)",
    probe: "golf-club",
    scene: "golf-ball",
    errors: [0.0, 0.003, 0.01, 0.03],
    of_scene: true,
    claim: "Force profiles are nearly identical with thresholds up to 3 % of the ball's radius, queries nearly two orders of magnitude \
            faster, and the front is smaller by nearly a factor of 100.",
    faster: 10.0,
    smaller: 10.0,
    note: "",
};

/// Repeats Fig. 3.15 on the recorded trajectory of the jaws.
///
/// # Errors
/// If a model cannot be built, the trajectory cannot be read, or the plot cannot be drawn.
pub fn jaws(name: &str) -> Result<Reproduction, String> {
    let file = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../assets/trajectories/jaws.csv"));
    let path = MotionPath::load(file, Interpolation::Smooth).map_err(|error| error.to_string())?;
    let poses = path.keyframes().iter().map(|keyframe| keyframe.pose).collect::<Vec<_>>();
    reproduce(name, &JAWS, &open(JAWS.probe)?, &open(JAWS.scene)?, &poses)
}

/// Repeats Fig. 3.15 on scanned dental casts; `None` if their files are absent.
///
/// # Errors
/// The same as [`jaws`].
pub fn casts(name: &str) -> Result<Option<Reproduction>, String> {
    let scenario = scenarios::open("dental-casts").map_err(|error| error.to_string())?;
    let made = scenario.map(|scenario| {
        let poses: Vec<Pose> = scenario.poses.iter().step_by(10).copied().collect();
        reproduce(name, &CASTS, &scenario.probe.object, &scenario.scene.object, &poses)
    });
    made.transpose()
}

/// Repeats Fig. 3.16, with a hand that taps the ball with the club.
///
/// # Errors
/// The same as [`jaws`].
pub fn golf(name: &str) -> Result<Reproduction, String> {
    let (club, ball) = (open(GOLF.probe)?, open(GOLF.scene)?);
    let poses = tapping(&club, &ball, &GOLF)?;
    reproduce(name, &GOLF, &club, &ball, &poses)
}

/// Records the probe's poses, 100 per second, in three seconds of a session in which an emulated hand taps
/// with it. The session uses the largest threshold.
fn tapping(probe: &Object, object: &Object, benchmark: &Benchmark) -> Result<Vec<Pose>, String> {
    let scene = Scene::new().with(object.clone(), Pose::IDENTITY);
    let intended = explore::path(Task::Tap, probe, &scene).map_err(|error| error.to_string())?;
    let settings = Settings {
        contact: ContactSettings::penalties(ContactSettings::default().stiffness),
        detail: DetailSettings {
            error: benchmark.errors[3] * benchmark.radius(probe, object),
            ..DetailSettings::default()
        },
        ..Settings::default()
    };
    let session = Experiment {
        probe,
        scene: &scene,
        settings,
        integrator: IntegratorKind::default(),
        contact_rate: 500.0,
        frozen: false,
        seconds: 3.0,
    };
    let trace = session.emulate(intended).map_err(|error| error.to_string())?;
    Ok(trace.samples.iter().step_by(10).map(|sample| sample.record.object).collect())
}

impl Benchmark {
    fn radius(&self, probe: &Object, scene: &Object) -> f64 {
        if self.of_scene { scene.bounding_radius() } else { probe.bounding_radius() }
    }
}

fn reproduce(
    name: &str,
    benchmark: &Benchmark,
    probe: &Object,
    scene: &Object,
    poses: &[Pose],
) -> Result<Reproduction, String> {
    let radius = benchmark.radius(probe, scene);
    let profiles = benchmark.errors.map(|error| Profile::of(probe, scene, poses, error * radius));
    let found = Found::of(&profiles[0], &profiles[3]);
    let named = |error: f64| if error == 0.0 { "exact".to_owned() } else { format!("{} %", 100.0 * error) };
    let figure = |axis: &str, scale: f64, of: fn(&Profile) -> &[f64]| Figure {
        caption: String::new(),
        across: "pose".to_owned(),
        axis: axis.to_owned(),
        curves: benchmark
            .errors
            .iter()
            .zip(&profiles)
            .map(|(error, profile)| Curve {
                name: named(*error),
                points: (0..).map(f64::from).zip(of(profile).iter().map(|value| scale * value)).collect(),
            })
            .collect(),
    };
    let figures = [
        figure("|F|/k, mm", 1e3, |profile| &profile.force),
        figure("query, µs", 1e6, |profile| &profile.time),
        figure("front, pairs", 1.0, |profile| &profile.front),
    ];
    let rows = benchmark.errors.iter().zip(&profiles).flat_map(|(error, profile)| {
        (0..poses.len()).map(move |pose| row![*error, pose, profile.force[pose], profile.front[pose]])
    });
    let times = benchmark.errors.iter().zip(&profiles).flat_map(|(error, profile)| {
        profile.time.iter().enumerate().map(move |(pose, time)| row![*error, pose, 1e6 * time])
    });
    let exact = median(profiles[0].time.clone());
    Ok(Reproduction {
        finding: Finding {
            claim: benchmark.claim.to_owned(),
            measured: format!(
                "{}, {} poses: with {} force profiles correlate by {:.3} where there is contact, queries are {:.1} times faster by their \
                 medians and fronts {:.1} times smaller. The exact query takes {:.0} µs{}.",
                benchmark.title,
                poses.len(),
                named(benchmark.errors[3]),
                found.correlation,
                found.faster,
                found.smaller,
                1e6 * exact,
                benchmark.note
            ),
            condition: format!(
                "With the largest threshold force profiles correlate by more than 0.9, and time and front are smaller by factors of {} and {}.",
                benchmark.faster, benchmark.smaller
            ),
            holds: found.is_as_claimed(benchmark),
        },
        table: Table {
            name: name.to_owned(),
            columns: vec!["error", "pose", "force_m", "front"],
            rows: rows.collect(),
        },
        timing: Some(Table {
            name: format!("{name}-time"),
            columns: vec!["error", "pose", "query_us"],
            rows: times.collect(),
        }),
        plot: draw(&figures).map_err(|error| error.to_string())?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Left-out detail makes fronts smaller. Without it, or on a path without contact, the claim does not
    /// hold.
    #[test]
    fn fronts_are_smaller_with_detail_left_out() {
        let (probe, scene) =
            (Object::model("ellipsoid@500").unwrap(), Object::model("golf-ball@20000").unwrap());
        let poses = tapping(&probe, &scene, &GOLF).unwrap();
        let [exact, coarse] =
            [0.0, 0.05].map(|error| Profile::of(&probe, &scene, &poses, error * scene.bounding_radius()));
        let found = Found::of(&exact, &coarse);
        assert!(found.correlation > 0.5 && found.smaller > 1.1, "{found:?}");
        let same = Found::of(&exact, &exact);
        assert!((same.correlation - 1.0).abs() < 1e-9 && !same.is_as_claimed(&GOLF), "{same:?}");
        let away: Vec<Pose> =
            poses.iter().map(|pose| Pose::from_translation(pose.translation + DVec3::Z)).collect();
        let nowhere = Profile::of(&probe, &scene, &away, 0.0);
        assert!(!Found::of(&nowhere, &nowhere).is_as_claimed(&GOLF));
    }
}
