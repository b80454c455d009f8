//! Devices that are reached by reports: over HID, a socket, or the calls of a maker's library.
//!
//! A driver is a [`Codec`] (bytes to a state, and a wrench to bytes; no clock, no system call) and a
//! [`Motion`] (states to poses and twists). A [`Link`] makes a device of them and of a [`Transport`], which
//! carries their reports; in tests that is a [`FakeWire`]. Your own driver needs only these.
//!
//! A system call for a report may take long. It is made in a thread of its own ([`Pump`]), which passes the
//! newest [`Codec::Sample`] to the haptic thread and takes the newest wrench from it, through triple buffers.
//! The haptic thread ([`LinkedDevice`]) never waits for it.
//!
//! The wrench is zero while the device is silent or not enabled, when the haptic thread does not renew it
//! within 8 ms, after 25 ms without a write, and after the device was gone until a new one is commanded. If
//! zero is sent instead of another wrench, [`Status::WITHHELD`](crate::Status::WITHHELD) is set, and zero
//! stays until the haptic thread commands a wrench after it has read that status: if it then starts from
//! zero, the hand never feels a jump.

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
#[cfg(feature = "hid")]
pub(crate) use device::REST_SILENCE;
pub use fake::{FakeTransport, FakeWire, QUEUE};
pub use pump::Pump;
pub use transport::{LONGEST_REPORT, Transport, TransportError};

/// Period of the pump's rounds while there is no device.
const IDLE_PERIOD: Duration = Duration::from_millis(20);
/// Shortest period of the pump's rounds: the thread has the highest priority, and must leave others the
/// processor, whatever its transport does.
const SHORTEST_PERIOD: Duration = Duration::from_micros(100);
/// Longest time that opening waits for the first report.
const FIRST_REPORT_TIMEOUT: Duration = Duration::from_millis(500);

/// Parameters of a link.
pub struct Link<C: Codec, M> {
    /// Codec of the device's reports.
    pub codec: C,
    /// Motion of the handle.
    pub motion: M,
    /// Specification of the device.
    pub specification: Specification,
    /// Longest time that a round of the [`Pump`] waits for a report.
    pub read_timeout: Duration,
    /// Silence after which the device counts as lost, s; infinite for a device that sends only when it is
    /// moved.
    pub silence: f64,
}

impl<C: Codec, M: Motion<Sample = C::Sample>> Link<C, M> {
    /// Both sides of a link to a device that `open` opens, now and whenever it is gone. The caller runs the
    /// pump's rounds.
    pub fn split(
        self,
        open: impl FnMut() -> Option<Box<dyn Transport>> + Send + 'static,
    ) -> (Pump<C>, LinkedDevice<M>) {
        let (mut pump, device) = self.closed(open);
        pump.open();
        (pump, device)
    }

    /// Both sides of a link to a device that is not open yet.
    fn closed(
        self,
        open: impl FnMut() -> Option<Box<dyn Transport>> + Send + 'static,
    ) -> (Pump<C>, LinkedDevice<M>) {
        let Self { codec, motion, specification, read_timeout, silence } = self;
        let (published, heard) = triple_buffer::triple_buffer(&News::default());
        let (asked, orders) = triple_buffer::triple_buffer(&Order::default());
        let pump = Pump::new(codec, (read_timeout, silence.is_finite()), Box::new(open), published, orders);
        let device = LinkedDevice::new(specification, motion, silence, heard, asked);
        (pump, device)
    }

    /// A device whose pump runs in a thread.
    ///
    /// # Errors
    /// If the system cannot start a thread.
    pub fn spawn(
        self,
        open: impl FnMut() -> Option<Box<dyn Transport>> + Send + 'static,
    ) -> std::io::Result<LinkedDevice<M>> {
        let (pump, mut device) = self.split(open);
        run(pump, &mut device)?;
        device.await_first_report(FIRST_REPORT_TIMEOUT);
        Ok(device)
    }
}

/// Runs a pump in a thread until the device ends it, at a priority above the haptic thread, so that a wrench
/// that was computed in time is written in time.
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
            let rest = if pump.round(begun.as_secs_f64()) { SHORTEST_PERIOD } else { IDLE_PERIOD };
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
