//! Loading a mesh with texture coordinates, and the image of fine detail that a glTF file may name.

use std::path::Path;

use palpate_core::mesh::{UvMesh, UvMeshError};

use crate::formats::surface::{Surface, Wanted};
#[cfg(feature = "gltf")]
use crate::formats::{gltf_scene, read_file};
use crate::load::{read, scaled};
use crate::{LoadError, LoadOptions, LoadWarning};

/// A mesh with texture coordinates as loaded, with warnings about it.
#[derive(Clone, Debug)]
pub struct LoadedUvMesh {
    /// The mesh (m) and its texture coordinates. Every vertex is finite and used by a triangle.
    pub mesh: UvMesh,
    /// Warnings about content that was left out or is doubtful, in the order in which it was found.
    pub warnings: Vec<LoadWarning>,
    /// The image of fine detail that the file names. OBJ files name none.
    pub height_texture: Option<HeightTexture>,
}

/// An image of displacements, encoded as in its file, and the scale of its values.
///
/// glTF has no ratified extension for one; it is named in the `extras` of a material:
///
/// ```json
/// {"heightTexture": {"index": 0, "texCoord": 0, "amplitude": 0.001, "midlevel": 0.5}}
/// ```
///
/// `index` is that of a glTF texture and `amplitude` the difference in height (m) of black and white.
/// `texCoord` (0 if left out) is the set of texture coordinates, `midlevel` (0.5 if left out) the value of
/// zero displacement.
#[derive(Clone, Debug, PartialEq)]
pub struct HeightTexture {
    /// The encoded image: the content of an image file.
    pub bytes: Vec<u8>,
    /// Its origin, for messages.
    pub name: String,
    /// Metres from black to white; finite and above zero. No scale of the file or of the options applies to
    /// it.
    pub amplitude: f64,
    /// The value of zero displacement, where black is 0 and white is 1; finite.
    pub midlevel: f64,
    /// Continuation of the image beyond its border, along u and along v.
    pub wrap: [TextureWrap; 2],
}

/// Continuation of an image beyond its border, in the terms of glTF's samplers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum TextureWrap {
    /// The image is repeated.
    #[default]
    Repeat,
    /// The texels of the border are continued.
    ClampToEdge,
    /// The image is repeated, every other copy mirrored.
    MirroredRepeat,
}

/// Whether a file is glTF and one of its materials names a [`HeightTexture`], which [`load_uv`] would load.
/// Reads only the file itself, and not its geometry.
///
/// # Errors
/// If the file cannot be read.
pub fn names_height_texture(path: &Path) -> Result<bool, LoadError> {
    let named = path
        .extension()
        .is_some_and(|extension| ["gltf", "glb"].iter().any(|gltf| extension.eq_ignore_ascii_case(gltf)));
    #[cfg(feature = "gltf")]
    let named = named && gltf_scene::names_height_texture(&read_file(path)?, path);
    // Without the reader, `load_uv` refuses the file and says why.
    Ok(named)
}

/// Loads a mesh with texture coordinates; the extension names the format: .obj, .gltf or .glb.
///
/// As with [`load`](crate::load()), triangles keep the order of the file, vertices are welded exactly, and
/// the scale applies to positions. Texture coordinates stay with the corners of triangles, so that seams do
/// not open the surface; those of OBJ are turned over to glTF's convention (v = 0 on the image's first row).
/// A glTF file's texture coordinates are the set `TEXCOORD_0`, or the one that the material's
/// [`HeightTexture`] names; `KHR_texture_transform` is not applied, and refused on a height texture.
///
/// # Errors
/// See [`LoadError`]. A face without texture coordinates is an error, as are triangles with numbers that are
/// not finite, different height textures in one file, and a height texture on a part of the surface only.
/// Repair is refused: it would separate triangles from their texture coordinates.
pub fn load_uv(path: &Path, options: &LoadOptions) -> Result<LoadedUvMesh, LoadError> {
    if options.repair {
        return Err(LoadError::TextureCoordinates {
            file: path.into(),
            place: "repair".into(),
            reason: "would separate triangles from their texture coordinates".into(),
            remedy: "load the file without, or repair the model before it is unwrapped",
        });
    }
    let Surface { vertices, triangles, coordinates, height_texture, mut warnings } =
        read(path, options, Wanted::Textured)?;
    let mesh = scaled(vertices, triangles, path, options)?;
    warnings.extend(LoadWarning::of_loaded_size(mesh.bounding_sphere().radius, options));
    let mesh = UvMesh::new(mesh, coordinates).map_err(|error| LoadError::TextureCoordinates {
        file: path.into(),
        place: match error {
            UvMeshError::NonFinite { triangle } => format!("triangle {triangle}"),
            UvMeshError::Count { .. } => "triangles".into(),
        },
        reason: error.to_string(),
        remedy: "correct that coordinate or unwrap the model again",
    })?;
    Ok(LoadedUvMesh { mesh, warnings, height_texture })
}
