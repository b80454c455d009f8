//! Input of a backend: the textures of surfaces, which stay, and the images and pairs of one submission.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::ceiling::Ceilings;
use crate::kernels::{Clips, Header, Image, Pair, Triangle};
use crate::spline::Level;
use crate::surface::TexturedSurface;

/// Maximum number of texels along a side of a grid.
pub const MAX_GRID: u32 = 1024;
/// Maximum number of texture levels: an f32 holds their index exactly.
const MAX_LEVELS: usize = 1 << 20;
/// Maximum number of spline coefficients, 4 bytes each: their total size in bytes fits into 32 bits.
const MAX_COEFFICIENTS: usize = 1 << 29;

/// Revision for the next set with a new texture. Sets without a texture have revision 0.
static NEXT_REVISION: AtomicU64 = AtomicU64::new(1);

/// The surfaces that may touch each other, with all of their textures.
#[derive(Clone, Debug, Default)]
pub struct SurfaceSet {
    /// Surfaces, with the index of the first level of their texture.
    surfaces: Vec<(Arc<TexturedSurface>, u32)>,
    /// Identifies the set's textures among all sets and earlier contents of this one.
    revision: u64,
    /// Shared with the thread that uploads them.
    pub(crate) levels: Arc<Vec<Level>>,
    pub(crate) coefficients: Arc<Vec<f32>>,
    pub(crate) ceilings: Ceilings,
}

/// Handle of a surface in a [`SurfaceSet`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SurfaceId(usize);

/// Error: the textures of a [`SurfaceSet`] are too large.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the textures have more than {MAX_COEFFICIENTS} texels in all: make them smaller")]
pub struct TooManyTexels;

impl SurfaceSet {
    /// Adds a surface. Surfaces that are the same [`Arc`] share their texture.
    ///
    /// # Errors
    /// If all textures together are too large.
    pub fn add(&mut self, surface: &Arc<TexturedSurface>) -> Result<SurfaceId, TooManyTexels> {
        if let Some(known) = self.surfaces.iter().position(|(known, _)| Arc::ptr_eq(known, surface)) {
            return Ok(SurfaceId(known));
        }
        let first = self.levels.len() as u32;
        if let Some(texture) = surface.texture() {
            let coefficients = self.coefficients.len();
            if coefficients + texture.coefficients.len() > MAX_COEFFICIENTS
                || self.levels.len() + texture.levels.len() > MAX_LEVELS
            {
                return Err(TooManyTexels);
            }
            let moved =
                |&[from, width, height, wrap]: &Level| [from + coefficients as u32, width, height, wrap];
            Arc::make_mut(&mut self.levels).extend(texture.levels.iter().map(moved));
            Arc::make_mut(&mut self.coefficients).extend_from_slice(&texture.coefficients);
            self.ceilings.add(&texture.levels, &texture.coefficients);
            self.revision = NEXT_REVISION.fetch_add(1, Ordering::Relaxed);
        }
        self.surfaces.push((surface.clone(), first));
        Ok(SurfaceId(self.surfaces.len() - 1))
    }

    /// Returns a surface of the set.
    pub fn surface(&self, id: SurfaceId) -> &TexturedSurface {
        &self.surfaces[id.0].0
    }

    #[cfg(feature = "gpu")]
    pub(crate) fn revision(&self) -> u64 {
        self.revision
    }

    /// Returns the index of the first level of a surface's texture.
    pub(crate) fn first_level(&self, id: SurfaceId) -> u32 {
        self.surfaces[id.0].1
    }
}

/// Images of heights, and pairs of them to compare.
#[derive(Clone, Debug, Default)]
pub struct Batch {
    pub(crate) header: Header,
    pub(crate) triangles: Vec<Triangle>,
    pub(crate) images: Vec<Image>,
    pub(crate) pairs: Vec<Pair>,
}

impl Batch {
    /// Copies another batch, reusing the allocated buffers.
    #[cfg(feature = "gpu")]
    pub(crate) fn copy_from(&mut self, other: &Self) {
        let Self { header, triangles, images, pairs } = self;
        *header = other.header;
        triangles.clone_from(&other.triangles);
        images.clone_from(&other.images);
        pairs.clone_from(&other.pairs);
    }

    pub(crate) fn clear(&mut self, grid: u32, refinements: u32) {
        self.header = Header { grid, images: 0, pairs: 0, refinements };
        self.triangles.clear();
        self.images.clear();
        self.pairs.clear();
    }

    /// Adds an image of the triangles from `first` to the last one, and returns its index.
    pub(crate) fn push_image(&mut self, first: usize, side: f64, step: f64, reach: f64) -> u32 {
        self.images.push(Image {
            first: first as u32,
            count: (self.triangles.len() - first) as u32,
            side: side as f32,
            step: step as f32,
            reach: reach as f32,
            unused: [0; 3],
        });
        self.header.images += 1;
        self.header.images - 1
    }

    /// Adds a pair of images. Each image A is in one pair only; pairs with the same B have the same clips.
    pub(crate) fn push_pair(&mut self, a: u32, b: u32, temperature: f64, clips: Clips) {
        self.pairs.push(Pair { a, b, temperature: temperature as f32, clips });
        self.header.pairs += 1;
    }

    /// Number of texels of an image; 1 for a batch that was never filled.
    pub(crate) fn grid_texels(&self) -> usize {
        (self.header.grid * self.header.grid).max(1) as usize
    }

    /// Number of texels of all images.
    pub(crate) fn texels(&self) -> usize {
        self.grid_texels() * self.images.len()
    }
}
