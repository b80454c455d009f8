//! The relative placement of two bodies.

use palpate_core::Pose;
use palpate_core::glam::{DMat3, DVec3};

/// Transform from the frame of hull **b** to that of hull **a**: `x ↦ rotation · x + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Rotation matrix from b's axes to a's.
    pub rotation: DMat3,
    /// b's origin in a's frame, m.
    pub translation: DVec3,
}

impl Placement {
    /// Both hulls in the same frame.
    pub const IDENTITY: Self = Self { rotation: DMat3::IDENTITY, translation: DVec3::ZERO };

    /// The placement of b relative to a, from both bodies' poses in a common frame.
    pub fn between(a: &Pose, b: &Pose) -> Self {
        let to_a = a.rotation.conjugate();
        Self {
            rotation: DMat3::from_quat((to_a * b.rotation).normalize()),
            translation: to_a * (b.translation - a.translation),
        }
    }

    /// A point of b, in a's frame.
    pub fn point(&self, point: DVec3) -> DVec3 {
        self.rotation * point + self.translation
    }

    /// A direction in b's axes, in a's axes.
    pub fn direction(&self, direction: DVec3) -> DVec3 {
        self.rotation * direction
    }

    /// A direction in a's axes, in b's axes.
    pub fn direction_to_b(&self, direction: DVec3) -> DVec3 {
        DVec3::new(
            self.rotation.x_axis.dot(direction),
            self.rotation.y_axis.dot(direction),
            self.rotation.z_axis.dot(direction),
        )
    }
}
