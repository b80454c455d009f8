//! Drawn pixels of the scene, of patches in contact, of arrows, and of the background, on any GPU.

use palpate::glam::DVec3;
use palpate::{ContactForce, ContactSnapshot, Object, Pose, Scene, TouchingPatches};
use palpate_view::{Camera, Painter, Picture, mesh_corners};

const SIZE: [u32; 2] = [320, 256];

fn painter() -> (Painter, wgpu::Device, wgpu::Queue) {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let adapter = pollster::block_on(instance.request_adapter(&Default::default()))
        .expect("a Vulkan driver is installed");
    let (device, queue) = pollster::block_on(adapter.request_device(&Default::default())).expect("a device");
    (Painter::new(&device, &queue), device, queue)
}

/// Returns the last drawn pixels, row by row.
fn pixels(painter: &Painter, device: &wgpu::Device, queue: &wgpu::Queue) -> Vec<[u8; 4]> {
    let texture = painter.texture().expect("something was drawn");
    let bytes_per_row = 4 * SIZE[0];
    assert_eq!(bytes_per_row % wgpu::COPY_BYTES_PER_ROW_ALIGNMENT, 0);
    let buffer = device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: u64::from(bytes_per_row * SIZE[1]),
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let mut encoder = device.create_command_encoder(&Default::default());
    let layout =
        wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(bytes_per_row), rows_per_image: None };
    encoder.copy_texture_to_buffer(
        texture.as_image_copy(),
        wgpu::TexelCopyBufferInfo { buffer: &buffer, layout },
        texture.size(),
    );
    queue.submit([encoder.finish()]);
    buffer.map_async(wgpu::MapMode::Read, .., |mapped| mapped.expect("the pixels can be read"));
    device.poll(wgpu::PollType::wait_indefinitely()).expect("the GPU answers");
    buffer.get_mapped_range(..).expect("mapped").as_chunks::<4>().0.to_vec()
}

#[test]
fn scene_patches_arrows_and_nothing_are_where_they_should_be() {
    let (mut painter, device, queue) = painter();
    let (ball, probe) = (Object::model("golf-ball@2000").unwrap(), Object::model("ellipsoid@500").unwrap());
    let scene = Scene::new().with(ball.clone(), Pose::IDENTITY);
    let radius = ball.bounding_radius();
    let camera = Camera { yaw: 0.0, pitch: 0.0, ..Camera::around(ball.clod.source.center, radius) };
    let scenery = [(painter.mesh(&mesh_corners(&ball.clod)), Pose::IDENTITY)];
    // Away from the ball, to the right of it and out of view.
    let away = Pose::from_translation(DVec3::X * 100.0 * radius);
    let held = (painter.mesh(&mesh_corners(&probe.clod)), away);

    let mut draw = |picture: &Picture, place: Pose| {
        painter.paint(SIZE, &camera, &scenery, &(held.0.clone(), place), picture);
        pixels(&painter, &device, &queue)
    };
    let bare = draw(&Picture::default(), away);
    let middle = (SIZE[0] * (SIZE[1] / 2) + SIZE[0] / 2) as usize;
    let [red, green, blue, _] = bare[middle];
    assert!(red.abs_diff(green) < 20 && (60..230).contains(&blue), "the ball is grey: {:?}", bare[middle]);
    assert_eq!(bare[0], [247, 247, 245, 255], "nothing is there");
    let ball_pixels = bare.iter().filter(|pixel| **pixel != bare[0]).count();
    // A disc of 1 / 1.2 of half the height.
    let disc = std::f64::consts::PI * (f64::from(SIZE[1]) / 2.4).powi(2);
    assert!((ball_pixels as f64 / disc - 1.0).abs() < 0.1, "{ball_pixels} of {disc}");

    // Leaf of the ball that is nearest to the camera: red is the finest level.
    let nodes = ball.clod.levels[0].nodes.clone();
    let nearest = nodes.min_by(|a, b| {
        let toward = |node: &u32| ball.clod.node(*node).center.y;
        toward(a).total_cmp(&toward(b))
    });
    let patches = TouchingPatches { object: 0, probe_node: 0, scene_node: nearest.unwrap(), weight: 1.0 };
    let push =
        ContactForce { point: DVec3::X * 1.1 * radius, normal: -DVec3::X, force: DVec3::X, depth: 1e-3 };
    let sight = ContactSnapshot { time: 0.0, patches: vec![patches], forces: vec![push] };
    let picture = Picture::new(&sight, &probe.clod, &away, &scene, 1.0);
    let marked = draw(&picture, away);
    let is_red = |pixel: &&[u8; 4]| pixel[0] > 150 && pixel[1] < 60 && pixel[2] < 60;
    let is_yellow = |pixel: &&[u8; 4]| pixel[0] > 120 && pixel[1] > 100 && pixel[2] < 80;
    assert_eq!(bare.iter().filter(is_red).count() + bare.iter().filter(is_yellow).count(), 0);
    assert!(marked.iter().filter(is_red).count() > 20, "{}", marked.iter().filter(is_red).count());
    assert!(marked.iter().filter(is_yellow).count() > 20, "{}", marked.iter().filter(is_yellow).count());

    // The probe in front of the ball is visible and translucent.
    let veiled = draw(&Picture::default(), Pose::from_translation(-DVec3::Y * 1.5 * radius));
    let [red, _, blue, _] = veiled[middle];
    assert!(veiled[middle] != bare[middle] && red > blue, "{:?}", veiled[middle]);
}
