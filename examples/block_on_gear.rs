//! Ridged block that is dragged across the teeth of a gear, along them, and lifted (Fig. 4.14 of the
//! dissertation): it climbs over the teeth in steps, and feels almost nothing along them.
//!
//! `cargo run --release --features textures --example block_on_gear`

use std::error::Error;
use std::f64::consts::{FRAC_PI_2, TAU};

use palpate::device::Emulation;
use palpate::glam::{DQuat, DVec3};
use palpate::settings::{SearchSettings, TextureSettings};
use palpate::{HapticRenderer, Pose, Scene, Settings};
use palpate_examples::{Options, detailed, path, say, smooth};

/// Half the block's height, m, and height of the gear's rim above its middle, m.
const HALF_BLOCK: f64 = 0.018;
const RIM: f64 = 0.0306;

fn main() -> Result<(), Box<dyn Error>> {
    let options = Options::parse("Renders a block on a gear")?;
    let block = detailed("block", 300, 2e-4)?;
    let gear = detailed("gear", 1600, 2e-4)?;
    // The gear stands upright, with its axis along x like the block's ridges.
    let upright = Pose::new(DVec3::ZERO, DQuat::from_rotation_y(FRAC_PI_2));
    let path = path(options.seconds, |time| dragging(time, options.seconds))?;
    let device = Emulation::default().open(path)?;
    let settings = Settings {
        search: SearchSettings { tolerance: Some(2e-4), ..SearchSettings::default() },
        textures: TextureSettings { half_size: Some(0.016), ..TextureSettings::default() },
        ..Settings::default()
    };
    let scene = Scene::new().with(gear, upright);
    let renderer = HapticRenderer::new(block, scene, Box::new(device), settings)?;
    let (_, records) = options.render("block_on_gear", "Ridged block on a gear", renderer)?;
    let largest = records.iter().fold(DVec3::ZERO, |most, record| most.max(record.contact.force.abs()));
    say("largest contact force along the teeth", format_args!("{:.4} N", largest.x))?;
    say("across them, and upwards", format_args!("{:.2} N, {:.2} N", largest.y, largest.z))?;
    Ok(())
}

/// Returns the intended pose of the block: down onto the gear, across its teeth there and back, along them,
/// and up.
fn dragging(time: f64, seconds: f64) -> Pose {
    let touching = HALF_BLOCK + RIM;
    let part = time / seconds;
    let down = smooth((part - 0.05) / 0.1) - smooth((part - 0.9) / 0.1);
    let across = 0.012 * (TAU * smooth((part - 0.2) / 0.4)).sin();
    let along = 0.006 * (TAU * smooth((part - 0.6) / 0.25)).sin();
    let place = DVec3::new(along, across, touching + 0.006 - 0.01 * down);
    Pose::from_translation(place)
}
