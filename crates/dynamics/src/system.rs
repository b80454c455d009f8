//! Linear systems in a small motion (linear, angular) of the body, as springs and dampers on points of it
//! make them.

use glam::{DMat3, DVec3, Vec3Swizzles as _};

use crate::algebra::linear_solve::{solve, solve_definite};
use crate::algebra::rotation::skew;

/// The matrix and right-hand side of a linear system.
#[derive(Clone, Copy)]
pub(crate) struct Linear {
    pub matrix: [[f64; 6]; 6],
    pub right: [f64; 6],
}

impl Linear {
    /// A system with a zero matrix.
    #[inline]
    pub fn with_right(right: [f64; 6]) -> Self {
        Self { matrix: [[0.0; 6]; 6], right }
    }

    /// Adds a block of the matrix.
    #[inline]
    pub fn add(&mut self, row: usize, column: usize, block: &DMat3) {
        for (j, entries) in block.to_cols_array_2d().iter().enumerate() {
            for (i, value) in entries.iter().enumerate() {
                self.matrix[row + i][column + j] += value;
            }
        }
    }

    /// Adds the rank-one matrix direction · rowᵀ.
    #[inline]
    pub fn add_along(&mut self, direction: &[f64; 6], row: &[f64; 6]) {
        for (entries, along) in self.matrix.iter_mut().zip(direction) {
            for (entry, value) in entries.iter_mut().zip(row) {
                *entry += along * value;
            }
        }
    }

    #[inline]
    pub fn add_lateral(&mut self, lateral: &Lateral) {
        self.add_with_lateral(lateral, &DMat3::ZERO, &DMat3::ZERO);
    }

    /// Adds springs or dampers, Σ g (1, −a*; a*, −a* a*), and the blocks of force and torque by angular
    /// motion.
    #[inline]
    pub fn add_with_lateral(&mut self, lateral: &Lateral, force_by_turn: &DMat3, torque_by_turn: &DMat3) {
        let cross = skew(lateral.first);
        self.add(0, 0, &DMat3::from_diagonal(DVec3::splat(lateral.gain)));
        self.add(0, 3, &(*force_by_turn - cross));
        self.add(3, 0, &cross);
        self.add(3, 3, &(*torque_by_turn + lateral.torque_by_turn()));
    }

    #[inline]
    pub fn add_right(&mut self, force: DVec3, torque: DVec3) {
        for (entry, value) in self.right.iter_mut().zip(six(force, torque)) {
            *entry += value;
        }
    }

    /// The solution. If the symmetric part of the matrix is known to be positive definite (`definite`), it is
    /// solved without pivoting first.
    #[inline(always)]
    pub fn solution(&self, definite: bool) -> Option<[f64; 6]> {
        let quick = if definite { solve_definite(self.matrix, self.right) } else { None };
        quick.or_else(|| solve(self.matrix, self.right))
    }
}

/// Springs or dampers that resist motion of points of the body in all directions alike: the sum of their
/// gains, and the gains' first and second moments about the centre of mass.
#[derive(Clone, Copy)]
pub(crate) struct Lateral {
    /// Σ g.
    gain: f64,
    /// Σ g a.
    first: DVec3,
    /// Second moments Σ g a aᵀ: xx, yy and zz; yz, zx and xy.
    second: (DVec3, DVec3),
}

impl Lateral {
    pub const NONE: Self = Self::at_centre(0.0);

    /// A spring or damper at the centre of mass.
    pub const fn at_centre(gain: f64) -> Self {
        Self { gain, first: DVec3::ZERO, second: (DVec3::ZERO, DVec3::ZERO) }
    }

    /// Adds a spring or damper at `arm`.
    #[inline]
    pub fn add(&mut self, gain: f64, arm: DVec3) {
        let first = arm * gain;
        self.gain += gain;
        self.first += first;
        self.second.0 += first * arm;
        self.second.1 += first.yzx() * arm.zxy();
    }

    /// −Σ g a* a* = Σ g (‖a‖² − a aᵀ).
    #[inline]
    fn torque_by_turn(&self) -> DMat3 {
        let (square, mixed) = self.second;
        let about = square.yzx() + square.zxy();
        DMat3::from_cols(
            DVec3::new(about.x, -mixed.z, -mixed.y),
            DVec3::new(-mixed.z, about.y, -mixed.x),
            DVec3::new(-mixed.y, -mixed.x, about.z),
        )
    }
}

/// Σ a* b* for `sum` = Σ b aᵀ, by a* b* = b aᵀ − (a · b) 1.
#[inline]
pub(crate) fn cross_sum(sum: &DMat3) -> DMat3 {
    let trace = sum.x_axis.x + sum.y_axis.y + sum.z_axis.z;
    *sum - DMat3::from_diagonal(DVec3::splat(trace))
}

/// A vector of six components, linear then angular.
#[inline]
pub(crate) fn six(linear: DVec3, angular: DVec3) -> [f64; 6] {
    [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
}

#[cfg(test)]
mod tests {
    use rand::{SeedableRng as _, rngs::StdRng};

    use super::*;
    use crate::algebra::rotation::skew_skew;
    use crate::differences::{random_twist, random_vector};
    use crate::jacobian::outer;

    #[test]
    fn lateral_dampers_resist_the_motion_of_their_points() {
        let seed = 101;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..200 {
            let dampers = [0.5, 2.0, 7.0].map(|gain| (gain, random_vector(&mut rng, 1.0)));
            let motion = random_twist(&mut rng, 1.0, 1.0);
            let (mut lateral, mut force, mut torque) = (Lateral::NONE, DVec3::ZERO, DVec3::ZERO);
            for (gain, arm) in dampers {
                lateral.add(gain, arm);
                let resisting = motion.velocity_at(arm) * gain;
                force += resisting;
                torque += arm.cross(resisting);
            }
            let mut linear = Linear::with_right([0.0; 6]);
            linear.add_lateral(&lateral);
            let along = six(motion.linear, motion.angular);
            for (entries, wanted) in linear.matrix.iter().zip(six(force, torque)) {
                let found: f64 = entries.iter().zip(along).map(|(entry, value)| entry * value).sum();
                assert!((found - wanted).abs() < 1e-12, "seed {seed}, case {case}: {found} is not {wanted}");
            }
        }
    }

    #[test]
    fn a_sum_of_crosses_equals_the_product_of_cross_matrices() {
        let (a, b) = (DVec3::new(1.0, -2.0, 0.5), DVec3::new(0.3, 4.0, -1.0));
        assert_eq!(cross_sum(&outer(b, a)), skew_skew(a, b));
    }
}
