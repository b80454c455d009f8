//! Displacement as a smooth function: a cubic B-spline that interpolates the texels of an image.
//!
//! The coefficients are stored, not images of slopes and curvatures as §5.6.2 suggests. From the 4 × 4
//! coefficients around a point, the displacement, its slopes and its curvatures follow exactly and
//! consistently, in a sixth of the memory. Texels of coarser levels are means of the finer level's, with
//! their own coefficients.

use glam::{Mat4, Vec4};

use crate::height_image::{HeightImage, Wrap};

/// A level of a texture: index of the first coefficient, width, height, and wrap modes (bits 0 and 1 along u,
/// 2 and 3 along v). The kernels bind this layout.
pub(crate) type Level = [u32; 4];

/// Displacement, m, and its derivatives by x and y in texels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Jet {
    pub value: f32,
    pub x: f32,
    pub y: f32,
    pub xx: f32,
    pub xy: f32,
    pub yy: f32,
}

/// Spline of the finest level of an image.
#[derive(Clone, Debug)]
pub(crate) struct Spline {
    level: Level,
    coefficients: Vec<f32>,
}

impl Spline {
    /// Creates the spline that interpolates an image.
    pub fn through(image: &HeightImage) -> Self {
        let (mut levels, mut coefficients) = (Vec::new(), Vec::new());
        push_levels(image, &mut levels, &mut coefficients);
        Self { level: levels[0], coefficients }
    }

    /// Returns the displacement at a point in texels, m; the first texel's centre is at (0, 0).
    pub fn at(&self, x: f64, y: f64) -> f64 {
        value(&self.level, &self.coefficients, (x + 0.5) as f32, (y + 0.5) as f32).into()
    }
}

/// Appends an image's levels, the finest first, each half as wide and high as the one before, down to 4
/// texels. An atlas has the finest level only.
pub(crate) fn push_levels(image: &HeightImage, levels: &mut Vec<Level>, coefficients: &mut Vec<f32>) {
    let mut heights: Vec<f64> = image.displacements().iter().map(|&height| f64::from(height)).collect();
    let [mut width, mut height] = [image.width(), image.height()].map(|n| n as usize);
    let wrap = image.wrap().map(|wrap| wrap as u32);
    loop {
        levels.push([coefficients.len() as u32, width as u32, height as u32, wrap[0] | wrap[1] << 2]);
        coefficients.extend(spline_coefficients(&heights, width, image.wrap()).iter().map(|&c| c as f32));
        if width.min(height) < 8 || image.is_atlas() {
            return;
        }
        // Halve the rows, then the columns as rows of the transposed image.
        heights = averaged(&heights, width, width.div_ceil(2));
        heights = transposed(&heights, height);
        width = width.div_ceil(2);
        heights = averaged(&heights, height, height.div_ceil(2));
        height = height.div_ceil(2);
        heights = transposed(&heights, width);
    }
}

/// Shrinks rows from `width` to `narrow` texels: each new texel is the mean over the part that it covers.
fn averaged(heights: &[f64], width: usize, narrow: usize) -> Vec<f64> {
    let ratio = width as f64 / narrow as f64;
    let mut means = Vec::with_capacity(heights.len() / width * narrow);
    for row in heights.chunks_exact(width) {
        for i in 0..narrow {
            let (from, to) = (i as f64 * ratio, (i + 1) as f64 * ratio);
            let covered = (from as usize)..(to.ceil() as usize).min(width);
            let sum = covered.map(|j| row[j] * ((j + 1) as f64).min(to) - row[j] * (j as f64).max(from));
            means.push(sum.sum::<f64>() / ratio);
        }
    }
    means
}

/// Transposes an image with this number of rows.
fn transposed(heights: &[f64], rows: usize) -> Vec<f64> {
    let width = heights.len() / rows;
    (0..heights.len()).map(|i| heights[i % rows * width + i / rows]).collect()
}

