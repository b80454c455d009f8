//! The proxy: a copy of the grasped object that does not pass through surfaces (§5.6.1).
//!
//! Penalty forces depend on the object's present pose only. Once it is deeper in a thin wall than half the
//! wall's thickness, or has crossed the wall between two contact queries, the shortest direction out is the
//! wrong one. The proxy moves from its last pose towards the object, in steps that go no further than the
//! known contacts allow, and stops before it penetrates more than a small allowed depth. From there it slides
//! along the surfaces: a [god-object](follow). The contacts are those of the proxy, and their planes push the
//! object back to it. Contacts that jump between the same two patches [persist](manifold).
//!
//! The contacts with a moving scene object move along with it, and the proxy is pushed clear of the object
//! before it follows the grasped one. If it cannot, because two objects close on it or an object was put over
//! it, it restarts at the grasped object.
//!
//! The coarse meshes of textured objects may sink into one another by their recess.
//!
//! As long as the object itself penetrates no more than the allowed depth, and passed nothing on its path,
//! the proxy coincides with it, with one query a step.

pub(crate) mod contact;
pub(crate) mod finder;
mod follow;
mod manifold;

use palpate_core::Pose;
use palpate_core::glam::DVec3;
use palpate_dynamics::{Body, MotionLimit};

pub(crate) use self::contact::{ProxyContact, carried, motion_between};
pub(crate) use self::finder::{ContactFinder, LevelFinder, QueryReport};
use self::manifold::Manifold;

/// Number of contacts that there is room for from the start.
const RESERVED: usize = 512;

/// State of the proxy: whether it is known to be on the side of all surfaces that it came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Side {
    /// There is no proxy: it always coincides with the object.
    Disabled,
    /// The proxy penetrates too deep, and restarts at the object.
    Unknown,
    /// The proxy penetrates no more than the allowed depth.
    Kept,
    /// The scene has changed since the side was kept: the proxy has to be pushed clear first.
    Disturbed,
}

/// The proxy with its contacts.
#[derive(Clone, Debug)]
pub(crate) struct Proxy {
    body: Body,
    /// Centre of mass in the mesh's frame, m.
    center_of_mass: DVec3,
    /// Bounding radius about the centre of mass, m.
    radius: f64,
    /// d, m.
    tolerance: f64,
    /// Depth that the coarse mesh may sink into each scene object, m; 0 for those beyond the list.
    recesses: Vec<f64>,
    side: Side,
    /// Pose of the centre of mass.
    pose: Pose,
    /// Bound on the distance of any point of the object from the same point of the proxy after the last
    /// step, m.
    lag: f64,
    /// All contacts at the pose, within the reach (m), sorted by pairs of patches.
    found: Vec<ProxyContact>,
    reach: f64,
    /// Contacts at the pose before.
    before: Vec<ProxyContact>,
    /// Persistent contacts, carried to the present pose.
    manifold: Manifold,
    limits: Vec<MotionLimit>,
    multipliers: Vec<f64>,
}

impl Proxy {
    pub fn new(
        body: Body,
        center_of_mass: DVec3,
        radius: f64,
        tolerance: f64,
        recesses: Vec<f64>,
        enabled: bool,
    ) -> Self {
        Self {
            body,
            center_of_mass,
            radius,
            tolerance,
            recesses,
            side: if enabled { Side::Unknown } else { Side::Disabled },
            pose: Pose::IDENTITY,
            lag: 0.0,
            found: Vec::with_capacity(RESERVED),
            before: Vec::with_capacity(RESERVED),
            reach: 0.0,
            manifold: Manifold::new(tolerance),
            limits: Vec::with_capacity(RESERVED),
            multipliers: Vec::with_capacity(RESERVED),
        }
    }

    /// Pose of the proxy's centre of mass.
    pub fn pose(&self) -> &Pose {
        &self.pose
    }

    /// Bound on the distance of any point of the object from the same point of the proxy after the last step,
    /// m.
    pub fn lag(&self) -> f64 {
        self.lag
    }

    /// Contacts at the proxy within the last reach, and the persistent ones.
    pub fn contacts(&self) -> impl Iterator<Item = &ProxyContact> {
        self.found.iter().chain(self.manifold.contacts())
    }

    /// Contacts at the proxy without the persistent ones.
    pub fn found(&self) -> &[ProxyContact] {
        &self.found
    }

    /// Depth that the coarse mesh may sink into a scene object, m.
    fn recess(&self, object: usize) -> f64 {
        self.recesses.get(object).copied().unwrap_or(0.0)
    }

    /// Sets the depth that the coarse mesh may sink into each scene object, m.
    pub fn set_recesses(&mut self, recesses: Vec<f64>) {
        self.recesses = recesses;
    }

    /// Discards the contacts: the scene has changed.
    pub fn scene_has_changed(&mut self) {
        self.disturb();
        self.found.clear();
        self.manifold.clear();
    }

    /// Moves the contacts with a scene object along as it moves from one pose to another, so that they stay
    /// on its surface.
    pub fn object_has_moved(&mut self, object: usize, from: &Pose, to: &Pose) {
        self.disturb();
        let motion = *to * from.inverse();
        let contacts = self.found.iter_mut().chain(self.manifold.contacts_mut());
        contacts.filter(|found| found.object == object).for_each(|found| found.move_with_object(&motion));
    }

    fn disturb(&mut self) {
        if self.side == Side::Kept {
            self.side = Side::Disturbed;
        }
    }
}

#[cfg(test)]
mod tests;
