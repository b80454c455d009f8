//! Settings that change while a session runs: the values that are sent to the two loops, and the ramp from
//! old gains to new ones. Without the ramp the force would jump, and a spring that is held stretched would
//! stiffen at once.

use palpate_dynamics::{ContactParameters, Friction, SlewLimit, VirtualCoupling};

use super::response::Response;

/// Duration of the ramp from old gains to new ones, s. A shorter ramp is felt as a jolt while a spring is
/// stretched.
const RAMP_TIME: f64 = 0.2;

/// Live settings of the haptic loop.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HapticTuning {
    pub coupling: VirtualCoupling,
    pub velocity_lags: (f64, f64),
    pub slew: SlewLimit,
    pub max_damping: (f64, f64),
}

/// Live settings of the contact loop.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ContactTuning {
    pub response: Response,
    pub parameters: ContactParameters,
    pub error: f64,
    pub interpolation: bool,
    pub query_budget: Option<f64>,
}

/// Linear change from one value to another over [`RAMP_TIME`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ramp<T> {
    from: T,
    to: T,
    elapsed: f64,
}

impl<T: Interpolate> Ramp<T> {
    pub fn new(from: T, to: T) -> Self {
        Self { from, to, elapsed: 0.0 }
    }

    /// Advances by `dt` (s). Returns the value, and whether the ramp has ended.
    pub fn advance(&mut self, dt: f64) -> (T, bool) {
        self.elapsed += if dt > 0.0 { dt } else { 0.0 };
        let t = (self.elapsed / RAMP_TIME).min(1.0);
        if t >= 1.0 { (self.to, true) } else { (self.from.lerp(&self.to, t), false) }
    }
}

/// Values that a [`Ramp`] can interpolate.
pub(crate) trait Interpolate: Copy {
    /// Interpolates linearly: `self` at t = 0, `other` at t = 1.
    fn lerp(&self, other: &Self, t: f64) -> Self;
}

impl Interpolate for f64 {
    fn lerp(&self, other: &Self, t: f64) -> Self {
        self + (other - self) * t
    }
}

impl Interpolate for VirtualCoupling {
    /// Interpolates the gains; other fields are those of `other`.
    fn lerp(&self, other: &Self, t: f64) -> Self {
        Self {
            linear_stiffness: self.linear_stiffness.lerp(&other.linear_stiffness, t),
            linear_damping: self.linear_damping.lerp(&other.linear_damping, t),
            angular_stiffness: self.angular_stiffness.lerp(&other.angular_stiffness, t),
            angular_damping: self.angular_damping.lerp(&other.angular_damping, t),
            ..*other
        }
    }
}

impl Interpolate for ContactParameters {
    fn lerp(&self, other: &Self, t: f64) -> Self {
        let (from, to) = (&self.friction, &other.friction);
        Self {
            stiffness: self.stiffness.lerp(&other.stiffness, t),
            damping: self.damping.lerp(&other.damping, t),
            friction: Friction {
                static_coefficient: from.static_coefficient.lerp(&to.static_coefficient, t),
                dynamic_coefficient: from.dynamic_coefficient.lerp(&to.dynamic_coefficient, t),
            },
            ..*other
        }
    }
}

/// Contact parameters and the error threshold s₀ (m).
impl Interpolate for (ContactParameters, f64) {
    fn lerp(&self, other: &Self, t: f64) -> Self {
        (self.0.lerp(&other.0, t), self.1.lerp(&other.1, t))
    }
}
