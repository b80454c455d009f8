//! What a search passes on, and the bound that it claims, against distances from a box by formula.

use std::collections::HashMap;

use palpate_core::TriMesh;
use palpate_core::glam::DQuat;
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

use super::*;
use crate::constraints::test_meshes::{ball, block, to_block};

/// Half of the edges of the box, m.
const HALF: DVec3 = DVec3::new(0.06, 0.04, 0.01);

/// Distance of a point from the box, m.
fn distance(p: DVec3) -> f64 {
    to_block(2.0 * HALF, p)
}

/// Places along the edges of a mesh at which it is not flat.
fn places(mesh: &TriMesh) -> Vec<DVec3> {
    let normal = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a).normalize();
    let mut known = HashMap::new();
    let mut places = Vec::new();
    for (index, triangle) in mesh.triangles().iter().enumerate() {
        let (corners, normal) = (mesh.corners(index), normal(mesh.corners(index)));
        for i in 0..3 {
            let (from, to) = (triangle[i], triangle[(i + 1) % 3]);
            known.insert([from, to], normal);
            if known.get(&[to, from]).is_some_and(|other| other.dot(normal) < 1.0 - 1e-6) {
                let at = |part: u32| corners[i].lerp(corners[(i + 1) % 3], f64::from(part) / 16.0);
                places.extend((0..=16).map(at));
            }
        }
    }
    places
}

/// A query with a number of readings at most: how far the bodies may move, m, and how many it has read.
fn find(
    known: &mut NearFeatures,
    probe: (&FeatureMesh, &Pose),
    scene: (&FeatureMesh, &Pose),
    radius: f64,
    (reaches, most): (&Reaches, usize),
    to: impl FnMut(&NearFeature),
) -> (f64, usize) {
    let surfaces = [probe.0, scene.0];
    known.begin(probe, scene, (DVec3::ZERO, radius), reaches);
    let (room, left) = known.go_on(surfaces, reaches, most);
    let (others, left) = known.end(surfaces, (reaches, left), to);
    (room.min(others).max(0.0), most - left)
}

/// A body wanders about the box. Whatever is nearer than the bound that is claimed is passed on, by a start
/// that may move to it and does not claim more room for it than there is. The bound is not far below the
/// distance.
#[test]
fn all_that_is_nearer_than_the_bound_is_passed_on() {
    let scene = FeatureMesh::new(&block(2.0 * HALF));
    let (mut near, mut inside, mut cut) = (0, 0, 0);
    for (name, mesh) in [
        ("box", block(DVec3::new(0.04, 0.02, 0.06))),
        ("needle", block(DVec3::new(4e-4, 4e-4, 0.08))),
        ("ball", ball(0.03, 48)),
    ] {
        let probe = FeatureMesh::new(&mesh);
        let radius = mesh.vertices().iter().map(|vertex| vertex.length()).fold(0.0, f64::max);
        let places = places(&mesh);
        let mut rng = StdRng::seed_from_u64(0x9EA2);
        let mut known = NearFeatures::default();
        let random =
            |rng: &mut StdRng| DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
        let mut pose = Pose::from_translation(DVec3::Z * 0.08);
        let (mut claimed, mut gap) = (f64::INFINITY, 0.05);
        for step in 0..600 {
            let motion = [1e-4, 1e-3, 5e-3, 0.0][step / 4 % 4];
            let turn = DQuat::from_scaled_axis(random(&mut rng) * 20.0 * motion);
            // To and fro between a millimetre from the box and three centimetres.
            let drift =
                if gap > [1e-3, 0.03][step / 50 % 2] { -0.7 } else { 0.7 } * pose.translation.normalize();
            let shift = (random(&mut rng) + drift) * motion;
            let to = Pose::new(pose.translation + shift, turn * pose.rotation);
            let gaps = places.iter().map(|place| distance(to.transform_point(*place)));
            let least = gaps.fold(f64::INFINITY, f64::min);
            if least < 1e-6 {
                continue;
            }
            (pose, gap) = (to, least);
            let edge = [0.02, 0.1][step / 200 % 2] * radius;
            let reach = [2e-3, 1e-2][step / 100 % 2];
            let reaches = Reaches { reach, enough: 0.03, edge, cell: edge, long: 2.0 * edge };
            let mut found = Vec::new();
            let (own, other) = ((&probe, &pose), (&scene, &Pose::IDENTITY));
            let most = [usize::MAX, 64][step / 25 % 2];
            let (room, read) =
                find(&mut known, own, other, radius, (&reaches, most), |near| found.push(*near));
            let is_cut = read >= most;
            cut += u32::from(is_cut);
            assert!(
                is_cut || room >= reach * (1.0 - 1e-6),
                "{name}, {step}: {room} m of room, {reach} m asked for"
            );
            let missed = |place: DVec3, count: &mut u64| {
                let there = distance(pose.transform_point(place));
                let is_near = there < room - 1e-9;
                *count += u64::from(is_near);
                is_near
                    && !found.iter().any(|start| {
                        start.is_probe
                            && start.leash.home.distance(place) <= f64::from(start.leash.length) + 1e-9
                            && start.least <= there + 1e-9
                    })
            };
            for place in &places {
                assert!(!missed(*place, &mut near), "{name}, {step}: {place} is passed over, {room} m");
            }
            // Negative control: insides of large faces are not passed on.
            inside += (0..mesh.triangles().len())
                .filter(|face| {
                    let [a, b, c] = mesh.corners(*face);
                    missed((a + b + c) / 3.0, &mut 0)
                })
                .count();
            if least > reach && motion == 0.0 && !is_cut {
                claimed = claimed.min(room / least.min(reaches.enough));
            }
        }
        assert!(claimed > 0.3, "{name}: {claimed} of the distance");
    }
    assert!(near > 10_000 && inside > 20, "{near} places near, {inside} insides of faces passed over");
    assert!(cut > 20, "{cut} queries are cut short");
}

