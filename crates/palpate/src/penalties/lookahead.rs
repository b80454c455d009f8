//! The distance beyond the tolerance d within which contacts are searched: the motion of the body until the
//! next contacts are in use, plus the lag of the proxy behind it.
//!
//! Contacts further apart than d cost time and do not push yet. So the reach adapts: it is halved when it
//! finds too many of them, and grows slowly again where it limits the motion.

use palpate_core::Twist;

/// Number of query intervals to look ahead: one passes before a query's answer is in use, another while the
/// contact model blends into it, one more before the next answer, and one is a margin. With fewer, a fast
/// body is inside a surface before the first contact with it is in use.
const INTERVALS: f64 = 4.0;

/// Longest query interval that the search covers, s. With longer ones the body may penetrate first, but the
/// reach is bounded.
const MAX_INTERVAL: f64 = 0.02;

/// Largest motion that the search covers, in bounding radii of the probe. With more, a fast probe searches
/// most of the scene.
const MAX_MOTION: f64 = 0.5;

/// Largest lag of the proxy that the search covers, in tolerances d. With less, a body pressed in deeper
/// loses contacts.
const MAX_LAG: f64 = 16.0;

/// Steps in which the reach changes, in tolerances d: a query starts from the front of the last one if the
/// reach is the same.
const REACH_STEP: f64 = 0.25;

/// Number of contacts further apart than d above which the motion is searched less far ahead, unless there
/// are more within d. With more, looking ahead would cost more than the contacts themselves.
const MAX_FAR_CONTACTS: usize = 64;

/// The same for the lag of the proxy, where the contacts hold the body.
const MAX_LAG_CONTACTS: usize = 256;

/// Factor by which a limited reach grows in a step without too many contacts. With more, it oscillates.
const GROWTH: f64 = 1.01;

/// The reach of the contact search beyond d.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lookahead {
    /// Whether contacts further apart than d are used, for braking or by the proxy.
    enabled: bool,
    /// d, m.
    tolerance: f64,
    /// Bounding radius of the probe about its centre of mass, m.
    radius: f64,
    /// Largest motion that the search covers now, m.
    max_motion: f64,
    /// Largest lag that the search covers now, m.
    max_lag: f64,
}

impl Lookahead {
    pub fn new(enabled: bool, tolerance: f64, radius: f64) -> Self {
        Self { enabled, tolerance, radius, max_motion: MAX_MOTION * radius, max_lag: MAX_LAG * tolerance }
    }

    /// Time that the search covers, s, with queries every `interval` (s); 0 if disabled.
    pub fn horizon(&self, interval: f64) -> f64 {
        if self.enabled && interval > 0.0 { INTERVALS * interval.min(MAX_INTERVAL) } else { 0.0 }
    }

    /// Largest motion that the search covers now, m.
    pub fn max_motion(&self) -> f64 {
        self.max_motion
    }

    /// Bound on the motion of any point of a body relative to the scene in a time t (s), m: (|v| + |ω| r + u)
    /// t, with the speed u (m/s) of the fastest object near the body. It is rounded up to whole steps and
    /// limited to the motion that the search covers.
    pub fn motion_bound(&self, twist: &Twist, fastest: f64, time: f64) -> f64 {
        let speed = twist.linear.length() + twist.angular.length() * self.radius + fastest;
        let step = REACH_STEP * self.tolerance;
        let motion = (speed * time).min(self.max_motion);
        if motion > step { (motion / step).ceil() * step } else { 0.0 }
    }

    /// The lag of the proxy (m), limited to the lag that the search covers.
    pub fn limited_lag(&self, lag: f64) -> f64 {
        lag.min(self.max_lag)
    }

    /// Adapts the reach to the depths (m) of the contacts found with a motion and a lag (m). Those deeper
    /// than −`near` (m) would have been found without either.
    pub fn adapt(&mut self, (motion, lag): (f64, f64), near: f64, depths: impl Iterator<Item = f64>) {
        let (mut within, mut far) = (0, 0);
        for depth in depths {
            if depth > -near { within += 1 } else { far += 1 }
        }
        if far > within.max(MAX_FAR_CONTACTS) {
            self.max_motion = (0.5 * motion).max(REACH_STEP * self.tolerance);
        } else if motion >= self.max_motion {
            self.max_motion = (GROWTH * self.max_motion).min(MAX_MOTION * self.radius);
        }
        if far > MAX_LAG_CONTACTS && lag > 0.0 {
            self.max_lag = (0.5 * lag).max(REACH_STEP * self.tolerance);
        } else if lag == 0.0 {
            self.max_lag = (GROWTH * self.max_lag).min(MAX_LAG * self.tolerance);
        }
    }
}

