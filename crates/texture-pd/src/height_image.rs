//! Height images: a displacement for each texel.

/// Continuation of an image beyond its border.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Wrap {
    /// The image is repeated.
    #[default]
    Repeat,
    /// The texels of the border are continued.
    Clamp,
    /// The image is repeated, mirrored every other time.
    Mirror,
}

/// Displacements of a surface along its normals, one per texel, row by row; the first row is at v = 0.
#[derive(Clone, Debug, PartialEq)]
pub struct HeightImage {
    width: u32,
    height: u32,
    displacements: Vec<f32>,
    wrap: [Wrap; 2],
    atlas: bool,
}

/// Reason why an image was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum HeightImageError {
    /// The image has no texels.
    #[error("a height image of {width} x {height} texels; it needs one at least")]
    Empty {
        /// Texels along a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// The image has more texels along a side than [`MAX_SIDE`].
    #[error(
        "a height image of {width} x {height} texels; at most {MAX_SIDE} a side are supported: make it smaller"
    )]
    TooLarge {
        /// Texels along a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// The number of displacements is not the number of texels.
    #[error("{found} displacements for {width} x {height} texels")]
    Count {
        /// Number of displacements.
        found: usize,
        /// Texels along a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// A displacement is infinite or not a number.
    #[error("the displacement of the texel in column {column}, row {row} is not a finite number")]
    NonFinite {
        /// Column of the first such texel.
        column: u32,
        /// Its row.
        row: u32,
    },
}

/// Maximum number of texels along a side of an image: 64 MiB of displacements.
pub const MAX_SIDE: u32 = 4096;

impl HeightImage {
    /// Creates an image from the displacements (m) of its texels, with wrap modes along u and v.
    ///
    /// # Errors
    /// If the image is empty or too large, or a displacement is not finite.
    pub fn new(
        width: u32,
        height: u32,
        displacements: Vec<f32>,
        wrap: [Wrap; 2],
    ) -> Result<Self, HeightImageError> {
        if width == 0 || height == 0 {
            return Err(HeightImageError::Empty { width, height });
        }
        if width > MAX_SIDE || height > MAX_SIDE {
            return Err(HeightImageError::TooLarge { width, height });
        }
        let found = displacements.len();
        if found != width as usize * height as usize {
            return Err(HeightImageError::Count { found, width, height });
        }
        match displacements.iter().position(|height| !height.is_finite()) {
            Some(at) => {
                let at = at as u32;
                Err(HeightImageError::NonFinite { column: at % width, row: at / width })
            }
            None => Ok(Self { width, height, displacements, wrap, atlas: false }),
        }
    }

    /// Marks the image as an atlas, whose neighbouring texels need not be neighbours on a surface. It has no
    /// coarser levels, since those would mix unrelated texels.
    #[must_use]
    pub fn into_atlas(self) -> Self {
        Self { atlas: true, ..self }
    }

    /// Returns whether the image is an atlas.
    pub fn is_atlas(&self) -> bool {
        self.atlas
    }

    /// Number of texels along a row.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Displacements, m, row by row.
    pub fn displacements(&self) -> &[f32] {
        &self.displacements
    }

    /// Wrap modes along u and v.
    pub fn wrap(&self) -> [Wrap; 2] {
        self.wrap
    }

    /// Smallest and largest displacement, m.
    pub fn range(&self) -> [f32; 2] {
        let range = [f32::INFINITY, f32::NEG_INFINITY];
        self.displacements.iter().fold(range, |[low, high], &height| [low.min(height), high.max(height)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_images_are_refused_with_what_and_where() {
        let image =
            |width, height, values: Vec<f32>| HeightImage::new(width, height, values, [Wrap::Clamp; 2]);
        assert_eq!(image(0, 3, vec![]), Err(HeightImageError::Empty { width: 0, height: 3 }));
        assert_eq!(image(2, 1, vec![0.0]), Err(HeightImageError::Count { found: 1, width: 2, height: 1 }));
        let too_large = HeightImageError::TooLarge { width: 16384, height: 1 };
        assert_eq!(image(16384, 1, vec![0.0; 16384]), Err(too_large));
        let broken = vec![0.0, 1.0, 2.0, f32::NAN];
        assert_eq!(image(2, 2, broken), Err(HeightImageError::NonFinite { column: 1, row: 1 }));
        assert_eq!(image(2, 1, vec![-1.0, 2.0]).unwrap().range(), [-1.0, 2.0]);
    }
}
