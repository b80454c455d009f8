//! Contact queries between two objects given as hierarchies of convex hulls (§3.4), and contact clustering (§5.4.2).
//!
//! A [`Shape`] is a hierarchy prepared for queries. [`ContactQuery`] descends two of them in tandem and reports a
//! [`PatchContact`] for every pair of convex surface patches that come within the tolerance, or penetrate: at full
//! resolution, or each at the coarsest whose error would not be felt. [`SceneQuery`] does so for one probe and many
//! objects, of which it leaves alone those that are far away. [`ContactSet`] puts the pieces together
//! again: local minima of the distance, and one contact for each connected region of intersection. [`Clustering`]
//! condenses contacts to a few representatives. [`ProximityQuery`] answers plainer questions: how far two surfaces are
//! apart, and whether two bodies intersect. [`CollisionEvents`] tells hosts that step through time when surfaces met. The queries between two convex hulls that it rests on are in [`convex`].
//!
//! Guarantees: everything is f64; the caller owns the workspaces; a query takes no lock, does not panic, and allocates
//! only while it exceeds the sizes reached before.

mod ball;
mod clustering;
mod contact_set;
pub mod convex;
mod error;
mod events;
mod motion;
mod patch;
mod proximity;
mod query;
mod scene_query;
mod sets;
mod shape;

pub use clustering::{Cluster, Clustering};
pub use contact_set::{ContactSet, ContactSetOutcome, ContactSetSettings};
pub use error::{ContactSetError, QueryError, QueryObject};
pub use events::{CollisionEvent, CollisionEvents};
pub use proximity::{Effort, Intersection, NearestPoints, ProximityQuery};
pub use query::{
    Budget, Combination, ContactQuery, ErrorMetrics, MAX_CONTACTS, MAX_PAIRS, PatchContact, QueryOutcome,
    QuerySettings, VelocityMetric, ViewMetric,
};
pub use scene_query::{ObjectContacts, ObjectHandle, SceneOutcome, SceneQuery};
pub use shape::Shape;
