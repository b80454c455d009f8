//! A faulty device, a late loop, a start inside geometry or a clutch cause nothing sudden at the hand.

use std::sync::{Arc, Mutex};

use palpate::device::{DeviceError, DeviceState, Emulation, HapticDevice, Specification, Status};
use palpate::dynamics::{ContactParameters, Friction, LinearContactModel};
use palpate::errors::RendererError;
use palpate::glam::{DQuat, DVec3};
use palpate::settings::{ContactSettings, DeviceSettings, OutputSettings, TimingSettings, ToolSettings};
use palpate::{
    Contact, ContactUpdate, HapticLoop, HapticRenderer, Pose, Record, Scene, Settings, Twist, Wrench,
};
use palpate_tests::model;

const PERIOD: f64 = 1e-3;

/// Device whose motion is given from outside and that keeps the last wrench.
struct Given {
    specification: Specification,
    state: Arc<Mutex<Option<DeviceState>>>,
    refuses: Arc<Mutex<bool>>,
}

impl HapticDevice for Given {
    fn specification(&self) -> &Specification {
        &self.specification
    }

    fn read(&mut self, _now: f64) -> Result<DeviceState, DeviceError> {
        self.state.lock().expect("one thread").ok_or(DeviceError::Closed)
    }

    fn write(&mut self, _wrench: &Wrench) -> Result<(), DeviceError> {
        if *self.refuses.lock().expect("one thread") { Err(DeviceError::Closed) } else { Ok(()) }
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }
}

fn at(pose: Pose, twist: Twist) -> DeviceState {
    DeviceState { time: 0.0, pose, twist, buttons: 0, status: Status::OK }
}

fn resting(x: DVec3) -> DeviceState {
    at(Pose::from_translation(x), Twist::ZERO)
}

/// Session in the loops of a host, pressed on a floor that is `depth` above where the object starts.
struct Rig {
    haptic: HapticLoop,
    device: Box<dyn HapticDevice>,
    state: Arc<Mutex<Option<DeviceState>>>,
    refuses: Arc<Mutex<bool>>,
    /// Height of the floor above the world's origin, m.
    floor: f64,
    now: f64,
    last: Wrench,
}

impl Rig {
    fn new(settings: Settings, depth: f64) -> Self {
        let state = Arc::new(Mutex::new(Some(resting(DVec3::ZERO))));
        let refuses = Arc::new(Mutex::new(false));
        let specification = Emulation::default().specification;
        let device = Given { specification, state: state.clone(), refuses: refuses.clone() };
        let renderer = HapticRenderer::new(model("ellipsoid@500"), Scene::new(), Box::new(device), settings);
        let (haptic, _, device) = renderer.expect("renderer").into_loops();
        let floor = haptic.body_state().pose.translation.z + depth;
        Self { haptic, device, state, refuses, floor, now: 0.0, last: Wrench::ZERO }
    }

    /// Returns the contact of the floor under the object's centre of mass.
    fn touch(&self) -> ContactUpdate {
        let center = self.haptic.body_state().pose;
        let point = center.translation;
        let depth = self.floor - point.z;
        let scene_point = point + DVec3::Z * depth;
        let touch = Contact { point, scene_point, normal: DVec3::NEG_Z, depth };
        let parameters =
            ContactParameters { stiffness: 2000.0, damping: 1.0, tolerance: 0.0, friction: Friction::NONE };
        let model = LinearContactModel::from_contacts([touch], &center, &parameters, self.now);
        ContactUpdate::new(model, self.now, depth, 1)
    }

    /// Takes a step with a state of the device, and checks that the wrench is finite and changes no faster
    /// than allowed.
    fn step_in(&mut self, state: Option<DeviceState>, dt: f64) -> Record {
        *self.state.lock().expect("one thread") = state;
        self.now += dt;
        self.haptic.update_contacts(&self.touch());
        let record = self.haptic.step_device(self.device.as_mut(), self.now, dt);
        let change = record.coupling - self.last;
        assert!(record.coupling.is_finite() && record.object.is_valid(), "{record:?}");
        let specification = self.device.specification();
        // A wrench may drop to zero at once.
        if record.coupling != Wrench::ZERO {
            let (force, torque) = (specification.peak_force, specification.peak_torque);
            assert!(
                change.force.length() <= force * dt / 0.01 * (1.0 + 1e-9),
                "at {} s: {change:?}",
                self.now
            );
            assert!(
                change.torque.length() <= torque * dt / 0.01 * (1.0 + 1e-9),
                "at {} s: {change:?}",
                self.now
            );
        }
        self.last = if *self.refuses.lock().expect("one thread") { Wrench::ZERO } else { record.coupling };
        record
    }

