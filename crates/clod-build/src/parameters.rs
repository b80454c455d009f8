//! The parameters of the error metrics (§3.3.5) that are known before any simplification: the resolution r of
//! the full mesh and the support area D of its vertices. Surface deviation s and Hausdorff distance h are 0
//! there.

use glam::DVec3;
use palpate_core::TriMesh;
use palpate_core::mesh::Adjacency;
use rayon::prelude::*;

/// r of the full mesh, 1/m: the inverse of its shortest edge, the finest sampling distance. (Eq. 3.1 measures
/// edges in projection on a low-resolution mesh; on the full mesh, of which no edge has been collapsed, the
/// edge itself is the bound.) Edges shorter than `negligible` are duplicate vertices rather than samples.
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

/// Limits of the area around a vertex that counts as one area of contact.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Support {
    /// Largest distance from the tangent plane of the vertex, m.
    pub distance: f64,
    /// Largest distance from the vertex, m.
    pub radius: f64,
    /// Half angle of the cone about the vertex normal in which the face normals lie, rad.
    pub cone: f64,
}

/// Largest number of faces visited around a vertex. With fewer, D of finely divided flat regions is too
/// small.
const MAX_FACES: usize = 4096;

/// D of every vertex, m²: the area, projected on the tangent plane of the vertex, of the faces around it that
/// lie within a distance of that plane, have a normal within a cone about the vertex normal, and are
/// connected to the vertex by such faces.
///
/// §3.3.5 speaks of the faces incident to the vertex. Those are smaller the finer a mesh is divided, so that
/// the same contact would be refined the further the more triangles an object has (s* = φ / D); the area that
/// can be in contact is the object's, not the mesh's. The dissertation also leaves open how a face that is
/// partly within the distance counts, how far from the vertex faces count, and the cone's half angle. Faces
/// are cut at the distance, so that D does not jump as vertices move, and those with a corner within the
/// radius count. The vertex normal is the sum of the normals of its faces, weighted with the angles at the
/// vertex, so that it does not depend on how flat faces are divided.
pub(crate) fn support_areas(mesh: &TriMesh, adjacency: &Adjacency, support: &Support) -> Vec<f64> {
    (0..mesh.vertices().len() as u32)
        .into_par_iter()
        .map_init(
            || Region::new(mesh.triangles().len()),
            |region, v| region.area(mesh, adjacency, v, support),
        )
        .collect()
}

/// The faces around a vertex that a search has reached.
struct Region {
    /// Last vertex from which each face was reached, plus one.
    reached: Vec<u32>,
    faces: Vec<u32>,
}

impl Region {
    fn new(triangles: usize) -> Self {
        Self { reached: vec![0; triangles], faces: Vec::new() }
    }

    fn area(&mut self, mesh: &TriMesh, adjacency: &Adjacency, v: u32, support: &Support) -> f64 {
        let here = mesh.vertices()[v as usize];
        let around = adjacency.vertex_triangles(v);
        let normal: DVec3 = around
            .iter()
            .map(|t| {
                let [p, q] = others(mesh, *t, v, here);
                p.cross(q).normalize_or_zero() * p.angle_between(q).max(0.0)
            })
            .sum();
        let normal = normal.normalize_or_zero();
        let least_cosine = support.cone.cos();
        self.faces.clear();
        for &face in around {
            self.reached[face as usize] = v + 1;
            self.faces.push(face);
        }
        // Breadth-first over the faces that count, starting from those at the vertex.
        let (mut sum, mut next) = (0.0, 0);
        while next < self.faces.len().min(MAX_FACES) {
            let face = self.faces[next];
            next += 1;
            let [p, q, r] = mesh.corners(face as usize).map(|corner| corner - here);
            let faces_out = (q - p).cross(r - p).normalize_or_zero().dot(normal) >= least_cosine;
            let near =
                [p, q, r].iter().any(|corner| corner.length_squared() <= support.radius * support.radius);
            if !(faces_out && near) {
                continue;
            }
            let area = projected_area([p, q, r], normal, support.distance);
            if area == 0.0 {
                continue;
            }
            sum += area;
            for neighbour in (0..3).filter_map(|side| adjacency.neighbour(face, side)) {
                if std::mem::replace(&mut self.reached[neighbour as usize], v + 1) != v + 1 {
                    self.faces.push(neighbour);
                }
            }
        }
        sum
    }
}

