//! What a contact query should find: the pairs of triangles within a distance of each other, all of them, the connected
//! regions that they make up, and the local minima of the distance among them.

use std::collections::HashMap;

use palpate::glam::DVec3;
use palpate::{Pose, TriMesh};

use crate::brute_force::nearest_on_triangle;
use crate::triangle_tree::TriangleTree;

/// A mesh prepared for looking for close pairs.
#[derive(Clone, Debug)]
pub struct Surface {
    /// The mesh, m.
    pub mesh: TriMesh,
    /// Over its triangles.
    pub tree: TriangleTree,
    /// Whether it bounds a solid, so that only the outside of its triangles can be touched.
    pub solid: bool,
    /// Triangles at each vertex.
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

    /// The triangles that a point of one of them (m, the mesh at a pose) is part of, but for `same` (m).
    fn at(&self, point: DVec3, triangle: u32, pose: &Pose, same: f64) -> Vec<u32> {
        let vertices = self.mesh.triangles()[triangle as usize];
        let mut found: Vec<u32> = vertices.iter().flat_map(|v| &self.around[*v as usize]).copied().collect();
        found.sort_unstable();
        found.dedup();
        found.retain(|t| nearest_on_triangle(point, &self.corners(*t, pose)).distance(point) <= same);
        found
    }

    /// Whether the nearest of its points to a place is seen from there from outside, where that is the point of all of
    /// these triangles: by the angle-weighted normal (Bærentzen and Aanæs 2005).
    fn faces(&self, point: DVec3, triangles: &[u32], pose: &Pose, direction: DVec3, same: f64) -> bool {
        let weighted = |t: &u32| {
            let corners = self.corners(*t, pose);
            let at = (0..3).find(|k| corners[*k].distance(point) <= same);
            // On an edge both triangles weigh the same.
            let angle = at.map_or(1.0, |k| {
                (corners[(k + 1) % 3] - corners[k]).angle_between(corners[(k + 2) % 3] - corners[k])
            });
            let [a, b, c] = corners;
            angle * (b - a).cross(c - a).normalize_or_zero()
        };
        !self.solid || triangles.iter().map(weighted).sum::<DVec3>().dot(direction) > 1e-6
    }
}

/// A triangle of the probe and one of the scene object that are close.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClosePair {
    /// Index of the probe's triangle, and of the scene object's.
    pub triangles: [u32; 2],
    /// m; 0 where they intersect.
    pub distance: f64,
    /// A nearest point of each, m.
    pub points: [DVec3; 2],
    /// The region that the pair is part of: pairs are neighbours where their triangles share vertices on both sides.
    pub region: usize,
}

/// All close pairs of triangles of a probe and a scene object, which stands at the origin.
#[derive(Clone, Debug)]
pub struct ClosePairs {
    /// The pairs.
    pub pairs: Vec<ClosePair>,
    /// Number of regions.
    pub regions: usize,
}

impl ClosePairs {
    /// The pairs within a distance (m), with the probe at a pose.
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
        let pairs = found.into_iter().zip(region_of).map(|((triangles, distance, points), region)| ClosePair {
            triangles,
            distance,
            points,
            region,
        });
        Self { pairs: pairs.collect(), regions }
    }

    /// Which of the pairs that do not intersect are local minima: no pair of triangles at their nearest points is closer,
    /// and of solids either is outside the other there. Lengths (m) are told apart from `same` on.
    pub fn minima(&self, probe: &Surface, pose: &Pose, scene: &Surface, same: f64) -> Vec<usize> {
        let distances: HashMap<[u32; 2], f64> =
            self.pairs.iter().map(|pair| (pair.triangles, pair.distance)).collect();
        let mut minima = Vec::new();
        for (index, pair) in self.pairs.iter().enumerate().filter(|(_, pair)| pair.distance > 0.0) {
            let ([i, j], [p, q]) = (pair.triangles, pair.points);
            let at_p = probe.at(p, i, pose, same);
            let at_q = scene.at(q, j, &Pose::IDENTITY, same);
            // Jointly, not one side at a time: crossing edges may come closer only by moving both.
            let undercut = at_p.iter().any(|k| {
                let closer = |l: &u32| distances.get(&[*k, *l]).is_some_and(|d| *d < pair.distance - same);
                at_q.iter().any(closer)
            });
            let direction = (q - p) / pair.distance;
            if !undercut
                && probe.faces(p, &at_p, pose, direction, same)
                && scene.faces(q, &at_q, &Pose::IDENTITY, -direction, same)
            {
                minima.push(index);
            }
        }
        minima
    }
}

/// Disjoint sets of numbers.
#[derive(Clone, Debug)]
pub struct Partition(Vec<usize>);

impl Partition {
    /// Each of so many numbers is a set of its own.
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

    /// How many sets there are, and which one each number is in.
    pub fn parts(mut self) -> (usize, Vec<usize>) {
        let mut count = 0;
        let mut part_of = Vec::with_capacity(self.0.len());
        for i in 0..self.0.len() {
            // The least of a set is its root, and comes first.
            let root = self.root(i);
            let part = if root == i { count } else { part_of[root] };
            count += usize::from(root == i);
            part_of.push(part);
        }
        (count, part_of)
    }
}
