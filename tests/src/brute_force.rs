//! Distances between meshes over all pairs of triangles: simple on purpose, and independent of the code that
//! is compared with it.

use palpate::glam::DVec3;
use palpate::{Pose, TriMesh};

/// Triangle with a bounding sphere.
#[derive(Clone, Copy, Debug)]
struct Placed {
    corners: [DVec3; 3],
    center: DVec3,
    radius: f64,
}

/// Returns the smallest distance (m) between the surfaces of two placed meshes, if it is below `limit`; 0
/// where they intersect.
///
/// Measures every pair of triangles whose bounding spheres are nearer than the smallest distance so far.
pub fn distance(a: &TriMesh, pose_a: &Pose, b: &TriMesh, pose_b: &Pose, limit: f64) -> Option<f64> {
    let (a, mut b) = (place(a, pose_a), place(b, pose_b));
    // Sorted along x, so that only triangles within reach there are visited.
    b.sort_by(|s, t| s.center.x.total_cmp(&t.center.x));
    let largest = b.iter().map(|t| t.radius).fold(0.0, f64::max);
    let mut best = limit;
    let mut found = None;
    for s in &a {
        let reach_x = (s.radius + largest + best) * (1.0 + 1e-9);
        let first = b.partition_point(|t| t.center.x < s.center.x - reach_x);
        for t in b[first..].iter().take_while(|t| t.center.x <= s.center.x + reach_x) {
            let reach = s.radius + t.radius + best;
            if s.center.distance_squared(t.center) > reach * reach {
                continue;
            }
            let (distance, _, _) = triangle_distance(&s.corners, &t.corners);
            if distance < best {
                best = distance;
                found = Some(distance);
                if distance == 0.0 {
                    return found;
                }
            }
        }
    }
    found
}

fn place(mesh: &TriMesh, pose: &Pose) -> Vec<Placed> {
    (0..mesh.triangles().len())
        .map(|triangle| {
            let corners = mesh.corners(triangle).map(|corner| pose.transform_point(corner));
            let center = (corners[0] + corners[1] + corners[2]) / 3.0;
            let radius = corners.iter().map(|corner| corner.distance(center)).fold(0.0, f64::max);
            Placed { corners, center, radius }
        })
        .collect()
}

/// Returns the distance (m) between two triangles with a nearest point of each; 0 where they intersect.
pub fn triangle_distance(a: &[DVec3; 3], b: &[DVec3; 3]) -> (f64, DVec3, DVec3) {
    for (first, second) in [(a, b), (b, a)] {
        for i in 0..3 {
            if let Some(point) = segment_crosses(first[i], first[(i + 1) % 3], second) {
                return (0.0, point, point);
            }
        }
    }
    let mut best = (f64::INFINITY, DVec3::ZERO, DVec3::ZERO);
    let mut offer = |p: DVec3, q: DVec3| {
        let distance = p.distance(q);
        if distance < best.0 {
            best = (distance, p, q);
        }
    };
    for i in 0..3 {
        offer(a[i], nearest_on_triangle(a[i], b));
        offer(nearest_on_triangle(b[i], a), b[i]);
        for j in 0..3 {
            let (p, q) = nearest_on_segments(a[i], a[(i + 1) % 3], b[j], b[(j + 1) % 3]);
            offer(p, q);
        }
    }
    best
}

/// Returns the point at which a segment crosses a triangle's plane inside the triangle. Segments in the plane
/// are left to the distances.
fn segment_crosses(p: DVec3, q: DVec3, triangle: &[DVec3; 3]) -> Option<DVec3> {
    let normal = (triangle[1] - triangle[0]).cross(triangle[2] - triangle[0]);
    let (height_p, height_q) = (normal.dot(p - triangle[0]), normal.dot(q - triangle[0]));
    if height_p * height_q > 0.0 || height_p == height_q {
        return None;
    }
    let crossing = p + (q - p) * (height_p / (height_p - height_q));
    let inside = (0..3).all(|i| {
        let (from, to) = (triangle[i], triangle[(i + 1) % 3]);
        normal.dot((to - from).cross(crossing - from)) >= 0.0
    });
    inside.then_some(crossing)
}

