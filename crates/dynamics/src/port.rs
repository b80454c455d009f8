//! Gains of the virtual coupling that a sampled device renders passively.
//!
//! A device of viscous damping b that renders a spring K sampled every T, with the force held between
//! samples, is passive whoever holds it if b > K T/2 (Colgate and Schenkel 1997). Position in steps of Δ and
//! Coulomb friction f_c add K ≤ 2 f_c/Δ (Abbott and Okamura 2005). The grasped body is taken to stand still,
//! as it does against a stiff wall: the device then renders the coupling alone. A body that moves
//! is in series with it, which makes the port softer, and so does a contact less stiff than the wall.
//!
//! # Delay
//!
//! A force that arrives a time t_d after its sample, t_d = (n + φ) T with n whole and 0 ≤ φ < 1, needs more.
//! The condition of Colgate and Schenkel for a law H(z), derived like theirs, becomes
//!
//! b > ½ (Re qσ + √((Re qσ)² + |q|² (1 − |σ|²))), with z = e^(jωT),
//! q = T/(2 (1 − cos ωT)) (1 − z⁻¹) z⁻ⁿ H(z) and σ = 1 − φ + φ z⁻¹,
//!
//! at all frequencies up to half the sampling rate: the hand's motion between samples no longer cancels if
//! the force changes between them. For whole periods (φ = 0) the right-hand side is Re q: the delay
//! multiplies H by z⁻ⁿ. It is a norm of q plus a term linear in q, so that a sum of laws needs at most the
//! sum of the dampings that each needs. A spring needs most as ω goes to 0: b > K h with the effective delay
//!
//! h = T/2 + t_d + T² φ (1 − φ)/(4 (T/2 + t_d)),
//!
//! which is exact for whole periods, where it is T/2 + t_d (Diolaiti et al. 2006), and otherwise too large by
//! less than 0.6 % (the test named below).
//!
//! # Dampers
//!
//! With a damper B beside the spring the condition without delay is b > K T/2 + B, which leaves no room for
//! critical damping of a body of 0.1 kg. But the condition is hardest at high frequencies, where a velocity
//! from differences of position through a first-order lag τ is small. With the backward-Euler lag's gain g =
//! T/(τ + T), H(z) = K + B g (1 − z⁻¹)/(T (1 − (1 − g) z⁻¹)). Without delay the condition becomes b > K T/2 −
//! B g (cos ωT − 1 + g)/(1 − 2 (1 − g) cos ωT + (1 − g)²), whose right-hand side grows with ω: it is hardest
//! at ωT = π, where b > K T/2 + B T/(2 τ + T). With a delay the worst frequency has no closed form; the bound
//!
//! b > K h + B min(1, h/(τ + T/2))
//!
//! is sufficient at every frequency, numerically (the test
//! `with_a_delay_the_bound_is_above_the_general_condition_and_near_it`). It is exact without delay, and close
//! if the lag is long against the delay: a lagged damper is then a spring B/τ that relaxes in τ.
//!
//! The force responds to an encoder step Δ with K Δ + B Δ/(τ + T) at once, so that friction absorbs it, as
//! for the spring alone, if K + B/(τ + T) ≤ 2 f_c/Δ, whatever the delay.
//!
//! So the damper stays critical for the body, and the device's velocity gets the lag that the
//! device's damping requires ([`PortAxes::velocity_lag`]). The lag grows with the body's mass; a damper that
//! lags by much is felt as a spring, and the body's own changes of velocity, as at each facet that it slides
//! over, as jolts of B Δv. Heavy bodies are therefore damped by less ([`VirtualCoupling::damped_within`]).
//! The body's own motion is damped without lag. For a
//! free body the port stays passive at every frequency: with m = k = 1 and damping B it has Re Z(jω) ∝ B + τ
//! B² + τ² B > 0; with a delay this holds numerically (the test
//! `a_free_body_needs_no_more_than_one_that_stands_still`).
//!
//! # Lever
//!
//! The force of a coupling that acts at a grasp ℓ away from the handle's origin also turns the handle: across
//! the lever it renders s sᵀ k_c + e eᵀ k_θ on (x, φ), with s = (1, ℓ) and e = (0, 1). If its force law needs
//! the damping N_c of a device and its couple N_θ, the device is passive if its damping diag(b, b_θ) is at
//! least s sᵀ N_c + e eᵀ N_θ. As 2 ℓ x φ ≤ ρ ℓ x² + ℓ φ²/ρ for every ρ > 0, this holds if
//!
//! b ≥ (1 + ρ ℓ) N_c and b_θ ≥ N_θ + ℓ (ℓ + 1/ρ) N_c,
//!
//! for each port by itself with its own stiffness and damping; ρ is chosen as √(b/b_θ). This assumes one
//! force law: the velocity of the grasp, v + ω × a, must lag by the same time in v and in ω. If v alone lags
//! less, a hand that turns the handle about a point near the grasp drives the difference of the two, b_c (L_v
//! − L_ω) v, at frequencies at which the device's damping is small against b_c. So a coupling with a lever
//! has one lag, the longer of those that the two ports need, unless the lever is so short that the rest of
//! the device's damping covers the difference.
//!
//! Encoder steps of both ports change the force, by Δ + ℓ Δ_θ at the grasp, and the torque by ℓ times that.
//!
//! For a device that renders forces but no torques none of this holds: turning the handle takes no work
//! and stretches the coupling. Only a grasp at the handle's origin has no such lever.

