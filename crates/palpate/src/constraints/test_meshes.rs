//! Meshes of tests.

use std::f64::consts::{PI, TAU};

use palpate_core::TriMesh;
use palpate_core::glam::DVec3;

/// A box with these edges, m, about the origin.
pub fn block(edges: DVec3) -> TriMesh {
    let corner = |i: u32| DVec3::new(f64::from(i & 1), f64::from((i >> 1) & 1), f64::from(i >> 2)) - 0.5;
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    TriMesh::new((0..8).map(|i| corner(i) * edges).collect(), triangles).expect("a box")
}

/// Signed distance of a point from such a box, m.
pub fn to_block(edges: DVec3, point: DVec3) -> f64 {
    let off = point.abs() - 0.5 * edges;
    off.max(DVec3::ZERO).length() + off.max_element().min(0.0)
}

/// A ball of `2 sides²` triangles.
pub fn ball(radius: f64, sides: u32) -> TriMesh {
    let at = |ring: u32, i: u32| 1 + (ring - 1) * sides + i % sides;
    let ring = |ring: u32| {
        (0..sides).map(move |i| {
            let (down, around) =
                (PI * f64::from(ring) / f64::from(sides), TAU * f64::from(i) / f64::from(sides));
            radius * DVec3::new(down.sin() * around.cos(), down.sin() * around.sin(), down.cos())
        })
    };
    let mut vertices = vec![DVec3::Z * radius];
    vertices.extend((1..sides).flat_map(ring));
    vertices.push(DVec3::NEG_Z * radius);
    let last = vertices.len() as u32 - 1;
    let caps = (0..sides)
        .flat_map(|i| [[0, at(1, i), at(1, i + 1)], [last, at(sides - 1, i + 1), at(sides - 1, i)]]);
    let sides = (1..sides - 1).flat_map(|ring| (0..sides).map(move |i| (ring, i))).flat_map(|(ring, i)| {
        let [a, b, c, d] = [at(ring, i), at(ring, i + 1), at(ring + 1, i), at(ring + 1, i + 1)];
        [[a, c, b], [b, c, d]]
    });
    TriMesh::new(vertices, caps.chain(sides).collect()).expect("a ball")
}
