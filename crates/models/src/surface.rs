//! Models given by an implicit surface: the zero set of a scalar field, negative inside.
//!
//! [`triangulate`] turns such a field into a closed, outward-oriented mesh with as many triangles as asked
//! for. A first triangulation with the correct topology comes from [`crate::tetrahedra`] (marching
//! tetrahedra, closed by construction); [`crate::remesh`] then evens it out to nearly equilateral triangles
//! on the surface and adjusts the count. Organic and blended shapes (teeth, a hosel running into a blade) are
//! far easier to describe as fields than as stitched patches, and a clearance between two bodies is a
//! difference of their fields.
//!
//! Fields work in whatever unit suits the model (ours use millimetres); the caller scales the mesh.

use palpate_core::{TriMesh, glam::DVec3};

use crate::{halfedge::EditableMesh, remesh::Remesher, tetrahedra};

/// A body bounded by the zero set of a scalar field.
pub(crate) trait Surface {
    /// Value of the field: negative inside, positive outside, approximately the distance to the surface when
    /// close to it. Further away it may jump, but must not exceed [`Surface::STEEPNESS`] times the distance.
    fn value(&self, p: DVec3) -> f64;

    /// A box (lower, upper corner) that contains the surface.
    fn bounds(&self) -> (DVec3, DVec3);

    /// Size of the smallest detail whose topology matters: the first triangulation is no coarser than this.
    fn feature(&self) -> f64;

    /// Wanted edge length at `p` relative to the rest of the model.
    fn sizing(&self, _p: DVec3) -> f64 {
        1.0
    }

    /// Upper bound of the field's magnitude divided by the distance to the surface.
    const STEEPNESS: f64 = 2.0;

    /// The field's gradient where it has the given value, by forward differences.
    fn gradient(&self, p: DVec3, value: f64) -> DVec3 {
        let e = 1e-3 * self.feature();
        let along = |axis: DVec3| self.value(p + e * axis) - value;
        DVec3::new(along(DVec3::X), along(DVec3::Y), along(DVec3::Z)) / e
    }
}

/// Largest number of triangles that is remeshed as a whole; larger meshes are subdivided from coarser ones,
/// which is faster.
const MAX_REMESHED: usize = 400_000;

/// Meshes the surface with `triangles` triangles (one fewer if odd: a closed mesh has an even number);
/// multiplies the coordinates by `scale`.
pub(crate) fn triangulate(surface: &impl Surface, triangles: usize, scale: f64) -> TriMesh {
    let mut base = triangles;
    let mut subdivisions = 0;
    while base > MAX_REMESHED {
        base /= 4;
        subdivisions += 1;
    }
    let feature = surface.feature();
    let mut first = tetrahedra::extract(surface, feature);
    let cell = 1.3 * edge_length(surface, &first, base);
    if cell < feature {
        first = tetrahedra::extract(surface, cell);
    }
    let length = edge_length(surface, &first, base);
    let mut remesher = Remesher::new(surface, EditableMesh::new(&first), length);
    remesher.reach(base);
    for _ in 0..subdivisions {
        remesher.subdivide();
    }
    let mesh = remesher.into_mesh();
    let vertices = mesh.vertices().iter().map(|v| *v * scale).collect();
    TriMesh::new(vertices, mesh.triangles().to_vec()).expect("indices are unchanged")
}

/// The edge length of `triangles` equilateral triangles that cover the mesh, where the relative size is 1.
fn edge_length(surface: &impl Surface, mesh: &TriMesh, triangles: usize) -> f64 {
    let weighted: f64 = (0..mesh.triangles().len())
        .map(|t| {
            let [a, b, c] = mesh.corners(t);
            let size = surface.sizing((a + b + c) / 3.0);
            0.5 * (b - a).cross(c - a).length() / (size * size)
        })
        .sum();
    (4.0 / 3f64.sqrt() * weighted / triangles as f64).sqrt()
}

/// The lesser of `a` and `b`, rounded where they differ by less than `k`: a union with a fillet.
pub(crate) fn smooth_min(a: f64, b: f64, k: f64) -> f64 {
    let h = (k - (a - b).abs()).max(0.0);
    a.min(b) - 0.25 * h * h / k
}

