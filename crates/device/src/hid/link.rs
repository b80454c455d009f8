//! Between the haptic thread and a device's reports.
//!
//! A system call for a report may take its time: it is made in a thread of its own ([`Pump`]), which hands the newest
//! [`Codec::Sample`] to the haptic thread and takes the newest wrench from it, through triple buffers. The haptic thread
//! ([`LinkedDevice`]) never waits for it.
//!
//! The wrench is zero where the device is not heard of, where the haptic thread does not renew it in time, and, after the
//! device was gone, until it is asked for anew.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use palpate_core::{Pose, Twist, Wrench};

use super::transport::{LONGEST_REPORT, Transport, TransportError};
use crate::clip::clipped;
use crate::{DeviceError, DeviceState, HapticDevice, Specification, Status};

/// A wrench that is not renewed for this long is taken back, s.
const RENEWAL: f64 = 8e-3;
/// A device that is gone is looked for this often, s.
const SEARCH: f64 = 0.5;
/// How long the pump rests while there is no device.
const REST: Duration = Duration::from_millis(20);
/// Reports taken in one round at most, and failures put up with in one: a device that floods the queue is not to hold up what is
/// written.
const ROUND: usize = 128;
const FAILURES: usize = 8;
/// How long opening waits for the first report.
const FIRST_WORD: Duration = Duration::from_millis(500);
/// How long closing waits for the pump to write its last reports.
const FAREWELL: Duration = Duration::from_millis(200);

/// A report that is not one of the device's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Malformed;

/// A report to write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Report {
    bytes: [u8; LONGEST_REPORT],
    length: usize,
}

impl Report {
    /// A report that begins with these bytes and goes on with zeros up to a length, of at most [`LONGEST_REPORT`].
    pub fn new(bytes: &[u8], length: usize) -> Self {
        let mut report = Self { bytes: [0; LONGEST_REPORT], length: length.min(LONGEST_REPORT) };
        report.bytes.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
        report
    }

    /// Its bytes.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[..self.length]
    }
}

/// The language of a kind of device.
pub trait Codec: Send + 'static {
    /// What its reports tell.
    type Sample: Copy + Default + Send + std::fmt::Debug + 'static;

    /// Adds a report to what is known.
    ///
    /// # Errors
    /// If it is none of the device's; nothing is changed then.
    fn decode(&mut self, report: &[u8], sample: &mut Self::Sample) -> Result<(), Malformed>;

    /// Says the reports that ask for a wrench on the hand (device axes), by what is known; none where there is nothing to say.
    fn encode(&mut self, wrench: &Wrench, sample: &Self::Sample, say: &mut dyn FnMut(Report));

    /// What is said first, and first after the device has come back.
    ///
    /// # Errors
    /// If the device does not take part: it is tried anew later.
    fn start(&mut self, transport: &mut dyn Transport) -> Result<(), TransportError> {
        let _ = transport;
        Ok(())
    }

    /// What is said last, after a wrench of zero.
    ///
    /// # Errors
    /// If the device does not take it.
    fn stop(&mut self, transport: &mut dyn Transport) -> Result<(), TransportError> {
        let _ = transport;
        Ok(())
    }
}

/// How the handle moves, by what a device's reports tell.
pub trait Motion: Send {
    /// What the reports tell.
    type Sample: Copy + Default + Send + 'static;

    /// Pose and twist of the handle (device axes) and the buttons at the driver's time `now` (s); `fresh` where a report came
    /// since the last call.
    fn advance(&mut self, sample: &Self::Sample, fresh: bool, now: f64) -> (Pose, Twist, u32);

    /// The device was gone: what was known of its motion says nothing now.
    fn restart(&mut self) {}
}

/// What the pump tells.
#[derive(Clone, Copy, Debug, Default)]
struct News<S> {
    sample: S,
    connected: bool,
    /// Reports that were understood, those that were not, writes that failed, and how often the device came.
    reports: u64,
    malformed: u64,
    unwritten: u64,
    arrivals: u64,
}

/// What the haptic thread asks for.
#[derive(Clone, Copy, Debug, Default)]
struct Order {
    wrench: Wrench,
    number: u64,
}

