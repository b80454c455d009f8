//! Packages of the workspace as cargo describes them, and which of them are published.

use std::process::Command;

use serde::Deserialize;

use crate::Failure;

/// A package of the workspace.
#[derive(Clone, Debug, Deserialize)]
pub struct Package {
    pub name: String,
    /// Registries that it may be published to: empty if none, `None` if any.
    publish: Option<Vec<String>>,
    /// Oldest Rust that it supports.
    pub rust_version: Option<String>,
    #[cfg(test)]
    manifest_path: std::path::PathBuf,
    targets: Vec<Target>,
}

#[derive(Clone, Debug, Deserialize)]
struct Target {
    kind: Vec<String>,
}

impl Package {
    /// Returns whether other packages can depend on it.
    pub fn is_library(&self) -> bool {
        self.targets.iter().any(|target| target.kind.iter().any(|kind| kind == "lib"))
    }
}

/// Lists the packages that are published.
///
/// # Errors
/// If cargo fails, or its output cannot be parsed.
pub fn published() -> Result<Vec<Package>, Failure> {
    #[derive(Deserialize)]
    struct Metadata {
        packages: Vec<Package>,
    }
    let output = Command::new("cargo")
        .args(["metadata", "--no-deps", "--format-version", "1", "--locked"])
        .current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
        .output()
        .map_err(|error| format!("`cargo metadata` could not be started: {error}"))?;
    if !output.status.success() {
        return Err(format!("`cargo metadata` failed: {}", String::from_utf8_lossy(&output.stderr)).into());
    }
    let Metadata { packages } = serde_json::from_slice(&output.stdout)?;
    Ok(packages
        .into_iter()
        .filter(|package| package.publish.as_ref().is_none_or(|to| !to.is_empty()))
        .collect())
}

/// Returns `--package NAME` for each package.
pub fn chosen<'a>(packages: impl IntoIterator<Item = &'a Package>) -> Vec<&'a str> {
    packages.into_iter().flat_map(|package| ["--package", package.name.as_str()]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn published_packages_contain_their_licences() {
        for package in published().expect("metadata") {
            for licence in ["LICENSE-APACHE", "LICENSE-MIT"] {
                let file = package.manifest_path.with_file_name(licence);
                assert!(file.is_file(), "{} is missing", file.display());
            }
        }
    }

    #[test]
    fn only_packages_for_users_are_published() {
        let published = published().expect("metadata");
        let has = |name: &str| published.iter().any(|package| package.name == name);
        assert!(has("palpate") && has("palpate-core") && has("palpate-cli"));
        assert!(
            !has("xtask") && !has("palpate-tests") && !has("palpate-benches") && !has("palpate-examples")
        );
        let cli = published.iter().find(|package| package.name == "palpate-cli").expect("the command line");
        assert!(!cli.is_library());
        assert!(published.iter().filter(|package| package.is_library()).count() + 1 == published.len());
    }
}
