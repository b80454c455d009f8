//! Map of pegs in holes, in sessions with the engine's contact query.

use std::convert::Infallible;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use palpate::device::{Emulation, IntendedPath};
use palpate::glam::{DQuat, DVec3};
use palpate::mesh_io::{LoadOptions, load};
use palpate::{ContactTiming, HapticRenderer, Object, Pose, Scene, Settings, Twist};
use palpate_report::{CellAxis, HeatMap};

use super::grid::{Plan, pairs};
use super::meshes;
use super::metered::Metered;
use super::page::{Picture, Section, Table, Verdict, row};
use palpate_measure::{Outcome, judge};

/// Radius and length of the peg, and depth and outer radius of the hole, m.
const RADIUS: f64 = 4e-3;
const LENGTH: f64 = 0.03;
const DEPTH: f64 = 0.02;
const OUTER: f64 = 0.012;
/// Height of the tip above the mouth at the start, and depth of the insertion, m.
const ABOVE: f64 = 3e-3;
const INSERTION: f64 = 12e-3;
/// Share of the travel from which an insertion counts as complete.
const COMPLETE: f64 = 0.9;
/// Rate of contact queries, Hz.
const RATE: f64 = 500.0;
/// Times until which the hand pushes, and until which it holds, s.
const PUSH_END: f64 = 1.5;
const HOLD_END: f64 = 2.6;

/// Two objects that fit, with the tip in the peg's frame and the middle of the mouth in the hole's, m.
#[derive(Clone)]
struct Pair {
    name: String,
    clearance: f64,
    peg: (Object, DVec3),
    hole: (Object, DVec3),
}

#[derive(Clone, Copy, Debug)]
struct Insertion {
    depth: f64,
    largest_force: f64,
    largest_torque: f64,
    outcome: Outcome,
    amplitude: f64,
    port_energy: f64,
    refused: u64,
}

impl Insertion {
    fn complete(&self) -> bool {
        self.depth >= COMPLETE * INSERTION
    }
}

/// Makes the map.
///
/// # Errors
/// If a mesh cannot be made, or a session cannot start.
pub fn map(plan: &Plan) -> Result<Section, String> {
    let clearances = plan.choose(&[2e-5, 1e-4, 5e-4, 1e-3], &[1e-4, 1e-3]);
    let tilts = plan.choose(&[0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0], &[0.0, 2.0]);
    let mut fits = plan.each("peg: meshes", &clearances, |&clearance| generated(clearance))?;
    let loaded = if plan.quick { None } else { loaded()? };
    let was_loaded = loaded.is_some();
    fits.extend(loaded);
    let cases = pairs(&fits, &tilts);
    let found = plan.each("peg", &cases, |(fit, tilt): &(Pair, f64)| insert(fit, tilt.to_radians()))?;
    let drawn = &found[..clearances.len() * tilts.len()];
    let peak = Emulation::default().specification;
    let picture = HeatMap {
        title: "insertion".to_owned(),
        x: CellAxis { name: "tilt, degrees".to_owned(), values: tilts.clone() },
        y: CellAxis {
            name: "clearance, mm".to_owned(),
            values: clearances.iter().map(|clearance| 1e3 * clearance).collect(),
        },
        cells: drawn.iter().map(|insertion| 1.0 - (insertion.depth / INSERTION).clamp(0.0, 1.0)).collect(),
        legend: vec![
            (0.0, "completely inserted".to_owned()),
            (0.5, "half inserted".to_owned()),
            (1.0, "not at all".to_owned()),
        ],
        boundaries: Vec::new(),
    };
    let rows = cases.iter().zip(&found).map(|((fit, tilt), insertion)| {
        row![
            fit.name,
            fit.clearance,
            tilt,
            insertion.depth,
            insertion.complete(),
            insertion.largest_force,
            insertion.largest_torque,
            insertion.outcome.word(),
            insertion.amplitude,
            insertion.port_energy,
            insertion.refused,
        ]
    });
    let columns = vec![
        "meshes",
        "clearance_m",
        "tilt_deg",
        "depth_m",
        "complete",
        "largest_force_n",
        "largest_torque_nm",
        "outcome",
        "amplitude_m",
        "port_energy_min_j",
        "refused",
    ];
    let complete = found.iter().filter(|insertion| insertion.complete()).count();
    let stable = || found.iter().filter(|insertion| insertion.outcome.is_stable());
    let force = found.iter().fold(0.0, |most: f64, insertion| most.max(insertion.largest_force));
    let torque = found.iter().fold(0.0, |most: f64, insertion| most.max(insertion.largest_torque));
    let least = stable().map(|insertion| insertion.port_energy).fold(0.0, f64::min);
    let under = stable().filter(|insertion| insertion.port_energy < super::body::MIN_PORT_ENERGY).count();
    let files = match (plan.quick, was_loaded) {
        (true, _) => "The peg and the hole of the test data are skipped.",
        (false, true) => "The peg and the hole of 8 mm of the test data were loaded and inserted too.",
        (false, false) => "The peg and the hole of 8 mm of the test data are skipped: they are absent.",
    };
    Ok(Section {
        title: "Peg in hole",
        paragraphs: vec![format!(
            "A peg of 8 mm is lowered {} mm into a hole, held tilted throughout by a relaxed grip, in sessions of the \
             engine with contacts at {RATE} Hz. {files} {complete} of {} insertions reach {} % of the depth or more.",
            1e3 * INSERTION,
            found.len(),
            100.0 * COMPLETE
        )],
        pictures: vec![Picture {
            name: "peg".to_owned(),
            caption: "Share of the depth that is not reached, by clearance and tilt.".to_owned(),
            maps: vec![picture],
            columns: 1,
        }],
        tables: vec![Table { name: "peg".to_owned(), columns, rows: rows.collect() }],
        verdicts: vec![
            Verdict::new(
                "every insertion completes",
                complete == found.len(),
                format!("{complete} of {} do", found.len()),
            ),
            Verdict::new(
                "every peg comes to rest",
                stable().count() == found.len(),
                format!("{} of {} do", stable().count(), found.len()),
            ),
            Verdict::new(
                "forces and torques stay within what the device renders",
                force <= peak.peak_force * (1.0 + 1e-9) && torque <= peak.peak_torque * (1.0 + 1e-9),
                format!("at most {force:.2} N and {torque:.3} N·m"),
            ),
            Verdict::new(
                "the energy at the port stays above −1 mJ in every stable insertion",
                under == 0,
                format!("{under} of {} go below; the least is {:.3} mJ", stable().count(), 1e3 * least),
            ),
        ],
    })
}

