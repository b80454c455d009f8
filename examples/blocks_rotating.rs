//! Ridged block that lies on another one, ridges in grooves, and is turned to and fro (Fig. 4.15 of the
//! dissertation): it rises as it turns, and a torque opposes.
//!
//! `cargo run --release --features textures --example blocks_rotating`

use std::error::Error;
use std::f64::consts::TAU;

use palpate::device::Emulation;
use palpate::glam::{DQuat, DVec3};
use palpate::settings::{SearchSettings, TextureSettings};
use palpate::{HapticRenderer, Pose, Scene, Settings};
use palpate_examples::{Options, detailed, path, say, smooth};

/// Height of a block, m.
const HEIGHT: f64 = 0.036;
/// Rotation of the block to either side, rad.
const TURN: f64 = 0.15;

fn main() -> Result<(), Box<dyn Error>> {
    let options = Options::parse("Renders a ridged block that turns on another one")?;
    let block = detailed("block", 300, 2e-4)?;
    let path = path(options.seconds, |time| turning(time, options.seconds))?;
    let device = Emulation::default().open(path)?;
    let settings = Settings {
        search: SearchSettings { tolerance: Some(2e-4), ..SearchSettings::default() },
        textures: TextureSettings { grid: 100, half_size: Some(0.05), ..TextureSettings::default() },
        ..Settings::default()
    };
    let scene = Scene::new().with(block.clone(), Pose::IDENTITY);
    let renderer = HapticRenderer::new(block, scene, Box::new(device), settings)?;
    let (_, records) = options.render("blocks_rotating", "Ridged block turned on another", renderer)?;
    let turned = |record: &palpate::Record| record.object.rotation.to_scaled_axis().z;
    let pressed = records.iter().filter(|record| record.contacts > 0);
    let (mut least, mut most) = (f64::INFINITY, (0.0_f64, 0.0));
    for record in pressed {
        least = least.min(record.object.translation.z);
        if turned(record).abs() > most.0 {
            most = (turned(record).abs(), record.object.translation.z);
        }
    }
    say("turned by at most", format_args!("{:.2} degrees", most.0.to_degrees()))?;
    say("risen there", format_args!("{:.3} mm", 1e3 * (most.1 - least)))?;
    Ok(())
}

/// Returns the intended pose of the block: down onto the other one, and turned to and fro three times.
fn turning(time: f64, seconds: f64) -> Pose {
    let part = time / seconds;
    let down = smooth((part - 0.05) / 0.1);
    let turn = TURN * (3.0 * TAU * ((part - 0.2) / 0.75).clamp(0.0, 1.0)).sin();
    let place = DVec3::new(0.0, 0.0, HEIGHT + 0.004 - 0.007 * down);
    Pose::new(place, DQuat::from_rotation_z(turn))
}
