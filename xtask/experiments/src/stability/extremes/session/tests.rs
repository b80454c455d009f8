use super::*;

fn jaws() -> (Object, Scene) {
    let open = |name| Object::model(name).expect("a model");
    (open("upper-jaw@3000"), Scene::new().with(open("lower-jaw@3000"), Pose::IDENTITY))
}

/// Records of the session that the command line makes of the device's address.
fn of_command(case: &Case<'_>, address: &str, seconds: f64) -> Vec<Record> {
    let device = explore::open_device_for(address, case.probe, case.scene, &case.settings).expect("a device");
    let (probe, scene) = (case.probe.clone(), case.scene.clone());
    let renderer = HapticRenderer::new(probe, scene, device, case.settings).expect("a session");
    let mut records = Vec::new();
    let timing = ContactTiming::busy(case.contact_rate);
    let Ok(_) = renderer.run_lockstep(seconds, timing, &AtomicBool::new(false), |record| {
        records.push(*record);
        Ok::<_, Infallible>(())
    });
    records
}

/// The hand's own path is that of the command line, step by step; that of a hand that pauses is not.
#[test]
fn sessions_are_those_of_the_command_line() {
    let (probe, scene) = &jaws();
    let case = Case { probe, scene, settings: Settings::default(), contact_rate: 100.0 };
    let records = |hands| {
        let device = Emulation::default().open(case.intended(hands).expect("a path")).expect("a device");
        case.records(hands, device).expect("a session")
    };
    let same = |a: &[Record], b: &[Record]| {
        a.len() == b.len()
            && a.iter()
                .zip(b)
                .all(|(a, b)| (a.object, a.coupling, a.depth) == (b.object, b.coupling, b.depth))
    };
    let exploring = of_command(&case, "emulated", 5.0);
    assert!(exploring.iter().any(|record| record.contacts > 0), "they touch");
    assert!(same(&records(Hands::Exploring), &exploring));
    assert!(same(&records(Hands::Pressing), &of_command(&case, "emulated:premium-1.5,task=press", 4.0)));
    let paused = records(Hands::Paused);
    assert!(!same(&paused, &exploring[..paused.len()]));
}

/// A hand that pauses reaches the depth of the strokes before it pauses there, and loses no time after that.
#[test]
fn a_hand_pauses_between_descent_and_strokes() {
    let hands = Hands::Paused;
    assert_eq!(hands.progress(0.0).0, 0.0);
    assert!((hands.progress(DESCENT - 1e-9).0 - 2.0).abs() < 1e-6);
    assert_eq!(hands.progress(DESCENT + 0.5 * PAUSE), (2.0, 0.0));
    let (time, speed) = hands.progress(DESCENT + PAUSE + 1.0);
    assert!((time - 3.0).abs() < 1e-12 && speed == 1.0);
}

#[test]
fn the_bounds_that_are_exceeded_are_named() {
    let level = |force| Level { force, ..Level::default() };
    let vibration =
        Vibration { free: level(0.004), onset: level(9.0), rest: level(0.02), sliding: level(0.04) };
    let exact = Deepest { depth: 2e-4, index: Some(3), beyond: 4 };
    let measured = Measured { told: 0.0, exact, steps: 8, vibration };
    assert_eq!(measured.outside(), ["depth", "rest"]);
    assert_eq!(measured.beyond(), 0.5);
    assert_eq!(worst(&measured.vibration.rest), [0.0; 2]);
}
