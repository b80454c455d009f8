//! Haptic textures: the directional penetration depth of two surface patches (§4.4.1), on the CPU and on the GPU.
//!
//! Two patches A and B in contact, projected along the penetration direction **n** onto a common grid, are height
//! fields h_A and h_B (Eq. 4.9). Their directional penetration depth is the largest overlap (Eq. 4.10)
//!
//! δ_n = max over the texels where both have a surface of (h_A − h_B).
//!
//! [`PatchPairs`] holds the heights of a batch of patches and says which pairs to evaluate; a [`Backend`] gives
//! depth and texel of each pair. [`CpuBackend`] is the reference; [`WgpuBackend`] (feature `gpu`) evaluates a
//! batch in one submission and reads back only the results. Both give the same answers.
//!
//! ```
//! use palpate_texture_pd::{Backend, CpuBackend, PatchPairs};
//!
//! let mut pairs = PatchPairs::new(2)?;
//! let a = pairs.add_patch(&[0.001, 0.003, f32::NAN, 0.002])?; // metres along n; NaN: no surface there
//! let b = pairs.add_patch(&[0.0; 4])?;
//! pairs.add_pair(a, b)?;
//!
//! let mut depths = Vec::new();
//! CpuBackend.directional_depths(&pairs, &mut depths)?;
//! let deepest = depths[0].expect("the patches share texels");
//! assert_eq!((deepest.depth, deepest.column, deepest.row), (0.003, 1, 0));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod backend;
mod bake;
#[cfg(feature = "gpu")]
mod gpu;
mod height_image;
mod kernels;
mod normals;
mod pairs;

pub use backend::{Backend, BackendError, CpuBackend};
pub use bake::{BakeError, BakeOptions, BakeReport, Baked, bake};
#[cfg(feature = "gpu")]
pub use gpu::WgpuBackend;
pub use height_image::{HeightImage, HeightImageError, MAX_SIDE, Wrap};
pub use normals::corner_directions;
pub use pairs::{DirectionalDepth, MAX_GRID, PairsError, Patch, PatchPairs};
/// The version of wgpu whose devices [`WgpuBackend::with_device`] takes.
#[cfg(feature = "gpu")]
pub use wgpu;
