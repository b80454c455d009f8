//! Project tasks that run the engine: `cargo xtask pictures`, `cargo xtask stability`, `cargo xtask
//! reproduce`, `cargo xtask trade`, `cargo xtask latency`, `cargo xtask harm`. They stand in a package of
//! their own so that the other tasks start without it.

#![allow(clippy::print_stdout, clippy::print_stderr)] // Tasks report to a person at a terminal.

mod harm;
mod latency;
mod pictures;
mod progress;
mod reproduce;
mod stability;
mod trade;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

#[derive(Parser)]
#[command(about = "Project tasks of palpate that run the engine", bin_name = "cargo xtask")]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Draws the built-in models.
    Pictures(pictures::Arguments),
    /// Maps where the engine is stable, and says whether it is where it should be.
    Stability(stability::Arguments),
    /// Repeats the dissertation's experiments, and says whether what it claims holds.
    Reproduce(reproduce::Arguments),
    /// Measures what each setting costs, and what accuracy it buys.
    Trade(trade::Arguments),
    /// Measures how late a session is while other programs keep the processors busy.
    Latency(latency::Arguments),
    /// Searches random sessions for a wrench that could hurt.
    Harm(harm::Arguments),
}

fn main() -> ExitCode {
    let result = match Arguments::parse().task {
        Task::Pictures(arguments) => pictures::run(&arguments),
        Task::Stability(arguments) => stability::run(&arguments),
        Task::Reproduce(arguments) => reproduce::run(&arguments),
        Task::Trade(arguments) => trade::run(&arguments),
        Task::Latency(arguments) => latency::run(&arguments),
        Task::Harm(arguments) => harm::run(&arguments),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("xtask: {failure}");
            ExitCode::FAILURE
        }
    }
}
