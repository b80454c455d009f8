//! The surface of each level of a hierarchy: adjacency of patches and triangles, and nearest points.

mod nearest;
mod neighbours;
mod trees;

pub(crate) use nearest::{NearestPoint, NearestSearch};
pub(crate) use trees::Patchwork;
