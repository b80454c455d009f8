//! Tracking of a device's readings: bad ones are replaced by the last good one, jumps are refused, motion
//! between encoder steps is [estimated](super::observer), and velocities are filtered for the coupling's
//! damper.

use palpate_core::glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist};
use palpate_device::{DeviceState, Status};

use crate::haptic::observer::StepObserver;
use crate::telemetry::Events;

/// Largest speeds of a handle in a hand, m/s and rad/s. Faster motion is a jump of the device.
const MAX_SPEED: (f64, f64) = (10.0, 100.0);

/// Number of consecutive readings, each reachable from the one before, after which a jump is accepted. With
/// fewer, a short fault of the device moves the hand.
const ACCEPT_AFTER: u32 = 5;

/// Time for which bad readings are replaced by the last good one, s. After that the device counts as lost.
const MAX_HOLD: f64 = 0.01;

/// Time without a new reading after which the device counts as lost, s.
const MAX_STALE: f64 = 0.025;

/// Weight of time with refused readings relative to time with good ones. A faulty device sometimes reports a
/// pose that a hand could have reached; with a smaller weight such a pose is trusted.
const FAULT_WEIGHT: f64 = 4.0;

/// Weighted time with refused readings above which no reading is taken, s: that of the longest hold.
const MAX_DOUBT_TRUSTED: f64 = FAULT_WEIGHT * MAX_HOLD;

/// Largest weighted time with refused readings that is counted, s. It bounds the time until a device is
/// trusted again.
const MAX_DOUBT: f64 = 1.5 * MAX_DOUBT_TRUSTED;

/// Smallest time between two readings for a velocity, in periods. The time stamps of two that arrive at once
/// are too inaccurate.
const MIN_INTERVAL: f64 = 0.25;

/// Velocities below this are set to 0, m/s and rad/s: through a lag they would decay for ever.
const MIN_SPEED: f64 = 1e-12;

/// Outcome of a reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reading {
    /// The reading was taken.
    Good,
    /// The reading is the same as before: its velocity is kept.
    Stale,
    /// The reading was refused; the last good one is held at rest.
    Held,
    /// The reading is the first one taken, or the first after the device was lost or jumped: the displacement
    /// since the last is set to 0.
    Back,
    /// The device does not answer, or has given no good reading for too long; the last good one is held at
    /// rest.
    Lost,
}

impl Reading {
    /// The worse of the readings of two ports that are used together; a stale one counts as good.
    pub fn or_worse(self, other: Self) -> Self {
        let either = |reading: Self| self == reading || other == reading;
        [Self::Lost, Self::Back, Self::Held]
            .into_iter()
            .find(|&reading| either(reading))
            .unwrap_or(Self::Good)
    }
}

/// The tracked state of the device, in device axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tracking {
    state: DeviceState,
    /// Displacement of the handle since the reading before: m, and rad as a rotation vector.
    displacement: Twist,
    /// Time since the last good reading, s.
    blind: f64,
    started: bool,
    /// Whether the device stamps its readings. Then an unchanged stamp means an unchanged reading.
    stamped: bool,
    /// Whether the device counts as lost.
    lost: bool,
    /// Time with good readings that is needed to make up for refused ones, s.
    doubt: f64,
    /// Pose that the device jumped to, and the number of readings there.
    suspect: Option<(Pose, u32)>,
    /// Lags of the velocity and the angular velocity, s; with 0 the device's own is taken.
    lags: (f64, f64),
    /// Velocities filtered through these lags.
    lagged: Twist,
    /// The encoders' steps, m and rad; 0 if readings are not rounded, or it is not known.
    steps: (f64, f64),
    /// Position and orientation between these steps.
    observers: (StepObserver, StepObserver),
    /// The pose that they estimate.
    estimated: Pose,
    period: f64,
}

