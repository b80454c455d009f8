//! WGSL compute kernels of the palpate haptic rendering engine.
//!
//! The kernels are a package of their own because cargo ships only the files below a package's root. Every
//! file in `wgsl/` is a constant here and listed in [`SHADERS`] with its entry points; a test validates each
//! with naga, which needs no GPU. The crate that runs a kernel has a CPU twin of each entry point, and a test
//! that fails if one is missing.

/// A WGSL file and its entry points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shader {
    /// Name of the file, without its extension.
    pub name: &'static str,
    /// WGSL source.
    pub source: &'static str,
    /// Names of the compute entry points.
    pub entry_points: &'static [&'static str],
}

/// Directional penetration depth of textured surfaces (§4.4): `height_images` fills images of their heights
/// over a common grid (Eq. 4.9); `overlaps` finds the largest overlap of pairs of images (Eq. 4.10) and the
/// sums from which its derivatives are computed.
///
/// Bindings of group 0, described in the file: 0, uniform, parameters of the batch; 1, triangles; 2, images;
/// 3, levels of the textures; 4, their coefficients; 5, heights, written by `height_images` and read by
/// `overlaps`; 6, pairs; 7, answers.
pub const TEXTURE_DEPTH: Shader = Shader {
    name: "texture_depth",
    source: include_str!("../wgsl/texture_depth.wgsl"),
    entry_points: &["height_images", "overlaps"],
};

/// Every shader.
pub const SHADERS: &[Shader] = &[TEXTURE_DEPTH];

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::path::Path;

    use naga::ShaderStage;
    use naga::valid::{Capabilities, ValidationFlags, Validator};

    use super::*;

    #[test]
    fn every_shader_parses_and_is_valid() {
        for shader in SHADERS {
            let module = naga::front::wgsl::parse_str(shader.source)
                .unwrap_or_else(|error| panic!("{}: {}", shader.name, error.emit_to_string(shader.source)));
            // No capability beyond what every WebGPU device has.
            Validator::new(ValidationFlags::all(), Capabilities::empty())
                .validate(&module)
                .unwrap_or_else(|error| panic!("{}: {}", shader.name, error.emit_to_string(shader.source)));
            let found: Vec<_> = module.entry_points.iter().map(|entry| entry.name.as_str()).collect();
            assert_eq!(found, shader.entry_points, "entry points of {}", shader.name);
            assert!(module.entry_points.iter().all(|entry| entry.stage == ShaderStage::Compute));
        }
    }

    #[test]
    fn every_file_is_listed_and_entry_points_have_distinct_names() {
        let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/wgsl"));
        let files: BTreeSet<String> =
            folder.read_dir().unwrap().map(|file| file.unwrap().file_name().into_string().unwrap()).collect();
        let listed: BTreeSet<String> = SHADERS.iter().map(|shader| format!("{}.wgsl", shader.name)).collect();
        assert_eq!(files, listed);
        let entry_points: Vec<_> = SHADERS.iter().flat_map(|shader| shader.entry_points).collect();
        assert_eq!(entry_points.iter().collect::<BTreeSet<_>>().len(), entry_points.len());
    }
}
