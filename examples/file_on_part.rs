//! File that scrapes a rough CAD part (Fig. 4.13 of the dissertation): an emulated hand presses, scrubs and
//! twists it.
//!
//! `cargo run --release --features textures --example file_on_part`

use std::error::Error;

use palpate::device::{Emulation, Task};
use palpate::settings::{SearchSettings, TextureSettings};
use palpate::{HapticRenderer, Pose, Scene, Settings, explore};
use palpate_examples::{Options, detailed};

fn main() -> Result<(), Box<dyn Error>> {
    let options = Options::parse("Renders a file on a CAD part")?;
    let probe = detailed("file", 632, 1e-4)?;
    let scene = Scene::new().with(detailed("cad-part", 8008, 2e-4)?, Pose::IDENTITY);
    let device = Emulation::default().open(explore::path(Task::default(), &probe, &scene)?)?;
    let settings = Settings {
        search: SearchSettings { tolerance: Some(2e-4), clusters: 7, ..SearchSettings::default() },
        textures: TextureSettings {
            half_size: Some(0.004),
            temperature: Some(2e-5),
            ..TextureSettings::default()
        },
        ..Settings::default()
    };
    let renderer = HapticRenderer::new(probe, scene, Box::new(device), settings)?;
    options.render("file_on_part", "A file scrapes a rough CAD part", renderer)?;
    Ok(())
}
