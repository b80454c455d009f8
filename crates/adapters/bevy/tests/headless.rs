//! The plugins in an application without a window.

use std::time::{Duration, Instant};

use bevy_app::{App, Update};
use bevy_ecs::prelude::*;
use bevy_math::{Quat, Vec3};
use bevy_transform::TransformPlugin;
use bevy_transform::components::Transform;
use palpate::device::{Emulation, IntendedPath};
use palpate::glam::{DMat3, DVec3};
use palpate::{DynamicBody, HapticRenderer, Object, Pose, Record, RunningSession};
use palpate_bevy::{ContactImpulse, Felt, Grasped, HapticContacts, HapticPlugins, Haptics};

/// Longest time to wait for anything.
const TIMEOUT: Duration = Duration::from_secs(60);

fn session(probe: &Object) -> RunningSession {
    let device = Emulation::default().open(IntendedPath::from(Pose::IDENTITY)).expect("an emulated device");
    let renderer = HapticRenderer::builder(probe.clone()).on(Box::new(device)).expect("a renderer");
    renderer.spawn().expect("threads")
}

fn app(probe: &Object) -> App {
    let mut app = App::new();
    app.add_plugins((TransformPlugin, HapticPlugins)).insert_resource(Haptics::new(session(probe)));
    app
}

