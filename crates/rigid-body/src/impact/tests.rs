//! Known impacts, and many random ones.

use glam::DQuat;
use palpate_core::Pose;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

use super::*;

fn ball(mass: f64, radius: f64) -> RigidBody {
    RigidBody::new(mass, DVec3::ZERO, DMat3::IDENTITY * (0.4 * mass * radius * radius)).unwrap()
}

fn moving(linear: DVec3, angular: DVec3) -> BodyState {
    BodyState { pose: Pose::IDENTITY, twist: Twist::new(linear, angular) }
}

fn law(restitution: f64, friction: f64) -> Law {
    Law { restitution, friction, gravity: DVec3::new(0.0, 0.0, -9.81), flight: 1e-3, micro: 0.02 }
}

/// An impact of a ball on the ground.
fn bounced(state: &BodyState, law: &Law) -> (Twist, Touch) {
    let mut touch = Touch::plastic(-0.02 * DVec3::Z, DVec3::Z);
    assert!(law.aim(&mut touch, &state.twist));
    let mut touches = [touch];
    let twist = strike(&ball(0.05, 0.02), state, &mut touches, law.friction);
    (twist, touches[0])
}

#[test]
fn ball_bounces_by_restitution_and_friction() {
    let start = moving(DVec3::new(1.0, 0.0, -2.0), DVec3::ZERO);
    for restitution in [0.0, 0.3, 0.8, 1.0] {
        // Too little friction: it keeps sliding.
        let (sliding, touch) = bounced(&start, &law(restitution, 0.05));
        assert!((sliding.linear.z - 2.0 * restitution).abs() < 1e-9);
        let slowed = 1.0 - 0.05 * 2.0 * (1.0 + restitution);
        assert!((sliding.linear.x - slowed).abs() < 1e-9, "{sliding:?}");
        assert!((touch.impulse - 0.05 * (sliding.linear - start.twist.linear)).length() < 1e-12);
        // Sufficient friction: it rolls with 5/7 of its speed.
        let (rolling, _) = bounced(&start, &law(restitution, 0.6));
        assert!((rolling.linear.x - 5.0 / 7.0).abs() < 1e-9, "{rolling:?}");
        assert!(rolling.velocity_at(-0.02 * DVec3::Z).truncate().length() < 1e-9);
        assert!((rolling.linear.z - 2.0 * restitution).abs() < 1e-9);
    }
}

#[test]
fn slow_contacts_return_to_their_place() {
    let law = law(0.0, 0.5);
    // A step of gravity on a slope of 20°, as in a train of impulses.
    let normal = DQuat::from_rotation_y(0.35) * DVec3::Z;
    let state = moving(0.5 * law.flight * law.gravity, DVec3::ZERO);
    let mut touch = Touch::plastic(DVec3::ZERO, normal);
    assert!(!law.aim(&mut touch, &state.twist));
    let mut touches = [touch];
    let twist = strike(&ball(0.05, 0.02), &state, &mut touches, law.friction);
    assert!((twist.linear + state.twist.linear).length() < 1e-12, "{twist:?}");
    // Faster, but too slow to leave the envelope: damped to the same.
    let state = moving(-0.015 * DVec3::Z, DVec3::ZERO);
    let mut touch = Touch::plastic(DVec3::ZERO, DVec3::Z);
    assert!(!law.aim(&mut touch, &state.twist));
    assert!((touch.target - 0.5 * 9.81e-3 * DVec3::Z).length() < 1e-12, "{touch:?}");
    // On a slope steeper than friction holds, it slides down.
    let normal = DQuat::from_rotation_y(0.7) * DVec3::Z;
    let state = moving(0.5 * law.flight * law.gravity, DVec3::ZERO);
    let mut touches = [Touch::plastic(DVec3::ZERO, normal)];
    law.aim(&mut touches[0], &state.twist);
    let twist = strike(&ball(0.05, 0.02), &state, &mut touches, law.friction);
    let impulse = touches[0].impulse;
    let (push, rub) = (impulse.dot(normal), impulse.reject_from(normal).length());
    assert!((rub / push - law.friction).abs() < 1e-6 && twist.is_finite(), "{impulse}");
}

