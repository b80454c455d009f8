//! Experiment of the dissertation with textures (§5.5.4): a probe with a round tip on a plate with ridges 8
//! mm high, which is a flat plate with a texture, moved from left to right and faster back.
//!
//! The device has no encoder steps, whose noise would be felt through the slopes of the ridges.

#![allow(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]

use palpate::device::{Emulation, Interpolation, Keyframe, MotionPath};
use palpate::glam::DVec3;
use palpate::settings::{
    ContactSettings, CouplingSettings, HandlePlace, SearchSettings, TextureSettings, ToolSettings,
};
use palpate::{HapticRenderer, Object, Pose, Record, Scene, Settings};
use palpate_tests::{model, penalties, ridged_plate, smooth};
use rayon::prelude::*;

/// Height of the ridges and their distance, m.
const HEIGHT: f64 = 8e-3;
const SPACING: f64 = 0.04;
/// Radius of the probe's tip, and height of its centre when it touches the flat plate, m.
const TIP: f64 = 0.01;
/// Depth beyond the touch that the hand aims at, and displacement to either side, m.
const PRESS: f64 = 0.01;
const STROKE: f64 = 0.12;
/// Times at which the hand begins to press, to move, to move back, and ends, s.
const TIMES: [f64; 4] = [0.5, 1.5, 5.0, 6.75];
const STEP: f64 = 1e-3;

fn plate(textured: bool) -> Object {
    if textured { ridged_plate(HEIGHT, SPACING) } else { model("plate") }
}

#[derive(Clone, Copy)]
struct Experiment {
    textured: bool,
    /// Contact stiffness, N/m.
    stiffness: f64,
    /// Rate of contact steps, Hz.
    contact_rate: f64,
    textures: TextureSettings,
}

/// Runs the experiment and returns the records, one per haptic step.
fn explore(experiment: &Experiment) -> Vec<Record> {
    let probe = model("stylus");
    let [start, pressed, back, end] = TIMES;
    let keyframes = (0..(end * 100.0) as usize + 20).map(|i| {
        let time = i as f64 * 0.01;
        let along = STROKE * (2.0 * (smooth(pressed, back, time) - smooth(back, end, time)) - 1.0);
        let above = TIP + 0.5 * HEIGHT + 0.002;
        let height = above - (above - TIP + PRESS) * smooth(start, pressed, time);
        Keyframe { time, pose: Pose::from_translation(DVec3::new(along, 0.003, height)) }
    });
    let path = MotionPath::new(keyframes.collect(), Interpolation::Smooth).unwrap();
    let mut emulation = Emulation::default();
    emulation.specification.encoder_step = 0.0;
    emulation.specification.angular_encoder_step = 0.0;
    let settings = Settings {
        tool: ToolSettings {
            mass: 0.01, // The path is that of the tip.
            handle: HandlePlace::MeshOrigin,
            ..ToolSettings::default()
        },
        contact: ContactSettings { stiffness: experiment.stiffness, ..penalties().contact },
        coupling: CouplingSettings {
            stiffness: Some(200.0),
            angular_stiffness: Some(3.0),
            ..CouplingSettings::default()
        },
        search: SearchSettings { tolerance: Some(2e-4), ..SearchSettings::default() },
        textures: experiment.textures,
        ..penalties()
    };
    let scene = Scene::new().with(plate(experiment.textured), Pose::IDENTITY);
    let device = Box::new(emulation.open(path).unwrap());
    let (mut haptic, mut contact, mut device) =
        HapticRenderer::new(probe, scene, device, settings).unwrap().into_loops();
    let every = (1.0 / (experiment.contact_rate * STEP)).round() as usize;
    let mut records = Vec::new();
    let mut waiting = None;
    for step in 0..(end / STEP) as usize {
        let now = step as f64 * STEP;
        if step % every == 0 {
            if let Some(update) = waiting.take() {
                haptic.update_contacts(&update);
            }
            waiting = Some(contact.step(haptic.body_state(), now));
        }
        records.push(haptic.step_device(device.as_mut(), now + STEP, STEP));
    }
    records
}

/// Observations while the probe moves to the right, and back.
#[derive(Debug)]
struct Seen {
    /// Deepest penetration, m.
    depth: f64,
    /// Lowest and highest position of the tip's centre, m.
    height: [f64; 2],
    /// Root mean square of the part above 50 Hz, where at most 5 ridges are passed in a second: of the depth
    /// (m) and of the vertical force at the device (N).
    noise: [f64; 2],
}

