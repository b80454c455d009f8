//! Map of the grasped body's mass by the stiffness of its contacts, for each integrator.

use palpate::dynamics::{Integrator as _, IntegratorKind};
use palpate_report::{CellAxis, HeatMap};

use super::geometry::Geometry;
use super::grid::{Plan, logarithmic, pairs};
use super::page::{Picture, Section, Table, Verdict, row};
use super::rig::{Rig, RigResult, ball};
use super::{pressing, rig};
use palpate_measure::Outcome;

/// Lower bound on the observed energy at the port, J.
pub const MIN_PORT_ENERGY: f64 = -1e-3;

/// Makes the map.
///
/// # Errors
/// If a case cannot be simulated.
pub fn map(plan: &Plan) -> Result<Section, String> {
    let masses = logarithmic(1e-4, 1.0, if plan.quick { 5 } else { 17 });
    let stiffness = logarithmic(100.0, 1e5, if plan.quick { 4 } else { 13 });
    let cells = pairs(&stiffness, &masses);
    let cases = pairs(&IntegratorKind::ALL, &cells);
    let results = plan.each("body", &cases, |&(integrator, (stiffness, mass))| {
        let body = ball(mass)?;
        let rig = Rig::new(body, palpate::Pose::IDENTITY, stiffness, Geometry::Plane);
        Rig { integrator, ..rig }.run(pressing::path)
    })?;
    let chunks = || IntegratorKind::ALL.iter().zip(results.chunks(cells.len()));
    let maps = chunks().map(|(integrator, results)| HeatMap {
        title: integrator.name().to_owned(),
        x: CellAxis { name: "mass, kg".to_owned(), values: masses.clone() },
        y: CellAxis { name: "contact stiffness, N/m".to_owned(), values: stiffness.clone() },
        cells: results.iter().map(|result| result.outcome.shade()).collect(),
        legend: Outcome::legend(),
        boundaries: Vec::new(),
    });
    let rows = cases.iter().zip(&results).map(|(&(integrator, (stiffness, mass)), result)| {
        [row![integrator.name(), mass, stiffness], measured(result)].concat()
    });
    let columns = [vec!["integrator", "mass_kg", "stiffness_n_m"], MEASURED.to_vec()].concat();
    let (_, engine) = chunks().next().ok_or("no integrator")?;
    Ok(Section {
        title: "Body: mass by contact stiffness",
        paragraphs: vec![format!(
            "A ball of 10 mm radius, held by the default device at 1 kHz with a relaxed grip, is pressed onto a plane, \
             rubbed over it and held still for {:.2} s. Contacts are queried at 500 Hz, each answer in use from 2 ms \
             after the state that it saw, and damped critically. Judged as the walls are, by the last second. With the \
             engine's step {} of {} bodies are stable; the largest force sent is {:.2} N.",
            rig::DURATION - 0.75,
            stable(engine),
            engine.len(),
            engine.iter().fold(0.0, |most: f64, result| most.max(result.largest_force))
        )],
        pictures: vec![Picture {
            name: "body".to_owned(),
            caption: "Mass by contact stiffness, a map an integrator.".to_owned(),
            maps: maps.collect(),
            columns: 3,
        }],
        tables: vec![Table { name: "body".to_owned(), columns, rows: rows.collect() }],
        verdicts: vec![all_stable("every mass and contact stiffness", engine), port(engine)],
    })
}

/// Returns the number of bodies that came to rest.
pub fn stable(results: &[RigResult]) -> usize {
    results.iter().filter(|result| result.outcome.is_stable()).count()
}

/// Returns the verdict that all bodies came to rest, and no step was refused.
pub fn all_stable(what: &str, results: &[RigResult]) -> Verdict {
    let refused: u64 = results.iter().map(|result| result.refused).sum();
    Verdict::new(
        format!("{what} is stable, and no step is refused"),
        !results.is_empty() && stable(results) == results.len() && refused == 0,
        format!("{} of {} are; {refused} steps refused", stable(results), results.len()),
    )
}

/// Returns the verdict that no stable session has given back energy.
pub fn port(results: &[RigResult]) -> Verdict {
    let stable = || results.iter().filter(|result| result.outcome.is_stable());
    let least = stable().map(|result| result.port_energy).fold(0.0, f64::min);
    let under = stable().filter(|result| result.port_energy < MIN_PORT_ENERGY).count();
    Verdict::new(
        "the energy at the port stays above −1 mJ in every stable session",
        under == 0,
        format!("{under} of {} go below; the least is {:.4} mJ", stable().count(), 1e3 * least),
    )
}

/// Columns of the tables of simulations.
pub const MEASURED: [&str; 7] = [
    "outcome",
    "amplitude_m",
    "largest_force_n",
    "held_force_n",
    "largest_torque_nm",
    "port_energy_min_j",
    "refused",
];

pub fn measured(result: &RigResult) -> Vec<String> {
    row![
        result.outcome.word(),
        result.amplitude,
        result.largest_force,
        result.held_force,
        result.largest_torque,
        result.port_energy,
        result.refused,
    ]
}
