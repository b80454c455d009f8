//! Sessions with several objects: far ones change nothing, and those that the host moves are felt where they are.

use std::convert::Infallible;
use std::sync::atomic::AtomicBool;

use palpate::device::{Emulation, IntendedPath, Task};
use palpate::dynamics::BodyState;
use palpate::glam::DVec3;
use palpate::{ContactLoop, ContactTiming, HapticRenderer, Object, Pose, Record, Scene, Settings, explore};
use palpate_tests::model;

fn objects() -> [Object; 2] {
    ["ellipsoid@500", "golf-ball@5000"].map(model)
}

fn renderer(probe: Object, scene: Scene, path: IntendedPath) -> HapticRenderer {
    let device = Emulation::default().open(path).expect("an emulated device");
    HapticRenderer::new(probe, scene, Box::new(device), Settings::default()).expect("renderer")
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
    // As text: before the first query the age of the contact model is not a number.
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
    assert!(contact.set_pose(1, &below) && touched(&mut contact));
    assert!(contact.set_pose(1, &far) && !touched(&mut contact));
    assert!(contact.set_pose(0, &below) && touched(&mut contact));
    assert!(contact.set_pose(0, &Pose::from_translation(DVec3::NAN)) && !touched(&mut contact));
    assert_eq!(contact.telemetry().events.contact_refused, 1);
    assert!(!contact.set_pose(2, &below), "there are two");
}
