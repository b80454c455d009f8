//! Fast and strong hands at thin walls (§5.6.1): an object stays on its side of the wall.

use std::convert::Infallible;
use std::sync::atomic::AtomicBool;

use palpate::device::{Emulation, IntendedPath, Interpolation, Keyframe, MotionPath};
use palpate::dynamics::BodyState;
use palpate::glam::{DQuat, DVec3};
use palpate::models::Model;
use palpate::settings::{ContactSettings, SearchSettings};
use palpate::{
    ContactTiming, HapticRenderer, Object, Pose, Record, Scene, SceneId, Session, Settings, TriMesh, Twist,
};
use palpate_tests::penalties;

/// Half extents of the plates, m.
const HALF: f64 = 0.05;

/// Returns a block about the origin with the given sides, m.
fn block(size: DVec3) -> Object {
    let mesh = Model::Block.generate(300).expect("in range");
    let (low, high) = mesh
        .vertices()
        .iter()
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), v| (low.min(*v), high.max(*v)));
    let scale = size / (high - low);
    let vertices = mesh.vertices().iter().map(|v| (*v - 0.5 * (low + high)) * scale).collect();
    let mesh = TriMesh::new(vertices, mesh.triangles().to_vec()).expect("a block");
    Object::from_mesh("block", &mesh).expect("a hierarchy")
}

fn plate(thickness: f64) -> Object {
    block(DVec3::new(2.0 * HALF, 2.0 * HALF, thickness))
}

/// Returns an ellipsoid, and the height of its centre above a surface that it lies on.
fn ellipsoid() -> (Object, f64) {
    let mesh = Model::Ellipsoid.generate(500).expect("in range");
    let lowest = mesh.vertices().iter().fold(f64::INFINITY, |low, v| low.min(v.z));
    (Object::from_mesh("ellipsoid", &mesh).expect("a hierarchy"), -lowest)
}

/// Renders a probe that a hand moves over a scene object at the origin.
fn render(
    probe: &Object,
    scene: &Object,
    path: impl Into<IntendedPath>,
    settings: Settings,
    (seconds, rate): (f64, f64),
) -> (Session, Vec<Record>) {
    let device = Emulation::default().open(path).expect("an emulation");
    let scene = Scene::new().with(scene.clone(), Pose::IDENTITY);
    let renderer = HapticRenderer::new(probe.clone(), scene, Box::new(device), settings).expect("a session");
    let mut records = Vec::new();
    let stop = AtomicBool::new(false);
    let Ok(session) = renderer.run_lockstep(seconds, ContactTiming::busy(rate), &stop, |record| {
        records.push(*record);
        Ok::<_, Infallible>(())
    });
    (session, records)
}

/// Counts hits in which an ellipsoid, driven 5 mm beyond its touch, ends behind the plate; without a proxy to
/// bring it back, hits in which it is behind for a moment. Of five hits at different phases of the contact
/// queries, 200 a second.
fn hits_through(thickness: f64, speed: f64, braking: bool, proxy: bool) -> usize {
    let (probe, low) = ellipsoid();
    let plate = plate(thickness);
    let touch = 0.5 * thickness + low;
    let rate = 200.0;
    let through = |late: f64| {
        let start = 0.15 * speed;
        let path = IntendedPath::function(move |time| {
            let gone = (time - late).max(0.0);
            // Acceleration for 0.1 s, then 0.1 s to the touch.
            let travel = speed * if gone < 0.1 { 5.0 * gone * gone } else { gone - 0.05 };
            let height = (start - travel).max(-0.005);
            let velocity = if height > -0.005 { -speed * (10.0 * gone).min(1.0) } else { 0.0 };
            (
                Pose::from_translation(DVec3::Z * (touch + height)),
                Twist::new(DVec3::Z * velocity, DVec3::ZERO),
            )
        });
        let settings = Settings {
            search: SearchSettings { braking, proxy, ..SearchSettings::default() },
            ..penalties()
        };
        let (_, records) = render(&probe, &plate, path, settings, (0.6, rate));
        let behind = |record: &Record| record.object.translation.z < 0.0;
        if proxy { records.last().is_some_and(behind) } else { records.iter().any(behind) }
    };
    (0..5).filter(|phase| through(0.2 * f64::from(*phase) / rate)).count()
}

