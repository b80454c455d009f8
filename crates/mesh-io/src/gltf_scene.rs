//! glTF 2.0 scenes, as .gltf (JSON with external or embedded buffers) and .glb: every triangle of the default scene, placed
//! by its node.
//!
//! The crate `gltf` parses the container and the JSON; accessors are read here, since its own readers take positions for
//! f32 (KHR_mesh_quantization allows 8 and 16 bits) and panic on what a file merely claims. Every index, offset and count
//! is checked before use; the node graph is walked with a list of its own, each node at most once, as the format demands.
//!
//! Left out, with a warning: points and lines, skins and morph targets (the mesh is loaded as it stands at rest), instances
//! placed by EXT_mesh_gpu_instancing. Compressed geometry (KHR_draco_mesh_compression, EXT_meshopt_compression) is refused
//! unless the file carries an uncompressed form as well.

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;

use base64::Engine;
use glam::{DAffine3, DMat4, DQuat, DVec3};
use gltf::Glb;
use gltf::json::accessor::{Accessor, ComponentType, Type};
use gltf::json::mesh::{Mode, Primitive, Semantic};
use gltf::json::scene::Node;
use gltf::json::validation::Checked;
use gltf::json::{Index, Root, accessor, buffer};

use crate::LoadError;
use crate::load::{Surface, read_file};
use crate::obj::quoted;

/// Vertices or triangles above which a scene is refused: one mesh may be placed by any number of nodes, and a count need not
/// be backed by data, so that the file's size does not bound them.
const MAX_ELEMENTS: usize = 1 << 25;

const REMEDY: &str = "the file breaks the glTF 2.0 rules: run a glTF validator on it, or export it again";

/// Extensions that a file may require without its triangles being other than they seem.
const HARMLESS: [&str; 6] =
    ["KHR_mesh_quantization", "KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "KHR_xmp"];
/// Extensions that hold geometry in a compressed form.
const COMPRESSED: [&str; 3] =
    ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"];

pub(crate) fn read_glb(bytes: &[u8], path: &Path) -> Result<Surface, LoadError> {
    let bad = |place: &str, reason: String| LoadError::Malformed {
        file: path.into(),
        place: place.into(),
        reason,
        remedy: "the file is damaged or no GLB: get it or export it again",
    };
    let word = |at: usize| bytes.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let (Some(magic), Some(version), Some(length)) = (bytes.get(..4), word(4), word(8)) else {
        return Err(bad("header", format!("takes 12 bytes, but the file has {}", bytes.len())));
    };
    if magic != b"glTF" {
        return Err(bad("header", format!("starts with {} instead of \"glTF\"", quoted(magic))));
    }
    if version != 2 {
        return Err(LoadError::Unsupported {
            file: path.into(),
            feature: format!("GLB version {version}"),
            remedy: "convert the file to glTF 2.0",
        });
    }
    // The crate subtracts the header's size from this unchecked.
    if u64::from(length) != bytes.len() as u64 {
        return Err(bad("header", format!("announces {length} bytes, but the file has {}", bytes.len())));
    }
    if bytes.len() < 20 {
        return Err(bad("header", "nothing follows it".into()));
    }
    let glb = Glb::from_slice(bytes).map_err(|e| bad("chunks", one_line(&e.to_string())))?;
    read_scene(&glb.json, glb.bin.as_deref(), path)
}

pub(crate) fn read_gltf(bytes: &[u8], path: &Path) -> Result<Surface, LoadError> {
    read_scene(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes), None, path)
}

fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn read_scene(json: &[u8], bin: Option<&[u8]>, path: &Path) -> Result<Surface, LoadError> {
    let root = Root::from_slice(json).map_err(|e| LoadError::Malformed {
        file: path.into(),
        place: "JSON".into(),
        reason: one_line(&e.to_string()),
        remedy: REMEDY,
    })?;
    let mut reader = Reader { root: &root, bin, path, buffers: HashMap::new() };
    if !root.asset.version.starts_with("2.") {
        return Err(reader.unsupported(format!("glTF version {}", quoted(root.asset.version.as_bytes()))));
    }
    for extension in &root.extensions_required {
        if !HARMLESS.iter().any(|harmless| extension.starts_with(harmless)) {
            return Err(reader.unsupported(quoted(extension.as_bytes())));
        }
    }
    let mut surface = Surface::default();
    let mut skipped = Skipped::default();
    for (mesh, placement) in reader.placed_meshes(&mut surface.warnings)? {
        let Some(definition) = root.meshes.get(mesh) else {
            return Err(reader.malformed("nodes".into(), format!("name mesh {mesh}, which is not there")));
        };
        // Primitives that differ in material often share their vertices.
        let mut loaded = HashMap::new();
        for (number, primitive) in definition.primitives.iter().enumerate() {
            let place = format!("mesh {mesh}, primitive {number}");
            reader.primitive(primitive, &placement, place, &mut loaded, &mut surface, &mut skipped)?;
        }
    }
    skipped.warn(&root, &mut surface.warnings);
    Ok(surface)
}

#[derive(Default)]
struct Skipped {
    points: usize,
    lines: usize,
    leftover: usize,
    morphed: bool,
}

impl Skipped {
    fn warn(&self, root: &Root, warnings: &mut Vec<String>) {
        for (count, what) in [
            (self.points, "point primitives skipped, being no surface"),
            (self.lines, "line primitives skipped, being no surface"),
            (self.leftover, "primitives with corners left over after the last triangle, which are ignored"),
        ] {
            if count > 0 {
                warnings.push(format!("{what}: {count}"));
            }
        }
        if self.morphed || root.nodes.iter().any(|node| node.skin.is_some() && node.mesh.is_some()) {
            warnings.push("skins and morph targets ignored: the mesh is taken as it stands at rest".into());
        }
        if root.extensions_used.iter().any(|name| name == "EXT_mesh_gpu_instancing") {
            warnings.push("instances placed by EXT_mesh_gpu_instancing ignored".into());
        }
    }
}

struct Reader<'a> {
    root: &'a Root,
    /// The binary chunk of a GLB.
    bin: Option<&'a [u8]>,
    path: &'a Path,
    buffers: HashMap<usize, Cow<'a, [u8]>>,
}

impl<'a> Reader<'a> {
    fn malformed(&self, place: String, reason: String) -> LoadError {
        LoadError::Malformed { file: self.path.into(), place, reason, remedy: REMEDY }
    }

    fn unsupported(&self, feature: String) -> LoadError {
        LoadError::Unsupported {
            file: self.path.into(),
            feature,
            remedy: "export the model as plain glTF 2.0, without it",
        }
    }

    /// The meshes of the default scene (else of the first; without scenes each mesh once) with their placements, depth first.
    fn placed_meshes(&self, warnings: &mut Vec<String>) -> Result<Vec<(usize, DAffine3)>, LoadError> {
        let nodes = &self.root.nodes;
        let Some(scene) = self.root.scene.map(|s| s.value()).or((!self.root.scenes.is_empty()).then_some(0))
        else {
            if !self.root.meshes.is_empty() {
                warnings
                    .push("the file has no scene: each mesh is loaded once, where it was modelled".into());
            }
            return Ok((0..self.root.meshes.len()).map(|mesh| (mesh, DAffine3::IDENTITY)).collect());
        };
        let Some(scene) = self.root.scenes.get(scene) else {
            return Err(self.malformed("scene".into(), format!("names scene {scene}, which is not there")));
        };
        let mut placed = Vec::new();
        let mut reached = vec![false; nodes.len()];
        let mut open: Vec<(usize, DAffine3)> =
            scene.nodes.iter().rev().map(|node| (node.value(), DAffine3::IDENTITY)).collect();
        while let Some((index, parent)) = open.pop() {
            let Some(node) = nodes.get(index) else {
                return Err(
                    self.malformed("nodes".into(), format!("node {index} is named, but is not there"))
                );
            };
            if std::mem::replace(&mut reached[index], true) {
                let reason = "is reached twice: the nodes form a loop, or have two parents".into();
                return Err(self.malformed(format!("node {index}"), reason));
            }
            let placement = parent * local_transform(node);
            if let Some(mesh) = node.mesh {
                placed.push((mesh.value(), placement));
            }
            let children = node.children.as_deref().unwrap_or_default();
            open.extend(children.iter().rev().map(|child| (child.value(), placement)));
        }
        Ok(placed)
    }

