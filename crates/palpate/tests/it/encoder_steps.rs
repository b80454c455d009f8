//! The steps of a device's encoders do not reach the hand: force above 20 Hz in free space, at rest in
//! contact, and after a step of the hand.
#![expect(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]

use std::convert::Infallible;
use std::f64::consts::{PI, SQRT_2, TAU};
use std::sync::atomic::AtomicBool;

use palpate::device::{DeviceError, DeviceState, Emulation, HapticDevice, IntendedPath, Specification};
use palpate::glam::{DQuat, DVec3};
use palpate::settings::{CouplingSettings, ToolSettings};
use palpate::{ContactTiming, HapticRenderer, Pose, Record, Scene, Settings, Twist, Wrench, explore};

use super::bodies::block;

/// Largest force above 20 Hz in free space, and at rest in contact, N rms.
const FREE: f64 = 5e-3;
const PRESSED: f64 = 1e-2;

/// Part of the force by readings that is left of a heavier object's in fast motion. Set after it was
/// measured, 0.32: at 0.2 m/s the hand's acceleration leaves too few readings for a fine estimate.
const LEFT: f64 = 0.4;

/// Masses of objects, kg. The last one is damped less than critically.
const MASSES: [f64; 4] = [1e-3, 1e-2, 0.1, 1.0];

/// Frequency above which force counts as vibration, Hz, and rate of the records.
const CORNER: f64 = 20.0;
const RATE: f64 = 1000.0;

/// A device that does not say that its readings are rounded.
struct Unstated<D>(D, Specification);

impl<D: HapticDevice> Unstated<D> {
    fn new(device: D) -> Self {
        let stated = device.specification().clone();
        Self(device, Specification { encoder_step: 0.0, angular_encoder_step: 0.0, ..stated })
    }
}

impl<D: HapticDevice> HapticDevice for Unstated<D> {
    fn specification(&self) -> &Specification {
        &self.1
    }

