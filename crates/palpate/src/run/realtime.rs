//! The real-time driver: a haptic thread, a contact thread for each body, and the caller's thread as the recorder.
//!
//! The haptic thread wakes at absolute deadlines (sleep, then a short spin), under SCHED_FIFO where that is allowed. It
//! hands the body's state to the contact thread through a triple buffer (the latest wins), takes contact models from a
//! lock-free ring, and puts records into another; none of them ever makes it wait. Periods that it wakes too late for
//! are counted and skipped, never replayed.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use palpate_core::Wrench;
use palpate_device::HapticDevice;
use palpate_dynamics::BodyState;
use palpate_realtime::{Role, ThreadSetup, lock_memory, set_up};
use rtrb::{Consumer, Producer, RingBuffer};
use spin_sleep::{SpinSleeper, SpinStrategy};

use crate::contact::{ContactLoop, ContactUpdate};
use crate::haptic::HapticLoop;
use crate::haptic::presence::FADE;
use crate::run::lockstep::steps_in;
use crate::run::machine::MachineSample;
use crate::run::renderer::HapticRenderer;
use crate::run::session::{Clock, RealtimeSetup, Session};
use crate::telemetry::record::Recorded;
use crate::tool::Tool;

/// Contact models that may wait for the haptic thread.
const MODEL_RING: usize = 8;
/// Records that may wait for the recorder: four seconds at 1 kHz.
const RECORD_RING: usize = 4096;
/// How long the recorder sleeps when it has caught up.
const RECORDER_NAP: Duration = Duration::from_millis(5);
/// How long the contact thread waits for a body state that it has not seen.
const CONTACT_NAP: Duration = Duration::from_micros(50);
/// The haptic thread sleeps until this long before a deadline, s, and spins the rest.
const SPIN: f64 = 1e-4;
/// Most of a period that it spins: a SCHED_FIFO thread that never sleeps is throttled by Linux for 50 ms a second.
const SPIN_SHARE: f64 = 0.25;
/// Most periods that one step makes up for after late wake-ups.
const MAX_PERIODS_A_STEP: u64 = 5;

impl<T: Tool> HapticRenderer<T> {
    /// Renders `seconds` of real time, or until `stop` is set, in threads of its own. Each step's record goes to `sink`,
    /// called in this thread; its first error ends the session. However the session ends, the device is first sent a
    /// wrench of zero.
    ///
    /// # Errors
    /// Only what `sink` returns.
    ///
    /// # Panics
    /// If the device's driver or `sink` does; the records up to then have gone to `sink`.
    #[cfg_attr(feature = "tracing", tracing::instrument(skip_all, fields(seconds)))]
    pub fn run_realtime<E>(
        mut self,
        seconds: f64,
        stop: &AtomicBool,
        mut sink: impl FnMut(&T::Record) -> Result<(), E>,
    ) -> Result<Session, E> {
        let steps = steps_in(seconds, self.period);
        let (mut records_in, mut records_out) = RingBuffer::new(RECORD_RING);
        write_through(&mut records_in, &mut records_out);
        let channels = (0..self.contacts.len()).map(|body| channels(self.haptic.tool.body_state(body)));
        let (to_contacts, from_contacts): (Vec<_>, Vec<_>) = channels.unzip();
        // Whatever ends one of the threads, a panic included, must end the others.
        let ended = AtomicBool::new(false);
        let mut result = Ok(());

        let mut haptic = HapticThread {
            haptic: &mut self.haptic,
            device: self.device.as_mut(),
            period: self.period,
            contacts: to_contacts,
            records: records_in,
        };
        // All that the threads need is allocated.
        let memory = lock_memory();
        let (haptic, contact, machine, lasted) = std::thread::scope(|scope| {
            let _ended = SetOnDrop(&ended);
            let contact_threads: Vec<_> = self
                .contacts
                .iter_mut()
                .zip(from_contacts)
                .map(|(contact, channels)| {
                    let ended = &ended;
                    scope.spawn(move || {
                        let _ended = SetOnDrop(ended);
                        run_contact(contact, channels, ended)
                    })
                })
                .collect();
            let haptic_thread = scope.spawn(|| {
                let _ended = SetOnDrop(&ended);
                let setup = set_up(Role::Haptic);
                let before = MachineSample::take();
                let lasted =
                    haptic.run(steps, || stop.load(Ordering::Acquire) || ended.load(Ordering::Acquire));
                (setup, MachineSample::take().since(&before), lasted)
            });
            let mut drain = || {
                while let Ok(record) = records_out.pop() {
                    if result.is_ok() {
                        result = sink(&record);
                        ended.fetch_or(result.is_err(), Ordering::AcqRel);
                    }
                }
            };
            while !haptic_thread.is_finished() {
                drain();
                std::thread::sleep(RECORDER_NAP);
            }
            let outcome = haptic_thread.join();
            drain();
            let (setup, machine, lasted) = outcome.unwrap_or_else(|panic| resume_unwind(panic));
            let lasted = lasted.unwrap_or_else(|panic| resume_unwind(panic));
            let joined = contact_threads.into_iter().map(|thread| thread.join());
            let setups: Vec<_> =
                joined.map(|setup| setup.unwrap_or_else(|panic| resume_unwind(panic))).collect();
            (setup, setups.into_iter().next(), machine, lasted)
        });
        let setup = RealtimeSetup { device: self.device.thread_setup().cloned(), haptic, contact, memory };
        let clock = Clock::Real { setup: Box::new(setup) };
        let session = Session::close(self, lasted.as_secs_f64(), clock, machine);
        result.map(|()| session)
    }
}

