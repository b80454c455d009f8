//! Measurement of how late this machine wakes a thread that sleeps and is scheduled as the haptic thread is.

use std::time::{Duration, Instant};

use palpate_realtime::{Role, ThreadSetup, set_up};

use crate::run::machine::{MachineLoad, MachineSample};
use crate::run::realtime::sleeper;
use crate::telemetry::Times;

/// Result of [`measure_wake_lateness`].
#[derive(Clone, Debug)]
pub struct WakeLateness {
    /// Scheduling and privileges that the operating system granted to the thread.
    pub setup: ThreadSetup,
    /// Time from each deadline to the wake-up for it.
    pub lateness: Times,
    /// Number of periods that the thread slept through.
    pub missed: u64,
    /// Load of the machine meanwhile.
    pub machine: MachineLoad,
}

/// Measures how late a thread wakes that sleeps for `seconds`, from one deadline to the next at `rate` (Hz),
/// by the same method and under the same scheduling as the haptic thread. It renders nothing.
///
/// A rate or a time that is not positive and finite gives an empty result.
pub fn measure_wake_lateness(rate: f64, seconds: f64) -> WakeLateness {
    std::thread::scope(|scope| {
        let measured = scope.spawn(|| {
            let setup = set_up(Role::Haptic);
            let before = MachineSample::take();
            let (lateness, missed) = sleep_through(rate, seconds);
            let machine = MachineSample::take().since(&before);
            WakeLateness { setup, lateness, missed, machine }
        });
        measured.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}

fn sleep_through(rate: f64, seconds: f64) -> (Times, u64) {
    let (mut lateness, mut missed) = (Times::new(), 0);
    let period = 1.0 / rate;
    let steps = rate * seconds;
    if !(period > 0.0 && period.is_finite() && steps.is_finite() && steps >= 1.0) {
        return (lateness, missed);
    }
    let sleeper = sleeper(period);
    let start = Instant::now();
    let mut last = 0;
    while last < steps as u64 {
        let deadline = Duration::from_nanos(((last + 1) as f64 * period * 1e9) as u64);
        sleeper.sleep_until(start + deadline);
        let late = start.elapsed().saturating_sub(deadline);
        lateness.record(late.as_nanos() as u64);
        let slept_through = (late.as_secs_f64() / period) as u64;
        missed += slept_through;
        last += 1 + slept_through;
    }
    (lateness, missed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_thread_wakes_in_each_period_or_misses_it() {
        let measured = measure_wake_lateness(1000.0, 0.2);
        let (woken, missed) = (measured.lateness.count(), measured.missed);
        // The last wake-up may be late by some periods of its own.
        assert!(woken > 0 && woken + missed >= 200, "{woken} + {missed}");
        assert!(measured.lateness.percentiles(1.0).max < 1e9);
        assert_eq!(measured.setup.role, Role::Haptic);
        assert_eq!(measured.lateness.count_between(0, u64::MAX), woken);
        for (rate, seconds) in [(0.0, 1.0), (-1.0, 1.0), (f64::NAN, 1.0), (1e3, f64::INFINITY), (1e3, 0.0)] {
            assert_eq!(measure_wake_lateness(rate, seconds).lateness.count(), 0, "{rate} {seconds}");
        }
    }
}
