//! Checks before a release: packages that can be published, the oldest supported Rust, and an API without
//! unintended breaking changes.

use std::process::{Command, Output};

use crate::workspace::{chosen, published};
use crate::{Failure, cargo};

/// Arguments of `cargo xtask semver`.
#[derive(clap::Args)]
pub struct SemverArguments {
    /// Revision to compare with: a tag, a commit, HEAD~20 [default: the latest tag]
    baseline: Option<String>,
}

/// Packs every published package as for a registry, and builds each from its packed files alone. Uploads
/// nothing.
///
/// # Errors
/// If a package cannot be packed or built.
pub fn publish_check() -> Result<(), Failure> {
    // Uncommitted changes are included, so that errors show before a commit.
    cargo(&["publish", "--dry-run", "--workspace", "--allow-dirty", "--locked"], &[])
}

/// Checks the published packages, with all features, with the oldest supported Rust.
///
/// # Errors
/// If the packages do not name one version, that version is not installed, or a check fails.
pub fn msrv() -> Result<(), Failure> {
    let packages = published()?;
    let mut versions: Vec<&str> =
        packages.iter().filter_map(|package| package.rust_version.as_deref()).collect();
    let given = versions.len();
    versions.dedup();
    let [version] = versions[..] else {
        return Err(
            format!("rust-version is {versions:?}: give one to all packages, in the workspace").into()
        );
    };
    if given != packages.len() {
        return Err("a published package has no rust-version; give it `rust-version.workspace = true`".into());
    }
    let packages = chosen(&packages);
    let check = [["check", "--all-features", "--locked"].as_slice(), &packages].concat();
    if is_version(&answer("rustc", &["--version"]).unwrap_or_default(), version) {
        return cargo(&check, &[]);
    }
    let installed = answer("rustup", &["run", version, "rustc", "--version"]);
    if !installed.is_some_and(|installed| is_version(&installed, version)) {
        return Err(format!(
            "Rust {version}, the oldest that palpate supports, is neither in use nor installed; \
             `rustup toolchain install {version} --profile minimal` installs it"
        )
        .into());
    }
    let shown = format!("rustup run {version} cargo {}", check.join(" "));
    println!("\n$ {shown}");
    let status = Command::new("rustup")
        .args(["run", version, "cargo"])
        .args(&check)
        .current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
        .status()
        .map_err(|error| format!("`{shown}` could not be started: {error}"))?;
    if status.success() { Ok(()) } else { Err(format!("`{shown}` failed ({status})").into()) }
}

/// Compares the API of the published libraries with that of a revision: lists what breaks, and the version
/// step that this requires.
///
/// # Errors
/// If cargo-semver-checks is not installed, there is no revision to compare with, or the version does not
/// permit the changes.
pub fn semver(arguments: &SemverArguments) -> Result<(), Failure> {
    if answer("cargo", &["semver-checks", "--version"]).is_none() {
        return Err(
            "cargo-semver-checks is not installed; `cargo install cargo-semver-checks --locked` does".into(),
        );
    }
    let baseline = match &arguments.baseline {
        Some(revision) => revision.clone(),
        None => answer("git", &["describe", "--tags", "--abbrev=0"]).ok_or(
            "there is no tag to compare with, so there was no release; name a revision, such as `cargo xtask semver HEAD~20`",
        )?,
    };
    let packages = published()?;
    let packages = chosen(packages.iter().filter(|package| package.is_library()));
    cargo(&[["semver-checks", "--baseline-rev", &baseline].as_slice(), &packages].concat(), &[])
}

/// Returns what a program prints, trimmed; `None` if it cannot be run or fails.
fn answer(program: &str, arguments: &[&str]) -> Option<String> {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
    let Output { status, stdout, .. } =
        Command::new(program).args(arguments).current_dir(root).output().ok()?;
    status.success().then(|| String::from_utf8_lossy(&stdout).trim().to_owned())
}

/// Returns whether the output of `rustc --version` names that version, of which the last number may be
/// omitted.
fn is_version(printed: &str, version: &str) -> bool {
    let number = printed.split(' ').nth(1).unwrap_or_default();
    number.strip_prefix(version).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_distinguished() {
        let printed = "rustc 1.95.0 (59807616e 2026-04-14)";
        assert!(is_version(printed, "1.95") && is_version(printed, "1.95.0"));
        for other in ["1.9", "1.96", "1.95.1", "2.95"] {
            assert!(!is_version(printed, other), "{other}");
        }
        assert!(!is_version("rustc 1.96.0-nightly (0 2026-04-14)", "1.95"));
        assert!(!is_version("", "1.95"));
    }
}
