//! A contact of the proxy, and how it is carried from one pose to another.

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

    /// Scene object and patches that the contact is between.
    pub fn pair(&self) -> (usize, u32, u32) {
        (self.object, self.contact.probe_node, self.contact.scene_node)
    }

    /// Depth that the proxy may have here, m, where it may have `depth` (m) in an object that is not textured.
    pub fn allowed(&self, depth: f64) -> f64 {
        depth + self.recess
    }

    /// Takes the contact along as its scene object moves, so that it stays on its side.
    pub fn move_with_object(&mut self, motion: &Pose) {
        let Contact { point, scene_point, normal, depth } = self.contact.contact;
        let plane = motion.transform_point(point - normal * depth);
        let normal = motion.transform_vector(normal);
        let scene_point = motion.transform_point(scene_point);
        self.contact.contact = Contact { point, scene_point, normal, depth: (point - plane).dot(normal) };
    }
}

/// The motion (a twist for the time of 1) from one pose to another.
pub(crate) fn motion_between(from: &Pose, to: &Pose) -> Twist {
    Twist::new(to.translation - from.translation, from.rotation_vector_to(to))
}

/// A contact of the body at one pose of its centre of mass, as its plane holds the body at another: the point moves with
/// the body, the plane stays. With p' the point there, δ' = δ + (p' − p) · n.
pub(crate) fn carried(contact: &Contact, from: &Pose, to: &Pose) -> Contact {
    if from == to {
        return *contact;
    }
    let arm = from.rotation.conjugate() * (contact.point - from.translation);
    let point = to.transform_point(arm);
    Contact { point, depth: contact.depth + (point - contact.point).dot(contact.normal), ..*contact }
}
