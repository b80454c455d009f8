//! Height images from files: PNG, TIFF and OpenEXR.
//!
//! Files come from anywhere: whatever the bytes, the answer is an image or one line that says what is wrong and what to
//! do. What a header claims is held against limits before memory is taken.

mod decode;
mod reduce;

use std::fs;
use std::path::Path;

use crate::{HeightImage, HeightImageError, MAX_SIDE, Wrap};
use decode::Samples;

/// The most texels that an image in a file has along a side. Those of more than [`MAX_SIDE`] are averaged.
pub const MAX_FILE_SIDE: u32 = 16384;
/// The most bytes that an image takes when decoded, and that a file has.
const MAX_BYTES: u64 = 1 << 30;

/// How the values of an image file become displacements.
///
/// A texel of value x is displaced by (x − `midlevel`) `amplitude` along the surface's normal. Values of integer images go
/// from 0 (black) to 1 (white); those of float images are taken as they stand, without a look at colour spaces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeightOptions {
    /// Metres from black to white, or per unit of a float image. Finite and above zero.
    pub amplitude: f64,
    /// The value that is no displacement. Between 0 and 1 for integer images, finite for float images.
    pub midlevel: f64,
    /// How the image goes on along u and along v.
    pub wrap: [Wrap; 2],
}

impl HeightOptions {
    /// Displacements over `amplitude` (m) around mid grey, in an image that is repeated.
    pub fn new(amplitude: f64) -> Self {
        Self { amplitude, midlevel: 0.5, wrap: [Wrap::Repeat; 2] }
    }
}

/// Why an image file was refused.
#[derive(Debug, thiserror::Error)]
pub enum HeightFileError {
    /// The file could not be read.
    #[error("{name}: cannot be read ({source}); check the path and its permissions")]
    Read {
        /// The file.
        name: String,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// The amplitude is not finite or not above zero.
    #[error("{name}: the amplitude of {amplitude} m is not usable; give a finite number above zero")]
    Amplitude {
        /// The image.
        name: String,
        /// The amplitude asked for.
        amplitude: f64,
    },
    /// The midlevel is not finite, or no grey of an integer image.
    #[error(
        "{name}: the midlevel {midlevel} is not usable; give one from 0 (black) to 1 (white), for float images any finite \
         number"
    )]
    Midlevel {
        /// The image.
        name: String,
        /// The midlevel asked for.
        midlevel: f64,
    },
    /// No image of a format that is read.
    #[error("{name}: is {found}; save it as PNG, TIFF or OpenEXR")]
    Format {
        /// The image.
        name: String,
        /// What the file looks like instead.
        found: &'static str,
    },
    /// The file does not follow its format, or uses a part of it that is not read.
    #[error(
        "{name}: {reason}; get the file again, or save it as grey PNG of 16 bits or grey TIFF of 32 bit floats"
    )]
    Decode {
        /// The image.
        name: String,
        /// What is wrong.
        reason: String,
    },
    /// More texels or bytes than are read.
    #[error(
        "{name}: {width} x {height} texels, {bytes} bytes when decoded; at most {MAX_FILE_SIDE} a side and {MAX_BYTES} \
         bytes are read: make it smaller, or grey"
    )]
    TooLarge {
        /// The image.
        name: String,
        /// Texels along a row.
        width: u64,
        /// Rows.
        height: u64,
        /// Bytes that they take.
        bytes: u64,
    },
    /// Every texel is infinite or not a number.
    #[error("{name}: none of the {width} x {height} texels is a finite number; export the image again")]
    NothingFinite {
        /// The image.
        name: String,
        /// Texels along a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// The displacements make no image.
    #[error("{name}: {source}")]
    Image {
        /// The image.
        name: String,
        /// What is wrong with them.
        source: HeightImageError,
    },
}

impl HeightImage {
    /// Reads a file, with notes for the user, one line each. See [`HeightImage::decode`].
    ///
    /// # Errors
    /// If the file cannot be read, or for what [`HeightImage::decode`] refuses.
    pub fn open(path: &Path, options: &HeightOptions) -> Result<(Self, Vec<String>), HeightFileError> {
        let name = path.display().to_string();
        match read_file(path) {
            Ok(bytes) => Self::decode(&bytes, &name, options),
            Err(source) => Err(HeightFileError::Read { name, source }),
        }
    }

    /// An image from the bytes of an image file, with notes for the user, one line each; `name` is for messages.
    ///
    /// Read are PNG of up to 16 bits, TIFF of 8 and 16 bits and 32 bit floats, and OpenEXR, grey or colour. Colour is turned
    /// into luma (weights of Rec. 709) and an alpha channel ignored, with a note where either makes a difference. An image
    /// of more than [`MAX_SIDE`] texels a side is averaged over blocks, and texels that are not finite are filled in
    /// from their nearest neighbours, both with a note. So is the step in height of an image of 8 bits or fewer.
    ///
    /// # Errors
    /// See [`HeightFileError`].
    pub fn decode(
        bytes: &[u8],
        name: &str,
        options: &HeightOptions,
    ) -> Result<(Self, Vec<String>), HeightFileError> {
        Self::decode_within(bytes, name, options, MAX_SIDE)
    }

    fn decode_within(
        bytes: &[u8],
        name: &str,
        options: &HeightOptions,
        side: u32,
    ) -> Result<(Self, Vec<String>), HeightFileError> {
        let HeightOptions { amplitude, midlevel, wrap } = *options;
        let name = || name.to_string();
        if !(amplitude.is_finite() && amplitude > 0.0) {
            return Err(HeightFileError::Amplitude { name: name(), amplitude });
        }
        let raw = decode::decode(bytes, &name())?;
        let usable = match raw.samples {
            Samples::Float(_) => midlevel.is_finite(),
            _ => (0.0..=1.0).contains(&midlevel),
        };
        if !usable {
            return Err(HeightFileError::Midlevel { name: name(), midlevel });
        }
        let reduced = reduce::reduce(&raw, options, side);
        let (width, height) = (reduced.width, reduced.height);
        let warnings = reduced.warnings(&raw, amplitude);
        let mut values = reduced.values;
        if reduced.missing.is_some() && !reduce::fill(&mut values, width as usize) {
            return Err(HeightFileError::NothingFinite {
                name: name(),
                width: raw.width,
                height: raw.height,
            });
        }
        match Self::new(width, height, values, wrap) {
            Ok(image) => Ok((image, warnings)),
            Err(source) => Err(HeightFileError::Image { name: name(), source }),
        }
    }
}

/// The bytes of a regular file: a device or a pipe might never end.
fn read_file(path: &Path) -> std::io::Result<Vec<u8>> {
    let about = fs::metadata(path)?;
    if !about.is_file() {
        return Err(std::io::Error::other("not a regular file"));
    }
    if about.len() > MAX_BYTES {
        return Err(std::io::Error::other(format!("{} bytes, of at most {MAX_BYTES}", about.len())));
    }
    fs::read(path)
}

#[cfg(test)]
mod tests;
