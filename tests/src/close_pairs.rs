//! Expected results of a contact query: all pairs of triangles within a distance of each other, the connected
//! regions that they form, the local minima of the distance among them, and the depths of the regions of
//! intersection.

use std::collections::HashMap;

use palpate::glam::DVec3;
use palpate::{Pose, TriMesh};

use crate::brute_force::nearest_on_triangle;
use crate::triangle_tree::TriangleTree;

/// Mesh prepared for the search of close pairs.
#[derive(Clone, Debug)]
pub struct Surface {
    /// Mesh, m.
    pub mesh: TriMesh,
    /// Tree over its triangles.
    pub tree: TriangleTree,
    /// Whether the mesh bounds a solid, so that only the outside of its triangles can be touched.
    pub solid: bool,
    /// Indices of the triangles at each vertex.
    around: Vec<Vec<u32>>,
}

impl Surface {
    /// Prepares a mesh.
    pub fn new(mesh: TriMesh) -> Self {
        let mut around = vec![Vec::new(); mesh.vertices().len()];
        for (index, corners) in (0..).zip(mesh.triangles()) {
            corners.iter().for_each(|vertex| around[*vertex as usize].push(index));
        }
        Self { tree: TriangleTree::new(&mesh), solid: mesh.validate().is_solid(), mesh, around }
    }

    fn corners(&self, triangle: u32, pose: &Pose) -> [DVec3; 3] {
        self.mesh.corners(triangle as usize).map(|corner| pose.transform_point(corner))
    }

    /// Returns the triangles that contain a point of one of them (m, with the mesh at a pose), up to an error
    /// of `same` (m).
    fn at(&self, point: DVec3, triangle: u32, pose: &Pose, same: f64) -> Vec<u32> {
        let vertices = self.mesh.triangles()[triangle as usize];
        let mut found: Vec<u32> = vertices.iter().flat_map(|v| &self.around[*v as usize]).copied().collect();
        found.sort_unstable();
        found.dedup();
        found.retain(|t| nearest_on_triangle(point, &self.corners(*t, pose)).distance(point) <= same);
        found
    }

    /// Returns whether a direction from a nearest point, shared by all of these triangles, leads outside: by
    /// the angle-weighted normal (Bærentzen and Aanæs 2005).
    fn faces(&self, point: DVec3, triangles: &[u32], pose: &Pose, direction: DVec3, same: f64) -> bool {
        let weighted = |t: &u32| {
            let corners = self.corners(*t, pose);
            let at = (0..3).find(|k| corners[*k].distance(point) <= same);
            // On an edge both triangles have the same weight.
            let angle = at.map_or(1.0, |k| {
                (corners[(k + 1) % 3] - corners[k]).angle_between(corners[(k + 2) % 3] - corners[k])
            });
            let [a, b, c] = corners;
            angle * (b - a).cross(c - a).normalize_or_zero()
        };
        !self.solid || triangles.iter().map(weighted).sum::<DVec3>().dot(direction) > 1e-6
    }
}

/// Close pair of a triangle of the probe and one of the scene object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClosePair {
    /// Indices of the probe's and the scene object's triangle.
    pub triangles: [u32; 2],
    /// Distance, m; 0 where they intersect.
    pub distance: f64,
    /// Nearest point of each, m.
    pub points: [DVec3; 2],
    /// Region of the pair: pairs are neighbours where their triangles share vertices on both sides.
    pub region: usize,
}

/// Local minimum of the distance.
#[derive(Clone, Debug, PartialEq)]
pub struct Minimum {
    /// Pair with the minimum. Others that have the same nearest points are minima as well.
    pub pair: ClosePair,
    /// Triangles at its points, on both surfaces.
    pub around: [Vec<u32>; 2],
}

/// All close pairs of triangles of a probe and a scene object, which stands at the origin.
#[derive(Clone, Debug)]
pub struct ClosePairs {
    /// Close pairs.
    pub pairs: Vec<ClosePair>,
    /// Number of regions.
    pub regions: usize,
}

impl ClosePairs {
    /// Finds the pairs within a distance (m), with the probe at a pose.
    pub fn new(probe: &Surface, pose: &Pose, scene: &Surface, reach: f64) -> Self {
        let found = probe.tree.placed(pose).pairs_within(&scene.tree, reach);
        let mut joined = Partition::new(found.len());
        let mut first_with = HashMap::new();
        for (index, ([i, j], ..)) in found.iter().enumerate() {
            for v in probe.mesh.triangles()[*i as usize] {
                for w in scene.mesh.triangles()[*j as usize] {
                    joined.join(index, *first_with.entry([v, w]).or_insert(index));
                }
            }
        }
        let (regions, region_of) = joined.parts();
        let pairs = found
            .into_iter()
            .zip(region_of)
            .map(|((triangles, distance, points), region)| ClosePair { triangles, distance, points, region });
        Self { pairs: pairs.collect(), regions }
    }

