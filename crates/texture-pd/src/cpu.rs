//! The backend on the processor.
//!
//! It gives the answers of the kernels' twins without making whole images. A displaced point is no higher than its triangle
//! and the largest displacement around ([`Ceilings`]), so that one look at the flat triangles bounds the overlap of each texel;
//! those that cannot overlap as much as one that is known are not displaced at all. Few are left.

use std::ops::Range;

use crate::backend::{Backend, BackendError};
use crate::batch::{Batch, SurfaceSet};
use crate::ceiling::Ceilings;
use crate::kernels::{
    Answer, Clips, FOLDED, Image, Known, LEAST, NO_SURFACE, NOWHERE, Pair, Point, Textures, between,
    coordinate, covered, pair_answer,
};

/// Rounding of f32, as a part of the grid's size.
const ROUNDING: f32 = 1e-6;

/// Bits of heights that are not known yet: no height is as large.
const UNKNOWN: u32 = NO_SURFACE + 1;

/// The backend on the processor: it cannot fail, and allocates only to grow its workspace.
#[derive(Clone, Debug, Default)]
pub struct CpuBackend {
    /// Where each image is looked at.
    clips: Vec<Clips>,
    /// The columns of each row that are.
    rows: Vec<Range<u32>>,
    /// Of each texel of each image: how far along n (A) or against it (B) its surface is at most, m.
    bounds: Vec<f32>,
    /// As the kernels have them, but where nothing was displaced.
    heights: Vec<[u32; 2]>,
    /// Where in its triangle the point of a texel is that was displaced.
    points: Vec<[f32; 2]>,
    /// Texels of a pair that may matter, with bounds of their overlaps, m.
    candidates: Vec<(u32, f32)>,
    /// Those of them that were displaced.
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

/// What is known of the texels of all images.
struct Texels<'a> {
    batch: &'a Batch,
    textures: Textures<'a>,
    ceilings: &'a Ceilings,
    bounds: &'a mut [f32],
    heights: &'a mut [[u32; 2]],
    points: &'a mut [[f32; 2]],
}

impl Texels<'_> {
    /// Finds which triangle is at each texel of an image, of some columns of each row, and how far the displaced one reaches at
    /// most. Where there are several, they are displaced to tell which is seen.
    fn outline(&mut self, index: u32, looked_at: &[Range<u32>]) {
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
                let looked_at = &looked_at[row as usize];
                let (first, end) = (columns.start.max(looked_at.start), columns.end.min(looked_at.end));
                if first >= end {
                    continue;
                }
                let [from, to] = triangle.crossing(v);
                let crossed = between(from, to, grid, step);
                for column in first.max(crossed.start)..end.min(crossed.end) {
                    let Some((s, t, base)) = triangle.flat(coordinate(column, grid, step), v, reach) else {
                        continue;
                    };
                    let texel = row * grid + column;
                    let at = self.at(index, texel);
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

    /// Keeps what is seen of the triangle at a texel and another one.
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

    /// Displaces the texels of a pair that may matter, and names them.
    fn displace(&mut self, pair: &Pair, candidates: &mut Vec<(u32, f32)>, displaced: &mut Vec<u32>) {
        let grid = self.batch.header.grid;
        let Image { step, .. } = self.batch.images[pair.a as usize];
        let slack = ROUNDING * grid as f32 * step - LEAST * pair.temperature;
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
                // Without a surface it is −∞.
                if bound > f32::NEG_INFINITY
                    && bound >= largest - slack
                    && pair.clips.margin(coordinate(column, grid, step), v) >= 0.0
                {
                    candidates.push((texel, bound));
                    best = if bound > best.1 { (texel, bound) } else { best };
                }
            }
            // The largest overlap so far lets most of the others be passed over.
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

    /// The height at a texel where there is a surface, m.
    #[inline]
    fn height(&mut self, image: u32, texel: u32) -> f32 {
        let at = self.at(image, texel);
        let [height, seen] = self.heights[at];
        if height == UNKNOWN {
            (self.heights[at], self.points[at]) = self.displaced(image, texel, seen);
        }
        f32::from_bits(self.heights[at][0])
    }

    /// Height and triangle at a texel that a triangle covers, as the kernels have them, and where in the triangle that is.
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

    /// Where a texel of an image is.
    #[inline]
    fn at(&self, image: u32, texel: u32) -> usize {
        image as usize * self.batch.grid_texels() + texel as usize
    }
}
