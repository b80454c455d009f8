//! What all ways to find contacts have in common.

use palpate::Pose;
use palpate_field::AreaContact;

/// A way to find contacts between a probe and a scene object that stands at the origin.
pub trait Method {
    /// Finds the contacts at a pose of the probe.
    fn run(&mut self, pose: &Pose);
    /// Appends the contacts of the last query, which was at this pose, in scene axes. Methods that do not know the area that a
    /// contact stands for give that of the smaller of the two features which it is between.
    fn append_contacts(&self, pose: &Pose, found: &mut Vec<AreaContact>);
    /// Bytes of memory held.
    fn bytes(&self) -> usize;
}