    /// Returns the pairs that do not intersect and are local minima: no pair of triangles at their nearest
    /// points is closer, and for solids each is outside the other there. Lengths that differ by less than
    /// `same` (m) count as equal.
    pub fn minima(&self, probe: &Surface, pose: &Pose, scene: &Surface, same: f64) -> Vec<Minimum> {
        let distances: HashMap<[u32; 2], f64> =
            self.pairs.iter().map(|pair| (pair.triangles, pair.distance)).collect();
        let mut minima = Vec::new();
        for pair in self.pairs.iter().filter(|pair| pair.distance > 0.0) {
            let ([i, j], [p, q]) = (pair.triangles, pair.points);
            let at_p = probe.at(p, i, pose, same);
            let at_q = scene.at(q, j, &Pose::IDENTITY, same);
            // Over both sides jointly: crossing edges may come closer only if both points move.
            let undercut = at_p.iter().any(|k| {
                let closer = |l: &u32| distances.get(&[*k, *l]).is_some_and(|d| *d < pair.distance - same);
                at_q.iter().any(closer)
            });
            let direction = (q - p) / pair.distance;
            if !undercut
                && probe.faces(p, &at_p, pose, direction, same)
                && scene.faces(q, &at_q, &Pose::IDENTITY, -direction, same)
            {
                minima.push(Minimum { pair: *pair, around: [at_p, at_q] });
            }
        }
        minima
    }
}

/// Connected region of intersection: pairs of intersecting triangles that share vertices on both sides, and
/// vertices of either object inside the other that are corners of those triangles, or joined to such corners
/// by edges.
#[derive(Clone, Debug, PartialEq)]
pub struct Intersection {
    /// Largest distance of its vertices from the other surface, m; 0 without vertices inside.
    pub depth: f64,
    /// Deepest vertex, or otherwise a point on both surfaces, m.
    pub deepest: DVec3,
    /// Smallest coordinates of its vertices and of known common points, m.
    pub low: DVec3,
    /// Largest coordinates of its vertices and of known common points, m.
    pub high: DVec3,
}

impl ClosePairs {
    /// Returns the regions of intersection. A solid that is wholly inside the other is in none.
    pub fn intersections(&self, probe: &Surface, pose: &Pose, scene: &Surface) -> Vec<Intersection> {
        let crossing: Vec<&ClosePair> = self.pairs.iter().filter(|pair| pair.distance == 0.0).collect();
        // Mesh, its pose, the other mesh, and the pose in that one's frame.
        let sides = [(probe, *pose, scene, *pose), (scene, Pose::IDENTITY, probe, pose.inverse())];
        let mut inside: [HashMap<u32, Option<usize>>; 2] = Default::default();
        let mut found: Vec<(usize, u32)> = Vec::new();
        let mut joins = Vec::new();
        for side in 0..2 {
            let (own, _, other, in_other) = sides[side];
            let mut look = |vertex: u32, found: &mut Vec<(usize, u32)>| {
                *inside[side].entry(vertex).or_insert_with(|| {
                    let at = in_other.transform_point(own.mesh.vertices()[vertex as usize]);
                    (other.solid && other.tree.winding(at) > 0).then(|| {
                        found.push((side, vertex));
                        crossing.len() + found.len() - 1
                    })
                })
            };
            let mut next = found.len();
            for (index, pair) in crossing.iter().enumerate() {
                for vertex in own.mesh.triangles()[pair.triangles[side] as usize] {
                    joins.extend(look(vertex, &mut found).map(|own| (index, own)));
                }
            }
            while let Some(&(_, vertex)) = found.get(next) {
                for triangle in &own.around[vertex as usize] {
                    for neighbour in own.mesh.triangles()[*triangle as usize] {
                        let joined = look(neighbour, &mut found);
                        joins.extend(joined.map(|other| (crossing.len() + next, other)));
                    }
                }
                next += 1;
            }
        }
        let mut parts = Partition::new(crossing.len() + found.len());
        joins.into_iter().for_each(|(i, j)| parts.join(i, j));
        let mut first_with = HashMap::new();
        for (index, pair) in crossing.iter().enumerate() {
            for v in probe.mesh.triangles()[pair.triangles[0] as usize] {
                for w in scene.mesh.triangles()[pair.triangles[1] as usize] {
                    parts.join(index, *first_with.entry([v, w]).or_insert(index));
                }
            }
        }
        let (count, part_of) = parts.parts();
        let nowhere = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let empty = Intersection { depth: 0.0, deepest: DVec3::NAN, low: nowhere.0, high: nowhere.1 };
        let mut regions = vec![empty; count];
        let points = crossing.iter().map(|pair| (0.0, pair.points[0]));
        let vertices = found.iter().map(|(side, vertex)| {
            let (own, own_pose, other, in_other) = sides[*side];
            let vertex = own.mesh.vertices()[*vertex as usize];
            (other.tree.distance(in_other.transform_point(vertex)), own_pose.transform_point(vertex))
        });
        for ((depth, point), part) in points.chain(vertices).zip(part_of) {
            let region = &mut regions[part];
            if depth > region.depth || region.deepest.is_nan() {
                (region.depth, region.deepest) = (depth, point);
            }
            (region.low, region.high) = (region.low.min(point), region.high.max(point));
        }
        regions
    }
}

