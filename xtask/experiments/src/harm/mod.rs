//! Search for harm: sessions with random settings, devices, hands, scenes and faults, and then mutations of
//! those that came nearest to harm.
//!
//! `cargo xtask harm [--sessions N] [--seed S] [--seconds T] [--out FILE]` checks in each session what the
//! engine promises of every wrench, by the engine's own checks and by what is visible at the device. It
//! prints how near the worst came, each with the argument that runs that session again: `cargo xtask harm
//! --session GENOME`.
//!
//! `cargo xtask harm --scenes N` and `cargo xtask harm --pokes N` look for sessions without any fault that
//! feel wrong: plain [`scenes`], and [`pokes`] that go in. `--scene GENOME` and `--poke GENOME` run one
//! again.

mod bench;
mod faults;
mod genome;
mod hand;
mod judge;
mod models;
mod oracle;
mod plan;
mod pokes;
mod route;
mod scenes;
mod search;
mod session;
mod solids;
#[cfg(test)]
mod tests;

use std::error::Error;
use std::path::PathBuf;
use std::time::Instant;

use genome::Genome;
use pokes::Pokes;
use scenes::Scenes;
use search::{Found, Search, Trial, Worst};
use session::{Outcome, Sessions};

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
    /// Plain scenes to run, at random, in place of sessions with faults.
    #[arg(long, value_name = "N", conflicts_with_all = ["session", "sessions", "seconds"])]
    scenes: Option<usize>,
    /// Runs these scenes alone.
    #[arg(long, value_name = "GENOME", num_args = 1.., conflicts_with = "session")]
    scene: Vec<Genome>,
    /// Pokes to run: half of them random, the others mutations of those that went deepest.
    #[arg(long, value_name = "N", conflicts_with_all = ["session", "sessions", "seconds", "scenes", "scene"])]
    pokes: Option<usize>,
    /// Runs these pokes alone.
    #[arg(long, value_name = "GENOME", num_args = 1.., conflicts_with_all = ["session", "scene"])]
    poke: Vec<Genome>,
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

/// Searches, and prints how near to harm it came.
///
/// # Errors
/// If harm was found, or a file cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), Box<dyn Error>> {
    let Arguments { sessions, seed, seconds, session, scenes, scene, pokes, poke, verbose, out } = arguments;
    if !(*seconds > 0.0 && *seconds <= 3600.0) {
        return Err(format!("--seconds {seconds}: give more than 0 and no more than 3600").into());
    }
    let begun = Instant::now();
    let faults = Sessions { seconds: *seconds };
    // Scenes share no parameters that mutations could improve on.
    let (trial, name, count, alone, random): (&dyn Trial, _, _, _, _) =
        if scenes.is_some() || !scene.is_empty() {
            (&Scenes, "scene", scenes.unwrap_or(0).div_ceil(scenes::VARIATIONS), scene, 1.0)
        } else if pokes.is_some() || !poke.is_empty() {
            (&Pokes, "poke", pokes.unwrap_or(0), poke, 0.5)
        } else {
            (&faults, "session", *sessions, session, 0.5)
        };
    let mut alone = alone.clone();
    if count == 1 && alone.is_empty() {
        alone.push(Genome::new(*seed));
    }
    if *verbose && name == "session" {
        alone.iter().for_each(|genome| println!("{:#?}", plan::Plan::of(genome, *seconds)));
    }
    let found = if alone.is_empty() {
        Search { sessions: count, seed: *seed, random }.run(trial)
    } else {
        Found::of(trial, &alone)
    };
    print(&found, name, begun.elapsed().as_secs_f64());
    if let Some(file) = out {
        let text = serde_json::to_string_pretty(&found.json())?;
        std::fs::write(file, text).map_err(|error| format!("{}: {error}", file.display()))?;
    }
    match found.harm.len() {
        0 => Ok(()),
        harmful => Err(format!("{harmful} {name}s did harm").into()),
    }
}

/// Prints what was found in sessions of a name, by which the task runs one again.
fn print(found: &Found, name: &str, took: f64) {
    let each = if name == "scene" { format!("times {} ", scenes::VARIATIONS) } else { String::new() };
    println!(
        "{} {each}{name}s, {} of them refused, {} touched something, {} steps, {took:.0} s",
        found.sessions, found.refused, found.touched, found.steps
    );
    println!("\n{:24} {:>10} {:>8}  --{name}", "largest part of its bound", "", "harm");
    for ((column, worst), above) in found.columns.iter().zip(&found.worst).zip(&found.above) {
        let harm = if column.is_promised { above.to_string() } else { "-".to_owned() };
        let none = Worst { part: 0.0, genome: Genome::new(0), note: String::new() };
        let Worst { part, genome, note } = worst.first().unwrap_or(&none);
        let genome = if *part > 0.0 { genome.to_string() } else { String::new() };
        println!("{:24} {part:>12.4} {harm:>8}  {genome}", column.name);
        if !note.is_empty() {
            println!("    {}", note.trim());
        }
    }
    for (genome, outcome) in found.harm.iter().take(50) {
        match outcome {
            Outcome::Panicked(text) => println!("panic: {text}\n    {genome}"),
            Outcome::Ended(ended) => {
                let parts = found.columns.iter().zip(&ended.parts);
                let above: Vec<String> = parts
                    .filter(|(column, part)| column.is_promised && **part > session::BROKEN)
                    .map(|(column, part)| format!("{} {part:.4}", column.name))
                    .collect();
                println!("harm: {}\n    {genome}", above.join(", "));
            }
            Outcome::Refused(_) => {}
        }
    }
}
