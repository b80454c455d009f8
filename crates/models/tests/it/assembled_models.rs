//! Models that are assembled: the thread of bolt and nut against the standard's figures, and the clearances
//! of nut and bolt and of peg and hole, by exact intersection.

use std::f64::consts::TAU;
use std::io::Write as _;

use palpate_core::{
    Pose, TriMesh,
    glam::{DQuat, DVec3},
};
use palpate_mesh_io::{intersecting_pairs, self_intersections};
use palpate_models::{MetricThread, Model, ModelError, PegFit};

/// Pitch of M16, m.
const PITCH: f64 = 0.002;
/// Height of the nut's centre at which it is on the middle of the thread, in phase with it, m.
const ENGAGED: f64 = 0.016;

fn meet(a: &TriMesh, pose: &Pose, b: &TriMesh) -> bool {
    !intersecting_pairs(a, pose, b, &Pose::IDENTITY, 1).is_empty()
}

fn turned(height: f64, turns: f64) -> Pose {
    Pose::new(DVec3::Z * height, DQuat::from_rotation_z(TAU * turns))
}

/// Largest distance of `moved` along a direction at which the meshes do not meet, by bisection, m.
fn play(moved: &TriMesh, fixed: &TriMesh, place: impl Fn(f64) -> Pose) -> f64 {
    assert!(!meet(moved, &place(0.0), fixed), "they meet where they should not");
    let (mut free, mut hit) = (0.0, 1e-3);
    assert!(meet(moved, &place(hit), fixed), "they do not meet within a millimetre");
    for _ in 0..14 {
        let middle = 0.5 * (free + hit);
        if meet(moved, &place(middle), fixed) { hit = middle } else { free = middle }
    }
    free
}

/// Least and greatest distance from the axis of the surface that a radius at an angle (rad) meets within a
/// range of heights; crossings with the meshes' triangles, independent of how these were made.
fn radii_along(mesh: &TriMesh, angle: f64, heights: impl Iterator<Item = f64>, nearest: bool) -> Vec<f64> {
    let out = DVec3::new(angle.cos(), angle.sin(), 0.0);
    heights
        .map(|height| {
            let from = DVec3::Z * height;
            let crossings = (0..mesh.triangles().len()).filter_map(|t| crossing(mesh.corners(t), from, out));
            if nearest { crossings.fold(f64::INFINITY, f64::min) } else { crossings.fold(0.0, f64::max) }
        })
        .collect()
}

/// Where a ray crosses a triangle (Möller and Trumbore 1997).
fn crossing([a, b, c]: [DVec3; 3], from: DVec3, along: DVec3) -> Option<f64> {
    let (u, v) = (b - a, c - a);
    let p = along.cross(v);
    let scale = u.dot(p);
    let t = from - a;
    let q = t.cross(u);
    let (x, y, distance) = (t.dot(p) / scale, along.dot(q) / scale, v.dot(q) / scale);
    (scale.abs() > 1e-18 && x >= 0.0 && y >= 0.0 && x + y <= 1.0 && distance > 0.0).then_some(distance)
}

fn default_mesh(model: Model) -> TriMesh {
    model.generate(model.default_triangles()).unwrap()
}

/// Diameters of M16 × 2 in ISO 724, m.
#[test]
fn the_basic_profile_has_the_standards_diameters() {
    let thread = MetricThread::M16;
    for (found, standard) in [
        (thread.pitch_diameter(), 14.701e-3),
        (thread.minor_diameter(), 13.835e-3),
        (thread.root_diameter(), 13.546e-3),
    ] {
        assert!((found - standard).abs() < 0.6e-6, "{found} m, not {standard} m");
    }
    // ISO 965-2: limits of the pitch diameters of the classes 6g and 6H.
    let bolt = thread.pitch_diameter() - 2.0 * thread.bolt_allowance;
    let nut = thread.pitch_diameter() + 2.0 * thread.nut_allowance;
    assert!((14.503e-3..14.663e-3).contains(&bolt) && (14.701e-3..14.913e-3).contains(&nut), "{bolt} {nut}");
}