#[test]
fn braking_keeps_an_object_on_its_side() {
    for speed in [0.3, 1.0] {
        assert_eq!(hits_through(1e-3, speed, true, false), 0, "{speed} m/s");
    }
    let without = hits_through(1e-3, 1.0, false, false);
    assert!(without > 0, "without braking none goes through, and nothing is shown");
}

#[test]
fn proxy_keeps_an_object_on_its_side() {
    for thickness in [2e-5, 1e-3] {
        for speed in [0.3, 1.0, 3.0, 5.0] {
            for braking in [false, true] {
                let through = hits_through(thickness, speed, braking, true);
                assert_eq!(through, 0, "{thickness} m at {speed} m/s, braking: {braking}");
            }
        }
    }
    assert!(hits_through(1e-3, 3.0, true, false) > 0, "braking alone does as well, and nothing is shown");
}

fn linear(keyframes: &[(f64, DVec3)]) -> MotionPath {
    let keyframes =
        keyframes.iter().map(|&(time, at)| Keyframe { time, pose: Pose::from_translation(at) }).collect();
    MotionPath::new(keyframes, Interpolation::Linear).expect("a path")
}

/// Pressed far beyond a sheet, the object is held on its side with the force of the hand, slides freely, and
/// is free again beyond the edge, where it may go below.
#[test]
fn sheet_is_pressed_stroked_and_left_over_its_edge() {
    let (probe, low) = ellipsoid();
    let thickness = 1e-4;
    let touch = 0.5 * thickness + low;
    let at = |x: f64, height: f64| DVec3::new(x, 0.0, touch + height);
    let beyond = HALF + 0.04;
    let path = linear(&[
        (0.0, at(0.0, 0.005)),
        (0.5, at(0.0, 0.005)),
        (1.0, at(0.0, -0.02)),
        (2.0, at(0.0, -0.02)),
        (3.0, at(0.02, -0.02)),
        (3.5, at(0.02, -0.02)),
        (5.0, at(beyond, -0.02)),
        (5.5, at(beyond, -0.06)),
        (7.0, at(0.0, -0.06)),
        (8.0, at(0.0, -0.06)),
    ]);
    for rate in [1000.0, 200.0] {
        let (session, records) = render(&probe, &plate(thickness), path.clone(), penalties(), (8.0, rate));
        assert!(
            session.contact.events.proxy_engaged > 100,
            "the proxy is never elsewhere, and nothing is shown"
        );
        let at = |time: f64| &records[(time * 1000.0) as usize];
        let pressed = at(1.9);
        assert!(pressed.coupling.force.z > 3.0, "{rate} Hz: {} N", pressed.coupling.force);
        assert!(pressed.object.translation.z > touch - 0.005, "{rate} Hz: {}", pressed.object.translation);
        let sideways = |record: &Record| record.coupling.force.truncate().length();
        let most = records[1500..3400].iter().map(sideways).fold(0.0, f64::max);
        assert!(most < 0.3, "{rate} Hz: {most} N along a sheet without friction");
        let stroked = at(3.4).object.translation;
        assert!((stroked.x - at(3.4).handle.translation.x).abs() < 1e-3, "{rate} Hz: {stroked}");
        // Below the sheet, and free.
        let left = at(7.9);
        assert!(left.object.translation.z < -0.02, "{rate} Hz: {}", left.object.translation);
        assert!(left.coupling.force.length() < 0.05, "{rate} Hz: {} N", left.coupling.force);
    }
}

