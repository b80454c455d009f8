//! Contact steps while the backend of textured contacts fails, is late, or is not ready yet: the processor
//! computes them in time, and this is counted.

use std::pin::pin;
use std::sync::Arc;
use std::task::{Context, Poll, Waker};
use std::time::{Duration, Instant};

use palpate::device::{Emulation, IntendedPath};
use palpate::dynamics::BodyState;
use palpate::glam::{DQuat, DVec3};
use palpate::models::Model;
use palpate::settings::{TextureBackend, TextureSettings};
use palpate::texture_pd::wgpu::{self, Device, Queue};
use palpate::texture_pd::{
    Answer, AutoBackend, Backend, BackendError, Batch, CpuBackend, DepthQuery, DepthSettings, Domain,
    SurfaceSet, TextureContact, TexturedSurface, WgpuBackend,
};
use palpate::{ContactLoop, HapticRenderer, Object, Pose, Scene, SceneId, Settings};
use palpate_tests::{model, penalties, ridged_plate};

/// Returns a pose of the object below the probe at the origin, in contact.
fn below(probe: &Object, object: &Object) -> Pose {
    let top = |object: &Object| object.clod.vertices.iter().map(|v| v.z).fold(f64::NEG_INFINITY, f64::max);
    let bottom = probe.clod.vertices.iter().map(|v| v.z).fold(f64::INFINITY, f64::min);
    Pose::from_translation((0.9 * bottom - top(object)) * DVec3::Z)
}

/// Contact loop whose probe is held against a textured plate.
struct Held {
    contact: ContactLoop,
    body: BodyState,
    time: f64,
}

impl Held {
    fn new(scene: Scene, backend: Option<Box<dyn Backend>>, textures: TextureSettings) -> Self {
        let probe = model("ellipsoid@500");
        let device = Emulation::default().open(IntendedPath::from(Pose::IDENTITY)).expect("a device");
        let settings = Settings { textures, ..penalties() };
        let mut renderer = HapticRenderer::new(probe, scene, Box::new(device), settings).expect("renderer");
        if let Some(backend) = backend {
            renderer.set_texture_backend(backend);
        }
        let (haptic, contact, _) = renderer.into_loops();
        Self { contact, body: *haptic.body_state(), time: 0.0 }
    }

    fn at_plate(backend: Box<dyn Backend>) -> Self {
        let (probe, plate) = (model("ellipsoid@500"), ridged_plate(5e-4, 2e-3));
        let at = below(&probe, &plate);
        Self::new(Scene::new().with(plate, at), Some(backend), TextureSettings::default())
    }

    /// Takes a contact step; returns its force, N, and its duration.
    fn step(&mut self) -> (f64, Duration) {
        self.time += 0.002;
        let start = Instant::now();
        let update = self.contact.step(&self.body, self.time);
        let took = start.elapsed();
        (update.model.wrench(&self.body).force.length(), took)
    }

    fn lost(&self) -> u64 {
        self.contact.telemetry().events.texture_backend_lost
    }
}

fn too_large() -> BackendError {
    BackendError::TooLarge { what: "heights", bytes: 2, limit: 1, device: "small".into() }
}

fn failed() -> BackendError {
    BackendError::Device { device: "gone".into(), reason: "it is lost".into() }
}

/// Backend that fails on demand, and otherwise computes as the processor does, or returns at once that
/// nothing touches.
struct Failing<F> {
    processor: CpuBackend,
    batches: usize,
    fails: F,
    hasty: bool,
}

impl<F: FnMut(usize) -> Option<BackendError> + Send> Backend for Failing<F> {
    fn name(&self) -> &str {
        "failing"
    }

    fn evaluate(
        &mut self,
        surfaces: &SurfaceSet,
        batch: &Batch,
        answers: &mut Vec<Answer>,
    ) -> Result<(), BackendError> {
        self.batches += 1;
        answers.clear();
        if let Some(error) = (self.fails)(self.batches) {
            return Err(error);
        }
        if self.hasty {
            answers.resize(1, Answer::default());
            return Ok(());
        }
        self.processor.evaluate(surfaces, batch, answers)
    }
}

