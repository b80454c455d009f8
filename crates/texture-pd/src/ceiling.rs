//! Local upper bounds of the displacement of a texture. [`CpuBackend`](crate::CpuBackend) skips texels of the
//! grid whose bound is too low.

use crate::spline::{Level, coefficient, floor, wrapped};

/// Side of the blocks that have a bound each, texels. Larger blocks give looser bounds.
const BLOCK: u32 = 2;
/// Margin around a block for which its bound holds as well, texels. A displaced point may be this far from
/// the flat one.
pub(crate) const RADIUS: u32 = 1;

/// Largest displacements in blocks of texels, for all levels of textures.
#[derive(Clone, Debug, Default)]
pub(crate) struct Ceilings {
    /// Index of the first block of each level. Blocks are stored row by row.
    first: Vec<u32>,
    /// Largest displacement of each block, m.
    highest: Vec<f32>,
}

/// Largest displacements of one level.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ceiling<'a> {
    blocks: &'a [f32],
    columns: u32,
    /// Width and height, texels, and the wrap mode along them.
    size: [u32; 2],
    wrap: [u32; 2],
}

impl Ceilings {
    /// Adds the levels of a texture. A spline is nowhere higher than the 4 × 4 coefficients around a point.
    pub fn add(&mut self, levels: &[Level], coefficients: &[f32]) {
        for level in levels {
            let &[_, width, height, wrap] = level;
            self.first.push(self.highest.len() as u32);
            // The coefficients that points of the block and its margin use: two texels farther.
            let around = |block: u32| {
                let [first, last] = [block * BLOCK, (block + 1) * BLOCK].map(|texel| texel as i32);
                first - (RADIUS + 2) as i32..last + (RADIUS + 2) as i32
            };
            let blocks = |size: u32| 0..size.div_ceil(BLOCK);
            let columns = blocks(width).end;
            // Maxima are separable: first along each row, then over rows.
            let mut rows = Vec::with_capacity((height * columns) as usize);
            for row in 0..height as i32 {
                let highest = |block| {
                    let values = around(block).map(|column| coefficient(level, coefficients, column, row));
                    values.fold(f32::NEG_INFINITY, f32::max)
                };
                rows.extend(blocks(width).map(highest));
            }
            for block in blocks(height) {
                let highest = |column| {
                    let row = |row| wrapped(row, height, wrap >> 2) * columns + column;
                    let values = around(block).map(|at| rows[row(at) as usize]);
                    values.fold(f32::NEG_INFINITY, f32::max)
                };
                self.highest.extend(blocks(width).map(highest));
            }
        }
    }

    /// Returns the bounds of a level.
    pub fn of(&self, index: usize, &[_, width, height, wrap]: &Level) -> Ceiling<'_> {
        let columns = width.div_ceil(BLOCK);
        let first = self.first[index] as usize;
        let blocks = &self.highest[first..][..(columns * height.div_ceil(BLOCK)) as usize];
        Ceiling { blocks, columns, size: [width, height], wrap: [wrap & 3, wrap >> 2] }
    }
}

impl Ceiling<'_> {
    /// Returns a bound of the displacement within [`RADIUS`] texels of a point along x and y, m.
    #[inline]
    pub fn around(&self, x: f32, y: f32) -> f32 {
        let [column, row] = [x, y].map(floor);
        let inside = (column as u32) < self.size[0] && (row as u32) < self.size[1];
        let [column, row] = if inside {
            [column as u32, row as u32]
        } else {
            [wrapped(column, self.size[0], self.wrap[0]), wrapped(row, self.size[1], self.wrap[1])]
        };
        self.blocks[(row / BLOCK * self.columns + column / BLOCK) as usize]
    }
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt as _, SeedableRng as _};

    use super::*;
    use crate::height_image::{HeightImage, Wrap};
    use crate::spline;

    #[test]
    fn bounds_hold_around_a_point_and_are_tight() {
        let mut rng = StdRng::seed_from_u64(7);
        let (mut levels, mut coefficients) = (Vec::new(), Vec::new());
        let mut ceilings = Ceilings::default();
        for _ in 0..40 {
            let (width, height) = (rng.random_range(1..40_u32), rng.random_range(1..40_u32));
            let heights = (0..width * height).map(|_| rng.random_range(-1.0..1.0)).collect();
            let wrap =
                [0, 1].map(|_| [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror][rng.random_range(0..3_usize)]);
            let image = HeightImage::new(width, height, heights, wrap).unwrap();
            let before = levels.len();
            spline::push_levels(&image, &mut levels, &mut coefficients);
            ceilings.add(&levels[before..], &coefficients);
        }
        let (mut sum, mut count) = (0.0, 0);
        for (index, level) in levels.iter().enumerate() {
            for _ in 0..200 {
                let [x, y] = [level[1], level[2]].map(|size| rng.random_range(-2.0..3.0) * size as f32);
                let ceiling = ceilings.of(index, level).around(x, y);
                let near = RADIUS as f32;
                let [dx, dy] = [0, 1].map(|_| rng.random_range(-near..near));
                let value = spline::value(level, &coefficients, x + dx, y + dy);
                assert!(value <= ceiling + 1e-5, "{value} above {ceiling} at ({x}, {y}) of {level:?}");
                (sum, count) = (sum + ceiling, count + 1);
            }
        }
        // Coefficients of white noise are about √3 times as large, and the 64 around a block nearly reach
        // their maximum.
        assert!(sum / (count as f32) < 2.6, "{} on average", sum / count as f32);
    }
}
