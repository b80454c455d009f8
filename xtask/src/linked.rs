//! Crates that a program links when it embeds palpate, by its features, as `cargo tree` lists them. Build
//! scripts and macros do not count.

use std::collections::BTreeSet;
use std::error::Error;
use std::process::Command;

/// Sets of features of `palpate`, with the cargo options that select them.
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

/// Crates that a program links with `palpate`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Linked {
    /// Names and versions of the crates, without duplicates.
    pub crates: BTreeSet<String>,
    /// The same crates as a tree, as cargo prints it: `(*)` marks a crate whose subtree was printed before.
    pub tree: String,
}

impl Linked {
    /// Returns the number of crates that are not palpate's own.
    pub fn of_others(&self) -> usize {
        self.crates.iter().filter(|name| !name.starts_with("palpate")).count()
    }
}

/// Returns the arguments with which cargo prints the tree.
pub fn tree_arguments(options: &[&'static str]) -> Vec<&'static str> {
    let tree = ["tree", "-p", "palpate", "-e", "normal,no-proc-macro", "--format", "{p}", "--locked"];
    [&tree, options].concat()
}

/// Lists the crates that a program links with `palpate`, with `options` for cargo.
///
/// # Errors
/// If cargo cannot be started, or fails.
pub fn linked(options: &[&'static str]) -> Result<Linked, Box<dyn Error>> {
    tree(&tree_arguments(options))
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

/// Parses a printed tree.
fn read(printed: &str) -> Linked {
    let mut tree = String::new();
    let mut crates = BTreeSet::new();
    for line in printed.lines() {
        let (kept, again) = line.strip_suffix(" (*)").map_or((line, ""), |line| (line, " (*)"));
        // The path of a workspace package follows its version in brackets.
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
    fn a_crate_is_counted_once_and_no_folder_is_printed() {
        let printed = "palpate v0.1.0 (/somewhere/crates/palpate)\n├── glam v0.34.2\n│   └── serde_core v1.0.0\n\
                       └── palpate-core v0.1.0 (/somewhere/crates/core)\n    └── glam v0.34.2 (*)\n";
        let linked = read(printed);
        assert_eq!((linked.crates.len(), linked.of_others()), (4, 2));
        assert_eq!(
            linked.tree,
            "palpate v0.1.0\n├── glam v0.34.2\n│   └── serde_core v1.0.0\n└── palpate-core v0.1.0\n    └── glam v0.34.2 (*)\n"
        );
    }

    /// Lists the crates that cargo compiles for an example of the default packages, macros and build scripts
    /// included: those of the README's first command. Features are unified over these packages, as in a
    /// build.
    fn compiled_for_examples(options: &[&'static str]) -> Result<Linked, Box<dyn Error>> {
        tree(&[&["tree", "-e", "normal,build", "--format", "{p}", "--locked"], options].concat())
    }

    fn has(linked: &Linked, name: &str) -> bool {
        linked.crates.iter().any(|linked| linked.split(' ').next() == Some(name))
    }

    #[test]
    fn crates_of_features_are_not_linked_by_default() {
        let with = |options: &[&'static str]| linked(options).unwrap_or_else(|error| panic!("{error}"));
        let minimal = with(&[]);
        assert!(has(&minimal, "palpate-collide"));
        let features = [
            ("gpu", "wgpu"),
            ("gpu", "naga"),
            ("hid", "hidapi"),
            ("images", "image"),
            ("haply", "tungstenite"),
            ("force-dimension", "libloading"),
        ];
        for (feature, name) in features {
            assert!(!has(&minimal, name), "{name} without {feature}");
            assert!(has(&with(&["--features", feature]), name), "{name} with {feature}");
        }
        // No feature of the engine links a window or a terminal.
        let all = with(&["--all-features"]);
        for name in ["winit", "eframe", "ratatui", "plotters"] {
            assert!(!has(&all, name), "{name}");
        }
    }

    /// The README's first command has to compile within minutes.
    #[test]
    fn the_jaws_compile_few_crates() {
        let with = |options: &[&'static str]| {
            compiled_for_examples(options).unwrap_or_else(|error| panic!("{error}"))
        };
        let jaws = with(&[]);
        assert!(has(&jaws, "palpate-examples") && has(&jaws, "syn"), "{}", jaws.tree);
        // (Limit set after 106 were seen, ten of them for exact arithmetic in repair.)
        assert!(jaws.crates.len() <= 110, "{} crates:\n{}", jaws.crates.len(), jaws.tree);
        for (feature, name) in [("textures", "wgpu"), ("terminal", "hidapi"), ("terminal", "ratatui")] {
            assert!(!has(&jaws, name), "{name}:\n{}", jaws.tree);
            assert!(has(&with(&["--features", feature]), name), "{name} with {feature}");
        }
    }
}