/// Measured on the meshes: major, minor and pitch diameter, the pitch and its hand.
#[test]
fn the_meshes_have_the_threads_diameters_and_pitch() {
    let thread = MetricThread::M16;
    let [bolt, nut] = [Model::Bolt, Model::Nut].map(default_mesh);
    let most = |radii: &[f64]| radii.iter().fold(0.0, |most: f64, radius| most.max(*radius));
    let least = |radii: &[f64]| radii.iter().fold(f64::INFINITY, |least: f64, radius| least.min(*radius));
    let steps = |from: f64| (0..400).map(move |step| from + PITCH * f64::from(step) / 400.0);
    // Polygons of some hundred corners are off by 5 µm, rows of heights by half a step.
    let close = |found: f64, wanted: f64| assert!((found - wanted).abs() < 8e-6, "{found} m, not {wanted} m");
    for angle in [0.3, 2.0, 4.4] {
        let outside = radii_along(&bolt, angle, steps(0.015), false);
        close(most(&outside), 0.5 * thread.diameter - thread.bolt_allowance);
        close(least(&outside), 0.5 * thread.root_diameter() - thread.bolt_allowance);
        // As much ridge as groove at the pitch diameter.
        let pitch_radius = 0.5 * thread.pitch_diameter() - thread.bolt_allowance;
        let ridge = outside.iter().filter(|radius| **radius > pitch_radius).count();
        assert!(ridge.abs_diff(200) <= 3, "{ridge} of 400 at the pitch diameter are ridge");

        let inside = radii_along(&nut, angle, steps(-0.001), true);
        close(most(&inside), 0.5 * thread.diameter + thread.nut_allowance);
        close(least(&inside), 0.5 * thread.minor_diameter() + thread.nut_allowance);

        // A quarter turn on, the same profile is a quarter of the pitch further up; a left-handed one is not.
        let further = |rise: f64| {
            let there = radii_along(&bolt, angle + 0.25 * TAU, steps(0.015 + rise), false);
            outside.iter().zip(there).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
        };
        assert!(further(0.25 * PITCH) < 1.2e-5, "{}", further(0.25 * PITCH));
        assert!(further(-0.25 * PITCH) > 1e-4);
    }
}

#[test]
fn a_nut_runs_along_the_bolt_with_the_stated_clearance() {
    let thread = MetricThread::M16;
    let [bolt, nut] = [Model::Bolt, Model::Nut].map(default_mesh);
    // From before the first thread to half way down, in phase.
    for step in 0..40 {
        let turns = 0.37 * f64::from(step);
        let pose = turned(0.046 - PITCH * turns, -turns);
        assert!(!meet(&nut, &pose, &bolt), "the nut meets the bolt after {turns} turns");
    }
    // Half a turn out of phase, they meet.
    assert!(meet(&nut, &turned(ENGAGED + 0.5 * PITCH, 0.0), &bolt));
    let clearance = thread.clearance();
    let tan_30 = (30.0_f64).to_radians().tan();
    // Polygons only add to the clearance, and by no more than their sagittas, 9 µm.
    for (what, axis, stated) in [
        ("up", DVec3::Z, clearance * tan_30),
        ("down", -DVec3::Z, clearance * tan_30),
        ("to the side", DVec3::X, clearance),
        ("to the other side", DVec3::new(-0.6, 0.8, 0.0), clearance),
    ] {
        let moved = |by: f64| {
            let engaged = turned(ENGAGED, 0.0);
            Pose::new(engaged.translation + axis * by, engaged.rotation)
        };
        let found = play(&nut, &bolt, moved);
        assert!((stated - 1e-7..stated + 1.0e-5).contains(&found), "{what}: {found} m, stated {stated} m");
    }
}

#[test]
fn the_clearance_is_as_asked_for() {
    for radial in [0.02e-3, 0.15e-3] {
        let thread = MetricThread::M16.with_clearance(radial);
        let (bolt, nut) = (thread.bolt(24_000).unwrap(), thread.nut(14_000).unwrap());
        let stated = radial * (30.0_f64).to_radians().tan();
        let found = play(&nut, &bolt, |by| turned(ENGAGED + by, 0.0));
        assert!((stated - 1e-7..stated + 6e-6).contains(&found), "{found} m, stated {stated} m");
    }
}

