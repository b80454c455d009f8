//! Map of thin walls and fast hands: share of hits in which an object pops through, in sessions with the
//! engine's contact query.

use std::convert::Infallible;
use std::sync::atomic::AtomicBool;

use palpate::device::{Emulation, Hand, IntendedPath};
use palpate::glam::DVec3;
use palpate::models::Model;
use palpate::settings::{ContactSettings, Response, SearchSettings};
use palpate::{ContactTiming, HapticRenderer, Object, Pose, Scene, Settings, Twist};
use palpate_report::{CellAxis, HeatMap};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

use super::grid::{Plan, pairs};
use super::meshes;
use super::metered::Metered;
use super::page::{Picture, Section, Table, Verdict, row};

/// Half width of the plate, m.
const PLATE: f64 = 0.05;
/// Depth beyond the touch that the hand aims at, m.
const PRESS: f64 = 5e-3;
/// Times in which the hand accelerates and keeps its speed before the touch, and until the end, s.
const SPEED_UP: f64 = 0.15;
const CRUISE: f64 = 0.1;
const AFTER_TOUCH: f64 = 0.35;

/// Thinnest wall, m, and fastest hand, m/s, of the hits of [`Endurance`], and rate of their contacts, Hz.
const THINNEST: f64 = 2e-4;
const FASTEST: f64 = 2.0;
const SLOWEST_CONTACTS: f64 = 50.0;
/// Number of these hits: a million steps.
const ENDURED: usize = 1700;

/// Settings that keep the object on its side.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Method {
    name: &'static str,
    response: Response,
    braking: bool,
    proxy: bool,
}

const fn penalties(name: &'static str, braking: bool, proxy: bool) -> Method {
    Method { name, response: Response::Penalty, braking, proxy }
}

/// Compared methods. The last one is the default, which is judged.
const METHODS: [Method; 5] = [
    penalties("penalties", false, false),
    penalties("penalties, braking", true, false),
    penalties("penalties, proxy", false, true),
    penalties("penalties, both", true, true),
    DEFAULT,
];
const DEFAULT: Method =
    Method { name: "constraints", response: Response::Constraints, braking: true, proxy: true };

/// Parameters of a hit.
#[derive(Clone, Copy, Debug)]
struct Case {
    method: Method,
    rate: f64,
    speed: f64,
    /// Delay of the hand, relative to the period between contact queries.
    phase: f64,
}

#[derive(Clone, Copy, Debug)]
struct Hit {
    /// Whether the object ends behind the plate.
    popped: bool,
    /// Largest depth of the object below its touch, m.
    deepest: f64,
    /// Speed of the handle just before the touch, m/s.
    speed: f64,
    largest_force: f64,
    port_energy: f64,
    steps: u32,
}

/// Hits of the thinnest wall with the slowest contacts, at random speeds and times.
struct Endurance {
    steps: u32,
    hits: usize,
    /// Numbers of hits that went through with the default, and with penalties and braking: the negative
    /// control.
    through: usize,
    through_with_penalties: usize,
}

