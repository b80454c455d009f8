//! Rigid motions and the forces that cause them.

use std::ops::{Add, AddAssign, Mul, Neg, Sub};

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// A rigid placement: maps local coordinates to world coordinates by `x ↦ rotation · x + translation`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Position of the local origin, m.
    pub translation: DVec3,
    /// Orientation, a unit quaternion.
    pub rotation: DQuat,
}

impl Pose {
    /// The pose of the world frame.
    pub const IDENTITY: Self = Self { translation: DVec3::ZERO, rotation: DQuat::IDENTITY };

    /// A pose from its parts; `rotation` must be of unit length.
    pub const fn new(translation: DVec3, rotation: DQuat) -> Self {
        Self { translation, rotation }
    }

    /// A pure translation, m.
    pub const fn from_translation(translation: DVec3) -> Self {
        Self { translation, rotation: DQuat::IDENTITY }
    }

    /// A point given in local coordinates, in world coordinates (m).
    #[inline]
    pub fn transform_point(&self, point: DVec3) -> DVec3 {
        self.rotation * point + self.translation
    }

    /// A direction given in local axes, in world axes.
    #[inline]
    pub fn transform_vector(&self, vector: DVec3) -> DVec3 {
        self.rotation * vector
    }

    /// The pose that undoes this one.
    #[inline]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.conjugate();
        Self { translation: -(rotation * self.translation), rotation }
    }

    /// The pose reached after moving for `dt` seconds at a constant twist: x ← x + v dt, R ← exp(ω dt) R.
    /// The rotation is exact for constant ω, and of unit length again.
    #[inline]
    pub fn moved(&self, twist: &Twist, dt: f64) -> Self {
        Self {
            translation: self.translation + twist.linear * dt,
            rotation: (DQuat::from_scaled_axis(twist.angular * dt) * self.rotation).normalize(),
        }
    }

    /// The rotation vector (rad, world axes) of the shortest rotation from this orientation to `other`'s.
    #[inline]
    pub fn rotation_vector_to(&self, other: &Self) -> DVec3 {
        rotation_vector(other.rotation * self.rotation.conjugate())
    }

    /// Whether every component is finite and the quaternion has unit length to within 1e-6.
    #[inline]
    pub fn is_valid(&self) -> bool {
        self.translation.is_finite()
            && self.rotation.is_finite()
            && (self.rotation.length_squared() - 1.0).abs() < 2e-6
    }
}

impl Default for Pose {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl Mul for Pose {
    type Output = Self;

    /// Composition: `(a * b)` places b's local frame inside a's.
    #[inline]
    fn mul(self, inner: Self) -> Self {
        Self {
            translation: self.transform_point(inner.translation),
            rotation: self.rotation * inner.rotation,
        }
    }
}

/// The rotation vector (rad) of the shortest rotation of a unit quaternion: its length is at most π.
///
/// The dissertation's Eq. 5.18 as corrected: u = 2 atan2(‖q_xyz‖, q_s) q_xyz / ‖q_xyz‖, with the sign of q
/// flipped when q_s < 0 and the series 2 q_xyz (1 + ‖q_xyz‖²/6) near zero.
#[inline]
pub fn rotation_vector(q: DQuat) -> DVec3 {
    let q = if q.w < 0.0 { -q } else { q };
    let v = DVec3::new(q.x, q.y, q.z);
    let sine = v.length();
    if sine < 1e-5 {
        return v * (2.0 + sine * sine / 3.0);
    }
    v * (2.0 * sine.atan2(q.w) / sine)
}

/// A velocity of a rigid body, or a small displacement of one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Twist {
    /// Velocity of the body's reference point, m/s, world axes.
    pub linear: DVec3,
    /// Angular velocity, rad/s, world axes.
    pub angular: DVec3,
}

impl Twist {
    /// The twist of a body at rest.
    pub const ZERO: Self = Self { linear: DVec3::ZERO, angular: DVec3::ZERO };

    /// A twist from its parts.
    pub const fn new(linear: DVec3, angular: DVec3) -> Self {
        Self { linear, angular }
    }

