//! Gains of the virtual coupling that a sampled device renders passively.
//!
//! A device of viscous damping b that renders a spring K sampled every T, with the force held between samples,
//! is passive whoever holds it if b > K T/2 (Colgate and Schenkel 1997). Position in steps of Δ and Coulomb
//! friction f_c add K ≤ 2 f_c/Δ (Abbott and Okamura 2005). The grasped body is taken to stand still, as it does
//! against a stiff wall: the coupling alone is then what the device renders. A body that gives way is in series
//! with it, which makes the port softer, and so does a contact less stiff than the wall.
//!
//! # Delay
//!
//! A force that is there t_d after its sample, t_d = (n + φ) T with n whole and 0 ≤ φ < 1, costs more. The condition of Colgate
//! and Schenkel for a law H(z), derived as theirs, becomes
//!
//! b > ½ (Re qσ + √((Re qσ)² + |q|² (1 − |σ|²))), with z = e^(jωT),
//! q = T/(2 (1 − cos ωT)) (1 − z⁻¹) z⁻ⁿ H(z) and σ = 1 − φ + φ z⁻¹,
//!
//! at all frequencies up to half the sampling rate: what the hand does between the samples no longer cancels where the force
//! changes there. For whole periods (φ = 0) the right-hand side is Re q: the delay multiplies H by z⁻ⁿ. It is a norm of q plus
//! what is linear in q, so that what a sum of laws needs is at most the sum of what each needs. A spring needs most where ω
//! goes to 0: b > K h with the effective delay
//!
//! h = T/2 + t_d + T² φ (1 − φ)/(4 (T/2 + t_d)),
//!
//! exact for whole periods, where it is T/2 + t_d (Diolaiti et al. 2006), and else too much by less than 0.6 % (the same test).
//!
//! # Dampers
//!
//! With a damper B beside the spring the condition without delay is b > K T/2 + B, which no damping leaves room for that is
//! critical for a body of 0.1 kg. But the force that counts is the one at high frequencies, where a velocity from differences
//! of position through a first-order lag τ is small. With g = T/(τ + T) the backward-Euler lag's weight, H(z) = K + B g (1 −
//! z⁻¹)/(T (1 − (1 − g) z⁻¹)). Without delay the condition becomes b > K T/2 − B g (cos ωT − 1 + g)/(1 − 2 (1 − g) cos ωT + (1
//! − g)²), whose right-hand side grows with ω: it is hardest at ωT = π, and there b > K T/2 + B T/(2 τ + T). With a delay the
//! worst frequency has no closed form; the bound
//!
//! b > K h + B min(1, h/(τ + T/2))
//!
//! is enough at every frequency, by the numbers (the test `with_a_delay_the_bound_is_above_the_general_condition_and_near_it`).
//! It is exact without delay, and close where the lag is long against the delay: a lagged damper is then a spring B/τ that lets
//! go in τ.
//!
//! A step Δ of the encoder answers with K Δ + B Δ/(τ + T) at once, so that what friction absorbs is, as for the spring
//! alone, K + B/(τ + T) ≤ 2 f_c/Δ, whatever the delay.
//!
//! So the damper stays critical for the body, and it is the device's velocity that is given the lag which the
//! device's damping asks for ([`PortAxes::velocity_lag`]). The body's own motion is damped without lag. For a
//! free body the port stays passive at every frequency: with m = k = 1 and damping B it has Re Z(jω) ∝ B + τ B² +
//! τ² B > 0; with a delay that is found by the numbers (the test `a_free_body_needs_no_more_than_one_that_stands_still`).
//!
//! # Lever
//!
//! A coupling that acts at a grasp ℓ away from the handle's origin turns the handle by its force: across the lever it renders
//! s sᵀ k_c + e eᵀ k_θ on (x, φ), with s = (1, ℓ) and e = (0, 1). If N_c is what its force law needs of a device, and N_θ what
//! its couple needs, the device is passive if its damping diag(b, b_θ) is at least s sᵀ N_c + e eᵀ N_θ. As 2 ℓ x φ ≤ ρ ℓ x² +
//! ℓ φ²/ρ for every ρ > 0, it is so if
//!
//! b ≥ (1 + ρ ℓ) N_c and b_θ ≥ N_θ + ℓ (ℓ + 1/ρ) N_c,
//!
//! each port by itself with a stiffness and a damping of its own; ρ is taken as √(b/b_θ). This takes one law of the force:
//! the velocity of the grasp, v + ω × a, must lag by one and the same time in v and in ω. Where v alone lags less, a hand that
//! turns the handle about a point near the grasp drives the difference of the two, b_c (L_v − L_ω) v, at frequencies at which
//! the device's damping is small against b_c. So a coupling with a lever has one lag, the longer of what the two ports ask
//! for, unless the lever is so short that the rest of the device's damping makes up for it.
//!
//! An encoder's steps reach the force both ways, Δ + ℓ Δ_θ at the grasp, and the torque by ℓ times that.
//!
//! Where forces reach the hand and torques do not, nothing of this holds: turning the handle costs nothing and
//! stretches the coupling. Only a grasp at the handle's origin has no such lever.

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
/// Share of the rotation's stiffness that the force at the end of a lever may take of it: half, so that the object's
/// orientation is held as well.
const LEVER_SHARE: f64 = 0.5;
/// The period that makers state stable gains for, s.
const MAKER_PERIOD: f64 = 1e-3;

