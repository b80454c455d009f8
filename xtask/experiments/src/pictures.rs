//! Draws the built-in models, one PNG each, a contact sheet of them, and the other pictures of the README.
//!
//! `cargo xtask pictures [MODEL…] [-o DIR]`; a model is a name or `NAME@TRIANGLES`.

mod scenes;

use std::error::Error;
use std::path::PathBuf;

use palpate_models::Model;
use palpate_report::raster::{Camera, Item, Shading, View};
use palpate_report::sheet::{Tile, contact_sheet};
use palpate_report::{Picture, views};

/// Arguments of `cargo xtask pictures`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Models to draw, as NAME or NAME@TRIANGLES; all if none is named.
    models: Vec<String>,
    /// Folder for the pictures.
    #[arg(short, long, value_name = "DIR", default_value = "target/pictures")]
    output: PathBuf,
    /// Views from this direction instead of each model's own: degrees about the vertical, from x towards y.
    #[arg(long, allow_negative_numbers = true)]
    azimuth: Option<f64>,
    /// Views from this angle above the horizon, in degrees, instead of each model's own.
    #[arg(long, allow_negative_numbers = true)]
    elevation: Option<f64>,
    /// Magnifies the middle of the picture.
    #[arg(long, default_value_t = 1.0)]
    zoom: f64,
    /// Shows the triangles: flat shading with edges.
    #[arg(long)]
    edges: bool,
}

/// Size of a picture, pixels.
const WIDTH: u32 = 640;
const HEIGHT: u32 = 480;
/// Layout of the contact sheet: columns, width of a tile in pixels, and size of a dot in its lettering.
const COLUMNS: u32 = 4;
const TILE_WIDTH: u32 = 320;
const DOT: u32 = 2;

/// Draws the pictures and prints the names of the written files.
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

    let save = |picture: &Picture, name: &str| -> Result<(), Box<dyn Error>> {
        let path = arguments.output.join(format!("{name}.png"));
        picture.save(&path).map_err(|error| format!("cannot write {}: {error}", path.display()))?;
        println!("{}", path.display());
        Ok(())
    };

    let mut tiles = Vec::new();
    for (model, name, triangles) in wanted {
        let mesh = model.generate(triangles)?;
        let scene = views::of_model(model);
        let view = View {
            azimuth: arguments.azimuth.map_or(scene.azimuth, f64::to_radians),
            elevation: arguments.elevation.map_or(scene.elevation, f64::to_radians),
            zoom: arguments.zoom,
            ..scene
        };
        let shading = if arguments.edges { Shading::Flat { line_width: 1.0 } } else { Shading::Smooth };
        let camera = Camera::fit(mesh.vertices(), &view, WIDTH, HEIGHT);
        let picture = camera.render(&[Item::new(&mesh, scenes::color(model))], shading);
        save(&picture, &name)?;
        tiles.push(Tile { picture, caption: vec![name] });
    }
    if tiles.len() > 1 {
        save(&contact_sheet(&tiles, COLUMNS, TILE_WIDTH, DOT), "contact-sheet")?;
    }
    if arguments.models.is_empty() {
        save(&scenes::touching_jaws()?, "touching-jaws")?;
        save(&scenes::levels_of_lower_jaw()?, "levels")?;
        for (name, picture) in scenes::assemblies()? {
            save(&picture, name)?;
        }
    }
    Ok(())
}