/// A random body, state and contacts, with Newton's restitution at each.
fn random(rng: &mut StdRng) -> (RigidBody, BodyState, Vec<Touch>, f64) {
    let mut vector = |size: f64| DVec3::from_array(std::array::from_fn(|_| rng.random_range(-size..size)));
    let extent = vector(1.0).abs() + 0.02;
    let axes = DQuat::from_scaled_axis(vector(3.0));
    let pose = Pose::new(vector(1.0), DQuat::from_scaled_axis(vector(3.0)));
    let state = BodyState { pose, twist: Twist::new(vector(3.0), vector(8.0)) };
    let places: Vec<(DVec3, DVec3)> =
        (0..8).map(|_| (vector(1.0), vector(1.0).normalize_or(DVec3::Z))).collect();
    let square = extent * extent;
    let moments = DVec3::new(square.y + square.z, square.z + square.x, square.x + square.y) / 3.0;
    let axes = DMat3::from_quat(axes);
    let mass = rng.random_range(0.01..10.0);
    let inertia = axes * DMat3::from_diagonal(mass * moments) * axes.transpose();
    let body = RigidBody::new(mass, DVec3::ZERO, inertia).unwrap();
    let law = law(rng.random_range(0.0..=1.0), [0.0, 0.3, 2.0][rng.random_range(0..3)]);
    let count = rng.random_range(1..=8);
    let touches = places.into_iter().take(count).map(|(direction, normal)| {
        let mut touch = Touch::plastic(pose.rotation * (direction * extent), normal);
        law.aim(&mut touch, &state.twist);
        touch
    });
    (body, state, touches.collect(), law.friction)
}

#[test]
fn energy_never_rises_at_an_impact() {
    let seed = 20_041;
    let mut rng = StdRng::seed_from_u64(seed);
    let (mut unguarded, mut still_coming) = (0, 0);
    for trial in 0..20_000 {
        let (body, state, mut touches, friction) = random(&mut rng);
        let energy = |twist| body.kinetic_energy(&BodyState { twist, ..state });
        let before = energy(state.twist);
        let free = solve(&body, &state, &mut touches.clone(), friction);
        unguarded += u32::from(energy(free) > before * (1.0 + 1e-9));
        let twist = strike(&body, &state, &mut touches, friction);
        assert!(energy(twist) <= before, "seed {seed}, trial {trial}: {:e}", energy(twist) / before - 1.0);
        // The stored impulses are those applied to the body, and are in the friction cones.
        let mut expected = state.twist;
        let inverse_mass = InverseMass { linear: 1.0 / body.mass(), angular: body.inverse_inertia(&state) };
        for touch in &touches {
            inverse_mass.apply(&mut expected, touch.arm, touch.impulse);
            let push = touch.impulse.dot(touch.normal);
            let rub = touch.impulse.reject_from(touch.normal).length();
            let slack = 1e-9 * touch.impulse.length();
            assert!(
                push >= -slack && rub <= friction * push + slack,
                "seed {seed}, trial {trial}: {touch:?}"
            );
        }
        let size = 1.0 + twist.linear.length() + twist.angular.length();
        let off = (expected.linear - twist.linear).length() + (expected.angular - twist.angular).length();
        assert!(off < 1e-9 * size, "seed {seed}, trial {trial}: {off:e}");
        let approach = |touch: &Touch| -twist.velocity_at(touch.arm).dot(touch.normal);
        still_coming += u32::from(touches.iter().any(|touch| approach(touch) > 1e-3 * size));
    }
    // The energy guard was needed in some cases, and bodies do not approach in any.
    assert!(unguarded > 1000, "{unguarded}");
    assert!(still_coming < 200, "{still_coming}");
}
