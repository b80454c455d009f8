//! Map of the device's port: whether a session, with the device, is passive for whatever hand holds it.
//!
//! # What is tested
//!
//! The hand holds a handle of mass and damping diag(b, b_θ) = D. At each sample k the session reads its
//! displacement x_k, of six components, and answers with a wrench w_k = −H x that is held for a period T from
//! a time t_d = (n + φ) T on. [`driven`] tells the handle where to be and records the wrenches, so that H is
//! measured alone, contacts, filters and all. The mass stores energy and needs no measurement.
//!
//! Between two samples the handle moves by Δ = x_{k+1} − x_k, and has to be at y after a time φ T, when the
//! wrench changes from w_{k−n−1} to w_{k−n}. The damping takes least energy on the way if both parts are
//! straight (Colgate and Schenkel 1997). With y at its worst, the sum over k of
//!
//! Δᵀ D Δ/T − Δᵀ (φ w_{k−n−1} + (1 − φ) w_{k−n}) − ¼ T φ (1 − φ) (w_{k−n} − w_{k−n−1})ᵀ D⁻¹ (w_{k−n} −
//! w_{k−n−1})
//!
//! is what the hand has to give. It is not negative, for every motion, if and only if
//!
//! C(ω) = D − Herm(q σ) − ¼ T² φ (1 − φ) Hᴴ D⁻¹ H with q = T/(2 (1 − cos ωT)) (1 − z⁻¹) z⁻ⁿ H(z), σ = 1 − φ
//! + φ z⁻¹ and z = e^(jωT)
//!
//! has no negative eigenvalue up to half the sampling rate, Herm(A) being (A + Aᴴ)/2. For one axis that is
//! the condition in `palpate_dynamics`'s `port.rs`. 2 C is Z + Zᴴ for the impedance Z = D + T/(z − 1) z⁻ⁿ σ
//! H, from the mean velocity in a period to the mean wrench. The impedance is tested and not its inverse, the
//! admittance: a session takes motions and gives wrenches, one is positive real where the other is, and the
//! inverse would carry the noise of directions in which little is felt. Eigenvalues are those of D^(−½) C
//! D^(−½), the part of the device's damping that is left.
//!
//! # Encoder steps and friction
//!
//! Without encoder steps the device's friction is left out. With them it has to absorb the rounding of
//! positions and the lag of the estimates between steps ([`multisine`] moves by several steps), so that it
//! counts: D is raised by the damping that takes as much energy from the multisines as the friction does, f_c
//! times the mean speed over the mean square of the speed. The table also has the least eigenvalue without
//! it.

mod boundary;
mod certificate;
mod driven;
mod frozen;
mod hands;
mod multisine;
mod rendered;
mod states;
#[cfg(test)]
mod tests;

use palpate::device::Emulation;

use super::grid::{Plan, pairs};
use super::page::{Section, Table, Verdict, row};
use boundary::{Case, MAX_DEVIATION};
use certificate::Certificate;
use hands::{Drawn, Genes};
use multisine::Design;
use rendered::Rendered;
use states::{Conditions, Scenery, State};

/// Delays of the device, s.
const DELAYS: [f64; 5] = [0.0, 1e-3, 2e-3, 5e-3, 5e-4];
/// Amplitude of the multisines' low harmonics by axis, m: with encoder steps, and without.
const ROUNDED_AMPLITUDE: f64 = 6e-5;
const AMPLITUDE: f64 = 2e-6;
/// Stiffness of the coupling of the negative control, over the largest that the device renders passively.
const TOO_STIFF: f64 = 2.0;
/// Largest change of the force from step to step while the handle is at rest, N.
const MAX_RESTLESS: f64 = 0.01;
/// Noise above which a state is not judged passive, in units of the device's damping.
const MAX_NOISE: f64 = 0.5;
/// Largest deviation of what is rendered from what is wanted.
const MAX_RENDERED: f64 = 0.05;
/// Numbers of hands drawn at random, of those that climb, and of the steps that they climb, in full and
/// quick.
const HANDS: (usize, usize) = (10_000, 60);
const CLIMBERS: (usize, usize) = (16, 2);
const CLIMBS: (usize, usize) = (25, 3);