/// When a device is read and when it answers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampling {
    /// Sampling period T, s.
    pub period: f64,
    /// t_d: how long after a sample the wrench that answers it is at the handle, s.
    pub delay: f64,
    /// How far the twist that the device reports lags behind, s.
    pub velocity_delay: f64,
}

impl Sampling {
    /// The effective delay h (s) of a force that is held for a period: a spring K needs a device of damping K h.
    pub fn effective_delay(&self) -> f64 {
        let Self { period, delay, .. } = *self;
        let (middle, part) = (0.5 * period + delay, (delay / period).fract());
        middle + period * period * part * (1.0 - part) / (4.0 * middle)
    }
}

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

/// What a coupling is for the axes of one port.
#[derive(Clone, Copy, Debug)]
struct Load {
    /// N/m or N·m/rad; N·s/m or N·m·s/rad.
    stiffness: f64,
    damping: f64,
    /// What a step of the encoders makes of the two: N or N·m; N·s or N·m·s.
    stiffness_answer: f64,
    damping_answer: f64,
}

impl PortAxes {
    /// The largest stiffness (N/m, N·m/rad) that is rendered passively with the margins of this module: infinite if nothing
    /// limits it.
    ///
    /// The least of half the maker's, b/(2 h), f_c/Δ; the latter two where b and f_c are known and not zero. A maker's
    /// figure holds at 1 kHz without delay; it is lowered for slower loops and later wrenches in proportion to the effective
    /// delay h, and not raised for faster ones.
    pub fn largest_stiffness(&self, sampling: &Sampling) -> f64 {
        let friction = if self.step > 0.0 { self.largest_answer() / self.step } else { f64::INFINITY };
        self.largest_undamped(sampling).min(friction)
    }

    /// The largest stiffness that the maker's figure and the device's damping allow.
    fn largest_undamped(&self, sampling: &Sampling) -> f64 {
        let delay = sampling.effective_delay();
        let maker = MAKER_SHARE * self.stiffness * (0.5 * MAKER_PERIOD / delay).min(1.0);
        maker.min(positive(self.viscous).map_or(f64::INFINITY, |b| SPRING_SHARE * b / delay))
    }

    /// What a spring may answer a step of the encoders with, N or N·m.
    fn largest_answer(&self) -> f64 {
        positive(self.friction).map_or(f64::INFINITY, |friction| FRICTION_SHARE * 2.0 * friction)
    }

    /// The lag τ (s) of the device's velocity with which `damping` (N·s/m, N·m·s/rad) beside `stiffness` (N/m,
    /// N·m/rad) is rendered passively; 0 if any lag does.
    ///
    /// Spring and damper may need nine tenths of b together, and of 2 f_c/Δ, and the damper has a tenth whatever
    /// the spring needs. If b is not known, the damper may need what the maker's damping needs through the device's own lag.
    pub fn velocity_lag(&self, stiffness: f64, damping: f64, sampling: &Sampling) -> f64 {
        self.lag(&self.load(stiffness, damping), sampling)
    }

    fn load(&self, stiffness: f64, damping: f64) -> Load {
        let (stiffness_answer, damping_answer) = (stiffness * self.step, damping * self.step);
        Load { stiffness, damping, stiffness_answer, damping_answer }
    }

    fn lag(&self, load: &Load, sampling: &Sampling) -> f64 {
        if !self.is_rendered() {
            return 0.0;
        }
        let usable = |lag: f64| if lag.is_finite() { lag.max(0.0) } else { 0.0 };
        let room = self.room(load.stiffness, sampling);
        let sampled = load.damping * sampling.effective_delay() / room - 0.5 * sampling.period;
        let sampled = if load.damping <= room { 0.0 } else { usable(sampled) };
        let rounded = load.damping_answer / self.rounding_room(load.stiffness_answer) - sampling.period;
        sampled.max(usable(rounded))
    }

    /// The largest damping (N·s/m, N·m·s/rad) that is passive beside a coupling on a velocity that lags by `lag` (s): the
    /// bound of [`Self::velocity_lag`]. Infinite if nothing limits it.
    fn largest_damping(&self, load: &Load, lag: f64, sampling: &Sampling) -> f64 {
        let gain = ((lag + 0.5 * sampling.period) / sampling.effective_delay()).max(1.0);
        let sampled = self.room(load.stiffness, sampling) * gain;
        if self.step > 0.0 {
            sampled.min(self.rounding_room(load.stiffness_answer) * (lag + sampling.period) / self.step)
        } else {
            sampled
        }
    }

