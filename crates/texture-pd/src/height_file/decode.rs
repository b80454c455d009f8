//! Decoding of an image file to samples.
//!
//! TIFF and EXR are read through the crates that `image` uses for them, since `image` itself has no grey
//! floats.

use std::io::Cursor;

use exr::prelude::{FlatSamples, ReadChannels, ReadLayers};
use image::codecs::jpeg::JpegDecoder;
use image::codecs::png::PngDecoder;
use image::codecs::webp::WebPDecoder;
use image::{DynamicImage, ExtendedColorType, ImageDecoder, ImageError, Limits};
use tiff::decoder::{Decoder, DecodingResult};
use tiff::tags::Tag;
use tiff::{ColorType, TiffError};

use super::error::{HeightFileError, MAX_BYTES, MAX_FILE_SIDE};

/// An image as stored in its file: row by row, with the channels of a texel next to each other.
#[derive(Debug)]
pub(super) struct Raw {
    pub width: u32,
    pub height: u32,
    /// Number of channels. 1: grey; 2: grey and alpha; 3: red, green and blue; 4: these and alpha.
    pub channels: usize,
    /// Bits of an integer sample in the file; 0 for floats.
    pub bits: u32,
    /// Whether the format keeps samples only about.
    pub is_lossy: bool,
    pub samples: Samples,
}

/// Samples of an image in the file's type.
#[derive(Debug)]
pub(super) enum Samples {
    Byte(Vec<u8>),
    Word(Vec<u16>),
    Float(Vec<f32>),
}

impl Samples {
    fn len(&self) -> usize {
        match self {
            Self::Byte(samples) => samples.len(),
            Self::Word(samples) => samples.len(),
            Self::Float(samples) => samples.len(),
        }
    }

    /// Returns the value of a sample; integers are scaled to 0 to 1.
    pub(super) fn value(&self, at: usize) -> f64 {
        match self {
            Self::Byte(samples) => f64::from(samples[at]) / f64::from(u8::MAX),
            Self::Word(samples) => f64::from(samples[at]) / f64::from(u16::MAX),
            Self::Float(samples) => f64::from(samples[at]),
        }
    }
}

/// Reason why an image was refused, without its name.
enum Refused {
    /// The bytes are faulty or unsupported.
    Reason(String),
    /// The image is too large: width, height and bytes.
    TooLarge([u64; 3]),
}

impl Refused {
    fn because(reason: impl std::fmt::Display) -> Self {
        Self::Reason(reason.to_string())
    }
}