/// Measurements at a state of contact.
#[derive(Clone, Copy, Debug)]
struct Measured {
    certificate: Certificate,
    rendered: Rendered,
    /// Least eigenvalue with its noise by the device's viscous damping alone.
    viscous: f64,
    /// Stiffness of the coupling, N/m, and the force at rest, N.
    stiffness: f64,
    force: f64,
    /// Largest change of the force from step to step at rest, N.
    restless: f64,
    /// Steps in which the object waited for newer contacts, while it was measured.
    waited: u64,
}

/// Makes the map.
///
/// # Errors
/// If a model cannot be made, or a session cannot start.
pub fn map(plan: &Plan) -> Result<Section, String> {
    let mut section = Section { title: "Port: passive for every hand", ..Section::default() };
    states_of_contact(plan, &mut section)?;
    limits(plan, &mut section)?;
    search(plan, &mut section)?;
    Ok(section)
}

fn states_of_contact(plan: &Plan, section: &mut Section) -> Result<(), String> {
    let sceneries = states::sceneries(plan)?;
    let states = states::draw(if plan.quick { 3 } else { 100 }, &sceneries)?;
    let cases: Vec<(State, Conditions)> = states
        .into_iter()
        .enumerate()
        .map(|(index, state)| (state, conditions(if plan.quick { 3 + index } else { index }, state.scenery)))
        .collect();
    let measured =
        plan.each("port: states", &cases, |(state, conditions)| measure(state, &sceneries, conditions))?;
    section.paragraphs.push(format!(
        "A session is driven into {} states of contact of the jaws, of a nut on a bolt and of a peg in a hole, with contacts \
         as constraints, delays of 0 to 5 ms, encoder steps or none, and contacts at 50 to 1,000 Hz. There the handle is \
         moved along and about all axes by small multisines, and the response of the wrench measured up to half the \
         sampling rate. The least eigenvalue is the part of the device's damping that is left in the worst direction: 1 \
         where the session needs none, and negative where a hand can draw energy. The noise is four standard errors, from \
         the differences between periods and phases.",
        cases.len(),
    ));
    section.tables.push(table(&cases, &measured, &sceneries));
    section.verdicts.extend(verdicts(&cases, &measured));
    section.verdicts.extend(controls(&cases, &sceneries)?);
    Ok(())
}

/// The conditions of a state by its number. Queries of the nut take ten times as long as those of the jaws,
/// those of the peg three times: they are seldom measured at the higher rates.
fn conditions(index: usize, scenery: usize) -> Conditions {
    let rates: &[f64] = match scenery {
        0 => &[50.0, 100.0, 500.0, 1000.0],
        1 => &[50.0, 100.0, 100.0, 50.0, 50.0, 500.0, 50.0],
        _ => &[50.0, 100.0, 500.0, 100.0, 50.0, 1000.0, 100.0],
    };
    Conditions {
        delay: DELAYS[index % 5],
        encoders: index / 5 % 2 == 1,
        rate: rates[index / 3 % rates.len()],
        stiffness: None,
    }
}

/// Measures at a state; nothing if no contact is reached.
fn measure(
    state: &State,
    sceneries: &[Scenery],
    conditions: &Conditions,
) -> Result<Option<Measured>, String> {
    let Some((mut session, about, rest)) = state.reach(sceneries, conditions)? else { return Ok(None) };
    let amplitude = if conditions.encoders { ROUNDED_AMPLITUDE } else { AMPLITUDE };
    let before = session.haptic().telemetry().events.waited;
    let design = Design { amplitude, sets: 1 };
    let response = multisine::measure(&mut session, &about, &design, 7);
    let bare = Emulation::default().handle;
    let mut handle = bare;
    if conditions.encoders {
        let (linear, angular) = multisine::damping_of_friction(&design);
        handle.damping += bare.friction * linear;
        handle.angular_damping += bare.angular_friction * angular;
    }
    let haptic = session.haptic();
    let (coupling, lags) = (haptic.coupling(), haptic.velocity_lags());
    Ok(Some(Measured {
        certificate: Certificate::of(&response, &handle, conditions.delay),
        viscous: Certificate::of(&response, &bare, conditions.delay).bound,
        rendered: Rendered::of(&response, coupling, lags, &rest.felt),
        stiffness: coupling.linear_stiffness,
        force: rest.felt.force.length(),
        restless: rest.restless,
        waited: haptic.telemetry().events.waited - before,
    }))
}

