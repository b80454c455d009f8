//! CPU twins of the WGSL entry points: the same bindings in the same layout, and the same answers to within
//! rounding. [`ReferenceBackend`](crate::ReferenceBackend) runs them unchanged;
//! [`CpuBackend`](crate::CpuBackend) uses the same functions, but does not fill whole images.
//!
//! Coordinates are those of a contact's frame: u and v along the grid and n along the penetration direction,
//! from the centre of the grid, in m and f32. The grid is no larger than the contact, so rounding is about
//! 1e-7 of its size.

mod displaced;
mod height_images;
mod overlaps;

use bytemuck::{Pod, Zeroable};

pub(crate) use displaced::{Point, Textures};
pub(crate) use height_images::{covered, height_images};
pub use overlaps::Answer;
pub(crate) use overlaps::{Known, MIN_EXPONENT, overlaps, pair_answer};

/// Texel index of a pair of images that have no texel in common.
pub(crate) const NOWHERE: u32 = u32::MAX;
/// Bits of the height of a texel without a surface: 2⁶⁴ m.
pub(crate) const NO_SURFACE: u32 = 0x5f80_0000;
/// Flag in a texel's triangle index: the displaced surface is folded there, as seen along n.
pub(crate) const FOLDED: u32 = 1 << 31;

/// Parameters of a batch, the same for all invocations.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub(crate) struct Header {
    /// Texels along a side of an image.
    pub grid: u32,
    pub images: u32,
    pub pairs: u32,
    /// Maximum number of Newton steps per texel.
    pub refinements: u32,
}

/// A flat triangle p₀ + s e₁ + t e₂ in a contact's frame, displaced by h(uv₀ + s d₁ + t d₂) along n₀ + s m₁ +
/// t m₂.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub(crate) struct Triangle {
    /// p₀, e₁ and e₂ along u and v.
    pub plane: [[f32; 2]; 3],
    /// Inverse of twice the signed area as seen along n, 1/m².
    pub inverse_area: f32,
    /// Index of the texture's level plus one; 0 without a texture.
    pub level: f32,
    /// p₀, e₁ and e₂ along n.
    pub rise: [f32; 3],
    /// Largest magnitude of the displacement, m.
    pub max_displacement: f32,
    /// n₀, m₁ and m₂.
    pub directions: [[f32; 3]; 3],
    /// uv₀, d₁ and d₂, texels.
    pub texture: [[f32; 2]; 3],
    /// Largest outward displacement, m.
    pub max_outwards: f32,
}

/// A request for a height image.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub(crate) struct Image {
    /// Index of its first triangle.
    pub first: u32,
    pub count: u32,
    /// 1 for the highest surface along n, −1 for the lowest.
    pub side: f32,
    /// Distance between texels, m.
    pub step: f32,
    /// Largest distance along n of undisplaced surfaces from the frame's origin, m; those farther away are
    /// ignored.
    pub reach: f32,
    pub unused: [u32; 3],
}

/// Two images to compare.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub(crate) struct Pair {
    pub a: u32,
    pub b: u32,
    /// Temperature τ of the smooth maximum, m; 0 for the largest overlap alone.
    pub temperature: f32,
    /// Half-planes outside of which overlaps do not count.
    pub clips: Clips,
}

/// Maximum number of half-planes of a domain; the WGSL kernels bind as many.
pub(crate) const MAX_CLIPS: usize = 8;

/// Half-planes x u + y v ≤ c that bound a contact's domain, with (x, y) of length 1 and c in m.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub(crate) struct Clips {
    count: u32,
    /// x, y, c and padding.
    planes: [[f32; 4]; MAX_CLIPS],
}

impl Clips {
    pub fn push(&mut self, [x, y, c]: [f32; 3]) {
        if let Some(free) = self.planes.get_mut(self.count as usize) {
            *free = [x, y, c, 0.0];
            self.count += 1;
        }
    }

    /// Returns the range of u, m, in which the line at v is inside all half-planes or outside by at most
    /// `step`.
    pub fn crossing(&self, v: f32, step: f32) -> [f32; 2] {
        let planes = self.planes.iter().take(self.count as usize);
        planes.fold([f32::NEG_INFINITY, f32::INFINITY], |[from, to], [x, y, c, _]| {
            let end = (c + step - y * v) / x;
            if *x > 0.0 {
                [from, to.min(end)]
            } else if *x < 0.0 {
                [from.max(end), to]
            } else if y * v <= c + step {
                [from, to]
            } else {
                [f32::INFINITY, f32::NEG_INFINITY]
            }
        })
    }

    /// Returns the distance of a point to the nearest border, m: negative outside of the domain.
    #[inline]
    pub fn margin(&self, u: f32, v: f32) -> f32 {
        let margins = self.planes.iter().take(self.count as usize).map(|[x, y, c, _]| c - (x * u + y * v));
        margins.fold(f32::INFINITY, f32::min)
    }
}

