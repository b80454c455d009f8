//! The real-time driver: a haptic thread, a contact thread for each body, and the caller's thread as the
//! recorder.
//!
//! The haptic thread wakes at absolute deadlines (sleep, then a short spin), under SCHED_FIFO where that is
//! allowed. It passes the body's state to the contact thread through a triple buffer (the latest wins), takes
//! contact models from a lock-free ring, and puts records into another; it never waits for any of them.
//! Periods that it wakes too late for are counted and skipped, never replayed.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use palpate_core::Wrench;
use palpate_device::HapticDevice;
use palpate_dynamics::BodyState;
use palpate_realtime::{Role, ThreadSetup, lock_memory, set_up};
use rtrb::{Consumer, Producer, RingBuffer};
use spin_sleep::{SpinSleeper, SpinStrategy};

use crate::contact_loop::{ContactLoop, ContactUpdate, Pull};
use crate::haptic::HapticLoop;
use crate::haptic::presence::FADE;
use crate::run::lockstep::steps_in;
use crate::run::machine::{MachineLoad, MachineSample};
use crate::run::renderer::HapticRenderer;
use crate::run::session::{Clock, RealtimeSetup, Session};
use crate::telemetry::record::Recorded;
use crate::tool::Tool;

/// Capacity of the ring of contact models. When it is full, new models are dropped and counted.
const MODEL_RING: usize = 8;
/// Capacity of the ring of records: four seconds at 1 kHz. When it is full, records are dropped and counted.
const RECORD_RING: usize = 4096;
/// Sleep of the recorder when it has caught up. It must be well below the time that fills the ring of
/// records.
const RECORDER_SLEEP: Duration = Duration::from_millis(5);
/// Sleep of the contact thread until it polls for a new body state. A longer sleep makes contact models
/// older.
const CONTACT_SLEEP: Duration = Duration::from_micros(50);
/// Time before a deadline at which the haptic thread wakes and starts to spin, s. A shorter time makes it
/// wake late more often; a longer one takes more processor time.
const SPIN: f64 = 1e-4;
/// Largest part of a period that is spent spinning. Linux throttles a SCHED_FIFO thread that never sleeps,
/// for 50 ms each second.
const MAX_SPIN_SHARE: f64 = 0.25;
/// Largest number of periods that one step integrates after late wake-ups. With more, the object could jump.
const MAX_PERIODS_A_STEP: u64 = 5;

impl<T: Tool> HapticRenderer<T> {
    /// Renders for `seconds` of real time, or until `stop` is set, in threads of its own. Calls `sink` in
    /// this thread with the record of each step; its first error ends the session. However the session ends,
    /// the device receives a wrench of zero.
    ///
    /// # Errors
    /// The first error that `sink` returns.
    ///
    /// # Panics
    /// If the device's driver or `sink` panics. If the driver does, `sink` has received all records up to
    /// then.
    #[cfg_attr(feature = "tracing", tracing::instrument(skip_all, fields(seconds)))]
    pub fn run_realtime<E>(
        mut self,
        seconds: f64,
        stop: &AtomicBool,
        sink: impl FnMut(&T::Record) -> Result<(), E>,
    ) -> Result<Session, E> {
        let steps = steps_in(seconds, self.period);
        let (records, consumer) = record_ring();
        let channels = (0..self.contacts.len()).map(|body| channels(self.haptic.tool.body_state(body)));
        let (to_contacts, from_haptic): (Vec<_>, Vec<_>) = channels.unzip();
        // A thread that ends, even by a panic, must end the others.
        let ended = AtomicBool::new(false);
        let mut recorder = Recorder { records: consumer, sink, result: Ok(()) };
        let mut haptic = HapticThread {
            haptic: &mut self.haptic,
            device: self.device.as_mut(),
            period: self.period,
            contacts: to_contacts,
            records,
        };
        // By now all memory that the threads need is allocated.
        let memory = lock_memory();
        let (haptic, contact, machine, lasted) = std::thread::scope(|scope| {
            let _ended = SetOnDrop(&ended);
            let contacts = self.contacts.iter_mut().zip(from_haptic);
            let contact_threads: Vec<_> = contacts
                .map(|(contact, channels)| {
                    scope.spawn(|| {
                        let _ended = SetOnDrop(&ended);
                        run_contact(contact, channels, &ended)
                    })
                })
                .collect();
            let haptic_thread = scope.spawn(|| haptic.run(steps, stop, &ended));
            while !haptic_thread.is_finished() {
                recorder.drain(&ended);
                std::thread::sleep(RECORDER_SLEEP);
            }
            let outcome = haptic_thread.join();
            recorder.drain(&ended);
            let (setup, machine, lasted) = or_resume(outcome);
            let setups: Vec<_> = contact_threads.into_iter().map(|thread| or_resume(thread.join())).collect();
            (setup, setups.into_iter().next(), machine, lasted)
        });
        let setup = RealtimeSetup { device: self.device.thread_setup().cloned(), haptic, contact, memory };
        let clock = Clock::Real { setup: Box::new(setup) };
        let session = Session::close(self, lasted.as_secs_f64(), clock, machine);
        recorder.result.map(|()| session)
    }
}

