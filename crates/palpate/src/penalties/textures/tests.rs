//! Textured contacts between tetrahedra whose textures are displaced by one height everywhere.

use palpate_core::glam::{DQuat, DVec2};
use palpate_core::mesh::UvMesh;
use palpate_core::{Contact, TriMesh};
use palpate_texture_pd::{HeightImage, Wrap};

use super::*;
use crate::settings::TextureBackend;

/// Side of the tetrahedron, height of its texture and tolerance, m.
const SIDE: f64 = 0.01;
const HEIGHT: f64 = 1e-4;
const TOLERANCE: f64 = 2e-4;

fn mesh() -> UvMesh {
    let corners = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|corner| corner * SIDE).to_vec();
    let mesh = TriMesh::new(corners, vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]).unwrap();
    UvMesh::projected(mesh, |corner| DVec2::new(corner.x, corner.y) / SIDE).unwrap()
}

fn object(height: f64) -> Object {
    let image = HeightImage::new(2, 2, vec![height as f32; 4], [Wrap::Clamp; 2]).unwrap();
    Object::textured("tetrahedron", &mesh(), &image, 1.0).unwrap()
}

fn settings(backend: TextureBackend) -> Settings {
    let mut settings = Settings::default();
    settings.textures.backend = backend;
    settings
}

/// The probe's lower face lies on the other's, which is turned up.
fn face_to_face() -> (Pose, PatchContact) {
    let axis = DVec3::new(1.0, 1.0, 0.0).normalize();
    let turned = Pose::new(DVec3::ZERO, DQuat::from_axis_angle(axis, std::f64::consts::PI));
    let point = DVec3::new(SIDE, SIDE, 0.0) / 3.0;
    let contact = Contact { point, scene_point: point, normal: DVec3::NEG_Z, depth: 0.0 };
    (turned, PatchContact { contact, probe_node: 0, scene_node: 0, weight: 1.0 })
}

fn textures(heights: [f64; 2]) -> Textures {
    let [probe, other] = heights.map(object);
    let settings = settings(TextureBackend::Processor);
    Textures::new(&probe, &[Some(&other)], &settings, TOLERANCE, SIDE).unwrap().expect("a textured pair")
}

#[test]
fn depth_is_that_of_the_displaced_surfaces() {
    let (pose, coarse) = face_to_face();
    for heights in [[HEIGHT, HEIGHT], [HEIGHT, 0.5 * HEIGHT], [-0.5 * HEIGHT, HEIGHT]] {
        let mut textures = textures(heights);
        assert!(textures.take(0, &coarse, TOLERANCE));
        let mut events = Events::default();
        let found = textures.run(&Pose::IDENTITY, DVec3::ZERO, |_| Some(pose), TOLERANCE, &mut events);
        assert!(!found.is_empty(), "{heights:?}");
        for contact in found {
            let depth = contact.contact.depth;
            // The smooth maximum of a plane of overlaps is above them by a few temperatures.
            let above = depth - heights.iter().sum::<f64>();
            assert!((0.0..6.0 * DEFAULT_TEMPERATURE * TOLERANCE).contains(&above), "{heights:?}: {depth}");
            assert!((contact.contact.linear - DVec3::NEG_Z).length() < 1e-3, "{:?}", contact.contact.linear);
            let lifted = contact.depth_after(&Twist::new(DVec3::Z * HEIGHT, DVec3::ZERO));
            assert!((lifted - (depth - HEIGHT)).abs() < 1e-6, "{lifted}");
        }
        assert_eq!(events, Events::default());
    }
}

#[test]
fn displacement_sets_how_far_contacts_are_searched_and_how_deep_meshes_sink() {
    let textures = textures([HEIGHT, HEIGHT]);
    assert!((textures.protrusion() - 2.0 * HEIGHT).abs() < 1e-9 && textures.recesses() == [0.0]);
    let sunk = self::textures([-HEIGHT, -HEIGHT]);
    assert!(sunk.protrusion() == 0.0 && (sunk.recesses()[0] - 2.0 * HEIGHT).abs() < 1e-9);
}

#[test]
fn coarse_contacts_count_up_to_the_protrusion() {
    let mut textures = textures([HEIGHT, HEIGHT]);
    let (_, mut coarse) = face_to_face();
    coarse.contact.depth = -TOLERANCE - 1.9 * HEIGHT;
    assert!(textures.take(0, &coarse, TOLERANCE));
    coarse.contact.depth = -TOLERANCE - 2.1 * HEIGHT;
    assert!(!textures.take(0, &coarse, TOLERANCE));
    assert!(!textures.take(7, &coarse, TOLERANCE), "there is one object");
}

#[test]
fn a_scene_without_textures_has_none() {
    let plain = Object::from_mesh("plain", mesh().mesh()).unwrap();
    let settings = settings(TextureBackend::Processor);
    let made = Textures::new(&plain, &[Some(&plain), None], &settings, TOLERANCE, SIDE).unwrap();
    assert!(made.is_none());
}

/// The backend stays as objects come and go.
#[test]
fn a_backend_is_kept_until_no_texture_is_left() {
    let (probe, other) = (object(HEIGHT), object(HEIGHT));
    let settings = settings(TextureBackend::Processor);
    let mut textures = None;
    let renew = |textures: &mut Option<Textures>, objects: &[Option<&Object>]| {
        Textures::renew(textures, &probe, objects, &settings, TOLERANCE, SIDE).unwrap();
    };
    renew(&mut textures, &[Some(&other)]);
    textures.as_mut().unwrap().set_backend(Box::new(palpate_texture_pd::CpuBackend::new()));
    renew(&mut textures, &[Some(&other), Some(&other)]);
    assert!(textures.as_ref().unwrap().computing.has_other());
    renew(&mut textures, &[]);
    assert!(textures.is_none());
}

/// The processor computes until the GPU's backend has been made in a thread.
#[cfg(feature = "gpu")]
#[test]
fn a_gpu_takes_over_once_it_is_made() {
    let (probe, other) = (object(HEIGHT), object(HEIGHT));
    let settings = settings(TextureBackend::Gpu);
    let mut textures = None;
    Textures::renew(&mut textures, &probe, &[Some(&other)], &settings, TOLERANCE, SIDE).unwrap();
    let textures = textures.as_mut().unwrap();
    assert_eq!(textures.backend(), "CPU");
    let begun = std::time::Instant::now();
    let mut events = Events::default();
    while textures.backend() == "CPU" {
        assert!(begun.elapsed().as_secs() < 60, "no backend was made");
        textures.run(&Pose::IDENTITY, DVec3::ZERO, |_| None, TOLERANCE, &mut events);
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    assert_eq!(events.texture_backend_lost, 0);
}
