use glam::{DQuat, DVec3};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

use super::parameters::MAX_DELAY;
use super::*;
use crate::mechanics::Handle;
use crate::{Interpolation, Keyframe, MotionPath};

/// An emulation without rounding, friction or delay.
fn ideal(hand: Hand) -> Emulation {
    let mut emulation = Emulation { hand, ..Emulation::default() };
    emulation.specification.encoder_step = 0.0;
    emulation.specification.angular_encoder_step = 0.0;
    emulation.specification.velocity_delay = 0.0;
    emulation.handle.friction = 0.0;
    emulation.handle.angular_friction = 0.0;
    emulation
}

fn pose(position: DVec3, turn: DVec3) -> Pose {
    Pose::new(position, DQuat::from_scaled_axis(turn))
}

fn run(device: &mut EmulatedDevice, seconds: f64) -> DeviceState {
    let start = device.now;
    let count = (seconds * 1000.0).round() as u32;
    let mut state = device.read(start).unwrap();
    for i in 1..=count {
        state = device.read(start + f64::from(i) * 0.001).unwrap();
    }
    state
}

#[test]
fn the_handle_comes_to_where_the_hand_means_it_to_be() {
    let (rest, goal) =
        (pose(DVec3::ZERO, DVec3::ZERO), pose(DVec3::new(0.02, -0.03, 0.01), DVec3::new(0.4, 1.0, -0.3)));
    let keyframes = vec![
        Keyframe { time: 0.0, pose: rest },
        Keyframe { time: 0.1, pose: rest },
        Keyframe { time: 0.4, pose: goal },
    ];
    for (name, hand) in Hand::PRESETS {
        let mut device = Emulation { hand, ..ideal(hand) }
            .open(MotionPath::new(keyframes.clone(), Interpolation::Smooth).unwrap())
            .unwrap();
        let state = run(&mut device, 3.0);
        let (distance, angle) = (
            (state.pose.translation - goal.translation).length(),
            state.pose.rotation_vector_to(&goal).length(),
        );
        if name == "none" {
            assert_eq!(state.pose, rest, "a handle that nobody holds stays");
        } else {
            assert!(distance < 1e-5 && angle < 1e-4, "{name}: {distance} m, {angle} rad");
            assert!(state.twist.linear.length() < 1e-4 && state.status.contains(Status::ENDED));
        }
    }
}

/// With friction, the handle stops where the hand's spring no longer overcomes it.
#[test]
fn a_hand_lets_go_and_another_takes_hold() {
    let mut device = ideal(Hand::GRIP).open(Pose::IDENTITY).unwrap();
    device.write(&Wrench::new(DVec3::X * 0.3, DVec3::ZERO)).unwrap();
    let held = run(&mut device, 2.0).pose.translation.x;
    assert!((held - 0.3 / Hand::GRIP.stiffness).abs() < 1e-6, "{held} m");
    device.hold_with(Hand::NONE).unwrap();
    let gone = run(&mut device, 1.0).pose.translation.x;
    assert!(gone > 0.1, "let go, the handle is pushed away: {gone} m");
    let refused = device.hold_with(Hand { stiffness: -1.0, ..Hand::FIRM });
    assert!(matches!(refused, Err(DeviceError::Parameter { .. })), "{refused:?}");
    assert_eq!(device.emulation().hand, Hand::NONE);
    device.hold_with(Hand::FIRM).unwrap();
    let firm = run(&mut device, 2.0).pose.translation.x;
    assert!((firm - 0.3 / Hand::FIRM.stiffness).abs() < 1e-6, "{firm} m");
}

#[test]
fn friction_stops_the_handle_short_by_at_most_friction_over_stiffness() {
    let emulation = Emulation::default();
    let goal = DVec3::new(0.01, 0.0, 0.0);
    let bound = emulation.handle.friction / emulation.hand.stiffness;
    let keyframes = [(0.0, DVec3::ZERO), (1.0, goal)]
        .map(|(time, position)| Keyframe { time, pose: Pose::from_translation(position) });
    let path = MotionPath::new(keyframes.to_vec(), Interpolation::Linear).unwrap();
    let mut device = emulation.open(path).unwrap();
    run(&mut device, 3.0);
    let (pose, twist) = device.handle();
    assert_eq!(twist, Twist::ZERO, "at rest exactly");
    let short = (pose.translation - goal).length();
    assert!(short > 0.0 && short <= bound * (1.0 + 1e-9), "{short} m of {bound} m");
}