/// Updates until a condition holds.
fn until(app: &mut App, what: &str, mut holds: impl FnMut(&mut App) -> bool) {
    let begun = Instant::now();
    loop {
        app.update();
        if holds(app) {
            return;
        }
        assert!(begun.elapsed() < TIMEOUT, "{what} {:?}", latest(app));
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn latest(app: &mut App) -> Option<Record> {
    app.world_mut().resource_mut::<Haptics>().session().latest().copied()
}

fn contacts(app: &mut App) -> u32 {
    latest(app).map_or(0, |record| record.contacts)
}

fn z(object: &Object) -> impl Iterator<Item = f64> {
    object.clod.vertices.iter().map(|vertex| vertex.z)
}

/// Returns the place of an object below the probe at the origin, a millimetre into it.
fn below(probe: &Object, object: &Object) -> Vec3 {
    let (bottom, top) = (z(probe).fold(f64::INFINITY, f64::min), z(object).fold(f64::NEG_INFINITY, f64::max));
    Vec3::Z * (bottom - top + 1e-3) as f32
}

#[test]
fn entities_are_felt_where_they_are() {
    let (probe, ball) = (Object::model("ellipsoid@500").unwrap(), Object::model("golf-ball@2000").unwrap());
    let mut app = app(&probe);
    let grasped = app.world_mut().spawn(Grasped).id();
    until(&mut app, "no step", |app| latest(app).is_some());
    assert_eq!(contacts(&mut app), 0);

    // Half as large, and placed by its parent.
    let there = below(&probe, &ball.scaled(0.5).unwrap());
    let place = Transform::from_translation(there).with_scale(Vec3::splat(0.5));
    let parent = app.world_mut().spawn(Transform::from_rotation(Quat::from_rotation_z(1.0))).id();
    let felt = app.world_mut().spawn((Felt::new(ball.clone()), place, ChildOf(parent))).id();
    until(&mut app, "it is not felt", |app| contacts(app) > 0);
    until(&mut app, "it does not push", |app| !app.world().resource::<HapticContacts>().forces.is_empty());
    let push = app.world().resource::<HapticContacts>().forces[0];
    assert!(push.force.z > 0.0, "{push:?}");
    // The grasped entity is where the session has it.
    let drawn = app.world().get::<Transform>(grasped).unwrap().translation;
    let known = latest(&mut app).unwrap().object.translation;
    assert!((f64::from(drawn.z) - known.z).abs() < 1e-3 && known.is_finite(), "{drawn} {known}");

    app.world_mut().get_mut::<Transform>(felt).unwrap().translation.x += 1.0;
    until(&mut app, "it is still felt", |app| contacts(app) == 0);
    app.world_mut().get_mut::<Transform>(felt).unwrap().translation = there;
    until(&mut app, "it is not felt again", |app| contacts(app) > 0);
    // At its full size, it is deep in the probe.
    app.world_mut().get_mut::<Transform>(felt).unwrap().scale = Vec3::ONE;
    until(&mut app, "it has not grown", |app| latest(app).is_some_and(|record| record.depth > 2e-3));
    app.world_mut().entity_mut(felt).remove::<Felt>();
    until(&mut app, "it is felt without being so", |app| contacts(app) == 0);
    app.world_mut().get_mut::<Transform>(felt).unwrap().scale = Vec3::splat(0.5);
    app.world_mut().entity_mut(felt).insert(Felt::new(ball));
    until(&mut app, "it is not felt once more", |app| contacts(app) > 0);
    app.world_mut().despawn(felt);
    until(&mut app, "it is felt though it is gone", |app| contacts(app) == 0);
    // The session received no invalid change.
    let haptics = app.world_mut().remove_resource::<Haptics>();
    app.update();
    drop(haptics);
}

/// The session goes on while there are no frames, and a new one receives everything.
#[test]
fn sessions_do_not_wait_for_frames() {
    let (probe, ball) = (Object::model("ellipsoid@500").unwrap(), Object::model("golf-ball@2000").unwrap());
    let mut app = app(&probe);
    app.world_mut().spawn((Felt::new(ball.clone()), Transform::from_translation(below(&probe, &ball))));
    until(&mut app, "it is not felt", |app| contacts(app) > 0);
    let before = latest(&mut app).unwrap().time;
    let begun = Instant::now();
    while latest(&mut app).unwrap().time < before + 0.2 {
        assert!(begun.elapsed() < TIMEOUT, "the session waits");
        std::thread::sleep(Duration::from_millis(5));
    }
    app.insert_resource(Haptics::new(session(&probe)));
    until(&mut app, "the new session does not know it", |app| contacts(app) > 0);
}

#[derive(Resource, Default)]
struct Pushed(Vec<ContactImpulse>);

#[test]
fn movable_entities_get_contact_impulses() {
    let (probe, ball) = (Object::model("ellipsoid@500").unwrap(), Object::model("golf-ball@2000").unwrap());
    let mut app = app(&probe);
    app.init_resource::<Pushed>();
    app.add_systems(Update, |mut impulses: MessageReader<ContactImpulse>, mut pushed: ResMut<Pushed>| {
        pushed.0.extend(impulses.read());
    });
    let dynamics = DynamicBody {
        mass: 1.0,
        inertia: DMat3::from_diagonal(DVec3::splat(1e-3)),
        center_of_mass: DVec3::ZERO,
        gravity: DVec3::ZERO,
        period: 1e-3,
    };
    let place = Transform::from_translation(below(&probe, &ball));
    let felt = app.world_mut().spawn((Felt::new(ball), place)).id();
    until(&mut app, "it is not felt", |app| contacts(app) > 0);
    assert!(app.world().resource::<Pushed>().0.is_empty());
    app.world_mut().entity_mut(felt).insert(palpate_bevy::Movable(dynamics));
    until(&mut app, "nothing pushes it", |app| app.world().resource::<Pushed>().0.len() > 10);
    let pushed = &app.world().resource::<Pushed>().0;
    assert!(
        pushed.iter().all(|impulse| impulse.entity == felt && impulse.linear.z <= 0.0),
        "{:?}",
        pushed[0]
    );
    app.world_mut().entity_mut(felt).remove::<palpate_bevy::Movable>();
    until(&mut app, "it is still pushed", |app| {
        let pushed = &mut app.world_mut().resource_mut::<Pushed>().0;
        let none = pushed.is_empty();
        pushed.clear();
        none
    });
}
