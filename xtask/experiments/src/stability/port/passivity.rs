//! Whether the port is passive at states of contact, and whether what is felt there is the coupling's spring.

use palpate::device::Emulation;

use super::super::grid::Plan;
use super::super::page::{Section, Table, Verdict, row};
use super::certificate::Certificate;
use super::driven::Driven;
use super::frozen::Frozen;
use super::multisine::{self, Design, Response};
use super::rendered::{self, Rendered};
use super::states::{self, AtRest, Conditions, Scenery, State};

/// Delays of the device, s.
const DELAYS: [f64; 5] = [0.0, 1e-3, 2e-3, 5e-3, 5e-4];
/// Amplitude of the multisines' low harmonics by axis, m: with encoder steps some of them, and without small
/// enough that contacts change little.
const ROUNDED_AMPLITUDE: f64 = 6e-5;
const AMPLITUDE: f64 = 2e-5;
/// Sets of phases that are measured in a session.
const SETS: usize = 3;
/// Largest number of sessions at a state, and the share of the noise that is allowed that they aim at: the
/// first session tells its noise only roughly.
const MOST_SESSIONS: usize = 8;
const AIM: f64 = 0.5;
/// Seed of the phases of the first session; each further one has the next.
const FIRST_SEED: u64 = 7;
/// Coefficient of friction of every third state.
const FRICTION: f64 = 0.3;
/// Delay of the negative control, s, that the session is not told of.
const UNTOLD: f64 = 5e-3;
/// Largest change of the force from step to step while the handle is at rest, N.
const MAX_RESTLESS: f64 = 0.01;
/// Noise above which a state cannot be told to be passive, in units of the device's damping.
const MAX_NOISE: f64 = 0.5;
/// Largest deviation of what is rendered from what is wanted.
const MAX_RENDERED: f64 = 0.05;

/// A state of contact with its conditions, and what is measured there; nothing where there was no contact.
struct Case {
    /// Scenery and number.
    name: String,
    state: State,
    at: Conditions,
}

/// Measurements at a state of contact.
#[derive(Clone, Copy, Debug)]
pub struct Measured {
    /// Number of sessions.
    pub sessions: usize,
    pub certificate: Certificate,
    pub rendered: Rendered,
    /// Least eigenvalue with its noise by the device's viscous damping alone.
    viscous: f64,
    /// Stiffness of the coupling, N/m, and the force at rest, N.
    stiffness: f64,
    force: f64,
    /// Largest change of the force from step to step at rest, N.
    restless: f64,
    /// Steps in which the object waited for newer contacts, while it was measured.
    waited: u64,
    /// How often a session dropped the wrench while it was measured, since more energy had come out than it
    /// allows.
    dropped: u64,
}

/// Maps the states of contact.
///
/// # Errors
/// If a model cannot be made, or a session cannot start.
pub fn map(plan: &Plan, section: &mut Section) -> Result<(), String> {
    let sceneries = states::sceneries(plan)?;
    let states = states::draw(if plan.quick { 3 } else { 100 }, &sceneries)?;
    let mut counts = vec![0; sceneries.len()];
    let cases: Vec<Case> = states
        .into_iter()
        .map(|state| {
            let count: &mut usize = &mut counts[state.scenery];
            *count += 1;
            let name = format!("{} {count}", sceneries[state.scenery].name);
            Case { name, state, at: conditions(*count - 1, state.scenery) }
        })
        .collect();
    let measured = plan.each("port: states", &cases, |case| measure(&case.state, &sceneries, &case.at))?;
    let reached = reached(&cases, &measured);
    let at = |holds: &dyn Fn(&Measured) -> bool| names(&reached, holds);
    section.paragraphs.push(format!(
        "A session is driven into {} states of contact of the jaws, of a nut on a bolt and of a peg in a hole, with contacts \
         as constraints, delays of 0 to 5 ms, encoder steps or none, contacts at 50 to 1,000 Hz, and friction of {FRICTION} in \
         every third state, where most contacts stick. There the handle is moved along and about all axes by small multisines, and \
         the response of the wrench measured up to half the sampling rate. The least eigenvalue is the part of the device's \
         damping that is left in the worst direction: 1 where the session needs none, and negative where a hand can draw \
         energy. The noise is four standard errors, from the differences between sets of phases. {SETS} sets are measured in a \
         session. Where they are too noisy to tell, so many more sessions follow, with other phases, as should bring the noise \
         down to what is allowed: up to {MOST_SESSIONS} sessions, or {} sets, in all. That was so at {}. No session is measured \
         for longer, since it drops its wrench once more energy has come out than it allows since the wrench was last zero, \
         and there is no damping here that takes up what comes out. While it was measured, that happened at {}.",
        cases.len(),
        MOST_SESSIONS * SETS,
        listed(&at(&|found| found.sessions > 1), cases.len()),
        listed(&at(&|found| found.dropped > 0), cases.len()),
    ));
    section.tables.push(table(&cases, &measured));
    section.verdicts.extend(verdicts(&cases, &measured));
    section.verdicts.extend(controls(&cases, &sceneries)?);
    Ok(())
}

