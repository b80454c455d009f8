//! The kernels on a device, with their buffers. All of it belongs to one thread.

use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use palpate_shaders::TEXTURE_DEPTH;
use wgpu::{
    BindGroup, BindGroupDescriptor, BindGroupEntry, Buffer, BufferAsyncError, BufferDescriptor, BufferUsages,
    ComputePipeline, ComputePipelineDescriptor, Device, ErrorFilter, MapMode, PollError, PollStatus,
    PollType, Queue,
};

use crate::backend::BackendError;
use crate::batch::Batch;
use crate::kernels::{Answer, Clips, Header, Image, Pair, Triangle};
use crate::spline::Level;

/// Workgroup size of `height_images`, as in the shader.
const WORKGROUP_TEXELS: u32 = 64;
/// Time after which a batch counts as having hung the device.
const BATCH_TIMEOUT: Duration = Duration::from_secs(10);
/// Timeout of the first batch, which waits for the driver's compiler: a second on a software driver, more on
/// a busy machine.
pub(super) const COMPILE_TIMEOUT: Duration = Duration::from_secs(120);
/// Time for which the device is polled without a pause. Longer values cost CPU time, shorter ones latency.
const SPIN_TIME: Duration = Duration::from_micros(300);
/// Pause between polls after that.
const POLL_PAUSE: Duration = Duration::from_micros(50);

/// Usage of buffers that the kernels bind.
const STORAGE: BufferUsages = BufferUsages::STORAGE.union(BufferUsages::COPY_DST);

/// Function that polls the device: [`Device::poll`], except in tests of devices that are lost or hang.
pub(super) type Poll = fn(&Device, PollType) -> Result<PollStatus, PollError>;

/// A batch on its way to the device, and its answers on their way back. Its buffers are used again.
#[derive(Debug)]
pub(super) struct Job {
    /// Textures to upload; `None` while the device has them.
    pub textures: Option<Textures>,
    pub batch: Batch,
    pub answers: Vec<Answer>,
    pub result: Result<(), BackendError>,
}

/// Textures of a set of surfaces.
#[derive(Debug, Default)]
pub(super) struct Textures {
    pub levels: Arc<Vec<Level>>,
    pub coefficients: Arc<Vec<f32>>,
}

impl Default for Job {
    fn default() -> Self {
        Self { textures: None, batch: Batch::default(), answers: Vec::new(), result: Ok(()) }
    }
}

/// Both kernels with their buffers.
#[derive(Debug)]
pub(super) struct Pipelines {
    name: String,
    device: Device,
    queue: Queue,
    images: ComputePipeline,
    overlaps: ComputePipeline,
    header: Buffer,
    triangles: Store,
    image_records: Store,
    levels: Store,
    coefficients: Store,
    heights: Store,
    pairs: Store,
    answers: Store,
    readback: Store,
    /// Bind groups of the current buffers, for `images` and `overlaps`.
    groups: Option<[BindGroup; 2]>,
    poll: Poll,
    timeout: Duration,
}

/// A buffer that grows and is never shrunk.
#[derive(Debug)]
struct Store {
    what: &'static str,
    usage: BufferUsages,
    buffer: Option<Buffer>,
}

