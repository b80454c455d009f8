//! Sessions with several objects: distant ones change nothing, and those that the host moves are felt where
//! they are.

use std::convert::Infallible;
use std::sync::atomic::AtomicBool;

use palpate::device::{Emulation, IntendedPath, Task};
use palpate::dynamics::BodyState;
use palpate::errors::EditError;
use palpate::glam::{DMat3, DVec3};
use palpate::{
    ContactLoop, ContactMonitor, ContactTiming, DynamicBody, HapticRenderer, Object, Pose, Record,
    RunningSession, Scene, SceneId, Twist, Wrench, explore,
};
use palpate_tests::{model, penalties, ridged_plate};

fn objects() -> [Object; 2] {
    ["ellipsoid@500", "golf-ball@5000"].map(model)
}

fn renderer(probe: Object, scene: Scene, path: IntendedPath) -> HapticRenderer {
    let device = Emulation::default().open(path).expect("an emulated device");
    HapticRenderer::new(probe, scene, Box::new(device), penalties()).expect("renderer")
}

#[test]
fn far_instances_change_nothing() {
    let [probe, ball] = objects();
    let one = Scene::new().with(ball.clone(), Pose::IDENTITY);
    let radius = ball.bounding_radius();
    let many = (1..500).fold(one.clone(), |scene, index| {
        let at = Pose::from_translation(4.0 * radius * f64::from(index) * DVec3::X);
        scene.with(ball.clone(), at)
    });
    let small = ball.scaled(0.5).expect("a factor");
    let many = many.with(small, Pose::from_translation(-4.0 * radius * DVec3::X));
    let [alone, among] = [&one, &many].map(|scene| {
        let path = explore::path(Task::default(), &probe, &one).expect("path");
        let mut records: Vec<Record> = Vec::new();
        let session = renderer(probe.clone(), scene.clone(), path)
            .run_lockstep(4.0, ContactTiming::busy(400.0), &AtomicBool::new(false), |row| {
                records.push(*row);
                Ok::<_, Infallible>(())
            })
            .expect("the sink never fails");
        assert_eq!(session.summary().events.contact_refused, 0);
        records
    });
    assert!(alone.iter().any(|row| row.contacts > 0));
    // Compared as text, since before the first query the age of the contact model is not a number.
    for (one, other) in alone.iter().zip(&among) {
        assert_eq!(format!("{one:?}"), format!("{other:?}"));
    }
    assert_eq!(alone.len(), among.len());
}

/// The second of two balls is moved from far away to below the probe, and away again.
#[test]
fn a_moved_object_is_felt_where_it_is() {
    let [probe, ball] = objects();
    let radius = ball.bounding_radius();
    let far = Pose::from_translation(10.0 * radius * DVec3::X);
    let below = Pose::from_translation(
        -(radius + 0.9 * probe.clod.vertices.iter().map(|v| v.z).fold(0.0, f64::max)) * DVec3::Z,
    );
    let scene = Scene::new().with(ball.clone(), far).with(ball, far);
    let path = IntendedPath::function(|_| (Pose::IDENTITY, palpate::Twist::ZERO));
    let (haptic, mut contact, _) = renderer(probe, scene, path).into_loops();
    let body: BodyState = *haptic.body_state();
    let touched = |contact: &mut ContactLoop| contact.step(&body, 0.0).contacts > 0;
    assert!(!touched(&mut contact));
    assert!(contact.set_pose(SceneId(1), &below) && touched(&mut contact));
    assert!(contact.set_pose(SceneId(1), &far) && !touched(&mut contact));
    assert!(contact.set_pose(SceneId(0), &below) && touched(&mut contact));
    assert!(contact.set_pose(SceneId(0), &Pose::from_translation(DVec3::NAN)) && !touched(&mut contact));
    assert_eq!(contact.telemetry().events.contact_refused, 1);
    assert!(!contact.set_pose(SceneId(2), &below), "there are two");
}

/// Returns a pose of the object below the probe at the origin, in contact.
fn below(probe: &Object, object: &Object) -> Pose {
    let top = |object: &Object| object.clod.vertices.iter().map(|v| v.z).fold(f64::NEG_INFINITY, f64::max);
    let bottom = probe.clod.vertices.iter().map(|v| v.z).fold(f64::INFINITY, f64::min);
    Pose::from_translation((0.9 * bottom - top(object)) * DVec3::Z)
}

/// Returns whether wrenches agree within a thousandth: where the probe is deep in the object, its proxy may
/// have taken another path.
fn same(one: Wrench, other: Wrench) -> bool {
    let near = |one: DVec3, other: DVec3| one.distance(other) < 1e-3 * other.length().max(1e-3);
    near(one.force, other.force) && one.torque.distance(other.torque) < 1e-5
}

