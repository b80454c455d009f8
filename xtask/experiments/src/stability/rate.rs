//! Map of the contact thread's rate, with the linearised contact model and without it.

use palpate_report::{CellAxis, HeatMap};

use super::body::{MEASURED, MIN_PORT_ENERGY, all_stable, measured, port, stable};
use super::geometry::Geometry;
use super::grid::{Plan, logarithmic, pairs};
use super::page::{Picture, Section, Table, Verdict, row};
use super::pressing;
use super::rig::{Rig, RigResult, ball};
use palpate_measure::Outcome;

/// Mass of the ball, kg.
const MASS: f64 = 0.1;

/// Makes the map.
///
/// # Errors
/// If a case cannot be simulated.
pub fn map(plan: &Plan) -> Result<Section, String> {
    let rates = plan.choose(
        &[20.0, 50.0, 100.0, 200.0, 300.0, 500.0, 1000.0, 2000.0, 5000.0],
        &[20.0, 100.0, 500.0, 2000.0],
    );
    let stiffness = logarithmic(100.0, 1e5, if plan.quick { 4 } else { 13 });
    let cells = pairs(&stiffness, &rates);
    let kinds: Vec<(bool, (&str, Geometry))> = pairs(
        &[false, true],
        &[("plane", Geometry::Plane), ("ball", Geometry::Bump), ("groove", Geometry::Groove)],
    );
    let cases = pairs(&kinds, &cells);
    let results = plan.each("rate", &cases, |((frozen, (_, geometry)), (stiffness, rate))| {
        let rig = Rig::new(ball(MASS)?, palpate::Pose::IDENTITY, *stiffness, geometry.clone());
        Rig { frozen: *frozen, contact_rate: *rate, ..rig }.run(pressing::path)
    })?;
    let name = |frozen: bool| if frozen { "force frozen between queries" } else { "linearised model" };
    let maps = kinds.iter().zip(results.chunks(cells.len())).map(|((frozen, (shape, _)), results)| HeatMap {
        title: format!("{shape}, {}", name(*frozen)),
        x: CellAxis { name: "contact rate, Hz".to_owned(), values: rates.clone() },
        y: CellAxis { name: "contact stiffness, N/m".to_owned(), values: stiffness.clone() },
        cells: results.iter().map(|result| result.outcome.shade()).collect(),
        legend: Outcome::legend(),
        boundaries: Vec::new(),
    });
    let rows = cases.iter().zip(&results).map(|(((frozen, (shape, _)), (stiffness, rate)), result)| {
        [row![shape, name(*frozen), rate, stiffness], measured(result)].concat()
    });
    let columns = [vec!["shape", "model", "contact_rate_hz", "stiffness_n_m"], MEASURED.to_vec()].concat();
    let (linearised, frozen): (&[RigResult], &[RigResult]) = results.split_at(3 * cells.len());
    let fastest = |bad: &dyn Fn(&RigResult) -> bool| {
        let pairs = cases.iter().zip(linearised).filter(|(_, result)| bad(result));
        pairs.fold(0.0, |most: f64, ((_, (_, rate)), _)| most.max(*rate))
    };
    let unstable = fastest(&|result| !result.outcome.is_stable());
    let giving = fastest(&|result| result.port_energy < MIN_PORT_ENERGY);
    Ok(Section {
        title: "Rate: contact thread by contact stiffness",
        paragraphs: vec![format!(
            "A ball of 100 g is pressed, rubbed and held as in the map of bodies, on a plane, on a ball of 20 mm radius \
             and in a groove of 12 mm radius, where the plane of a contact ages as the ball moves on. Each query \
             takes its whole period; the haptic loop runs at 1 kHz, or as fast as the queries. With the linearised \
             model {} of {} cases are stable; with the force frozen between queries, which is what the model is there \
             to replace, {} of {}. With the linearised model \
             every case is stable at rates above {unstable} Hz, and gives back no more than 1 mJ above {giving} Hz.",
            stable(linearised),
            linearised.len(),
            stable(frozen),
            frozen.len()
        )],
        pictures: vec![Picture {
            name: "rate".to_owned(),
            caption: "Contact rate by contact stiffness; above with the linearised model, below without it."
                .to_owned(),
            maps: maps.collect(),
            columns: 3,
        }],
        tables: vec![Table { name: "rate".to_owned(), columns, rows: rows.collect() }],
        verdicts: vec![
            all_stable("every rate, stiffness and shape with the linearised model", linearised),
            Verdict::new(
                "the linearised model is stable in more cases than the frozen force",
                stable(linearised) > stable(frozen),
                format!("{} against {}", stable(linearised), stable(frozen)),
            ),
            port(linearised),
        ],
    })
}
