//! Sessions on a simulated clock: reproducible, stable, and faithful to the hand.

use std::convert::Infallible;
use std::sync::atomic::AtomicBool;

use palpate::settings::{CouplingSettings, SearchSettings, TimingSettings, ToolSettings};
use palpate::{ContactTiming, HapticRenderer, Pose, Record, RecordWriter, Scene, Session, Settings, explore};
use palpate_tests::{model, penalties};

/// Runs a session of an ellipsoid that explores a coarse golf ball.
fn explore_golf_ball(seconds: f64, settings: Settings) -> (Vec<Record>, Session) {
    let probe = model("ellipsoid@2000");
    let ball = model("golf-ball@20000");
    let scene = Scene::new().with(ball, Pose::IDENTITY);
    let device = explore::open_device("emulated", &probe, &scene).expect("emulated device");
    let renderer = HapticRenderer::new(probe, scene, device, settings).expect("renderer");
    let mut records = Vec::new();
    let session = renderer
        .run_lockstep(seconds, ContactTiming::busy(400.0), &AtomicBool::new(false), |row| {
            records.push(*row);
            Ok::<_, Infallible>(())
        })
        .expect("the sink never fails");
    (records, session)
}

fn csv(records: &[Record]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut writer = RecordWriter::new(&mut bytes).expect("memory");
    for record in records {
        writer.write(record).expect("memory");
    }
    writer.finish().expect("memory");
    bytes
}

#[test]
fn two_runs_give_the_same_bytes() {
    let (first, _) = explore_golf_ball(4.0, penalties());
    let (second, _) = explore_golf_ball(4.0, penalties());
    assert_eq!(first.len(), 4000);
    assert!(csv(&first) == csv(&second), "two lockstep recordings differ");
}

#[test]
fn touching_is_felt_and_bounded() {
    let (records, session) = explore_golf_ball(10.0, penalties());
    let summary = session.summary();
    let radius = model("ellipsoid@2000").bounding_radius();
    assert_eq!(summary.haptic.steps, 10_000);
    assert_eq!(summary.contact.rate_hz, 400.0, "a rate that does not divide the haptic one");
    assert!(records.iter().any(|row| row.contacts > 0), "the probe never came near the ball");
    let pressed: Vec<&Record> = records.iter().filter(|row| (3.0..7.0).contains(&row.time)).collect();
    let mean = pressed.iter().map(|row| row.coupling.force.z).sum::<f64>() / pressed.len() as f64;
    assert!(mean > 0.02, "pressing down on the ball pushes the hand up: {mean} N");
    assert!(summary.depth_max < 0.1 * radius, "penetration {} m of radius {radius} m", summary.depth_max);
    assert_eq!(summary.events.step_refused, 0);
    assert_eq!(summary.events.device_refused, 0);
    assert_eq!(summary.events.faded, 0);
    for row in &records {
        assert!(row.object.is_valid() && row.coupling.is_finite() && row.contact.is_finite(), "{row:?}");
    }
    let last = records.last().expect("rows");
    assert!(last.contact.force.length() < 1e-9, "withdrawn, but {:?}", last.contact);
    let first = records.iter().find(|row| row.contact.force.length() > 1e-6).map(|row| row.time);
    assert!(first.is_some_and(|time| time > 0.1), "the probe starts away from the ball: {first:?}");
    assert_eq!(summary.first_touch_s, first);
    assert_eq!(Some(summary.contacts_max), records.iter().map(|row| row.contacts).max());
    assert_eq!(summary.contacts_at_end, last.contacts);
    let center_of_mass = model("ellipsoid@2000").clod.source.center_of_mass;
    assert_eq!(summary.grasp, center_of_mass);
    let stretch = records.iter().map(|row| row.stretch(center_of_mass)).fold(0.0, f64::max);
    assert!(stretch > 1e-4 && summary.coupling_stretch_max == stretch, "{}", summary.coupling_stretch_max);
    // Real time does not matter here; 2.5 ms suffice for most queries.
    assert!(summary.contact.longer_than_slot.is_some_and(|longer| longer < 2000), "{:?}", summary.contact);
    assert_eq!((summary.haptic.stolen_s, summary.haptic.preempted), (None, None));
}

#[test]
fn free_space_is_quiet() {
    let probe = model("ellipsoid@2000");
    let scene = Scene::new();
    let device = explore::open_device("emulated", &probe, &scene).expect("emulated device");
    let renderer = HapticRenderer::new(probe, scene, device, penalties()).expect("renderer");
    let session = renderer
        .run_lockstep(2.0, ContactTiming::busy(1000.0), &AtomicBool::new(false), |row| {
            assert_eq!(row.contact.force.length(), 0.0);
            Ok::<_, Infallible>(())
        })
        .expect("the sink never fails");
    assert!(session.summary().stages["contact query"].starts_with("off"));
    assert!(session.summary().coupling_force_max < 0.5, "{:?}", session.summary());
    let summary = session.summary();
    assert_eq!((summary.first_touch_s, summary.contacts_max, summary.contacts_at_end), (None, 0, 0));
    let json = serde_json::to_value(&summary).expect("JSON");
    assert!(json["first_touch_s"].is_null() && json["haptic"]["stolen_s"].is_null(), "{json}");
}

