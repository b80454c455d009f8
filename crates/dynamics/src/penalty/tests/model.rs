use std::num::NonZeroU32;

use glam::{DMat3, DVec3};
use palpate_core::{Contact, Pose, Twist, Wrench};
use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

use crate::body::{Body, BodyState};
use crate::coupling::{DeviceMotion, VirtualCoupling};
use crate::differences::{
    random_direction, random_pose, random_twist, random_vector, relative_error, wrench_jacobian,
};
use crate::integrators::{Integrator as _, IntegratorKind};
use crate::jacobian::WrenchJacobian;
use crate::penalty::{
    ContactClass, ContactParameters, ContactPatch, Friction, LinearContactModel, MovingBody, PenaltyContact,
};
use crate::step::Frame;

fn random_contact(rng: &mut StdRng, at: &Pose) -> Contact {
    let point = at.translation + random_vector(rng, 0.1);
    let normal = random_direction(rng);
    let depth = rng.random_range(-0.004..0.004);
    Contact { point, scene_point: point - normal * depth, normal, depth }
}

fn random_parameters(rng: &mut StdRng) -> ContactParameters {
    ContactParameters {
        stiffness: rng.random_range(100.0..1e4),
        damping: rng.random_range(0.0..20.0),
        tolerance: rng.random_range(0.0..0.005),
        friction: Friction::NONE,
    }
}

#[test]
fn jacobian_equals_central_differences_away_from_the_clamp() {
    let seed = 41;
    let mut rng = StdRng::seed_from_u64(seed);
    let mut checked = 0;
    for case in 0..2000 {
        let found_at = random_pose(&mut rng, 0.5);
        let parameters = random_parameters(&mut rng);
        let contacts: Vec<_> =
            (0..rng.random_range(1..6)).map(|_| random_contact(&mut rng, &found_at)).collect();
        let mut model = LinearContactModel::from_contacts(contacts, &found_at, &parameters, 0.0);
        let braking_time = [0.0, 0.01][case % 2];
        model.contacts_mut().iter_mut().for_each(|c| c.braking_time = braking_time);
        // The body has moved and turned since the contacts were found.
        let pose = found_at.moved(&random_twist(&mut rng, 0.002, 0.5), 1.0);
        let state = BodyState { pose, twist: random_twist(&mut rng, 0.1, 2.0) };
        // Differences reach 6e-4 rad, 6e-4 m and 0.2 m/s: keep all contacts on one side of the clamp.
        let rotation = DMat3::from_quat(pose.rotation);
        let margin = 0.003 * (parameters.stiffness + 40.0 * parameters.damping) + 1.0 * parameters.damping;
        let clear = model.contacts().iter().all(|c| {
            let at = c.at(&state, &rotation);
            let Some(stiffness) = c.stiffness_at(at.overlap) else { return at.overlap < -0.003 };
            let force = stiffness * at.overlap + c.damping * at.rate;
            at.overlap.abs() > 0.003 && force.abs() > margin + 0.3 * stiffness * 0.003
        });
        if !clear {
            continue;
        }
        let response = model.evaluate(&state);
        assert!((response.wrench - model.wrench(&state)).force.length() < 1e-9);
        if response.active == 0 {
            continue;
        }
        checked += 1;
        let expected = wrench_jacobian(|s| model.wrench(s), &state);
        let error = relative_error(&response.jacobian, &expected);
        assert!(error < 1e-6, "seed {seed}, case {case}: relative error {error}");
    }
    assert!(checked > 200, "only {checked} cases were away from the clamp");
}

#[test]
fn force_at_the_pose_of_the_query_is_stiffness_times_depth_and_tolerance() {
    let seed = 42;
    let mut rng = StdRng::seed_from_u64(seed);
    for case in 0..1000 {
        let pose = random_pose(&mut rng, 0.5);
        let parameters = random_parameters(&mut rng);
        let mut contact = random_contact(&mut rng, &pose);
        // Even where the two points do not lie along the normal, as for a cluster's representative.
        contact.scene_point += random_vector(&mut rng, 0.001);
        let model = LinearContactModel::from_contacts([contact], &pose, &parameters, 0.0);
        let wrench = model.wrench(&BodyState::at_rest(pose));
        let size = (parameters.stiffness * (contact.depth + parameters.tolerance)).max(0.0);
        let expected = Wrench::from_force_at(contact.normal * -size, contact.point - pose.translation);
        assert!((wrench.force - expected.force).length() < 1e-11, "seed {seed}, case {case}");
        assert!((wrench.torque - expected.torque).length() < 1e-11, "seed {seed}, case {case}");
    }
}