fn generated(clearance: f64) -> Result<Pair, String> {
    Ok(Pair {
        name: "generated".to_owned(),
        clearance,
        peg: (meshes::peg(RADIUS, LENGTH)?, DVec3::ZERO),
        hole: (meshes::hole(RADIUS + clearance, OUTER, DEPTH)?, DVec3::ZERO),
    })
}

/// Loads peg and hole of the optional test data, in `shared` beside the repository.
fn loaded() -> Result<Option<Pair>, String> {
    let folder = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/models/good"));
    let open = |name: &str| -> Result<Option<(Object, DVec3, DVec3)>, String> {
        let file = folder.join(name);
        if !file.exists() {
            return Ok(None);
        }
        let mesh = load(&file, &LoadOptions::default()).map_err(|error| error.to_string())?.mesh;
        let bounds = mesh
            .vertices()
            .iter()
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), v| (low.min(*v), high.max(*v)));
        let object = Object::from_mesh(name, &mesh).map_err(|error| error.to_string())?;
        Ok(Some((object, bounds.0, bounds.1)))
    };
    let (Some((peg, low, high)), Some((hole, _, top))) = (open("peg_8mm.obj")?, open("hole_8mm.obj")?) else {
        return Ok(None);
    };
    let tip = DVec3::new(0.5 * (low.x + high.x), 0.5 * (low.y + high.y), low.z);
    // The bore's radius is half of its nominal 9 mm; the clearance is the difference to the peg's.
    let clearance = 4.5e-3 - 0.5 * (high.x - low.x);
    let name = "peg_8mm.obj in hole_8mm.obj".to_owned();
    Ok(Some(Pair { name, clearance, peg: (peg, tip), hole: (hole, DVec3::Z * top.z) }))
}

/// Returns the intended height of the tip over the mouth, m, and its rate, m/s.
fn lowering(time: f64) -> (f64, f64) {
    let x = (time / PUSH_END).clamp(0.0, 1.0);
    let travel = ABOVE + INSERTION;
    (ABOVE - travel * x * x * (3.0 - 2.0 * x), -travel * 6.0 * x * (1.0 - x) / PUSH_END)
}

/// Lowers the peg, tilted by an angle (rad), into the hole.
fn insert(fit: &Pair, tilt: f64) -> Result<Insertion, String> {
    let (peg, tip) = fit.peg.clone();
    let rotation = DQuat::from_rotation_y(tilt);
    let path = IntendedPath::function(move |time| {
        let (height, rate) = lowering(time);
        let pose = Pose::new(DVec3::Z * height - rotation * tip, rotation);
        (pose, Twist::new(DVec3::Z * rate, DVec3::ZERO))
    });
    let emulation = Emulation::default();
    let floor = (2.0 * emulation.specification.encoder_step)
        .max(2.0 * emulation.handle.friction / (0.5 * emulation.specification.stiffness));
    let (device, meter) = Metered::new(emulation.open(path).map_err(|error| error.to_string())?);
    let scene = Scene::new().with(fit.hole.0.clone(), Pose::from_translation(-fit.hole.1));
    let renderer = HapticRenderer::new(peg, scene, Box::new(device), Settings::default())
        .map_err(|error| error.to_string())?;
    let mut found = Insertion {
        depth: 0.0,
        largest_force: 0.0,
        largest_torque: 0.0,
        outcome: Outcome::Diverged,
        amplitude: f64::INFINITY,
        port_energy: 0.0,
        refused: 0,
    };
    let mut trace = Vec::new();
    let stop = AtomicBool::new(false);
    let run = renderer.run_lockstep(HOLD_END, ContactTiming::busy(RATE), &stop, |record| {
        let place = record.object.transform_point(tip);
        found.depth = -place.z;
        found.largest_force = found.largest_force.max(record.coupling.force.length());
        found.largest_torque = found.largest_torque.max(record.coupling.torque.length());
        let handle = meter.seen().pose.translation;
        trace.push([handle.x, handle.y, handle.z, place.x, place.y, place.z]);
        Ok::<_, Infallible>(())
    });
    let Ok(session) = run;
    (found.outcome, found.amplitude) = judge(&trace[trace.len().saturating_sub(1000)..], floor);
    found.port_energy = -meter.seen().most_work;
    found.refused = session.summary().events.step_refused;
    Ok(found)
}
