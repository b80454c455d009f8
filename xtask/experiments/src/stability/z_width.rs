//! Z-width: walls, by stiffness and damping, that a device renders stably, and the conditions of theory.

use palpate::device::Hand;
use palpate_report::{Boundary, CellAxis, HeatMap};

use super::grid::{Plan, logarithmic, pairs};
use super::page::{Picture, Section, Table, Verdict, row};
use super::wall::{Motion, Velocity, WallCase, WallResult};
use palpate_measure::Outcome;

/// Variation of the base case that makes one picture.
struct Sweep {
    name: &'static str,
    motion: Motion,
    settings: Vec<(String, WallCase)>,
}

/// Simulated case, and the sweep and setting that it belongs to.
struct Run {
    study: &'static str,
    case: WallCase,
    result: WallResult,
}

const HANDS: [(&str, Hand); 4] =
    [("none", Hand::NONE), ("light", Hand::LIGHT), ("grip", Hand::GRIP), ("arm", Hand::ARM)];

/// Lower bound on the energy at the port of a stable wall, J.
const MIN_PORT_ENERGY: f64 = -1e-3;

/// Makes the map.
///
/// # Errors
/// If a case cannot be simulated.
pub fn map(plan: &Plan) -> Result<Section, String> {
    let stiffness = logarithmic(50.0, 20_000.0, if plan.quick { 6 } else { 14 });
    let damping = plan.choose(
        &[0.0, 0.1, 0.2, 0.5, 0.8, 1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 20.0, 30.0],
        &[0.0, 0.5, 2.0, 10.0, 30.0],
    );
    let walls = pairs(&stiffness, &damping);
    let sweeps = sweeps(plan);
    let mut cases: Vec<(&'static str, WallCase)> = Vec::new();
    for (_, setting) in sweeps.iter().flat_map(|sweep| &sweep.settings) {
        cases.extend(walls.iter().map(|&(k, b)| ("sweep", with(setting, k, b))));
    }
    cases.extend(assumed(plan));
    cases.extend(springs(plan));
    if !plan.quick {
        cases.extend(product(plan));
    }
    let results = plan.each("z-width", &cases, |(_, case)| case.run())?;
    let runs: Vec<Run> =
        cases.into_iter().zip(results).map(|((study, case), result)| Run { study, case, result }).collect();

    let contradictions = contradictions(&runs);
    let explained = plan.each("contradictions", &contradictions, |run| explain(&run.case))?;
    let mut section = Section { title: "Z-width: a wall on a device", ..Section::default() };
    section.pictures = pictures(&sweeps, &stiffness, &damping, &runs);
    section.verdicts = verdicts(&runs, &explained);
    section.paragraphs = paragraphs(&runs, &walls, &sweeps, &explained);
    section.tables = vec![table(&runs), explanations(&contradictions, &explained)];
    Ok(section)
}

fn with(setting: &WallCase, stiffness: f64, damping: f64) -> WallCase {
    WallCase { stiffness, damping, ..*setting }
}

/// Returns sweeps of one parameter at a time about the base case.
fn sweeps(plan: &Plan) -> Vec<Sweep> {
    let periods = plan.choose(&[1e-4, 2e-4, 5e-4, 1e-3, 2e-3], &[5e-4, 1e-3]);
    let delays = plan.choose(&[0.0, 5e-4, 1e-3, 2e-3, 5e-3], &[1e-3]);
    let quanta = plan.choose(&[0.0, 1e-6, 1e-5, 3e-5, 1e-4], &[1e-4]);
    let hands = plan.choose(&HANDS, &HANDS[..1]);
    let mut sweeps = Vec::new();
    for motion in Motion::ALL {
        let base = WallCase::base(motion);
        let mut sweep = |name, settings| sweeps.push(Sweep { name, motion, settings });
        let settings =
            periods.iter().map(|&period| (format!("T = {} ms", 1e3 * period), WallCase { period, ..base }));
        sweep("period", settings.collect());
        let settings =
            delays.iter().map(|&delay| (format!("delay {} ms", 1e3 * delay), WallCase { delay, ..base }));
        sweep("delay", settings.collect());
        let settings = quanta
            .iter()
            .map(|&quantum| (format!("encoder step {} µm", 1e6 * quantum), WallCase { quantum, ..base }));
        sweep("quantum", settings.collect());
        let settings = hands.iter().map(|&hand| (format!("hand: {}", hand.0), WallCase { hand, ..base }));
        sweep("hand", settings.collect());
    }
    sweeps
}

/// Returns walls under the assumptions of Colgate and Schenkel: exact position, backward difference, no
/// delay, no friction.
fn assumed(plan: &Plan) -> Vec<(&'static str, WallCase)> {
    let stiffness = logarithmic(50.0, 20_000.0, if plan.quick { 5 } else { 14 });
    let damping = plan.choose(&[0.0, 0.2, 0.4, 0.6, 0.8, 0.95], &[0.0, 0.6]);
    let periods = plan.choose(&[1e-4, 2e-4, 5e-4, 1e-3, 2e-3], &[1e-3]);
    let mut cases = Vec::new();
    for (motion, (period, hand)) in pairs(&Motion::ALL, &pairs(&periods, &HANDS)) {
        let setting = WallCase {
            period,
            hand,
            quantum: 0.0,
            friction: false,
            velocity: Velocity::BackwardDifference,
            ..WallCase::base(motion)
        };
        cases.extend(pairs(&stiffness, &damping).iter().map(|&(k, b)| ("assumed", with(&setting, k, b))));
    }
    cases
}

/// Returns springs without damping, for the conditions that assume them.
fn springs(plan: &Plan) -> Vec<(&'static str, WallCase)> {
    let stiffness = logarithmic(50.0, 20_000.0, if plan.quick { 6 } else { 14 });
    let periods = plan.choose(&[1e-4, 5e-4, 1e-3, 2e-3], &[1e-3]);
    let delays = plan.choose(&[0.0, 5e-4, 2e-3], &[0.0, 1e-3]);
    let quanta = plan.choose(&[0.0, 3e-5, 1e-4], &[3e-5]);
    let mut cases = Vec::new();
    for ((motion, hand), ((period, delay), quantum)) in
        pairs(&pairs(&Motion::ALL, &HANDS), &pairs(&pairs(&periods, &delays), &quanta))
    {
        let setting = WallCase { period, delay, quantum, hand, ..WallCase::base(motion) };
        cases.extend(stiffness.iter().map(|&k| ("springs", with(&setting, k, 0.0))));
    }
    cases
}

/// Returns all combinations of coarse values.
fn product(plan: &Plan) -> Vec<(&'static str, WallCase)> {
    let walls = pairs(&logarithmic(50.0, 20_000.0, 6), &plan.choose(&[0.0, 0.5, 5.0, 30.0], &[]));
    let mut cases = Vec::new();
    for ((motion, hand), ((period, delay), quantum)) in pairs(
        &pairs(&Motion::ALL, &HANDS),
        &pairs(&pairs(&[1e-4, 5e-4, 1e-3, 2e-3], &[0.0, 1e-3, 5e-3]), &[0.0, 3e-5, 1e-4]),
    ) {
        let setting = WallCase { period, delay, quantum, hand, ..WallCase::base(motion) };
        cases.extend(walls.iter().map(|&(k, b)| ("product", with(&setting, k, b))));
    }
    cases
}

/// Returns whether a condition calls the case passive, whatever else the condition assumes.
fn called_passive(case: &WallCase) -> bool {
    let wall = case.sampled();
    wall.colgate_schenkel() || (case.damping == 0.0 && (wall.abbott_okamura() || wall.diolaiti()))
}

/// Returns runs that are not stable though a condition calls them passive.
fn contradictions(runs: &[Run]) -> Vec<&Run> {
    runs.iter().filter(|run| called_passive(&run.case) && !run.result.outcome.is_stable()).collect()
}

/// Returns the case with one departure from the conditions' assumptions undone at a time, and all at once,
/// the most specific first.
fn restored(case: &WallCase) -> Vec<(&'static str, WallCase)> {
    let mut changes = Vec::new();
    if case.delay > 0.0 {
        changes.push(("no delay", WallCase { delay: 0.0, ..*case }));
    }
    if case.damping > 0.0 && case.velocity == Velocity::Sensed {
        changes.push(("backward difference", WallCase { velocity: Velocity::BackwardDifference, ..*case }));
    }
    if case.quantum > 0.0 {
        changes.push(("exact position", WallCase { quantum: 0.0, ..*case }));
    }
    if changes.len() > 1 {
        let velocity = Velocity::BackwardDifference;
        changes.push(("all of these", WallCase { delay: 0.0, quantum: 0.0, velocity, ..*case }));
    }
    changes
}

/// Returns the first change back to the conditions' assumptions that makes a contradicting case stable.
fn explain(case: &WallCase) -> Result<Option<&'static str>, String> {
    for (name, changed) in restored(case) {
        if changed.run()?.outcome.is_stable() {
            return Ok(Some(name));
        }
    }
    Ok(None)
}

