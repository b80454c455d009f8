//! Objects with haptic textures, by the options of the command line.

use std::ops::ControlFlow;
use std::path::Path;

use palpate::mesh_io::{HeightTexture, LoadOptions, TextureWrap, load_uv, names_height_texture};
use palpate::texture_pd::{BakeOptions, HeightImage, HeightOptions, Wrap, texel_sizes};
use palpate::{Object, OpenOptions, open_mesh};

use crate::failure::Failure;
use crate::progress;

/// Angle between triangles of a coarse mesh above which their edge is sharp, rad. With a smaller one, round
/// surfaces get creases; with a larger one, sharp edges are rounded.
const CREASE: f64 = 0.6;

/// Default size of baked texels, in bounding radii. Smaller ones take more memory and time.
const DEFAULT_TEXEL: f64 = 1.0 / 400.0;

/// Source of an object's fine detail.
pub enum Detail<'a> {
    /// No option was given.
    None,
    /// An image for the object's texture coordinates, and its amplitude from black to white, m.
    Heights(&'a Path, f64),
    /// A detailed mesh in the same frame, and the size of baked texels, m.
    Mesh(&'a str, Option<f64>),
}

/// Opens an object with its detail and a progress bar, and prints the loaders' warnings. Without an option
/// for detail, a glTF file has the detail of the height texture that it names.
pub fn open(argument: &str, detail: &Detail<'_>, options: &OpenOptions) -> Result<Object, Failure> {
    match *detail {
        // If the file cannot be read, opening it reports the error.
        Detail::None if names_height_texture(Path::new(argument)).unwrap_or(false) => {
            if options.repair {
                let left_out = "its height texture is left out: repair separates triangles from it";
                progress::warn(argument, &[left_out.to_owned()]);
                return Ok(progress::open(argument, options)?);
            }
            displaced(argument, None, options)
        }
        Detail::None => Ok(progress::open(argument, options)?),
        Detail::Heights(image, amplitude) => displaced(argument, Some((image, amplitude)), options),
        Detail::Mesh(detailed, texel) => baked(argument, detailed, texel, options),
    }
}

/// Opens an object displaced by an image with an amplitude, or by the height texture that its file names.
fn displaced(argument: &str, image: Option<(&Path, f64)>, options: &OpenOptions) -> Result<Object, Failure> {
    let load = LoadOptions { scale: options.scale, repair: options.repair, ..LoadOptions::default() };
    let loaded = load_uv(Path::new(argument), &load).map_err(|error| Failure::Message(error.to_string()))?;
    let (name, heights) = match (image, loaded.height_texture) {
        (Some((image, amplitude)), _) => {
            (image.display().to_string(), HeightImage::open(image, &HeightOptions::new(amplitude)))
        }
        (None, Some(HeightTexture { bytes, name, amplitude, midlevel, wrap })) => {
            let options = HeightOptions { amplitude, midlevel, wrap: wrap.map(wrapped) };
            let heights = HeightImage::decode(&bytes, &name, &options);
            (name, heights)
        }
        (None, None) => return Ok(progress::open(argument, options)?),
    };
    progress::warn_of_loading(argument, &loaded.warnings);
    let (heights, warnings) = heights.map_err(|error| Failure::Message(error.to_string()))?;
    progress::warn(&name, &warnings);
    let size = [heights.width(), heights.height()];
    progress::warn(argument, &texel_sizes(&loaded.mesh, size).warnings);
    Ok(Object::textured(argument, &loaded.mesh, &heights, CREASE)?)
}

fn wrapped(wrap: TextureWrap) -> Wrap {
    match wrap {
        TextureWrap::Repeat => Wrap::Repeat,
        TextureWrap::ClampToEdge => Wrap::Clamp,
        TextureWrap::MirroredRepeat => Wrap::Mirror,
    }
}

fn baked(
    argument: &str,
    detailed: &str,
    texel: Option<f64>,
    options: &OpenOptions,
) -> Result<Object, Failure> {
    let [coarse, detailed] = [argument, detailed].map(|argument| open_mesh(argument, options));
    let (coarse, detailed) = (coarse?, detailed?);
    progress::warn_of_loading(&coarse.name, &coarse.warnings);
    progress::warn_of_loading(&detailed.name, &detailed.warnings);
    let texel = texel.unwrap_or(DEFAULT_TEXEL * coarse.mesh.bounding_sphere().radius);
    let bar = progress::bar(&format!("{}: baking", detailed.name));
    let options = BakeOptions { texel, reach: None, crease: CREASE };
    let made = Object::detailed(argument, &coarse.mesh, &detailed.mesh, &options, &mut |fraction| {
        progress::set(&bar, fraction);
        ControlFlow::Continue(())
    });
    bar.finish_and_clear();
    Ok(made?.0)
}