    /// What a damper may answer a step of the encoders with, times τ + T, beside what the spring does: N or N·m.
    fn rounding_room(&self, answer: f64) -> f64 {
        positive(self.friction).map_or(f64::INFINITY, |friction| {
            let whole = 2.0 * friction;
            (TOTAL_SHARE * whole - answer).max(DAMPER_SHARE * whole)
        })
    }

    /// What a damper may need of the device, N·s/m or N·m·s/rad.
    fn room(&self, stiffness: f64, sampling: &Sampling) -> f64 {
        match positive(self.viscous) {
            Some(b) => (TOTAL_SHARE * b - stiffness * sampling.effective_delay()).max(DAMPER_SHARE * b),
            // What the maker's damping needs at 1 kHz, or at the rate of a faster loop. No delay makes it more.
            None => {
                let half = 0.5 * sampling.period.min(MAKER_PERIOD);
                self.damping * half / (sampling.velocity_delay + half)
            }
        }
    }

    /// The damping (N·s/m, N·m·s/rad) that is enough for a device to render `stiffness` and `damping` of
    /// a velocity with lag `lag` (s) passively.
    pub fn needed_viscous(stiffness: f64, damping: f64, lag: f64, sampling: &Sampling) -> f64 {
        let delay = sampling.effective_delay();
        stiffness * delay + damping * (delay / (lag + 0.5 * sampling.period)).min(1.0)
    }

    /// b, or the least that the maker's stiffness speaks of; infinite if there is no limit.
    fn supposed_viscous(&self) -> f64 {
        positive(self.viscous).unwrap_or(0.5 * MAKER_PERIOD * self.stiffness)
    }

    fn is_rendered(&self) -> bool {
        self.peak > 0.0
    }

    /// The stiffness to use: a limit, or `otherwise` if that is none or nothing rendered.
    fn usable_or(&self, limit: f64, otherwise: f64) -> f64 {
        if self.is_rendered() && limit > 0.0 && limit.is_finite() { limit } else { otherwise }
    }

    /// The limit of the coupling's spring. Axes that are not rendered at all still have to move the object.
    fn spring_limit(&self) -> f64 {
        if self.is_rendered() { self.peak } else { f64::INFINITY }
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
    /// ℓ: how far from the handle's origin the coupling acts, m.
    pub lever: f64,
    /// When it is asked, and when it answers.
    pub sampling: Sampling,
}

/// How much a coupling's force loads each port: the translation's, and the rotation's in m².
#[derive(Clone, Copy, Debug)]
struct LeverShares {
    translation: f64,
    rotation: f64,
}

impl PortLimits {
    /// The same for a coupling that acts at a distance from the handle's origin, m.
    #[must_use]
    pub fn with_lever(self, lever: f64) -> Self {
        Self { lever, ..self }
    }

    /// The limits as they are in a world that the device moves in `scale` times as far (see
    /// [`DeviceMapping`](crate::DeviceMapping)): forces `scale` times as large, torques and what goes with them
    /// `scale`² times, stiffness and damping of translation the same.
    pub fn in_world(&self, scale: f64) -> Self {
        Self {
            translation: self.translation.scaled(scale, scale),
            rotation: self.rotation.scaled(scale * scale, 1.0),
            lever: self.lever * scale,
            ..*self
        }
    }

    /// The lags (s) of the device's velocity and angular velocity with which `coupling` is passive at the port;
    /// 0 where the twist that the device reports will do as it is. See [`PortAxes::velocity_lag`]. They are equal where the
    /// coupling acts at a lever.
    pub fn velocity_lags(&self, coupling: &VirtualCoupling) -> (f64, f64) {
        let (translation, rotation) = self.loads(coupling);
        let own = |lag: f64| if lag <= self.sampling.velocity_delay { 0.0 } else { lag };
        let lags = (
            self.translation.lag(&translation, &self.sampling),
            self.rotation.lag(&rotation, &self.sampling),
        );
        if self.has_one_lag(coupling) {
            let longest = own(lags.0.max(lags.1));
            return (longest, longest);
        }
        (own(lags.0), own(lags.1))
    }

    /// The most damping (N·s/m, N·m·s/rad) that is passive at the handle's origin beside the springs of a coupling, on
    /// velocities that lag by [`Self::velocity_lags`].
    pub fn largest_dampings(&self, coupling: &VirtualCoupling) -> (f64, f64) {
        let (translation, rotation) = self.loads(coupling);
        let (lag, angular_lag) = self.velocity_lags(coupling);
        let largest = |axes: &PortAxes, load: &Load, lag: f64| {
            axes.largest_damping(load, lag.max(self.sampling.velocity_delay), &self.sampling)
        };
        (largest(&self.translation, &translation, lag), largest(&self.rotation, &rotation, angular_lag))
    }

