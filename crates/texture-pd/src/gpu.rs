//! Directional penetration depth on the GPU, through wgpu.
//!
//! The pipeline is built once, and buffers grow to the largest batch met and stay. A batch is one upload, one
//! dispatch (a workgroup a pair) and one copy in one submission, then a wait for the results; heights are never
//! read back. wgpu allocates a few small objects for each submission: a backend belongs on the contact thread,
//! not on the haptic one.

use std::sync::mpsc;
use std::time::Duration;

use palpate_shaders::DIRECTIONAL_DEPTH;
use wgpu::{
    BindGroup, BindGroupDescriptor, BindGroupEntry, Buffer, BufferDescriptor, BufferUsages, ComputePipeline,
    ComputePipelineDescriptor, Device, ErrorFilter, Instance, InstanceDescriptor, MapMode, PollType, Queue,
};

use crate::backend::{Backend, BackendError};
use crate::pairs::{DirectionalDepth, PatchPairs};

/// Bytes of the uniform `{ pairs, texels }`, of a pair and of an answer.
const UNIFORM_BYTES: u64 = 8;
const PAIR_BYTES: u64 = 8;
const OVERLAP_BYTES: u64 = 8;
/// A batch that takes longer has hung the device.
const TIMEOUT: Duration = Duration::from_secs(10);

/// A backend on a GPU, or on a software driver that stands in for one.
#[derive(Debug)]
pub struct WgpuBackend {
    name: String,
    device: Device,
    queue: Queue,
    pipeline: ComputePipeline,
    buffers: Option<Buffers>,
}

/// Buffers for batches of up to a number of heights and pairs.
#[derive(Debug)]
struct Buffers {
    heights_bytes: u64,
    pairs: u64,
    uniform: Buffer,
    heights: Buffer,
    pair_starts: Buffer,
    overlaps: Buffer,
    readback: Buffer,
    bind_group: BindGroup,
}

impl WgpuBackend {
    /// A backend on the fastest adapter of this machine: Vulkan, Metal or Direct3D 12. Where there is no GPU, a
    /// software driver serves.
    pub fn new() -> Result<Self, BackendError> {
        Self::from_instance(&Instance::new(InstanceDescriptor::new_without_display_handle()))
    }

    /// A backend on the fastest adapter of `instance`.
    pub fn from_instance(instance: &Instance) -> Result<Self, BackendError> {
        let options = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            ..Default::default()
        };
        let adapter = pollster::block_on(instance.request_adapter(&options))
            .map_err(|error| BackendError::NoAdapter { reason: error.to_string() })?;
        let name = adapter.get_info().name;
        // The least that WebGPU asks for, but room for as much as the adapter binds.
        let most = adapter.limits();
        let limits = wgpu::Limits {
            max_buffer_size: most.max_buffer_size,
            max_storage_buffer_binding_size: most.max_storage_buffer_binding_size,
            ..wgpu::Limits::downlevel_defaults()
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
    pub fn with_device(name: &str, device: Device, queue: Queue) -> Result<Self, BackendError> {
        let pipeline = caught(name, &device, || {
            let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(DIRECTIONAL_DEPTH.name),
                source: wgpu::ShaderSource::Wgsl(DIRECTIONAL_DEPTH.source.into()),
            });
            device.create_compute_pipeline(&ComputePipelineDescriptor {
                label: Some(DIRECTIONAL_DEPTH.name),
                layout: None,
                module: &module,
                entry_point: Some(DIRECTIONAL_DEPTH.entry_points[0]),
                compilation_options: Default::default(),
                cache: None,
            })
        })?;
        Ok(Self { name: name.into(), device, queue, pipeline, buffers: None })
    }

    /// Takes the buffers out, or new ones where those there are cannot hold the batch.
    fn take_buffers(&mut self, heights_bytes: u64, pairs: u64) -> Result<Buffers, BackendError> {
        // The old ones are given back before new ones are made, and those hold as much at least.
        let (had_heights, had_pairs) = match self.buffers.take() {
            Some(buffers) if heights_bytes <= buffers.heights_bytes && pairs <= buffers.pairs => {
                return Ok(buffers);
            }
            Some(buffers) => (buffers.heights_bytes, buffers.pairs),
            None => (0, 0),
        };
        let limits = self.device.limits();
        let limit =
            limits.max_buffer_size.min(limits.max_storage_buffer_binding_size) / PAIR_BYTES * PAIR_BYTES;
        for (what, bytes) in [("heights", heights_bytes), ("pairs", pairs * PAIR_BYTES)] {
            if bytes > limit {
                return Err(BackendError::TooLarge { what, bytes, limit, device: self.name.clone() });
            }
        }
        let heights_bytes = heights_bytes.max(had_heights).next_power_of_two().min(limit);
        let pairs = pairs.max(had_pairs).next_power_of_two().min(limit / PAIR_BYTES);
        caught(&self.name, &self.device, || Buffers::new(&self.device, &self.pipeline, heights_bytes, pairs))
    }

    fn run(
        &self,
        buffers: &Buffers,
        batch: &PatchPairs,
        depths: &mut Vec<Option<DirectionalDepth>>,
    ) -> Result<(), BackendError> {
        let count = batch.len() as u32;
        self.queue.write_buffer(&buffers.uniform, 0, bytemuck::cast_slice(&[count, batch.texels()]));
        self.queue.write_buffer(&buffers.heights, 0, bytemuck::cast_slice(batch.heights()));
        self.queue.write_buffer(&buffers.pair_starts, 0, bytemuck::cast_slice(batch.pairs()));
        let mut encoder = self.device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &buffers.bind_group, &[]);
            let across = count.min(self.device.limits().max_compute_workgroups_per_dimension);
            pass.dispatch_workgroups(across, count.div_ceil(across), 1);
        }
        let used = u64::from(count) * OVERLAP_BYTES;
        encoder.copy_buffer_to_buffer(&buffers.overlaps, 0, &buffers.readback, 0, used);
        let submission = self.queue.submit([encoder.finish()]);

        let (send, receive) = mpsc::sync_channel(1);
        buffers.readback.map_async(MapMode::Read, ..used, move |result| {
            // The receiver is gone only after a timeout.
            let _ = send.send(result);
        });
        let failed = |reason: String| BackendError::Device { device: self.name.clone(), reason };
        let wait = PollType::Wait { submission_index: Some(submission), timeout: Some(TIMEOUT) };
        self.device.poll(wait).map_err(|error| failed(error.to_string()))?;
        match receive.try_recv() {
            Ok(Ok(())) => {}
            Ok(Err(error)) => return Err(failed(error.to_string())),
            Err(_) => return Err(failed("the results did not arrive".into())),
        }
        {
            let bytes =
                buffers.readback.get_mapped_range(..used).map_err(|error| failed(error.to_string()))?;
            let overlaps: &[[u32; 2]] = bytemuck::cast_slice(&bytes);
            depths.extend(overlaps.iter().map(|&overlap| batch.decode(overlap)));
        }
        buffers.readback.unmap();
        Ok(())
    }
}

