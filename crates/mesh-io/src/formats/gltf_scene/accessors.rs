//! Reading of accessors: positions, texture coordinates and indices, dequantised, with sparse values applied,
//! from any buffer.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use base64::Engine;
use glam::{DVec2, DVec3};
use gltf::json::accessor::{Accessor, ComponentType, Type};
use gltf::json::validation::Checked;
use gltf::json::{Index, accessor, buffer};

use super::{MAX_ELEMENTS, Reader};
use crate::LoadError;
use crate::formats::read_file;
use crate::formats::text::quoted;

/// Extensions that hold geometry in a compressed form.
const COMPRESSED: [&str; 3] =
    ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"];

impl<'a> Reader<'a> {
    /// The positions of an accessor, one a vertex.
    pub(super) fn positions(&mut self, index: Index<Accessor>, place: &str) -> Result<Vec<DVec3>, LoadError> {
        let values =
            self.vectors(index, (Type::Vec3, 3), format!("{place}, accessor {} (POSITION)", index.value()))?;
        Ok(values.chunks_exact(3).map(|v| DVec3::new(v[0], v[1], v[2])).collect())
    }

    /// The texture coordinates of an accessor, one a vertex.
    pub(super) fn coordinates(
        &mut self,
        index: Index<Accessor>,
        set: u32,
        place: &str,
    ) -> Result<Vec<DVec2>, LoadError> {
        let place = format!("{place}, accessor {} (TEXCOORD_{set})", index.value());
        let values = self.vectors(index, (Type::Vec2, 2), place)?;
        Ok(values.chunks_exact(2).map(|v| DVec2::new(v[0], v[1])).collect())
    }

    /// The components of an accessor of vectors: of type `kind`, with `width` components each.
    fn vectors(
        &mut self,
        index: Index<Accessor>,
        (kind, width): (Type, usize),
        place: String,
    ) -> Result<Vec<f64>, LoadError> {
        let accessor = self.accessor(index, kind, &place)?;
        let Checked::Valid(accessor::GenericComponentType(component)) = accessor.component_type else {
            return Err(self.malformed(place, "its component type is none of glTF's".into()));
        };
        self.components(accessor, component, width, &place)
    }

    /// The indices of a primitive, all below `vertices`.
    pub(super) fn indices(
        &mut self,
        index: Index<Accessor>,
        vertices: usize,
        place: &str,
    ) -> Result<Vec<u32>, LoadError> {
        let place = format!("{place}, accessor {} (indices)", index.value());
        let accessor = self.accessor(index, Type::Scalar, &place)?;
        let component = match accessor.component_type {
            Checked::Valid(accessor::GenericComponentType(
                component @ (ComponentType::U8 | ComponentType::U16 | ComponentType::U32),
            )) => component,
            _ => return Err(self.malformed(place, "indices must be unsigned integers".into())),
        };
        let values = self.components(accessor, component, 1, &place)?;
        if let Some(at) = values.iter().position(|&v| v >= vertices as f64) {
            let reason =
                format!("index {at} names vertex {}, but there are {vertices}, counted from 0", values[at]);
            return Err(self.malformed(place, reason));
        }
        Ok(values.iter().map(|&v| v as u32).collect())
    }

