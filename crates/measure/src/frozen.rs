//! A contact model whose force does not change, to compare the linear model with.

use palpate::dynamics::{BodyState, LinearContactModel, PlaneConstraint, SurfaceMotion};
use palpate::glam::DMat3;

/// k of the springs, N/m: so soft that no motion changes their force. A stiffer one lets the force depend on
/// the motion.
const SOFT: f64 = 1e-6;

/// The force of a contact model on a body in a state, whatever the body does afterwards: what a contact
/// thread hands over that gives no Jacobian (§5.1.2). Friction, curvature terms and braking are left out.
///
/// It consists of very soft springs, compressed so far that no motion changes their force.
#[must_use]
pub fn frozen(model: &LinearContactModel, state: &BodyState) -> LinearContactModel {
    let mut frozen = LinearContactModel::empty(&state.pose, model.time());
    let rotation = DMat3::from_quat(state.pose.rotation);
    for constraint in model.constraints() {
        let arm = rotation * constraint.point;
        let scene_point = state.pose.translation + arm;
        let depth = (scene_point - constraint.scene_point).dot(constraint.normal);
        let rate = (state.twist.velocity_at(arm) - constraint.surface.velocity).dot(constraint.normal);
        let overlap = depth + constraint.tolerance;
        let force = constraint.stiffness * overlap + constraint.damping * rate;
        if overlap > 0.0 && force > 0.0 {
            frozen.push_constraint(PlaneConstraint {
                stiffness: SOFT,
                damping: 0.0,
                tolerance: force / SOFT,
                scene_point,
                surface: SurfaceMotion { object: constraint.surface.object, ..SurfaceMotion::STILL },
                ..*constraint
            });
        }
    }
    frozen
}
