//! Dense linear systems of a few unknowns, in fixed arrays.

// Whole rows are updated, also left of the pivot where nothing is read again: loops of constant length have
// packed instructions and no bounds checks, and are faster than shorter ones.

/// Solves `matrix` · x = `right` by LU factorisation with partial pivoting; `None` if the matrix
/// is singular to rounding or not finite.
pub(crate) fn solve<const N: usize>(mut matrix: [[f64; N]; N], mut right: [f64; N]) -> Option<[f64; N]> {
    let mut inverse_pivots = [0.0; N];
    for column in 0..N {
        let mut pivot = column;
        for row in column + 1..N {
            if matrix[row][column].abs() > matrix[pivot][column].abs() {
                pivot = row;
            }
        }
        if pivot != column {
            matrix.swap(column, pivot);
            right.swap(column, pivot);
        }
        let pivot_row = matrix[column];
        let pivot_right = right[column];
        let value = pivot_row[column];
        if value == 0.0 || !value.is_finite() {
            return None;
        }
        let inverse = 1.0 / value;
        inverse_pivots[column] = inverse;
        for row in column + 1..N {
            let factor = matrix[row][column] * inverse;
            for (entry, above) in matrix[row].iter_mut().zip(&pivot_row) {
                *entry -= factor * above;
            }
            right[row] -= factor * pivot_right;
        }
    }
    substitute_back(&matrix, &inverse_pivots, right)
}

/// Solves `matrix` · x = `right` by LU factorisation without pivoting, for a matrix whose symmetric
/// part is positive definite; `None` also if a pivot is not positive.
#[inline(always)]
pub(crate) fn solve_definite<const N: usize>(
    mut matrix: [[f64; N]; N],
    mut right: [f64; N],
) -> Option<[f64; N]> {
    let mut inverse_pivots = [0.0; N];
    for column in 0..N {
        let pivot_row = matrix[column];
        let pivot_right = right[column];
        // An infinite pivot has the inverse 0, which is refused as well.
        let inverse = 1.0 / pivot_row[column];
        if inverse.is_nan() || inverse <= 0.0 {
            return None;
        }
        inverse_pivots[column] = inverse;
        for row in column + 1..N {
            let factor = matrix[row][column] * inverse;
            right[row] -= factor * pivot_right;
            for (entry, above) in matrix[row].iter_mut().zip(&pivot_row) {
                *entry -= factor * above;
            }
        }
    }
    substitute_back(&matrix, &inverse_pivots, right)
}

/// Solves `upper` · x = `right` without reading entries below the diagonal; `None` if the solution is not
/// finite.
#[inline(always)]
fn substitute_back<const N: usize>(
    upper: &[[f64; N]; N],
    inverse_pivots: &[f64; N],
    mut right: [f64; N],
) -> Option<[f64; N]> {
    for row in (0..N).rev() {
        let value = right[row] * inverse_pivots[row];
        if !value.is_finite() {
            return None;
        }
        right[row] = value;
        for above in 0..row {
            right[above] -= upper[above][row] * value;
        }
    }
    Some(right)
}

/// The inverse of a matrix by Gauss–Jordan elimination with partial pivoting; `None` if it is singular to
/// rounding or not finite.
pub(crate) fn inverse<const N: usize>(mut matrix: [[f64; N]; N]) -> Option<[[f64; N]; N]> {
    let mut result: [[f64; N]; N] =
        std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j))));
    for column in 0..N {
        let mut pivot = column;
        for row in column + 1..N {
            if matrix[row][column].abs() > matrix[pivot][column].abs() {
                pivot = row;
            }
        }
        matrix.swap(column, pivot);
        result.swap(column, pivot);
        let value = matrix[column][column];
        if value == 0.0 || !value.is_finite() {
            return None;
        }
        let scale = 1.0 / value;
        let pivot_row = matrix[column].map(|entry| entry * scale);
        let pivot_result = result[column].map(|entry| entry * scale);
        for row in 0..N {
            let factor = if row == column { 0.0 } else { matrix[row][column] };
            for j in 0..N {
                matrix[row][j] -= factor * pivot_row[j];
                result[row][j] -= factor * pivot_result[j];
            }
        }
        (matrix[column], result[column]) = (pivot_row, pivot_result);
    }
    result.iter().flatten().all(|entry| entry.is_finite()).then_some(result)
}

