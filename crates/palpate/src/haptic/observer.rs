//! The handle's motion between the steps of its encoders.
//!
//! A reading q that is rounded to whole steps Δ says that the position is within Δ/2 of it, its cell, and no
//! more. A force that follows readings changes by (K + B/(τ + T)) Δ at each step, for a spring K and a damper
//! B on a velocity with the lag τ: at 500 N/m and 30 µm by up to 54 mN, which a hand feels.
//!
//! [`StepObserver`] estimates the position x̂, velocity and acceleration of each axis. It predicts x̂ from
//! the two, draws it towards the reading with a critically damped tracker of third order (three equal poles
//! at −ω), and clamps it to the cell. What the clamp moves corrects velocity and acceleration, too, and
//! raises ω for a short time. So a steady motion, or a steadily accelerated one, becomes a smooth curve, a
//! motion that changes is followed at once, and a handle at rest is exactly at rest, at the reading. The
//! fewer steps a second, the slower the tracker: it must not follow the staircase of the readings.
//!
//! # Passivity
//!
//! The coupling acts on x̂, and its damper on differences of x̂ through the lag: the law of
//! `palpate_dynamics`'s port with x̂ in place of the position x. Nothing filters it beyond the cell: x̂ and x
//! are in one cell, so that the spring's force is off by at most K Δ, and the damper's as that of a spring
//! B/(τ + T) that relaxes. The worst estimate trails at the edge that x came from. Over a cell it is off by
//! Δ/2 on average, so that a spring gives K Δ²/2 that it did not take, while friction takes f_c Δ. Friction
//! absorbs it if K ≤ 2 f_c/Δ: the condition of Abbott and Okamura for readings themselves, which the port's
//! gains keep with a margin. The limit at which friction still brings a handle to rest against a spring is
//! that of readings to within a few per cent (the test `friction_absorbs_estimates_as_it_absorbs_readings`).
//!
//! Friction does not resist small vibrations of a handle that slides. For them, within the cell, the tracker
//! is a linear filter 1 − s³/(s + ω)³, which asks hand and device for a damping of up to 0.38 (K + B/(τ +
//! T))/ω. A vibration that reaches beyond the cell raises ω. So a handle that slides evenly, or that neither
//! friction nor a hand damps, may vibrate by one or two steps, as it does on readings. Where the damper lags
//! far behind, beyond [`LONGEST_LAG`], it would vibrate further, and the readings are taken as they are.
//!
//! The lag that the port's law counts is that of the damper's velocity, a difference of estimates: they add
//! less than a millisecond to motions of many steps, and no more than Δ/(τ + T) to any velocity.

use palpate_core::glam::DVec3;

/// Smallest and largest ω of the tracker in even motion, rad/s. With less, it trails behind a hand's
/// acceleration, and the clamp passes the rounding on; with more, it follows the rounding.
const EVEN_RATES: (f64, f64) = (15.0, 40.0);

/// ω in even motion for each step in a second, rad. With more, the tracker follows the staircase of slow
/// readings.
const RATE_BY_STEPS: f64 = 0.35;

/// Largest ω, rad/s. With less, a vibrating handle is followed too late.
const FASTEST_RATE: f64 = 400.0;

/// Rise of ω, relative to that of even motion, for a clamp by one step. With more, the tracker follows the
/// rounding after each change of motion; with less, it lags behind vibrations.
const RISE_BY_STEP: f64 = 3.0;

/// Time in which ω falls back, s.
const RISE_TIME: f64 = 0.03;

/// Longest time between two readings over which motion is predicted, s.
const LONGEST_INTERVAL: f64 = 0.025;

/// Longest lag of a damper's velocity with which motion is estimated, s: that of couplings as they are by
/// default, with room for rounding. A damper that lags by more damps the handle's swing on the coupling
/// hardly at all, and an estimate that trails would let the swing grow further than readings do (the test
/// `estimates_let_a_handle_swing_by_less_than_readings`).
const LONGEST_LAG: f64 = 2.001 * palpate_dynamics::LONGEST_LAG;

/// Distance from the reading, in steps, below which a handle is at rest: with none, the tracker would
/// approach it for ever.
const REST: f64 = 1e-6;

/// Estimates the motion of three axes from readings that are rounded to steps.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct StepObserver {
    /// Δ, m or rad; with 0 the estimates are the readings.
    step: f64,
    /// x̂ less the reading: at most half a step by axis.
    offset: DVec3,
    velocity: DVec3,
    acceleration: DVec3,
    /// Rise of ω relative to that of even motion.
    rise: DVec3,
}

