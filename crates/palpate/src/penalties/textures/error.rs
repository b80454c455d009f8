//! Why textures cannot be rendered.

use palpate_texture_pd::{BackendError, DepthError, SurfaceError, TooManyTexels};

/// Why textures cannot be rendered.
#[derive(Debug, thiserror::Error)]
pub enum TextureError {
    /// An object's surface is empty or not finite.
    #[error("{name}: {source}")]
    Surface {
        /// The object's name.
        name: String,
        /// Why.
        source: SurfaceError,
    },
    /// All textures together are too large.
    #[error(transparent)]
    Size(#[from] TooManyTexels),
    /// A setting is out of range.
    #[error(transparent)]
    Depth(#[from] DepthError),
    /// The settings ask for a GPU, and there is none.
    #[error(transparent)]
    Backend(#[from] BackendError),
}
