//! Directional penetration depth on the GPU, through wgpu.
//!
//! Pipelines are built and run once when the backend is made. Textures are uploaded once, and buffers grow to the largest
//! batch met and stay. A batch is one upload, two dispatches (an invocation a texel of the images, then a workgroup a pair)
//! and one copy in one submission, then a wait for the answers, 272 bytes a pair; images are never read back. wgpu allocates
//! a few small objects for each submission: a backend belongs on the contact thread, not on the haptic one.
//!
//! A thread of the backend's own makes all calls on the device and drops it. A driver that hangs, in a submission or while a
//! queue is dropped, hangs that thread, and whoever asked for a batch waits for no longer than the backend's deadline. Where a
//! device turns out to be lost while it is polled, wgpu 30 has no error for it but panics: that thread catches the panic. (In
//! a program that is built with `panic = "abort"` the process ends there.)

mod pipelines;
#[cfg(test)]
mod tests;

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, SyncSender, TryRecvError};
use std::time::{Duration, Instant};

use wgpu::{Device, Instance, InstanceDescriptor, Queue};

use self::pipelines::{COMPILE_TIMEOUT, Job, Look, Pipelines, Textures};
use crate::backend::{Backend, BackendError};
use crate::batch::{Batch, SurfaceSet};
use crate::kernels::Answer;

/// How long a batch is waited for unless [`set_deadline`](Backend::set_deadline) says otherwise: for work that is in no hurry,
/// on a software driver too.
const UNHURRIED: Duration = Duration::from_secs(10);
/// A device is given up that answered this many batches in a row later than the deadline, or one not within this time.
const MISSES: u32 = 3;
const PATIENCE: Duration = Duration::from_secs(1);
/// How long an idle device is waited for to be dropped, so that a process does not end amid that.
const FAREWELL: Duration = Duration::from_secs(1);

/// Why a device has no more answers.
const ENDED: &str = "it failed before";

/// A backend on a GPU, or on a software driver that stands in for one.
///
/// A batch whose answers come later than the deadline is an error ([`BackendError::Late`]), as are all until they have come.
/// Then the device is asked again. The error of the third late batch in a row [lasts](BackendError::is_lasting), and so does
/// that of a batch that was asked for while another had no answer for a second.
///
/// The deadline is 10 s, for work that is in no hurry, unless [`set_deadline`](Backend::set_deadline) says otherwise.
#[derive(Debug)]
pub struct WgpuBackend {
    name: String,
    /// To the device's thread and back; none once it is told to end.
    jobs: Option<SyncSender<Job>>,
    done: Receiver<Job>,
    /// None while the device has it.
    job: Option<Job>,
    /// When it was last sent.
    sent: Instant,
    /// How many batches in a row were late.
    misses: u32,
    deadline: Duration,
    /// Which textures the device has.
    uploaded: Option<u64>,
}

/// The adapters of this machine that a [`WgpuBackend`] may run on, software ones included: Vulkan, Metal or Direct3D 12. Loads
/// their drivers, which may take long.
pub fn adapters() -> Vec<wgpu::AdapterInfo> {
    let instance = Instance::new(InstanceDescriptor::new_without_display_handle());
    let found = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::PRIMARY));
    found.iter().map(wgpu::Adapter::get_info).collect()
}

impl WgpuBackend {
    /// A backend on the fastest adapter of this machine: Vulkan, Metal or Direct3D 12. Where there is no GPU, a
    /// software driver serves.
    ///
    /// # Errors
    /// If there is no adapter, or it gives no device.
    pub fn new() -> Result<Self, BackendError> {
        Self::from_instance(&Instance::new(InstanceDescriptor::new_without_display_handle()))
    }

    /// A backend on the fastest adapter of `instance`.
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
        // What WebGPU promises everywhere, but room for as much as the adapter binds.
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

    /// A backend on a device that the host has, so that both share it. It goes by `name`.
    ///
    /// The backend submits to `queue` and waits for its own submissions, from a thread of its own; the host may poll and submit
    /// beside it. Errors of its own calls are caught and do not reach the host's error handler.
    ///
    /// # Errors
    /// If the device fails, or gives fewer than the eight storage buffers that WebGPU promises.
    pub fn with_device(name: &str, device: Device, queue: Queue) -> Result<Self, BackendError> {
        Self::looking(name, device, queue, Device::poll)
    }