    fn step(&mut self, state: DeviceState) -> Record {
        self.step_in(Some(state), PERIOD)
    }

    fn rest(&mut self, steps: usize, x: DVec3) -> Record {
        (0..steps).map(|_| self.step(resting(x))).last().expect("a step")
    }

    fn events(&self) -> palpate::Events {
        self.haptic.telemetry().events
    }
}

#[test]
fn a_start_deep_inside_comes_up_from_nothing() {
    // 2 cm deep: a wall of 2 kN/m and a coupling of 400 N/m would push with 6.7 N.
    let mut rig = Rig::new(Settings::default(), 0.02);
    let mut forces = Vec::new();
    for _ in 0..400 {
        forces.push(rig.step(resting(DVec3::ZERO)).coupling.force.z);
    }
    assert!(forces[0].abs() < 1e-3, "{} N at once", forces[0]);
    assert!(forces[19] < 0.1 * forces[399], "{} N after 20 ms", forces[19]);
    assert!(forces[399] > 5.0 && (forces[399] - forces[299]).abs() < 0.01, "{} N in the end", forces[399]);
    let steepest = forces.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
    assert!(steepest < 0.1, "{steepest} N in a step");
    let events = rig.events();
    assert_eq!((events.engaging, events.faded, events.slewed), (199, 0, 0));
}

#[test]
fn the_wrench_changes_no_faster_than_the_slew_limit() {
    let mut rig = Rig::new(
        Settings {
            timing: TimingSettings { engagement: 0.0, ..TimingSettings::default() },
            ..Settings::default()
        },
        -1.0,
    );
    rig.rest(10, DVec3::ZERO);
    // A hand that moves as fast as is accepted: the damper alone would push with the device's peak at once.
    for step in 1..=8 {
        let x = DVec3::X * (9e-3 * f64::from(step));
        rig.step(at(Pose::from_translation(x), Twist::new(DVec3::X * 9.0, DVec3::ZERO)));
    }
    assert!(rig.events().slewed > 3, "{:?}", rig.events());
    assert!(rig.haptic.telemetry().coupling_force_max > 3.0);
    let mut free = Rig::new(
        Settings {
            output: OutputSettings { force_slew: Some(1.0), ..OutputSettings::default() },
            ..Settings::default()
        },
        0.01,
    );
    let record = free.rest(100, DVec3::ZERO);
    assert!(record.coupling.force.length() <= 0.1 + 1e-9, "1 N/s for 100 ms: {:?}", record.coupling);
}

#[test]
fn readings_that_are_not_finite_are_held_and_then_nothing_is_sent() {
    let mut rig = Rig::new(Settings::default(), 5e-3);
    let before = rig.rest(400, DVec3::ZERO).coupling.force.z;
    assert!(before > 1.0, "{before}");
    let mut bad = resting(DVec3::ZERO);
    bad.pose.translation.y = f64::NAN;
    for step in 1..=30 {
        let record = rig.step(bad);
        assert_eq!(record.device, Pose::IDENTITY);
        if step <= 9 {
            assert!((record.coupling.force.z - before).abs() < 1e-6, "step {step}: held");
        } else if step > 11 {
            assert_eq!(record.coupling, Wrench::ZERO, "step {step}: given up");
        }
    }
    let back = rig.rest(1, DVec3::ZERO).coupling.force.z;
    assert!(back.abs() < 1e-2 * before, "{back} N at once");
    assert!((rig.rest(300, DVec3::ZERO).coupling.force.z - before).abs() < 1e-3);
    assert_eq!(rig.events().device_refused, 30);
}

