//! The vocabulary of palpate: rigid motions ([`Pose`], [`Twist`], [`Wrench`]), [`Contact`]s, triangle meshes
//! ([`TriMesh`], its adjacency, mass properties and validation report) and the dual hierarchy [`Clod`] with
//! its file format.
//!
//! SI units everywhere (m, kg, s, N, N·m, rad), right-handed axes, quaternions in the order x, y, z, w.
//! Vectors are in world axes unless a field says otherwise.

pub mod clod;
mod contact;
mod conversions;
pub mod mesh;
mod motion;
pub mod triangle;

pub use clod::Clod;
pub use contact::Contact;
pub use glam;
pub use mesh::TriMesh;
pub use motion::{Pose, Twist, Wrench};
