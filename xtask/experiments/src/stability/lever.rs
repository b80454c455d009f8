//! Map of bodies held far from their centre of mass.

use palpate::Pose;
use palpate::dynamics::Body;
use palpate::glam::{DMat3, DVec3};
use palpate_report::{CellAxis, HeatMap};

use super::body::{MEASURED, all_stable, measured, port, stable};
use super::geometry::{BALL, Geometry};
use super::grid::{Plan, logarithmic, pairs};
use super::page::{Picture, Section, Table, row};
use super::pressing;
use super::rig::{Rig, RigResult};
use palpate_measure::Outcome;

/// Mass of the tool, kg.
const MASS: f64 = 0.1;

/// Simulated time, s: a long tool is slow on so soft a spring.
const DURATION: f64 = 6.0;

/// Returns a tool on four feet: a ball whose handle is a rod of length `arm` (m) along z or x.
fn tool(arm: f64, along: bool) -> Result<(Body, Pose, Geometry), String> {
    let (thin, wide) = (0.4 * MASS * BALL * BALL, 0.4 * MASS * BALL * BALL + MASS * arm * arm / 12.0);
    let (moments, grasp) = if along {
        (DVec3::new(wide, wide, thin), DVec3::Z * arm)
    } else {
        (DVec3::new(thin, wide, wide), DVec3::X * arm)
    };
    let body = Body::new(MASS, DMat3::from_diagonal(moments)).map_err(|error| error.to_string())?;
    let feet = [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)];
    let feet = feet.map(|(x, y)| DVec3::new(FOOT * x, FOOT * y, -BALL)).to_vec();
    Ok((body, Pose::from_translation(grasp), Geometry::Points(feet)))
}

/// Distance of the feet from the tool's axis, m.
const FOOT: f64 = BALL;

/// Returns whether statics predicts that a tool buckles when it is pressed along its handle. Its feet slide,
/// so the pressing force F turns it by a torque F ℓ per radian, against the springs of coupling and hand in
/// series and those of the feet. F follows from the springs in series between hand and plane.
fn buckles(rig: &Rig, along: bool, arm: f64, stiffness: f64) -> bool {
    let hand = rig.emulation.hand;
    let series = |a: f64, b: f64| 1.0 / (1.0 / a + 1.0 / b);
    let feet = 4.0 * stiffness;
    let pressed = series(series(hand.stiffness, rig.coupling.linear_stiffness), feet)
        * (pressing::PRESS + rig.parameters.tolerance);
    let held = series(hand.angular_stiffness, rig.coupling.angular_stiffness) + feet * FOOT * FOOT;
    along && pressed * arm > held
}

/// Makes the map.
///
/// # Errors
/// If a case cannot be simulated.
pub fn map(plan: &Plan) -> Result<Section, String> {
    let arms = plan.choose(&[0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0], &[0.0, 0.05, 0.3, 1.0]);
    let stiffness = logarithmic(100.0, 1e5, if plan.quick { 3 } else { 13 });
    let cells = pairs(&stiffness, &arms);
    let cases = pairs(&[true, false], &cells);
    let results = plan.each("lever", &cases, |&(along, (stiffness, arm))| {
        let (body, grasp, geometry) = tool(arm, along)?;
        let rig = Rig { duration: DURATION, ..Rig::new(body, grasp, stiffness, geometry) };
        let buckles = buckles(&rig, along, arm, stiffness);
        Ok((rig.run(pressing::path)?, buckles))
    })?;
    let (results, buckling): (Vec<RigResult>, Vec<bool>) = results.into_iter().unzip();
    let of = |kind: bool| -> Vec<RigResult> {
        results
            .iter()
            .zip(&buckling)
            .filter(|(_, buckles)| **buckles == kind)
            .map(|(result, _)| *result)
            .collect()
    };
    let (held, buckled) = (of(false), of(true));
    let name = |along: bool| if along { "pressed along the handle" } else { "pressed across the handle" };
    let maps = [true, false].into_iter().zip(results.chunks(cells.len())).map(|(along, results)| HeatMap {
        title: name(along).to_owned(),
        x: CellAxis { name: "lever arm, m".to_owned(), values: arms.clone() },
        y: CellAxis { name: "contact stiffness, N/m".to_owned(), values: stiffness.clone() },
        cells: results.iter().map(|result| result.outcome.shade()).collect(),
        legend: Outcome::legend(),
        boundaries: Vec::new(),
    });
    let rows =
        cases.iter().zip(&results).zip(&buckling).map(|((&(along, (stiffness, arm)), result), buckles)| {
            [row![name(along), arm, stiffness, *buckles], measured(result)].concat()
        });
    let columns =
        [vec!["press", "lever_arm_m", "stiffness_n_m", "buckles_by_statics"], MEASURED.to_vec()].concat();
    Ok(Section {
        title: "Lever: long tools",
        paragraphs: vec![format!(
            "A tool of 100 g on four feet, 20 mm apart, is held at the end of a handle of up to a metre and pressed \
             onto a plane, along its handle (where it is an inverted pendulum) and across it (where it is a lever), for \
             {DURATION} s. Its feet slide without friction: where the pressing force times the lever arm exceeds what \
             the springs of hand, coupling and feet hold against a turn, it buckles, by statics alone. That is so of {} \
             tools, of which {} do not come to rest.",
            buckled.len(),
            buckled.len() - stable(&buckled)
        )],
        pictures: vec![Picture {
            name: "lever".to_owned(),
            caption: "Lever arm by contact stiffness.".to_owned(),
            maps: maps.collect(),
            columns: 2,
        }],
        tables: vec![Table { name: "lever".to_owned(), columns, rows: rows.collect() }],
        verdicts: vec![all_stable("every tool that statics does not let buckle", &held), port(&results)],
    })
}