fn verdicts(runs: &[Run], explained: &[Option<&'static str>]) -> Vec<Verdict> {
    let inside = |name: &str, belongs: &dyn Fn(&WallCase) -> bool, passive: &dyn Fn(&WallCase) -> bool| {
        let called = runs.iter().filter(|run| belongs(&run.case) && passive(&run.case));
        let (mut count, mut wrong) = (0, 0);
        for run in called {
            count += 1;
            wrong += usize::from(!run.result.outcome.is_stable());
        }
        Verdict::new(
            format!("every wall that {name} calls passive is stable"),
            count > 0 && wrong == 0,
            format!("{wrong} of {count} are not"),
        )
    };
    let as_assumed = |case: &WallCase| {
        case.quantum == 0.0 && case.delay == 0.0 && case.velocity == Velocity::BackwardDifference
    };
    let stable = || runs.iter().filter(|run| run.result.outcome.is_stable());
    let least = stable().map(|run| run.result.port_energy).fold(0.0, f64::min);
    let under = stable().filter(|run| run.result.port_energy < MIN_PORT_ENERGY).count();
    let at_hand = stable().filter(|run| run.result.hand_energy < MIN_PORT_ENERGY).count();
    let least_at_hand = stable().map(|run| run.result.hand_energy).fold(0.0, f64::min);
    let passive = || stable().filter(|run| called_passive(&run.case) && as_assumed(&run.case));
    let least_passive = passive().map(|run| run.result.hand_energy).fold(0.0, f64::min);
    let left = explained.iter().filter(|why| why.is_none()).count();
    vec![
        inside(
            "Colgate and Schenkel's condition, under its own assumptions (backward difference of an exact position, no \
             delay, no friction),",
            &as_assumed,
            &|case| case.sampled().colgate_schenkel(),
        ),
        inside(
            "Abbott and Okamura's condition (springs, rounded position, no delay)",
            &|case| case.damping == 0.0 && case.delay == 0.0,
            &|case| case.sampled().abbott_okamura(),
        ),
        inside(
            "Diolaiti, Niemeyer, Barbagli and Salisbury's condition (springs, rounded position, with delay)",
            &|case| case.damping == 0.0,
            &|case| case.sampled().diolaiti(),
        ),
        inside(
            "Colgate and Schenkel's condition, on devices as they are (filtered velocity, rounding, delay, friction),",
            &|case| !as_assumed(case),
            &|case| case.sampled().colgate_schenkel(),
        ),
        Verdict::new(
            "every wall that contradicts a condition becomes stable once the assumption that it breaks is restored",
            left == 0,
            format!("{left} of {} do not", explained.len()),
        ),
        Verdict::new(
            "every stable wall, taken alone, keeps the energy that it had from the device above −1 mJ",
            under == 0,
            format!("{under} of {} go below; the least is {:.3} mJ", stable().count(), 1e3 * least),
        ),
        Verdict::new(
            "every stable wall, taken with the device's damping and friction, keeps the energy that it had from the \
             hand above −1 mJ",
            at_hand == 0,
            format!("{at_hand} of {} go below; the least is {:.3} mJ", stable().count(), 1e3 * least_at_hand),
        ),
        Verdict::new(
            "every wall that is passive by Colgate and Schenkel under its assumptions, with the device, keeps the \
             energy that it had from the hand above −1 mJ",
            passive().count() > 0 && least_passive > MIN_PORT_ENERGY,
            format!("{} walls; the least is {:.6} mJ", passive().count(), 1e3 * least_passive),
        ),
    ]
}

/// Returns the stiffest spring below which all are stable, N/m, among the walls of a setting with the given
/// damping.
fn stiffest(runs: &[&Run], damping: f64) -> Option<f64> {
    let mut column: Vec<&&Run> = runs.iter().filter(|run| run.case.damping == damping).collect();
    column.sort_by(|a, b| a.case.stiffness.total_cmp(&b.case.stiffness));
    column.iter().take_while(|run| run.result.outcome.is_stable()).last().map(|run| run.case.stiffness)
}

fn paragraphs(
    runs: &[Run],
    walls: &[(f64, f64)],
    sweeps: &[Sweep],
    explained: &[Option<&'static str>],
) -> Vec<String> {
    let mut paragraphs = vec![format!(
        "A unilateral spring K and damper B, sampled with period T and held, act on a premium-1.5 whose handle is \
         integrated in steps of 10 µs, with Coulomb friction and rounded encoders; the hand drives it into the wall at \
         0.2 m/s and leans on it, and where there is no hand a steady force of 1 N pushes. Stable means that in the \
         last second of two the handle is at rest, within two encoder steps or the dead zone of friction (2 f_c/K), or \
         that its motion dies away steadily, by a fifth in half a second. Forces are not clipped. In rotation all values are \
         those at the lever arm of {:.1} mm at which the device's inertia weighs as much as its mass. The base case \
         is T = 1 ms, no delay, the device's own encoder step and velocity filter, and a relaxed grip. {} walls were \
         simulated.",
        1e3 * super::wall::lever_arm(),
        runs.len()
    )];
    let mut place = 0;
    let mut lines = Vec::new();
    for sweep in sweeps {
        for (name, _) in &sweep.settings {
            let runs: Vec<&Run> = runs[place..place + walls.len()].iter().collect();
            place += walls.len();
            let mut best: Option<(f64, f64)> = None;
            for &(_, b) in walls {
                if let Some(k) = stiffest(&runs, b).filter(|&k| best.is_none_or(|(most, _)| k > most)) {
                    best = Some((k, b));
                }
            }
            let spring = stiffest(&runs, 0.0).map_or("none".to_owned(), |k| k.to_string());
            let damped = best.map_or("none".to_owned(), |(k, b)| format!("{k} at B = {b}"));
            lines.push(format!("| {} | {name} | {spring} | {damped} |", sweep.motion.word()));
        }
    }
    paragraphs.push(format!(
        "The stiffest wall, N/m, with every softer one on the grid stable too:\n\n| motion | setting | without \
         damping | with damping, N·s/m |\n|---|---|---|---|\n{}",
        lines.join("\n")
    ));
    if explained.is_empty() {
        paragraphs.push("No wall contradicts a condition.".to_owned());
    } else {
        let mut reasons: Vec<&str> = explained.iter().map(|why| why.unwrap_or("nothing tried")).collect();
        reasons.sort_unstable();
        let counts: Vec<String> = reasons
            .chunk_by(|a, b| a == b)
            .map(|same| format!("{} by \"{}\"", same.len(), same[0]))
            .collect();
        paragraphs.push(format!(
            "Walls that are not stable though a condition calls them passive: {}. The conditions assume no delay (but \
             Diolaiti's), an exact position (Colgate and Schenkel) and the backward difference for a velocity. Simulated \
             again with what they assume, one change at a time, they became stable: {}.",
            explained.len(),
            counts.join(", ")
        ));
    }
    paragraphs
}

fn pictures(sweeps: &[Sweep], stiffness: &[f64], damping: &[f64], runs: &[Run]) -> Vec<Picture> {
    let count = stiffness.len() * damping.len();
    let mut place = 0;
    let mut pictures = Vec::new();
    for sweep in sweeps {
        let mut maps = Vec::new();
        for (name, setting) in &sweep.settings {
            let cells = runs[place..place + count].iter().map(|run| run.result.outcome.shade()).collect();
            place += count;
            maps.push(HeatMap {
                title: format!("{}, {name}", sweep.motion.word()),
                x: CellAxis { name: "B, N·s/m".to_owned(), values: damping.to_vec() },
                y: CellAxis { name: "K, N/m".to_owned(), values: stiffness.to_vec() },
                cells,
                legend: Outcome::legend(),
                boundaries: boundaries(setting, stiffness),
            });
        }
        pictures.push(Picture {
            name: format!("z-width-{}-{}", sweep.name, sweep.motion.word()),
            caption: format!(
                "Walls in {}, varying the {}. To the left of and below the blue line walls are passive by Colgate and \
                 Schenkel, b > K T/2 + B; below the green one springs are by Diolaiti and others.",
                sweep.motion.word(),
                if sweep.name == "quantum" { "encoder step" } else { sweep.name }
            ),
            maps,
            columns: 3,
        });
    }
    pictures
}

/// Returns the limits of the conditions on a map of stiffness by damping.
fn boundaries(setting: &WallCase, stiffness: &[f64]) -> Vec<Boundary> {
    let wall = setting.sampled();
    let (low, high) = (stiffness[0], stiffness[stiffness.len() - 1]);
    let points = logarithmic(low, high, 60)
        .into_iter()
        .map(|k| (wall.device_damping - 0.5 * k * wall.period, k))
        .filter(|(b, _)| *b >= 0.0)
        .collect();
    let viscous = wall.device_damping / (0.5 * wall.period + wall.delay);
    let rounding = if wall.quantum > 0.0 { 2.0 * wall.friction / wall.quantum } else { f64::INFINITY };
    let spring = viscous.min(rounding);
    vec![
        Boundary { name: "Colgate and Schenkel".to_owned(), points },
        Boundary {
            name: "Diolaiti and others, B = 0".to_owned(),
            points: vec![(0.0, spring), (0.1, spring)],
        },
    ]
}

fn table(runs: &[Run]) -> Table {
    let rows = runs.iter().map(|Run { study, case, result }| {
        let wall = case.sampled();
        row![
            study,
            case.motion.word(),
            case.hand.0,
            case.period,
            case.delay,
            case.quantum,
            case.velocity.word(),
            wall.friction,
            case.stiffness,
            case.damping,
            result.outcome.word(),
            result.amplitude,
            result.port_energy,
            result.hand_energy,
            wall.colgate_schenkel(),
            case.damping == 0.0 && wall.abbott_okamura(),
            case.damping == 0.0 && wall.diolaiti(),
        ]
    });
    let columns = vec![
        "study",
        "motion",
        "hand",
        "period_s",
        "delay_s",
        "encoder_step_m",
        "velocity",
        "friction_n",
        "stiffness_n_m",
        "damping_ns_m",
        "outcome",
        "amplitude_m",
        "port_energy_min_j",
        "hand_energy_min_j",
        "colgate_schenkel",
        "abbott_okamura",
        "diolaiti",
    ];
    Table { name: "z-width".to_owned(), columns, rows: rows.collect() }
}

fn explanations(contradictions: &[&Run], explained: &[Option<&'static str>]) -> Table {
    let rows = contradictions.iter().zip(explained).map(|(run, why)| {
        let case = &run.case;
        row![
            run.study,
            case.motion.word(),
            case.hand.0,
            case.period,
            case.delay,
            case.quantum,
            case.stiffness,
            case.damping,
            run.result.amplitude,
            why.unwrap_or("nothing tried"),
        ]
    });
    let columns = vec![
        "study",
        "motion",
        "hand",
        "period_s",
        "delay_s",
        "encoder_step_m",
        "stiffness_n_m",
        "damping_ns_m",
        "amplitude_m",
        "stable_with",
    ];
    Table { name: "z-width-contradictions".to_owned(), columns, rows: rows.collect() }
}