#[test]
fn other_threads_are_sound() {
    for (diameter, pitch) in [(0.006, 0.001), (0.008, 0.00125), (0.024, 0.003), (0.016, 0.0015)] {
        let thread = MetricThread { diameter, pitch, ..MetricThread::M16 }.with_clearance(0.05 * pitch);
        let (bolt, nut) = (thread.bolt(30_000).unwrap(), thread.nut(20_000).unwrap());
        for mesh in [&bolt, &nut] {
            let report = mesh.validate();
            assert!(report.closed && report.manifold && report.oriented && report.degenerate == 0);
            assert_eq!(self_intersections(mesh).count, 0, "M{} × {}", 1e3 * diameter, 1e3 * pitch);
        }
        assert!(!meet(&nut, &turned(8.0 * pitch, 0.0), &bolt));
    }
    let unknown = MetricThread { pitch: f64::NAN, ..MetricThread::M16 };
    assert!(matches!(unknown.nut(20_000), Err(ModelError::Dimensions { .. })));
    assert!(matches!(MetricThread::M16.bolt(12), Err(ModelError::OutOfRange { .. })));
}

/// The optional test data has a bolt and a nut M16 that others made: the same pitch and, within their looser
/// fit, the same diameters.
#[test]
fn like_the_bolt_and_nut_of_the_test_data() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/models/good/");
    let load = |name: &str| {
        let path = std::path::PathBuf::from(folder).join(name);
        let options = palpate_mesh_io::LoadOptions::default();
        path.exists().then(|| palpate_mesh_io::load(&path, &options).expect("a mesh").mesh)
    };
    let (Some(bolt), Some(nut)) = (load("bolt_m16.obj"), load("nut_m16.obj")) else {
        let _ = writeln!(std::io::stderr(), "skipped: {folder} is absent");
        return;
    };
    let thread = MetricThread::M16;
    let radii = |mesh: &TriMesh, from: f64, nearest: bool| {
        radii_along(mesh, 1.0, (0..200).map(|step| from + PITCH * f64::from(step) / 200.0), nearest)
    };
    let (outside, above) = (radii(&bolt, 0.018, false), radii(&bolt, 0.018 + PITCH, false));
    let apart = outside.iter().zip(&above).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(apart < 2e-5, "the profile repeats after 2 mm: {apart} m");
    let most = outside.iter().fold(0.0, |most: f64, radius| most.max(*radius));
    assert!((most - 0.5 * thread.diameter).abs() < 0.3e-3, "major radius {most} m");
    let middle = nut.vertices().iter().map(|vertex| vertex.z).sum::<f64>() / nut.vertices().len() as f64;
    let least = radii(&nut, middle, true).iter().fold(f64::INFINITY, |least: f64, radius| least.min(*radius));
    assert!((least - 0.5 * thread.minor_diameter()).abs() < 0.3e-3, "minor radius {least} m");
}

#[test]
fn the_peg_fits_the_hole_with_the_stated_clearance() {
    for clearance in [0.02e-3, 0.05e-3, 0.5e-3] {
        let fit = PegFit { clearance, ..PegFit::LOOSE_8_MM };
        let (peg, hole) = (fit.peg(2000).unwrap(), fit.hole(2400).unwrap());
        let deep = |by: DVec3| Pose::from_translation(DVec3::new(0.0, 0.0, -0.015) + by);
        for axis in [DVec3::X, DVec3::new(-0.6, 0.8, 0.0)] {
            let found = play(&peg, &hole, |by| deep(axis * by));
            assert!((clearance - 1e-7..clearance + 1e-5).contains(&found), "{found} m, stated {clearance} m");
        }
        // Above the mouth it meets nothing, and beside the hole it meets the block.
        assert!(!meet(&peg, &Pose::from_translation(DVec3::Z * 1e-4), &hole));
        assert!(meet(&peg, &deep(DVec3::X * 2e-3), &hole));
    }
    let thick = PegFit { chamfer: 0.1, ..PegFit::LOOSE_8_MM };
    assert!(matches!(thick.peg(2000), Err(ModelError::Dimensions { .. })));
}
