//! Search for harm: sessions with random settings, devices, hands, scenes and faults, and then mutations of
//! those that came nearest to harm.
//!
//! `cargo xtask harm [--sessions N] [--seed S] [--seconds T] [--out FILE]` checks in each session what the
//! engine promises of every wrench, by the engine's own checks and by what is visible at the device. It
//! prints how near the worst came, each with the argument that runs that session again: `cargo xtask harm
//! --session GENOME`.

mod bench;
mod faults;
mod genome;
mod hand;
mod judge;
mod models;
mod plan;
mod search;
mod session;
#[cfg(test)]
mod tests;

use std::error::Error;
use std::path::PathBuf;
use std::time::Instant;

use genome::Genome;
use palpate::Wrench;
use search::{Found, Search};
use session::{Measure, Outcome};

/// Arguments of `cargo xtask harm`.
#[derive(clap::Args, Clone, Debug)]
pub struct Arguments {
    /// Sessions to run: half of them random, the others mutations of the worst.
    #[arg(long, default_value_t = 10_000)]
    sessions: usize,
    /// Seed of the random numbers, in hexadecimal digits; with --sessions 1, the session of that seed.
    #[arg(long, default_value = "1", value_parser = hexadecimal)]
    seed: u64,
    /// Length of each session, s.
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// Runs these sessions alone, in the form that a search prints.
    #[arg(long, value_name = "GENOME", num_args = 1..)]
    session: Vec<Genome>,
    /// Also prints the settings, device, scene and faults of these sessions.
    #[arg(long)]
    verbose: bool,
    /// JSON file for the worst sessions, and for all that did harm.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

fn hexadecimal(text: &str) -> Result<u64, String> {
    u64::from_str_radix(text, 16).map_err(|error| error.to_string())
}

/// Leaves a wrench as it is.
fn as_asked(wrench: &Wrench, _: &Wrench) -> Wrench {
    *wrench
}

/// Searches, and prints how near to harm it came.
///
/// # Errors
/// If harm was found, or a file cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), Box<dyn Error>> {
    let Arguments { sessions, seed, seconds, session, verbose, out } = arguments;
    if !(*seconds > 0.0 && *seconds <= 3600.0) {
        return Err(format!("--seconds {seconds}: give more than 0 and no more than 3600").into());
    }
    let begun = Instant::now();
    let mut alone = session.clone();
    if *sessions == 1 && alone.is_empty() {
        alone.push(Genome::new(*seed));
    }
    let search = Search { sessions: *sessions, seed: *seed, seconds: *seconds };
    if *verbose {
        alone.iter().for_each(|genome| println!("{:#?}", plan::Plan::of(genome, *seconds)));
    }
    let found = if alone.is_empty() { search.run() } else { search.of(&alone) };
    print(&found, begun.elapsed().as_secs_f64());
    if let Some(file) = out {
        let text = serde_json::to_string_pretty(&found.json())?;
        std::fs::write(file, text).map_err(|error| format!("{}: {error}", file.display()))?;
    }
    match found.harm.len() {
        0 => Ok(()),
        sessions => Err(format!("{sessions} sessions did harm").into()),
    }
}

fn print(found: &Found, took: f64) {
    println!(
        "{} sessions, {} of them refused, {} touched something, {} steps, {took:.0} s",
        found.sessions, found.refused, found.touched, found.steps
    );
    println!("\n{:24} {:>10} {:>8}  session", "largest part of its bound", "", "harm");
    for (index, measure) in Measure::ALL.iter().enumerate() {
        let harm = if measure.is_promised() { found.above[index].to_string() } else { "-".to_owned() };
        let (part, genome) = match found.worst[index].first() {
            Some((part, genome)) => (*part, genome.to_string()),
            None => (0.0, String::new()),
        };
        println!("{:24} {part:>12.4} {harm:>8}  {genome}", measure.name());
    }
    for (genome, outcome) in found.harm.iter().take(50) {
        match outcome {
            Outcome::Panicked(text) => println!("panic: {text}\n    {genome}"),
            Outcome::Ended(ended) => {
                let parts = Measure::ALL.iter().zip(&ended.parts);
                let above: Vec<String> = parts
                    .filter(|(measure, part)| measure.is_promised() && **part > session::BROKEN)
                    .map(|(measure, part)| format!("{} {part:.4}", measure.name()))
                    .collect();
                println!("harm: {}\n    {genome}", above.join(", "));
            }
            Outcome::Refused(_) => {}
        }
    }
}