impl Tracking {
    pub fn new(state: DeviceState, lags: (f64, f64), period: f64) -> Self {
        Self {
            state,
            displacement: Twist::ZERO,
            blind: 0.0,
            started: false,
            stamped: false,
            lost: false,
            doubt: 0.0,
            suspect: None,
            lags,
            lagged: Twist::ZERO,
            steps: (0.0, 0.0),
            observers: Default::default(),
            estimated: state.pose,
            period,
        }
    }

    /// Estimates the motion between encoder steps (m, rad) where the lags allow it; with steps of 0 the
    /// readings are taken as they are.
    #[must_use]
    pub fn between_steps(mut self, steps: (f64, f64)) -> Self {
        self.steps = steps;
        self.set_lags(self.lags);
        self
    }

    /// Changes the lags of the velocities, which continue from their present values.
    pub fn set_lags(&mut self, lags: (f64, f64)) {
        let twist = self.damped_state().twist;
        self.lagged = twist;
        self.lags = lags;
        self.observers.0.set(self.steps.0, lags.0);
        self.observers.1.set(self.steps.1, lags.1);
        self.estimated = self.estimate();
    }

    /// Lags of velocity and angular velocity, s; 0 where the device's own is taken.
    pub fn lags(&self) -> (f64, f64) {
        self.lags
    }

    /// The last good state, its twist zero while it is held.
    pub fn state(&self) -> &DeviceState {
        &self.state
    }

    /// The last good state with pose and velocities for the coupling: the pose is estimated between encoder
    /// steps.
    pub fn damped_state(&self) -> DeviceState {
        let Twist { mut linear, mut angular } = self.state.twist;
        if self.lags.0 > 0.0 {
            linear = self.lagged.linear;
        }
        if self.lags.1 > 0.0 {
            angular = self.lagged.angular;
        }
        DeviceState { pose: self.estimated, twist: Twist { linear, angular }, ..self.state }
    }

    /// Displacement of the handle in the last call of [`Self::take`].
    pub fn displacement(&self) -> &Twist {
        &self.displacement
    }

    /// Takes a reading, `elapsed` seconds after the one before, or counts why it was refused.
    pub fn take(&mut self, device: Option<&DeviceState>, elapsed: f64, events: &mut Events) -> Reading {
        let elapsed = if elapsed > 0.0 && elapsed.is_finite() { elapsed } else { 0.0 };
        self.blind += elapsed;
        self.displacement = Twist::ZERO;
        let Some(state) = device else {
            events.device_refused += 1;
            // A device that does not answer gets no wrench, not even for a short time.
            self.lost = true;
            return self.hold();
        };
        // A reading that the driver holds is not the device's own.
        let held = state.status.contains(Status::HELD);
        if held || !(state.pose.is_valid() && state.twist.is_finite()) {
            events.device_refused += 1;
            return self.refuse(elapsed);
        }
        if self.is_stale(state) {
            events.device_stale += 1;
            return if self.lost || self.blind > MAX_STALE { self.hold() } else { Reading::Stale };
        }
        events.device_ended += u64::from(state.status.contains(Status::ENDED));
        let blind = self.blind.max(self.period);
        let moved = moved(&self.state.pose, &state.pose);
        let jumped = self.started && !reachable(&moved, blind);
        if jumped && !self.accept_jump(&state.pose) {
            events.device_jumped += 1;
            return self.refuse(elapsed);
        }
        self.doubt = if jumped { 0.0 } else { (self.doubt - elapsed).max(0.0) };
        if self.doubt >= MAX_DOUBT_TRUSTED {
            return self.hold();
        }
        let interval = self.interval(state, blind);
        let back = !self.started || jumped || self.lost;
        self.stamped |= self.started && state.time > self.state.time;
        (self.started, self.lost) = (true, false);
        self.suspect = None;
        self.blind = 0.0;
        self.state = *state;
        if back {
            self.lagged = Twist::ZERO;
            self.drop_estimate();
            return Reading::Back;
        }
        self.displacement = moved;
        let linear = self.observers.0.advance(moved.linear, interval);
        let angular = self.observers.1.advance(moved.angular, interval);
        self.estimated = self.estimate();
        self.lagged.linear = filtered(self.lagged.linear, linear, interval, self.lags.0);
        self.lagged.angular = filtered(self.lagged.angular, angular, interval, self.lags.1);
        Reading::Good
    }

