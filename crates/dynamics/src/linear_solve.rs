//! Dense linear systems of a few unknowns, in fixed arrays.

/// The solution of `matrix` · x = `right` by LU factorisation with partial pivoting, or `None` if the matrix is singular
/// to rounding or holds what is not finite.
pub fn solve<const N: usize>(mut matrix: [[f64; N]; N], mut right: [f64; N]) -> Option<[f64; N]> {
    for column in 0..N {
        let mut pivot = column;
        for row in column + 1..N {
            if matrix[row][column].abs() > matrix[pivot][column].abs() {
                pivot = row;
            }
        }
        matrix.swap(column, pivot);
        right.swap(column, pivot);
        let value = matrix[column][column];
        if value == 0.0 || !value.is_finite() {
            return None;
        }
        let inverse = 1.0 / value;
        let (upper, lower) = matrix.split_at_mut(column + 1);
        let pivot_row = &upper[column];
        for (row, entries) in lower.iter_mut().enumerate() {
            let factor = entries[column] * inverse;
            for k in column + 1..N {
                entries[k] -= factor * pivot_row[k];
            }
            right[column + 1 + row] -= factor * right[column];
        }
    }
    for row in (0..N).rev() {
        let mut sum = right[row];
        for k in row + 1..N {
            sum -= matrix[row][k] * right[k];
        }
        right[row] = sum / matrix[row][row];
    }
    right.iter().all(|x| x.is_finite()).then_some(right)
}

/// Whether a symmetric matrix, of which only the lower triangle is read, is positive definite, by the signs of the
/// pivots of its LDLᵀ factorisation.
pub fn is_positive_definite<const N: usize>(mut matrix: [[f64; N]; N]) -> bool {
    for column in 0..N {
        let pivot = matrix[column][column];
        if pivot.is_nan() || pivot <= 0.0 {
            return false;
        }
        let inverse = 1.0 / pivot;
        let below: [f64; N] = std::array::from_fn(|k| matrix[k][column]);
        for (row, entries) in matrix.iter_mut().enumerate().skip(column + 1) {
            let factor = below[row] * inverse;
            for k in column + 1..=row {
                entries[k] -= factor * below[k];
            }
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

    use super::*;

    fn random_matrix<const N: usize>(rng: &mut StdRng) -> [[f64; N]; N] {
        std::array::from_fn(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0)))
    }

    fn product<const N: usize>(matrix: &[[f64; N]; N], x: &[f64; N]) -> [f64; N] {
        std::array::from_fn(|i| (0..N).map(|j| matrix[i][j] * x[j]).sum())
    }

    #[test]
    fn solution_has_a_small_residual() {
        let seed = 11;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..2000 {
            let matrix = random_matrix::<6>(&mut rng);
            let right = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
            let x = solve(matrix, right).expect("a random matrix is regular");
            let size = x.iter().fold(1.0, |m: f64, v| m.max(v.abs()));
            for (found, wanted) in product(&matrix, &x).iter().zip(right) {
                assert!((found - wanted).abs() < 1e-13 * size, "seed {seed}, case {case}");
            }
        }
    }

    #[test]
    fn a_zero_leading_entry_is_pivoted_away() {
        assert_eq!(solve([[0.0, 2.0], [4.0, 0.0]], [6.0, 8.0]), Some([2.0, 3.0]));
    }

    #[test]
    fn singular_and_non_finite_systems_are_refused() {
        assert_eq!(solve([[1.0, 2.0], [2.0, 4.0]], [1.0, 1.0]), None);
        assert_eq!(solve([[f64::NAN, 0.0], [0.0, 1.0]], [1.0, 1.0]), None);
        assert_eq!(solve([[1.0, 0.0], [0.0, 1.0]], [f64::INFINITY, 1.0]), None);
        assert_eq!(solve([[1e-300, 0.0], [0.0, 1.0]], [1e300, 1.0]), None);
    }

    #[test]
    fn definiteness_agrees_with_how_the_matrix_was_made() {
        let seed = 12;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..500 {
            let factor = random_matrix::<6>(&mut rng);
            let mut gram: [[f64; 6]; 6] = std::array::from_fn(|i| {
                std::array::from_fn(|j| (0..6).map(|k| factor[i][k] * factor[j][k]).sum())
            });
            for (i, row) in gram.iter_mut().enumerate() {
                row[i] += 1e-6;
            }
            assert!(is_positive_definite(gram), "seed {seed}, case {case}");
            // Taking more than xᵀGx / xᵀx off the diagonal makes the form negative along x.
            let x: [f64; 6] = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
            let square: f64 = x.iter().map(|v| v * v).sum();
            let form: f64 = product(&gram, &x).iter().zip(x).map(|(a, b)| a * b).sum();
            for (i, row) in gram.iter_mut().enumerate() {
                row[i] -= form / square * (1.0 + 1e-9);
            }
            assert!(!is_positive_definite(gram), "seed {seed}, case {case}");
        }
    }
}
