//! Zero that the driver sends instead of a wrench is reported, and the wrench then rises only from zero.

use glam::DVec3;
use palpate_core::Wrench;
use palpate_device::haply::inverse3;
use palpate_device::hid::WoodenHapticsModel;
use palpate_device::link::{Codec, FakeWire, Link, LinkedDevice, Motion, Pump};
use palpate_device::sdk::{SdkCodec, SdkMotion, SdkState, wrench_of};
use palpate_device::{DeviceError, Emulation, HapticDevice as _, Status};

use crate::link::{Bench, status};

/// Largest rise of the wrench in a millisecond after the haptic loop has read that it was withheld, N.
const RISE: f64 = 0.05;
/// Force that the loop commands in the end, N.
const FORCE: f64 = 1.0;

/// A haptic loop's command: it starts again from zero after a withheld wrench, if it listens.
struct Loop {
    force: f64,
    listens: bool,
}

impl Loop {
    fn step<M: Motion>(&mut self, device: &mut LinkedDevice<M>, now: f64) -> Status {
        let seen = status(device.read(now));
        let lost = [Status::SILENT, Status::DISCONNECTED, Status::WITHHELD];
        let anew = self.listens && lost.into_iter().any(|flag| seen.contains(flag));
        self.force = if anew { 0.0 } else { (self.force + RISE).min(FORCE) };
        let _ = device.write(&Wrench::new(DVec3::X * self.force, DVec3::ZERO));
        seen
    }
}

fn largest([a, b, c]: [i16; 3]) -> f64 {
    [a, b, c].map(|current| f64::from(current).abs()).into_iter().fold(0.0, f64::max)
}

/// Largest rise from one write to the next, as a fraction of the current of the full force, after a silence
/// of 9 ms, and the number of times a withheld wrench was reported.
fn rise_after_silence(listens: bool) -> (f64, u32) {
    let mut bench = Bench::new();
    let mut haptic = Loop { force: FORCE, listens };
    for _ in 0..20 {
        bench.device_speaks();
        haptic.step(&mut bench.device, bench.now);
    }
    let full = largest(bench.currents);
    let (mut last, mut rise, mut reported, mut fell) = (full, 0.0_f64, 0, false);
    for i in 0..100 {
        bench.alive = i >= 9;
        bench.device_speaks();
        reported += u32::from(haptic.step(&mut bench.device, bench.now).contains(Status::WITHHELD));
        let written = largest(bench.currents);
        rise = rise.max((written - last) / full);
        fell |= written == 0.0;
        last = written;
    }
    assert!(fell && last > 0.9 * full, "it went to zero and came back: {last} of {full} mA");
    (rise, reported)
}

#[test]
fn after_silence_the_force_comes_up_from_zero() {
    let (rise, reported) = rise_after_silence(true);
    assert!(rise < 1.1 * RISE / FORCE, "a write rises by {rise} of the full force above the one before");
    assert!(reported > 0, "a withheld wrench is reported");
    // The counter-check: a loop that does not listen lets it rise at once.
    let (rise, _) = rise_after_silence(false);
    assert!(rise > 0.9, "{rise}");
}

#[test]
fn wrenches_commanded_before_reading_the_status_stay_withheld() {
    let mut bench = Bench::new();
    let wrench = Wrench::new(DVec3::X, DVec3::ZERO);
    bench.alive = false;
    for _ in 0..7 {
        bench.device_speaks();
        bench.device.write(&wrench).unwrap();
    }
    bench.alive = true;
    for _ in 0..5 {
        // The device sends again, but the haptic thread has not read that.
        bench.device.write(&wrench).unwrap();
        bench.device_speaks();
        assert_eq!(bench.currents, [0; 3]);
    }
    assert_eq!(bench.haptic().unwrap().status, Status::WITHHELD);
    bench.device.write(&wrench).unwrap();
    bench.device_speaks();
    assert!(bench.currents != [0; 3]);
    assert_eq!(bench.haptic().unwrap().status, Status::OK, "it is reported once");
}

#[test]
fn zero_that_was_asked_for_is_not_withheld() {
    let mut bench = Bench::new();
    bench.tick().0.unwrap();
    bench.device.write(&Wrench::ZERO).unwrap();
    bench.device_speaks();
    bench.alive = false;
    for _ in 0..9 {
        bench.device_speaks();
        bench.device.write(&Wrench::ZERO).unwrap();
    }
    bench.alive = true;
    bench.device_speaks();
    assert_eq!(bench.haptic().unwrap().status, Status::OK);
}

