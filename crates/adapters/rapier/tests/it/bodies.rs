//! Felt bodies, updates sent to the session, and refused bodies.

use crate::session::{Session, bottom, cuboid, model, world};
use palpate::errors::EditError;
use palpate::glam::DVec3;
use palpate_rapier::rapier3d::prelude::{
    MassProperties, RigidBodyBuilder, RigidBodyHandle, RigidBodyType, Vector,
};
use palpate_rapier::{TouchError, TouchedBodies, solid_collider, surface_collider};

const SIDE: f64 = 0.04;
/// Gap between the probe and a box below it, m.
const GAP: f64 = 1e-3;

/// Returns a box below the probe, which a still hand holds.
fn below(builder: RigidBodyBuilder, every: u32) -> (Session, RigidBodyHandle) {
    let (probe, cube) = (model("ellipsoid@500"), cuboid(DVec3::splat(SIDE)));
    let mut world = world(0.0);
    let height = bottom(&probe) - 0.5 * SIDE - GAP;
    let builder = builder.translation(Vector::new(0.0, 0.0, height as f32)).can_sleep(false);
    let (body, _) = world.insert(builder, solid_collider(&cube, 0, 0.1).expect("a collider"));
    let mut session = Session::new(world, every, &probe, |_| (DVec3::ZERO, DVec3::ZERO));
    session.touch(body, &cube);
    (session, body)
}

fn run(session: &mut Session, steps: u32) -> f64 {
    (0..steps).map(|_| session.step().contact.force.z).last().unwrap_or(0.0)
}

/// Returns the mean force along z over so many steps, N.
fn mean(session: &mut Session, steps: u32) -> f64 {
    (0..steps).map(|_| session.step().contact.force.z).sum::<f64>() / f64::from(steps)
}

/// A platform rises against the probe, is put back and removed.
#[test]
fn kinematic_bodies_are_felt_and_not_pushed() {
    for every in [1, 4, 16] {
        let speed = 0.01_f32;
        let rising = RigidBodyBuilder::kinematic_velocity_based().linvel(Vector::new(0.0, 0.0, speed));
        let (mut session, body) = below(rising, every);
        let start = session.world.bodies[body].translation().z;
        let force = run(&mut session, 512);
        assert!(force > 0.1, "every {every} ms: {force} N");
        let rise = session.world.bodies[body].translation().z - start;
        assert!((rise - 0.512 * speed).abs() < 1e-5, "every {every} ms: rose by {rise} m");
        assert!(session.reactions.take().is_none());
        // It stops, and the force persists.
        session.world.bodies[body].set_linvel(Vector::ZERO, true);
        let (one, other) = (mean(&mut session, 1000), mean(&mut session, 1000));
        assert!((one - other).abs() < 1e-3 * one, "every {every} ms: {one} and {other} N");
        // A removed body is not felt.
        session.touched.remove(&mut session.scene, body).expect("it is touched");
        assert!(session.touched.is_empty());
        assert_eq!(run(&mut session, 100), 0.0);
    }
}

/// A box in the probe's path is felt, wherever it is put, until the world removes it.
#[test]
fn fixed_bodies_are_felt_until_they_are_removed() {
    let (mut session, body) = below(RigidBodyBuilder::fixed(), 1);
    assert_eq!(run(&mut session, 300), 0.0);
    let place = session.world.bodies[body].translation() + Vector::new(0.0, 0.0, 3e-3);
    session.world.bodies[body].set_translation(place, true);
    let force = run(&mut session, 600);
    assert!(force > 0.1, "{force} N");
    assert!(session.reactions.take().is_none());
    session.world.remove_body(body);
    assert_eq!(run(&mut session, 300), 0.0);
    assert!(session.touched.is_empty() && session.touched.scene_id(body).is_none());
}

/// A body that is made kinematic is not pushed from then on; made dynamic again, it is.
#[test]
fn a_change_of_type_is_sent() {
    let rising = RigidBodyBuilder::kinematic_velocity_based().linvel(Vector::new(0.0, 0.0, 0.01));
    let (mut session, body) = below(rising, 1);
    run(&mut session, 300);
    assert!(session.reactions.take().is_none());
    session.world.bodies[body].set_body_type(RigidBodyType::Dynamic, true);
    session.world.bodies[body].set_linvel(Vector::ZERO, true);
    run(&mut session, 300);
    let velocity = session.world.bodies[body].linvel().z;
    assert!(velocity < -1e-3, "{velocity} m/s");
    session.world.bodies[body].set_body_type(RigidBodyType::KinematicVelocityBased, true);
    run(&mut session, 10);
    while session.reactions.take().is_some() {}
    session.world.bodies[body].set_linvel(Vector::new(0.0, 0.0, 0.02), true);
    let force = run(&mut session, 600);
    assert!(force > 0.05, "{force} N");
    assert!(session.reactions.take().is_none());
}