/// The conditions of the state of a scenery by its number. Their periods have no common divisors, so that
/// they vary independently. Queries of the nut take ten times as long as those of the jaws, those of the peg
/// three times: they are seldom measured at the higher rates.
fn conditions(index: usize, scenery: usize) -> Conditions {
    let rates = match scenery {
        0 => [50.0, 100.0, 500.0, 50.0, 100.0, 1000.0, 100.0],
        1 => [50.0, 100.0, 100.0, 50.0, 50.0, 500.0, 50.0],
        _ => [50.0, 100.0, 500.0, 100.0, 50.0, 1000.0, 100.0],
    };
    let delay = DELAYS[index % 5];
    Conditions {
        delay,
        told_delay: delay,
        encoders: index % 2 == 1,
        rate: rates[index % 7],
        friction: if index % 3 == 2 { FRICTION } else { 0.0 },
    }
}

/// Measures at a state; nothing if no contact is reached. How many sessions are measured is decided once, by
/// the noise of the first: to stop when the noise happens to be low would let it look lower than it is.
///
/// # Errors
/// If a session cannot start.
pub fn measure(
    state: &State,
    sceneries: &[Scenery],
    conditions: &Conditions,
) -> Result<Option<Measured>, String> {
    let amplitude = if conditions.encoders { ROUNDED_AMPLITUDE } else { AMPLITUDE };
    let design = Design { amplitude, sets: SETS };
    let bare = Emulation::default().handle;
    let mut handle = bare;
    if conditions.encoders {
        let (linear, angular) = multisine::damping_of_friction(&design);
        handle.damping += bare.friction * linear;
        handle.angular_damping += bare.angular_friction * angular;
    }
    let (mut waited, mut dropped) = (0, 0);
    let mut session = |seed: u64| -> Result<Option<(Driven, AtRest, Response)>, String> {
        let Some((mut session, about, rest)) = state.reach(sceneries, conditions)? else { return Ok(None) };
        let before = session.haptic().telemetry().events;
        let response = multisine::measure(&mut session, &about, &design, seed);
        let after = session.haptic().telemetry().events;
        waited += after.waited - before.waited;
        dropped += after.energy_created - before.energy_created;
        Ok(Some((session, rest, response)))
    };
    let Some((first, rest, mut response)) = session(FIRST_SEED)? else { return Ok(None) };
    let (coupling, lags) = (first.haptic().coupling(), first.haptic().velocity_lags());
    let judged = |response: &Response| {
        let certificate = Certificate::of(response, &handle, conditions.delay);
        (certificate, Rendered::of(response, coupling, lags, &rest.felt))
    };
    let (certificate, rendered) = judged(&response);
    let sessions = sessions(f64::max(certificate.largest_noise / MAX_NOISE, rendered.noise / MAX_RENDERED));
    for seed in (FIRST_SEED..).take(sessions).skip(1) {
        if let Some((_, _, more)) = session(seed)? {
            response.add(more);
        }
    }
    let (certificate, rendered) = judged(&response);
    Ok(Some(Measured {
        sessions,
        certificate,
        viscous: Certificate::of(&response, &bare, conditions.delay).bound,
        rendered,
        stiffness: coupling.linear_stiffness,
        force: rest.felt.force.length(),
        restless: rest.restless,
        waited,
        dropped,
    }))
}

