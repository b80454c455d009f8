//! Nearest points and inside tests on a mesh, and close pairs of triangles of two meshes, by a plain tree of
//! boxes. It is independent of the trees of the engine and the builder, and is itself compared with brute
//! force below.

use palpate::glam::DVec3;
use palpate::{Pose, TriMesh};

use crate::brute_force::{nearest_on_triangle, triangle_distance};

/// Largest number of triangles in a leaf.
const MAX_LEAF_TRIANGLES: usize = 4;

/// Directions of rays, in no special position to any mesh.
const RAYS: [DVec3; 3] = [
    DVec3::new(0.617_21, 0.289_44, 0.731_65),
    DVec3::new(-0.413_83, 0.803_17, -0.428_61),
    DVec3::new(0.150_49, -0.560_08, -0.814_66),
];

/// Mesh prepared for queries of distance and inside.
#[derive(Clone, Debug)]
pub struct TriangleTree {
    /// Triangles with their indices in the mesh, in the order of the leaves.
    triangles: Vec<([DVec3; 3], u32)>,
    nodes: Vec<Node>,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    low: DVec3,
    high: DVec3,
    /// Range of the triangles of a leaf; for an inner node, of all leaves below it.
    first: usize,
    end: usize,
    /// Index of the second child (the first follows the node), or 0 for a leaf.
    second: usize,
}

impl TriangleTree {
    /// Builds a tree over a mesh with at least one triangle.
    pub fn new(mesh: &TriMesh) -> Self {
        let count = mesh.triangles().len() as u32;
        let mut triangles: Vec<_> = (0..count).map(|t| (mesh.corners(t as usize), t)).collect();
        let mut nodes = Vec::new();
        let end = triangles.len();
        split(&mut triangles, 0, end, &mut nodes);
        Self { triangles, nodes }
    }

    /// Returns the tree of the mesh at a pose.
    pub fn placed(&self, pose: &Pose) -> Self {
        let place = |(corners, index): &([DVec3; 3], u32)| (corners.map(|p| pose.transform_point(p)), *index);
        let mut placed =
            Self { triangles: self.triangles.iter().map(place).collect(), nodes: self.nodes.clone() };
        for index in (0..placed.nodes.len()).rev() {
            let node = placed.nodes[index];
            let (low, high) = if node.second == 0 {
                bounds(&placed.triangles[node.first..node.end])
            } else {
                let [first, second] = [index + 1, node.second].map(|child| placed.nodes[child]);
                (first.low.min(second.low), first.high.max(second.high))
            };
            placed.nodes[index] = Node { low, high, ..node };
        }
        placed
    }

    /// Returns all pairs of a triangle of this mesh and one of another that are no further apart than `reach`
    /// (m): their indices, the distance (m; 0 where they intersect), and a nearest point of each.
    pub fn pairs_within(&self, other: &Self, reach: f64) -> Vec<([u32; 2], f64, [DVec3; 2])> {
        let mut found = Vec::new();
        let mut stack = vec![(0, 0)];
        while let Some((i, j)) = stack.pop() {
            let (a, b) = (&self.nodes[i], &other.nodes[j]);
            let gap = (a.low - b.high).max(b.low - a.high).max(DVec3::ZERO).length();
            if gap > reach * (1.0 + 1e-9) {
                continue;
            }
            if a.second == 0 && b.second == 0 {
                for (s, first) in &self.triangles[a.first..a.end] {
                    for (t, second) in &other.triangles[b.first..b.end] {
                        let (distance, p, q) = triangle_distance(s, t);
                        if distance <= reach {
                            found.push(([*first, *second], distance, [p, q]));
                        }
                    }
                }
            } else if b.second == 0 || (a.second != 0 && a.end - a.first >= b.end - b.first) {
                stack.extend([(i + 1, j), (a.second, j)]);
            } else {
                stack.extend([(i, j + 1), (i, b.second)]);
            }
        }
        found
    }