fn table(cases: &[(State, Conditions)], measured: &[Option<Measured>], sceneries: &[Scenery]) -> Table {
    let rows = cases.iter().zip(measured).map(|((state, at), found)| {
        let mut row = row![sceneries[state.scenery].name, at.delay, at.encoders, at.rate, found.is_some()];
        if let Some(Measured { certificate, rendered, viscous, stiffness, force, restless, waited }) = found {
            row.extend(row![
                force,
                restless,
                stiffness,
                waited,
                certificate.least,
                certificate.frequency,
                certificate.noise,
                certificate.bound,
                certificate.largest_noise,
                viscous,
                rendered.deviation,
                rendered.stiffness,
                rendered.damping,
            ]);
        }
        row.resize(18, String::new());
        row
    });
    let columns = vec![
        "scenery",
        "delay_s",
        "encoder_steps",
        "contact_rate_hz",
        "touches",
        "force_n",
        "change_at_rest_n",
        "coupling_stiffness_n_m",
        "waited_steps",
        "least_eigenvalue",
        "at_hz",
        "noise_there",
        "least_with_noise",
        "largest_noise",
        "least_without_friction",
        "rendered_deviation",
        "rendered_stiffness",
        "rendered_damping",
    ];
    Table { name: "port".to_owned(), columns, rows: rows.collect() }
}

fn verdicts(cases: &[(State, Conditions)], measured: &[Option<Measured>]) -> Vec<Verdict> {
    let found: Vec<(&Conditions, &Measured)> = cases
        .iter()
        .zip(measured)
        .filter_map(|((_, at), found)| found.as_ref().map(|found| (at, found)))
        .collect();
    let restless = found.iter().filter(|(_, found)| found.restless > MAX_RESTLESS).count();
    let most = found.iter().map(|(_, found)| found.restless).fold(0.0, f64::max);
    let mut verdicts = vec![
        Verdict::new(
            "nearly all states are reached: 9 of 10 touch",
            10 * found.len() >= 9 * cases.len(),
            format!("{} of {}", found.len(), cases.len()),
        ),
        Verdict::new(
            format!(
                "with the handle at rest, the force changes by at most {MAX_RESTLESS} N from step to step"
            ),
            restless == 0,
            format!("by more at {restless} of {} states, by at most {most:.3} N", found.len()),
        ),
    ];
    for encoders in [false, true] {
        verdicts.push(passive(&found, encoders));
    }
    for encoders in [false, true] {
        let of: Vec<f64> = found
            .iter()
            .filter(|(at, _)| at.encoders == encoders)
            .map(|(_, found)| found.rendered.deviation)
            .collect();
        let beyond = of.iter().filter(|deviation| **deviation > MAX_RENDERED).count();
        let most = of.iter().fold(0.0, |most: f64, deviation| most.max(*deviation));
        verdicts.push(Verdict::new(
            format!(
                "pressing on is felt as the coupling's spring and lagged damper below {} Hz, within 5 %, {} encoder steps",
                rendered::HIGHEST,
                if encoders { "with" } else { "without" },
            ),
            beyond == 0,
            format!("{beyond} of {} states are further off, by up to {:.1} %", of.len(), 100.0 * most),
        ));
    }
    verdicts
}

