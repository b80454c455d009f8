//! Cost of each stage of the pipeline in a scene that needs it, and a check that it costs nothing in a scene
//! that does not.
//!
//! `cargo bench -p palpate-benches --bench stages`, with `-- --json` for programs. A convex hull strokes
//! another in one contact, and each further scene differs by one stage. Instructions per step are counted by
//! valgrind's callgrind, where that is installed; times are medians of single steps; threads are those that a
//! real-time session adds. A scene without a stage has to take as many instructions as the plain scene, else
//! the benchmark fails. Scenes are run by `stage_steps`, an example of the crate `palpate`, since it has to
//! be built with and without features.

#![allow(clippy::print_stdout, reason = "it prints tables")]

use std::collections::BTreeMap;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use clap::Parser;
use palpate_benches::callgrind;
use serde::Serialize;

#[derive(Parser)]
#[command(about = "Cost of each stage of the pipeline, present and absent")]
struct Arguments {
    /// Number of timed steps
    #[arg(long, default_value_t = 1000)]
    steps: u32,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
    /// Argument that cargo passes to every benchmark
    #[arg(long, hide = true)]
    bench: bool,
}

type Failure = Box<dyn Error>;

/// Number of steps whose instructions are counted, after as many that are not: together a round of the
/// stroke.
const COUNTED: &str = "250";
/// Length of the sessions in which threads are counted, s.
const SESSION: &str = "0.3";
/// Functions of the scenes' program, by a part of their names in the profile.
const FUNCTIONS: [&str; 3] = ["counted_contact_step", "counted_haptic_step", "counted_clustering"];
/// Scene that the others are compared with, and the same with a hierarchy.
const BARE: &str = "bare";
const HIERARCHY: &str = "hierarchy";

/// Scenes: name, the scene that it is compared with, and the difference.
const SCENES: [(&str, &str, &str); 14] = [
    (BARE, "", "two convex hulls, one contact, nothing else"),
    (HIERARCHY, BARE, "the object has a hierarchy (golf-ball@5000)"),
    ("error", HIERARCHY, "detail is left out, with interpolation between levels"),
    ("second-away", BARE, "a second object out of reach"),
    ("second-touching", BARE, "a second object that is touched"),
    ("friction", BARE, "friction"),
    ("braking", BARE, "braking"),
    ("proxy", BARE, "proxy"),
    ("defaults", BARE, "braking and proxy, as by default"),
    ("passivity", BARE, "passivity controller"),
    ("watch", BARE, "someone looks on"),
    ("plate", "", "a convex hull on a plate"),
    ("texture", "plate", "the plate is textured, on the processor"),
    ("texture-auto", "plate", "likewise, the faster of processor and GPU"),
];

/// Settings that a scene does not need and that must cost nothing: name, the scene that must take as many
/// instructions, and description.
const ABSENT: [(&str, &str, &str); 5] = [
    ("texture-settings", BARE, "large grids and a GPU are asked for, but nothing is textured"),
    ("error-without-levels", BARE, "detail is to be left out, but there is one convex hull an object"),
    ("no-friction-at-rest", BARE, "a coefficient of friction at rest is given, of 0"),
    ("one-cluster", BARE, "1 cluster in place of 5, with one contact"),
    ("16-clusters", BARE, "16 clusters in place of 5, with one contact"),
];
/// Scenes that are also counted in a build without features.
const MINIMAL: [&str; 2] = [BARE, HIERARCHY];

#[derive(Clone, Copy, Debug, Default, Serialize)]
struct Counts {
    contact: Option<f64>,
    haptic: Option<f64>,
    clustering: Option<f64>,
}

/// Largest relative difference between counts of the same work: copies of the contact model take a few
/// instructions more or less by their alignment on the stack.
const MAX_RELATIVE_DIFFERENCE: f64 = 0.0025;

impl Counts {
    /// Returns whether both steps take as many instructions, up to the alignment of copies; `None` if they
    /// were not counted.
    fn equal(&self, other: &Self) -> Option<bool> {
        let close = |a: f64, b: f64| (a - b).abs() <= MAX_RELATIVE_DIFFERENCE * a.max(b);
        Some(close(self.contact?, other.contact?) && close(self.haptic?, other.haptic?))
    }
}

