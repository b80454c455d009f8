//! Cache of built hierarchies and distance fields, in the folder `palpate` of the user's cache folder, under
//! names derived from the mesh.
//!
//! If the cache cannot be read or written, hierarchies and fields are built anew.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use palpate_clod_build::{BuildError, BuildOptions, REVISION, Stage};
use palpate_core::{Clod, TriMesh};
use palpate_field::{FeatureMesh, FieldOptions};

use crate::scene::field::{FIELD_REVISION, Field};

/// Revision of the data that are stored with a field. Raise it when their format or meaning changes;
/// otherwise old files are read wrongly.
const STORED_FIELD_REVISION: u32 = 1;

/// Loads the hierarchy of `mesh` from the cache, or builds and stores it.
pub(crate) fn build_or_load(
    mesh: &TriMesh,
    options: &BuildOptions,
    progress: &mut dyn FnMut(Stage, f64) -> ControlFlow<()>,
) -> Result<Clod, BuildError> {
    let path = path_of(mesh, options);
    if let Some(clod) =
        path.as_ref().and_then(|path| Clod::load(path).ok()).filter(|clod| made_from(clod, mesh))
    {
        return Ok(clod);
    }
    let clod = palpate_clod_build::build(mesh, options, progress)?;
    if let Some(path) = path {
        store(&path, |partial| clod.save(partial).is_ok());
    }
    Ok(clod)
}

/// Path of the hierarchy of `mesh`: the name holds the builder's revision and a hash of the mesh and the
/// options.
fn path_of(mesh: &TriMesh, options: &BuildOptions) -> Option<PathBuf> {
    let name = format!("{REVISION}-{:016x}.clod", hash_of(mesh, &format!("{options:?}")));
    Some(cache_folder()?.join(name))
}

/// Hash of a mesh, and of the options with which something is made of it.
fn hash_of(mesh: &TriMesh, options: &str) -> u64 {
    let mut hasher = DefaultHasher::new();
    options.hash(&mut hasher);
    mesh.triangles().hash(&mut hasher);
    for vertex in mesh.vertices() {
        vertex.to_array().map(f64::to_bits).hash(&mut hasher);
    }
    hasher.finish()
}

/// Loads the distance field of `mesh` from the cache; `None` if it is not there. The mesh's linked features
/// are made only if it is.
pub(crate) fn stored_field(
    mesh: &TriMesh,
    features: impl FnOnce() -> Arc<FeatureMesh>,
    options: &FieldOptions,
) -> Option<Field> {
    Field::from_bytes(&std::fs::read(path_of_field(mesh, options)?).ok()?, features())
}

/// Makes the distance field of `mesh`, and stores it in the cache.
pub(crate) fn make_field(mesh: &TriMesh, features: Arc<FeatureMesh>, options: &FieldOptions) -> Field {
    let field = Field::new(mesh, features, options);
    if let Some(path) = path_of_field(mesh, options) {
        store(&path, |partial| std::fs::write(partial, field.to_bytes()).is_ok());
    }
    field
}

/// Path of the distance field of `mesh`: the name holds the revisions of fields, and a hash of the mesh and
/// the options.
fn path_of_field(mesh: &TriMesh, options: &FieldOptions) -> Option<PathBuf> {
    let hash = hash_of(mesh, &format!("{options:?}"));
    let name = format!("{FIELD_REVISION}.{STORED_FIELD_REVISION}-{hash:016x}.field");
    Some(cache_folder()?.join(name))
}

/// Folder of the cache, whether or not it exists yet; `None` if the system names no cache folder for this
/// user.
pub fn cache_folder() -> Option<PathBuf> {
    Some(dirs::cache_dir()?.join("palpate"))
}

/// Whether a hierarchy has the vertex and triangle counts of `mesh`: guards against hash collisions and stale
/// files.
fn made_from(clod: &Clod, mesh: &TriMesh) -> bool {
    clod.source.vertices as usize == mesh.vertices().len()
        && clod.source.triangles as usize == mesh.triangles().len()
}

/// Writes a file under another name and renames it, so that a session that ends meanwhile does not leave a
/// partial file.
fn store(path: &Path, write: impl FnOnce(&Path) -> bool) {
    let Some(folder) = path.parent() else { return };
    let partial = path.with_extension(format!("{}.partial", std::process::id()));
    let written = std::fs::create_dir_all(folder).is_ok() && write(&partial);
    if !(written && std::fs::rename(&partial, path).is_ok()) {
        // If the partial file cannot be removed either, it stays.
        drop(std::fs::remove_file(&partial));
    }
}
