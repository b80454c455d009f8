//! TODO
use palpate_core::TriMesh;
pub(crate) const MIN_TRIANGLES: usize = 1000;
pub(crate) fn build(_triangles: usize) -> TriMesh {
    unimplemented!()
}
