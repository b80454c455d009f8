//! Readings carry the arrival time of their report, and velocities are based on these times: they are right
//! for a device that reports less often than it is read, or is read at uneven times.

use palpate_device::haply::inverse3;
use palpate_device::hid::{EncodedMotion, WoodenHapticsCodec, WoodenHapticsModel};
use palpate_device::link::{Codec, FakeWire, Link, Motion};
use palpate_device::{DeviceState, HapticDevice as _, Status};

/// States of a device in steady motion that reports every `every` ms, read each ms, late by `late` (s).
fn states<C: Codec, M: Motion<Sample = C::Sample>>(
    link: Link<C, M>,
    every: i16,
    report: impl Fn(i16) -> Vec<u8>,
    late: impl Fn(i16) -> f64,
) -> Vec<DeviceState> {
    let wire = FakeWire::new();
    let other = wire.clone();
    let (mut pump, mut device) = link.split(move || Some(Box::new(other.open()?)));
    let read = |step: i16| {
        let now = 1e-3 * f64::from(step);
        if step % every == 0 {
            wire.send(&report(step));
        }
        pump.round(now);
        device.read(now + late(step)).unwrap()
    };
    (0..200).map(read).collect()
}

fn wooden() -> Link<WoodenHapticsCodec, EncodedMotion> {
    Link::wooden_haptics("wooden", WoodenHapticsModel::WOODEN_HAPTICS)
}

/// The first joint turns by five counts a millisecond.
fn encoders(step: i16) -> Vec<u8> {
    [5 * step, 1333, 2547, 0, 0, 0, 0].into_iter().flat_map(i16::to_le_bytes).collect()
}

/// The lowest and the highest speed, as a fraction of the mean one, without the first readings.
fn speeds(states: &[DeviceState]) -> (f64, f64) {
    let speeds: Vec<f64> = states[20..].iter().map(|state| state.twist.linear.length()).collect();
    let mean = speeds.iter().sum::<f64>() / speeds.len() as f64;
    assert!(mean > 0.01, "{mean} m/s");
    let (low, high) = speeds
        .iter()
        .fold((f64::INFINITY, 0.0_f64), |(low, high), speed| (low.min(*speed), high.max(*speed)));
    (low / mean, high / mean)
}

#[track_caller]
fn assert_steady(states: &[DeviceState]) {
    let (low, high) = speeds(states);
    assert!(low > 0.98 && high < 1.02, "the speed is {low} to {high} of the mean one");
}

#[test]
fn half_the_rate_gives_no_ripple() {
    for every in [1, 2, 4, 8] {
        let states = states(wooden(), every, encoders, |_| 0.0);
        assert_steady(&states);
        for (step, state) in states.iter().enumerate() {
            let came = 1e-3 * (step - step % every as usize) as f64;
            assert!((state.time - came).abs() < 1e-12, "{step}: {} s", state.time);
        }
    }
}

#[test]
fn uneven_times_of_reading_give_no_ripple() {
    let late = |step: i16| 1e-4 * f64::from(step * 7 % 10);
    assert_steady(&states(wooden(), 1, encoders, late));
    assert_steady(&states(wooden(), 2, encoders, late));
}

/// A position in mm instead of m, say, or after encoders have lost count.
#[test]
fn positions_far_outside_the_workspace_are_rejected() {
    let wire = FakeWire::new();
    let other = wire.clone();
    let (mut pump, mut device) = inverse3().split(move || Some(Box::new(other.open()?)));
    let mut read = |step: u32, x: f32| {
        let numbers = [x, -0.17, 0.16, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0].map(f32::to_le_bytes);
        wire.send(&[&numbers.concat()[..], &[0; 4], &[1]].concat());
        pump.round(1e-3 * f64::from(step));
        device.read(1e-3 * f64::from(step)).unwrap()
    };
    let before = read(1, 0.05);
    assert!(before.status.is_ok(), "{before:?}");
    let edge = read(2, 0.35);
    assert!(edge.status == Status::OUTSIDE_WORKSPACE && edge.pose != before.pose, "{edge:?}");
    let far = read(3, 50.0);
    assert!(far.status.contains(Status::HELD) && far.pose == edge.pose && far.time == edge.time, "{far:?}");
    assert!(read(4, 0.05).status.is_ok());
}
