//! Devices that are reached by reports: over HID, a socket, or the calls of a maker's library.
//!
//! A driver is a [`Codec`] (bytes to a sample and a wrench to bytes; no clock, no system call) and a [`Motion`] (samples to
//! poses and twists). A [`Link`] makes a device of them and of whatever carries their reports ([`Transport`]); in tests that is
//! a [`FakeWire`]. A driver of one's own needs no more than these.
//!
//! A system call for a report may take its time: it is made in a thread of its own ([`Pump`]), which hands the newest
//! [`Codec::Sample`] to the haptic thread and takes the newest wrench from it, through triple buffers. The haptic thread
//! ([`LinkedDevice`]) never waits for it.
//!
//! The wrench is zero where the device is not heard of or not enabled, where the haptic thread does not renew it within 8 ms, after
//! 25 ms without a write, and, after the device was gone, until it is asked for anew. Zero that is sent in place of another wrench is
//! told ([`Status::WITHHELD`](crate::Status::WITHHELD)), and zero stays until a wrench is asked for by one who has read that: who then
//! begins from zero never gives the hand a jump.

#[cfg(any(feature = "force-dimension", feature = "open-haptics", feature = "haption"))]
mod apart;
mod clock;
mod codec;
mod device;
mod fake;
mod pump;
mod transport;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use palpate_realtime::{Role, set_up};

use crate::Specification;

use pump::{News, Order};

#[cfg(any(feature = "force-dimension", feature = "open-haptics", feature = "haption"))]
pub(crate) use apart::Found;
pub use codec::{Codec, Malformed, Motion, Report};
pub use device::LinkedDevice;
pub use fake::{FakeTransport, FakeWire, QUEUE};
pub use pump::Pump;
pub use transport::{LONGEST_REPORT, Transport, TransportError};

/// How long the pump rests while there is no device.
const REST: Duration = Duration::from_millis(20);
/// A round takes at least this long: a thread above all others leaves them the processor, whatever its transport does.
const SHORTEST_ROUND: Duration = Duration::from_micros(100);
/// A device that speaks only when it is moved is at rest where it has said nothing for so long, s: most speak each 1 to 10 ms.
pub(crate) const RESTING: f64 = 12e-3;
/// How long opening waits for the first report.
const FIRST_WORD: Duration = Duration::from_millis(500);

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
        open: impl FnMut() -> Option<Box<dyn Transport>> + Send + 'static,
    ) -> (Pump<C>, LinkedDevice<M>) {
        let (mut pump, device) = self.closed(open);
        pump.open();
        (pump, device)
    }

    /// Both sides of a device that is not open yet.
    fn closed(
        self,
        open: impl FnMut() -> Option<Box<dyn Transport>> + Send + 'static,
    ) -> (Pump<C>, LinkedDevice<M>) {
        let Self { codec, motion, specification, patience, silence } = self;
        let (told, heard) = triple_buffer::triple_buffer(&News::default());
        let (asked, orders) = triple_buffer::triple_buffer(&Order::default());
        let pump = Pump::new(codec, (patience, silence.is_finite()), Box::new(open), told, orders);
        let device = LinkedDevice::new(specification, motion, silence, heard, asked);
        (pump, device)
    }

    /// A device with its pump in a thread.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn spawn(
        self,
        open: impl FnMut() -> Option<Box<dyn Transport>> + Send + 'static,
    ) -> std::io::Result<LinkedDevice<M>> {
        let (pump, mut device) = self.split(open);
        run(pump, &mut device)?;
        device.await_first_word(FIRST_WORD);
        Ok(device)
    }
}

/// Runs a pump in a thread until the device ends it: above the haptic thread, so that what that computed in time is written in
/// time.
fn run<C: Codec, M: Motion>(mut pump: Pump<C>, device: &mut LinkedDevice<M>) -> std::io::Result<()> {
    let start = Instant::now();
    pump.keep_time(start);
    device.keep_time(start);
    let stop = Arc::new(AtomicBool::new(false));
    let (stopped, setup) = (stop.clone(), device.thread_setup_cell());
    let thread = std::thread::Builder::new().name("palpate-device".into()).spawn(move || {
        setup.get_or_init(|| set_up(Role::Device));
        while !stopped.load(Ordering::Acquire) {
            let begun = start.elapsed();
            let rest = if pump.round(begun.as_secs_f64()) { SHORTEST_ROUND } else { REST };
            let taken = start.elapsed() - begun;
            if taken < rest {
                std::thread::sleep(rest - taken);
            }
        }
        pump.end();
    })?;
    device.run_by(stop, thread);
    Ok(())
}
