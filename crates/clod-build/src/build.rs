//! From a mesh to its hierarchy: the order of the steps, what can be asked of them and why they may refuse.

use palpate_core::{Clod, TriMesh};

/// What can be chosen about a build.
#[derive(Clone, Debug, PartialEq)]
pub struct BuildOptions {
    /// How far a patch's surface may lie inside its own hull, and how deep other surface may reach into it, before the
    /// patch counts as not convex (§3.3.1). A fraction of the bounding radius.
    pub tolerance: f64,
    /// Distance tolerance of support areas (§3.3.5) along a vertex normal: a fraction of the bounding radius.
    pub support_distance: f64,
    /// Half angle of the normal cone of support areas (§3.3.5), rad.
    pub support_cone: f64,
}

impl Default for BuildOptions {
    fn default() -> Self {
        Self { tolerance: 1e-6, support_distance: 0.025, support_cone: std::f64::consts::FRAC_PI_3 }
    }
}

/// What a build is doing, for its progress callback.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Stage {
    /// Checking and indexing the mesh.
    Mesh,
    /// Surface convex decomposition (§3.3.1).
    Decomposition,
    /// Merging patches up to the root (§3.3.3).
    Hierarchy,
    /// Error metric parameters (§3.3.5).
    Parameters,
}

/// Why a hierarchy could not be built.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BuildError {
    /// The mesh has no triangles.
    #[error(
        "the mesh has no triangles (of {vertices} vertices), so there is nothing to touch: check the file that it came from"
    )]
    Empty {
        /// How many vertices it has.
        vertices: usize,
    },
    /// A vertex of a triangle is not finite.
    #[error(
        "vertex {vertex} at ({x}, {y}, {z}) is not finite: run with --repair to drop the triangles that use it"
    )]
    NonFinite {
        /// Index of the first such vertex.
        vertex: usize,
        /// Its x coordinate, m.
        x: f64,
        /// Its y coordinate, m.
        y: f64,
        /// Its z coordinate, m.
        z: f64,
    },
    /// All vertices of the triangles coincide.
    #[error(
        "all {triangles} triangles have shrunk to one point, so the mesh has no size: check its units and the scale it was loaded with"
    )]
    NoExtent {
        /// How many triangles there are.
        triangles: usize,
    },
    /// An option is out of range.
    #[error("the build option `{option}` is {value}, but has to be {wanted}")]
    Option {
        /// Its name.
        option: &'static str,
        /// What it was set to.
        value: f64,
        /// What it may be.
        wanted: &'static str,
    },
}

/// Builds the hierarchy of contact levels of detail of a mesh.
///
/// Any finite mesh builds. Where it is not a closed, oriented 2-manifold, inside and outside are not defined: no hull can
/// then be verified to lie inside the object, [`Node::contained`](palpate_core::clod::Node::contained) is false and so is
/// [`Source::solid`](palpate_core::clod::Source::solid).
///
/// `progress` is called from the calling thread with the fraction of the stage that is done.
///
/// # Errors
/// If the mesh has no triangles, no extent or a vertex that is not finite, or an option is out of range.
pub fn build(
    mesh: &TriMesh,
    options: &BuildOptions,
    progress: &mut dyn FnMut(Stage, f64),
) -> Result<Clod, BuildError> {
    let _ = (options, progress);
    Err(BuildError::Empty { vertices: mesh.vertices().len() })
}