#[test]
fn no_contact_attracts_in_any_state() {
    let seed = 43;
    let mut rng = StdRng::seed_from_u64(seed);
    let (mut pushed, mut clamped) = (0, 0);
    for case in 0..20_000 {
        let pose = random_pose(&mut rng, 0.5);
        let parameters = random_parameters(&mut rng);
        let contact = random_contact(&mut rng, &pose);
        let mut model = LinearContactModel::from_contacts([contact], &pose, &parameters, 0.0);
        model.contacts_mut()[0].braking_time = [0.0, 0.01][case % 2];
        let state = BodyState {
            pose: pose.moved(&random_twist(&mut rng, 0.01, 0.3), 1.0),
            twist: random_twist(&mut rng, 1.0, 20.0),
        };
        let along = model.wrench(&state).force.dot(contact.normal);
        assert!(along <= 0.0, "seed {seed}, case {case}: attracts with {along} N");
        let at = model.contacts()[0].at(&state, &DMat3::from_quat(state.pose.rotation));
        if at.overlap <= 0.0 && case % 2 == 0 {
            assert_eq!(along, 0.0, "seed {seed}, case {case}: open contact pushes");
        } else if along == 0.0 {
            clamped += 1;
            assert_eq!(model.evaluate(&state).jacobian, WrenchJacobian::ZERO);
        }
        pushed += usize::from(along < 0.0);
    }
    assert!(pushed > 5000 && clamped > 500, "{pushed} pushed, {clamped} clamped");
}

#[test]
fn contacts_that_are_not_finite_are_refused() {
    let parameters =
        ContactParameters { stiffness: 1.0, damping: 0.0, tolerance: 0.0, friction: Friction::NONE };
    let good = Contact { point: DVec3::X, scene_point: DVec3::X, normal: DVec3::Z, depth: 0.5 };
    let bad = [
        Contact { point: DVec3::NAN, ..good },
        Contact { normal: DVec3::ZERO, ..good },
        Contact { normal: DVec3::NAN, ..good },
        Contact { depth: f64::INFINITY, ..good },
    ];
    let model =
        LinearContactModel::from_contacts(bad.into_iter().chain([good]), &Pose::IDENTITY, &parameters, 0.0);
    assert_eq!((model.contacts().len(), model.refused()), (1, 4));
}

#[test]
fn displacement_is_the_furthest_motion_of_a_contact_point() {
    let parameters =
        ContactParameters { stiffness: 1.0, damping: 0.0, tolerance: 0.0, friction: Friction::NONE };
    let contact = |x| Contact { point: DVec3::X * x, scene_point: DVec3::ZERO, normal: DVec3::Z, depth: 0.0 };
    let model =
        LinearContactModel::from_contacts([contact(0.1), contact(-0.3)], &Pose::IDENTITY, &parameters, 0.0);
    assert_eq!(model.displacement(&Pose::IDENTITY), 0.0);
    let turned = Pose::new(DVec3::ZERO, glam::DQuat::from_rotation_z(std::f64::consts::PI));
    assert!((model.displacement(&turned) - 0.6).abs() < 1e-15);
}

fn random_moving(rng: &mut StdRng, pose: &Pose, friction: f64, object: &MovingBody) -> LinearContactModel {
    let contacts: Vec<_> = (0..rng.random_range(1..5))
        .map(|_| ContactPatch {
            contact: random_contact(rng, pose),
            radius: if rng.random_bool(0.5) { 0.01 } else { 0.0 },
        })
        .collect();
    let parameters = ContactParameters { friction: Friction::coulomb(friction), ..random_parameters(rng) };
    let mut model = LinearContactModel::empty(pose, 0.0);
    contacts.iter().for_each(|contact| model.push(ContactClass::Touching, *contact, &parameters, object));
    model
}