#[derive(Clone, Debug, Serialize)]
struct SceneCost {
    name: &'static str,
    what: &'static str,
    /// Scene that it is compared with.
    beside: &'static str,
    instructions: Counts,
    contact_ns: f64,
    haptic_ns: f64,
    contacts: f64,
    /// Number of threads that a session adds; `None` if the system does not report it.
    threads: Option<u32>,
    /// Whether a GPU was looked for, that is, Vulkan was loaded; `None` if the system does not report it.
    gpu: Option<bool>,
    textures: String,
}

#[derive(Clone, Debug, Serialize)]
struct Absence {
    what: String,
    instructions: Counts,
    of: Counts,
    equal: Option<bool>,
}

#[derive(Clone, Debug, Serialize)]
struct Report {
    scenes: Vec<SceneCost>,
    absent: Vec<Absence>,
}

fn main() -> Result<(), Failure> {
    let arguments = Arguments::parse();
    let folder = tempfile::tempdir()?;
    let program = Program::build(&["--features", "gpu,hid,images"], folder.path(), "whole")?;
    program.run(&["make"])?;
    let mut scenes = Vec::new();
    for (name, beside, what) in SCENES {
        scenes.push(program.cost(name, beside, what, arguments.steps)?);
    }
    let known: BTreeMap<&str, Counts> = scenes.iter().map(|scene| (scene.name, scene.instructions)).collect();
    let mut absent = Vec::new();
    let mut compare = |what: String, instructions: Counts, of: Counts| {
        absent.push(Absence { what, instructions, of, equal: instructions.equal(&of) });
    };
    for (name, of, what) in ABSENT {
        compare(what.to_owned(), program.count(name)?, known[of]);
    }
    let minimal = Program::build(&[], folder.path(), "minimal")?;
    for name in MINIMAL {
        let what = format!("built with the features gpu, hid and images, and without: {name}");
        compare(what, known[name], minimal.count(name)?);
    }
    let report = Report { scenes, absent };
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        print(&report);
    }
    let unequal = report.absent.iter().filter(|absence| absence.equal == Some(false)).count();
    if unequal > 0 {
        Err(format!("{unequal} stages that a scene does not need cost instructions").into())
    } else {
        Ok(())
    }
}

/// Program that runs scenes, built with some features.
struct Program {
    path: PathBuf,
    folder: PathBuf,
}

impl Program {
    /// Builds the program, and copies it to a folder, since the next build with other features replaces it.
    fn build(features: &[&str], folder: &Path, name: &str) -> Result<Self, Failure> {
        let build = ["build", "--release", "--quiet", "-p", "palpate", "--example", "stage_steps"];
        let features = [&["--features", "models"], features].concat();
        let output = cargo(&[&build[..], &features, &["--message-format=json"]].concat())?;
        let messages = String::from_utf8(output.stdout)?;
        let mut built = messages.lines().filter_map(|line| {
            let message: serde_json::Value = serde_json::from_str(line).ok()?;
            Some(PathBuf::from(message["executable"].as_str()?))
        });
        let path = folder.join(name);
        std::fs::copy(built.next_back().ok_or("cargo names no program")?, &path)?;
        Ok(Self { path, folder: folder.to_owned() })
    }

    /// Runs the program on the folder.
    fn run(&self, arguments: &[&str]) -> Result<Output, Failure> {
        // Makes the dynamic linker of Linux print on stderr what it loads, such as a GPU's driver.
        let output =
            Command::new(&self.path).args(arguments).arg(&self.folder).env("LD_DEBUG", "libs").output()?;
        checked(output, &arguments.join(" "))
    }

    fn cost(
        &self,
        name: &'static str,
        beside: &'static str,
        what: &'static str,
        steps: u32,
    ) -> Result<SceneCost, Failure> {
        let times = figures(&self.run(&["steps", name, &steps.to_string()])?);
        let number = |key: &str| -> Result<f64, Failure> {
            Ok(times.get(key).ok_or_else(|| format!("{name}: {key} is missing"))?.parse()?)
        };
        let output = self.run(&["session", name, SESSION])?;
        let session = figures(&output);
        let loaded = String::from_utf8_lossy(&output.stderr);
        Ok(SceneCost {
            name,
            what,
            beside,
            instructions: self.count(name)?,
            contact_ns: number("contact_ns")?,
            haptic_ns: number("haptic_ns")?,
            contacts: number("contacts")?,
            threads: session.get("threads").and_then(|threads| threads.parse().ok()),
            gpu: loaded.contains("find library=").then(|| loaded.contains("find library=libvulkan")),
            textures: session.get("textures").cloned().unwrap_or_default(),
        })
    }

