//! Project tasks: `cargo xtask test`, `ci`, `dependencies`, `publish-check`, `msrv` and `semver`. Tasks that
//! run the engine are forwarded to `palpate-experiments`: `cargo xtask pictures`, `stability`, `reproduce`,
//! `trade`, `latency` and `harm`.

#![allow(clippy::print_stdout, clippy::print_stderr)] // Tasks report to a person at a terminal.

mod dependencies;
mod linked;
mod packages;
mod release;
mod workspace;

use std::ffi::OsString;
use std::process::{Command, ExitCode};
use std::time::{Duration, Instant};

use clap::{Parser, Subcommand};

#[derive(Parser)]
#[command(about = "Project tasks of palpate")]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Runs all tests. First tries to install a software Vulkan driver where none is found.
    Test,
    /// Runs what CI runs: the tests, rustfmt, clippy and the documentation; the dependency bans if cargo-deny
    /// is installed.
    Ci {
        /// Also runs what takes too long for every change: models of full size, a million damaged files,
        /// damaged files without assertions, a thousand dropped spoons, the adapter for Rerun, the dependency
        /// bans, the oldest supported Rust, and packages as published.
        #[arg(long)]
        full: bool,
    },
    /// Draws the built-in models.
    #[command(disable_help_flag = true)]
    Pictures(Passed),
    /// Maps where the engine is stable, and checks it against what is expected.
    #[command(disable_help_flag = true)]
    Stability(Passed),
    /// Repeats the dissertation's experiments, and checks its claims.
    #[command(disable_help_flag = true)]
    Reproduce(Passed),
    /// Measures the cost and the accuracy of each setting.
    #[command(disable_help_flag = true)]
    Trade(Passed),
    /// Measures the delays of a session while other programs keep the processors busy.
    #[command(disable_help_flag = true)]
    Latency(Passed),
    /// Searches random sessions for a wrench that could hurt.
    #[command(disable_help_flag = true)]
    Harm(Passed),
    /// Writes the page of the crates that a program links when it embeds palpate.
    Dependencies(dependencies::Arguments),
    /// Packs every published package and builds it from the packed files alone. Uploads nothing.
    PublishCheck,
    /// Checks the published packages with the oldest supported Rust.
    Msrv,
    /// Lists breaking changes in the API of the published libraries since a revision.
    Semver(release::SemverArguments),
}

/// Arguments that are forwarded to an experiment, which parses them.
#[derive(clap::Args)]
struct Passed {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<OsString>,
}

/// Error message for a person.
type Failure = Box<dyn std::error::Error>;