    fn read(&mut self, now: f64) -> Result<DeviceState, DeviceError> {
        self.0.read(now)
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceError> {
        self.0.write(wrench)
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        self.0.close()
    }
}

fn settings(mass: f64) -> Settings {
    Settings {
        tool: ToolSettings { mass, ..ToolSettings::default() },
        coupling: CouplingSettings { stiffness: Some(500.0), ..CouplingSettings::default() },
        ..Settings::default()
    }
}

fn records(scene: Scene, device: Box<dyn HapticDevice>, settings: Settings, seconds: f64) -> Vec<Record> {
    let mut records = Vec::new();
    let renderer =
        HapticRenderer::new(block(DVec3::splat(0.03)), scene, device, settings).expect("a renderer");
    let sink = |row: &Record| {
        records.push(*row);
        Ok::<_, Infallible>(())
    };
    let never = AtomicBool::new(false);
    renderer.run_lockstep(seconds, ContactTiming::busy(500.0), &never, sink).expect("the sink never fails");
    records
}

/// A high-pass of second order (Butterworth), forwards and backwards: without a phase.
fn above_corner(signal: &[f64]) -> Vec<f64> {
    let tangent = (PI * CORNER / RATE).tan();
    let scale = 1.0 / (1.0 + SQRT_2 * tangent + tangent * tangent);
    let feedback =
        (2.0 * (tangent * tangent - 1.0) * scale, (1.0 - SQRT_2 * tangent + tangent * tangent) * scale);
    let pass = |signal: &[f64]| {
        let (mut inputs, mut outputs) = ((signal[0], signal[0]), (0.0, 0.0));
        let mut filtered: Vec<f64> = Vec::with_capacity(signal.len());
        for &input in signal {
            let output =
                scale * (input - 2.0 * inputs.0 + inputs.1) - feedback.0 * outputs.0 - feedback.1 * outputs.1;
            (inputs, outputs) = ((input, inputs.0), (output, outputs.0));
            filtered.push(output);
        }
        filtered.reverse();
        filtered
    };
    pass(&pass(signal))
}

/// Force above 20 Hz between two times (s), N rms.
fn vibration(records: &[Record], from: f64, to: f64) -> f64 {
    let (from, to) = ((from * RATE) as usize, (to * RATE) as usize);
    let axis = |axis: usize| {
        let force: Vec<f64> = records.iter().map(|row| row.coupling.force[axis]).collect();
        above_corner(&force)[from..to].iter().map(|force| force * force).sum::<f64>()
    };
    ((axis(0) + axis(1) + axis(2)) / (to - from) as f64).sqrt()
}

/// The filter passes what is above its corner and stops what is below.
#[test]
fn the_filter_is_a_high_pass() {
    for (frequency, passed) in [(1.0, 0.0), (5.0, 0.004), (20.0, 0.5), (80.0, 0.996), (300.0, 1.0)] {
        let wave: Vec<f64> = (0..4000).map(|i| (TAU * frequency * f64::from(i) / RATE).sin()).collect();
        let square: f64 = above_corner(&wave)[1000..3000].iter().map(|value| value * value).sum();
        let size = (square / 1000.0).sqrt();
        assert!((size - passed).abs() < 0.01, "{frequency} Hz: {size}");
    }
}

/// The default task of the hand, far from everything.
fn exploring(mass: f64, stated: bool) -> f64 {
    let (settings, scene) = (settings(mass), Scene::new());
    let probe = block(DVec3::splat(0.03));
    let device = explore::open_device_for("emulated", &probe, &scene, &settings).expect("a device");
    let device = if stated { device } else { Box::new(Unstated::new(device)) };
    vibration(&records(scene, device, settings, 10.0), 0.5, 9.5)
}

/// A smooth path along all axes at up to 0.2 m/s, with the rotation of a hand.
fn gliding(mass: f64, stated: bool) -> f64 {
    let path = IntendedPath::function(|time| {
        let swing = |amplitude: f64, rate: f64| {
            let phase = TAU * rate * time;
            (amplitude * phase.sin(), amplitude * TAU * rate * phase.cos())
        };
        let ((x, vx), (y, vy), (z, vz)) = (swing(0.05, 0.43), swing(0.03, 0.61), swing(0.02, 0.71));
        let (turn, rate) = swing(0.2, 0.37);
        let pose = Pose::new(DVec3::new(x, y, z), DQuat::from_rotation_y(turn));
        (pose, Twist::new(DVec3::new(vx, vy, vz), DVec3::Y * rate))
    });
    let device = Emulation::default().open(path).expect("a device");
    let device: Box<dyn HapticDevice> =
        if stated { Box::new(device) } else { Box::new(Unstated::new(device)) };
    let rows = records(Scene::new(), device, settings(mass), 6.0);
    let fastest =
        rows[500..].windows(11).map(|w| w[0].device.translation.distance(w[10].device.translation) * 100.0);
    let fastest = fastest.fold(0.0, f64::max);
    assert!((0.17..0.24).contains(&fastest), "{fastest} m/s");
    vibration(&rows, 0.5, 5.5)
}

#[test]
fn encoder_steps_are_not_felt_in_free_space() {
    for mass in [1e-3, 1e-2, 0.1] {
        for (name, motion) in [("explore", exploring as fn(f64, bool) -> f64), ("glide", gliding)] {
            let (felt, readings) = (motion(mass, true), motion(mass, false));
            println!("{name} with {mass} kg: {felt:.5} N rms, by readings {readings:.5}");
            let fast_and_heavy = mass > 0.05 && name == "glide";
            let allowed = if fast_and_heavy { LEFT * readings } else { FREE };
            assert!(felt < allowed, "{name} with {mass} kg: {felt} N");
            assert!(
                readings > if mass < 5e-3 { 2.5 * felt } else { 1.7 * FREE },
                "{name}, {mass} kg: {readings} N"
            );
        }
    }
}

/// A hand that stands still between two steps feels nothing, and nothing moves.
#[test]
fn a_hand_that_stands_still_feels_nothing() {
    for mass in MASSES {
        let place = Pose::new(DVec3::new(1.4e-5, 0.7e-5, -1.1e-5), DQuat::from_rotation_x(3e-5));
        let device = Emulation::default().open(IntendedPath::from(place)).expect("a device");
        let rows = records(Scene::new(), Box::new(device), settings(mass), 4.0);
        assert!(vibration(&rows, 0.5, 3.5) < 1e-6, "{mass} kg");
        let rest = &rows[3500..];
        assert!(
            rest.iter().all(|row| row.coupling.force.length() < 1e-9),
            "{mass} kg: {:?}",
            rest[0].coupling
        );
    }
}

/// A hand that presses and holds on a plate feels a steady force.
#[test]
fn a_hand_that_rests_in_contact_feels_a_steady_force() {
    for mass in MASSES {
        let settings = settings(mass);
        let plate = block(DVec3::new(0.2, 0.2, 0.02));
        let scene = Scene::new().with(plate, Pose::from_translation(DVec3::NEG_Z * 0.01));
        let probe = block(DVec3::splat(0.03));
        let device =
            explore::open_device_for("emulated:task=press", &probe, &scene, &settings).expect("a device");
        let rows = records(scene, device, settings, 3.0);
        let (from, to) = (1.7, 2.6);
        let held = &rows[(from * RATE) as usize..(to * RATE) as usize];
        let least = held.iter().map(|row| row.coupling.force.z).fold(f64::INFINITY, f64::min);
        let felt = vibration(&rows, from, to);
        println!("pressed with {mass} kg: {felt:.6} N rms of {least:.3} N");
        assert!(least > 0.05, "{mass} kg: pressed with {least} N");
        assert!(felt < PRESSED, "{mass} kg: {felt} N");
    }
}

/// After a quick step of the hand the object is soon where the hand is, to less than a tenth of the step, and
/// swings over by no more than three quarters of it, hand and object together.
#[test]
fn a_step_of_the_hand_is_followed() {
    for mass in MASSES {
        let path = IntendedPath::function(|time| {
            let x = if time < 0.5 { 0.0 } else { 5e-3 };
            (Pose::from_translation(DVec3::X * x), Twist::ZERO)
        });
        let device = Emulation::default().open(path).expect("a device");
        let settle = 8.0 * (mass / 500.0).sqrt() + 0.4;
        let rows = records(Scene::new(), Box::new(device), settings(mass), 0.6 + 2.0 * settle);
        let off = |row: &Record| (row.object.translation.x - row.device.translation.x).abs();
        let late = rows.iter().filter(|row| row.time > 0.5 + settle).map(off).fold(0.0, f64::max);
        let furthest = rows.iter().map(|row| row.object.translation.x).fold(0.0, f64::max);
        println!("{mass} kg: {late} m off after {settle} s, at most {furthest} m");
        assert!(late < 4e-4, "{mass} kg: {late} m off after {settle} s");
        assert!(furthest > 4.5e-3 && furthest < 8.75e-3, "{mass} kg: to {furthest} m");
    }
}
