use palpate::device::{Emulation, HapticDevice};
use palpate::glam::DQuat;

use super::*;

const RATE: f64 = 1000.0;

fn held() -> Held {
    let Emulation { handle, hand, .. } = Emulation::default();
    Held { center: DVec3::new(0.01, 0.0, -0.02), radius: 0.03, handle, hand }
}

fn sine(frequency: f64, amplitude: f64, seconds: f64) -> Vec<DVec3> {
    let steps = (seconds * RATE) as usize;
    let axis = DVec3::new(2.0, -1.0, 2.0) / 3.0;
    (0..steps).map(|step| axis * (amplitude * (TAU * frequency * step as f64 / RATE).sin())).collect()
}

/// The gain of a Butterworth filter of fourth order, twice, at frequencies warped by the bilinear transform;
/// the wave is neither shifted nor distorted. Ends are left out.
#[test]
fn the_high_pass_has_the_gain_of_theory_and_no_phase() {
    let warped = |frequency: f64| (0.5 * TAU * frequency / RATE).tan();
    for frequency in [2.0, 10.0, 20.0, 30.0, 80.0, 450.0] {
        let wave = sine(frequency, 2.0, 3.0);
        let gain = 1.0 / (1.0 + (warped(20.0) / warped(frequency)).powi(8));
        let passed = high_passed(&wave, 20.0, RATE);
        assert_eq!(passed.len(), wave.len());
        for step in 500..2500 {
            let error = (passed[step] - gain * wave[step]).length();
            assert!(error < 1e-3 * gain + 1e-7, "{frequency} Hz, step {step}: {error}, gain {gain}");
        }
    }
    // A ramp far from zero is no vibration, up to its ends.
    let ramp: Vec<DVec3> = (0..2000).map(|step| DVec3::splat(5.0 + 1e-3 * f64::from(step))).collect();
    let left = high_passed(&ramp, 20.0, RATE).iter().fold(0.0, |most: f64, v| most.max(v.length()));
    assert!(left < 1e-3, "{left}");
    assert!(high_passed(&[], 20.0, RATE).is_empty());
    assert_eq!(high_passed(&[DVec3::X], 20.0, RATE), [DVec3::ZERO]);
}

#[test]
fn a_tone_is_in_its_third_octave() {
    for (frequency, center) in [(20.0, 19.95), (32.0, 31.62), (100.0, 100.0), (170.0, 158.5), (480.0, 501.2)]
    {
        let found = third_octaves(&sine(frequency, 0.2, 1.0), RATE, |_| true, &held());
        assert_eq!(found.len(), 15);
        let all = found.iter().map(|band| band.level.powi(2)).sum::<f64>().sqrt();
        let band = found.iter().max_by(|a, b| a.level.total_cmp(&b.level)).expect("bands");
        assert!((band.center - center).abs() < 0.1, "{frequency} Hz in {band:?}");
        assert!((band.level - 0.2 / SQRT_2).abs() < 0.01, "{frequency} Hz: {band:?}");
        assert!((all - 0.2 / SQRT_2).abs() < 2e-3, "{frequency} Hz: {all}");
    }
    // Half a second is the least.
    assert!(third_octaves(&sine(100.0, 1.0, 0.49), RATE, |_| true, &held()).is_empty());
}

/// A burst counts as it is in its window, and what lies outside the phase does not count.
#[test]
fn the_strongest_window_within_a_phase_counts() {
    let mut forces = sine(100.0, 0.01, 4.0);
    forces[1000..1500].copy_from_slice(&sine(100.0, 0.1, 0.5));
    forces[2500..].copy_from_slice(&sine(100.0, 1.0, 1.5));
    let level = |within: &dyn Fn(usize) -> bool| third_octaves(&forces, RATE, within, &held())[7].level;
    assert!((level(&|step| step < 2500) - 0.1 / SQRT_2).abs() < 1e-3);
    assert!((level(&|step| step < 1000) - 0.01 / SQRT_2).abs() < 1e-4);
    assert!((level(&|_| true) - 1.0 / SQRT_2).abs() < 1e-2);
}

/// A force of threshold level moves the emulated handle, without its friction, by the displacement that hands
/// detect.
#[test]
fn thresholds_move_the_handle_as_far_as_hands_detect() {
    for (center, peak) in [(20.0, 8.5e-6), (160.0, 0.065e-6), (320.0, 0.06e-6), (500.0, 0.06e-6)] {
        let mut emulation = Emulation::default();
        (emulation.handle.friction, emulation.substep) = (0.0, 1e-5);
        let Band { threshold, .. } = Band::at(center, 0.0, &held());
        let mut device = emulation.open(Pose::IDENTITY).expect("a device");
        let mut most = 0.0_f64;
        for step in 0..100_000 {
            let time = f64::from(step) * 1e-5;
            device.read(time).expect("a reading");
            if time > 0.9 {
                most = most.max(device.handle().0.translation.x.abs());
            }
            let force = DVec3::X * (SQRT_2 * threshold * (TAU * center * time).sin());
            device.write(&Wrench { force, torque: DVec3::ZERO }).expect("written");
        }
        assert!((most / peak - 1.0).abs() < 0.05, "{center} Hz: {most} m for {peak} m");
    }
    // 13 dB an octave between 20 and 160 Hz.
    let slope = 20.0 * (detected(40.0) / detected(80.0)).log10();
    assert!((12.0..15.0).contains(&slope), "{slope} dB");
    // Without the hand's mass, less is felt already.
    let bare = Held { hand: Hand::NONE, ..held() };
    assert!(Band::at(160.0, 0.0, &bare).threshold < 0.5 * Band::at(160.0, 0.0, &held()).threshold);
}

