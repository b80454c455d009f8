//! Meshes whose decomposition is known, and files that are read when they are there.
#![allow(dead_code, reason = "each test program uses some of them")]

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};
use std::io::Write as _;
use std::path::PathBuf;

use glam::{DMat3, DVec3};
use palpate_clod_build::{BuildOptions, build, unwatched};
use palpate_core::TriMesh;
use palpate_core::clod::Parts;
use palpate_mesh_io::{LoadOptions, load};

/// Options of the plain hierarchy: the decomposition of the full mesh, and free levels over it.
pub fn plain() -> BuildOptions {
    BuildOptions { simplify: false, ..BuildOptions::default() }
}

/// Builds the plain hierarchy and checks the invariants of hierarchies.
pub fn built(mesh: &TriMesh) -> Parts {
    let clod = build(mesh, &plain(), &mut unwatched).expect("the mesh builds").parts();
    clod.validate().expect("the hierarchy is valid");
    clod
}

/// The folder of test data beside the repository, or a note that the test is skipped.
pub fn shared(folder: &str) -> Option<PathBuf> {
    let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")).join(folder);
    if path.exists() {
        return Some(path);
    }
    // Directly to the stream: the test runner captures the output of the print macros.
    let _ = writeln!(std::io::stderr(), "skipped: {} is not there", path.display());
    None
}

/// A file of the test data, if it is there.
pub fn shared_mesh(file: &str) -> Option<TriMesh> {
    Some(load(&shared(file)?, &LoadOptions::default()).expect("a good mesh loads").mesh)
}

fn mesh(vertices: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> TriMesh {
    TriMesh::new(vertices, triangles).expect("indices are in range")
}

/// Several meshes as one.
pub fn together(meshes: &[TriMesh]) -> TriMesh {
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for m in meshes {
        let base = vertices.len() as u32;
        vertices.extend_from_slice(m.vertices());
        triangles.extend(m.triangles().iter().map(|t| t.map(|v| v + base)));
    }
    mesh(vertices, triangles)
}

/// The mesh turned inside out.
pub fn inverted(m: &TriMesh) -> TriMesh {
    mesh(m.vertices().to_vec(), m.triangles().iter().map(|[a, b, c]| [*a, *c, *b]).collect())
}

/// The mesh mapped by a matrix and shifted.
pub fn mapped(m: &TriMesh, matrix: DMat3, shift: DVec3) -> TriMesh {
    mesh(m.vertices().iter().map(|p| matrix * *p + shift).collect(), m.triangles().to_vec())
}

/// A box of `n` × `n` squares a side, from -1 to 1.
pub fn cube(n: u32) -> TriMesh {
    let mut numbers = HashMap::new();
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for axis in 0..3 {
        for side in [0, n] {
            for i in 0..n {
                for j in 0..n {
                    let mut corner = |di: u32, dj: u32| {
                        let mut key = [0; 3];
                        key[axis] = side;
                        key[(axis + 1) % 3] = i + di;
                        key[(axis + 2) % 3] = j + dj;
                        *numbers.entry(key).or_insert_with(|| {
                            vertices.push(DVec3::from_array(
                                key.map(|k| 2.0 * f64::from(k) / f64::from(n) - 1.0),
                            ));
                            vertices.len() as u32 - 1
                        })
                    };
                    let [a, b, c, d] = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
                    if side == n {
                        triangles.extend([[a, b, c], [a, c, d]]);
                    } else {
                        triangles.extend([[a, c, b], [a, d, c]]);
                    }
                }
            }
        }
    }
    mesh(vertices, triangles)
}

/// A prism of height 1 over a polygon (counter-clockwise) that the given triangles fill.
pub fn prism(outline: &[(f64, f64)], fill: &[[u32; 3]]) -> TriMesh {
    let n = outline.len() as u32;
    let level = |z: f64| outline.iter().map(move |(x, y)| DVec3::new(*x, *y, z));
    let vertices = level(0.0).chain(level(1.0)).collect();
    let mut triangles: Vec<[u32; 3]> = fill.iter().map(|[a, b, c]| [*a, *c, *b]).collect();
    triangles.extend(fill.iter().map(|t| t.map(|v| v + n)));
    for k in 0..n {
        let next = (k + 1) % n;
        triangles.extend([[k, next, next + n], [k, next + n, k + n]]);
    }
    mesh(vertices, triangles)
}

/// An L-shaped prism: a square of side 2 less one of side 1.
pub fn l_prism() -> TriMesh {
    prism(
        &[(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 1.0), (1.0, 2.0), (0.0, 2.0)],
        &[[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]],
    )
}

/// The unit sphere as a grid of `n` parallels and 2n meridians, moved outwards by `offset(direction)`.
pub fn globe(n: u32, offset: impl Fn(DVec3) -> f64) -> TriMesh {
    let mut vertices = vec![DVec3::Z, -DVec3::Z];
    let at = |i: u32, j: u32| match i {
        0 => 0,
        i if i == n => 1,
        i => 2 + (i - 1) * 2 * n + j % (2 * n),
    };
    for i in 1..n {
        for j in 0..2 * n {
            let (polar, around) = (PI * f64::from(i) / f64::from(n), PI * f64::from(j) / f64::from(n));
            vertices.push(DVec3::new(polar.sin() * around.cos(), polar.sin() * around.sin(), polar.cos()));
        }
    }
    for p in &mut vertices {
        *p *= 1.0 + offset(*p);
    }
    let mut triangles = Vec::new();
    for i in 0..n {
        for j in 0..2 * n {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            triangles.extend(
                [[a, b, c], [a, c, d]].into_iter().filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]),
            );
        }
    }
    mesh(vertices, triangles)
}

/// A torus of radii 1 and `tube`.
pub fn torus(n: u32, tube: f64) -> TriMesh {
    let (around, across) = (2 * n, n);
    let vertices = (0..around * across)
        .map(|k| {
            let (u, v) = (
                TAU * f64::from(k / across) / f64::from(around),
                TAU * f64::from(k % across) / f64::from(across),
            );
            let r = 1.0 + tube * v.cos();
            DVec3::new(r * u.cos(), r * u.sin(), tube * v.sin())
        })
        .collect();
    let at = |i: u32, j: u32| i % around * across + j % across;
    let mut triangles = Vec::new();
    for i in 0..around {
        for j in 0..across {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    mesh(vertices, triangles)
}

/// A wall of height 1 wound three times into a spiral, seen from its convex side: every edge is convex, but
/// only about half a turn of it lies on a common hull.
pub fn spiral(steps: u32) -> TriMesh {
    let vertices = (0..=steps)
        .flat_map(|k| {
            let turn = 3.0 * TAU * f64::from(k) / f64::from(steps);
            let r = 1.0 + 0.1 * turn;
            [0.0, 1.0].map(|z| DVec3::new(r * turn.cos(), r * turn.sin(), z))
        })
        .collect();
    let triangles =
        (0..steps).flat_map(|k| [[2 * k, 2 * k + 2, 2 * k + 3], [2 * k, 2 * k + 3, 2 * k + 1]]).collect();
    mesh(vertices, triangles)
}

/// Winding number of a mesh about a point: the sum of the solid angles of its triangles.
pub fn winding(mesh: &TriMesh, point: DVec3) -> f64 {
    let sum: f64 = (0..mesh.triangles().len())
        .map(|t| {
            let [a, b, c] = mesh.corners(t).map(|p| p - point);
            let (la, lb, lc) = (a.length(), b.length(), c.length());
            let over = a.dot(b.cross(c));
            2.0 * over.atan2(la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb)
        })
        .sum();
    sum / (2.0 * TAU)
}
