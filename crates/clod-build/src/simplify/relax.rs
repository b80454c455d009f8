//! Filtering: the position of a vertex at which the surface around it is as nearly linear as possible
//! (§3.3.4, step 3).
//!
//! Guskov, Sweldens and Schröder (1999): the second-order divided difference of a function across an edge is
//! the jump of its gradient between the edge's two triangles, unfolded into a plane. The vertex moves to the
//! position with the least sum of squared differences, over all edges whose difference depends on the vertex:
//! those at it and those opposite to it. A linear function has no jump, so that a flat surface stays flat and
//! its vertices stay in it.

use glam::DVec3;

/// Coefficients, for j, k, l and m, of the second-order difference across the edge (j, k) between the
/// triangles (j, k, l) and (k, j, m). `None` if a triangle has no area. They are half those of the paper,
/// which unfolds the quadrilateral and writes signed areas.
pub(crate) fn difference(j: DVec3, k: DVec3, l: DVec3, m: DVec3) -> Option<[f64; 4]> {
    let length = j.distance(k);
    let along = (k - j) / length;
    let [(x1, h1), (x2, h2)] = [l, m].map(|p| {
        let x = along.dot(p - j);
        (x / length, (p - j - x * along).length())
    });
    let shortest = 1e-6 * length;
    (length > 0.0 && h1 > shortest && h2 > shortest).then(|| {
        let (a, b) = (1.0 / h1, 1.0 / h2);
        [-((1.0 - x1) * a + (1.0 - x2) * b), -(x1 * a + x2 * b), a, b]
    })
}

/// Sum of the squared differences that depend on a vertex, as a function of its position.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Relaxation {
    weight: f64,
    pull: DVec3,
}

impl Relaxation {
    /// Adds a difference: the vertex's coefficient, and the sum of the other coefficients times their points.
    pub fn add(&mut self, own: f64, others: DVec3) {
        self.weight += own * own;
        self.pull -= own * others;
    }

    /// The position with the least sum of squares; `None` if no difference was added.
    pub fn position(&self) -> Option<DVec3> {
        let p = self.pull / self.weight;
        (self.weight > 0.0 && p.is_finite()).then_some(p)
    }
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    #[test]
    fn linear_functions_have_no_difference() {
        let seed = 71;
        println!("seed {seed}");
        let mut rng = StdRng::seed_from_u64(seed);
        for _ in 0..200 {
            let mut at =
                |y: std::ops::Range<f64>| DVec3::new(rng.random_range(-1.0..1.0), rng.random_range(y), 0.0);
            let (l, m) = (at(0.1..1.0), at(-1.0..-0.1));
            let (j, k) = (DVec3::X * -0.6, DVec3::X * 0.7);
            let c = difference(j, k, l, m).expect("no triangle is flat");
            let f = |p: DVec3| 3.0 * p.x - 5.0 * p.y + 2.0;
            let jump: f64 = c.iter().zip([j, k, l, m]).map(|(c, p)| c * f(p)).sum();
            assert!(jump.abs() < 1e-12 * c.iter().map(|c| c.abs()).sum::<f64>() * 10.0, "{jump}");
            // A function of |y| has a jump of 2, however the triangles are cut.
            let jump: f64 = c.iter().zip([j, k, l, m]).map(|(c, p)| c * p.y.abs()).sum();
            assert!((jump - 2.0).abs() < 1e-12, "{jump}");
        }
    }

    #[test]
    fn folding_does_not_change_the_coefficients() {
        let (j, k) = (DVec3::ZERO, DVec3::X);
        let flat = difference(j, k, DVec3::new(0.3, 0.5, 0.0), DVec3::new(0.6, -0.8, 0.0));
        let bent = difference(j, k, DVec3::new(0.3, 0.3, 0.4), DVec3::new(0.6, -0.8, 0.0));
        for (a, b) in flat.expect("has area").iter().zip(bent.expect("has area")) {
            assert!((a - b).abs() < 1e-12);
        }
        assert!(difference(j, k, DVec3::X * 0.5, DVec3::Y).is_none());
    }
}
