//! Indexed triangle meshes, their connectivity, mass properties and validation.

mod adjacency;
mod bounding;
mod double_double;
mod mass;
#[cfg(test)]
mod test_shapes;
mod textured;
mod validation;

use glam::DVec3;
use serde::{Deserialize, Serialize};

pub use adjacency::{Adjacency, EdgeKind, HalfEdge, NO_NEIGHBOUR};
pub use bounding::Sphere;
pub use mass::MassProperties;
pub use textured::{UvMesh, UvMeshError};
pub use validation::{FirstOffenders, NEGLIGIBLE_HEIGHT, OffendingEdge, ValidationReport};

/// An indexed triangle mesh. Counter-clockwise triangles face outwards.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TriMesh {
    vertices: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
}

/// Why a mesh was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MeshError {
    /// A triangle names a vertex that the mesh does not have.
    #[error("triangle {triangle} refers to vertex {vertex}, but the mesh has {vertices} vertices")]
    IndexOutOfRange {
        /// Index of the first such triangle.
        triangle: usize,
        /// The index that it names.
        vertex: u32,
        /// Number of vertices in the mesh.
        vertices: usize,
    },
    /// More vertices than 32-bit indices can name, or more triangles than have half-edges that 32-bit indices
    /// can name.
    #[error("the mesh has {count} {what}; at most {limit} are supported: split or simplify it")]
    TooLarge {
        /// `"vertices"` or `"triangles"`.
        what: &'static str,
        /// Number of them.
        count: usize,
        /// Largest number supported.
        limit: usize,
    },
    /// A triangle has a vertex that is infinite or not a number.
    #[error(
        "vertex {vertex} of triangle {triangle} has a coordinate that is not a finite number: repair the mesh"
    )]
    NonFinite {
        /// Index of the first such triangle.
        triangle: usize,
        /// Its first such vertex.
        vertex: u32,
    },
    /// The surface has a border, so that it encloses no volume.
    #[error(
        "the surface is open at the edge between vertices {} and {} of triangle {triangle}: \
         only a closed surface has mass properties; close its holes (repair may do)", edge[0], edge[1]
    )]
    Open {
        /// The edge's vertices.
        edge: [u32; 2],
        /// A triangle at the edge.
        triangle: usize,
    },
    /// Neighbouring triangles face opposite sides.
    #[error(
        "the triangles at the edge between vertices {} and {}, triangle {triangle} among them, do not agree on which \
         side is outside: orient them consistently (repair may do)", edge[0], edge[1]
    )]
    Misoriented {
        /// The edge's vertices.
        edge: [u32; 2],
        /// A triangle at the edge.
        triangle: usize,
    },
    /// The mesh has no triangle of positive area, or encloses a volume indistinguishable from zero.
    #[error("the mesh encloses no volume: it needs the surface of a solid, not a sheet or nothing at all")]
    NoVolume,
    /// The triangles of a closed surface face inwards.
    #[error("the enclosed volume is negative: the triangles face inwards; reverse them all (repair does)")]
    Inverted,
    /// The volume is positive as a whole, but the second moments are not those of a body.
    #[error(
        "part of the surface faces inwards, more than can be cavities: reverse the shells that do (repair may do)"
    )]
    PartlyInverted,
    /// The density is not a positive finite number.
    #[error("the density must be a positive finite number of kg/m³")]
    BadDensity,
    /// The mass properties do not fit into 64-bit floating-point numbers.
    #[error("the mesh's volume or inertia is too large or too small a number: scale the mesh to metres")]
    OutOfRange,
}

/// Largest number of triangles of a mesh: each has three half-edges, named by 32-bit indices of which the
/// last is reserved.
const MAX_TRIANGLES: usize = (u32::MAX / 3) as usize - 1;

impl TriMesh {
    /// A mesh from vertex positions (m) and triangles of vertex indices.
    ///
    /// # Errors
    /// If a triangle names a vertex that is not there, or there are 2³² − 1 or more vertices or a third as
    /// many triangles. Nothing else is required of the mesh: see the validation report for the rest.
    pub fn new(vertices: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> Result<Self, MeshError> {
        for (what, count, limit) in [
            ("vertices", vertices.len(), u32::MAX as usize - 1),
            ("triangles", triangles.len(), MAX_TRIANGLES),
        ] {
            if count > limit {
                return Err(MeshError::TooLarge { what, count, limit });
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn indices_out_of_range_are_refused() {
        let refused = TriMesh::new(vec![DVec3::ZERO; 3], vec![[0, 1, 2], [0, 3, 1]]).unwrap_err();
        assert_eq!(refused, MeshError::IndexOutOfRange { triangle: 1, vertex: 3, vertices: 3 });
        assert!(refused.to_string().contains("triangle 1"));
        assert!(TriMesh::new(vec![], vec![]).is_ok());
    }
}
