//! Any bytes as a height image: it is finite, or refused in one line.

#![no_main]

use libfuzzer_sys::fuzz_target;
use palpate::texture_pd::{HeightImage, HeightOptions};

fuzz_target!(|data: &[u8]| {
    match HeightImage::decode(data, "image", &HeightOptions::new(1e-3)) {
        Ok((image, warnings)) => {
            assert!(image.displacements().iter().all(|displacement| displacement.is_finite()));
            assert!(warnings.iter().all(|warning| !warning.contains('\n')));
        }
        Err(error) => assert!(!error.to_string().contains('\n'), "{error}"),
    }
});
