//! Ends of real-time sessions: all threads end, the device is left without a wrench, and no record is lost.

use std::convert::Infallible;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use palpate::device::{DeviceError, DeviceState, Emulation, HapticDevice, Specification};
use palpate::glam::DVec3;
use palpate::threads::Role;
use palpate::{HapticRenderer, Object, Pose, Record, Scene, Settings, Wrench};
use palpate_tests::model;

/// Length of a session that is longer than any test, s.
const DAY: f64 = 86_400.0;

/// Emulated device that is shaken, panics at a read on demand, and keeps the last wrench.
struct Shaken {
    inner: Box<dyn HapticDevice>,
    panics_at: usize,
    /// Duration of every tenth read.
    delay: std::time::Duration,
    reads: usize,
    last: Arc<Mutex<Wrench>>,
}

impl HapticDevice for Shaken {
    fn specification(&self) -> &Specification {
        self.inner.specification()
    }

    fn read(&mut self, now: f64) -> Result<DeviceState, DeviceError> {
        self.reads += 1;
        assert!(self.reads <= self.panics_at, "the driver panics, as this test wants");
        if self.reads.is_multiple_of(10) {
            std::thread::sleep(self.delay);
        }
        let mut state = self.inner.read(now)?;
        state.pose.translation += DVec3::X * 1e-3 * (self.reads % 7) as f64;
        Ok(state)
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceError> {
        *self.last.lock().expect("no panic while locked") = *wrench;
        self.inner.write(wrench)
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        // Not zeroed here: it must have been zero before.
        self.inner.close()
    }
}

fn renderer(panics_at: usize) -> (HapticRenderer, Arc<Mutex<Wrench>>) {
    slow_renderer(panics_at, std::time::Duration::ZERO, DVec3::ZERO)
}

/// The object in the hand is at the origin, and another one `at` a place.
fn slow_renderer(
    panics_at: usize,
    delay: std::time::Duration,
    at: DVec3,
) -> (HapticRenderer, Arc<Mutex<Wrench>>) {
    let last = Arc::new(Mutex::new(Wrench::new(DVec3::ONE, DVec3::ONE)));
    let inner = Box::new(Emulation::default().open(Pose::IDENTITY).expect("emulated device"));
    let device = Shaken { inner, panics_at, delay, reads: 0, last: Arc::clone(&last) };
    let object: Object = model("ellipsoid@500");
    let scene = Scene::new().with(object.clone(), Pose::from_translation(at));
    let renderer = HapticRenderer::new(object, scene, Box::new(device), Settings::default());
    (renderer.expect("renderer"), last)
}

fn released(last: &Mutex<Wrench>) -> bool {
    *last.lock().expect("no panic while locked") == Wrench::ZERO
}

#[test]
fn stop_ends_the_session_in_order() {
    let (renderer, last) = renderer(usize::MAX);
    let stop = AtomicBool::new(false);
    let mut records: Vec<Record> = Vec::new();
    let session = renderer
        .run_realtime(DAY, &stop, |record| {
            records.push(*record);
            stop.store(records.len() >= 100, Ordering::Release);
            Ok::<_, Infallible>(())
        })
        .expect("the sink never fails");
    assert!(released(&last));
    let summary = session.summary();
    assert!(records.iter().any(|record| record.coupling != Wrench::ZERO), "nothing was felt");
    assert_eq!(records.len() as u64, summary.haptic.steps - summary.events.record_dropped);
    assert!(records.is_sorted_by(|a, b| a.time < b.time));
    // Steps and skipped periods add up to the time that passed on the driver's clock.
    let periods = (records.last().expect("records").time / 1e-3).round() as u64;
    assert_eq!(summary.haptic.steps + summary.haptic.missed_deadlines, periods);
}

#[test]
fn an_error_of_the_sink_ends_the_session() {
    let (renderer, last) = renderer(usize::MAX);
    let stop = AtomicBool::new(false);
    let mut taken = 0;
    let ended = renderer.run_realtime(DAY, &stop, |_| {
        taken += 1;
        if taken == 50 { Err("disk full") } else { Ok(()) }
    });
    assert_eq!(ended.err(), Some("disk full"));
    assert_eq!(taken, 50, "a sink that failed is left alone");
    assert!(released(&last) && !stop.load(Ordering::Acquire), "the caller's flag is the caller's");
}

#[test]
fn a_panic_of_the_sink_ends_the_session() {
    let (renderer, last) = renderer(usize::MAX);
    let ended = catch_unwind(AssertUnwindSafe(|| {
        renderer.run_realtime(DAY, &AtomicBool::new(false), |_| -> Result<(), Infallible> {
            panic!("the sink panics, as this test wants")
        })
    }));
    assert!(ended.is_err() && released(&last));
}

#[test]
fn a_panic_of_the_driver_ends_the_session_with_its_records_written() {
    // One read when the renderer is made, and 40 that answer.
    let (renderer, last) = renderer(41);
    let mut taken = 0;
    let ended = catch_unwind(AssertUnwindSafe(|| {
        renderer.run_realtime(DAY, &AtomicBool::new(false), |_| {
            taken += 1;
            Ok::<_, Infallible>(())
        })
    }));
    assert!(ended.is_err() && released(&last));
    assert_eq!(taken, 40);
}

/// Device whose driver fails: at reads, at writes, or with a panic.
struct Failing {
    inner: Box<dyn HapticDevice>,
    fails: &'static str,
    calls: usize,
}

impl HapticDevice for Failing {
    fn specification(&self) -> &Specification {
        self.inner.specification()
    }