    /// Velocity (m/s) of the body's point at `arm` (m, world axes) from the reference point: v + ω × arm.
    pub fn velocity_at(&self, arm: DVec3) -> DVec3 {
        self.linear + self.angular.cross(arm)
    }

    /// Whether every component is finite.
    pub fn is_finite(&self) -> bool {
        self.linear.is_finite() && self.angular.is_finite()
    }
}

/// A force with a torque about a reference point that the context names.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Wrench {
    /// Force, N, world axes.
    pub force: DVec3,
    /// Torque about the reference point, N·m, world axes.
    pub torque: DVec3,
}

impl Wrench {
    /// No force and no torque.
    pub const ZERO: Self = Self { force: DVec3::ZERO, torque: DVec3::ZERO };

    /// A wrench from its parts.
    pub const fn new(force: DVec3, torque: DVec3) -> Self {
        Self { force, torque }
    }

    /// The wrench of a force (N) acting at `arm` (m, world axes) from the reference point.
    pub fn from_force_at(force: DVec3, arm: DVec3) -> Self {
        Self { force, torque: arm.cross(force) }
    }

    /// The same wrench about another reference point, which lies at `offset` (m, world axes) from the present
    /// one.
    pub fn about(&self, offset: DVec3) -> Self {
        Self { force: self.force, torque: self.torque - offset.cross(self.force) }
    }

    /// The power (W) that this wrench gives to a body moving at `twist` (same reference point).
    pub fn power(&self, twist: &Twist) -> f64 {
        self.force.dot(twist.linear) + self.torque.dot(twist.angular)
    }

    /// Whether every component is finite.
    pub fn is_finite(&self) -> bool {
        self.force.is_finite() && self.torque.is_finite()
    }
}

impl Add for Wrench {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { force: self.force + other.force, torque: self.torque + other.torque }
    }
}

impl AddAssign for Wrench {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Sub for Wrench {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Neg for Wrench {
    type Output = Self;

    fn neg(self) -> Self {
        Self { force: -self.force, torque: -self.torque }
    }
}

impl Mul<f64> for Wrench {
    type Output = Self;

    fn mul(self, factor: f64) -> Self {
        Self { force: self.force * factor, torque: self.torque * factor }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    fn axis() -> DVec3 {
        DVec3::new(0.3, -0.5, 0.8).normalize()
    }

    #[test]
    fn rotation_vector_inverts_from_scaled_axis_and_takes_the_short_way() {
        for angle in [0.0, 1e-9, 1e-6, 2e-5, 0.1, 1.0, 3.0, PI - 1e-9] {
            let expected = axis() * angle;
            let q = DQuat::from_scaled_axis(expected);
            for sign in [1.0, -1.0] {
                let error = (rotation_vector(q * sign) - expected).length();
                assert!(error < 1e-9, "angle {angle}, sign {sign}: error {error}");
            }
        }
        let long_way = DQuat::from_scaled_axis(axis() * 4.0);
        assert!((rotation_vector(long_way) + axis() * (2.0 * PI - 4.0)).length() < 1e-12);
    }

    #[test]
    fn composition_and_inverse_agree_with_points() {
        let a = Pose::new(DVec3::new(1.0, 2.0, 3.0), DQuat::from_scaled_axis(axis()));
        let b = Pose::new(DVec3::new(-0.4, 0.1, 9.0), DQuat::from_rotation_y(2.0));
        let p = DVec3::new(0.2, -7.0, 0.5);
        assert!(((a * b).transform_point(p) - a.transform_point(b.transform_point(p))).length() < 1e-14);
        assert!((a.inverse().transform_point(a.transform_point(p)) - p).length() < 1e-14);
    }

    #[test]
    fn power_does_not_depend_on_the_reference_point() {
        let twist = Twist::new(DVec3::new(1.0, 0.5, -2.0), DVec3::new(0.1, 3.0, 0.7));
        let wrench = Wrench::new(DVec3::new(4.0, -1.0, 0.3), DVec3::new(0.2, 0.9, -0.6));
        let offset = DVec3::new(0.3, 0.2, -0.8);
        let moved = Twist::new(twist.velocity_at(offset), twist.angular);
        assert!((wrench.power(&twist) - wrench.about(offset).power(&moved)).abs() < 1e-12);
    }
}
