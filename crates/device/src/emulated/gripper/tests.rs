use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

use super::*;
use crate::{EmulatedDevice, HapticDevice};

/// A gripper without rounding, friction or peak.
fn ideal() -> GripperEmulation {
    let handle = GripperHandle { inertia: 1e-5, damping: 1e-3, friction: 0.0 };
    let specification = GripperSpecification {
        peak_torque: f64::INFINITY,
        stiffness: f64::INFINITY,
        damping: f64::INFINITY,
        encoder_step: 0.0,
        handle: Some(handle),
    };
    GripperEmulation { specification, fingers: Fingers::default() }
}

fn opened(gripper: GripperEmulation, path: impl Into<GripperPath>) -> EmulatedDevice {
    let device = Emulation::default().open(Pose::IDENTITY).unwrap();
    device.with_gripper(gripper, path).unwrap()
}

fn refused(gripper: GripperEmulation, path: impl Into<GripperPath>) -> String {
    let device = Emulation::default().open(Pose::IDENTITY).unwrap();
    device.with_gripper(gripper, path).unwrap_err().to_string()
}

#[test]
fn a_constant_torque_deflects_the_fingers_by_torque_over_stiffness() {
    for torque in [0.3, -0.15] {
        let mut device = opened(ideal(), 0.4);
        let gripper = device.gripper().unwrap();
        gripper.write(torque).unwrap();
        let state = (1..=2000).map(|i| gripper.read(f64::from(i) * 1e-3).unwrap()).last().unwrap();
        let deflection = torque / Fingers::default().stiffness;
        assert!((state.angle - 0.4 - deflection).abs() < 1e-9, "{}", state.angle);
        assert_eq!((state.time, state.status), (2.0, Status::OK));
        // The work is stored in the spring, τ²/(2 k), and lost in the dampers: at least twice the energy
        // stored.
        let work = device.emulated_gripper().unwrap().work();
        assert!(work >= 0.99 * torque * deflection && work < 1.01 * torque * deflection, "{work}");
    }
}

/// Gripper and fingers around a fixed angle never give back more energy than they were given, whatever
/// torques are written, and whenever.
#[test]
fn gripper_and_fingers_are_passive() {
    let mut rng = StdRng::seed_from_u64(71);
    for _ in 0..50 {
        let handle = GripperHandle {
            inertia: 10_f64.powf(rng.random_range(-7.0..-3.0)),
            damping: rng.random_range(0.0..1e-3),
            friction: rng.random_range(0.0..1e-2),
        };
        let fingers = Fingers {
            inertia: rng.random_range(0.0..1e-4),
            damping: rng.random_range(0.0..0.02),
            stiffness: rng.random_range(0.0..10.0),
        };
        let specification = GripperSpecification { handle: Some(handle), ..ideal().specification };
        let mut device = opened(GripperEmulation { specification, fingers }, 0.2);
        let mut now = 0.0;
        for _ in 0..500 {
            let gripper = device.gripper().unwrap();
            gripper.write(rng.random_range(-0.5..0.5)).unwrap();
            now += rng.random_range(0.0..5e-3);
            gripper.read(now).unwrap();
            let work = device.emulated_gripper().unwrap().work();
            assert!(work > -1e-12, "gave {work} J");
        }
    }
}

/// A spring of the stated stiffness at 1 kHz, against which the fingers close, gives no more energy than it
/// was given, and comes to rest.
#[test]
fn the_default_gripper_renders_its_stated_stiffness() {
    let emulation = GripperEmulation::default();
    let close = |time: f64| (0.3 * (1.0 - time.min(1.0)), if time < 1.0 { -0.3 } else { 0.0 });
    let mut device = opened(emulation, GripperPath::function(close));
    let (mut lowest, mut highest) = (f64::INFINITY, f64::NEG_INFINITY);
    for i in 0..3000 {
        let gripper = device.gripper().unwrap();
        let state = gripper.read(f64::from(i) * 1e-3).unwrap();
        gripper.write(emulation.specification.stiffness * (0.15 - state.angle).max(0.0)).unwrap();
        if i >= 2700 {
            (lowest, highest) = (lowest.min(state.angle), highest.max(state.angle));
        }
    }
    assert!(highest - lowest <= 2.0 * emulation.specification.encoder_step, "{lowest} to {highest} rad");
    // Springs in series: the fingers at 1.5 N·m/rad towards 0, the wall at 2 N·m/rad towards 0.15.
    assert!((lowest - 0.3 / 3.5).abs() < 2e-3, "{lowest}");
    // The written torque acted against the closing fingers.
    assert!(device.emulated_gripper().unwrap().work() < 0.0);
}

