//! The backend on the CPU.
//!
//! It gives the same answers as the kernels' twins without filling whole images. A displaced point is at most
//! as high as the flat triangle plus the largest displacement nearby ([`Ceilings`]), so one pass over the
//! flat triangles bounds the overlap of each texel. Only texels whose bound reaches the largest overlap found
//! so far are displaced; they are few.

use std::ops::Range;

use crate::backend::{Backend, BackendError};
use crate::batch::{Batch, SurfaceSet};
use crate::ceiling::Ceilings;
use crate::kernels::{
    Answer, Clips, FOLDED, Image, Known, MIN_EXPONENT, NO_SURFACE, NOWHERE, Pair, Point, Textures, between,
    coordinate, covered, pair_answer,
};

/// Allowance for f32 rounding of overlaps, as a part of the grid's side. Without it a texel with the largest
/// overlap could be passed over.
const RELATIVE_ROUNDING: f32 = 1e-6;

/// Bits of a height that is not computed yet: no height is as large.
const UNKNOWN: u32 = NO_SURFACE + 1;

/// Backend on the CPU. It cannot fail, and allocates only to grow its workspace.
#[derive(Clone, Debug, Default)]
pub struct CpuBackend {
    /// Domain of each image.
    clips: Vec<Clips>,
    /// Columns of each row that are in the domain.
    rows: Vec<Range<u32>>,
    /// Upper bound of the surface along n (A) or against it (B), m, for each texel of each image.
    bounds: Vec<f32>,
    /// Heights as in the kernels, except for texels that were not displaced.
    heights: Vec<[u32; 2]>,
    /// Point in its triangle, (s, t), of each displaced texel.
    points: Vec<[f32; 2]>,
    /// Texels of a pair that may have the largest overlap, with bounds of their overlaps, m.
    candidates: Vec<(u32, f32)>,
    /// Candidates that were displaced.
    displaced: Vec<u32>,
}

impl CpuBackend {
    /// A backend with an empty workspace.
    pub fn new() -> Self {
        Self::default()
    }
}

impl Backend for CpuBackend {
    fn name(&self) -> &str {
        "CPU"
    }

    fn evaluate(
        &mut self,
        surfaces: &SurfaceSet,
        batch: &Batch,
        answers: &mut Vec<Answer>,
    ) -> Result<(), BackendError> {
        let textures = Textures { levels: &surfaces.levels, coefficients: &surfaces.coefficients };
        let Batch { header, triangles, images, pairs } = batch;
        self.bounds.resize(batch.texels(), 0.0);
        self.heights.resize(batch.texels(), [0; 2]);
        self.points.resize(batch.texels(), [0.0; 2]);
        self.candidates.resize(batch.grid_texels(), (0, 0.0));
        self.displaced.resize(batch.grid_texels(), 0);
        self.clips.clear();
        self.clips.resize(images.len(), Clips::default());
        for pair in pairs {
            [self.clips[pair.a as usize], self.clips[pair.b as usize]] = [pair.clips; 2];
        }
        let mut texels = Texels {
            batch,
            textures,
            ceilings: &surfaces.ceilings,
            bounds: &mut self.bounds,
            heights: &mut self.heights,
            points: &mut self.points,
        };
        for (image, clips) in (0..).zip(&self.clips) {
            let step = images[image as usize].step;
            let columns = |row| {
                let [from, to] = clips.crossing(coordinate(row, header.grid, step), step);
                between(from, to, header.grid, step)
            };
            self.rows.clear();
            self.rows.extend((0..header.grid).map(columns));
            texels.outline(image, &self.rows);
        }
        answers.clear();
        for pair in pairs {
            texels.displace(pair, &mut self.candidates, &mut self.displaced);
            let known = Known { points: texels.points, texels: &self.displaced };
            let heights = &*texels.heights;
            answers.push(pair_answer(header, triangles, images, textures, heights, Some(known), pair));
        }
        Ok(())
    }
}

/// Texels of all images.
struct Texels<'a> {
    batch: &'a Batch,
    textures: Textures<'a>,
    ceilings: &'a Ceilings,
    bounds: &'a mut [f32],
    heights: &'a mut [[u32; 2]],
    points: &'a mut [[f32; 2]],
}

