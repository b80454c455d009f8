//! The command line of palpate: see `palpate --help`.

#![allow(clippy::print_stderr)] // Errors, warnings and progress are for a person at a terminal.

mod arguments;
mod check;
mod devices;
mod failure;
mod hierarchy;
mod models;
mod output;
mod progress;
mod query;
mod run;

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
        Command::Run(arguments) => run::run(&arguments),
        Command::Devices(arguments) => devices::run(&arguments),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) if failure.is_closed_pipe() => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("palpate: {failure}");
            ExitCode::FAILURE
        }
    }
}
