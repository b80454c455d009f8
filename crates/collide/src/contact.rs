//! The contact that queries report.

use palpate_core::{Contact, Pose};

/// A contact with the pair of patches that it is between.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PatchContact {
    /// The contact, in world axes.
    pub contact: Contact,
    /// Node of the probe's hierarchy.
    pub probe_node: u32,
    /// Node of the scene object's hierarchy.
    pub scene_node: u32,
    /// Weight of the contact: 1, unless contacts of finer patches have the rest
    /// ([`QuerySettings::interpolate`](crate::QuerySettings::interpolate)).
    pub weight: f64,
}

/// Transforms a contact from a body's frame to world axes.
pub(crate) fn to_world(contact: &Contact, pose: &Pose) -> Contact {
    Contact {
        point: pose.transform_point(contact.point),
        scene_point: pose.transform_point(contact.scene_point),
        normal: pose.transform_vector(contact.normal),
        depth: contact.depth,
    }
}
