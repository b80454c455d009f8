//! The lockstep driver: both loops in one thread on a simulated clock, so that a session is reproducible bit by bit.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::run::machine::MachineLoad;
use crate::run::renderer::HapticRenderer;
use crate::run::session::{Clock, Session};
use crate::telemetry::record::Record;

/// How fast the contact loop is made out to be, relative to the simulated clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactTiming {
    /// Contact queries a second, Hz; at most the haptic rate.
    pub rate: f64,
    /// Time from a query's start to its result, s; at least one haptic period passes in any case. Finite.
    pub latency: f64,
}

impl ContactTiming {
    /// Queries at `rate` (Hz), each taking its whole period, as a thread that is never idle does.
    pub fn busy(rate: f64) -> Self {
        Self { rate, latency: 1.0 / rate }
    }
}

impl HapticRenderer {
    /// Renders `seconds` of simulated time, or until `stop` is set. Each step's record goes to `sink`, whose first
    /// error ends the session.
    ///
    /// Query k starts at k / rate and sees the newest body state of that time; its result is in use from the first haptic
    /// step that is the latency later. The records depend on nothing but the arguments; step and query times in the
    /// telemetry are measured ones.
    ///
    /// # Errors
    /// Only what `sink` returns.
    #[cfg_attr(feature = "tracing", tracing::instrument(skip_all, fields(seconds)))]
    pub fn run_lockstep<E>(
        mut self,
        seconds: f64,
        timing: ContactTiming,
        stop: &AtomicBool,
        mut sink: impl FnMut(&Record) -> Result<(), E>,
    ) -> Result<Session, E> {
        let steps = steps_in(seconds, self.period);
        let query_period = (1.0 / timing.rate).max(self.period);
        // Absorbs the rounding of products of periods.
        let slack = 1e-6 * self.period;
        self.contact.telemetry_mut().longer_than_slot = Some(0);
        let mut queries = 0u64;
        let mut pending = VecDeque::new();
        let mut result = Ok(());
        for step in 1..=steps {
            let (seen, now) = ((step - 1) as f64 * self.period, step as f64 * self.period);
            let start = queries as f64 * query_period;
            if start < now - slack {
                let begun = std::time::Instant::now();
                let update = self.contact.step(self.haptic.body_state(), seen);
                let took = begun.elapsed();
                let telemetry = self.contact.telemetry_mut();
                telemetry.query.record(took.as_nanos() as u64);
                if let Some(longer) = &mut telemetry.longer_than_slot {
                    *longer += u64::from(took.as_secs_f64() > query_period);
                }
                pending.push_back((start + timing.latency, update));
                queries += 1;
            }
            while let Some((_, update)) = pending.pop_front_if(|(arrival, _)| *arrival <= now + slack) {
                self.haptic.update_contacts(&update);
            }
            let begun = std::time::Instant::now();
            let record = self.haptic.step_device(self.device.as_mut(), now, self.period);
            self.haptic.telemetry_mut().step.record(begun.elapsed().as_nanos() as u64);
            result = sink(&record);
            if result.is_err() || stop.load(Ordering::Acquire) {
                break;
            }
        }
        let seconds = self.haptic.telemetry().steps as f64 * self.period;
        let session = Session::close(self, seconds, Clock::Simulated, MachineLoad::default());
        result.map(|()| session)
    }
}

/// Whole periods in a time: at least one, but none in a time that is not positive.
pub(crate) fn steps_in(seconds: f64, period: f64) -> u64 {
    if seconds > 0.0 { (seconds / period).round().max(1.0) as u64 } else { 0 }
}
