//! How far beyond the tolerance d contacts are looked for: as far as the body may move before the next contacts are in use, and as far
//! as it has gone ahead of its proxy.
//!
//! Contacts further apart than d cost time and push nothing yet. So the reach adapts: it is halved where it found too many of them, and
//! grows slowly again where it limits the motion that is looked ahead for.

use palpate_core::Twist;

/// Intervals between queries that are looked ahead: one passes before a query's answer is in use, another while the contact model goes
/// over to it, one more before the next, and one to spare. With fewer, a fast body is inside a surface when that is first known.
const INTERVALS: f64 = 4.0;

/// Longest interval between queries that is looked ahead for, s. Beyond it the body is unprotected, but the reach stays bounded.
const LONGEST_INTERVAL: f64 = 0.02;

/// Largest motion that is looked ahead for, in bounding radii of the probe.
const LARGEST_MOTION: f64 = 0.5;

/// Largest lag of the proxy that is looked for, in tolerances d.
const LARGEST_LAG: f64 = 16.0;

/// Steps in which the reach changes, in tolerances d: queries start from the front of the last one where the reach is the same.
const STEP: f64 = 0.25;

/// Number of contacts further apart than d that the motion ahead may find, or else as many as there are within d. With more, looking
/// ahead would cost more than the contacts themselves.
const FAR_CONTACTS: usize = 64;

/// The same for the lag of the proxy: those contacts hold the body.
const LAG_CONTACTS: usize = 256;

/// Growth of the reach a step, where it was limited and need not be.
const GROWTH: f64 = 1.01;

/// How far ahead of the body contacts are looked for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lookahead {
    /// Whether contacts further apart than d matter: to brake the body, or for its proxy.
    enabled: bool,
    /// d, m.
    tolerance: f64,
    /// Bounding radius of the probe about its centre of mass, m.
    radius: f64,
    /// Largest motion that is looked ahead for now, m.
    outlook: f64,
    /// Largest lag that is looked for now, m.
    furthest_lag: f64,
}

impl Lookahead {
    pub fn new(enabled: bool, tolerance: f64, radius: f64) -> Self {
        let outlook = LARGEST_MOTION * radius;
        Self { enabled, tolerance, radius, outlook, furthest_lag: LARGEST_LAG * tolerance }
    }

    /// Time that contacts are looked ahead for, s, where queries are `interval` (s) apart: 0 where nothing asks for them.
    pub fn horizon(&self, interval: f64) -> f64 {
        if self.enabled && interval > 0.0 { INTERVALS * interval.min(LONGEST_INTERVAL) } else { 0.0 }
    }

    /// Largest motion that is looked ahead for now, m.
    pub fn outlook(&self) -> f64 {
        self.outlook
    }

    /// Bound on the motion of any point of a body against the scene in a time (s), m, in whole steps: with |v| + |ω| r for the body and
    /// the speed (m/s) of the fastest object near it. No more than the outlook.
    pub fn motion_bound(&self, twist: &Twist, fastest: f64, time: f64) -> f64 {
        let speed = twist.linear.length() + twist.angular.length() * self.radius + fastest;
        let step = STEP * self.tolerance;
        let motion = (speed * time).min(self.outlook);
        if motion > step { (motion / step).ceil() * step } else { 0.0 }
    }

    /// The lag of the proxy (m), as far as it is looked for now.
    pub fn limited_lag(&self, lag: f64) -> f64 {
        lag.min(self.furthest_lag)
    }

    /// Adapts to the depths (m) of the contacts that were found within a motion ahead and a lag (m): those deeper than −`near` (m)
    /// would have been found without.
    pub fn adapt(&mut self, (motion, lag): (f64, f64), near: f64, depths: impl Iterator<Item = f64>) {
        let (mut within, mut far) = (0, 0);
        for depth in depths {
            if depth > -near { within += 1 } else { far += 1 }
        }
        if far > within.max(FAR_CONTACTS) {
            self.outlook = (0.5 * motion).max(STEP * self.tolerance);
        } else if motion >= self.outlook {
            self.outlook = (GROWTH * self.outlook).min(LARGEST_MOTION * self.radius);
        }
        if far > LAG_CONTACTS && lag > 0.0 {
            self.furthest_lag = (0.5 * lag).max(STEP * self.tolerance);
        } else if lag == 0.0 {
            self.furthest_lag = (GROWTH * self.furthest_lag).min(LARGEST_LAG * self.tolerance);
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
            let steps = bound / (STEP * TOLERANCE);
            assert!(bound >= furthest && bound < furthest + STEP * TOLERANCE, "{bound} m of {furthest}");
            assert!((steps - steps.round()).abs() < 1e-9, "{steps} steps");
        }
        assert_eq!(ahead.motion_bound(&Twist::ZERO, 0.0, 1.0), 0.0);
    }

    #[test]
    fn nothing_is_looked_ahead_for_where_nothing_asks() {
        let ahead = Lookahead::new(false, TOLERANCE, RADIUS);
        assert_eq!(ahead.horizon(1e-3), 0.0);
        for interval in [0.0, -1.0, f64::NAN] {
            assert_eq!(lookahead().horizon(interval), 0.0);
        }
        // A contact thread that was stopped does not make the reach grow without bound.
        assert_eq!(lookahead().horizon(10.0), 4.0 * LONGEST_INTERVAL);
    }

    /// Too many contacts beyond d halve the reach of the motion; without them it comes back to all of it, and no further.
    #[test]
    fn the_reach_shrinks_at_a_glut_and_recovers() {
        let mut ahead = lookahead();
        let full = ahead.outlook();
        let motion = ahead.motion_bound(&Twist::new(DVec3::X * 100.0, DVec3::ZERO), 0.0, 1.0);
        ahead.adapt((motion, 0.0), TOLERANCE, std::iter::repeat_n(-2.0 * TOLERANCE, 65));
        assert_eq!(ahead.outlook(), 0.5 * motion);
        // As many within d make them worth it.
        let mut held = lookahead();
        let depths = std::iter::repeat_n(0.0, 70).chain(std::iter::repeat_n(-2.0 * TOLERANCE, 65));
        held.adapt((motion, 0.0), TOLERANCE, depths);
        assert_eq!(held.outlook(), full);
        for _ in 0..100 {
            ahead.adapt((ahead.outlook(), 0.0), TOLERANCE, std::iter::empty());
        }
        assert_eq!(ahead.outlook(), full);
        // It never shrinks below a step.
        for _ in 0..100 {
            ahead.adapt((0.0, 0.0), TOLERANCE, std::iter::repeat_n(-1.0, 1000));
        }
        assert_eq!(ahead.outlook(), STEP * TOLERANCE);
    }

    #[test]
    fn the_lag_that_is_looked_for_is_bounded_likewise() {
        let mut ahead = lookahead();
        assert_eq!(ahead.limited_lag(1.0), LARGEST_LAG * TOLERANCE);
        assert_eq!(ahead.limited_lag(0.5 * TOLERANCE), 0.5 * TOLERANCE);
        ahead.adapt((0.0, 4.0 * TOLERANCE), TOLERANCE, std::iter::repeat_n(-3.0 * TOLERANCE, 300));
        assert_eq!(ahead.limited_lag(1.0), 2.0 * TOLERANCE);
        for _ in 0..300 {
            ahead.adapt((0.0, 0.0), TOLERANCE, std::iter::empty());
        }
        assert_eq!(ahead.limited_lag(1.0), LARGEST_LAG * TOLERANCE);
    }
}
