//! The penalty force of textured contacts (§4.3.2) and its derivatives (§5.4.4).
//!
//! A contact stores the energy U = ½ k (δ_n + d)² while δ_n + d > 0 (Eq. 4.4, begun at the distance d as all contacts are,
//! §5.4.3). Force and torque on the moving surface A are −∇U: with g = ∇δ_n,
//!
//! (F, T) = −k (δ_n + d) g,  ∂(F, T)/∂(x, θ) = −k (g gᵀ + (δ_n + d) ∇²δ_n)  (Eqs. 4.5, 5.51–5.56).
//!
//! The tangential parts are in proportion to the normal force, as perceived roughness is. Of all contacts they add up.
//!
//! Across the crest of a ridge the energy falls to both sides, so that the second part alone would be a negative stiffness.
//! [`TextureForce::held`] leaves such directions out, for an implicit step that has to stay solvable.

use palpate_core::Wrench;

use crate::depth::TextureDepth;
use crate::maximum::Matrix6;

/// Rotations after which a symmetric matrix of six rows is diagonal to rounding, at most: it takes some five sweeps of 15.
const ROTATIONS: usize = 12 * 15;

/// What a textured contact does to A.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextureForce {
    /// U, J.
    pub energy: f64,
    /// On A, about the centre that the contact was given, world axes.
    pub wrench: Wrench,
    /// By how much the wrench opposes a shift and a turn of A: −∂(F, T)/∂(x, θ), N/m, N and N·m; symmetric.
    pub stiffness: Matrix6,
    /// Of that, k (δ_n + d) ∇²δ_n.
    pub bending: Matrix6,
}

impl TextureForce {
    /// Of a contact of stiffness k (N/m) that begins to push at the distance d (m).
    pub fn new(found: &TextureDepth, stiffness: f64, tolerance: f64) -> Self {
        let overlap = (found.depth + tolerance).max(0.0);
        let push = stiffness * overlap;
        let gradient = [found.linear.to_array(), found.angular.to_array()].concat();
        let bending = found.second.map(|row| row.map(|value| push * value));
        let share = if overlap > 0.0 { stiffness } else { 0.0 };
        Self {
            energy: 0.5 * push * overlap,
            wrench: Wrench { force: found.linear * -push, torque: found.angular * -push },
            stiffness: std::array::from_fn(|i| {
                std::array::from_fn(|j| share * gradient[i] * gradient[j] + bending[i][j])
            }),
            bending,
        }
    }

    /// The stiffness without the directions in which bending is negative: symmetric and positive semi-definite. `lever`
    /// (m) makes turns comparable with shifts: usually about the size of A.
    pub fn held(&self, lever: f64) -> Matrix6 {
        let kept = semi_definite(&self.bending, lever);
        let mut held = self.stiffness;
        for (row, (kept, bending)) in held.iter_mut().zip(kept.iter().zip(&self.bending)) {
            for (value, (kept, bending)) in row.iter_mut().zip(kept.iter().zip(bending)) {
                *value += kept - bending;
            }
        }
        held
    }
}

/// The nearest positive semi-definite matrix to a symmetric one, with turns scaled by `lever`: its negative eigenvalues
/// become 0.
fn semi_definite(matrix: &Matrix6, lever: f64) -> Matrix6 {
    let scale = |i: usize| if i < 3 { 1.0 } else { lever };
    let scaled = std::array::from_fn(|i| std::array::from_fn(|j| matrix[i][j] / (scale(i) * scale(j))));
    let (values, vectors) = eigen(scaled);
    std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            let sum: f64 = (0..6).map(|k| values[k].max(0.0) * vectors[i][k] * vectors[j][k]).sum();
            sum * scale(i) * scale(j)
        })
    })
}

/// Eigenvalues, and eigenvectors as columns, of a symmetric matrix, by Jacobi's rotations, the largest entry first.
fn eigen(mut matrix: Matrix6) -> ([f64; 6], Matrix6) {
    let mut vectors: Matrix6 = std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j))));
    for _ in 0..ROTATIONS {
        let (mut p, mut q, mut most) = (0, 1, 0.0);
        for (i, row) in matrix.iter().enumerate() {
            for (j, value) in row.iter().enumerate().skip(i + 1) {
                if value.abs() > most {
                    (p, q, most) = (i, j, value.abs());
                }
            }
        }
        let size = matrix.iter().flatten().fold(0.0_f64, |size, value| size.max(value.abs()));
        if most <= f64::EPSILON * size {
            break;
        }
        let angle = 0.5 * (2.0 * matrix[p][q]).atan2(matrix[q][q] - matrix[p][p]);
        let (sin, cos) = angle.sin_cos();
        let turn = |row: &mut [f64; 6]| {
            (row[p], row[q]) = (cos * row[p] - sin * row[q], sin * row[p] + cos * row[q])
        };
        matrix.iter_mut().for_each(turn);
        vectors.iter_mut().for_each(turn);
        let (first, second) = (matrix[p], matrix[q]);
        for k in 0..6 {
            matrix[p][k] = cos * first[k] - sin * second[k];
            matrix[q][k] = sin * first[k] + cos * second[k];
        }
    }
    (std::array::from_fn(|i| matrix[i][i]), vectors)
}