/// The inverse of a matrix whose symmetric part is positive definite, by Gauss–Jordan elimination without
/// pivoting; `None` also if a pivot is not positive and finite, or an entry of the result is not finite.
pub(crate) fn inverse_definite<const N: usize>(mut matrix: [[f64; N]; N]) -> Option<[[f64; N]; N]> {
    // In place: the columns of the inverse take those of the matrix.
    for column in 0..N {
        let pivot = matrix[column][column];
        if pivot <= 0.0 || !pivot.is_finite() {
            return None;
        }
        let scale = 1.0 / pivot;
        // An entry that is written on its own is not soon read again as a part of a row: the processor waits.
        let with = |row: &[f64; N], at_pivot: f64| {
            let row = *row;
            std::array::from_fn(move |j| if j == column { at_pivot } else { row[j] })
        };
        let pivot_row: [f64; N] = with(&matrix[column], 1.0).map(|entry: f64| entry * scale);
        for (row, entries) in matrix.iter_mut().enumerate() {
            if row == column {
                *entries = pivot_row;
                continue;
            }
            let factor = entries[column];
            let own: [f64; N] = with(entries, 0.0);
            *entries = std::array::from_fn(|j| own[j] - factor * pivot_row[j]);
        }
    }
    matrix.iter().flatten().all(|entry| entry.is_finite()).then_some(matrix)
}

/// Whether a symmetric matrix is positive definite, by the signs of the pivots of its LDLᵀ factorisation.
#[inline(always)]
pub(crate) fn is_positive_definite<const N: usize>(mut matrix: [[f64; N]; N]) -> bool {
    for column in 0..N {
        let pivot_row = matrix[column];
        let pivot = pivot_row[column];
        if pivot.is_nan() || pivot <= 0.0 {
            return false;
        }
        let inverse = 1.0 / pivot;
        for row in column + 1..N {
            let factor = pivot_row[row] * inverse;
            for (entry, above) in matrix[row].iter_mut().zip(&pivot_row) {
                *entry -= factor * above;
            }
        }
    }
    true
}