/// A body in contact behaves the same in a frame that moves with a constant velocity.
#[test]
fn contact_is_the_same_in_a_moving_frame() {
    let seed = 45;
    let mut rng = StdRng::seed_from_u64(seed);
    let body = Body::new(0.1, DMat3::from_diagonal(DVec3::new(1e-4, 2e-4, 1.5e-4))).unwrap();
    let coupling = VirtualCoupling {
        linear_stiffness: 0.0,
        linear_damping: 0.0,
        angular_stiffness: 0.0,
        angular_damping: 0.0,
        ..VirtualCoupling::critically_damped(&body, Pose::IDENTITY, 1.0, 1.0)
    };
    let dt = 1e-3;
    let mut pushed = 0;
    for case in 0..500 {
        let pose = random_pose(&mut rng, 0.1);
        let still = random_moving(
            &mut rng,
            &pose,
            [0.0, 0.5][case % 2],
            &MovingBody { twist: Twist::ZERO, object: None },
        );
        let velocity = random_vector(&mut rng, 0.5);
        let object = MovingBody { twist: Twist::new(velocity, DVec3::ZERO), object: None };
        let mut moving = LinearContactModel::empty(&pose, 0.0);
        for contact in still.contacts() {
            let surface = object.surface_at(contact.scene_point);
            moving.push_contact(PenaltyContact { surface, ..*contact });
        }
        moving.advance(dt);
        let state = BodyState { pose, twist: random_twist(&mut rng, 0.2, 1.0) };
        let carried =
            BodyState { twist: Twist::new(state.twist.linear + velocity, state.twist.angular), ..state };
        let step = |contacts: &LinearContactModel, state: &BodyState, kind: IntegratorKind| {
            let device = DeviceMotion::at_rest(pose);
            let frame =
                Frame { body: &body, device: &device, coupling: &coupling, contacts, gravity: DVec3::ZERO };
            kind.step(&frame, state, dt)
        };
        for kind in [IntegratorKind::SemiImplicit, IntegratorKind::FullyImplicit] {
            let (at_rest, moved) = (step(&still, &state, kind), step(&moving, &carried, kind));
            let gained = moved.state.twist.linear - at_rest.state.twist.linear - velocity;
            let went = moved.state.pose.translation - at_rest.state.pose.translation - velocity * dt;
            let off = [1e-12, 1e-9][case % 2];
            assert!(gained.length() < off, "seed {seed}, case {case}, {kind:?}: {gained} m/s");
            assert!(went.length() < off * dt, "seed {seed}, case {case}, {kind:?}: {went} m");
            assert!((moved.contact - at_rest.contact).force.length() < 1e4 * off, "seed {seed}, case {case}");
            pushed += usize::from(at_rest.contact != Wrench::ZERO);
        }
    }
    assert!(pushed > 300, "{pushed} pushed");
}

#[test]
fn a_turning_surface_drags_a_patch_along() {
    let pose = Pose::IDENTITY;
    let parameters = ContactParameters {
        stiffness: 1000.0,
        damping: 1.0,
        tolerance: 0.0,
        friction: Friction::coulomb(0.5),
    };
    let contact =
        Contact { point: DVec3::ZERO, scene_point: DVec3::NEG_Z * 0.01, normal: DVec3::Z, depth: 0.01 };
    let mut model = LinearContactModel::empty(&pose, 0.0);
    let twist = Twist::new(DVec3::ZERO, DVec3::Z * 2.0);
    let patch = ContactPatch { contact, radius: 0.01 };
    model.push(ContactClass::Touching, patch, &parameters, &MovingBody { twist, object: None });
    let at_rest = BodyState::at_rest(pose);
    let by_damper = model.wrench(&at_rest).torque.z;
    assert!((by_damper - 1.0 * 0.01 * 0.01 * 2.0).abs() < 1e-9, "{by_damper}");
    model.advance(0.005);
    let turned = model.wrench(&at_rest).torque.z - by_damper;
    let expected = 1000.0 * 0.01 * 0.01 * 2.0 * (0.005 * 2.0_f64 / 2.0).sin();
    assert!((turned - expected).abs() < 1e-9, "{turned} {expected}");
    // It stops after the largest time.
    (0..100).for_each(|_| model.advance(0.005));
    let end = model.wrench(&at_rest).torque.z;
    model.advance(0.005);
    assert_eq!(model.wrench(&at_rest).torque.z, end);
    let most = 1000.0 * 0.01 * 0.01 * 2.0 * (LinearContactModel::MAX_SURFACE_MOTION * 2.0 / 2.0).sin();
    assert!((end - most).abs() < 1e-9, "{end} {most}");
}

#[test]
fn reactions_are_the_reverse_of_the_wrench() {
    let seed = 46;
    let mut rng = StdRng::seed_from_u64(seed);
    let mut pushed = 0;
    for case in 0..500 {
        let pose = random_pose(&mut rng, 0.5);
        let mut model = LinearContactModel::empty(&pose, 0.0);
        for object in 1..4 {
            let twist = random_twist(&mut rng, 0.2, 1.0);
            let object = MovingBody { twist, object: NonZeroU32::new(object) };
            for contact in random_moving(&mut rng, &pose, 0.5, &object).contacts() {
                model.push_contact(*contact);
            }
        }
        let state = BodyState { pose, twist: random_twist(&mut rng, 0.2, 1.0) };
        let sum = model.reactions(&state).fold(Wrench::ZERO, |sum, (_, wrench)| sum + wrench);
        let on_body = model.wrench(&state).about(-pose.translation);
        let left = sum + on_body;
        assert!(left.force.length() < 1e-9 && left.torque.length() < 1e-9, "seed {seed}, case {case}");
        pushed += model.reactions(&state).count();
    }
    assert!(pushed > 500, "{pushed} pushed");
    assert_eq!(
        LinearContactModel::empty(&Pose::IDENTITY, 0.0)
            .reactions(&BodyState::at_rest(Pose::IDENTITY))
            .count(),
        0
    );
}