/// Returns the indices of texels between two coordinates along u or v, m, widened by one texel for rounding.
#[inline]
pub(crate) fn between(from: f32, to: f32, grid: u32, step: f32) -> std::ops::Range<u32> {
    let index = |at: f32| at / step + 0.5 * grid as f32 - 0.5;
    // Casts to u32 saturate.
    let (from, to) = ((index(from) - 1.0) as u32, (index(to) + 3.0) as u32);
    from.min(grid)..to.min(grid)
}

/// Returns the coordinate of a texel's centre along u or v, m.
#[inline]
pub(crate) fn coordinate(index: u32, grid: u32, step: f32) -> f32 {
    (index as f32 + 0.5 - 0.5 * grid as f32) * step
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::sync::Arc;

    use glam::{DVec2, DVec3};
    use palpate_core::TriMesh;
    use palpate_core::mesh::UvMesh;

    use super::{Answer, Clips, NOWHERE, Triangle};
    use crate::{
        Backend, Batch, CpuBackend, HeightImage, ReferenceBackend, SurfaceSet, TexturedSurface, Wrap,
    };

    /// Names of the twins: `tests/it/backends.rs` runs twins and entry points on the same inputs.
    const TWINS: [&str; 2] = ["height_images", "overlaps"];

    #[test]
    fn every_entry_point_has_a_twin() {
        // They exist, or this would not compile.
        let _ = (super::height_images, super::overlaps);
        let entry_points = palpate_shaders::SHADERS.iter().flat_map(|shader| shader.entry_points).copied();
        assert_eq!(entry_points.collect::<BTreeSet<_>>(), TWINS.into());
    }

    /// A set with one texture of constant height (m).
    fn even(height: f32) -> SurfaceSet {
        let corners = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
        let uv = vec![[DVec2::ZERO, DVec2::X, DVec2::Y]];
        let mesh = UvMesh::new(TriMesh::new(corners, vec![[0, 1, 2]]).unwrap(), uv).unwrap();
        let image = HeightImage::new(1, 1, vec![height], [Wrap::Clamp; 2]).unwrap();
        let mut surfaces = SurfaceSet::default();
        surfaces.add(&Arc::new(TexturedSurface::textured(&mesh, &image, 1.0).unwrap())).unwrap();
        surfaces
    }

    /// The triangle's directions meet in one point at the height of its texture. All of the triangle is
    /// displaced to that point, so its area as seen along n is exactly 0.
    #[test]
    fn a_triangle_displaced_to_a_point_has_finite_derivatives() {
        let height = 0.25;
        let surfaces = even(height);
        // A triangle that faces along n (side 1) or against it (side −1).
        let triangle = |side: f32, folded: bool| {
            let facing =
                |edges: [[f32; 2]; 3]| if side > 0.0 { edges } else { [edges[0], edges[2], edges[1]] };
            let flat = Triangle {
                plane: facing([[-0.5, -0.5], [2.0, 0.0], [0.0, 2.0]]),
                inverse_area: 0.25 * side,
                rise: [0.0, 0.2, -0.1],
                ..Triangle::default()
            };
            let [across, along] = [[-8.0, 0.0, 0.0], [0.0, -8.0, 0.0]];
            let collapsed = Triangle {
                level: 1.0,
                max_displacement: height,
                max_outwards: height,
                directions: if side > 0.0 {
                    [[2.0, 2.0, 1.0], across, along]
                } else {
                    [[2.0, 2.0, -1.0], along, across]
                },
                texture: [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]],
                ..flat
            };
            if folded { collapsed } else { flat }
        };
        let mut batch = Batch::default();
        batch.clear(8, 5);
        for temperature in [0.0, 1e-3] {
            for folded in [[true, false], [false, true], [true, true]] {
                let [a, b] = [(1.0, folded[0]), (-1.0, folded[1])].map(|(side, folded)| {
                    let first = batch.triangles.len();
                    batch.triangles.push(triangle(side, folded));
                    batch.push_image(first, side.into(), 0.05, 10.0)
                });
                batch.push_pair(a, b, temperature, Clips::default());
            }
        }
        let mut backends: Vec<Box<dyn Backend>> = vec![
            Box::new(ReferenceBackend::new()),
            Box::new(CpuBackend::new()),
            #[cfg(feature = "gpu")]
            Box::new(crate::WgpuBackend::new().unwrap()),
        ];
        for backend in &mut backends {
            let mut answers: Vec<Answer> = Vec::new();
            backend.evaluate(&surfaces, &batch, &mut answers).unwrap();
            assert_eq!(answers.len(), 6);
            for answer in &answers {
                let sums = answer.gradient.iter().chain(&answer.spread).chain(&answer.curvature);
                let all = sums.chain(&answer.jet_a).chain(&answer.jet_b).chain([&answer.weight]);
                let steepest =
                    all.fold(
                        0.0_f32,
                        |most, value| if value.is_finite() { most.max(value.abs()) } else { f32::INFINITY },
                    );
                assert!(answer.texel != NOWHERE && answer.folded > 0, "{}: {answer:?}", backend.name());
                assert!(steepest < 1e3, "{}: {answer:?}", backend.name());
            }
        }
    }
}
