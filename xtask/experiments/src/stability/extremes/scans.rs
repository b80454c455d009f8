//! Pairs of scans of the optional test data, with many masses and contact rates.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use palpate::settings::ToolSettings;
use palpate::{Object, OpenOptions, Pose, Scene, Settings};
use palpate_report::{CellAxis, HeatMap};

use super::session::{Case, Hands, Measured, worst};
use crate::stability::grid::{Plan, ScanCase, pairs};
use crate::stability::page::{Picture, Table, Verdict, row};

/// A file, and the factor from its lengths to metres.
type Scan = (&'static str, f64);

const UPPER_TEETH: Scan = ("dental_cast_upper.obj", 1.0);
const LOWER_TEETH: Scan = ("dental_cast_lower.obj", 1.0);
const MANDIBLE: Scan = ("human_mandible.obj", 1e-3);
const FEMUR: Scan = ("femur_left.stl", 1e-3);
const GOLF_BALL: Scan = ("ycb_golf_ball.obj", 1.0);
const HAMMER: Scan = ("ycb_hammer.obj", 1.0);
const MUG: Scan = ("ycb_mug.obj", 1.0);
const SPOON: Scan = ("ycb_spoon.obj", 1.0);
const DOG: Scan = ("dog_body.stl", 1.0);
/// It has no unit; so it is 61 mm in radius.
const SCALLOP: Scan = ("scallop_120k.glb", 0.02);

/// Held objects, which have to fit into the device's workspace, and those that they touch: every pair of
/// different ones.
const HELD: [Scan; 8] = [UPPER_TEETH, LOWER_TEETH, MANDIBLE, FEMUR, GOLF_BALL, MUG, SPOON, SCALLOP];
const TOUCHED: [Scan; 10] =
    [UPPER_TEETH, LOWER_TEETH, MANDIBLE, FEMUR, GOLF_BALL, MUG, SPOON, SCALLOP, HAMMER, DOG];
const MASSES: [f64; 5] = [1e-3, 1e-2, 0.1, 1.0, 10.0];
const RATES: [f64; 4] = [50.0, 100.0, 500.0, 1000.0];
/// Share of the cases that should be within the bounds.
const WITHIN: f64 = 0.95;
/// Duration of contact below which a case says nothing about contact, s.
const LEAST_CONTACT: f64 = 0.5;

/// How a session answers contact: a name, and its settings.
type Response = (&'static str, fn(&mut Settings));

/// The axis of responses. Penalties have a stiffness and so would belong here several times, with 1, 10 and
/// 100 kN/m; constraints have none. Each response multiplies the number of cases.
const RESPONSES: [Response; 1] = [("constraints", |_| ())];

/// Results of the map of scans.
#[derive(Default)]
pub struct Scans {
    pub paragraphs: Vec<String>,
    pub tables: Vec<Table>,
    pub pictures: Vec<Picture>,
    pub verdicts: Vec<Verdict>,
}

/// Held object and what it touches.
struct Pair {
    held: Object,
    scene: Scene,
    /// Names of the files.
    names: [&'static str; 2],
}

/// A pair with a mass (kg), a contact rate (Hz) and a response.
struct Parameters<'a> {
    pair: &'a Pair,
    mass: f64,
    rate: f64,
    response: &'a Response,
}

/// Makes the map of scans, or says why not.
///
/// # Errors
/// If a case cannot be simulated.
pub fn map(plan: &Plan) -> Result<Scans, String> {
    let folder = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/models/good"));
    let missing = |why: &str| Scans {
        paragraphs: vec![format!("The pairs of scans of the test data are skipped{why}.")],
        ..Scans::default()
    };
    if plan.quick {
        return Ok(missing(""));
    }
    if !folder.exists() {
        return Ok(missing(": they are absent"));
    }
    let (scans, notes) = opened(plan, &folder)?;
    let cells = pairs(&MASSES, &RATES);
    let cases: Vec<Parameters<'_>> = scans
        .iter()
        .flat_map(|pair| RESPONSES.iter().map(move |response| (pair, response)))
        .flat_map(|(pair, response)| {
            cells.iter().map(move |&(mass, rate)| Parameters { pair, mass, rate, response })
        })
        .filter(|case| plan.scans.is_empty() || plan.scans.contains(&case.as_in_table()))
        .collect();
    if cases.len() < plan.scans.len() {
        return Err(format!(
            "{} of {} cases are not in the table",
            plan.scans.len() - cases.len(),
            plan.scans.len()
        ));
    }
    let found = plan.each("extremes: scans", &cases, Parameters::measure)?;
    Ok(described(&cases, &found, &notes))
}

/// Opens the scans and pairs them. Returns notes about those that were repaired or left out.
fn opened(plan: &Plan, folder: &Path) -> Result<(Vec<Pair>, Vec<String>), String> {
    let opened = plan.each("extremes: meshes", &TOUCHED, |scan| Ok(open(folder, scan)))?;
    let (mut objects, mut notes) = (BTreeMap::new(), Vec::new());
    for ((name, _), object) in TOUCHED.iter().zip(opened) {
        match object {
            Ok((object, repaired)) => {
                notes.extend(repaired.then(|| format!("{name} was repaired")));
                objects.insert(*name, object);
            }
            Err(why) => notes.push(format!("{name} is left out: {why}")),
        }
    }
    let pair = |(held, touched): (Scan, Scan)| {
        let scene = Scene::new().with(objects.get(touched.0)?.clone(), Pose::IDENTITY);
        let held = (held != touched).then_some(held)?;
        Some(Pair { held: objects.get(held.0)?.clone(), scene, names: [held.0, touched.0] })
    };
    Ok((pairs(&HELD, &TOUCHED).into_iter().filter_map(pair).collect(), notes))
}

/// Opens a scan, and repairs it if it cannot be opened otherwise. Returns whether it was repaired.
fn open(folder: &Path, (name, scale): &Scan) -> Result<(Object, bool), String> {
    let file = folder.join(name);
    let open = |repair| {
        let options = OpenOptions { scale: *scale, repair, cache: true };
        Object::open(&file.to_string_lossy(), &options, &mut |_, _| ControlFlow::Continue(()))
    };
    open(false)
        .map(|object| (object, false))
        .or_else(|_| open(true).map(|object| (object, true)).map_err(|error| error.to_string()))
}

impl Parameters<'_> {
    /// The default settings but for the mass.
    fn settings(&self) -> Settings {
        let mut settings = Settings {
            tool: ToolSettings { mass: self.mass, ..ToolSettings::default() },
            ..Settings::default()
        };
        (self.response.1)(&mut settings);
        settings
    }

    fn as_in_table(&self) -> ScanCase {
        let [held, touched] = self.pair.names.map(str::to_owned);
        ScanCase { held, touched, mass: self.mass, rate: self.rate }
    }

    fn measure(&self) -> Result<Measured, String> {
        let Pair { held, scene, names: [name, touched] } = self.pair;
        let case = Case { probe: held, scene, settings: self.settings(), contact_rate: self.rate };
        case.measure(Hands::Paused)
            .map_err(|error| format!("{name} on {touched}, {} kg, {} Hz: {error}", self.mass, self.rate))
    }
}

fn described(cases: &[Parameters<'_>], found: &[Measured], notes: &[String]) -> Scans {
    let touched = |measured: &Measured| measured.touching() >= LEAST_CONTACT;
    let counted = cases.iter().zip(found).filter(|(_, measured)| touched(measured));
    let counted: Vec<(&Parameters<'_>, &Measured)> = counted.collect();
    let within = counted.iter().filter(|(_, measured)| measured.outside().is_empty()).count();
    let share = within as f64 / counted.len().max(1) as f64;
    let outside =
        |bound: &str| counted.iter().filter(|(_, measured)| measured.outside().contains(&bound)).count();
    let mut paragraphs = vec![format!(
        "{} pairs of scans, with masses of {} to {} kg and contacts at {} to {} Hz, with constraints: the hand \
         comes down, pauses, and strokes. {within} of {} cases with contact are within the bounds: {} are deeper, {} \
         vibrate in free space, {} at rest, {} in sliding. {} cases touch for less than {LEAST_CONTACT} s and are not \
         counted. The table names each.",
        found.len() / (MASSES.len() * RATES.len() * RESPONSES.len()),
        MASSES[0],
        MASSES[MASSES.len() - 1],
        RATES[0],
        RATES[RATES.len() - 1],
        counted.len(),
        outside("depth"),
        outside("free"),
        outside("rest"),
        outside("sliding"),
        found.len() - counted.len(),
    )];
    paragraphs.extend((!notes.is_empty()).then(|| format!("{}.", notes.join("; "))));
    Scans {
        paragraphs,
        tables: vec![table(cases, found)],
        pictures: vec![picture(&counted)],
        verdicts: vec![Verdict::new(
            format!("{} % of the cases of scans are within the bounds", 100.0 * WITHIN),
            share >= WITHIN,
            format!("{:.1} %: {within} of {}", 100.0 * share, counted.len()),
        )],
    }
}

fn table(cases: &[Parameters<'_>], found: &[Measured]) -> Table {
    let columns = vec![
        "held",
        "touched",
        "response",
        "mass_kg",
        "contact_rate_hz",
        "within",
        "outside",
        "contact_s",
        "told_m",
        "exact_m",
        "deeper_share",
        "free_n",
        "onset_n",
        "rest_n",
        "sliding_n",
        "rest_band_hz",
        "rest_ratio",
        "sliding_band_hz",
        "sliding_ratio",
    ];
    let rows = cases.iter().zip(found).map(|(case, measured)| {
        let vibration = &measured.vibration;
        let [rest, sliding] = [&vibration.rest, &vibration.sliding].map(worst);
        let outside = measured.outside();
        row![
            case.pair.names[0],
            case.pair.names[1],
            case.response.0,
            case.mass,
            case.rate,
            outside.is_empty(),
            outside.join(" "),
            measured.touching(),
            measured.told,
            measured.exact.depth,
            measured.beyond(),
            vibration.free.force,
            vibration.onset.force,
            vibration.rest.force,
            vibration.sliding.force,
            rest[0],
            rest[1],
            sliding[0],
            sliding[1],
        ]
    });
    Table { name: "extremes-scans".to_owned(), columns, rows: rows.collect() }
}

/// Share of the pairs outside the bounds, by mass and rate.
fn picture(counted: &[(&Parameters<'_>, &Measured)]) -> Picture {
    let share = |&(mass, rate): &(f64, f64)| {
        let here = || counted.iter().filter(|(case, _)| case.mass == mass && case.rate == rate);
        let outside = here().filter(|(_, measured)| !measured.outside().is_empty()).count();
        outside as f64 / here().count().max(1) as f64
    };
    let map = HeatMap {
        title: "pairs of scans outside the bounds".to_owned(),
        x: CellAxis { name: "contact rate, Hz".to_owned(), values: RATES.to_vec() },
        y: CellAxis { name: "mass, kg".to_owned(), values: MASSES.to_vec() },
        cells: pairs(&MASSES, &RATES).iter().map(share).collect(),
        legend: vec![(0.0, "none".to_owned()), (0.5, "half".to_owned()), (1.0, "all".to_owned())],
        boundaries: Vec::new(),
    };
    Picture {
        name: "extremes".to_owned(),
        caption: "Share of the pairs of scans that are outside the bounds, by mass and contact rate."
            .to_owned(),
        maps: vec![map],
        columns: 1,
    }
}
