//! The command line of palpate: see `palpate --help`.

mod arguments;
mod check;
mod devices;
mod doctor;
mod failure;
mod hierarchy;
mod models;
mod output;
mod progress;
mod query;
mod recommend;
mod run;
mod textures;

use std::fmt::Arguments as Text;
use std::io::Write;
use std::process::ExitCode;

use clap::Parser;

use arguments::{Arguments, Command};

fn main() -> ExitCode {
    let result = match Arguments::parse().command {
        Command::Models(arguments) => models::list(&arguments),
        Command::Export(arguments) => models::export(&arguments),
        Command::Check(arguments) => check::run(&arguments),
        Command::Build(arguments) => hierarchy::build(&arguments),
        Command::Inspect(arguments) => hierarchy::inspect(&arguments),
        Command::Query(arguments) => query::run(&arguments),
        Command::Recommend(arguments) => recommend::run(&arguments),
        Command::Run(arguments) => run::run(&arguments),
        Command::View(arguments) => run::view(&arguments),
        Command::Devices(arguments) => devices::run(&arguments),
        Command::Doctor(arguments) => doctor::run(&arguments),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) if failure.is_closed_pipe() => ExitCode::SUCCESS,
        Err(failure) => {
            complain(format_args!("palpate: {failure}"));
            ExitCode::FAILURE
        }
    }
}

/// Writes a line to standard error. Failures are ignored, since there is nowhere left to report them.
fn complain(line: Text<'_>) {
    let _ = writeln!(std::io::stderr(), "{line}");
}