/// Decodes an image file. The result has at least one texel, and a sample for each channel of each.
pub(super) fn decode(bytes: &[u8], name: &str) -> Result<Raw, HeightFileError> {
    let name = || name.to_string();
    let decoded = match bytes {
        [0x89, b'P', b'N', b'G', ..] => png(bytes),
        [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => tiff(bytes),
        [0x76, 0x2f, 0x31, 0x01, ..] => exr(bytes),
        [0xff, 0xd8, 0xff, ..] => jpeg(bytes),
        [b'R', b'I', b'F', b'F', _, _, _, _, b'W', b'E', b'B', b'P', ..] => webp(bytes),
        [] => return Err(HeightFileError::Format { name: name(), found: "empty" }),
        _ => return Err(HeightFileError::Format { name: name(), found: "no image of a known format" }),
    };
    let raw = decoded.map_err(|refused| match refused {
        // A decoder's message may have several lines; ours is one.
        Refused::Reason(reason) => HeightFileError::Decode {
            name: name(),
            reason: reason.split_whitespace().collect::<Vec<_>>().join(" "),
        },
        Refused::TooLarge([width, height, bytes]) => {
            HeightFileError::TooLarge { name: name(), width, height, bytes }
        }
    })?;
    let expected = u64::from(raw.width) * u64::from(raw.height) * raw.channels as u64;
    if expected == 0 || raw.samples.len() as u64 != expected {
        let reason = format!(
            "{} samples for {} x {} texels of {} channels",
            raw.samples.len(),
            raw.width,
            raw.height,
            raw.channels
        );
        return Err(HeightFileError::Decode { name: name(), reason });
    }
    Ok(raw)
}

/// Refuses an image that takes too much memory, before the memory is allocated.
fn checked_size(width: u64, height: u64, texel_bytes: u64) -> Result<[u32; 2], Refused> {
    let bytes = width.saturating_mul(height).saturating_mul(texel_bytes);
    let side = |side: u64| u32::try_from(side).ok().filter(|side| *side <= MAX_FILE_SIDE);
    match (side(width), side(height)) {
        (Some(width), Some(height)) if bytes <= MAX_BYTES => Ok([width, height]),
        _ => Err(Refused::TooLarge([width, height, bytes])),
    }
}

fn png(bytes: &[u8]) -> Result<Raw, Refused> {
    // Width and height follow the signature and the header of the first chunk. A texel takes at least a byte.
    if let Some(&[a, b, c, d, e, f, g, h]) = bytes.get(16..24) {
        let [width, height] = [[a, b, c, d], [e, f, g, h]].map(|side| u64::from(u32::from_be_bytes(side)));
        checked_size(width, height, 1)?;
    }
    decoded(PngDecoder::with_limits(Cursor::new(bytes), limits()), false)
}

fn jpeg(bytes: &[u8]) -> Result<Raw, Refused> {
    // The decoder fills in what is cut off. Neither marker is part of compressed data.
    let last = |marker: u8| bytes.windows(2).rposition(|pair| pair == [0xff, marker]);
    let [start_of_scan, end] = [0xda, 0xd9].map(last);
    if end < start_of_scan || end.is_none() {
        return Err(Refused::because("the file is cut off"));
    }
    decoded(JpegDecoder::new(Cursor::new(bytes)), true)
}

fn webp(bytes: &[u8]) -> Result<Raw, Refused> {
    // The first chunk of image data is one or the other; an extended header may be before it.
    let lossless = bytes.windows(4).position(|tag| tag == b"VP8L");
    let lossy = bytes.windows(4).position(|tag| tag == b"VP8 ");
    let is_lossy = lossy.is_some_and(|lossy| lossless.is_none_or(|lossless| lossy < lossless));
    decoded(WebPDecoder::new(Cursor::new(bytes)), is_lossy)
}

/// Limits of memory for a decoder.
fn limits() -> Limits {
    let mut limits = Limits::default();
    limits.max_alloc = Some(MAX_BYTES);
    limits
}

/// The image of a decoder of `image`.
fn decoded(decoder: Result<impl ImageDecoder, ImageError>, is_lossy: bool) -> Result<Raw, Refused> {
    let broken = |error: ImageError| Refused::because(error);
    let mut decoder = decoder.map_err(broken)?;
    let (width, height) = decoder.dimensions();
    let texel_bytes = u64::from(decoder.color_type().bytes_per_pixel());
    checked_size(width.into(), height.into(), texel_bytes)?;
    decoder.set_limits(limits()).map_err(broken)?;
    let bits = match decoder.original_color_type() {
        ExtendedColorType::L1 => 1,
        ExtendedColorType::L2 => 2,
        ExtendedColorType::L4 => 4,
        _ => 8 * u32::from(decoder.color_type().bytes_per_pixel() / decoder.color_type().channel_count()),
    };
    let (channels, samples) = match DynamicImage::from_decoder(decoder).map_err(broken)? {
        DynamicImage::ImageLuma8(image) => (1, Samples::Byte(image.into_raw())),
        DynamicImage::ImageLumaA8(image) => (2, Samples::Byte(image.into_raw())),
        DynamicImage::ImageRgb8(image) => (3, Samples::Byte(image.into_raw())),
        DynamicImage::ImageRgba8(image) => (4, Samples::Byte(image.into_raw())),
        DynamicImage::ImageLuma16(image) => (1, Samples::Word(image.into_raw())),
        DynamicImage::ImageLumaA16(image) => (2, Samples::Word(image.into_raw())),
        DynamicImage::ImageRgb16(image) => (3, Samples::Word(image.into_raw())),
        DynamicImage::ImageRgba16(image) => (4, Samples::Word(image.into_raw())),
        other => return Err(Refused::because(format!("texels of type {:?}", other.color()))),
    };
    Ok(Raw { width, height, channels, bits, is_lossy, samples })
}

fn tiff(bytes: &[u8]) -> Result<Raw, Refused> {
    let broken = |error: TiffError| Refused::because(error);
    let mut limits = tiff::decoder::Limits::default();
    limits.decoding_buffer_size = MAX_BYTES as usize;
    limits.intermediate_buffer_size = MAX_BYTES as usize / 4;
    let mut decoder = Decoder::new(Cursor::new(bytes)).map_err(broken)?.with_limits(limits);
    let (width, height) = decoder.dimensions().map_err(broken)?;
    let kind = decoder.colortype().map_err(broken)?;
    let (channels, bits) = match kind {
        ColorType::Gray(bits) => (1, bits),
        ColorType::GrayA(bits) => (2, bits),
        ColorType::RGB(bits) => (3, bits),
        ColorType::RGBA(bits) => (4, bits),
        _ => return Err(Refused::because(format!("texels of type {kind:?} are not read"))),
    };
    if !matches!(bits, 8 | 16 | 32) {
        return Err(Refused::because(format!("samples of {bits} bits are not read")));
    }
    let planar = decoder.find_tag_unsigned::<u16>(Tag::PlanarConfiguration).map_err(broken)?;
    if channels > 1 && planar.is_some_and(|planar| planar != 1) {
        return Err(Refused::because("channels that lie apart (planar configuration) are not read"));
    }
    checked_size(width.into(), height.into(), channels as u64 * u64::from(bits) / 8)?;
    let (bits, samples) = match decoder.read_image().map_err(broken)? {
        DecodingResult::U8(samples) => (8, Samples::Byte(samples)),
        DecodingResult::U16(samples) => (16, Samples::Word(samples)),
        DecodingResult::F32(samples) => (0, Samples::Float(samples)),
        _ => return Err(Refused::because(format!("samples of {bits} bits of this kind are not read"))),
    };
    Ok(Raw { width, height, channels, bits, is_lossy: false, samples })
}

/// Decodes the first layer of an EXR file: its only channel, else the channel Y, else R, G and B with or
/// without A.
fn exr(bytes: &[u8]) -> Result<Raw, Refused> {
    let broken = |error: exr::error::Error| Refused::because(error);
    let about = exr::meta::MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(broken)?;
    for header in &about.headers {
        let size = header.layer_size;
        // Samples are held twice: by channel as decoded, and interleaved.
        let texel_bytes = header.channels.list.len() as u64 * 8;
        checked_size(size.width() as u64, size.height() as u64, texel_bytes)?;
    }
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(broken)?;
    let layer = &image.layer_data;
    let window = image.attributes.display_window;
    if layer.size != window.size || layer.attributes.layer_position != window.position {
        return Err(Refused::because("the data window is not the display window: save it uncropped"));
    }
    let [width, height] = checked_size(layer.size.width() as u64, layer.size.height() as u64, 4)?;
    let list = &layer.channel_data.list;
    let named = |name: &str| list.iter().find(|channel| channel.name.eq(name));
    let chosen = match (list.as_slice(), named("Y"), named("R"), named("G"), named("B"), named("A")) {
        ([only], ..) => vec![only],
        (_, Some(grey), ..) => vec![grey],
        (_, None, Some(r), Some(g), Some(b), None) => vec![r, g, b],
        (_, None, Some(r), Some(g), Some(b), Some(a)) => vec![r, g, b, a],
        _ => return Err(Refused::because("there are several channels, but neither Y nor R, G and B")),
    };
    let count = width as usize * height as usize;
    if chosen.iter().any(|channel| channel.sample_data.len() != count) {
        return Err(Refused::because("channels of different sizes (subsampling) are not read"));
    }
    let mut samples = Vec::with_capacity(count * chosen.len());
    for at in 0..count {
        samples.extend(chosen.iter().map(|channel| match &channel.sample_data {
            FlatSamples::F16(values) => values[at].to_f32(),
            FlatSamples::F32(values) => values[at],
            FlatSamples::U32(values) => values[at] as f32,
        }));
    }
    Ok(Raw {
        width,
        height,
        channels: chosen.len(),
        bits: 0,
        is_lossy: false,
        samples: Samples::Float(samples),
    })
}