#[test]
fn a_jump_is_refused_and_a_lasting_one_is_believed_and_drags_nothing() {
    let mut rig = Rig::new(Settings::default(), -1.0);
    rig.rest(300, DVec3::ZERO);
    // One bad reading changes nothing.
    let record = rig.step(resting(DVec3::X * 0.3));
    assert_eq!((record.device.translation, rig.events().device_jumped), (DVec3::ZERO, 1));
    assert!(rig.rest(50, DVec3::ZERO).coupling.force.length() < 1e-6);
    // The device stays where it jumped to, and is trusted at the fifth reading.
    for step in 1..=5 {
        let record = rig.step(resting(DVec3::X * 0.06));
        assert_eq!(record.device.translation.x > 0.0, step == 5, "step {step}");
        assert!(record.coupling.force.length() < 1e-2, "step {step}: {:?}", record.coupling);
    }
    assert_eq!(rig.events().device_jumped, 5);
    let record = rig.rest(500, DVec3::X * 0.06);
    assert!(record.object.translation.length() < 1e-6, "the object stays: {}", record.object.translation);
    assert_eq!((record.device.translation.x, rig.events().rebased), (0.06, 1));
    assert!(rig.haptic.telemetry().coupling_force_max < 1e-2);
    // The same for a rotation.
    let turned = at(Pose::new(DVec3::X * 0.06, DQuat::from_rotation_z(1.0)), Twist::ZERO);
    rig.step(turned);
    assert_eq!(rig.events().device_jumped, 6);
}

#[test]
fn late_ticks_do_not_kick() {
    let mut rig = Rig::new(Settings::default(), 5e-3);
    let before = rig.rest(400, DVec3::ZERO).coupling.force.z;
    for dt in [2e-3, 5e-3, 1e-3, 5e-3, 5e-3, 1e-3, 3e-3, 20e-3] {
        let force = rig.step_in(Some(resting(DVec3::ZERO)), dt).coupling.force.z;
        assert!((force - before).abs() < 0.01 * before, "dt {dt}: {force} N, {before} N before");
    }
}

#[test]
fn a_lost_device_and_a_refused_write_let_go_at_once_and_come_up_slowly() {
    let mut rig = Rig::new(Settings::default(), 5e-3);
    let before = rig.rest(400, DVec3::ZERO).coupling.force.z;
    for _ in 0..20 {
        assert_eq!(rig.step_in(None, PERIOD).coupling, Wrench::ZERO);
    }
    assert!(rig.rest(1, DVec3::ZERO).coupling.force.z < 1e-2 * before);
    assert!((rig.rest(300, DVec3::ZERO).coupling.force.z - before).abs() < 1e-3);
    assert_eq!(rig.events().device_refused, 20);
    *rig.refuses.lock().expect("one thread") = true;
    rig.rest(5, DVec3::ZERO);
    *rig.refuses.lock().expect("one thread") = false;
    assert!(rig.rest(1, DVec3::ZERO).coupling.force.z < 1e-2 * before);
    assert_eq!(rig.events().device_refused, 25);
}

#[test]
fn a_clutch_moves_the_device_without_the_object_and_gives_it_back_without_a_step() {
    let settings = Settings {
        device: DeviceSettings { clutch_button: Some(1), ..DeviceSettings::default() },
        ..Settings::default()
    };
    let mut rig = Rig::new(settings, 5e-3);
    let before = rig.rest(500, DVec3::ZERO);
    let held = before.object;
    // The button is pressed, and the hand moves 5 cm aside and turns.
    let mut state = resting(DVec3::ZERO);
    for step in 1..=300 {
        let share = f64::from(step - 1) / 299.0;
        state.pose = Pose::new(DVec3::new(0.05, 0.0, 0.02) * share, DQuat::from_rotation_x(0.5 * share));
        state.buttons = 0b10;
        let record = rig.step(state);
        let moved = record.object.translation.distance(held.translation);
        assert!(moved < 1e-6, "step {step}: the object moved by {moved} m");
        assert_eq!(record.device, state.pose);
    }
    rig.rest_at(state, 200);
    assert!(rig.last == Wrench::ZERO, "{:?}", rig.last);
    assert_eq!(rig.events().clutched, 500);
    state.buttons = 0b01;
    for _ in 0..300 {
        let record = rig.step(state);
        assert!(record.object.translation.distance(held.translation) < 1e-6);
        assert!(record.handle.translation.length() < 1e-12, "the image is where it was");
    }
    assert!(
        (rig.last.force - before.coupling.force).length() < 1e-3,
        "{:?}, {:?}",
        rig.last,
        before.coupling
    );
    // After the clutch, the object follows along the same axes.
    let start = state.pose;
    for step in 1..=300 {
        state.pose.translation = start.translation + DVec3::X * 1e-4 * f64::from(step);
        rig.step(state);
    }
    let moved = rig.rest_at(state, 300).object.translation - held.translation;
    assert!((moved - DVec3::X * 0.03).length() < 1e-4, "{moved}");
    // The host's clutch does the same.
    rig.haptic.set_clutch(true);
    rig.rest_at(state, 10);
    assert_eq!(rig.events().clutched, 510);
    rig.haptic.set_clutch(false);
    rig.rest_at(state, 10);
    assert_eq!(rig.events().clutched, 510);
}

