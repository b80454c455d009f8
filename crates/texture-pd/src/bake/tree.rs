//! Ray casts and nearest-point queries on a triangle mesh.
//!
//! Boxes are stored in f32 (`obvhs`), in units of the mesh's radius about its centre, widened by more than
//! rounding. Boxes and triangles are tested in f64. Triangles have a tolerance, so that a ray through an edge
//! hits at least one of its triangles.

use glam::{DVec3, Vec3A};
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};
use palpate_core::TriMesh;

/// Padding of boxes, in units of the mesh's radius: more than the rounding of f64.
const PADDING: f64 = 1e-12;

/// Tolerance of ray casts, as a part of the triangle. It keeps rays from passing between two triangles by
/// rounding.
const EDGE_TOLERANCE: f64 = 1e-9;

/// Cosine between a triangle's normal and the ray below which the triangle is edge-on and ignored.
const EDGE_ON: f64 = 1e-6;

/// Replacement for a zero component of a direction, so that its reciprocal is finite.
const MIN_COMPONENT: f64 = 1e-300;

/// Hit of a ray on a triangle that faces along the ray.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    /// Distance along the ray, in lengths of its direction.
    pub along: f64,
    /// Cosine of the angle between the triangle's normal and the direction; above 0.
    pub facing: f64,
    pub triangle: u32,
}

/// Triangle of a mesh that is nearest to a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Nearest {
    pub triangle: usize,
    pub point: DVec3,
    /// Distance from the query point, m.
    pub distance: f64,
}

/// The triangles of a mesh in a hierarchy of boxes.
pub(super) struct Tree<'a> {
    mesh: &'a TriMesh,
    boxes: Bvh2,
    center: DVec3,
    /// Factor from metres to units of the mesh's radius, 1/m.
    scale: f64,
}

impl<'a> Tree<'a> {
    /// Builds the hierarchy of a mesh with finite vertices. It is deterministic: built on one thread, without
    /// hashing.
    pub fn new(mesh: &'a TriMesh) -> Self {
        let sphere = mesh.bounding_sphere();
        let (center, scale) = (sphere.center, sphere.radius.recip());
        let triangles = mesh.triangles().len();
        let boxes: Vec<Aabb> = (0..triangles)
            .map(|t| {
                let [a, b, c] = mesh.corners(t).map(|p| (p - center) * scale);
                let low = (a.min(b).min(c) - PADDING).as_vec3().to_array().map(f32::next_down);
                let high = (a.max(b).max(c) + PADDING).as_vec3().to_array().map(f32::next_up);
                Aabb::new(Vec3A::from_array(low), Vec3A::from_array(high))
            })
            .collect();
        let order = (0..triangles as u32).collect();
        let boxes = PlocBuilder::new().build(PlocSearchDistance::Low, &boxes, order, SortPrecision::U64, 0);
        Self { mesh, boxes, center, scale }
    }

    /// Collects the hits of the line `origin` + t `direction`, |t| ≤ `reach`, on triangles that face along
    /// it.
    pub fn hits(&self, origin: DVec3, direction: DVec3, reach: f64, hits: &mut Vec<Hit>) {
        hits.clear();
        let from = (origin - self.center) * self.scale;
        let inverse =
            (direction * self.scale).to_array().map(|x| if x == 0.0 { MIN_COMPONENT } else { x }.recip());
        let inverse = DVec3::from_array(inverse);
        let mut stack = vec![0];
        while let Some(node) = stack.pop().and_then(|index: u32| self.boxes.nodes.get(index as usize)) {
            let (low, high) = bounds(node);
            // Slab test of the box, to both sides of the origin.
            let (a, b) = ((low - from) * inverse, (high - from) * inverse);
            let (enter, leave) = (a.min(b).max_element(), a.max(b).min_element());
            if enter > leave || enter > reach || leave < -reach {
                continue;
            }
            if !node.is_leaf() {
                stack.extend([node.first_index, node.first_index + 1]);
                continue;
            }
            let met = self.items(node).filter_map(|t| {
                let [along, facing] = meet(self.mesh.corners(t), origin, direction)?;
                Some(Hit { along, facing, triangle: t as u32 })
            });
            hits.extend(met.filter(|hit| hit.along.abs() <= reach));
        }
    }

