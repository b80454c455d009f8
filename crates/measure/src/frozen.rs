//! A contact model with constant force, for comparison with the linear model.

use palpate::dynamics::{BodyState, LinearContactModel, PenaltyContact, SurfaceMotion};
use palpate::glam::DMat3;

/// Stiffness of the springs, N/m. It is so small that no motion changes their force; with a stiffer spring
/// the force would depend on the motion.
const SPRING_STIFFNESS: f64 = 1e-6;

/// Returns a model with the force of a contact model on a body in a state, whatever the body does afterwards.
/// A contact thread that provides no Jacobian (§5.1.2) hands over such a model. Friction, curvature terms and
/// braking are left out.
///
/// It consists of very soft springs, compressed so far that no motion changes their force.
#[must_use]
pub fn frozen(model: &LinearContactModel, state: &BodyState) -> LinearContactModel {
    let mut frozen = LinearContactModel::empty(&state.pose, model.time());
    let rotation = DMat3::from_quat(state.pose.rotation);
    for contact in model.contacts() {
        let arm = rotation * contact.point;
        let scene_point = state.pose.translation + arm;
        let depth = (scene_point - contact.scene_point).dot(contact.normal);
        let rate = (state.twist.velocity_at(arm) - contact.surface.velocity).dot(contact.normal);
        let overlap = depth + contact.tolerance;
        let force = contact.stiffness * overlap + contact.damping * rate;
        if overlap > 0.0 && force > 0.0 {
            frozen.push_contact(PenaltyContact {
                stiffness: SPRING_STIFFNESS,
                damping: 0.0,
                tolerance: force / SPRING_STIFFNESS,
                scene_point,
                surface: SurfaceMotion { object: contact.surface.object, ..SurfaceMotion::STILL },
                ..*contact
            });
        }
    }
    frozen
}
