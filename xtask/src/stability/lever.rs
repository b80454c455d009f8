//! Bodies held far from their centre of mass.

use palpate::Pose;
use palpate::dynamics::Body;
use palpate::glam::{DMat3, DVec3};
use palpate_report::{CellAxis, HeatMap};

use super::body::{MEASURED, all_stable, measured, port};
use super::geometry::{BALL, Geometry};
use super::grid::{Plan, logarithmic, pairs};
use super::judge::Outcome;
use super::page::{Picture, Section, Table, row};
use super::pressing;
use super::rig::Rig;

/// Mass of the tool, kg.
const MASS: f64 = 0.1;

/// A tool: a ball whose handle is a rod of length `arm` (m) along z or x, on four feet.
fn tool(arm: f64, along: bool) -> Result<(Body, Pose, Geometry), String> {
    let (thin, wide) = (0.4 * MASS * BALL * BALL, 0.4 * MASS * BALL * BALL + MASS * arm * arm / 12.0);
    let (moments, grasp) = if along {
        (DVec3::new(wide, wide, thin), DVec3::Z * arm)
    } else {
        (DVec3::new(thin, wide, wide), DVec3::X * arm)
    };
    let body = Body::new(MASS, DMat3::from_diagonal(moments)).map_err(|error| error.to_string())?;
    let feet = [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)];
    let feet = feet.map(|(x, y)| DVec3::new(x, y, -1.0) * BALL).to_vec();
    Ok((body, Pose::from_translation(grasp), Geometry::Points(feet)))
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
        Rig::new(body, grasp, stiffness, geometry).run(pressing::path)
    })?;
    let name = |along: bool| if along { "pressed along the handle" } else { "pressed across the handle" };
    let maps = [true, false].into_iter().zip(results.chunks(cells.len())).map(|(along, results)| HeatMap {
        title: name(along).to_owned(),
        x: CellAxis { name: "lever arm, m".to_owned(), values: arms.clone() },
        y: CellAxis { name: "contact stiffness, N/m".to_owned(), values: stiffness.clone() },
        cells: results.iter().map(|result| result.outcome.shade()).collect(),
        legend: Outcome::legend(),
        boundaries: Vec::new(),
    });
    let rows = cases.iter().zip(&results).map(|(&(along, (stiffness, arm)), result)| {
        [row![name(along), arm, stiffness], measured(result)].concat()
    });
    let columns = [vec!["press", "lever_arm_m", "stiffness_n_m"], MEASURED.to_vec()].concat();
    Ok(Section {
        title: "Lever: long tools",
        paragraphs: vec![
            "A tool of 100 g on four feet, 20 mm apart, is held at the end of a handle of up to a metre and pressed \
             onto a plane, along its handle (where it is an inverted pendulum) and across it (where it is a lever)."
                .to_owned(),
        ],
        pictures: vec![Picture {
            name: "lever".to_owned(),
            caption: "Lever arm by contact stiffness.".to_owned(),
            maps: maps.collect(),
            columns: 2,
        }],
        tables: vec![Table { name: "lever".to_owned(), columns, rows: rows.collect() }],
        verdicts: vec![all_stable("every lever arm and stiffness", &results), port(&results)],
    })
}
