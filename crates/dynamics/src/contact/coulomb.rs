//! Coulomb's law of friction of one contact (absent in the dissertation, §6.2.1).
//!
//! The body's point is held along the contact's plane by a spring and a damper with the gains k and b of the
//! contact itself, from an anchor in the world. With ξ the displacement from the anchor and v_t the velocity,
//! both along the plane,
//!
//! F_t = −s (k ξ + b v_t),  s = min(1, μ λ / ‖k ξ + b v_t‖),
//!
//! so that a contact sticks (s = 1) as long as it can, without drift, and slides at the Coulomb limit
//! otherwise. At the end of each step the anchor is drawn after the point, as far as the spring alone exceeds
//! the limit: it never holds more energy than it was given. Between sticking and sliding the force is
//! continuous. The coefficient falls with the speed of sliding, from the static one to the dynamic one, μ =
//! μ_d + (μ_s − μ_d) / (1 + (v / v_s)²) (Stribeck), so that the force does not jump when a contact breaks
//! away either.
//!
//! A contact that stands for a patch of contacts, of radius ρ, resists spinning too: by ρ² (k τ + b ω_n),
//! with τ the angle that it has turned about its normal. Sliding and spinning share the limit, (F_t / μ λ)² +
//! (T_n / ρ μ λ)² ≤ 1, the ellipsoid that is usual for soft fingers (Howe and Cutkosky 1996): a patch that
//! spins slides easily.

use glam::{DQuat, DVec3};

/// v_s: speed of sliding at which the coefficient is half way from static to dynamic, m/s.
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

    /// Whether there is any.
    pub fn is_some(&self) -> bool {
        self.static_coefficient > 0.0 || self.dynamic_coefficient > 0.0
    }

    /// μ at a speed of sliding, given its square, m²/s².
    pub(crate) fn coefficient(&self, speed_squared: f64) -> f64 {
        self.dynamic_coefficient
            + (self.static_coefficient - self.dynamic_coefficient) / stribeck(speed_squared)
    }

    /// s: share of a `trial` force (N) that friction holds in a contact that slides with `slide` (m/s), under
    /// a normal force (N, not negative).
    #[inline(always)]
    pub(crate) fn share(&self, trial: &Strain, slide: &Strain, normal_force: f64) -> f64 {
        // Held at the lower coefficient, and so at any: no square root, no division.
        let surely = self.least() * normal_force;
        let square = trial.length_squared();
        if square <= surely * surely {
            return 1.0;
        }
        share_within(self.coefficient(slide.length_squared()) * normal_force, square.sqrt())
    }

    /// Lower of the two coefficients.
    fn least(&self) -> f64 {
        self.static_coefficient.min(self.dynamic_coefficient)
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

/// s: share of a trial force that is within a limit.
fn share_within(limit: f64, trial: f64) -> f64 {
    if trial > limit { limit / trial } else { 1.0 }
}

/// Placement of the body in which the friction spring of a contact is relaxed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrictionAnchor {
    /// Anchor of the body's point in the world, m; only its place along the contact's plane counts.
    pub point: DVec3,
    /// Orientation of the body in which the contact is not twisted; [`DQuat::IDENTITY`] also where nothing
    /// resists spinning.
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

/// Strain of a contact along its plane or the rate of it: ξ or v_t, m or m/s, and ρ τ or ρ ω_n likewise.
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