/// Makes the ring of records. It is filled and emptied, so that its pages are mapped before the haptic thread
/// writes to them.
fn record_ring<R: Recorded>() -> (Producer<R>, Consumer<R>) {
    let (mut producer, mut consumer) = RingBuffer::new(RECORD_RING);
    while producer.push(R::BLANK).is_ok() {}
    while consumer.pop().is_ok() {}
    (producer, consumer)
}

/// The value of a thread, or its panic in this thread.
fn or_resume<V>(outcome: std::thread::Result<V>) -> V {
    outcome.unwrap_or_else(|panic| resume_unwind(panic))
}

/// Takes the records of the haptic thread out of their ring.
struct Recorder<R, E, S> {
    records: Consumer<R>,
    sink: S,
    /// First error of the sink.
    result: Result<(), E>,
}

impl<R, E, S: FnMut(&R) -> Result<(), E>> Recorder<R, E, S> {
    /// Passes the records that have arrived to the sink, until its first error; that sets `ended`.
    fn drain(&mut self, ended: &AtomicBool) {
        while let Ok(record) = self.records.pop() {
            if self.result.is_ok() {
                self.result = (self.sink)(&record);
                ended.fetch_or(self.result.is_err(), Ordering::AcqRel);
            }
        }
    }
}

/// Sets a flag when dropped.
struct SetOnDrop<'a>(&'a AtomicBool);

impl Drop for SetOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Release);
    }
}

/// Time (s), state of a body and how the hand pulls it.
type Moment = (f64, BodyState, Pull);

/// Haptic loop's end of the channels to and from a contact loop.
#[derive(Debug)]
pub(crate) struct ToContact {
    models: Consumer<ContactUpdate>,
    state: triple_buffer::Input<Moment>,
}

/// Contact loop's end of the channels to and from the haptic loop.
#[derive(Debug)]
pub(crate) struct FromHaptic {
    models: Producer<ContactUpdate>,
    state: triple_buffer::Output<Moment>,
}

/// Makes the channels between the haptic loop and the contact loop of a body, with the body's initial state.
pub(crate) fn channels(body: BodyState) -> (ToContact, FromHaptic) {
    let (models_in, models) = RingBuffer::new(MODEL_RING);
    let (state, state_out) = triple_buffer::triple_buffer(&(0.0, body, Pull::default()));
    (ToContact { models, state }, FromHaptic { models: models_in, state: state_out })
}

impl ToContact {
    /// Passes the contact models that have arrived for each body to the haptic loop.
    pub fn receive<T: Tool>(all: &mut [Self], haptic: &mut HapticLoop<T>) {
        for (body, channels) in all.iter_mut().enumerate() {
            // Read in place: a model is large.
            let Ok(arrived) = channels.models.read_chunk(channels.models.slots()) else { continue };
            let (first, second) = arrived.as_slices();
            first.iter().chain(second).for_each(|update| haptic.take_model(body, update));
            arrived.commit_all();
        }
    }

    /// Sends the state of each body after the step at `now` (s).
    pub fn send<T: Tool>(all: &mut [Self], haptic: &HapticLoop<T>, now: f64) {
        for (body, channels) in all.iter_mut().enumerate() {
            channels.state.write((now, haptic.tool.body_state(body), haptic.pull_of(body)));
        }
    }
}

