//! Acceleration as a function of texture spacing.

use palpate::glam::{DMat3, DVec3};

/// Curve of the largest acceleration for each spacing of the sweep.
#[derive(Clone, Debug)]
pub struct Curve {
    /// Spacings, ascending, m.
    pub spacing: Vec<f64>,
    /// Largest accelerations, m/s².
    pub acceleration: Vec<f64>,
}

impl Curve {
    fn highest(&self) -> usize {
        let values = self.acceleration.iter().enumerate();
        values.max_by(|a, b| a.1.total_cmp(b.1)).map_or(0, |(index, _)| index)
    }

    /// Returns whether the maximum is at neither end.
    pub fn peaks_within(&self) -> bool {
        (1..self.spacing.len().saturating_sub(1)).contains(&self.highest())
    }

    /// Returns spacing (m) and acceleration (m/s²) of the maximum: the vertex of the parabola through the
    /// largest value and its neighbours, in logarithms, in which the spacings are evenly spaced.
    pub fn peak(&self) -> (f64, f64) {
        let highest = self.highest();
        if !self.peaks_within() {
            return (self.spacing[highest], self.acceleration[highest]);
        }
        let [left, middle, right] =
            [-1, 0, 1].map(|step| self.acceleration[highest.wrapping_add_signed(step)].ln());
        // Vertex of the parabola through (−1, l), (0, m), (1, r): x = ½ (l − r)/(l − 2 m + r), y = m − ¼ (l −
        // r) x.
        let at = 0.5 * (left - right) / (left - 2.0 * middle + right);
        let ratio = self.spacing[highest + 1] / self.spacing[highest];
        let top = middle - 0.25 * (left - right) * at;
        (self.spacing[highest] * ratio.powf(at), top.exp())
    }

    /// Returns whether the curve is below another at all spacings from `least` (m) on.
    pub fn below(&self, other: &Self, least: f64) -> bool {
        let pairs = self.acceleration.iter().zip(&other.acceleration);
        self.spacing.iter().zip(pairs).filter(|(at, _)| **at >= least).all(|(_, (own, others))| own < others)
    }

    /// Returns R² of the least squares quadratic function, both axes in logarithms.
    pub fn quadratic(&self) -> f64 {
        let count = self.spacing.len() as f64;
        let middle = self.spacing.iter().map(|at| at.ln()).sum::<f64>() / count;
        let points: Vec<(DVec3, f64)> = self
            .spacing
            .iter()
            .zip(&self.acceleration)
            .map(|(at, value)| {
                let x = at.ln() - middle;
                (DVec3::new(1.0, x, x * x), value.ln())
            })
            .collect();
        // Normal equations (Σ p pᵀ) fit = Σ p y with p = (1, x, x²).
        let normal = points
            .iter()
            .fold(DMat3::ZERO, |sum, (p, _)| sum + DMat3::from_cols(*p * p.x, *p * p.y, *p * p.z));
        let fit = normal.inverse() * points.iter().fold(DVec3::ZERO, |sum, (p, y)| sum + *p * *y);
        let mean = points.iter().map(|(_, y)| y).sum::<f64>() / count;
        let square =
            |of: &dyn Fn(DVec3) -> f64| points.iter().map(|(p, y)| (y - of(*p)).powi(2)).sum::<f64>();
        1.0 - square(&|p| fit.dot(p)) / square(&|_| mean)
    }
}

/// Returns the largest ratio between curves at one spacing of up to `most` (m).
pub fn spread(curves: &[Curve], most: f64) -> f64 {
    let [first, ..] = curves else { return 1.0 };
    let small = first.spacing.iter().take_while(|spacing| **spacing <= most).count();
    (0..small).fold(1.0, |spread: f64, index| {
        let values = curves.iter().map(|curve| curve.acceleration[index]);
        let (low, high) = values.fold((f64::INFINITY, 0.0_f64), |(low, high), v| (low.min(v), high.max(v)));
        spread.max(high / low)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parabola_by_logarithms_is_found() {
        let spacing: Vec<f64> = (0..12).map(|index| 1e-3 * 1.3_f64.powi(index)).collect();
        let parabola = |at: &f64| 3.0 * (-0.4 * (at / 3.2e-3).ln().powi(2)).exp();
        let curve = Curve { acceleration: spacing.iter().map(parabola).collect(), spacing };
        assert!(curve.peaks_within());
        let (at, top) = curve.peak();
        assert!((at / 3.2e-3 - 1.0).abs() < 1e-9 && (top / 3.0 - 1.0).abs() < 1e-9, "{at} {top}");
        assert!((curve.quadratic() - 1.0).abs() < 1e-9);
    }
}