/// Returns the coefficients of the spline through the values of an image.
fn spline_coefficients(heights: &[f64], width: usize, wrap: [Wrap; 2]) -> Vec<f64> {
    let mut rows = heights.to_vec();
    let mut scratch = vec![0.0; width.max(heights.len() / width)];
    rows.chunks_exact_mut(width).for_each(|row| interpolate(row, wrap[0], &mut scratch));
    let mut columns = transposed(&rows, heights.len() / width);
    columns
        .chunks_exact_mut(heights.len() / width)
        .for_each(|column| interpolate(column, wrap[1], &mut scratch));
    transposed(&columns, width)
}

/// Solves (c₋ + 4 c + c₊) / 6 = h along a row, in place. `wrap` continues the row beyond its ends; mirroring
/// repeats the last coefficient, as clamping does.
fn interpolate(row: &mut [f64], wrap: Wrap, scratch: &mut [f64]) {
    let n = row.len();
    if n == 1 {
        return;
    }
    if wrap != Wrap::Repeat {
        solve(row, [5.0; 2], scratch);
        return;
    }
    if n == 2 {
        // Both neighbours c₋ and c₊ are the other coefficient.
        let [a, b] = [row[0], row[1]];
        (row[0], row[1]) = (2.0 * a - b, 2.0 * b - a);
        return;
    }
    // Sherman–Morrison formula: the cyclic matrix has 1 in its corners, so it is a tridiagonal one plus an
    // outer product.
    let mut corner = vec![0.0; n];
    (corner[0], corner[n - 1]) = (1.0, 1.0);
    corner.iter_mut().for_each(|value| *value /= 6.0);
    solve(&mut corner, [3.0; 2], scratch);
    solve(row, [3.0; 2], scratch);
    let factor = (row[0] + row[n - 1]) / (1.0 + corner[0] + corner[n - 1]);
    row.iter_mut().zip(&corner).for_each(|(value, corner)| *value -= factor * corner);
}

/// Thomas algorithm for the tridiagonal matrix with rows (1, 4, 1) / 6 and the given first and last
/// diagonals.
fn solve(row: &mut [f64], ends: [f64; 2], scratch: &mut [f64]) {
    let n = row.len();
    let diagonal = |i: usize| {
        if i == 0 {
            ends[0]
        } else if i == n - 1 {
            ends[1]
        } else {
            4.0
        }
    };
    let mut last = 0.0;
    for i in 0..n {
        let pivot = diagonal(i) - last;
        row[i] = (6.0 * row[i] - if i > 0 { row[i - 1] } else { 0.0 }) / pivot;
        last = 1.0 / pivot;
        scratch[i] = last;
    }
    for i in (0..n - 1).rev() {
        row[i] -= scratch[i] * row[i + 1];
    }
}

/// Returns the index of the coefficient that stands for index `i` of `n`. `wrap`: 0 repeats, 1 clamps, 2
/// mirrors.
#[inline]
pub(crate) fn wrapped(i: i32, n: u32, wrap: u32) -> u32 {
    let size = n as i32;
    let at = match wrap {
        0 => i.rem_euclid(size),
        1 => i.clamp(0, size - 1),
        _ => {
            let j = i.rem_euclid(2 * size);
            if j < size { j } else { 2 * size - 1 - j }
        }
    };
    at as u32
}

/// Returns a level's coefficient at any column and row, inside or outside of the image.
pub(crate) fn coefficient(level: &Level, coefficients: &[f32], column: i32, row: i32) -> f32 {
    let &[first, width, height, wrap] = level;
    coefficients
        [(first + wrapped(row, height, wrap >> 2) * width + wrapped(column, width, wrap & 3)) as usize]
}

/// Returns the cubic B-spline weights of the four coefficients around a point at f from the second one.
#[inline]
fn weights(f: f32) -> Vec4 {
    let [a, b, c, d] = [
        Vec4::new(1.0, 4.0, 1.0, 0.0),
        Vec4::new(-3.0, 0.0, 3.0, 0.0),
        Vec4::new(3.0, -6.0, 3.0, 0.0),
        Vec4::new(-1.0, 3.0, -3.0, 1.0),
    ];
    (a + (b + (c + d * f) * f) * f) * (1.0 / 6.0)
}