/// Fills and empties the ring, so that its memory is there before the haptic thread writes to it.
fn write_through<R: Recorded>(records_in: &mut Producer<R>, records_out: &mut Consumer<R>) {
    while records_in.push(R::BLANK).is_ok() {}
    while records_out.pop().is_ok() {}
}

/// Sets a flag when dropped.
struct SetOnDrop<'a>(&'a AtomicBool);

impl Drop for SetOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Release);
    }
}

/// The haptic loop's end of the channels to and from a contact loop.
#[derive(Debug)]
pub(crate) struct ToContact {
    models: Consumer<ContactUpdate>,
    state: triple_buffer::Input<(f64, BodyState)>,
}

/// The contact loop's end.
#[derive(Debug)]
pub(crate) struct FromHaptic {
    models: Producer<ContactUpdate>,
    state: triple_buffer::Output<(f64, BodyState)>,
}

/// The channels between the haptic loop and the contact loop of a body that begins in a state.
pub(crate) fn channels(body: BodyState) -> (ToContact, FromHaptic) {
    let (models_in, models) = RingBuffer::new(MODEL_RING);
    let (state, state_out) = triple_buffer::triple_buffer(&(0.0, body));
    (ToContact { models, state }, FromHaptic { models: models_in, state: state_out })
}

impl ToContact {
    /// Takes the models that have arrived for each body.
    pub fn receive<T: Tool>(all: &mut [Self], haptic: &mut HapticLoop<T>) {
        for (body, channels) in all.iter_mut().enumerate() {
            while let Ok(update) = channels.models.pop() {
                haptic.take_model(body, &update);
            }
        }
    }

    /// Sends the state of each body after the step at `now` (s).
    pub fn send<T: Tool>(all: &mut [Self], haptic: &HapticLoop<T>, now: f64) {
        for (body, channels) in all.iter_mut().enumerate() {
            channels.state.write((now, haptic.tool.body_state(body)));
        }
    }
}

/// State of the haptic thread.
struct HapticThread<'a, T: Tool> {
    haptic: &'a mut HapticLoop<T>,
    device: &'a mut dyn HapticDevice,
    /// s.
    period: f64,
    contacts: Vec<ToContact>,
    records: Producer<T::Record>,
}

