//! An emulated hand moves an upper jaw over a lower one: it opens, closes, grinds sideways and back and
//! forth, and opens.
//!
//! `cargo run --release --example jaws`

use std::error::Error;
use std::f64::consts::TAU;

use palpate::device::Emulation;
use palpate::glam::DVec3;
use palpate::{HapticRenderer, Pose, Scene, Settings};
use palpate_examples::{Options, open_all, path, smooth};

fn main() -> Result<(), Box<dyn Error>> {
    let options = Options::parse("Renders an upper jaw that an emulated hand closes on a lower one")?;
    let [upper, lower] = open_all(["upper-jaw", "lower-jaw"])?;
    let path = path(options.seconds, chewing)?;
    let device = Emulation::default().open(path)?;
    let scene = Scene::new().with(lower, Pose::IDENTITY);
    let renderer = HapticRenderer::new(upper, scene, Box::new(device), Settings::default())?;
    options.render("jaws", "Upper jaw over lower jaw", renderer)?;
    Ok(())
}

/// Returns the intended pose of the upper jaw. The jaws are closed when their frames coincide; the hand bites
/// 3 mm further, which its stiffness turns into a force.
fn chewing(time: f64) -> Pose {
    const OPEN: f64 = 8e-3;
    const BITE: f64 = -3e-3;
    let phase = (time / 10.0).fract();
    let ramp = |from: f64, to: f64| smooth((phase - from) / (to - from));
    let closed = ramp(0.0, 0.3) - ramp(0.8, 1.0);
    let grinding = ramp(0.3, 0.35) - ramp(0.7, 0.75);
    let sideways = 3e-3 * (TAU * 5.0 * phase).sin() * grinding;
    let forth = 2e-3 * (TAU * 3.0 * phase).sin() * grinding;
    let offset = DVec3::new(sideways, forth, OPEN + (BITE - OPEN) * closed);
    Pose::from_translation(offset)
}
