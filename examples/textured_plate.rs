//! Probe with a round tip that explores a plate with ridges 8 mm high, which is a flat plate with a texture:
//! from left to right, and faster back (§5.5.4 of the dissertation).
//!
//! `cargo run --release --features textures --example textured_plate`; `-- --flat` for the plate without its
//! texture.

use std::error::Error;
use std::f64::consts::TAU;

use palpate::core::mesh::UvMesh;
use palpate::device::Emulation;
use palpate::glam::{DVec2, DVec3};
use palpate::models::Model;
use palpate::settings::{ContactSettings, CouplingSettings, SearchSettings, ToolSettings};
use palpate::texture_pd::{HeightImage, Wrap};
use palpate::{HapticRenderer, Object, Pose, Scene, Settings};
use palpate_examples::{CommandLine, Options, open, path, smooth};

/// Height of the ridges, and their distance, m.
const HEIGHT: f64 = 8e-3;
const SPACING: f64 = 0.04;
/// Number of texels from crest to crest.
const TEXELS: u32 = 64;
/// Radius of the probe's tip, m.
const TIP: f64 = 0.01;

/// Options beyond those of every session.
const HELP: [&str; 2] =
    ["--flat         Leave the texture out", "--stiffness K  Contact stiffness, N/m [default: 2000]"];

fn main() -> Result<(), Box<dyn Error>> {
    let mut line = CommandLine::new(
        "Renders a probe that explores a plate with ridges",
        &[&Options::HELP[..], &HELP].concat(),
    );
    let options = Options::take(&mut line)?;
    let (flat, stiffness) = (line.flag("--flat"), line.value("--stiffness", 2000.0)?);
    line.finish()?;
    let stylus = open("stylus@5000")?;
    let plate = if flat { open("plate")? } else { ridged_plate()? };
    let device = Emulation::default().open(path(options.seconds, |time| strokes(time, options.seconds))?)?;
    let scene = Scene::new().with(plate, Pose::IDENTITY);
    let settings = Settings {
        tool: ToolSettings { mass: 0.01, ..ToolSettings::default() },
        contact: ContactSettings { stiffness, ..ContactSettings::default() },
        coupling: CouplingSettings {
            stiffness: Some(200.0),
            angular_stiffness: Some(3.0),
            ..CouplingSettings::default()
        },
        search: SearchSettings { tolerance: Some(2e-4), ..SearchSettings::default() },
        ..Settings::default()
    };
    let renderer = HapticRenderer::new(stylus, scene, Box::new(device), settings)?;
    options.render("textured_plate", "Probe on a plate with ridges", renderer)?;
    Ok(())
}

/// Returns the plate with an image of one ridge, which is repeated.
fn ridged_plate() -> Result<Object, Box<dyn Error>> {
    let wave = |i: u32| (TAU * (f64::from(i) + 0.5) / f64::from(TEXELS)).cos();
    let ridge = (0..TEXELS).map(|i| (0.5 * HEIGHT * wave(i)) as f32).collect();
    let image = HeightImage::new(TEXELS, 1, ridge, [Wrap::Repeat; 2])?;
    let texel = SPACING / f64::from(TEXELS);
    let flat = Model::Plate.generate(Model::Plate.default_triangles())?;
    let mesh = UvMesh::projected(flat, |corner| DVec2::new(corner.x / SPACING, corner.y / texel))?;
    Ok(Object::textured("plate with ridges", &mesh, &image, 0.5)?)
}

/// Returns the intended pose of the tip: down onto the plate and 1 cm further, to the right in half of the
/// remaining time, and back in half of that.
fn strokes(time: f64, seconds: f64) -> Pose {
    let above = TIP + 0.5 * HEIGHT + 0.002;
    let part = time / seconds;
    let down = smooth((part - 0.05) / 0.15);
    let along = smooth((part - 0.2) / 0.5) - smooth((part - 0.7) / 0.25);
    let place = DVec3::new(0.24 * along - 0.12, 0.0, above - (above + 0.01 - TIP) * down);
    Pose::from_translation(place)
}