/// Returns the largest depth (m) of the lower end of a blade below a sheet, when it is pressed 15 mm beyond
/// its touch and rocked.
fn blade_below(proxy: bool, rocking: f64) -> f64 {
    let (length, thickness) = (0.06, 5e-4);
    let blade = block(DVec3::new(length, 0.02, thickness));
    let rate = std::f64::consts::TAU * rocking;
    let path = IntendedPath::function(move |time| {
        let (pressed, rocked) = ((time - 0.3).clamp(0.0, 0.5), (time - 1.0).max(0.0));
        let lowering = if (0.3..0.8).contains(&time) { -0.04 } else { 0.0 };
        let turning = if time > 1.0 { 0.5 * rate * (rate * rocked).cos() } else { 0.0 };
        let rotation = DQuat::from_rotation_y(0.5 * (rate * rocked).sin());
        let pose = Pose::new(DVec3::Z * (0.005 - 0.04 * pressed), rotation);
        (pose, Twist::new(DVec3::Z * lowering, DVec3::Y * turning))
    });
    let settings = Settings { search: SearchSettings { proxy, ..SearchSettings::default() }, ..penalties() };
    let (_, records) = render(&blade, &plate(2e-4), path, settings, (4.0, 200.0));
    let lowest = |record: &Record| {
        let down = |x: f64| -record.object.transform_point(DVec3::X * x).z;
        down(0.5 * length).max(down(-0.5 * length))
    };
    records.iter().map(lowest).fold(f64::NEG_INFINITY, f64::max)
}

#[test]
fn blade_is_not_rocked_through_a_sheet() {
    for rocking in [0.5, 2.0] {
        let below = blade_below(true, rocking);
        assert!(below < 5e-3, "rocked at {rocking} Hz: an end comes {below} m below the sheet");
    }
    let without = blade_below(false, 0.5);
    assert!(without > 0.01, "without a proxy an end comes {without} m below, and nothing is shown");
}

/// A body state that is not finite, and a sheet that moves over the object, do not stop the proxy
/// permanently.
#[test]
fn proxy_recovers_from_invalid_states_and_a_moving_scene() {
    let (probe, low) = ellipsoid();
    let device = Emulation::default().open(IntendedPath::Still(Pose::IDENTITY)).expect("an emulation");
    let scene = Scene::new().with(plate(2e-4), Pose::IDENTITY);
    let settings =
        Settings { contact: ContactSettings { stiffness: 2000.0, ..penalties().contact }, ..penalties() };
    let renderer = HapticRenderer::new(probe, scene, Box::new(device), settings).expect("a session");
    let (_, mut contact, _) = renderer.into_loops();
    let mut time = 0.0;
    let mut step = |contact: &mut palpate::ContactLoop, height: f64| {
        time += 5e-3;
        let state = BodyState::at_rest(Pose::from_translation(DVec3::Z * (low + height)));
        contact.step(&state, time)
    };
    let pushed_up = |update: &palpate::ContactUpdate, height: f64| {
        let state = BodyState::at_rest(Pose::from_translation(DVec3::Z * (low + height)));
        update.model.wrench(&state).force.z
    };
    step(&mut contact, 1e-3);
    let deep = step(&mut contact, -5e-3);
    assert!(pushed_up(&deep, -5e-3) > 9.0 && deep.depth > 4e-3, "held by {} N", pushed_up(&deep, -5e-3));

    for _ in 0..3 {
        let update = step(&mut contact, f64::NAN);
        assert!(update.model.is_empty() && update.depth == 0.0);
    }
    let again = step(&mut contact, -5e-3);
    assert!(pushed_up(&again, -5e-3) > 9.0, "held again by {} N", pushed_up(&again, -5e-3));

    // The sheet jumps above the object, which then has nothing to be held back from.
    assert!(contact.set_pose(SceneId(0), &Pose::from_translation(DVec3::Z * 0.1)));
    let free = step(&mut contact, -5e-3);
    assert!(free.model.is_empty(), "{} m deep", free.depth);
    // The object is above where the sheet comes back to, and is held there.
    step(&mut contact, 5e-3);
    assert!(contact.set_pose(SceneId(0), &Pose::IDENTITY));
    let deep = step(&mut contact, -5e-3);
    assert!(pushed_up(&deep, -5e-3) > 9.0, "held after all by {} N", pushed_up(&deep, -5e-3));
}
