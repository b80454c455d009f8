//! Directional penetration depth on the GPU, through wgpu.
//!
//! Pipelines are built and run once when the backend is created. Textures are uploaded once; buffers grow to
//! the largest batch so far and stay. A batch takes one upload, two dispatches (one invocation per texel of
//! the images, then one workgroup per pair) and one copy in a single submission, then a wait for the answers,
//! 272 bytes per pair. Images are never read back. wgpu allocates a few small objects for each submission, so
//! a backend belongs on the contact thread, not on the haptic thread.
//!
//! The backend's own thread makes all calls on the device and drops it. A driver that hangs, in a submission
//! or while a queue is dropped, hangs only that thread; a caller waits no longer than the backend's deadline.
//! If a device is found to be lost while it is polled, wgpu 30 panics instead of returning an error, and the
//! thread catches the panic. (In a program built with `panic = "abort"` the process ends.)

mod pipelines;
#[cfg(test)]
mod tests;

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, SyncSender, TryRecvError};
use std::time::{Duration, Instant};

use wgpu::{Device, Instance, InstanceDescriptor, Queue};

use self::pipelines::{COMPILE_TIMEOUT, Job, Pipelines, Poll, Textures};
use crate::backend::{Backend, BackendError};
use crate::batch::{Batch, SurfaceSet};
use crate::kernels::Answer;

/// Default deadline of a batch: long enough for offline work on a software driver.
const DEFAULT_DEADLINE: Duration = Duration::from_secs(10);
/// Number of late batches in a row after which a device counts as lost.
const MAX_LATE_BATCHES: u32 = 3;
/// Time without an answer after which a device counts as hanging.
const HANG_TIMEOUT: Duration = Duration::from_secs(1);
/// Maximum wait for an idle device to be dropped. Without the wait a process may end in the middle of it.
const DROP_TIMEOUT: Duration = Duration::from_secs(1);

/// Error message of a device whose thread has ended.
const ENDED: &str = "it failed before";

/// Backend on a GPU, or on a software driver that replaces one.
///
/// A batch whose answers arrive after the deadline fails ([`BackendError::Late`]), and so do all batches
/// until they have arrived. Then the device is used again. The third late batch in a row fails with an error
/// that [lasts](BackendError::is_lasting), and so does a batch that is requested while another has had no
/// answer for a second.
///
/// The deadline is 10 s, for offline work, unless [`set_deadline`](Backend::set_deadline) changes it.
#[derive(Debug)]
pub struct WgpuBackend {
    name: String,
    /// Channel to the device's thread; `None` once that thread is to end.
    jobs: Option<SyncSender<Job>>,
    /// Channel from the device's thread.
    done: Receiver<Job>,
    /// The reused job; `None` while the device has it.
    job: Option<Job>,
    /// Time at which the job was last sent.
    sent: Instant,
    /// Number of late batches in a row.
    late_batches: u32,
    deadline: Duration,
    /// Revision of the textures that the device has.
    uploaded: Option<u64>,
}

/// Lists the adapters of this machine that a [`WgpuBackend`] may run on, including software drivers: Vulkan,
/// Metal or Direct3D 12. It loads their drivers, which may take long.
pub fn adapters() -> Vec<wgpu::AdapterInfo> {
    let instance = Instance::new(InstanceDescriptor::new_without_display_handle());
    let found = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::PRIMARY));
    found.iter().map(wgpu::Adapter::get_info).collect()
}

impl WgpuBackend {
    /// Creates a backend on the fastest adapter of this machine: Vulkan, Metal or Direct3D 12. Without a GPU
    /// it runs on a software driver.
    ///
    /// # Errors
    /// If there is no adapter, or it provides no device.
    pub fn new() -> Result<Self, BackendError> {
        Self::from_instance(&Instance::new(InstanceDescriptor::new_without_display_handle()))
    }

