//! Project tasks: `cargo xtask test`, `cargo xtask ci`, `cargo xtask dependencies`, `cargo xtask publish-check`, `cargo xtask msrv`,
//! `cargo xtask semver`; and those that run the engine, which are handed to `palpate-experiments`: `cargo xtask pictures`,
//! `cargo xtask stability`, `cargo xtask reproduce`, `cargo xtask trade`.

#![allow(clippy::print_stdout, clippy::print_stderr)] // Tasks report to a person at a terminal.

mod dependencies;
mod packages;
mod release;
mod workspace;

use std::ffi::OsString;
use std::process::{Command, ExitCode};

use clap::{Parser, Subcommand};

#[derive(Parser)]
#[command(about = "Project tasks of palpate")]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Runs every test; first installs a software Vulkan driver where one is missing and that is possible.
    Test,
    /// Runs what CI runs: the tests, rustfmt, clippy, the documentation and the dependency bans.
    Ci,
    /// Draws the built-in models.
    #[command(disable_help_flag = true)]
    Pictures(Passed),
    /// Maps where the engine is stable, and says whether it is where it should be.
    #[command(disable_help_flag = true)]
    Stability(Passed),
    /// Repeats the dissertation's experiments, and says whether what it claims holds.
    #[command(disable_help_flag = true)]
    Reproduce(Passed),
    /// Measures what each setting costs, and what accuracy it buys.
    #[command(disable_help_flag = true)]
    Trade(Passed),
    /// Writes the page of what a program links that embeds palpate.
    Dependencies(dependencies::Arguments),
    /// Packs every published package and builds it from that alone, without uploading anything.
    PublishCheck,
    /// Checks the published packages with the oldest Rust that they are for.
    Msrv,
    /// Says what breaks in the API of the published libraries since a revision.
    Semver(release::SemverArguments),
}

/// What is passed on to an experiment, which knows what it means.
#[derive(clap::Args)]
struct Passed {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<OsString>,
}

/// What went wrong, for a person to read.
type Failure = Box<dyn std::error::Error>;

fn main() -> ExitCode {
    let result = match Arguments::parse().task {
        Task::Test => test(),
        Task::Ci => ci(),
        Task::Pictures(passed) => experiment("pictures", &passed),
        Task::Stability(passed) => experiment("stability", &passed),
        Task::Reproduce(passed) => experiment("reproduce", &passed),
        Task::Trade(passed) => experiment("trade", &passed),
        Task::Dependencies(arguments) => dependencies::run(&arguments),
        Task::PublishCheck => release::publish_check(),
        Task::Msrv => release::msrv(),
        Task::Semver(arguments) => release::semver(&arguments),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("xtask: {failure}");
            ExitCode::FAILURE
        }
    }
}

/// Runs a task of `palpate-experiments`, which says itself what went wrong.
fn experiment(name: &str, passed: &Passed) -> Result<(), Failure> {
    let status = Command::new("cargo")
        .args(["run", "--release", "--quiet", "--locked", "--package", "palpate-experiments", "--", name])
        .args(&passed.arguments)
        .status()
        .map_err(|error| format!("cargo could not be started: {error}"))?;
    if status.success() { Ok(()) } else { std::process::exit(status.code().unwrap_or(1)) }
}

/// All packages, with the window, but the adapter for Rerun: its SDK takes many minutes to build. `cargo test -p palpate-rerun` tests it.
const WORKSPACE: [&str; 5] = ["--workspace", "--exclude", "palpate-rerun", "--features", "palpate-cli/view"];

fn test() -> Result<(), Failure> {
    packages::ensure_vulkan()?;
    packages::try_players();
    cargo(&[["test", "--locked"].as_slice(), &WORKSPACE].concat(), &[])?;
    // Hostile files once more: with and without assertions they must be refused cleanly.
    unchecked_tests(&["--test", "hostile_files"])
}

/// Runs tests of the workspace without palpate's debug assertions and overflow checks, as in a release. What it depends on stays as it is
/// built for [`test`].
fn unchecked_tests(chosen: &[&str]) -> Result<(), Failure> {
    let unchecked =
        [("CARGO_PROFILE_DEV_DEBUG_ASSERTIONS", "false"), ("CARGO_PROFILE_DEV_OVERFLOW_CHECKS", "false")];
    cargo(&[["test", "--locked"].as_slice(), &WORKSPACE, chosen].concat(), &unchecked)
}

fn ci() -> Result<(), Failure> {
    cargo(&["fmt", "--all", "--check"], &[])?;
    test()?;
    // What takes long where everything is checked: models of full size, a million damaged files, and a thousand spoons.
    let files = ["--test", "levels", "--test", "clod_mutations", "--test", "drops"];
    let tests = ["--", "--ignored", "built_in_models_of_full_size", "a_million", "a_thousand"];
    unchecked_tests(&[files.as_slice(), &tests].concat())?;
    let strict = ["--all-targets", "--", "-D", "warnings"];
    cargo(&[["clippy", "--locked"].as_slice(), &WORKSPACE, &strict].concat(), &[])?;
    for package in ["palpate-texture-pd", "palpate-device"] {
        cargo(&["check", "--package", package, "--no-default-features", "--locked"], &[])?;
    }
    // Conversions and spans, which nothing in the workspace asks for.
    let converted =
        ["test", "--package", "palpate-core", "--features", "mint,nalgebra", "--locked", "conversions"];
    cargo(&converted, &[])?;
    let traced = ["test", "--package", "palpate", "--features", "tracing", "--locked", "--test", "tracing"];
    cargo(&traced, &[])?;
    // Devices that are left out where nothing is asked for.
    let devices = ["--package", "palpate-device", "--all-features", "--locked"];
    let tests = ["--lib", "--test", "haply", "--test", "sdk"];
    cargo(&[["test"].as_slice(), &devices, &tests].concat(), &[])?;
    cargo(&[["clippy"].as_slice(), &devices, &strict].concat(), &[])?;
    cargo(
        &[["doc", "--no-deps", "--locked"].as_slice(), &WORKSPACE].concat(),
        &[("RUSTDOCFLAGS", "-D warnings")],
    )?;
    dependencies::check()?;
    if !Command::new("cargo").args(["deny", "--version"]).output().is_ok_and(|output| output.status.success())
    {
        cargo(&["install", "cargo-deny", "--version", "0.20.2", "--locked"], &[])?;
    }
    cargo(&["deny", "check", "bans", "licenses", "sources"], &[])
}

/// Runs cargo in the workspace root and echoes the command line.
fn cargo(arguments: &[&str], environment: &[(&str, &str)]) -> Result<(), Failure> {
    let shown = format!("cargo {}", arguments.join(" "));
    println!("\n$ {shown}");
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
    let status = Command::new("cargo")
        .args(arguments)
        .envs(environment.iter().copied())
        .current_dir(root)
        .status()
        .map_err(|error| format!("`{shown}` could not be started: {error}"))?;
    if status.success() { Ok(()) } else { Err(format!("`{shown}` failed ({status})").into()) }
}
