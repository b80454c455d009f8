//! Texture coordinates of primitives, and the height texture that materials name in their `extras`
//! ([`HeightTexture`]).
//!
//! The image is passed on undecoded, from a buffer view, a data URI or a file beside the scene.

use std::rc::Rc;

use glam::DVec2;
use gltf::json::mesh::{Primitive, Semantic};
use gltf::json::texture::{Sampler, WrappingMode};
use gltf::json::validation::Checked;
use gltf::json::{Image, Material};
use serde::Deserialize;
use serde::de::IgnoredAny;

use super::height::Height;
use super::{MAX_ELEMENTS, Reader, Shared, Skipped, one_line};
use crate::formats::text::quoted;
use crate::{HeightTexture, LoadError, LoadWarning, TextureWrap};

const TRANSFORM: &str = "KHR_texture_transform";

/// The part of a material's extras that is read here.
#[derive(Default, Deserialize)]
#[serde(rename_all = "camelCase")]
struct Extras {
    height_texture: Option<Info>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Info {
    index: usize,
    #[serde(default)]
    tex_coord: u32,
    amplitude: f64,
    #[serde(default = "half")]
    midlevel: f64,
    #[serde(default)]
    extensions: std::collections::BTreeMap<String, IgnoredAny>,
}

fn half() -> f64 {
    0.5
}

impl Reader<'_> {
    /// The texture coordinates of a primitive's `count` vertices, in the set that its height texture uses.
    pub(super) fn corner_coordinates(
        &mut self,
        primitive: &Primitive,
        count: usize,
        place: &str,
        loaded: &mut Shared,
        skipped: &mut Skipped,
    ) -> Result<Rc<[DVec2]>, LoadError> {
        let set = self.note_height(primitive, place)?;
        let Some(accessor) = primitive.attributes.get(&Checked::Valid(Semantic::TexCoords(set))) else {
            return Err(LoadError::TextureCoordinates {
                file: self.path.into(),
                place: place.into(),
                reason: format!("its faces have no texture coordinates (TEXCOORD_{set})"),
                remedy: "unwrap the whole model and export it with texture coordinates",
            });
        };
        let coordinates = match loaded.coordinates.get(&accessor.value()) {
            Some(known) => Rc::clone(known),
            None => {
                let read: Rc<[DVec2]> = self.coordinates(*accessor, set, place)?.into();
                // Any number of primitives may name accessors that have no data.
                skipped.coordinates += read.len();
                if skipped.coordinates > 3 * MAX_ELEMENTS {
                    return Err(self.too_large("texture coordinates"));
                }
                loaded.coordinates.insert(accessor.value(), Rc::clone(&read));
                read
            }
        };
        if coordinates.len() != count {
            let reason = format!("has {count} positions, but {} texture coordinates", coordinates.len());
            return Err(self.malformed(place.into(), reason));
        }
        Ok(coordinates)
    }

    /// Checks that a primitive's material has the same height texture as the first one. Returns the set of
    /// texture coordinates that it uses: 0 without one.
    fn note_height(&mut self, primitive: &Primitive, place: &str) -> Result<u32, LoadError> {
        let (height, set) = match primitive.material {
            Some(index) => self.known_height(index.value())?.unzip(),
            None => (None, None),
        };
        let (first, other) = self.height.get_or_insert_with(|| (height.clone(), place.into()));
        if *first == height {
            return Ok(set.unwrap_or(0));
        }
        let reason = match (&first, &height) {
            (Some(_), Some(_)) => format!("its height texture is not that of {other}"),
            (Some(_), None) => format!("its material has no height texture, but that of {other} has"),
            _ => format!("its material has a height texture, but that of {other} has none"),
        };
        Err(LoadError::TextureCoordinates {
            file: self.path.into(),
            place: place.into(),
            reason,
            remedy: "split the model into a file for each height texture",
        })
    }

    fn known_height(&mut self, material: usize) -> Result<Option<(Height, u32)>, LoadError> {
        if let Some(known) = self.heights.get(&material) {
            return Ok(known.clone());
        }
        let height = self.material_height(material)?;
        self.heights.insert(material, height.clone());
        Ok(height)
    }

