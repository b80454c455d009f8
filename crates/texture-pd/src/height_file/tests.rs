use std::io::Cursor;

use exr::prelude::{AnyChannel, AnyChannels, FlatSamples, Image as ExrImage, WritableImage};
use image::{DynamicImage, GrayImage, ImageBuffer, ImageFormat, Luma, LumaA, Rgb, RgbImage};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use tiff::encoder::{TiffEncoder, colortype};

use super::{HeightFileError, HeightImage, HeightOptions, MAX_FILE_SIDE};
use crate::Wrap;

const AMPLITUDE: f64 = 0.002;

fn options() -> HeightOptions {
    HeightOptions::new(AMPLITUDE)
}

fn decode(bytes: &[u8]) -> Result<(HeightImage, Vec<String>), HeightFileError> {
    HeightImage::decode(bytes, "map", &options())
}

fn png(image: impl Into<DynamicImage>) -> Vec<u8> {
    file(image, ImageFormat::Png)
}

fn file(image: impl Into<DynamicImage>, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    image.into().write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

fn tiff<C: colortype::ColorType>(width: u32, height: u32, samples: &[C::Inner]) -> Vec<u8>
where
    [C::Inner]: tiff::encoder::TiffValue,
{
    let mut bytes = Cursor::new(Vec::new());
    TiffEncoder::new(&mut bytes).unwrap().write_image::<C>(width, height, samples).unwrap();
    bytes.into_inner()
}

fn exr_file(width: usize, height: usize, channels: &[(&str, FlatSamples)]) -> Vec<u8> {
    let channel = |(name, samples): &(&str, FlatSamples)| AnyChannel::new(*name, samples.clone());
    let list = channels.iter().map(channel).collect();
    let mut bytes = Cursor::new(Vec::new());
    let image = ExrImage::from_channels((width, height), AnyChannels::sort(list));
    image.write().non_parallel().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

/// Grey values that fit into 8 bits, and their displacements.
const GREY: [u8; 6] = [0, 255, 51, 102, 153, 204];
const PARTS: [f64; 6] = [0.0, 1.0, 0.2, 0.4, 0.6, 0.8];

fn check_displacements(bytes: &[u8], case: &str) -> Vec<String> {
    let (image, warnings) = decode(bytes).unwrap_or_else(|error| panic!("{case}: {error}"));
    assert_eq!((image.width(), image.height()), (3, 2), "{case}");
    for (found, part) in image.displacements().iter().zip(PARTS) {
        let expected = (part - 0.5) * AMPLITUDE;
        assert!((f64::from(*found) - expected).abs() < 1e-9, "{case}: {found} for {expected}");
    }
    warnings
}

fn parts() -> Vec<f32> {
    PARTS.map(|part| part as f32).to_vec()
}

fn words() -> Vec<u16> {
    GREY.map(|grey| u16::from(grey) * 257).to_vec()
}

#[test]
fn known_values_in_all_formats() {
    let steps = |warnings: Vec<String>, case: &str| {
        assert_eq!(warnings.len(), 1, "{case}: {warnings:?}");
        assert!(warnings[0].contains("8 bits") && warnings[0].contains("7.843e-6 m"), "{case}: {warnings:?}");
    };
    let quiet = |warnings: Vec<String>, case: &str| assert!(warnings.is_empty(), "{case}: {warnings:?}");
    let grey8 = GrayImage::from_raw(3, 2, GREY.to_vec()).unwrap();
    steps(check_displacements(&png(grey8), "png 8"), "png 8");
    let grey16 = ImageBuffer::<Luma<u16>, _>::from_raw(3, 2, words()).unwrap();
    quiet(check_displacements(&png(grey16), "png 16"), "png 16");
    let triple = |grey: &[u8]| grey.iter().flat_map(|&g| [g; 3]).collect::<Vec<_>>();
    steps(check_displacements(&png(RgbImage::from_raw(3, 2, triple(&GREY)).unwrap()), "png rgb"), "png rgb");

    // Which the encoder here writes without loss.
    let webp = file(RgbImage::from_raw(3, 2, triple(&GREY)).unwrap(), ImageFormat::WebP);
    steps(check_displacements(&webp, "webp"), "webp");
    steps(check_displacements(&tiff::<colortype::Gray8>(3, 2, &GREY), "tiff 8"), "tiff 8");
    quiet(check_displacements(&tiff::<colortype::Gray16>(3, 2, &words()), "tiff 16"), "tiff 16");
    quiet(check_displacements(&tiff::<colortype::Gray32Float>(3, 2, &parts()), "tiff f32"), "tiff f32");
    let colours: Vec<f32> = parts().iter().flat_map(|&part| [part; 3]).collect();
    quiet(check_displacements(&tiff::<colortype::RGB32Float>(3, 2, &colours), "tiff rgb"), "tiff rgb");

    let plane = || FlatSamples::F32(parts());
    quiet(check_displacements(&exr_file(3, 2, &[("height", plane())]), "exr one"), "exr one");
    let several = [("A", plane()), ("Y", plane()), ("Z", FlatSamples::F32(vec![9.0; 6]))];
    quiet(check_displacements(&exr_file(3, 2, &several), "exr y"), "exr y");
    let rgb = ["R", "G", "B"].map(|name| (name, plane()));
    quiet(check_displacements(&exr_file(3, 2, &rgb), "exr rgb"), "exr rgb");
    let half = FlatSamples::F16(parts().iter().map(|&part| exr::prelude::f16::from_f32(part)).collect());
    let (image, _) = decode(&exr_file(3, 2, &[("Y", half)])).unwrap();
    assert!((image.displacements()[2] - (0.2 - 0.5) * 0.002).abs() < 1e-6);
}

/// Lossy files keep smooth heights to some parts in a hundred, with a warning.
#[test]
fn lossy_files_are_read_with_a_warning() {
    let ramp = GrayImage::from_fn(64, 16, |x, _| Luma([(4 * x) as u8]));
    let (image, warnings) = decode(&file(ramp, ImageFormat::Jpeg)).unwrap();
    assert_eq!((image.width(), image.height()), (64, 16));
    for (at, found) in image.displacements().iter().enumerate() {
        let expected = ((4 * (at % 64)) as f64 / 255.0 - 0.5) * AMPLITUDE;
        assert!((f64::from(*found) - expected).abs() < 0.03 * AMPLITUDE, "{at}: {found} for {expected}");
    }
    assert_eq!(warnings.iter().filter(|warning| warning.contains("compression")).count(), 1, "{warnings:?}");
    // One texel of a lossy WebP.
    const LOSSY_WEBP: &[u8] = b"RIFF\x22\x00\x00\x00WEBPVP8 \x16\x00\x00\x000\x01\x00\x9d\x01*\x01\x00\x01\x00\x0e\xc0\xfe%\xa4\x00\x03p\x00\x00\x00\x00";
    let (image, warnings) = decode(LOSSY_WEBP).unwrap();
    assert_eq!((image.width(), image.height()), (1, 1));
    assert!(warnings.iter().any(|warning| warning.contains("compression")), "{warnings:?}");
}

#[test]
fn files_and_wraps() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.png");
    let image = ImageBuffer::<Luma<u16>, _>::from_raw(3, 2, words()).unwrap();
    std::fs::write(&path, png(image)).unwrap();
    let wrap = [Wrap::Mirror, Wrap::Clamp];
    let (image, _) = HeightImage::open(&path, &HeightOptions { wrap, midlevel: 0.0, ..options() }).unwrap();
    assert_eq!(image.wrap(), wrap);
    assert_eq!(image.range(), [0.0, AMPLITUDE as f32]);
    for (path, part) in
        [(folder.path().join("absent.png"), "absent.png"), (folder.path().into(), "regular file")]
    {
        let message = HeightImage::open(&path, &options()).unwrap_err().to_string();
        assert!(message.contains("cannot be read") && message.contains(part), "{message}");
    }
}

#[test]
fn colour_and_alpha_cause_warnings_if_they_matter() {
    let colour = RgbImage::from_raw(1, 1, vec![255, 0, 0]).unwrap();
    let (image, warnings) = decode(&png(colour)).unwrap();
    assert!((f64::from(image.displacements()[0]) - (0.2126 - 0.5) * AMPLITUDE).abs() < 1e-9);
    assert!(warnings.iter().any(|warning| warning.contains("luma")), "{warnings:?}");
    for (alpha, expected) in [(65535, 0), (65534, 1)] {
        let image = ImageBuffer::<LumaA<u16>, _>::from_raw(1, 1, vec![65535_u16, alpha]).unwrap();
        let (image, warnings) = decode(&png(image)).unwrap();
        assert_eq!(image.displacements(), [0.5 * AMPLITUDE as f32]);
        assert_eq!(
            warnings.iter().filter(|warning| warning.contains("alpha")).count(),
            expected,
            "{warnings:?}"
        );
    }
    let image = ImageBuffer::<Rgb<u16>, _>::from_raw(1, 1, vec![7_u16, 7, 7]).unwrap();
    assert!(decode(&png(image)).unwrap().1.is_empty());
}

#[test]
fn large_images_are_averaged() {
    // 7 x 3 texels of a ramp into at most 3 a side: blocks of up to 3 x 3.
    let ramp: Vec<f32> = (0..21).map(|at| (at % 7) as f32).collect();
    let bytes = tiff::<colortype::Gray32Float>(7, 3, &ramp);
    let scale = HeightOptions { amplitude: 1.0, midlevel: 0.0, ..options() };
    let (image, warnings) = HeightImage::decode_within(&bytes, "map", &scale, 3).unwrap();
    assert_eq!((image.width(), image.height()), (3, 1));
    assert_eq!(image.displacements(), [0.5, 2.5, 5.0]);
    assert!(warnings[0].contains("7 x 3") && warnings[0].contains("3 x 1"), "{warnings:?}");
    assert!(HeightImage::decode_within(&bytes, "map", &scale, 7).unwrap().1.is_empty());
    // A real one: rows of 4097 texels, just above what an image may have.
    let wide = ImageBuffer::<Luma<u16>, _>::from_fn(4097, 2, |x, _| Luma([x as u16]));
    let (image, warnings) = decode(&png(wide)).unwrap();
    assert_eq!((image.width(), image.height()), (2049, 1));
    assert!(warnings[0].contains("2049 x 1"), "{warnings:?}");
    // The mean of all values is about kept.
    let mean = image.displacements().iter().map(|&d| f64::from(d)).sum::<f64>() / 2049.0;
    assert!((mean - (2048.0 / 65535.0 - 0.5) * AMPLITUDE).abs() < 1e-7, "{mean}");
}

#[test]
fn texels_that_are_not_finite_are_filled_in() {
    let nan = f32::NAN;
    let unit = HeightOptions { amplitude: 1.0, midlevel: 0.0, ..options() };
    let grey = |width, height, values: &[f32]| {
        HeightImage::decode(&tiff::<colortype::Gray32Float>(width, height, values), "map", &unit)
    };
    let (image, warnings) = grey(3, 3, &[1.0, 2.0, 3.0, 4.0, nan, 6.0, 7.0, 8.0, 9.0]).unwrap();
    assert_eq!(image.displacements()[4], 5.0);
    assert!(warnings[0].contains("1, the first in column 1, row 1"), "{warnings:?}");
    let (image, warnings) = grey(5, 1, &[f32::INFINITY, nan, 4.0, nan, nan]).unwrap();
    assert_eq!(image.displacements(), [4.0; 5]);
    assert!(warnings[0].contains("4, the first in column 0, row 0"), "{warnings:?}");
    // Between two sides, each layer takes what is next to it, and the middle the mean of both.
    let (image, _) = grey(5, 1, &[1.0, nan, nan, nan, 3.0]).unwrap();
    assert_eq!(image.displacements(), [1.0, 1.0, 2.0, 3.0, 3.0]);
    let message = grey(2, 1, &[nan, f32::NEG_INFINITY]).unwrap_err().to_string();
    assert!(message.contains("none of the 2 x 1 texels"), "{message}");
    // Finite, but not as a displacement.
    let far = HeightOptions { amplitude: 1e10, ..unit };
    let bytes = tiff::<colortype::Gray32Float>(2, 1, &[1.0, 3e38]);
    let message = HeightImage::decode(&bytes, "map", &far).unwrap_err().to_string();
    assert!(message.contains("column 1, row 0"), "{message}");
}

#[test]
fn unusable_options_are_refused() {
    let integer = png(GrayImage::from_raw(1, 1, vec![3]).unwrap());
    let float = tiff::<colortype::Gray32Float>(1, 1, &[3.0]);
    for amplitude in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let error = HeightImage::decode(&integer, "map", &HeightOptions { amplitude, ..options() });
        assert!(matches!(error, Err(HeightFileError::Amplitude { .. })), "{amplitude}");
    }
    for (midlevel, of_integers, of_floats) in [
        (0.0, true, true),
        (1.0, true, true),
        (1.5, false, true),
        (-0.1, false, true),
        (f64::NAN, false, false),
    ] {
        let options = HeightOptions { midlevel, ..options() };
        assert_eq!(HeightImage::decode(&integer, "map", &options).is_ok(), of_integers, "{midlevel}");
        assert_eq!(HeightImage::decode(&float, "map", &options).is_ok(), of_floats, "{midlevel}");
    }
}

