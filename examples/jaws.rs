//! An emulated hand moves an upper jaw over a lower one: it opens, closes, grinds sideways and back and forth, and opens.
//!
//! `cargo run --release --example jaws`

use std::error::Error;
use std::f64::consts::TAU;

use clap::Parser;
use palpate::device::{Emulation, Interpolation, Keyframe, MotionPath};
use palpate::glam::DVec3;
use palpate::{HapticRenderer, Pose, Scene, Settings};
use palpate_examples::{Options, open};

#[derive(Parser)]
struct Arguments {
    #[command(flatten)]
    options: Options,
}

fn main() -> Result<(), Box<dyn Error>> {
    let Arguments { options } = Arguments::parse();
    let upper = open("upper-jaw")?;
    let lower = open("lower-jaw")?;
    let path = MotionPath::new(chewing(options.seconds), Interpolation::Smooth)?;
    let device = Emulation::default().open(path)?;
    let scene = Scene::new().with(lower, Pose::IDENTITY);
    // Contact begins at 0.1 mm: a small part of the teeth's relief.
    let settings = Settings { tolerance: Some(1e-4), ..Settings::default() };
    let renderer = HapticRenderer::new(upper, scene, Box::new(device), settings)?;
    options.render("jaws", "Upper jaw over lower jaw", renderer)?;
    Ok(())
}

/// Where the hand means the upper jaw to be, as 100 poses a second. The jaws are closed when their frames coincide; the
/// hand bites 3 mm further, which its springiness turns into a force.
fn chewing(seconds: f64) -> Vec<Keyframe> {
    const OPEN: f64 = 8e-3;
    const BITE: f64 = -3e-3;
    // A little longer than the session, so that the hand never comes to the end of its path.
    let samples = ((seconds + 0.1) * 100.0) as usize + 1;
    (0..samples)
        .map(|sample| {
            let time = sample as f64 / 100.0;
            let phase = (time / 10.0).fract();
            let ramp = |from: f64, to: f64| {
                let x = ((phase - from) / (to - from)).clamp(0.0, 1.0);
                x * x * (3.0 - 2.0 * x)
            };
            let closed = ramp(0.0, 0.3) - ramp(0.8, 1.0);
            let grinding = ramp(0.3, 0.35) - ramp(0.7, 0.75);
            let sideways = 3e-3 * (TAU * 5.0 * phase).sin() * grinding;
            let forth = 2e-3 * (TAU * 3.0 * phase).sin() * grinding;
            let offset = DVec3::new(sideways, forth, OPEN + (BITE - OPEN) * closed);
            Keyframe { time, pose: Pose::from_translation(offset) }
        })
        .collect()
}
