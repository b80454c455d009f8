use glam::{DMat3, DQuat};
use palpate_core::{Contact, Wrench};
use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

use super::*;
use crate::algebra::rotation::skew;
use crate::differences::{derivative, largest, random_pose, random_twist, random_vector};
use crate::penalty::Friction;
use crate::penalty::{ContactParameters, MAX_CLUSTERS};

/// An inertia like that of a solid of uneven shape, turned to arbitrary axes.
fn random_inertia(rng: &mut StdRng, size: f64) -> DMat3 {
    let r = DMat3::from_quat(random_pose(rng, 1.0).rotation);
    let squares = DVec3::from_array(std::array::from_fn(|_| rng.random_range(0.1..1.0) * size));
    let moments = DVec3::new(squares.y + squares.z, squares.z + squares.x, squares.x + squares.y);
    r * DMat3::from_diagonal(moments) * r.transpose()
}

#[test]
fn derivative_of_the_carried_momentum_equals_central_differences() {
    let seed = 51;
    let mut rng = StdRng::seed_from_u64(seed);
    for case in 0..300 {
        let inertia = random_inertia(&mut rng, 1e-4);
        let angular = random_vector(&mut rng, [0.1, 10.0, 300.0, 3000.0][case % 4]);
        let dt = 1e-3;
        let (gained, found) = carried_momentum(&inertia, angular, dt);
        let carried = DQuat::from_scaled_axis(angular * dt) * (inertia * angular);
        assert!((inertia * angular + gained - carried).length() < 1e-14 * carried.length() * 10.0);
        let columns = DVec3::AXES.map(|e| {
            let momentum = |s: f64| {
                let w = angular + e * s;
                Wrench::new(DQuat::from_scaled_axis(w * dt) * (inertia * w), DVec3::ZERO)
            };
            derivative(momentum, 1e-3 * (1.0 + angular.length())).force
        });
        let expected = DMat3::from_cols(columns[0], columns[1], columns[2]);
        let error = largest(&(found - expected)) / largest(&expected);
        assert!(error < 1e-6, "seed {seed}, case {case}: relative error {error}");
    }
}

#[test]
fn carried_momentum_is_the_gyroscopic_torque_to_first_order() {
    let mut rng = StdRng::seed_from_u64(52);
    let inertia = random_inertia(&mut rng, 1e-4);
    let angular = DVec3::new(3.0, -7.0, 2.0);
    let gyroscopic = angular.cross(inertia * angular);
    let by_spin = skew(angular) * inertia - skew(inertia * angular);
    let mut previous = f64::INFINITY;
    for dt in [1e-3, 1e-4, 1e-5] {
        let (gained, derivative) = carried_momentum(&inertia, angular, dt);
        let error = (gained / dt - gyroscopic).length() / gyroscopic.length();
        assert!(error < 10.0 * dt && error < previous / 5.0);
        let error = largest(&((derivative - inertia) * (1.0 / dt) - by_spin)) / largest(&by_spin);
        assert!(error < 20.0 * dt);
        previous = error;
    }
}

