//! Any bytes as a mesh file, of the format that the first byte chooses: loaded as it is and with repair, and
//! validated; and loaded with texture coordinates.

#![no_main]

use std::path::PathBuf;
use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use palpate::mesh_io::{LoadOptions, load, load_uv};

const FORMATS: [&str; 5] = ["obj", "stl", "ply", "glb", "gltf"];

static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| {
    let folder = std::env::temp_dir().join(format!("palpate-fuzz-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("the temporary folder can be written to");
    folder
});

fuzz_target!(|data: &[u8]| {
    let Some((choice, bytes)) = data.split_first() else { return };
    let format = FORMATS[usize::from(*choice) % FORMATS.len()];
    let file = FOLDER.join("mesh").with_extension(format);
    std::fs::write(&file, bytes).expect("the temporary folder can be written to");
    for repair in [false, true] {
        match load(&file, &LoadOptions { repair, ..LoadOptions::default() }) {
            Ok(loaded) => {
                let report = loaded.mesh.validate();
                assert_eq!(report.triangles, loaded.mesh.triangles().len());
                assert!(loaded.mesh.vertices().iter().all(|v| v.is_finite()));
            }
            Err(error) => assert!(!error.to_string().contains('\n'), "{error}"),
        }
    }
    match load_uv(&file, &LoadOptions::default()) {
        Ok(loaded) => assert_eq!(loaded.mesh.coordinates().len(), loaded.mesh.mesh().triangles().len()),
        Err(error) => assert!(!error.to_string().contains('\n'), "{error}"),
    }
});