fn main() -> ExitCode {
    let result = match Arguments::parse().task {
        Task::Test => test(),
        Task::Ci { full } => ci(full),
        Task::Pictures(passed) => experiment("pictures", &passed),
        Task::Stability(passed) => experiment("stability", &passed),
        Task::Reproduce(passed) => experiment("reproduce", &passed),
        Task::Trade(passed) => experiment("trade", &passed),
        Task::Latency(passed) => experiment("latency", &passed),
        Task::Harm(passed) => experiment("harm", &passed),
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

/// Runs a task of `palpate-experiments`, which prints its own errors.
fn experiment(name: &str, passed: &Passed) -> Result<(), Failure> {
    let mut command = Command::new("cargo");
    command.args(["run", "--release", "--quiet", "--locked", "--package", "palpate-experiments", "--", name]);
    if passed.arguments.iter().any(|word| word == "--scenes" || word == "--pokes") {
        // Fields of bodies that are drawn at random are of no use later: with a file in place of the folder,
        // the cache stores nothing.
        command.env("XDG_CACHE_HOME", concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml"));
    }
    let status = command
        .args(&passed.arguments)
        .status()
        .map_err(|error| format!("cargo could not be started: {error}"))?;
    if status.success() { Ok(()) } else { std::process::exit(status.code().unwrap_or(1)) }
}

/// All packages with all features, so that everything is compiled once. The adapter for Rerun is left out,
/// whose SDK takes many minutes to build: `cargo test -p palpate-rerun` tests it.
const WORKSPACE: [&str; 4] = ["--workspace", "--exclude", "palpate-rerun", "--all-features"];

/// Settings with which a clean build takes less time, and what it builds runs faster. Backtraces then have no
/// line numbers.
const CLEAN_BUILD: [(&str, &str); 2] = [("CARGO_PROFILE_DEV_DEBUG", "0"), ("CARGO_INCREMENTAL", "0")];

fn test() -> Result<(), Failure> {
    packages::ensure_vulkan()?;
    packages::try_players();
    let mut steps = Steps::default();
    run_tests(&mut steps, &[])?;
    steps.print();
    Ok(())
}

fn run_tests(steps: &mut Steps, environment: &[(&str, &str)]) -> Result<(), Failure> {
    let test = [["test", "--locked"].as_slice(), &WORKSPACE].concat();
    // Without the examples, which clippy compiles too, and nothing here runs.
    let tests = [&test, ["--tests"].as_slice()].concat();
    steps.cargo("compile the tests", &[&tests, ["--no-run"].as_slice()].concat(), environment)?;
    steps.cargo("run the tests", &tests, environment)?;
    steps.cargo("run the tests in documentation", &[&test, ["--doc"].as_slice()].concat(), environment)
}

fn ci(full: bool) -> Result<(), Failure> {
    let mut steps = Steps::default();
    steps.cargo("formatting", &["fmt", "--all", "--check"], &[])?;
    packages::ensure_vulkan()?;
    packages::try_players();
    run_tests(&mut steps, &CLEAN_BUILD)?;
    let strict = ["--all-targets", "--", "-D", "warnings"];
    steps.cargo("clippy", &[["clippy", "--locked"].as_slice(), &WORKSPACE, &strict].concat(), &[])?;
    // One package at a time, since cargo unifies the features of packages that it checks together.
    for package in ["palpate-mesh-io", "palpate-texture-pd", "palpate-device", "palpate"] {
        let check =
            ["clippy", "--package", package, "--no-default-features", "--locked", "--", "-D", "warnings"];
        steps.cargo(&format!("{package} without features"), &check, &[])?;
    }
    let warnings = [("RUSTDOCFLAGS", "-D warnings")];
    let doc = ["doc", "--no-deps", "--locked"];
    steps.cargo("documentation", &[doc.as_slice(), &WORKSPACE].concat(), &warnings)?;
    let plain = [doc.as_slice(), &["--package", "palpate"]].concat();
    steps.cargo("documentation without features", &plain, &warnings)?;
    steps.run("page of dependencies", dependencies::check)?;
    let deny = Command::new("cargo").args(["deny", "--version"]).output();
    let has_deny = deny.is_ok_and(|output| output.status.success());
    if full && !has_deny {
        // Without optimisation, since it takes far longer to compile than to run.
        let install = ["install", "cargo-deny", "--version", "0.20.2", "--locked", "--debug"];
        steps.cargo("install cargo-deny", &install, &[])?;
    }
    if full || has_deny {
        steps.cargo("bans, licences and sources", &["deny", "check", "bans", "licenses", "sources"], &[])?;
    } else {
        println!(
            "\ncargo-deny is not installed: bans, licences and sources are left to `cargo xtask ci --full`"
        );
    }
    if full {
        // Models of full size, a million damaged files, a thousand spoons, and nasty meshes.
        let test = [["test", "--release", "--locked"].as_slice(), &WORKSPACE].concat();
        let ignored = [
            "of_full_size",
            "at_length",
            "a_million",
            "a_thousand",
            "in_further_cases",
            "do_not_cross_themselves",
        ];
        let ignored = [test.as_slice(), &["--", "--ignored"], &ignored].concat();
        steps.cargo("tests at full size", &ignored, &[])?;
        // Damaged files must be refused cleanly without assertions, too.
        let hostile = [test.as_slice(), &["--test", "hostile_files"]].concat();
        steps.cargo("hostile files in a release build", &hostile, &[])?;
        steps.cargo("the adapter for Rerun", &["test", "--locked", "--package", "palpate-rerun"], &[])?;
        steps.run("the oldest Rust", release::msrv)?;
        steps.run("packages as published", release::publish_check)?;
    }
    steps.print();
    Ok(())
}

/// Times of the steps.
#[derive(Default)]
struct Steps(Vec<(String, Duration)>);

impl Steps {
    fn cargo(&mut self, name: &str, arguments: &[&str], environment: &[(&str, &str)]) -> Result<(), Failure> {
        self.run(name, || cargo(arguments, environment))
    }

    fn run(&mut self, name: &str, step: impl FnOnce() -> Result<(), Failure>) -> Result<(), Failure> {
        let begun = Instant::now();
        let result = step();
        self.0.push((name.to_owned(), begun.elapsed()));
        if result.is_err() {
            self.print();
        }
        result
    }

    fn print(&self) {
        println!();
        let total = self.0.iter().map(|(_, time)| *time).sum();
        let rows = self.0.iter().map(|(name, time)| (name.as_str(), *time));
        for (name, time) in rows.chain([("in all", total)]) {
            let seconds = time.as_secs();
            println!("{name:48}{:3} min {:02} s", seconds / 60, seconds % 60);
        }
    }
}

/// Runs cargo in the workspace root and echoes the command line.
fn cargo(arguments: &[&str], environment: &[(&str, &str)]) -> Result<(), Failure> {
    let shown = format!("cargo {}", arguments.join(" "));
    println!("\n$ {shown}");
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
    let status = Command::new("cargo")
        .args(arguments)
        // Incremental compilation only helps later builds.
        .env("CARGO_INCREMENTAL", "0")
        .envs(environment.iter().copied())
        .current_dir(root)
        .status()
        .map_err(|error| format!("`{shown}` could not be started: {error}"))?;
    if status.success() { Ok(()) } else { Err(format!("`{shown}` failed ({status})").into()) }
}