impl<T: Tool> HapticThread<'_, T> {
    /// Renders, then sends the device a wrench of zero: the hand must not stay under the last one while the other threads
    /// come to their end. How long it rendered; the panic of a device's driver is handed on.
    fn run(&mut self, steps: u64, stop: impl Fn() -> bool) -> Result<Duration, Box<dyn Any + Send>> {
        let rendered = catch_unwind(AssertUnwindSafe(|| self.render(steps, stop)));
        let released = catch_unwind(AssertUnwindSafe(|| {
            let gripper = self.device.gripper().map_or(Ok(()), |gripper| gripper.write(0.0));
            self.device.write(&Wrench::ZERO).and(gripper)
        }));
        let lasted = rendered?;
        if let Err(error) = released? {
            self.haptic.telemetry_mut().events.device_refused += 1;
            self.haptic.keep_device_error(error);
        }
        Ok(lasted)
    }

    fn render(&mut self, mut steps: u64, stop: impl Fn() -> bool) -> Duration {
        let period = self.period;
        // The last steps let the wrench fade out, so that the hand does not lunge.
        let fading = (FADE / period).ceil() as u64;
        let sleeper = sleeper(period);
        let start = Instant::now();
        let mut last = 0;
        let mut stepped = Duration::ZERO;
        while last < steps {
            let next = last + 1;
            let deadline = Duration::from_nanos((next as f64 * period * 1e9) as u64);
            sleeper.sleep_until(start + deadline);
            let woke = start.elapsed();
            let lateness = woke.saturating_sub(deadline);
            let missed = (lateness.as_secs_f64() / period) as u64;
            let tick = (next + missed).min(steps);

            ToContact::receive(&mut self.contacts, self.haptic);
            if steps - tick <= fading || stop() {
                self.haptic.leave();
                steps = steps.min(tick + fading);
            }
            let now = tick as f64 * period;
            let dt = (tick - last).min(MAX_PERIODS_A_STEP) as f64 * period;
            let record = self.haptic.step_device(self.device, now, dt);
            ToContact::send(&mut self.contacts, self.haptic, now);
            let dropped = self.records.push(record).is_err();

            let telemetry = self.haptic.telemetry_mut();
            telemetry.events.record_dropped += u64::from(dropped);
            let skipped = tick - next;
            let by_step = missed_by_step(skipped, stepped.saturating_sub(deadline), period);
            telemetry.missed_deadlines += skipped;
            telemetry.missed_by_step += by_step;
            telemetry.missed_by_machine += skipped - by_step;
            telemetry.wake.record(lateness.as_nanos() as u64);
            stepped = start.elapsed();
            telemetry.step.record((stepped - woke).as_nanos() as u64);
            last = tick;
        }
        start.elapsed()
    }
}

/// How many of the skipped periods passed while the step before was still running, `overrun` being how long after the deadline
/// that came next it ended. A loop that wakes late skips periods, so that a step starts less than a period (s) after its
/// own deadline: one that overruns the next deadline by a period took longer than a period itself.
fn missed_by_step(skipped: u64, overrun: Duration, period: f64) -> u64 {
    ((overrun.as_secs_f64() / period) as u64).min(skipped)
}

/// How the haptic thread sleeps between deadlines that are `period` (s) apart.
pub(crate) fn sleeper(period: f64) -> SpinSleeper {
    let spin = SPIN.min(SPIN_SHARE * period);
    SpinSleeper::new((spin * 1e9) as u32).with_spin_strategy(SpinStrategy::SpinLoopHint)
}

/// The contact thread: as fast as it can, but never twice for the same state. What it obtained of the operating system.
pub(crate) fn run_contact(
    contact: &mut ContactLoop,
    FromHaptic { mut models, mut state }: FromHaptic,
    ended: &AtomicBool,
) -> ThreadSetup {
    let setup = set_up(Role::Contact);
    let mut first = true;
    while !ended.load(Ordering::Acquire) {
        if !state.update() && !first {
            std::thread::sleep(CONTACT_NAP);
            continue;
        }
        first = false;
        let (time, body) = *state.output_buffer_mut();
        let begun = Instant::now();
        let update = contact.step(&body, time);
        let telemetry = contact.telemetry_mut();
        telemetry.query.record(begun.elapsed().as_nanos() as u64);
        telemetry.events.model_dropped += u64::from(models.push(update).is_err());
    }
    setup
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn periods_are_missed_by_the_step_only_while_it_runs() {
        let ms = Duration::from_millis;
        // A step that ended in time: whatever is missed, the machine was late.
        assert_eq!(missed_by_step(4, Duration::ZERO, 1e-3), 0);
        // It ended half a period after the deadline, and the thread was resumed later still.
        assert_eq!(missed_by_step(4, Duration::from_micros(500), 1e-3), 0);
        assert_eq!(missed_by_step(4, ms(3), 1e-3), 3);
        assert_eq!(missed_by_step(4, ms(9), 1e-3), 4);
        assert_eq!(missed_by_step(0, ms(9), 1e-3), 0);
    }
}