    /// A backend whose thread looks at the device in a way of its own.
    fn looking(name: &str, device: Device, queue: Queue, look: Look) -> Result<Self, BackendError> {
        let (jobs, to_do) = mpsc::sync_channel(1);
        let (send, done) = mpsc::sync_channel(1);
        let called = name.to_owned();
        std::thread::Builder::new()
            .name("palpate-gpu".into())
            .spawn(move || serve(&called, || Pipelines::new(&called, device, queue, look), &to_do, &send))
            .map_err(|error| BackendError::NoDevice { adapter: name.into(), reason: error.to_string() })?;
        let mut backend = Self {
            name: name.into(),
            jobs: Some(jobs),
            done,
            job: None,
            sent: Instant::now(),
            misses: 0,
            deadline: UNHURRIED,
            uploaded: None,
        };
        let made =
            backend.done.recv_timeout(COMPILE_TIMEOUT).map_err(|_| backend.lost("it compiles no kernels"))?;
        backend.take_back(made, &mut Vec::new())?;
        Ok(backend)
    }

    /// The room for a batch: an error where the device still has it.
    fn room(&mut self) -> Result<Job, BackendError> {
        if self.job.is_none() {
            match self.done.try_recv() {
                // Nobody waits for these answers any more.
                Ok(late) => self.take_back(late, &mut Vec::new())?,
                Err(TryRecvError::Empty) if self.sent.elapsed() < PATIENCE => return Err(self.late()),
                Err(TryRecvError::Empty) => return Err(self.lost("it hangs")),
                Err(TryRecvError::Disconnected) => return Err(self.lost(ENDED)),
            }
        }
        self.job.take().ok_or_else(|| self.lost(ENDED))
    }

    /// Sends a batch to the device, with the textures where these are new.
    fn send(&mut self, mut job: Job, surfaces: &SurfaceSet, batch: &Batch) -> Result<(), BackendError> {
        job.batch.copy_from(batch);
        if self.uploaded != Some(surfaces.revision()) {
            let SurfaceSet { levels, coefficients, .. } = surfaces;
            job.textures = Some(Textures { levels: levels.clone(), coefficients: coefficients.clone() });
            self.uploaded = Some(surfaces.revision());
        }
        self.sent = Instant::now();
        // There is room for one, and one is on its way at most.
        let sent = self.jobs.as_ref().is_some_and(|jobs| jobs.try_send(job).is_ok());
        if sent { Ok(()) } else { Err(self.lost(ENDED)) }
    }

    /// Keeps the room that comes back, and gives the answers in it.
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
        let room = self.room()?;
        self.send(room, surfaces, batch)?;
        match self.done.recv_timeout(self.deadline) {
            Ok(job) => {
                self.misses = 0;
                self.take_back(job, answers)
            }
            Err(RecvTimeoutError::Timeout) => {
                self.misses += 1;
                Err(if self.misses < MISSES {
                    self.late()
                } else {
                    self.lost("its answers keep coming late")
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
            let _ = self.done.recv_timeout(FAREWELL);
        }
    }
}

/// What the device's thread does: it makes the pipelines and says so, and then answers what it is sent, until nobody sends any
/// more or the device panics. The pipelines are dropped before it lets go of `done`.
fn serve(
    name: &str,
    make: impl FnOnce() -> Result<Pipelines, BackendError>,
    to_do: &Receiver<Job>,
    done: &SyncSender<Job>,
) {
    let (mut pipelines, made) = match guarded(name, make) {
        Ok(Ok(pipelines)) => (Some(pipelines), Ok(())),
        Ok(Err(error)) | Err(error) => (None, Err(error)),
    };
    if done.send(Job { result: made, ..Job::default() }).is_err() {
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

/// What `work` gives, or an error that says what it panicked with.
fn guarded<T>(name: &str, work: impl FnOnce() -> T) -> Result<T, BackendError> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|panic| BackendError::Device {
        device: name.into(),
        reason: message_of(&*panic).unwrap_or("it panicked").into(),
    })
}

fn message_of(panic: &(dyn Any + Send)) -> Option<&str> {
    panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied())
}