/// The side of the reports.
pub struct Pump<C: Codec> {
    codec: C,
    open: Box<dyn FnMut() -> Option<Box<dyn Transport>> + Send>,
    transport: Option<Box<dyn Transport>>,
    /// How long a round waits for a report.
    patience: Duration,
    /// Whether a device that is silent is one that is not well.
    talks: bool,
    news: News<C::Sample>,
    told: triple_buffer::Input<News<C::Sample>>,
    orders: triple_buffer::Output<Order>,
    /// The last order, when it came (s), and the last one from before the device came.
    order: u64,
    ordered: f64,
    stale: u64,
    searched: f64,
}

/// How a device is linked.
pub struct Link<C: Codec, M> {
    /// Its language.
    pub codec: C,
    /// Its motion.
    pub motion: M,
    /// What it can do.
    pub specification: Specification,
    /// How long a round of the [`Pump`] waits for a report.
    pub patience: Duration,
    /// How long the device may be silent before it counts as lost, s: infinite for one that speaks only when it is moved.
    pub silence: f64,
}

impl<C: Codec, M: Motion<Sample = C::Sample>> Link<C, M> {
    /// Both sides of a device that `open` opens, now and whenever it has gone. The pump's rounds are the caller's.
    pub fn split(
        self,
        mut open: impl FnMut() -> Option<Box<dyn Transport>> + Send + 'static,
    ) -> (Pump<C>, LinkedDevice<M>) {
        let Self { codec, motion, specification, patience, silence } = self;
        let (told, heard) = triple_buffer::triple_buffer(&News::default());
        let (asked, orders) = triple_buffer::triple_buffer(&Order::default());
        let transport = open();
        let mut pump = Pump {
            codec,
            open: Box::new(open),
            transport: None,
            patience,
            talks: silence.is_finite(),
            news: News::default(),
            told,
            orders,
            order: 0,
            ordered: f64::NEG_INFINITY,
            stale: 0,
            searched: f64::NEG_INFINITY,
        };
        if let Some(transport) = transport {
            pump.meet(transport);
        }
        let device = LinkedDevice {
            specification,
            motion,
            silence,
            heard,
            asked,
            seen: News::default(),
            order: Order::default(),
            fresh: f64::NEG_INFINITY,
            now: 0.0,
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
        };
        (pump, device)
    }

    /// A device with its pump in a thread.
    pub fn spawn(
        self,
        open: impl FnMut() -> Option<Box<dyn Transport>> + Send + 'static,
    ) -> std::io::Result<LinkedDevice<M>> {
        let (mut pump, mut device) = self.split(open);
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        let thread = std::thread::Builder::new().name("palpate-hid".into()).spawn(move || {
            let start = Instant::now();
            while !stopped.load(Ordering::Acquire) {
                if !pump.round(start.elapsed().as_secs_f64()) {
                    std::thread::sleep(REST);
                }
            }
            pump.end();
        })?;
        device.pump = Some((stop, thread));
        // A device that speaks by itself is given the time to.
        let start = Instant::now();
        while device.silence.is_finite() && device.heard.read().reports == 0 && start.elapsed() < FIRST_WORD {
            std::thread::sleep(Duration::from_millis(1));
        }
        Ok(device)
    }
}

impl<C: Codec> Pump<C> {
    /// One round at a time (s) that never runs back: takes what the device has sent, and writes what it is to do. Whether there is
    /// a device.
    pub fn round(&mut self, now: f64) -> bool {
        if self.transport.is_none() && now - self.searched >= SEARCH {
            self.searched = now;
            if let Some(transport) = (self.open)() {
                self.meet(transport);
            }
        }
        let heard = self.listen();
        self.told.write(self.news);
        let order = *self.orders.read();
        if order.number != self.order {
            (self.order, self.ordered) = (order.number, now);
        }
        let live = (heard || !self.talks) && order.number > self.stale && now - self.ordered <= RENEWAL;
        let wrench = if live { order.wrench } else { Wrench::ZERO };
        self.ask(&wrench);
        self.transport.is_some()
    }

    /// The last words.
    pub fn end(&mut self) {
        self.ask(&Wrench::ZERO);
        if let Some(mut transport) = self.transport.take() {
            // There is nobody left to tell.
            let _ = self.codec.stop(&mut *transport);
        }
    }

