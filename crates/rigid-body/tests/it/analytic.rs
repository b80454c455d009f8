//! Motions with a known solution.

use crate::worlds::{ball, block};
use palpate_collide::{ErrorMetrics, QueryError, Shape};
use palpate_core::glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist};
use palpate_rigid_body::{BodyState, RigidBody, Settings, SettingsError, Simulation, StepError};

/// Pose of the ground: its upper face is at z = 0.
const GROUND: Pose = Pose::from_translation(DVec3::new(0.0, 0.0, -0.05));
const GRAVITY: f64 = 9.80665;
const TOLERANCE: f64 = 1e-4;

fn ground() -> Shape {
    block(DVec3::new(2.0, 2.0, 0.05))
}

fn simulation(shape: &Shape, ground_pose: Pose, start: BodyState, settings: Settings) -> Simulation {
    let body = RigidBody::solid(shape, 0.1).unwrap();
    Simulation::new(body, shape, &ground(), ground_pose, start, settings).unwrap()
}

#[test]
fn ball_bounces_to_e_squared_of_its_height() {
    let (radius, height) = (0.02, 0.3);
    let shape = ball(radius);
    for (restitution, step) in [(0.5, 1e-3), (0.8, 1e-3), (0.8, 2.5e-4), (1.0, 4e-3)] {
        let settings = Settings { restitution, friction: 0.0, ..Settings::new(TOLERANCE) };
        let start = BodyState::at_rest(Pose::from_translation((radius + height) * DVec3::Z));
        let mut ball = simulation(&shape, GROUND, start, settings);
        let mut apex = 0.0f64;
        let mut hits = 0;
        while ball.time() < 2.0 && hits < 2 {
            ball.step(step).unwrap();
            hits += ball.impacts().iter().filter(|impact| !impact.micro).count();
            if hits == 1 {
                apex = apex.max(ball.state().pose.translation.z - radius);
            }
        }
        assert_eq!(hits, 2);
        // Surfaces collide at up to half the tolerance, and the height is sampled once a step.
        let seen = GRAVITY * step * step;
        let off = apex - restitution * restitution * height;
        assert!(off.abs() < TOLERANCE + seen, "e {restitution}, step {step}: off by {off}");
    }
}

#[test]
fn bouncing_ball_comes_to_rest() {
    let shape = ball(0.02);
    let settings = Settings { restitution: 0.6, ..Settings::new(TOLERANCE) };
    let start = BodyState::at_rest(Pose::from_translation(0.1 * DVec3::Z));
    let mut ball = simulation(&shape, GROUND, start, settings);
    while ball.still_for() < 0.5 && ball.time() < 5.0 {
        ball.step(1e-3).unwrap();
    }
    // Bounces of 2 √(2h/g), each e times as long as the one before, after a fall of half the first.
    let fall = (2.0 * 0.08 / GRAVITY).sqrt();
    let rest = fall * (1.0 + 2.0 * 0.6 / 0.4);
    let found = ball.time() - ball.still_for();
    assert!((found - rest).abs() < 0.05, "at rest after {found} s, not {rest} s");
    assert!((ball.state().pose.translation.z - 0.02).abs() < TOLERANCE);
}

/// A block that lies on a slope.
fn on_slope(angle: f64, speed: f64, friction: f64) -> Simulation {
    let half = DVec3::new(0.04, 0.03, 0.01);
    let turn = DQuat::from_rotation_y(angle);
    let pose = Pose::new(turn * ((half.z + 0.25 * TOLERANCE) * DVec3::Z), turn);
    let start = BodyState { pose, twist: Twist::new(turn * (speed * DVec3::X), DVec3::ZERO) };
    let settings = Settings { friction, restitution: 0.3, ..Settings::new(TOLERANCE) };
    simulation(&block(half), Pose::new(turn * GROUND.translation, turn), start, settings)
}

/// Returns the distance that a block slides down the slope in a time, m.
fn slid(mut block: Simulation, time: f64) -> f64 {
    let start = block.state().pose;
    while block.time() < time {
        let outcome = block.step(1e-3).unwrap();
        assert!(outcome.depth < TOLERANCE && outcome.exhausted == 0, "{outcome:?}");
    }
    let way = start.rotation.conjugate() * (block.state().pose.translation - start.translation);
    assert!(way.z.abs() < TOLERANCE && way.y.abs() < 10.0 * TOLERANCE, "{way}");
    way.x
}

#[test]
fn block_slides_down_a_slope_against_friction() {
    for (angle, friction) in [(0.5f64, 0.2), (0.5, 0.0), (0.3, 0.15)] {
        let acceleration = GRAVITY * (angle.sin() - friction * angle.cos());
        let expected = 0.5 * acceleration * 0.25;
        let found = slid(on_slope(angle, 0.0, friction), 0.5);
        assert!((found / expected - 1.0).abs() < 0.02, "μ {friction}: {found} m, not {expected} m");
    }
}

