//! A level of detail as simplification puts it out.

use palpate_core::TriMesh;

use crate::decomposition::Decomposition;
use crate::surface::Surface;

/// A level of detail with its patches.
#[derive(Debug)]
pub(crate) struct SimplifiedLevel {
    /// Its mesh, m.
    pub mesh: TriMesh,
    /// The same in unit coordinates.
    pub surface: Surface,
    /// Its convex patches.
    pub decomposition: Decomposition,
    /// D of its vertices, m².
    pub areas: Vec<f64>,
    /// r, in the inverse of the unit of unit coordinates.
    pub resolution: f64,
}