    /// Returns the distance (m) of a point from the surface.
    pub fn distance(&self, p: DVec3) -> f64 {
        let mut best = f64::INFINITY;
        let mut stack = vec![(0, self.nodes[0].distance_squared(p))];
        while let Some((index, squared)) = stack.pop() {
            if squared >= best {
                continue;
            }
            let node = &self.nodes[index];
            if node.second == 0 {
                for (triangle, _) in &self.triangles[node.first..node.end] {
                    best = best.min(nearest_on_triangle(p, triangle).distance_squared(p));
                }
                continue;
            }
            let children =
                [index + 1, node.second].map(|child| (child, self.nodes[child].distance_squared(p)));
            // The nearer child goes on top of the stack, so that the bound shrinks early.
            let nearer = usize::from(children[1].1 < children[0].1);
            stack.extend([children[1 - nearer], children[nearer]]);
        }
        best.sqrt()
    }

    /// Returns the winding number of a closed, oriented surface about a point that is not on it: 1 inside an
    /// object, 0 outside. It is the count of signed crossings that two of three rays agree on, since one may
    /// hit an edge.
    pub fn winding(&self, p: DVec3) -> i32 {
        let [a, b, c] = RAYS.map(|ray| self.crossings(p, ray));
        if b == c { b } else { a }
    }

    fn crossings(&self, p: DVec3, ray: DVec3) -> i32 {
        let mut count = 0;
        let mut stack = vec![0];
        while let Some(index) = stack.pop() {
            let node = &self.nodes[index];
            if !node.is_hit(p, ray) {
                continue;
            }
            if node.second != 0 {
                stack.extend([index + 1, node.second]);
                continue;
            }
            for (corners, _) in &self.triangles[node.first..node.end] {
                let [a, b, c] = corners.map(|q| q - p);
                // Side of each edge on which the ray passes; the same arithmetic for both triangles at an
                // edge.
                let sides = [side(a, b, ray), side(b, c, ray), side(c, a, ray)];
                let normal = (b - a).cross(c - a);
                if sides == [1; 3] && normal.dot(a) > 0.0 {
                    count += 1;
                } else if sides == [-1; 3] && normal.dot(a) < 0.0 {
                    count -= 1;
                }
            }
        }
        count
    }
}

/// Returns the side of an edge on which a ray passes; exactly the opposite for the reversed edge.
fn side(from: DVec3, to: DVec3, ray: DVec3) -> i32 {
    let turned = |p: DVec3, q: DVec3| if p.cross(q).dot(ray) >= 0.0 { 1 } else { -1 };
    if from.to_array() <= to.to_array() { turned(from, to) } else { -turned(to, from) }
}

impl Node {
    fn distance_squared(&self, p: DVec3) -> f64 {
        (self.low - p).max(p - self.high).max(DVec3::ZERO).length_squared()
    }

    fn is_hit(&self, p: DVec3, ray: DVec3) -> bool {
        let (to_low, to_high) = ((self.low - p) / ray, (self.high - p) / ray);
        let enters = to_low.min(to_high).max_element();
        let leaves = to_low.max(to_high).min_element();
        // Boxes may be flat, so rounding is compensated.
        enters.max(0.0) <= leaves + 1e-12 * (leaves.abs() + enters.abs())
    }
}

fn bounds(triangles: &[([DVec3; 3], u32)]) -> (DVec3, DVec3) {
    let corners = || triangles.iter().flat_map(|(corners, _)| corners).copied();
    (corners().fold(DVec3::INFINITY, DVec3::min), corners().fold(DVec3::NEG_INFINITY, DVec3::max))
}