/// Objects that are added, moved, scaled and removed from elsewhere feel as if the scene had been so from the
/// start.
#[test]
fn edits_are_felt_from_the_next_step() {
    let [probe, ball] = objects();
    let near = below(&probe, &ball);
    let still = || IntendedPath::from(Pose::IDENTITY);
    let mut edited = renderer(probe.clone(), Scene::new(), still());
    let mut editor = edited.scene_editor();
    let (haptic, mut contact, _) = edited.into_loops();
    let body: BodyState = *haptic.body_state();
    let mut time = 0.0;
    let mut felt = |contact: &mut ContactLoop| {
        time += 0.002;
        contact.step(&body, time).model.wrench(&body)
    };
    let as_from_the_start = |object: &Object, pose: Pose| {
        let scene = Scene::new().with(object.clone(), pose);
        let (_, mut contact, _) = renderer(probe.clone(), scene, still()).into_loops();
        contact.step(&body, 0.002).model.wrench(&body)
    };
    let nothing = Wrench::ZERO;
    assert_eq!(felt(&mut contact), nothing);
    let first = editor.add(&ball, near).expect("room");
    let pushed = as_from_the_start(&ball, near);
    assert!(pushed.force.z > 0.01, "{pushed:?}");
    let now = felt(&mut contact);
    assert!(same(now, pushed), "{now:?} {pushed:?}");
    let far = Pose::from_translation(DVec3::X);
    editor.set_pose(first, far).expect("room");
    assert_eq!(felt(&mut contact), nothing);
    // Half as large, with its top at the same height.
    let small = ball.scaled(0.5).expect("a factor");
    let at = below(&probe, &small);
    editor.replace(first, &small, at).expect("room");
    assert!(same(felt(&mut contact), as_from_the_start(&small, at)));
    editor.remove(first).expect("room");
    assert_eq!(felt(&mut contact), nothing);
    let second = editor.add(&ball, near).expect("room");
    assert!(second != first);
    let now = felt(&mut contact);
    assert!(same(now, pushed), "{now:?} {pushed:?}");
    assert_eq!(contact.telemetry().events.edit_refused, 0);
    // Unknown objects cannot be changed.
    let unknown = EditError::Unknown;
    assert_eq!(editor.set_pose(first, near), Err(unknown(first)));
    assert_eq!(editor.remove(first), Err(unknown(first)));
    assert_eq!(editor.replace(first, &ball, near), Err(unknown(first)));
    assert_eq!(editor.set_motion(first, near, Twist::ZERO), Err(unknown(first)));
    assert_eq!(editor.set_dynamics(first, None), Err(unknown(first)));
    assert_eq!(editor.set_pose(SceneId(77), near), Err(unknown(SceneId(77))));
    let now = felt(&mut contact);
    assert!(same(now, pushed), "{now:?} {pushed:?}");
    assert_eq!(contact.telemetry().events.edit_refused, 0);
    // A change that the loop can no longer make is counted.
    let gone = editor.add(&ball, far).expect("room");
    felt(&mut contact);
    editor.set_pose(gone, near).expect("room");
    assert!(contact.remove(gone));
    assert_eq!(editor.remove(gone), Err(unknown(gone)), "removed by the host of the loop");
    felt(&mut contact);
    assert_eq!(contact.telemetry().events.edit_refused, 1);
    assert_eq!(editor.set_pose(second, Pose::from_translation(DVec3::NAN)), Err(EditError::Pose));
    let more = (0..10_000).map(|_| editor.set_pose(second, near)).find(Result::is_err);
    assert_eq!(more, Some(Err(EditError::Full)));
}

/// Textures are added and removed with their objects.
#[test]
fn textured_objects_can_be_added() {
    let [probe, ball] = objects();
    let plate = ridged_plate(5e-4, 2e-3);
    let mut edited = renderer(
        probe.clone(),
        Scene::new().with(ball, Pose::from_translation(DVec3::X)),
        Pose::IDENTITY.into(),
    );
    let mut editor = edited.scene_editor();
    assert!(edited.stages()["textures"].starts_with("off"));
    let (haptic, mut contact, _) = edited.into_loops();
    let body: BodyState = *haptic.body_state();
    let lowest = contact.step(&body, 0.0).contacts;
    assert_eq!(lowest, 0);
    let id = editor.add(&plate, below(&probe, &plate)).expect("room");
    let update = contact.step(&body, 0.002);
    assert!(update.depth > 0.0 && update.model.wrench(&body).force.length() > 0.0, "{}", update.depth);
    editor.remove(id).expect("room");
    assert_eq!(contact.step(&body, 0.004).contacts, 0);
    assert_eq!(contact.telemetry().events.edit_refused, 0);
}

