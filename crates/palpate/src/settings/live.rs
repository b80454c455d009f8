//! Settings that change while a session runs: what waits for the two loops, and how gains go over from the old ones to the new, so that
//! no force jumps, and a spring that is held stretched is not stiffened at once.

use palpate_dynamics::{ContactParameters, Friction, SlewLimit, VirtualCoupling};

/// Time in which gains go over to new ones, s.
const RAMP: f64 = 0.2;

/// What the haptic loop is tuned to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HapticTuning {
    pub coupling: VirtualCoupling,
    pub velocity_lags: (f64, f64),
    pub slew: SlewLimit,
    pub max_damping: (f64, f64),
}

/// What the contact loop is tuned to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ContactTuning {
    pub parameters: ContactParameters,
    pub error: f64,
    pub interpolation: bool,
    pub query_budget: Option<f64>,
}

/// Going over from one to another.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ramp<T> {
    from: T,
    to: T,
    elapsed: f64,
}

impl<T: Between> Ramp<T> {
    pub fn new(from: T, to: T) -> Self {
        Self { from, to, elapsed: 0.0 }
    }

    /// Where it is `dt` (s) later, and whether that is the end.
    pub fn advance(&mut self, dt: f64) -> (T, bool) {
        self.elapsed += if dt > 0.0 { dt } else { 0.0 };
        let part = (self.elapsed / RAMP).min(1.0);
        if part >= 1.0 { (self.to, true) } else { (self.from.between(&self.to, part), false) }
    }
}

/// What can be between two.
pub(crate) trait Between: Copy {
    /// A part of the way from this to another, 0 to 1.
    fn between(&self, other: &Self, part: f64) -> Self;
}

impl Between for f64 {
    fn between(&self, other: &Self, part: f64) -> Self {
        self + (other - self) * part
    }
}

impl Between for VirtualCoupling {
    /// Of the gains; the rest is the other's.
    fn between(&self, other: &Self, part: f64) -> Self {
        Self {
            linear_stiffness: self.linear_stiffness.between(&other.linear_stiffness, part),
            linear_damping: self.linear_damping.between(&other.linear_damping, part),
            angular_stiffness: self.angular_stiffness.between(&other.angular_stiffness, part),
            angular_damping: self.angular_damping.between(&other.angular_damping, part),
            ..*other
        }
    }
}

impl Between for ContactParameters {
    fn between(&self, other: &Self, part: f64) -> Self {
        let (rest, sliding) = (
            self.friction.static_coefficient.between(&other.friction.static_coefficient, part),
            self.friction.dynamic_coefficient.between(&other.friction.dynamic_coefficient, part),
        );
        Self {
            stiffness: self.stiffness.between(&other.stiffness, part),
            damping: self.damping.between(&other.damping, part),
            friction: Friction { static_coefficient: rest, dynamic_coefficient: sliding },
            ..*other
        }
    }
}

/// Contact parameters and s₀ (m).
impl Between for (ContactParameters, f64) {
    fn between(&self, other: &Self, part: f64) -> Self {
        (self.0.between(&other.0, part), self.1.between(&other.1, part))
    }
}