#[test]
fn force_moves_the_handle_only_above_friction() {
    let open = || Emulation { hand: Hand::NONE, ..Emulation::default() }.open(Pose::IDENTITY).unwrap();
    let Handle { friction, angular_friction, .. } = Emulation::default().handle;
    let direction = DVec3::new(1.0, -2.0, 2.0) / 3.0;
    let mut device = open();
    device
        .write(&Wrench::new(direction * (0.999 * friction), direction * (0.999 * angular_friction)))
        .unwrap();
    let state = run(&mut device, 1.0);
    assert_eq!((device.handle(), state.twist), ((Pose::IDENTITY, Twist::ZERO), Twist::ZERO));
    let mut device = open();
    device.write(&Wrench::new(direction * (1.1 * friction), direction * (1.1 * angular_friction))).unwrap();
    run(&mut device, 1.0);
    let (pose, twist) = device.handle();
    assert!(pose.translation.dot(direction) > 1e-4 && twist.angular.dot(direction) > 1e-3);
}

#[test]
fn a_constant_wrench_displaces_the_hand_by_wrench_over_stiffness() {
    let mut device = ideal(Hand::GRIP).open(Pose::IDENTITY).unwrap();
    device.write(&Wrench::new(DVec3::X * 1.2, DVec3::Y * 0.1)).unwrap();
    let state = run(&mut device, 4.0);
    let expected = pose(DVec3::X * (1.2 / 300.0), DVec3::Y * 0.1);
    assert!((state.pose.translation - expected.translation).length() < 1e-8);
    assert!(state.pose.rotation_vector_to(&expected).length() < 1e-6);
    // The work is stored in the hand's springs and lost in the dampers: at least twice the energy stored.
    assert!(device.work() > 1.2 * 0.004 * 0.99 && device.work() < (1.2 * 0.004 + 0.1 * 0.1) * 1.01);
}

/// A stiff unilateral wall at z = 0, rendered at 1 kHz from readings. Gives the largest energy that the wall
/// returned, and the largest depths in the first and in the last tenth of 3 s.
fn press_into_wall(emulation: Emulation, stiffness: f64, damping: f64) -> (f64, f64, f64) {
    let keyframes = [(0.0, 0.005), (0.2, -0.01)]
        .map(|(time, z)| Keyframe { time, pose: Pose::from_translation(DVec3::Z * z) });
    let path = MotionPath::new(keyframes.to_vec(), Interpolation::Smooth).unwrap();
    let mut device = emulation.open(path).unwrap();
    let (mut given, mut early, mut low, mut high) = (0.0_f64, 0.0_f64, f64::INFINITY, f64::NEG_INFINITY);
    for i in 0..3000 {
        let state = device.read(f64::from(i) * 0.001).unwrap();
        let depth = -state.pose.translation.z;
        let force =
            if depth > 0.0 { (stiffness * depth - damping * state.twist.linear.z).max(0.0) } else { 0.0 };
        device.write(&Wrench::new(DVec3::Z * force, DVec3::ZERO)).unwrap();
        given = given.max(device.work());
        let depth = -device.handle().0.translation.z;
        if i < 600 {
            early = early.max(depth);
        }
        if i >= 2700 {
            (low, high) = (low.min(depth), high.max(depth));
        }
    }
    (given, early, high - low)
}

#[test]
fn a_stiff_wall_is_stable_and_gives_no_energy() {
    let emulation = Emulation::default();
    let stiffness = emulation.specification.stiffness;
    let (given, deepest, wander) = press_into_wall(emulation, stiffness, 1.0);
    // A spring pressed to the depth reached stores this much; sampling may give back a small part more than
    // it took.
    let stored = 0.5 * stiffness * deepest * deepest;
    assert!(deepest > 5e-4, "the wall was pressed: {deepest}");
    assert!(given < 0.02 * stored, "the wall gave {given} J of {stored} J");
    assert!(wander < 3e-5, "the handle wanders over {wander} m at the end");
}

/// The counter-check: far beyond what the damping allows at 1 kHz, the emulated wall buzzes as a real one
/// does.
#[test]
fn a_wall_far_too_stiff_buzzes() {
    let (given, _, wander) = press_into_wall(Emulation::default(), 60_000.0, 0.0);
    assert!(wander > 1e-4 && given > 1e-3, "{wander} m, {given} J");
}

