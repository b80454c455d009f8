//! Boxes at rest stay at rest, and pressed ones come to rest.

use crate::session::{Session, bottom, cuboid, model, vector, world};
use palpate::Object;
use palpate::glam::DVec3;
use palpate::settings::Response;
use palpate_rapier::rapier3d::prelude::{
    ColliderBuilder, LockedAxes, PhysicsWorld, RigidBodyBuilder, RigidBodyHandle, Vector,
};
use palpate_rapier::solid_collider;

const SIDE: f64 = 0.04;

/// Returns a stack of boxes with a mass (kg) each, on a floor at z = 0.
fn stack(object: &Object, count: usize, mass: f64) -> (PhysicsWorld, Vec<RigidBodyHandle>) {
    let mut world = world(9.81);
    let floor = ColliderBuilder::cuboid(1.0, 1.0, 0.1).translation(Vector::new(0.0, 0.0, -0.1));
    world.insert(RigidBodyBuilder::fixed(), floor);
    let boxes = (0..count).map(|place| {
        let height = SIDE * (0.5 + place as f64);
        let body = RigidBodyBuilder::dynamic().translation(Vector::new(0.0, 0.0, height as f32));
        let collider = solid_collider(object, 0, mass).expect("a collider");
        world.insert(body, collider).0
    });
    let boxes = boxes.collect();
    (world, boxes)
}

/// Returns the kinetic energy that rapier leaves in a stack of three pressed with a constant force (N), J.
fn residual(object: &Object, mass: f64, every: u32, force: f64) -> f64 {
    let (mut world, boxes) = stack(object, 3, mass);
    let dt = f64::from(every) * crate::session::PERIOD;
    world.integration_parameters.dt = dt as f32;
    let mut most = 0.0_f64;
    for step in 1..=4000 / every {
        let impulse = Vector::new(0.0, 0.0, -(force * dt) as f32);
        let point = world.bodies[boxes[2]].translation() + Vector::new(0.003, 0.002, 0.5 * SIDE as f32);
        world.bodies[boxes[2]].apply_impulse_at_point(impulse, point, true);
        world.step();
        if step > 3000 / every {
            most = most.max(world.bodies.iter().map(|(_, body)| f64::from(body.kinetic_energy())).sum());
        }
    }
    most
}

/// With a probe far away the boxes move exactly as without one, bit by bit, and stay at rest.
#[test]
fn boxes_at_rest_stay_at_rest() {
    let (probe, cube) = (model("ellipsoid@500"), cuboid(DVec3::splat(SIDE)));
    for (mass, every) in [(0.01, 1), (0.1, 1), (10.0, 1), (0.1, 4), (0.1, 16)] {
        let (mut alone, _) = stack(&cube, 4, mass);
        let (world, boxes) = stack(&cube, 4, mass);
        let mut session = Session::new(world, every, &probe, |_| (DVec3::Z * 0.5, DVec3::ZERO));
        alone.integration_parameters = session.world.integration_parameters;
        boxes.iter().for_each(|body| session.touch(*body, &cube));
        let (mut settled, mut moved) = (Vec::new(), 0.0_f64);
        for step in 1..=7000 {
            let record = session.step();
            assert_eq!(record.contact.force, DVec3::ZERO);
            if step % every != 0 {
                continue;
            }
            alone.step();
            let places: Vec<_> = boxes.iter().map(|body| *session.world.bodies[*body].position()).collect();
            let others = boxes.iter().map(|body| *alone.bodies[*body].position());
            assert!(others.eq(places.iter().copied()), "{mass} kg every {every} ms: apart at {step} ms");
            // Time in which they sink in as far as rapier lets them.
            if step >= 2000 && settled.is_empty() {
                settled.clone_from(&places);
            }
            for (now, then) in places.iter().zip(&settled) {
                moved = moved.max(f64::from(now.translation.distance(then.translation)));
            }
        }
        assert!(moved < 1e-4, "{mass} kg every {every} ms: moved by {moved} m");
    }
}

/// A hand presses on the topmost and holds still: the force persists, and the boxes come to rest.
#[test]
fn a_stack_that_is_pressed_comes_to_rest() {
    stacks_come_to_rest(Response::Constraints, &[(0.1, 4), (0.1, 16), (10.0, 16)]);
    stacks_come_to_rest(Response::Penalty, &[(0.01, 1), (0.1, 4), (0.01, 16), (10.0, 16)]);
}

#[test]
#[ignore = "for a release build: cargo test --release -p palpate-rapier --test it rest:: -- --ignored"]
fn a_stack_that_is_pressed_comes_to_rest_in_further_cases() {
    for response in [Response::Constraints, Response::Penalty] {
        stacks_come_to_rest(response, &[(0.1, 1), (10.0, 1), (10.0, 4)]);
    }
    stacks_come_to_rest(Response::Penalty, &[(0.01, 4), (0.1, 16)]);
}

