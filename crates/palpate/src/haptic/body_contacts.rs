//! The contacts of one body in the haptic loop: the blended contact model, and how far the body has moved since that was found.

use palpate_core::Pose;
use palpate_dynamics::ContactBlend;

use crate::telemetry::record::ModelData;

/// Distance that a body may move from where its contact model was found: in bounding radii, and at least in m at the device. Beyond it
/// the planes are of other places.
const ROAM: (f64, f64) = (0.5, 0.01);

/// The contacts of one body.
#[derive(Clone, Debug)]
pub(super) struct BodyContacts {
    pub blend: ContactBlend,
    /// What the newest contact model was found with.
    pub found: ModelData,
    /// Bounding radius of the body about its centre of mass, m.
    radius: f64,
    /// Distance, m, that the body may move from where its contact model was found before that holds no more.
    roam: f64,
}

impl BodyContacts {
    pub fn new(pose: Pose, radius: f64, scale: f64) -> Self {
        let roam = (ROAM.0 * radius).max(ROAM.1 * scale);
        Self { blend: ContactBlend::new(), found: ModelData::none(pose), radius, roam }
    }

    /// Largest displacement of any point of the body from where its contact model was found, as a part of how far it may roam; 0
    /// without contacts.
    pub fn strayed(&self, pose: &Pose) -> f64 {
        let found = &self.found;
        if found.contacts == 0 {
            return 0.0;
        }
        let turn = 0.5 * found.pose.rotation_vector_to(pose).length();
        let moved = found.pose.translation.distance(pose.translation) + 2.0 * self.radius * turn.sin();
        moved / self.roam
    }
}

#[cfg(test)]
mod tests {
    use palpate_core::glam::{DQuat, DVec3};

    use super::*;

    #[test]
    fn a_body_strays_by_its_shift_and_its_turn() {
        let mut body = BodyContacts::new(Pose::IDENTITY, 0.1, 1.0);
        // Half of the radius is more than a centimetre at the device.
        assert_eq!(body.roam, 0.05);
        let moved = Pose::new(DVec3::X * 0.01, DQuat::from_rotation_z(0.2));
        assert_eq!(body.strayed(&moved), 0.0, "there are no contacts yet");
        body.found.contacts = 3;
        // A point at the radius moves by the chord 2 r sin(θ/2).
        let wanted = (0.01 + 2.0 * 0.1 * 0.1_f64.sin()) / 0.05;
        assert!((body.strayed(&moved) - wanted).abs() < 1e-12, "{}", body.strayed(&moved));
        // Of a small body a centimetre at the device counts, which is ten in a world scaled by ten.
        assert_eq!(BodyContacts::new(Pose::IDENTITY, 0.001, 10.0).roam, 0.1);
    }
}
