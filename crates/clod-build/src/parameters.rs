//! The parameters of the error metrics (§3.3.5) that are known before any simplification: the resolution r of the full
//! mesh and the support area D of its vertices. Surface deviation s and Hausdorff distance h are 0 there.

use glam::DVec3;
use palpate_core::TriMesh;
use palpate_core::mesh::Adjacency;

/// r of the full mesh, 1/m: the inverse of its shortest edge, the finest sampling there is. (Eq. 3.1 measures edges in
/// projection on a low-resolution mesh; on the full mesh, of which no edge has been collapsed, the edge itself is the
/// bound.) Edges shorter than `negligible` are duplicate vertices rather than samples.
pub(crate) fn finest_resolution(mesh: &TriMesh, adjacency: &Adjacency, negligible: f64) -> f64 {
    let points = mesh.vertices();
    let shortest = adjacency
        .edges()
        .iter()
        .map(|edge| points[edge[0] as usize].distance(points[edge[1] as usize]))
        .filter(|length| *length > negligible)
        .fold(f64::INFINITY, f64::min);
    // Without any edge there is one sample to the size of the object.
    if shortest.is_finite() { 1.0 / shortest } else { negligible.recip() }
}

/// D of every vertex, m²: the area, projected on the tangent plane of the vertex, of those parts of its faces that lie
/// within `distance` (m) of that plane, for faces whose normal is within `cone` (rad) of the vertex's.
///
/// The dissertation leaves open how a face counts that is partly within the distance, and the cone's half angle. Faces
/// are cut at the distance, so that D does not jump as vertices move. The vertex normal is the sum of the face normals,
/// weighted with the angles at the vertex, so that it does not depend on how flat faces are divided.
pub(crate) fn support_areas(mesh: &TriMesh, adjacency: &Adjacency, distance: f64, cone: f64) -> Vec<f64> {
    let least_cosine = cone.cos();
    (0..mesh.vertices().len() as u32)
        .map(|v| {
            let here = mesh.vertices()[v as usize];
            let fan = || adjacency.vertex_triangles(v).iter().map(|t| around(mesh, *t, v, here));
            let normal = fan()
                .map(|[p, q]| p.cross(q).normalize_or_zero() * p.angle_between(q).max(0.0))
                .sum::<DVec3>();
            let normal = normal.normalize_or_zero();
            fan()
                .filter(|[p, q]| p.cross(*q).normalize_or_zero().dot(normal) >= least_cosine)
                .map(|[p, q]| projected_area(p, q, normal, distance))
                .sum()
        })
        .collect()
}

/// The other two corners of a triangle as seen from its corner `v`, in order.
fn around(mesh: &TriMesh, triangle: u32, v: u32, here: DVec3) -> [DVec3; 2] {
    let corners = mesh.triangles()[triangle as usize];
    let k = corners.iter().position(|c| *c == v).unwrap_or(0);
    [1, 2].map(|step| mesh.vertices()[corners[(k + step) % 3] as usize] - here)
}

/// The area of the triangle (0, p, q) where it is within `distance` of the plane through 0, projected on that plane.
fn projected_area(p: DVec3, q: DVec3, normal: DVec3, distance: f64) -> f64 {
    let mut polygon = vec![DVec3::ZERO, p, q];
    for side in [1.0, -1.0] {
        let height = |x: DVec3| side * normal.dot(x) - distance;
        let mut cut = Vec::with_capacity(polygon.len() + 1);
        for k in 0..polygon.len() {
            let (a, b) = (polygon[k], polygon[(k + 1) % polygon.len()]);
            let (ha, hb) = (height(a), height(b));
            if ha <= 0.0 {
                cut.push(a);
            }
            if (ha <= 0.0) != (hb <= 0.0) {
                cut.push(a + (b - a) * (ha / (ha - hb)));
            }
        }
        polygon = cut;
    }
    let doubled: f64 =
        (0..polygon.len()).map(|k| polygon[k].cross(polygon[(k + 1) % polygon.len()]).dot(normal)).sum();
    0.5 * doubled.abs()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_3;

    fn cube() -> TriMesh {
        let vertices = (0..8)
            .map(|k| DVec3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2 & 1)))
            .collect();
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
        TriMesh::new(vertices, triangles).unwrap()
    }

    #[test]
    fn corner_of_a_cube() {
        let mesh = cube();
        let adjacency = mesh.adjacency();
        assert_eq!(finest_resolution(&mesh, &adjacency, 1e-9), 1.0);
        // Each face at a corner is cut at a depth d: a right isosceles triangle with legs of √3 d, at 54.7° to the
        // tangent plane, or all of what it has there when d is large.
        let distance = 0.1;
        for area in support_areas(&mesh, &adjacency, distance, FRAC_PI_3) {
            let expected = 3.0 * 0.5 * 3.0 * distance * distance / 3f64.sqrt();
            assert!((area - expected).abs() < 1e-14, "{area} {expected}");
        }
        let all: f64 = support_areas(&mesh, &adjacency, 10.0, FRAC_PI_3).iter().sum();
        assert!((all - 3.0 * 6.0 / 3f64.sqrt()).abs() < 1e-12, "each triangle counts at each corner");
        assert!(
            support_areas(&mesh, &adjacency, 10.0, 0.9).iter().all(|a| *a == 0.0),
            "faces are 54.7° = 0.955 off"
        );
    }

    #[test]
    fn flat_fan_counts_whole_whatever_the_distance() {
        let ring = (0..12).map(|k| 2.0 * FRAC_PI_3 / 4.0 * f64::from(k));
        let mut vertices: Vec<DVec3> = ring.map(|a| DVec3::new(a.cos(), a.sin(), 0.0)).collect();
        vertices.push(DVec3::ZERO);
        let triangles = (0..12).map(|k| [12, k, (k + 1) % 12]).collect();
        let mesh = TriMesh::new(vertices, triangles).unwrap();
        let area = support_areas(&mesh, &mesh.adjacency(), 1e-9, 0.1)[12];
        assert!((area - 3.0).abs() < 1e-12, "{area}");
    }
}