/// Checks cases of a box's mass (kg) and the period of the world's steps (ms).
fn stacks_come_to_rest(response: Response, cases: &[(f64, u32)]) {
    let (probe, cube) = (model("ellipsoid@500"), cuboid(DVec3::splat(SIDE)));
    for &(mass, every) in cases {
        let (world, boxes) = stack(&cube, 3, mass);
        let height = 3.0 * SIDE - bottom(&probe) + 1e-3;
        // 3 mm down from 0.5 s on, in 0.5 s.
        let hand = move |time: f64| {
            let along = ((time - 0.5) / 0.5).clamp(0.0, 1.0);
            let moving = (0.5..1.0).contains(&time);
            let velocity = if moving { DVec3::NEG_Z * 6e-3 } else { DVec3::ZERO };
            (DVec3::new(0.003, 0.002, height - 3e-3 * along), velocity)
        };
        let mut session = Session::with(response, world, every, &probe, hand);
        boxes.iter().for_each(|body| session.touch(*body, &cube));
        let (mut energies, mut force) = (Vec::new(), 0.0);
        let mut at_hold = Vec::new();
        for step in 1..=6000 {
            // Single steps push more and less.
            let pushed = session.step().contact.force.z;
            force += if step > 5000 { 1e-3 * pushed } else { 0.0 };
            energies.push(session.world_energy());
            if step == 2000 {
                at_hold = boxes.iter().map(|body| session.world.bodies[*body].translation()).collect();
            }
        }
        let case = format!("{response:?}, {mass} kg every {every} ms");
        let seconds: Vec<f64> =
            energies.chunks(1000).map(|second| second.iter().copied().fold(0.0, f64::max)).collect();
        let nothing = residual(&cube, mass, every, force);
        assert!(force > 1e-4, "{case}: {force} N");
        for (second, pair) in seconds.windows(2).enumerate().skip(1) {
            assert!(pair[1] <= pair[0].max(1.05 * nothing), "{case}: {seconds:?} J, after second {second}");
        }
        let moved = boxes
            .iter()
            .zip(&at_hold)
            .map(|(body, then)| f64::from(session.world.bodies[*body].translation().distance(*then)));
        let moved = moved.fold(0.0, f64::max);
        assert!(moved < 1e-5, "{case}: moved by {moved} m");
        assert!(vector(session.world.bodies[boxes[2]].translation()).z > 2.4 * SIDE, "{case}: fallen");
    }
}

/// A plate lies on the handle of a spoon that a still hand holds: it sinks in deeper than the handle is
/// thick, and stays there.
#[test]
fn an_object_on_a_thin_tool_stays_there() {
    let (probe, thickness) = (model("spoon@2000"), 0.01);
    let plate = cuboid(DVec3::new(0.06, 0.06, thickness));
    let near = |v: &&DVec3| v.x.abs() < 0.03;
    let surface = probe.clod.leaves().iter().flat_map(|leaf| probe.clod.hull(leaf));
    let top = surface.filter(near).map(|v| v.z).fold(f64::NEG_INFINITY, f64::max);
    for mass in [0.02, 0.1] {
        let mut world = world(9.81);
        let height = top + 0.5 * thickness + 5e-4;
        let axes =
            LockedAxes::ROTATION_LOCKED | LockedAxes::TRANSLATION_LOCKED_X | LockedAxes::TRANSLATION_LOCKED_Y;
        let builder = RigidBodyBuilder::dynamic().locked_axes(axes);
        let builder = builder.translation(Vector::new(0.0, 0.0, height as f32));
        let (body, _) = world.insert(builder, solid_collider(&plate, 0, mass).expect("a collider"));
        let mut session = Session::new(world, 1, &probe, |_| (DVec3::ZERO, DVec3::ZERO));
        session.touch(body, &plate);
        let mut force = 0.0;
        for step in 0..2000 {
            // Single steps push more and less.
            let pushed = -session.step().contact.force.z;
            force += if step >= 1900 { 1e-2 * pushed } else { 0.0 };
        }
        let (weight, sunk) = (9.81 * mass, height - f64::from(session.world.bodies[body].translation().z));
        assert!((force - weight).abs() < 0.02 * weight, "{mass} kg: {force} N");
        assert!(sunk < 0.02, "{mass} kg: sunk by {sunk} m");
    }
}

/// A box that drifts against a probe held by a still hand bounces off with no more energy than before.
#[test]
fn a_bounce_adds_no_energy() {
    let (probe, cube) = (model("ellipsoid@500"), cuboid(DVec3::splat(SIDE)));
    for (mass, every) in
        [(0.01, 1), (0.1, 1), (10.0, 1), (0.01, 4), (0.1, 4), (10.0, 4), (0.01, 16), (0.1, 16), (10.0, 16)]
    {
        let speed = 0.05_f32;
        for aside in [0.0, 0.012] {
            let mut world = world(0.0);
            let height = bottom(&probe) - 0.5 * SIDE - 0.02;
            let body = RigidBodyBuilder::dynamic()
                .translation(Vector::new(aside, 0.0, height as f32))
                .linvel(Vector::new(0.0, 0.0, speed))
                .can_sleep(false);
            let (body, _) = world.insert(body, solid_collider(&cube, 0, mass).expect("a collider"));
            let mut session = Session::new(world, every, &probe, |_| (DVec3::ZERO, DVec3::ZERO));
            session.touch(body, &cube);
            let first = session.world_energy();
            let (mut most, mut hit) = (0.0_f64, false);
            for _ in 0..4000 {
                hit |= session.step().contact.force.z > 1e-6;
                // In between, the body has not yet received the impulse of the probe.
                if session.steps.is_multiple_of(every) {
                    most = most.max(session.world_energy() + session.hand_energy());
                }
            }
            let last = session.world_energy() + session.hand_energy();
            let case = format!("{mass} kg every {every} ms, {aside} m aside");
            assert!(hit, "{case}: no touch");
            assert!(most < 1.001 * first, "{case}: {most:e} J of {first:e} J");
            assert!(last < first, "{case}: {last:e} J of {first:e} J");
        }
    }
}
