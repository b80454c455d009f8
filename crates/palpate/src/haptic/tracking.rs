//! What the haptic loop takes a device's readings for: the last good one held, jumps refused, and the velocity that
//! the coupling's damper needs.

use palpate_core::glam::DVec3;
use palpate_core::{Pose, Twist};
use palpate_device::{DeviceState, Status};

use crate::telemetry::Events;

/// No hand moves or turns a handle faster: m/s and rad/s.
const FASTEST: (f64, f64) = (10.0, 100.0);
/// Readings in a row, each within reach of the one before, after which a place that the device jumped to is believed.
const BELIEVED: u32 = 5;
/// How long the last good reading is held for the device, s, before it counts as lost: after bad readings, and where none newer
/// comes.
const LONGEST_HOLD: f64 = 0.01;
const LONGEST_STALE: f64 = 0.025;
/// A device that talks nonsense now and then says something that a hand could have done: that is not to be trusted. Time with refused
/// readings counts so many times as much as time with good ones.
const AMENDS: f64 = 4.0;
/// Good readings are not taken while so much is against the device, s: as the longest hold makes. And the most that counts, s.
const DOUBTED: f64 = AMENDS * LONGEST_HOLD;
const MOST_DOUBT: f64 = 1.5 * DOUBTED;
/// The velocity is that of readings at least this part of a period apart: the stamps of two that came at once say nothing of it.
const CLOSEST: f64 = 0.25;
/// Velocities below these are none, m/s and rad/s: a lag lets them halve for ever.
const SLOWEST: f64 = 1e-12;

/// What came of a reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reading {
    /// It was taken.
    Good,
    /// It is the one before, once more: its velocity goes on.
    Stale,
    /// It was refused; the last good one is held at rest.
    Held,
    /// It is the first one taken, or the first of a device that was lost or is elsewhere now: the displacement since the last is
    /// none.
    Back,
    /// There is none, or none that is good has come for too long; the last good one is held at rest.
    Lost,
}

impl Reading {
    /// The worse of the readings of two ports that are used together: one that goes on is good.
    pub fn or_worse(self, other: Self) -> Self {
        let either = |reading: Self| self == reading || other == reading;
        [Self::Lost, Self::Back, Self::Held]
            .into_iter()
            .find(|&reading| either(reading))
            .unwrap_or(Self::Good)
    }
}

