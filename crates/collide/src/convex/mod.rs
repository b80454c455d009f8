//! Queries between two convex hulls given by their extreme points: [`gjk`] for the distance of separated
//! hulls, [`penetration`] for the depth of overlapping ones.
//!
//! The hulls keep their own coordinates; a [`Placement`] maps those of the second, **b** (the scene's), into
//! the frame of the first, **a** (the probe's), in which all results are given. A hull may be degenerate:
//! flat, a needle or a single point.
//!
//! All numbers are f64. With f32 and accordingly larger tolerances, little time is saved on the pairs of
//! patches in contact in the benchmark scenarios, since most of it is spent on memory access and comparisons
//! rather than on arithmetic in wide registers; and depths have errors of up to a ten-thousandth of the
//! tolerance d. These could not be felt in one contact. But the queries also prove bounds, which decide how
//! long a pair needs no recheck. The bounds distinguish surfaces that touch from surfaces that are apart at a
//! tolerance of 0, and must not depend on the unit of length or on a body's distance from the origin.

pub mod gjk;
pub mod penetration;
mod placement;
mod simplex;
mod support;

pub use gjk::{Distance, Limits, Separation, Start};
pub use penetration::{Penetration, Polytope};
pub use placement::Placement;
pub(crate) use simplex::nearest_on_triangle;
pub use simplex::{Simplex, Vertex};
pub use support::{Hull, HullPoints, SupportMap};