/// A session has no room for changes: sleeping bodies need none, and changes of awake bodies are sent later,
/// starting with those that waited.
#[test]
fn a_full_session_gets_changes_later() {
    let cube = cuboid(DVec3::splat(SIDE));
    let mut world = world(0.0);
    // In a row out of the probe's reach, all with the same speed.
    let bodies: Vec<_> = (0..3)
        .map(|place| {
            let start = Vector::new(0.1 * place as f32, 0.0, -1.0);
            let builder = RigidBodyBuilder::dynamic().translation(start).linvel(Vector::new(0.0, 0.1, 0.0));
            world.insert(builder.can_sleep(false), solid_collider(&cube, 0, 0.1).expect("a collider")).0
        })
        .collect();
    let sleeping = RigidBodyBuilder::dynamic().translation(Vector::new(0.0, 0.0, -2.0)).sleeping(true);
    let (sleeper, _) = world.insert(sleeping, solid_collider(&cube, 0, 0.1).expect("a collider"));
    let mut session = Session::new(world, 1, &model("ellipsoid@500"), |_| (DVec3::ZERO, DVec3::ZERO));
    session.touch(sleeper, &cube);
    run(&mut session, 10);
    // More than any queue holds.
    for _ in 0..10_000 {
        session.world.step();
        session.touched.after_step(&mut session.scene, &session.world.bodies).expect("nothing to send");
    }
    bodies.iter().for_each(|body| session.touch(*body, &cube));
    let mut refused = 0;
    for _ in 0..1000 {
        session.world.step();
        let sent = session.touched.after_step(&mut session.scene, &session.world.bodies);
        if let Err(error) = sent {
            assert!(matches!(error, TouchError::Edit { source: EditError::Full, .. }), "{error}");
            refused += 1;
        }
    }
    assert!(refused > 500, "{refused}");
    // The contact loop goes on, and there is room again.
    run(&mut session, 10);
    assert_eq!(session.touched.len(), 4);
}

#[test]
fn invalid_bodies_are_refused() {
    let (mut session, body) = below(RigidBodyBuilder::dynamic(), 1);
    let cube = cuboid(DVec3::splat(SIDE));
    let Session { touched, scene, world, .. } = &mut session;
    assert_eq!(touched.add(scene, &world.bodies, body, &cube), Err(TouchError::Already(body)));
    let nobody = RigidBodyHandle::from_raw_parts(77, 3);
    assert_eq!(touched.add(scene, &world.bodies, nobody, &cube), Err(TouchError::NoBody(nobody)));
    assert_eq!(touched.remove(scene, nobody), Err(TouchError::NotTouched(nobody)));
    let light = world.insert_body(RigidBodyBuilder::dynamic());
    assert_eq!(touched.add(scene, &world.bodies, light, &cube), Err(TouchError::NoMass(light)));
    // A body's own mass is present after a step of the world.
    let properties = MassProperties::new(Vector::ZERO, 1.0, Vector::ZERO);
    let heavy = world.insert_body(RigidBodyBuilder::dynamic().additional_mass_properties(properties));
    assert_eq!(touched.add(scene, &world.bodies, heavy, &cube), Err(TouchError::NoMass(heavy)));
    world.step();
    touched.add(scene, &world.bodies, heavy, &cube).expect("a mass");
    for period in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let mut timeless = TouchedBodies::new(period, world.gravity);
        let refused = timeless.add(scene, &world.bodies, body, &cube);
        assert_eq!(refused, Err(TouchError::Edit { body, source: EditError::DynamicBody }), "{period}");
        assert!(timeless.is_empty());
        // A fixed body needs no period.
        let fixed = world.insert_body(RigidBodyBuilder::fixed());
        timeless.add(scene, &world.bodies, fixed, &cube).expect("it is not pushed");
    }
    // Refused bodies have been removed again.
    let error = TouchError::NoMass(light).to_string();
    assert!(error.contains("no mass") && error.contains("collider"), "{error}");
}

/// A body with invalid numbers stays where it was, and the others go on.
#[test]
fn a_body_with_an_invalid_pose_delays_no_other() {
    let (mut session, body) = below(RigidBodyBuilder::dynamic(), 1);
    run(&mut session, 10);
    session.world.bodies[body].set_linvel(Vector::new(f32::NAN, 0.0, 0.0), false);
    let cube = cuboid(DVec3::splat(SIDE));
    let other = RigidBodyBuilder::kinematic_velocity_based().translation(Vector::new(1.0, 0.0, 0.0));
    let (other, _) = session.world.insert(other, surface_collider(&cube).expect("triangles"));
    session.touch(other, &cube);
    session.world.bodies[other].set_linvel(Vector::new(0.1, 0.0, 0.0), true);
    let refused = session.touched.after_step(&mut session.scene, &session.world.bodies);
    assert_eq!(refused, Err(TouchError::Edit { body, source: EditError::Twist }));
    // The other body was sent and has no further changes.
    session.world.bodies[body].set_linvel(Vector::ZERO, false);
    session.touched.after_step(&mut session.scene, &session.world.bodies).expect("room");
}
