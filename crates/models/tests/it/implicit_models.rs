//! The models that are meshed from implicit surfaces: topology, number of triangles, size and shape of the
//! triangles, and the fit of the two jaws and of the two halves of the ball joint.

use std::sync::OnceLock;

use palpate_core::{
    Pose, TriMesh,
    glam::{DQuat, DVec3},
};
use palpate_mesh_io::{intersecting_pairs, self_intersections};
use palpate_models::Model;

const IMPLICIT: [Model; 6] = [
    Model::LowerJaw,
    Model::UpperJaw,
    Model::BallJointBall,
    Model::BallJointSocket,
    Model::GolfClub,
    Model::GolfBall,
];

fn fewest(model: Model) -> usize {
    (1..).find(|count| model.generate(*count).is_ok()).unwrap()
}

/// The model, fine enough to show its shape, generated once for all tests.
fn fine_mesh(model: Model) -> &'static TriMesh {
    static MESHES: [OnceLock<TriMesh>; IMPLICIT.len()] = [const { OnceLock::new() }; IMPLICIT.len()];
    let index = IMPLICIT.iter().position(|m| *m == model).unwrap();
    MESHES[index].get_or_init(|| model.generate(model.default_triangles().min(50_000)).unwrap())
}

/// The longest edge over the shortest height of each triangle: 1.15 for an equilateral one.
fn aspects(mesh: &TriMesh) -> Vec<f64> {
    let aspect = |triangle: usize| {
        let [a, b, c] = mesh.corners(triangle);
        let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
        longest * longest / (b - a).cross(c - a).length()
    };
    (0..mesh.triangles().len()).map(aspect).collect()
}

/// Checks the properties of a model that hold at any resolution.
fn check(model: Model, count: usize, mesh: &TriMesh) {
    let name = format!("{}@{count}", model.name());
    let report = mesh.validate();
    assert!(report.closed && report.manifold && report.oriented, "{name}: {report:?}");
    assert_eq!(
        (report.degenerate, report.duplicate, report.nonfinite, report.unreferenced, report.components),
        (0, 0, 0, 0, 1),
        "{name}: {report:?}"
    );
    assert!(report.volume > 0.0, "{name} is inside out: {} m³", report.volume);
    let triangles = mesh.triangles().len();
    assert_eq!(report.vertices as i64 - triangles as i64 / 2, 2, "{name}: has no handles");
    assert!(triangles.abs_diff(count) <= 1, "{name} has {triangles} triangles");
    let aspects = aspects(mesh);
    let poor = aspects.iter().filter(|aspect| **aspect > 4.0).count();
    assert!(poor * 200 <= triangles, "{name}: {poor} of {triangles} triangles are poor");
    let worst = aspects.into_iter().fold(0.0, f64::max);
    assert!(worst < 8.0, "{name}: worst aspect {worst}");
    let crossing = self_intersections(mesh);
    assert_eq!(crossing.count, 0, "{name}: first {:?}", crossing.first);
}

#[test]
#[ignore = "for a release build: cargo test --release -p palpate-models --test it -- --ignored"]
fn models_of_full_size_are_sound() {
    for model in IMPLICIT {
        let count = model.default_triangles();
        check(model, count, &model.generate(count).unwrap());
    }
}

#[test]
fn sound_when_coarse() {
    for model in IMPLICIT {
        let count = fewest(model);
        check(model, count, &model.generate(count).unwrap());
    }
}

#[test]
fn sizes() {
    for (model, radius) in [
        (Model::LowerJaw, 0.060),
        (Model::UpperJaw, 0.060),
        (Model::BallJointBall, 0.0612),
        (Model::BallJointSocket, 0.060),
        (Model::GolfBall, 0.021_335),
    ] {
        let found = smallest_sphere(fine_mesh(model));
        assert!((found / radius - 1.0).abs() < 0.03, "{}: radius {found} m, not {radius}", model.name());
    }
}

/// Radius of the smallest bounding sphere to a fraction of a per cent, by Bădoiu and Clarkson's iteration.
fn smallest_sphere(mesh: &TriMesh) -> f64 {
    let mut center = mesh.bounding_sphere().center;
    let mut radius = f64::INFINITY;
    for step in 1..300 {
        let far = mesh.vertices().iter().copied();
        let far =
            far.max_by(|a, b| a.distance_squared(center).total_cmp(&b.distance_squared(center))).unwrap();
        radius = f64::min(radius, far.distance(center));
        center += (far - center) / (f64::from(step) + 10.0);
    }
    radius
}

fn shifted(x: f64, y: f64, z: f64) -> Pose {
    Pose { translation: DVec3::new(x, y, z), rotation: DQuat::IDENTITY }
}

