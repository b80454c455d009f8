//! Small meshes for tests.

use glam::{DQuat, DVec3};
use rand::{RngExt, rngs::StdRng};

use super::TriMesh;

/// A box between two corners.
pub fn cuboid(low: DVec3, high: DVec3) -> TriMesh {
    let vertices = (0..8)
        .map(|i| DVec3::new([low.x, high.x][i & 1], [low.y, high.y][i >> 1 & 1], [low.z, high.z][i >> 2]))
        .collect();
    let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    TriMesh::new(vertices, quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect()).unwrap()
}

/// The corner tetrahedron of the unit cube.
pub fn tetrahedron() -> TriMesh {
    let vertices = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
    TriMesh::new(vertices, vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]).unwrap()
}

/// A sphere: an octahedron's triangles split in four `levels` times.
pub fn sphere(radius: f64, levels: u32) -> TriMesh {
    let mut triangles: Vec<[DVec3; 3]> = (0..8)
        .map(|i| {
            let sign = |bit: usize| if i >> bit & 1 == 0 { 1.0 } else { -1.0 };
            let [a, b, c] = [DVec3::X * sign(0), DVec3::Y * sign(1), DVec3::Z * sign(2)];
            if sign(0) * sign(1) * sign(2) > 0.0 { [a, b, c] } else { [a, c, b] }
        })
        .collect();
    for _ in 0..levels {
        triangles = (triangles.iter())
            .flat_map(|&[a, b, c]| {
                let [d, e, f] = [(a + b).normalize(), (b + c).normalize(), (c + a).normalize()];
                [[a, d, f], [d, b, e], [f, e, c], [d, e, f]]
            })
            .collect();
    }
    let corners: Vec<DVec3> = triangles.into_iter().flatten().collect();
    let mut vertices: Vec<DVec3> = Vec::new();
    let mut index = std::collections::HashMap::new();
    let triangles = (corners.iter())
        .map(|p| {
            // Adding 0 makes −0 and 0 the same key.
            *index.entry((*p + DVec3::ZERO).to_array().map(f64::to_bits)).or_insert_with(|| {
                vertices.push(*p * radius);
                vertices.len() as u32 - 1
            })
        })
        .collect::<Vec<_>>();
    TriMesh::new(vertices, triangles.as_chunks::<3>().0.to_vec()).unwrap()
}

/// Several meshes as one.
pub fn together(parts: &[TriMesh]) -> TriMesh {
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for part in parts {
        let first = vertices.len() as u32;
        vertices.extend(part.vertices());
        triangles.extend(part.triangles().iter().map(|t| t.map(|v| v + first)));
    }
    TriMesh::new(vertices, triangles).unwrap()
}

/// The same surface facing the other side.
pub fn reversed(mesh: &TriMesh) -> TriMesh {
    TriMesh::new(mesh.vertices().to_vec(), mesh.triangles().iter().map(|&[a, b, c]| [a, c, b]).collect())
        .unwrap()
}

/// The mesh with its vertices moved.
pub fn mapped(mesh: &TriMesh, mut map: impl FnMut(DVec3) -> DVec3) -> TriMesh {
    TriMesh::new(mesh.vertices().iter().map(|p| map(*p)).collect(), mesh.triangles().to_vec()).unwrap()
}

/// Triangles between random ones of a few vertices, with every defect of connectivity.
pub fn tangle(random: &mut StdRng, vertices: u32, triangles: usize) -> TriMesh {
    let positions =
        (0..vertices).map(|_| DVec3::from_array([0; 3].map(|_| random.random_range(-1.0..1.0)))).collect();
    let triangles = (0..triangles).map(|_| [0; 3].map(|_| random.random_range(0..vertices))).collect();
    TriMesh::new(positions, triangles).unwrap()
}

/// A random orientation.
pub fn rotation(random: &mut StdRng) -> DQuat {
    DQuat::from_scaled_axis(DVec3::from_array([0; 3].map(|_| random.random_range(-3.0..3.0))))
}
