//! Map of pegs that are held aslant by a hand that trembles.

use palpate::device::{Emulation, Hand, IntendedPath};
use palpate::glam::{DQuat, DVec3};
use palpate::models::PegFit;
use palpate::{HandlePlacement, Pose, Twist};
use palpate_report::{CellAxis, HeatMap};

use super::super::grid::{Plan, pairs};
use super::super::page::{Picture, Section, Table, Verdict, row};
use super::exact::Exact;
use super::{MAX_DEPTH, Part, Response, responses, session};

/// Height of the tip above the mouth at the start, and depth of the insertion, m.
const ABOVE: f64 = 3e-3;
const INSERTION: f64 = 12e-3;
/// Share of the depth from which an insertion counts as complete.
const COMPLETE: f64 = 0.9;
/// Times until which the hand pushes, and until which it holds, s.
const PUSH_END: f64 = 1.5;
const HOLD_END: f64 = 2.4;
/// Tremor of the hand, m to each side, at the frequency of [`Hand`]'s.
const TREMOR: f64 = 3e-4;
/// Friction of steel that is lightly oiled.
const FRICTION: f64 = 0.1;

#[derive(Clone)]
struct Case {
    response: Response,
    fit: usize,
    tremor: f64,
    /// Degrees.
    tilt: f64,
}

#[derive(Clone, Copy, Debug)]
struct Inserted {
    depth: f64,
    deepest: f64,
    largest: (f64, f64),
    port_energy: f64,
    refused: u64,
}

/// Makes the map.
///
/// # Errors
/// If a mesh cannot be made, or a session cannot start.
pub fn map(plan: &Plan) -> Result<Section, String> {
    let clearances = plan.choose(&[2e-5, 5e-5, 2e-4], &[5e-5]);
    let tilts = plan.choose(&[0.0, 1.0, 2.0], &[0.0, 2.0]);
    let tremors = [0.0, TREMOR];
    let fits = plan.each("fits", &clearances, |clearance| parts(*clearance))?;
    let indices: Vec<usize> = (0..fits.len()).collect();
    let responses = responses();
    let cells = pairs(&indices, &tilts);
    let cases: Vec<Case> = pairs(&pairs(&responses, &tremors), &cells)
        .into_iter()
        .map(|((response, tremor), (fit, tilt))| Case { response, fit, tremor, tilt })
        .collect();
    let found = plan.each("insertion", &cases, |case| insert(case, &fits[case.fit]))?;
    let judged = &found[found.len() - tremors.len() * cells.len()..];
    let maps = pairs(&responses, &tremors).into_iter().zip(found.chunks(cells.len()));
    let maps = maps.map(|((response, tremor), found)| {
        let title = format!("{}, tremor {} mm", response.name, 1e3 * tremor);
        heat_map(title, found, &tilts, &clearances)
    });
    Ok(Section {
        title: "Insertion: a peg held aslant by a hand that trembles",
        paragraphs: vec![format!(
            "A chamfered peg of 8 mm, of steel, is lowered {} mm into a chamfered hole, held aslant throughout by a relaxed \
             grip that trembles by {} mm at {} Hz or not, with friction of {FRICTION}, in sessions of the engine with contacts at \
             {} Hz. The hand turns the peg about its tip. Penetration is judged by exact intersection of the meshes at recorded \
             poses.",
            1e3 * INSERTION,
            1e3 * TREMOR,
            Hand::GRIP.tremor_frequency,
            super::RATE,
        )],
        pictures: vec![Picture {
            name: "insertion".to_owned(),
            caption: "Share of the depth that is not reached, by clearance and tilt.".to_owned(),
            maps: maps.collect(),
            columns: 2,
        }],
        tables: vec![table(&cases, &found, &clearances)],
        verdicts: verdicts(judged),
    })
}