impl Texels<'_> {
    /// Finds the triangle at each texel of an image, within the given columns of each row, and bounds the
    /// height of its displaced surface. Where several triangles overlap, they are displaced to find the
    /// visible one.
    fn outline(&mut self, index: u32, domain: &[Range<u32>]) {
        let batch = self.batch;
        let grid = batch.header.grid;
        let all = self.at(index, 0)..self.at(index + 1, 0);
        self.heights[all.clone()].fill([NO_SURFACE, NOWHERE]);
        self.bounds[all].fill(f32::NEG_INFINITY);
        let Image { first, count, step, side, reach, .. } = batch.images[index as usize];
        for seen in first..first + count {
            let triangle = &batch.triangles[seen as usize];
            let lift = triangle.lift(&self.textures, self.ceilings);
            let [columns, rows] = covered(triangle, grid, step);
            for row in rows {
                let v = coordinate(row, grid, step);
                let inside = &domain[row as usize];
                let (first, end) = (columns.start.max(inside.start), columns.end.min(inside.end));
                if first >= end {
                    continue;
                }
                // Only the columns that the triangle crosses in this row.
                let [from, to] = triangle.crossing(v);
                let crossed = between(from, to, grid, step);
                for column in first.max(crossed.start)..end.min(crossed.end) {
                    let Some((s, t, base)) = triangle.flat(coordinate(column, grid, step), v, reach) else {
                        continue;
                    };
                    let texel = row * grid + column;
                    let at = self.at(index, texel);
                    // The first triangle at a texel is not displaced yet: its bound suffices.
                    if self.heights[at][1] == NOWHERE {
                        self.heights[at] = [UNKNOWN, seen];
                        self.bounds[at] = side * base + triangle.lift_at(&lift, s, t);
                    } else {
                        self.choose(index, texel, seen);
                    }
                }
            }
        }
    }

    /// Keeps the visible one of the triangle at a texel and another one.
    fn choose(&mut self, image: u32, texel: u32, other: u32) {
        let side = self.batch.images[image as usize].side;
        let known = self.height(image, texel);
        let (height, point) = self.displaced(image, texel, other);
        let at = self.at(image, texel);
        if (f32::from_bits(height[0]) - known) * side > 0.0 {
            (self.heights[at], self.points[at]) = (height, point);
        }
        self.bounds[at] = side * f32::from_bits(self.heights[at][0]);
    }

    /// Displaces the texels of a pair that may count, and lists them in `displaced`.
    fn displace(&mut self, pair: &Pair, candidates: &mut Vec<(u32, f32)>, displaced: &mut Vec<u32>) {
        let grid = self.batch.header.grid;
        let Image { step, .. } = self.batch.images[pair.a as usize];
        // An overlap counts if it is at least δ − 8 τ: the smooth maximum ignores smaller ones.
        let slack = RELATIVE_ROUNDING * grid as f32 * step - MIN_EXPONENT * pair.temperature;
        let overlap =
            |texels: &mut Self, texel: u32| texels.height(pair.a, texel) - texels.height(pair.b, texel);
        let mut largest = f32::NEG_INFINITY;
        candidates.clear();
        for row in 0..grid {
            let v = coordinate(row, grid, step);
            let [from, to] = pair.clips.crossing(v, 0.0);
            let mut best = (0, f32::NEG_INFINITY);
            for column in between(from, to, grid, step) {
                let texel = row * grid + column;
                let bound = self.bounds[self.at(pair.a, texel)] + self.bounds[self.at(pair.b, texel)];
                // Texels without a surface have the bound −∞.
                if bound > f32::NEG_INFINITY
                    && bound >= largest - slack
                    && pair.clips.margin(coordinate(column, grid, step), v) >= 0.0
                {
                    candidates.push((texel, bound));
                    best = if bound > best.1 { (texel, bound) } else { best };
                }
            }
            // Displacing the most promising texel of each row raises `largest` early, which rules out most
            // others.
            if best.1 > largest {
                largest = largest.max(overlap(self, best.0));
            }
        }
        displaced.clear();
        for &(texel, bound) in &*candidates {
            if bound >= largest - slack {
                largest = largest.max(overlap(self, texel));
                displaced.push(texel);
            }
        }
    }

    /// Returns the height at a texel with a surface, m; displaces it if that is still to be done.
    #[inline]
    fn height(&mut self, image: u32, texel: u32) -> f32 {
        let at = self.at(image, texel);
        let [height, seen] = self.heights[at];
        if height == UNKNOWN {
            (self.heights[at], self.points[at]) = self.displaced(image, texel, seen);
        }
        f32::from_bits(self.heights[at][0])
    }

    /// Returns the height and triangle at a texel, in the kernels' format, and the point in the triangle.
    fn displaced(&self, image: u32, texel: u32, seen: u32) -> ([u32; 2], [f32; 2]) {
        let header = &self.batch.header;
        let Image { step, reach, .. } = self.batch.images[image as usize];
        let [u, v] =
            [texel % header.grid, texel / header.grid].map(|index| coordinate(index, header.grid, step));
        let triangle = &self.batch.triangles[seen as usize];
        match triangle.above(u, v, (step, reach), header.refinements, &self.textures) {
            Some(Point { s, t, height, folded }) => {
                ([height.to_bits(), seen | if folded { FOLDED } else { 0 }], [s, t])
            }
            None => ([NO_SURFACE, NOWHERE], [0.0; 2]),
        }
    }

    /// Returns the index of a texel of an image among all images.
    #[inline]
    fn at(&self, image: u32, texel: u32) -> usize {
        image as usize * self.batch.grid_texels() + texel as usize
    }
}