#[test]
fn files_without_an_image_are_refused() {
    for (bytes, part) in [
        (&b""[..], "is empty"),
        (b"height", "no image"),
        (b"\xff\xd8\xff\xe0", "cut off"),
        (b"\xff\xd8\xff\xda\xff\xd9", "map: "),
        (b"RIFF\x08\0\0\0WEBPVP8 ", "map: "),
        (b"\x89PNG\r\n\x1a\n", "map: "),
        (b"II*\0", "map: "),
        (b"\x76\x2f\x31\x01", "map: "),
    ] {
        let message = decode(bytes).unwrap_err().to_string();
        assert!(message.contains(part) && !message.contains('\n'), "{message}");
    }
    // Only depth and something else: no telling which is the height.
    let plane = || FlatSamples::F32(vec![0.0; 6]);
    let message = decode(&exr_file(3, 2, &[("Z", plane()), ("id", plane())])).unwrap_err().to_string();
    assert!(message.contains("neither Y nor R, G and B"), "{message}");
}

/// The header of a PNG with its checksum, changed to another size.
fn png_of_size(width: u32, height: u32) -> Vec<u8> {
    let mut bytes = png(ImageBuffer::<Luma<u16>, _>::from_raw(3, 2, words()).unwrap());
    bytes[16..20].copy_from_slice(&width.to_be_bytes());
    bytes[20..24].copy_from_slice(&height.to_be_bytes());
    // CRC-32 of the chunk, bit by bit.
    let crc = !bytes[12..29].iter().fold(u32::MAX, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ (0xedb8_8320 & (crc & 1).wrapping_neg()))
    });
    bytes[29..33].copy_from_slice(&crc.to_be_bytes());
    bytes
}

