//! Common interface of methods that find contacts.

use palpate::Pose;
use palpate_field::AreaContact;

/// Method that finds contacts between a probe and a scene object that stands at the origin.
pub trait Method {
    /// Finds the contacts at a pose of the probe.
    fn run(&mut self, pose: &Pose);
    /// Appends the contacts of the last query, which was at this pose, in scene axes. Methods that do not
    /// know the area of a contact use that of the smaller of its two features.
    fn append_contacts(&self, pose: &Pose, found: &mut Vec<AreaContact>);
    /// Returns the error that the last query says its depths have, m, if it says one.
    fn error(&self) -> Option<f64> {
        None
    }
    /// Returns the bytes of memory held.
    fn bytes(&self) -> usize;
}
