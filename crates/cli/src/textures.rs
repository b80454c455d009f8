//! Objects with haptic textures, as `palpate run` is asked for them.

use std::ops::ControlFlow;
use std::path::Path;

use palpate::mesh_io::{LoadOptions, load_uv};
use palpate::texture_pd::{BakeOptions, HeightImage, HeightOptions, texel_sizes};
use palpate::{Object, OpenOptions, open_mesh};

use crate::failure::Failure;
use crate::progress;

/// Edges of coarse meshes are sharp where their triangles differ by more, rad.
const CREASE: f64 = 0.6;

/// Texels are this part of the bounding radius where nothing is said of them.
const TEXEL: f64 = 1.0 / 400.0;

/// Where an object's fine detail comes from.
pub enum Detail<'a> {
    /// It has none.
    None,
    /// An image for the object's texture coordinates, of so many metres from black to white.
    Heights(&'a Path, f64),
    /// A detailed mesh in the same frame, and the size of texels to bake it with, m.
    Mesh(&'a str, Option<f64>),
}

/// Opens an object with its detail and progress bars, and prints what the loaders warn of.
pub fn open(argument: &str, detail: &Detail<'_>, options: &OpenOptions) -> Result<Object, Failure> {
    match *detail {
        Detail::None => Ok(progress::open(argument, options)?),
        Detail::Heights(image, amplitude) => displaced(argument, image, amplitude, options),
        Detail::Mesh(detailed, texel) => baked(argument, detailed, texel, options),
    }
}

fn displaced(argument: &str, image: &Path, amplitude: f64, options: &OpenOptions) -> Result<Object, Failure> {
    let load = LoadOptions { scale: options.scale, repair: options.repair, ..LoadOptions::default() };
    let loaded = load_uv(Path::new(argument), &load).map_err(|error| Failure::Message(error.to_string()))?;
    progress::warn(argument, &loaded.warnings);
    let (heights, warnings) = HeightImage::open(image, &HeightOptions::new(amplitude))
        .map_err(|error| Failure::Message(error.to_string()))?;
    progress::warn(&image.display().to_string(), &warnings);
    let size = [heights.width(), heights.height()];
    progress::warn(argument, &texel_sizes(&loaded.mesh, size).warnings);
    Ok(Object::textured(argument, &loaded.mesh, &heights, CREASE)?)
}

fn baked(
    argument: &str,
    detailed: &str,
    texel: Option<f64>,
    options: &OpenOptions,
) -> Result<Object, Failure> {
    let [coarse, detailed] = [argument, detailed].map(|argument| open_mesh(argument, options));
    let (coarse, detailed) = (coarse?, detailed?);
    progress::warn(&coarse.name, &coarse.warnings);
    progress::warn(&detailed.name, &detailed.warnings);
    let texel = texel.unwrap_or(TEXEL * coarse.mesh.bounding_sphere().radius);
    let bar = progress::bar(&format!("{}: baking", detailed.name));
    let options = BakeOptions { texel, reach: None, crease: CREASE };
    let made = Object::detailed(argument, &coarse.mesh, &detailed.mesh, &options, &mut |fraction| {
        progress::set(&bar, fraction);
        ControlFlow::Continue(())
    });
    bar.finish_and_clear();
    Ok(made?.0)
}