#[test]
fn hostile_headers_are_refused_before_memory_is_allocated() {
    assert!(decode(&png_of_size(3, 2)).is_ok(), "the checksum is right");
    for (width, height) in [(MAX_FILE_SIDE + 1, 1), (0x7fff_ffff, 0x7fff_ffff), (1, 1 << 20)] {
        let error = decode(&png_of_size(width, height)).unwrap_err();
        assert!(!error.to_string().contains('\n'), "{error}");
        assert!(matches!(error, HeightFileError::TooLarge { .. }), "{width} x {height}: {error}");
    }
    for (width, height) in [(0, 2), (3, 0), (MAX_FILE_SIDE, 4000)] {
        let error = decode(&png_of_size(width, height)).unwrap_err();
        assert!(matches!(error, HeightFileError::Decode { .. }), "{width} x {height}: {error}");
    }
}

fn small_files() -> Vec<(&'static str, Vec<u8>)> {
    let plane = || FlatSamples::F32(parts());
    vec![
        ("png", png(ImageBuffer::<Luma<u16>, _>::from_raw(3, 2, words()).unwrap())),
        ("jpeg", file(GrayImage::from_raw(3, 2, GREY.to_vec()).unwrap(), ImageFormat::Jpeg)),
        ("webp", file(GrayImage::from_raw(3, 2, GREY.to_vec()).unwrap(), ImageFormat::WebP)),
        ("tiff 16", tiff::<colortype::Gray16>(3, 2, &words())),
        ("tiff f32", tiff::<colortype::Gray32Float>(3, 2, &parts())),
        ("exr", exr_file(3, 2, &[("Y", plane())])),
        ("exr rgb", exr_file(3, 2, &["R", "G", "B"].map(|name| (name, plane())))),
    ]
}