fn split(triangles: &mut [([DVec3; 3], u32)], first: usize, end: usize, nodes: &mut Vec<Node>) {
    let own = &mut triangles[first..end];
    let (low, high) = bounds(own);
    let index = nodes.len();
    nodes.push(Node { low, high, first, end, second: 0 });
    if end - first <= MAX_LEAF_TRIANGLES {
        return;
    }
    let axis = (high - low).max_position();
    let middle = own.len() / 2;
    let along = |(t, _): &([DVec3; 3], u32)| t[0][axis] + t[1][axis] + t[2][axis];
    own.select_nth_unstable_by(middle, |s, t| along(s).total_cmp(&along(t)));
    split(triangles, first, first + middle, nodes);
    nodes[index].second = nodes.len();
    split(triangles, first + middle, end, nodes);
}

#[cfg(test)]
mod tests {
    use palpate::glam::DQuat;
    use palpate::models::Model;
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    /// Returns the winding number as the sum of the triangles' solid angles over 4π (van Oosterom and
    /// Strackee 1983).
    fn winding_by_solid_angles(mesh: &TriMesh, p: DVec3) -> f64 {
        let angles = (0..mesh.triangles().len()).map(|t| {
            let [a, b, c] = mesh.corners(t).map(|q| q - p);
            let (l, m, n) = (a.length(), b.length(), c.length());
            let volume = a.dot(b.cross(c));
            2.0 * volume.atan2(l * m * n + a.dot(b) * n + b.dot(c) * l + c.dot(a) * m)
        });
        angles.sum::<f64>() / (4.0 * std::f64::consts::PI)
    }

    #[test]
    fn answers_agree_with_all_triangles() {
        let seed = 33;
        let mut random = StdRng::seed_from_u64(seed);
        for model in [Model::Torus, Model::Cup, Model::Block] {
            let mesh = model.generate(1000).expect("within range");
            let (tree, sphere) = (TriangleTree::new(&mesh), mesh.bounding_sphere());
            let mut inside = 0;
            for _ in 0..1000 {
                let offset = DVec3::from_array(std::array::from_fn(|_| random.random_range(-1.2..1.2)));
                let p = sphere.center + sphere.radius * offset;
                let plain = (0..mesh.triangles().len())
                    .map(|t| nearest_on_triangle(p, &mesh.corners(t)).distance(p))
                    .fold(f64::INFINITY, f64::min);
                assert!((tree.distance(p) - plain).abs() <= 1e-15, "seed {seed}, {}: {p}", model.name());
                let turns = winding_by_solid_angles(&mesh, p);
                assert!(
                    (f64::from(tree.winding(p)) - turns).abs() < 1e-6,
                    "seed {seed}, {}: {p}",
                    model.name()
                );
                inside += tree.winding(p);
            }
            assert!(inside > 10, "{}: {inside} points inside", model.name());
        }
    }

    #[test]
    fn close_pairs_are_those_of_all_pairs() {
        let seed = 34;
        let mut random = StdRng::seed_from_u64(seed);
        let [a, b] = [Model::Torus, Model::Cup].map(|model| model.generate(1000).expect("within range"));
        let trees = [&a, &b].map(TriangleTree::new);
        let radius = a.bounding_sphere().radius;
        let mut found = 0;
        for round in 0..4 {
            let mut vector = || DVec3::from_array(std::array::from_fn(|_| random.random_range(-1.0..1.0)));
            let pose = Pose::new(radius * vector(), DQuat::from_scaled_axis(3.0 * vector()));
            let reach = 0.05 * radius;
            let mut close: Vec<[u32; 2]> = trees[0]
                .placed(&pose)
                .pairs_within(&trees[1], reach)
                .into_iter()
                .map(|pair| pair.0)
                .collect();
            close.sort_unstable();
            let mut plain = Vec::new();
            for i in 0..a.triangles().len() {
                let corners = a.corners(i).map(|p| pose.transform_point(p));
                for j in 0..b.triangles().len() {
                    if triangle_distance(&corners, &b.corners(j)).0 <= reach {
                        plain.push([i as u32, j as u32]);
                    }
                }
            }
            assert_eq!(close, plain, "seed {seed}, round {round}");
            found += close.len();
        }
        assert!(found > 200, "{found} pairs");
    }
}
