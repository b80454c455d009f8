//! The backend on the processor.
//!
//! It gives the answers of the kernels' twins without making whole images. A displaced point is no higher than its triangle
//! and the largest displacement, so that one look at the flat triangles bounds the overlap of each texel; those that cannot
//! overlap as much as one that is known are not displaced at all. Of a round contact few are left.

use crate::backend::{Backend, BackendError};
use crate::batch::{Batch, SurfaceSet};
use crate::kernels::{
    Answer, FOLDED, Image, LEAST, NO_SURFACE, NOWHERE, Pair, Point, Textures, coordinate, covered,
    pair_answer,
};

/// Of the first texels that are looked at, each is so many from the next, either way: their largest overlap lets most of the
/// others be passed over.
const STRIDE: u32 = 5;
/// Rounding of f32, as a part of the grid's size.
const ROUNDING: f32 = 1e-6;

/// Bits of heights that are not known yet, of an A (2⁶⁴ m down) and of a B (a little more than 2⁶⁴ m up): no overlap is so
/// small as with one of these.
const UNKNOWN_A: u32 = NO_SURFACE | 1 << 31;
const UNKNOWN_B: u32 = NO_SURFACE + 1;

/// The backend on the processor: it cannot fail, and allocates only to grow its workspace.
#[derive(Clone, Debug, Default)]
pub struct CpuBackend {
    /// Of each texel of each image: how far along n (A) or against it (B) its surface is at most, m.
    bounds: Vec<f32>,
    /// As the kernels have them, but where nothing was displaced.
    heights: Vec<[u32; 2]>,
    /// Where in its triangle the point of a texel is that was displaced.
    points: Vec<[f32; 2]>,
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
        self.bounds.resize(batch.texels(), 0.0);
        self.heights.resize(batch.texels(), [0; 2]);
        self.points.resize(batch.texels(), [0.0; 2]);
        let texels = batch.grid_texels();
        let known = self.bounds.chunks_exact_mut(texels).zip(self.heights.chunks_exact_mut(texels));
        let known = known.zip(self.points.chunks_exact_mut(texels));
        for (image, ((bounds, heights), points)) in batch.images.iter().zip(known) {
            Texels { batch, textures, image, bounds, heights, points }.outline();
        }
        answers.clear();
        for pair in &batch.pairs {
            self.displace(batch, textures, pair);
            let Batch { header, triangles, images, .. } = batch;
            let points = Some(&self.points[..]);
            answers.push(pair_answer(header, triangles, images, textures, &self.heights, points, pair));
        }
        Ok(())
    }
}

impl CpuBackend {
    /// Displaces the texels of a pair that may matter.
    fn displace(&mut self, batch: &Batch, textures: Textures, pair: &Pair) {
        let Batch { header, images, .. } = batch;
        let texels = batch.grid_texels();
        let [first_a, first_b] = [pair.a, pair.b].map(|image| image as usize * texels);
        let image = &images[pair.a as usize];
        let slack = ROUNDING * header.grid as f32 * image.step - LEAST * pair.temperature;
        let mut largest = f32::NEG_INFINITY;
        let mut look = |column: u32, row: u32| {
            let texel = (row * header.grid + column) as usize;
            let [a, b] = [first_a + texel, first_b + texel];
            let bound = self.bounds[a] + self.bounds[b];
            // Without a surface the bound is −∞.
            if bound == f32::NEG_INFINITY || bound < largest - slack {
                return;
            }
            if pair.clips.margin(texel as u32, header.grid, image.step) < 0.0 {
                return;
            }
            for (at, image) in [(a, pair.a), (b, pair.b)] {
                if matches!(self.heights[at][0], UNKNOWN_A | UNKNOWN_B) {
                    let image = &images[image as usize];
                    (self.heights[at], self.points[at]) =
                        displaced(batch, textures, image, self.heights[at][1], [column, row]);
                }
            }
            largest = largest.max(f32::from_bits(self.heights[a][0]) - f32::from_bits(self.heights[b][0]));
        };
        let few = (STRIDE / 2..header.grid).step_by(STRIDE as usize);
        few.clone().for_each(|row| few.clone().for_each(|column| look(column, row)));
        (0..header.grid).for_each(|row| (0..header.grid).for_each(|column| look(column, row)));
    }
}

/// An image to be made.
struct Texels<'a> {
    batch: &'a Batch,
    textures: Textures<'a>,
    image: &'a Image,
    bounds: &'a mut [f32],
    heights: &'a mut [[u32; 2]],
    points: &'a mut [[f32; 2]],
}

impl Texels<'_> {
    /// Finds which triangle is at each texel, and how far the displaced one reaches at most. Where there are several, they
    /// are displaced to tell which is seen.
    fn outline(&mut self) {
        self.heights.fill([NO_SURFACE, NOWHERE]);
        self.bounds.fill(f32::NEG_INFINITY);
        let grid = self.batch.header.grid;
        let Image { first, count, step, side, reach, .. } = *self.image;
        let unknown = if side > 0.0 { UNKNOWN_A } else { UNKNOWN_B };
        for index in first..first + count {
            let triangle = &self.batch.triangles[index as usize];
            let lift = triangle.lift();
            let [columns, rows] = covered(triangle, grid, step);
            for row in rows {
                let v = coordinate(row, grid, step);
                let [from, to] = triangle.crossing(v).map(|u| u / step + 0.5 * grid as f32 - 0.5);
                // A texel more either side, for rounding and the width of edges.
                let from = columns.start.max((from - 1.0) as u32);
                let to = columns.end.min((to + 3.0) as u32);
                for column in from..to {
                    let Some((_, _, base)) = triangle.flat(coordinate(column, grid, step), v, reach) else {
                        continue;
                    };
                    let texel = (row * grid + column) as usize;
                    if self.heights[texel][1] == NOWHERE {
                        self.heights[texel] = [unknown, index];
                        self.bounds[texel] = side * base + lift;
                    } else {
                        self.choose(texel, index, [column, row], unknown);
                    }
                }
            }
        }
    }

    /// Keeps what is seen of the triangle at a texel and another one.
    fn choose(&mut self, texel: usize, index: u32, at: [u32; 2], unknown: u32) {
        let displaced = |index| displaced(self.batch, self.textures, self.image, index, at);
        let known = self.heights[texel];
        let first = if known[0] == unknown { displaced(known[1]) } else { (known, self.points[texel]) };
        let second = displaced(index);
        let further = f32::from_bits(second.0[0]) - f32::from_bits(first.0[0]);
        (self.heights[texel], self.points[texel]) =
            if further * self.image.side > 0.0 { second } else { first };
        self.bounds[texel] = self.image.side * f32::from_bits(self.heights[texel][0]);
    }
}

/// Height and triangle at a texel that a triangle covers, as the kernels have them, and where in the triangle that is.
fn displaced(
    batch: &Batch,
    textures: Textures,
    image: &Image,
    index: u32,
    [column, row]: [u32; 2],
) -> ([u32; 2], [f32; 2]) {
    let header = &batch.header;
    let [u, v] = [column, row].map(|index| coordinate(index, header.grid, image.step));
    let triangle = &batch.triangles[index as usize];
    match triangle.above(u, v, (image.step, image.reach), header.refinements, &textures) {
        Some(Point { s, t, height, folded }) => {
            ([height.to_bits(), index | if folded { FOLDED } else { 0 }], [s, t])
        }
        None => ([NO_SURFACE, NOWHERE], [0.0; 2]),
    }
}
