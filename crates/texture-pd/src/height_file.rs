//! Height images from files: PNG, TIFF, OpenEXR, JPEG and WebP.
//!
//! Files are untrusted. Whatever the bytes, the result is an image or a one-line error that says what is
//! wrong and what to do. Sizes in a header are checked against limits before memory is allocated.

mod decode;
mod error;
mod options;
mod reduce;

use std::fs;
use std::path::Path;

use crate::{HeightImage, MAX_SIDE};
use decode::Samples;

use error::MAX_BYTES;
pub use error::{HeightFileError, MAX_FILE_SIDE};
pub use options::HeightOptions;

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
    /// Supported are PNG of up to 16 bits, TIFF of 8 and 16 bits and 32-bit floats, OpenEXR, JPEG and WebP,
    /// grey or colour. Colour is converted to luma (weights of Rec. 709) and an alpha channel ignored, with a
    /// warning if either makes a difference. An image of more than [`MAX_SIDE`] texels a side is averaged
    /// over blocks, and texels that are not finite are filled in from their nearest neighbours, both with
    /// a warning. Images of 8 bits or fewer cause a warning with their step in height, and
    /// lossy compression causes one, too.
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