/// Queries of fine meshes read no more distances than they may. What they have not come to bounds the motion,
/// also of bodies that are near each other from the start, and the next queries find it. At rest, nothing is
/// read.
#[test]
fn queries_are_cut_short_and_gone_on_with() {
    const MOST: usize = 512;
    let (scene, radius) = (FeatureMesh::new(&block(2.0 * HALF)), 0.03);
    let edge = 0.02 * radius;
    let near = Reaches { reach: 2e-3, enough: 0.03, edge, cell: edge, long: 2.0 * edge };
    for sides in [96, 160] {
        let probe = FeatureMesh::new(&ball(radius, sides));
        for gap in [0.02, 1e-3, 0.0, -1e-3] {
            let pose = Pose::from_translation(DVec3::new(0.01, 0.02, HALF.z + radius + gap));
            let find = |known: &mut NearFeatures, most: usize| {
                let mut passed = 0;
                let (own, other) = ((&probe, &pose), (&scene, &Pose::IDENTITY));
                let (room, read) = find(known, own, other, radius, (&near, most), |_| passed += 1);
                (room, passed, read)
            };
            let mut at_once = NearFeatures::default();
            let (room, passed, read) = find(&mut at_once, usize::MAX);
            assert!(room >= near.reach && room <= near.enough.max(gap), "{sides}, {gap} m: {room} m");
            let mut known = NearFeatures::default();
            let cut: Vec<_> = (0..40).map(|_| find(&mut known, MOST)).collect();
            let most = cut.iter().map(|(.., read)| *read).max();
            assert!(most <= Some(MOST + 2), "{sides} sides, {gap} m apart: {most:?} read");
            assert!(cut.is_sorted_by(|a, b| a.0 <= b.0 && a.1 <= b.1), "{sides} sides, {gap} m: {cut:?}");
            assert_eq!(cut[39], (room, passed, 0), "{sides} sides, {gap} m apart, after {cut:?}");
            let queries = cut.iter().filter(|(.., read)| *read > 0).count();
            assert_eq!(queries > 1, read > MOST, "{sides} sides, {gap} m apart: {read} are read at once");
        }
    }
}

/// A body that has been elsewhere starts at about as many features as one that has not: regions that were
/// divided where it was near are whole again.
#[test]
fn what_was_divided_becomes_whole() {
    let scene = FeatureMesh::new(&block(2.0 * HALF));
    for (mesh, radius) in [(block(DVec3::new(0.06, 0.04, 0.02)), 0.04), (ball(0.03, 160), 0.03)] {
        let probe = FeatureMesh::new(&mesh);
        let half = mesh.vertices().iter().map(|vertex| vertex.z).fold(0.0, f64::max);
        let edge = 0.02 * radius;
        let near = Reaches { reach: 1e-2, enough: 0.03, edge, cell: edge, long: 2.0 * edge };
        let starts = |known: &mut NearFeatures, at: DVec3| {
            let (mut passed, pose) = (0_u32, Pose::from_translation(at));
            let (own, other) = ((&probe, &pose), (&scene, &Pose::IDENTITY));
            let _ = find(known, own, other, radius, (&near, usize::MAX), |_| passed += 1);
            passed
        };
        let over = |gap: f64| DVec3::new(1e-3, 2e-3, HALF.z + half + gap);
        let beside = DVec3::new(HALF.x, 0.0, HALF.z + half + 1e-4);
        let mut known = NearFeatures::default();
        for (from, to) in [(beside, over(1e-4)), (over(1e-4), over(5e-3))] {
            let fresh = starts(&mut NearFeatures::default(), to);
            let before = starts(&mut known, from);
            let most = (0..=50).map(|i| starts(&mut known, from.lerp(to, f64::from(i) / 50.0))).max();
            // Once more where distances are old, as they are nearer than they are taken for.
            let after = (0..4).map(|i| starts(&mut known, to + DVec3::X * 1e-3 * f64::from(i % 2))).last();
            let after = after.unwrap_or(0);
            assert!(before > 0 && most >= Some(after), "{before} starts, then {most:?}, then {after}");
            // Spheres become whole at half of the radius at which they are divided.
            assert!(after <= 4 * fresh, "{after} starts, not {fresh}");
        }
    }
}
