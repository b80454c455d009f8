//! Coulomb's law of friction of one contact (absent in the dissertation, §6.2.1).
//!
//! The body's point is held along the contact's plane by a spring and a damper with the gains k and b of the
//! contact itself, from an anchor in the world. With ξ the displacement from the anchor and v_t the velocity,
//! both along the plane,
//!
//! F_t = −s (k ξ + b v_t),  s = min(1, μ λ / ‖k ξ + b v_t‖),
//!
//! so that a contact sticks (s = 1) without drift within the Coulomb limit, and slides at the limit beyond
//! it. At the end of each step the anchor is moved along with the point, as far as the spring alone exceeds
//! the limit: the spring never stores more energy than it was given. Between sticking and sliding the force
//! is continuous. The coefficient falls with the sliding speed, from the static to the dynamic one, μ = μ_d +
//! (μ_s − μ_d) / (1 + (v / v_s)²) (Stribeck), so that the force does not jump either when a contact breaks
//! away.
//!
//! A contact that represents a patch of contacts of radius ρ resists spinning too, by ρ² (k τ + b ω_n), where
//! τ is the angle that it has turned about its normal. Sliding and spinning share the limit, (F_t / μ λ)² +
//! (T_n / ρ μ λ)² ≤ 1, the usual ellipsoid of soft fingers (Howe and Cutkosky 1996): a patch that spins
//! slides easily.

use glam::{DQuat, DVec3};

/// v_s: sliding speed at which the coefficient is halfway between static and dynamic, m/s. With less,
/// contacts break away with a step in force.
const STRIBECK_SPEED: f64 = 0.005;

/// Coulomb friction between two surfaces.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Friction {
    /// μ_s: largest force that a contact holds before it slides, over its normal force.
    pub static_coefficient: f64,
    /// μ_d: force against sliding, over the normal force.
    pub dynamic_coefficient: f64,
}

impl Friction {
    /// No friction.
    pub const NONE: Self = Self { static_coefficient: 0.0, dynamic_coefficient: 0.0 };

    /// Friction with the same coefficient at rest and in motion.
    pub const fn coulomb(coefficient: f64) -> Self {
        Self { static_coefficient: coefficient, dynamic_coefficient: coefficient }
    }

    /// Whether there is friction.
    pub fn is_some(&self) -> bool {
        self.static_coefficient > 0.0 || self.dynamic_coefficient > 0.0
    }

    /// μ at a sliding speed, given its square, m²/s².
    pub(crate) fn coefficient(&self, speed_squared: f64) -> f64 {
        self.dynamic_coefficient
            + (self.static_coefficient - self.dynamic_coefficient) / stribeck(speed_squared)
    }

    /// s: share of a `trial` force (N) that friction holds in a contact that slides with `slide` (m/s), under
    /// a normal force (N, not negative).
    #[inline(always)]
    pub(crate) fn share(&self, trial: &Strain, slide: &Strain, normal_force: f64) -> f64 {
        // A force within the limit of the lower coefficient is held at any speed: no square root, no
        // division.
        let least = self.static_coefficient.min(self.dynamic_coefficient) * normal_force;
        let square = trial.length_squared();
        if square <= least * least {
            return 1.0;
        }
        let (limit, size) = (self.coefficient(slide.length_squared()) * normal_force, square.sqrt());
        if size > limit { limit / size } else { 1.0 }
    }

    /// (dμ/dv) / v, s²/m², given v².
    pub(crate) fn falling(&self, speed_squared: f64) -> f64 {
        let stribeck = stribeck(speed_squared);
        -2.0 * (self.static_coefficient - self.dynamic_coefficient)
            / (stribeck * stribeck * STRIBECK_SPEED * STRIBECK_SPEED)
    }
}

/// 1 + (v / v_s)², given v².
fn stribeck(speed_squared: f64) -> f64 {
    1.0 + speed_squared * (1.0 / (STRIBECK_SPEED * STRIBECK_SPEED))
}

/// Placement of the body at which the friction spring of a contact is relaxed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrictionAnchor {
    /// Anchor of the body's point in the world, m; only its place along the contact's plane counts.
    pub point: DVec3,
    /// Orientation of the body at which the contact is not twisted; [`DQuat::IDENTITY`] also if the contact
    /// does not resist spinning.
    pub rotation: DQuat,
}

impl FrictionAnchor {
    /// The world's origin, not twisted.
    pub(crate) const ORIGIN: Self = Self { point: DVec3::ZERO, rotation: DQuat::IDENTITY };
}

impl Default for FrictionAnchor {
    fn default() -> Self {
        Self::ORIGIN
    }
}

/// Strain of a contact's spring, or its rate, or the force that it causes: along the plane (ξ or v_t, m or
/// m/s) and about the normal (ρ τ or ρ ω_n).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Strain {
    pub along: DVec3,
    pub spin: f64,
}

impl Strain {
    pub fn length(&self) -> f64 {
        self.length_squared().sqrt()
    }

    pub fn length_squared(&self) -> f64 {
        self.along.length_squared() + self.spin * self.spin
    }

    pub fn scaled(&self, by: f64) -> Self {
        Self { along: self.along * by, spin: self.spin * by }
    }

    pub fn plus(&self, other: &Self) -> Self {
        Self { along: self.along + other.along, spin: self.spin + other.spin }
    }
}