    /// Returns the instructions of a scene's steps; zero counts without valgrind.
    fn count(&self, name: &str) -> Result<Counts, Failure> {
        if !callgrind::is_installed() {
            return Ok(Counts::default());
        }
        let folder = self.folder.to_string_lossy();
        let profile = self.folder.join("callgrind.out");
        let counted = callgrind::count(&self.path, &["steps", name, COUNTED, &folder], FUNCTIONS, &profile)?;
        let [contact, haptic, clustering] = counted.map(|cost| cost.per_call());
        if contact.is_none() || haptic.is_none() {
            return Err(format!("callgrind saw no step of {name}: was it built without line tables?").into());
        }
        Ok(Counts { contact, haptic, clustering })
    }
}

/// Returns the printed lines by their first word.
fn figures(output: &Output) -> BTreeMap<String, String> {
    let printed = String::from_utf8_lossy(&output.stdout);
    let entry = |line: &str| line.split_once(' ').map(|(name, value)| (name.to_owned(), value.to_owned()));
    printed.lines().filter_map(entry).collect()
}

fn cargo(arguments: &[&str]) -> Result<Output, Failure> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
    let output = Command::new(cargo).args(arguments).arg("--locked").current_dir(root).output()?;
    checked(output, &format!("cargo {}", arguments.join(" ")))
}

fn checked(output: Output, command: &str) -> Result<Output, Failure> {
    if output.status.success() {
        Ok(output)
    } else {
        Err(format!("{command}: {}", String::from_utf8_lossy(&output.stderr)).into())
    }
}

fn print(report: &Report) {
    let counted = |count: Option<f64>| count.map_or_else(|| "–".to_owned(), |count| format!("{count:.0}"));
    let more = |count: Option<f64>, beside: Option<f64>| match (count, beside) {
        (Some(count), Some(beside)) => format!("{:+.0}", count - beside),
        _ => "–".to_owned(),
    };
    if !callgrind::is_installed() {
        println!(
            "Instructions are not counted, and the cost of absent stages is not checked: valgrind is not installed (on Debian and Ubuntu \
             `sudo apt-get install valgrind`).\n"
        );
    }
    println!(
        "| scene | instructions a contact step | more than | instructions a haptic step | more than | contact step, ns | haptic step, ns | contacts | threads | GPU |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for scene in &report.scenes {
        let beside = report.scenes.iter().find(|other| other.name == scene.beside);
        let difference = |of: fn(&Counts) -> Option<f64>| match beside {
            Some(beside) => {
                format!("{}: {}", beside.name, more(of(&scene.instructions), of(&beside.instructions)))
            }
            None => String::new(),
        };
        println!(
            "| {}: {} | {} | {} | {} | {} | {:.0} | {:.0} | {} | {} | {} |",
            scene.name,
            scene.what,
            counted(scene.instructions.contact),
            difference(|counts| counts.contact),
            counted(scene.instructions.haptic),
            difference(|counts| counts.haptic),
            scene.contact_ns,
            scene.haptic_ns,
            scene.contacts,
            scene.threads.map_or_else(|| "–".to_owned(), |threads| format!("+{threads}")),
            match scene.gpu {
                None => "–",
                Some(false) => "not looked for",
                Some(true) => "looked for",
            }
        );
    }
    for scene in report.scenes.iter().filter(|scene| scene.textures.starts_with("on")) {
        println!("\n{}: textures are {}", scene.name, scene.textures);
    }
    if let Some(clustering) = report.scenes[0].instructions.clustering {
        println!("\nOf the contact step, clustering the one contact takes {clustering:.0} instructions.");
    }
    println!(
        "\n| absent, and costs nothing | contact step | compared with | haptic step | compared with | equal |"
    );
    println!("|---|---|---|---|---|---|");
    for Absence { what, instructions, of, equal } in &report.absent {
        println!(
            "| {what} | {} | {} | {} | {} | {} |",
            counted(instructions.contact),
            counted(of.contact),
            counted(instructions.haptic),
            counted(of.haptic),
            match equal {
                None => "not counted",
                Some(true) => "yes",
                Some(false) => "NO",
            }
        );
    }
}
