//! Plain bodies, and hands that follow a path.

use std::f64::consts::{PI, TAU};

use palpate::device::IntendedPath;
use palpate::glam::{DQuat, DVec3};
use palpate::{Object, Pose, TriMesh, Twist};

pub fn object(name: &str, vertices: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> Object {
    Object::from_mesh(name, &TriMesh::new(vertices, triangles).expect("a mesh")).expect("an object")
}

/// The same object under another name.
pub fn named(name: &str, mut object: Object) -> Object {
    name.clone_into(&mut object.name);
    object
}

/// Triangles of quadrangles.
pub fn halved(faces: impl IntoIterator<Item = [u32; 4]>) -> Vec<[u32; 3]> {
    faces.into_iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).collect()
}

/// A box with these edges about the origin, m.
pub fn block(edges: DVec3) -> Object {
    block_about(DVec3::ZERO, edges)
}

/// The same about a centre, m.
pub fn block_about(center: DVec3, edges: DVec3) -> Object {
    let corner = |i: u32| DVec3::new(f64::from(i & 1), f64::from((i >> 1) & 1), f64::from(i >> 2)) - 0.5;
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    object("box", (0..8).map(|i| center + corner(i) * edges).collect(), halved(faces))
}

/// A solid of revolution about z: the profile (radius, height) from the bottom of the axis to its top, m.
pub fn turned(name: &str, profile: &[(f64, f64)], segments: u32) -> Object {
    let rim = &profile[1..profile.len() - 1];
    let mut vertices = vec![DVec3::Z * profile[0].1, DVec3::Z * profile[profile.len() - 1].1];
    for i in 0..segments {
        let (sin, cos) = (TAU * f64::from(i) / f64::from(segments)).sin_cos();
        vertices.extend(rim.iter().map(|&(r, z)| DVec3::new(r * cos, r * sin, z)));
    }
    let count = rim.len() as u32;
    let at = |i: u32, j: u32| 2 + (i % segments) * count + j;
    let mut triangles = Vec::new();
    for i in 0..segments {
        triangles.push([0, at(i + 1, 0), at(i, 0)]);
        triangles.push([1, at(i, count - 1), at(i + 1, count - 1)]);
        triangles
            .extend(halved((0..count - 1).map(|j| [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)])));
    }
    object(name, vertices, triangles)
}

/// A ball of a radius (m) with its poles on z, of so many rings of so many faces.
pub fn ball(radius: f64, (rings, segments): (u32, u32)) -> Object {
    let at = |i: u32| {
        let (sin, cos) = (PI * f64::from(i) / f64::from(rings)).sin_cos();
        (radius * sin, -radius * cos)
    };
    let profile: Vec<_> = (0..=rings).map(at).collect();
    turned("ball", &profile, segments)
}

/// A hand that is at a place (m), turned, at each time (s).
pub fn path(f: impl Fn(f64) -> (DVec3, DQuat) + Send + 'static) -> IntendedPath {
    IntendedPath::function(move |time| {
        let at = |time: f64| {
            let (translation, rotation) = f(time);
            Pose::new(translation, rotation)
        };
        let (before, after) = (at(time - 5e-5), at(time + 5e-5));
        let linear = (after.translation - before.translation) / 1e-4;
        (at(time), Twist::new(linear, before.rotation_vector_to(&after) / 1e-4))
    })
}
