use glam::{DMat3, DVec3};
use palpate_core::{Pose, Twist, Wrench};
use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

use crate::algebra::eigen::Matrix6;
use crate::body::BodyState;
use crate::differences::{random_pose, random_twist, random_vector, relative_error, wrench_jacobian};
use crate::penalty::curvature::MAX_GRADIENT_CHANGE;
use crate::penalty::{
    ContactClass, ContactParameters, CurvedContact, FoundContact, Friction, LinearContactModel, MovingBody,
};

const PARAMETERS: ContactParameters =
    ContactParameters { stiffness: 2000.0, damping: 0.0, tolerance: 5e-4, friction: Friction::NONE };

/// A quadratic depth of a body of about 5 cm, with curvatures of both signs.
fn random_contact(rng: &mut StdRng, pose: &Pose) -> CurvedContact {
    let lever = 0.05;
    let entries: Matrix6 = std::array::from_fn(|_| std::array::from_fn(|_| rng.random_range(-100.0..100.0)));
    let scale = |i: usize| if i < 3 { 1.0 } else { lever };
    let second =
        std::array::from_fn(|i| std::array::from_fn(|j| entries[i.max(j)][i.min(j)] * scale(i) * scale(j)));
    CurvedContact {
        point: pose.translation + random_vector(rng, lever),
        depth: rng.random_range(1e-3..2e-3),
        linear: random_vector(rng, 1.0),
        angular: random_vector(rng, lever),
        second,
        lever,
    }
}

fn model(contact: &CurvedContact, pose: &Pose, parameters: &ContactParameters) -> LinearContactModel {
    let mut model = LinearContactModel::empty(pose, 0.0);
    let found = FoundContact::Curved(contact, pose);
    model.push(ContactClass::Touching, found, parameters, &MovingBody::STILL);
    model
}

fn product(contact: &CurvedContact, motion: &Twist) -> f64 {
    let q = [motion.linear.to_array(), motion.angular.to_array()].concat();
    (0..6).map(|i| (0..6).map(|j| q[i] * contact.second[i][j] * q[j]).sum::<f64>()).sum()
}

#[test]
fn wrench_where_it_was_found_is_that_of_the_potential() {
    let seed = 121;
    let mut rng = StdRng::seed_from_u64(seed);
    for case in 0..500 {
        let pose = random_pose(&mut rng, 0.3);
        let contact = random_contact(&mut rng, &pose);
        let square = contact.linear.length_squared();
        if square < 0.01 {
            continue;
        }
        let wrench = model(&contact, &pose, &PARAMETERS).wrench(&BodyState::at_rest(pose));
        let push = PARAMETERS.stiffness * (contact.depth + PARAMETERS.tolerance);
        let off = wrench - Wrench::new(contact.linear * -push, contact.angular * -push);
        assert!(off.force.length() < 1e-9 * push, "seed {seed}, case {case}: {off:?}");
        assert!(off.torque.length() < 1e-9 * push, "seed {seed}, case {case}: {off:?}");
    }
}

/// With two positive curvatures and no others, the depth equals its second-order expansion.
#[test]
fn energy_follows_the_second_order_of_the_depth() {
    let seed = 122;
    let mut rng = StdRng::seed_from_u64(seed);
    for case in 0..300 {
        let pose = random_pose(&mut rng, 0.3);
        let mut contact = random_contact(&mut rng, &pose);
        // A point on a surface that curves up along two directions.
        contact.linear = contact.linear.normalize();
        let arm = contact.point - pose.translation;
        contact.angular = arm.cross(contact.linear);
        let (u, v) = contact.linear.any_orthonormal_pair();
        let curved = [u, v].map(|axis| (axis, arm.cross(axis), rng.random_range(1.0..300.0)));
        let (a, g) = (arm.to_array(), contact.linear.to_array());
        contact.second = std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                let along = |(l, m, curvature): (DVec3, DVec3, f64)| {
                    let q = [l.to_array(), m.to_array()].concat();
                    curvature * q[i] * q[j]
                };
                let plane = if i >= 3 && j >= 3 {
                    let unit = f64::from(u8::from(i == j));
                    0.5 * (a[i - 3] * g[j - 3] + g[i - 3] * a[j - 3]) - unit * arm.dot(contact.linear)
                } else {
                    0.0
                };
                plane + curved.into_iter().map(along).sum::<f64>()
            })
        });
        let model = model(&contact, &pose, &PARAMETERS);
        let motion = random_twist(&mut rng, 1.0, 20.0);
        let mut errors = [1e-4, 5e-5].map(|step| {
            let q = Twist::new(motion.linear * step, motion.angular * step);
            let depth = contact.depth
                + contact.linear.dot(q.linear)
                + contact.angular.dot(q.angular)
                + 0.5 * product(&contact, &q);
            let expected = 0.5 * PARAMETERS.stiffness * (depth + PARAMETERS.tolerance).powi(2);
            (model.potential_energy(&pose.moved(&q, 1.0)) - expected).abs()
        });
        errors[1] *= 5.0;
        assert!(errors[0] < 1e-9 && errors[1] < errors[0] + 1e-15, "seed {seed}, case {case}: {errors:?}");
    }
}

