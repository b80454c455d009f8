//! Map of a thread that locks itself: a nut is pushed along the axis and free to turn.
//!
//! A push F along the axis turns a nut if the thread's lead drives it more than friction holds it. On a
//! flank at the mean radius r, with lead angle λ, tan λ = P/(2π r), and flank angle α = 30°, measured in the
//! plane through the axis, the normal of the flank makes an angle with the tangent of the helix's cylinder:
//! in its normal section the flank angle is αₙ with tan αₙ = tan α cos λ. The normal force N then has, along
//! the axis, N cos αₙ cos λ + μ N sin λ = F, and around it N cos αₙ sin λ − μ N cos λ, which is zero at
//!
//! μₛ = tan λ cos αₙ,
//!
//! the condition of self-locking (Shigley, *Mechanical Engineering Design*, power screws, with the
//! collar left out; there with αₙ ≈ α). The mean radius is the middle of where the flanks overlap, from the
//! nut's minor radius to the bolt's major radius.

use std::f64::consts::TAU;

use palpate::Pose;
use palpate::device::{Emulation, Hand, IntendedPath};
use palpate::glam::DVec3;
use palpate::models::MetricThread;
use palpate_report::{CellAxis, HeatMap};

use super::super::grid::Plan;
use super::super::page::{Picture, Section, Table, Verdict, row};
use super::nut::{Track, engaged};
use super::{Part, Response, bolt_and_nut, responses, session};

/// Force of the push, N, and stiffness with which it is exerted, N/m: so soft that it hardly falls as the nut
/// goes on.
const PUSH: f64 = 2.0;
const PUSH_STIFFNESS: f64 = 20.0;
/// Time in which the push grows, and length of a session, s.
const GROWTH: f64 = 0.3;
const DURATION: f64 = 1.6;
/// Turn from which a nut counts as turning by itself, rad, within the last part of a session (s). Driven by a
/// tenth of the torque that it has without friction, it would turn by a radian.
const TURNING: f64 = 0.01;
const OBSERVED: f64 = 0.5;
/// Height of the nut's centre over the head, in pitches.
const PITCHES: f64 = 9.0;
/// Friction that is bisected, from where the nut turns to where it does not, and number of halvings: to 1 %
/// of the theory's.
const BRACKET: [f64; 2] = [0.0, 0.12];
const HALVINGS: usize = 8;
/// Deviation from theory that is allowed.
const MAX_DEVIATION: f64 = 0.1;

/// Mean radius of the overlap of the flanks, m.
pub fn mean_radius(thread: &MetricThread) -> f64 {
    let minor = 0.5 * thread.minor_diameter() + thread.nut_allowance;
    let major = 0.5 * thread.diameter - thread.bolt_allowance;
    0.5 * (minor + major)
}

/// Friction from which a thread with a flank angle of 30° locks itself.
pub fn locking_friction(thread: &MetricThread) -> f64 {
    let lead = (thread.pitch / (TAU * mean_radius(thread))).atan();
    let normal_flank = (30.0_f64.to_radians().tan() * lead.cos()).atan();
    lead.tan() * normal_flank.cos()
}

/// Friction at which a response begins to hold the nut.
struct Found {
    response: &'static str,
    /// Whether the nut turns without friction, and is held at the upper end of the bracket.
    bracketed: bool,
    friction: f64,
    /// Friction and turn in the last part of the session, rad, of each session.
    tried: Vec<(f64, f64)>,
}

