use glam::{DMat3, DQuat, DVec3};
use palpate_core::{Pose, Twist};
use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

use crate::body::BodyState;
use crate::differences::{
    derivative, random_direction, random_pose, random_twist, random_vector, relative_error, wrench_jacobian,
};
use crate::penalty::{
    ContactParameters, Friction, FrictionAnchor, LinearContactModel, PenaltyContact, SurfaceMotion,
};

/// A contact that pushes, with random strain and sliding.
fn random_contact(rng: &mut StdRng, state: &BodyState) -> PenaltyContact {
    let point = random_vector(rng, 0.1);
    let at = state.pose.transform_point(point);
    let normal = random_direction(rng);
    let twist = DQuat::from_scaled_axis(random_vector(rng, 0.05));
    PenaltyContact {
        point,
        scene_point: at - normal * rng.random_range(0.004..0.01),
        normal,
        stiffness: rng.random_range(100.0..1e4),
        damping: rng.random_range(0.0..20.0),
        tolerance: rng.random_range(0.0..0.005),
        braking_time: 0.0,
        friction: if rng.random_bool(0.5) {
            Friction::coulomb(rng.random_range(0.1..1.0))
        } else {
            let dynamic_coefficient = rng.random_range(0.1..1.0);
            Friction { static_coefficient: 2.0 * dynamic_coefficient, dynamic_coefficient }
        },
        radius: if rng.random_bool(0.5) { rng.random_range(0.001..0.02) } else { 0.0 },
        anchor: FrictionAnchor {
            point: at - random_vector(rng, 0.01),
            rotation: twist * state.pose.rotation,
        },
        surface: SurfaceMotion::STILL,
    }
}

#[test]
fn jacobian_equals_central_differences_whether_it_sticks_or_slides() {
    let seed = 61;
    let mut rng = StdRng::seed_from_u64(seed);
    let (mut stuck, mut slid) = (0, 0);
    for case in 0..2000 {
        let state = BodyState { pose: random_pose(&mut rng, 0.5), twist: random_twist(&mut rng, 0.3, 3.0) };
        let mut contact = random_contact(&mut rng, &state);
        if case % 2 == 1 {
            let (velocity, angular) = (random_vector(&mut rng, 0.1), random_vector(&mut rng, 1.0));
            contact.surface = SurfaceMotion { velocity, angular, ..SurfaceMotion::STILL };
        }
        let mut model = LinearContactModel::empty(&state.pose, 0.0);
        model.push_contact(contact);
        let at = contact.at(&state, &DMat3::from_quat(state.pose.rotation));
        let friction = contact.friction_force(&state, &at, contact.normal_force(&at));
        // The differences reach 6e-4 m and 0.2 m/s, over which the contact has to stay open or closed, and
        // stuck or not.
        let limit = contact.friction.coefficient(friction.slide.length_squared()) * contact.normal_force(&at);
        let margin = 0.4 * contact.damping + 0.002 * contact.stiffness;
        let clear = contact.normal_force(&at) > 3.0 * margin
            && (friction.trial.length() - limit).abs() > 3.0 * margin
            && friction.slide.length() > 0.1;
        if !clear {
            continue;
        }
        let found = model.evaluate(&state).jacobian;
        let falls = contact.friction.static_coefficient > contact.friction.dynamic_coefficient;
        let error = if falls {
            // Along one motion, in steps so small that the coefficient changes little.
            let (moved, change) = (random_twist(&mut rng, 1.0, 10.0), random_twist(&mut rng, 1.0, 10.0));
            let at = |s: f64| BodyState {
                pose: state.pose.moved(&moved, s),
                twist: Twist::new(
                    state.twist.linear + change.linear * s,
                    state.twist.angular + change.angular * s,
                ),
            };
            let expected = derivative(|s| model.wrench(&at(s)), 1e-5);
            let off = found.pose.apply(&moved) + found.twist.apply(&change) - expected;
            (off.force.length() / expected.force.length()).max(off.torque.length() / expected.torque.length())
        } else {
            relative_error(&found, &wrench_jacobian(|s| model.wrench(s), &state))
        };
        assert!(error < 1e-5, "seed {seed}, case {case}, share {}: relative error {error}", friction.share);
        stuck += usize::from(friction.share == 1.0);
        slid += usize::from(friction.share < 1.0);
    }
    assert!(stuck > 15 && slid > 50, "{stuck} stuck and {slid} slid");
}

#[test]
fn the_coefficient_falls_as_its_derivative_says() {
    let friction = Friction { static_coefficient: 0.8, dynamic_coefficient: 0.5 };
    for speed in [1e-4, 1e-3, 0.005, 0.02, 0.3] {
        let h = 1e-6 * speed;
        let at = |speed: f64| friction.coefficient(speed * speed);
        let slope = (at(speed + h) - at(speed - h)) / (2.0 * h);
        let expected = friction.falling(speed * speed) * speed;
        assert!((slope - expected).abs() < 1e-6 * slope.abs(), "at {speed} m/s");
    }
    assert_eq!(friction.coefficient(0.0), 0.8);
    assert!((friction.coefficient(1.0) - 0.5).abs() < 1e-4);
}

