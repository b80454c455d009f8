//! Recordings of devices: both file formats, and replay.

use std::path::Path;

use glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist, Wrench};
use palpate_device::hid::WoodenHapticsModel;
use palpate_device::link::{FakeWire, Link};
use palpate_device::{
    DeviceError, DeviceState, Emulation, HapticDevice, IntendedPath, Reading, RecordedDevice, Recording,
    RecordingWriter, Status, Tap,
};
use rand::rngs::StdRng;
use rand::{Rng as _, RngExt as _, SeedableRng as _};

/// A second of a tapped emulated device that is waved about.
fn waved() -> Recording {
    let wave = |t: f64| {
        let place = DVec3::new((9.0 * t).sin(), (7.0 * t).cos(), t) * 0.03;
        (Pose::new(place, DQuat::from_rotation_x((5.0 * t).sin())), Twist::ZERO)
    };
    let device = Emulation::default().open(IntendedPath::function(wave)).unwrap();
    let (mut tap, mut taps) = Tap::new(device);
    let mut readings = Vec::new();
    for i in 0..1000 {
        let now = f64::from(i) * 1e-3;
        let state = tap.read(now).unwrap();
        tap.write(&Wrench::new(DVec3::X * (20.0 * now).sin(), DVec3::ZERO)).unwrap();
        let reading = taps.take().unwrap();
        assert_eq!(reading, Reading { now, state });
        readings.push(reading);
    }
    assert!(taps.take().is_none() && taps.lost() == 0);
    Recording::new(tap.specification().clone(), readings).unwrap()
}

#[test]
fn both_forms_of_files_give_every_bit_back() {
    let folder = tempfile::tempdir().unwrap();
    let mut recording = waved();
    // Infinite limits and unsensed axes are kept.
    recording.specification.stiffness = f64::INFINITY;
    recording.specification.handle = None;
    for name in ["device.csv", "device.dev"] {
        let file = folder.path().join(name);
        recording.save(&file).unwrap();
        assert_eq!(Recording::load(&file).unwrap(), recording, "{name}");
        // The session ended in the middle of a reading.
        let bytes = std::fs::read(&file).unwrap();
        let cut = Recording::parse(&bytes[..bytes.len() - 7], Path::new(name)).unwrap();
        assert_eq!(cut.readings(), &recording.readings()[..999], "{name}");
        let mut device = palpate_device::open(&format!("replay:{}", file.display())).unwrap();
        assert_eq!(device.specification(), &recording.specification);
        assert_eq!(device.read(0.5).unwrap(), recording.readings()[500].state);
    }
}

#[test]
fn numbers_of_any_bits_come_back() {
    let mut rng = StdRng::seed_from_u64(81);
    let specification = Emulation::default().specification;
    let mut now = 0.0;
    let readings: Vec<Reading> = (0..2000)
        .map(|_| {
            now += f64::from_bits(rng.random_range(1.0_f64.to_bits()..2.0_f64.to_bits())) * 1e-3;
            let mut number = || {
                let exponent = rng.random_range(-300..300);
                rng.random_range(-1.0..1.0) * 2_f64.powi(exponent)
            };
            let mut vector = || DVec3::new(number(), number(), number());
            let (translation, linear, angular) = (vector(), vector(), vector());
            let turn = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-2.0..2.0)));
            let pose = Pose { translation, rotation: DQuat::from_scaled_axis(turn) };
            let twist = Twist::new(linear, angular);
            let state = DeviceState { time: now, pose, twist, buttons: rng.random(), status: Status::GAP };
            Reading { now, state }
        })
        .collect();
    let recording = Recording::new(specification, readings).unwrap();
    for text in [false, true] {
        let mut bytes = Vec::new();
        let mut writer = RecordingWriter::new(&mut bytes, &recording.specification, text).unwrap();
        recording.readings().iter().for_each(|reading| writer.write(reading).unwrap());
        writer.finish().unwrap();
        assert_eq!(Recording::parse(&bytes, Path::new("some")).unwrap(), recording);
    }
}