/// Returns the first derivatives of [`weights`].
#[inline]
fn slopes(f: f32) -> Vec4 {
    let [a, b, c] =
        [Vec4::new(-0.5, 0.0, 0.5, 0.0), Vec4::new(1.0, -2.0, 1.0, 0.0), Vec4::new(-0.5, 1.5, -1.5, 0.5)];
    a + (b + c * f) * f
}

/// Returns the second derivatives of [`weights`].
#[inline]
fn curvatures(f: f32) -> Vec4 {
    Vec4::new(1.0, -2.0, 1.0, 0.0) + Vec4::new(-1.0, 3.0, -3.0, 1.0) * f
}

/// Returns the 4 × 4 coefficients around a point in texels (the centre of the first texel is at 0.5), and the
/// point's offset from the second column and row.
#[inline(always)]
fn taps(level: &Level, coefficients: &[f32], x: f32, y: f32) -> (Mat4, f32, f32) {
    let &[first, width, height, _] = level;
    let (x, y) = (x - 0.5, y - 0.5);
    let (left, top) = (floor(x), floor(y));
    let (column, row) = (left - 1, top - 1);
    let inside = column >= 0 && row >= 0 && column + 4 <= width as i32 && row + 4 <= height as i32;
    let rows = if inside {
        let from = first as usize + row as usize * width as usize + column as usize;
        [0, 1, 2, 3].map(|j| Vec4::from_slice(&coefficients[from + j * width as usize..]))
    } else {
        border(level, coefficients, column, row)
    };
    (Mat4::from_cols(rows[0], rows[1], rows[2], rows[3]), x - left as f32, y - top as f32)
}

/// Returns 4 × 4 coefficients of which some are beyond the border.
#[cold]
fn border(&[first, width, height, wrap]: &Level, coefficients: &[f32], column: i32, row: i32) -> [Vec4; 4] {
    let columns = [0, 1, 2, 3].map(|i| wrapped(column + i, width, wrap & 3));
    [0, 1, 2, 3].map(|j| {
        let from = first + wrapped(row + j, height, wrap >> 2) * width;
        Vec4::from_array(columns.map(|column| coefficients[(from + column) as usize]))
    })
}

/// Rounds down. Without SSE 4.1 as a build target `f32::floor` is a function call.
#[inline]
pub(crate) fn floor(x: f32) -> i32 {
    let towards_zero = x as i32;
    towards_zero - i32::from(x < towards_zero as f32)
}

/// Returns the displacement at a point in texels, m: h = w(f)ᵀ C w(g), with the coefficients C.
#[inline]
pub(crate) fn value(level: &Level, coefficients: &[f32], x: f32, y: f32) -> f32 {
    let (taps, f, g) = taps(level, coefficients, x, y);
    weights(f).dot(taps * weights(g))
}

/// Returns the displacement at a point in texels, and its slopes by x and y.
#[inline]
pub(crate) fn slope(level: &Level, coefficients: &[f32], x: f32, y: f32) -> [f32; 3] {
    let (taps, f, g) = taps(level, coefficients, x, y);
    let (along, across) = (weights(f), taps * weights(g));
    [along.dot(across), slopes(f).dot(across), along.dot(taps * slopes(g))]
}

