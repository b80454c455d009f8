//! Eigenvalues of symmetric 6×6 matrices.

pub(crate) type Matrix6 = [[f64; 6]; 6];

/// Largest number of Jacobi rotations: a matrix takes some five sweeps of 15 to be diagonal to rounding.
const MAX_ROTATIONS: usize = 12 * 15;

/// Eigenvalues, and eigenvectors as columns, of a symmetric matrix, by Jacobi rotations of the largest
/// off-diagonal entry.
pub(crate) fn eigen(mut matrix: Matrix6) -> ([f64; 6], Matrix6) {
    let mut vectors: Matrix6 = std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j))));
    for _ in 0..MAX_ROTATIONS {
        let (mut p, mut q, mut largest) = (0, 1, 0.0);
        for (i, row) in matrix.iter().enumerate() {
            for (j, value) in row.iter().enumerate().skip(i + 1) {
                if value.abs() > largest {
                    (p, q, largest) = (i, j, value.abs());
                }
            }
        }
        let size = matrix.iter().flatten().fold(0.0_f64, |size, value| size.max(value.abs()));
        if largest <= f64::EPSILON * size {
            break;
        }
        // The rotation R by θ in the plane of p and q, tan 2θ = 2 a_pq / (a_qq − a_pp), makes a_pq zero: A ←
        // Rᵀ A R and V ← V R.
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

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

    use super::*;

    #[test]
    fn eigenvectors_are_orthonormal_and_diagonalise_the_matrix() {
        let seed = 111;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..300 {
            let entries: Matrix6 =
                std::array::from_fn(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
            let matrix: Matrix6 =
                std::array::from_fn(|i| std::array::from_fn(|j| entries[i.max(j)][i.min(j)]));
            let (values, vectors) = eigen(matrix);
            for i in 0..6 {
                for j in 0..6 {
                    let made: f64 = (0..6).map(|k| values[k] * vectors[i][k] * vectors[j][k]).sum();
                    let product: f64 = (0..6).map(|k| vectors[k][i] * vectors[k][j]).sum();
                    let unit = f64::from(u8::from(i == j));
                    assert!((made - matrix[i][j]).abs() < 1e-12, "seed {seed}, case {case}");
                    assert!((product - unit).abs() < 1e-12, "seed {seed}, case {case}");
                }
            }
        }
        assert_eq!(eigen([[0.0; 6]; 6]).0, [0.0; 6]);
    }
}
