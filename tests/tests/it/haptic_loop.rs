//! Wrenches that reach the device: about its origin, within its limits, and zero after a fault.

use std::f64::consts::TAU;
use std::sync::{Arc, Mutex};

use palpate::device::{Axes, DeviceError, DeviceState, Emulation, HapticDevice, Specification, Status};
use palpate::dynamics::{ContactParameters, Friction, LinearContactModel};
use palpate::glam::{DQuat, DVec3};
use palpate::settings::{CouplingSettings, HandlePlace, TimingSettings, ToolSettings};
use palpate::{Contact, ContactUpdate, HapticLoop, HapticRenderer, Pose, Scene, Settings, Twist, Wrench};
use palpate_tests::{model, smooth};

const PERIOD: f64 = 1e-3;

/// Returns a device without limits, whose motion is neither rounded nor delayed.
fn specification() -> Specification {
    Specification {
        peak_force: f64::INFINITY,
        peak_torque: f64::INFINITY,
        damping: f64::INFINITY,
        angular_damping: f64::INFINITY,
        encoder_step: 0.0,
        angular_encoder_step: 0.0,
        velocity_delay: 0.0,
        delay: 0.0,
        handle: None,
        ..Emulation::default().specification
    }
}

/// Handle that circles and turns whatever is written to it, and keeps the written wrenches.
struct Circling {
    specification: Specification,
    /// Range of the reads that fail, counted from 0.
    lost: std::ops::Range<usize>,
    reads: usize,
    written: Arc<Mutex<Vec<Wrench>>>,
}

impl Circling {
    fn new(specification: Specification) -> Self {
        Self { specification, lost: 0..0, reads: 0, written: Arc::default() }
    }
}

/// Returns pose and twist of a handle that circles at 2 Hz and turns about x at 3 rad/s.
fn circling(time: f64) -> (Pose, Twist) {
    let (rate, radius) = (2.0 * TAU, 0.02);
    let (sine, cosine) = (rate * time).sin_cos();
    let pose = Pose::new(DVec3::new(radius * cosine, radius * sine, 0.1), DQuat::from_rotation_x(3.0 * time));
    (pose, Twist::new(DVec3::new(-sine, cosine, 0.0) * radius * rate, DVec3::X * 3.0))
}

fn state(time: f64) -> DeviceState {
    let (pose, twist) = circling(time);
    DeviceState { time, pose, twist, buttons: 0, status: Status::OK }
}

impl HapticDevice for Circling {
    fn specification(&self) -> &Specification {
        &self.specification
    }

