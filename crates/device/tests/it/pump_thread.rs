//! Timing of the pump's thread: it runs above the haptic thread, and leaves the processor to others when it
//! has nothing to wait for.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use palpate_core::Pose;
use palpate_device::hid::WoodenHapticsModel;
use palpate_device::link::{FakeTransport, FakeWire, LONGEST_REPORT, Link, Transport, TransportError};
use palpate_device::{Emulation, HapticDevice, HoldToEnable, Tap};
use palpate_realtime::{Role, ThreadSetup, realtime_priority, set_up};

/// A transport that records which thread reads its reports.
struct Watched {
    inner: FakeTransport,
    wire: FakeWire,
    /// Duration of a read.
    waits: Duration,
    /// Number of writes, one a round.
    writes: Arc<AtomicU64>,
    /// SCHED_FIFO priority of the thread, as the system reports it.
    priority: Arc<Mutex<Option<u8>>>,
}

impl Transport for Watched {
    fn read(
        &mut self,
        report: &mut [u8; LONGEST_REPORT],
        timeout: Duration,
    ) -> Result<usize, TransportError> {
        *self.priority.lock().unwrap() = realtime_priority();
        if timeout.is_zero() {
            // The second read of a round.
            return Ok(0);
        }
        std::thread::sleep(self.waits);
        self.wire.send(&[0, 1333_i16, 2547, 0, 0, 0, 0].map(i16::to_le_bytes).concat());
        self.inner.read(report, timeout)
    }

    fn write(&mut self, report: &[u8]) -> Result<(), TransportError> {
        self.writes.fetch_add(1, Ordering::Relaxed);
        self.inner.write(report)
    }
}

/// Priority of the pump's thread, rounds a second, and the device, watched for a tenth of a second.
fn watch(waits: Duration) -> (Option<u8>, f64, impl HapticDevice) {
    let (writes, priority) = (Arc::<AtomicU64>::default(), Arc::<Mutex<Option<u8>>>::default());
    let (counted, seen) = (writes.clone(), priority.clone());
    let open = move || {
        let wire = FakeWire::new();
        let (inner, writes, priority) = (wire.open()?, writes.clone(), priority.clone());
        Some(Box::new(Watched { inner, wire, waits, writes, priority }) as Box<dyn Transport>)
    };
    let device = Link::wooden_haptics("test", WoodenHapticsModel::WOODEN_HAPTICS).spawn(open).unwrap();
    let (begun, before) = (Instant::now(), counted.load(Ordering::Relaxed));
    std::thread::sleep(Duration::from_millis(100));
    let rounds = counted.load(Ordering::Relaxed) - before;
    let priority = *seen.lock().unwrap();
    (priority, rounds as f64 / begun.elapsed().as_secs_f64(), device)
}

/// Scheduling that a thread of a role obtains here, as the system reports it.
fn obtained(role: Role) -> (Option<u8>, ThreadSetup) {
    let thread = std::thread::spawn(move || (set_up(role), realtime_priority()));
    let (setup, priority) = thread.join().unwrap();
    (priority, setup)
}

/// The pump runs above the haptic thread: otherwise a wrench computed in time is written late.
#[test]
#[allow(clippy::print_stdout)] // Says what could not be tried.
fn the_pump_runs_above_the_haptic_thread() {
    let (haptic, _) = obtained(Role::Haptic);
    let (expected, setup) = obtained(Role::Device);
    let (pump, rounds, device) = watch(Duration::from_millis(1));
    assert!(rounds > 0.0);
    assert_eq!(pump, expected, "haptic thread {haptic:?}");
    assert_eq!(device.thread_setup(), Some(&setup));
    if setup.scheduling.remedy.is_some() {
        // Real-time priority is refused, or limited.
        println!("skipped: {}", setup.scheduling);
        assert!(pump >= haptic);
    } else if setup.scheduling.is_granted() {
        assert!(pump > haptic, "pump {pump:?}, haptic thread {haptic:?}");
    }
}

/// With this priority, a transport that never waits would otherwise occupy a processor.
#[test]
fn a_transport_that_never_waits_leaves_the_processor_to_others() {
    let (_, rounds, _device) = watch(Duration::ZERO);
    assert!(rounds <= 1.1e4, "{rounds} rounds a second, where a round takes 100 µs at least");
}

/// Wrapped devices report the thread of the device inside; a device without a thread reports none.
#[test]
fn wrapped_devices_report_their_thread() {
    let (_, _, device) = watch(Duration::from_millis(1));
    let setup = device.thread_setup().cloned();
    assert!(setup.is_some());
    let (tap, _taps) = Tap::new(HoldToEnable::new(Box::new(device) as Box<dyn HapticDevice>, 0));
    assert_eq!(tap.thread_setup(), setup.as_ref());
    let emulated = Emulation::default().open(Pose::IDENTITY).unwrap();
    assert_eq!(emulated.thread_setup(), None);
}
