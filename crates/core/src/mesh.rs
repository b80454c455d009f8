//! Indexed triangle meshes.

use glam::DVec3;
use serde::{Deserialize, Serialize};

/// An indexed triangle mesh. Counter-clockwise triangles face outwards.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TriMesh {
    vertices: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
}

/// Why a mesh was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MeshError {
    /// A triangle names a vertex that the mesh has not.
    #[error("triangle {triangle} refers to vertex {vertex}, but the mesh has {vertices} vertices")]
    IndexOutOfRange {
        /// Index of the first such triangle.
        triangle: usize,
        /// The index that it names.
        vertex: u32,
        /// Number of vertices in the mesh.
        vertices: usize,
    },
    /// More vertices or triangles than 32-bit indices can name.
    #[error("the mesh has {count} {what}, more than the {} that 32-bit indices can name", u32::MAX)]
    TooLarge {
        /// `"vertices"` or `"triangles"`.
        what: &'static str,
        /// How many there are.
        count: usize,
    },
}

impl TriMesh {
    /// A mesh from vertex positions (m) and triangles of vertex indices.
    ///
    /// # Errors
    /// If a triangle names a vertex that is not there, or there are 2³² − 1 or more vertices or triangles.
    /// Nothing else is required of the mesh: see the validation report for the rest.
    pub fn new(vertices: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> Result<Self, MeshError> {
        for (what, count) in [("vertices", vertices.len()), ("triangles", triangles.len())] {
            if count >= u32::MAX as usize {
                return Err(MeshError::TooLarge { what, count });
            }
        }
        for (triangle, corners) in triangles.iter().enumerate() {
            for &vertex in corners {
                if vertex as usize >= vertices.len() {
                    return Err(MeshError::IndexOutOfRange { triangle, vertex, vertices: vertices.len() });
                }
            }
        }
        Ok(Self { vertices, triangles })
    }

    /// Vertex positions, m.
    pub fn vertices(&self) -> &[DVec3] {
        &self.vertices
    }

    /// Triangles as vertex indices, counter-clockwise seen from outside.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// The corner positions (m) of a triangle.
    pub fn corners(&self, triangle: usize) -> [DVec3; 3] {
        self.triangles[triangle].map(|v| self.vertices[v as usize])
    }
}
