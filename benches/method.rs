//! What all ways to find contacts have in common.

use palpate::collide::PatchContact;
use palpate::{Contact, Pose};

/// A way to find contacts between a probe and a scene object that stands at the origin.
pub trait Method {
    /// Finds the contacts at a pose of the probe.
    fn run(&mut self, pose: &Pose);
    /// Appends the contacts of the last query, which was at this pose, in scene axes.
    fn append_contacts(&self, pose: &Pose, found: &mut Vec<PatchContact>);
    /// Bytes of memory held.
    fn bytes(&self) -> usize;
}

/// A contact that was not found between nodes of hierarchies.
pub fn without_nodes(contact: Contact) -> PatchContact {
    PatchContact { contact, probe_node: 0, scene_node: 0, weight: 1.0 }
}