/// State of the haptic thread.
struct HapticThread<'a, T: Tool> {
    haptic: &'a mut HapticLoop<T>,
    device: &'a mut dyn HapticDevice,
    /// Period of the haptic loop, s.
    period: f64,
    contacts: Vec<ToContact>,
    records: Producer<T::Record>,
}

impl<T: Tool> HapticThread<'_, T> {
    /// Runs the haptic thread: renders, then releases the device. Returns what the operating system granted
    /// to the thread, how busy the machine was, and how long it rendered.
    ///
    /// # Panics
    /// If the device's driver panics; the device is released even then.
    fn run(
        &mut self,
        steps: u64,
        stop: &AtomicBool,
        ended: &AtomicBool,
    ) -> (ThreadSetup, MachineLoad, Duration) {
        let _ended = SetOnDrop(ended);
        let setup = set_up(Role::Haptic);
        let before = MachineSample::take();
        let stop = || stop.load(Ordering::Acquire) || ended.load(Ordering::Acquire);
        let rendered = catch_unwind(AssertUnwindSafe(|| self.render(steps, stop)));
        // The hand must not stay under the last wrench while the other threads end.
        let released = catch_unwind(AssertUnwindSafe(|| {
            let gripper = self.device.gripper().map_or(Ok(()), |gripper| gripper.write(0.0));
            self.device.write(&Wrench::ZERO).and(gripper)
        }));
        let lasted = or_resume(rendered);
        if let Err(error) = or_resume(released) {
            self.haptic.telemetry_mut().events.device_refused += 1;
            self.haptic.keep_device_error(error);
        }
        (setup, MachineSample::take().since(&before), lasted)
    }

    /// Takes a haptic step at each deadline, up to `steps` of them or until `stop`. Returns how long that
    /// took.
    fn render(&mut self, mut steps: u64, stop: impl Fn() -> bool) -> Duration {
        let period = self.period;
        // The wrench fades out over the last steps, so that the hand does not lunge.
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

/// Number of skipped periods that passed while the previous step was still running; `overrun` is the time by
/// which that step ended after the next deadline. Since a loop that wakes late skips periods, a step starts
/// less than a period (s) after its own deadline: a step that overruns the next deadline by a period has
/// itself taken longer than a period.
fn missed_by_step(skipped: u64, overrun: Duration, period: f64) -> u64 {
    ((overrun.as_secs_f64() / period) as u64).min(skipped)
}

/// Makes the sleeper of the haptic thread, for deadlines that are `period` (s) apart.
pub(crate) fn sleeper(period: f64) -> SpinSleeper {
    let spin = SPIN.min(MAX_SPIN_SHARE * period);
    SpinSleeper::new((spin * 1e9) as u32).with_spin_strategy(SpinStrategy::SpinLoopHint)
}

/// Runs a contact thread until `ended` is set: contact steps as fast as possible, but never two for the same
/// state. Returns what the operating system granted to the thread.
pub(crate) fn run_contact(
    contact: &mut ContactLoop,
    FromHaptic { mut models, mut state }: FromHaptic,
    ended: &AtomicBool,
) -> ThreadSetup {
    let setup = set_up(Role::Contact);
    let mut first = true;
    while !ended.load(Ordering::Acquire) {
        if !state.update() && !first {
            std::thread::sleep(CONTACT_SLEEP);
            continue;
        }
        first = false;
        let (time, body, pull) = *state.output_buffer_mut();
        let begun = Instant::now();
        let update = contact.step_pulled(&body, &pull, time);
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
        // The step ended in time, so the machine missed all periods.
        assert_eq!(missed_by_step(4, Duration::ZERO, 1e-3), 0);
        // The step ended half a period after the deadline, and the thread was resumed even later.
        assert_eq!(missed_by_step(4, Duration::from_micros(500), 1e-3), 0);
        assert_eq!(missed_by_step(4, ms(3), 1e-3), 3);
        assert_eq!(missed_by_step(4, ms(9), 1e-3), 4);
        assert_eq!(missed_by_step(0, ms(9), 1e-3), 0);
    }
}