/// The number of sessions that bring the noise down to what is allowed, by the ratio of the first session's
/// noise to that. Noise falls with the square root of their number.
pub fn sessions(ratio: f64) -> usize {
    let needed = if ratio > 1.0 { (ratio / AIM).powi(2).ceil() } else { 1.0 };
    (needed as usize).clamp(1, MOST_SESSIONS)
}

fn table(cases: &[Case], measured: &[Option<Measured>]) -> Table {
    let rows = cases.iter().zip(measured).map(|(Case { name, at, .. }, found)| {
        let mut row = row![name, at.delay, at.encoders, at.rate, at.friction, found.is_some()];
        if let Some(found) = found {
            let Measured { certificate, rendered, .. } = found;
            row.extend(row![
                found.force,
                found.restless,
                found.stiffness,
                found.waited,
                found.sessions,
                found.dropped,
                certificate.least,
                certificate.frequency,
                certificate.noise,
                certificate.bound,
                certificate.largest_noise,
                found.viscous,
                rendered.deviation,
                rendered.noise,
                rendered.stiffness,
                rendered.damping,
            ]);
        }
        row.resize(22, String::new());
        row
    });
    let columns = vec![
        "state",
        "delay_s",
        "encoder_steps",
        "contact_rate_hz",
        "friction",
        "touches",
        "force_n",
        "change_at_rest_n",
        "coupling_stiffness_n_m",
        "waited_steps",
        "sessions",
        "dropped_wrenches",
        "least_eigenvalue",
        "at_hz",
        "noise_there",
        "least_with_noise",
        "largest_noise",
        "least_without_friction",
        "rendered_deviation",
        "rendered_noise",
        "rendered_stiffness",
        "rendered_damping",
    ];
    Table { name: "port".to_owned(), columns, rows: rows.collect() }
}

/// The states with contact.
fn reached<'a>(cases: &'a [Case], measured: &'a [Option<Measured>]) -> Vec<(&'a Case, &'a Measured)> {
    cases.iter().zip(measured).filter_map(|(case, found)| Some((case, found.as_ref()?))).collect()
}

fn verdicts(cases: &[Case], measured: &[Option<Measured>]) -> Vec<Verdict> {
    let found = reached(cases, measured);
    let restless = names(&found, |found| found.restless > MAX_RESTLESS);
    let most = found.iter().map(|(_, found)| found.restless).fold(0.0, f64::max);
    let mut verdicts = vec![
        Verdict::new(
            "nearly all states are reached: 9 of 10 touch",
            10 * found.len() >= 9 * cases.len(),
            format!("{} of {}", found.len(), cases.len()),
        ),
        Verdict::new(
            format!("the handle at rest, the force changes by at most {MAX_RESTLESS} N from step to step"),
            restless.is_empty(),
            format!("by more at {}, by at most {most:.3} N", listed(&restless, found.len())),
        ),
    ];
    for (encoders, steps) in
        [(false, "without encoder steps"), (true, "with encoder steps and the device's friction")]
    {
        let of: Vec<(&Case, &Measured)> =
            found.iter().filter(|(case, _)| case.at.encoders == encoders).copied().collect();
        verdicts.extend(passive(&of, steps));
        verdicts.extend(felt(&of, steps));
    }
    verdicts
}