/// Each preset, in the default hand, renders the stiffness and damping that it states.
#[test]
fn presets_render_their_own_ceilings() {
    for (name, _) in Emulation::presets() {
        let emulation = Emulation::preset(name).unwrap();
        let specification = emulation.specification.clone();
        let goal = pose(DVec3::new(0.004, -0.002, 0.003), DVec3::new(0.02, 0.03, -0.02));
        let path = [(0.0, Pose::IDENTITY), (0.1, goal)].map(|(time, pose)| Keyframe { time, pose });
        let mut device =
            emulation.open(MotionPath::new(path.to_vec(), Interpolation::Linear).unwrap()).unwrap();
        let (mut linear, mut angular) = (0.0_f64, 0.0_f64);
        for i in 0..3000 {
            let state = device.read(f64::from(i) * 0.001).unwrap();
            let turn = state.pose.rotation_vector_to(&Pose::IDENTITY);
            let force = state.pose.translation * -specification.stiffness
                - state.twist.linear * specification.damping;
            let torque =
                turn * specification.angular_stiffness - state.twist.angular * specification.angular_damping;
            device.write(&Wrench::new(force, torque)).unwrap();
            if i > 2500 {
                let (_, twist) = device.handle();
                linear = linear.max(twist.linear.length());
                angular = angular.max(twist.angular.length());
            }
        }
        assert!(linear < 1e-3 && angular < 1e-2, "{name} still moves at {linear} m/s, {angular} rad/s");
        assert!(device.handle().0.translation.length() > 5e-5, "{name} was pressed");
    }
}

/// A run with a wrench that depends on the state, written at every millisecond; read `between` times inside
/// each.
fn trace(between: &dyn Fn(u32) -> u32) -> Vec<DeviceState> {
    let keyframes = (0..20)
        .map(|i| {
            let a = f64::from(i);
            Keyframe {
                time: 0.03 * a,
                pose: pose(DVec3::new(a.sin(), a.cos(), 0.1 * a) * 0.02, DVec3::new(0.1, a.sin(), 0.0)),
            }
        })
        .collect();
    let mut device =
        Emulation::default().open(MotionPath::new(keyframes, Interpolation::Smooth).unwrap()).unwrap();
    (0..500)
        .map(|i| {
            let pieces = between(i);
            for piece in 1..=pieces {
                device.read((f64::from(i * 10) + f64::from(10 * piece / pieces)) * 1e-4).unwrap();
            }
            let state = device.read(f64::from(i + 1) * 1e-3).unwrap();
            let force = state.pose.translation * -200.0;
            device.write(&Wrench::new(force, state.twist.angular * -0.001)).unwrap();
            state
        })
        .collect()
}

#[test]
fn runs_are_equal_bit_for_bit_however_time_is_cut() {
    let whole = trace(&|_| 1);
    assert!(whole.iter().any(|state| state.twist.linear.length() > 0.01), "something moves");
    assert_eq!(whole, trace(&|_| 1));
    assert_eq!(whole, trace(&|_| 10));
    assert_eq!(whole, trace(&|i| 1 + i % 10));
}

#[test]
fn reads_between_substeps_advance_whole_substeps() {
    let mut device = Emulation::default().open(Pose::IDENTITY).unwrap();
    let state = device.read(0.000_25).unwrap();
    assert!((state.time - 0.0002).abs() < 1e-15);
    assert_eq!(device.read(0.000_299).unwrap().time, state.time);
    assert!((device.read(0.0003).unwrap().time - 0.0003).abs() < 1e-15);
}

#[test]
fn readings_are_rounded_to_the_encoder_steps() {
    let mut device =
        Emulation::preset("touch").unwrap().open(Pose::from_translation(DVec3::splat(0.0101))).unwrap();
    device.write(&Wrench::new(DVec3::X, DVec3::ZERO)).unwrap();
    let step = device.specification().encoder_step;
    for i in 0..200 {
        let state = device.read(f64::from(i) * 0.001).unwrap();
        let (handle, _) = device.handle();
        for (read, truth) in state.pose.translation.to_array().into_iter().zip(handle.translation.to_array())
        {
            assert!(((read / step) - (read / step).round()).abs() < 1e-9);
            assert!((read - truth).abs() <= 0.5 * step * (1.0 + 1e-9));
        }
    }
}