impl StepObserver {
    /// Starts at rest at the reading, with steps in m or rad, for a damper on a velocity with a lag (s).
    pub fn new(step: f64, lag: f64) -> Self {
        let step = if step.is_finite() && lag <= LONGEST_LAG { step.max(0.0) } else { 0.0 };
        Self { step, ..Self::default() }
    }

    /// Sets the steps (m or rad) and the damper's lag, s. If it estimates from now on, or no more, it starts
    /// anew at the reading.
    pub fn set(&mut self, step: f64, lag: f64) {
        let new = Self::new(step, lag);
        if new.step != self.step {
            *self = new;
        }
    }

    /// The estimate less the reading, m or rad.
    pub fn offset(&self) -> DVec3 {
        self.offset
    }

    /// Starts anew at the reading.
    pub fn reset(&mut self) {
        *self = Self { step: self.step, ..Self::default() };
    }

    /// Stops the estimate where it is.
    pub fn rest(&mut self) {
        let offset = self.offset;
        self.reset();
        self.offset = offset;
    }

    /// Takes a reading that moved by `moved` (m or rad) in a time T (s, above 0). Returns the displacement of
    /// the estimate.
    pub fn advance(&mut self, moved: DVec3, interval: f64) -> DVec3 {
        let Self { step, offset: before, .. } = *self;
        if step == 0.0 || (self.is_at_rest() && moved == DVec3::ZERO) {
            return moved;
        }
        if interval > LONGEST_INTERVAL {
            self.reset();
            return moved - before;
        }
        let predicted = before - moved + (self.velocity + self.acceleration * (0.5 * interval)) * interval;
        let rate = self.rate();
        let gains = Gains::new(rate * interval);
        self.velocity += self.acceleration * interval;
        let tracked = predicted - gains.position * predicted;
        self.correct(&gains, -predicted, interval);

        let half = DVec3::splat(0.5 * step);
        self.offset = tracked.clamp(-half, half);
        let cut = self.offset - tracked;
        self.correct(&gains, cut, interval);
        let rise = cut.abs() * (RISE_BY_STEP / step);
        self.rise = (self.rise + rise) / (1.0 + interval / RISE_TIME);
        self.settle(interval);
        moved + self.offset - before
    }

    /// ω of the tracker, rad/s.
    fn rate(&self) -> DVec3 {
        let steps = self.velocity.abs() / self.step;
        let (least, most) = EVEN_RATES;
        let even = (RATE_BY_STEPS * steps).clamp(DVec3::splat(least), DVec3::splat(most));
        (even * (1.0 + self.rise)).min(DVec3::splat(FASTEST_RATE))
    }

    /// Corrects velocity and acceleration by an error of the predicted position.
    fn correct(&mut self, gains: &Gains, error: DVec3, interval: f64) {
        self.velocity += gains.velocity * error / interval;
        self.acceleration += gains.acceleration * error / (interval * interval);
    }

    fn is_at_rest(&self) -> bool {
        self.offset == DVec3::ZERO && self.velocity == DVec3::ZERO && self.acceleration == DVec3::ZERO
    }

    /// Puts axes to rest that have come close to their readings.
    fn settle(&mut self, interval: f64) {
        let reach =
            self.offset.abs() + (self.velocity.abs() + self.acceleration.abs() * LONGEST_INTERVAL) * interval;
        let moves = reach.cmpgt(DVec3::splat(REST * self.step));
        let kept = |value: DVec3| DVec3::select(moves, value, DVec3::ZERO);
        self.offset = kept(self.offset);
        self.velocity = kept(self.velocity);
        self.acceleration = kept(self.acceleration);
        self.rise = kept(self.rise);
    }
}

/// Gains of a critically damped tracker of third order, by axis: shares of an error that position, velocity
/// times T, and acceleration times T² are corrected by.
struct Gains {
    position: DVec3,
    velocity: DVec3,
    acceleration: DVec3,
}

impl Gains {
    /// Gains with three equal poles at 1/(1 + ωT), for ωT by axis.
    fn new(rate: DVec3) -> Self {
        let rest = (1.0 + rate).recip();
        let share = 1.0 - rest;
        let square = share * share;
        Self {
            position: 1.0 - rest * rest * rest,
            velocity: 1.5 * square * (1.0 + rest),
            acceleration: square * share,
        }
    }
}

#[cfg(test)]
mod tests;