    fn meet(&mut self, mut transport: Box<dyn Transport>) {
        if self.codec.start(&mut *transport).is_err() {
            self.news.unwritten += 1;
            return;
        }
        self.transport = Some(transport);
        self.news.sample = C::Sample::default();
        self.news.connected = true;
        self.news.arrivals += 1;
        self.stale = self.orders.read().number;
        self.told.write(self.news);
    }

    fn lose(&mut self) {
        self.transport = None;
        self.news.connected = false;
    }

    /// Takes all reports that wait. Whether one was understood.
    fn listen(&mut self) -> bool {
        let (mut report, mut patience) = ([0; LONGEST_REPORT], self.patience);
        let (mut heard, mut failures) = (false, 0);
        for _ in 0..ROUND {
            let Some(transport) = &mut self.transport else { break };
            match transport.read(&mut report, patience) {
                Ok(0) => break,
                Ok(length) => {
                    patience = Duration::ZERO;
                    match self.codec.decode(&report[..length.min(LONGEST_REPORT)], &mut self.news.sample) {
                        Ok(()) => (heard, self.news.reports) = (true, self.news.reports + 1),
                        Err(Malformed) => self.news.malformed += 1,
                    }
                }
                Err(TransportError::Failed) if failures < FAILURES => failures += 1,
                Err(TransportError::Failed) => break,
                Err(TransportError::Disconnected) => self.lose(),
            }
        }
        heard
    }

    /// Writes what asks for a wrench.
    fn ask(&mut self, wrench: &Wrench) {
        let Self { codec, transport, news, .. } = self;
        let Some(open) = transport else { return };
        let (mut failed, mut gone) = (0, false);
        codec.encode(wrench, &news.sample, &mut |report| match open.write(report.bytes()) {
            Ok(()) => {}
            Err(TransportError::Failed) => failed += 1,
            Err(TransportError::Disconnected) => gone = true,
        });
        if failed > 0 || gone {
            news.unwritten += failed;
            if gone {
                self.lose();
            }
            self.told.write(self.news);
        }
    }
}

impl<C: Codec> std::fmt::Debug for Pump<C> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Pump").field("news", &self.news).finish_non_exhaustive()
    }
}

/// The side of the haptic thread. Made by a [`Link`].
pub struct LinkedDevice<M: Motion> {
    specification: Specification,
    motion: M,
    silence: f64,
    heard: triple_buffer::Output<News<M::Sample>>,
    asked: triple_buffer::Input<Order>,
    /// What was known at the last read.
    seen: News<M::Sample>,
    order: Order,
    /// When a report was last seen, and the latest time, s.
    fresh: f64,
    now: f64,
    state: DeviceState,
    /// Why the device cannot be read; nothing where it can.
    lost: Status,
    events: Status,
    closed: bool,
    pump: Option<(Arc<AtomicBool>, JoinHandle<()>)>,
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
            self.fresh = self.now;
        }
        // A pump that has ended, by a panic, tells no more.
        let ended = self.pump.as_ref().is_some_and(|(_, thread)| thread.is_finished());
        self.lost = if !news.connected || ended {
            Status::DISCONNECTED
        } else if self.silence.is_finite() && self.now - self.fresh > self.silence {
            Status::SILENT
        } else {
            Status::OK
        };
        if !self.lost.is_ok() {
            return Err(DeviceError::Lost { status: self.lost });
        }
        let (pose, twist, buttons) = self.motion.advance(&news.sample, fresh, self.now);
        let mut status = std::mem::take(&mut self.events);
        if pose.is_valid() && twist.is_finite() {
            let time = if self.silence.is_finite() { self.fresh } else { self.now };
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
        self.ask(if self.lost.is_ok() { wrench } else { Wrench::ZERO });
        if self.lost.is_ok() { Ok(()) } else { Err(DeviceError::Lost { status: self.lost }) }
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        self.end();
        Ok(())
    }
}

impl<M: Motion> LinkedDevice<M> {
    fn ask(&mut self, wrench: Wrench) {
        self.order = Order { wrench, number: self.order.number + 1 };
        self.asked.write(self.order);
    }

    /// Lets go of the device. A pump that hangs in a system call is left to itself.
    fn end(&mut self) {
        self.ask(Wrench::ZERO);
        self.closed = true;
        if let Some((stop, thread)) = self.pump.take() {
            stop.store(true, Ordering::Release);
            let start = Instant::now();
            while !thread.is_finished() && start.elapsed() < FAREWELL {
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