    /// Whether the velocity of the grasp must lag by one time: different ones may need b_c ℓ ρ of b and b_c ℓ/ρ of b_θ,
    /// for which there is what [`TOTAL_SHARE`] leaves.
    fn has_one_lag(&self, coupling: &VirtualCoupling) -> bool {
        let damping = self.translation.supposed_viscous() * self.rotation.supposed_viscous();
        let rendered = self.translation.is_rendered() && self.rotation.is_rendered();
        rendered && coupling.linear_damping * self.lever > (1.0 - TOTAL_SHARE) * damping.sqrt()
    }

    /// What a coupling is for translation and for rotation.
    fn loads(&self, coupling: &VirtualCoupling) -> (Load, Load) {
        let shares = self.lever_shares();
        let at_grasp = self.step_at_grasp();
        let translation = Load {
            stiffness: shares.translation * coupling.linear_stiffness,
            damping: shares.translation * coupling.linear_damping,
            stiffness_answer: coupling.linear_stiffness * at_grasp,
            damping_answer: coupling.linear_damping * at_grasp,
        };
        let own = self.rotation.load(coupling.angular_stiffness, coupling.angular_damping);
        let rotation = Load {
            stiffness: own.stiffness + shares.rotation * coupling.linear_stiffness,
            damping: own.damping + shares.rotation * coupling.linear_damping,
            stiffness_answer: own.stiffness_answer + self.lever * translation.stiffness_answer,
            damping_answer: own.damping_answer + self.lever * translation.damping_answer,
        };
        (translation, rotation)
    }

    /// 1 + ρ ℓ and ℓ (ℓ + 1/ρ). Where one of the ports is not rendered, or has no limit, the force loads the other by itself.
    fn lever_shares(&self) -> LeverShares {
        let ratio = (self.translation.supposed_viscous() / self.rotation.supposed_viscous()).sqrt();
        let rendered = self.translation.is_rendered() && self.rotation.is_rendered();
        if rendered && ratio > 0.0 && ratio.is_finite() {
            let rotation = self.lever * (self.lever + ratio.recip());
            return LeverShares { translation: 1.0 + ratio * self.lever, rotation };
        }
        LeverShares { translation: 1.0, rotation: self.lever * self.lever }
    }

    /// What a step of each encoder moves the grasp by, m.
    fn step_at_grasp(&self) -> f64 {
        self.translation.step + self.lever * self.rotation.step
    }

    /// The stiffest springs (N/m, N·m/rad) that are passive with the margins of this module. A lever takes of the rotation's
    /// stiffness no more than half, and makes the translation's softer where that is not enough.
    fn stiffest(&self) -> (f64, f64) {
        let Self { translation, rotation, lever, sampling } = self;
        let (shares, at_grasp) = (self.lever_shares(), self.step_at_grasp());
        let quotient = |limit: f64, by: f64| if by > 0.0 { limit / by } else { f64::INFINITY };
        let own = (translation.largest_undamped(sampling) / shares.translation)
            .min(quotient(translation.largest_answer(), at_grasp));
        let mut linear = translation.usable_or(own, STIFFNESS);
        let angular = rotation.largest_undamped(sampling);
        let answer = rotation.largest_answer();
        if rotation.is_rendered() && angular > 0.0 {
            linear = linear
                .min(quotient(LEVER_SHARE * angular, shares.rotation))
                .min(quotient(LEVER_SHARE * answer, lever * at_grasp));
        }
        let left = (angular - linear * shares.rotation)
            .min(quotient(answer - linear * lever * at_grasp, rotation.step));
        (linear, rotation.usable_or(left, ANGULAR_STIFFNESS))
    }
}

impl VirtualCoupling {
    /// A coupling for `body` held at `grasp` by a device of the given limits: springs as stiff as the device
    /// renders passively with a margin ([`PortAxes::largest_stiffness`]), its [lever](PortLimits::lever) counted, and no stronger
    /// than it, and damped critically ([`Self::critically_damped`]). 500 N/m and 3 N·m/rad, the upper values of §5.5.1, where
    /// nothing limits the stiffness or nothing is rendered.
    ///
    /// The damper is passive at the port only with the lag of [`PortLimits::velocity_lags`].
    pub fn auto(body: &Body, grasp: Pose, limits: &PortLimits) -> Self {
        let (linear, angular) = limits.stiffest();
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
    use std::f64::consts::PI;
    use std::ops::{Add, Mul};

    use glam::{DMat3, DVec3};
    use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

    use super::*;

    /// A Phantom Premium's figures.
    fn limits(sampling: Sampling) -> PortLimits {
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
            lever: 0.0,
            sampling,
        }
    }

    fn sampling(period: f64, delay: f64) -> Sampling {
        Sampling { period, delay, velocity_delay: 3e-3 }
    }