use palpate_core::Pose;

use crate::body::Body;
use crate::coupling::VirtualCoupling;

/// Stiffness of the coupling if nothing limits it: the upper values of §5.5.1, N/m and N·m/rad.
const STIFFNESS: f64 = 500.0;
const ANGULAR_STIFFNESS: f64 = 3.0;

/// Share used of the stiffness that the maker states as stable. With 1 there is no margin.
const MAKER_SHARE: f64 = 0.5;
/// Share of the device's damping that the spring may need; the rest is for the damper.
const SPRING_SHARE: f64 = 0.5;
/// Share of 2 f_c/Δ that the spring may need; the rest is for the damper.
const FRICTION_SHARE: f64 = 0.5;
/// Share of the device's damping that spring and damper may need together. With 1 there is no margin.
const TOTAL_SHARE: f64 = 0.9;
/// Smallest share of the device's damping for the damper, beside a given spring that needs all. With 0 its
/// lag would be infinite.
const DAMPER_SHARE: f64 = 0.1;
/// Share of the rotation's stiffness that the force at the end of a lever may use; the rest holds the
/// object's orientation.
const LEVER_SHARE: f64 = 0.5;
/// Longest lag of the device's velocity that a coupling needs by default, s. With more, heavy bodies are felt
/// to jolt on facets and encoder steps; with less, they swing longer on the coupling.
pub const LONGEST_LAG: f64 = 0.01;
/// Period for which makers state stable gains, s.
const MAKER_PERIOD: f64 = 1e-3;

/// Times at which a device is read and responds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampling {
    /// Sampling period T, s.
    pub period: f64,
    /// t_d: time from a sample until the wrench computed from it is at the handle, s.
    pub delay: f64,
    /// Lag of the twist that the device reports, s.
    pub velocity_delay: f64,
}

impl Sampling {
    /// The effective delay h (s) of a force that is held for a period: a spring K needs a device of damping K
    /// h.
    pub fn effective_delay(&self) -> f64 {
        let Self { period, delay, .. } = *self;
        let (middle, part) = (0.5 * period + delay, (delay / period).fract());
        middle + period * period * part * (1.0 - part) / (4.0 * middle)
    }
}

/// Limits of a device along, or about, its axes. Translation in N, m; rotation in N·m, rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PortAxes {
    /// Largest stiffness that the maker states as stable at 1 kHz (N/m, N·m/rad). Infinite if there is no
    /// limit, 0 if nothing is rendered.
    pub stiffness: f64,
    /// Largest virtual damping that the maker states as stable at 1 kHz (N·s/m, N·m·s/rad). Used if
    /// `viscous` is not known.
    pub damping: f64,
    /// Viscous damping b of the handle itself (N·s/m, N·m·s/rad).
    pub viscous: Option<f64>,
    /// Coulomb friction f_c of the handle itself (N, N·m).
    pub friction: Option<f64>,
    /// Largest force (N, N·m); infinite if there is no limit, 0 if nothing is rendered.
    pub peak: f64,
    /// Smallest change of position that is sensed, Δ (m, rad); 0 if positions are not rounded.
    pub step: f64,
}

