//! Devices that are lost or hang, simulated by functions that replace wgpu's poll.

use std::sync::atomic::{AtomicUsize, Ordering};

use wgpu::{PollError, PollStatus, PollType};

use super::*;
use crate::fallback::Fallback;
use crate::kernels::Clips;

const DEADLINE: Duration = Duration::from_millis(20);

/// A backend that polls its device with the given function, with the deadline of a contact loop.
fn backend(poll: Poll) -> WgpuBackend {
    let instance = Instance::new(InstanceDescriptor::new_without_display_handle());
    let adapter = pollster::block_on(instance.request_adapter(&Default::default())).unwrap();
    let (device, queue) = pollster::block_on(adapter.request_device(&Default::default())).unwrap();
    let mut backend = WgpuBackend::with_poll("injected", device, queue, poll).unwrap();
    backend.set_deadline(DEADLINE);
    backend
}

/// A pair of images without a surface.
fn batch() -> Batch {
    let mut batch = Batch::default();
    batch.clear(2, 0);
    let (a, b) = (batch.push_image(0, 1.0, 1.0, 1.0), batch.push_image(0, -1.0, 1.0, 1.0));
    batch.push_pair(a, b, 0.0, Clips::default());
    batch
}

/// Evaluates a batch; returns the result and the time that it took.
fn evaluate(backend: &mut dyn Backend) -> (Result<usize, BackendError>, Duration) {
    let mut answers = Vec::new();
    let start = Instant::now();
    let result = backend.evaluate(&SurfaceSet::default(), &batch(), &mut answers);
    (result.map(|()| answers.len()), start.elapsed())
}

fn assert_is_late(result: &Result<usize, BackendError>) {
    assert!(matches!(result, Err(error @ BackendError::Late { .. }) if !error.is_lasting()), "{result:?}");
}

fn assert_is_lost(result: &Result<usize, BackendError>, why: &str) {
    assert!(
        matches!(result, Err(error @ BackendError::Device { reason, .. }) if error.is_lasting() && reason.contains(why)),
        "{result:?}"
    );
}

/// Polls the device, and calls `wrong` for each finished batch from the second one on. The first batch is the
/// kernels' first run.
fn poll(
    device: &Device,
    how: PollType,
    batches: &AtomicUsize,
    wrong: fn(usize),
) -> Result<PollStatus, PollError> {
    let status = device.poll(how)?;
    if status.is_queue_empty() {
        let before = batches.fetch_add(1, Ordering::Relaxed);
        if before > 0 {
            wrong(before);
        }
    }
    Ok(status)
}

/// Panics like wgpu when the driver reports a lost device.
fn panicking(device: &Device, how: PollType) -> Result<PollStatus, PollError> {
    static BATCHES: AtomicUsize = AtomicUsize::new(0);
    poll(device, how, &BATCHES, |_| panic!("Error in Device::poll: Parent device is lost"))
}

#[test]
fn panic_over_a_lost_device_is_an_error_and_the_cpu_takes_over() {
    let mut fallback = Fallback::new(Box::new(backend(panicking)));
    // The panic message is printed first.
    fallback.set_deadline(DEFAULT_DEADLINE);
    assert_eq!(fallback.name(), "injected");
    for _ in 0..5 {
        assert_eq!(evaluate(&mut fallback).0.unwrap(), 1);
    }
    assert_eq!((fallback.name(), fallback.failures()), ("CPU", 1));
    assert!(fallback.failure().unwrap().to_string().contains("Parent device is lost"));
}

/// Never returns.
fn hanging(device: &Device, how: PollType) -> Result<PollStatus, PollError> {
    static BATCHES: AtomicUsize = AtomicUsize::new(0);
    poll(device, how, &BATCHES, |_| {
        loop {
            std::thread::park();
        }
    })
}

#[test]
fn hanging_device_is_lost_after_the_deadline() {
    let mut backend = backend(hanging);
    let (result, took) = evaluate(&mut backend);
    assert_is_late(&result);
    assert!(took >= DEADLINE && took < 10 * DEADLINE, "{took:?}");
    let (result, took) = evaluate(&mut backend);
    assert_is_late(&result);
    assert!(took < DEADLINE, "{took:?}, though the first batch still has no answer");
    std::thread::sleep(HANG_TIMEOUT);
    assert_is_lost(&evaluate(&mut backend).0, "hangs");
    let start = Instant::now();
    drop(backend);
    assert!(start.elapsed() < DEADLINE, "{:?} to drop it", start.elapsed());
}

/// Is late for two batches.
fn tardy(device: &Device, how: PollType) -> Result<PollStatus, PollError> {
    static BATCHES: AtomicUsize = AtomicUsize::new(0);
    poll(device, how, &BATCHES, |before| {
        if before < 3 {
            std::thread::sleep(5 * DEADLINE);
        }
    })
}

/// Is always late.
fn slow(device: &Device, how: PollType) -> Result<PollStatus, PollError> {
    static BATCHES: AtomicUsize = AtomicUsize::new(0);
    poll(device, how, &BATCHES, |_| std::thread::sleep(5 * DEADLINE))
}

#[test]
fn device_that_is_late_twice_is_used_again_but_not_one_that_is_always_late() {
    let mut once = backend(tardy);
    for _ in 0..2 {
        assert_is_late(&evaluate(&mut once).0);
        std::thread::sleep(10 * DEADLINE);
    }
    once.set_deadline(DEFAULT_DEADLINE);
    assert_eq!(evaluate(&mut once).0.unwrap(), 1);
    let mut always = backend(slow);
    for _ in 0..2 {
        assert_is_late(&evaluate(&mut always).0);
        std::thread::sleep(10 * DEADLINE);
    }
    assert_is_lost(&evaluate(&mut always).0, "late");
}