#[test]
fn wrenches_are_clipped_to_the_peaks_and_to_the_actuated_axes() {
    let mut device = Emulation::default().open(Pose::IDENTITY).unwrap();
    let direction = DVec3::new(1.0, 2.0, -2.0) / 3.0;
    for size in [9.0, 1e3, 1e300] {
        device.write(&Wrench::new(direction * size, direction * size)).unwrap();
        let applied = device.applied_wrench();
        assert!((applied.force - direction * 8.5).length() < 1e-12, "{size}");
        assert!((applied.torque - direction * 0.188).length() < 1e-12, "{size}");
        let status = device.read(device.now + 0.001).unwrap().status;
        assert_eq!(status, Status::FORCE_CLIPPED | Status::TORQUE_CLIPPED);
    }
    let gentle = Wrench::new(direction * 8.4, direction * 0.18);
    device.write(&gentle).unwrap();
    assert_eq!((device.applied_wrench(), device.read(device.now).unwrap().status), (gentle, Status::OK));

    let mut touch = Emulation::preset("touch").unwrap().open(Pose::IDENTITY).unwrap();
    touch.write(&Wrench::new(DVec3::X, DVec3::ONE)).unwrap();
    assert_eq!(touch.applied_wrench(), Wrench::new(DVec3::X, DVec3::ZERO));
    assert_eq!(touch.read(0.001).unwrap().status, Status::OK, "a missing axis is no clipping");
}

#[test]
fn wrenches_that_are_not_finite_become_zero_and_are_flagged_once() {
    let mut device = Emulation::default().open(Pose::IDENTITY).unwrap();
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for wrench in
            [Wrench::new(DVec3::X * bad, DVec3::ZERO), Wrench::new(DVec3::ONE, DVec3::new(0.0, 0.0, bad))]
        {
            device.write(&Wrench::new(DVec3::X, DVec3::ZERO)).unwrap();
            device.write(&wrench).unwrap();
            assert_eq!(device.applied_wrench(), Wrench::ZERO);
            assert_eq!(device.read(device.now + 0.001).unwrap().status, Status::WRENCH_REFUSED);
            assert_eq!(device.read(device.now).unwrap().status, Status::OK);
        }
    }
}

#[test]
fn hostile_clocks_and_wrenches_never_give_a_pose_that_is_not_finite() {
    let mut rng = StdRng::seed_from_u64(41);
    let clocks = [f64::NAN, f64::INFINITY, -1.0, 0.0, 1e300, 1e-300];
    let sizes = [0.0, 1.0, 1e10, f64::MAX, f64::MIN_POSITIVE, f64::NAN, f64::INFINITY];
    for _ in 0..50 {
        let mut device = Emulation { catch_up: 0.01, ..Emulation::default() }.open(Pose::IDENTITY).unwrap();
        let mut now = 0.0;
        for _ in 0..100 {
            now += rng.random_range(0.0..0.02);
            let asked = if rng.random_bool(0.2) { clocks[rng.random_range(0..clocks.len())] } else { now };
            let state = device.read(asked).unwrap();
            assert!(state.pose.is_valid() && state.twist.is_finite() && state.time.is_finite());
            let mut number = || sizes[rng.random_range(0..sizes.len())] * rng.random_range(-1.0..1.0);
            let wrench = Wrench::new(
                DVec3::new(number(), number(), number()),
                DVec3::new(number(), number(), number()),
            );
            device.write(&wrench).unwrap();
            assert!(device.applied_wrench().force.length() <= 8.5 * (1.0 + 1e-12));
        }
    }
}

#[test]
fn a_clock_that_runs_back_holds_the_state() {
    let mut device = Emulation::default().open(Pose::from_translation(DVec3::X * 0.01)).unwrap();
    let before = device.read(0.02).unwrap();
    for now in [0.01, -5.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let state = device.read(now).unwrap();
        assert_eq!(state, DeviceState { status: Status::CLOCK, ..before });
    }
    assert_eq!(device.read(0.021).unwrap().status, Status::OK);
}

#[test]
fn a_gap_is_left_out_for_handle_and_hand_and_counted() {
    let fast = |t: f64| (Pose::from_translation(DVec3::X * t), Twist::new(DVec3::X, DVec3::ZERO));
    let mut device = Emulation::default().open(IntendedPath::function(fast)).unwrap();
    device.read(0.05).unwrap();
    let state = device.read(20.05).unwrap();
    assert_eq!(state.status, Status::GAP | Status::OUTSIDE_WORKSPACE);
    assert!((state.time - 20.05).abs() < 1e-9);
    assert!((device.skipped_time() - 19.9).abs() < 1e-9);
    let (intended, _) = device.intended();
    assert!((intended.translation.x - 0.15).abs() < 1e-9, "the hand stood still as well");
    assert!(!device.read(20.06).unwrap().status.contains(Status::GAP));
}