impl Pipelines {
    /// Compiles the kernels and runs them once.
    ///
    /// # Errors
    /// If the device fails, or has fewer than the eight storage buffers that WebGPU guarantees.
    pub fn new(name: &str, device: Device, queue: Queue, poll: Poll) -> Result<Self, BackendError> {
        let (images, overlaps, header) = caught(name, &device, || {
            let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(TEXTURE_DEPTH.name),
                source: wgpu::ShaderSource::Wgsl(TEXTURE_DEPTH.source.into()),
            });
            let [images, overlaps] = ["height_images", "overlaps"].map(|entry_point| {
                device.create_compute_pipeline(&ComputePipelineDescriptor {
                    label: Some(entry_point),
                    layout: None,
                    module: &module,
                    entry_point: Some(entry_point),
                    compilation_options: Default::default(),
                    cache: None,
                })
            });
            let header = device.create_buffer(&BufferDescriptor {
                label: Some("header"),
                size: size_of::<Header>() as u64,
                usage: BufferUsages::UNIFORM | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            });
            (images, overlaps, header)
        })?;
        let store = |what, usage| Store { what, usage, buffer: None };
        let mut pipelines = Self {
            name: name.into(),
            device,
            queue,
            images,
            overlaps,
            header,
            triangles: store("triangles", STORAGE),
            image_records: store("images", STORAGE),
            levels: store("levels", STORAGE),
            coefficients: store("textures", STORAGE),
            heights: store("heights", BufferUsages::STORAGE),
            pairs: store("pairs", STORAGE),
            answers: store("answers", BufferUsages::STORAGE | BufferUsages::COPY_SRC),
            readback: store("readback", BufferUsages::MAP_READ | BufferUsages::COPY_DST),
            groups: None,
            poll,
            timeout: COMPILE_TIMEOUT,
        };
        pipelines.warm_up()?;
        pipelines.timeout = BATCH_TIMEOUT;
        Ok(pipelines)
    }

    /// Runs both kernels once, on a pair of empty images, because drivers compile at the first use.
    fn warm_up(&mut self) -> Result<(), BackendError> {
        let mut batch = Batch::default();
        batch.clear(2, 0);
        let (a, b) = (batch.push_image(0, 1.0, 1.0, 1.0), batch.push_image(0, -1.0, 1.0, 1.0));
        batch.push_pair(a, b, 0.0, Clips::default());
        self.evaluate(&mut Job { textures: Some(Textures::default()), batch, ..Job::default() })
    }

    /// Runs the kernels on a job.
    ///
    /// # Errors
    /// If the device fails or is too small. The textures then have to be uploaded again.
    pub fn evaluate(&mut self, job: &mut Job) -> Result<(), BackendError> {
        let Job { textures, batch, answers, .. } = job;
        answers.clear();
        let (name, device) = (self.name.clone(), self.device.clone());
        let result = caught(&name, &device, || {
            self.load(textures.take(), batch)?;
            self.submit(batch, answers)
        });
        let result = result.flatten();
        if result.is_err() {
            // Buffers of a failed run may still be mapped or in use, so the next run creates new ones.
            answers.clear();
            self.readback.buffer = None;
            self.groups = None;
        }
        result
    }

    /// Grows the buffers as needed and uploads the batch.
    fn load(&mut self, textures: Option<Textures>, batch: &Batch) -> Result<(), BackendError> {
        let (device, queue, name) = (&self.device, &self.queue, &self.name);
        let mut grown = false;
        if let Some(Textures { levels, coefficients }) = textures {
            grown |= self.levels.write(device, queue, name, bytemuck::cast_slice(&levels))?;
            grown |= self.coefficients.write(device, queue, name, bytemuck::cast_slice(&coefficients))?;
        }
        grown |= self.triangles.write(
            device,
            queue,
            name,
            bytemuck::cast_slice::<Triangle, _>(&batch.triangles),
        )?;
        grown |=
            self.image_records.write(device, queue, name, bytemuck::cast_slice::<Image, _>(&batch.images))?;
        grown |= self.pairs.write(device, queue, name, bytemuck::cast_slice::<Pair, _>(&batch.pairs))?;
        grown |= self.heights.reserve(device, name, (batch.texels() * size_of::<[u32; 2]>()) as u64)?;
        let answers = (batch.pairs.len() * size_of::<Answer>()) as u64;
        grown |= self.answers.reserve(device, name, answers)?;
        self.readback.reserve(device, name, answers)?;
        queue.write_buffer(&self.header, 0, bytemuck::bytes_of(&batch.header));
        if grown || self.groups.is_none() {
            self.groups = self.bind();
        }
        Ok(())
    }

    /// Creates the bind groups of the current buffers.
    fn bind(&self) -> Option<[BindGroup; 2]> {
        let stores = [
            (1, &self.triangles),
            (2, &self.image_records),
            (3, &self.levels),
            (4, &self.coefficients),
            (5, &self.heights),
            (6, &self.pairs),
            (7, &self.answers),
        ];
        let header = BindGroupEntry { binding: 0, resource: self.header.as_entire_binding() };
        let mut entries = vec![header];
        for (binding, store) in stores {
            entries.push(BindGroupEntry { binding, resource: store.buffer.as_ref()?.as_entire_binding() });
        }
        // `height_images` binds neither pairs nor answers.
        Some([(&self.images, &entries[..6]), (&self.overlaps, &entries[..])].map(|(pipeline, entries)| {
            self.device.create_bind_group(&BindGroupDescriptor {
                label: Some(TEXTURE_DEPTH.name),
                layout: &pipeline.get_bind_group_layout(0),
                entries,
            })
        }))
    }

    /// Dispatches both kernels and waits for the answers.
    fn submit(&self, batch: &Batch, answers: &mut Vec<Answer>) -> Result<(), BackendError> {
        let failed = |reason: String| BackendError::Device { device: self.name.clone(), reason };
        let missing = || failed("a buffer is missing".into());
        let [images, overlaps] = self.groups.as_ref().ok_or_else(missing)?;
        let (found, readback) = (self.answers.buffer.as_ref(), self.readback.buffer.as_ref());
        let (found, readback) = (found.ok_or_else(missing)?, readback.ok_or_else(missing)?);
        let Header { grid, images: image_count, pairs, .. } = batch.header;
        let mut encoder = self.device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            let most = self.device.limits().max_compute_workgroups_per_dimension;
            pass.set_pipeline(&self.images);
            pass.set_bind_group(0, images, &[]);
            // Images and pairs are spread over two dimensions, since each is limited.
            let across = image_count.min(most);
            pass.dispatch_workgroups(
                (grid * grid).div_ceil(WORKGROUP_TEXELS),
                across,
                image_count.div_ceil(across),
            );
            pass.set_pipeline(&self.overlaps);
            pass.set_bind_group(0, overlaps, &[]);
            let across = pairs.min(most);
            pass.dispatch_workgroups(across, pairs.div_ceil(across), 1);
        }
        let used = u64::from(pairs) * size_of::<Answer>() as u64;
        encoder.copy_buffer_to_buffer(found, 0, readback, 0, used);
        self.queue.submit([encoder.finish()]);

        let (send, receive) = mpsc::sync_channel(1);
        readback.map_async(MapMode::Read, ..used, move |result| {
            // The receiver is dropped only after a timeout.
            let _ = send.send(result);
        });
        self.await_answers(&receive)?;
        {
            let bytes = readback.get_mapped_range(..used).map_err(|error| failed(error.to_string()))?;
            answers.extend_from_slice(bytemuck::cast_slice(&bytes));
        }
        readback.unmap();
        Ok(())
    }

    /// Waits until the answers are mapped.
    ///
    /// The callback runs on the thread that polls the device once the answers are mapped. That may be a
    /// thread of the host that polls or submits to the same device, and the callback may run after our own
    /// poll. wgpu's wait (`PollType::Wait`) does not cover that case. It also keeps the host from releasing
    /// buffers while it waits, and panics if it times out while the host polls (wgpu 30).
    fn await_answers(&self, mapped: &Receiver<Result<(), BufferAsyncError>>) -> Result<(), BackendError> {
        let failed = |reason: String| BackendError::Device { device: self.name.clone(), reason };
        let start = Instant::now();
        loop {
            (self.poll)(&self.device, PollType::Poll).map_err(|error| failed(error.to_string()))?;
            let waited = start.elapsed();
            let pause = if waited < SPIN_TIME { Duration::ZERO } else { POLL_PAUSE };
            match mapped.recv_timeout(pause) {
                Ok(Ok(())) => return Ok(()),
                Ok(Err(error)) => return Err(failed(error.to_string())),
                Err(RecvTimeoutError::Timeout) if waited < self.timeout => std::thread::yield_now(),
                Err(_) => return Err(failed("the answers did not arrive".into())),
            }
        }
    }
}

