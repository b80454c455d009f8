//! Errors of reading a mesh file. Each message is one line that says what is wrong, where, and what to do.

use std::path::PathBuf;

/// Why a mesh file was refused.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    /// The file, or one that it names, could not be read.
    #[error("{}: cannot be read ({source}); check the path and its permissions", .file.display())]
    Read {
        /// The file that could not be read.
        file: PathBuf,
        /// The operating system's error.
        source: std::io::Error,
    },
    /// The extension is not one of a supported format.
    #[error("{}: {what}; use a file named .obj, .gltf, .glb, .stl or .ply", .file.display())]
    UnknownFormat {
        /// The file.
        file: PathBuf,
        /// The defect of its name.
        what: String,
    },
    /// The scale is not a positive finite number.
    #[error("{}: the scale {scale} is not usable; give a finite number above zero (0.001 for a file in millimetres)", .file.display())]
    Scale {
        /// The file that was to be scaled.
        file: PathBuf,
        /// The scale asked for.
        scale: f64,
    },
    /// The file does not follow its format.
    #[error("{}: {place}: {reason}; {remedy}", .file.display())]
    Malformed {
        /// The file.
        file: PathBuf,
        /// Place in the file: a line, an element, a byte offset.
        place: String,
        /// The defect there.
        reason: String,
        /// Advice on what to do about it.
        remedy: &'static str,
    },
    /// The file uses a part of its format that is not supported.
    #[error("{}: uses {feature}, which is not supported; {remedy}", .file.display())]
    Unsupported {
        /// The file.
        file: PathBuf,
        /// Name of the feature or extension.
        feature: String,
        /// Advice on what to do about it.
        remedy: &'static str,
    },
    /// The file holds no surface.
    #[error("{}: has no triangles ({found}); export the model as a surface mesh", .file.display())]
    NoTriangles {
        /// The file.
        file: PathBuf,
        /// The file's actual content.
        found: String,
    },
    /// A triangle uses a vertex with a coordinate that is infinite or not a number.
    #[error(
        "{}: vertex {vertex}, used by triangle {triangle} (both counted from 0), is at ({x}, {y}, {z}); correct it, or repair the mesh to drop such triangles",
        .file.display()
    )]
    NonFinite {
        /// The file.
        file: PathBuf,
        /// Index of the vertex in file order, from 0.
        vertex: usize,
        /// Index of the first triangle that uses it, from 0.
        triangle: usize,
        /// Its x coordinate.
        x: f64,
        /// Its y coordinate.
        y: f64,
        /// Its z coordinate.
        z: f64,
    },
    /// A mesh with texture coordinates was requested, but they are missing, or not finite, or could not be
    /// kept.
    #[error("{}: {place}: {reason}; {remedy}", .file.display())]
    TextureCoordinates {
        /// The file.
        file: PathBuf,
        /// Place in the file: a line, a primitive, a triangle.
        place: String,
        /// The defect there.
        reason: String,
        /// Advice on what to do about it.
        remedy: &'static str,
    },
    /// More vertices or triangles than 32-bit indices can name.
    #[error("{}: {source}; split the model", .file.display())]
    TooLarge {
        /// The file.
        file: PathBuf,
        /// The elements, and their number.
        source: palpate_core::mesh::MeshError,
    },
}
