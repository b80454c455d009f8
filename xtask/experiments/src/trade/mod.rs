//! Speed against accuracy: cost and accuracy of each setting.
//!
//! `cargo xtask trade [SCENARIO…|all] [--axis PART…] [--json] [--out FOLDER]` renders each scenario with each
//! setting in turn and the same hand motion. The reference is a session at full resolution in which a contact
//! step ends within each haptic step; for representative contacts, which follow another force law, it is a
//! session with the smallest EPS. Contact steps are timed alone, one session after another, and counted in
//! instructions where valgrind is installed. Sessions run on a simulated clock at a fixed rate of contact
//! steps, whatever these take, so that results are reproducible.

mod cost;
mod measured;
mod pareto;
mod scenario;
mod section;
mod variation;

use std::error::Error;
use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use self::cost::{Instructions, Job};
use self::measured::{Measured, Reference};
pub use self::section::section;
use self::variation::{Axis, Variation, variations};
use crate::reproduce::page;
use crate::stability::page::{Table, row};

/// Arguments of `cargo xtask trade`.
#[derive(clap::Args, Clone, Debug)]
pub struct Arguments {
    /// Scenarios, or all.
    #[arg(default_value = "all", value_name = "SCENARIO")]
    scenarios: Vec<String>,
    /// Only settings whose names contain one of these: s0, representatives, query limit and so on.
    #[arg(long, num_args = 1.., value_name = "PART")]
    axis: Vec<String>,
    /// Prints the measurements as a JSON list.
    #[arg(long)]
    json: bool,
    /// Folder for values and plots.
    #[arg(long, value_name = "FOLDER", default_value = "target/reproduce")]
    out: PathBuf,
    /// Runs the job in a file, to be counted.
    #[arg(long, value_name = "FILE", hide = true)]
    counted: Option<PathBuf>,
}

/// Measurements on a scenario.
struct Trade {
    scenario: &'static str,
    rows: Vec<Measured>,
    /// Instruction counts by variation, where valgrind is installed.
    instructions: Vec<Option<Instructions>>,
}

/// Measures the scenarios.
///
/// # Errors
/// If a scenario cannot be rendered, or a file cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), Box<dyn Error>> {
    if let Some(job) = &arguments.counted {
        return Ok(cost::run_counted(job)?);
    }
    let Arguments { scenarios, out, .. } = arguments;
    std::fs::create_dir_all(out).map_err(|error| format!("{}: {error}", out.display()))?;
    let all = scenarios.iter().any(|name| name == "all");
    let names: Vec<&str> =
        if all { scenario::names().collect() } else { scenarios.iter().map(String::as_str).collect() };
    let mut values = Vec::new();
    for name in names {
        let Some(trade) = measure(name, &arguments.axis, out)? else {
            section::forget(out, name)?;
            eprintln!("{name}: skipped, its files are absent");
            continue;
        };
        tables(&trade).iter().try_for_each(|table| table.write(out))?;
        trade.keep(out)?;
        if !arguments.json {
            println!("{}\n", trade.text());
        }
        values.extend(trade.values());
        page::write(out)?;
    }
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&values)?);
    } else {
        println!("Values, plots and a page of all: {}", out.join("index.html").display());
    }
    Ok(())
}

