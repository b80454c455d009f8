//! The readers, one for each format: each turns bytes into a [`Surface`](surface::Surface).

#[cfg(feature = "gltf")]
pub(crate) mod gltf_scene;
pub(crate) mod obj;
pub(crate) mod ply;
pub(crate) mod stl;
pub(crate) mod surface;
pub(crate) mod text;

use std::fs;
use std::path::Path;

use crate::LoadError;

/// Reads the bytes of a regular file. Others are refused: a device or a pipe might never end.
pub(crate) fn read_file(path: &Path) -> Result<Vec<u8>, LoadError> {
    let failed = |source| LoadError::Read { file: path.into(), source };
    if !fs::metadata(path).map_err(failed)?.is_file() {
        return Err(failed(std::io::Error::other("not a regular file")));
    }
    fs::read(path).map_err(failed)
}
