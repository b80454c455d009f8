//! Gains of the virtual coupling that a sampled device renders passively.
//!
//! A device of viscous damping b that renders a spring K sampled every T, with the force held between
//! samples, is passive whoever holds it if b > K T/2 (Colgate and Schenkel 1997). Position in steps of Δ and
//! Coulomb friction f_c add K ≤ 2 f_c/Δ (Abbott and Okamura 2005). The grasped body is taken to stand still,
//! as it does against a stiff wall: the coupling alone is then what the device renders. A body that gives way
//! is in series with it, which makes the port softer, and so does a contact less stiff than the wall.
//!
//! # Delay
//!
//! A force that is there t_d after its sample, t_d = (n + φ) T with n whole and 0 ≤ φ < 1, costs more. The
//! condition of Colgate and Schenkel for a law H(z), derived as theirs, becomes
//!
//! b > ½ (Re qσ + √((Re qσ)² + |q|² (1 − |σ|²))), with z = e^(jωT),
//! q = T/(2 (1 − cos ωT)) (1 − z⁻¹) z⁻ⁿ H(z) and σ = 1 − φ + φ z⁻¹,
//!
//! at all frequencies up to half the sampling rate: what the hand does between the samples no longer cancels
//! where the force changes there. For whole periods (φ = 0) the right-hand side is Re q: the delay multiplies
//! H by z⁻ⁿ. It is a norm of q plus what is linear in q, so that what a sum of laws needs is at most the sum
//! of what each needs. A spring needs most where ω goes to 0: b > K h with the effective delay
//!
//! h = T/2 + t_d + T² φ (1 − φ)/(4 (T/2 + t_d)),
//!
//! exact for whole periods, where it is T/2 + t_d (Diolaiti et al. 2006), and else too much by less than 0.6
//! % (the same test).
//!
//! # Dampers
//!
//! With a damper B beside the spring the condition without delay is b > K T/2 + B, which no damping leaves
//! room for that is critical for a body of 0.1 kg. But the force that counts is the one at high frequencies,
//! where a velocity from differences of position through a first-order lag τ is small. With g = T/(τ + T) the
//! backward-Euler lag's weight, H(z) = K + B g (1 − z⁻¹)/(T (1 − (1 − g) z⁻¹)). Without delay the condition
//! becomes b > K T/2 − B g (cos ωT − 1 + g)/(1 − 2 (1 − g) cos ωT + (1 − g)²), whose right-hand side grows
//! with ω: it is hardest at ωT = π, and there b > K T/2 + B T/(2 τ + T). With a delay the worst frequency has
//! no closed form; the bound
//!
//! b > K h + B min(1, h/(τ + T/2))
//!
//! is enough at every frequency, by the numbers (the test
//! `with_a_delay_the_bound_is_above_the_general_condition_and_near_it`). It is exact without delay, and close
//! where the lag is long against the delay: a lagged damper is then a spring B/τ that lets go in τ.
//!
//! A step Δ of the encoder answers with K Δ + B Δ/(τ + T) at once, so that what friction absorbs is, as for
//! the spring alone, K + B/(τ + T) ≤ 2 f_c/Δ, whatever the delay.
//!
//! So the damper stays critical for the body, and it is the device's velocity that is given the lag which the
//! device's damping asks for ([`PortAxes::velocity_lag`]). The body's own motion is damped without lag. For a
//! free body the port stays passive at every frequency: with m = k = 1 and damping B it has Re Z(jω) ∝ B + τ
//! B² + τ² B > 0; with a delay that is found by the numbers (the test
//! `a_free_body_needs_no_more_than_one_that_stands_still`).
//!
//! # Lever
//!
//! A coupling that acts at a grasp ℓ away from the handle's origin turns the handle by its force: across the
//! lever it renders s sᵀ k_c + e eᵀ k_θ on (x, φ), with s = (1, ℓ) and e = (0, 1). If N_c is what its force
//! law needs of a device, and N_θ what its couple needs, the device is passive if its damping diag(b, b_θ) is
//! at least s sᵀ N_c + e eᵀ N_θ. As 2 ℓ x φ ≤ ρ ℓ x² + ℓ φ²/ρ for every ρ > 0, it is so if
//!
//! b ≥ (1 + ρ ℓ) N_c and b_θ ≥ N_θ + ℓ (ℓ + 1/ρ) N_c,
//!
//! each port by itself with a stiffness and a damping of its own; ρ is taken as √(b/b_θ). This takes one law
//! of the force: the velocity of the grasp, v + ω × a, must lag by one and the same time in v and in ω. Where
//! v alone lags less, a hand that turns the handle about a point near the grasp drives the difference of the
//! two, b_c (L_v − L_ω) v, at frequencies at which the device's damping is small against b_c. So a coupling
//! with a lever has one lag, the longer of what the two ports ask for, unless the lever is so short that the
//! rest of the device's damping makes up for it.
//!
//! An encoder's steps reach the force both ways, Δ + ℓ Δ_θ at the grasp, and the torque by ℓ times that.
//!
//! Where forces reach the hand and torques do not, nothing of this holds: turning the handle costs nothing
//! and stretches the coupling. Only a grasp at the handle's origin has no such lever.

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
/// Share of the rotation's stiffness that the force at the end of a lever may take of it: half, so that the
/// object's orientation is held as well.
const LEVER_SHARE: f64 = 0.5;
/// The period that makers state stable gains for, s.
const MAKER_PERIOD: f64 = 1e-3;

