//! What the GPU backend does about the device it runs on: none, a shared one, a small one, a lost one.
#![cfg(feature = "gpu")]

use palpate_texture_pd::wgpu::{self, Backends, Device, Instance, InstanceDescriptor, Limits, Queue};
use palpate_texture_pd::{Backend, BackendError, PatchPairs, WgpuBackend};

fn device(limits: Limits) -> (Device, Queue) {
    let instance = Instance::new(InstanceDescriptor::new_without_display_handle());
    let adapter = pollster::block_on(instance.request_adapter(&Default::default()))
        .expect("a Vulkan driver is installed");
    let descriptor = wgpu::DeviceDescriptor { required_limits: limits, ..Default::default() };
    pollster::block_on(adapter.request_device(&descriptor)).expect("the adapter gives a device")
}

/// One pair of flat patches, A `height` above B.
fn flat(size: u32, height: f32) -> PatchPairs {
    let mut pairs = PatchPairs::new(size).unwrap();
    let texels = (size * size) as usize;
    let a = pairs.add_patch(&vec![height; texels]).unwrap();
    let b = pairs.add_patch(&vec![0.0; texels]).unwrap();
    pairs.add_pair(a, b).unwrap();
    pairs
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
fn a_host_shares_its_device_between_backends() {
    let (device, queue) = device(Limits::downlevel_defaults());
    let mut first = WgpuBackend::with_device("host", device.clone(), queue.clone()).unwrap();
    let mut second = WgpuBackend::with_device("host", device, queue).unwrap();
    let mut depths = Vec::new();
    for i in 1..5 {
        for backend in [&mut first, &mut second] {
            backend.directional_depths(&flat(8, i as f32), &mut depths).unwrap();
            assert_eq!(depths[0].unwrap().depth, i as f32);
        }
    }
    assert_eq!(first.name(), "host");
}

#[test]
fn a_batch_beyond_the_devices_limits_is_refused_and_the_next_one_runs() {
    let small = Limits { max_storage_buffer_binding_size: 1 << 16, ..Limits::downlevel_defaults() };
    let (device, queue) = device(small);
    let mut backend = WgpuBackend::with_device("small", device, queue).unwrap();
    let mut depths = Vec::new();
    let error = backend.directional_depths(&flat(128, 1.0), &mut depths).unwrap_err();
    assert!(
        matches!(error, BackendError::TooLarge { what: "heights", bytes: 131_072, limit: 65_536, .. }),
        "{error}"
    );
    backend.directional_depths(&flat(64, 1.0), &mut depths).unwrap();
    assert_eq!(depths[0].unwrap().depth, 1.0);
}

#[test]
fn a_lost_device_is_an_error_and_no_panic() {
    let (device, queue) = device(Limits::downlevel_defaults());
    let mut backend = WgpuBackend::with_device("lost", device.clone(), queue.clone()).unwrap();
    let mut depths = Vec::new();
    backend.directional_depths(&flat(8, 1.0), &mut depths).unwrap();
    device.destroy();
    for _ in 0..2 {
        let error = backend.directional_depths(&flat(8, 1.0), &mut depths).unwrap_err();
        assert!(matches!(error, BackendError::Device { .. }) && depths.is_empty(), "{error}");
    }
    // A backend made on a device that is lost already may be refused at once or at its first batch.
    let late = WgpuBackend::with_device("lost", device, queue)
        .and_then(|mut backend| backend.directional_depths(&flat(8, 1.0), &mut depths));
    assert!(matches!(late, Err(BackendError::Device { .. })));
}