/// Returns the displacement at a point in texels with its derivatives.
pub(crate) fn jet(level: &Level, coefficients: &[f32], x: f32, y: f32) -> Jet {
    let (taps, f, g) = taps(level, coefficients, x, y);
    let [along, along_x, along_xx] = [weights(f), slopes(f), curvatures(f)];
    let [across, across_y, across_yy] = [weights(g), slopes(g), curvatures(g)].map(|across| taps * across);
    Jet {
        value: along.dot(across),
        x: along_x.dot(across),
        y: along.dot(across_y),
        xx: along_xx.dot(across),
        xy: along_x.dot(across_y),
        yy: along.dot(across_yy),
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

    use super::*;

    const WRAPS: [Wrap; 3] = [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror];

    fn levels(image: &HeightImage) -> (Vec<Level>, Vec<f32>) {
        let (mut levels, mut coefficients) = (Vec::new(), Vec::new());
        push_levels(image, &mut levels, &mut coefficients);
        (levels, coefficients)
    }

    #[test]
    fn spline_goes_through_every_texel_of_every_size_and_wrap() {
        let seed = 61;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..300 {
            let (width, height) = (rng.random_range(1..20_u32), rng.random_range(1..20_u32));
            let wrap = [0, 1].map(|_| WRAPS[rng.random_range(0..3)]);
            let heights: Vec<f32> = (0..width * height).map(|_| rng.random_range(-1e-3..1e-3)).collect();
            let image = HeightImage::new(width, height, heights.clone(), wrap).unwrap();
            let (levels, coefficients) = levels(&image);
            for row in 0..height {
                for column in 0..width {
                    let (x, y) = (column as f32 + 0.5, row as f32 + 0.5);
                    let error =
                        value(&levels[0], &coefficients, x, y) - heights[(row * width + column) as usize];
                    assert!(error.abs() < 3e-9, "seed {seed}, case {case}: {error} at {column}, {row}");
                }
            }
        }
    }

    #[test]
    fn jet_is_the_derivative_of_the_value_beyond_the_border_too() {
        let seed = 62;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..200 {
            let (width, height) = (rng.random_range(4..12_u32), rng.random_range(4..12_u32));
            let wrap = [0, 1].map(|_| WRAPS[rng.random_range(0..3)]);
            let heights: Vec<f32> = (0..width * height).map(|_| rng.random_range(-1.0..1.0)).collect();
            let image = HeightImage::new(width, height, heights, wrap).unwrap();
            let (levels, coefficients) = levels(&image);
            let at = |x: f32, y: f32| jet(&levels[0], &coefficients, x, y);
            let (x, y) = (rng.random_range(-15.0..25.0_f32), rng.random_range(-15.0..25.0_f32));
            let here = at(x, y);
            assert!((here.value - value(&levels[0], &coefficients, x, y)).abs() < 1e-6);
            let step = 2_f32.powi(-6);
            let ([left, right], [up, down]) =
                ([at(x - step, y), at(x + step, y)], [at(x, y - step), at(x, y + step)]);
            let pairs = [
                (here.x, right.value - left.value),
                (here.y, down.value - up.value),
                (here.xx, right.x - left.x),
                (here.xy, down.x - up.x),
                (here.yy, down.y - up.y),
            ];
            for (index, (slope, difference)) in pairs.into_iter().enumerate() {
                // Third derivatives jump by up to some ten at the knots.
                let error = slope - difference / (2.0 * step);
                assert!(error.abs() < 0.3, "seed {seed}, case {case}, {index}: {slope}, off by {error}");
            }
        }
    }

    #[test]
    fn coarser_levels_keep_the_mean_and_a_wave_that_they_can_hold() {
        let wave = |column: u32| (std::f32::consts::TAU * (column as f32 + 0.5) / 64.0).sin();
        let heights: Vec<f32> = (0..64 * 24).map(|i| 0.25 + wave(i % 64)).collect();
        let image = HeightImage::new(64, 24, heights, [Wrap::Repeat, Wrap::Clamp]).unwrap();
        let (levels, coefficients) = levels(&image);
        let sizes: Vec<_> = levels.iter().map(|level| [level[1], level[2]]).collect();
        assert_eq!(sizes, [[64, 24], [32, 12], [16, 6]]);
        for level in &levels {
            for i in 0..200 {
                let u = i as f32 / 200.0;
                let expected = 0.25 + (std::f32::consts::TAU * u).sin();
                let found = value(level, &coefficients, u * level[1] as f32, 0.3 * level[2] as f32);
                assert!((found - expected).abs() < 0.01, "{} texels, u = {u}: {found}, {expected}", level[1]);
            }
        }
    }
}
