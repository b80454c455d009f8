//! Shapes that tests of repair share, and what they measure on meshes.

use std::f64::consts::PI;

use palpate_core::TriMesh;
use palpate_core::glam::{DQuat, DVec3};
use palpate_mesh_io::{RepairSummary, repair, self_intersections};

pub fn area(mesh: &TriMesh) -> f64 {
    let area = |[a, b, c]: [DVec3; 3]| 0.5 * (b - a).cross(c - a).length();
    (0..mesh.triangles().len()).map(|t| area(mesh.corners(t))).sum()
}

/// Checks that the mesh has no defects.
pub fn assert_sound(mesh: &TriMesh, name: &str) {
    let report = mesh.validate();
    assert!(report.manifold && report.oriented, "{name}: {report:?}");
    let wrong = [report.degenerate, report.duplicate, report.nonfinite, report.unreferenced];
    assert_eq!(wrong, [0; 4], "{name}: {report:?}");
    assert!(!report.closed || report.volume >= 0.0, "{name}: {report:?}");
    assert_eq!(self_intersections(mesh).count, 0, "{name}");
}

/// Repairs a mesh; checks that the result is sound and that repairing it again changes nothing.
pub fn repaired(mesh: &TriMesh, name: &str) -> (TriMesh, RepairSummary) {
    let (result, summary) = repair(mesh);
    assert_sound(&result, name);
    let (again, second) = repair(&result);
    assert_eq!(second, Default::default(), "{name}, after {summary:?}");
    assert_eq!(again, result, "{name}");
    (result, summary)
}

/// A closed ball of about 4 n² triangles.
pub fn ball(n: u32, center: DVec3, radius: f64) -> TriMesh {
    let at = |i: u32, j: u32| match i {
        0 => 0,
        i if i == n => 1,
        i => 2 + (i - 1) * 2 * n + j % (2 * n),
    };
    let mut vertices = vec![DVec3::Z, -DVec3::Z];
    for i in 1..n {
        vertices.extend((0..2 * n).map(|j| {
            let (polar, turn) = (PI * f64::from(i) / f64::from(n), PI * f64::from(j) / f64::from(n));
            DVec3::new(polar.sin() * turn.cos(), polar.sin() * turn.sin(), polar.cos())
        }));
    }
    let quads = (0..n)
        .flat_map(|i| (0..2 * n).map(move |j| [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]));
    let triangles = quads
        .flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]])
        .filter(|[a, b, c]| a != b && b != c && c != a)
        .collect();
    TriMesh::new(vertices.iter().map(|p| center + radius * *p).collect(), triangles).unwrap()
}

pub fn together(meshes: &[TriMesh]) -> TriMesh {
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for mesh in meshes {
        let first = vertices.len() as u32;
        vertices.extend_from_slice(mesh.vertices());
        triangles.extend(mesh.triangles().iter().map(|t| t.map(|v| v + first)));
    }
    TriMesh::new(vertices, triangles).unwrap()
}

/// A box with an edge that runs from the corner `low` to `high`, turned by `turn`, whose faces are cut along
/// one diagonal or the other, by the bits of `diagonals`.
pub fn cuboid(low: DVec3, high: DVec3, diagonals: u32, turn: DQuat) -> TriMesh {
    const QUADS: [[u32; 4]; 6] =
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let pick = |i: u32, axis: usize| if i >> axis & 1 == 1 { high[axis] } else { low[axis] };
    let vertices = (0..8).map(|i| turn * DVec3::new(pick(i, 0), pick(i, 1), pick(i, 2))).collect();
    let triangles = (0..6).flat_map(|face| {
        let [a, b, c, d] = QUADS[face];
        if diagonals >> face & 1 == 0 { [[a, b, c], [a, c, d]] } else { [[b, c, d], [b, d, a]] }
    });
    TriMesh::new(vertices, triangles.collect()).unwrap()
}

/// Generalised winding number of a mesh about a point: the sum of the triangles' solid angles (Van Oosterom
/// and Strackee 1983) over 4π.
pub fn winding_number(mesh: &TriMesh, point: DVec3) -> f64 {
    let angle = |t: usize| {
        let [a, b, c] = mesh.corners(t).map(|p| p - point);
        let (la, lb, lc) = (a.length(), b.length(), c.length());
        2.0 * a.dot(b.cross(c)).atan2(la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb)
    };
    (0..mesh.triangles().len()).map(angle).sum::<f64>() / (4.0 * PI)
}