/// Whether the smallest eigenvalues are not below the noise, with encoder steps or without.
fn passive(found: &[(&Conditions, &Measured)], encoders: bool) -> Verdict {
    let of: Vec<&Measured> =
        found.iter().filter(|(at, _)| at.encoders == encoders).map(|(_, found)| *found).collect();
    let active = of.iter().filter(|found| !found.certificate.holds()).count();
    let least = of.iter().map(|found| found.certificate.bound).fold(f64::INFINITY, f64::min);
    let noisy = of.iter().filter(|found| found.certificate.largest_noise > MAX_NOISE).count();
    let mut noises: Vec<f64> = of.iter().map(|found| found.certificate.largest_noise).collect();
    noises.sort_by(f64::total_cmp);
    let steps = if encoders { "with encoder steps and friction" } else { "without encoder steps" };
    Verdict::new(
        format!("{steps}, the smallest eigenvalue is not below minus the measurement's noise at any state"),
        active == 0 && noisy == 0 && !of.is_empty(),
        format!(
            "it is at {active} of {}, and {noisy} are too noisy to tell; the least with its noise is {least:.3} of the device's damping; the noise is at most \
             {:.3} at half of the states, and {:.3} at all",
            of.len(),
            noises.get(noises.len() / 2).copied().unwrap_or(f64::NAN),
            noises.last().copied().unwrap_or(f64::NAN),
        ),
    )
}

/// The negative controls: a coupling that is too stiff, and a frozen force.
fn controls(cases: &[(State, Conditions)], sceneries: &[Scenery]) -> Result<Vec<Verdict>, String> {
    let handle = Emulation::default().handle;
    let delay = 1e-3;
    let stiffness = TOO_STIFF * handle.damping / (0.5 * driven::PERIOD + delay);
    let stiff = Conditions { delay, encoders: false, rate: 50.0, stiffness: Some(stiffness) };
    let mut found = None;
    for (state, _) in cases.iter().filter(|(state, _)| state.scenery == 2) {
        found = measure(state, sceneries, &stiff)?;
        if found.is_some() {
            break;
        }
    }
    let stiff = found.map_or(f64::NAN, |found| found.certificate.bound);
    let (mut frozen, about) = frozen::Frozen::start((400.0, 0.15), 50.0)?;
    let design = Design { amplitude: AMPLITUDE, sets: 2 };
    let response = multisine::measure(&mut frozen, &about, &design, 7);
    let frozen = Certificate::of(&response, &handle, 0.0);
    let verdict = |name: &str, bound: f64| {
        let found = format!("the least with its noise is {bound:.3} of the device's damping");
        Verdict::new(name, bound < 0.0, found)
    };
    Ok(vec![
        verdict("a coupling of twice the stiffness that is passive is found not to be", stiff),
        verdict("a contact whose force is frozen between queries at 50 Hz is found not to be", frozen.bound),
    ])
}

/// Stability of a pressed coupling against exact eigenvalues.
fn limits(plan: &Plan, section: &mut Section) -> Result<(), String> {
    let devices = plan.choose(&[(0.075, 1.0), (0.075, 0.5), (0.3, 1.0), (0.3, 2.0)], &[(0.075, 1.0)]);
    let delays = plan.choose(&[0.0, 5e-4, 1e-3, 2e-3, 5e-3], &[0.0, 1.5e-3]);
    let dampings = plan.choose(&[5.0, 15.0], &[5.0]);
    let cases: Vec<Case> = pairs(&devices, &pairs(&delays, &dampings))
        .into_iter()
        .map(|((mass, device_damping), (delay, damping))| Case { mass, device_damping, damping, delay })
        .collect();
    let table = boundary::Table::new()?;
    let found = plan.each("port: limits", &cases, |case| Ok((case.limit(), case.measured(&table)?)))?;
    let ratios: Vec<f64> = found.iter().map(|(limit, measured)| measured / limit).collect();
    let beyond = ratios.iter().filter(|ratio| (**ratio - 1.0).abs() > MAX_DEVIATION).count();
    let (low, high) =
        ratios.iter().fold((f64::INFINITY, 0.0_f64), |(low, high), &r| (low.min(r), high.max(r)));
    section.paragraphs.push(
        "A ball is pressed on a table by a handle without friction on a soft spring, and the push falters for 20 ms. The \
         stiffest coupling with which the swing that follows decays is found by bisection in sessions, and compared \
         with the eigenvalues of the exact discrete system, with its delay and the lag that the engine chooses for the \
         damper."
            .to_owned(),
    );
    let rows = cases.iter().zip(&found).map(|(case, (limit, measured))| {
        row![case.mass, case.device_damping, case.damping, case.delay, limit, measured, measured / limit]
    });
    section.tables.push(Table {
        name: "port-limits".to_owned(),
        columns: vec![
            "mass_kg",
            "device_damping_ns_m",
            "damping_ns_m",
            "delay_s",
            "limit_n_m",
            "measured_n_m",
            "ratio",
        ],
        rows: rows.collect(),
    });
    section.verdicts.push(Verdict::new(
        "the stiffest stable coupling is within 5 % of that of the exact eigenvalues",
        beyond == 0,
        format!("{beyond} of {} are not; {low:.3} to {high:.3} of it", ratios.len()),
    ));
    Ok(())
}