    fn read(&mut self, now: f64) -> Result<DeviceState, DeviceError> {
        self.calls += 1;
        assert!(self.calls < 20 || self.fails != "panic", "joint {} is out of range", 3);
        if self.calls >= 20 && self.fails == "read" {
            return Err(DeviceError::driver(format!("USB endpoint 0x81 stalled at call {}", self.calls)));
        }
        self.inner.read(now)
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceError> {
        if self.fails == "write" {
            Err(DeviceError::driver("amplifier too hot"))
        } else {
            self.inner.write(wrench)
        }
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        if self.fails == "close" { Err(DeviceError::Closed) } else { self.inner.close() }
    }
}

fn failing(fails: &'static str) -> HapticRenderer {
    let inner = Box::new(Emulation::default().open(Pose::IDENTITY).expect("emulated device"));
    let device = Failing { inner, fails, calls: 0 };
    let renderer =
        HapticRenderer::new(model("ellipsoid@500"), Scene::new(), Box::new(device), Settings::default());
    renderer.expect("renderer")
}

/// The host reads the first error of a driver, in the driver's words, while the session runs and after it.
#[test]
fn the_words_of_a_driver_reach_the_host() {
    let words = [
        ("read", Some("USB endpoint 0x81 stalled at call 20".to_owned())),
        ("write", Some("amplifier too hot".to_owned())),
        ("close", Some(DeviceError::Closed.to_string())),
        ("nothing", None),
    ];
    for (fails, said) in words {
        let sink = |_: &Record| Ok::<_, Infallible>(());
        let session = failing(fails).run_realtime(0.1, &AtomicBool::new(false), sink);
        let session = session.expect("the sink never fails");
        assert_eq!(session.device_error, said, "{fails}");
        assert_eq!(session.summary().device_error, said, "{fails}");
    }
    let running = failing("read").spawn().expect("threads");
    let begun = std::time::Instant::now();
    while running.device_error().is_none() {
        assert!(running.is_running() && begun.elapsed().as_secs() < 60, "no error is seen");
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    let seen = running.device_error().map(ToString::to_string);
    let session = running.stop().expect("no panic");
    assert_eq!(session.device_error, seen);
}

#[test]
fn a_panic_of_the_driver_is_an_error_of_a_spawned_session() {
    let running = failing("panic").spawn().expect("threads");
    let begun = std::time::Instant::now();
    while running.is_running() {
        assert!(begun.elapsed().as_secs() < 60, "the session does not end");
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    let error = running.stop().expect_err("the driver panicked");
    assert_eq!(error.message, "joint 3 is out of range");
    assert!(error.to_string().contains("joint 3 is out of range"));
}

#[test]
fn deadlines_missed_by_a_slow_driver_are_put_down_to_the_step() {
    let run = |delay| {
        // Apart, so that a step's time is the driver's.
        let (renderer, _) = slow_renderer(usize::MAX, std::time::Duration::from_millis(delay), DVec3::X);
        let sink = |_: &Record| Ok::<_, Infallible>(());
        renderer.run_realtime(0.3, &AtomicBool::new(false), sink).expect("the sink never fails").summary()
    };
    let slow = run(5).haptic;
    // A read of at least 5 ms overruns the four deadlines after its own.
    let slow_steps = slow.steps / 10;
    assert!(slow_steps > 5 && slow.missed_by_step >= 4 * (slow_steps - 1), "{slow:?}");
    assert_eq!(slow.missed_deadlines, slow.missed_by_step + slow.missed_by_machine);
    assert!(slow.missed_verdict().contains("because the step took longer than its period"), "{slow:?}");
    let usual = run(0).haptic;
    assert_eq!(usual.missed_deadlines, usual.missed_by_step + usual.missed_by_machine);
    // A loaded machine may interrupt a step, but not as often.
    assert!(4 * usual.missed_by_step < slow.missed_by_step, "{usual:?}");
    if cfg!(target_os = "linux") {
        assert!(usual.preempted.is_some(), "{usual:?}");
    }
}

#[test]
fn any_positive_time_is_a_step() {
    for (seconds, steps) in [(1e-12, 1), (0.004, 4), (0.0, 0), (-1.0, 0), (f64::NAN, 0)] {
        let sink = |_: &Record| Ok::<_, Infallible>(());
        let session = renderer(usize::MAX).0.run_realtime(seconds, &AtomicBool::new(false), sink);
        let summary = session.expect("the sink never fails").summary();
        assert_eq!(summary.haptic.steps + summary.haptic.missed_deadlines, steps, "{seconds} s");
        assert!(summary.haptic.rate_hz.is_finite() && summary.contact.rate_hz.is_finite());
    }
}

/// The first touch of a page costs the haptic thread some microseconds, or much more where memory is short,
/// so its memory is touched before. With the test's allocator warm, the remaining faults are those of the
/// samples themselves.
#[test]
#[cfg(target_os = "linux")]
fn the_haptic_thread_causes_no_page_faults() {
    let (renderer, _) = renderer(usize::MAX);
    let sink = |_: &Record| Ok::<_, Infallible>(());
    let session = renderer.run_realtime(1.5, &AtomicBool::new(false), sink).expect("the sink never fails");
    let faults = session.machine.page_faults.expect("Linux counts them");
    let steps = session.haptic.steps;
    assert!(steps > 1000 && faults <= 4, "{faults} pages were missing in {steps} steps");
}

/// The summary holds the request of each thread and its result, in words and for machines, whatever this
/// machine grants.
#[test]
fn the_summary_holds_what_was_granted() {
    let sink = |_: &Record| Ok::<_, Infallible>(());
    let (renderer, _) = renderer(usize::MAX);
    let session = renderer.run_realtime(0.05, &AtomicBool::new(false), sink).expect("the sink never fails");
    let summary = session.summary();
    let setup = summary.realtime.expect("it ran in real time");
    assert_eq!(setup.device, None, "an emulated device has no thread");
    assert_eq!(
        (setup.haptic.role, setup.contact.as_ref().expect("a thread").role),
        (Role::Haptic, Role::Contact)
    );
    assert_eq!(summary.haptic.scheduling, setup.haptic.scheduling_line());
    let json = serde_json::to_value(&setup).expect("JSON");
    for thread in ["haptic", "contact"] {
        for asked in ["scheduling", "processors", "timer_slack", "stack", "denormals"] {
            let state = json[thread][asked]["state"].as_str().expect("a state");
            assert!(["granted", "refused", "not_asked"].contains(&state), "{json}");
            assert!(json[thread][asked]["detail"].as_str().is_some_and(|said| !said.is_empty()), "{json}");
        }
    }
    // A request that was refused for lack of a privilege names the privilege.
    for (what, outcome) in setup.limited() {
        assert!(outcome.remedy.is_some(), "{what}: {outcome}");
    }
}