    /// Creates a backend on the fastest adapter of `instance`.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn from_instance(instance: &Instance) -> Result<Self, BackendError> {
        let options = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            ..Default::default()
        };
        let adapter = pollster::block_on(instance.request_adapter(&options))
            .map_err(|error| BackendError::NoAdapter { reason: error.to_string() })?;
        let name = adapter.get_info().name;
        // WebGPU's guaranteed limits, except for buffer sizes: those are as large as the adapter allows.
        let most = adapter.limits();
        let limits = wgpu::Limits {
            max_buffer_size: most.max_buffer_size,
            max_storage_buffer_binding_size: most.max_storage_buffer_binding_size,
            ..wgpu::Limits::default()
        };
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("palpate"),
            required_limits: limits,
            memory_hints: wgpu::MemoryHints::MemoryUsage,
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|error| BackendError::NoDevice { adapter: name.clone(), reason: error.to_string() })?;
        Self::with_device(&name, device, queue)
    }

    /// Creates a backend on a device that it shares with the host program; `name` appears in messages.
    ///
    /// The backend submits to `queue` and waits for its own submissions on its own thread; the host may poll
    /// and submit at the same time. Errors of the backend's calls are caught and do not reach the host's
    /// error handler.
    ///
    /// # Errors
    /// If the device fails, or has fewer than the eight storage buffers that WebGPU guarantees.
    pub fn with_device(name: &str, device: Device, queue: Queue) -> Result<Self, BackendError> {
        Self::with_poll(name, device, queue, Device::poll)
    }

    /// Creates a backend whose thread polls the device with the given function.
    fn with_poll(name: &str, device: Device, queue: Queue, poll: Poll) -> Result<Self, BackendError> {
        let (jobs, to_do) = mpsc::sync_channel(1);
        let (send, done) = mpsc::sync_channel(1);
        let called = name.to_owned();
        std::thread::Builder::new()
            .name("palpate-gpu".into())
            .spawn(move || serve(&called, || Pipelines::new(&called, device, queue, poll), &to_do, &send))
            .map_err(|error| BackendError::NoDevice { adapter: name.into(), reason: error.to_string() })?;
        let mut backend = Self {
            name: name.into(),
            jobs: Some(jobs),
            done,
            job: None,
            sent: Instant::now(),
            late_batches: 0,
            deadline: DEFAULT_DEADLINE,
            uploaded: None,
        };
        let made = backend
            .done
            .recv_timeout(COMPILE_TIMEOUT)
            .map_err(|_| backend.lost("its driver did not compile the kernels in time"))?;
        backend.take_back(made, &mut Vec::new())?;
        Ok(backend)
    }

    /// Returns the job to reuse, or an error while the device still has it.
    fn free_job(&mut self) -> Result<Job, BackendError> {
        if self.job.is_none() {
            match self.done.try_recv() {
                // Late answers, whose caller has gone on: they are discarded.
                Ok(late) => self.take_back(late, &mut Vec::new())?,
                Err(TryRecvError::Empty) if self.sent.elapsed() < HANG_TIMEOUT => return Err(self.late()),
                Err(TryRecvError::Empty) => return Err(self.lost("it hangs")),
                Err(TryRecvError::Disconnected) => return Err(self.lost(ENDED)),
            }
        }
        self.job.take().ok_or_else(|| self.lost(ENDED))
    }

    /// Sends a batch to the device, with the textures if they are new.
    fn send(&mut self, mut job: Job, surfaces: &SurfaceSet, batch: &Batch) -> Result<(), BackendError> {
        job.batch.copy_from(batch);
        if self.uploaded != Some(surfaces.revision()) {
            let SurfaceSet { levels, coefficients, .. } = surfaces;
            job.textures = Some(Textures { levels: levels.clone(), coefficients: coefficients.clone() });
            self.uploaded = Some(surfaces.revision());
        }
        self.sent = Instant::now();
        // The channel holds one job, and there is only one.
        let sent = self.jobs.as_ref().is_some_and(|jobs| jobs.try_send(job).is_ok());
        if sent { Ok(()) } else { Err(self.lost(ENDED)) }
    }

    /// Stores a job that came back for reuse, and copies its answers.
    fn take_back(&mut self, mut job: Job, answers: &mut Vec<Answer>) -> Result<(), BackendError> {
        let result = std::mem::replace(&mut job.result, Ok(()));
        match result {
            Ok(()) => answers.extend_from_slice(&job.answers),
            Err(_) => self.uploaded = None,
        }
        self.job = Some(job);
        result
    }

    fn late(&self) -> BackendError {
        BackendError::Late { device: self.name.clone(), deadline: self.deadline }
    }

    fn lost(&self, reason: &str) -> BackendError {
        BackendError::Device { device: self.name.clone(), reason: reason.into() }
    }
}

impl Backend for WgpuBackend {
    fn name(&self) -> &str {
        &self.name
    }

    fn set_deadline(&mut self, deadline: Duration) {
        self.deadline = deadline;
    }

    fn evaluate(
        &mut self,
        surfaces: &SurfaceSet,
        batch: &Batch,
        answers: &mut Vec<Answer>,
    ) -> Result<(), BackendError> {
        answers.clear();
        if batch.pairs.is_empty() {
            return Ok(());
        }
        let job = self.free_job()?;
        self.send(job, surfaces, batch)?;
        match self.done.recv_timeout(self.deadline) {
            Ok(job) => {
                self.late_batches = 0;
                self.take_back(job, answers)
            }
            Err(RecvTimeoutError::Timeout) => {
                self.late_batches += 1;
                Err(if self.late_batches < MAX_LATE_BATCHES {
                    self.late()
                } else {
                    self.lost("its answers keep arriving late")
                })
            }
            Err(RecvTimeoutError::Disconnected) => Err(self.lost(ENDED)),
        }
    }
}

impl Drop for WgpuBackend {
    fn drop(&mut self) {
        // The device's thread ends, and drops the device.
        self.jobs = None;
        if self.job.is_some() {
            let _ = self.done.recv_timeout(DROP_TIMEOUT);
        }
    }
}

/// Body of the device's thread. It creates the pipelines, reports the result, and then answers jobs until the
/// channel is closed or the device panics. The pipelines are dropped before `done` is.
fn serve(
    name: &str,
    make: impl FnOnce() -> Result<Pipelines, BackendError>,
    to_do: &Receiver<Job>,
    done: &SyncSender<Job>,
) {
    let (mut pipelines, result) = match guarded(name, make) {
        Ok(Ok(pipelines)) => (Some(pipelines), Ok(())),
        Ok(Err(error)) | Err(error) => (None, Err(error)),
    };
    if done.send(Job { result, ..Job::default() }).is_err() {
        return;
    }
    while let (Some(device), Ok(mut job)) = (&mut pipelines, to_do.recv()) {
        let answered = guarded(name, || device.evaluate(&mut job));
        let panicked = answered.is_err();
        job.result = answered.flatten();
        if done.send(job).is_err() || panicked {
            return;
        }
    }
}

/// Returns the result of `work`, or an error with the message of its panic.
fn guarded<T>(name: &str, work: impl FnOnce() -> T) -> Result<T, BackendError> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|panic| BackendError::Device {
        device: name.into(),
        reason: message_of(&*panic).unwrap_or("it panicked").into(),
    })
}

fn message_of(panic: &(dyn Any + Send)) -> Option<&str> {
    panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied())
}
