//! The surface of each level of a hierarchy: which patches and triangles meet, and which point of it is
//! nearest to another.

mod nearest;
mod neighbours;
mod trees;

pub(crate) use nearest::{NearestPoint, NearestSearch};
pub(crate) use trees::Patchwork;