/// Disjoint sets of numbers.
#[derive(Clone, Debug)]
pub struct Partition(Vec<usize>);

impl Partition {
    /// Puts each of `count` numbers into a set of its own.
    pub fn new(count: usize) -> Self {
        Self((0..count).collect())
    }

    fn root(&mut self, mut i: usize) -> usize {
        while self.0[i] != i {
            self.0[i] = self.0[self.0[i]];
            i = self.0[i];
        }
        i
    }

    /// Joins the sets of two numbers.
    pub fn join(&mut self, i: usize, j: usize) {
        let (i, j) = (self.root(i), self.root(j));
        self.0[i.max(j)] = i.min(j);
    }

    /// Returns the number of sets, and the set of each number.
    pub fn parts(mut self) -> (usize, Vec<usize>) {
        let mut count = 0;
        let mut part_of = Vec::with_capacity(self.0.len());
        for i in 0..self.0.len() {
            // The smallest number of a set is its root, and comes first.
            let root = self.root(i);
            let part = if root == i { count } else { part_of[root] };
            count += usize::from(root == i);
            part_of.push(part);
        }
        (count, part_of)
    }
}

#[cfg(test)]
mod tests {
    use palpate::models::Model;

    use super::*;

    #[test]
    fn a_ball_pressed_into_a_larger_one_is_one_region() {
        let ball = Surface::new(Model::GolfBall.generate(4_000).expect("in range"));
        let radius = ball.mesh.bounding_sphere().radius;
        for press in [0.02, 0.1] {
            let pose = Pose::from_translation((2.0 - press) * radius * DVec3::X);
            let close = ClosePairs::new(&ball, &pose, &ball, 0.01 * radius);
            let found = close.intersections(&ball, &pose, &ball);
            let [region] = &found[..] else { panic!("pressed {press}: {found:?}") };
            // A dimple is one hundredth of the radius deep.
            assert!((region.depth / radius - press).abs() < 0.02, "pressed {press}: {region:?}");
            assert!((region.deepest.x / radius - 1.0).abs() < 1.1 * press, "{region:?}");
        }
    }

    #[test]
    fn a_ball_next_to_another_has_one_minimum_that_is_nearest() {
        let ball = Surface::new(Model::Ellipsoid.generate(1_000).expect("in range"));
        let radius = ball.mesh.bounding_sphere().radius;
        for apart in [0.01, 0.03] {
            let pose = Pose::from_translation((2.0 + apart) * radius * DVec3::X);
            let reach = 0.1 * radius;
            let close = ClosePairs::new(&ball, &pose, &ball, reach);
            let minima = close.minima(&ball, &pose, &ball, 1e-9 * radius);
            let nearest = close.pairs.iter().map(|pair| pair.distance).fold(f64::INFINITY, f64::min);
            assert_eq!(
                (close.regions, close.intersections(&ball, &pose, &ball)),
                (usize::from(!close.pairs.is_empty()), vec![])
            );
            // Several pairs share the nearest vertices.
            assert!(minima.iter().all(|minimum| (minimum.pair.distance - nearest).abs() < 1e-9 * radius));
            assert_eq!(minima.is_empty(), close.pairs.is_empty());
        }
    }

    #[test]
    fn sets_are_numbered_in_order() {
        let mut sets = Partition::new(6);
        for (i, j) in [(4, 1), (5, 3), (1, 5)] {
            sets.join(i, j);
        }
        assert_eq!(sets.parts(), (3, vec![0, 1, 2, 1, 1, 1]));
    }
}