    fn accessor(&self, index: Index<Accessor>, kind: Type, place: &str) -> Result<&'a Accessor, LoadError> {
        let Some(accessor) = self.root.accessors.get(index.value()) else {
            return Err(self.malformed(place.into(), "is not there".into()));
        };
        if accessor.type_ != Checked::Valid(kind) {
            return Err(self
                .malformed(place.into(), format!("must be of type {}", format!("{kind:?}").to_uppercase())));
        }
        if accessor.count.0 > MAX_ELEMENTS as u64 {
            return Err(self.too_large("vertices"));
        }
        Ok(accessor)
    }

    /// All components of an accessor, dequantised, with sparse values applied.
    fn components(
        &mut self,
        accessor: &Accessor,
        component: ComponentType,
        width: usize,
        place: &str,
    ) -> Result<Vec<f64>, LoadError> {
        let count = accessor.count.0 as usize;
        if accessor.buffer_view.is_none() && accessor.sparse.is_none() {
            let compressed = |name: &&String| COMPRESSED.contains(&name.as_str());
            return Err(match self.root.extensions_used.iter().find(compressed) {
                Some(name) => self.unsupported(name.clone()),
                None => self.malformed(place.into(), "has no data".into()),
            });
        }
        let normalized = accessor.normalized;
        let mut values = match accessor.buffer_view {
            Some(view) => {
                let offset = accessor.byte_offset.unwrap_or_default().0;
                self.strided(view, offset, count, component, width, normalized, place)?
            }
            None => vec![0.0; count * width],
        };
        if let Some(sparse) = &accessor.sparse {
            let place = format!("{place}, sparse");
            let replaced = sparse.count.0;
            if replaced > count as u64 {
                let reason = format!("replaces {replaced} of {count} elements");
                return Err(self.malformed(place, reason));
            }
            let replaced = replaced as usize;
            let Checked::Valid(accessor::IndexComponentType(index_type)) = sparse.indices.component_type
            else {
                return Err(self.malformed(place, "its indices must be unsigned integers".into()));
            };
            let (view, offset) = (sparse.indices.buffer_view, sparse.indices.byte_offset.0);
            let at = self.strided(view, offset, replaced, index_type, 1, false, &place)?;
            let (view, offset) = (sparse.values.buffer_view, sparse.values.byte_offset.0);
            let new = self.strided(view, offset, replaced, component, width, normalized, &place)?;
            for (element, new) in at.iter().zip(new.chunks_exact(width)) {
                let element = *element as usize;
                if element >= count {
                    return Err(self.malformed(place, format!("replaces element {element} of {count}")));
                }
                values[element * width..][..width].copy_from_slice(new);
            }
        }
        Ok(values)
    }

    #[expect(
        clippy::too_many_arguments,
        reason = "they are the fields of an accessor, which sparse parts only have some of"
    )]
    fn strided(
        &mut self,
        view: Index<buffer::View>,
        offset: u64,
        count: usize,
        component: ComponentType,
        width: usize,
        normalized: bool,
        place: &str,
    ) -> Result<Vec<f64>, LoadError> {
        let size = match component {
            ComponentType::I8 | ComponentType::U8 => 1,
            ComponentType::I16 | ComponentType::U16 => 2,
            ComponentType::U32 | ComponentType::F32 => 4,
        };
        let element = size * width;
        let stride = self.view(view, place)?.byte_stride.map_or(element, |stride| stride.0);
        if stride < element {
            let reason = format!(
                "its buffer view's stride of {stride} bytes is less than the {element} of an element"
            );
            return Err(self.malformed(place.into(), reason));
        }
        let needed = match count {
            0 => Some(0),
            _ => (stride as u64).checked_mul(count as u64 - 1).and_then(|n| n.checked_add(element as u64)),
        };
        let (view_bytes, described) = self.view_bytes(view, place)?;
        let bytes = needed
            .and_then(|needed| {
                Some(usize::try_from(offset).ok()?..usize::try_from(offset.checked_add(needed)?).ok()?)
            })
            .and_then(|range| view_bytes?.get(range));
        let Some(bytes) = bytes else {
            let reason =
                format!("{count} elements of {element} bytes from byte {offset} on do not fit {described}");
            return Err(self.malformed(place.into(), reason));
        };
        let decode = |b: &[u8]| match component {
            ComponentType::I8 => quantised(f64::from(b[0] as i8), 127.0, normalized),
            ComponentType::U8 => quantised(f64::from(b[0]), 255.0, normalized),
            ComponentType::I16 => quantised(f64::from(i16::from_le_bytes([b[0], b[1]])), 32767.0, normalized),
            ComponentType::U16 => quantised(f64::from(u16::from_le_bytes([b[0], b[1]])), 65535.0, normalized),
            ComponentType::U32 => f64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            ComponentType::F32 => f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])),
        };
        Ok(bytes.chunks(stride).flat_map(|chunk| chunk[..element].chunks_exact(size).map(decode)).collect())
    }

    fn view(&self, index: Index<buffer::View>, place: &str) -> Result<&'a buffer::View, LoadError> {
        let index = index.value();
        self.root.buffer_views.get(index).ok_or_else(|| {
            self.malformed(place.into(), format!("names buffer view {index}, which is not there"))
        })
    }

    /// The bytes of a buffer view, if its buffer holds them, and a description of the view for messages.
    pub(super) fn view_bytes(
        &mut self,
        index: Index<buffer::View>,
        place: &str,
    ) -> Result<(Option<&[u8]>, String), LoadError> {
        let view = self.view(index, place)?;
        let start = view.byte_offset.unwrap_or_default().0;
        let length = view.byte_length.0;
        let data = self.buffer(view.buffer.value())?;
        let described = format!(
            "buffer view {} ({length} bytes from byte {start} of a buffer of {})",
            index.value(),
            data.len()
        );
        let bytes = usize::try_from(start)
            .ok()
            .zip(start.checked_add(length).and_then(|end| usize::try_from(end).ok()))
            .and_then(|(start, end)| data.get(start..end));
        Ok((bytes, described))
    }

    fn buffer(&mut self, index: usize) -> Result<&[u8], LoadError> {
        if !self.buffers.contains_key(&index) {
            let bytes = self.read_buffer(index)?;
            self.buffers.insert(index, bytes);
        }
        Ok(&self.buffers[&index])
    }

    fn read_buffer(&self, index: usize) -> Result<Cow<'a, [u8]>, LoadError> {
        let place = || format!("buffer {index}");
        let Some(buffer) = self.root.buffers.get(index) else {
            return Err(self.malformed(place(), "is not there".into()));
        };
        let bytes: Cow<'a, [u8]> = match (&buffer.uri, self.bin) {
            (None, Some(bin)) if index == 0 => bin.into(),
            (None, _) => {
                let compressed = |name: &&String| COMPRESSED.contains(&name.as_str());
                return Err(match self.root.extensions_used.iter().find(compressed) {
                    Some(name) => self.unsupported(name.clone()),
                    None => self.malformed(place(), "has neither a uri nor a binary chunk".into()),
                });
            }
            (Some(uri), _) => self.uri_bytes(uri, "buffer", &place())?.into(),
        };
        if (bytes.len() as u64) < buffer.byte_length.0 {
            let reason = format!("has {} bytes instead of {}", bytes.len(), buffer.byte_length.0);
            return Err(self.malformed(place(), reason));
        }
        Ok(bytes)
    }

    /// The bytes that a URI names: base64 data in the URI itself, or a file beside the scene's. `what` is
    /// their purpose, for messages.
    pub(super) fn uri_bytes(&self, uri: &str, what: &str, place: &str) -> Result<Vec<u8>, LoadError> {
        let Some(data) = uri.strip_prefix("data:") else {
            return read_file(&self.beside(uri, what)?);
        };
        let Some((_, data)) = data.split_once(";base64,") else {
            return Err(self.malformed(place.into(), "its data URI is not base64".into()));
        };
        let engine = base64::engine::general_purpose::GeneralPurpose::new(
            &base64::alphabet::STANDARD,
            base64::engine::general_purpose::NO_PAD
                .with_decode_padding_mode(base64::engine::DecodePaddingMode::Indifferent),
        );
        engine.decode(data).map_err(|e| self.malformed(place.into(), format!("its data URI: {e}")))
    }

    /// The file that a relative URI names.
    pub(super) fn beside(&self, uri: &str, what: &str) -> Result<PathBuf, LoadError> {
        let name = percent_decoded(uri);
        let relative = Path::new(&name);
        if relative.is_absolute() || uri.split('/').next().is_some_and(|head| head.contains(':')) {
            let feature = format!("{what} uri {} (neither relative nor data)", quoted(uri.as_bytes()));
            return Err(self.unsupported(feature));
        }
        Ok(self.path.parent().unwrap_or(Path::new("")).join(relative))
    }
}

/// A component, dequantised (glTF 2.0, 3.11).
fn quantised(value: f64, largest: f64, normalized: bool) -> f64 {
    if normalized { (value / largest).max(-1.0) } else { value }
}

/// A URI's path with `%20` and the like replaced.
fn percent_decoded(uri: &str) -> String {
    let mut bytes = Vec::with_capacity(uri.len());
    let mut rest = uri.as_bytes();
    while let [first, tail @ ..] = rest {
        let hex = |b: u8| char::from(b).to_digit(16);
        match (first, tail) {
            (b'%', [high, low, tail @ ..]) if hex(*high).is_some() && hex(*low).is_some() => {
                bytes.push((hex(*high).unwrap_or(0) * 16 + hex(*low).unwrap_or(0)) as u8);
                rest = tail;
            }
            _ => {
                bytes.push(*first);
                rest = tail;
            }
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}
