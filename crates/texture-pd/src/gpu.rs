//! Directional penetration depth on the GPU, through wgpu.
//!
//! Pipelines are built and run once when the backend is made. Textures are uploaded once, and buffers grow to the largest
//! batch met and stay. A batch is one upload, two dispatches (an invocation a texel of the images, then a workgroup a pair)
//! and one copy in one submission, then a wait for the answers, 272 bytes a pair; images are never read back. wgpu allocates
//! a few small objects for each submission: a backend belongs on the contact thread, not on the haptic one.

use std::sync::mpsc;
use std::time::Duration;

use palpate_shaders::TEXTURE_DEPTH;
use wgpu::{
    BindGroup, BindGroupDescriptor, BindGroupEntry, Buffer, BufferDescriptor, BufferUsages, ComputePipeline,
    ComputePipelineDescriptor, Device, ErrorFilter, Instance, InstanceDescriptor, MapMode, PollType, Queue,
};

use crate::backend::{Backend, BackendError};
use crate::batch::{Batch, SurfaceSet};
use crate::kernels::{Answer, Clips, Header, Image, Pair, Triangle};

/// Invocations of a workgroup of `height_images`.
const TEXELS: u32 = 64;
/// A batch that takes longer has hung the device.
const TIMEOUT: Duration = Duration::from_secs(10);
/// The first batch waits for the driver's compiler, which takes a second on a software driver, and more on a busy machine.
const COMPILE_TIMEOUT: Duration = Duration::from_secs(120);

/// What the kernels bind.
const STORAGE: BufferUsages = BufferUsages::STORAGE.union(BufferUsages::COPY_DST);

/// A backend on a GPU, or on a software driver that stands in for one.
#[derive(Debug)]
pub struct WgpuBackend {
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
    /// Those of the stores as they are.
    groups: Option<[BindGroup; 2]>,
    /// Which textures are uploaded.
    uploaded: Option<u64>,
    timeout: Duration,
}

/// A buffer that grows and stays.
#[derive(Debug)]
struct Store {
    what: &'static str,
    usage: BufferUsages,
    buffer: Option<Buffer>,
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
    /// The backend submits to `queue` and waits for its own submissions. Errors of its own calls are caught and
    /// do not reach the host's error handler.
    ///
    /// # Errors
    /// If the device fails, or gives fewer than the eight storage buffers that WebGPU promises.
    pub fn with_device(name: &str, device: Device, queue: Queue) -> Result<Self, BackendError> {
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
        let mut backend = Self {
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
            uploaded: None,
            timeout: COMPILE_TIMEOUT,
        };
        backend.warm_up()?;
        backend.timeout = TIMEOUT;
        Ok(backend)
    }

    /// Runs both kernels once, on one pair of empty images: drivers compile at the first use.
    fn warm_up(&mut self) -> Result<(), BackendError> {
        let mut batch = Batch::default();
        batch.clear(2, 0);
        let (a, b) = (batch.push_image(0, 1.0, 1.0, 1.0), batch.push_image(0, -1.0, 1.0, 1.0));
        batch.push_pair(a, b, 0.0, Clips::default());
        self.evaluate(&SurfaceSet::default(), &batch, &mut Vec::new())
    }

    /// Makes room and uploads.
    fn load(&mut self, surfaces: &SurfaceSet, batch: &Batch) -> Result<(), BackendError> {
        let (device, queue, name) = (&self.device, &self.queue, &self.name);
        let mut grown = false;
        if self.uploaded != Some(surfaces.revision()) {
            self.uploaded = None;
            grown |= self.levels.write(device, queue, name, bytemuck::cast_slice(&surfaces.levels))?;
            grown |=
                self.coefficients.write(device, queue, name, bytemuck::cast_slice(&surfaces.coefficients))?;
            self.uploaded = Some(surfaces.revision());
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
        // Images know nothing of pairs.
        Some([(&self.images, &entries[..6]), (&self.overlaps, &entries[..])].map(|(pipeline, entries)| {
            self.device.create_bind_group(&BindGroupDescriptor {
                label: Some(TEXTURE_DEPTH.name),
                layout: &pipeline.get_bind_group_layout(0),
                entries,
            })
        }))
    }

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
            let across = image_count.min(most);
            pass.dispatch_workgroups((grid * grid).div_ceil(TEXELS), across, image_count.div_ceil(across));
            pass.set_pipeline(&self.overlaps);
            pass.set_bind_group(0, overlaps, &[]);
            let across = pairs.min(most);
            pass.dispatch_workgroups(across, pairs.div_ceil(across), 1);
        }
        let used = u64::from(pairs) * size_of::<Answer>() as u64;
        encoder.copy_buffer_to_buffer(found, 0, readback, 0, used);
        let submission = self.queue.submit([encoder.finish()]);

        let (send, receive) = mpsc::sync_channel(1);
        readback.map_async(MapMode::Read, ..used, move |result| {
            // The receiver is gone only after a timeout.
            let _ = send.send(result);
        });
        let wait = PollType::Wait { submission_index: Some(submission), timeout: Some(self.timeout) };
        self.device.poll(wait).map_err(|error| failed(error.to_string()))?;
        match receive.try_recv() {
            Ok(Ok(())) => {}
            Ok(Err(error)) => return Err(failed(error.to_string())),
            Err(_) => return Err(failed("the answers did not arrive".into())),
        }
        {
            let bytes = readback.get_mapped_range(..used).map_err(|error| failed(error.to_string()))?;
            answers.extend_from_slice(bytemuck::cast_slice(&bytes));
        }
        readback.unmap();
        Ok(())
    }
}

impl Store {
    /// Makes room for as many bytes; whether the buffer is a new one.
    fn reserve(&mut self, device: &Device, name: &str, bytes: u64) -> Result<bool, BackendError> {
        if self.buffer.as_ref().is_some_and(|buffer| buffer.size() >= bytes) {
            return Ok(false);
        }
        let limits = device.limits();
        let limit = limits.max_buffer_size.min(limits.max_storage_buffer_binding_size) / 16 * 16;
        if bytes > limit {
            return Err(BackendError::TooLarge { what: self.what, bytes, limit, device: name.into() });
        }
        // The old one is given back before the new one is made.
        self.buffer = None;
        self.buffer = Some(device.create_buffer(&BufferDescriptor {
            label: Some(self.what),
            size: bytes.next_power_of_two().clamp(256, limit),
            usage: self.usage,
            mapped_at_creation: false,
        }));
        Ok(true)
    }

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

impl Backend for WgpuBackend {
    fn name(&self) -> &str {
        &self.name
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
        let (name, device) = (self.name.clone(), self.device.clone());
        let result = caught(&name, &device, || {
            self.load(surfaces, batch)?;
            self.submit(batch, answers)
        });
        let result = result.flatten();
        if result.is_err() {
            // Buffers of a failed run may still be mapped or in use: the next run makes new ones.
            answers.clear();
            self.readback.buffer = None;
            self.groups = None;
            self.uploaded = None;
        }
        result
    }
}

/// What `work` gives, or the first error that its calls on the device raised: uncaught, they would panic.
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