/// Makes the map.
///
/// # Errors
/// If a mesh cannot be made, or a session cannot start.
pub fn map(plan: &Plan) -> Result<Section, String> {
    let thread = MetricThread::M16;
    let [bolt, nut] = bolt_and_nut(&thread)?;
    let halvings = if plan.quick { 4 } else { HALVINGS };
    let responses = responses();
    let found =
        plan.each("locking", &responses, |response| bisect(response, (&thread, &nut, &bolt), halvings))?;
    let theory = locking_friction(&thread);
    let rows = found.iter().flat_map(|found| {
        found.tried.iter().map(|(friction, turn)| row![found.response, *friction, *turn, *turn >= TURNING])
    });
    let table = Table {
        name: "locking".to_owned(),
        columns: vec!["response", "friction", "turn_rad", "turns_by_itself"],
        rows: rows.collect(),
    };
    let judged = found.last().ok_or("no response")?;
    let off = judged.friction / theory - 1.0;
    Ok(Section {
        title: "Locking: a nut that is pushed and free to turn",
        paragraphs: vec![format!(
            "A nut M16 in the middle of its bolt is pushed along the axis by {PUSH} N, and nothing but friction keeps it from \
             turning. A thread locks itself from μ = tan λ cos α on, with the lead angle λ at the mean radius of the flanks and \
             the flank angle α = 30° in the normal section: {theory:.4}. Found by {halvings} halvings of {} to {}: {}.",
            BRACKET[0],
            BRACKET[1],
            found
                .iter()
                .map(|found| format!("{} {:.4}", found.response, found.friction))
                .collect::<Vec<_>>()
                .join(", ")
        )],
        pictures: vec![picture(judged)],
        tables: vec![table],
        verdicts: vec![
            Verdict::new(
                "a nut turns by itself without friction, and not with much",
                judged.bracketed,
                format!("turns of {:.3} and {:.4} rad", judged.tried[0].1, judged.tried[1].1),
            ),
            Verdict::new(
                "the thread locks itself at the friction of theory, within 10 %",
                judged.bracketed && off.abs() <= MAX_DEVIATION,
                format!("{:.4} against {theory:.4}, {:+.1} %", judged.friction, 100.0 * off),
            ),
        ],
    })
}

fn picture(found: &Found) -> Picture {
    let mut tried = found.tried.clone();
    tried.sort_by(|a, b| a.0.total_cmp(&b.0));
    let map = HeatMap {
        title: found.response.to_owned(),
        x: CellAxis {
            name: "coefficient of friction".to_owned(),
            values: tried.iter().map(|(friction, _)| *friction).collect(),
        },
        y: CellAxis { name: "".to_owned(), values: vec![1.0] },
        cells: tried.iter().map(|(_, turn)| if *turn < TURNING { 0.0 } else { 1.0 }).collect(),
        legend: vec![(0.0, "held".to_owned()), (1.0, "turns by itself".to_owned())],
        boundaries: Vec::new(),
    };
    Picture {
        name: "locking".to_owned(),
        caption: "Whether a nut that is pushed turns by itself, by friction.".to_owned(),
        maps: vec![map],
        columns: 1,
    }
}

fn bisect(
    response: &Response,
    parts: (&MetricThread, &Part, &Part),
    halvings: usize,
) -> Result<Found, String> {
    let [mut turning, mut held] = BRACKET;
    let push = |friction: f64| push(response, parts, friction, DURATION);
    let mut tried = vec![(turning, push(turning)?), (held, push(held)?)];
    let bracketed = tried[0].1 >= TURNING && tried[1].1 < TURNING;
    if bracketed {
        for _ in 0..halvings {
            let middle = 0.5 * (turning + held);
            let turn = push(middle)?;
            tried.push((middle, turn));
            if turn < TURNING { held = middle } else { turning = middle }
        }
    }
    Ok(Found { response: response.name, bracketed, friction: 0.5 * (turning + held), tried })
}

/// Pushes the nut for some time (s); returns how far it turns in the last part of the session, rad.
pub(super) fn push(
    response: &Response,
    (thread, nut, bolt): (&MetricThread, &Part, &Part),
    friction: f64,
    duration: f64,
) -> Result<f64, String> {
    let start = engaged(thread, PITCHES, 0.0);
    // A hand that pushes and guides the nut, and leaves it free to turn.
    let hand = Hand { stiffness: PUSH_STIFFNESS, angular_stiffness: 0.0, angular_damping: 0.0, ..Hand::GRIP };
    let mut emulation = Emulation { hand: Hand { inertia: 0.0, ..hand }, ..Emulation::default() };
    // A handle that turns freely, so that only the thread holds the nut.
    emulation.handle.inertia = 1e-6;
    emulation.handle.angular_friction = 0.0;
    emulation.handle.angular_damping = 1e-6;
    emulation.specification.handle = Some(emulation.handle);
    let path = IntendedPath::function(move |time| {
        let x = (time / GROWTH).clamp(0.0, 1.0);
        let (ahead, rate) = (x * x * (3.0 - 2.0 * x), 6.0 * x * (1.0 - x) / GROWTH);
        let reach = DVec3::NEG_Z * (PUSH / PUSH_STIFFNESS);
        let pose = Pose::new(start.translation + reach * ahead, start.rotation);
        (pose, palpate::Twist::new(reach * rate, DVec3::ZERO))
    });
    let settings = response.settings(friction, nut);
    let recorded = session::run((nut, bolt), (emulation, path), settings, duration)?;
    let track = Track::of(&recorded.records);
    Ok((track.angle_at(duration) - track.angle_at(duration - OBSERVED.min(0.5 * duration))).abs())
}
