//! Meshes with texture coordinates.

use glam::{DVec2, DVec3};

use super::TriMesh;

/// A mesh whose triangles have a place in a texture.
///
/// Coordinates are those of glTF: (0, 0) is the upper left corner of the image and (1, 1) the lower right
/// one, so that the first row of texels is at v = 0. Each corner of a triangle has its own, as seams need.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UvMesh {
    mesh: TriMesh,
    coordinates: Vec<[DVec2; 3]>,
}

/// Why a mesh with texture coordinates was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum UvMeshError {
    /// There are fewer or more coordinates than triangles.
    #[error("texture coordinates for {coordinates} triangles of {triangles}: each triangle needs its own")]
    Count {
        /// Number of triangles with coordinates.
        coordinates: usize,
        /// Number of triangles.
        triangles: usize,
    },
    /// A coordinate is infinite or not a number.
    #[error("a texture coordinate of triangle {triangle} is not a finite number")]
    NonFinite {
        /// The first such triangle.
        triangle: usize,
    },
}

impl UvMesh {
    /// A mesh (m) with the texture coordinates of each triangle's corners, in the order of its vertices.
    ///
    /// # Errors
    /// If there are not as many as triangles, or one is not finite.
    pub fn new(mesh: TriMesh, coordinates: Vec<[DVec2; 3]>) -> Result<Self, UvMeshError> {
        let triangles = mesh.triangles().len();
        if coordinates.len() != triangles {
            return Err(UvMeshError::Count { coordinates: coordinates.len(), triangles });
        }
        match coordinates.iter().position(|corners| !corners.iter().all(|uv| uv.is_finite())) {
            Some(triangle) => Err(UvMeshError::NonFinite { triangle }),
            None => Ok(Self { mesh, coordinates }),
        }
    }

    /// A mesh with texture coordinates by projection: `place` maps each vertex (m) to its place in the
    /// texture.
    ///
    /// # Errors
    /// If a coordinate is not finite.
    pub fn projected(mesh: TriMesh, place: impl Fn(DVec3) -> DVec2) -> Result<Self, UvMeshError> {
        let coordinates = (0..mesh.triangles().len()).map(|i| mesh.corners(i).map(&place)).collect();
        Self::new(mesh, coordinates)
    }

    /// The mesh, m.
    pub fn mesh(&self) -> &TriMesh {
        &self.mesh
    }

    /// Texture coordinates of each triangle's corners.
    pub fn coordinates(&self) -> &[[DVec2; 3]] {
        &self.coordinates
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_triangle_needs_finite_coordinates() {
        let mesh = || TriMesh::new(vec![DVec3::ZERO, DVec3::X, DVec3::Y], vec![[0, 1, 2]]).unwrap();
        let corners = [DVec2::ZERO, DVec2::X, DVec2::Y];
        assert_eq!(UvMesh::new(mesh(), vec![corners]).unwrap().coordinates(), [corners]);
        assert_eq!(UvMesh::new(mesh(), Vec::new()), Err(UvMeshError::Count { coordinates: 0, triangles: 1 }));
        let broken = [DVec2::ZERO, DVec2::NAN, DVec2::Y];
        assert_eq!(UvMesh::new(mesh(), vec![broken]), Err(UvMeshError::NonFinite { triangle: 0 }));
    }
}
