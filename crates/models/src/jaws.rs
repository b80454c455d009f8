//! TODO
use palpate_core::TriMesh;
pub(crate) const MIN_TRIANGLES: usize = 1000;
pub(crate) fn lower(_triangles: usize) -> TriMesh { unimplemented!() }
pub(crate) fn upper(_triangles: usize) -> TriMesh { unimplemented!() }
