//! The lockstep driver: all loops in one thread on a simulated clock, so that sessions are reproducible bit
//! by bit.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use palpate_device::DeviceState;

use crate::contact_loop::ContactUpdate;
use crate::haptic::HapticLoop;
use crate::run::machine::MachineLoad;
use crate::run::renderer::HapticRenderer;
use crate::run::session::{Clock, Session};
use crate::telemetry::Events;
use crate::telemetry::hinged_record::HingedRecord;
use crate::tool::Tool;
use crate::tool::hinged::Hinged;
use crate::tool::rigid::Rigid;

/// Rate and latency of the contact loop on the simulated clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactTiming {
    /// Rate of contact queries, Hz; at most the haptic rate.
    pub rate: f64,
    /// Time from a query's start to its result, s, finite. At least one haptic period passes in any case.
    pub latency: f64,
}

impl ContactTiming {
    /// Queries at `rate` (Hz) that each take the whole period, as in a thread that is never idle.
    pub fn busy(rate: f64) -> Self {
        Self { rate, latency: 1.0 / rate }
    }
}

/// Session on a simulated clock, stepped one haptic period at a time.
///
/// Query k of each body starts at k / rate and uses the newest state at that time; its result is in use from
/// the first haptic step at or after the query's start plus the latency. The records depend only on the
/// arguments; the durations of steps and queries in the telemetry are measured in real time. Contact steps
/// allocate while their workspaces grow.
pub struct LockstepSession<T: Tool = Rigid> {
    renderer: HapticRenderer<T>,
    query_period: f64,
    latency: f64,
    steps: u64,
    queries: u64,
    /// Results of queries, each with the time of its arrival (s).
    pending: VecDeque<(f64, Vec<ContactUpdate>)>,
}

impl<T: Tool> HapticRenderer<T> {
    /// Turns the renderer into a session on a simulated clock that the caller steps.
    pub fn lockstep(mut self, timing: ContactTiming) -> LockstepSession<T> {
        for contact in &mut self.contacts {
            contact.telemetry_mut().longer_than_slot = Some(0);
        }
        LockstepSession {
            query_period: (1.0 / timing.rate).max(self.period),
            latency: timing.latency,
            steps: 0,
            queries: 0,
            pending: VecDeque::new(),
            renderer: self,
        }
    }

    /// Renders for `seconds` of simulated time, or until `stop` is set. Calls `sink` with the record of each
    /// step; its first error ends the session. [`LockstepSession`] defines the timing of queries.
    ///
    /// # Errors
    /// The first error that `sink` returns.
    #[cfg_attr(feature = "tracing", tracing::instrument(skip_all, fields(seconds)))]
    pub fn run_lockstep<E>(
        self,
        seconds: f64,
        timing: ContactTiming,
        stop: &AtomicBool,
        mut sink: impl FnMut(&T::Record) -> Result<(), E>,
    ) -> Result<Session, E> {
        let steps = steps_in(seconds, self.period);
        let mut session = self.lockstep(timing);
        let mut result = Ok(());
        for _ in 0..steps {
            result = sink(&session.step_device());
            if result.is_err() || stop.load(Ordering::Acquire) {
                break;
            }
        }
        result.map(|()| session.finish())
    }
}

impl<T: Tool> LockstepSession<T> {
    /// Takes a haptic step of a period with the session's own device.
    pub fn step_device(&mut self) -> T::Record {
        let now = self.find_contacts();
        let HapticRenderer { haptic, device, period, .. } = &mut self.renderer;
        let begun = Instant::now();
        let record = haptic.step_device(device.as_mut(), now, *period);
        haptic.telemetry_mut().step.record(begun.elapsed().as_nanos() as u64);
        record
    }

    /// Runs the query that starts in this step, if any, and passes the contact models that have arrived to
    /// the haptic loop. Returns the time at the step's end, s.
    fn find_contacts(&mut self) -> f64 {
        let HapticRenderer { haptic, contacts, period, .. } = &mut self.renderer;
        let (seen, now) = (self.steps as f64 * *period, (self.steps + 1) as f64 * *period);
        self.steps += 1;
        // Multiples of the two periods are equal only up to rounding.
        let slack = 1e-6 * *period;
        let start = self.queries as f64 * self.query_period;
        if start < now - slack {
            let updates = contacts.iter_mut().enumerate().map(|(body, contact)| {
                let begun = Instant::now();
                let update = contact.step_pulled(&haptic.tool.body_state(body), &haptic.pull_of(body), seen);
                let took = begun.elapsed();
                let telemetry = contact.telemetry_mut();
                telemetry.query.record(took.as_nanos() as u64);
                if let Some(longer) = &mut telemetry.longer_than_slot {
                    *longer += u64::from(took.as_secs_f64() > self.query_period);
                }
                update
            });
            self.pending.push_back((start + self.latency, updates.collect()));
            self.queries += 1;
        }
        while let Some((_, updates)) = self.pending.pop_front_if(|(arrival, _)| *arrival <= now + slack) {
            for (body, update) in updates.iter().enumerate() {
                haptic.take_model(body, update);
            }
        }
        now
    }

    /// Period of a step, s.
    pub fn period(&self) -> f64 {
        self.renderer.period
    }

    /// The haptic loop.
    pub fn haptic(&self) -> &HapticLoop<T> {
        &self.renderer.haptic
    }

    /// Holds or releases the clutch ([`HapticLoop::set_clutch`]).
    pub fn set_clutch(&mut self, held: bool) {
        self.renderer.haptic.set_clutch(held);
    }

    /// Counts of events in all loops.
    pub fn events(&self) -> Events {
        let contacts = self.renderer.contacts.iter().map(|contact| contact.telemetry().events);
        contacts.fold(self.renderer.haptic.telemetry().events, |sum, events| sum.and(&events))
    }

    /// Ends the session.
    pub fn finish(self) -> Session {
        let seconds = self.renderer.haptic.telemetry().steps as f64 * self.renderer.period;
        Session::close(self.renderer, seconds, Clock::Simulated, MachineLoad::default())
    }
}

impl LockstepSession<Hinged> {
    /// Takes a haptic step of a period, with the device's state and the gripper's angle (rad) at its end.
    pub fn step(&mut self, device: &DeviceState, gripper_angle: f64) -> HingedRecord {
        let now = self.find_contacts();
        self.renderer.haptic.step(device, gripper_angle, now, self.renderer.period)
    }
}

/// Number of whole periods in a time (s), at least one; 0 if the time is not positive.
pub(crate) fn steps_in(seconds: f64, period: f64) -> u64 {
    if seconds > 0.0 { (seconds / period).round().max(1.0) as u64 } else { 0 }
}
