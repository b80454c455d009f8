//! Figures that tables are made of.

/// 0/0 when there are no values.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// By the nearest rank; 0 when there are no values.
pub fn quantile(values: &[f64], fraction: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let rank = (fraction * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied().unwrap_or(0.0)
}

/// Pearson's correlation of two lists of equal length.
pub fn correlation(x: &[f64], y: &[f64]) -> f64 {
    let (x0, y0) = (mean(x), mean(y));
    let covariance = |x: &[f64], x0: f64, y: &[f64], y0: f64| {
        x.iter().zip(y).map(|(x, y)| (x - x0) * (y - y0)).sum::<f64>()
    };
    covariance(x, x0, y, y0) / (covariance(x, x0, x, x0) * covariance(y, y0, y, y0)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_figures() {
        let values = [4.0, 1.0, 3.0, 2.0];
        assert_eq!((mean(&values), quantile(&values, 0.5), quantile(&values, 0.99)), (2.5, 2.0, 4.0));
        assert_eq!(quantile(&[], 0.5), 0.0);
        assert!((correlation(&values, &values.map(|v| 7.0 - 2.0 * v)) + 1.0).abs() < 1e-15);
        assert!(correlation(&[0.0, 1.0, 0.0, -1.0], &[1.0, 0.0, -1.0, 0.0]).abs() < 1e-15);
    }
}