/// Waits until the latest step satisfies a condition.
fn wait(running: &mut RunningSession, what: &str, is_so: impl Fn(&Record) -> bool) {
    let begun = std::time::Instant::now();
    while !running.latest().is_some_and(&is_so) {
        assert!(running.is_running() && begun.elapsed().as_secs() < 60, "{what}");
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
}

/// A spawned session takes edits while it runs, shows where the object is, and returns its summary when it is
/// stopped.
#[test]
fn a_spawned_session_is_edited_while_it_runs() {
    let [probe, ball] = objects();
    let near = below(&probe, &ball);
    let mut running = renderer(probe, Scene::new(), Pose::IDENTITY.into()).spawn().expect("threads");
    wait(&mut running, "no step is shown", |record| record.time > 0.05 && record.contacts == 0);
    let id = running.scene.add(&ball, near).expect("room");
    wait(&mut running, "the ball is not felt", |record| record.contacts > 0 && record.contact.force.z > 0.0);
    assert!(!running.contacts.latest().forces.is_empty());
    running.scene.remove(id).expect("room");
    assert_eq!(running.scene.remove(id), Err(EditError::Unknown(id)));
    let session = running.stop().expect("no panic");
    assert!(session.summary().haptic.steps > 50 && session.summary().events.edit_refused == 0);
}

/// All editors of a scene share its objects: what one adds the other can move.
#[test]
fn editors_of_a_scene_share_their_objects() {
    let [probe, ball] = objects();
    let near = below(&probe, &ball);
    let mut renderer = renderer(probe, Scene::new(), Pose::IDENTITY.into());
    let (mut first, mut second) = (renderer.scene_editor(), renderer.scene_editor());
    let (haptic, mut contact, _) = renderer.into_loops();
    let id = first.add(&ball, Pose::from_translation(DVec3::X)).expect("room");
    second.set_pose(id, near).expect("the other's object");
    assert_ne!(second.add(&ball, Pose::from_translation(DVec3::Y)), Ok(id));
    assert!(contact.step(haptic.body_state(), 0.002).contacts > 0);
    // So do the host's objects.
    let hosts = SceneId(100);
    assert!(contact.add(hosts, &ball, &Pose::from_translation(DVec3::Z)));
    first.remove(hosts).expect("the host's object");
    assert_eq!(contact.editor().add(&ball, Pose::from_translation(DVec3::Z)), Ok(SceneId(101)));
    contact.step(haptic.body_state(), 0.004);
    assert_eq!(contact.telemetry().events.edit_refused, 0);
}

/// Handles taken of a renderer work once its session runs, and so do those of the session, each in its own
/// thread.
#[test]
fn handles_taken_before_spawn_work_after_it() {
    fn sendable<T: Send + 'static>(_: &T) {}
    let [probe, ball] = objects();
    let near = below(&probe, &ball);
    let mut renderer = renderer(probe, Scene::new(), Pose::IDENTITY.into());
    let (mut early_scene, mut early_watch) = (renderer.scene_editor(), renderer.contact_monitor());
    let (mut early_settings, early_reactions) = (renderer.settings_editor(), renderer.reactions());
    let running = renderer.spawn().expect("threads");
    sendable(&running);
    let RunningSession { handle, scene, mut settings, contacts, reactions } = running;
    sendable(&(handle.is_running(), &scene, &settings, &contacts, &reactions).0);
    let id =
        std::thread::spawn(move || early_scene.add(&ball, near)).join().expect("no panic").expect("room");
    let pushed = |mut watch: ContactMonitor| {
        std::thread::spawn(move || {
            let begun = std::time::Instant::now();
            while watch.latest().forces.is_empty() {
                assert!(begun.elapsed().as_secs() < 60, "no push is seen");
                std::thread::sleep(std::time::Duration::from_millis(2));
            }
            watch
        })
    };
    let (late, early) = (pushed(contacts), pushed(early_watch));
    let late_watch = late.join().expect("pushes");
    early_watch = early.join().expect("pushes");
    // Both kinds of handles change the same settings.
    let mut softer = early_settings.settings().live();
    softer.contact.stiffness = 700.0;
    early_settings.set(softer).expect("in range");
    assert_eq!(settings.settings().live(), softer);
    softer.contact.friction = 0.2;
    settings.set(softer).expect("in range");
    assert_eq!(early_settings.settings().contact.stiffness, 700.0);
    // A reaction goes to one of the handles that take reactions.
    let mut scene = scene;
    let mobility = DynamicBody {
        mass: 1.0,
        inertia: DMat3::IDENTITY,
        center_of_mass: DVec3::ZERO,
        gravity: DVec3::ZERO,
        period: 1e-3,
    };
    scene.set_dynamics(id, Some(mobility)).expect("known to both editors");
    let begun = std::time::Instant::now();
    for mut taker in [early_reactions, reactions] {
        while taker.take().is_none() {
            assert!(begun.elapsed().as_secs() < 60, "nothing is pushed");
            std::thread::sleep(std::time::Duration::from_millis(2));
        }
    }
    let session = handle.stop().expect("no panic");
    assert_eq!(session.summary().events.edit_refused, 0);
    drop((late_watch, early_watch));
    // Dropping the handle ends the session.
    assert!(scene.remove(id).is_ok(), "a change waits, whether or not anyone makes it");
}
