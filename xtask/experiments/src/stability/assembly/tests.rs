//! The instruments against what is known without them.

use std::f64::consts::TAU;

use palpate::glam::{DQuat, DVec3};
use palpate::models::{MetricThread, PegFit};
use palpate::{Pose, Record, TriMesh, Wrench};

use super::exact::Exact;
use super::locking::{locking_friction, push};
use super::nut::Track;
use super::{Part, bolt_and_nut, responses};

/// Friction that holds a nut which presses evenly on the upper flanks of a bolt's mesh where those of the
/// nut overlap them, from the triangles' own normals: drive and friction of each triangle summed up.
fn locking_friction_of(bolt: &TriMesh, thread: &MetricThread) -> f64 {
    let overlap =
        (0.5 * thread.minor_diameter() + thread.nut_allowance, 0.5 * thread.diameter - thread.bolt_allowance);
    let (mut drive, mut hold) = (0.0, 0.0);
    for triangle in 0..bolt.triangles().len() {
        let [a, b, c] = bolt.corners(triangle);
        let (middle, area) = ((a + b + c) / 3.0, 0.5 * (b - a).cross(c - a));
        let (normal, radius) = (area.normalize(), middle.truncate().length());
        let on_thread = (0.3..0.8).contains(&(middle.z / thread.bolt_length()));
        let flank = normal.z > 0.7 && normal.z < 0.99 && (overlap.0..overlap.1).contains(&radius);
        if !(on_thread && flank) {
            continue;
        }
        // Around the axis: of the pressure, and of the friction along the helix.
        drive += middle.cross(area).z;
        let around = DVec3::new(-middle.y, middle.x, 0.0) / radius;
        let along_helix = (around - normal * normal.dot(around)).normalize();
        hold += middle.cross(along_helix).z * area.length();
    }
    (drive / hold).abs()
}

#[test]
fn the_friction_of_self_locking_is_that_of_the_flanks() {
    for (diameter, pitch) in [(0.016, 0.002), (0.008, 0.00125), (0.03, 0.002)] {
        let thread = MetricThread { diameter, pitch, ..MetricThread::M16 }.with_clearance(0.05 * pitch);
        // Flanks that are divided finely, so that the overlap is not cut off coarsely.
        let bolt = thread.bolt(200_000).unwrap();
        let (theory, summed) = (locking_friction(&thread), locking_friction_of(&bolt, &thread));
        assert!((summed / theory - 1.0).abs() < 0.02, "{summed} of the mesh, {theory} in theory");
        // Without the flank angle, theory would be off by 15 %.
        assert!((summed * 30.0_f64.to_radians().cos() / theory - 1.0).abs() > 0.1);
    }
}

/// With friction below that of theory a thread lets the nut turn, above it holds it.
#[test]
fn a_nut_that_is_pushed_turns_until_friction_holds_it() {
    let thread = MetricThread::M16;
    let [bolt, nut] = bolt_and_nut(&thread).unwrap();
    let constraints = responses().pop().unwrap();
    let theory = locking_friction(&thread);
    let turn = |share: f64| push(&constraints, (&thread, &nut, &bolt), share * theory, 0.6).unwrap();
    let (turning, held) = rayon::join(|| turn(0.7), || turn(1.3));
    assert!(turning > 0.1 && held < 1e-3, "{turning} and {held} rad");
}