/// Makes the map.
///
/// # Errors
/// If a session cannot start.
pub fn map(plan: &Plan) -> Result<Section, String> {
    let rates = plan.choose(&[50.0, 200.0, 1000.0], &[200.0]);
    let speeds = plan.choose(&[0.1, 0.2, 0.5, 1.0, 2.0, 3.0, 5.0], &[0.1, 1.0, 5.0]);
    let walls = plan.choose(&[2e-4, 5e-4, 1e-3, 2e-3, 3e-3, 5e-3], &[5e-4, 2e-3]);
    let phases = plan.choose(&[0.0, 0.2, 0.4, 0.6, 0.8], &[0.0]);
    let mesh = Model::Ellipsoid.generate(500).map_err(|error| error.to_string())?;
    let lowest = mesh.vertices().iter().fold(f64::INFINITY, |low, vertex| low.min(vertex.z));
    let probe = Object::from_mesh("ellipsoid", &mesh).map_err(|error| error.to_string())?;
    let plates: Result<Vec<(f64, Object)>, String> = walls
        .iter()
        .map(|&wall| Ok((wall, meshes::block("plate", DVec3::new(PLATE, PLATE, 0.5 * wall))?)))
        .collect();
    let plates = plates?;
    let cells = pairs(&plates, &speeds);
    let cases = pairs(&pairs(&pairs(&METHODS, &rates), &cells), &phases);
    let hits = plan.each("thin wall", &cases, |(((method, rate), ((thickness, plate), speed)), phase)| {
        let case = Case { method: *method, rate: *rate, speed: *speed, phase: *phase };
        hit(&case, &probe, plate, 0.5 * thickness - lowest)
    })?;
    let endurance = endure(plan, &probe, -lowest)?;
    let by_cell: Vec<&[Hit]> = hits.chunks(phases.len()).collect();
    let shares = pairs(&METHODS, &rates).into_iter().zip(by_cell.chunks(cells.len()));
    let shown = |method: &Method| *method == METHODS[0] || *method == DEFAULT;
    let maps = shares.filter(|((method, _), _)| shown(method)).map(|((method, rate), tries)| HeatMap {
        title: format!("{}, contacts at {rate} Hz", method.name),
        x: CellAxis { name: "speed of the hand, m/s".to_owned(), values: speeds.clone() },
        y: CellAxis {
            name: "thickness, mm".to_owned(),
            values: walls.iter().map(|wall| 1e3 * wall).collect(),
        },
        cells: tries.iter().map(|tries| through(tries) as f64 / tries.len() as f64).collect(),
        legend: vec![
            (0.0, "never through".to_owned()),
            (0.5, "half of the hits".to_owned()),
            (1.0, "always through".to_owned()),
        ],
        boundaries: Vec::new(),
    });
    let rows = cases.iter().zip(&hits).map(|((((method, rate), ((thickness, _), speed)), phase), hit)| {
        row![
            method.name,
            rate,
            thickness,
            speed,
            phase,
            hit.speed,
            hit.popped,
            hit.deepest,
            hit.largest_force,
            hit.port_energy
        ]
    });
    let columns = vec![
        "method",
        "contact_rate_hz",
        "thickness_m",
        "speed_m_s",
        "phase",
        "speed_at_touch_m_s",
        "popped_through",
        "deepest_m",
        "largest_force_n",
        "port_energy_min_j",
    ];
    let by_method: Vec<&[Hit]> = hits.chunks(hits.len() / METHODS.len()).collect();
    let judged = by_method[by_method.len() - 1];
    let popped = through(judged);
    let peak = Emulation::default().specification.peak_force;
    let largest = judged.iter().fold(0.0, |most: f64, hit| most.max(hit.largest_force));
    let stopped = || judged.iter().filter(|hit| !hit.popped);
    let least = stopped().map(|hit| hit.port_energy).fold(0.0, f64::min);
    let under = stopped().filter(|hit| hit.port_energy < super::body::MIN_PORT_ENERGY).count();
    Ok(Section {
        title: "Thin wall: fast hands",
        paragraphs: vec![
            format!(
                "An ellipsoid of {:.1} mm radius, in a relaxed grip, is driven at a plate that is 100 mm wide, and the \
                 hand means to stop 5 mm past the touch, each hit {} times with the contact queries differently in time. \
                 The session is the engine's own, with its contact query and default settings, but for what is to keep \
                 the object on its side: constraints, or penalties with braking before it touches, a proxy that does not \
                 pass through surfaces, neither, or both.",
                1e3 * probe.bounding_radius(),
                phases.len(),
            ),
            by_method
                .iter()
                .zip(METHODS)
                .fold(String::new(), |text, (hits, method)| text + &described(&method, &rates, hits)),
            format!(
                "Of {} hits on a wall of {} mm at up to {FASTEST} m/s and at random times, with contacts at \
                 {SLOWEST_CONTACTS} Hz, {} go through with constraints, and {} with penalties and braking.",
                endurance.hits,
                1e3 * THINNEST,
                endurance.through,
                endurance.through_with_penalties
            ),
        ],
        pictures: vec![Picture {
            name: "thin-wall".to_owned(),
            caption: "Share of the hits that end behind the plate, by speed and thickness.".to_owned(),
            maps: maps.collect(),
            columns: rates.len(),
        }],
        tables: vec![Table { name: "thin-wall".to_owned(), columns, rows: rows.collect() }],
        verdicts: vec![
            Verdict::new(
                "nothing pops through a wall",
                popped == 0,
                format!("{popped} of {} hits do", judged.len()),
            ),
            Verdict::new(
                format!("{} mm are not passed in {} steps", 1e3 * THINNEST, endurance.steps),
                endurance.through == 0,
                format!("{} of {} hits pass", endurance.through, endurance.hits),
            ),
            Verdict::new(
                "of the same hits some pass with penalties and braking",
                endurance.through_with_penalties > 0,
                format!("{} do", endurance.through_with_penalties),
            ),
            Verdict::new(
                "the force stays within what the device renders",
                largest <= peak * (1.0 + 1e-9),
                format!("at most {largest:.2} N of {peak} N"),
            ),
            Verdict::new(
                "the energy at the port stays above −1 mJ in every hit that is stopped",
                under == 0,
                format!("{under} of {} go below; the least is {:.2} mJ", stopped().count(), 1e3 * least),
            ),
        ],
    })
}

