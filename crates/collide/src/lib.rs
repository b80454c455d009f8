//! Contact queries between two objects given as hierarchies of convex hulls (§3.4), and contact clustering (§5.4.2).
//!
//! [`ContactQuery`] descends both hierarchies in tandem and reports a [`PatchContact`] for every pair of convex surface
//! patches that come within the tolerance, or penetrate. [`Clustering`] condenses them to a few representatives.
//! The convex queries below them work on plain point sets.
//!
//! Guarantees: everything is f64; the caller owns the workspaces; a query takes no lock, does not panic, and allocates
//! only while it exceeds the sizes reached before.

pub mod clustering;
pub mod query;

pub use clustering::{Cluster, Clustering};
pub use query::{ContactQuery, PatchContact, QueryOutcome, QuerySettings};
