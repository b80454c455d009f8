//! Map of the number of contacts of a flat block by their stiffness.

use palpate::Pose;
use palpate::dynamics::Body;
use palpate::glam::{DMat3, Vec3Swizzles};
use palpate_report::{CellAxis, HeatMap};

use super::body::{MEASURED, all_stable, measured, port};
use super::geometry::{BLOCK, Geometry};
use super::grid::{Plan, logarithmic, pairs};
use super::page::{Picture, Section, Table, Verdict, row};
use super::pressing;
use super::rig::Rig;
use palpate_measure::Outcome;

/// Mass of the block, kg, and number of clusters K.
const MASS: f64 = 0.1;
const CLUSTERS: usize = 5;

/// Returns a solid block with the sides of [`BLOCK`].
fn block() -> Result<Body, String> {
    let squares = (2.0 * BLOCK).powf(2.0);
    let moments = (squares.yzx() + squares.zxy()) * (MASS / 12.0);
    Body::new(MASS, DMat3::from_diagonal(moments)).map_err(|error| error.to_string())
}

/// Makes the map.
///
/// # Errors
/// If a case cannot be simulated.
pub fn map(plan: &Plan) -> Result<Section, String> {
    let counts = plan.choose(&[1, 2, 3, 4, 5, 7, 10, 20, 50, 100, 200, 500, 1000], &[1, 5, 30, 1000]);
    let stiffness = logarithmic(100.0, 1e5, if plan.quick { 3 } else { 13 });
    let cases = pairs(&stiffness, &counts);
    let results = plan.each("contacts", &cases, |&(stiffness, count)| {
        let geometry = Geometry::underside(count, CLUSTERS);
        Rig::new(block()?, Pose::IDENTITY, stiffness, geometry).run(pressing::path)
    })?;
    let columns = [vec!["contacts", "stiffness_n_m"], MEASURED.to_vec()].concat();
    let rows = cases
        .iter()
        .zip(&results)
        .map(|((stiffness, count), result)| [row![count, stiffness], measured(result)].concat());
    let width = counts.len();
    let softest = &results[..width];
    let (least, most) = softest.iter().skip(1).fold((f64::INFINITY, 0.0), |(least, most): (f64, f64), r| {
        (least.min(r.held_force), most.max(r.held_force))
    });
    Ok(Section {
        title: "Contacts: how many",
        paragraphs: vec![format!(
            "A block of 100 × 100 × 20 mm and 100 g is pressed flat onto a plane that it touches at 1 to 1,000 points of \
             its underside, which are condensed to {CLUSTERS} clusters, and rubbed and held as the balls are. On the \
             softest contacts the held force is {:.3} N on one point and {least:.3} to {most:.3} N on more.",
            softest[0].held_force
        )],
        pictures: vec![Picture {
            name: "contacts".to_owned(),
            caption: "Number of contacts by contact stiffness.".to_owned(),
            maps: vec![HeatMap {
                title: format!("flat block, {CLUSTERS} clusters"),
                x: CellAxis {
                    name: "contacts".to_owned(),
                    values: counts.iter().map(|&count| count as f64).collect(),
                },
                y: CellAxis { name: "contact stiffness, N/m".to_owned(), values: stiffness.clone() },
                cells: results.iter().map(|result| result.outcome.shade()).collect(),
                legend: Outcome::legend(),
                boundaries: Vec::new(),
            }],
            columns: 1,
        }],
        tables: vec![Table { name: "contacts".to_owned(), columns, rows: rows.collect() }],
        verdicts: vec![
            all_stable("every number of contacts and stiffness", &results),
            Verdict::new(
                "a thousand contacts are felt no more than five times as stiff as one",
                results
                    .chunks(width)
                    .all(|row| row[width - 1].held_force <= CLUSTERS as f64 * row[0].held_force + 1e-9),
                "by the forces held at each stiffness",
            ),
            port(&results),
        ],
    })
}