/// A pump that stood still: the device may have switched its force off meanwhile.
#[test]
fn after_a_gap_between_writes_the_force_comes_up_from_zero() {
    let model = WoodenHapticsModel::WOODEN_HAPTICS;
    let wire = FakeWire::new();
    let other = wire.clone();
    // A device that may be silent, so that the haptic thread does not notice.
    let link = Link { silence: f64::INFINITY, ..Link::wooden_haptics("silent", model) };
    let (mut pump, mut device) = link.split(move || Some(Box::new(other.open()?)));
    let mut haptic = Loop { force: FORCE, listens: true };
    let mut forces = Vec::new();
    for i in 0..200 {
        let now = 1e-3 * f64::from(i);
        if !(100..130).contains(&i) {
            pump.round(now);
            let force = |report: &Vec<u8>| i16::from_le_bytes([report[3], report[4]]);
            forces.extend(wire.written().last().map(force).map(f64::from));
        }
        haptic.step(&mut device, now);
    }
    let full: f64 = forces[99];
    assert!(full.abs() > 100.0 && forces[100] == 0.0 && forces[169] == full, "{forces:?}");
    let rise = forces
        .windows(2)
        .map(|pair| (pair[1].abs() - pair[0].abs()) / full.abs())
        .skip(99)
        .fold(0.0, f64::max);
    assert!(rise < 1.1 * RISE, "{rise}");
}

/// Force written at each step by a codec that is enabled, then not, then again.
fn disabled<C: Codec, M: Motion<Sample = C::Sample>>(
    link: Link<C, M>,
    report: impl Fn(bool) -> Vec<u8>,
    force: impl Fn(&[u8]) -> f64,
) {
    let wire = FakeWire::new();
    let other = wire.clone();
    let name = link.specification.name.clone();
    let (mut pump, mut device): (Pump<C>, _) = link.split(move || Some(Box::new(other.open()?)));
    let mut haptic = Loop { force: 0.0, listens: true };
    let (mut last, mut now) = (0.0, 0.0);
    for i in 0..300 {
        let enabled = !(100..150).contains(&i);
        wire.send(&report(enabled));
        now += 1e-3;
        pump.round(now);
        let written = wire.written().last().map_or(last, |written| force(written));
        assert!(written - last < 1.5 * RISE, "{name}, {i}: from {last} to {written}");
        last = written;
        assert!(enabled || written == 0.0, "{name}, {i}: {written}");
        assert!(i != 99 && i != 299 || written > 0.9, "{name}, {i}: {written}");
        let seen = haptic.step(&mut device, now);
        assert_eq!(seen.contains(Status::NOT_ENABLED), !enabled, "{name}, {i}: {seen}");
        let withheld = seen.contains(Status::WITHHELD);
        assert!(
            if i == 100 { withheld } else { !withheld || (100..152).contains(&i) },
            "{name}, {i}: {seen}"
        );
    }
}

#[test]
fn a_device_that_is_not_ready_is_not_enabled_and_its_force_comes_up_from_zero() {
    let specification = Emulation::default().specification;
    let motion = SdkMotion::new(&specification);
    let read_timeout = std::time::Duration::from_millis(5);
    let link = Link { codec: SdkCodec, motion, specification, read_timeout, silence: 0.02 };
    let state = |ready| SdkState { ready, ..SdkState::default() };
    disabled(link, |ready| state(ready).to_report().to_vec(), |said| wrench_of(said).unwrap().force.x);

    let number = |number: f32| number.to_le_bytes();
    let inverse = |ready: bool| -> Vec<u8> {
        let numbers = [0.04, -0.17, 0.16, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0].map(number);
        numbers.into_iter().flatten().chain([0; 4]).chain([ready.into()]).collect()
    };
    disabled(inverse3(), inverse, |said| f32::from_le_bytes(said[..4].try_into().unwrap()).into());

    let model = WoodenHapticsModel::WOODEN_HAPTICS;
    let encoders = |ready: bool| {
        let words = [1_i16, 1333, 2547, 0, 0, 0, if ready { 0 } else { 1 }];
        words.into_iter().flat_map(i16::to_le_bytes).collect::<Vec<u8>>()
    };
    let full = largest_current(&model);
    let written = |said: &[u8]| {
        let currents = [1, 3, 5].map(|at: usize| i16::from_le_bytes([said[at], said[at + 1]]));
        // A report that sets the encoders has no currents.
        if said[7] == 1 { 0.0 } else { largest(currents) / full }
    };
    disabled(Link::wooden_haptics("wooden", model), encoders, written);
}

fn largest_current(model: &WoodenHapticsModel) -> f64 {
    model.currents(DVec3::X, &[1, 1333, 2547, 0, 0, 0]).abs().max_element() * 1000.0
}

#[test]
fn a_lost_device_that_comes_back_reports_that_its_wrench_was_withheld() {
    let mut bench = Bench::new();
    bench.wire.unplug();
    assert!(matches!(bench.tick().0, Err(DeviceError::Lost { .. })));
    bench.wire.plug_in();
    let mut first = bench.tick().0;
    for _ in 0..600 {
        if first.is_ok() {
            break;
        }
        first = bench.tick().0;
    }
    assert!(first.unwrap().status.contains(Status::WITHHELD));
}
