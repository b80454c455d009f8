//! The grasped rigid body: its inertia, pose and twist (§5.2.1).

use glam::{DMat3, DVec3};
use palpate_core::{Pose, Twist};

/// Reason why a body was refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum BodyError {
    /// The mass is not a positive finite number.
    #[error(
        "body mass is {mass} kg; it must be positive and finite (is the mesh closed and the density positive?)"
    )]
    Mass {
        /// The mass given, kg.
        mass: f64,
    },
    /// An entry of the inertia is not finite.
    #[error(
        "body inertia has an entry that is not finite: {inertia}; compute it from a closed mesh or a simple solid"
    )]
    NotFinite {
        /// The inertia given, kg·m².
        inertia: DMat3,
    },
    /// The inertia is not symmetric.
    #[error(
        "body inertia is not symmetric: {inertia}; give it about the centre of mass, entries (i, j) and (j, i) equal"
    )]
    NotSymmetric {
        /// The inertia given, kg·m².
        inertia: DMat3,
    },
    /// A principal moment is not positive.
    #[error(
        "body inertia has principal moments {moments} kg·m²; all must be positive (is the body flat or inside out?)"
    )]
    NotPositive {
        /// Principal moments in ascending order, kg·m².
        moments: DVec3,
    },
    /// A principal moment exceeds the sum of the other two, which is impossible for a distribution of mass.
    #[error(
        "body inertia has principal moments {moments} kg·m²; the largest exceeds the sum of the others, so it is no \
         body's inertia (is it about the centre of mass, in one unit?)"
    )]
    Triangle {
        /// Principal moments in ascending order, kg·m².
        moments: DVec3,
    },
}

/// Mass and inertia of a rigid body.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Body {
    /// Mass, kg.
    pub mass: f64,
    /// Inertia about the centre of mass, in body axes, kg·m². The dissertation's M.
    pub inertia: DMat3,
}

/// Relative slack of the symmetry and triangle conditions. A flat plate and a thin rod lie on the boundary of
/// the triangle condition; with less slack, rounding of integrals over their meshes gets them refused.
const INERTIA_SLACK: f64 = 1e-6;

/// Smallest principal moment relative to the largest. With less, the inverse of the inertia is mostly
/// rounding.
const MIN_MOMENT_RATIO: f64 = 1e-12;

impl Body {
    /// A body of the given mass (kg) and inertia about its centre of mass in body axes (kg·m²).
    ///
    /// # Errors
    ///
    /// A mass that is not positive, an inertia that is not finite, symmetric and positive definite, or one
    /// that breaks the triangle inequality of principal moments by more than rounding.
    pub fn new(mass: f64, inertia: DMat3) -> Result<Self, BodyError> {
        if !(mass > 0.0 && mass.is_finite()) {
            return Err(BodyError::Mass { mass });
        }
        if !inertia.is_finite() {
            return Err(BodyError::NotFinite { inertia });
        }
        let size = inertia.to_cols_array().iter().fold(0.0, |m: f64, x| m.max(x.abs()));
        let skewness = inertia - inertia.transpose();
        if skewness.to_cols_array().iter().any(|x| x.abs() > INERTIA_SLACK * size) {
            return Err(BodyError::NotSymmetric { inertia });
        }
        let inertia = (inertia + inertia.transpose()) * 0.5;
        let moments = principal_moments(&inertia);
        if moments.x.is_nan() || moments.x <= MIN_MOMENT_RATIO * moments.z {
            return Err(BodyError::NotPositive { moments });
        }
        if moments.z > (moments.x + moments.y) * (1.0 + INERTIA_SLACK) {
            return Err(BodyError::Triangle { moments });
        }
        Ok(Self { mass, inertia })
    }

    /// Principal moments of inertia about the centre of mass, ascending, kg·m².
    pub fn principal_moments(&self) -> DVec3 {
        principal_moments(&self.inertia)
    }

    /// The inertia about the body point at `arm` (m, body axes) from the centre of mass, kg·m², by the
    /// parallel-axis rule I + m (‖a‖² − a aᵀ).
    pub fn inertia_about(&self, arm: DVec3) -> DMat3 {
        let square = DMat3::from_cols(arm * arm.x, arm * arm.y, arm * arm.z);
        self.inertia + (DMat3::IDENTITY * arm.length_squared() - square) * self.mass
    }

    /// Twist of the centre of mass after an impulse (N·s) and an angular one about it (N·m·s), world axes.
    pub fn pushed(&self, state: &BodyState, linear: DVec3, angular: DVec3) -> Twist {
        let to_world = state.pose.rotation;
        let turned = to_world * (self.inertia.inverse() * (to_world.conjugate() * angular));
        Twist::new(state.twist.linear + linear / self.mass, state.twist.angular + turned)
    }

    /// Kinetic energy at a state, J.
    pub fn kinetic_energy(&self, state: &BodyState) -> f64 {
        let spin = state.pose.rotation.conjugate() * state.twist.angular;
        0.5 * self.mass * state.twist.linear.length_squared() + 0.5 * spin.dot(self.inertia * spin)
    }