#[test]
fn penetration_is_as_deep_as_the_nut_was_pushed() {
    let thread = MetricThread::M16;
    let [bolt, nut] = bolt_and_nut(&thread).unwrap();
    let mut exact = Exact::new(&nut, &bolt);
    let play = thread.clearance() * 30.0_f64.to_radians().tan();
    let at = |offset: f64| Pose::from_translation(DVec3::Z * (0.016 + offset));
    assert_eq!(exact.depth(&at(0.0)).unwrap(), 0.0);
    assert_eq!(exact.depth(&at(0.9 * play)).unwrap(), 0.0);
    for push in [2e-5, 6e-5, 1.2e-4] {
        // Along the flank's normal, less what polygons add to the clearance.
        let expected = push * 30.0_f64.to_radians().cos();
        for sign in [1.0, -1.0] {
            let found = exact.depth(&at(sign * (play + push))).unwrap();
            assert!((expected - 8e-6..expected + 1e-6).contains(&found), "{found} m, not {expected} m");
        }
    }
    let poses: Vec<Pose> = (0..40).map(|i| at(if i == 19 { play + 1e-4 } else { play + 2e-5 })).collect();
    let deepest = exact.deepest(&poses).unwrap();
    assert!(deepest > 7e-5, "{deepest} m: a single deep pose between judged ones is found");
}

#[test]
fn penetration_of_a_peg_is_how_far_it_was_moved() {
    let fit = PegFit::LOOSE_8_MM;
    let peg = Part::new("peg", fit.peg(1000).unwrap()).unwrap();
    let hole = Part::new("hole", fit.hole(1200).unwrap()).unwrap();
    let mut exact = Exact::new(&peg, &hole);
    let at = |offset: f64| Pose::from_translation(DVec3::new(offset, 0.0, -0.012));
    assert_eq!(exact.depth(&at(0.9 * fit.clearance)).unwrap(), 0.0);
    let found = exact.depth(&at(fit.clearance + 1e-4)).unwrap();
    // The sagittas of both polygons add 12 µm to the clearance where a corner meets a corner.
    assert!((8.6e-5..1.001e-4).contains(&found), "{found} m, not 0.1 mm");
    // Aslant by 2°, it meets both sides.
    let aslant = Pose { rotation: DQuat::from_rotation_y(2.0_f64.to_radians()), ..at(0.0) };
    assert!(exact.depth(&aslant).unwrap() > 1e-4);
}

/// No triangles of a pin meet those of the peg that it is wholly inside of.
#[test]
fn what_is_wholly_inside_is_as_deep_as_it_is() {
    let mesh = PegFit::LOOSE_8_MM.peg(1000).unwrap();
    let small = mesh.vertices().iter().map(|vertex| *vertex * 0.2).collect();
    let pin = Part::new("pin", TriMesh::new(small, mesh.triangles().to_vec()).unwrap()).unwrap();
    let peg = Part::new("peg", mesh).unwrap();
    let [low, high] =
        [f64::min, f64::max].map(|of| peg.mesh.vertices().iter().map(|v| v.z).reduce(of).unwrap());
    let mut exact = Exact::new(&pin, &peg);
    let at = |z: f64| exact.depth(&Pose::from_translation(DVec3::Z * z)).unwrap();
    let [inside, beside] = [0.4 * (low + high), high + 0.3 * (high - low)].map(at);
    // The pin's axis is 4 mm below the peg's surface.
    assert!((3e-3..5e-3).contains(&inside) && beside == 0.0, "{inside} and {beside} m");
}

#[test]
fn travel_in_a_turn_is_that_of_the_helix() {
    let record = |index: usize| {
        let turns = -0.004 * index as f64;
        let wobble = 1e-5 * (0.3 * index as f64).sin();
        let object = Pose::new(
            DVec3::new(0.0, 0.0, 0.04 + 0.002 * turns + wobble),
            DQuat::from_rotation_z(TAU * turns),
        );
        Record {
            time: 1e-3 * index as f64,
            device: object,
            handle: object,
            object,
            coupling: Wrench::ZERO,
            contact: Wrench::ZERO,
            depth: 0.0,
            contacts: 0,
            model_age: 0.0,
        }
    };
    let records: Vec<Record> = (0..1000).map(record).collect();
    let track = Track::of(&records);
    assert!((track.angle_at(0.999) + TAU * 0.004 * 999.0).abs() < 1e-9, "{}", track.angle_at(0.999));
    let travel = track.travel(0.1, 0.9);
    assert!((travel / 0.002 - 1.0).abs() < 2e-3, "{travel} m");
}
