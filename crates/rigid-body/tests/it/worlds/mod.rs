//! Solids for simulations.
#![allow(dead_code)]

use palpate_clod_build::{BuildOptions, build, unwatched};
use palpate_collide::Shape;
use palpate_core::TriMesh;
use palpate_core::glam::DVec3;
use palpate_models::Model;

/// Builds the hierarchy of a mesh.
pub fn shape(mesh: &TriMesh) -> Shape {
    Shape::new(build(mesh, &BuildOptions::default(), &mut unwatched).expect("closed and oriented"))
}

/// A built-in model with its own number of triangles.
pub fn model(model: Model) -> Shape {
    shape(&model.generate(model.default_triangles()).expect("its own number"))
}

/// A block about the origin, by half its edges, m.
pub fn block(half: DVec3) -> Shape {
    let corner = |index: u32| {
        let sign = |bit: u32| if index & bit == 0 { -1.0 } else { 1.0 };
        half * DVec3::new(sign(1), sign(2), sign(4))
    };
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    shape(&TriMesh::new((0..8).map(corner).collect(), triangles).expect("eight corners"))
}

/// A ball about the origin, of 2048 triangles with a corner along each axis.
pub fn ball(radius: f64) -> Shape {
    let mut vertices = vec![DVec3::X, -DVec3::X, DVec3::Y, -DVec3::Y, DVec3::Z, -DVec3::Z];
    let mut triangles: Vec<[u32; 3]> =
        vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    for _ in 0..4 {
        let mut middles = std::collections::HashMap::new();
        let mut refined = Vec::new();
        for triangle in &triangles {
            let [a, b, c] = *triangle;
            let [ab, bc, ca] = [[a, b], [b, c], [c, a]].map(|[p, q]| {
                *middles.entry((p.min(q), p.max(q))).or_insert_with(|| {
                    vertices.push((vertices[p as usize] + vertices[q as usize]).normalize());
                    vertices.len() as u32 - 1
                })
            });
            refined.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        triangles = refined;
    }
    let vertices = vertices.into_iter().map(|vertex| radius * vertex).collect();
    shape(&TriMesh::new(vertices, triangles).expect("its own corners"))
}