    /// Angular momentum about the centre of mass in world axes, kg·m²/s: the dissertation's L.
    pub fn angular_momentum(&self, state: &BodyState) -> DVec3 {
        let to_world = state.pose.rotation;
        to_world * (self.inertia * (to_world.conjugate() * state.twist.angular))
    }
}

/// Eigenvalues of a symmetric matrix in ascending order, by cyclic Jacobi rotations, which keep the relative
/// accuracy of small eigenvalues where the closed form loses it.
pub(crate) fn principal_moments(matrix: &DMat3) -> DVec3 {
    let scale = matrix.to_cols_array().iter().fold(0.0, |m: f64, x| m.max(x.abs()));
    if scale == 0.0 || !scale.is_finite() {
        return DVec3::splat(if scale == 0.0 { 0.0 } else { f64::NAN });
    }
    let mut a = (*matrix * (1.0 / scale)).to_cols_array_2d();
    // Cyclic sweeps converge quadratically, so that the limit is never reached.
    for _ in 0..20 {
        let off = a[0][1].abs() + a[0][2].abs() + a[1][2].abs();
        if off < 1e-300 {
            break;
        }
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if a[p][q] == 0.0 {
                continue;
            }
            // The rotation by θ in the plane of p and q with tan 2θ = 2 a_pq / (a_qq − a_pp) makes a_pq zero;
            // t = tan θ is the root of t² + 2 τ t = 1 with |θ| ≤ 45°.
            let tau = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
            let t = if tau >= 0.0 { 1.0 } else { -1.0 } / (tau.abs() + tau.hypot(1.0));
            let c = 1.0 / t.hypot(1.0);
            let s = t * c;
            let r = 3 - p - q;
            let (apq, arp, arq) = (a[p][q], a[r][p], a[r][q]);
            a[p][p] -= t * apq;
            a[q][q] += t * apq;
            a[p][q] = 0.0;
            a[q][p] = 0.0;
            a[r][p] = c * arp - s * arq;
            a[p][r] = a[r][p];
            a[r][q] = s * arp + c * arq;
            a[q][r] = a[r][q];
        }
    }
    let mut moments = [a[0][0] * scale, a[1][1] * scale, a[2][2] * scale];
    moments.sort_by(f64::total_cmp);
    DVec3::from_array(moments)
}

/// Pose and twist of a body.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BodyState {
    /// Placement of the body axes; the translation is the centre of mass **x** in the world, m.
    pub pose: Pose,
    /// Velocity of the centre of mass and angular velocity, world axes.
    pub twist: Twist,
}

impl BodyState {
    /// A state at rest.
    pub const fn at_rest(pose: Pose) -> Self {
        Self { pose, twist: Twist::ZERO }
    }

    /// Whether the pose is a rigid placement and every number is finite.
    pub fn is_valid(&self) -> bool {
        self.pose.is_valid() && self.twist.is_finite()
    }
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;

    #[test]
    fn principal_moments_are_invariant_under_rotation() {
        let moments = DVec3::new(1e-9, 2.5e-6, 2.5004e-6);
        for angle in [0.0, 0.3, 1.0, 2.7] {
            let r = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::new(0.2, -0.7, 0.5).normalize() * angle));
            let found = principal_moments(&(r * DMat3::from_diagonal(moments) * r.transpose()));
            assert!(
                (found - moments).abs().max_element() < 1e-15 * moments.z * 10.0,
                "{found} at angle {angle}"
            );
        }
    }

    #[test]
    fn parallel_axis_rule_adds_mass_times_squared_distance() {
        let body = Body::new(2.0, DMat3::from_diagonal(DVec3::new(1.0, 1.2, 1.5))).unwrap();
        let about = body.inertia_about(DVec3::X * 3.0);
        assert_eq!(about, DMat3::from_diagonal(DVec3::new(1.0, 19.2, 19.5)));
    }

    #[test]
    fn impossible_bodies_are_refused() {
        let good = DMat3::from_diagonal(DVec3::new(1.0, 2.0, 2.5));
        assert!(Body::new(1.0, good).is_ok());
        for mass in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(Body::new(mass, good), Err(BodyError::Mass { .. })));
        }
        let mut bent = good;
        bent.x_axis.y = 0.1;
        assert!(matches!(Body::new(1.0, bent), Err(BodyError::NotSymmetric { .. })));
        bent.x_axis.y = f64::NAN;
        assert!(matches!(Body::new(1.0, bent), Err(BodyError::NotFinite { .. })));
        let diagonal = |x, y, z| Body::new(1.0, DMat3::from_diagonal(DVec3::new(x, y, z)));
        assert!(matches!(diagonal(0.0, 1.0, 1.0), Err(BodyError::NotPositive { .. })));
        assert!(matches!(diagonal(-1.0, 1.0, 1.0), Err(BodyError::NotPositive { .. })));
        assert!(matches!(diagonal(1.0, 1.0, 2.1), Err(BodyError::Triangle { .. })));
        // A flat plate lies on the boundary and is a body.
        assert!(diagonal(1.0, 1.0, 2.0).is_ok());
    }
}