    #[derive(Clone, Copy)]
    struct Complex(f64, f64);

    impl Complex {
        fn real(x: f64) -> Self {
            Self(x, 0.0)
        }

        fn turned(angle: f64) -> Self {
            Self(angle.cos(), angle.sin())
        }

        fn square(self) -> f64 {
            self.0 * self.0 + self.1 * self.1
        }

        fn inverse(self) -> Self {
            Self(self.0 / self.square(), -self.1 / self.square())
        }
    }

    impl Add for Complex {
        type Output = Self;
        fn add(self, b: Self) -> Self {
            Self(self.0 + b.0, self.1 + b.1)
        }
    }

    impl Mul for Complex {
        type Output = Self;
        fn mul(self, b: Self) -> Self {
            Self(self.0 * b.0 - self.1 * b.1, self.0 * b.1 + self.1 * b.0)
        }
    }

    /// (1 − z⁻¹)/T at an angle ωT, and H of a spring and a damper on it through a lag.
    fn law(stiffness: f64, damping: f64, lag: f64, period: f64, angle: f64) -> (Complex, Complex) {
        let gain = period / (lag + period);
        let back = Complex::turned(-angle);
        let rate = (Complex::real(1.0) + back * Complex::real(-1.0)) * Complex::real(1.0 / period);
        let pole = Complex::real(1.0) + back * Complex::real(gain - 1.0);
        (rate, Complex::real(stiffness) + rate * pole.inverse() * Complex::real(damping * gain))
    }

    /// q of a law, and σ.
    fn late(law: Complex, sampling: &Sampling, angle: f64) -> (Complex, Complex) {
        let Sampling { period, delay, .. } = *sampling;
        let whole = (delay / period + 1e-9).floor();
        let part = (delay / period - whole).max(0.0);
        let back = Complex::turned(-angle);
        // 1 − z⁻¹ and the square of its size, 2 (1 − cos ωT), without cancellation.
        let half = (0.5 * angle).sin();
        let difference = Complex(2.0 * half * half, angle.sin());
        let size = Complex::real(period / (4.0 * half * half));
        (
            size * difference * Complex::turned(-whole * angle) * law,
            Complex::real(1.0 - part) + back * Complex::real(part),
        )
    }

    /// The right-hand side of the general condition for a law, by its definition in complex numbers.
    fn needed_at(law: Complex, sampling: &Sampling, angle: f64) -> f64 {
        let (q, sigma) = late(law, sampling, angle);
        let real = (q * sigma).0;
        0.5 * (real + (real * real + q.square() * (1.0 - sigma.square()).max(0.0)).sqrt())
    }

    /// Angles ωT up to half the sampling rate, closer where they are small.
    fn angles(count: u32) -> impl Iterator<Item = f64> {
        (1..=count).map(move |i| PI * (f64::from(i) / f64::from(count)).powf(1.5))
    }

    /// The most that spring and lagged damper need at any frequency.
    fn needed(stiffness: f64, damping: f64, lag: f64, sampling: &Sampling) -> f64 {
        angles(2000)
            .map(|angle| needed_at(law(stiffness, damping, lag, sampling.period, angle).1, sampling, angle))
            .fold(f64::NEG_INFINITY, f64::max)
    }

    /// A delay of none, of whole periods, of part of one, of some and of many.
    fn random_delay(rng: &mut StdRng, kind: usize, period: f64) -> f64 {
        period
            * match kind % 5 {
                0 => 0.0,
                1 => f64::from(rng.random_range(1..6)),
                2 => rng.random_range(0.0..1.0),
                3 => rng.random_range(0.0..10.0),
                _ => rng.random_range(10.0..50.0),
            }
    }

    #[test]
    fn without_delay_the_closed_form_is_the_worst_frequency_of_the_general_condition() {
        let seed = 71;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..500 {
            let (stiffness, damping) = (rng.random_range(0.0..3000.0), rng.random_range(0.0..50.0));
            let sampling = sampling(10_f64.powf(rng.random_range(-4.0..-2.0)), 0.0);
            let lag = if case % 5 == 0 { 0.0 } else { 10_f64.powf(rng.random_range(-4.5..-1.0)) };
            let closed = PortAxes::needed_viscous(stiffness, damping, lag, &sampling);
            let worst = needed(stiffness, damping, lag, &sampling);
            assert!((worst / closed - 1.0).abs() < 1e-9, "seed {seed}, case {case}: {worst}, {closed}");
        }
    }

