//! Map of a nut that a hand turns on a bolt and off again.

use std::f64::consts::TAU;

use palpate::device::{Emulation, IntendedPath, Task, TaskParameters, TaskSite};
use palpate::glam::{DQuat, DVec3};
use palpate::models::MetricThread;
use palpate::{HandlePlacement, Pose, Record};
use palpate_report::{CellAxis, HeatMap};

use super::super::grid::{Plan, pairs};
use super::super::page::{Picture, Section, Table, Verdict, row};
use super::exact::Exact;
use super::locking::{locking_friction, mean_radius};
use super::{MAX_DEPTH, Part, Response, bolt_and_nut, responses, session};

/// Number of turns on and off: three are measured.
const TURNS: f64 = 5.0;
/// Coefficients of friction.
const FRICTION: [f64; 2] = [0.0, 0.15];
/// Turns after which the travel is measured, and at the end of turning off for which it is not. Before, less
/// than a turn of the thread is full, since both chamfers cut into it: a nut that is held softly leans there
/// within its play, and its centre rises or falls by some 0.06 mm.
const ENGAGED: f64 = 2.0;
/// Cosine of a flank's angle: the normal force on the flanks is as much more than that along the axis. Lead
/// and friction change it by less than 1 %.
const NORMAL_FLANK: f64 = 0.866;
/// Deviation of the travel in a turn from the pitch that is allowed, as a part of the pitch.
const MAX_DEVIATION: f64 = 0.01;
/// Height over the first touch at which the nut counts as off, m.
const OFF: f64 = 5e-4;

#[derive(Clone, Copy, Debug)]
struct Case {
    response: Response,
    friction: f64,
    /// Rate of the hand, turns a second.
    rate: f64,
}

/// What a session in which a nut was turned on and off has shown.
#[derive(Clone, Copy, Debug)]
struct Turned {
    /// Travel along the axis in a turn, m, on and off, and turns of the nut itself while the hand turned it
    /// on.
    on: f64,
    off: f64,
    turns: f64,
    /// Whether the nut came off in the end.
    came_off: bool,
    /// Deepest penetration of the meshes, m.
    deepest: f64,
    /// Mean torque about the axis while it is turned on and off, N·m: positive against turning on.
    torque: [f64; 2],
    /// The same by theory from the mean force along the axis.
    torque_theory: [f64; 2],
    largest: (f64, f64),
    port_energy: f64,
    refused: u64,
}

impl Turned {
    fn follows(&self, pitch: f64) -> bool {
        [self.on, self.off].iter().all(|travel| (travel / pitch - 1.0).abs() <= MAX_DEVIATION)
    }
}

/// Makes the map.
///
/// # Errors
/// If a mesh cannot be made, or a session cannot start.
pub fn map(plan: &Plan) -> Result<Section, String> {
    let thread = MetricThread::M16;
    let rates = plan.choose(&[0.5, 1.0, 2.0], &[2.0]);
    let [bolt, nut] = bolt_and_nut(&thread)?;
    let responses = responses();
    let cases: Vec<Case> = pairs(&responses, &pairs(&FRICTION, &rates))
        .into_iter()
        .map(|(response, (friction, rate))| Case { response, friction, rate })
        .collect();
    let found = plan.each("nut", &cases, |case| turn(case, &thread, &nut, &bolt))?;
    let judged = &found[found.len() - FRICTION.len() * rates.len()..];
    let maps =
        responses.iter().zip(found.chunks(FRICTION.len() * rates.len())).map(|(response, found)| HeatMap {
            title: response.name.to_owned(),
            x: CellAxis { name: "turns a second".to_owned(), values: rates.clone() },
            y: CellAxis { name: "coefficient of friction".to_owned(), values: FRICTION.to_vec() },
            cells: found.iter().map(|turned| (turned.deepest / (5.0 * MAX_DEPTH)).min(1.0)).collect(),
            legend: vec![
                (0.0, "no penetration".to_owned()),
                (0.2, "0.02 mm".to_owned()),
                (1.0, "0.1 mm or more".to_owned()),
            ],
            boundaries: Vec::new(),
        });
    Ok(Section {
        title: "Nut: turned on a bolt and off",
        paragraphs: vec![format!(
            "A nut M16 of steel, {:.0} g, is turned on a bolt by {TURNS} turns and off again by a hand in a relaxed grip that \
             means to be {:.0} mm ahead along the axis, in sessions of the engine with contacts at {} Hz. The travel in a turn is \
             the slope of the height by the angle of the nut once {ENGAGED} turns are engaged. Penetration is judged by exact \
             intersection of the meshes at recorded poses. Clearance: {:.3} mm radially.",
            1e3 * nut.mass(),
            1e3 * TaskParameters::default().press,
            super::RATE,
            1e3 * thread.clearance(),
        )],
        pictures: vec![Picture {
            name: "nut".to_owned(),
            caption: "Deepest penetration, by rate and friction.".to_owned(),
            maps: maps.collect(),
            columns: 2,
        }],
        tables: vec![table(&cases, &found)],
        verdicts: verdicts(judged, thread.pitch),
    })
}

