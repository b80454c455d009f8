//! A contact monitor shows the forces that the hand feels, and a hand follows its steering.

use std::convert::Infallible;
use std::sync::atomic::AtomicBool;

use palpate::glam::DVec3;
use palpate::settings::{ContactSearch, SearchSettings};
use palpate::{ContactTiming, HapticRenderer, Pose, Scene, Settings, explore};
use palpate_tests::{model, penalties};

/// A hand is steered down onto a golf ball, rests there, and is steered up again. The monitor shows the
/// patches that touch, forces that add up to the contact force, and nothing away from the ball.
#[test]
fn pushes_are_those_that_are_felt() {
    watch_a_push(ContactSearch::Levels, 0.15);
    watch_a_push(ContactSearch::Representatives, 0.15);
}

/// Steers a hand down by a part of the probe's radius, and checks the monitored forces.
fn watch_a_push(search: ContactSearch, down: f64) {
    let probe = model("ellipsoid@500");
    let scene = Scene::new().with(model("golf-ball@5000"), Pose::IDENTITY);
    let (device, steering) = explore::open_steered_device("emulated:hand=firm", &probe, &scene, &penalties())
        .expect("emulated device");
    let mut steering = steering.expect("a hand without a task is steered");
    let settings =
        Settings { search: SearchSettings { method: search, ..SearchSettings::default() }, ..penalties() };
    let mut renderer = HapticRenderer::new(probe.clone(), scene.clone(), device, settings).expect("renderer");
    let mut watch = renderer.contact_monitor();
    assert!(watch.latest().time.is_nan() && watch.latest().forces.is_empty());

    let above = steering.aimed();
    let down = Pose::from_translation(above.translation - DVec3::Z * down * probe.bounding_radius());
    let (mut rested, mut seen) = (0, 0);
    let stop = AtomicBool::new(false);
    let session = renderer.run_lockstep(4.0, ContactTiming::busy(1000.0), &stop, |record| {
        steering.aim(if record.time < 2.0 { down } else { above });
        let sight = watch.latest();
        let felt: DVec3 = sight.forces.iter().map(|push| push.force).sum();
        if (1.8..2.0).contains(&record.time) {
            rested += 1;
            seen += usize::from(!sight.patches.is_empty());
            let difference = felt.distance(record.contact.force) / record.contact.force.length();
            assert!(felt.z > 0.2 && difference < 0.02, "{felt} seen, {} felt", record.contact.force);
            // The ball is below: normals point out of the probe, down to it, and the forces point up.
            let tolerance = 0.01 * probe.bounding_radius();
            for push in &sight.forces {
                assert!((push.normal.length() - 1.0).abs() < 1e-9 && push.normal.z < 0.0, "{push:?}");
                let penalty = settings.contact.stiffness * (push.depth + tolerance);
                if search == ContactSearch::Levels {
                    let difference = push.force.distance(-penalty * push.normal);
                    assert!(difference < 1e-9 * push.force.length(), "{push:?}");
                } else {
                    // Planes share the stiffness of all clusters.
                    let share = push.force.dot(-push.normal) / (settings.search.clusters as f64 * penalty);
                    assert!(share > 0.0 && share < 1.0 + 1e-9, "{push:?}");
                }
            }
            for patches in &sight.patches {
                assert_eq!(patches.object, 0);
                assert!((patches.probe_node as usize) < probe.clod.nodes().len());
                assert!((patches.scene_node as usize) < scene.objects()[0].object.clod.nodes().len());
                assert!(patches.weight > 0.0 && patches.weight <= 1.0);
            }
            assert!(record.time - sight.time < 3e-3);
        }
        if record.time > 3.8 {
            assert!(sight.forces.is_empty() && sight.patches.is_empty());
        }
        Ok::<(), Infallible>(())
    });
    let Ok(session) = session;
    assert!(session.summary().coupling_force_max > 0.2);
    assert!(rested > 190 && seen == rested, "{seen} of {rested}");
}

/// A hand with a task cannot be steered, and neither can another device.
#[test]
fn devices_with_a_motion_of_their_own_are_not_steered() {
    let probe = model("ellipsoid@500");
    let scene = Scene::new().with(model("golf-ball@1000"), Pose::IDENTITY);
    let opened = |address: &str| explore::open_steered_device(address, &probe, &scene, &penalties());
    assert!(opened("emulated:touch").is_ok_and(|(_, steering)| steering.is_some()));
    assert!(opened("emulated:task=tap").is_ok_and(|(_, steering)| steering.is_none()));
    assert!(opened("emulated:task=fly").is_err() && opened("nothing").is_err());
}
