//! Queries between two convex hulls given by their extreme points: [`gjk`] for the distance of separated hulls,
//! [`penetration`] for the depth of overlapping ones.
//!
//! The hulls keep their own coordinates; a [`Placement`] maps those of the second, **b** (the scene's), into the frame of
//! the first, **a** (the probe's), in which all results are given. A hull may be degenerate: flat, a needle or a
//! single point.

pub mod gjk;
pub mod penetration;
mod placement;
mod simplex;
mod support;

pub use gjk::{Distance, Limits, Separation, Start};
pub use penetration::{Penetration, Polytope};
pub use placement::Placement;
pub use simplex::{Simplex, Vertex, nearest_on_triangle};
pub use support::{Hull, SupportMap};
