//! Brute-force answers to test the query against: every pair of triangles, by the textbook formulas for
//! points, segments and triangles (Ericson 2005, chapter 5), without the crate's own code.
#![allow(dead_code)]

use palpate_core::glam::DVec3;
use palpate_core::{Pose, TriMesh};

pub type Triangle = [DVec3; 3];

pub fn placed(mesh: &TriMesh, pose: &Pose) -> Vec<Triangle> {
    (0..mesh.triangles().len()).map(|t| mesh.corners(t).map(|c| pose.transform_point(c))).collect()
}

pub fn point_triangle(p: DVec3, [a, b, c]: Triangle) -> DVec3 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let sum = va + vb + vc;
    a + ab * (vb / sum) + ac * (vc / sum)
}

pub fn point_segment(p: DVec3, [a, b]: [DVec3; 2]) -> DVec3 {
    let edge = b - a;
    let length = edge.length_squared();
    if length == 0.0 { a } else { a + edge * ((p - a).dot(edge) / length).clamp(0.0, 1.0) }
}

pub fn segments([p, q]: [DVec3; 2], [r, s]: [DVec3; 2]) -> (DVec3, DVec3) {
    let mut best = (p, point_segment(p, [r, s]));
    let mut offer = |x: DVec3, y: DVec3| {
        if x.distance_squared(y) < best.0.distance_squared(best.1) {
            best = (x, y);
        }
    };
    offer(q, point_segment(q, [r, s]));
    offer(point_segment(r, [p, q]), r);
    offer(point_segment(s, [p, q]), s);
    let (u, v, w) = (q - p, s - r, p - r);
    let det = u.dot(u) * v.dot(v) - u.dot(v) * u.dot(v);
    if det > 0.0 {
        let s1 = (u.dot(v) * v.dot(w) - v.dot(v) * u.dot(w)) / det;
        let s2 = (u.dot(u) * v.dot(w) - u.dot(v) * u.dot(w)) / det;
        if (0.0..=1.0).contains(&s1) && (0.0..=1.0).contains(&s2) {
            offer(p + u * s1, r + v * s2);
        }
    }
    best
}

/// Whether a segment passes through a triangle (Möller and Trumbore's test).
pub fn segment_crosses([p, q]: [DVec3; 2], [a, b, c]: Triangle) -> bool {
    let (direction, e1, e2) = (q - p, b - a, c - a);
    let h = direction.cross(e2);
    let det = e1.dot(h);
    if det == 0.0 {
        return false;
    }
    let s = p - a;
    let u = s.dot(h) / det;
    let k = s.cross(e1);
    let v = direction.dot(k) / det;
    let t = e2.dot(k) / det;
    u >= 0.0 && v >= 0.0 && u + v <= 1.0 && (0.0..=1.0).contains(&t)
}

pub fn edges(t: Triangle) -> [[DVec3; 2]; 3] {
    [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]]
}

pub fn intersect(t: Triangle, u: Triangle) -> bool {
    edges(t).into_iter().any(|e| segment_crosses(e, u)) || edges(u).into_iter().any(|e| segment_crosses(e, t))
}

/// Nearest points of two triangles that do not pass through each other.
pub fn nearest(t: Triangle, u: Triangle) -> (DVec3, DVec3) {
    let mut best = (t[0], u[0]);
    let mut offer = |(x, y): (DVec3, DVec3)| {
        if x.distance_squared(y) < best.0.distance_squared(best.1) {
            best = (x, y);
        }
    };
    for i in 0..3 {
        offer((t[i], point_triangle(t[i], u)));
        offer((point_triangle(u[i], t), u[i]));
        for j in 0..3 {
            offer(segments(edges(t)[i], edges(u)[j]));
        }
    }
    best
}

pub fn distance(t: Triangle, u: Triangle) -> f64 {
    if intersect(t, u) {
        return 0.0;
    }
    let (x, y) = nearest(t, u);
    x.distance(y)
}

fn sphere(t: Triangle) -> (DVec3, f64) {
    let center = (t[0] + t[1] + t[2]) / 3.0;
    (center, t.iter().map(|c| c.distance(center)).fold(0.0, f64::max))
}

/// All pairs of triangles within a distance: indices and distance (0 where they intersect). Sorted along x,
/// so that pairs that are further apart than that along x alone are skipped.
pub fn pairs_within(a: &[Triangle], b: &[Triangle], tolerance: f64) -> Vec<(usize, usize, f64)> {
    let mut found = Vec::new();
    let mut spheres: Vec<_> = b.iter().map(|t| sphere(*t)).enumerate().collect();
    spheres.sort_by(|p, q| p.1.0.x.total_cmp(&q.1.0.x));
    let largest = spheres.iter().map(|s| s.1.1).fold(0.0, f64::max);
    for (i, t) in a.iter().enumerate() {
        let (center, radius) = sphere(*t);
        let reach = (radius + largest + tolerance) * (1.0 + 1e-9);
        let first = spheres.partition_point(|s| s.1.0.x < center.x - reach);
        for (j, (other, other_radius)) in &spheres[first..] {
            if other.x > center.x + reach {
                break;
            }
            if center.distance(*other) > (radius + other_radius + tolerance) * (1.0 + 1e-9) {
                continue;
            }
            let d = distance(*t, b[*j]);
            if d <= tolerance {
                found.push((i, *j, d));
            }
        }
    }
    found
}

/// Unit normal of a triangle; zero for one without area.
pub fn normal(t: Triangle) -> DVec3 {
    (t[1] - t[0]).cross(t[2] - t[0]).normalize_or_zero()
}

/// Whether a point is inside a closed mesh: its winding number (Van Oosterom and Strackee 1983).
pub fn is_inside(point: DVec3, triangles: &[Triangle]) -> bool {
    let angle = |t: &Triangle| {
        let [a, b, c] = t.map(|corner| corner - point);
        let (x, y, z) = (a.length(), b.length(), c.length());
        let below = x * y * z + a.dot(b) * z + b.dot(c) * x + c.dot(a) * y;
        2.0 * a.dot(b.cross(c)).atan2(below)
    };
    triangles.iter().map(angle).sum::<f64>() > std::f64::consts::TAU
}

/// Distance of a point from the nearest triangle.
pub fn to_surface(point: DVec3, triangles: &[Triangle]) -> f64 {
    triangles.iter().map(|t| point_triangle(point, *t).distance(point)).fold(f64::INFINITY, f64::min)
}
