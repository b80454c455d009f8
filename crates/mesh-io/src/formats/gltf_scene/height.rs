//! Height textures of glTF materials.

use crate::TextureWrap;

/// A height texture by the image that it uses.
#[derive(Clone, PartialEq)]
pub(super) struct Height {
    pub image: usize,
    pub amplitude: f64,
    pub midlevel: f64,
    pub wrap: [TextureWrap; 2],
}