#[test]
fn the_coulomb_limit_holds_in_every_state() {
    let seed = 62;
    let mut rng = StdRng::seed_from_u64(seed);
    for case in 0..5000 {
        let state = BodyState { pose: random_pose(&mut rng, 0.5), twist: random_twist(&mut rng, 1.0, 10.0) };
        let contact = random_contact(&mut rng, &state);
        let at = contact.at(&state, &DMat3::from_quat(state.pose.rotation));
        let normal = contact.normal_force(&at);
        let friction = contact.friction_force(&state, &at, normal);
        let most = contact.friction.static_coefficient.max(contact.friction.dynamic_coefficient);
        let over = if contact.radius > 0.0 { friction.moment / contact.radius } else { 0.0 };
        let felt = (friction.force.length_squared() + over * over).sqrt();
        assert!(felt <= most * normal * (1.0 + 1e-9), "seed {seed}, case {case}: {felt} N of {normal} N");
        assert!(friction.force.dot(contact.normal).abs() <= 1e-9 * felt, "seed {seed}, case {case}");
    }
}

/// Settling takes energy out of the springs and never adds any, and a second time it changes nothing.
#[test]
fn settling_never_stretches_a_spring() {
    let seed = 63;
    let mut rng = StdRng::seed_from_u64(seed);
    let mut yielded = 0;
    for case in 0..2000 {
        let state = BodyState { pose: random_pose(&mut rng, 0.5), twist: random_twist(&mut rng, 0.3, 3.0) };
        let rotation = DMat3::from_quat(state.pose.rotation);
        let before = random_contact(&mut rng, &state);
        let mut after = before;
        after.settle(&state, &rotation);
        let at = before.at(&state, &rotation);
        let (x, y) = (before.stretch(&state, &at), after.stretch(&state, &at));
        assert!(y.length() <= x.length() * (1.0 + 1e-9), "seed {seed}, case {case}");
        yielded += usize::from(y.length() < 0.99 * x.length());
        let limit = before.friction.coefficient(before.slide(&state, &at).length_squared())
            * before.normal_force(&at);
        let small_turn = 0.5 * y.spin.abs() < 0.1 * before.radius;
        assert!(
            !small_turn || before.stiffness * y.length() <= limit * (1.0 + 1e-6) + 1e-9,
            "seed {seed}, case {case}: {} N of {limit}",
            before.stiffness * y.length()
        );
    }
    assert!(yielded > 200, "{yielded} yielded");
}

/// A new model with other contacts holds the body with the same wrench.
#[test]
fn friction_goes_over_to_new_contacts() {
    let seed = 64;
    let mut rng = StdRng::seed_from_u64(seed);
    for case in 0..500 {
        let pose = random_pose(&mut rng, 0.5);
        let state = BodyState::at_rest(pose);
        let mut model = |count: usize| {
            let mut model = LinearContactModel::empty(&pose, 0.0);
            for _ in 0..count {
                let mut contact = random_contact(&mut rng, &state);
                contact.friction = Friction::coulomb(1e6);
                model.push_contact(contact);
            }
            model
        };
        let (old, mut new) = (model(3), model(5));
        new.take_over_friction(&old, &state);
        let friction = |model: &LinearContactModel| {
            let mut smooth = *model;
            smooth.contacts_mut().iter_mut().for_each(|c| c.friction = Friction::NONE);
            model.wrench(&state) - smooth.wrench(&state)
        };
        let (was, is) = (friction(&old), friction(&new));
        let (force, torque) = ((was - is).force.length(), (was - is).torque.length());
        // The old springs' own wrench, large turns of theirs apart.
        assert!(force < 1e-3 * was.force.length(), "seed {seed}, case {case}: {was:?} {is:?}");
        assert!(torque < 1e-2 * (was.torque.length() + 0.1 * was.force.length()), "seed {seed}, case {case}");
    }
}

#[test]
fn friction_of_the_same_contacts_stays_however_often_they_are_found_anew() {
    let pose = Pose::from_translation(DVec3::Z * 0.02);
    let parameters = ContactParameters {
        stiffness: 1000.0,
        damping: 1.0,
        tolerance: 0.001,
        friction: Friction::coulomb(0.5),
    };
    let touch = |x: f64, y: f64, depth: f64| palpate_core::Contact {
        point: DVec3::new(x, y, 0.0),
        scene_point: DVec3::new(x, y, depth),
        normal: DVec3::NEG_Z,
        depth,
    };
    let found = [touch(0.01, 0.0, 0.001), touch(-0.01, 0.01, 0.0015), touch(0.0, -0.01, 0.0005)];
    let fresh = LinearContactModel::from_contacts(found, &pose, &parameters, 0.0);
    let moved = BodyState::at_rest(Pose::new(
        pose.translation + DVec3::new(2e-4, -1e-4, 0.0),
        DQuat::from_rotation_z(0.01),
    ));
    let mut model = fresh;
    let held = model.wrench(&moved);
    for _ in 0..30_000 {
        let mut next = fresh;
        next.take_over_friction(&model, &moved);
        model = next;
    }
    let after = model.wrench(&moved);
    assert!((after - held).force.length() < 1e-3 * held.force.length(), "{held:?} {after:?}");
    assert!((after - held).torque.length() < 1e-3 * held.torque.length(), "{held:?} {after:?}");
}
