//! Queries between two convex hulls given by their extreme points: [`gjk`] for the distance of separated
//! hulls, [`penetration`] for the depth of overlapping ones.
//!
//! The hulls keep their own coordinates; a [`Placement`] maps those of the second, **b** (the scene's), into
//! the frame of the first, **a** (the probe's), in which all results are given. A hull may be degenerate:
//! flat, a needle or a single point.
//!
//! Everything is f64. With f32, and tolerances that are larger accordingly, on the pairs of patches that are
//! in contact in the benchmark scenarios, little time is saved, since most of it goes into looking up and
//! comparing rather than into arithmetic on wide registers; and depths are then off by up to a ten-thousandth
//! of the tolerance d. That could not be felt in one contact. But the queries also prove bounds, which decide
//! how long a pair needs no recheck. They distinguish surfaces that touch from surfaces that are apart at a
//! tolerance of 0, and must not depend on the unit of length or on how far from the origin a body is
//! modelled.

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