fn through(hits: &[Hit]) -> usize {
    hits.iter().filter(|hit| hit.popped).count()
}

/// Hits the thinnest wall, which the probe touches at a height `touch` over its surface (m).
fn endure(plan: &Plan, probe: &Object, touch: f64) -> Result<Endurance, String> {
    let plate = meshes::block("plate", DVec3::new(PLATE, PLATE, 0.5 * THINNEST))?;
    let mut rng = StdRng::seed_from_u64(0x3A11);
    let count = if plan.quick { ENDURED / 100 } else { ENDURED };
    let cases: Vec<(f64, f64)> =
        (0..count).map(|_| (rng.random_range(0.1..FASTEST), rng.random_range(0.0..1.0))).collect();
    let hits = |method: Method| {
        plan.each("thin wall: endurance", &cases, |&(speed, phase)| {
            let case = Case { method, rate: SLOWEST_CONTACTS, speed, phase };
            hit(&case, probe, &plate, touch + 0.5 * THINNEST)
        })
    };
    let (found, control) = (hits(DEFAULT)?, hits(METHODS[1])?);
    Ok(Endurance {
        steps: found.iter().map(|hit| hit.steps).sum(),
        hits: count,
        through: through(&found),
        through_with_penalties: through(&control),
    })
}

/// Describes the hits with one method, by contact rate.
fn described(method: &Method, rates: &[f64], hits: &[Hit]) -> String {
    let counts = rates.iter().zip(hits.chunks(hits.len() / rates.len()));
    let counts: Vec<String> = counts.map(|(rate, hits)| format!("{} at {rate} Hz", through(hits))).collect();
    let mut depths: Vec<f64> = hits.iter().map(|hit| hit.deepest).collect();
    depths.sort_by(f64::total_cmp);
    format!(
        "With {}: {} of {} hits end behind the plate ({}); half of all hits go deeper than {:.1} mm for a moment. ",
        method.name,
        through(hits),
        hits.len(),
        counts.join(", "),
        1e3 * depths[depths.len() / 2]
    )
}

/// Drives the probe, which touches at the height `touch`, at the plate.
fn hit(case: &Case, probe: &Object, plate: &Object, touch: f64) -> Result<Hit, String> {
    let Case { method, rate, speed, phase } = *case;
    let start = speed * (0.5 * SPEED_UP + CRUISE);
    let late = phase / rate;
    let path = IntendedPath::function(move |time| {
        let time = (time - late).max(0.0);
        let faster = time.min(SPEED_UP);
        let travel = speed * (0.5 * faster * faster / SPEED_UP + (time - faster));
        let height = start - travel;
        if height > -PRESS {
            let velocity = -speed * faster / SPEED_UP;
            (
                Pose::from_translation(DVec3::Z * (touch + height)),
                Twist::new(DVec3::Z * velocity, DVec3::ZERO),
            )
        } else {
            (Pose::from_translation(DVec3::Z * (touch - PRESS)), Twist::ZERO)
        }
    });
    let emulation = Emulation { hand: Hand::GRIP, ..Emulation::default() };
    let (device, meter) = Metered::new(emulation.open(path).map_err(|error| error.to_string())?);
    let scene = Scene::new().with(plate.clone(), Pose::IDENTITY);
    let settings = Settings {
        contact: ContactSettings { response: method.response, ..ContactSettings::default() },
        search: SearchSettings { braking: method.braking, proxy: method.proxy, ..SearchSettings::default() },
        ..Settings::default()
    };
    let renderer = HapticRenderer::new(probe.clone(), scene, Box::new(device), settings)
        .map_err(|error| error.to_string())?;
    // The probe has popped through if its middle is beyond the middle of the plate.
    let center = probe.clod.source.center;
    let mut touched = false;
    let seconds = SPEED_UP + CRUISE + late + PRESS / speed + AFTER_TOUCH;
    let mut found =
        Hit { popped: false, deepest: 0.0, speed: 0.0, largest_force: 0.0, port_energy: 0.0, steps: 0 };
    let stop = AtomicBool::new(false);
    let run = renderer.run_lockstep(seconds, ContactTiming::busy(rate), &stop, |record| {
        found.steps += 1;
        found.popped = record.object.transform_point(center).z < 0.0;
        found.deepest = found.deepest.max(touch - record.object.translation.z);
        found.largest_force = found.largest_force.max(record.coupling.force.length());
        let seen = meter.seen();
        touched |= seen.pose.translation.z <= touch;
        if !touched {
            found.speed = -seen.twist.linear.z;
        }
        Ok::<_, Infallible>(())
    });
    let Ok(_) = run;
    found.port_energy = -meter.seen().most_work;
    Ok(found)
}