#[cfg(test)]
mod tests {
    use palpate_core::glam::DVec3;

    use super::*;

    const TOLERANCE: f64 = 1e-3;
    const RADIUS: f64 = 0.1;

    fn lookahead() -> Lookahead {
        Lookahead::new(true, TOLERANCE, RADIUS)
    }

    #[test]
    fn the_bound_covers_every_point_of_the_body_in_whole_steps() {
        let ahead = lookahead();
        let twist = Twist::new(DVec3::new(0.3, 0.0, 0.4), DVec3::Z * 2.0);
        for interval in [1e-3, 2e-3, 5e-3] {
            let time = ahead.horizon(interval);
            assert_eq!(time, 4.0 * interval);
            // |v| + |ω| r + the object's speed.
            let furthest = (0.5 + 0.2 + 0.1) * time;
            let bound = ahead.motion_bound(&twist, 0.1, time);
            let steps = bound / (REACH_STEP * TOLERANCE);
            assert!(
                bound >= furthest && bound < furthest + REACH_STEP * TOLERANCE,
                "{bound} m of {furthest}"
            );
            assert!((steps - steps.round()).abs() < 1e-9, "{steps} steps");
        }
        assert_eq!(ahead.motion_bound(&Twist::ZERO, 0.0, 1.0), 0.0);
    }

    #[test]
    fn the_horizon_is_zero_if_disabled_and_bounded_otherwise() {
        let ahead = Lookahead::new(false, TOLERANCE, RADIUS);
        assert_eq!(ahead.horizon(1e-3), 0.0);
        for interval in [0.0, -1.0, f64::NAN] {
            assert_eq!(lookahead().horizon(interval), 0.0);
        }
        // The reach stays bounded after a contact thread was suspended.
        assert_eq!(lookahead().horizon(10.0), 4.0 * MAX_INTERVAL);
    }

    /// Too many contacts beyond d halve the motion that the search covers; without them it grows back to the
    /// initial one.
    #[test]
    fn the_reach_shrinks_with_too_many_contacts_and_recovers() {
        let mut ahead = lookahead();
        let full = ahead.max_motion();
        let motion = ahead.motion_bound(&Twist::new(DVec3::X * 100.0, DVec3::ZERO), 0.0, 1.0);
        ahead.adapt((motion, 0.0), TOLERANCE, std::iter::repeat_n(-2.0 * TOLERANCE, 65));
        assert_eq!(ahead.max_motion(), 0.5 * motion);
        // More contacts within d justify the cost.
        let mut held = lookahead();
        let depths = std::iter::repeat_n(0.0, 70).chain(std::iter::repeat_n(-2.0 * TOLERANCE, 65));
        held.adapt((motion, 0.0), TOLERANCE, depths);
        assert_eq!(held.max_motion(), full);
        for _ in 0..100 {
            ahead.adapt((ahead.max_motion(), 0.0), TOLERANCE, std::iter::empty());
        }
        assert_eq!(ahead.max_motion(), full);
        // It never shrinks below a step.
        for _ in 0..100 {
            ahead.adapt((0.0, 0.0), TOLERANCE, std::iter::repeat_n(-1.0, 1000));
        }
        assert_eq!(ahead.max_motion(), REACH_STEP * TOLERANCE);
    }

    #[test]
    fn the_lag_shrinks_with_too_many_contacts_and_recovers() {
        let mut ahead = lookahead();
        assert_eq!(ahead.limited_lag(1.0), MAX_LAG * TOLERANCE);
        assert_eq!(ahead.limited_lag(0.5 * TOLERANCE), 0.5 * TOLERANCE);
        ahead.adapt((0.0, 4.0 * TOLERANCE), TOLERANCE, std::iter::repeat_n(-3.0 * TOLERANCE, 300));
        assert_eq!(ahead.limited_lag(1.0), 2.0 * TOLERANCE);
        for _ in 0..300 {
            ahead.adapt((0.0, 0.0), TOLERANCE, std::iter::empty());
        }
        assert_eq!(ahead.limited_lag(1.0), MAX_LAG * TOLERANCE);
    }
}
