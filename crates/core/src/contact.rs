//! Contacts, as a contact query reports them.

use glam::DVec3;
use serde::{Deserialize, Serialize};

/// A contact between the grasped object and an object in the scene (§5.4.1), in world axes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Contact {
    /// **p**: the point on the surface of the grasped object, m.
    pub point: DVec3,
    /// **p₀**: the point on the surface of the scene object, m.
    pub scene_point: DVec3,
    /// **n**: unit normal that points out of the grasped object.
    pub normal: DVec3,
    /// δ: penetration depth, m. Positive when **p** lies inside the scene object; negative, and then minus
    /// the separation distance, when it lies outside but closer than the query's tolerance.
    pub depth: f64,
}

impl Contact {
    /// Separation distance, m: 0 when the surfaces touch or penetrate.
    pub fn distance(&self) -> f64 {
        (-self.depth).max(0.0)
    }

    /// The contact with probe and scene exchanged.
    pub fn swapped(&self) -> Self {
        Self { point: self.scene_point, scene_point: self.point, normal: -self.normal, depth: self.depth }
    }
}
