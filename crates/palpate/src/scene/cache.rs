//! Built hierarchies and distance fields, kept in the user's cache folder (`palpate` in it) under a name derived from the mesh.
//!
//! A cache that cannot be read or written is as good as none: what is wanted is built, and the session goes on.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use palpate_clod_build::{BuildError, BuildOptions, REVISION, Stage};
use palpate_core::{Clod, TriMesh};
use palpate_field::FieldOptions;

use crate::scene::field::{FIELD_REVISION, Field};

/// Changes whenever what is kept with a field does.
const WITH_FIELD: u32 = 1;

/// The hierarchy of `mesh`, from the cache if it is there, else built and kept.
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
        keep(&path, |partial| clod.save(partial).is_ok());
    }
    Ok(clod)
}

/// Where the hierarchy of `mesh` is kept: the name holds the builder's revision and a hash of the mesh and the options.
fn path_of(mesh: &TriMesh, options: &BuildOptions) -> Option<PathBuf> {
    let name = format!("{REVISION}-{:016x}.clod", hash_of(mesh, &format!("{options:?}")));
    Some(cache_folder()?.join(name))
}

/// A hash of a mesh, and of how something is made of it.
fn hash_of(mesh: &TriMesh, how: &str) -> u64 {
    let mut hasher = DefaultHasher::new();
    how.hash(&mut hasher);
    mesh.triangles().hash(&mut hasher);
    for vertex in mesh.vertices() {
        vertex.to_array().map(f64::to_bits).hash(&mut hasher);
    }
    hasher.finish()
}

/// The distance field of `mesh`, from the cache if it is there, else made and kept. The name holds the revision of how it is made.
pub(crate) fn field(mesh: &TriMesh, options: &FieldOptions) -> Field {
    let name = format!("{FIELD_REVISION}.{WITH_FIELD}-{:016x}.field", hash_of(mesh, &format!("{options:?}")));
    let path = cache_folder().map(|folder| folder.join(name));
    let kept = path.as_ref().and_then(|path| std::fs::read(path).ok());
    if let Some(field) = kept.and_then(|bytes| Field::from_bytes(&bytes)) {
        return field;
    }
    let field = Field::new(mesh, options);
    if let Some(path) = path {
        keep(&path, |partial| std::fs::write(partial, field.to_bytes()).is_ok());
    }
    field
}

/// The folder that built hierarchies are kept in, whether or not it exists yet; none where the system names no cache folder
/// for this user.
pub fn cache_folder() -> Option<PathBuf> {
    Some(dirs::cache_dir()?.join("palpate"))
}

/// A guard against a hash collision and a stale file.
fn made_from(clod: &Clod, mesh: &TriMesh) -> bool {
    clod.source.vertices as usize == mesh.vertices().len()
        && clod.source.triangles as usize == mesh.triangles().len()
}

/// Writes the file under another name first, so that a session that ends meanwhile leaves no half a file.
fn keep(path: &Path, write: impl FnOnce(&Path) -> bool) {
    let Some(folder) = path.parent() else { return };
    let partial = path.with_extension(format!("{}.partial", std::process::id()));
    let written = std::fs::create_dir_all(folder).is_ok() && write(&partial);
    if !(written && std::fs::rename(&partial, path).is_ok()) {
        // Nothing to be done about a partial file that cannot be removed either.
        drop(std::fs::remove_file(&partial));
    }
}