#[test]
fn a_path_that_is_not_finite_is_passed_over() {
    let broken = |t: f64| {
        let x = if t > 0.01 { f64::NAN } else { 0.01 };
        (Pose::from_translation(DVec3::X * x), Twist::ZERO)
    };
    let mut device = Emulation::default().open(IntendedPath::function(broken)).unwrap();
    let state = run(&mut device, 0.05);
    assert!(state.status.contains(Status::HELD) && (state.pose.translation.x - 0.01).abs() < 1e-4);
    let from_the_start = IntendedPath::function(|_| (Pose::from_translation(DVec3::NAN), Twist::ZERO));
    assert_eq!(run(&mut Emulation::default().open(from_the_start).unwrap(), 0.01).pose, Pose::IDENTITY);
    let error = Emulation::default().open(Pose::from_translation(DVec3::INFINITY)).unwrap_err().to_string();
    assert!(error.contains("give finite metres"), "{error}");
}

#[test]
fn closing_zeroes_the_wrench_and_ends_the_device() {
    let mut device = Emulation::default().open(Pose::IDENTITY).unwrap();
    device.write(&Wrench::new(DVec3::X, DVec3::X)).unwrap();
    device.close().unwrap();
    device.close().unwrap();
    assert_eq!(device.applied_wrench(), Wrench::ZERO);
    assert!(matches!(device.read(1.0), Err(DeviceError::Closed)));
    assert!(matches!(device.write(&Wrench::ZERO), Err(DeviceError::Closed)));
}

#[test]
fn wrong_parameters_are_refused_by_name() {
    let refused = |change: &dyn Fn(&mut Emulation), word: &str| {
        let mut emulation = Emulation::default();
        change(&mut emulation);
        let error = emulation.open(Pose::IDENTITY).map(drop).unwrap_err().to_string();
        assert!(error.contains(word) && error.contains("give"), "{error}");
    };
    refused(&|e| e.handle.mass = 0.0, "handle mass (kg) is 0");
    refused(&|e| e.handle.inertia = -1.0, "handle inertia (kg·m²) is -1");
    refused(&|e| e.handle.friction = f64::NAN, "handle friction (N) is NaN");
    refused(&|e| e.hand.stiffness = f64::INFINITY, "hand stiffness (N/m) is inf");
    refused(&|e| e.hand.angular_damping = 1e9, "hand angular damping");
    refused(&|e| e.substep = 0.0, "substep (s) is 0");
    refused(&|e| e.catch_up = 1e-5, "catch-up (s)");
    refused(&|e| e.specification.encoder_step = -1e-5, "encoder step (m)");
    refused(&|e| e.specification.peak_force = f64::NAN, "peak force (N)");
    refused(&|e| e.specification.velocity_delay = f64::INFINITY, "velocity delay (s)");
    let unlimited = Emulation::default();
    let unlimited = Emulation {
        specification: Specification { peak_force: f64::INFINITY, ..unlimited.specification },
        ..unlimited
    };
    assert!(unlimited.open(Pose::IDENTITY).is_ok());
}

#[test]
fn buttons_come_through() {
    let mut device = Emulation::default().open(Pose::IDENTITY).unwrap();
    device.set_buttons(0b101);
    assert_eq!(device.read(0.001).unwrap().buttons, 0b101);
}

/// An emulation with a delay, s.
fn late(delay: f64) -> Emulation {
    let mut emulation = ideal(Hand::GRIP);
    emulation.specification.delay = delay;
    emulation
}