fn failing(
    fails: impl FnMut(usize) -> Option<BackendError> + Send,
) -> Failing<impl FnMut(usize) -> Option<BackendError> + Send> {
    Failing { processor: CpuBackend::new(), batches: 0, fails, hasty: false }
}

/// The processor computes a batch that is too large for the backend, and the backend the next one.
#[test]
fn a_batch_that_is_too_large_falls_back_alone() {
    let asked = Arc::new(std::sync::atomic::AtomicUsize::new(0));
    let count = asked.clone();
    let mut held = Held::at_plate(Box::new(failing(move |batch| {
        count.store(batch, std::sync::atomic::Ordering::Relaxed);
        (batch % 2 == 1).then(too_large)
    })));
    for _ in 0..10 {
        assert!(held.step().0 > 0.01);
    }
    assert_eq!(
        asked.load(std::sync::atomic::Ordering::Relaxed),
        10,
        "batches that the backend was asked for"
    );
    assert_eq!(held.lost(), 5);
}

/// Returns the surface of a plate, and a contact of two of them.
fn plates() -> (SurfaceSet, TextureContact) {
    let plate = Model::Plate.generate(12).expect("plate");
    let surface = Arc::new(TexturedSurface::plain(&plate).expect("a surface"));
    let mut surfaces = SurfaceSet::default();
    let id = surfaces.add(&surface).expect("room");
    let contact = TextureContact {
        a: id,
        pose_a: Pose::new(DVec3::Z * 1e-3, DQuat::from_rotation_x(std::f64::consts::PI)),
        center: DVec3::ZERO,
        b: id,
        pose_b: Pose::IDENTITY,
        normal: -DVec3::Z,
        point: DVec3::ZERO,
        half_size: 0.01,
        reach: 0.1,
        domain: Domain::WHOLE,
    };
    (surfaces, contact)
}

/// A backend that selects the faster of two counts fallbacks like any other.
#[test]
fn failures_are_counted_with_the_selecting_backend() {
    let (surfaces, contact) = plates();
    // The selection takes ten batches; the third batch of the session is lost.
    let other = Failing { hasty: true, ..failing(|batch| (batch > 12).then(failed)) };
    let settings = DepthSettings { grid: 200, ..DepthSettings::default() };
    let auto = AutoBackend::choose(Box::new(other), &surfaces, &[contact], &settings).expect("settings");
    assert_eq!(auto.name(), "failing");
    let mut held = Held::at_plate(Box::new(auto));
    for _ in 0..6 {
        held.step();
    }
    assert!(held.step().0 > 0.01);
    assert_eq!(held.lost(), 1);
}

/// Returns the value of a future; wgpu's native ones are ready at once.
fn ready<T>(future: impl Future<Output = T>) -> T {
    match pin!(future).poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(value) => value,
        Poll::Pending => panic!("it is not ready"),
    }
}

/// Returns the device of a software driver, which works through submissions one after the other.
fn device() -> (Device, Queue) {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let software = wgpu::RequestAdapterOptions { force_fallback_adapter: true, ..Default::default() };
    let adapter = ready(instance.request_adapter(&software)).expect("a software Vulkan driver is installed");
    ready(adapter.request_device(&Default::default())).expect("the adapter gives a device")
}

/// Work of a host on its device.
struct Work {
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
}

impl Work {
    fn new(device: &Device) -> Self {
        let source = "@group(0) @binding(0) var<storage, read_write> sum: array<u32>;
            @compute @workgroup_size(1)
            fn main() {
                var x = sum[0];
                for (var i = 0u; i < 50000u; i++) { x = x * 1664525u + 1013904223u + (x >> 7u); }
                sum[0] = x;
            }";
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: None,
            source: wgpu::ShaderSource::Wgsl(source.into()),
        });
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: None,
            layout: None,
            module: &module,
            entry_point: None,
            compilation_options: Default::default(),
            cache: None,
        });
        let buffer = device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: 4,
            usage: wgpu::BufferUsages::STORAGE,
            mapped_at_creation: false,
        });
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &pipeline.get_bind_group_layout(0),
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: buffer.as_entire_binding() }],
        });
        Self { pipeline, group }
    }

    fn submit(&self, device: &Device, queue: &Queue, rows: u32) {
        let mut encoder = device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &self.group, &[]);
            pass.dispatch_workgroups(500, rows, 1);
        }
        queue.submit([encoder.finish()]);
    }

    /// Keeps a device busy for some seconds.
    fn occupy(device: &Device, queue: &Queue, seconds: f64) {
        let work = Self::new(device);
        let time = || {
            let start = Instant::now();
            work.submit(device, queue, 1);
            device.poll(wgpu::PollType::wait_indefinitely()).expect("a device");
            start.elapsed().as_secs_f64()
        };
        // The driver compiles at the first use.
        let once = time().min(time()).min(time());
        work.submit(device, queue, (seconds / once) as u32);
    }
}