    fn read(&mut self, now: f64) -> Result<DeviceState, DeviceError> {
        self.reads += 1;
        if self.lost.contains(&(self.reads - 1)) { Err(DeviceError::Closed) } else { Ok(state(now)) }
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceError> {
        self.written.lock().expect("one thread").push(*wrench);
        Ok(())
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }
}

fn haptic_loop(specification: Specification, settings: Settings) -> HapticLoop {
    let device = Box::new(Circling::new(specification));
    let renderer = HapticRenderer::new(model("ellipsoid@500"), Scene::new(), device, settings);
    renderer.expect("renderer").into_loops().0
}

/// Returns a contact model without contacts, found at `time`.
fn update(time: f64) -> ContactUpdate {
    let model = LinearContactModel::empty(&Pose::IDENTITY, time);
    ContactUpdate::new(model, time, 0.0, 0)
}

#[test]
fn the_wrench_at_the_device_does_the_work_of_the_coupling() {
    // Held 7 cm from the device's origin by a spring without torque: a pure force at the grasp.
    let grasp = Pose::new(DVec3::new(0.03, -0.06, 0.02), DQuat::from_rotation_z(1.0));
    let settings = Settings {
        tool: ToolSettings { grasp: Some(grasp), handle: HandlePlace::MeshOrigin, ..ToolSettings::default() },
        coupling: CouplingSettings {
            angular_stiffness: Some(0.0),
            angular_damping: Some(0.0),
            ..CouplingSettings::default()
        },
        timing: TimingSettings { engagement: 0.0, ..TimingSettings::default() },
        ..Settings::default()
    };
    let mut haptic = haptic_loop(specification(), settings);
    let (mut energy, mut held) = (0.0, 0.0);
    let mut last = (DVec3::ZERO, DVec3::ZERO);
    let mut largest: f64 = 0.0;
    for step in 1..=500 {
        let device = state(f64::from(step) * PERIOD);
        haptic.update_contacts(&update(device.time));
        let Wrench { force, torque } = haptic.step(&device, device.time, PERIOD).coupling;
        let arm = device.pose.rotation * grasp.translation;
        assert!((torque - arm.cross(force)).length() < 1e-12, "step {step}: {torque}");
        energy -= force.dot(device.twist.linear + device.twist.angular.cross(arm)) * PERIOD;
        // Work of the held force over the period, along the displacement of its point of application.
        let point = device.pose.transform_point(grasp.translation);
        held -= last.0.dot(point - last.1);
        last = (force, point);
        largest = largest.max(force.length());
    }
    assert!(largest > 0.05, "the object's inertia is felt: {largest} N");
    assert!(energy > 1e-4, "the hand drives the object: {energy} J");
    assert!((haptic.telemetry().energy / held - 1.0).abs() < 1e-3, "{} of {held}", haptic.telemetry().energy);
    assert!(
        (haptic.telemetry().energy / energy - 1.0).abs() < 0.1,
        "{} of {energy}",
        haptic.telemetry().energy
    );
    assert_eq!(haptic.telemetry().events.saturated, 0);
}

#[test]
fn the_wrench_stays_within_the_limits_of_the_device() {
    let settings = Settings {
        coupling: CouplingSettings { stiffness: Some(2000.0), ..CouplingSettings::default() },
        ..Settings::default()
    };
    let mut free = haptic_loop(specification(), settings);
    let mut weak = specification();
    weak.peak_force = 0.05;
    weak.peak_torque = 0.0;
    weak.actuated = Axes { translation: [true, false, true], rotation: [false; 3] };
    // The spring saturates at the device's limit too, which would change the motion; that is tested in its
    // crate.
    let mut limited = haptic_loop(weak, settings);
    let mut saturated = 0;
    for step in 1..=500 {
        let device = state(f64::from(step) * PERIOD);
        free.update_contacts(&update(device.time));
        limited.update_contacts(&update(device.time));
        let free = free.step(&device, device.time, PERIOD).coupling;
        let limited = limited.step(&device, device.time, PERIOD).coupling;
        assert_eq!((limited.torque, limited.force.y), (DVec3::ZERO, 0.0));
        assert!(limited.force.length() <= 0.05 * (1.0 + 1e-12), "step {step}: {}", limited.force);
        let share = smooth(0.0, 1.0, f64::from(step) / 200.0);
        saturated += u64::from(limited.force.length() > 0.75 * 0.05 * share);
        assert!(free.force.is_finite());
    }
    assert!(saturated > 0, "the limit was never reached");
    assert_eq!(limited.telemetry().events.saturated, saturated, "axes that are not actuated do not count");
}

#[test]
fn an_overdue_contact_model_fades_the_wrench_out_and_in() {
    let settings = Settings {
        timing: TimingSettings { contact_timeout: 0.1, ..TimingSettings::default() },
        ..Settings::default()
    };
    let mut fresh = haptic_loop(specification(), settings);
    let mut late = fresh.clone();
    for step in 1..=600 {
        let device = state(f64::from(step) * PERIOD);
        fresh.update_contacts(&update(device.time));
        // Models arrive up to step 50, and again from step 300 on.
        if step <= 50 || step >= 300 {
            late.update_contacts(&update(device.time));
        }
        let whole = fresh.step(&device, device.time, PERIOD).coupling;
        let sent = late.step(&device, device.time, PERIOD).coupling;
        let age = f64::from(step - 50) * PERIOD;
        let share = match step {
            0..=50 => 1.0,
            51..300 => (1.0 - (age - 0.1) / 0.05).clamp(0.0, 1.0),
            // Two per cent more each millisecond.
            _ => (f64::from(step - 299) / 50.0).min(1.0),
        };
        let share = smooth(0.0, 1.0, share);
        assert!((sent.force - whole.force * share).length() < 1e-9, "step {step}: share {share}");
        assert!((sent.torque - whole.torque * share).length() < 1e-9, "step {step}: share {share}");
    }
    assert_eq!(fresh.telemetry().events.faded, 0);
    // From 100 ms after step 50 (an age equal to the timeout is still in time) until the full wrench at step
    // 349.
    assert!((197..=199).contains(&late.telemetry().events.faded), "{:?}", late.telemetry().events);
}

#[test]
fn a_session_without_any_contact_model_fades_out() {
    let mut haptic = haptic_loop(
        specification(),
        Settings {
            timing: TimingSettings { contact_timeout: 0.05, ..TimingSettings::default() },
            ..Settings::default()
        },
    );
    let mut felt = false;
    for step in 1..=300 {
        // A host's clock need not start at zero.
        let (device, now) = (state(f64::from(step) * PERIOD), 1e4 + f64::from(step) * PERIOD);
        let sent = haptic.step(&device, now, PERIOD).coupling;
        felt |= step < 50 && sent.force.length() > 0.01;
        assert!(step <= 101 || sent == Wrench::ZERO, "step {step}: {sent:?}");
    }
    assert!(felt, "nothing to fade");
}

#[test]
fn a_lost_device_gets_no_wrench_and_a_found_one_gets_it_back_slowly() {
    let mut device = Circling::new(specification());
    device.lost = 100..110;
    let written = Arc::clone(&device.written);
    let settings = Settings {
        timing: TimingSettings { engagement: 0.1, ..TimingSettings::default() },
        ..Settings::default()
    };
    let mut haptic = haptic_loop(specification(), settings);
    // The same with a host that holds the last good pose itself.
    let mut holding = haptic.clone();
    let mut records = Vec::new();
    for step in 0..300 {
        let now = f64::from(step) * PERIOD;
        haptic.update_contacts(&update(now));
        holding.update_contacts(&update(now));
        let record = haptic.step_device(&mut device, now, PERIOD);
        let held = DeviceState { time: now, twist: Twist::ZERO, ..state(99.0 * PERIOD) };
        let device = if (100..110).contains(&step) { held } else { state(now) };
        let whole = holding.step(&device, now, PERIOD).coupling;
        let share = match step {
            ..100 => 1.0,
            100..110 => 0.0,
            _ => smooth(0.0, 1.0, f64::from(step - 109) / 100.0),
        };
        let (sent, whole) = (record.coupling, whole * share);
        assert!((sent.force - whole.force).length() < 1e-9, "step {step}: share {share}");
        assert!((sent.torque - whole.torque).length() < 1e-9, "step {step}: share {share}");
        records.push(record);
    }
    let written = written.lock().expect("one thread");
    for (step, (record, written)) in records.iter().zip(written.iter()).enumerate() {
        assert_eq!(record.coupling, *written, "step {step}: the record says what was sent");
        assert_eq!((100..110).contains(&step), *written == Wrench::ZERO, "step {step}");
        let expected = if (100..110).contains(&step) { 99 } else { step };
        assert_eq!(
            record.device,
            circling(expected as f64 * PERIOD).0,
            "step {step}: the last good pose is held"
        );
    }
    let events = haptic.telemetry().events;
    assert_eq!((events.device_refused, events.faded), (10, 0));
    assert_eq!(events.engaging, 99 + 10 + 99, "up at the start, and again when the device is back");
}

#[test]
fn a_motion_that_is_not_finite_is_held() {
    let mut haptic = haptic_loop(specification(), Settings::default());
    let good = state(0.01);
    haptic.step(&good, 0.01, PERIOD);
    for spoil in [
        |s: &mut DeviceState| s.pose.translation.x = f64::NAN,
        |s: &mut DeviceState| s.pose.rotation = DQuat::from_xyzw(0.0, 0.0, 0.0, 2.0),
        |s: &mut DeviceState| s.twist.angular.z = f64::INFINITY,
    ] {
        let mut bad = state(0.02);
        spoil(&mut bad);
        let record = haptic.step(&bad, 0.02, PERIOD);
        assert_eq!(record.device, good.pose);
        assert!(record.coupling.is_finite() && record.object.is_valid());
    }
    assert_eq!(haptic.telemetry().events.device_refused, 3);
}

#[test]
fn steps_without_a_solution_send_nothing() {
    let mut haptic = haptic_loop(specification(), Settings::default());
    let step = |haptic: &mut HapticLoop, time: f64, dt: f64| {
        haptic.update_contacts(&update(time));
        haptic.step(&state(time), time, dt).coupling
    };
    for i in 1..=100 {
        step(&mut haptic, f64::from(i) * PERIOD, PERIOD);
    }
    for dt in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert_eq!(step(&mut haptic, 0.101, dt), Wrench::ZERO, "dt {dt}");
    }
    assert_eq!(haptic.telemetry().events.step_refused, 4);
    let back = step(&mut haptic, 0.102, PERIOD);
    assert!(back != Wrench::ZERO && back.is_finite() && haptic.telemetry().energy.is_finite(), "{back:?}");
}

