//! glTF 2.0 scenes, as .gltf (JSON with external or embedded buffers) and .glb: every triangle of the default
//! scene, placed by its node.
//!
//! The crate `gltf` parses the container and the JSON; accessors are read here, since its own readers assume
//! that positions are f32 (KHR_mesh_quantization allows 8 and 16 bits) and panic on false claims of a file.
//! Every index, offset and count is checked before use; the node graph is traversed with an explicit stack,
//! each node at most once, as the format demands.
//!
//! Where textures are asked for, texture coordinates and the height texture come with the triangles:
//! `textures`.
//!
//! Left out, with a warning: points and lines, skins and morph targets (the mesh is loaded in its rest
//! shape), instances placed by EXT_mesh_gpu_instancing. Compressed geometry (KHR_draco_mesh_compression,
//! EXT_meshopt_compression) is refused unless the file carries an uncompressed form as well.

mod accessors;
mod height;
mod textures;

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;
use std::rc::Rc;

use glam::{DAffine3, DMat4, DQuat, DVec2, DVec3};
use gltf::Glb;
use gltf::json::Root;
use gltf::json::mesh::{Mode, Primitive, Semantic};
use gltf::json::scene::Node;
use gltf::json::validation::Checked;
use serde_json::Value;

use self::height::Height;
use crate::formats::surface::{Surface, Wanted};
use crate::formats::text::quoted;
use crate::{LoadError, LoadWarning};

/// Largest number of vertices, and of triangles, of a scene. One mesh may be placed by any number of nodes,
/// and a count need not be backed by data, so that the file's size does not bound them.
const MAX_ELEMENTS: usize = 1 << 25;

/// First bytes of a GLB file.
const MAGIC: &[u8] = b"glTF";

const INSTANCING: &str = "EXT_mesh_gpu_instancing";

const REMEDY: &str = "the file breaks the glTF 2.0 rules: run a glTF validator on it, or export it again";

/// Extensions that do not affect triangles, so that a file may require them.
const HARMLESS: [&str; 6] =
    ["KHR_mesh_quantization", "KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "KHR_xmp"];

pub(crate) fn read_glb(bytes: &[u8], path: &Path, wanted: Wanted) -> Result<Surface, LoadError> {
    let glb = chunks(bytes, path)?;
    read_scene(&glb.json, glb.bin.as_deref(), path, wanted)
}

/// Whether a material names a height texture, by the JSON alone; false if the bytes are not glTF.
pub(crate) fn names_height_texture(bytes: &[u8], path: &Path) -> bool {
    let json = if bytes.starts_with(MAGIC) {
        chunks(bytes, path).map_or(Cow::Borrowed(&[][..]), |glb| glb.json)
    } else {
        Cow::Borrowed(without_mark(bytes))
    };
    let named = |root: Root| {
        let extras = root.materials.iter().filter_map(|material| material.extras.as_ref());
        let mut values = extras.filter_map(|extras| serde_json::from_str::<Value>(extras.get()).ok());
        values.any(|extras| extras.get("heightTexture").is_some())
    };
    Root::from_slice(&json).is_ok_and(named)
}

/// The two parts of a GLB file.
fn chunks<'a>(bytes: &'a [u8], path: &Path) -> Result<Glb<'a>, LoadError> {
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
    if magic != MAGIC {
        let found: Vec<String> = magic.iter().map(|byte| format!("{byte:02x}")).collect();
        let reason = format!("starts with the bytes {} (hexadecimal) instead of \"glTF\"", found.join(" "));
        return Err(bad("header", reason));
    }
    if version != 2 {
        return Err(LoadError::Unsupported {
            file: path.into(),
            feature: format!("GLB version {version}"),
            remedy: "convert the file to glTF 2.0",
        });
    }
    // The crate subtracts the header's size from `length` unchecked.
    if u64::from(length) != bytes.len() as u64 {
        return Err(bad("header", format!("announces {length} bytes, but the file has {}", bytes.len())));
    }
    if bytes.len() < 20 {
        return Err(bad("header", "nothing follows it".into()));
    }
    Glb::from_slice(bytes).map_err(|e| bad("chunks", one_line(&e.to_string())))
}

pub(crate) fn read_gltf(bytes: &[u8], path: &Path, wanted: Wanted) -> Result<Surface, LoadError> {
    read_scene(without_mark(bytes), None, path, wanted)
}

fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)
}

fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn read_scene(json: &[u8], bin: Option<&[u8]>, path: &Path, wanted: Wanted) -> Result<Surface, LoadError> {
    let root = Root::from_slice(json).map_err(|e| LoadError::Malformed {
        file: path.into(),
        place: "JSON".into(),
        reason: one_line(&e.to_string()),
        remedy: REMEDY,
    })?;
    let mut reader = Reader {
        root: &root,
        bin,
        path,
        wanted,
        buffers: HashMap::new(),
        heights: HashMap::new(),
        height: None,
    };
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
        let mut loaded = Shared::default();
        for (number, primitive) in definition.primitives.iter().enumerate() {
            let place = format!("mesh {mesh}, primitive {number}");
            reader.primitive(primitive, &placement, place, &mut loaded, &mut surface, &mut skipped)?;
        }
    }
    skipped.warn(&root, &mut surface.warnings);
    if wanted == Wanted::Textured {
        reader.warn_of_transforms(&mut surface.warnings);
        surface.height_texture = reader.height_texture()?;
    }
    Ok(surface)
}

/// Data that primitives of a placed mesh share, by accessor.
#[derive(Default)]
struct Shared {
    /// The first vertex in the surface, and the number of vertices.
    positions: HashMap<usize, (u32, usize)>,
    coordinates: HashMap<usize, Rc<[DVec2]>>,
}

