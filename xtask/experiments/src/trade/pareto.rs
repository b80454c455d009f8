//! Settings that no other one betters in both time and accuracy.

/// Which of points of a cost and an error are such that no other has less of one and no more of the other. Points that are not
/// finite are none of them.
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
    fn the_front_is_what_nothing_betters() {
        let points = [(1.0, 5.0), (2.0, 3.0), (2.0, 4.0), (3.0, 3.0), (4.0, 1.0), (0.5, f64::NAN)];
        assert_eq!(front(&points), [true, true, false, false, true, false]);
        // Of equals all are.
        assert_eq!(front(&[(1.0, 1.0), (1.0, 1.0)]), [true, true]);
    }
}