/// The greater of `a` and `b`, rounded where they differ by less than `k`: an intersection with a rounded
/// edge.
pub(crate) fn smooth_max(a: f64, b: f64, k: f64) -> f64 {
    -smooth_min(-a, -b, k)
}

/// 0 below `from`, 1 above `to`, a cubic in between.
pub(crate) fn smooth_step(from: f64, to: f64, x: f64) -> f64 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::remesh::shape_quality;

    struct Sphere;
    impl Surface for Sphere {
        fn value(&self, p: DVec3) -> f64 {
            p.length() - 10.0
        }
        fn bounds(&self) -> (DVec3, DVec3) {
            (DVec3::splat(-10.0), DVec3::splat(10.0))
        }
        fn feature(&self) -> f64 {
            2.0
        }
    }

    struct Ring;
    impl Surface for Ring {
        fn value(&self, p: DVec3) -> f64 {
            DVec3::new(p.x, p.y, 0.0).length().mul_add(1.0, -10.0).hypot(p.z) - 4.0
        }
        fn bounds(&self) -> (DVec3, DVec3) {
            (DVec3::new(-14.0, -14.0, -4.0), DVec3::new(14.0, 14.0, 4.0))
        }
        fn feature(&self) -> f64 {
            1.5
        }
        fn sizing(&self, p: DVec3) -> f64 {
            if p.x > 0.0 { 1.0 } else { 2.0 }
        }
    }

    fn volume(mesh: &TriMesh) -> f64 {
        (0..mesh.triangles().len()).map(|t| mesh.corners(t)).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
    }

    fn edges(mesh: &TriMesh) -> std::collections::HashMap<(u32, u32), usize> {
        let mut edges = std::collections::HashMap::new();
        for [a, b, c] in mesh.triangles().iter().copied() {
            for edge in [(a, b), (b, c), (c, a)] {
                *edges.entry(edge).or_default() += 1;
            }
        }
        edges
    }

    fn euler(mesh: &TriMesh) -> i64 {
        let edges = edges(mesh);
        assert!(
            edges.iter().all(|((a, b), n)| *n == 1 && edges.contains_key(&(*b, *a))),
            "closed and oriented"
        );
        mesh.vertices().len() as i64 - edges.len() as i64 / 2 + mesh.triangles().len() as i64
    }

    fn worst_shape(mesh: &TriMesh) -> f64 {
        (0..mesh.triangles().len()).map(|t| shape_quality(mesh.corners(t))).fold(1.0, f64::min)
    }

    #[test]
    fn extraction_is_closed_and_faces_outwards() {
        for cell in [0.3, 1.0, 2.0] {
            let mesh = tetrahedra::extract(&Sphere, cell);
            assert_eq!(euler(&mesh), 2);
            let exact = 4.0 / 3.0 * std::f64::consts::PI * 1e3;
            assert!((volume(&mesh) / exact - 1.0).abs() < 0.05, "{} of {exact}", volume(&mesh));
        }
        assert_eq!(euler(&tetrahedra::extract(&Ring, 1.0)), 0);
    }

    #[test]
    fn count_is_met_with_good_triangles() {
        for n in [200, 1000, 5001, 30_000] {
            let mesh = triangulate(&Sphere, n, 0.1);
            assert_eq!(mesh.triangles().len(), n & !1);
            assert_eq!(euler(&mesh), 2);
            assert!(worst_shape(&mesh) > 0.5, "{n}: {}", worst_shape(&mesh));
            assert!(mesh.vertices().iter().all(|v| (v.length() - 1.0).abs() < 1e-4));
        }
        let ring = triangulate(&Ring, 6000, 1.0);
        assert_eq!((ring.triangles().len(), euler(&ring)), (6000, 0));
        assert!(worst_shape(&ring) > 0.4, "{}", worst_shape(&ring));
    }

    #[test]
    fn many_triangles_are_subdivided_to_the_count() {
        let mesh = triangulate(&Sphere, 500_000, 1.0);
        assert!(mesh.triangles().len().abs_diff(500_000) < 8);
        assert!(worst_shape(&mesh) > 0.5);
    }
}