/// Whether the smallest eigenvalues are not below the noise, and whether that can be told.
fn passive(of: &[(&Case, &Measured)], steps: &str) -> [Verdict; 2] {
    let active = names(of, |found| !found.certificate.holds());
    let noisy = names(of, |found| found.certificate.holds() && found.certificate.largest_noise > MAX_NOISE);
    let least = of.iter().map(|(_, found)| found.certificate.bound).fold(f64::INFINITY, f64::min);
    let mut noises: Vec<f64> = of.iter().map(|(_, found)| found.certificate.largest_noise).collect();
    noises.sort_by(f64::total_cmp);
    [
        Verdict::new(
            format!(
                "{steps}, the smallest eigenvalue is not below minus the measurement's noise at any state"
            ),
            active.is_empty() && !of.is_empty(),
            format!(
                "below at {}; the least with its noise is {least:.3} of the device's damping",
                listed(&active, of.len())
            ),
        ),
        Verdict::new(
            format!(
                "{steps}, that can be told at every state: the noise is at most {MAX_NOISE} of the damping"
            ),
            noisy.is_empty(),
            format!(
                "too noisy are {}; the noise is at most {:.3} at half of the states, and {:.3} at all",
                listed(&noisy, of.len()),
                noises.get(noises.len() / 2).copied().unwrap_or(f64::NAN),
                noises.last().copied().unwrap_or(f64::NAN),
            ),
        ),
    ]
}

/// Whether what is felt is the coupling, and whether that can be told.
fn felt(of: &[(&Case, &Measured)], steps: &str) -> [Verdict; 2] {
    let off = names(of, |found| found.rendered.beyond_noise > MAX_RENDERED);
    let noisy =
        names(of, |found| found.rendered.beyond_noise <= MAX_RENDERED && found.rendered.noise > MAX_RENDERED);
    let most = of.iter().fold(0.0, |most: f64, (_, found)| most.max(found.rendered.deviation));
    let percent = 100.0 * MAX_RENDERED;
    let highest = rendered::HIGHEST;
    [
        Verdict::new(
            format!(
                "{steps}, pressing on is felt as the coupling's spring and lagged damper below {highest} Hz: no \
                 state is off by more than {percent:.0} % and the noise"
            ),
            off.is_empty() && !of.is_empty(),
            format!("off are {}; the largest deviation is {:.1} %", listed(&off, of.len()), 100.0 * most),
        ),
        Verdict::new(
            format!("{steps}, that can be told at every state: the noise is at most {percent:.0} %, too"),
            noisy.is_empty(),
            format!("too noisy are {}", listed(&noisy, of.len())),
        ),
    ]
}

/// Names of the states of which something holds.
fn names<'a>(of: &[(&'a Case, &Measured)], holds: impl Fn(&Measured) -> bool) -> Vec<&'a str> {
    of.iter().filter(|(_, found)| holds(found)).map(|(case, _)| case.name.as_str()).collect()
}

fn listed(names: &[&str], of: usize) -> String {
    match names {
        [] => format!("none of {of} states"),
        _ => format!("{} of {of} states ({})", names.len(), names.join(", ")),
    }
}

/// The negative controls: a session that is not told of the device's delay, and a frozen force.
fn controls(cases: &[Case], sceneries: &[Scenery]) -> Result<Vec<Verdict>, String> {
    let late = Conditions { delay: UNTOLD, told_delay: 0.0, encoders: false, rate: 50.0, friction: 0.0 };
    let mut verdicts = Vec::new();
    for (index, scenery) in sceneries.iter().enumerate() {
        let mut bound = f64::NAN;
        for case in cases.iter().filter(|case| case.state.scenery == index) {
            if let Some(found) = measure(&case.state, sceneries, &late)? {
                bound = found.certificate.bound;
                break;
            }
        }
        let who = format!("{}: a session that is not told of a delay of {} ms", scenery.name, 1e3 * UNTOLD);
        verdicts.push(caught(&who, bound));
    }
    let (mut frozen, about) = Frozen::start((400.0, 0.15), 50.0)?;
    let response =
        multisine::measure(&mut frozen, &about, &Design { amplitude: AMPLITUDE, sets: SETS }, FIRST_SEED);
    let bound = Certificate::of(&response, &Emulation::default().handle, 0.0).bound;
    verdicts.push(caught("a contact whose force is frozen between queries at 50 Hz", bound));
    Ok(verdicts)
}

/// Whether a port that is not passive is found not to be.
fn caught(who: &str, bound: f64) -> Verdict {
    let found = format!("the least with its noise is {bound:.3} of the device's damping");
    Verdict::new(format!("{who} is found not to be passive"), bound < 0.0, found)
}
