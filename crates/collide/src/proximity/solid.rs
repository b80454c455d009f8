//! Whether a point lies inside a solid, and a point of each of its pieces.
//!
//! The crossings of a ray with the surface are counted with their sign (outwards 1, inwards −1): outside, and in a
//! cavity, they cancel. A ray that passes too close to an edge to tell is replaced by another; after the last, the solid
//! angles of all triangles are summed (Van Oosterom and Strackee 1983), which has no such cases.

use std::collections::HashMap;
use std::f64::consts::PI;

use palpate_core::Clod;
use palpate_core::glam::DVec3;

use super::triangles::Triangle;
use crate::sets::Sets;
use crate::shape::Shape;

/// Directions to cast rays in, chosen to be aligned with nothing.
const RAYS: [DVec3; 4] = [
    DVec3::new(0.487_13, 0.617_31, 0.617_73),
    DVec3::new(-0.711_09, 0.310_77, -0.630_69),
    DVec3::new(0.123_71, -0.894_51, 0.429_57),
    DVec3::new(-0.402_33, -0.288_91, 0.868_71),
];

/// A ray that passes an edge by less than this, as a fraction of its distance, is not used.
const CLOSE: f64 = 1e-10;

/// One point of every connected piece of a surface, m.
pub(crate) fn pieces(clod: &Clod) -> Vec<DVec3> {
    let mut ids = HashMap::new();
    let mut points: Vec<DVec3> = Vec::new();
    let mut sets = Sets::default();
    for node in clod.levels.first().map_or(&[][..], |_| clod.leaves()) {
        let corners = clod.hull(node);
        for triangle in clod.patch(node) {
            let [p, q, r] = triangle.map(|v| {
                let point = corners[v as usize];
                // Adding 0 makes −0 and 0 one.
                *ids.entry((point + 0.0).to_array().map(f64::to_bits)).or_insert_with(|| {
                    points.push(point);
                    sets.add()
                })
            });
            sets.join(p, q);
            sets.join(q, r);
        }
    }
    (0..sets.len()).filter(|index| sets.root(*index) == *index).map(|index| points[index as usize]).collect()
}

/// Whether a point (body frame, m) that does not lie on the surface of a solid lies inside. `stack` is a buffer.
pub(crate) fn contains(shape: &Shape, point: DVec3, stack: &mut Vec<u32>) -> bool {
    let source = &shape.clod().source;
    if !source.solid || point.distance(source.center) > source.bounding_radius * (1.0 + 1e-9) {
        return false;
    }
    let crossings = RAYS.iter().find_map(|ray| crossings(shape, point, *ray, stack));
    crossings.unwrap_or_else(|| turns(shape.clod(), point)) != 0
}

/// The signed crossings of a ray, or `None` if it passes an edge too closely.
fn crossings(shape: &Shape, origin: DVec3, ray: DVec3, stack: &mut Vec<u32>) -> Option<i32> {
    let clod = shape.clod();
    let mut sum = 0;
    stack.clear();
    stack.push(Clod::ROOT);
    while let Some(index) = stack.pop() {
        let packed = shape.node(index);
        let to_center = packed.center - origin;
        let along = to_center.dot(ray);
        let radius = packed.radius * (1.0 + 1e-9);
        // The rays are of unit length to some 1e-5 only.
        let aside = to_center.length_squared() - along * along * (1.0 + 1e-4);
        if aside > radius * radius || along < -radius * (1.0 + 1e-4) {
            continue;
        }
        if !packed.is_leaf() {
            stack.extend(packed.first_child..packed.last_child);
            continue;
        }
        let node = &clod.nodes[index as usize];
        let points = clod.hull(node);
        for triangle in clod.patch(node) {
            sum += crossing(triangle.map(|v| points[v as usize] - origin), ray)?;
        }
    }
    Some(sum)
}

/// 1 if a ray from the origin leaves through a triangle, −1 if it enters, 0 if it misses; `None` if it is too close to an
/// edge.
fn crossing([p, q, r]: Triangle, ray: DVec3) -> Option<i32> {
    let close = CLOSE * p.length_squared().max(q.length_squared()).max(r.length_squared());
    let sides = [p.cross(q).dot(ray), q.cross(r).dot(ray), r.cross(p).dot(ray)];
    let outwards = sides.iter().all(|side| *side > -close);
    let inwards = sides.iter().all(|side| *side < close);
    if !outwards && !inwards {
        return Some(0);
    }
    let behind = [p, q, r].iter().all(|corner| corner.dot(ray) < 0.0);
    if behind {
        return Some(0);
    }
    if sides.iter().any(|side| side.abs() <= close) {
        return None;
    }
    // The ray's line passes through; the plane is ahead if the origin is on the side that the normal leaves.
    let ahead = (q - p).cross(r - p).dot(p) * if outwards { 1.0 } else { -1.0 } > 0.0;
    Some(i32::from(ahead) * if outwards { 1 } else { -1 })
}

/// How many times the surface goes around a point.
fn turns(clod: &Clod, point: DVec3) -> i32 {
    let mut angle = 0.0;
    for node in clod.leaves() {
        let points = clod.hull(node);
        for triangle in clod.patch(node) {
            let [p, q, r] = triangle.map(|v| points[v as usize] - point);
            let (x, y, z) = (p.length(), q.length(), r.length());
            let volume = p.dot(q.cross(r));
            angle += 2.0 * volume.atan2(x * y * z + p.dot(q) * z + q.dot(r) * x + r.dot(p) * y);
        }
    }
    (angle / (4.0 * PI)).round() as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tetrahedron around the origin, seen from inside and outside, and through edges and corners.
    #[test]
    fn crossings_of_a_tetrahedron() {
        let v = [
            DVec3::ONE,
            DVec3::new(-1.0, -1.0, 1.0),
            DVec3::new(-1.0, 1.0, -1.0),
            DVec3::new(1.0, -1.0, -1.0),
        ];
        let faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        let count = |origin: DVec3, ray: DVec3| -> Option<i32> {
            faces.iter().map(|f| crossing(f.map(|i| v[i] - origin), ray)).sum()
        };
        for ray in RAYS {
            assert_eq!(count(DVec3::ZERO, ray), Some(1));
            assert_eq!(count(DVec3::ZERO, -ray), Some(1));
            assert_eq!(count(3.0 * ray, ray), Some(0));
            assert_eq!(count(-3.0 * ray, ray), Some(0));
        }
        assert_eq!(count(DVec3::ZERO, DVec3::ONE.normalize()), None, "a corner");
        assert_eq!(count(DVec3::ZERO, DVec3::Z), None, "an edge");
        assert_eq!(count(DVec3::new(0.0, 0.0, 2.0), DVec3::Z), Some(0), "an edge behind");
    }
}
