//! Errors of baking.

use palpate_core::mesh::{MeshError, UvMeshError};

use crate::HeightImageError;

/// Reason why nothing was baked.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BakeError {
    /// The coarse mesh is unusable.
    #[error("coarse mesh: {0}")]
    Coarse(MeshError),
    /// The detailed mesh is unusable.
    #[error("detailed mesh: {0}")]
    Detailed(MeshError),
    /// A mesh has no triangle with an area.
    #[error("the {which} mesh has no triangle with an area")]
    NoSurface {
        /// `"coarse"` or `"detailed"`.
        which: &'static str,
    },
    /// An option is out of range.
    #[error("{option} of {value} {unit}: {wanted}")]
    BadOption {
        /// Name of the option.
        option: &'static str,
        /// Value that was given.
        value: f64,
        /// Unit of the value.
        unit: &'static str,
        /// Accepted values.
        wanted: &'static str,
    },
    /// The coarse mesh has more triangles than fit into the largest image.
    #[error(
        "the coarse mesh's {triangles} triangles do not fit into one image, however coarse the texels: simplify it further"
    )]
    TooManyTriangles {
        /// Number of triangles of the coarse mesh.
        triangles: usize,
    },
    /// No ray from the coarse mesh hit the detailed mesh.
    #[error(
        "no part of the detailed mesh faces along the coarse one's normals within {reach} m of it: are both meshes in one \
         frame, and oriented outwards?"
    )]
    NothingWithinReach {
        /// Length of the rays to either side, m.
        reach: f64,
    },
    /// The displacements are no valid image.
    #[error(transparent)]
    Image(#[from] HeightImageError),
    /// The coarse mesh cannot be given texture coordinates.
    #[error(transparent)]
    Coordinates(#[from] UvMeshError),
    /// The progress callback cancelled the work.
    #[error("cancelled")]
    Cancelled,
}
