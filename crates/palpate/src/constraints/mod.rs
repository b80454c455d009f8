//! Contacts as constraints: what the contact loop finds of them, and what the haptic loop holds the body by.
//!
//! The contact loop searches for [convex features near each other](near_features), chooses those at which
//! [points start](guard), and hands over [contact geometry](geometry). The haptic loop measures its
//! [points](guarded_point) at each step, exactly on the meshes. Both threads read the geometry and the
//! meshes; neither changes what the other one reads.

pub(crate) mod geometry;
pub(crate) mod guard;
pub(crate) mod guarded_point;
pub(crate) mod near_features;
pub(crate) mod pairs;
#[cfg(test)]
pub(crate) mod test_meshes;
