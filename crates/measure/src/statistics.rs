//! Means, quantiles and correlations.

/// Returns the mean; 0 for no values.
pub fn mean(values: impl IntoIterator<Item = f64>) -> f64 {
    let (sum, count) =
        values.into_iter().fold((0.0, 0_usize), |(sum, count), value| (sum + value, count + 1));
    if count == 0 { 0.0 } else { sum / count as f64 }
}

/// Returns a quantile by the nearest rank (0.5 is the median); 0 for no values. NaN counts as the largest
/// value.
pub fn quantile(values: &[f64], fraction: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (fraction * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied().unwrap_or(0.0)
}

/// Pearson correlation of two lists of equal length; not a number where one of them never varies.
pub fn correlation(x: &[f64], y: &[f64]) -> f64 {
    let (x0, y0) = (mean(x.iter().copied()), mean(y.iter().copied()));
    let covariance = |x: &[f64], x0: f64, y: &[f64], y0: f64| {
        x.iter().zip(y).map(|(x, y)| (x - x0) * (y - y0)).sum::<f64>()
    };
    covariance(x, x0, y, y0) / (covariance(x, x0, x, x0) * covariance(y, y0, y, y0)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_by_the_nearest_rank() {
        let values: Vec<f64> = (1..=100).rev().map(f64::from).collect();
        assert_eq!(
            [0.0, 0.5, 0.99, 1.0].map(|fraction| quantile(&values, fraction)),
            [1.0, 50.0, 99.0, 100.0]
        );
        assert_eq!(quantile(&[], 0.5), 0.0);
        assert_eq!((mean([1.0, 2.0, 6.0]), mean([])), (3.0, 0.0));
    }

    #[test]
    fn correlations_of_a_falling_line_and_of_waves_a_quarter_apart() {
        let values = [4.0, 1.0, 3.0, 2.0];
        assert!((correlation(&values, &values.map(|v| 7.0 - 2.0 * v)) + 1.0).abs() < 1e-15);
        assert!(correlation(&[0.0, 1.0, 0.0, -1.0], &[1.0, 0.0, -1.0, 0.0]).abs() < 1e-15);
    }
}
