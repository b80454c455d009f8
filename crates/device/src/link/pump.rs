//! The report side of a link.

use std::time::{Duration, Instant};

use palpate_core::Wrench;

use super::clock::Clock;
use super::codec::{Codec, Malformed};
use super::transport::{LONGEST_REPORT, Transport, TransportError};

/// Age of a command after which its wrench is replaced by zero, s.
const ORDER_LIFETIME: f64 = 8e-3;
/// Gap between writes after which the device's own watchdog may have switched the force off, s. The shortest
/// known one waits 32 ms.
const WRITE_GAP: f64 = 25e-3;
/// Interval at which a device that is gone is searched for, s.
const SEARCH_PERIOD: f64 = 0.5;
/// Largest numbers of reports read, and of failures tolerated, in one round: a device that floods the queue
/// must not hold up writing.
const REPORTS_PER_ROUND: usize = 128;
const FAILURES_PER_ROUND: usize = 8;

/// State that the pump publishes to the haptic thread.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct News<S> {
    pub sample: S,
    pub connected: bool,
    /// Whether the device accepts a wrench.
    pub enabled: bool,
    /// Pump's time of the last report that was understood, s.
    pub arrived: f64,
    /// Number of reports that were understood, of those that were not, of writes that failed, and of times
    /// the device was opened.
    pub reports: u64,
    pub malformed: u64,
    pub unwritten: u64,
    pub arrivals: u64,
    /// Number of times the wrench was withheld: zero is sent in its place until an order acknowledges this
    /// count.
    pub withheld: u64,
}

/// Command of the haptic thread.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Order {
    pub wrench: Wrench,
    pub number: u64,
    /// Pump's time of the command, s.
    pub made: f64,
    /// Number of withheld wrenches that the haptic thread has seen.
    pub withheld: u64,
}

/// Opens a device; `None` if it is not there.
pub(super) type Opener = Box<dyn FnMut() -> Option<Box<dyn Transport>> + Send>;

/// The report side of a link. Made by a [`Link`](super::Link).
pub struct Pump<C: Codec> {
    codec: C,
    open: Opener,
    transport: Option<Box<dyn Transport>>,
    clock: Clock,
    /// Longest time that a round waits for a report.
    read_timeout: Duration,
    /// Whether the device sends by itself, so that silence is a fault.
    talks: bool,
    news: News<C::Sample>,
    published: triple_buffer::Input<News<C::Sample>>,
    orders: triple_buffer::Output<Order>,
    /// Number of the last order from before the device was opened.
    stale: u64,
    /// Time at which a round was last written completely since the device was opened, s.
    written: Option<f64>,
    searched: f64,
}

impl<C: Codec> Pump<C> {
    /// A pump of a device that is not open yet; `talks` if it sends by itself, so that silence is a fault.
    pub(super) fn new(
        codec: C,
        (read_timeout, talks): (Duration, bool),
        open: Opener,
        published: triple_buffer::Input<News<C::Sample>>,
        orders: triple_buffer::Output<Order>,
    ) -> Self {
        Self {
            codec,
            open,
            transport: None,
            clock: Clock::Rounds(0.0),
            read_timeout,
            talks,
            news: News::default(),
            published,
            orders,
            stale: 0,
            written: None,
            searched: f64::NEG_INFINITY,
        }
    }

    /// Measures times from an instant instead of taking those of the rounds.
    pub(super) fn keep_time(&mut self, start: Instant) {
        self.clock = Clock::Since(start);
    }

    /// Opens the device if it is there.
    pub(super) fn open(&mut self) {
        if let Some(transport) = (self.open)() {
            self.meet(transport);
        }
    }

    /// Runs one round at a time (s) that never runs back: takes the device's reports and writes the wrench.
    /// Gives whether there is a device.
    pub fn round(&mut self, now: f64) -> bool {
        self.clock.set(now);
        self.codec.begin_round(now);
        if self.transport.is_none() && now - self.searched >= SEARCH_PERIOD {
            self.searched = now;
            self.open();
        }
        let heard = self.listen();
        let order = *self.orders.read();
        let wrench = self.admitted(&order, heard);
        self.published.write(self.news);
        self.ask(&wrench);
        self.transport.is_some()
    }

    /// Writes a zero wrench and ends the use of the device.
    pub fn end(&mut self) {
        self.ask(&Wrench::ZERO);
        if let Some(mut transport) = self.transport.take() {
            // An error has no receiver any more.
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
        self.news.enabled = self.codec.is_enabled(&self.news.sample);
        self.news.connected = true;
        self.news.arrivals += 1;
        self.stale = self.orders.read().number;
        self.written = None;
        self.published.write(self.news);
    }

    fn lose(&mut self) {
        self.transport = None;
        self.news.connected = false;
    }

    /// Takes all waiting reports; gives whether one was understood.
    fn listen(&mut self) -> bool {
        let before = self.news.reports;
        let (mut report, mut read_timeout) = ([0; LONGEST_REPORT], self.read_timeout);
        let mut failures = 0;
        for _ in 0..REPORTS_PER_ROUND {
            let Some(transport) = &mut self.transport else { break };
            match transport.read(&mut report, read_timeout) {
                Ok(0) => break,
                Ok(length) => {
                    read_timeout = Duration::ZERO;
                    let news = &mut self.news;
                    match self.codec.decode(&report[..length.min(LONGEST_REPORT)], &mut news.sample) {
                        Ok(()) => (news.arrived, news.reports) = (self.clock.now(), news.reports + 1),
                        Err(Malformed) => news.malformed += 1,
                    }
                }
                Err(TransportError::Failed) if failures < FAILURES_PER_ROUND => failures += 1,
                Err(TransportError::Failed) => break,
                Err(TransportError::Disconnected) => self.lose(),
            }
        }
        self.news.reports > before
    }

    /// The order's wrench if it may be written now, else zero; counted as withheld if the order's wrench is
    /// another.
    fn admitted(&mut self, order: &Order, heard: bool) -> Wrench {
        let now = self.clock.now();
        let news = &mut self.news;
        news.enabled = self.codec.is_enabled(&news.sample);
        // A transport that does not wait, such as the fake one, has rounds without a report.
        let heard = heard || news.reports > 0 && now - news.arrived < self.read_timeout.as_secs_f64();
        let live = news.enabled
            && (heard || !self.talks)
            && order.number > self.stale
            && now - order.made <= ORDER_LIFETIME
            && self.written.is_none_or(|written| now - written <= WRITE_GAP);
        let knows = order.withheld == news.withheld;
        if live && knows {
            return order.wrench;
        }
        if knows && order.wrench != Wrench::ZERO {
            news.withheld += 1;
        }
        Wrench::ZERO
    }

    /// Writes the reports that command a wrench.
    fn ask(&mut self, wrench: &Wrench) {
        let Self { codec, transport, news, .. } = self;
        let Some(open) = transport else { return };
        let (mut failed, mut gone) = (0, false);
        codec.encode(wrench, &news.sample, &mut |report| match open.write(report.bytes()) {
            Ok(()) => {}
            Err(TransportError::Failed) => failed += 1,
            Err(TransportError::Disconnected) => gone = true,
        });
        if failed == 0 && !gone {
            self.written = Some(self.clock.now());
            return;
        }
        news.unwritten += failed;
        if gone {
            self.lose();
        }
        self.published.write(self.news);
    }
}

impl<C: Codec> std::fmt::Debug for Pump<C> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Pump").field("news", &self.news).finish_non_exhaustive()
    }
}