fn measure(name: &str, axes: &[String], out: &Path) -> Result<Option<Trade>, String> {
    let Some(scenario) = scenario::open(name)? else { return Ok(None) };
    let mut variations = variations(&scenario);
    let full = variations[0].clone();
    let is_asked_for =
        |axis: Axis| axes.is_empty() || axes.iter().any(|part| axis.word().contains(part.as_str()));
    variations.retain(|variation| is_asked_for(variation.axis));
    if variations.is_empty() {
        return Err(format!("{name}: no setting's name contains {}", axes.join(" or ")));
    }
    let bar = ProgressBar::with_draw_target(
        Some(variations.len() as u64 + 3),
        ProgressDrawTarget::stderr_with_hz(4),
    );
    if let Ok(style) = ProgressStyle::with_template("{msg:32} {bar:32} {pos}/{len} {elapsed}") {
        bar.set_style(style);
    }
    bar.set_message(format!("{name}: full resolution"));
    let reference = Reference::of(&scenario, &full)?;
    bar.inc(1);
    // Representative contacts follow another force law (that of areas), so they have a reference of their
    // own.
    let finest = variations.iter().find(|variation| variation.axis == Axis::Representatives);
    let by_fields = finest.map(|finest| Reference::of(&scenario, finest)).transpose()?;
    bar.inc(1);
    let mut rows = Vec::with_capacity(variations.len());
    for variation in &variations {
        bar.set_message(format!("{name}: {} {}", variation.axis.word(), variation.value));
        let own = by_fields.as_ref().filter(|_| variation.axis == Axis::Representatives);
        match Measured::of(&scenario, variation, &full, own.unwrap_or(&reference)) {
            Ok(row) => rows.push(row),
            // Without a GPU, or a software driver, there is nothing to measure.
            Err(error) if variation.axis == Axis::Precision => {
                eprintln!("{name}: {}: {error}", variation.value)
            }
            Err(error) => {
                return Err(format!("{name}: {} {}: {error}", variation.axis.word(), variation.value));
            }
        }
        bar.inc(1);
    }
    bar.set_message(format!("{name}: counting instructions"));
    let counted = rows.iter().map(|row| &row.variation).filter(|variation| variation.is_counted());
    let settings = counted.map(|variation| (variation.settings, variation.integrator)).collect();
    let job = Job::new(&scenario, &reference.path.states, reference.path.period, settings);
    let instructions = job.count(&scenario, out)?;
    bar.finish_and_clear();
    if instructions.is_none() {
        eprintln!(
            "{name}: instructions are not counted: install valgrind (on Debian and Ubuntu `apt-get install valgrind`)"
        );
    }
    let mut counts = instructions.into_iter().flatten();
    let instructions =
        rows.iter().map(|row| row.variation.is_counted().then(|| counts.next()).flatten()).collect();
    Ok(Some(Trade { scenario: scenario.name, rows, instructions }))
}

/// Returns the reproducible columns as one table, and the others as another.
fn tables(trade: &Trade) -> [Table; 2] {
    let (mut behaviour, mut cost) = (Vec::new(), Vec::new());
    for (index, measured) in trade.rows.iter().enumerate() {
        let Measured { variation: Variation { axis, value, .. }, contact, haptic, bytes, .. } = measured;
        let same = behaviour_row(trade.scenario, measured);
        if axis.is_reproducible() {
            behaviour.push(same);
        }
        let counted = trade.counted(index);
        let count = |of: fn(&Instructions) -> f64| counted.map_or(f64::NAN, of);
        cost.push(row![
            trade.scenario,
            axis.word(),
            value,
            1e6 * contact[0],
            1e6 * contact[1],
            count(|counted| counted.contact),
            1e9 * haptic[0],
            1e9 * haptic[1],
            count(|counted| counted.haptic),
            *bytes,
            measured.felt_error(),
        ]);
    }
    [
        Table {
            name: format!("trade-{}", trade.scenario),
            columns: vec![
                "scenario",
                "axis",
                "value",
                "rendered_force_mean",
                "rendered_force_p99",
                "rendered_force_correlation",
                "rendered_torque_mean",
                "rendered_torque_p99",
                "rendered_torque_correlation",
                "felt_force_rms",
                "felt_force_mean",
                "felt_force_p99",
                "felt_force_correlation",
                "felt_torque_rms",
                "felt_torque_mean",
                "felt_torque_p99",
                "felt_torque_correlation",
                "force_above_20_hz",
                "torque_above_20_hz",
                "penetration",
                "stability_margin",
            ],
            rows: behaviour,
        },
        Table {
            name: format!("trade-{}-cost", trade.scenario),
            columns: vec![
                "scenario",
                "axis",
                "value",
                "contact_median_us",
                "contact_p99_us",
                "contact_instructions",
                "haptic_median_ns",
                "haptic_p99_ns",
                "haptic_instructions",
                "bytes",
                "felt_error",
            ],
            rows: cost,
        },
    ]
}

fn behaviour_row(scenario: &str, measured: &Measured) -> Vec<String> {
    let Measured { variation, rendered, felt, penetration, stability_margin, .. } = measured;
    row![
        scenario,
        variation.axis.word(),
        variation.value,
        rendered.force.mean,
        rendered.force.p99,
        rendered.force.correlation,
        rendered.torque.mean,
        rendered.torque.p99,
        rendered.torque.correlation,
        felt.force.exact_rms,
        felt.force.mean,
        felt.force.p99,
        felt.force.correlation,
        felt.torque.exact_rms,
        felt.torque.mean,
        felt.torque.p99,
        felt.torque.correlation,
        felt.force.vibration,
        felt.torque.vibration,
        *penetration,
        *stability_margin,
    ]
}
