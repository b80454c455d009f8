//! The momentum that a free body gains comes from the contact wrench.

use crate::session::{PERIOD, Session, bottom, cuboid, model, vector, world};
use palpate::glam::{DVec2, DVec3};
use palpate_rapier::rapier3d::prelude::{RigidBodyBuilder, Vector};
use palpate_rapier::solid_collider;

/// Struck off its centre of mass, from light to heavy, and in worlds with long steps.
#[test]
fn a_struck_body_takes_the_momentum_that_it_is_given() {
    let probe = model("ellipsoid@500");
    let cases = [
        (cuboid(DVec3::new(0.06, 0.04, 0.02)), DVec2::new(0.015, 0.008)),
        // Its centre of mass is not the origin of its frame, and its mesh's axes are not the principal ones.
        (model("hammer@2000"), DVec2::ZERO),
    ];
    for (object, aim) in &cases {
        for (mass, every) in [(0.01, 1), (0.2, 1), (10.0, 1), (0.05, 4), (1.0, 16)] {
            let case = format!("{}, {mass} kg, every {every} ms", object.name);
            let mut world = world(0.0);
            let coarsest = object.clod.levels.len() - 1;
            let collider = solid_collider(object, coarsest, mass).expect("a collider");
            let (body, _) = world.insert(RigidBodyBuilder::dynamic().can_sleep(false), collider);
            let surface = object.clod.leaves().iter().flat_map(|leaf| object.clod.hull(leaf));
            let top = surface.map(|v| v.z).fold(f64::NEG_INFINITY, f64::max);
            // Down onto it, and slightly through its first position.
            let above = DVec3::new(aim.x, aim.y, top - bottom(&probe) + 2e-3);
            let hand = move |time: f64| {
                let along = (time - 0.3).clamp(0.0, 0.1);
                let velocity = if (0.3..0.4).contains(&time) { DVec3::NEG_Z * 0.1 } else { DVec3::ZERO };
                (above + DVec3::NEG_Z * 0.1 * along, velocity)
            };
            let mut session = Session::new(world, every, &probe, hand);
            session.touch(body, object);
            let (mut linear, mut angular) = (DVec3::ZERO, DVec3::ZERO);
            for _ in 0..800 {
                let contact = session.step().contact;
                let center = session.probe_center();
                linear -= contact.force * PERIOD;
                angular -= (contact.torque + center.cross(contact.force)) * PERIOD;
            }
            session.touched.before_step(&mut session.reactions, &mut session.world.bodies);
            let (taken, turning) = session.momentum(body);
            assert!(taken.z < -1e-5, "{case}: {taken} N·s");
            let (off, of) = ((taken - linear).length(), linear.length());
            assert!(off < 0.01 * of, "{case}: {off:e} of {of:e} N·s");
            // About the initial centre of mass, where both are of similar size.
            let first = vector(session.world.bodies[body].local_center_of_mass());
            let (given, gained) = (angular - first.cross(linear), turning - first.cross(taken));
            let (off, of) = ((gained - given).length(), given.length());
            assert!(of > 1e-7, "{case}: {of:e} N·m·s");
            assert!(off < 0.01 * of, "{case}: {off:e} of {of:e} N·m·s");
        }
    }
}

/// A world pauses, as when it loads data. It receives the impulses on its body meanwhile, for longer than the
/// session can store step by step, when it goes on, and not when the body is touched again.
#[test]
fn a_world_that_stalls_loses_nothing() {
    let (probe, cube) = (model("ellipsoid@500"), cuboid(DVec3::splat(0.04)));
    let mut world = world(0.0);
    let height = bottom(&probe) - 0.02 - 1e-3;
    let builder = RigidBodyBuilder::dynamic().translation(Vector::new(0.0, 0.0, height as f32));
    let (body, _) = world.insert(builder, solid_collider(&cube, 0, 0.5).expect("a collider"));
    // Down for five seconds, and up again.
    let hand = |time: f64| {
        let down = 2e-3 * ((time - 0.3).clamp(0.0, 0.1) - (time - 5.3).clamp(0.0, 0.5)) / 0.1;
        (DVec3::Z * -down, DVec3::ZERO)
    };
    let mut session = Session::new(world, 1, &probe, hand);
    session.touch(body, &cube);
    session.every = u32::MAX;
    let (mut given, mut steps) = (DVec3::ZERO, 0);
    let last = |session: &mut Session| session.step().contact.force * PERIOD;
    for _ in 0..6000 {
        let step = last(&mut session);
        given -= step;
        steps += u32::from(step != DVec3::ZERO);
    }
    assert!(steps > 4500, "{steps}");
    assert_eq!(last(&mut session), DVec3::ZERO);
    session.touched.before_step(&mut session.reactions, &mut session.world.bodies);
    session.step();
    session.touched.before_step(&mut session.reactions, &mut session.world.bodies);
    let (taken, _) = session.momentum(body);
    assert!(given.length() > 0.1, "{given} N·s");
    assert!((taken - given).length() < 1e-3 * given.length(), "{taken} of {given} N·s");
}
