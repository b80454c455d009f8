//! Guarded points against distances of lines, planes and all vertices.

use std::f64::consts::SQRT_2;

use palpate_core::TriMesh;
use palpate_core::glam::DQuat;
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

use super::*;

fn random(rng: &mut StdRng) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)))
}

/// A roof of 0.1 m along x with its ridge on the x axis, at 45°.
fn roof() -> FeatureMesh {
    let end = |x: f64| [DVec3::new(x, 0.0, 0.0), DVec3::new(x, -0.02, -0.02), DVec3::new(x, 0.02, -0.02)];
    let triangles =
        vec![[0, 1, 2], [3, 5, 4], [0, 2, 5], [0, 5, 3], [0, 3, 4], [0, 4, 1], [1, 4, 5], [1, 5, 2]];
    let triangles = triangles.into_iter().map(|[a, b, c]: [u32; 3]| [a, c, b]).collect();
    FeatureMesh::new(&TriMesh::new([end(-0.05), end(0.05)].concat(), triangles).expect("a roof"))
}

/// A box with these edges, m.
fn block(edges: DVec3) -> FeatureMesh {
    let corner = |i: u32| DVec3::new(f64::from(i & 1), f64::from((i >> 1) & 1), f64::from(i >> 2)) - 0.5;
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    let mesh = TriMesh::new((0..8).map(|i| corner(i) * edges).collect(), triangles).expect("a mesh");
    FeatureMesh::new(&mesh)
}

/// A point that starts near `home` (m, in its own frame).
fn new((home, length): (DVec3, f64), is_probe: bool, frames: &Frames<'_>) -> GuardedPoint {
    GuardedPoint::new((frames.own(is_probe).place_near(home), length), 0, is_probe, 0, frames)
}

fn measure(
    point: &mut GuardedPoint,
    probe: (&FeatureMesh, &Pose),
    object: (&FeatureMesh, &Pose),
) -> Measured {
    // As many steps as pass between two queries.
    let mut measured = point.measure(&Frames::new(probe, object));
    for _ in 0..20 {
        measured = point.measure(&Frames::new(probe, object));
    }
    measured
}

/// Two ridges that cross: the point is on one edge where it is nearest to the other.
#[test]
fn crossed_edges_are_nearest_where_they_cross() {
    let roof = roof();
    let mut rng = StdRng::seed_from_u64(0x60A1);
    for round in 0..800 {
        let gap = [1e-3, 1e-4, 1e-5, -1e-4][round % 4];
        let is_probe = round % 8 < 4;
        let angle = rng.random_range(0.3..2.8);
        // The upper roof is turned over, so that its ridge is its lowest edge.
        let turned = DQuat::from_rotation_z(angle) * DQuat::from_rotation_x(std::f64::consts::PI);
        let shift = DVec3::new(rng.random_range(-0.02..0.02), rng.random_range(-0.005..0.005), gap);
        let (upper, lower) = (Pose::new(shift, turned), Pose::IDENTITY);
        // Lines along x, and along (cos, sin) through the shift, cross in plan.
        let along = DVec3::new(angle.cos(), angle.sin(), 0.0);
        let crossing = shift - along * (shift.y / along.y);
        let (probe, object) = ((&roof, &upper), (&roof, &lower));
        let own = if is_probe { &upper } else { &lower };
        let from = crossing + own.transform_vector(DVec3::X) * rng.random_range(-0.02..0.02);
        let home = own.inverse().transform_point(from);
        let mut point = new((home, 0.05), is_probe, &Frames::new(probe, object));
        let found = measure(&mut point, probe, object);
        let place = found.point.distance(crossing);
        // A ridge that overlaps is as deep as the faces beside the other one say, at 45°.
        let wanted = if gap < 0.0 { gap / SQRT_2 } else { gap };
        assert!((found.distance - wanted).abs() < 2e-8, "round {round}: {found:?}, but {wanted} m");
        if gap < 0.0 {
            assert!(found.point.distance(crossing) < 2e-4, "round {round}: {found:?}, not {crossing}");
            continue;
        }
        assert!(found.normal.distance(DVec3::NEG_Z) < 0.02, "round {round}: {found:?}");
        // A point of the object is measured at its nearest on the probe.
        assert!(place < gap + 2e-5, "round {round}: {found:?}, not {crossing}");
    }
}