#[derive(Default)]
struct Skipped {
    /// Corners read so far, whether or not they made triangles.
    corners: usize,
    /// Texture coordinates read so far.
    coordinates: usize,
    points: usize,
    lines: usize,
    leftover: usize,
    morphed: bool,
}

impl Skipped {
    fn warn(&self, root: &Root, warnings: &mut Vec<LoadWarning>) {
        let counted = [
            (self.points, LoadWarning::Points { count: self.points }),
            (self.lines, LoadWarning::Lines { count: self.lines }),
            (self.leftover, LoadWarning::LeftoverCorners { primitives: self.leftover }),
        ];
        warnings.extend(counted.into_iter().filter(|(count, _)| *count > 0).map(|(_, warning)| warning));
        if self.morphed || root.nodes.iter().any(|node| node.skin.is_some() && node.mesh.is_some()) {
            warnings.push(LoadWarning::AtRest);
        }
        if root.extensions_used.iter().any(|name| name == INSTANCING) {
            let effect = "the instances that it places are left out";
            warnings.push(LoadWarning::IgnoredExtension { name: INSTANCING, effect });
        }
    }
}

struct Reader<'a> {
    root: &'a Root,
    /// The binary chunk of a GLB.
    bin: Option<&'a [u8]>,
    path: &'a Path,
    wanted: Wanted,
    buffers: HashMap<usize, Cow<'a, [u8]>>,
    /// Height textures of the materials read so far, with their sets of texture coordinates.
    heights: HashMap<usize, Option<(Height, u32)>>,
    /// The height texture of the first primitive, if it has one, and the name of that primitive.
    height: Option<(Option<Height>, String)>,
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

    /// The meshes of the default scene (else of the first; without scenes each mesh once) with their
    /// placements, depth first.
    fn placed_meshes(&self, warnings: &mut Vec<LoadWarning>) -> Result<Vec<(usize, DAffine3)>, LoadError> {
        let nodes = &self.root.nodes;
        let Some(scene) = self.root.scene.map(|s| s.value()).or((!self.root.scenes.is_empty()).then_some(0))
        else {
            if !self.root.meshes.is_empty() {
                warnings.push(LoadWarning::NoScene);
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
        loaded: &mut Shared,
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
        let (base, count) = match loaded.positions.get(&positions.value()) {
            Some(&known) => known,
            None => {
                let points = self.positions(*positions, &place)?;
                let base = surface.vertices.len();
                if base + points.len() > MAX_ELEMENTS {
                    return Err(self.too_large("vertices"));
                }
                surface.vertices.extend(points.iter().map(|p| placement.transform_point3(*p)));
                loaded.positions.insert(positions.value(), (base as u32, points.len()));
                (base as u32, points.len())
            }
        };
        let coordinates = match self.wanted {
            Wanted::Surface => None,
            Wanted::Textured => Some(self.corner_coordinates(primitive, count, &place, loaded, skipped)?),
        };
        let indices: Vec<u32> = match primitive.indices {
            Some(indices) => self.indices(indices, count, &place)?,
            None => (0..count as u32).collect(),
        };
        let mirrored = placement.matrix3.determinant() < 0.0;
        let mut push = |a: usize, b: usize, c: usize| {
            // A mirrored placement turns the surface inside out: its triangles are turned over (glTF 2.0,
            // 3.7.4).
            let corners = if mirrored { [a, c, b] } else { [a, b, c] }.map(|i| indices[i]);
            surface.triangles.push(corners.map(|corner| base + corner));
            if let Some(coordinates) = &coordinates {
                surface.coordinates.push(corners.map(|corner| coordinates[corner as usize]));
            }
        };
        let n = indices.len();
        // Any number of primitives may name the same indices, and those of a strip need not make a triangle.
        skipped.corners += n;
        if skipped.corners > 3 * MAX_ELEMENTS {
            return Err(self.too_large("corners"));
        }
        match mode {
            Mode::TriangleStrip | Mode::TriangleFan => {
                skipped.leftover += usize::from(n == 1 || n == 2);
                for i in 2..n {
                    let (a, b, c) = match mode {
                        Mode::TriangleFan => (i - 1, i, 0),
                        _ if i % 2 == 0 => (i - 2, i - 1, i),
                        _ => (i - 2, i, i - 1),
                    };
                    // Repeated corners stitch strips together and are not meant as triangles.
                    if indices[a] != indices[b] && indices[b] != indices[c] && indices[c] != indices[a] {
                        push(a, b, c);
                    }
                }
            }
            _ => {
                skipped.leftover += usize::from(!n.is_multiple_of(3));
                (0..n / 3).for_each(|t| push(3 * t, 3 * t + 1, 3 * t + 2));
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
}

fn local_transform(node: &Node) -> DAffine3 {
    if let Some(matrix) = node.matrix {
        return DAffine3::from_mat4(DMat4::from_cols_array(&matrix.map(f64::from)));
    }
    let vector = |v: Option<[f32; 3]>, default| v.map_or(default, |v| DVec3::from_array(v.map(f64::from)));
    let rotation = node.rotation.map_or(DQuat::IDENTITY, |q| {
        // In the file it has unit length only to f32; a zero quaternion stands for no rotation.
        let q = DQuat::from_array(q.0.map(f64::from));
        if q.length_squared() > 0.0 { q.normalize() } else { DQuat::IDENTITY }
    });
    DAffine3::from_scale_rotation_translation(
        vector(node.scale, DVec3::ONE),
        rotation,
        vector(node.translation, DVec3::ZERO),
    )
}
