//! Fast hands and thin walls (§5.6.1): an object that is braked before it touches stays on its side of a plate.

use std::convert::Infallible;
use std::sync::atomic::AtomicBool;

use palpate::device::{Emulation, IntendedPath};
use palpate::glam::DVec3;
use palpate::models::Model;
use palpate::{ContactTiming, HapticRenderer, Object, Pose, Scene, Settings, TriMesh, Twist};

/// Thickness of the plate, m; contact queries a second, Hz.
const THICKNESS: f64 = 1e-3;
const RATE: f64 = 200.0;

fn plate() -> Object {
    let mesh = Model::Block.generate(300).expect("in range");
    let (low, high) = mesh
        .vertices()
        .iter()
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), v| (low.min(*v), high.max(*v)));
    let size = DVec3::new(0.1, 0.1, THICKNESS) / (high - low);
    let vertices = mesh.vertices().iter().map(|v| (*v - 0.5 * (low + high)) * size).collect();
    let mesh = TriMesh::new(vertices, mesh.triangles().to_vec()).expect("a block");
    Object::from_mesh("plate", &mesh).expect("a hierarchy")
}

/// How often an ellipsoid that is driven 5 mm past its touch comes out behind the plate, of five hits that meet the
/// contact queries at different times.
fn hits_through(speed: f64, braking: bool) -> usize {
    let mesh = Model::Ellipsoid.generate(500).expect("in range");
    let lowest = mesh.vertices().iter().fold(f64::INFINITY, |low, v| low.min(v.z));
    let probe = Object::from_mesh("ellipsoid", &mesh).expect("a hierarchy");
    let touch = 0.5 * THICKNESS - lowest;
    let through = |late: f64| {
        let start = 0.15 * speed;
        let path = IntendedPath::function(move |time| {
            let gone = (time - late).max(0.0);
            // Up to speed in 0.1 s, then 0.1 s to the touch.
            let travel = speed * if gone < 0.1 { 5.0 * gone * gone } else { gone - 0.05 };
            let height = (start - travel).max(-0.005);
            let velocity = if height > -0.005 { -speed * (10.0 * gone).min(1.0) } else { 0.0 };
            (
                Pose::from_translation(DVec3::Z * (touch + height)),
                Twist::new(DVec3::Z * velocity, DVec3::ZERO),
            )
        });
        let device = Emulation::default().open(path).expect("an emulation");
        let scene = Scene::new().with(plate(), Pose::IDENTITY);
        let settings = Settings { braking, ..Settings::default() };
        let renderer =
            HapticRenderer::new(probe.clone(), scene, Box::new(device), settings).expect("a session");
        let mut behind = false;
        let stop = AtomicBool::new(false);
        let Ok(_) = renderer.run_lockstep(0.6, ContactTiming::busy(RATE), &stop, |record| {
            behind |= record.object.translation.z < 0.0;
            Ok::<_, Infallible>(())
        });
        behind
    };
    (0..5).filter(|phase| through(0.2 * f64::from(*phase) / RATE)).count()
}

#[test]
fn braking_keeps_an_object_on_its_side() {
    for speed in [0.3, 1.0] {
        assert_eq!(hits_through(speed, true), 0, "{speed} m/s");
    }
    assert!(hits_through(1.0, false) > 0, "without braking none goes through, and nothing is shown");
}
