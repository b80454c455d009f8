//! Conversion of the values of image files to displacements.

use crate::Wrap;

/// Conversion of the values of an image file to displacements.
///
/// A texel of value x is displaced by (x − `midlevel`) `amplitude` along the surface's normal. Values of
/// integer images go from 0 (black) to 1 (white); those of float images are used unchanged, whatever their
/// colour space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeightOptions {
    /// Displacement from black to white, or per unit of a float image, m. Finite and above zero.
    pub amplitude: f64,
    /// Value without displacement. Between 0 and 1 for integer images, finite for float images.
    pub midlevel: f64,
    /// Wrap modes along u and v.
    pub wrap: [Wrap; 2],
}

impl HeightOptions {
    /// Returns options for displacements over `amplitude` (m) around mid grey, in an image that is repeated.
    pub fn new(amplitude: f64) -> Self {
        Self { amplitude, midlevel: 0.5, wrap: [Wrap::Repeat; 2] }
    }
}
