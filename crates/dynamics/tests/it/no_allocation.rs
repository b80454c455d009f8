//! A haptic step by any integrator allocates nothing: 100 000 steps under a counting allocator.

use allocation_counter::measure;
use palpate_core::glam::{DMat3, DQuat, DVec3};
use palpate_core::{Contact, Pose};
use palpate_dynamics::{
    Body, BodyState, Constraint, ContactParameters, DeviceMotion, Frame, Friction, Integrator,
    IntegratorKind, LinearContactModel, MAX_CONSTRAINTS, MotionBound, Recovery, VirtualCoupling,
    constrained_step, saturate,
};

#[test]
fn a_hundred_thousand_steps_allocate_nothing() {
    for kind in IntegratorKind::ALL {
        steps_allocate_nothing(kind);
    }
    let counted = measure(|| drop(std::hint::black_box(Vec::<u8>::with_capacity(100))));
    assert_eq!(counted.count_total, 1, "the counter counts");
}

fn steps_allocate_nothing(kind: IntegratorKind) {
    let body = Body::new(0.05, DMat3::from_diagonal(DVec3::new(1e-5, 2e-5, 2.5e-5))).unwrap();
    let coupling =
        VirtualCoupling::critically_damped(&body, Pose::from_translation(DVec3::X * 0.02), 400.0, 0.6);
    let parameters =
        ContactParameters { stiffness: 2000.0, damping: 1.0, tolerance: 0.0005, friction: Friction::NONE };
    let mut state = BodyState::at_rest(Pose::IDENTITY);
    let mut pushes = 0_u64;
    let mut felt = DVec3::ZERO;

    let made = measure(|| {
        for i in 0..100_000 {
            let t = f64::from(i) * 1e-3;
            // Every 40 steps a fresh model of a floor and a wall, as the contact thread would hand it over.
            let contacts = (0..5).map(|c| {
                let angle = f64::from(c) * 1.2;
                let normal = DVec3::new(0.2 * angle.cos(), 0.2 * angle.sin(), -1.0).normalize();
                let point =
                    state.pose.transform_point(DVec3::new(0.02 * angle.cos(), 0.02 * angle.sin(), -0.01));
                Contact { point, scene_point: point, normal, depth: -0.01 - point.z }
            });
            let model = LinearContactModel::from_contacts(contacts, &state.pose, &parameters, t);
            let turn = DQuat::from_rotation_x(0.4 * (2.0 * t).sin());
            let device = DeviceMotion::at_rest(Pose::new(
                DVec3::new(0.0, 0.01 * t.cos(), 0.01 * (5.0 * t).sin()),
                turn,
            ));
            let frame = Frame {
                body: &body,
                device: &device,
                coupling: &coupling,
                contacts: &model,
                gravity: DVec3::NEG_Z * 9.81,
            };
            let step = kind.step(&frame, &state, 1e-3);
            state = step.state;
            pushes += u64::from(step.active != 0);
            felt += saturate(&step.coupling, 3.3, 0.2).force;
        }
    })
    .count_total;

    assert_eq!(made, 0, "{kind}: {made} allocations in 100 000 steps");
    assert!(
        pushes > 10_000 && pushes < 99_000,
        "{kind}: contact in {pushes} steps: the case does not open and close"
    );
    assert!(felt.is_finite());
}

/// Steps of a body that is pressed on a floor and dragged along it, with more contacts than a step
/// solves for.
#[test]
fn steps_with_constraints_allocate_nothing() {
    let body = Body::new(0.05, DMat3::from_diagonal(DVec3::new(1e-5, 2e-5, 2.5e-5))).unwrap();
    let coupling = VirtualCoupling::critically_damped(&body, Pose::IDENTITY, 400.0, 0.6);
    let model = LinearContactModel::empty(&Pose::IDENTITY, 0.0);
    let mut state = BodyState::at_rest(Pose::from_translation(DVec3::Z * 0.01));
    let corner = |i: usize| DQuat::from_rotation_z(i as f64 * 0.03) * DVec3::new(0.02, 0.0, -0.01);
    let contact = |i: usize| Constraint {
        friction: 0.3,
        key: i as u16,
        ..Constraint::new(corner(i), DVec3::NEG_Z, 0.0)
    };
    let mut contacts: [Constraint; 3 * MAX_CONSTRAINTS] = std::array::from_fn(contact);
    let (mut pushes, mut held_back, mut recovery) = (0, 0, Recovery::at_scale(1.0));
    let made = measure(|| {
        for i in 0..20_000 {
            let t = f64::from(i) * 1e-3;
            for contact in &mut contacts {
                contact.arm = state.pose.transform_vector(corner(contact.key.into()));
                contact.gap = (state.pose.translation + contact.arm).z;
            }
            let device = DeviceMotion::at_rest(Pose::from_translation(DVec3::new(
                0.02 * t.cos(),
                0.0,
                0.01 + 0.005 * (3.0 * t).sin(),
            )));
            let frame = Frame {
                body: &body,
                device: &device,
                coupling: &coupling,
                contacts: &model,
                gravity: DVec3::ZERO,
            };
            let bound = MotionBound { from: state.pose, room: 1e-3, step: 3e-5, radius: 0.03 };
            let found = constrained_step(&frame, &state, &mut contacts, &[], &bound, &recovery, 1e-3);
            (state, recovery.speed) = (found.step.state, found.recovery);
            pushes += u32::from(contacts.iter().any(|contact| contact.impulse.z < 0.0));
            held_back += u32::from(found.held_back);
        }
    })
    .count_total;
    assert_eq!(made, 0, "{made} allocations");
    assert!((5_000..15_000).contains(&pushes), "contact in {pushes} steps: the case does not open and close");
    assert!(held_back > 100, "{held_back} steps held back");
}