#[test]
fn block_stays_on_a_slope_if_friction_holds_it() {
    for angle in [0.0f64, 0.2, 0.4] {
        let found = slid(on_slope(angle, 0.0, 1.2 * angle.tan() + 0.05), 2.0);
        assert!(found.abs() < TOLERANCE, "{angle} rad: crept {found} m");
    }
    // On a steeper one it does not.
    let slips = slid(on_slope(0.4, 0.0, 0.8 * 0.4f64.tan()), 2.0);
    assert!(slips > 0.1, "{slips}");
}

#[test]
fn sliding_block_stops_at_the_known_distance() {
    let (speed, friction) = (0.8, 0.3);
    let expected = speed * speed / (2.0 * friction * GRAVITY);
    let found = slid(on_slope(0.0, speed, friction), 1.0);
    assert!((found / expected - 1.0).abs() < 0.03, "{found} m, not {expected} m");
}

#[test]
fn body_at_rest_stays_at_rest() {
    let mut block = on_slope(0.0, 0.0, 0.3);
    let start = *block.state();
    for _ in 0..5000 {
        block.step(1e-3).unwrap();
    }
    assert!(block.still_for() > 4.9, "{}", block.still_for());
    assert!(block.state().pose.translation.distance(start.pose.translation) < TOLERANCE);
    // Without the ground it does not.
    let mut falling = on_slope(0.0, 0.0, 0.3);
    let away = Pose::from_translation(10.0 * DVec3::X);
    falling.set_state(BodyState::at_rest(away)).unwrap();
    for _ in 0..100 {
        falling.step(1e-3).unwrap();
    }
    assert!(falling.still_for() < 0.01);
}

#[test]
fn body_at_rest_allocates_nothing() {
    let mut block = on_slope(0.2, 0.0, 0.5);
    let mut steps = || (0..200).for_each(|_| assert!(block.step(1e-3).is_ok()));
    steps();
    assert_eq!(allocation_counter::measure(steps).count_total, 0);
}

#[test]
fn distant_body_needs_few_queries() {
    let mut block = on_slope(0.0, 0.0, 0.3);
    let start = BodyState {
        pose: Pose::from_translation(1e4 * DVec3::Z),
        twist: Twist::new(300.0 * DVec3::X, DVec3::X),
    };
    block.set_state(start).unwrap();
    let energy = block.energy();
    for _ in 0..1000 {
        assert_eq!(block.step(1e-2).unwrap().queries, 1);
    }
    assert!((block.energy() / energy - 1.0).abs() < 1e-9);
}

#[test]
fn invalid_settings_and_steps_are_refused() {
    let shape = block(DVec3::splat(0.02));
    let good = Settings::new(TOLERANCE);
    let start = BodyState::at_rest(Pose::from_translation(0.1 * DVec3::Z));
    let ground = ground();
    let new = |settings, start| {
        let body = RigidBody::solid(&shape, 0.1).unwrap();
        Simulation::new(body, &shape, &ground, GROUND, start, settings)
    };
    type Refused = fn(&SettingsError) -> bool;
    let wrong: [(Settings, Refused); 8] = [
        (Settings { gravity: DVec3::NAN, ..good }, |e| matches!(e, SettingsError::Gravity { .. })),
        (Settings { restitution: 1.1, ..good }, |e| matches!(e, SettingsError::Restitution { .. })),
        (Settings { restitution: f64::NAN, ..good }, |e| matches!(e, SettingsError::Restitution { .. })),
        (Settings { friction: -0.1, ..good }, |e| matches!(e, SettingsError::Friction { .. })),
        (Settings { tolerance: 0.0, ..good }, |e| matches!(e, SettingsError::Tolerance { .. })),
        (Settings { travel: f64::INFINITY, ..good }, |e| matches!(e, SettingsError::Travel { .. })),
        (Settings { error: ErrorMetrics::from(-1.0), ..good }, |e| {
            *e == SettingsError::Query(QueryError::HapticMetric { given: -1.0 })
        }),
        (Settings { tolerance: 1.0, ..good }, |e| {
            matches!(e, SettingsError::Query(QueryError::Tolerance { given: 1.0, .. }))
        }),
    ];
    for (settings, refused) in wrong {
        let error = new(settings, start).expect_err("refused");
        assert!(refused(&error), "{error}");
    }
    let nowhere = BodyState::at_rest(Pose::from_translation(DVec3::NAN));
    assert_eq!(new(good, nowhere).err(), Some(SettingsError::State));

    let mut simulation = new(good, start).unwrap();
    for duration in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(simulation.step(duration), Err(StepError::Duration { .. })));
    }
    let fast = BodyState { twist: Twist::new(1e9 * DVec3::Z, DVec3::ZERO), ..start };
    simulation.set_state(fast).unwrap();
    assert!(matches!(simulation.step(1e-3), Err(StepError::TooFast { .. })));
    assert_eq!(*simulation.state(), fast);
    assert_eq!(simulation.time(), 0.0);
}