/// The device as the loop sees it, in the device's axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tracking {
    state: DeviceState,
    /// What the handle moved by from the reading before: m, and rad as a rotation vector.
    displacement: Twist,
    /// Time since the last good reading, s, up to now.
    blind: f64,
    started: bool,
    /// Whether the device stamps its readings: a time that stays means that the reading does.
    stamped: bool,
    /// Whether it counts as lost.
    lost: bool,
    /// Time with good readings that is wanting to make up for refused ones, s.
    doubt: f64,
    /// A place that the device jumped to, and how many readings were there.
    suspect: Option<(Pose, u32)>,
    /// Lags of the velocity and the angular velocity, s; 0 takes the device's own.
    lags: (f64, f64),
    /// Velocities through these lags.
    lagged: Twist,
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
            period,
        }
    }

    /// Lets velocities lag otherwise, from what they are now.
    pub fn set_lags(&mut self, lags: (f64, f64)) {
        let twist = self.damped_state().twist;
        self.lagged = twist;
        self.lags = lags;
    }

    /// The last good state, its twist zero while it is held.
    pub fn state(&self) -> &DeviceState {
        &self.state
    }

    /// The same with the velocities for the coupling's damper.
    pub fn damped_state(&self) -> DeviceState {
        let pick = |lag: f64| lag > 0.0;
        let twist = &self.state.twist;
        DeviceState {
            twist: Twist {
                linear: if pick(self.lags.0) { self.lagged.linear } else { twist.linear },
                angular: if pick(self.lags.1) { self.lagged.angular } else { twist.angular },
            },
            ..self.state
        }
    }

    /// What the handle moved by at the last call of [`Self::take`].
    pub fn displacement(&self) -> &Twist {
        &self.displacement
    }

    /// Takes a reading that comes `elapsed` seconds after the one before, or counts why it was not taken.
    pub fn take(&mut self, device: Option<&DeviceState>, elapsed: f64, events: &mut Events) -> Reading {
        let elapsed = if elapsed > 0.0 && elapsed.is_finite() { elapsed } else { 0.0 };
        self.blind += elapsed;
        self.displacement = Twist::ZERO;
        let Some(state) = device else {
            events.device_refused += 1;
            // A device that does not answer is sent nothing, however short that is.
            self.lost = true;
            return self.hold();
        };
        // What the driver holds is not what the device says.
        let held = state.status.contains(Status::HELD);
        if held || !(state.pose.is_valid() && state.twist.is_finite()) {
            events.device_refused += 1;
            return self.refuse(elapsed);
        }
        if self.is_stale(state) {
            events.device_stale += 1;
            return if self.lost || self.blind > LONGEST_STALE { self.hold() } else { Reading::Stale };
        }
        events.device_ended += u64::from(state.status.contains(Status::ENDED));
        let blind = self.blind.max(self.period);
        let moved = moved(&self.state.pose, &state.pose);
        let jumped = self.started && !reachable(&moved, blind);
        if jumped && !self.believe(&state.pose) {
            events.device_jumped += 1;
            return self.refuse(elapsed);
        }
        self.doubt = if jumped { 0.0 } else { (self.doubt - elapsed).max(0.0) };
        if self.doubt >= DOUBTED {
            return self.hold();
        }
        let between = self.between(state, blind);
        let back = !self.started || jumped || self.lost;
        self.stamped |= self.started && state.time > self.state.time;
        (self.started, self.lost) = (true, false);
        self.suspect = None;
        self.blind = 0.0;
        self.state = *state;
        if back {
            self.lagged = Twist::ZERO;
            return Reading::Back;
        }
        self.displacement = moved;
        let lag = |tau: f64| if tau > 0.0 { between / (tau + between) } else { 0.0 };
        let follow = |lagged: DVec3, moved: DVec3, tau: f64| {
            let velocity = lagged + (moved / between - lagged) * lag(tau);
            if velocity.abs().max_element() < SLOWEST { DVec3::ZERO } else { velocity }
        };
        self.lagged.linear = follow(self.lagged.linear, moved.linear, self.lags.0);
        self.lagged.angular = follow(self.lagged.angular, moved.angular, self.lags.1);
        Reading::Good
    }

    /// Whether a reading is the one before. A device that does not stamp its readings is taken to give a new one each time.
    fn is_stale(&self, state: &DeviceState) -> bool {
        self.started && self.stamped && state.time <= self.state.time && state.pose == self.state.pose
    }

    /// Time from the reading before to this one, s: by their stamps as far as these can be, `blind` (s) after the last good one.
    fn between(&self, state: &DeviceState, blind: f64) -> f64 {
        let stamps = state.time - self.state.time;
        let time = if stamps > 0.0 { stamps.min(blind + LONGEST_STALE) } else { blind };
        time.max(CLOSEST * self.period)
    }

    /// Takes no reading, and the device is trusted less.
    fn refuse(&mut self, elapsed: f64) -> Reading {
        self.doubt = (self.doubt + AMENDS * elapsed).min(MOST_DOUBT);
        self.hold()
    }

    fn hold(&mut self) -> Reading {
        self.state.twist = Twist::ZERO;
        self.lagged = Twist::ZERO;
        self.lost |= self.blind > LONGEST_HOLD;
        if self.lost { Reading::Lost } else { Reading::Held }
    }

    /// Whether the device has been where it jumped to for long enough.
    fn believe(&mut self, pose: &Pose) -> bool {
        let count = match self.suspect {
            Some((last, count)) if reachable(&moved(&last, pose), self.period) => count + 1,
            _ => 1,
        };
        self.suspect = Some((*pose, count));
        count >= BELIEVED.max((self.doubt / (AMENDS * self.period)) as u32)
    }
}

/// The displacement from one pose to another: m, and rad as a rotation vector.
fn moved(from: &Pose, to: &Pose) -> Twist {
    Twist::new(to.translation - from.translation, from.rotation_vector_to(to))
}

/// Whether a hand can move a handle so far in `seconds`.
fn reachable(moved: &Twist, seconds: f64) -> bool {
    moved.linear.length() <= FASTEST.0 * seconds && moved.angular.length() <= FASTEST.1 * seconds
}

#[cfg(test)]
mod tests;