/// Gains of a coupling at the axes of one port.
#[derive(Clone, Copy, Debug)]
struct Load {
    /// Stiffness, N/m or N·m/rad.
    stiffness: f64,
    /// Damping, N·s/m or N·m·s/rad.
    damping: f64,
    /// Change of the spring's force by an encoder step, N or N·m.
    stiffness_answer: f64,
    /// Change of the damper's force by an encoder step, times its time, N·s or N·m·s.
    damping_answer: f64,
}

impl PortAxes {
    /// The largest stiffness (N/m, N·m/rad) that is rendered passively with the margins of this module;
    /// infinite if nothing limits it.
    ///
    /// It is the smallest of half the maker's, b/(2 h) and f_c/Δ; the latter two if b and f_c are known and
    /// not zero. A maker's value holds at 1 kHz without delay; it is lowered for slower loops and later
    /// wrenches in proportion to the effective delay h, and not raised for faster ones.
    pub fn largest_stiffness(&self, sampling: &Sampling) -> f64 {
        let friction = if self.step > 0.0 { self.largest_answer() / self.step } else { f64::INFINITY };
        self.largest_undamped(sampling).min(friction)
    }

    /// The largest stiffness that the maker's value and the device's damping allow, N/m or N·m/rad.
    fn largest_undamped(&self, sampling: &Sampling) -> f64 {
        let delay = sampling.effective_delay();
        let maker = MAKER_SHARE * self.stiffness * (0.5 * MAKER_PERIOD / delay).min(1.0);
        maker.min(positive(self.viscous).map_or(f64::INFINITY, |b| SPRING_SHARE * b / delay))
    }

    /// Largest change of a spring's force by an encoder step, N or N·m.
    fn largest_answer(&self) -> f64 {
        positive(self.friction).map_or(f64::INFINITY, |friction| FRICTION_SHARE * 2.0 * friction)
    }

    /// The lag τ (s) of the device's velocity with which `damping` (N·s/m, N·m·s/rad) beside `stiffness`
    /// (N/m, N·m/rad) is rendered passively; 0 if any lag will do.
    ///
    /// Spring and damper may need nine tenths of b together, and of 2 f_c/Δ, and the damper has at least a
    /// tenth. If b is not known, the damper may need as much as the maker's damping needs through the
    /// device's own lag.
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
        // B h/(τ + T/2) ≤ room for sampling, and B Δ/(τ + T) ≤ rounding room for the encoders, solved for τ.
        let usable = |lag: f64| if lag.is_finite() { lag.max(0.0) } else { 0.0 };
        let room = self.room(load.stiffness, sampling);
        let sampled = load.damping * sampling.effective_delay() / room - 0.5 * sampling.period;
        let sampled = if load.damping <= room { 0.0 } else { usable(sampled) };
        let rounded = load.damping_answer / self.rounding_room(load.stiffness_answer) - sampling.period;
        sampled.max(usable(rounded))
    }

    /// Largest share of a load's damping that needs a lag of at most [`LONGEST_LAG`], up to 1.
    fn share_within(&self, load: &Load, sampling: &Sampling) -> f64 {
        let room = self.room(load.stiffness, sampling);
        if !self.is_rendered() || room <= 0.0 {
            return 1.0;
        }
        let sampled =
            room * (LONGEST_LAG + 0.5 * sampling.period) / (load.damping * sampling.effective_delay());
        let rounding = self.rounding_room(load.stiffness_answer);
        let rounded = rounding * (LONGEST_LAG + sampling.period) / load.damping_answer;
        sampled.min(rounded).min(1.0)
    }

    /// The largest damping (N·s/m, N·m·s/rad) that is passive beside a coupling on a velocity that lags by
    /// `lag` (s): the bound of [`Self::velocity_lag`]. Infinite if nothing limits it.
    fn largest_damping(&self, load: &Load, lag: f64, sampling: &Sampling) -> f64 {
        let gain = ((lag + 0.5 * sampling.period) / sampling.effective_delay()).max(1.0);
        let sampled = self.room(load.stiffness, sampling) * gain;
        if self.step > 0.0 {
            sampled.min(self.rounding_room(load.stiffness_answer) * (lag + sampling.period) / self.step)
        } else {
            sampled
        }
    }

    /// Largest change of a damper's force by an encoder step beside the spring's `answer`, N or N·m.
    fn rounding_room(&self, answer: f64) -> f64 {
        positive(self.friction).map_or(f64::INFINITY, |friction| {
            let whole = 2.0 * friction;
            (TOTAL_SHARE * whole - answer).max(DAMPER_SHARE * whole)
        })
    }

    /// Part of the device's damping that a damper may need beside a stiffness, N·s/m or N·m·s/rad.
    fn room(&self, stiffness: f64, sampling: &Sampling) -> f64 {
        match positive(self.viscous) {
            Some(b) => (TOTAL_SHARE * b - stiffness * sampling.effective_delay()).max(DAMPER_SHARE * b),
            // The damping that the maker's stable damping needs at 1 kHz, or at the rate of a faster loop; a
            // delay does not raise it.
            None => {
                let half = 0.5 * sampling.period.min(MAKER_PERIOD);
                self.damping * half / (sampling.velocity_delay + half)
            }
        }
    }

    /// The damping (N·s/m, N·m·s/rad) with which a device renders `stiffness`, and `damping` on a velocity
    /// with a lag (s), passively: K h + B min(1, h/(τ + T/2)).
    pub fn needed_viscous(stiffness: f64, damping: f64, lag: f64, sampling: &Sampling) -> f64 {
        let delay = sampling.effective_delay();
        stiffness * delay + damping * (delay / (lag + 0.5 * sampling.period)).min(1.0)
    }

    /// b, or the smallest damping that the maker's stiffness implies, K T/2; infinite if there is no limit.
    fn supposed_viscous(&self) -> f64 {
        positive(self.viscous).unwrap_or(0.5 * MAKER_PERIOD * self.stiffness)
    }

    fn is_rendered(&self) -> bool {
        self.peak > 0.0
    }

    /// The stiffness to use: a limit, or `otherwise` if there is no limit or nothing is rendered.
    fn usable_or(&self, limit: f64, otherwise: f64) -> f64 {
        if self.is_rendered() && limit > 0.0 && limit.is_finite() { limit } else { otherwise }
    }

    /// The limit of the coupling's spring; infinite for axes that are not rendered, which still have to move
    /// the object.
    fn spring_limit(&self) -> f64 {
        if self.is_rendered() { self.peak } else { f64::INFINITY }
    }

    /// The same in a world in which forces are `force` times and lengths `length` times as large.
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