    #[test]
    #[expect(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]
    fn with_a_delay_the_bound_is_above_the_general_condition_and_near_it() {
        let seed = 75;
        let mut rng = StdRng::seed_from_u64(seed);
        let (mut of_springs, mut of_long_lags, mut of_all) = (f64::INFINITY, f64::INFINITY, f64::INFINITY);
        for case in 0..1500 {
            let period = 10_f64.powf(rng.random_range(-4.0..-2.0));
            let sampling = sampling(period, random_delay(&mut rng, case, period));
            let stiffness = rng.random_range(0.0..3000.0);
            let damping = if case % 3 == 0 { 0.0 } else { rng.random_range(0.0..50.0) };
            let lag = if case % 7 == 0 { 0.0 } else { 10_f64.powf(rng.random_range(-4.5..-0.5)) };
            let bound = PortAxes::needed_viscous(stiffness, damping, lag, &sampling);
            let share = needed(stiffness, damping, lag, &sampling) / bound;
            assert!(
                share < 1.0 + 1e-9,
                "seed {seed}, case {case}: {share} of {bound}, {sampling:?}, lag {lag}"
            );
            of_all = of_all.min(share);
            if damping == 0.0 {
                of_springs = of_springs.min(share);
            } else if lag > 30.0 * sampling.effective_delay() {
                of_long_lags = of_long_lags.min(share);
            }
        }
        println!(
            "least share of the bound: springs {of_springs:.4}, long lags {of_long_lags:.3}, all {of_all:.3}"
        );
        assert!(of_springs > 0.994 && of_long_lags > 0.75 && of_all > 0.4);
    }

    #[test]
    fn what_was_enough_without_a_delay_is_not_with_one() {
        let at = |delay| needed(400.0, 5.0, 10e-3, &sampling(1e-3, delay));
        let none = PortAxes::needed_viscous(400.0, 5.0, 10e-3, &sampling(1e-3, 0.0));
        assert!(at(0.0) <= none * (1.0 + 1e-9));
        assert!(at(2e-3) > 3.0 * none, "{} of {none}", at(2e-3));
    }

    /// A body between the coupling and a free world is in series with it.
    #[test]
    fn a_free_body_needs_no_more_than_one_that_stands_still() {
        let seed = 76;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..600 {
            let period = 10_f64.powf(rng.random_range(-4.0..-2.0));
            let sampling = sampling(period, random_delay(&mut rng, case, period));
            let mass = 10_f64.powf(rng.random_range(-4.0..2.0));
            let body = Body::new(mass, DMat3::from_diagonal(DVec3::splat(1e-4 * mass))).unwrap();
            let limits = limits(sampling);
            let coupling = VirtualCoupling::auto(&body, Pose::IDENTITY, &limits);
            let (stiffness, damping) = (coupling.linear_stiffness, coupling.linear_damping);
            let (lag, _) = limits.velocity_lags(&coupling);
            let lag = lag.max(sampling.velocity_delay);
            for angle in angles(1000) {
                let (rate, law) = law(stiffness, damping, lag, period, angle);
                let inertia = rate * rate * Complex::real(mass);
                let held = Complex::real(stiffness) + rate * Complex::real(damping);
                let series = law * (Complex::real(1.0) + held * inertia.inverse()).inverse();
                let needed = needed_at(series, &sampling, angle);
                assert!(needed < 0.9 + 1e-6, "seed {seed}, case {case}: {needed} at {angle}, {sampling:?}");
            }
        }
    }

    fn random_body(rng: &mut StdRng) -> (Body, f64) {
        let mass = 10_f64.powf(rng.random_range(-4.0..2.0));
        let size = 10_f64.powf(rng.random_range(-2.5..0.0));
        let inertia = DMat3::from_diagonal(DVec3::new(0.3, 0.9, 1.0)) * (0.1 * mass * size * size);
        (Body::new(mass, inertia).unwrap(), size)
    }

    #[test]
    fn auto_gains_are_passive_for_every_mass_rate_and_delay() {
        let seed = 72;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..2000 {
            let (body, size) = random_body(&mut rng);
            let period = 1.0 / rng.random_range(100.0..10_000.0);
            let sampling = sampling(period, random_delay(&mut rng, case, period));
            let limits = limits(sampling).in_world(10_f64.powf(rng.random_range(-2.0..2.0)));
            let grasp = Pose::from_translation(DVec3::X * rng.random_range(0.0..size));
            let coupling = VirtualCoupling::auto(&body, grasp, &limits);
            let (lag, angular_lag) = limits.velocity_lags(&coupling);
            for (axes, stiffness, damping, lag) in [
                (limits.translation, coupling.linear_stiffness, coupling.linear_damping, lag),
                (limits.rotation, coupling.angular_stiffness, coupling.angular_damping, angular_lag),
            ] {
                let lag = if lag == 0.0 { sampling.velocity_delay } else { lag };
                let needed = PortAxes::needed_viscous(stiffness, damping, lag, &sampling);
                let has = axes.viscous.unwrap();
                assert!(needed <= 0.9 * has * (1.0 + 1e-9), "seed {seed}, case {case}: {needed} of {has}");
                assert!(stiffness <= axes.friction.unwrap() / axes.step * (1.0 + 1e-12));
                let answer = (stiffness + damping / (lag + period)) * axes.step;
                assert!(answer <= 1.8 * axes.friction.unwrap() * (1.0 + 1e-9), "seed {seed}, case {case}");
                assert!(stiffness <= 0.5 * axes.stiffness * (1.0 + 1e-12), "seed {seed}, case {case}");
                assert!(stiffness > 0.0 && damping > 0.0 && lag.is_finite(), "seed {seed}, case {case}");
            }
        }
    }

