//! Gains of the virtual coupling that a sampled device renders passively.
//!
//! A device of viscous damping b that renders a spring K sampled every T, with the force held between samples,
//! is passive whoever holds it if b > K T/2 (Colgate and Schenkel 1997). Position in steps of Δ and Coulomb
//! friction f_c add K ≤ 2 f_c/Δ (Abbott and Okamura 2005). The grasped body is taken to stand still, as it does
//! against a stiff wall: the coupling alone is then what the device renders. A body that gives way is in series
//! with it, which makes the port softer, and so does a contact less stiff than the wall.
//!
//! # Dampers
//!
//! With a damper B beside the spring the condition is b > K T/2 + B, which no damping leaves room for that is
//! critical for a body of 0.1 kg. But the force that counts is the one at half the sampling rate, where a
//! velocity from differences of position through a first-order lag τ is small. With g = T/(τ + T) the
//! backward-Euler lag's weight, the general condition of Colgate and Schenkel,
//!
//! b > T/(2 (1 − cos ωT)) Re((1 − e^(−jωT)) H(e^(jωT))),  H(z) = K + B g (1 − z⁻¹)/(T (1 − (1 − g) z⁻¹)),
//!
//! becomes b > K T/2 − B g (cos ωT − 1 + g)/(1 − 2 (1 − g) cos ωT + (1 − g)²), whose right-hand side grows with
//! ω: it is hardest at ωT = π, and there
//!
//! b > K T/2 + B T/(2 τ + T).
//!
//! A step Δ of the encoder answers with K Δ + B Δ/(τ + T) at once, so that what friction absorbs is, as for the spring
//! alone, K + B/(τ + T) ≤ 2 f_c/Δ.
//!
//! So the damper stays critical for the body, and it is the device's velocity that is given the lag which the
//! device's damping asks for ([`PortAxes::velocity_lag`]). The body's own motion is damped without lag. For a
//! free body the port stays passive at every frequency: with m = k = 1 and damping B it has Re Z(jω) ∝ B + τ B² +
//! τ² B > 0.

use palpate_core::Pose;

use crate::body::Body;
use crate::coupling::VirtualCoupling;

/// Stiffness of the coupling where nothing limits it: the upper values of §5.5.1, N/m and N·m/rad.
const STIFFNESS: f64 = 500.0;
const ANGULAR_STIFFNESS: f64 = 3.0;

/// Share used of the stiffness that the maker calls stable.
const MAKER_SHARE: f64 = 0.5;
/// Share of the device's damping that the spring may need: half, which leaves the rest to the damper.
const SPRING_SHARE: f64 = 0.5;
/// Share of 2 f_c/Δ that the spring may need.
const FRICTION_SHARE: f64 = 0.5;
/// Share of the device's damping that spring and damper may need together.
const TOTAL_SHARE: f64 = 0.9;
/// Least share of the device's damping that is left to the damper, for a spring that was given and needs all.
const DAMPER_SHARE: f64 = 0.1;
/// The period that makers state stable gains for, s.
const MAKER_PERIOD: f64 = 1e-3;

/// What a device can do along, or about, its axes. Translation in N, m; rotation in N·m, rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PortAxes {
    /// Largest stiffness that the maker calls stable at 1 kHz (N/m, N·m/rad). Infinite if there is no limit, 0 if
    /// nothing is rendered.
    pub stiffness: f64,
    /// Largest virtual damping that the maker calls stable at 1 kHz (N·s/m, N·m·s/rad). Used where `viscous` is
    /// not known.
    pub damping: f64,
    /// Viscous damping b of the handle itself (N·s/m, N·m·s/rad).
    pub viscous: Option<f64>,
    /// Coulomb friction f_c of the handle itself (N, N·m).
    pub friction: Option<f64>,
    /// Largest force (N, N·m); infinite if there is no limit, 0 if nothing is rendered.
    pub peak: f64,
    /// Smallest change of position that is sensed, Δ (m, rad); 0 if it is not rounded.
    pub step: f64,
}

impl PortAxes {
    /// The largest stiffness (N/m, N·m/rad) that is rendered passively with the margins of this module, at a
    /// sampling period (s): infinite if nothing limits it.
    ///
    /// The least of half the maker's, b/T, f_c/Δ; the latter two where b and f_c are known and not zero. A maker's
    /// figure holds at 1 kHz; it is lowered for slower loops in proportion, and not raised for faster ones.
    pub fn largest_stiffness(&self, period: f64) -> f64 {
        let maker = MAKER_SHARE * self.stiffness * (MAKER_PERIOD / period).min(1.0);
        let viscous = positive(self.viscous).map_or(f64::INFINITY, |b| SPRING_SHARE * 2.0 * b / period);
        let friction = positive(self.friction)
            .filter(|_| self.step > 0.0)
            .map_or(f64::INFINITY, |f| FRICTION_SHARE * 2.0 * f / self.step);
        maker.min(viscous).min(friction)
    }