/// Searches for hands that draw energy.
fn search(plan: &Plan, section: &mut Section) -> Result<(), String> {
    let of = |(full, quick): (usize, usize)| if plan.quick { quick } else { full };
    let table = boundary::Table::new()?;
    let drawn: Vec<Genes> = (0..of(HANDS)).map(|seed| Genes::random(seed as u64)).collect();
    let found = plan.each("port: hands", &drawn, |genes| genes.run(&table, None))?;
    let mut all: Vec<(Genes, Drawn)> = drawn.into_iter().zip(found).collect();
    all.sort_by(|a, b| b.1.nearness().total_cmp(&a.1.nearness()));
    let random = all[0].1;
    let climbers: Vec<(usize, (Genes, Drawn))> = all.iter().take(of(CLIMBERS)).copied().enumerate().collect();
    let climbed = plan.each("port: climbing", &climbers, |&(index, mut best)| {
        for climb in 0..of(CLIMBS) {
            let genes = best.0.changed((1 + index * 1000 + climb) as u64);
            let drawn = genes.run(&table, None)?;
            if drawn.nearness() > best.1.nearness() {
                best = (genes, drawn);
            }
        }
        Ok(best)
    })?;
    all.extend(climbed);
    all.sort_by(|a, b| b.1.nearness().total_cmp(&a.1.nearness()));
    let beyond = all.iter().filter(|(_, drawn)| !drawn.holds()).count();
    let worst = all[0].1;
    // The same hands with a coupling that is not passive: the search must find it.
    let stiffness = 4.0 * Emulation::default().handle.damping / (0.5 * driven::PERIOD);
    let controls: Vec<Genes> = (0..of((200, 40))).map(|seed| Genes::random(seed as u64)).collect();
    let control = plan.each("port: control", &controls, |genes| genes.run(&table, Some(stiffness)))?;
    let caught = control.iter().filter(|drawn| !drawn.holds()).count();
    section.paragraphs.push(format!(
        "{} hands of random mass, damping and stiffness, on random paths, press a ball on a table in sessions of 0.4 s, \
         with random delays, encoder steps and rates of contacts. The {} that came nearest to drawing energy are then \
         changed a little, {} times each, and the better ones kept. What a hand has given to device and session may never \
         be negative, beyond the energy by which encoder steps can deceive the session at any moment: (K + B/(τ + T)) Δ² \
         by axis.",
        of(HANDS),
        of(CLIMBERS),
        of(CLIMBS),
    ));
    let rows = all.iter().take(200).map(|(genes, drawn)| {
        row![
            genes.delay(),
            genes.encoders(),
            genes.rate(),
            drawn.least,
            drawn.tolerance,
            drawn.most,
            drawn.share
        ]
    });
    section.tables.push(Table {
        name: "port-hands".to_owned(),
        columns: vec![
            "delay_s",
            "encoder_steps",
            "contact_rate_hz",
            "least_energy_j",
            "tolerance_j",
            "most_energy_j",
            "share_of_heat",
        ],
        rows: rows.collect(),
    });
    section.verdicts.push(Verdict::new(
        "no hand draws energy",
        beyond == 0,
        format!(
            "{beyond} of {} do; the nearest gave {:.3} of the heat in the device, before climbing {:.3}, and {:.2e} J at \
             the least, with a tolerance of {:.2e} J",
            all.len(),
            worst.share,
            random.share,
            worst.least,
            worst.tolerance,
        ),
    ));
    section.verdicts.push(Verdict::new(
        "with a coupling of four times the stiffness that is passive, hands draw energy",
        caught > 0,
        format!("{caught} of {} do", control.len()),
    ));
    Ok(())
}
