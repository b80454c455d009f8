//! The haptic thread's side of a link.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use palpate_core::{Pose, Twist, Wrench};
use palpate_realtime::ThreadSetup;

use super::clock::{Clock, Lead};
use super::codec::Motion;
use super::pump::{News, Order};
use crate::clip::clipped;
use crate::{DeviceError, DeviceState, HapticDevice, Specification, Status};

/// Distance from the origin, in radii of the workspace, beyond which a position is not valid: millimetres
/// were taken for metres, or encoders have lost count.
const MAX_DISTANCE: f64 = 4.0;
/// Longest time that closing waits for the pump to write its last reports.
const CLOSE_TIMEOUT: Duration = Duration::from_millis(200);

/// Silence after which a device that sends only when it is moved counts as at rest, s. Most send every 1 to
/// 10 ms.
pub(crate) const REST_SILENCE: f64 = 12e-3;

/// The haptic thread's side of a link. Made by a [`Link`](super::Link).
pub struct LinkedDevice<M: Motion> {
    specification: Specification,
    motion: M,
    silence: f64,
    heard: triple_buffer::Output<News<M::Sample>>,
    asked: triple_buffer::Input<Order>,
    /// State of the pump at the last read.
    seen: News<M::Sample>,
    order: Order,
    /// The pump's clock, and its lead over the reader's if they differ.
    clock: Clock,
    lead: Option<Lead>,
    /// Number of withheld wrenches reported so far.
    withheld: u64,
    /// Arrival time of the last report, and the latest time of a read, s.
    arrived: f64,
    now: f64,
    /// Whether the pose changes without reports, as that of a rate-controlled device does.
    moves_alone: bool,
    state: DeviceState,
    /// Reason why the device cannot be read; empty if it can.
    lost: Status,
    events: Status,
    closed: bool,
    pump: Option<(Arc<AtomicBool>, JoinHandle<()>)>,
    /// Scheduling that the pump's thread obtained.
    setup: Arc<OnceLock<ThreadSetup>>,
}

impl<M: Motion> HapticDevice for LinkedDevice<M> {
    fn specification(&self) -> &Specification {
        &self.specification
    }

    fn read(&mut self, now: f64) -> Result<DeviceState, DeviceError> {
        if self.closed {
            return Err(DeviceError::Closed);
        }
        if now.is_finite() && now >= self.now {
            self.now = now;
            self.clock.set(now);
            if let Some(lead) = &mut self.lead {
                lead.update(now, self.clock.now());
            }
        } else {
            self.events |= Status::CLOCK;
        }
        let news = *self.heard.read();
        let before = std::mem::replace(&mut self.seen, news);
        let more = |count: fn(&News<M::Sample>) -> u64| count(&news) > count(&before);
        if more(|news| news.malformed) {
            self.events |= Status::MALFORMED;
        }
        if more(|news| news.unwritten) {
            self.events |= Status::UNWRITTEN;
        }
        if more(|news| news.arrivals) {
            self.motion.restart();
        }
        let fresh = more(|news| news.reports);
        if fresh {
            self.arrived =
                self.lead.map_or(news.arrived, |lead| lead.reader_time(news.arrived)).min(self.now);
        }
        // A pump whose thread has ended, by a panic, publishes nothing more.
        let ended = self.pump.as_ref().is_some_and(|(_, thread)| thread.is_finished());
        self.lost = if !news.connected || ended {
            Status::DISCONNECTED
        } else if self.silence.is_finite() && self.now - self.arrived > self.silence {
            Status::SILENT
        } else {
            Status::OK
        };
        if !self.lost.is_ok() {
            return Err(DeviceError::Lost { status: self.lost });
        }
        let came = fresh.then_some(self.arrived);
        let (pose, twist, buttons) = self.motion.advance(&news.sample, came, self.now);
        let mut status = std::mem::take(&mut self.events);
        if !news.enabled {
            status |= Status::NOT_ENABLED;
        }
        if news.withheld > std::mem::replace(&mut self.withheld, news.withheld) {
            status |= Status::WITHHELD;
        }
        let far = pose.translation.length() > MAX_DISTANCE * self.specification.workspace_radius;
        if pose.is_valid() && twist.is_finite() && !far {
            self.moves_alone |= !fresh && pose != self.state.pose;
            let time = if self.is_of_report() { self.arrived } else { self.now };
            let time = time.max(self.state.time);
            self.state = DeviceState { time, pose, twist, buttons, ..self.state };
        } else {
            (self.state.twist, self.state.buttons) = (Twist::ZERO, buttons);
            status |= Status::HELD;
        }
        if self.state.pose.translation.length() > self.specification.workspace_radius {
            status |= Status::OUTSIDE_WORKSPACE;
        }
        Ok(DeviceState { status, ..self.state })
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceError> {
        if self.closed {
            return Err(DeviceError::Closed);
        }
        let (wrench, events) = clipped(wrench, &self.specification);
        self.events |= events;
        if self.lost.is_ok() {
            self.ask(wrench);
            return Ok(());
        }
        if wrench != Wrench::ZERO {
            self.events |= Status::WITHHELD;
        }
        self.ask(Wrench::ZERO);
        Err(DeviceError::Lost { status: self.lost })
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        self.end();
        Ok(())
    }

    fn thread_setup(&self) -> Option<&ThreadSetup> {
        self.setup.get()
    }
}

impl<M: Motion> LinkedDevice<M> {
    pub(super) fn new(
        specification: Specification,
        motion: M,
        silence: f64,
        heard: triple_buffer::Output<News<M::Sample>>,
        asked: triple_buffer::Input<Order>,
    ) -> Self {
        Self {
            specification,
            motion,
            silence,
            heard,
            asked,
            seen: News::default(),
            order: Order::default(),
            clock: Clock::Rounds(0.0),
            lead: None,
            withheld: 0,
            arrived: f64::NEG_INFINITY,
            now: 0.0,
            moves_alone: false,
            state: DeviceState {
                time: 0.0,
                pose: Pose::IDENTITY,
                twist: Twist::ZERO,
                buttons: 0,
                status: Status::OK,
            },
            lost: Status::SILENT,
            events: Status::OK,
            closed: false,
            pump: None,
            setup: Arc::default(),
        }
    }