    /// The lag τ (s) of the device's velocity with which `damping` (N·s/m, N·m·s/rad) beside `stiffness` (N/m,
    /// N·m/rad) is rendered passively at a sampling `period` (s); 0 if any lag does.
    ///
    /// Spring and damper may need nine tenths of b together, and of 2 f_c/Δ, and the damper has a tenth whatever
    /// the spring needs. If b is not known, the damper may at half the sampling rate be what the maker's damping is there
    /// through the device's own lag, `velocity_delay` (s).
    pub fn velocity_lag(&self, stiffness: f64, damping: f64, velocity_delay: f64, period: f64) -> f64 {
        if self.peak.is_nan() || self.peak <= 0.0 {
            return 0.0;
        }
        let usable = |lag: f64| if lag.is_finite() { lag.max(0.0) } else { 0.0 };
        let sampled = 0.5 * period * (damping / self.room(stiffness, velocity_delay, period) - 1.0);
        let rounded = damping / self.rounding_room(stiffness) - period;
        usable(sampled).max(usable(rounded))
    }

    /// The largest damping (N·s/m, N·m·s/rad) that is passive beside `stiffness` (N/m, N·m/rad) on a velocity
    /// that lags by `lag` (s), `velocity_delay` (s) being the device's own lag: the bound of
    /// [`Self::velocity_lag`]. Infinite if nothing limits it.
    pub fn largest_damping(&self, stiffness: f64, lag: f64, velocity_delay: f64, period: f64) -> f64 {
        let sampled = self.room(stiffness, velocity_delay, period) * (2.0 * lag + period) / period;
        sampled.min(self.rounding_room(stiffness) * (lag + period))
    }

    /// What B/(τ + T) may be, N/m or N·m/rad.
    fn rounding_room(&self, stiffness: f64) -> f64 {
        match positive(self.friction).filter(|_| self.step > 0.0) {
            Some(friction) => {
                let whole = 2.0 * friction / self.step;
                (TOTAL_SHARE * whole - stiffness).max(DAMPER_SHARE * whole)
            }
            None => f64::INFINITY,
        }
    }

    /// What the damper may be at half the sampling rate.
    fn room(&self, stiffness: f64, velocity_delay: f64, period: f64) -> f64 {
        match positive(self.viscous) {
            Some(b) => (TOTAL_SHARE * b - 0.5 * stiffness * period).max(DAMPER_SHARE * b),
            None => self.damping * period / (2.0 * velocity_delay + period),
        }
    }

    /// The damping (N·s/m, N·m·s/rad) that a device must have of its own to render `stiffness` and `damping` of
    /// a velocity with lag `lag` (s) passively at a sampling `period` (s).
    pub fn needed_viscous(stiffness: f64, damping: f64, lag: f64, period: f64) -> f64 {
        0.5 * stiffness * period + damping * period / (2.0 * lag + period)
    }

    /// The stiffness to use: the largest passive one, or `otherwise` if there is no limit or nothing rendered.
    fn stiffness_or(&self, otherwise: f64, period: f64) -> f64 {
        let largest = self.largest_stiffness(period);
        if self.peak > 0.0 && largest > 0.0 && largest.is_finite() { largest } else { otherwise }
    }

    /// The limit of the coupling's spring. Axes that are not rendered at all still have to move the object.
    fn spring_limit(&self) -> f64 {
        if self.peak > 0.0 { self.peak } else { f64::INFINITY }
    }

    /// The same seen from a world in which forces are `force` times as large and lengths `length` times.
    fn scaled(&self, force: f64, length: f64) -> Self {
        let gain = force / length;
        Self {
            stiffness: self.stiffness * gain,
            damping: self.damping * gain,
            viscous: self.viscous.map(|b| b * gain),
            friction: self.friction.map(|f| f * force),
            peak: self.peak * force,
            step: self.step * length,
        }
    }
}

fn positive(value: Option<f64>) -> Option<f64> {
    value.filter(|value| *value > 0.0)
}