fn table(cases: &[Case], found: &[Turned]) -> Table {
    let rows = cases.iter().zip(found).map(|(case, turned)| {
        row![
            case.response.name,
            case.friction,
            case.rate,
            turned.on,
            turned.off,
            turned.turns,
            turned.came_off,
            turned.deepest,
            turned.torque[0],
            turned.torque_theory[0],
            turned.torque[1],
            turned.torque_theory[1],
            turned.largest.0,
            turned.largest.1,
            turned.port_energy,
            turned.refused,
        ]
    });
    let columns = vec![
        "response",
        "friction",
        "turns_per_s",
        "travel_on_m",
        "travel_off_m",
        "turned_on",
        "came_off",
        "deepest_m",
        "torque_on_nm",
        "torque_on_theory_nm",
        "torque_off_nm",
        "torque_off_theory_nm",
        "largest_force_n",
        "largest_torque_nm",
        "port_energy_min_j",
        "refused",
    ];
    Table { name: "nut".to_owned(), columns, rows: rows.collect() }
}

fn verdicts(judged: &[Turned], pitch: f64) -> Vec<Verdict> {
    let count = |of: &dyn Fn(&Turned) -> bool| judged.iter().filter(|turned| of(turned)).count();
    let worst = judged
        .iter()
        .flat_map(|turned| [turned.on, turned.off])
        .map(|travel| (travel / pitch - 1.0).abs())
        .fold(0.0, f64::max);
    let deepest = judged.iter().fold(0.0, |most: f64, turned| most.max(turned.deepest));
    let off = count(&|turned| turned.came_off);
    let refused: u64 = judged.iter().map(|turned| turned.refused).sum();
    vec![
        Verdict::new(
            "the nut goes by the pitch in every turn, on and off, within 1 %",
            count(&|turned| turned.follows(pitch)) == judged.len(),
            format!("off by at most {:.2} %", 100.0 * worst),
        ),
        Verdict::new("the nut comes off again", off == judged.len(), format!("{off} of {} do", judged.len())),
        Verdict::new(
            format!("the meshes penetrate by at most {} mm", 1e3 * MAX_DEPTH),
            deepest <= MAX_DEPTH,
            format!("by at most {:.4} mm", 1e3 * deepest),
        ),
        Verdict::new("no step is refused", refused == 0, format!("{refused} are")),
    ]
}

