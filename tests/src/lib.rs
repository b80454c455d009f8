//! What the integration tests share: the optional test data, and brute force to compare clever answers with.

pub mod brute_force;
pub mod levels;
pub mod triangle_tree;

use std::io::Write as _;
use std::path::PathBuf;

use palpate::clod_build::unwatched;
use palpate::mesh_io::{LoadOptions, load};
use palpate::{Object, OpenOptions, TriMesh};

/// A file of the optional test data, which lies in `shared` beside the repository; says that the test is skipped, and
/// gives `None`, when it is absent.
pub fn shared(path: &str) -> Option<PathBuf> {
    let file = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared")).join(path);
    if file.exists() {
        return Some(file);
    }
    // Straight to the stream: the test runner keeps back what the print macros say.
    let _ = writeln!(std::io::stderr(), "skipped: {} is absent", file.display());
    None
}

/// A mesh of the optional test data, exactly welded.
///
/// # Panics
/// If the file is there but cannot be loaded.
pub fn shared_mesh(path: &str) -> Option<TriMesh> {
    let file = shared(path)?;
    match load(&file, &LoadOptions::default()) {
        Ok(loaded) => Some(loaded.mesh),
        Err(error) => panic!("{error}"),
    }
}

/// A built-in model with its hierarchy built anew, whatever the user's cache holds.
///
/// # Panics
/// If there is no such model.
pub fn model(name: &str) -> Object {
    let options = OpenOptions { cache: false, ..OpenOptions::default() };
    match Object::open(name, &options, &mut unwatched) {
        Ok((object, _)) => object,
        Err(error) => panic!("{error}"),
    }
}