impl Store {
    /// Grows the buffer to hold `bytes`. Returns whether it is a new one.
    fn reserve(&mut self, device: &Device, name: &str, bytes: u64) -> Result<bool, BackendError> {
        if self.buffer.as_ref().is_some_and(|buffer| buffer.size() >= bytes) {
            return Ok(false);
        }
        let limits = device.limits();
        let limit = limits.max_buffer_size.min(limits.max_storage_buffer_binding_size) / 16 * 16;
        if bytes > limit {
            return Err(BackendError::TooLarge { what: self.what, bytes, limit, device: name.into() });
        }
        // The old buffer is released before the new one is created.
        self.buffer = None;
        self.buffer = Some(device.create_buffer(&BufferDescriptor {
            label: Some(self.what),
            size: bytes.next_power_of_two().clamp(256, limit),
            usage: self.usage,
            mapped_at_creation: false,
        }));
        Ok(true)
    }

    /// Writes bytes to the buffer, which grows as needed. Returns whether it is a new one.
    fn write(
        &mut self,
        device: &Device,
        queue: &Queue,
        name: &str,
        bytes: &[u8],
    ) -> Result<bool, BackendError> {
        let grown = self.reserve(device, name, bytes.len() as u64)?;
        if let Some(buffer) = &self.buffer {
            queue.write_buffer(buffer, 0, bytes);
        }
        Ok(grown)
    }
}

/// Returns the result of `work`, or the first error that its calls on the device raised: uncaught, it would
/// panic.
fn caught<T>(name: &str, device: &Device, work: impl FnOnce() -> T) -> Result<T, BackendError> {
    let scopes = [ErrorFilter::Internal, ErrorFilter::OutOfMemory, ErrorFilter::Validation]
        .map(|filter| device.push_error_scope(filter));
    let result = work();
    let mut first = None;
    // A scope can be popped only from the top of the stack.
    for scope in scopes.into_iter().rev() {
        first = first.or(pollster::block_on(scope.pop()));
    }
    match first {
        None => Ok(result),
        Some(error) => Err(BackendError::Device { device: name.into(), reason: error.to_string() }),
    }
}
