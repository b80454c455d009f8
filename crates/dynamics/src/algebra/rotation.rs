//! The rotation group's exponential and its derivatives, in rotation vectors (rad).
//!
//! With u* the matrix of the cross product by u (Eq. A.5) and θ = ‖u‖: exp(u*) = 1 + a u* + b u*², a = sin θ
//! / θ, b = (1 − cos θ) / θ²; exp((u + δ)*) ≈ exp((J_l(u) δ)*) exp(u*) with J_l = 1 + b u* + c u*², c = (1 −
//! a) / θ²; and log(exp(u*) exp(δ*)) ≈ u + J_r⁻¹(u) δ. These take the place of the quaternion derivatives of
//! §A.2.5 and of Eq. 5.25, which is wrong as printed.

use glam::{DMat3, DVec3};

/// The matrix u* for which u* v = u × v (Eq. A.5).
pub(crate) fn skew(u: DVec3) -> DMat3 {
    DMat3::from_cols(DVec3::new(0.0, u.z, -u.y), DVec3::new(-u.z, 0.0, u.x), DVec3::new(u.y, -u.x, 0.0))
}

/// The matrix product a* b* = b aᵀ − (a·b) 1.
pub(crate) fn skew_skew(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(b * a.x, b * a.y, b * a.z) - DMat3::from_diagonal(DVec3::splat(a.dot(b)))
}

/// The matrix product a* m: the cross product of a with each column.
pub(crate) fn cross_columns(a: DVec3, m: &DMat3) -> DMat3 {
    DMat3::from_cols(a.cross(m.x_axis), a.cross(m.y_axis), a.cross(m.z_axis))
}

/// Largest θ² for which the coefficients are computed by five terms of their series, whose remainder is below
/// rounding.
pub(crate) const SERIES_BELOW: f64 = 0.01;

/// The coefficients (a, b, c) above for a squared angle.
#[inline(always)]
pub(crate) fn coefficients(t: f64) -> (f64, f64, f64) {
    if t < SERIES_BELOW {
        let a = 1.0 - t / 6.0 * (1.0 - t / 20.0 * (1.0 - t / 42.0 * (1.0 - t / 72.0)));
        let b = 0.5 * (1.0 - t / 12.0 * (1.0 - t / 30.0 * (1.0 - t / 56.0 * (1.0 - t / 90.0))));
        let c = (1.0 - t / 20.0 * (1.0 - t / 42.0 * (1.0 - t / 72.0 * (1.0 - t / 110.0)))) / 6.0;
        return (a, b, c);
    }
    let angle = t.sqrt();
    let (sine, cosine) = angle.sin_cos();
    let a = sine / angle;
    (a, (1.0 - cosine) / t, (1.0 - a) / t)
}

/// exp(u*) − 1 and J_l(u), of a rotation vector `u` (rad); J_l is the rotation, in world axes, that a change
/// of `u` makes. The 1 is left out so that small rotations keep their digits.
#[inline(always)]
pub(crate) fn exponential(u: DVec3) -> (DMat3, DMat3) {
    let (a, b, c) = coefficients(u.length_squared());
    let (first, second) = (skew(u), skew_skew(u, u));
    (first * a + second * b, DMat3::IDENTITY + first * b + second * c)
}

/// J_r⁻¹(u): the derivative of log(exp(u*) exp(δ*)) by δ at 0.
///
/// J_r⁻¹ = 1 + u*/2 + e u*², e = (1 − (θ/2) cot(θ/2)) / θ², which is regular up to and including θ = π, the
/// largest angle of the shorter rotation. Its symmetric part is positive semidefinite there: across the axis
/// it is (θ/2) cot(θ/2).
#[inline(always)]
pub(crate) fn inverse_right_jacobian(u: DVec3) -> DMat3 {
    let t = u.length_squared();
    let e = if t < SERIES_BELOW {
        1.0 / 12.0 + t * (1.0 / 720.0 + t * (1.0 / 30_240.0 + t * (1.0 / 1_209_600.0 + t / 47_900_160.0)))
    } else {
        let half = 0.5 * t.sqrt();
        let (sine, cosine) = half.sin_cos();
        (1.0 - half * cosine / sine) / t
    };
    DMat3::IDENTITY + skew(u) * 0.5 + skew_skew(u, u) * e
}

#[cfg(test)]
mod tests {
    use glam::DQuat;
    use palpate_core::Pose;

    use super::*;

    const ANGLES: [f64; 10] = [0.0, 1e-9, 1e-4, 0.03, 0.099, 0.101, 1.0, 2.0, 3.0, 3.13];

    fn axis() -> DVec3 {
        DVec3::new(-0.4, 0.7, 0.2).normalize()
    }

    fn rotation_vector(q: DQuat) -> DVec3 {
        Pose::IDENTITY.rotation_vector_to(&Pose::new(DVec3::ZERO, q))
    }

    /// Central differences of a vector function of a small vector, columns as in a Jacobian.
    fn differences(f: impl Fn(DVec3) -> DVec3) -> DMat3 {
        let h = 1e-5;
        DMat3::from_cols(
            (f(DVec3::X * h) - f(DVec3::X * -h)) / (2.0 * h),
            (f(DVec3::Y * h) - f(DVec3::Y * -h)) / (2.0 * h),
            (f(DVec3::Z * h) - f(DVec3::Z * -h)) / (2.0 * h),
        )
    }

    fn distance(a: DMat3, b: DMat3) -> f64 {
        (a - b).to_cols_array().iter().fold(0.0, |m: f64, x| m.max(x.abs()))
    }

    #[test]
    fn exponential_equals_the_quaternion_rotation() {
        for angle in ANGLES {
            let u = axis() * angle;
            let expected = DMat3::from_quat(DQuat::from_scaled_axis(u));
            let error = distance(DMat3::IDENTITY + exponential(u).0, expected);
            assert!(error < 1e-15 * 10.0, "angle {angle}: {error}");
        }
    }

    #[test]
    fn jacobians_equal_central_differences() {
        for angle in ANGLES {
            let u = axis() * angle;
            let q = DQuat::from_scaled_axis(u);
            let left = differences(|d| rotation_vector(DQuat::from_scaled_axis(u + d) * q.conjugate()));
            assert!(distance(exponential(u).1, left) < 1e-8, "J_l at angle {angle}");
            let right = differences(|d| rotation_vector(q * DQuat::from_scaled_axis(d)));
            assert!(distance(inverse_right_jacobian(u), right) < 1e-8, "inverse of J_r at angle {angle}");
        }
    }

    #[test]
    fn series_and_closed_form_meet() {
        let root = SERIES_BELOW.sqrt();
        let (below, above) = (axis() * (root * (1.0 - 1e-12)), axis() * (root * (1.0 + 1e-12)));
        assert!(distance(exponential(below).1, exponential(above).1) < 1e-12);
        assert!(distance(inverse_right_jacobian(below), inverse_right_jacobian(above)) < 1e-12);
        assert!(distance(exponential(below).0, exponential(above).0) < 1e-12);
    }

    #[test]
    fn skew_products_equal_matrix_products() {
        let (a, b) = (DVec3::new(1.0, -2.0, 0.5), DVec3::new(0.3, 4.0, -1.0));
        assert!(distance(skew_skew(a, b), skew(a) * skew(b)) < 1e-14);
        assert!((skew(a) * b - a.cross(b)).length() < 1e-15);
        assert!(distance(cross_columns(a, &skew(b)), skew(a) * skew(b)) < 1e-14);
    }
}
