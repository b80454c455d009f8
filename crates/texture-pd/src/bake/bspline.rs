//! Cubic B-splines through the values of a grid (Unser, *Splines: a perfect fit for signal and image processing*, 1999).

use crate::HeightImage;

/// How a line of coefficients ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ends {
    /// With coefficients of 0 beyond.
    Zero,
    /// As the second differences of the values there tell, to fourth order.
    Smooth,
}

/// The coefficients, in place, of the spline through a grid of values with rows of `width`.
pub(super) fn prefilter(values: &mut [f64], width: usize, ends: Ends) {
    let height = values.len() / width.max(1);
    let mut pivots = Vec::new();
    for row in values.chunks_exact_mut(width.max(1)) {
        prefilter_line(row, 1, width, ends, &mut pivots);
    }
    for column in 0..width {
        prefilter_line(&mut values[column..], width, height, ends, &mut pivots);
    }
}

/// Solves (c₋₁ + 4 c₀ + c₁)/6 = value along one line, by elimination.
fn prefilter_line(line: &mut [f64], stride: usize, count: usize, ends: Ends, pivots: &mut Vec<f64>) {
    let mut inner = 0..count;
    if ends == Ends::Smooth && count >= 6 {
        let corrected = |at: [usize; 4]| {
            let [a, b, c, d] = at.map(|i| line[i * stride]);
            // c = v − v″/6 + O(v⁗).
            a - (2.0 * a - 5.0 * b + 4.0 * c - d) / 6.0
        };
        let (first, last) = (corrected([0, 1, 2, 3]), corrected([1, 2, 3, 4].map(|back| count - back)));
        line[0] = first;
        line[(count - 1) * stride] = last;
        line[stride] -= first / 6.0;
        line[(count - 2) * stride] -= last / 6.0;
        inner = 1..count - 1;
    }
    let mut before = (0.0, 0.0);
    pivots.clear();
    for i in inner.clone() {
        let pivot = 1.0 / (4.0 - before.0);
        before = (pivot, (6.0 * line[i * stride] - before.1) * pivot);
        line[i * stride] = before.1;
        pivots.push(pivot);
    }
    let mut after = 0.0;
    for (i, pivot) in inner.zip(pivots.iter()).rev() {
        line[i * stride] -= pivot * after;
        after = line[i * stride];
    }
}

/// The value at a node from the coefficients around it, those of three rows.
pub(super) fn value_at_node(around: [[f64; 3]; 3]) -> f64 {
    let line = |[a, b, c]: [f64; 3]| (a + 4.0 * b + c) / 6.0;
    line(around.map(line))
}

/// The spline through the texels of an image with two rows and columns of 0 along its border, and its coefficients 0.
pub(super) struct Spline {
    width: usize,
    height: usize,
    coefficients: Vec<f64>,
}

impl Spline {
    pub fn through(image: &HeightImage) -> Self {
        let (width, height) = (image.width() as usize, image.height() as usize);
        let mut coefficients: Vec<f64> = image.displacements().iter().map(|h| f64::from(*h)).collect();
        prefilter(&mut coefficients, width, Ends::Zero);
        Self { width, height, coefficients }
    }

    /// The value at a place in texels, where the first texel's centre is at (0, 0).
    pub fn at(&self, x: f64, y: f64) -> f64 {
        let (column, row) = (x.floor(), y.floor());
        let (across, down) = (weights(x - column), weights(y - row));
        let mut sum = 0.0;
        for (j, weight) in down.into_iter().enumerate() {
            for (i, along) in across.into_iter().enumerate() {
                sum += weight
                    * along
                    * self.coefficient(column as i64 + i as i64 - 1, row as i64 + j as i64 - 1);
            }
        }
        sum
    }

    fn coefficient(&self, column: i64, row: i64) -> f64 {
        let inside = (0..self.width as i64).contains(&column) && (0..self.height as i64).contains(&row);
        if inside { self.coefficients[row as usize * self.width + column as usize] } else { 0.0 }
    }
}

/// The weights of four coefficients at a fraction of the way from the second to the third.
fn weights(t: f64) -> [f64; 4] {
    let (s, t2) = (1.0 - t, t * t);
    [
        s * s * s / 6.0,
        (4.0 - 6.0 * t2 + 3.0 * t2 * t) / 6.0,
        (4.0 - 6.0 * s * s + 3.0 * s * s * s) / 6.0,
        t2 * t / 6.0,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Wrap;

    #[test]
    fn coefficients_give_the_values_back() {
        let (width, height) = (9, 12);
        let value = |i: usize| ((i * i) % 31) as f64 * 0.1 - 1.0;
        let values: Vec<f64> = (0..width * height).map(value).collect();
        for ends in [Ends::Zero, Ends::Smooth] {
            let mut filtered = values.clone();
            prefilter(&mut filtered, width, ends);
            for (row, column) in (1..height - 1).flat_map(|row| (1..width - 1).map(move |c| (row, c))) {
                let around =
                    [0, 1, 2].map(|j| [0, 1, 2].map(|i| filtered[(row + j - 1) * width + column + i - 1]));
                let back = value_at_node(around);
                assert!((back - values[row * width + column]).abs() < 1e-12, "{ends:?} {row} {column}");
            }
        }
    }

    #[test]
    fn spline_goes_through_the_texels() {
        let texels: Vec<f32> = (0..70).map(|i| ((i * 37) % 11) as f32).collect();
        let image = HeightImage::new(10, 7, texels.clone(), [Wrap::Clamp; 2]).unwrap();
        let spline = Spline::through(&image);
        for (i, texel) in texels.into_iter().enumerate() {
            let value = spline.at((i % 10) as f64, (i / 10) as f64);
            assert!((value - f64::from(texel)).abs() < 1e-9, "{i}: {value} {texel}");
        }
    }

    #[test]
    fn smooth_ends_are_exact_for_quadratics() {
        // v = x² has c = x² − 1/3.
        let mut line: Vec<f64> = (0..10).map(|x| f64::from(x * x)).collect();
        prefilter_line(&mut line, 1, 10, Ends::Smooth, &mut Vec::new());
        for (x, c) in line.iter().enumerate() {
            assert!((c - ((x * x) as f64 - 1.0 / 3.0)).abs() < 1e-12, "{line:?}");
        }
    }
}
