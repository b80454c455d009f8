//! Sessions whose haptic loop and device belong to the host.

use palpate::device::{Emulation, HapticDevice as _, Task};
use palpate::{HostedSession, Object, Pose, Scene, SceneId, Wrench, explore};
use palpate_tests::{model, penalties};

fn scene() -> (Object, Scene) {
    let [probe, ball] = ["ellipsoid@500", "golf-ball@5000"].map(model);
    (probe, Scene::new().with(ball, Pose::IDENTITY))
}

/// A host that reads and writes an emulated device itself feels the ball, and no step allocates.
#[test]
fn a_host_steps_its_own_loop() {
    let (probe, scene) = scene();
    let path = explore::path(Task::Press, &probe, &scene).expect("a path");
    let mut device = Emulation::default().open(path).expect("an emulated device");
    let state = device.read(0.0).expect("a reading");
    let specification = device.specification().clone();
    let mut session = HostedSession::new(probe, scene, specification, state, penalties()).expect("a session");
    assert!(session.latest().is_none());
    let (mut most, mut allocated) = (0.0_f64, 0);
    for step in 1..=3000 {
        let state = device.read(1e-3 * f64::from(step)).expect("a reading");
        let mut wrench = Wrench::ZERO;
        let counted = allocation_counter::measure(|| wrench = session.step(1e-3, &state));
        allocated += counted.count_total;
        device.write(&wrench).expect("taken");
        let contacts = session.latest().is_some_and(|record| record.contacts > 0);
        if contacts {
            most = most.max(wrench.force.length());
        }
        // As with a host's clock, so that contacts are found meanwhile.
        std::thread::sleep(std::time::Duration::from_micros(200));
    }
    // (Limit set after 0.0995 N were seen.)
    assert!(most > 0.05, "{most} N");
    assert_eq!(allocated, 0);
    assert_eq!(session.events().step_refused, 0);
    // A step without duration changes no time.
    let before = *session.latest().expect("a step");
    let last = session.step(0.0, &state);
    assert_eq!((last, session.latest().copied()), (before.coupling, Some(before)));
    assert_eq!(session.step(f64::NAN, &state), before.coupling);
}

/// The haptic thread has only the stepper; changes and views from other threads take effect.
#[test]
fn the_parts_of_a_hosted_session_go_to_other_threads() {
    let (probe, scene) = scene();
    let path = explore::path(Task::Press, &probe, &scene).expect("a path");
    let mut device = Emulation::default().open(path).expect("an emulated device");
    let state = device.read(0.0).expect("a reading");
    let specification = device.specification().clone();
    let hosted = HostedSession::new(probe, scene, specification, state, penalties());
    let HostedSession { mut stepper, mut scene, mut contacts, .. } = hosted.expect("a session");
    let haptic = std::thread::spawn(move || {
        let (mut touched, mut parted) = (false, false);
        for step in 1..=20_000 {
            let state = device.read(1e-3 * f64::from(step).min(2000.0)).expect("a reading");
            stepper.step(1e-3, &state);
            let contacts = stepper.latest().map_or(0, |record| record.contacts);
            touched |= contacts > 0;
            parted = touched && contacts == 0;
            if parted {
                break;
            }
            std::thread::sleep(std::time::Duration::from_micros(200));
        }
        (touched, parted)
    });
    let begun = std::time::Instant::now();
    while contacts.latest().forces.is_empty() {
        assert!(begun.elapsed().as_secs() < 60, "no push is seen");
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    scene.remove(SceneId(0)).expect("the ball");
    assert_eq!(haptic.join().expect("no panic"), (true, true));
}