/// The host's own work occupies the queue for seconds. A contact step waits no longer than its deadline, and
/// the device is given up after a second without an answer.
#[test]
fn a_device_that_hangs_delays_no_contact_step() {
    let (device, queue) = device();
    let mut backend = WgpuBackend::with_device("host", device.clone(), queue.clone()).expect("a backend");
    let (surfaces, contact) = plates();
    // Without a contact loop, whose deadline a busy machine may miss: the third late batch in a row would be
    // the last.
    let settings = DepthSettings::default();
    DepthQuery::new().run(&surfaces, &[contact], &settings, &mut backend).expect("the device answers");
    let mut held = Held::at_plate(Box::new(backend));
    Work::occupy(&device, &queue, 4.0);
    let before = held.lost();
    let begun = Instant::now();
    let (mut longest, mut steps) = (Duration::ZERO, 0);
    while begun.elapsed() < Duration::from_millis(1500) {
        let (force, took) = held.step();
        assert!(force > 0.01, "the processor computes");
        longest = longest.max(took);
        steps += 1;
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(longest < Duration::from_millis(200), "{longest:?} for one of {steps} steps");
    let busy = device.poll(wgpu::PollType::Poll).expect("a device");
    assert_ne!(busy, wgpu::PollStatus::QueueEmpty, "the host's work is over: make it longer");
    let lost = held.lost() - before;
    assert!(lost > 1 && lost < steps, "{lost} of {steps} steps were counted");
    let ended = Instant::now();
    drop(held);
    assert!(ended.elapsed() < Duration::from_millis(500), "{:?} to end", ended.elapsed());
}

/// The processor takes over from one step to the next when the host's device is lost.
#[test]
fn a_device_that_is_lost_is_counted_and_not_used_again() {
    let (device, queue) = device();
    let backend = WgpuBackend::with_device("host", device.clone(), queue).expect("a backend");
    let mut held = Held::at_plate(Box::new(backend));
    held.step();
    let before = held.lost();
    device.destroy();
    // On a busy machine an answer may be late before the loss is known.
    for _ in 0..10 {
        assert!(held.step().0 > 0.01);
        std::thread::sleep(Duration::from_millis(20));
    }
    let lost = held.lost();
    assert!((1..10).contains(&(lost - before)), "{} counted", lost - before);
    for _ in 0..10 {
        assert!(held.step().0 > 0.01);
    }
    assert_eq!(held.lost(), lost);
}

/// A device and its kernels take long to build, which must not happen in the contact step in which the first
/// texture appears.
#[test]
fn a_new_texture_delays_no_contact_step() {
    let textures = TextureSettings::default();
    let (probe, plate) = (model("ellipsoid@500"), ridged_plate(5e-4, 2e-3));
    let at = below(&probe, &plate);
    let add = |backend| {
        let mut held = Held::new(Scene::new(), None, TextureSettings { backend, ..textures });
        held.step();
        let start = Instant::now();
        assert!(held.contact.add(SceneId(7), &plate, &at));
        let added = start.elapsed();
        let (force, took) = held.step();
        assert!(force > 0.01, "the processor computes meanwhile");
        assert!(held.contact.remove(SceneId(7)) && held.step().0 == 0.0);
        added + took
    };
    // The fastest of three, since the machine may be busy.
    let fastest = |backend| (0..3).map(|_| add(backend)).min().unwrap_or_default();
    let processor = fastest(TextureBackend::Processor);
    for backend in [TextureBackend::Gpu, TextureBackend::Auto] {
        let took = fastest(backend);
        assert!(
            took < 3 * processor + Duration::from_millis(30),
            "{backend:?}: {took:?}, {processor:?} without"
        );
    }
}