/// A box above a plate: the point descends to the lowest corner, and follows as the box turns.
#[test]
fn a_point_follows_the_lowest_corner_of_a_turning_box() {
    let (cube, plate) = (block(DVec3::splat(0.02)), block(DVec3::new(0.2, 0.2, 0.01)));
    let mut rng = StdRng::seed_from_u64(0x60A2);
    let at = Pose::from_translation(DVec3::NEG_Z * 0.005);
    let corners = |pose: &Pose| {
        let corner = |i: u32| DVec3::new(f64::from(i & 1), f64::from((i >> 1) & 1), f64::from(i >> 2)) - 0.5;
        (0..8).map(|i| pose.transform_point(corner(i) * 0.02)).min_by(|a, b| a.z.total_cmp(&b.z))
    };
    let (mut changes, mut rests) = (0, 0);
    for round in 0..100 {
        let axis = random(&mut rng).normalize();
        let turned = |angle: f64| {
            let rotation = DQuat::from_axis_angle(axis, angle) * DQuat::from_rotation_x(0.4);
            let lowest = corners(&Pose::new(DVec3::ZERO, rotation)).expect("corners").z;
            Pose::new(DVec3::Z * (1e-4 - lowest), rotation)
        };
        let start = turned(0.0);
        let home = start.inverse().transform_point(corners(&start).expect("corners") + DVec3::X * 2e-3);
        let mut point = new((home, 0.1), true, &Frames::new((&cube, &start), (&plate, &at)));
        let mut place = start.inverse().transform_point(corners(&start).expect("corners"));
        // At 2 rad/s for a radian, in steps of 1 ms.
        for step in 0..=500 {
            let pose = turned(f64::from(step) * 2e-3);
            let frames = Frames::new((&cube, &pose), (&plate, &at));
            // At rest it is measured as by a descent.
            if let Some((position, closest)) = point.at_rest(&frames) {
                let mut same = point;
                let (wanted, by_descent) = same.descend(&frames, MAX_MOVES);
                let parts = |found: &ClosestPoint| (found.point, found.distance, found.normal, found.face);
                assert_eq!((position, parts(&closest)), (wanted, parts(&by_descent)), "{round}, {step}");
                assert_eq!((same.place, same.face, same.stride), (point.place, point.face, point.stride));
                rests += 1;
            }
            let found = point.measure(&frames);
            let lowest = corners(&pose).expect("corners");
            let now = pose.inverse().transform_point(lowest);
            changes += u32::from(now.distance(place) > 1e-3);
            place = now;
            // Level edges are left late, at the slope that counts as level.
            let off = found.distance - lowest.z;
            assert!((-1e-9..5e-5).contains(&off), "round {round}, step {step}: {found:?}, not {lowest}");
            assert!(found.normal.distance(DVec3::NEG_Z) < 1e-6, "round {round}, step {step}: {found:?}");
        }
    }
    assert!(changes > 30, "the lowest corner changes {changes} times");
    assert!(rests > 1000, "the point rests in {rests} steps");
}

/// A corner of the scene's object below a face of the probe is found from either side, with the same normal.
#[test]
fn points_of_the_object_have_the_probes_normal() {
    let (cube, plate) = (block(DVec3::splat(0.02)), block(DVec3::new(0.2, 0.2, 0.01)));
    // A corner upwards, 0.1 mm below the plate.
    let up = DQuat::from_rotation_arc(DVec3::ONE.normalize(), DVec3::Z);
    let top = 0.01 * 3.0_f64.sqrt();
    let object = Pose::new(DVec3::new(0.013, -0.02, -top), up);
    let probe = Pose::from_translation(DVec3::Z * (0.005 + 1e-4));
    let tip = DVec3::splat(0.01);
    let mut point =
        new((tip - DVec3::X * 2e-3, 0.01), false, &Frames::new((&plate, &probe), (&cube, &object)));
    let found = measure(&mut point, (&plate, &probe), (&cube, &object));
    assert!((found.distance - 1e-4).abs() < 1e-9, "{found:?}");
    assert!(found.normal.distance(DVec3::NEG_Z) < 1e-9, "{found:?}");
    assert!(found.point.distance(DVec3::new(0.013, -0.02, 1e-4)) < 1e-6, "{found:?}");
}
