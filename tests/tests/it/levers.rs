//! Objects whose mesh origin is away from their centre of mass: the device's handle is at the origin and the
//! grasp at the centre of mass, so every force at the grasp turns the handle by the lever.

use std::convert::Infallible;
use std::sync::atomic::AtomicBool;

use palpate::device::{Emulation, Hand, IntendedPath};
use palpate::glam::{DQuat, DVec3};
use palpate::settings::{HandlePlace, ToolSettings};
use palpate::{ContactTiming, HapticRenderer, Object, Pose, Record, Scene, Settings, TriMesh, Twist};

const SECONDS: f64 = 4.0;
/// Start of the disturbance, s, and start of the judged time, a second after its end.
const DISTURBANCE_START: f64 = 1.0;
const JUDGED_FROM: f64 = 2.5;
/// Half the turn of the disturbance, rad.
const TURN: f64 = 0.03;

/// Returns a cube with an edge (m) about a point of its mesh's frame.
fn cube(edge: f64, center: DVec3) -> Object {
    let corner = |index: usize| {
        let side = |bit: usize| if index >> bit & 1 == 1 { 0.5 * edge } else { -0.5 * edge };
        center + DVec3::new(side(0), side(1), side(2))
    };
    let quads: [[u32; 4]; 6] =
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    let mesh = TriMesh::new((0..8).map(corner).collect(), triangles).expect("indices");
    Object::from_mesh("cube", &mesh).expect("a hierarchy")
}

/// Returns the intended motion of a hand that turns by a third of a degree and back within a quarter of a
/// second.
fn nudged(time: f64) -> (Pose, Twist) {
    let phase = (time - DISTURBANCE_START) / 0.25 * std::f64::consts::TAU;
    let inside = (0.0..std::f64::consts::TAU).contains(&phase);
    let (turn, rate) = if inside {
        let rate = TURN * phase.sin() * std::f64::consts::TAU / 0.25;
        (TURN * (1.0 - phase.cos()), rate)
    } else {
        (0.0, 0.0)
    };
    (Pose::new(DVec3::ZERO, DQuat::from_rotation_y(turn)), Twist::new(DVec3::ZERO, DVec3::Y * rate))
}

/// Runs a session with a light hand on a Premium.
fn hold(probe: Object, scene: Scene, settings: Settings) -> Vec<Record> {
    let device = Emulation { hand: Hand::LIGHT, ..Emulation::default() };
    let device = device.open(IntendedPath::function(nudged)).expect("an emulation");
    let renderer = HapticRenderer::new(probe, scene, Box::new(device), settings).expect("renderer");
    let mut records = Vec::new();
    renderer
        .run_lockstep(SECONDS, ContactTiming::busy(500.0), &AtomicBool::new(false), |row| {
            records.push(*row);
            Ok::<_, Infallible>(())
        })
        .expect("the sink never fails");
    records
}

/// Returns the largest force (N) and torque (N·m) at the hand after the disturbance.
fn left_over(records: &[Record]) -> (f64, f64) {
    let late = records.iter().filter(|row| row.time > JUDGED_FROM);
    late.fold((0.0, 0.0), |(force, torque), row| {
        (force.max(row.coupling.force.length()), torque.max(row.coupling.torque.length()))
    })
}

#[test]
fn an_object_held_by_a_long_lever_does_not_swing_by_itself() {
    for lever in [0.0, 0.05, 0.1, 0.2] {
        for mass in [0.01, 0.1, 1.0, 3.0] {
            let settings = Settings {
                tool: ToolSettings { mass, handle: HandlePlace::MeshOrigin, ..ToolSettings::default() },
                ..Settings::default()
            };
            let records = hold(cube(0.04, DVec3::X * lever), Scene::new(), settings);
            let (force, torque) = left_over(&records);
            assert!(
                force < 0.05 && torque < 0.005,
                "{lever} m, {mass} kg: {force} N and {torque} N·m without contact"
            );
        }
    }
}

/// A cube of 40 mm whose millimetres were taken for metres. A tolerance of 1 % of its size would push from
/// 0.35 m away.
#[test]
fn a_probe_in_wrong_units_that_is_accepted_does_not_push_without_contact() {
    let probe = cube(40.0, DVec3::X * 44.0);
    let below = cube(40.0, DVec3::new(44.0, 0.0, -40.3));
    let scene = Scene::new().with(below, Pose::IDENTITY);
    for handle in [HandlePlace::Grasp, HandlePlace::MeshOrigin] {
        let settings = Settings {
            tool: ToolSettings { handle, unusual_size: true, ..ToolSettings::default() },
            ..Settings::default()
        };
        let records = hold(probe.clone(), scene.clone(), settings);
        let largest = records.iter().map(|row| row.coupling.force.length()).fold(0.0, f64::max);
        assert!(largest < 0.2, "{handle:?}: {largest} N without contact");
        // About the grasp, the mesh's origin moves by 44 m for each radian that the hand turns.
        let grasp = DVec3::X * 44.0;
        let strayed =
            records.iter().map(|row| row.object.transform_point(grasp).distance(grasp)).fold(0.0, f64::max);
        assert!(strayed < 3.0, "{handle:?}: it was pushed {strayed} m away");
    }
}