#[test]
fn a_wrench_takes_effect_after_the_delay() {
    let force = |newtons: f64| Wrench::new(DVec3::X * newtons, DVec3::ZERO);
    let mut device = late(2e-3).open(Pose::IDENTITY).unwrap();
    let mut felt = Vec::new();
    for i in 0..8 {
        device.read(f64::from(i) * 1e-3).unwrap();
        // The last of two wrenches in one substep counts.
        device.write(&force(-1.0)).unwrap();
        device.write(&force(f64::from(i))).unwrap();
        felt.push(device.applied_wrench().force.x);
    }
    assert_eq!(felt, [0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
    // A delayed wrench does not take effect after closing.
    device.close().unwrap();
    assert_eq!((device.applied_wrench(), device.wrench.pending.len()), (Wrench::ZERO, 0));
}

/// A delayed force moves the handle as the same force written later does.
#[test]
fn a_late_wrench_moves_the_handle_as_one_written_later_does() {
    let at = |delay: f64, writes_at: u32| {
        let mut device = late(delay).open(Pose::IDENTITY).unwrap();
        for i in 0..=200 {
            device.read(f64::from(i) * 1e-3).unwrap();
            if i == writes_at {
                device.write(&Wrench::new(DVec3::X, DVec3::Y * 0.1)).unwrap();
            }
        }
        (device.handle(), device.work())
    };
    assert_eq!(at(5e-3, 10), at(0.0, 15));
    assert_ne!(at(5e-3, 10), at(0.0, 14));
    // Rounded to whole substeps.
    assert_eq!(at(5.04e-3, 10), at(5e-3, 10));
}

/// The queue never grows beyond its initial capacity, and time left out counts towards the delay.
#[test]
fn pending_wrenches_need_no_allocation() {
    let mut device = late(MAX_DELAY).open(Pose::IDENTITY).unwrap();
    let room = device.wrench.pending.capacity();
    for i in 0..5000 {
        device.read(f64::from(i) * 1e-4).unwrap();
        device.write(&Wrench::new(DVec3::X * f64::from(i), DVec3::ZERO)).unwrap();
    }
    assert_eq!((device.wrench.pending.capacity(), device.wrench.pending.len()), (room, 1000));
    let state = device.read(10.0).unwrap();
    assert!(state.status.contains(Status::GAP) && device.wrench.pending.is_empty());
    assert_eq!(device.applied_wrench().force.x, 8.5);
}

#[test]
fn a_delay_that_no_device_has_is_refused() {
    for delay in [-1e-3, 0.11, f64::NAN, f64::INFINITY] {
        let error = late(delay).open(Pose::IDENTITY).expect_err("a delay").to_string();
        assert!(error.contains("delay (s)"), "{error}");
    }
}

/// The intention trembles by the amplitude to each side at the frequency, about the path; the twist is its
/// derivative, and it sets in smoothly.
#[test]
fn a_hand_trembles_about_its_path() {
    let (amplitude, frequency) = (3e-4, 8.0);
    let hand = Hand { tremor: amplitude, tremor_frequency: frequency, ..Hand::GRIP };
    let path = |time: f64| {
        (Pose::from_translation(DVec3::X * 0.01 * time), Twist::new(DVec3::X * 0.01, DVec3::ZERO))
    };
    let mut device = ideal(hand).open(IntendedPath::function(path)).unwrap();
    let mut offsets: Vec<DVec3> = Vec::new();
    let mut last: Option<(Pose, Twist)> = None;
    for i in 0..=3000 {
        let time = f64::from(i) * 1e-3;
        device.read(time).unwrap();
        let (pose, twist) = device.intended();
        offsets.push(pose.translation - path(time).0.translation);
        if let Some((before, rate)) = last {
            let moved = (pose.translation - before.translation) / 1e-3;
            let error = moved.distance(0.5 * (rate.linear + twist.linear));
            assert!(error < 1e-4, "the velocity is off by {error} m/s at {time} s");
        }
        last = Some((pose, twist));
    }
    assert!(offsets[0].length() < 1e-12 && offsets[1].length() < 1e-8, "{}", offsets[1]);
    let steady = &offsets[1000..];
    assert!(steady.iter().all(|offset| (offset.length() - amplitude).abs() < 1e-9 && offset.z == 0.0));
    let crossings = steady.windows(2).filter(|pair| pair[0].y < 0.0 && pair[1].y >= 0.0).count();
    assert_eq!(crossings, 16, "8 Hz over 2 s");
    // The handle follows: it trembles too, and a steady hand does not.
    let shaken = |tremor: f64| {
        let mut device = ideal(Hand { tremor, ..hand }).open(Pose::IDENTITY).unwrap();
        run(&mut device, 1.0);
        (0..125).map(|_| run(&mut device, 1e-3).pose.translation.x.abs()).fold(0.0, f64::max)
    };
    assert!(shaken(amplitude) > 0.3 * amplitude && shaken(0.0) == 0.0, "{} m", shaken(amplitude));
}