/// Returns the point of a triangle nearest to `p`.
pub fn nearest_on_triangle(p: DVec3, triangle: &[DVec3; 3]) -> DVec3 {
    let normal = (triangle[1] - triangle[0]).cross(triangle[2] - triangle[0]);
    let inside = normal != DVec3::ZERO
        && (0..3).all(|i| {
            let (from, to) = (triangle[i], triangle[(i + 1) % 3]);
            normal.dot((to - from).cross(p - from)) >= 0.0
        });
    if inside {
        return p - normal * (normal.dot(p - triangle[0]) / normal.length_squared());
    }
    let on_edge = |i: usize| nearest_on_segment(p, triangle[i], triangle[(i + 1) % 3]);
    let candidates = [on_edge(0), on_edge(1), on_edge(2)];
    let mut nearest = candidates[0];
    for candidate in candidates {
        if candidate.distance_squared(p) < nearest.distance_squared(p) {
            nearest = candidate;
        }
    }
    nearest
}

fn nearest_on_segment(p: DVec3, from: DVec3, to: DVec3) -> DVec3 {
    let along = to - from;
    let length_squared = along.length_squared();
    if length_squared == 0.0 {
        return from;
    }
    from + along * ((p - from).dot(along) / length_squared).clamp(0.0, 1.0)
}

/// Returns the nearest points of two segments: the interior solution where there is one, else the best of the
/// four ends.
fn nearest_on_segments(p0: DVec3, p1: DVec3, q0: DVec3, q1: DVec3) -> (DVec3, DVec3) {
    let mut best = (p0, nearest_on_segment(p0, q0, q1));
    let mut offer = |p: DVec3, q: DVec3| {
        if p.distance_squared(q) < best.0.distance_squared(best.1) {
            best = (p, q);
        }
    };
    offer(p1, nearest_on_segment(p1, q0, q1));
    offer(nearest_on_segment(q0, p0, p1), q0);
    offer(nearest_on_segment(q1, p0, p1), q1);
    let (u, v, w) = (p1 - p0, q1 - q0, p0 - q0);
    let (a, b, c, d, e) = (u.dot(u), u.dot(v), v.dot(v), u.dot(w), v.dot(w));
    let determinant = a * c - b * b;
    if determinant > 0.0 {
        let s = (b * e - c * d) / determinant;
        let t = (a * e - b * d) / determinant;
        if (0.0..=1.0).contains(&s) && (0.0..=1.0).contains(&t) {
            offer(p0 + u * s, q0 + v * t);
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRIANGLE: [DVec3; 3] = [DVec3::ZERO, DVec3::X, DVec3::Y];

    #[test]
    fn known_distances() {
        let above = TRIANGLE.map(|p| p + DVec3::new(0.2, 0.2, 0.5));
        assert!((triangle_distance(&TRIANGLE, &above).0 - 0.5).abs() < 1e-15);
        let beside = TRIANGLE.map(|p| p + DVec3::new(3.0, 0.0, 0.0));
        assert!((triangle_distance(&TRIANGLE, &beside).0 - 2.0).abs() < 1e-15);
        let crossing = [DVec3::new(0.2, 0.2, -1.0), DVec3::new(0.2, 0.2, 1.0), DVec3::new(9.0, 9.0, 1.0)];
        assert_eq!(triangle_distance(&TRIANGLE, &crossing).0, 0.0);
        // Two edges that pass each other at a right angle, 0.3 apart.
        let bridge = [DVec3::new(0.5, -0.3, -1.0), DVec3::new(0.5, -0.3, 1.0), DVec3::new(0.5, -5.0, 0.0)];
        assert!((triangle_distance(&TRIANGLE, &bridge).0 - 0.3).abs() < 1e-15);
    }

    #[test]
    fn nearest_points_beat_samples() {
        // A grid of points on both triangles never comes nearer than the answer, and comes close to it.
        let other = [DVec3::new(0.3, 0.9, 0.4), DVec3::new(1.4, 0.8, 1.0), DVec3::new(0.9, 1.5, 0.2)];
        let (distance, p, q) = triangle_distance(&TRIANGLE, &other);
        assert!((p.distance(q) - distance).abs() < 1e-15);
        let grid = |t: [DVec3; 3]| {
            (0..=60).flat_map(move |i| {
                (0..=60 - i).map(move |j| {
                    t[0] + (t[1] - t[0]) * f64::from(i) / 60.0 + (t[2] - t[0]) * f64::from(j) / 60.0
                })
            })
        };
        let sampled =
            grid(TRIANGLE).flat_map(|p| grid(other).map(move |q| p.distance(q))).fold(f64::MAX, f64::min);
        assert!(sampled >= distance - 1e-12 && sampled < distance + 0.02, "{sampled} against {distance}");
    }
}
