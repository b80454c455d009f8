//! Response of rapier's bodies to contact forces.

use palpate::DynamicBody;
use palpate::glam::{DMat3, DQuat, DVec3};
use rapier3d::dynamics::{MassProperties, RigidBody};

use crate::convert::{rotation, vector};

/// Returns the dynamics of a dynamic body in a world that is stepped every `period` (s), with a gravity
/// (m/s²); `None` if it has no mass. Locked axes count as free, which makes contacts softer than necessary.
/// An axis about which the body cannot turn gets the largest of its other moments, or that of a ring of a
/// radius (m) if it has none. Moments that no body can have, as by rounding, are reduced to valid ones.
pub fn dynamic_body(body: &RigidBody, radius: f64, (period, gravity): (f64, DVec3)) -> Option<DynamicBody> {
    let properties = &body.mass_properties().local_mprops;
    let &MassProperties { local_com, inv_mass, inv_principal_inertia, principal_inertia_local_frame } =
        properties;
    if inv_mass.is_nan() || inv_mass <= 0.0 {
        return None;
    }
    let mass = 1.0 / f64::from(inv_mass);
    let inverse = vector(inv_principal_inertia);
    let moments =
        inverse.to_array().into_iter().filter(|inverse| *inverse > 0.0).map(|inverse| 1.0 / inverse);
    let most = moments.reduce(f64::max).unwrap_or(mass * radius * radius);
    let moment = |inverse: f64| if inverse > 0.0 { 1.0 / inverse } else { most };
    let principal = DVec3::new(moment(inverse.x), moment(inverse.y), moment(inverse.z));
    // No principal moment is larger than the sum of the others.
    let principal = principal.min(DVec3::splat(principal.element_sum()) - principal);
    let inertia = turned(principal, rotation(principal_inertia_local_frame));
    let gravity = gravity * f64::from(body.gravity_scale());
    Some(DynamicBody { mass, inertia, center_of_mass: vector(local_com), gravity, period })
}

/// Returns a tensor with given principal moments and axes; exactly symmetric.
fn turned(principal: DVec3, axes: DQuat) -> DMat3 {
    let axes = DMat3::from_quat(axes);
    let tensor = axes * DMat3::from_diagonal(principal) * axes.transpose();
    (tensor + tensor.transpose()) * 0.5
}

#[cfg(test)]
mod tests {
    use rapier3d::prelude::*;

    use super::*;
    use crate::convert::to_vector;

    fn body(properties: MassProperties) -> RigidBody {
        let mut world = PhysicsWorld::default();
        let builder = RigidBodyBuilder::dynamic().additional_mass_properties(properties);
        let handle = world.insert_body(builder);
        world.bodies[handle].recompute_mass_properties_from_colliders(&world.colliders);
        world.bodies[handle].clone()
    }

    #[test]
    fn a_tensor_with_products_of_inertia_is_preserved() {
        let axes = DQuat::from_scaled_axis(DVec3::new(0.3, -0.7, 1.1));
        let wanted = turned(DVec3::new(1e-3, 2e-3, 2.5e-3), axes);
        let columns = wanted.to_cols_array().map(|x| x as f32);
        let center = DVec3::new(0.01, -0.02, 0.03);
        let properties =
            MassProperties::with_inertia_matrix(to_vector(center), 0.5, Matrix::from_cols_array(&columns));
        let found = dynamic_body(&body(properties), 0.1, (1e-3, DVec3::ZERO)).expect("a mass");
        assert!((found.mass - 0.5).abs() < 1e-7);
        assert!((found.center_of_mass - center).length() < 1e-8);
        let off =
            (found.inertia - wanted).to_cols_array().into_iter().fold(0.0, |most: f64, x| most.max(x.abs()));
        assert!(off < 1e-5 * 2.5e-3, "{off} kg·m²");
        let one = DVec3::new(0.2, 0.4, -0.9);
        assert!((found.inertia * one - wanted * one).length() < 1e-5 * (wanted * one).length());
    }

    #[test]
    fn a_body_that_cannot_turn_has_moments() {
        let point = MassProperties::new(Vector::ZERO, 2.0, Vector::ZERO);
        let found = dynamic_body(&body(point), 0.1, (1e-3, DVec3::ZERO)).expect("a mass");
        assert_eq!(found.inertia, DMat3::from_diagonal(DVec3::splat(2.0 * 0.1 * 0.1)));
        let hinge = MassProperties::new(Vector::ZERO, 2.0, Vector::new(0.5, 0.0, 0.0));
        let found = dynamic_body(&body(hinge), 0.1, (1e-3, DVec3::ZERO)).expect("a mass");
        assert_eq!(found.inertia, DMat3::from_diagonal(DVec3::splat(0.5)));
        let none_has = MassProperties::new(Vector::ZERO, 2.0, Vector::new(0.5, 0.25, 2.0));
        let found = dynamic_body(&body(none_has), 0.1, (1e-3, DVec3::ZERO)).expect("a mass");
        assert_eq!(found.inertia, DMat3::from_diagonal(DVec3::new(0.5, 0.25, 0.75)));
        let nothing = MassProperties::new(Vector::ZERO, 0.0, Vector::ZERO);
        assert_eq!(dynamic_body(&body(nothing), 0.1, (1e-3, DVec3::ZERO)), None);
    }
}