fn heat_map(title: String, found: &[Inserted], tilts: &[f64], clearances: &[f64]) -> HeatMap {
    HeatMap {
        title,
        x: CellAxis { name: "tilt, degrees".to_owned(), values: tilts.to_vec() },
        y: CellAxis {
            name: "clearance, mm".to_owned(),
            values: clearances.iter().map(|clearance| 1e3 * clearance).collect(),
        },
        cells: found.iter().map(|inserted| 1.0 - (inserted.depth / INSERTION).clamp(0.0, 1.0)).collect(),
        legend: vec![
            (0.0, "completely inserted".to_owned()),
            (0.5, "half inserted".to_owned()),
            (1.0, "not at all".to_owned()),
        ],
        boundaries: Vec::new(),
    }
}

fn table(cases: &[Case], found: &[Inserted], clearances: &[f64]) -> Table {
    let rows = cases.iter().zip(found).map(|(case, inserted)| {
        row![
            case.response.name,
            case.tremor,
            clearances[case.fit],
            case.tilt,
            inserted.depth,
            inserted.depth >= COMPLETE * INSERTION,
            inserted.deepest,
            inserted.largest.0,
            inserted.largest.1,
            inserted.port_energy,
            inserted.refused,
        ]
    });
    let columns = vec![
        "response",
        "tremor_m",
        "clearance_m",
        "tilt_deg",
        "depth_m",
        "complete",
        "deepest_m",
        "largest_force_n",
        "largest_torque_nm",
        "port_energy_min_j",
        "refused",
    ];
    Table { name: "insertion".to_owned(), columns, rows: rows.collect() }
}

fn verdicts(judged: &[Inserted]) -> Vec<Verdict> {
    let complete = judged.iter().filter(|inserted| inserted.depth >= COMPLETE * INSERTION).count();
    let deepest = judged.iter().fold(0.0, |most: f64, inserted| most.max(inserted.deepest));
    let refused: u64 = judged.iter().map(|inserted| inserted.refused).sum();
    vec![
        Verdict::new(
            "every insertion completes",
            complete == judged.len(),
            format!("{complete} of {} do", judged.len()),
        ),
        Verdict::new(
            format!("the meshes penetrate by at most {} mm", 1e3 * MAX_DEPTH),
            deepest <= MAX_DEPTH,
            format!("by at most {:.4} mm", 1e3 * deepest),
        ),
        Verdict::new("no step is refused", refused == 0, format!("{refused} are")),
    ]
}

/// Makes a peg and a hole.
fn parts(clearance: f64) -> Result<[Part; 2], String> {
    let fit = PegFit { clearance, ..PegFit::LOOSE_8_MM };
    let peg = fit.peg(1000).map_err(|error| error.to_string())?;
    let hole = fit.hole(1200).map_err(|error| error.to_string())?;
    Ok([Part::new("peg", peg)?, Part::new("hole", hole)?])
}

/// Returns the intended height of the tip over the mouth, m, and its rate, m/s.
fn lowering(time: f64) -> (f64, f64) {
    let x = (time / PUSH_END).clamp(0.0, 1.0);
    let travel = ABOVE + INSERTION;
    (ABOVE - travel * x * x * (3.0 - 2.0 * x), -travel * 6.0 * x * (1.0 - x) / PUSH_END)
}

/// Lowers the peg into the hole.
fn insert(case: &Case, [peg, hole]: &[Part; 2]) -> Result<Inserted, String> {
    let settings = case.response.settings(FRICTION, peg);
    let hand = Hand { tremor: case.tremor, ..Hand::GRIP };
    let emulation = Emulation { hand, ..Emulation::default() };
    let placement = HandlePlacement::new(&settings, &peg.object, &emulation.specification);
    let rotation = DQuat::from_rotation_y(case.tilt.to_radians());
    let path = IntendedPath::function(move |time| {
        let (height, rate) = lowering(time);
        let pose = placement.device_pose(&Pose::new(DVec3::Z * height, rotation));
        (pose, Twist::new(DVec3::Z * rate, DVec3::ZERO))
    });
    let recorded = session::run((peg, hole), (emulation, path), settings, HOLD_END)?;
    Ok(Inserted {
        depth: recorded.records.last().map_or(0.0, |last| -last.object.translation.z),
        deepest: Exact::new(peg, hole).deepest(&recorded.poses())?,
        largest: recorded.largest(),
        port_energy: recorded.port_energy,
        refused: recorded.refused,
    })
}