/// Turns the nut on and off.
fn turn(case: &Case, thread: &MetricThread, nut: &Part, bolt: &Part) -> Result<Turned, String> {
    let parameters = TaskParameters {
        turns: TURNS,
        turn_rate: case.rate,
        pitch: thread.pitch,
        ..TaskParameters::default()
    };
    let touch = DVec3::Z * (thread.bolt_length() + 0.5 * thread.nut_height());
    let site = TaskSite { touch, pivot: DVec3::ZERO, size: thread.diameter };
    let settings = case.response.settings(case.friction, nut);
    let emulation = Emulation::default();
    let placement = HandlePlacement::new(&settings, &nut.object, &emulation.specification);
    let cycle = parameters.cycle(Task::TurnNut);
    let path = IntendedPath::cycle(cycle, |time| {
        placement.device_pose(&parameters.pose(Task::TurnNut, time, &site))
    })
    .map_err(|error| error.to_string())?;
    let recorded = session::run((nut, bolt), (emulation, path), settings, cycle)?;

    let [on, turned_on, off, turned_off] = parameters.turning();
    let track = Track::of(&recorded.records);
    let records = &recorded.records;
    let engaged = ENGAGED / case.rate;
    let measured = [(on + engaged, turned_on), (off, turned_off - engaged)];
    let felt = measured.map(|(from, to)| mean_felt(records, from, to));
    // The hand's push helps it to turn: friction is against it, the lead is with it.
    let locking = locking_friction(thread);
    let lever = |force: f64| force.abs() * mean_radius(thread) * (case.friction - locking) / NORMAL_FLANK;
    Ok(Turned {
        on: track.travel(measured[0].0, measured[0].1),
        off: track.travel(measured[1].0, measured[1].1),
        turns: -(track.angle_at(turned_on) - track.angle_at(on)) / TAU,
        came_off: records.last().is_some_and(|last| last.object.translation.z > touch.z + OFF),
        deepest: Exact::new(nut, bolt).deepest(&recorded.poses())?,
        torque: felt.map(|(_, torque)| torque),
        torque_theory: [lever(felt[0].0), -lever(felt[1].0)],
        largest: recorded.largest(),
        port_energy: recorded.port_energy,
        refused: recorded.refused,
    })
}

/// Mean force along the axis (N) and torque about it (N·m) that the hand feels between two times (s).
fn mean_felt(records: &[Record], from: f64, to: f64) -> (f64, f64) {
    let within = || records.iter().filter(|record| (from..to).contains(&record.time));
    let count = within().count().max(1) as f64;
    let sum = |of: fn(&Record) -> f64| within().map(of).sum::<f64>();
    (sum(|record| record.coupling.force.z) / count, sum(|record| record.coupling.torque.z) / count)
}

/// Angle about the axis, over whole turns, and height of a body in time.
pub struct Track {
    /// Time (s), angle (rad) and height (m).
    points: Vec<[f64; 3]>,
}

impl Track {
    pub fn of(records: &[Record]) -> Self {
        let mut angle = 0.0;
        let mut last: Option<Pose> = None;
        let points = records.iter().map(|record| {
            let before = last.replace(record.object).unwrap_or(record.object);
            angle += before.rotation_vector_to(&record.object).z;
            [record.time, angle, record.object.translation.z]
        });
        Self { points: points.collect() }
    }

    /// Angle at a time, rad.
    pub fn angle_at(&self, time: f64) -> f64 {
        let index = self.points.partition_point(|point| point[0] < time);
        self.points.get(index).or(self.points.last()).map_or(0.0, |point| point[1])
    }

    /// Travel along the axis in a turn between two times (s): the slope of the straight line that fits best,
    /// m. Positive for a right-handed thread.
    pub fn travel(&self, from: f64, to: f64) -> f64 {
        let within = || self.points.iter().filter(|point| (from..to).contains(&point[0]));
        let count = within().count().max(1) as f64;
        let mean = |of: usize| within().map(|point| point[of]).sum::<f64>() / count;
        let (angle, height) = (mean(1), mean(2));
        let (mut covariance, mut variance) = (0.0, 0.0);
        for point in within() {
            covariance += (point[1] - angle) * (point[2] - height);
            variance += (point[1] - angle) * (point[1] - angle);
        }
        if variance > 0.0 { TAU * covariance / variance } else { 0.0 }
    }
}

/// Pose of the nut engaged with the bolt at a whole number of pitches over the head, turned by some turns.
pub fn engaged(thread: &MetricThread, pitches: f64, turns: f64) -> Pose {
    let height = thread.pitch * (pitches + turns);
    Pose::new(DVec3::Z * height, DQuat::from_rotation_z(TAU * turns))
}