    fn primitive(
        &mut self,
        primitive: &Primitive,
        placement: &DAffine3,
        place: String,
        loaded: &mut HashMap<usize, (u32, usize)>,
        surface: &mut Surface,
        skipped: &mut Skipped,
    ) -> Result<(), LoadError> {
        let mode = match primitive.mode {
            Checked::Valid(Mode::Points) => {
                skipped.points += 1;
                return Ok(());
            }
            Checked::Valid(Mode::Lines | Mode::LineLoop | Mode::LineStrip) => {
                skipped.lines += 1;
                return Ok(());
            }
            Checked::Valid(mode) => mode,
            Checked::Invalid => return Err(self.malformed(place, "its mode is none of glTF's".into())),
        };
        skipped.morphed |= primitive.targets.as_ref().is_some_and(|targets| !targets.is_empty());
        let Some(positions) = primitive.attributes.get(&Checked::Valid(Semantic::Positions)) else {
            return Err(self.malformed(place, "has no POSITION attribute".into()));
        };
        let (base, count) = match loaded.get(&positions.value()) {
            Some(&known) => known,
            None => {
                let points = self.positions(*positions, &place)?;
                let base = surface.vertices.len();
                if base + points.len() > MAX_ELEMENTS {
                    return Err(self.too_large("vertices"));
                }
                surface.vertices.extend(points.iter().map(|p| placement.transform_point3(*p)));
                loaded.insert(positions.value(), (base as u32, points.len()));
                (base as u32, points.len())
            }
        };
        let indices: Vec<u32> = match primitive.indices {
            Some(indices) => self.indices(indices, count, &place)?,
            None => (0..count as u32).collect(),
        };
        let mirrored = placement.matrix3.determinant() < 0.0;
        let corners = |a: usize, b: usize, c: usize| {
            let [a, b, c] = [a, b, c].map(|i| base + indices[i]);
            // A mirrored placement turns the surface inside out: its triangles are turned over (glTF 2.0, 3.7.4).
            if mirrored { [a, c, b] } else { [a, b, c] }
        };
        let n = indices.len();
        match mode {
            Mode::TriangleStrip | Mode::TriangleFan => {
                skipped.leftover += usize::from(n == 1 || n == 2);
                for i in 2..n {
                    let triangle = match mode {
                        Mode::TriangleFan => corners(i - 1, i, 0),
                        _ if i % 2 == 0 => corners(i - 2, i - 1, i),
                        _ => corners(i - 2, i, i - 1),
                    };
                    // Repeated corners stitch strips together and are not meant as triangles.
                    let [a, b, c] = triangle;
                    if a != b && b != c && c != a {
                        surface.triangles.push(triangle);
                    }
                }
            }
            _ => {
                skipped.leftover += usize::from(n % 3 != 0);
                surface.triangles.extend((0..n / 3).map(|t| corners(3 * t, 3 * t + 1, 3 * t + 2)));
            }
        }
        if surface.triangles.len() > MAX_ELEMENTS {
            return Err(self.too_large("triangles"));
        }
        Ok(())
    }

    fn too_large(&self, what: &str) -> LoadError {
        let reason = format!("places more than {MAX_ELEMENTS} {what}");
        LoadError::Malformed {
            file: self.path.into(),
            place: "scene".into(),
            reason,
            remedy: "split the model",
        }
    }

    fn positions(&mut self, index: Index<Accessor>, place: &str) -> Result<Vec<DVec3>, LoadError> {
        let place = format!("{place}, accessor {} (POSITION)", index.value());
        let accessor = self.accessor(index, Type::Vec3, &place)?;
        let Checked::Valid(accessor::GenericComponentType(component)) = accessor.component_type else {
            return Err(self.malformed(place, "its component type is none of glTF's".into()));
        };
        let values = self.components(accessor, component, 3, &place)?;
        Ok(values.chunks_exact(3).map(|v| DVec3::new(v[0], v[1], v[2])).collect())
    }

