//! Draws the built-in models: one PNG a model, and a contact sheet of all.
//!
//! `cargo xtask pictures [MODEL…] [-o DIR]`; a model is a name or `NAME@TRIANGLES`. [`raster`] is the renderer.

mod lettering;
mod raster;
mod scenes;

use std::error::Error;
use std::path::PathBuf;

use image::{Rgb, RgbImage, imageops};
use palpate_models::Model;

use raster::{Item, Shading, View};

/// What `cargo xtask pictures` is asked to draw.
#[derive(clap::Args)]
pub struct Arguments {
    /// Models to draw, as NAME or NAME@TRIANGLES; all of them when none is named.
    models: Vec<String>,
    /// Folder for the pictures.
    #[arg(short, long, value_name = "DIR", default_value = "target/pictures")]
    output: PathBuf,
    /// Looks from this direction instead of each model's own: degrees about the vertical, from x towards y.
    #[arg(long, allow_negative_numbers = true)]
    azimuth: Option<f64>,
    /// Looks down from this angle above the horizon, in degrees, instead of each model's own.
    #[arg(long, allow_negative_numbers = true)]
    elevation: Option<f64>,
    /// Magnifies the middle of the picture.
    #[arg(long, default_value_t = 1.0)]
    zoom: f64,
    /// Shows the triangles: flat shading with their edges drawn.
    #[arg(long)]
    edges: bool,
}

const TILE_WIDTH: u32 = 320;
const TILE_HEIGHT: u32 = 240;
const LABEL_HEIGHT: u32 = 28;
const COLUMNS: u32 = 4;

/// Draws the pictures and prints the name of each file written.
///
/// # Errors
/// If a model's name is unknown, its number of triangles is out of range, or a file cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), Box<dyn Error>> {
    let wanted = if arguments.models.is_empty() {
        Model::ALL.iter().map(|model| (*model, model.name().to_owned(), model.default_triangles())).collect()
    } else {
        let mut wanted = Vec::new();
        for text in &arguments.models {
            let (model, triangles) = Model::parse(text)?;
            wanted.push((model, text.replace('@', "-"), triangles));
        }
        wanted
    };
    std::fs::create_dir_all(&arguments.output)
        .map_err(|error| format!("cannot create the folder {}: {error}", arguments.output.display()))?;

    let save = |picture: &RgbImage, name: &str| -> Result<(), Box<dyn Error>> {
        let path = arguments.output.join(format!("{name}.png"));
        picture.save(&path).map_err(|error| format!("cannot write {}: {error}", path.display()))?;
        println!("{}", path.display());
        Ok(())
    };

    let mut tiles = Vec::new();
    for (model, name, triangles) in wanted {
        let mesh = model.generate(triangles)?;
        let scene = scenes::view(model);
        let view = View {
            azimuth: arguments.azimuth.map_or(scene.azimuth, f64::to_radians),
            elevation: arguments.elevation.map_or(scene.elevation, f64::to_radians),
            zoom: arguments.zoom,
            shading: if arguments.edges { Shading::Edges } else { Shading::Smooth },
            ..scene
        };
        let picture = raster::render(&[Item::new(&mesh, scenes::color(model))], &view);
        save(&picture, &name)?;
        tiles.push((name, picture));
    }
    if tiles.len() > 1 {
        save(&contact_sheet(&tiles), "contact-sheet")?;
    }
    if arguments.models.is_empty() {
        save(&scenes::touching_jaws()?, "touching-jaws")?;
    }
    Ok(())
}

/// The pictures side by side in rows, each with its name below.
fn contact_sheet(tiles: &[(String, RgbImage)]) -> RgbImage {
    let rows = (tiles.len() as u32).div_ceil(COLUMNS);
    let columns = COLUMNS.min(tiles.len() as u32);
    let mut sheet =
        RgbImage::from_pixel(columns * TILE_WIDTH, rows * (TILE_HEIGHT + LABEL_HEIGHT), Rgb([255; 3]));
    for (index, (name, picture)) in (0..).zip(tiles) {
        let (left, top) = (index % COLUMNS * TILE_WIDTH, index / COLUMNS * (TILE_HEIGHT + LABEL_HEIGHT));
        let tile = imageops::thumbnail(picture, TILE_WIDTH, TILE_HEIGHT);
        imageops::replace(&mut sheet, &tile, left.into(), top.into());
        let indent = TILE_WIDTH.saturating_sub(lettering::width(name, 2)) / 2;
        lettering::write(&mut sheet, name, left + indent, top + TILE_HEIGHT + 7, 2, Rgb([40; 3]));
    }
    sheet
}