    /// Takes the last reading as it is: what was estimated between steps is dropped.
    pub fn drop_estimate(&mut self) {
        self.observers.0.reset();
        self.observers.1.reset();
        self.estimated = self.state.pose;
    }

    /// The pose by the last reading and what is estimated beyond it.
    fn estimate(&self) -> Pose {
        displaced(&self.state.pose, self.observers.0.offset(), self.observers.1.offset())
    }

    /// Whether a reading is the same as before. Readings without time stamps always count as new.
    fn is_stale(&self, state: &DeviceState) -> bool {
        self.started && self.stamped && state.time <= self.state.time && state.pose == self.state.pose
    }

    /// Time between the reading before and this one, s: by their stamps if these are plausible for a reading
    /// that comes `blind` (s) after the last good one.
    fn interval(&self, state: &DeviceState, blind: f64) -> f64 {
        let stamps = state.time - self.state.time;
        let time = if stamps > 0.0 { stamps.min(blind + MAX_STALE) } else { blind };
        time.max(MIN_INTERVAL * self.period)
    }

    /// Refuses a reading and raises the doubt about the device.
    fn refuse(&mut self, elapsed: f64) -> Reading {
        self.doubt = (self.doubt + FAULT_WEIGHT * elapsed).min(MAX_DOUBT);
        self.hold()
    }

    /// Holds the last good state at rest.
    fn hold(&mut self) -> Reading {
        self.state.twist = Twist::ZERO;
        self.lagged = Twist::ZERO;
        self.observers.0.rest();
        self.observers.1.rest();
        self.lost |= self.blind > MAX_HOLD;
        if self.lost { Reading::Lost } else { Reading::Held }
    }

    /// Counts a reading at a pose that the device jumped to. Returns `true` if there were enough in a row,
    /// more after many refused ones.
    fn accept_jump(&mut self, pose: &Pose) -> bool {
        let count = match self.suspect {
            Some((last, count)) if reachable(&moved(&last, pose), self.period) => count + 1,
            _ => 1,
        };
        self.suspect = Some((*pose, count));
        count >= ACCEPT_AFTER.max((self.doubt / (FAULT_WEIGHT * self.period)) as u32)
    }
}

/// A velocity after a displacement Δ over an interval T (s), through a first-order lag τ (s): v + (Δ / T − v)
/// T / (τ + T). Without a lag it does not change, since it is not used.
fn filtered(velocity: DVec3, moved: DVec3, interval: f64, lag: f64) -> DVec3 {
    let gain = if lag > 0.0 { interval / (lag + interval) } else { 0.0 };
    let velocity = velocity + (moved / interval - velocity) * gain;
    if velocity.abs().max_element() < MIN_SPEED { DVec3::ZERO } else { velocity }
}

/// A pose displaced by an offset (m) and turned by a rotation vector (rad).
fn displaced(pose: &Pose, offset: DVec3, turn: DVec3) -> Pose {
    let turned =
        if turn == DVec3::ZERO { pose.rotation } else { DQuat::from_scaled_axis(turn) * pose.rotation };
    Pose { translation: pose.translation + offset, rotation: turned }
}

/// The displacement from one pose to another: m, and rad as a rotation vector.
fn moved(from: &Pose, to: &Pose) -> Twist {
    Twist::new(to.translation - from.translation, from.rotation_vector_to(to))
}

/// Whether a hand can move a handle by a displacement in `seconds`.
fn reachable(moved: &Twist, seconds: f64) -> bool {
    moved.linear.length() <= MAX_SPEED.0 * seconds && moved.angular.length() <= MAX_SPEED.1 * seconds
}

#[cfg(test)]
mod tests;