/// A session of 6 s: free, a touch-down at 1 s that bounces for 50 ms, strokes until 3 s, rest until 5 s, a
/// release. `force` adds to what the device is sent.
fn session(force: impl Fn(usize) -> f64) -> Vec<Record> {
    let record = |step: usize| {
        let bounces = (1020..1050).contains(&step);
        let contact = if (1000..5000).contains(&step) && !bounces { DVec3::Z } else { DVec3::ZERO };
        // 10 mm/s while it moves, and encoder steps of 30 µm.
        let moved = 1e-5 * step.min(3000) as f64;
        let encoder = if step % 7 < 3 { 3e-5 } else { 0.0 };
        let place = DVec3::X * (moved + encoder);
        let push = contact.length() + force(step);
        Record {
            time: step as f64 / RATE,
            device: Pose::from_translation(place),
            handle: Pose::from_translation(place),
            object: Pose::IDENTITY,
            coupling: Wrench { force: DVec3::Z * push, torque: DVec3::X * (0.1 * push) },
            contact: Wrench { force: contact, torque: DVec3::ZERO },
            depth: 0.0,
            contacts: 1,
            model_age: 1e-3,
        }
    };
    (0..6000).map(record).collect()
}

/// Poses at which the device holds the object.
fn handles(records: &[Record]) -> Vec<Pose> {
    records.iter().map(|record| record.handle).collect()
}

fn vibration(force: impl Fn(usize) -> f64) -> Vibration {
    let records = session(force);
    Vibration::of(&records, &handles(&records), RATE, &held())
}

#[test]
fn phases_are_told_from_contact_and_from_the_hand() {
    let records = session(|_| 0.0);
    let found = phases(&records, &handles(&records), RATE, &held());
    let runs = found.chunk_by(|a, b| a == b).map(|run| (run[0], run.len())).collect::<Vec<_>>();
    let [free, down, slid, rested, up, away] = runs[..] else { panic!("{runs:?}") };
    assert_eq!((free, down), ((Phase::Free, 850), (Phase::Onset, 300)));
    assert_eq!((slid.0, rested.0), (Phase::Sliding, Phase::Rest));
    // The hand stops at 3 s. The averages on both sides of a step x ms later still tell a speed of
    // 10 mm/s (1 − x/50)²/2, which falls to 2 mm/s at x = 18; rest begins 0.15 s after that.
    assert!((1150 + slid.1).abs_diff(3168) < 8, "{runs:?}");
    assert_eq!((up, away), ((Phase::Onset, 300), (Phase::Free, 850)));
    assert_eq!(found.len(), 6000);
    // Where the hand intends to stay, it is at rest whatever shakes the handle.
    let still = phases(&records, &[Pose::IDENTITY; 6000], RATE, &held());
    assert!(!still.contains(&Phase::Sliding) && still[1150..4850] == [Phase::Rest; 3700]);
}

/// A turn about the object's centre is motion, too.
#[test]
fn a_hand_that_turns_is_not_at_rest() {
    let mut records = session(|_| 0.0);
    for (step, record) in records.iter_mut().enumerate().skip(3000) {
        let turn = Pose::new(DVec3::ZERO, DQuat::from_rotation_z(2e-4 * (step - 3000) as f64));
        record.handle = record.handle
            * Pose::from_translation(held().center)
            * turn
            * Pose::from_translation(-held().center);
    }
    assert!(!phases(&records, &handles(&records), RATE, &held()).contains(&Phase::Rest));
}

/// Vibration counts in the phase in which it is, and the steps of the force at the touch-down count as onset.
#[test]
fn vibration_counts_where_it_is() {
    let wave = |step: usize, amplitude: f64| amplitude * (TAU * 100.0 * step as f64 / RATE).sin();
    let silent = vibration(|_| 0.0);
    assert!(silent.onset.force > 0.1, "{silent:?}");
    assert!(silent.free.force.max(silent.rest.force) < 1e-3 && silent.sliding.force < 3e-3, "{silent:?}");
    let shaken = vibration(|step| match step {
        1200..3000 => wave(step, 0.02),
        3300..4800 => wave(step, 0.01),
        5200.. => wave(step, 0.005),
        _ => 0.0,
    });
    for (level, amplitude) in [(&shaken.sliding, 0.02), (&shaken.rest, 0.01)] {
        let share = level.force * SQRT_2 / amplitude;
        assert!((0.9..1.01).contains(&share), "{level:?}");
        assert!((level.torque / level.force - 0.1).abs() < 1e-3, "{level:?}");
        let worst = level.worst().expect("bands");
        assert!((worst.center - 100.0).abs() < 0.1, "{worst:?}");
        assert!((worst.level * SQRT_2 / amplitude - 1.0).abs() < 0.02, "{worst:?}");
    }
    // Half of the time in free space is silent.
    assert!((shaken.free.force - 0.005 / 2.0).abs() < 3e-4, "{:?}", shaken.free);
    assert!(silent.rest.worst().is_some_and(|band| band.ratio() < 0.1), "{:?}", silent.rest.worst());
}