#[test]
fn a_replayed_device_gives_the_recorded_readings() {
    let recording = waved();
    let mut device = RecordedDevice::new(recording.clone());
    for Reading { now, state } in recording.readings() {
        assert_eq!(device.read(*now).unwrap(), *state);
        device.write(&Wrench::new(DVec3::NAN, DVec3::ZERO)).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(device.applied_wrench(), Wrench::ZERO);
        // Reported at the next reading, as with any device; here that is the same one.
        assert!(device.read(*now).unwrap().status.contains(Status::WRENCH_REFUSED));
    }
    let state = device.read(7.0).unwrap();
    assert!(state.status.contains(Status::ENDED) && state.twist == Twist::ZERO);
    assert_eq!(state.pose, recording.readings()[999].state.pose);
}

/// A host's clock may count since 1970. The recording of such a session plays from its beginning, in both
/// forms of files; otherwise it would stand still for half a century.
#[test]
fn a_recording_by_a_clock_since_1970_plays_from_its_beginning() {
    let plain = waved();
    let first = 1_767_225_600.0;
    let stamped: Vec<Reading> = plain
        .readings()
        .iter()
        .map(|reading| {
            let time = first + reading.state.time;
            Reading { now: first + reading.now, state: DeviceState { time, ..reading.state } }
        })
        .collect();
    let mut bytes = Vec::new();
    let mut writer = RecordingWriter::new(&mut bytes, &plain.specification, false).unwrap();
    stamped.iter().for_each(|reading| writer.write(reading).unwrap());
    writer.finish().unwrap();
    let made = Recording::new(plain.specification.clone(), stamped).unwrap();
    assert_eq!(Recording::parse(&bytes, Path::new("some")).unwrap(), made);
    let mut device = RecordedDevice::new(made);
    for Reading { now, state } in plain.readings() {
        let played = device.read(*now).unwrap();
        // Numbers of 64 bits have 2.4e-7 s for such a clock; the fastest motion here is 0.5 m/s.
        assert!((played.time - state.time).abs() < 5e-7, "{} s for {} s", played.time, state.time);
        assert!(played.pose.translation.distance(state.pose.translation) < 3e-7, "{now} s");
        assert!(!played.status.contains(Status::ENDED));
    }
}

#[test]
fn it_is_played_from_anywhere_at_any_speed() {
    let recording = waved();
    let mut device = RecordedDevice::new(recording.clone()).at(0.5, 0.3).unwrap();
    for i in 0..400 {
        let state = device.read(f64::from(i) * 1e-3).unwrap();
        // Half of the times lie between two readings.
        let (index, between) = (300 + i as usize / 2, i % 2 == 1);
        let [from, to] = [index, index + 1].map(|index| recording.readings()[index].state);
        let expected =
            if between { from.pose.translation.midpoint(to.pose.translation) } else { from.pose.translation };
        assert!(state.pose.translation.distance(expected) < 4e-5, "{i}");
        assert!(state.time <= f64::from(i) * 1e-3 + 1e-9 && state.pose.is_valid());
        let slow = from.twist.linear.lerp(to.twist.linear, if between { 0.5 } else { 0.0 }) * 0.5;
        assert!(state.twist.linear.distance(slow) < 5e-3, "{i}: {} {slow}", state.twist.linear);
    }
    for (speed, start) in [(0.0, 0.0), (f64::NAN, 0.0), (1e4, 0.0), (1.0, f64::INFINITY)] {
        let refused = RecordedDevice::new(recording.clone()).at(speed, start);
        assert!(matches!(refused, Err(DeviceError::Parameter { .. })), "{speed} {start}");
    }
}

