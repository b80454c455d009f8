//! The surface of each level of a hierarchy: adjacency of patches and triangles, nearest points, and
//! connected parts.

mod nearest;
mod neighbours;
mod parts;
mod trees;

pub(crate) use nearest::{NearestPoint, NearestSearch};
pub(crate) use parts::Parts;
pub(crate) use trees::Patchwork;