    /// Returns the triangle nearest to a point; `None` if the mesh is empty.
    pub fn nearest(&self, point: DVec3) -> Option<Nearest> {
        let at = (point - self.center) * self.scale;
        let mut found: Option<Nearest> = None;
        let mut stack = vec![(0.0, 0)];
        while let Some((distance, index)) = stack.pop() {
            let bound = found.map_or(f64::INFINITY, |found| found.distance * self.scale);
            let Some(node) = self.boxes.nodes.get(index as usize) else { break };
            if distance > bound {
                continue;
            }
            if node.is_leaf() {
                for triangle in self.items(node) {
                    let nearest = nearest_in(self.mesh.corners(triangle), point);
                    let distance = nearest.distance(point);
                    let nearer = |found: Nearest| {
                        distance < found.distance || distance == found.distance && triangle < found.triangle
                    };
                    if found.is_none_or(nearer) {
                        found = Some(Nearest { triangle, point: nearest, distance });
                    }
                }
                continue;
            }
            let mut children = [node.first_index, node.first_index + 1].map(|child| {
                let distance =
                    self.boxes.nodes.get(child as usize).map_or(f64::INFINITY, |node| gap(bounds(node), at));
                (distance, child)
            });
            if children[0].0 < children[1].0 {
                children.swap(0, 1);
            }
            stack.extend(children);
        }
        found
    }

    /// Iterates over the triangles of a leaf.
    fn items(&self, leaf: &Bvh2Node) -> impl Iterator<Item = usize> {
        let first = leaf.first_index as usize;
        self.boxes.primitive_indices[first..first + leaf.prim_count as usize].iter().map(|t| *t as usize)
    }
}

fn bounds(node: &Bvh2Node) -> (DVec3, DVec3) {
    (node.aabb().min.as_dvec3(), node.aabb().max.as_dvec3())
}

/// Returns the distance of a point from a box.
fn gap((low, high): (DVec3, DVec3), at: DVec3) -> f64 {
    (low - at).max(at - high).max(DVec3::ZERO).length()
}

/// Returns the hit of a line on a triangle that faces along it: distance in lengths of the direction, and
/// cosine. The three signed volumes of the line with the triangle's edges are not negative inside.
fn meet(corners: [DVec3; 3], origin: DVec3, direction: DVec3) -> Option<[f64; 2]> {
    let [a, b, c] = corners.map(|p| p - origin);
    let volumes = [(b, c), (c, a), (a, b)].map(|(p, q)| direction.dot(p.cross(q)));
    let normal = (b - a).cross(c - a);
    let rate = normal.dot(direction);
    let facing = rate / (normal.length() * direction.length());
    let meets = facing > EDGE_ON && volumes.iter().all(|volume| *volume >= -EDGE_TOLERANCE * rate);
    meets.then(|| [normal.dot(a) / rate, facing])
}

/// Returns the point of a triangle that is nearest to a point (Ericson, *Real-Time Collision Detection*,
/// 2005, §5.1.5).
pub(super) fn nearest_in([a, b, c]: [DVec3; 3], point: DVec3) -> DVec3 {
    let (ab, ac) = (b - a, c - a);
    let from = |p: DVec3| (ab.dot(point - p), ac.dot(point - p));
    let ((d1, d2), (d3, d4), (d5, d6)) = (from(a), from(b), from(c));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let (va, vb, vc) = (d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2);
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return b + (c - b) * ((d4 - d3) / (d4 - d3 + d5 - d6));
    }
    let sum = va + vb + vc;
    a + ab * (vb / sum) + ac * (vc / sum)
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    fn random(rng: &mut StdRng) -> DVec3 {
        DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)))
    }

    #[test]
    fn tree_agrees_with_exhaustive_search() {
        let seed = 11;
        let mut rng = StdRng::seed_from_u64(seed);
        let offset = DVec3::new(1e4, -3.0, 0.5);
        let vertices = (0..900)
            .flat_map(|_| {
                let at = random(&mut rng) + offset;
                [at, at + 0.2 * random(&mut rng), at + 0.2 * random(&mut rng)]
            })
            .collect();
        let mesh = TriMesh::new(vertices, (0..900).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect()).unwrap();
        let tree = Tree::new(&mesh);
        let (mut hits, mut met) = (Vec::new(), 0);
        for case in 0..500 {
            let (origin, direction) = (random(&mut rng) + offset, random(&mut rng));
            tree.hits(origin, direction, 0.7, &mut hits);
            let mut expected: Vec<f64> = (0..900)
                .filter_map(|t| meet(mesh.corners(t), origin, direction).map(|[along, _]| along))
                .filter(|along| along.abs() <= 0.7)
                .collect();
            let mut found: Vec<f64> = hits.iter().map(|hit| hit.along).collect();
            expected.sort_by(f64::total_cmp);
            found.sort_by(f64::total_cmp);
            assert_eq!(found, expected, "seed {seed}, case {case}");
            met += found.len();
            let all = (0..900).map(|t| nearest_in(mesh.corners(t), origin).distance(origin));
            let nearest = tree.nearest(origin).unwrap();
            assert_eq!(nearest.distance, all.fold(f64::INFINITY, f64::min), "seed {seed}, case {case}");
            assert_eq!(nearest.distance, nearest_in(mesh.corners(nearest.triangle), origin).distance(origin));
        }
        assert!(met > 100, "seed {seed}: {met}");
    }
}
