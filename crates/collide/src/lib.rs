//! Contact queries between two objects given as hierarchies of convex hulls (§3.4), and contact clustering
//! (§5.4.2).
//!
//! | type | purpose |
//! |---|---|
//! | [`Shape`] | a hierarchy prepared for queries |
//! | [`ContactQuery`] | descends two shapes in tandem and reports a [`PatchContact`] for every pair of convex surface patches that are within the tolerance or penetrate, at full resolution or at the coarsest level whose error would not be felt |
//! | [`SceneQuery`] | the same for one probe and many objects; objects far away cost almost nothing |
//! | [`ContactSet`] | merges the contacts of a query into local minima of the distance and one contact for each connected region of intersection, also where one object is wholly inside the other |
//! | [`Containment`] | tells which connected parts of one object are wholly inside the other |
//! | [`Clustering`] | reduces contacts to a few representatives |
//! | [`CollisionEvents`] | finds times and points at which surfaces met, for hosts that step through time |
//! | [`convex`] | queries between two convex hulls, which all others use |
//!
//! All numbers are f64, and the caller owns the workspaces. A query takes no lock, does not panic, and
//! allocates only when it needs more room than any query before it. Invalid input returns a [`QueryError`],
//! which does not allocate.
//!
//! # Layers
//!
//! Each module imports from floors below its own only, and the modules of one floor are independent:
//!
//! 1. `tolerances`, `error`, `ball`, `disjoint_sets`, `incidence`, `contact`, `detail`: numbers and plain
//!    data
//! 2. `convex`: distance and penetration of two hulls
//! 3. `motion`, `patch`, `patchwork`: bounds on the bodies' motion, real surface of hulls, whole surfaces
//! 4. `shape`: a hierarchy prepared for queries
//! 5. `query`, `contact_set`, `clustering`, `events`: queries of pairs of shapes, and processing of their
//!    contacts
//! 6. `scene_query`: many objects
//!
//! # Frames and signs
//!
//! A [`Pose`](palpate_core::Pose) maps points of an object's frame to the world. Contacts are in world axes,
//! m. The normal **n** points out of the probe, the first of the two objects. The depth δ is positive if
//! the surfaces penetrate and minus their distance if they are apart. So the point on the scene object is
//! **p** − δ **n**, moving the probe by −δ **n** ends the penetration, and a penalty force
//! on the probe is along −**n**.
//!
//! # Example
//!
//! ```toml
//! [dependencies]
//! palpate-collide = "0.1"
//! palpate-core = "0.1"       # meshes, poses, contacts
//! palpate-clod-build = "0.1" # builds hierarchies; not needed if they are read from .clod files
//! ```
//!
//! An octahedron whose lowest tip is 1 mm inside a cube:
//!
//! ```
//! use palpate_clod_build::{BuildOptions, build, unwatched};
//! use palpate_collide::{ContactQuery, QuerySettings, Shape};
//! use palpate_core::glam::DVec3;
//! use palpate_core::{Pose, TriMesh};
//!
//! // Closed meshes, triangles counter-clockwise seen from outside, metres.
//! let corner = |i: u32| DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2)) * 0.1;
//! #[rustfmt::skip]
//! let cube = TriMesh::new((0..8).map(corner).collect(), vec![
//!     [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
//!     [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
//! ])?;
//! let tips = [DVec3::X, -DVec3::X, DVec3::Y, -DVec3::Y, DVec3::Z, -DVec3::Z].map(|tip| 0.05 * tip);
//! #[rustfmt::skip]
//! let octahedron = TriMesh::new(tips.to_vec(), vec![
//!     [0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5],
//! ])?;
//!
//! // Building is offline work; `Clod::save` and `Clod::load` keep the result.
//! let options = BuildOptions::default();
//! let probe = Shape::new(build(&octahedron, &options, &mut unwatched)?);
//! let scene = Shape::new(build(&cube, &options, &mut unwatched)?);
//!
//! let mut query = ContactQuery::new(&probe, &scene);
//! let settings = QuerySettings::new(0.002); // contacts within 2 mm
//! let pose = Pose::from_translation(DVec3::new(0.04, 0.05, 0.1 + 0.05 - 0.001));
//! let outcome = query.run(&pose, &Pose::IDENTITY, &settings)?;
//! assert!((outcome.deepest.expect("a contact") - 0.001).abs() < 1e-9);
//! let deepest = query.contacts().iter().map(|found| found.contact).max_by(|a, b| a.depth.total_cmp(&b.depth));
//! let deepest = deepest.expect("a contact");
//! assert!(deepest.normal.distance(-DVec3::Z) < 1e-9); // out of the octahedron, into the cube
//! assert!(deepest.point.distance(DVec3::new(0.04, 0.05, 0.099)) < 1e-9); // the tip
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! With the facade, `palpate`, objects are opened from mesh files and built-in models, and are kept in a
//! cache; its guide has a chapter on contact queries.

mod ball;
mod clustering;
mod contact;
mod contact_set;
pub mod convex;
mod detail;
mod disjoint_sets;
mod error;
mod events;
mod incidence;
mod motion;
mod patch;
mod patchwork;
mod query;
mod scene_query;
mod shape;
mod tolerances;

pub use clustering::{Cluster, Clustering};
pub use contact::PatchContact;
pub use contact_set::{ContactSet, ContactSetOutcome, ContactSetSettings, Containment};
pub use error::{ContactSetError, QueryError, QueryObject};
pub use events::{CollisionEvent, CollisionEvents};
pub use query::{
    Budget, Combination, ContactQuery, ErrorMetrics, MAX_CONTACTS, MAX_PAIRS, QueryOutcome, QuerySettings,
    VelocityMetric, ViewMetric,
};
pub use scene_query::{ObjectContacts, ObjectHandle, SceneOutcome, SceneQuery};
pub use shape::Shape;