    /// How much of the device's damping is left at an angle ωT, at least: the smaller eigenvalue of diag(b, b_θ) less the
    /// Hermitian part of what the coupling renders, each divided by the root of its damping. For delays of whole periods.
    fn left_at(limits: &PortLimits, coupling: &VirtualCoupling, lags: (f64, f64), angle: f64) -> f64 {
        let PortLimits { translation, rotation, lever, sampling } = limits;
        let q = |stiffness, damping, lag| {
            late(law(stiffness, damping, lag, sampling.period, angle).1, sampling, angle).0
        };
        let (k, b) = (coupling.linear_stiffness, coupling.linear_damping);
        // The force answers v and ω, and turns the handle by the lever.
        let (along, across) = (q(k, b, lags.0), q(k, b, lags.1));
        let own = q(coupling.angular_stiffness, coupling.angular_damping, lags.1);
        let (v, w) = (translation.viscous.unwrap(), rotation.viscous.unwrap());
        let first = 1.0 - along.0 / v;
        let second = 1.0 - (own.0 + across.0 * lever * lever) / w;
        let mixed = Complex(across.0 + along.0, across.1 - along.1);
        let mixed = 0.25 * mixed.square() * lever * lever / (v * w);
        0.5 * (first + second) - (0.25 * (first - second).powi(2) + mixed).sqrt()
    }

