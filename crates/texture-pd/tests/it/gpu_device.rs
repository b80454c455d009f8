//! The GPU backend with no device, a shared one, a small one and a lost one.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::common::{Plates, turned_over};
use glam::{DVec2, DVec3};
use palpate_texture_pd::wgpu::{self, Backends, Device, Instance, InstanceDescriptor, Limits, Queue};
use palpate_texture_pd::{
    BackendError, DepthError, DepthQuery, DepthSettings, SurfaceId, SurfaceSet, WgpuBackend,
};

fn device(limits: Limits) -> (Device, Queue) {
    let instance = Instance::new(InstanceDescriptor::new_without_display_handle());
    let adapter = pollster::block_on(instance.request_adapter(&Default::default()))
        .expect("a Vulkan driver is installed");
    let descriptor = wgpu::DeviceDescriptor { required_limits: limits, ..Default::default() };
    pollster::block_on(adapter.request_device(&descriptor)).expect("the adapter gives a device")
}

/// Two flat plates, with a texture of `texels` × `texels`.
struct Flat {
    surfaces: SurfaceSet,
    ids: [SurfaceId; 2],
    query: DepthQuery,
}

impl Flat {
    fn new(texels: u32) -> Self {
        let (surfaces, ids) = plates().surfaces(texels);
        Self { surfaces, ids, query: DepthQuery::new() }
    }

    /// Computes the depth of A in B, which is `depth` (m).
    fn depth(&mut self, backend: &mut WgpuBackend, grid: u32, depth: f64) -> Result<f64, BackendError> {
        let contact = plates().contact(self.ids, turned_over(DVec2::ZERO, -depth, DVec3::ZERO), 0.01);
        let settings = DepthSettings { grid, ..DepthSettings::default() };
        match self.query.run(&self.surfaces, &[contact], &settings, backend) {
            Ok(depths) => Ok(depths[0].map_or(f64::NAN, |found| found.depth)),
            Err(DepthError::Backend(error)) => Err(error),
            Err(error) => panic!("{error}"),
        }
    }
}

fn plates() -> Plates<'static> {
    Plates { half: 0.03, relief_a: &|_| 0.0, relief_b: &|_| 0.0 }
}

fn assert_is_deep(found: Result<f64, BackendError>, depth: f64) {
    let found = found.unwrap_or_else(|error| panic!("{error}"));
    assert!((found - depth).abs() < 1e-8, "{found} in place of {depth}");
}

#[test]
fn without_an_adapter_the_error_says_what_to_install() {
    let none = InstanceDescriptor {
        backends: Backends::empty(),
        ..InstanceDescriptor::new_without_display_handle()
    };
    let error = WgpuBackend::from_instance(&Instance::new(none)).unwrap_err();
    assert!(matches!(error, BackendError::NoAdapter { .. }));
    let message = error.to_string();
    assert!(
        message.contains("apt-get install mesa-vulkan-drivers") && message.contains("CPU backend"),
        "{message}"
    );
}

#[test]
fn host_shares_its_device_between_backends() {
    let (device, queue) = device(Limits::default());
    let mut first = WgpuBackend::with_device("host", device.clone(), queue.clone()).unwrap();
    let mut second = WgpuBackend::with_device("host", device, queue).unwrap();
    let mut flat = Flat::new(4);
    for i in 1..5 {
        for backend in [&mut first, &mut second] {
            let depth = f64::from(i) * 1e-3;
            assert_is_deep(flat.depth(backend, 8, depth), depth);
        }
    }
    assert_eq!(palpate_texture_pd::Backend::name(&first), "host");
}

/// A host that polls and submits at the same time may run our callback, after our own poll.
#[test]
fn host_that_polls_at_the_same_time_loses_no_answers() {
    const BATCHES: usize = 3000;
    let (device, queue) = device(Limits::default());
    let mut backend = WgpuBackend::with_device("host", device.clone(), queue.clone()).unwrap();
    let mut flat = Flat::new(4);
    let done = AtomicBool::new(false);
    let failures = std::thread::scope(|scope| {
        scope.spawn(|| {
            while !done.load(Ordering::Relaxed) {
                device.poll(wgpu::PollType::Poll).unwrap();
            }
        });
        scope.spawn(|| {
            while !done.load(Ordering::Relaxed) {
                queue.submit([]);
                std::thread::yield_now();
            }
        });
        let found: Vec<_> = (0..BATCHES).map(|_| flat.depth(&mut backend, 2, 1e-3)).collect();
        done.store(true, Ordering::Relaxed);
        found.into_iter().filter_map(Result::err).collect::<Vec<_>>()
    });
    assert!(failures.is_empty(), "{} of {BATCHES}: {}", failures.len(), failures[0]);
}

#[test]
fn backend_uploads_the_textures_of_another_set() {
    let (device, queue) = device(Limits::default());
    let mut backend = WgpuBackend::with_device("host", device, queue).unwrap();
    let mut flat = Flat::new(4);
    let raised = Plates { relief_b: &|_| 2e-3, ..plates() };
    let (surfaces, ids) = raised.surfaces(4);
    let mut raised = Flat { surfaces, ids, query: DepthQuery::new() };
    for _ in 0..2 {
        assert_is_deep(flat.depth(&mut backend, 8, 1e-3), 1e-3);
        assert_is_deep(raised.depth(&mut backend, 8, 1e-3), 3e-3);
    }
}

#[test]
fn batch_beyond_the_devices_limits_is_refused_and_the_next_one_runs() {
    let small = Limits { max_storage_buffer_binding_size: 1 << 16, ..Limits::default() };
    let (device, queue) = device(small);
    let mut backend = WgpuBackend::with_device("small", device, queue).unwrap();
    let mut flat = Flat::new(4);
    let error = flat.depth(&mut backend, 128, 1e-3).unwrap_err();
    assert!(
        matches!(error, BackendError::TooLarge { what: "heights", bytes: 262_144, limit: 65_536, .. }),
        "{error}"
    );
    assert_is_deep(flat.depth(&mut backend, 64, 1e-3), 1e-3);
    let error = Flat::new(256).depth(&mut backend, 64, 1e-3).unwrap_err();
    assert!(matches!(error, BackendError::TooLarge { what: "textures", .. }), "{error}");
    assert_is_deep(flat.depth(&mut backend, 64, 1e-3), 1e-3);
}

#[test]
fn device_with_too_few_buffers_is_refused() {
    let (device, queue) = device(Limits::downlevel_defaults());
    let error = WgpuBackend::with_device("old", device, queue).unwrap_err();
    assert!(matches!(error, BackendError::Device { .. }), "{error}");
}

#[test]
fn lost_device_is_an_error_without_a_panic() {
    let (device, queue) = device(Limits::default());
    let mut backend = WgpuBackend::with_device("lost", device.clone(), queue.clone()).unwrap();
    let mut flat = Flat::new(4);
    assert_is_deep(flat.depth(&mut backend, 8, 1e-3), 1e-3);
    device.destroy();
    for _ in 0..2 {
        let error = flat.depth(&mut backend, 8, 1e-3).unwrap_err();
        assert!(matches!(error, BackendError::Device { .. }), "{error}");
    }
    // A backend on a lost device is refused, since it runs the kernels at once.
    let late = WgpuBackend::with_device("lost", device, queue);
    assert!(matches!(late, Err(BackendError::Device { .. })));
}
