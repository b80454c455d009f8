//! Plane curves by arc length: profiles that are turned on a lathe, and centre lines that are swept along.

use palpate_core::glam::DVec2;

/// Number of straight pieces that replace a curve.
const SEGMENTS: usize = 400;

/// A plane curve that can be walked by arc length.
pub(crate) struct Path {
    points: Vec<DVec2>,
    /// Arc length up to each point.
    reached: Vec<f64>,
}

impl Path {
    /// The curve that `curve` draws as its parameter goes from 0 to 1.
    pub(crate) fn new(curve: impl Fn(f64) -> DVec2) -> Self {
        let points: Vec<DVec2> = (0..=SEGMENTS).map(|index| curve(index as f64 / SEGMENTS as f64)).collect();
        let mut reached = vec![0.0];
        for pair in points.windows(2) {
            reached.push(reached[reached.len() - 1] + pair[0].distance(pair[1]));
        }
        Self { points, reached }
    }

    /// A straight piece.
    pub(crate) fn line(from: DVec2, to: DVec2) -> Self {
        Self::new(|at| from.lerp(to, at))
    }

    /// An arc from one angle to another (rad, counter-clockwise when increasing).
    pub(crate) fn arc(center: DVec2, radius: f64, from: f64, to: f64) -> Self {
        Self::new(|at| center + radius * DVec2::from_angle(from + (to - from) * at))
    }

    /// A cubic between two points with given derivatives there.
    pub(crate) fn cubic(from: DVec2, leaving: DVec2, to: DVec2, arriving: DVec2) -> Self {
        Self::new(|t| {
            let (t2, t3) = (t * t, t * t * t);
            (2.0 * t3 - 3.0 * t2 + 1.0) * from
                + (t3 - 2.0 * t2 + t) * leaving
                + (3.0 * t2 - 2.0 * t3) * to
                + (t3 - t2) * arriving
        })
    }

    /// Arc length.
    pub(crate) fn length(&self) -> f64 {
        self.reached[SEGMENTS]
    }

    /// The point at a part (0 to 1) of the arc length, and the unit tangent there.
    pub(crate) fn at(&self, part: f64) -> (DVec2, DVec2) {
        let goal = part.clamp(0.0, 1.0) * self.length();
        let index = self.reached.partition_point(|reached| *reached <= goal).clamp(1, SEGMENTS) - 1;
        let (a, b) = (self.points[index], self.points[index + 1]);
        let within = (goal - self.reached[index]) / (self.reached[index + 1] - self.reached[index]);
        (a.lerp(b, within), (b - a).normalize_or_zero())
    }
}

/// `count + 1` stations from `low` to `high`, spaced in inverse proportion to `density`.
pub(crate) fn stations(low: f64, high: f64, count: usize, density: impl Fn(f64) -> f64) -> Vec<f64> {
    let at = |index: f64| low + (high - low) * index / SEGMENTS as f64;
    let mut reached = vec![0.0];
    for index in 0..SEGMENTS {
        reached.push(reached[index] + density(at(index as f64 + 0.5)));
    }
    (0..=count)
        .map(|station| {
            let goal = reached[SEGMENTS] * station as f64 / count as f64;
            let index = reached.partition_point(|reached| *reached <= goal).clamp(1, SEGMENTS) - 1;
            at(index as f64 + (goal - reached[index]) / (reached[index + 1] - reached[index]))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arc_length_of_a_circle() {
        let path = Path::arc(DVec2::new(3.0, 1.0), 2.0, 0.0, std::f64::consts::PI);
        assert!((path.length() - std::f64::consts::TAU).abs() < 1e-4);
        let (top, tangent) = path.at(0.5);
        assert!(top.distance(DVec2::new(3.0, 3.0)) < 1e-3);
        assert!(tangent.distance(DVec2::NEG_X) < 1e-2);
    }

    #[test]
    fn stations_keep_ends_and_follow_the_density() {
        let stations = stations(-1.0, 3.0, 10, |x| if x < 1.0 { 3.0 } else { 1.0 });
        assert!((stations[0] + 1.0).abs() < 1e-12 && (stations[10] - 3.0).abs() < 1e-12);
        let below = stations.iter().filter(|x| **x < 1.0).count();
        assert_eq!(below, 8, "three quarters of the stations lie in the denser half: {stations:?}");
    }
}