/// Limits of a device, and the rate at which it is driven.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PortLimits {
    /// Limits along the axes.
    pub translation: PortAxes,
    /// Limits about the axes.
    pub rotation: PortAxes,
    /// ℓ: distance of the coupling's grasp from the handle's origin, m.
    pub lever: f64,
    /// Times at which the device is read and responds.
    pub sampling: Sampling,
}

/// Load of a coupling's force on each port: the translation's, and the rotation's in m².
#[derive(Clone, Copy, Debug)]
struct LeverShares {
    translation: f64,
    rotation: f64,
}

impl PortLimits {
    /// The same limits for a coupling that acts at a distance from the handle's origin, m.
    #[must_use]
    pub fn with_lever(self, lever: f64) -> Self {
        Self { lever, ..self }
    }

    /// The limits in a world in which the device moves `scale` times as far (see
    /// [`DeviceMapping`](crate::DeviceMapping)): forces are `scale` times as large, torques and the gains of
    /// rotation `scale`² times; stiffness and damping of translation are the same.
    pub fn in_world(&self, scale: f64) -> Self {
        Self {
            translation: self.translation.scaled(scale, scale),
            rotation: self.rotation.scaled(scale * scale, 1.0),
            lever: self.lever * scale,
            ..*self
        }
    }

    /// The lags (s) of the device's velocity and angular velocity with which `coupling` is passive at the
    /// port; 0 if the device's own twist can be used. See [`PortAxes::velocity_lag`]. They
    /// are equal if the coupling acts at a lever.
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

    /// The lags (s) for a coupling whose damping was lowered from a `critical` one's
    /// ([`VirtualCoupling::damped_within`]): those that the critical one would need, up to twice the longest
    /// that the lowered one does. The longer they are, the less a hand feels of encoder steps; the swing of a
    /// heavy body is so slow that it is damped all the same.
    pub fn long_lags(&self, coupling: &VirtualCoupling, critical: &VirtualCoupling) -> (f64, f64) {
        let (needed, long) = (self.velocity_lags(coupling), self.velocity_lags(critical));
        let lag = |needed: f64, long: f64| needed.max(long.min(2.0 * LONGEST_LAG));
        (lag(needed.0, long.0), lag(needed.1, long.1))
    }