impl Rig {
    fn rest_at(&mut self, state: DeviceState, steps: usize) -> Record {
        (0..steps).map(|_| self.step(DeviceState { twist: Twist::ZERO, ..state })).last().expect("a step")
    }
}

#[test]
fn a_scaled_and_turned_workspace_feels_as_stiff() {
    let turn = DQuat::from_rotation_x(0.5 * std::f64::consts::PI);
    for scale in [0.2, 1.0, 5.0] {
        let settings = Settings {
            device: DeviceSettings {
                workspace_scale: scale,
                frame: Pose::new(DVec3::new(0.3, -0.1, 0.2), turn),
                ..DeviceSettings::default()
            },
            contact: ContactSettings {
                // So stiff that the object stands still.
                stiffness: 1e7,
                ..ContactSettings::default()
            },
            tool: ToolSettings {
                // At the handle: any lever makes the coupling softer.
                grasp: Some(Pose::IDENTITY),
                ..ToolSettings::default()
            },
            ..Settings::default()
        };
        let mut rig = Rig::new(settings, 0.0);
        assert!(rig.haptic.object_pose().translation.distance(settings.device.frame.translation) < 1e-12);
        // World up is the device's −z … y: the floor's normal is world z, which is the device's y axis
        // turned.
        let down = turn.conjugate() * DVec3::NEG_Z * 2e-3;
        let record = rig.rest(1000, down);
        let pressed = settings.device.frame.transform_point(down * scale);
        assert!(record.handle.translation.distance(pressed) < 1e-12);
        // In the world: floor and coupling in series; at the hand, the same stiffness.
        let (k, wall) = (400.0, 2000.0);
        let expected = -down.normalize() * (2e-3 * k * wall / (k + wall));
        assert!((record.coupling.force - expected).length() < 1e-4, "scale {scale}: {:?}", record.coupling);
        assert_eq!(record.device.translation, down);
    }
}

#[test]
fn settings_of_the_workspace_are_checked() {
    let refused = [
        (
            Settings {
                device: DeviceSettings { workspace_scale: 0.0, ..DeviceSettings::default() },
                ..Settings::default()
            },
            "workspace-scale",
        ),
        (
            Settings {
                device: DeviceSettings { clutch_button: Some(32), ..DeviceSettings::default() },
                ..Settings::default()
            },
            "clutch-button",
        ),
        (
            Settings {
                timing: TimingSettings { engagement: -1.0, ..TimingSettings::default() },
                ..Settings::default()
            },
            "engagement",
        ),
        (
            Settings {
                output: OutputSettings { force_slew: Some(0.0), ..OutputSettings::default() },
                ..Settings::default()
            },
            "force-slew",
        ),
        (
            Settings {
                output: OutputSettings { torque_slew: Some(f64::NAN), ..OutputSettings::default() },
                ..Settings::default()
            },
            "torque-slew",
        ),
        (
            Settings {
                device: DeviceSettings {
                    frame: Pose::from_translation(DVec3::NAN),
                    ..DeviceSettings::default()
                },
                ..Settings::default()
            },
            "device-frame rotation's length",
        ),
    ];
    for (settings, name) in refused {
        let error: RendererError = settings.check().expect_err(name).into();
        assert!(error.to_string().starts_with(name), "{error}");
    }
}
