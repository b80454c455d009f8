//! Cubic B-splines through the values of a grid (Unser, *Splines: a perfect fit for signal and image
//! processing*, 1999).

/// Replaces a grid of values with rows of `width` by the coefficients of the spline through them. End
/// conditions come from second differences of the values at the border, accurate to fourth order.
pub(super) fn prefilter(values: &mut [f64], width: usize) {
    let height = values.len() / width.max(1);
    let mut pivots = Vec::new();
    for row in values.chunks_exact_mut(width.max(1)) {
        prefilter_line(row, 1, width, &mut pivots);
    }
    for column in 0..width {
        prefilter_line(&mut values[column..], width, height, &mut pivots);
    }
}

/// Solves (c₋₁ + 4 c₀ + c₁) / 6 = v along a line by the Thomas algorithm.
fn prefilter_line(line: &mut [f64], stride: usize, count: usize, pivots: &mut Vec<f64>) {
    let mut inner = 0..count;
    if count >= 6 {
        let corrected = |at: [usize; 4]| {
            let [a, b, c, d] = at.map(|i| line[i * stride]);
            // At the ends c = v − v″/6 + O(v⁗), with a one-sided second difference v″ = 2 v₀ − 5 v₁ + 4 v₂ −
            // v₃.
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

/// Returns the value at a node from the 3 × 3 coefficients around it.
pub(super) fn value_at_node(around: [[f64; 3]; 3]) -> f64 {
    let line = |[a, b, c]: [f64; 3]| (a + 4.0 * b + c) / 6.0;
    line(around.map(line))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coefficients_give_the_values_back() {
        let (width, height) = (9, 12);
        let value = |i: usize| ((i * i) % 31) as f64 * 0.1 - 1.0;
        let values: Vec<f64> = (0..width * height).map(value).collect();
        let mut filtered = values.clone();
        prefilter(&mut filtered, width);
        for (row, column) in (1..height - 1).flat_map(|row| (1..width - 1).map(move |c| (row, c))) {
            let around =
                [0, 1, 2].map(|j| [0, 1, 2].map(|i| filtered[(row + j - 1) * width + column + i - 1]));
            let back = value_at_node(around);
            assert!((back - values[row * width + column]).abs() < 1e-12, "{row} {column}");
        }
    }

    #[test]
    fn smooth_ends_are_exact_for_quadratics() {
        // v = x² has c = x² − 1/3.
        let mut line: Vec<f64> = (0..10).map(|x| f64::from(x * x)).collect();
        prefilter_line(&mut line, 1, 10, &mut Vec::new());
        for (x, c) in line.iter().enumerate() {
            assert!((c - ((x * x) as f64 - 1.0 / 3.0)).abs() < 1e-12, "{line:?}");
        }
    }
}