/// The other two corners of a triangle as seen from its corner `v`, in order.
fn others(mesh: &TriMesh, triangle: u32, v: u32, here: DVec3) -> [DVec3; 2] {
    let corners = mesh.triangles()[triangle as usize];
    let k = corners.iter().position(|c| *c == v).unwrap_or(0);
    [1, 2].map(|step| mesh.vertices()[corners[(k + step) % 3] as usize] - here)
}

/// The area of a triangle where it is within `distance` of the plane through 0, projected on that plane.
fn projected_area(corners: [DVec3; 3], normal: DVec3, distance: f64) -> f64 {
    let doubled = |polygon: &[DVec3]| -> f64 {
        let count = polygon.len();
        (0..count).map(|k| polygon[k].cross(polygon[(k + 1) % count]).dot(normal)).sum()
    };
    let heights = corners.map(|corner| normal.dot(corner));
    if heights.iter().all(|height| height.abs() <= distance) {
        return 0.5 * doubled(&corners).abs();
    }
    // Each of the two cuts adds a corner at most.
    let mut polygon = [DVec3::ZERO; 5];
    polygon[..3].copy_from_slice(&corners);
    let mut count = 3;
    for side in [1.0, -1.0] {
        let height = |x: DVec3| side * normal.dot(x) - distance;
        let (mut cut, mut kept) = ([DVec3::ZERO; 5], 0);
        for k in 0..count {
            let (a, b) = (polygon[k], polygon[(k + 1) % count]);
            let (ha, hb) = (height(a), height(b));
            if ha <= 0.0 {
                cut[kept] = a;
                kept += 1;
            }
            if (ha <= 0.0) != (hb <= 0.0) {
                cut[kept] = a + (b - a) * (ha / (ha - hb));
                kept += 1;
            }
        }
        (polygon, count) = (cut, kept);
    }
    0.5 * doubled(&polygon[..count]).abs()
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

    fn areas(mesh: &TriMesh, distance: f64, cone: f64) -> Vec<f64> {
        support_areas(mesh, &mesh.adjacency(), &Support { distance, radius: 100.0, cone })
    }

    #[test]
    fn corner_of_a_cube() {
        let mesh = cube();
        let adjacency = mesh.adjacency();
        assert_eq!(finest_resolution(&mesh, &adjacency, 1e-9), 1.0);
        // Each face at a corner is cut at a depth d: a right isosceles triangle with legs of √3 d, at 54.7°
        // to the tangent plane, or all of what it has there when d is large.
        let distance = 0.1;
        for area in areas(&mesh, distance, FRAC_PI_3) {
            let expected = 3.0 * 0.5 * 3.0 * distance * distance / 3f64.sqrt();
            assert!((area - expected).abs() < 1e-14, "{area} {expected}");
        }
        let all: f64 = areas(&mesh, 10.0, FRAC_PI_3).iter().sum();
        assert!((all - 8.0 * 3.0 / 3f64.sqrt()).abs() < 1e-12, "three whole faces at each corner");
        assert!(areas(&mesh, 10.0, 0.9).iter().all(|a| *a == 0.0), "faces are 54.7° = 0.955 off");
    }

    #[test]
    fn flat_fan_counts_whole_whatever_the_distance() {
        let ring = (0..12).map(|k| 2.0 * FRAC_PI_3 / 4.0 * f64::from(k));
        let mut vertices: Vec<DVec3> = ring.map(|a| DVec3::new(a.cos(), a.sin(), 0.0)).collect();
        vertices.push(DVec3::ZERO);
        let triangles = (0..12).map(|k| [12, k, (k + 1) % 12]).collect();
        let mesh = TriMesh::new(vertices, triangles).unwrap();
        let area = areas(&mesh, 1e-9, 0.1)[12];
        assert!((area - 3.0).abs() < 1e-12, "{area}");
    }
}
