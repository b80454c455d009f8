//! The time of a session, for other threads.

use std::sync::atomic::{AtomicU64, Ordering};

/// Time of a haptic loop, s, that it sets and other threads read.
#[derive(Debug)]
pub(crate) struct SessionClock(AtomicU64);

impl Default for SessionClock {
    /// A clock that has not been set: it shows NaN.
    fn default() -> Self {
        Self(AtomicU64::new(f64::NAN.to_bits()))
    }
}

impl SessionClock {
    pub fn now(&self) -> f64 {
        f64::from_bits(self.0.load(Ordering::Relaxed))
    }

    pub fn set(&self, time: f64) {
        self.0.store(time.to_bits(), Ordering::Relaxed);
    }
}