    fn least_left(limits: &PortLimits, coupling: &VirtualCoupling, (lag, angular_lag): (f64, f64)) -> f64 {
        let felt = |lag: f64| if lag == 0.0 { limits.sampling.velocity_delay } else { lag };
        let lags = (felt(lag), felt(angular_lag));
        angles(400).map(|angle| left_at(limits, coupling, lags, angle)).fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn a_coupling_at_a_lever_is_passive_in_translation_and_rotation_together() {
        let seed = 77;
        let mut rng = StdRng::seed_from_u64(seed);
        let (mut without, mut apart, mut unequal) = (0, 0, 0);
        for case in 0..1000 {
            let (body, size) = random_body(&mut rng);
            let period = 1.0 / rng.random_range(200.0..5000.0);
            let sampling = sampling(period, random_delay(&mut rng, case % 2, period));
            let scale = 10_f64.powf(rng.random_range(-1.0..1.0));
            let lever = 10_f64.powf(rng.random_range(-6.0..0.0));
            let at_origin = limits(sampling);
            let limits = at_origin.with_lever(lever).in_world(scale);
            let grasp = Pose::from_translation(DVec3::X * rng.random_range(0.0..size));
            let coupling = VirtualCoupling::auto(&body, grasp, &limits);
            let lags = limits.velocity_lags(&coupling);
            let left = least_left(&limits, &coupling, lags);
            assert!(left > -1e-9, "seed {seed}, case {case}: {left} at {lever} m, lags {lags:?}");
            unequal += usize::from(lags.0 != lags.1);

            // By the handle's limits alone, as if the force did not turn it, and with lags of each port's own, it is not.
            let blind = VirtualCoupling::auto(&body, grasp, &at_origin.in_world(scale));
            let own = at_origin.in_world(scale).velocity_lags(&blind);
            without += usize::from(least_left(&limits, &blind, own) < 0.0);
            let (translation, rotation) = limits.loads(&coupling);
            let own =
                (limits.translation.lag(&translation, &sampling), limits.rotation.lag(&rotation, &sampling));
            apart += usize::from(least_left(&limits, &coupling, own) < 0.0);
        }
        assert!(without > 200 && apart > 20 && unequal > 100, "{without}, {apart}, {unequal} of 1000");
    }

    #[test]
    fn a_lever_takes_of_the_rotation_and_then_of_the_translation() {
        let at = |lever| limits(sampling(1e-3, 0.0)).with_lever(lever).stiffest();
        assert_eq!(at(0.0), (400.0, 0.15));
        let (mut before, _) = at(0.0);
        for lever in [1e-4, 1e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 1.0, 50.0] {
            let (linear, angular) = at(lever);
            assert!(linear <= before && (0.0749999..=0.15).contains(&angular), "{lever} m");
            assert!(linear > 0.0 && angular + linear * lever * lever <= 0.15 * (1.0 + 1e-12), "{lever} m");
            before = linear;
        }
        // A tenth of the lever's own share is what √(b/b_θ) = 31.6/m adds to ℓ² at 0.1 m.
        assert!((at(0.1).0 - 0.075 / (0.01 + 0.1 / 1000_f64.sqrt())).abs() < 1e-9, "{}", at(0.1).0);

        // Where no torque reaches the hand, no lever limits it; where no force does, the rotation has all of its own.
        let mut one_sided = limits(sampling(1e-3, 0.0)).with_lever(0.1);
        one_sided.rotation.peak = 0.0;
        assert_eq!(one_sided.stiffest(), (400.0, ANGULAR_STIFFNESS));
        let mut other_sided = limits(sampling(1e-3, 0.0)).with_lever(0.1);
        other_sided.translation.peak = 0.0;
        let (linear, angular) = other_sided.stiffest();
        assert!((linear - 7.5).abs() < 1e-9 && (angular - 0.075).abs() < 1e-12, "{linear}, {angular}");
    }

    #[test]
    fn gains_that_were_given_stay_and_lags_follow_the_lever() {
        let body = Body::new(0.1, DMat3::from_diagonal(DVec3::splat(1e-4))).unwrap();
        let given = VirtualCoupling::critically_damped(&body, Pose::IDENTITY, 100.0, 0.05);
        let lags = |lever| limits(sampling(1e-3, 0.0)).with_lever(lever).velocity_lags(&given);
        let (short, long) = (lags(0.02), lags(0.1));
        assert!(short.0 == short.1 && long.0 == long.1 && long.0 > short.0, "{short:?}, {long:?}");
        assert!(lags(0.0).0 < short.0 && lags(0.0).1 < short.0, "{:?}, {short:?}", lags(0.0));
        let damping = |lever| limits(sampling(1e-3, 0.0)).with_lever(lever).largest_dampings(&given);
        // On the same lag, the springs at the lever leave less of the device's damping.
        assert!(damping(0.02).1 / (short.1 + 5e-4) < damping(0.0).1 / (3e-3 + 5e-4));
    }

    /// What the maker calls stable at 1 kHz is passive for a device of some damping. With no more than that, what is chosen of
    /// the maker's figures alone is passive, too, at any rate and delay.
    #[test]
    fn the_makers_figures_alone_are_enough_with_a_delay() {
        let seed = 78;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..1000 {
            let period = 1.0 / rng.random_range(100.0..10_000.0);
            let sampling = sampling(period, random_delay(&mut rng, case, period));
            let made = Sampling { period: MAKER_PERIOD, delay: 0.0, ..sampling };
            let axes = PortAxes {
                stiffness: 10_f64.powf(rng.random_range(2.0..4.0)),
                damping: rng.random_range(0.5..10.0),
                viscous: None,
                friction: None,
                ..limits(sampling).translation
            };
            let has = PortAxes::needed_viscous(axes.stiffness, axes.damping, made.velocity_delay, &made);
            let stiffness = axes.largest_stiffness(&sampling);
            let damping = rng.random_range(0.0..50.0);
            let lag = axes.velocity_lag(stiffness, damping, &sampling).max(sampling.velocity_delay);
            let needed = needed(stiffness, damping, lag, &sampling);
            assert!(needed <= has, "seed {seed}, case {case}: {needed} of {has}, {sampling:?}");
        }
    }

    #[test]
    fn what_is_not_known_or_not_rendered_falls_back() {
        let at = |period| sampling(period, 0.0);
        let known = limits(at(1e-3));
        assert_eq!(known.translation.largest_stiffness(&at(1e-3)), 400.0);
        let mut unknown = known.translation;
        (unknown.viscous, unknown.friction) = (None, None);
        assert_eq!(unknown.largest_stiffness(&at(1e-3)), 400.0);
        assert_eq!(unknown.largest_stiffness(&at(1e-4)), 400.0);
        assert_eq!(unknown.largest_stiffness(&at(2e-3)), 200.0);
        // Half a millisecond was counted; two more make five times as much.
        assert!((unknown.largest_stiffness(&sampling(1e-3, 2e-3)) - 80.0).abs() < 1e-9);
        // The maker's 2 N·s/m through the device's 3 ms are rendered without more lag; twice as much is not.
        assert!((unknown.velocity_lag(400.0, 2.0, &at(1e-3)) - 3e-3).abs() < 1e-12);
        assert!((unknown.velocity_lag(400.0, 4.0, &at(1e-3)) - 6.5e-3).abs() < 1e-12);
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
        for lever in [0.0, 0.1] {
            for rotation in [none, free] {
                let limits = PortLimits { translation: free, rotation, lever, ..known };
                let coupling = VirtualCoupling::auto(&body, Pose::IDENTITY, &limits);
                assert_eq!((coupling.linear_stiffness, coupling.angular_stiffness), (500.0, 3.0));
                assert_eq!((coupling.max_force, coupling.max_torque), (f64::INFINITY, f64::INFINITY));
                assert_eq!(limits.velocity_lags(&coupling), (0.0, 0.0));
                assert!(!limits.largest_dampings(&coupling).0.is_nan());
            }
        }
    }
}