#[test]
fn angles_are_rounded_and_torques_clipped_and_refused() {
    let mut device = opened(GripperEmulation::default(), 0.123_456);
    let gripper = device.gripper().unwrap();
    assert!((gripper.read(0.0).unwrap().angle - 0.1235).abs() < 1e-12);
    for (written, status, applied) in [
        (0.1, Status::OK, 0.1),
        (-3.0, Status::TORQUE_CLIPPED, -0.5),
        (f64::NAN, Status::WRENCH_REFUSED, 0.0),
        (f64::NEG_INFINITY, Status::WRENCH_REFUSED, 0.0),
    ] {
        let gripper = device.gripper().unwrap();
        gripper.write(written).unwrap();
        assert_eq!(gripper.read(0.001).unwrap().status, status, "{written}");
        assert_eq!(device.emulated_gripper().unwrap().applied_torque(), applied);
    }
}

#[test]
fn a_gripper_follows_its_path_and_reports_its_end() {
    let path = AnglePath::new(&[(0.0, 0.6), (0.5, 0.6), (1.0, 0.1)]).unwrap();
    let mut device = opened(ideal(), path);
    let gripper = device.gripper().unwrap();
    let states: Vec<_> = (0..=1500).map(|i| gripper.read(f64::from(i) * 1e-3).unwrap()).collect();
    assert_eq!((states[0].angle, states[0].status), (0.6, Status::OK));
    assert!((states[500].angle - 0.6).abs() < 1e-3 && (states[1500].angle - 0.1).abs() < 1e-3);
    assert!(states[1500].status.contains(Status::ENDED));
}

#[test]
fn a_delayed_torque_acts_as_the_same_torque_later() {
    let late = |delay: f64, written: u32| {
        let mut emulation = Emulation::default();
        emulation.specification.delay = delay;
        let device = emulation.open(Pose::IDENTITY).unwrap();
        let mut device = device.with_gripper(ideal(), 0.0).unwrap();
        let gripper = device.gripper().unwrap();
        for i in 0..50 {
            gripper.read(f64::from(i) * 1e-3).unwrap();
            gripper.write(if i >= written { 0.2 } else { 0.0 }).unwrap();
        }
        gripper.read(0.05).unwrap().angle
    };
    assert_eq!(late(5e-3, 10), late(0.0, 15));
}

#[test]
fn clocks_that_run_back_hold_the_state_and_gaps_are_reported() {
    let mut device = opened(ideal(), 0.0);
    let gripper = device.gripper().unwrap();
    gripper.write(0.1).unwrap();
    let state = gripper.read(0.01).unwrap();
    for now in [0.005, f64::NAN, f64::INFINITY] {
        let again = gripper.read(now).unwrap();
        assert_eq!((again.angle, again.time), (state.angle, state.time));
        assert_eq!(again.status, Status::CLOCK);
    }
    assert!(gripper.read(10.0).unwrap().status.contains(Status::GAP));
}

#[test]
fn closing_the_device_ends_the_gripper() {
    let mut device = opened(ideal(), 0.0);
    device.gripper().unwrap().write(0.1).unwrap();
    device.close().unwrap();
    assert_eq!(device.emulated_gripper().unwrap().applied_torque(), 0.0);
    let gripper = device.gripper().unwrap();
    assert!(matches!(gripper.read(0.1), Err(DeviceError::Closed)));
    assert!(matches!(gripper.write(0.1), Err(DeviceError::Closed)));
}

#[test]
fn a_device_opened_without_a_gripper_has_none() {
    assert!(Emulation::default().open(Pose::IDENTITY).unwrap().gripper().is_none());
}

#[test]
fn the_handle_moves_the_same_with_and_without_a_gripper() {
    let end = |mut device: EmulatedDevice| {
        device.write(&palpate_core::Wrench::new(DVec3::X, DVec3::Z * 0.01)).unwrap();
        (1..100).map(|i| device.read(f64::from(i) * 1e-3).unwrap()).last()
    };
    let without = Emulation::default().open(Pose::IDENTITY).unwrap();
    assert_eq!(end(opened(ideal(), 0.3)), end(without));
}

#[test]
fn wrong_parameters_are_refused_by_name() {
    let changed = |change: &dyn Fn(&mut GripperEmulation)| {
        let mut emulation = ideal();
        change(&mut emulation);
        emulation
    };
    for (emulation, expected) in [
        (changed(&|e| e.fingers.stiffness = -1.0), "finger stiffness (N·m/rad) is -1"),
        (changed(&|e| e.fingers.damping = f64::NAN), "finger damping"),
        (changed(&|e| e.specification.peak_torque = f64::NAN), "gripper peak torque"),
        (changed(&|e| e.specification.encoder_step = -1.0), "gripper encoder step"),
        (
            changed(&|e| (e.specification.handle, e.fingers) = (None, Fingers::NONE)),
            "inertia of gripper and fingers",
        ),
    ] {
        let error = refused(emulation, 0.0);
        assert!(error.contains(expected), "{error}");
    }
    assert!(refused(ideal(), f64::NAN).contains("gripper angle (rad) is NaN"));
    assert!(refused(ideal(), 30.0).contains("gripper angle (rad) is 30"));
}