    /// Largest damping (N·s/m, N·m·s/rad) that is passive at the handle's origin beside the springs of a
    /// coupling, on velocities that lag by [`Self::velocity_lags`].
    pub fn largest_dampings(&self, coupling: &VirtualCoupling) -> (f64, f64) {
        let (translation, rotation) = self.loads(coupling);
        let (lag, angular_lag) = self.velocity_lags(coupling);
        let largest = |axes: &PortAxes, load: &Load, lag: f64| {
            axes.largest_damping(load, lag.max(self.sampling.velocity_delay), &self.sampling)
        };
        (largest(&self.translation, &translation, lag), largest(&self.rotation, &rotation, angular_lag))
    }

    /// Whether v and ω of the grasp must have the same lag: different ones may need b_c ℓ ρ of b and b_c ℓ/ρ
    /// of b_θ, for which only the rest beyond [`TOTAL_SHARE`] is available.
    fn has_one_lag(&self, coupling: &VirtualCoupling) -> bool {
        let damping = self.translation.supposed_viscous() * self.rotation.supposed_viscous();
        let rendered = self.translation.is_rendered() && self.rotation.is_rendered();
        rendered && coupling.linear_damping * self.lever > (1.0 - TOTAL_SHARE) * damping.sqrt()
    }

    /// Gains of a coupling at the ports of translation and of rotation.
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

    /// 1 + ρ ℓ and ℓ (ℓ + 1/ρ). If one of the ports is not rendered, or has no limit, the force loads the
    /// other one alone.
    fn lever_shares(&self) -> LeverShares {
        let ratio = (self.translation.supposed_viscous() / self.rotation.supposed_viscous()).sqrt();
        let rendered = self.translation.is_rendered() && self.rotation.is_rendered();
        if rendered && ratio > 0.0 && ratio.is_finite() {
            let rotation = self.lever * (self.lever + ratio.recip());
            return LeverShares { translation: 1.0 + ratio * self.lever, rotation };
        }
        LeverShares { translation: 1.0, rotation: self.lever * self.lever }
    }

    /// Displacement of the grasp by a step of each encoder, m.
    fn step_at_grasp(&self) -> f64 {
        self.translation.step + self.lever * self.rotation.step
    }

    /// The stiffest springs (N/m, N·m/rad) that are passive with the margins of this module. A lever uses at
    /// most half of the rotation's stiffness; if it needs more, the spring of the translation is made softer.
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
    /// Makes a coupling for `body` held at `grasp` by a device with the given limits. Its springs are as
    /// stiff as the device renders passively with a margin ([`PortAxes::largest_stiffness`]), with its
    /// [lever](PortLimits::lever) accounted for, no stronger than the device, and damped critically
    /// ([`Self::critically_damped`]), for heavy bodies less ([`Self::damped_within`]). They have 500 N/m and
    /// 3 N·m/rad, the upper values of §5.5.1, if nothing limits the stiffness or nothing is rendered.
    ///
    /// The damper is passive at the port only with the lag of [`PortLimits::velocity_lags`].
    pub fn auto(body: &Body, grasp: Pose, limits: &PortLimits) -> Self {
        let (linear, angular) = limits.stiffest();
        Self::critically_damped(body, grasp, linear, angular).limited_to(limits).damped_within(limits)
    }

    /// Lowers the damping to what needs a lag of the device's velocity of at most [`LONGEST_LAG`].
    pub fn damped_within(mut self, limits: &PortLimits) -> Self {
        let PortLimits { translation, rotation, sampling, .. } = limits;
        let loads = limits.loads(&self);
        let linear = translation.share_within(&loads.0, sampling);
        let angular = rotation.share_within(&loads.1, sampling);
        // At a lever the force loads the rotation, too.
        self.linear_damping *= if limits.lever > 0.0 { linear.min(angular) } else { linear };
        self.angular_damping *= angular;
        self
    }

    /// Limits the springs to the peaks of a device, so that pressing harder than it can
    /// render does not press the body deeper (§5.3.3).
    pub fn limited_to(mut self, limits: &PortLimits) -> Self {
        self.max_force = limits.translation.spring_limit();
        self.max_torque = limits.rotation.spring_limit();
        self
    }
}

#[cfg(test)]
mod tests;