#[test]
fn truncated_files_give_the_image_or_an_error() {
    for (name, bytes) in small_files() {
        let whole = decode(&bytes).unwrap().0;
        let mut refused = 0;
        for length in 0..bytes.len() {
            match decode(&bytes[..length]) {
                Ok((image, _)) => assert_eq!(image, whole, "{name}, {length} bytes"),
                Err(error) => {
                    assert!(!error.to_string().contains(['\n', '\r']), "{name}, {length} bytes: {error}");
                    refused += 1;
                }
            }
        }
        // All but what may follow the texels.
        assert!(refused + 24 >= bytes.len(), "{name}: {refused} of {}", bytes.len());
    }
}

#[test]
fn damaged_files_never_panic() {
    let seed = 17;
    let mut random = StdRng::seed_from_u64(seed);
    for (name, original) in small_files() {
        let (mut read, mut refused) = (0, 0);
        for round in 0..4000 {
            let mut bytes = original.clone();
            for _ in 0..random.random_range(1..4) {
                let at = random.random_range(0..bytes.len());
                match random.random_range(0..4) {
                    0 => bytes[at] = random.random_range(0..=255),
                    1 => bytes[at] ^= 1 << random.random_range(0..8),
                    2 => bytes[at] = 255,
                    _ => drop(bytes.remove(at)),
                }
            }
            let result = std::panic::catch_unwind(|| decode(&bytes))
                .unwrap_or_else(|_| panic!("seed {seed}, {name}, round {round}: {bytes:?}"));
            match result {
                Ok((image, _)) => {
                    assert!(image.displacements().iter().all(|d| d.is_finite()), "{name}, round {round}");
                    read += 1;
                }
                Err(error) => {
                    assert!(!error.to_string().contains(['\n', '\r']), "{name}, round {round}: {error}");
                    refused += 1;
                }
            }
        }
        assert!(read > 0 && refused > 100, "{name}: {read} read, {refused} refused");
    }
}