/// What a device can do, and how often it is asked to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PortLimits {
    /// Along the axes.
    pub translation: PortAxes,
    /// About the axes.
    pub rotation: PortAxes,
    /// How far the twist that the device reports lags behind, s.
    pub velocity_delay: f64,
    /// Sampling period, s.
    pub period: f64,
}

impl PortLimits {
    /// The limits as they are in a world that the device moves in `scale` times as far (see
    /// [`DeviceMapping`](crate::DeviceMapping)): forces `scale` times as large, torques and what goes with them
    /// `scale`² times, stiffness and damping of translation the same.
    pub fn in_world(&self, scale: f64) -> Self {
        Self {
            translation: self.translation.scaled(scale, scale),
            rotation: self.rotation.scaled(scale * scale, 1.0),
            ..*self
        }
    }

    /// The lags (s) of the device's velocity and angular velocity with which `coupling` is passive at the port;
    /// 0 where the twist that the device reports will do as it is. See [`PortAxes::velocity_lag`].
    pub fn velocity_lags(&self, coupling: &VirtualCoupling) -> (f64, f64) {
        let lag = |axes: &PortAxes, stiffness, damping| {
            let lag = axes.velocity_lag(stiffness, damping, self.velocity_delay, self.period);
            if lag <= self.velocity_delay { 0.0 } else { lag }
        };
        (
            lag(&self.translation, coupling.linear_stiffness, coupling.linear_damping),
            lag(&self.rotation, coupling.angular_stiffness, coupling.angular_damping),
        )
    }
}

impl VirtualCoupling {
    /// A coupling for `body` held at `grasp` by a device of the given limits: springs as stiff as the device
    /// renders passively with a margin ([`PortAxes::largest_stiffness`]) and no stronger than it, and damped
    /// critically ([`Self::critically_damped`]). 500 N/m and 3 N·m/rad, the upper values of §5.5.1, where
    /// nothing limits the stiffness or nothing is rendered.
    ///
    /// The damper is passive at the port only with the lag of [`PortLimits::velocity_lags`].
    pub fn auto(body: &Body, grasp: Pose, limits: &PortLimits) -> Self {
        let linear = limits.translation.stiffness_or(STIFFNESS, limits.period);
        let angular = limits.rotation.stiffness_or(ANGULAR_STIFFNESS, limits.period);
        Self::critically_damped(body, grasp, linear, angular).limited_to(limits)
    }

    /// The coupling with springs no stronger than a device of the given limits: pressing harder than it can
    /// render must not press the body deeper (§5.3.3).
    pub fn limited_to(mut self, limits: &PortLimits) -> Self {
        self.max_force = limits.translation.spring_limit();
        self.max_torque = limits.rotation.spring_limit();
        self
    }
}

#[cfg(test)]
mod tests {
    use glam::{DMat3, DVec3};
    use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

    use super::*;

    /// A Phantom Premium's figures.
    fn limits(period: f64) -> PortLimits {
        PortLimits {
            translation: PortAxes {
                stiffness: 800.0,
                damping: 2.0,
                viscous: Some(1.0),
                friction: Some(0.04),
                peak: 8.5,
                step: 3e-5,
            },
            rotation: PortAxes {
                stiffness: 0.3,
                damping: 0.002,
                viscous: Some(1e-3),
                friction: Some(1e-3),
                peak: 0.188,
                step: 1e-4,
            },
            velocity_delay: 3e-3,
            period,
        }
    }

    /// The right-hand side of the condition of Colgate and Schenkel for spring and lagged damper, by its
    /// definition in complex numbers.
    fn needed_at(stiffness: f64, damping: f64, lag: f64, period: f64, angle: f64) -> f64 {
        let gain = period / (lag + period);
        let multiply = |a: (f64, f64), b: (f64, f64)| (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0);
        let divide = |a: (f64, f64), b: (f64, f64)| {
            let size = b.0 * b.0 + b.1 * b.1;
            let product = multiply(a, (b.0, -b.1));
            (product.0 / size, product.1 / size)
        };
        let delay = (angle.cos(), -angle.sin());
        let difference = (1.0 - delay.0, -delay.1);
        let pole = (1.0 - (1.0 - gain) * delay.0, -(1.0 - gain) * delay.1);
        let velocity = divide(difference, pole);
        let size = damping * gain / period;
        let response = (stiffness + size * velocity.0, size * velocity.1);
        period / (2.0 * (1.0 - angle.cos())) * multiply(difference, response).0
    }

