//! Which points of a blunt cone over a floor are guarded.

use std::f64::consts::TAU;

use palpate_core::TriMesh;
use palpate_core::glam::DQuat;

use super::*;
use crate::constraints::geometry::tests::without_points;
use crate::constraints::test_meshes::block;

const RINGS: u32 = 10;
const SIDES: u32 = 10;

/// Height of the cone's tip and of the foot's, m.
const TIP: f64 = 1e-5;
const FOOT: f64 = 5e-5;

/// Height of all that may be near, m, and edge of the smallest cells, m.
const NEAR: f64 = 4e-4;
const EDGE: f64 = 5e-4;

/// A blunt cone of 10 mm with rings of vertices, tip downwards, and a small foot 30 mm beside it. The
/// vertices of each are the tip, those around it, and the one above.
fn cone_and_foot() -> TriMesh {
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for (at, height, rings, sides) in [(0.0, TIP, RINGS, SIDES), (0.03, FOOT, 1, 3)] {
        let first = vertices.len() as u32;
        let tip = DVec3::new(at, 0.0, height);
        vertices.push(tip);
        for ring in 1..=rings {
            let aside = if rings > 1 { 1e-3 * f64::from(ring) } else { 1e-4 };
            vertices.extend((0..sides).map(|i| {
                let around = DQuat::from_rotation_z(TAU * f64::from(i) / f64::from(sides));
                tip + around * DVec3::new(aside, 0.0, if rings > 1 { 0.02 * aside } else { aside })
            }));
        }
        let last = vertices.len() as u32;
        vertices.push(tip + DVec3::Z * 0.01);
        let on = |ring: u32, i: u32| first + 1 + (ring - 1) * sides + i % sides;
        for i in 0..sides {
            triangles.extend([[first, on(1, i + 1), on(1, i)], [last, on(rings, i), on(rings, i + 1)]]);
            for ring in 1..rings {
                let [a, b, c, d] = [on(ring, i), on(ring, i + 1), on(ring + 1, i), on(ring + 1, i + 1)];
                triangles.extend([[a, b, c], [b, d, c]]);
            }
        }
    }
    TriMesh::new(vertices, triangles).expect("a mesh")
}

/// The cone over two floors at the same place, with a start at each of its lower vertices, and at the foot.
fn over_floors(mesh: &TriMesh) -> (Guard, ContactGeometry) {
    let floor = Arc::new(FeatureMesh::new(&block(DVec3::new(0.2, 0.2, 0.01))));
    let probe = Arc::new(FeatureMesh::new(mesh));
    let mut geometry = without_points((&probe, &floor), [(DVec3::new(0.01, 0.0, -0.005), 0.0); 2]);
    geometry.objects[1].place = 1;
    let mut guard = Guard::new();
    for place in 0..2 {
        for vertex in 0..=RINGS * SIDES + 2 {
            let point = mesh.vertices()[vertex as usize];
            if point.z > NEAR {
                continue;
            }
            let near = NearFeature {
                place: Place::Vertex(vertex),
                is_probe: true,
                is_tip: false,
                point,
                distance: point.z,
                apart: 0.0,
                least: point.z,
                // As far as its tip; starts of different parts have different ones.
                leash: Leash {
                    home: point,
                    length: (1.1
                        * point.with_z(0.0).length().min(point.with_z(0.0).distance(DVec3::X * 0.03))
                        + 1e-6 * f64::from(vertex)) as f32,
                },
                hint: 0,
            };
            let start = Start::new(&near, place, (point, DVec3::NEG_Z));
            guard.starts.push(Start { object: (place as u8, place as u16), ..start });
        }
    }
    (guard, geometry)
}

/// More points than may be near come to the cone's tip. They are one point with each floor, which may go
/// where all of them may, and cells stay as small as they are, so that the foot beside it has its own.
#[test]
fn points_that_meet_are_one_before_cells_grow() {
    let mesh = cone_and_foot();
    let limits = Limits { edge: EDGE, near: NEAR, room: 1e-3 };
    // Without it, there is no room for them.
    let (mut guard, geometry) = over_floors(&mesh);
    let cells = Cells::new(EDGE, 0);
    guard.choose(&cells, usize::MAX);
    guard.make(&geometry, &Pose::IDENTITY, &limits, &cells);
    let unmerged = guard.near(NEAR);
    assert!(unmerged > MAX_NEAR && !guard.are_too_many(NEAR), "{unmerged} points");

    let (mut guard, mut geometry) = over_floors(&mesh);
    let (nearest, missed) = guard.fill(&mut geometry, &Pose::IDENTITY, &limits);
    assert_eq!((nearest, missed), (f64::INFINITY, 0));
    assert_eq!(guard.coarseness, 0);
    let foot = RINGS * SIDES + 2;
    let guards = |object: u8, vertex: u32| {
        let is_it = |point: &&GuardedPoint| {
            let at = geometry.frames(&Pose::IDENTITY)[usize::from(object)];
            point.object == object && point.ends(&at)[0] == mesh.vertices()[vertex as usize]
        };
        geometry.points.iter().filter(is_it).count()
    };
    for object in 0..2 {
        assert_eq!(guards(object, 0), 1, "a point at the tip");
        assert!(guards(object, foot) >= 1, "one at the foot");
    }
    assert!(geometry.points.len() < unmerged / 4, "{} points", geometry.points.len());
    // Where the cone tilts onto its rim, these points get there.
    let tilt = DQuat::from_rotation_y(-0.05) * DQuat::from_rotation_z(0.3);
    let cone = &mesh.vertices()[..=(RINGS * SIDES) as usize];
    let lowest = cone.iter().map(|vertex| (tilt * *vertex).z).fold(f64::INFINITY, f64::min);
    let pose = Pose::new(DVec3::Z * (TIP - lowest), tilt);
    let frames = geometry.frames(&pose);
    for object in 0..2 {
        let own = geometry.points.iter().filter(|point| point.object == object);
        let heights = own.map(|point| {
            let mut point = *point;
            (0..10).map(|_| point.measure_on(&frames[usize::from(object)], 0.0, 0.0).nearest).last()
        });
        let least = heights.flatten().fold(f64::INFINITY, f64::min);
        assert!((least - TIP).abs() < 1e-9, "the rim is at {least} m");
    }
}

/// An attempt to make points leaves the starts as they are: coarser cells are as few after it as before.
#[test]
fn an_attempt_does_not_change_the_next_one() {
    let mesh = cone_and_foot();
    let limits = Limits { edge: EDGE, near: NEAR, room: 1e-3 };
    let (mut guard, geometry) = over_floors(&mesh);
    let [fine, coarse] = [0, COARSE + 4].map(|coarseness| Cells::new(EDGE, coarseness));
    let mut count = |cells: &Cells, is_made: bool| {
        guard.choose(cells, usize::MAX);
        if is_made {
            guard.make(&geometry, &Pose::IDENTITY, &limits, cells);
        }
        guard.chosen.len()
    };
    let before = count(&coarse, false);
    assert!(count(&fine, true) > 2 * before, "{before} coarse cells");
    assert_eq!(count(&coarse, true), before);
    assert_eq!(count(&coarse, false), before);
}
