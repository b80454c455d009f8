//! Builds contact levels of detail (§3.2, §3.3): the surface convex decomposition of a mesh, and the
//! hierarchy of convex hulls over it.
//!
//! [`build`] is offline work: it allocates freely, may use all cores, and gives the same bytes for the same
//! mesh and options whatever the number of threads.

#![cfg_attr(
    test,
    allow(clippy::print_stdout, reason = "seeds and figures, shown by --nocapture or on failure")
)]

mod bounding;
mod box_tree;
mod build;
mod containment;
mod convexity;
mod decomposition;
mod deviation;
mod enclosing;
mod error;
mod hierarchy;
mod hull;
mod intersect;
mod layout;
mod levels;
mod nearest;
mod parameters;
mod progress;
mod requirements;
mod simplify;
mod skin;
mod surface;

pub use build::{BuildOptions, REVISION, build};
pub use error::BuildError;
pub use hull::hull_faces;
pub use progress::{Stage, unwatched};
