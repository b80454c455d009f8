//! Page of the crates that a program links when it embeds palpate: `docs/dependencies.md`.

use std::fmt::Write as _;
use std::path::Path;

use crate::Failure;
use crate::linked::{FEATURE_SETS, linked, tree_arguments};

/// Arguments of `cargo xtask dependencies`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Writes nothing, and fails if the page is out of date.
    #[arg(long)]
    check: bool,
}

/// Path of the page from the root of the workspace.
const PAGE: &str = "docs/dependencies.md";

/// Fixed target, so that the page does not depend on the machine that writes it.
const TARGET: [&str; 2] = ["--target", "x86_64-unknown-linux-gnu"];

/// Checks that the page is up to date.
///
/// # Errors
/// If it is out of date, or cargo fails.
pub fn check() -> Result<(), Failure> {
    run(&Arguments { check: true })
}

/// Writes the page, or checks it.
///
/// # Errors
/// If cargo fails, the page cannot be written, or a checked page is out of date.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/..")).join(PAGE);
    let page = page()?;
    if arguments.check {
        let written = std::fs::read_to_string(&path).map_err(|error| format!("{PAGE}: {error}"))?;
        if written != page {
            return Err(format!("{PAGE} is out of date: `cargo xtask dependencies` writes it").into());
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
    let (minimal, command) = minimal.ok_or("no set of features is listed")?;
    Ok(format!(
        "# What palpate links\n\n\
         `cargo xtask dependencies` writes this page, and `cargo xtask ci` fails if it is out of date. It lists the crates that a program \
         links,\non Linux, when it embeds `palpate`: each once, palpate's own included. Macros and build scripts run during the build and do not \
         count.\n`cargo test -p xtask linked::` checks that there is no GPU, HID or image crate among them without features, and no window \
         with all\nof them.\n\n\
         | features of palpate | crates | by others | command |\n|---|---|---|---|\n{rows}\n\
         ## Without features\n\n{} crates, {} of them by others. `(*)` marks a crate whose own tree stands further up.\n\n\
         ```sh\ncargo {command}\n```\n\n```text\n{}```\n",
        minimal.crates.len(),
        minimal.of_others(),
        minimal.tree,
    ))
}