#[cfg(feature = "integrators")]
/// Whether all leading principal minors of a matrix are positive, by the signs of the pivots of its LU
/// factorisation: of a symmetric matrix, whether it is positive definite.
pub(crate) fn has_positive_minors<const N: usize>(mut matrix: [[f64; N]; N]) -> bool {
    for column in 0..N {
        let pivot_row = matrix[column];
        let pivot = pivot_row[column];
        if pivot.is_nan() || pivot <= 0.0 {
            return false;
        }
        for entries in &mut matrix[column + 1..] {
            let factor = entries[column] / pivot;
            for (entry, above) in entries.iter_mut().zip(&pivot_row) {
                *entry -= factor * above;
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

    /// The sum of a Gram matrix, which is definite, and a skew one.
    fn random_definite(rng: &mut StdRng) -> [[f64; 6]; 6] {
        let (factor, skew) = (random_matrix::<6>(rng), random_matrix::<6>(rng));
        std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                let gram: f64 = (0..6).map(|k| factor[i][k] * factor[j][k]).sum();
                gram + f64::from(i == j) + skew[i][j] - skew[j][i]
            })
        })
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
    fn solution_without_pivoting_has_a_small_residual_where_the_matrix_is_definite() {
        let seed = 13;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..2000 {
            let matrix = random_definite(&mut rng);
            let right = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
            let x = solve_definite(matrix, right).expect("definite");
            for (found, wanted) in product(&matrix, &x).iter().zip(right) {
                assert!((found - wanted).abs() < 1e-13, "seed {seed}, case {case}");
            }
        }
        assert_eq!(solve_definite([[-1.0, 0.0], [0.0, 1.0]], [1.0, 1.0]), None);
        assert_eq!(solve_definite([[1.0, f64::NAN], [0.0, 1.0]], [1.0, 1.0]), None);
        assert_eq!(solve_definite([[f64::INFINITY, 0.0], [0.0, 1.0]], [1.0, 1.0]), None);
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
    fn inverse_has_a_small_residual() {
        let seed = 14;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..2000 {
            let matrix = random_matrix::<6>(&mut rng);
            let found = inverse(matrix).expect("a random matrix is regular");
            let size = found.iter().flatten().fold(1.0, |m: f64, v| m.max(v.abs()));
            let columns: [[f64; 6]; 6] = std::array::from_fn(|j| found.map(|row| row[j]));
            for (j, column) in columns.iter().enumerate() {
                for (i, entry) in product(&matrix, column).into_iter().enumerate() {
                    let off = (entry - f64::from(u8::from(i == j))).abs();
                    assert!(off < 1e-13 * size, "seed {seed}, case {case}: {off}, entries up to {size}");
                }
            }
        }
        assert_eq!(inverse([[0.0, 2.0], [4.0, 0.0]]), Some([[0.0, 0.25], [0.5, 0.0]]));
    }

    #[test]
    fn inverse_without_pivoting_is_that_with_it_where_the_matrix_is_definite() {
        let seed = 15;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..2000 {
            let matrix = random_definite(&mut rng);
            let (found, wanted) =
                (inverse_definite(matrix).expect("definite"), inverse(matrix).expect("regular"));
            for (found, wanted) in found.iter().flatten().zip(wanted.iter().flatten()) {
                assert!((found - wanted).abs() < 1e-13, "seed {seed}, case {case}: {found}, not {wanted}");
            }
        }
        assert_eq!(inverse_definite([[-1.0, 0.0], [0.0, 1.0]]), None);
        assert_eq!(inverse_definite([[1.0, 2.0], [2.0, 1.0]]), None);
        assert_eq!(inverse_definite([[1.0, f64::NAN], [0.0, 1.0]]), None);
        assert_eq!(inverse_definite([[f64::INFINITY, 0.0], [0.0, 1.0]]), None);
    }

    #[test]
    fn matrices_without_an_inverse_are_refused() {
        assert_eq!(inverse([[1.0, 2.0], [2.0, 4.0]]), None);
        assert_eq!(inverse([[0.0; 3]; 3]), None);
        for bad in [f64::NAN, f64::INFINITY] {
            for place in 0..4 {
                let mut matrix = [[2.0, 1.0], [1.0, 2.0]];
                matrix[place / 2][place % 2] = bad;
                assert_eq!(inverse(matrix), None, "{bad} at {place}");
            }
        }
        assert_eq!(inverse([[1e-310, 0.0], [0.0, 1.0]]), None, "the inverse is not finite");
        assert!(inverse([[2.0, 1.0], [1.0, 2.0]]).is_some());
    }

    #[test]
    fn minors_of_matrices_that_are_not_symmetric() {
        // Minors 1, 2; 1, −5; 0.
        assert!(has_positive_minors([[1.0, 5.0], [-1.0, -3.0]]));
        assert!(!has_positive_minors([[1.0, 2.0], [3.0, 1.0]]));
        assert!(!has_positive_minors([[0.0, 1.0], [-1.0, 1.0]]));
    }

    #[test]
    fn gram_matrices_are_definite_until_a_form_becomes_negative() {
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
            assert!(is_positive_definite(gram) && has_positive_minors(gram), "seed {seed}, case {case}");
            // Taking more than xᵀGx / xᵀx off the diagonal makes the form negative along x.
            let x: [f64; 6] = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
            let square: f64 = x.iter().map(|v| v * v).sum();
            let form: f64 = product(&gram, &x).iter().zip(x).map(|(a, b)| a * b).sum();
            for (i, row) in gram.iter_mut().enumerate() {
                row[i] -= form / square * (1.0 + 1e-9);
            }
            assert!(!is_positive_definite(gram) && !has_positive_minors(gram), "seed {seed}, case {case}");
        }
    }
}
