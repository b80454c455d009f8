//! The side of the reports.

use std::time::{Duration, Instant};

use palpate_core::Wrench;

use super::clock::Clock;
use super::codec::{Codec, Malformed};
use super::transport::{LONGEST_REPORT, Transport, TransportError};

/// A wrench that was asked for so long ago is taken back, s.
const RENEWAL: f64 = 8e-3;
/// After a gap between writes of this long the device may have let go by itself, s: the watchdog that waits least of those known
/// waits 32 ms.
const GAP: f64 = 25e-3;
/// A device that is gone is looked for this often, s.
const SEARCH: f64 = 0.5;
/// Reports taken in one round at most, and failures put up with in one: a device that floods the queue is not to hold up what is
/// written.
const ROUND: usize = 128;
const FAILURES: usize = 8;

/// What the pump tells.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct News<S> {
    pub sample: S,
    pub connected: bool,
    /// Whether the device takes a wrench.
    pub enabled: bool,
    /// When the last report that was understood came, in the pump's time, s.
    pub arrived: f64,
    /// Reports that were understood, those that were not, writes that failed, and how often the device came.
    pub reports: u64,
    pub malformed: u64,
    pub unwritten: u64,
    pub arrivals: u64,
    /// How often the wrench was withheld: zero sent in its place, from then on until an order is made that knows of it.
    pub withheld: u64,
}

/// What the haptic thread asks for.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Order {
    pub wrench: Wrench,
    pub number: u64,
    /// When it was made, in the pump's time, s.
    pub made: f64,
    /// Of how many withheld wrenches it knows.
    pub withheld: u64,
}

/// What opens a device: none where it is not there.
pub(super) type Opener = Box<dyn FnMut() -> Option<Box<dyn Transport>> + Send>;

/// The side of the reports.
pub struct Pump<C: Codec> {
    codec: C,
    open: Opener,
    transport: Option<Box<dyn Transport>>,
    clock: Clock,
    /// How long a round waits for a report.
    patience: Duration,
    /// Whether a device that is silent is one that is not well.
    talks: bool,
    news: News<C::Sample>,
    told: triple_buffer::Input<News<C::Sample>>,
    orders: triple_buffer::Output<Order>,
    /// The last order from before the device came.
    stale: u64,
    /// When all of a round was last written since the device came, s.
    written: Option<f64>,
    searched: f64,
}

impl<C: Codec> Pump<C> {
    /// Of a device that is not open yet; `talks` where one that is silent is one that is not well.
    pub(super) fn new(
        codec: C,
        (patience, talks): (Duration, bool),
        open: Opener,
        told: triple_buffer::Input<News<C::Sample>>,
        orders: triple_buffer::Output<Order>,
    ) -> Self {
        Self {
            codec,
            open,
            transport: None,
            clock: Clock::Rounds(0.0),
            patience,
            talks,
            news: News::default(),
            told,
            orders,
            stale: 0,
            written: None,
            searched: f64::NEG_INFINITY,
        }
    }

    /// Its times are those since an instant, and no longer those of the rounds alone.
    pub(super) fn keep_time(&mut self, start: Instant) {
        self.clock = Clock::Since(start);
    }

    /// Opens the device where it is there.
    pub(super) fn open(&mut self) {
        if let Some(transport) = (self.open)() {
            self.meet(transport);
        }
    }

    /// One round at a time (s) that never runs back: takes what the device has sent, and writes what it is to do. Whether there is
    /// a device.
    pub fn round(&mut self, now: f64) -> bool {
        self.clock.set(now);
        self.codec.begin_round(now);
        if self.transport.is_none() && now - self.searched >= SEARCH {
            self.searched = now;
            self.open();
        }
        let heard = self.listen();
        let order = *self.orders.read();
        let wrench = self.admitted(&order, heard);
        self.told.write(self.news);
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
        self.news.enabled = self.codec.is_enabled(&self.news.sample);
        self.news.connected = true;
        self.news.arrivals += 1;
        self.stale = self.orders.read().number;
        self.written = None;
        self.told.write(self.news);
    }

    fn lose(&mut self) {
        self.transport = None;
        self.news.connected = false;
    }

    /// Takes all reports that wait. Whether one was understood.
    fn listen(&mut self) -> bool {
        let before = self.news.reports;
        let (mut report, mut patience) = ([0; LONGEST_REPORT], self.patience);
        let mut failures = 0;
        for _ in 0..ROUND {
            let Some(transport) = &mut self.transport else { break };
            match transport.read(&mut report, patience) {
                Ok(0) => break,
                Ok(length) => {
                    patience = Duration::ZERO;
                    let news = &mut self.news;
                    match self.codec.decode(&report[..length.min(LONGEST_REPORT)], &mut news.sample) {
                        Ok(()) => (news.arrived, news.reports) = (self.clock.now(), news.reports + 1),
                        Err(Malformed) => news.malformed += 1,
                    }
                }
                Err(TransportError::Failed) if failures < FAILURES => failures += 1,
                Err(TransportError::Failed) => break,
                Err(TransportError::Disconnected) => self.lose(),
            }
        }
        self.news.reports > before
    }

    /// The wrench of an order where it may be written now, else zero, which is counted where the order is for another.
    fn admitted(&mut self, order: &Order, heard: bool) -> Wrench {
        let now = self.clock.now();
        let news = &mut self.news;
        news.enabled = self.codec.is_enabled(&news.sample);
        // A transport that does not wait, as the fake one, has rounds without a report.
        let heard = heard || news.reports > 0 && now - news.arrived < self.patience.as_secs_f64();
        let live = news.enabled
            && (heard || !self.talks)
            && order.number > self.stale
            && now - order.made <= RENEWAL
            && self.written.is_none_or(|written| now - written <= GAP);
        let knows = order.withheld == news.withheld;
        if live && knows {
            return order.wrench;
        }
        if knows && order.wrench != Wrench::ZERO {
            news.withheld += 1;
        }
        Wrench::ZERO
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
        if failed == 0 && !gone {
            self.written = Some(self.clock.now());
            return;
        }
        news.unwritten += failed;
        if gone {
            self.lose();
        }
        self.told.write(self.news);
    }
}

impl<C: Codec> std::fmt::Debug for Pump<C> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Pump").field("news", &self.news).finish_non_exhaustive()
    }
}
