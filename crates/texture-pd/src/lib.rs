//! Haptic textures: the directional penetration depth of two surfaces with fine detail (§4.4), on the CPU and
//! on the GPU.
//!
//! A [`TexturedSurface`] is a coarse mesh and the fine detail that displaces it, a [`HeightImage`]. For each
//! contact that coarse collision detection finds between two surfaces, [`DepthQuery`] computes their
//! directional penetration depth δ_n along the contact's direction **n**, and its derivatives by the motion
//! of one of them. A [`Backend`] evaluates the height images.
//!
//! ```
//! use std::sync::Arc;
//! use glam::{DVec2, DVec3};
//! use palpate_core::mesh::UvMesh;
//! use palpate_core::{Pose, TriMesh};
//! use palpate_texture_pd::*;
//!
//! // A plate of 10 cm with ridges 1 mm high and 5 mm apart, and a tetrahedron above it.
//! let corners = [[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]];
//! let plate = TriMesh::new(corners.map(|[x, y]| DVec3::new(x, y, 0.0)).to_vec(), vec![[0, 1, 2], [0, 2, 3]])?;
//! let uv = [DVec2::ZERO, DVec2::X * 20.0, DVec2::new(20.0, 1.0), DVec2::Y];
//! let plate = UvMesh::new(plate, vec![[uv[0], uv[1], uv[2]], [uv[0], uv[2], uv[3]]])?;
//! let ridge = (0..16).map(|i| 0.0005 * (std::f32::consts::TAU * (i as f32 + 0.5) / 16.0).cos()).collect();
//! let ridges = HeightImage::new(16, 1, ridge, [Wrap::Repeat; 2])?;
//! let tip = vec![DVec3::ZERO, DVec3::new(0.01, 0.0, 0.02), DVec3::new(-0.01, 0.01, 0.02), DVec3::new(-0.01, -0.01, 0.02)];
//! let tip = TriMesh::new(tip, vec![[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]])?;
//!
//! let mut surfaces = SurfaceSet::default();
//! let a = surfaces.add(&Arc::new(TexturedSurface::plain(&tip)?))?;
//! let b = surfaces.add(&Arc::new(TexturedSurface::textured(&plate, &ridges, 0.5)?))?;
//!
//! // The tip stands on the flank of a ridge.
//! let place = DVec3::new(0.001, 0.0, 0.0);
//! let contact = TextureContact {
//!     a,
//!     pose_a: Pose::from_translation(place),
//!     center: place,
//!     b,
//!     pose_b: Pose::IDENTITY,
//!     normal: -DVec3::Z,
//!     point: place,
//!     half_size: 0.002,
//!     reach: 0.01,
//!     domain: Domain::WHOLE,
//! };
//! let mut query = DepthQuery::new();
//! let depths = query.run(&surfaces, &[contact], &DepthSettings::default(), &mut CpuBackend::new())?;
//! let found = depths[0].expect("both surfaces are in the grid");
//! // The force is against the gradient: down the flank, towards the next groove.
//! assert!(found.linear.x < 0.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![cfg_attr(docsrs, feature(doc_cfg))]

mod auto;
mod backend;
mod bake;
mod batch;
mod ceiling;
mod cpu;
mod depth;
mod domain;
mod fallback;
mod force;
#[cfg(feature = "gpu")]
mod gpu;
#[cfg(feature = "images")]
mod height_file;
mod height_image;
mod kernels;
mod maximum;
mod normals;
mod spline;
mod surface;
mod texels;

pub use auto::AutoBackend;
pub use backend::{Backend, BackendError, ReferenceBackend};
pub use bake::{BakeError, BakeOptions, BakeReport, Baked, bake};
pub use batch::{Batch, MAX_GRID, SurfaceId, SurfaceSet, TooManyTexels};
pub use cpu::CpuBackend;
pub use depth::{DepthError, DepthQuery, DepthSettings, TextureContact, TextureDepth, TextureFilter};
pub use domain::{Domain, HalfSpace};
pub use fallback::Fallback;
pub use force::{TextureForce, sum_of_forces};
#[cfg(feature = "gpu")]
pub use gpu::{WgpuBackend, adapters};
#[cfg(feature = "images")]
pub use height_file::{HeightFileError, HeightOptions, MAX_FILE_SIDE};
pub use height_image::{HeightImage, HeightImageError, MAX_SIDE, Wrap};
pub use kernels::Answer;
pub use normals::corner_directions;
pub use surface::{SurfaceError, TexturedSurface};
pub use texels::{TexelReport, texel_sizes};
/// Version of wgpu whose devices [`WgpuBackend::with_device`] accepts.
#[cfg(feature = "gpu")]
pub use wgpu;
