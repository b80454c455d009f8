//! Contacts of the proxy, and how they are carried from one pose to another.

use palpate_collide::PatchContact;
use palpate_core::{Contact, Pose, Twist};

/// A contact of the proxy with a scene object.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ProxyContact {
    pub contact: PatchContact,
    /// The object, by its place in the scene's query.
    pub object: usize,
    /// Depth that the coarse mesh of a textured object may sink into, m.
    pub recess: f64,
}

impl ProxyContact {
    /// A contact without a recess.
    pub fn new(contact: PatchContact, object: usize) -> Self {
        Self { contact, object, recess: 0.0 }
    }

    /// The scene object and the patches in contact.
    pub fn pair(&self) -> (usize, u32, u32) {
        (self.object, self.contact.probe_node, self.contact.scene_node)
    }

    /// Allowed depth at this contact, m: `depth` (m) plus the recess of a textured object.
    pub fn allowed(&self, depth: f64) -> f64 {
        depth + self.recess
    }

    /// Moves the contact's plane with its scene object; the point on the proxy stays. With the plane's point
    /// **q** = **p** − δ **n** and its normal moved, δ' = (**p** − **q**') · **n**'.
    pub fn move_with_object(&mut self, motion: &Pose) {
        let Contact { point, scene_point, normal, depth } = self.contact.contact;
        let plane = motion.transform_point(point - normal * depth);
        let normal = motion.transform_vector(normal);
        let scene_point = motion.transform_point(scene_point);
        self.contact.contact = Contact { point, scene_point, normal, depth: (point - plane).dot(normal) };
    }
}

/// The motion from one pose to another, as a twist over a time of 1.
pub(crate) fn motion_between(from: &Pose, to: &Pose) -> Twist {
    Twist::new(to.translation - from.translation, from.rotation_vector_to(to))
}

/// Carries a contact from one pose of the body's centre of mass to another: the point moves with the body,
/// the plane stays. With **p**' the moved point, δ' = δ + (**p**' − **p**) · **n**.
pub(crate) fn carried(contact: &Contact, from: &Pose, to: &Pose) -> Contact {
    if from == to {
        return *contact;
    }
    let arm = from.rotation.conjugate() * (contact.point - from.translation);
    let point = to.transform_point(arm);
    Contact { point, depth: contact.depth + (point - contact.point).dot(contact.normal), ..*contact }
}
