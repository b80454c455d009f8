//! What is wrong with a mesh, if anything.

use serde::Serialize;

use super::TriMesh;

/// Counts of everything that a mesh may have wrong with it, made by [`TriMesh::validate`].
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ValidationReport {
    /// Vertices that a triangle refers to.
    pub vertices: usize,
    /// Triangles, degenerate ones included.
    pub triangles: usize,
    /// Whether every edge belongs to exactly two triangles.
    pub closed: bool,
    /// Whether no edge belongs to more than two triangles, and the triangles around each vertex form one fan.
    pub manifold: bool,
    /// Whether no two triangles run along a shared edge in the same direction.
    pub oriented: bool,
    /// Edges of one triangle.
    pub boundary_edges: usize,
    /// Edges of three or more triangles.
    pub nonmanifold_edges: usize,
    /// Edges of two triangles that disagree on which side is outside.
    pub misoriented_edges: usize,
    /// Vertices whose triangles do not form a single fan.
    pub nonmanifold_vertices: usize,
    /// Triangles that name a vertex twice or have no area.
    pub degenerate: usize,
    /// Those of the degenerate triangles that have three different vertices.
    pub zero_area: usize,
    /// Triangles that have the same vertices as an earlier one.
    pub duplicate: usize,
    /// Vertices with a coordinate that is not a finite number.
    pub nonfinite: usize,
    /// Vertices that no triangle refers to.
    pub unreferenced: usize,
    /// Connected components.
    pub components: usize,
    /// Radius of the [bounding sphere](TriMesh::bounding_sphere), m.
    pub bounding_radius: f64,
    /// Signed volume, m³.
    pub volume: f64,
    /// The first offending element of each kind found.
    pub first: FirstOffenders,
}

/// An edge with something wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct OffendingEdge {
    /// Its vertices, the lower first.
    pub vertices: [u32; 2],
    /// The first triangle at it.
    pub triangle: u32,
}

/// The first offending element of each kind, where there is one.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct FirstOffenders {
    /// The first boundary edge.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub boundary_edge: Option<OffendingEdge>,
    /// The first edge of three or more triangles.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nonmanifold_edge: Option<OffendingEdge>,
    /// The first edge whose two triangles disagree on which side is outside.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub misoriented_edge: Option<OffendingEdge>,
    /// The first vertex whose triangles do not form a single fan.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nonmanifold_vertex: Option<u32>,
    /// The first degenerate triangle.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub degenerate: Option<u32>,
    /// The first triangle that repeats an earlier one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub duplicate: Option<u32>,
    /// The first vertex with a coordinate that is not a finite number.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nonfinite: Option<u32>,
    /// The first vertex that no triangle refers to.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unreferenced: Option<u32>,
}

impl ValidationReport {
    /// Whether the surface is closed, 2-manifold and consistently oriented, faces outwards and is made of finite
    /// numbers: inside and outside are defined. (It may still intersect itself.)
    pub fn is_solid(&self) -> bool {
        self.closed && self.manifold && self.oriented && self.nonfinite == 0 && self.volume > 0.0
    }
}

impl TriMesh {
    /// Looks for everything that may be wrong with the mesh.
    pub fn validate(&self) -> ValidationReport {
        ValidationReport { vertices: self.vertices().len(), ..ValidationReport::default() }
    }
}