fn passes(records: &[Record]) -> [Seen; 2] {
    let [_, pressed, back, end] = TIMES;
    [[pressed, back], [back, end - 0.1]].map(|[from, to]| {
        let records: Vec<_> = records.iter().filter(|r| r.time >= from && r.time < to).collect();
        let series = |value: fn(&Record) -> f64| records.iter().map(|r| value(r)).collect::<Vec<_>>();
        let heights = series(|r| r.object.translation.z);
        Seen {
            depth: series(|r| r.depth).into_iter().fold(0.0, f64::max),
            height: [
                heights.iter().copied().fold(f64::INFINITY, f64::min),
                heights.iter().copied().fold(f64::NEG_INFINITY, f64::max),
            ],
            noise: [fast_part(&series(|r| r.depth)), fast_part(&series(|r| r.coupling.force.z))],
        }
    })
}

/// Returns the root mean square of a series above 50 Hz: after subtracting its moving mean with a Hann window
/// of 20 ms, twice.
fn fast_part(series: &[f64]) -> f64 {
    const HALF: usize = 20;
    let weight =
        |i: usize| 0.5 + 0.5 * (std::f64::consts::PI * (i as f64 - HALF as f64) / (HALF as f64 + 1.0)).cos();
    let total: f64 = (0..=2 * HALF).map(weight).sum();
    let without = |series: &[f64]| -> Vec<f64> {
        series
            .windows(2 * HALF + 1)
            .map(|window| {
                let mean: f64 = window.iter().enumerate().map(|(i, x)| weight(i) * x).sum();
                window[HALF] - mean / total
            })
            .collect()
    };
    let fast = without(&without(series));
    (fast.iter().map(|x| x * x).sum::<f64>() / fast.len() as f64).sqrt()
}

const TEXTURED: Experiment = Experiment {
    textured: true,
    stiffness: 2000.0,
    contact_rate: 1000.0,
    textures: TextureSettings {
        grid: 50,
        half_size: None,
        temperature: None,
        backend: palpate::settings::TextureBackend::Processor,
    },
};

fn observe_passes(name: &str, experiment: &Experiment) -> [Seen; 2] {
    let seen = passes(&explore(experiment));
    println!("{name}: {seen:?}");
    seen
}

/// The ridges are felt without disturbance: the probe is not thrown about, and the high frequencies in depth
/// and force are a small part of those with forces from the largest overlap alone (noise in Fig. 5.12).
#[test]
fn ridges_are_felt_without_noise() {
    felt_without_noise(&[(2000.0, 1000.0, 1e-6)]);
}

#[test]
#[ignore = "for a release build: cargo test --release -p palpate-tests --test it textured_plate:: -- --ignored"]
fn ridges_are_felt_without_noise_in_further_cases() {
    let [flat, _] = observe_passes("flat", &Experiment { textured: false, ..TEXTURED });
    assert!(flat.height[1] - flat.height[0] < 1e-5, "{flat:?}");
    felt_without_noise(&[(2000.0, 500.0, 2e-6), (5000.0, 500.0, 2e-6), (5000.0, 1000.0, 1e-6)]);
}

/// Checks cases of a stiffness (N/m), a contact rate (Hz) and a bound on the noise of the depth (m).
fn felt_without_noise(cases: &[(f64, f64, f64)]) {
    let largest = TextureSettings { temperature: Some(0.0), ..TEXTURED.textures };
    let noisy = || observe_passes("largest overlap alone", &Experiment { textures: largest, ..TEXTURED });
    let passes = || {
        let each = cases.par_iter().map(|&(stiffness, contact_rate, most)| {
            let name = format!("{stiffness} N/m, contacts at {contact_rate} Hz");
            let experiment = Experiment { stiffness, contact_rate, ..TEXTURED };
            let seen = observe_passes(&name, &experiment);
            (name, contact_rate, most, seen)
        });
        each.collect::<Vec<_>>()
    };
    let ([noisy, _], passes) = rayon::join(noisy, passes);
    for (name, contact_rate, most, [there, back]) in passes {
        for seen in [&there, &back] {
            // The hand presses with 1.6 N, plus the force that moves the body around the ridges.
            assert!(seen.depth < 1e-3, "{name}: {seen:?}");
            assert!(seen.height[1] - seen.height[0] > 0.8 * HEIGHT, "{name}: {seen:?}");
        }
        assert!(there.noise[0] < most && there.noise[1] < 3e-3, "{name}: {there:?}");
        let noisier = noisy.noise[0] / there.noise[0];
        assert!(contact_rate < 1000.0 || noisier > 10.0, "{name}: {there:?}, {noisy:?}");
    }
}
