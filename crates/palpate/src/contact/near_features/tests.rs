//! What a search passes on, and the bound that it claims, against distances from a box by formula.

use std::collections::HashMap;

use palpate_core::TriMesh;
use palpate_core::glam::DQuat;
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

use super::*;
use crate::contact::test_meshes::{ball, block, to_block};

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

/// A body wanders about the box. Whatever is nearer than the bound that is claimed is passed on, by a start
/// that may move to it and does not claim more room for it than there is. The bound is not far below the
/// distance.
#[test]
fn all_that_is_nearer_than_the_bound_is_passed_on() {
    let scene = FeatureMesh::new(&block(2.0 * HALF));
    let (mut near, mut inside) = (0, 0);
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
            let reaches = Reaches { reach, enough: 0.03, edge, long: 2.0 * edge };
            let mut found = Vec::new();
            let (own, other) = ((&probe, &pose), (&scene, &Pose::IDENTITY));
            let room = known.find(own, other, (DVec3::ZERO, radius), &reaches, |near| found.push(*near));
            assert!(room >= reach * (1.0 - 1e-6), "{name}, {step}: {room} m of room, {reach} m asked for");
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
            if least > reach && motion == 0.0 {
                claimed = claimed.min(room / least.min(reaches.enough));
            }
        }
        assert!(claimed > 0.3, "{name}: {claimed} of the distance");
    }
    assert!(near > 10_000 && inside > 20, "{near} places near, {inside} insides of faces passed over");
}

/// Number of distances that a query has just read: those as old as the motion so far.
fn read_just_now(known: &NearFeatures) -> usize {
    let now = |reading: &&Reading| reading.at == known.moved;
    let of = |side: &Readings| {
        side.vertices.iter().chain(&side.edges).chain(side.parts.iter().flatten()).filter(now).count()
    };
    known.sides.iter().map(of).sum()
}

/// The first query of bodies that come near each other, and the next ones, read few of the distances of fine
/// meshes: up to 7,530 when this was written.
#[test]
fn first_queries_read_few_distances() {
    const MOST: usize = 10_000;
    let (scene, radius) = (FeatureMesh::new(&block(2.0 * HALF)), 0.03);
    let edge = 0.02 * radius;
    let near = Reaches { reach: 2e-3, enough: 0.03, edge, long: 2.0 * edge };
    for sides in [96, 160] {
        let probe = FeatureMesh::new(&ball(radius, sides));
        let nodes = probe.tree().vertices.len() + probe.tree().edges.len();
        assert!(nodes > 2 * MOST, "{sides} sides: {nodes} distances, and nothing is shown");
        for gap in [0.02, 1e-3, 0.0, -1e-3] {
            let (mut known, mut passed) = (NearFeatures::default(), 0);
            let read = [0.0, 1e-5, 2e-5, 1e-3].map(|aside| {
                let pose = Pose::from_translation(DVec3::new(0.01 + aside, 0.02, HALF.z + radius + gap));
                let (own, other) = ((&probe, &pose), (&scene, &Pose::IDENTITY));
                let _ = known.find(own, other, (DVec3::ZERO, radius), &near, |_| passed += 1);
                read_just_now(&known)
            });
            assert!(read[0] > 100 && passed > 0, "{sides} sides, {gap} m apart: {read:?} read");
            assert!(read.iter().all(|read| *read < MOST), "{sides} sides, {gap} m apart: {read:?} read");
        }
    }
}
