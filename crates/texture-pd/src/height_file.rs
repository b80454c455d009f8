//! Height images from files: PNG, TIFF and OpenEXR.
//!
//! Files are untrusted. Whatever the bytes, the result is an image or a one-line error that says what is
//! wrong and what to do. Sizes in a header are checked against limits before memory is allocated.

mod decode;
mod reduce;

use std::fs;
use std::path::Path;

use crate::{HeightImage, HeightImageError, MAX_SIDE, Wrap};
use decode::Samples;

/// Maximum number of texels along a side of an image in a file. Images of more than [`MAX_SIDE`] are
/// averaged.
pub const MAX_FILE_SIDE: u32 = 16384;
/// Maximum size of a file, and of its decoded image, bytes.
const MAX_BYTES: u64 = 1 << 30;

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

/// Reason why an image file was refused.
#[derive(Debug, thiserror::Error)]
pub enum HeightFileError {
    /// The file could not be read.
    #[error("{name}: cannot be read ({source}); check the path and its permissions")]
    Read {
        /// Name of the file.
        name: String,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The amplitude is not finite or not above zero.
    #[error("{name}: the amplitude of {amplitude} m is not usable; give a finite number above zero")]
    Amplitude {
        /// Name of the image.
        name: String,
        /// Amplitude that was given, m.
        amplitude: f64,
    },
    /// The midlevel is not finite, or outside 0 to 1 for an integer image.
    #[error(
        "{name}: the midlevel {midlevel} is not usable; give one from 0 (black) to 1 (white), for float images any finite \
         number"
    )]
    Midlevel {
        /// Name of the image.
        name: String,
        /// Midlevel that was given.
        midlevel: f64,
    },
    /// The file is not in a supported format.
    #[error("{name}: is {found}; save it as PNG, TIFF or OpenEXR")]
    Format {
        /// Name of the image.
        name: String,
        /// Description of what the file contains instead.
        found: &'static str,
    },
    /// The file violates its format, or uses an unsupported part of it.
    #[error(
        "{name}: {reason}; get the file again, or save it as grey PNG of 16 bits or grey TIFF of 32 bit floats"
    )]
    Decode {
        /// Name of the image.
        name: String,
        /// Description of the fault.
        reason: String,
    },
    /// The image has too many texels or bytes.
    #[error(
        "{name}: {width} x {height} texels, {bytes} bytes when decoded; at most {MAX_FILE_SIDE} a side and {MAX_BYTES} \
         bytes are read: make it smaller, or grey"
    )]
    TooLarge {
        /// Name of the image.
        name: String,
        /// Texels along a row.
        width: u64,
        /// Rows.
        height: u64,
        /// Size of the decoded image, bytes.
        bytes: u64,
    },
    /// Every texel is infinite or not a number.
    #[error("{name}: none of the {width} x {height} texels is a finite number; export the image again")]
    NothingFinite {
        /// Name of the image.
        name: String,
        /// Texels along a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// The displacements are no valid image.
    #[error("{name}: {source}")]
    Image {
        /// Name of the image.
        name: String,
        /// Error of the image.
        source: HeightImageError,
    },
}

impl HeightImage {
    /// Reads an image file. Returns the image and warnings for the user, one line each. See
    /// [`HeightImage::decode`].
    ///
    /// # Errors
    /// If the file cannot be read, or [`HeightImage::decode`] refuses it.
    pub fn open(path: &Path, options: &HeightOptions) -> Result<(Self, Vec<String>), HeightFileError> {
        let name = path.display().to_string();
        match read_file(path) {
            Ok(bytes) => Self::decode(&bytes, &name, options),
            Err(source) => Err(HeightFileError::Read { name, source }),
        }
    }

    /// Decodes the bytes of an image file. Returns the image and warnings for the user, one line each; `name`
    /// appears in messages.
    ///
    /// Supported are PNG of up to 16 bits, TIFF of 8 and 16 bits and 32-bit floats, and OpenEXR, grey or
    /// colour. Colour is converted to luma (weights of Rec. 709) and an alpha channel ignored, with a warning
    /// if either makes a difference. An image of more than [`MAX_SIDE`] texels a side is averaged over
    /// blocks, and texels that are not finite are filled in from their nearest neighbours, both with a
    /// warning. Images of 8 bits or fewer cause a warning with their step in height.
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

/// Reads a regular file. Devices and pipes are refused, since they might never end.
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
