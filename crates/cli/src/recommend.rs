//! `palpate recommend`: tries settings with the user's objects, and chooses the best whose contact steps fit
//! into a time.

use std::fmt::Display;

use palpate::device::{Interpolation, MotionPath};
use palpate::errors::RendererError;
use palpate::settings::ContactSearch;
use palpate::{Pose, Scene, Settings};
use palpate_measure::{Choice, Hand, Measured, Recommendation, Request};
use serde::Serialize;

use crate::arguments::RecommendArguments;
use crate::failure::Failure;
use crate::{output, progress, textures};

/// Largest duration of the hand's motion, s. Each setting renders all of it, so longer ones take hours.
const MAX_SECONDS: f64 = 600.0;

#[derive(Serialize)]
struct Advice<'a> {
    /// Command that renders with the recommended settings.
    command: &'a str,
    /// Time limit of a contact step, s.
    budget: f64,
    /// Haptic period, s.
    period: f64,
    #[serde(flatten)]
    recommendation: &'a Recommendation,
}

pub fn run(arguments: &RecommendArguments) -> Result<(), Failure> {
    let seconds = arguments.seconds;
    if !(seconds > 0.0 && seconds <= MAX_SECONDS) {
        return Err(Failure::Message(format!(
            "--seconds {seconds}: give more than 0, at most {MAX_SECONDS}"
        )));
    }
    let trajectory = arguments.trajectory.as_deref();
    output::check_files(trajectory.as_slice(), arguments.json.file().as_slice())?;
    let hand = match trajectory {
        Some(file) => Hand::Path(MotionPath::load(file, Interpolation::Smooth)?),
        None => Hand::Task(arguments.task.unwrap_or_default()),
    };
    let reading = &arguments.reading;
    let probe = textures::open(&arguments.probe, &arguments.textures.of_probe(), &reading.of_probe())?;
    let object = textures::open(&arguments.scene, &arguments.textures.of_scene(), &reading.of_scene())?;
    let scene = Scene::new().with(object, Pose::IDENTITY);
    let settings = arguments.textures.applied_to(Settings::default());
    let settings = arguments.physics.applied_to(settings, probe.bounding_radius());
    settings.check().map_err(RendererError::from)?;
    let period = 1.0 / settings.timing.rate;
    let budget = arguments.budget_us.map_or(period, |us| 1e-6 * us);
    if !(1e-6..=1.0).contains(&budget) {
        let given = arguments.budget_us.unwrap_or_default();
        return Err(Failure::Message(format!("--budget-us {given}: give microseconds from 1 to 1000000")));
    }
    let request = Request { probe: &probe, scene: &scene, settings, budget, seconds, hand };
    let bar = progress::bar("trying settings");
    let found = palpate_measure::recommend(&request, |done| progress::set(&bar, done))?;
    bar.finish_and_clear();
    let command = command(arguments, &found.chosen.choice);
    let advice = Advice { command: &command, budget, period, recommendation: &found };
    output::result(&arguments.json, &advice, |table| print(&advice, table))
}

/// Rows of all settings that were tried, and the recommendation.
fn print(advice: &Advice<'_>, table: &mut output::Table) {
    const HEADINGS: [&str; 11] = [
        "",
        "s0",
        "smooth",
        "limit",
        "grid",
        "median",
        "p99",
        "force off",
        "torque off",
        "vibration",
        "memory",
    ];
    table.row(HEADINGS.each_ref().map(|heading| heading as &dyn Display));
    for measured in &advice.recommendation.tried {
        let mark = match (*measured == advice.recommendation.chosen, measured.fits) {
            (true, _) => "->",
            (false, true) => "",
            (false, false) => "slow",
        };
        row(table, mark, measured);
    }
    table.row([]);
    for (name, value) in in_words(advice) {
        table.row([&name, &value]);
    }
}

