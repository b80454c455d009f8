//! What a program links that embeds palpate, as a page: `docs/dependencies.md`.

use std::fmt::Write as _;
use std::path::Path;

use xtask::linked::{FEATURE_SETS, linked, tree_arguments};

use crate::Failure;

/// What `cargo xtask dependencies` is asked to do.
#[derive(clap::Args)]
pub struct Arguments {
    /// Writes nothing, and fails if the page is not up to date.
    #[arg(long)]
    check: bool,
}

/// The page, from the root of the workspace.
const PAGE: &str = "docs/dependencies.md";

/// The page is the same whatever machine it is made on.
const TARGET: [&str; 2] = ["--target", "x86_64-unknown-linux-gnu"];

/// Whether the page is up to date.
///
/// # Errors
/// If it is not, or cargo fails.
pub fn check() -> Result<(), Failure> {
    run(&Arguments { check: true })
}

/// Writes the page, or sees whether it is up to date.
///
/// # Errors
/// If cargo fails, the page cannot be written, or it is to be checked and is not up to date.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/..")).join(PAGE);
    let page = page()?;
    if arguments.check {
        let there = std::fs::read_to_string(&path).map_err(|error| format!("{PAGE}: {error}"))?;
        if there != page {
            return Err(format!("{PAGE} is not up to date: `cargo xtask dependencies` writes it").into());
        }
        println!("{PAGE} is up to date");
    } else {
        std::fs::write(&path, page).map_err(|error| format!("{PAGE}: {error}"))?;
        println!("{PAGE}");
    }
    Ok(())
}

fn page() -> Result<String, Failure> {
    let mut rows = String::new();
    let mut minimal = None;
    for (name, options) in FEATURE_SETS {
        let options = [options, &TARGET].concat();
        let linked = linked(&options)?;
        let command = tree_arguments(&options).join(" ").replace("{p}", "'{p}'");
        writeln!(rows, "| {name} | {} | {} | `cargo {command}` |", linked.crates.len(), linked.of_others())?;
        minimal.get_or_insert((linked, command));
    }
    let (minimal, command) = minimal.ok_or("there is no set of features")?;
    Ok(format!(
        "# What palpate links\n\n\
         `cargo xtask dependencies` writes this page, and `cargo xtask ci` fails if it is out of date. It lists the crates that a program \
         links,\non Linux, when it embeds `palpate`: each once, palpate's own included. Macros and build scripts run during the build and do not \
         count.\n`cargo bench -p palpate-benches --bench stages` counts the same way. `cargo test -p palpate-tests --test it stages::` \
         checks that\nthere is no GPU, HID or image crate among them without features, and no window with all of them.\n\n\
         | features of palpate | crates | by others | command |\n|---|---|---|---|\n{rows}\n\
         ## Without features\n\n{} crates, {} of them by others. `(*)` marks a crate whose own tree stands further up.\n\n\
         ```sh\ncargo {command}\n```\n\n```text\n{}```\n",
        minimal.crates.len(),
        minimal.of_others(),
        minimal.tree,
    ))
}
