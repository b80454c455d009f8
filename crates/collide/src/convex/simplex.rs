//! Simplices of points of the Minkowski difference a − b, and the point of a simplex that is nearest to the
//! origin.
//!
//! The nearest point is found by testing the faces, with barycentric coordinates as in Ericson (2005,
//! §5.1 and §9.5): it lies on a face whose plane is well defined and whose barycentric coordinates are all
//! non-negative, otherwise on the best of the face's edges. A simplex whose height is lost in rounding is
//! treated as the union of its faces, so that flat and needle-like hulls need no special case.

use palpate_core::glam::DVec3;

use crate::tolerances::{FLAT_SIMPLEX, OUTSIDE_FACE};

/// A point of the Minkowski difference with its two hull vertices.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vertex {
    /// Vertex of a minus vertex of b, in a's frame, m.
    pub difference: DVec3,
    /// Index of the vertex of a.
    pub a: u32,
    /// Index of the vertex of b.
    pub b: u32,
}

/// Up to four points of the Minkowski difference, with barycentric weights of the point of their hull that is
/// nearest to the origin.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Simplex {
    pub(super) vertices: [Vertex; 4],
    pub(super) weights: [f64; 4],
    pub(super) len: usize,
}

impl Simplex {
    /// The vertices of the face that the nearest point lies on.
    pub fn vertices(&self) -> &[Vertex] {
        &self.vertices[..self.len]
    }

    /// Barycentric weights of the vertices: positive, with sum 1.
    pub fn weights(&self) -> &[f64] {
        &self.weights[..self.len]
    }

    pub(super) fn contains(&self, vertex: &Vertex) -> bool {
        self.vertices().iter().any(|v| v.a == vertex.a && v.b == vertex.b)
    }

    pub(super) fn push(&mut self, vertex: Vertex) {
        self.vertices[self.len] = vertex;
        self.len += 1;
    }

    /// Reduces the simplex to the face that its point nearest to the origin lies on, **v** = Σ λᵢ **p**ᵢ with
    /// all λᵢ > 0, and returns that point. `None` if the origin is inside the tetrahedron, which is then kept
    /// whole, with the origin's own weights.
    pub(super) fn reduce(&mut self) -> Option<DVec3> {
        let p = self.vertices.map(|v| v.difference);
        let weights = match self.len {
            0 | 1 => [1.0, 0.0, 0.0, 0.0],
            2 => {
                let [u, v] = on_segment(p[0], p[1]);
                [u, v, 0.0, 0.0]
            }
            3 => {
                let [u, v, w] = nearest_on_triangle(p[0], p[1], p[2]);
                [u, v, w, 0.0]
            }
            _ => match on_tetrahedron(&p) {
                Nearest::OnFace(weights) => weights,
                Nearest::Inside(weights) => {
                    self.weights = weights;
                    return None;
                }
            },
        };
        let mut kept = 0;
        let mut nearest = DVec3::ZERO;
        for index in 0..self.len {
            if weights[index] > 0.0 {
                self.vertices[kept] = self.vertices[index];
                self.weights[kept] = weights[index];
                nearest += weights[index] * p[index];
                kept += 1;
            }
        }
        self.len = kept;
        Some(nearest)
    }
}

impl Simplex {
    /// Distance of the origin from the nearest face of the tetrahedron around it, m; 0 if the simplex is not
    /// a tetrahedron. Overlapping hulls keep overlapping until they have moved by this distance.
    pub(crate) fn depth(&self) -> f64 {
        if self.len < 4 {
            return 0.0;
        }
        let p = self.vertices.map(|v| v.difference);
        [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]
            .map(|[i, j, k]: [usize; 3]| (p[j] - p[i]).cross(p[k] - p[i]).normalize_or_zero().dot(p[i]).abs())
            .into_iter()
            .fold(f64::INFINITY, f64::min)
    }

    /// The nearest point **v** with an accurate direction. For a triangle it is the normal **n**
    /// scaled to |**v**|, which is accurate even if **v** is so close to the origin that its own
    /// direction is lost in rounding.
    pub(super) fn axis(&self, nearest: DVec3) -> DVec3 {
        if self.len != 3 {
            return nearest;
        }
        let [a, b, c, _] = self.vertices.map(|v| v.difference);
        let (ab, ac) = (b - a, c - a);
        let normal = ab.cross(ac);
        let (area, distance) = (normal.length_squared(), nearest.length_squared());
        // If |n| ≤ |v| · longest edge, the triangle is a needle, or small against its distance, and v is more
        // accurate.
        if area <= distance * ab.length_squared().max(ac.length_squared()) {
            return nearest;
        }
        normal * (distance / area).sqrt().copysign(normal.dot(a))
    }
}

