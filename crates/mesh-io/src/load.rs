//! Loading a mesh file: choice of the reader, units, finiteness, welding and repair.

use std::path::Path;

use glam::DVec3;
use palpate_core::TriMesh;

#[cfg(feature = "gltf")]
use crate::formats::gltf_scene;
use crate::formats::surface::{Surface, Wanted};
use crate::formats::{obj, ply, read_file, stl};
use crate::{LoadError, LoadWarning, RepairEffect, RepairSummary, repair, weld};

/// Options for loading a mesh file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoadOptions {
    /// Metres per unit of the file: 0.001 for one in millimetres. Finite and above zero; 1 by default.
    pub scale: f64,
    /// Whether vertices at bitwise equal positions are joined ([`weld`]); true by default.
    pub weld: bool,
    /// Whether the mesh is repaired ([`repair`]); false by default. Repair welds, whatever `weld` says.
    pub repair: bool,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self { scale: 1.0, weld: true, repair: false }
    }
}

/// A mesh as loaded, with warnings about it.
#[derive(Clone, Debug)]
pub struct LoadedMesh {
    /// The mesh, m. Every vertex is finite and used by a triangle.
    pub mesh: TriMesh,
    /// Vertices in the file (for glTF: placed in the scene), before welding, whether used or not.
    pub raw_vertices: usize,
    /// Warnings about content that was left out or is doubtful, in the order in which it was found.
    pub warnings: Vec<LoadWarning>,
    /// Changes that repair made, if it was requested; if there are any, they are among the warnings too.
    pub repairs: Option<RepairSummary>,
    /// What those changes did to the surface.
    pub effect: Option<RepairEffect>,
}

/// Loads a mesh file; the extension (in either case) names the format: .obj, .stl or .ply, and with the
/// feature `gltf` .gltf or .glb.
///
/// The triangles keep the order of the file (for glTF, that of the scene's nodes, depth first). Degenerate
/// and duplicate triangles are kept unless repair is asked for. The file is read whole into memory.
///
/// # Errors
/// See [`LoadError`]. A triangle with a coordinate that is not finite (also after scaling) is an error unless
/// repair is asked for, which drops it; so is a mesh of which repair leaves nothing.
pub fn load(path: &Path, options: &LoadOptions) -> Result<LoadedMesh, LoadError> {
    finish(read(path, options, Wanted::Surface)?, path, options)
}

/// The surface of a file, its vertices not yet scaled.
pub(crate) fn read(path: &Path, options: &LoadOptions, wanted: Wanted) -> Result<Surface, LoadError> {
    if !(options.scale.is_finite() && options.scale > 0.0) {
        return Err(LoadError::Scale { file: path.into(), scale: options.scale });
    }
    let Some(extension) = path.extension() else {
        return Err(LoadError::UnknownFormat { file: path.into(), what: "has no extension".into() });
    };
    let extension = extension.to_string_lossy().to_ascii_lowercase();
    let read: fn(&[u8], &Path, Wanted) -> Result<Surface, LoadError> = match extension.as_str() {
        "obj" => obj::read,
        #[cfg(feature = "gltf")]
        "gltf" => gltf_scene::read_gltf,
        #[cfg(feature = "gltf")]
        "glb" => gltf_scene::read_glb,
        #[cfg(not(feature = "gltf"))]
        "gltf" | "glb" => {
            return Err(LoadError::Unsupported {
                file: path.into(),
                feature: "glTF".into(),
                remedy: "build with the feature `gltf`, or export the model as OBJ, STL or PLY",
            });
        }
        "stl" | "ply" if wanted == Wanted::Textured => return Err(no_coordinates(path, &extension)),
        "stl" => |bytes, path, _| stl::read(bytes, path),
        "ply" => |bytes, path, _| ply::read(bytes, path),
        _ => {
            let what = format!("the extension {extension:?} names no supported format");
            return Err(LoadError::UnknownFormat { file: path.into(), what });
        }
    };
    let bytes = read_file(path)?;
    if bytes.is_empty() {
        return Err(LoadError::NoTriangles { file: path.into(), found: "the file is empty".into() });
    }
    let surface = read(&bytes, path, wanted)?;
    if surface.triangles.is_empty() {
        let mut found = format!("{} vertices", surface.vertices.len());
        for warning in &surface.warnings {
            found.push_str("; ");
            found.push_str(&warning.to_string());
        }
        return Err(LoadError::NoTriangles { file: path.into(), found });
    }
    Ok(surface)
}

fn no_coordinates(path: &Path, extension: &str) -> LoadError {
    LoadError::TextureCoordinates {
        file: path.into(),
        place: format!("extension {extension:?}"),
        reason: format!("no texture coordinates are read from {} files", extension.to_ascii_uppercase()),
        remedy: "export the model with texture coordinates as OBJ or glTF",
    }
}

/// Scales the vertices and makes a mesh of them. The vertices of triangles must be finite unless repair
/// follows.
pub(crate) fn scaled(
    mut vertices: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    path: &Path,
    options: &LoadOptions,
) -> Result<TriMesh, LoadError> {
    if options.scale != 1.0 {
        vertices.iter_mut().for_each(|v| *v *= options.scale);
    }
    if !options.repair {
        for (triangle, corners) in triangles.iter().enumerate() {
            if let Some(&vertex) = corners.iter().find(|v| !vertices[**v as usize].is_finite()) {
                let DVec3 { x, y, z } = vertices[vertex as usize];
                return Err(LoadError::NonFinite {
                    file: path.into(),
                    vertex: vertex as usize,
                    triangle,
                    x,
                    y,
                    z,
                });
            }
        }
    }
    let mesh = TriMesh::new(vertices, triangles)
        .map_err(|source| LoadError::TooLarge { file: path.into(), source })?;
    Ok(if options.weld || options.repair { weld::weld(&mesh) } else { weld::drop_unreferenced(&mesh) })
}

fn finish(surface: Surface, path: &Path, options: &LoadOptions) -> Result<LoadedMesh, LoadError> {
    let Surface { vertices, triangles, mut warnings, .. } = surface;
    let raw_vertices = vertices.len();
    let mut mesh = scaled(vertices, triangles, path, options)?;
    let (mut repairs, mut effect) = (None, None);
    if options.repair {
        let before = mesh.triangles().len();
        let (repaired, summary, done) = repair::repair_measured(&mesh);
        if repaired.triangles().is_empty() {
            let found = format!("repair leaves none of the {before} in the file: {summary}");
            return Err(LoadError::NoTriangles { file: path.into(), found });
        }
        if summary != RepairSummary::default() {
            warnings.push(LoadWarning::Repaired { changes: summary, effect: done });
        }
        if done.lost_surface() {
            warnings.push(LoadWarning::LostSurface { area: done.lost_area, of: done.area_before });
        }
        (mesh, repairs, effect) = (repaired, Some(summary), Some(done));
    }
    warnings.extend(LoadWarning::of_loaded_size(mesh.bounding_sphere().radius, options));
    Ok(LoadedMesh { mesh, raw_vertices, warnings, repairs, effect })
}