    #[test]
    fn the_closed_form_is_the_worst_frequency_of_the_general_condition() {
        let seed = 71;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..500 {
            let (stiffness, damping) = (rng.random_range(0.0..3000.0), rng.random_range(0.0..50.0));
            let period = 10_f64.powf(rng.random_range(-4.0..-2.0));
            let lag = if case % 5 == 0 { 0.0 } else { 10_f64.powf(rng.random_range(-4.5..-1.0)) };
            let closed = PortAxes::needed_viscous(stiffness, damping, lag, period);
            let worst = (1..=2000)
                .map(|i| {
                    needed_at(stiffness, damping, lag, period, f64::from(i) * std::f64::consts::PI / 2000.0)
                })
                .fold(f64::NEG_INFINITY, f64::max);
            assert!((worst / closed - 1.0).abs() < 1e-9, "seed {seed}, case {case}: {worst}, {closed}");
        }
    }

    #[test]
    fn auto_gains_are_passive_for_every_mass_and_rate() {
        let seed = 72;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..2000 {
            let mass = 10_f64.powf(rng.random_range(-4.0..2.0));
            let size = 10_f64.powf(rng.random_range(-2.5..0.0));
            let body =
                Body::new(mass, DMat3::from_diagonal(DVec3::new(0.3, 0.9, 1.0)) * (0.1 * mass * size * size))
                    .unwrap();
            let limits = limits(1.0 / rng.random_range(100.0..10_000.0))
                .in_world(10_f64.powf(rng.random_range(-2.0..2.0)));
            let grasp = Pose::from_translation(DVec3::X * rng.random_range(0.0..size));
            let coupling = VirtualCoupling::auto(&body, grasp, &limits);
            let (lag, angular_lag) = limits.velocity_lags(&coupling);
            for (axes, stiffness, damping, lag) in [
                (limits.translation, coupling.linear_stiffness, coupling.linear_damping, lag),
                (limits.rotation, coupling.angular_stiffness, coupling.angular_damping, angular_lag),
            ] {
                let lag = if lag == 0.0 { limits.velocity_delay } else { lag };
                let needed = PortAxes::needed_viscous(stiffness, damping, lag, limits.period);
                let has = axes.viscous.unwrap();
                assert!(needed <= 0.9 * has * (1.0 + 1e-9), "seed {seed}, case {case}: {needed} of {has}");
                assert!(stiffness <= axes.friction.unwrap() / axes.step * (1.0 + 1e-12));
                let answer = (stiffness + damping / (lag + limits.period)) * axes.step;
                assert!(answer <= 1.8 * axes.friction.unwrap() * (1.0 + 1e-9), "seed {seed}, case {case}");
                assert!(stiffness <= 0.5 * axes.stiffness * (1.0 + 1e-12), "seed {seed}, case {case}");
                assert!(stiffness > 0.0 && damping > 0.0 && lag.is_finite(), "seed {seed}, case {case}");
            }
        }
    }

    #[test]
    fn what_is_not_known_or_not_rendered_falls_back() {
        let known = limits(1e-3);
        assert_eq!(known.translation.largest_stiffness(1e-3), 400.0);
        let mut unknown = known.translation;
        (unknown.viscous, unknown.friction) = (None, None);
        assert_eq!(unknown.largest_stiffness(1e-3), 400.0);
        assert_eq!(unknown.largest_stiffness(1e-4), 400.0);
        assert_eq!(unknown.largest_stiffness(2e-3), 200.0);
        // The maker's 2 N·s/m through the device's 3 ms are rendered without more lag; twice as much is not.
        assert!((unknown.velocity_lag(400.0, 2.0, 3e-3, 1e-3) - 3e-3).abs() < 1e-12);
        assert!((unknown.velocity_lag(400.0, 4.0, 3e-3, 1e-3) - 6.5e-3).abs() < 1e-12);
        let none = PortAxes { stiffness: 0.0, peak: 0.0, ..known.rotation };
        let free = PortAxes {
            stiffness: f64::INFINITY,
            damping: f64::INFINITY,
            viscous: None,
            friction: None,
            peak: f64::INFINITY,
            step: 0.0,
        };
        let body = Body::new(0.1, DMat3::from_diagonal(DVec3::splat(1e-4))).unwrap();
        let limits = PortLimits { translation: free, rotation: none, ..known };
        let coupling = VirtualCoupling::auto(&body, Pose::IDENTITY, &limits);
        assert_eq!((coupling.linear_stiffness, coupling.angular_stiffness), (500.0, 3.0));
        assert_eq!((coupling.max_force, coupling.max_torque), (f64::INFINITY, f64::INFINITY));
        assert_eq!(limits.velocity_lags(&coupling), (0.0, 0.0));
    }
}
