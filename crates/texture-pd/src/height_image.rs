//! Images of fine detail: a displacement for each texel.

/// How an image goes on beyond its border.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Wrap {
    /// It is repeated.
    #[default]
    Repeat,
    /// The texels of the border go on.
    Clamp,
    /// It is repeated, every other time in a mirror.
    Mirror,
}

/// Displacements of a surface along its normals, one a texel: row after row, the first row at v = 0.
#[derive(Clone, Debug, PartialEq)]
pub struct HeightImage {
    width: u32,
    height: u32,
    displacements: Vec<f32>,
    wrap: [Wrap; 2],
    atlas: bool,
}

/// Why an image was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum HeightImageError {
    /// No texel at all.
    #[error("a height image of {width} x {height} texels; it needs one at least")]
    Empty {
        /// Texels along a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// More texels along a side than [`MAX_SIDE`].
    #[error(
        "a height image of {width} x {height} texels; at most {MAX_SIDE} a side are supported: make it smaller"
    )]
    TooLarge {
        /// Texels along a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// Not as many displacements as texels.
    #[error("{found} displacements for {width} x {height} texels")]
    Count {
        /// How many displacements there are.
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

/// The most texels that an image has along a side: 64 MiB of displacements.
pub const MAX_SIDE: u32 = 4096;

impl HeightImage {
    /// An image from the displacements (m) of its texels. `wrap` is how it goes on along u and along v.
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

    /// The image as an atlas, whose neighbouring texels need not be neighbours on a surface: it has no coarser levels, as
    /// those would mix them.
    #[must_use]
    pub fn into_atlas(self) -> Self {
        Self { atlas: true, ..self }
    }

    /// Whether the image is an atlas.
    pub fn is_atlas(&self) -> bool {
        self.atlas
    }

    /// Texels along a row.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Displacements, m.
    pub fn displacements(&self) -> &[f32] {
        &self.displacements
    }

    /// How the image goes on along u and along v.
    pub fn wrap(&self) -> [Wrap; 2] {
        self.wrap
    }

    /// The smallest and the largest displacement, m.
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