#[test]
fn a_lost_device_is_played_lost() {
    let wire = FakeWire::new();
    let other = wire.clone();
    let link = Link::wooden_haptics("unit", WoodenHapticsModel::WOODEN_HAPTICS);
    let (mut pump, device) = link.split(move || Some(Box::new(other.open()?)));
    let (mut tap, mut taps) = Tap::new(device);
    let mut read = Vec::new();
    for i in 0..60_i16 {
        let now = f64::from(i) * 1e-3;
        if i == 30 {
            wire.unplug();
        }
        let words = [i, 1333, 2547, 0, 0, 0, 0];
        wire.send(&words.into_iter().flat_map(i16::to_le_bytes).collect::<Vec<_>>());
        pump.round(now);
        read.push((now, tap.read(now).map_err(|error| error.to_string())));
    }
    assert!(read[29].1.is_ok() && read[31].1.is_err());
    let readings = std::iter::from_fn(|| taps.take()).collect();
    let mut device = RecordedDevice::new(Recording::new(tap.specification().clone(), readings).unwrap());
    for (now, read) in read {
        assert_eq!(device.read(now).map_err(|error| error.to_string()), read, "{now}");
        assert_eq!(device.write(&Wrench::ZERO).is_ok(), read.is_ok());
    }
}

#[test]
fn faults_in_files_are_reported_with_their_place() {
    let recording = waved();
    let written = |text: bool| {
        let mut bytes = Vec::new();
        let mut writer = RecordingWriter::new(&mut bytes, &recording.specification, text).unwrap();
        recording.readings()[..5].iter().for_each(|reading| writer.write(reading).unwrap());
        writer.finish().unwrap();
        bytes
    };
    let text = String::from_utf8(written(true)).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    let check = |bytes: &[u8], parts: &[&str]| {
        let error = Recording::parse(bytes, Path::new("some.csv")).unwrap_err().to_string();
        assert!(parts.iter().all(|part| error.contains(part)), "{error}");
    };
    let joined = |lines: &[&str]| lines.join("\n") + "\n";
    check(b"", &["some.csv:1", "description"]);
    check(joined(&lines[1..]).as_bytes(), &["some.csv:1"]);
    check(joined(&lines[..1]).as_bytes(), &["some.csv:2", "header"]);
    check(joined(&lines[..2]).as_bytes(), &["no sample"]);
    check(joined(&[lines[0], lines[1], lines[4], lines[3]]).as_bytes(), &["some.csv:4", "runs back"]);
    check(joined(&[lines[0], lines[1], "1,2,3"]).as_bytes(), &["some.csv:3", "missing"]);
    check(joined(&[lines[0], lines[1], &lines[2].replace(",0,0", ",0,0,0")]).as_bytes(), &["some.csv:3"]);
    check(joined(&[lines[0], lines[1], &lines[2].replacen("0,0,", "0,NaN,", 1)]).as_bytes(), &["not finite"]);
    let mut compact = written(false);
    check(&compact[..20], &["description"]);
    let end = compact.len();
    compact[end - 128..end - 120].copy_from_slice(&f64::NAN.to_le_bytes());
    check(&compact, &["some.csv:5", "readings"]);
    // Arbitrary bytes.
    let mut rng = StdRng::seed_from_u64(82);
    let good = [written(false), written(true)];
    for i in 0..20_000 {
        let mut bytes = good[i % 2].clone();
        for _ in 0..rng.random_range(1..8) {
            let at = rng.random_range(0..bytes.len());
            bytes[at] = (rng.next_u32() >> 8) as u8;
        }
        bytes.truncate(rng.random_range(0..=bytes.len()));
        if let Ok(recording) = Recording::parse(&bytes, Path::new("some")) {
            let mut device = RecordedDevice::new(recording);
            for now in [0.0, 0.0005, 0.002, 1e3] {
                if let Ok(state) = device.read(now) {
                    assert!(state.pose.is_valid() && state.twist.is_finite());
                }
            }
        }
    }
}