    /// Whether the pose holds for the time of the last report: true unless the device moves without reports,
    /// or is silent because it rests.
    fn is_of_report(&self) -> bool {
        self.silence.is_finite() || !self.moves_alone && self.now - self.arrived <= REST_SILENCE
    }

    /// Sets the pump's thread, which ends when `stop` is set.
    pub(super) fn run_by(&mut self, stop: Arc<AtomicBool>, thread: JoinHandle<()>) {
        self.pump = Some((stop, thread));
    }

    /// The cell into which the pump's thread puts the scheduling that it obtained.
    pub(super) fn thread_setup_cell(&self) -> Arc<OnceLock<ThreadSetup>> {
        Arc::clone(&self.setup)
    }

    /// Measures the pump's times from an instant.
    pub(super) fn keep_time(&mut self, start: Instant) {
        (self.clock, self.lead) = (Clock::Since(start), Some(Lead::default()));
    }

    /// Replaces specification and motion by those of the device that was found.
    #[cfg(any(feature = "force-dimension", feature = "open-haptics", feature = "haption"))]
    pub(super) fn specify(&mut self, specification: Specification, motion: M) {
        (self.specification, self.motion) = (specification, motion);
    }

    /// Waits for the first report of a device that sends by itself.
    pub(super) fn await_first_report(&mut self, timeout: Duration) {
        let start = Instant::now();
        while self.silence.is_finite() && self.heard.read().reports == 0 && start.elapsed() < timeout {
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    fn ask(&mut self, wrench: Wrench) {
        let (number, made) = (self.order.number + 1, self.clock.now());
        self.order = Order { wrench, number, made, withheld: self.withheld };
        self.asked.write(self.order);
    }

    /// Releases the device. A pump that hangs in a system call is left to itself.
    fn end(&mut self) {
        self.ask(Wrench::ZERO);
        self.closed = true;
        if let Some((stop, thread)) = self.pump.take() {
            stop.store(true, Ordering::Release);
            let start = Instant::now();
            while !thread.is_finished() && start.elapsed() < CLOSE_TIMEOUT {
                std::thread::sleep(Duration::from_millis(1));
            }
        }
    }
}

impl<M: Motion> Drop for LinkedDevice<M> {
    fn drop(&mut self) {
        self.end();
    }
}

impl<M: Motion> std::fmt::Debug for LinkedDevice<M> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LinkedDevice").field("specification", &self.specification).finish_non_exhaustive()
    }
}
