//! Reading and writing a device allocates nothing.

use allocation_counter::measure;
use glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist, Wrench};
use palpate_device::hid::WoodenHapticsModel;
use palpate_device::link::{FakeWire, Link};
use palpate_device::{
    AnglePath, EmulatedDevice, Emulation, GripperEmulation, HapticDevice, HoldToEnable, IntendedPath,
    Interpolation, Keyframe, MotionPath, Reading, RecordedDevice, Recording, ReplayDevice, Tap,
};

fn path() -> MotionPath {
    let keyframes = (0..100)
        .map(|i| {
            let a = 0.1 * f64::from(i);
            Keyframe {
                time: a,
                pose: Pose::new(DVec3::new(a.sin(), 0.0, 0.1) * 0.1, DQuat::from_rotation_y(a)),
            }
        })
        .collect();
    MotionPath::new(keyframes, Interpolation::Smooth).unwrap()
}

#[test]
fn reading_and_writing_allocate_nothing() {
    let circle = |t: f64| (Pose::from_translation(DVec3::new(t.cos(), t.sin(), 0.0) * 0.1), Twist::ZERO);
    let mut recorded = Emulation::default().open(path()).unwrap();
    let readings = (0..5000).map(|i| {
        let now = f64::from(i) * 1e-3;
        Reading { now, state: recorded.read(now).unwrap() }
    });
    let readings = readings.collect();
    let recording = Recording::new(recorded.specification().clone(), readings).unwrap();
    let tapped = Emulation::default().open(path()).unwrap();
    let angles = || AnglePath::new(&[(0.0, 0.6), (4.0, 0.1)]).unwrap();
    let gripper =
        |device: EmulatedDevice| device.with_gripper(GripperEmulation::default(), angles()).unwrap();
    let devices: [Box<dyn HapticDevice>; 7] = [
        Box::new(gripper(Emulation::default().open(Pose::IDENTITY).unwrap())),
        Box::new(Emulation::preset("omega").unwrap().open(path()).unwrap()),
        Box::new(Emulation::default().open(IntendedPath::function(circle)).unwrap()),
        Box::new(ReplayDevice::new("path", path())),
        Box::new(RecordedDevice::new(recording)),
        Box::new(HoldToEnable::new(gripper(Emulation::default().open(path()).unwrap()), 0)),
        // Nothing takes its readings: most are lost.
        Box::new(Tap::new(tapped).0),
    ];
    for mut device in devices {
        let mut moved = 0.0;
        let counted = measure(|| {
            for i in 0..12_000 {
                // Every event too: a clock that runs back, a gap, a clipped and a refused wrench, the path's
                // end.
                let now = match i % 1000 {
                    998 => f64::NAN,
                    999 => 0.0,
                    _ => f64::from(i) * 0.001 + f64::from(i / 5000) * 0.5,
                };
                let state = device.read(now).unwrap();
                moved += state.twist.linear.length();
                let force = if i % 777 == 0 { DVec3::NAN } else { state.pose.translation * -1e3 };
                device.write(&Wrench::new(force, DVec3::X)).unwrap();
                if let Some(gripper) = device.gripper() {
                    let angle = gripper.read(now).unwrap().angle;
                    gripper.write(if i % 777 == 0 { f64::NAN } else { -1.5 * angle }).unwrap();
                }
            }
        });
        assert_eq!(counted.count_total, 0, "{} ({moved})", device.specification().name);
    }
    assert_eq!(measure(|| drop(std::hint::black_box(Box::new(1)))).count_total, 1, "the counter counts");
}

/// A device that comes and goes: the haptic thread's side of the link.
#[test]
fn a_linked_device_allocates_nothing() {
    let wire = FakeWire::new();
    let other = wire.clone();
    let link = Link::wooden_haptics("unit", WoodenHapticsModel::POLHEM);
    let (mut pump, mut device) = link.split(move || Some(Box::new(other.open()?)));
    let (mut counted, mut read, mut lost) = (0, 0, 0);
    for i in 0..4000_i16 {
        match i % 1000 {
            300 => wire.unplug(),
            400 => wire.plug_in(),
            _ => {}
        }
        let report = [i % 700, 900, -1800, i % 300, 5, 6, 0].into_iter().flat_map(i16::to_le_bytes);
        wire.send(&report.take(if i % 50 == 0 { 3 } else { 14 }).collect::<Vec<_>>());
        let now = f64::from(i) * 1e-3;
        pump.round(now);
        counted += measure(|| {
            let state = device.read(now);
            if state.is_ok() {
                read += 1
            } else {
                lost += 1
            }
            let force = if i % 77 == 0 { DVec3::NAN } else { DVec3::X * f64::from(i % 9) };
            let _ = device.write(&Wrench::new(force, DVec3::X));
        })
        .count_total;
    }
    assert!(read > 1000 && lost > 300, "{read} {lost}");
    assert_eq!(counted, 0);
}
