//! Orientations from rotation matrices.

use glam::{DMat3, DQuat};

/// Unit quaternion x, y, z, w of a rotation matrix given by its columns; not finite if the matrix is not a
/// rotation.
pub(super) fn orientation(columns: [[f64; 3]; 3]) -> [f64; 4] {
    let matrix = DMat3::from_cols_array_2d(&columns);
    let product = matrix.transpose() * matrix;
    let off =
        (product - DMat3::IDENTITY).to_cols_array().into_iter().fold(0.0, |off: f64, part| off + part.abs());
    // Comparisons with numbers that are not finite are false.
    if off <= 1e-2 && matrix.determinant() > 0.0 {
        DQuat::from_mat3(&matrix).normalize().to_array()
    } else {
        [f64::NAN; 4]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_rotations_have_an_orientation() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        // A quarter turn about z takes x to y.
        let turn = orientation([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]);
        let off = DQuat::from_array(turn).angle_between(DQuat::from_xyzw(0.0, 0.0, half, half));
        assert!(off < 1e-7, "{turn:?}");
        for columns in [
            [[0.0; 3]; 3],
            [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]],
            [[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            [[f64::NAN, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            [[f64::MAX; 3]; 3],
        ] {
            assert!(orientation(columns).iter().all(|part| part.is_nan()), "{columns:?}");
        }
    }
}