#[test]
fn pressed_on_a_contact_the_hand_is_pushed_back() {
    // A floor under the held object, 1 mm above its lowest point: force up, on object and hand alike. Held at
    // the handle: a lever of a micrometre makes the coupling softer by less than a ten-thousandth.
    let held = Settings {
        tool: ToolSettings { grasp: Some(Pose::IDENTITY), ..ToolSettings::default() },
        ..Settings::default()
    };
    let mut haptic = haptic_loop(specification(), held);
    let pose = circling(0.0).0;
    let device = DeviceState { twist: Twist::ZERO, ..state(0.0) };
    let touch = Contact {
        point: pose.translation,
        scene_point: pose.translation + DVec3::Z * 1e-3,
        normal: DVec3::NEG_Z,
        depth: 1e-3,
    };
    let parameters =
        ContactParameters { stiffness: 2000.0, damping: 1.0, tolerance: 0.0, friction: Friction::NONE };
    let center = haptic.body_state().pose;
    let model = LinearContactModel::from_contacts([touch], &center, &parameters, 0.0);
    let mut last = None;
    for step in 1..=400 {
        let now = f64::from(step) * PERIOD;
        haptic.update_contacts(&ContactUpdate::new(model, now, 1e-3, 1));
        last = Some(haptic.step(&device, now, PERIOD));
    }
    let last = last.expect("steps");
    // Springs in series: the coupling's 400 N/m (half of what the device renders) and the contact's.
    let expected = 1e-3 * 400.0 * 2000.0 / 2400.0;
    assert!((last.coupling.force - DVec3::Z * expected).length() < 1e-6, "{:?}", last.coupling);
    assert!((last.contact.force - DVec3::Z * expected).length() < 1e-6, "{:?}", last.contact);
    assert_eq!((haptic.telemetry().depth_max, last.contacts), (1e-3, 1));
}