/// Sampling of a device: when it is read and when it answers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampling {
    /// Sampling period T, s.
    pub period: f64,
    /// t_d: how long after a sample the wrench that answers it is at the handle, s.
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
    /// Largest stiffness that the maker calls stable at 1 kHz (N/m, N·m/rad). Infinite if there is no limit,
    /// 0 if nothing is rendered.
    pub stiffness: f64,
    /// Largest virtual damping that the maker calls stable at 1 kHz (N·s/m, N·m·s/rad). Used where `viscous`
    /// is not known.
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

/// Gains of a coupling as the axes of one port see them.
#[derive(Clone, Copy, Debug)]
struct Load {
    /// N/m or N·m/rad; N·s/m or N·m·s/rad.
    stiffness: f64,
    damping: f64,
    /// Change of spring and damper force by a step of the encoders: N or N·m; N·s or N·m·s.
    stiffness_answer: f64,
    damping_answer: f64,
}

impl PortAxes {
    /// The largest stiffness (N/m, N·m/rad) that is rendered passively with the margins of this module:
    /// infinite if nothing limits it.
    ///
    /// The least of half the maker's, b/(2 h), f_c/Δ; the latter two where b and f_c are known and not zero.
    /// A maker's figure holds at 1 kHz without delay; it is lowered for slower loops and later wrenches in
    /// proportion to the effective delay h, and not raised for faster ones.
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

    /// Largest change of a spring's force by a step of the encoders, N or N·m.
    fn largest_answer(&self) -> f64 {
        positive(self.friction).map_or(f64::INFINITY, |friction| FRICTION_SHARE * 2.0 * friction)
    }

    /// The lag τ (s) of the device's velocity with which `damping` (N·s/m, N·m·s/rad) beside `stiffness`
    /// (N/m, N·m/rad) is rendered passively; 0 if any lag does.
    ///
    /// Spring and damper may need nine tenths of b together, and of 2 f_c/Δ, and the damper has a tenth
    /// whatever the spring needs. If b is not known, the damper may need what the maker's damping needs
    /// through the device's own lag.
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

    /// Largest change of a damper's force by a step of the encoders, times τ + T, besides the spring's: N or
    /// N·m.
    fn rounding_room(&self, answer: f64) -> f64 {
        positive(self.friction).map_or(f64::INFINITY, |friction| {
            let whole = 2.0 * friction;
            (TOTAL_SHARE * whole - answer).max(DAMPER_SHARE * whole)
        })
    }

    /// Largest damping that a damper may need of the device, N·s/m or N·m·s/rad.
    fn room(&self, stiffness: f64, sampling: &Sampling) -> f64 {
        match positive(self.viscous) {
            Some(b) => (TOTAL_SHARE * b - stiffness * sampling.effective_delay()).max(DAMPER_SHARE * b),
            // What the maker's damping needs at 1 kHz, or at the rate of a faster loop. No delay makes it
            // more.
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

/// Limits of a device, and the rate at which it is driven.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PortLimits {
    /// Along the axes.
    pub translation: PortAxes,
    /// About the axes.
    pub rotation: PortAxes,
    /// ℓ: how far from the handle's origin the coupling acts, m.
    pub lever: f64,
    /// Times at which the device is read and answers.
    pub sampling: Sampling,
}

/// Load of a coupling's force on each port: the translation's, and the rotation's in m².
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
    /// [`DeviceMapping`](crate::DeviceMapping)): forces `scale` times as large, torques and what goes with
    /// them `scale`² times, stiffness and damping of translation the same.
    pub fn in_world(&self, scale: f64) -> Self {
        Self {
            translation: self.translation.scaled(scale, scale),
            rotation: self.rotation.scaled(scale * scale, 1.0),
            lever: self.lever * scale,
            ..*self
        }
    }

    /// The lags (s) of the device's velocity and angular velocity with which `coupling` is passive at the
    /// port; 0 where the twist that the device reports will do as it is. See [`PortAxes::velocity_lag`]. They
    /// are equal where the coupling acts at a lever.
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

    /// Whether the velocity of the grasp must lag by one time: different ones may need b_c ℓ ρ of b and b_c
    /// ℓ/ρ of b_θ, for which there is what [`TOTAL_SHARE`] leaves.
    fn has_one_lag(&self, coupling: &VirtualCoupling) -> bool {
        let damping = self.translation.supposed_viscous() * self.rotation.supposed_viscous();
        let rendered = self.translation.is_rendered() && self.rotation.is_rendered();
        rendered && coupling.linear_damping * self.lever > (1.0 - TOTAL_SHARE) * damping.sqrt()
    }

    /// Gains of a coupling for translation and for rotation.
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

    /// 1 + ρ ℓ and ℓ (ℓ + 1/ρ). Where one of the ports is not rendered, or has no limit, the force loads the
    /// other by itself.
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

    /// The stiffest springs (N/m, N·m/rad) that are passive with the margins of this module. A lever takes of
    /// the rotation's stiffness no more than half, and makes the translation's softer where that is not
    /// enough.
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
    /// renders passively with a margin ([`PortAxes::largest_stiffness`]), its [lever](PortLimits::lever)
    /// counted, and no stronger than it, and damped critically ([`Self::critically_damped`]). 500 N/m and 3
    /// N·m/rad, the upper values of §5.5.1, where nothing limits the stiffness or nothing is rendered.
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
mod tests;
