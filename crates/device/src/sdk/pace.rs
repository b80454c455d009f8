//! Rate limit of calls.

use std::time::{Duration, Instant};

/// Keeps calls at least a period apart.
#[derive(Debug)]
pub(super) struct Pace {
    period: Duration,
    due: Instant,
}

impl Pace {
    pub fn new(period: Duration) -> Self {
        Self { period, due: Instant::now() }
    }

    /// Waits until the next call is due, or `timeout` has passed; gives whether it is due.
    pub fn wait(&mut self, timeout: Duration) -> bool {
        let early = self.due.saturating_duration_since(Instant::now());
        if !early.is_zero() {
            std::thread::sleep(early.min(timeout));
        }
        if early > timeout {
            return false;
        }
        self.due = Instant::now() + self.period;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounds_are_no_closer_than_they_may_be() {
        let mut pace = Pace::new(Duration::from_millis(2));
        let start = Instant::now();
        assert!(pace.wait(Duration::ZERO) && !pace.wait(Duration::ZERO));
        for _ in 0..20 {
            assert!(pace.wait(Duration::from_secs(1)));
        }
        assert!(start.elapsed() >= Duration::from_millis(40));
    }
}
