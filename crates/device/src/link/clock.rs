//! Clocks of the two sides of a link.

use std::time::Instant;

/// Lag behind the other clock beyond which a clock has been stopped, s.
const STOPPED_LAG: f64 = 5e-3;
/// Largest relative drift between the two clocks.
const MAX_DRIFT: f64 = 1e-3;

/// Clock of a pump, s: the time of its last round, or the time since its thread started.
#[derive(Clone, Copy, Debug)]
pub(super) enum Clock {
    Rounds(f64),
    Since(Instant),
}

impl Clock {
    pub fn now(&self) -> f64 {
        match self {
            Self::Rounds(now) => *now,
            Self::Since(start) => start.elapsed().as_secs_f64(),
        }
    }

    /// Sets the time of a round.
    pub fn set(&mut self, now: f64) {
        if let Self::Rounds(last) = self {
            *last = now;
        }
    }
}

/// Lead of the pump's clock over the reader's.
///
/// A reader looks at its clock some time before it reads, so each read shows a lead that is too large by that
/// delay: the smallest recent value counts. It is forgotten slowly, as clocks drift, and at once if the
/// reader's clock has been stopped.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Lead {
    /// The lead, s; `None` before the first read.
    lead: Option<f64>,
    /// Reader's time of the last read, s.
    read: f64,
}

impl Lead {
    /// Updates the lead by a read at `now` of the reader's clock and `pump` of the pump's.
    pub fn update(&mut self, now: f64, pump: f64) {
        let shown = pump - now;
        let known = self.lead.map_or(shown, |lead| lead + MAX_DRIFT * (now - self.read).max(0.0));
        self.lead = Some(if shown - known > STOPPED_LAG { shown } else { shown.min(known) });
        self.read = now;
    }

    /// Reader's time for a time of the pump.
    pub fn reader_time(&self, pump: f64) -> f64 {
        pump - self.lead.unwrap_or(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn late_reads_do_not_move_the_times_of_reports() {
        let mut lead = Lead::default();
        let mut worst = 0.0_f64;
        for i in 0..2000 {
            let now = f64::from(i) * 1e-3;
            // Each read is 2 to 50 µs late, and some are 3 ms late.
            let late = if i % 100 == 50 { 3e-3 } else { 2e-6 + 1e-6 * f64::from(i * 7 % 49) };
            lead.update(now, now + 17.0 + late);
            if i > 100 {
                worst = worst.max((lead.reader_time(now + 17.0) - now).abs());
            }
        }
        assert!(worst < 2e-5, "{worst} s");
    }

    #[test]
    fn a_clock_that_stands_still_or_jumps_is_followed() {
        let mut lead = Lead::default();
        for i in 0..100 {
            let now = f64::from(i) * 1e-3;
            lead.update(now, now + 1.0);
        }
        // The reader's clock was stopped for a second.
        lead.update(0.1, 2.1);
        assert!((lead.reader_time(2.1) - 0.1).abs() < 1e-12);
        // The reader's clock was put forward.
        lead.update(5.0, 2.2);
        assert!((lead.reader_time(2.2) - 5.0).abs() < 1e-12);
        assert_eq!(Lead::default().reader_time(3.0), 3.0);
    }

    #[test]
    fn a_slower_clock_is_followed_to_within_its_bound() {
        let mut lead = Lead::default();
        let mut worst = 0.0_f64;
        for i in 0..10_000 {
            let (now, pump) = (f64::from(i) * 0.7e-3, f64::from(i) * 1e-3);
            lead.update(now, pump);
            worst = worst.max((lead.reader_time(pump) - now).abs());
        }
        assert!(worst <= STOPPED_LAG, "{worst} s");
    }
}
