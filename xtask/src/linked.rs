//! Which crates end up in a program that embeds palpate, by its features, as `cargo tree` tells it. Build scripts and macros do not.

use std::collections::BTreeSet;
use std::error::Error;
use std::process::Command;

/// Sets of features of `palpate`, and the options with which cargo takes them.
pub const FEATURE_SETS: [(&str, &[&str]); 11] = [
    ("none, by default", &[]),
    ("models", &["--features", "models"]),
    ("gltf", &["--features", "gltf"]),
    ("images", &["--features", "images"]),
    ("hid", &["--features", "hid"]),
    ("haply", &["--features", "haply"]),
    ("force-dimension", &["--features", "force-dimension"]),
    ("open-haptics", &["--features", "open-haptics"]),
    ("haption", &["--features", "haption"]),
    ("gpu", &["--features", "gpu"]),
    ("gpu, hid, images", &["--features", "gpu,hid,images"]),
];

/// What a program links with `palpate`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Linked {
    /// Names and versions of the crates, each once.
    pub crates: BTreeSet<String>,
    /// The same as a tree, as cargo draws it: `(*)` marks what was drawn before.
    pub tree: String,
}

impl Linked {
    /// How many of the crates are not palpate's own.
    pub fn of_others(&self) -> usize {
        self.crates.iter().filter(|name| !name.starts_with("palpate")).count()
    }
}

/// The arguments of cargo that draw the tree.
pub fn tree_arguments(options: &[&'static str]) -> Vec<&'static str> {
    let tree = ["tree", "-p", "palpate", "-e", "normal,no-proc-macro", "--format", "{p}", "--locked"];
    [&tree, options].concat()
}

/// What a program links with `palpate`, with `options` for cargo.
///
/// # Errors
/// If cargo cannot be started, or fails.
pub fn linked(options: &[&'static str]) -> Result<Linked, Box<dyn Error>> {
    tree(&tree_arguments(options))
}

/// What cargo compiles for an example of the packages that plain commands select, macros and build scripts included: the crates of
/// README's first command. `options` are for cargo. Features are unified over these packages, as they are when cargo builds.
///
/// # Errors
/// If cargo cannot be started, or fails.
pub fn compiled_for_examples(options: &[&'static str]) -> Result<Linked, Box<dyn Error>> {
    tree(&[&["tree", "-e", "normal,build", "--format", "{p}", "--locked"], options].concat())
}

fn tree(arguments: &[&str]) -> Result<Linked, Box<dyn Error>> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
    let output = Command::new(cargo).args(arguments).current_dir(root).output()?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        return Err(format!("cargo {}: {said}", arguments.join(" ")).into());
    }
    Ok(read(&String::from_utf8(output.stdout)?))
}

/// What a printed tree says.
fn read(printed: &str) -> Linked {
    let mut tree = String::new();
    let mut crates = BTreeSet::new();
    for line in printed.lines() {
        let (kept, again) = line.strip_suffix(" (*)").map_or((line, ""), |line| (line, " (*)"));
        // A path in brackets follows what lies in the workspace.
        let kept = kept.split(" (").next().unwrap_or(kept);
        tree.extend([kept, again, "\n"]);
        let name = kept.trim_start_matches(|c: char| !c.is_ascii_alphanumeric());
        if !name.is_empty() {
            crates.insert(name.to_owned());
        }
    }
    Linked { crates, tree }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_crate_is_counted_once_and_no_folder_is_told() {
        let printed = "palpate v0.1.0 (/somewhere/crates/palpate)\n├── glam v0.34.2\n│   └── serde_core v1.0.0\n\
                       └── palpate-core v0.1.0 (/somewhere/crates/core)\n    └── glam v0.34.2 (*)\n";
        let linked = read(printed);
        assert_eq!((linked.crates.len(), linked.of_others()), (4, 2));
        assert_eq!(
            linked.tree,
            "palpate v0.1.0\n├── glam v0.34.2\n│   └── serde_core v1.0.0\n└── palpate-core v0.1.0\n    └── glam v0.34.2 (*)\n"
        );
    }
}