#[test]
fn the_jaws_close_without_touching_and_lock() {
    let (upper, lower) = (fine_mesh(Model::UpperJaw), fine_mesh(Model::LowerJaw));
    let hits = |pose: &Pose| !intersecting_pairs(upper, pose, lower, &Pose::IDENTITY, 1).is_empty();
    assert!(!hits(&Pose::IDENTITY), "the jaws are closed at equal poses");
    // Closed, they leave less than a millimetre: no further.
    assert!(hits(&shifted(0.0, 0.0, -0.001)));
    // Nor do they slide in any direction.
    for degrees in (0..360).step_by(30) {
        let (sin, cos) = f64::from(degrees).to_radians().sin_cos();
        assert!(hits(&shifted(0.0015 * cos, 0.0015 * sin, 0.0)), "they slide towards {degrees}°");
    }
    // Opened by 6 mm they are free.
    assert!(!hits(&shifted(0.0, 0.0, 0.006)) && !hits(&shifted(0.003, 0.0, 0.006)));
}

#[test]
fn cusps_reach_into_fissures_all_along_the_arch() {
    let (upper, lower) = (fine_mesh(Model::UpperJaw), fine_mesh(Model::LowerJaw));
    // In slices from the last molars to the incisors, the lower teeth rise above the upper ones' lowest
    // points.
    for slice in -2..4 {
        let within = |v: &&DVec3| (0.0..0.010).contains(&(v.y - 0.010 * f64::from(slice)));
        let rise = lower.vertices().iter().filter(within).map(|v| v.z).fold(f64::NEG_INFINITY, f64::max);
        let fall = upper.vertices().iter().filter(within).map(|v| v.z).fold(f64::INFINITY, f64::min);
        assert!(rise - fall > 0.002, "slice {slice}: {} m", rise - fall);
    }
    let gap = lower
        .vertices()
        .iter()
        .filter(|v| v.z > -0.006)
        .map(|v| {
            let near = upper.vertices().iter().filter(|w| w.z < 0.006);
            near.map(|w| w.distance_squared(*v)).fold(f64::INFINITY, f64::min)
        })
        .fold(f64::INFINITY, f64::min)
        .sqrt();
    assert!((5e-5..1e-3).contains(&gap), "gap {gap} m");
}

#[test]
fn the_ball_joint_holds_the_ball() {
    let (ball, socket) = (fine_mesh(Model::BallJointBall), fine_mesh(Model::BallJointSocket));
    let hits = |pose: &Pose| !intersecting_pairs(ball, pose, socket, &Pose::IDENTITY, 1).is_empty();
    assert!(!hits(&Pose::IDENTITY), "assembled at equal poses");
    // A whole lobe's turn fits again, half a lobe's does not.
    let turned = |degrees: f64| Pose {
        translation: DVec3::ZERO,
        rotation: DQuat::from_rotation_z(degrees.to_radians()),
    };
    assert!(!hits(&turned(45.0)) && hits(&turned(22.5)) && !hits(&turned(2.0)));
    for step in [DVec3::X, DVec3::Y, DVec3::Z, -DVec3::X, -DVec3::Y, -DVec3::Z] {
        let moved = 0.003 * step;
        assert!(hits(&shifted(moved.x, moved.y, moved.z)), "the ball is held towards {step}");
    }
}

#[test]
fn the_golf_ball_is_dimpled() {
    let mesh = fine_mesh(Model::GolfBall);
    let radii = || mesh.vertices().iter().map(|v| v.length());
    let (least, most) = (radii().fold(f64::INFINITY, f64::min), radii().fold(0.0, f64::max));
    assert!((most - 0.021_335).abs() < 5e-6, "radius {most} m");
    assert!((most - least - 0.000_25).abs() < 3e-5, "depth {} m", most - least);
}

#[test]
fn the_club_fits_the_ball() {
    let (club, ball) = (fine_mesh(Model::GolfClub), fine_mesh(Model::GolfBall));
    // The ball just before and just after it meets the middle of the face, along the face's normal.
    let loft = 33_f64.to_radians();
    let at = |gap: f64| {
        let along = DVec3::new(loft.cos(), 0.0, loft.sin());
        Pose { translation: (0.021_335 + gap) * along, rotation: DQuat::IDENTITY }
    };
    let hits = |gap: f64| !intersecting_pairs(ball, &at(gap), club, &Pose::IDENTITY, 1).is_empty();
    assert!(!hits(1e-4) && hits(-8e-4));
    // A right-hander's: the shaft rises on the side of +y, towards the player.
    let top = club.vertices().iter().copied().max_by(|a, b| a.z.total_cmp(&b.z)).unwrap();
    assert!(top.y > 0.1 && top.z > 0.13, "{top}");
}
