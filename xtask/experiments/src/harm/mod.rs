//! A search for harm: sessions with random settings, devices, hands, things to touch and faults, and then with such as came nearest
//! to harm, a little changed.
//!
//! `cargo xtask harm [--sessions N] [--seed S] [--seconds T] [--out FILE]` checks in each what the engine promises of every wrench, by its
//! own checks and by what is seen at the device, and prints how near the worst came with what makes that session again:
//! `cargo xtask harm --session GENOME`.

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

/// What `cargo xtask harm` is asked to search.
#[derive(clap::Args, Clone, Debug)]
pub struct Arguments {
    /// Sessions to run: the first half at random, the others near the worst.
    #[arg(long, default_value_t = 10_000)]
    sessions: usize,
    /// What the random numbers come from, in hexadecimal digits; with --sessions 1, the session of that seed.
    #[arg(long, default_value = "1", value_parser = hexadecimal)]
    seed: u64,
    /// How long each is, s.
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// Runs these sessions alone, as a search has printed them.
    #[arg(long, value_name = "GENOME", num_args = 1..)]
    session: Vec<Genome>,
    /// Also says what the sessions that are run alone are made of.
    #[arg(long)]
    verbose: bool,
    /// File for the worst sessions, and for all that did harm, as JSON.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

fn hexadecimal(text: &str) -> Result<u64, String> {
    u64::from_str_radix(text, 16).map_err(|error| error.to_string())
}

/// Nothing becomes of a wrench on its way.
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
