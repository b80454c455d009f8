//! Limits of image files, and why a file was refused.

use crate::HeightImageError;

/// Maximum number of texels along a side of an image in a file. Images of more than
/// [`MAX_SIDE`](crate::MAX_SIDE) are averaged.
pub const MAX_FILE_SIDE: u32 = 16384;
/// Maximum size of a file, and of its decoded image, bytes.
pub(super) const MAX_BYTES: u64 = 1 << 30;

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
    #[error("{name}: is {found}; save it as PNG, TIFF, OpenEXR, JPEG or WebP")]
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
