//! The real-time driver: a haptic thread, a contact thread, and the caller's thread as the recorder.
//!
//! The haptic thread wakes at absolute deadlines (sleep, then a short spin), under SCHED_FIFO where that is allowed. It
//! hands the body's state to the contact thread through a triple buffer (the latest wins), takes contact models from a
//! lock-free ring, and puts records into another; none of them ever makes it wait. Periods that it wakes too late for
//! are counted and skipped, never replayed.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use palpate_dynamics::BodyState;
use rtrb::{Consumer, Producer, RingBuffer};
use spin_sleep::{SpinSleeper, SpinStrategy};
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

use crate::contact_loop::{ContactLoop, ContactUpdate};
use crate::lockstep::steps_in;
use crate::record::Record;
use crate::renderer::HapticRenderer;
use crate::session::{Clock, Session};

/// Contact models that may wait for the haptic thread.
const MODEL_RING: usize = 8;
/// Records that may wait for the recorder: four seconds at 1 kHz.
const RECORD_RING: usize = 4096;
/// How long the recorder sleeps when it has caught up.
const RECORDER_NAP: Duration = Duration::from_millis(5);
/// How long the contact thread waits for a body state that it has not seen.
const CONTACT_NAP: Duration = Duration::from_micros(50);
/// The haptic thread sleeps until this long before a deadline, and spins the rest.
const SPIN_NS: u32 = 100_000;
/// Most periods that one step makes up for after late wake-ups.
const MAX_PERIODS_A_STEP: u64 = 5;
/// SCHED_FIFO priority asked for.
const PRIORITY: u8 = 80;

impl HapticRenderer {
    /// Renders `seconds` of real time, or until `stop` is set, in threads of its own. Each step's record goes to `sink`,
    /// called in this thread; its first error ends the session.
    ///
    /// # Errors
    /// Only what `sink` returns.
    pub fn run_realtime<E>(
        mut self,
        seconds: f64,
        stop: &AtomicBool,
        mut sink: impl FnMut(&Record) -> Result<(), E>,
    ) -> Result<Session, E> {
        let steps = steps_in(seconds, self.period);
        let (models_in, models_out) = RingBuffer::new(MODEL_RING);
        let (records_in, mut records_out) = RingBuffer::new(RECORD_RING);
        let (state_in, state_out) = triple_buffer::triple_buffer(&(0.0, *self.haptic.body_state()));
        let ended = AtomicBool::new(false);
        let begun = Instant::now();
        let mut result = Ok(());
        let mut scheduling = String::new();

        let contact = &mut self.contact;
        let mut haptic = HapticThread {
            haptic: &mut self.haptic,
            device: self.device.as_mut(),
            period: self.period,
            models: models_out,
            records: records_in,
            state: state_in,
        };
        std::thread::scope(|scope| {
            scope.spawn(|| run_contact(contact, state_out, models_in, &ended));
            let haptic_thread = scope.spawn(|| {
                // Whatever ends this thread, a panic of a device driver included, must end the others too.
                let _ended = SetOnDrop(&ended);
                let scheduling = ask_for_realtime();
                haptic.run(steps, stop);
                scheduling
            });
            loop {
                let finished = ended.load(Ordering::Acquire);
                while let Ok(record) = records_out.pop() {
                    if result.is_ok() {
                        result = sink(&record);
                        if result.is_err() {
                            stop.store(true, Ordering::Release);
                        }
                    }
                }
                if finished {
                    break;
                }
                std::thread::sleep(RECORDER_NAP);
            }
            match haptic_thread.join() {
                Ok(got) => scheduling = got,
                Err(panic) => std::panic::resume_unwind(panic),
            }
        });
        let seconds = begun.elapsed().as_secs_f64();
        let session = Session::close(self, seconds, Clock::Real { scheduling });
        result.map(|()| session)
    }
}

/// Sets a flag when dropped.
struct SetOnDrop<'a>(&'a AtomicBool);

impl Drop for SetOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Release);
    }
}

/// What the haptic thread works with.
struct HapticThread<'a> {
    haptic: &'a mut crate::haptic_loop::HapticLoop,
    device: &'a mut dyn palpate_device::HapticDevice,
    period: f64,
    models: Consumer<ContactUpdate>,
    records: Producer<Record>,
    state: triple_buffer::Input<(f64, BodyState)>,
}

impl HapticThread<'_> {
    fn run(&mut self, steps: u64, stop: &AtomicBool) {
        let sleeper = SpinSleeper::new(SPIN_NS).with_spin_strategy(SpinStrategy::SpinLoopHint);
        let period = Duration::from_secs_f64(self.period);
        let start = Instant::now();
        let mut last = 0;
        while last < steps && !stop.load(Ordering::Acquire) {
            let next = last + 1;
            sleeper.sleep_until(start + period_times(period, next));
            let woke = start.elapsed();
            let lateness = woke.saturating_sub(period_times(period, next));
            let missed = (lateness.as_nanos() / period.as_nanos().max(1)) as u64;
            let tick = (next + missed).min(steps);

            while let Ok(update) = self.models.pop() {
                self.haptic.update_contacts(&update);
            }
            let now = tick as f64 * self.period;
            let dt = (tick - last).min(MAX_PERIODS_A_STEP) as f64 * self.period;
            let record = self.haptic.step_device(self.device, now, dt);
            self.state.write((now, *self.haptic.body_state()));
            let dropped = self.records.push(record).is_err();

            let telemetry = self.haptic.telemetry_mut();
            telemetry.events.record_dropped += u64::from(dropped);
            telemetry.missed_deadlines += tick - next;
            telemetry.wake.record(lateness.as_nanos() as u64);
            telemetry.step.record((start.elapsed() - woke).as_nanos() as u64);
            last = tick;
        }
    }
}

/// `count` periods.
fn period_times(period: Duration, count: u64) -> Duration {
    Duration::from_nanos(period.as_nanos() as u64 * count)
}

/// The contact thread: as fast as it can, but never twice for the same state.
fn run_contact(
    contact: &mut ContactLoop,
    mut state: triple_buffer::Output<(f64, BodyState)>,
    mut models: Producer<ContactUpdate>,
    ended: &AtomicBool,
) {
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
}

/// Asks for SCHED_FIFO for the calling thread; what was obtained, for the report.
fn ask_for_realtime() -> String {
    if !cfg!(target_os = "linux") {
        return "normal: SCHED_FIFO is asked for on Linux only".to_owned();
    }
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    let asked =
        ThreadPriorityValue::try_from(PRIORITY).map_err(|error| error.to_string()).and_then(|priority| {
            set_thread_priority_and_policy(
                thread_native_id(),
                ThreadPriority::Crossplatform(priority),
                policy,
            )
            .map_err(|error| format!("{error:?}"))
        });
    match asked {
        Ok(()) => format!("SCHED_FIFO, priority {PRIORITY}"),
        Err(why) => {
            format!("normal: SCHED_FIFO was refused ({why}); allow it with a `rtprio` limit or CAP_SYS_NICE")
        }
    }
}