    /// The height texture of a material, and the set of texture coordinates that it uses.
    fn material_height(&self, index: usize) -> Result<Option<(Height, u32)>, LoadError> {
        let place = format!("material {index}");
        let Some(material) = self.root.materials.get(index) else {
            return Err(self.malformed(place, "is not there".into()));
        };
        let Some(info) = self.extras(material, &place)?.height_texture else { return Ok(None) };
        let place = format!("{place}, heightTexture");
        if let Some(extension) = info.extensions.keys().next() {
            let feature = format!("{} on a height texture", quoted(extension.as_bytes()));
            return Err(LoadError::Unsupported {
                file: self.path.into(),
                feature,
                remedy: "apply it to the texture coordinates or the image and export without it",
            });
        }
        let Info { index, tex_coord, amplitude, midlevel, .. } = info;
        if !(amplitude.is_finite() && amplitude > 0.0) {
            let reason = format!("the amplitude of {amplitude} m is not above zero");
            return Err(self.malformed(place, reason));
        }
        let Some(texture) = self.root.textures.get(index) else {
            return Err(self.malformed(place, format!("names texture {index}, which is not there")));
        };
        let image = texture.source.value();
        if self.root.images.get(image).is_none() {
            return Err(self.malformed(place, format!("texture {index} has no image that is there")));
        }
        let wrap = match texture.sampler {
            None => Default::default(),
            Some(sampler) => self.wrap(sampler.value(), &place)?,
        };
        Ok(Some((Height { image, amplitude, midlevel, wrap }, tex_coord)))
    }

    /// Reads a material's extras. They may be any JSON; only an object can hold ours.
    fn extras(&self, material: &Material, place: &str) -> Result<Extras, LoadError> {
        let text = material.extras.as_ref().map_or("", |extras| extras.get().trim_ascii_start());
        if !text.starts_with('{') {
            return Ok(Extras::default());
        }
        let unusable = |e: serde_json::Error| LoadError::Malformed {
            file: self.path.into(),
            place: format!("{place}, extras"),
            reason: one_line(&e.to_string()),
            remedy: "a heightTexture needs index and amplitude (m), and may have texCoord and midlevel",
        };
        serde_json::from_str(text).map_err(unusable)
    }

    fn wrap(&self, sampler: usize, place: &str) -> Result<[TextureWrap; 2], LoadError> {
        let Some(Sampler { wrap_s, wrap_t, .. }) = self.root.samplers.get(sampler) else {
            return Err(self.malformed(place.into(), format!("names sampler {sampler}, which is not there")));
        };
        let named = |wrap: &Checked<WrappingMode>| match wrap {
            Checked::Valid(WrappingMode::Repeat) => Ok(TextureWrap::Repeat),
            Checked::Valid(WrappingMode::ClampToEdge) => Ok(TextureWrap::ClampToEdge),
            Checked::Valid(WrappingMode::MirroredRepeat) => Ok(TextureWrap::MirroredRepeat),
            Checked::Invalid => {
                Err(self.malformed(format!("sampler {sampler}"), "its wrapping is none of glTF's".into()))
            }
        };
        Ok([named(wrap_s)?, named(wrap_t)?])
    }

    /// The height texture of the primitives read so far, with its image.
    pub(super) fn height_texture(&mut self) -> Result<Option<HeightTexture>, LoadError> {
        let Some((Some(height), _)) = self.height.take() else { return Ok(None) };
        let Height { image: index, amplitude, midlevel, wrap } = height;
        let place = format!("image {index}");
        let Some(image) = self.root.images.get(index) else {
            return Err(self.malformed(place, "is not there".into()));
        };
        let name = self.image_name(image, &place)?;
        let bytes = self.image_bytes(image, &place)?;
        if bytes.is_empty() {
            return Err(self.malformed(place, "is empty".into()));
        }
        Ok(Some(HeightTexture { bytes, name, amplitude, midlevel, wrap }))
    }

    /// The image's own file, or its place in the scene's file.
    fn image_name(&self, image: &Image, place: &str) -> Result<String, LoadError> {
        match &image.uri {
            Some(uri) if !uri.starts_with("data:") => Ok(self.beside(uri, "image")?.display().to_string()),
            _ => Ok(format!("{}: {place}", self.path.display())),
        }
    }

    fn image_bytes(&mut self, image: &Image, place: &str) -> Result<Vec<u8>, LoadError> {
        match (&image.uri, image.buffer_view) {
            (Some(uri), None) => self.uri_bytes(uri, "image", place),
            (None, Some(view)) => {
                let (bytes, described) = self.view_bytes(view, place)?;
                let bytes = bytes.map(<[u8]>::to_vec);
                bytes.ok_or_else(|| self.malformed(place.into(), format!("there is no {described}")))
            }
            _ => Err(self.malformed(place.into(), "needs a uri or a buffer view, and not both".into())),
        }
    }

    /// Warns that texture transforms are ignored: they belong to other textures.
    pub(super) fn warn_of_transforms(&self, warnings: &mut Vec<LoadWarning>) {
        if self
            .root
            .extensions_used
            .iter()
            .chain(&self.root.extensions_required)
            .any(|name| name == TRANSFORM)
        {
            let effect = "texture coordinates are taken as they stand";
            warnings.push(LoadWarning::IgnoredExtension { name: TRANSFORM, effect });
        }
    }
}
