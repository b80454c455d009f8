//! Levels at contacts of a spoon that falls fast and slides slowly, with the velocity-dependent metric (Fig.
//! 3.18).

use palpate::Pose;
use palpate::collide::{ContactQuery, PatchContact, QuerySettings};
use palpate::core::Clod;
use palpate_report::{Curve, Figure, draw};
use palpate_rigid_body::QuerySample;

use super::{FRAMES, Metric, Scenario};
use crate::reproduce::outcome::{Finding, Reproduction};
use crate::stability::page::{Table, row};

/// Relative speed from which a contact belongs to the fall, m/s.
const MIN_FALL_SPEED: f64 = 0.5;
/// Range of relative speeds that belong to the slide, m/s. Below it the spoon rests and moves by
/// micro-collisions alone.
const SLIDE_SPEEDS: [f64; 2] = [0.01, 0.05];
/// Number of levels by which the finest contact of the slide has to be finer than the mean of the fall.
const MIN_FINER_LEVELS: f64 = 4.0;
/// Ratio of polygon counts that counts as roughly ten times as many.
const MIN_POLYGON_RATIO: f64 = 5.0;

/// Deepest contact of a query during the fall or the slide.
#[derive(Clone, Copy, Debug)]
struct Seen {
    /// Time, s.
    time: f64,
    /// Relative speed of the surfaces, m/s.
    speed: f64,
    /// Levels of spoon and cup, 0 being the finest.
    levels: [u32; 2],
    /// Sum of the triangles of these levels.
    triangles: u32,
}

impl Seen {
    fn of(scenario: &Scenario, sample: &QuerySample, contact: &PatchContact) -> Self {
        let level = |clod: &Clod, node: u32| clod.node(node).level;
        let (spoon, cup) = (&scenario.spoon.clod, &scenario.cup.clod);
        let levels = [level(spoon, contact.probe_node), level(cup, contact.scene_node)];
        let triangles = |clod: &Clod, level: u32| clod.levels[level as usize].triangles;
        let arm = contact.contact.point - sample.pose.translation;
        Self {
            time: sample.time,
            speed: sample.twist.velocity_at(arm).length(),
            levels,
            triangles: triangles(spoon, levels[0]) + triangles(cup, levels[1]),
        }
    }
}

/// Returns the deepest contacts of the queries along a path, repeated with a metric.
fn seen(scenario: &Scenario, path: &[Vec<QuerySample>], metric: Metric) -> Vec<Seen> {
    let mut query = ContactQuery::new(scenario.spoon.shape(), scenario.cup.shape());
    let mut seen = Vec::new();
    for sample in path.iter().flatten() {
        let error = scenario.error(metric, sample.twist);
        let settings = QuerySettings { error, ..QuerySettings::new(scenario.tolerance()) };
        query.run(&sample.pose, &Pose::IDENTITY, &settings).expect("valid poses and settings");
        let deepest = query.contacts().iter().max_by(|x, y| x.contact.depth.total_cmp(&y.contact.depth));
        seen.extend(deepest.map(|contact| Seen::of(scenario, sample, contact)));
    }
    seen
}

/// Comparison of the contacts of the fall and of the slide.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Found {
    contacts: [usize; 2],
    /// Mean levels of each body, spoon and cup.
    levels: [[f64; 2]; 2],
    /// Largest number of levels by which a contact of the slide is finer, on either body, than the mean of
    /// the fall.
    finer: f64,
    /// Mean triangles of the levels in the slide over those in the fall.
    polygons: f64,
}

impl Found {
    fn of(seen: &[Seen]) -> Self {
        let falls: Vec<&Seen> = seen.iter().filter(|seen| seen.speed >= MIN_FALL_SPEED).collect();
        let slides: Vec<&Seen> =
            seen.iter().filter(|seen| (SLIDE_SPEEDS[0]..=SLIDE_SPEEDS[1]).contains(&seen.speed)).collect();
        let mean = |of: &[&Seen], value: &dyn Fn(&Seen) -> f64| {
            of.iter().map(|seen| value(seen)).sum::<f64>() / of.len() as f64
        };
        let levels = [&falls, &slides]
            .map(|of| [0, 1].map(|body: usize| mean(of, &|seen| f64::from(seen.levels[body]))));
        let finer = |body: usize| {
            let finest = slides.iter().map(|seen| f64::from(seen.levels[body])).fold(f64::INFINITY, f64::min);
            levels[0][body] - finest
        };
        let triangles = |of: &[&Seen]| mean(of, &|seen| f64::from(seen.triangles));
        Self {
            contacts: [falls.len(), slides.len()],
            levels,
            finer: finer(0).max(finer(1)),
            polygons: triangles(&slides) / triangles(&falls),
        }
    }

