//! Hammer that touches a wrinkled torus (Fig. 4.12 of the dissertation): an emulated hand presses, scrubs and
//! twists it.
//!
//! `cargo run --release --features textures --example hammer_on_torus`

use std::error::Error;

use palpate::device::{Emulation, Task};
use palpate::settings::{SearchSettings, TextureSettings};
use palpate::{HapticRenderer, Pose, Scene, Settings, explore};
use palpate_examples::{Options, detailed};

fn main() -> Result<(), Box<dyn Error>> {
    let options = Options::parse("Renders a hammer on a wrinkled torus")?;
    let probe = detailed("hammer", 804, 2e-4)?;
    let scene = Scene::new().with(detailed("torus", 532, 2e-4)?, Pose::IDENTITY);
    let device = Emulation::default().open(explore::path(Task::default(), &probe, &scene)?)?;
    let settings = Settings {
        search: SearchSettings { tolerance: Some(2e-4), clusters: 7, ..SearchSettings::default() },
        textures: TextureSettings { half_size: Some(0.01), ..TextureSettings::default() },
        ..Settings::default()
    };
    let renderer = HapticRenderer::new(probe, scene, Box::new(device), settings)?;
    options.render("hammer_on_torus", "A hammer touches a wrinkled torus", renderer)?;
    Ok(())
}