/// The sum over contacts (§4.3.2), of which those that were not found add nothing.
pub fn sum_of_forces<'a>(
    depths: impl IntoIterator<Item = &'a Option<TextureDepth>>,
    stiffness: f64,
    tolerance: f64,
) -> Wrench {
    depths.into_iter().flatten().fold(Wrench::ZERO, |mut sum, found| {
        sum += TextureForce::new(found, stiffness, tolerance).wrench;
        sum
    })
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

    use super::*;

    fn random_depth(rng: &mut StdRng) -> TextureDepth {
        let mut vector =
            |most: f64| DVec3::from_array(std::array::from_fn(|_| rng.random_range(-most..most)));
        let (linear, angular, point) = (vector(1.0), vector(0.05), vector(0.1));
        let lever = |k: usize| if k < 3 { 1.0 } else { 0.05 };
        let values: Matrix6 =
            std::array::from_fn(|_| std::array::from_fn(|_| rng.random_range(-200.0..200.0)));
        let second = std::array::from_fn(|i| {
            std::array::from_fn(|j| values[i.max(j)][i.min(j)] * lever(i) * lever(j))
        });
        let depth = rng.random_range(-0.001..0.003);
        TextureDepth { depth, linear, angular, second, point, scene_point: point, folded: 0.0 }
    }

    fn quadratic(matrix: &Matrix6, motion: &[f64; 6]) -> f64 {
        (0..6).map(|i| (0..6).map(|j| motion[i] * matrix[i][j] * motion[j]).sum::<f64>()).sum()
    }

    #[test]
    fn held_stiffness_is_semi_definite_and_no_softer_than_the_true_one() {
        let seed = 81;
        let mut rng = StdRng::seed_from_u64(seed);
        let mut changed = 0;
        for case in 0..500 {
            let force = TextureForce::new(&random_depth(&mut rng), 2000.0, 0.0005);
            let held = force.held(0.05);
            for _ in 0..20 {
                let motion: [f64; 6] =
                    std::array::from_fn(|i| rng.random_range(-1.0..1.0) / if i < 3 { 1.0 } else { 0.05 });
                let (held, true_one) = (quadratic(&held, &motion), quadratic(&force.stiffness, &motion));
                let size = 1e-9 * (held.abs() + true_one.abs()) + 1e-9;
                assert!(held >= -size, "seed {seed}, case {case}: {held}");
                assert!(held >= true_one - size, "seed {seed}, case {case}: {held}, {true_one}");
                changed += usize::from(held > true_one + size);
            }
        }
        assert!(changed > 1000, "{changed}");
    }

    #[test]
    fn what_is_semi_definite_stays_as_it_is() {
        let mut rng = StdRng::seed_from_u64(82);
        for case in 0..100 {
            let factor: Matrix6 =
                std::array::from_fn(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
            let square: Matrix6 = std::array::from_fn(|i| {
                std::array::from_fn(|j| (0..6).map(|k| factor[i][k] * factor[j][k]).sum())
            });
            let kept = semi_definite(&square, 0.3);
            let error = kept.iter().flatten().zip(square.iter().flatten()).map(|(a, b)| (a - b).abs());
            assert!(error.fold(0.0, f64::max) < 1e-12, "case {case}");
        }
    }

    #[test]
    fn contact_that_is_apart_does_nothing() {
        let mut rng = StdRng::seed_from_u64(83);
        let apart = TextureDepth { depth: -0.001, ..random_depth(&mut rng) };
        let force = TextureForce::new(&apart, 1000.0, 0.0005);
        assert_eq!((force.energy, force.wrench.force, force.stiffness), (0.0, DVec3::ZERO, [[0.0; 6]; 6]));
        let deep = TextureDepth { depth: 0.001, ..apart };
        let sum = sum_of_forces(&[Some(apart), None, Some(deep), Some(deep)], 1000.0, 0.0005);
        let one = TextureForce::new(&deep, 1000.0, 0.0005).wrench;
        assert!((sum.force - one.force * 2.0).length() < 1e-12 && one.force.length() > 0.1);
    }
}