/// Barycentric weights of the point of segment ab that is nearest to the origin: a + t (b − a) with
/// t = −a · (b − a) / |b − a|², clamped to 0 to 1.
fn on_segment(a: DVec3, b: DVec3) -> [f64; 2] {
    let edge = b - a;
    let along = -a.dot(edge);
    let length = edge.length_squared();
    if along <= 0.0 || length == 0.0 {
        [1.0, 0.0]
    } else if along >= length {
        [0.0, 1.0]
    } else {
        let t = along / length;
        [1.0 - t, t]
    }
}

/// Barycentric weights of the point of triangle abc that is nearest to the origin.
pub(crate) fn nearest_on_triangle(a: DVec3, b: DVec3, c: DVec3) -> [f64; 3] {
    let (ab, ac) = (b - a, c - a);
    let normal = ab.cross(ac);
    let area = normal.length_squared();
    let longest = ab.length_squared().max(ac.length_squared()).max((c - b).length_squared());
    // Barycentric coordinates of the origin's projection on the plane: with n = ab × ac, v = (ac × a) · n /
    // |n|² and w = (a × ab) · n / |n|² are the areas of the triangles opposite b and c over that of abc.
    if area > FLAT_SIMPLEX * FLAT_SIMPLEX * longest * longest {
        let (v, w) = (ac.cross(a).dot(normal) / area, a.cross(ab).dot(normal) / area);
        let u = 1.0 - v - w;
        if u >= 0.0 && v >= 0.0 && w >= 0.0 {
            return [u, v, w];
        }
    }
    let [ab0, ab1] = on_segment(a, b);
    let [bc0, bc1] = on_segment(b, c);
    let [ca0, ca1] = on_segment(c, a);
    let near_ab = (ab0 * a + ab1 * b).length_squared();
    let near_bc = (bc0 * b + bc1 * c).length_squared();
    let near_ca = (ca0 * c + ca1 * a).length_squared();
    if near_ab <= near_bc && near_ab <= near_ca {
        [ab0, ab1, 0.0]
    } else if near_bc <= near_ca {
        [0.0, bc0, bc1]
    } else {
        [ca1, 0.0, ca0]
    }
}

/// Weights of the point of a tetrahedron that is nearest to the origin.
enum Nearest {
    /// A point of a face.
    OnFace([f64; 4]),
    /// The origin itself.
    Inside([f64; 4]),
}

/// The point of a tetrahedron that is nearest to the origin. Faces are numbered by the vertex opposite.
fn on_tetrahedron(p: &[DVec3; 4]) -> Nearest {
    const FACES: [[usize; 3]; 4] = [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]];
    let [ab, ac, ad] = [p[1] - p[0], p[2] - p[0], p[3] - p[0]];
    let (cross_b, cross_c, cross_d) = (ac.cross(ad), ad.cross(ab), ab.cross(ac));
    let volume = ab.dot(cross_b);
    let longest = ab.length_squared().max(ac.length_squared()).max(ad.length_squared());
    let widest = cross_b
        .length_squared()
        .max(cross_c.length_squared())
        .max(cross_d.length_squared())
        .max((p[2] - p[1]).cross(p[3] - p[1]).length_squared());
    // The smallest height is |volume| / largest face (volume and areas as products of edges, six and two
    // times as large).
    let solid = volume * volume > FLAT_SIMPLEX * FLAT_SIMPLEX * longest * widest;
    let mut candidate = [true; 4];
    if solid {
        // The origin's barycentric coordinates by Cramer's rule: the volume with one edge replaced, over the
        // volume.
        let origin = -p[0];
        let (b, c, d) =
            (origin.dot(cross_b) / volume, origin.dot(cross_c) / volume, origin.dot(cross_d) / volume);
        let coordinates = [1.0 - b - c - d, b, c, d];
        if coordinates.iter().all(|&x| x >= 0.0) {
            return Nearest::Inside(coordinates);
        }
        // The origin is outside of the nearest face: the coordinate of the opposite vertex is negative. Faces
        // too close to decide are kept.
        candidate = coordinates.map(|x| x < OUTSIDE_FACE);
    }
    let mut best = (f64::INFINITY, [0.0; 4]);
    for (face, [i, j, k]) in FACES.into_iter().enumerate() {
        if !candidate[face] {
            continue;
        }
        let [u, v, w] = nearest_on_triangle(p[i], p[j], p[k]);
        let distance = (u * p[i] + v * p[j] + w * p[k]).length_squared();
        if distance < best.0 {
            let mut weights = [0.0; 4];
            (weights[i], weights[j], weights[k]) = (u, v, w);
            best = (distance, weights);
        }
    }
    Nearest::OnFace(best.1)
}