/// The same system assembled entry by entry from the full public Jacobians.
#[test]
fn system_equals_the_one_from_the_public_jacobians() {
    let seed = 53;
    let mut rng = StdRng::seed_from_u64(seed);
    let mut with_contact = 0;
    for case in 0..500 {
        let body = Body::new(rng.random_range(0.01..0.5), random_inertia(&mut rng, 1e-4)).unwrap();
        let mut coupling = VirtualCoupling::critically_damped(&body, random_pose(&mut rng, 0.05), 300.0, 0.5);
        // Linear, and in the bend before the limit.
        (coupling.max_force, coupling.max_torque) = [(f64::INFINITY, f64::INFINITY), (1.5, 0.1)][case % 2];
        let state = BodyState { pose: random_pose(&mut rng, 0.5), twist: random_twist(&mut rng, 0.2, 2.0) };
        let grasp = state.pose * coupling.grasp;
        let device = DeviceMotion {
            pose: grasp.moved(&random_twist(&mut rng, 0.01, 0.4), 1.0),
            twist: random_twist(&mut rng, 0.1, 1.0),
        };
        let contacts: Vec<_> = (0..4)
            .map(|_| Contact {
                point: state.pose.translation + random_vector(&mut rng, 0.05),
                scene_point: DVec3::ZERO,
                normal: random_vector(&mut rng, 1.0).normalize(),
                depth: 0.003,
            })
            .collect();
        let parameters =
            ContactParameters { stiffness: 500.0, damping: 0.5, tolerance: 0.001, friction: Friction::NONE };
        let model = LinearContactModel::from_contacts(contacts, &state.pose, &parameters, 0.0);
        let gravity = DVec3::NEG_Z * 9.81;
        let dt = 1e-3;
        let step = semi_implicit_step(&body, &state, &device, &coupling, &model, gravity, dt);
        let now = model.evaluate(&state);
        if step.active != now.active || step.status.geometric_stiffness_dropped {
            continue;
        }
        with_contact += 1;

        let held = coupling.evaluate(&state, &device);
        let mut jacobian = held.jacobian;
        jacobian += now.jacobian;
        let rotation = DMat3::from_quat(state.pose.rotation);
        let inertia = rotation * body.inertia * rotation.transpose();
        let (gained, by_spin) = carried_momentum(&inertia, state.twist.angular, dt);
        let force = held.on_body + now.wrench + Wrench::new(gravity * body.mass, DVec3::ZERO);
        // The system's residual at the velocity that the step found, by the formula of the module doc.
        let change = Twist::new(
            step.state.twist.linear - state.twist.linear,
            step.state.twist.angular - state.twist.angular,
        );
        let total = force + jacobian.pose.apply(&step.state.twist) * dt + jacobian.twist.apply(&change);
        let linear = change.linear * body.mass - total.force * dt;
        let angular = by_spin * change.angular + gained - total.torque * dt;
        assert!(
            linear.length() < 1e-12 * (1.0 + force.force.length() * dt),
            "seed {seed}, case {case}: {linear}"
        );
        assert!(angular.length() < 1e-12 * (1.0 + force.torque.length() * dt), "seed {seed}, case {case}");
    }
    assert!(with_contact > 100, "only {with_contact} cases kept their contacts");
}

#[test]
#[expect(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]
fn active_set_never_attracts_and_always_ends() {
    let seed = 54;
    let mut rng = StdRng::seed_from_u64(seed);
    let (mut most, mut unsettled, mut dropped) = (0, 0, 0);
    let cases = 20_000;
    for case in 0..cases {
        let body = Body::new(rng.random_range(0.001..0.2), random_inertia(&mut rng, 1e-5)).unwrap();
        let coupling = VirtualCoupling::critically_damped(&body, random_pose(&mut rng, 0.1), 200.0, 0.6);
        let state = BodyState { pose: random_pose(&mut rng, 0.5), twist: random_twist(&mut rng, 1.0, 30.0) };
        let device = DeviceMotion::at_rest(
            (state.pose * coupling.grasp).moved(&random_twist(&mut rng, 0.03, 1.0), 1.0),
        );
        let contacts: Vec<_> = (0..rng.random_range(1..=MAX_CLUSTERS))
            .map(|_| Contact {
                point: state.pose.translation + random_vector(&mut rng, 0.1),
                scene_point: DVec3::ZERO,
                normal: random_vector(&mut rng, 1.0).normalize(),
                depth: rng.random_range(-0.003..0.003),
            })
            .collect();
        let parameters = ContactParameters {
            stiffness: rng.random_range(100.0..20_000.0),
            damping: rng.random_range(0.0..30.0),
            tolerance: 0.001,
            friction: Friction::coulomb([0.0, 0.4, 2.0][case % 3]),
        };
        let model = LinearContactModel::from_contacts(contacts, &state.pose, &parameters, 0.0);
        let frame = Frame {
            body: &body,
            device: &device,
            coupling: &coupling,
            contacts: &model,
            gravity: DVec3::ZERO,
        };
        let mut candidates = ArrayVec::new();
        let mut system = System::new(&frame, &state, 1e-3, &mut candidates);
        let Solution { change, active, status, .. } = system.solve().expect("regular");
        let (pushing, _) = system.predict(&change);
        assert_eq!(active & !pushing, 0, "seed {seed}, case {case}: an active contact attracts");
        most = most.max(status.solves);
        unsettled += usize::from(status.active_set_unsettled);
        dropped += usize::from(status.geometric_stiffness_dropped);
    }
    println!(
        "most solves {most}, unsettled {unsettled} and geometric stiffness dropped {dropped} of {cases}"
    );
    assert!(most <= MAX_SOLVES);
    // The bound is for the record: random heaps of stiff contacts are harsher than any that a query
    // reports.
    assert!(unsettled * 50 < cases, "{unsettled} of {cases} active sets did not settle");
}