    fn is_as_claimed(&self) -> bool {
        self.contacts.iter().all(|count| *count > 0)
            && self.finer >= MIN_FINER_LEVELS
            && self.polygons >= MIN_POLYGON_RATIO
    }
}

/// Repeats Fig. 3.18.
///
/// # Errors
/// If a model cannot be built, the fall cannot be simulated, or the plot cannot be drawn.
pub fn reproduce(name: &str) -> Result<Reproduction, String> {
    let scenario = Scenario::open("spoon", "cup")?;
    let path = scenario.fall(Metric::Velocity, FRAMES)?;
    let along = seen(&scenario, &path, Metric::Velocity);
    let found = Found::of(&along);
    let constant = Found::of(&seen(&scenario, &path, Metric::Haptic));
    let curve = |name: &str, value: &dyn Fn(&Seen) -> f64| Curve {
        name: name.to_owned(),
        points: along.iter().map(|seen| (seen.time, value(seen))).collect(),
    };
    let figure = |axis: &str, curves| Figure {
        caption: String::new(),
        across: "s".to_owned(),
        axis: axis.to_owned(),
        curves,
    };
    let figures = [
        figure("speed, m/s", vec![curve("at the contact", &|seen| seen.speed)]),
        figure(
            "level",
            vec![
                curve("spoon", &|seen| f64::from(seen.levels[0])),
                curve("cup", &|seen| f64::from(seen.levels[1])),
            ],
        ),
        figure("triangles", vec![curve("of these levels", &|seen| f64::from(seen.triangles))]),
    ];
    let rows = along
        .iter()
        .map(|seen| row![seen.time, seen.speed, seen.levels[0], seen.levels[1], seen.triangles])
        .collect();
    let Found { contacts, levels, finer, polygons } = found;
    Ok(Reproduction {
        finding: Finding {
            claim: "With the velocity-dependent metric coarse levels are selected where the spoon falls quickly into the cup, and levels up \
                    to 4 finer where it slides slowly along its side, with polygon counts that differ roughly by a factor of 10."
                .to_owned(),
            measured: format!(
                "s₀ is 3.5 % of the radius at 1 m/s. {} queries with contact at {MIN_FALL_SPEED} m/s or more use levels {:.1} of the spoon and {:.1} \
                 of the cup on average, {} at {} to {} m/s levels {:.1} and {:.1}: up to {finer:.1} finer, with {polygons:.1} times as \
                 many triangles. With a constant metric on the same path these are {:.1} and {:.1}.",
                contacts[0],
                levels[0][0],
                levels[0][1],
                contacts[1],
                SLIDE_SPEEDS[0],
                SLIDE_SPEEDS[1],
                levels[1][0],
                levels[1][1],
                constant.finer,
                constant.polygons,
            ),
            condition: format!(
                "At some contact of the slide a level is finer by {MIN_FINER_LEVELS} or more than the fall's mean, and the slide's levels have \
                 {MIN_POLYGON_RATIO} or more times as many triangles."
            ),
            holds: found.is_as_claimed(),
        },
        table: Table {
            name: name.to_owned(),
            columns: vec!["t", "speed", "spoon_level", "cup_level", "triangles"],
            rows,
        },
        timing: None,
        plot: draw(&figures).map_err(|error| error.to_string())?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_constant_metric_shows_no_difference_of_levels() {
        let scenario = Scenario::open("spoon@20000", "cup@20000").unwrap();
        let path = scenario.fall(Metric::Velocity, 20).unwrap();
        let constant = Found::of(&seen(&scenario, &path, Metric::Haptic));
        assert!(constant.contacts.iter().all(|count| *count > 0), "{constant:?}");
        assert!(!constant.is_as_claimed() && constant.polygons < 2.0, "{constant:?}");
        let exact = Found::of(&seen(&scenario, &path, Metric::Exact));
        assert!(exact.finer <= 0.0 && !exact.is_as_claimed(), "{exact:?}");
    }

    #[test]
    fn each_part_of_the_claim_is_required() {
        let contact = |speed, level, triangles| Seen { time: 0.0, speed, levels: [level, 0], triangles };
        let claimed = |contacts: &[Seen]| Found::of(contacts).is_as_claimed();
        let (fall, slide) = (contact(1.0, 6, 1000), contact(0.02, 1, 9000));
        assert!(claimed(&[fall, fall, slide]));
        assert!(!claimed(&[fall, contact(0.02, 3, 9000)]), "not fine enough");
        assert!(!claimed(&[fall, contact(0.02, 1, 3000)]), "not enough polygons");
        assert!(!claimed(&[fall]) && !claimed(&[slide]), "nothing to compare");
        assert!(!claimed(&[fall, contact(0.001, 1, 9000)]), "it rests");
    }
}