#[test]
fn jacobian_equals_central_differences() {
    let seed = 123;
    let mut rng = StdRng::seed_from_u64(seed);
    let mut curved = 0;
    for case in 0..500 {
        let found_at = random_pose(&mut rng, 0.3);
        let contact = random_contact(&mut rng, &found_at);
        if contact.linear.length() < 0.3 {
            continue;
        }
        let parameters = ContactParameters { stiffness: 2000.0, tolerance: 0.02, ..PARAMETERS };
        let model = model(&contact, &found_at, &parameters);
        let state = BodyState {
            pose: found_at.moved(&random_twist(&mut rng, 5e-4, 0.01), 1.0),
            twist: random_twist(&mut rng, 0.1, 1.0),
        };
        let response = model.evaluate(&state);
        let expected = wrench_jacobian(|s| model.wrench(s), &state);
        let error = relative_error(&response.jacobian, &expected);
        // The turn of the terms is taken to first order.
        assert!(error < 1e-2, "seed {seed}, case {case}: relative error {error}");
        curved += usize::from(model.curvature_terms().len() > 1);
    }
    assert!(curved > 200, "{curved} were curved");
}

/// The stiffness of a curved contact, without the turning of its arm, is positive semidefinite.
#[test]
fn stiffness_of_curvature_terms_is_semi_definite_wherever_the_body_is() {
    let seed = 124;
    let mut rng = StdRng::seed_from_u64(seed);
    let mut pushed = 0;
    for case in 0..1000 {
        let pose = random_pose(&mut rng, 0.3);
        let contact = random_contact(&mut rng, &pose);
        let model = model(&contact, &pose, &PARAMETERS);
        let state = BodyState::at_rest(pose.moved(&random_twist(&mut rng, 0.02, 0.5), 1.0));
        let response = model.evaluate(&state);
        if response.active == 0 {
            continue;
        }
        pushed += 1;
        let at = model.at(0, &state, &DMat3::from_quat(state.pose.rotation));
        let force = model.contacts()[0].normal_force(&at);
        for term in model.curvature_terms() {
            let at_state = term.at(&state);
            let change = if term.curvature > 0.0 {
                at_state.linear.length().hypot(at_state.angular.length() / contact.lever)
                    * at_state.slope.abs()
                    * contact.linear.length()
            } else {
                0.0
            };
            assert!(
                change <= MAX_GRADIENT_CHANGE * (1.0 + 1e-9),
                "seed {seed}, case {case}: turned by {change}"
            );
        }
        for _ in 0..10 {
            let moved = random_twist(&mut rng, 1.0, 20.0);
            let resisting = response.jacobian.pose.apply(&moved);
            let turning = crate::algebra::rotation::skew_skew(model.contacts()[0].normal * -force, at.arm)
                * moved.angular;
            let energy = -resisting.force.dot(moved.linear) - (resisting.torque - turning).dot(moved.angular);
            assert!(energy >= -1e-9 * force.max(1.0), "seed {seed}, case {case}: {energy}");
        }
    }
    assert!(pushed > 300, "{pushed} pushed");
}

#[test]
fn contacts_that_are_not_finite_are_refused() {
    let mut rng = StdRng::seed_from_u64(125);
    let pose = random_pose(&mut rng, 0.3);
    let good = random_contact(&mut rng, &pose);
    let mut crooked = good;
    crooked.second[2][3] = f64::NAN;
    let bad = [
        CurvedContact { depth: f64::NAN, ..good },
        CurvedContact { linear: DVec3::ZERO, ..good },
        CurvedContact { angular: DVec3::splat(f64::INFINITY), ..good },
        CurvedContact { lever: 0.0, ..good },
    ];
    let mut model = LinearContactModel::empty(&pose, 0.0);
    let push = |model: &mut LinearContactModel, contact: &CurvedContact| {
        let found = FoundContact::Curved(contact, &pose);
        model.push(ContactClass::Touching, found, &PARAMETERS, &MovingBody::STILL);
    };
    for contact in bad {
        push(&mut model, &contact);
    }
    assert_eq!((model.contacts().len(), model.refused()), (0, 4));
    // A contact with an unknown curvature becomes a plane.
    push(&mut model, &crooked);
    assert!(model.curvature_terms().iter().all(|term| term.curvature == 0.0) && model.contacts().len() == 1);
}
