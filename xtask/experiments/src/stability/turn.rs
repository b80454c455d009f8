//! Map of the rotations of the coupling that are recovered from.

use palpate::Pose;
use palpate::dynamics::Body;
use palpate::glam::{DMat3, DQuat, DVec3};
use palpate_report::{CellAxis, HeatMap};

use super::body::{MEASURED, all_stable, measured, port};
use super::geometry::Geometry;
use super::grid::{Plan, logarithmic, pairs};
use super::page::{Picture, Section, Table, Verdict, row};
use super::rig::Rig;
use palpate_measure::Outcome;

/// Moments of inertia of a body of 1 kg, kg·m²: those of a slab of 80 × 50 × 20 mm.
const MOMENTS: DVec3 = DVec3::new(2.417e-4, 5.667e-4, 7.417e-4);
/// Time that a rotation has to come back, s: a kilogram held outside itself is slow on so soft a spring.
const DURATION: f64 = 12.0;
/// Rotation below which the coupling counts as recovered, rad.
const MAX_REMAINING: f64 = 1e-3;

/// Largest rotation that has to be recovered from, degrees. Beyond it the spring is weak; it vanishes at half
/// a turn.
const MAX_RECOVERED: f64 = 170.0;

/// Makes the map.
///
/// # Errors
/// If a case cannot be simulated.
pub fn map(plan: &Plan) -> Result<Section, String> {
    let degrees = plan.choose(
        &[10.0, 30.0, 60.0, 90.0, 120.0, 150.0, 170.0, 175.0, 179.0, 179.9, 180.0],
        &[30.0, 90.0, 170.0, 180.0],
    );
    let masses = logarithmic(1e-3, 1.0, if plan.quick { 3 } else { 10 });
    let arms = plan.choose(&[0.0, 0.05, 0.3], &[0.0]);
    let cells = pairs(&masses, &degrees);
    let cases = pairs(&arms, &cells);
    let results = plan.each("turn", &cases, |&(arm, (mass, degrees)): &(f64, (f64, f64))| {
        let body =
            Body::new(mass, DMat3::from_diagonal(MOMENTS * mass)).map_err(|error| error.to_string())?;
        let grasp = Pose::from_translation(DVec3::X * arm);
        let mut rig = Rig::new(body, grasp, 1000.0, Geometry::Free);
        rig.duration = DURATION;
        let axis = DVec3::new(0.3, -0.5, 0.8).normalize();
        rig.start = Pose::new(DVec3::ZERO, DQuat::from_axis_angle(axis, degrees.to_radians()));
        // The hand holds the handle upright at the grasp of the rotated body.
        let held = (rig.start * grasp).translation;
        rig.run_held(Pose::from_translation(held).into())
    })?;
    let maps = arms.iter().zip(results.chunks(cells.len())).map(|(arm, results)| HeatMap {
        title: format!("held at {arm} m"),
        x: CellAxis { name: "turn, degrees".to_owned(), values: degrees.clone() },
        y: CellAxis { name: "mass, kg".to_owned(), values: masses.clone() },
        cells: results
            .iter()
            .map(|result| if result.deviation.1 <= MAX_REMAINING { result.outcome.shade() } else { 1.0 })
            .collect(),
        legend: Outcome::legend(),
        boundaries: Vec::new(),
    });
    let rows = cases.iter().zip(&results).map(|(&(arm, (mass, degrees)), result)| {
        [row![arm, mass, degrees, result.deviation.0, result.deviation.1], measured(result)].concat()
    });
    let columns = [vec!["lever_arm_m", "mass_kg", "turn_deg", "left_m", "left_rad"], MEASURED.to_vec()];
    let held = || {
        cases
            .iter()
            .zip(&results)
            .filter(|((_, (_, degrees)), _)| *degrees <= MAX_RECOVERED)
            .map(|(_, result)| result)
    };
    let away = held().filter(|result| result.deviation.1 > MAX_REMAINING).count();
    let worst = held().fold(0.0, |most: f64, result| most.max(result.deviation.1));
    Ok(Section {
        title: "Turn: up to half a turn of the coupling",
        paragraphs: vec![
            "A slab, held at its centre of mass or outside it, starts turned away from the handle about an axis that is \
             none of its own, and is let go in free space; the hand holds the handle. The angular spring fades from 150° on, so \
             that its torque does not change sides at a half turn, where nothing is left of it."
                .to_owned(),
        ],
        pictures: vec![Picture {
            name: "turn".to_owned(),
            caption: "Turn by mass; dark where more than a milliradian is left in the end.".to_owned(),
            maps: maps.collect(),
            columns: 3,
        }],
        tables: vec![Table { name: "turn".to_owned(), columns: columns.concat(), rows: rows.collect() }],
        verdicts: vec![
            all_stable("every turn", &results),
            Verdict::new(
                format!("every turn up to {MAX_RECOVERED}° comes back to within a milliradian in {DURATION} s"),
                away == 0,
                format!("{away} of {} do not; the most left is {worst:.2e} rad", held().count()),
            ),
            port(&results),
        ],
    })
}