fn row(table: &mut output::Table, mark: &str, measured: &Measured) {
    let Choice { search, error, interpolation, query_budget, grid } = measured.choice;
    let (force, torque) = (measured.felt.force, measured.felt.torque);
    let none = || "-".to_owned();
    let share = |off: f64, of: f64| if of > 0.0 { format!("{:.1} %", 100.0 * off / of) } else { none() };
    let micros = |seconds: f64| format!("{:.0} µs", 1e6 * seconds);
    let smooth = match interpolation {
        _ if error == 0.0 && query_budget.is_none() => "-",
        true => "yes",
        false => "no",
    };
    table.row([
        &mark,
        &if search == ContactSearch::Representatives {
            "representative".to_owned()
        } else if error > 0.0 {
            format!("{:.3} mm", 1e3 * error)
        } else {
            "0".to_owned()
        },
        &smooth,
        &query_budget.map_or_else(none, micros),
        &grid.map_or_else(none, |grid| grid.to_string()),
        &micros(measured.median),
        &micros(measured.p99),
        &share(force.mean, force.exact_rms),
        &share(torque.mean, torque.exact_rms),
        &format!("{:.4} N", force.vibration),
        &format!("{:.1} MB", measured.bytes as f64 / 1e6),
    ]);
}

/// Lines of the recommendation: names and values.
fn in_words(advice: &Advice<'_>) -> Vec<(&'static str, String)> {
    let Advice { command, budget, period, recommendation: found } = advice;
    let (chosen, force) = (&found.chosen, found.chosen.felt.force);
    let micros = |seconds: f64| format!("{:.1} µs", 1e6 * seconds);
    let fits = if chosen.fits {
        format!("{} of {} allowed", micros(chosen.p99), micros(*budget))
    } else {
        let (p99, budget) = (micros(chosen.p99), micros(*budget));
        format!("{p99}, more than the {budget} allowed: nothing that was tried is faster")
    };
    let haptic = if found.haptic_fits { "" } else { ", more than the period: choose a lower --rate" };
    let margin = found.stability_margin;
    let stability = if margin < 1.0 {
        format!("not at rest when held in contact: choose {margin} times the --contact-stiffness")
    } else {
        format!("at rest when held in contact, with contacts up to {margin} times as stiff")
    };
    vec![
        ("recommended", (*command).to_owned()),
        ("contact step, p99", fits),
        (
            "force",
            format!(
                "{:.4} N root mean square; off by {:.4} N in the mean, {:.4} N at the 99th percentile; correlation {:.4}",
                force.exact_rms, force.mean, force.p99, force.correlation
            ),
        ),
        (
            "vibration above 20 Hz",
            format!("{:.4} N, {:.4} N at full resolution", force.vibration, force.exact_vibration),
        ),
        (
            "deepest penetration",
            format!(
                "{:.4} mm, at {:.0} contact steps a second",
                1e3 * chosen.penetration,
                chosen.contact_rate
            ),
        ),
        ("haptic step, p99.9", format!("{} of {}{haptic}", micros(found.haptic_step), micros(*period))),
        ("stability", stability),
    ]
}

/// Command that renders with the chosen settings and the options that were given.
fn command(arguments: &RecommendArguments, choice: &Choice) -> String {
    let mut words = vec![format!("palpate run {} {} --response penalty", arguments.probe, arguments.scene)];
    words.extend(arguments.reading.words());
    if choice.search == ContactSearch::Representatives {
        words.push("--representative".to_owned());
    } else if choice.error > 0.0 {
        words.push(format!("--error {:.4e}", choice.error));
        if !choice.interpolation {
            words.push("--no-interpolation".to_owned());
        }
    } else {
        words.push("--error 0".to_owned());
    }
    words.extend(choice.query_budget.map(|budget| format!("--budget-us {:.1}", 1e6 * budget)));
    words.extend(choice.grid.map(|grid| format!("--texture-grid {grid}")));
    words.extend(arguments.physics.rate().map(|rate| format!("--rate {rate}")));
    words.join(" ")
}
