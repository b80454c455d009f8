//! Pareto-optimal settings: no other is better in both time and accuracy.

/// Returns which points of a cost and an error are Pareto-optimal: no other is smaller in one without being
/// larger in the other. Points that are not finite are not.
pub fn front(points: &[(f64, f64)]) -> Vec<bool> {
    let betters = |x: &(f64, f64), y: &(f64, f64)| x.0 <= y.0 && x.1 <= y.1 && x != y;
    points
        .iter()
        .map(|point| {
            point.0.is_finite() && point.1.is_finite() && !points.iter().any(|other| betters(other, point))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_front_holds_the_points_that_nothing_betters() {
        let points = [(1.0, 5.0), (2.0, 3.0), (2.0, 4.0), (3.0, 3.0), (4.0, 1.0), (0.5, f64::NAN)];
        assert_eq!(front(&points), [true, true, false, false, true, false]);
        // Equal points are all optimal.
        assert_eq!(front(&[(1.0, 1.0), (1.0, 1.0)]), [true, true]);
    }
}
