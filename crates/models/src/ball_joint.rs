//! TODO
use palpate_core::TriMesh;
pub(crate) const MIN_TRIANGLES: usize = 1000;
pub(crate) fn ball(_triangles: usize) -> TriMesh { unimplemented!() }
pub(crate) fn socket(_triangles: usize) -> TriMesh { unimplemented!() }