#[test]
fn queries_that_take_longer_than_their_slot_are_counted() {
    let ball = model("golf-ball@20000");
    let scene = Scene::new().with(ball.clone(), Pose::IDENTITY);
    // Two balls inside each other: a query takes far longer than its slot of 50 µs.
    let device =
        Box::new(palpate::device::Emulation::default().open(Pose::IDENTITY).expect("emulated device"));
    let settings =
        Settings { timing: TimingSettings { rate: 20_000.0, ..TimingSettings::default() }, ..penalties() };
    let renderer = HapticRenderer::new(ball, scene, device, settings).expect("renderer");
    let sink = |_: &Record| Ok::<_, Infallible>(());
    let session = renderer.run_lockstep(1e-3, ContactTiming::busy(20_000.0), &AtomicBool::new(false), sink);
    let summary = session.expect("the sink never fails").summary();
    assert_eq!(summary.haptic.steps, 20);
    assert!(summary.contact.query_us.p50 > 50.0, "{:?}", summary.contact);
    let longer = summary.contact.longer_than_slot;
    assert!(longer.is_some_and(|longer| (10..=20).contains(&longer)), "{:?}", summary.contact);
}

#[test]
fn a_replayed_probe_follows_its_path() {
    // A kinematic device in free space: the object follows within the deflection of the coupling's spring.
    let probe = model("spoon@5000");
    let folder = tempfile::tempdir().expect("temporary folder");
    let file = folder.path().join("path.csv");
    let mut text = String::from("t,px,py,pz,qx,qy,qz,qw\n");
    for i in 0..=200 {
        let t = f64::from(i) * 0.01;
        let x = 0.02 * (std::f64::consts::TAU * 0.5 * t).sin();
        text.push_str(&format!("{t},{x},0,0,0,0,0,1\n"));
    }
    std::fs::write(&file, text).expect("temporary file");
    let scene = Scene::new();
    let device = explore::open_device(&format!("replay:{}", file.display()), &probe, &scene).expect("replay");
    let settings = Settings { tool: ToolSettings { mass: 0.01, ..ToolSettings::default() }, ..penalties() };
    let renderer = HapticRenderer::new(probe, scene, device, settings).expect("renderer");
    let mut worst: f64 = 0.0;
    renderer
        .run_lockstep(2.0, ContactTiming::busy(1000.0), &AtomicBool::new(false), |row| {
            worst = worst.max((row.device.translation - row.object.translation).length());
            Ok::<_, Infallible>(())
        })
        .expect("the sink never fails");
    assert!(worst < 1e-3, "the object lags {worst} m behind");
}

#[test]
fn a_contact_model_is_in_use_after_its_latency() {
    let probe = model("ellipsoid@500");
    let scene = Scene::new().with(probe.clone(), Pose::from_translation(palpate::glam::DVec3::Z));
    // Rate, latency, and the age of the models in use, in periods, when each comes into use and just before
    // it is replaced.
    for (rate, latency, first, last) in [
        (100.0, 10e-3, 10, 19),
        (100.0, 3e-3, 3, 12),
        (1000.0, 1e-3, 1, 1),
        (1e9, 1e-9, 1, 1),
        (250.0, 0.0, 1, 4),
    ] {
        let device = explore::open_device("emulated", &probe, &scene).expect("emulated device");
        let renderer =
            HapticRenderer::new(probe.clone(), scene.clone(), device, penalties()).expect("renderer");
        let mut ages = Vec::new();
        renderer
            .run_lockstep(0.2, ContactTiming { rate, latency }, &AtomicBool::new(false), |row| {
                ages.push(row.model_age * 1e3);
                Ok::<_, Infallible>(())
            })
            .expect("the sink never fails");
        let cycle = last - first + 1;
        for (step, age) in (1..).zip(&ages) {
            if step < first {
                assert!(age.is_nan(), "{rate} Hz, {latency} s: age {age} at step {step}");
            } else {
                let expected = f64::from(first + (step - first) % cycle);
                assert!((age - expected).abs() < 1e-6, "{rate} Hz, {latency} s: age {age} at step {step}");
            }
        }
    }
}

#[test]
fn a_tolerance_beyond_the_probe_is_refused() {
    let probe = model("ellipsoid@500");
    let scene = Scene::new();
    let device = explore::open_device("emulated", &probe, &scene).expect("emulated device");
    let settings = Settings {
        search: SearchSettings { tolerance: Some(1.0), ..SearchSettings::default() },
        ..penalties()
    };
    let error = HapticRenderer::new(probe, scene, device, settings).err().expect("a metre is no tolerance");
    assert!(error.to_string().starts_with("tolerance is 1;"), "{error}");
}

#[test]
fn bad_settings_are_refused_by_name() {
    for (settings, name) in [
        (Settings { tool: ToolSettings { mass: 0.0, ..ToolSettings::default() }, ..penalties() }, "mass"),
        (
            Settings { tool: ToolSettings { mass: f64::NAN, ..ToolSettings::default() }, ..penalties() },
            "mass",
        ),
        (
            Settings { timing: TimingSettings { rate: 0.0, ..TimingSettings::default() }, ..penalties() },
            "rate",
        ),
        (
            Settings { search: SearchSettings { clusters: 0, ..SearchSettings::default() }, ..penalties() },
            "clusters",
        ),
        (
            Settings { search: SearchSettings { clusters: 17, ..SearchSettings::default() }, ..penalties() },
            "clusters",
        ),
        (
            Settings {
                search: SearchSettings { tolerance: Some(0.0), ..SearchSettings::default() },
                ..penalties()
            },
            "tolerance",
        ),
        (
            Settings {
                coupling: CouplingSettings { stiffness: Some(-1.0), ..CouplingSettings::default() },
                ..penalties()
            },
            "coupling-stiffness",
        ),
    ] {
        let error = settings.check().expect_err(name);
        assert!(error.to_string().starts_with(name), "{error}");
    }
}