impl Backend for WgpuBackend {
    fn name(&self) -> &str {
        &self.name
    }

    fn directional_depths(
        &mut self,
        pairs: &PatchPairs,
        depths: &mut Vec<Option<DirectionalDepth>>,
    ) -> Result<(), BackendError> {
        depths.clear();
        if pairs.is_empty() {
            return Ok(());
        }
        let buffers = self.take_buffers(size_of_val(pairs.heights()) as u64, pairs.len() as u64)?;
        let result = caught(&self.name, &self.device, || self.run(&buffers, pairs, depths)).flatten();
        match result {
            Ok(()) => self.buffers = Some(buffers),
            // Buffers of a failed run may still be mapped or in use: the next run makes new ones.
            Err(_) => depths.clear(),
        }
        result
    }
}

impl Buffers {
    fn new(device: &Device, pipeline: &ComputePipeline, heights_bytes: u64, pairs: u64) -> Self {
        let buffer = |label, size, usage| {
            device.create_buffer(&BufferDescriptor {
                label: Some(label),
                size,
                usage,
                mapped_at_creation: false,
            })
        };
        let input = BufferUsages::STORAGE | BufferUsages::COPY_DST;
        let uniform = buffer("batch", UNIFORM_BYTES, BufferUsages::UNIFORM | BufferUsages::COPY_DST);
        let heights = buffer("heights", heights_bytes, input);
        let pair_starts = buffer("pairs", pairs * PAIR_BYTES, input);
        let overlaps =
            buffer("overlaps", pairs * OVERLAP_BYTES, BufferUsages::STORAGE | BufferUsages::COPY_SRC);
        let readback =
            buffer("readback", pairs * OVERLAP_BYTES, BufferUsages::MAP_READ | BufferUsages::COPY_DST);
        let bind_group = device.create_bind_group(&BindGroupDescriptor {
            label: Some(DIRECTIONAL_DEPTH.name),
            layout: &pipeline.get_bind_group_layout(0),
            entries: &[&uniform, &heights, &pair_starts, &overlaps]
                .into_iter()
                .zip(0..)
                .map(|(buffer, binding)| BindGroupEntry { binding, resource: buffer.as_entire_binding() })
                .collect::<Vec<_>>(),
        });
        Self { heights_bytes, pairs, uniform, heights, pair_starts, overlaps, readback, bind_group }
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