    /// The indices of a primitive, all below `vertices`.
    fn indices(
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

    /// All components of an accessor, dequantised, sparse values put in.
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
        let index = view.value();
        let Some(view) = self.root.buffer_views.get(index) else {
            return Err(
                self.malformed(place.into(), format!("names buffer view {index}, which is not there"))
            );
        };
        let size = match component {
            ComponentType::I8 | ComponentType::U8 => 1,
            ComponentType::I16 | ComponentType::U16 => 2,
            ComponentType::U32 | ComponentType::F32 => 4,
        };
        let element = size * width;
        let stride = view.byte_stride.map_or(element, |stride| stride.0);
        if stride < element {
            let reason = format!(
                "its buffer view's stride of {stride} bytes is less than the {element} of an element"
            );
            return Err(self.malformed(place.into(), reason));
        }
        let start = view.byte_offset.unwrap_or_default().0;
        let length = view.byte_length.0;
        let needed = match count {
            0 => Some(0),
            _ => (stride as u64).checked_mul(count as u64 - 1).and_then(|n| n.checked_add(element as u64)),
        };
        let data = self.buffer(view.buffer.value())?;
        let view_bytes = usize::try_from(start)
            .ok()
            .zip(start.checked_add(length).and_then(|end| usize::try_from(end).ok()))
            .and_then(|(start, end)| data.get(start..end));
        let bytes = needed
            .and_then(|needed| {
                Some(usize::try_from(offset).ok()?..usize::try_from(offset.checked_add(needed)?).ok()?)
            })
            .and_then(|range| view_bytes?.get(range));
        let Some(bytes) = bytes else {
            let reason = format!(
                "{count} elements of {element} bytes from byte {offset} on do not fit buffer view {index} ({length} bytes from \
                 byte {start} of a buffer of {})",
                data.len()
            );
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
            (Some(uri), _) => match uri.strip_prefix("data:") {
                Some(data) => {
                    let Some((_, data)) = data.split_once(";base64,") else {
                        return Err(self.malformed(place(), "its data URI is not base64".into()));
                    };
                    let engine = base64::engine::general_purpose::GeneralPurpose::new(
                        &base64::alphabet::STANDARD,
                        base64::engine::general_purpose::NO_PAD
                            .with_decode_padding_mode(base64::engine::DecodePaddingMode::Indifferent),
                    );
                    let decoded = engine.decode(data);
                    decoded.map_err(|e| self.malformed(place(), format!("its data URI: {e}")))?.into()
                }
                None => {
                    let name = percent_decoded(uri);
                    let relative = Path::new(&name);
                    if relative.is_absolute() || uri.split('/').next().is_some_and(|head| head.contains(':'))
                    {
                        let feature =
                            format!("buffer uri {} (neither relative nor data)", quoted(uri.as_bytes()));
                        return Err(self.unsupported(feature));
                    }
                    read_file(&self.path.parent().unwrap_or(Path::new("")).join(relative))?.into()
                }
            },
        };
        if (bytes.len() as u64) < buffer.byte_length.0 {
            let reason = format!("has {} bytes instead of {}", bytes.len(), buffer.byte_length.0);
            return Err(self.malformed(place(), reason));
        }
        Ok(bytes)
    }
}

/// A component as the quantisation rules have it (glTF 2.0, 3.11).
fn quantised(value: f64, largest: f64, normalized: bool) -> f64 {
    if normalized { (value / largest).max(-1.0) } else { value }
}

fn local_transform(node: &Node) -> DAffine3 {
    if let Some(matrix) = node.matrix {
        return DAffine3::from_mat4(DMat4::from_cols_array(&matrix.map(f64::from)));
    }
    let vector = |v: Option<[f32; 3]>, default| v.map_or(default, |v| DVec3::from_array(v.map(f64::from)));
    let rotation = node.rotation.map_or(DQuat::IDENTITY, |q| {
        // Unit length only to f32 in the file; a zero quaternion stands for no rotation.
        let q = DQuat::from_array(q.0.map(f64::from));
        if q.length_squared() > 0.0 { q.normalize() } else { DQuat::IDENTITY }
    });
    DAffine3::from_scale_rotation_translation(
        vector(node.scale, DVec3::ONE),
        rotation,
        vector(node.translation, DVec3::ZERO),
    )
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
