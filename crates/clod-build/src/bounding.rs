//! Bounds of a node's descendants for culling: h (§3.3.5), points that reduce h, and a sphere.
//!
//! The hulls of a simplified level need not contain those of the finer levels (§3.6.2). Departing from the
//! dissertation, which compensates for it by h alone, a hull gets a few points of its descendants for
//! culling: each time the one that is farthest from it. The descendants lie within a distance h of the hull,
//! so that every point added makes culling tighter; the cost is that support points are searched among more
//! points. With enough points h is 0, and each hull contains its descendants.
//!
//! The distance to a convex set is a convex function, so that its maximum over a hull is at one of its
//! extreme points. The maximum over all descendants is found exactly, without visiting most of them: none is
//! further away than its bounding sphere.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use glam::DVec3;
use palpate_core::clod::{Node, Parts};
use rayon::prelude::*;

use crate::convexity::HULL_THICKNESS;
use crate::enclosing::smallest_sphere;
use crate::hull::{Hull, HullBuilder, Plane, Shape};
use crate::nearest::distance_to_triangle;

/// Distance, in unit coordinates, up to which a hull counts as containing its descendants: more than
/// rounding.
const ROUNDING: f64 = 1e-11;

/// Height above a face's plane, in unit coordinates, up to which a point counts as in the plane: more than
/// rounding.
const IN_PLANE: f64 = 1e-12;

/// Margin added to a distance, as a fraction of it, so that it remains a bound in spite of rounding.
const SLACK: f64 = 1e-9;

/// Number of last bits of a distance that are ignored, so that distances that are equal but for rounding are
/// the same in any unit.
const UNCERTAIN_BITS: u32 = 20;

/// A convex hull to which distances are measured.
pub(crate) struct Target {
    points: Vec<DVec3>,
    hull: Hull,
    planes: Vec<Plane>,
}

impl Target {
    /// The hull of points in unit coordinates.
    pub fn new(points: Vec<DVec3>, builder: &mut HullBuilder) -> Self {
        let hull = builder.hull(&points, HULL_THICKNESS);
        let planes = hull.faces.iter().map(|f| Plane::through(f.map(|v| points[v as usize]))).collect();
        Self { points, hull, planes }
    }

    /// Distance of a point from the hull; inside a polytope, minus its depth.
    pub fn distance(&self, p: DVec3) -> f64 {
        let at = |v: u32| self.points[v as usize];
        let least = |distances: &mut dyn Iterator<Item = f64>| distances.fold(f64::INFINITY, f64::min);
        if self.hull.shape == Shape::Polytope {
            let highest = self.planes.iter().map(|plane| plane.height(p)).fold(f64::NEG_INFINITY, f64::max);
            if highest <= 0.0 {
                return highest;
            }
            // The nearest point is on a face that is visible from the point, or whose plane contains the
            // point but for rounding: a vertex of the hull may be above no plane but, by rounding, that of a
            // distant face.
            let visible =
                self.hull.faces.iter().zip(&self.planes).filter(|(_, plane)| plane.height(p) > -IN_PLANE);
            let nearest = least(&mut visible.map(|(f, _)| distance_to_triangle(p, f.map(at))));
            return if nearest.is_finite() { nearest } else { 0.0 };
        }
        let extreme = &self.hull.extreme;
        let first = extreme[0];
        if let [only] = **extreme {
            return p.distance(at(only));
        }
        least(
            &mut extreme[1..]
                .windows(2.min(extreme.len() - 1))
                .map(|w| distance_to_triangle(p, [at(first), at(w[0]), at(w[w.len() - 1])])),
        )
    }
}

/// Bounds of a node's descendants, in metres.
struct Bounds {
    /// Points of [`Parts::vertices`] that are added to the hull.
    added: Vec<u32>,
    hausdorff: f64,
    center: DVec3,
    radius: f64,
}

/// Sets the bounding hull of every node, with at most `most` added points, its h and its sphere, level by
/// level from the finest; `scale` converts metres to unit coordinates. Fails with the number of points if
/// 32-bit indices cannot name them.
pub(crate) fn bound_descendants(clod: &mut Parts, most: u32, scale: f64) -> Result<(), usize> {
    let mut added: Vec<Vec<u32>> = vec![Vec::new(); clod.nodes.len()];
    for level in 1..clod.levels.len() {
        let shared: &Parts = clod;
        let found: Vec<Bounds> = shared
            .level(level)
            .par_iter()
            .map_init(HullBuilder::default, |builder, node| bounds(shared, node, most, scale, builder))
            .collect();
        for (node, bounds) in clod.levels[level].nodes.clone().zip(found) {
            let index = node as usize;
            added[index] = bounds.added;
            let node = &mut clod.nodes[index];
            (node.hausdorff, node.center, node.radius) = (bounds.hausdorff, bounds.center, bounds.radius);
        }
    }
    add(clod, &added)
}

fn bounds(clod: &Parts, node: &Node, most: u32, scale: f64, builder: &mut HullBuilder) -> Bounds {
    let unit = |p: DVec3| (p - clod.source.center) * scale;
    let mut points: Vec<DVec3> = clod.extreme(node).iter().map(|p| unit(*p)).collect();
    let mut added = Vec::new();
    let mut search = FarthestSearch::below(node);
    let hausdorff = loop {
        let target = Target::new(points.clone(), builder);
        let (distance, farthest) = search.farthest(clod, scale, |p| target.distance(unit(p)));
        if distance <= ROUNDING {
            break 0.0;
        }
        // A point that was added before differs from the hull by rounding only, and would be found again and
        // again.
        if added.len() == most as usize || added.contains(&farthest) {
            break distance * (1.0 + SLACK) / scale;
        }
        added.push(farthest);
        points.push(unit(clod.vertices[farthest as usize]));
    };
    let center = smallest_sphere(&points).0 / scale + clod.source.center;
    let own = clod.extreme(node).iter().map(|p| p.distance(center)).fold(0.0, f64::max);
    let below = FarthestSearch::below(node).farthest(clod, 1.0, |p| p.distance(center)).0;
    Bounds { added, hausdorff, center, radius: own.max(below) }
}

/// A search for the extreme point of any descendant that is farthest from a set, which may grow from one
/// search to the next: distances found earlier remain upper bounds.
struct FarthestSearch {
    /// Largest bound first.
    waiting: BinaryHeap<Waiting>,
    searches: u32,
}

/// A descendant, or a vertex of a descendant that has been visited.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Waiting {
    /// The leading bits of an upper bound of the distance. It is positive, so that its bits are ordered as
    /// it is.
    bound: u64,
    is_vertex: bool,
    index: Reverse<u32>,
    /// Number of the search that computed it.
    search: u32,
}

impl FarthestSearch {
    fn below(node: &Node) -> Self {
        let bound = f64::INFINITY.to_bits() >> UNCERTAIN_BITS;
        let waiting = node
            .children
            .clone()
            .map(|child| Waiting { bound, is_vertex: false, index: Reverse(child), search: 0 })
            .collect();
        Self { waiting, searches: 0 }
    }

    /// An upper bound of the largest distance, and the vertex that has it: the first of those that are
    /// equally far. `distance` is that of a point, in metres times `scale`. Returns a distance of 0 if no
    /// point has a larger one.
    fn farthest(&mut self, clod: &Parts, scale: f64, distance: impl Fn(DVec3) -> f64) -> (f64, u32) {
        self.searches += 1;
        let search = self.searches;
        let wait = |is_vertex: bool, index: u32| {
            let bound = if is_vertex {
                distance(clod.vertices[index as usize])
            } else {
                // The margin exceeds the rounding of the spheres.
                let Node { center, radius, .. } = clod.nodes[index as usize];
                distance(center) + radius * scale * (1.0 + SLACK)
            };
            (bound > 0.0).then(|| Waiting {
                bound: bound.to_bits() >> UNCERTAIN_BITS,
                is_vertex,
                index: Reverse(index),
                search,
            })
        };
        while let Some(next) = self.waiting.pop() {
            let Reverse(index) = next.index;
            if next.search != search {
                self.waiting.extend(wait(next.is_vertex, index));
            } else if next.is_vertex {
                self.waiting.push(next);
                return (f64::from_bits((next.bound + 1) << UNCERTAIN_BITS), index);
            } else {
                let below = &clod.nodes[index as usize];
                let vertices = below.vertices.start..below.vertices.start + below.extreme;
                self.waiting.extend(vertices.filter_map(|v| wait(true, v)));
                self.waiting.extend(below.children.clone().filter_map(|child| wait(false, child)));
            }
        }
        (0.0, 0)
    }
}

/// Puts the points added to each node's hull before its own.
fn add(clod: &mut Parts, added: &[Vec<u32>]) -> Result<(), usize> {
    let count = clod.vertices.len() + added.iter().map(Vec::len).sum::<usize>();
    if count >= u32::MAX as usize {
        return Err(count);
    }
    let (mut vertices, mut areas) = (Vec::with_capacity(count), Vec::with_capacity(count));
    for (node, added) in clod.nodes.iter_mut().zip(added) {
        let own = node.vertices.clone();
        for vertex in added.iter().copied().chain(own.clone()) {
            vertices.push(clod.vertices[vertex as usize]);
            areas.push(clod.support_areas[vertex as usize]);
        }
        node.added = added.len() as u32;
        let start = vertices.len() as u32 - (own.end - own.start);
        node.vertices = start..vertices.len() as u32;
    }
    (clod.vertices, clod.support_areas) = (vertices, areas);
    Ok(())
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    #[test]
    fn distance_to_a_hull_agrees_with_projection_by_iteration() {
        let seed = 91;
        println!("seed {seed}");
        let mut rng = StdRng::seed_from_u64(seed);
        let mut builder = HullBuilder::default();
        let mut outside = 0;
        for round in 0..200 {
            let flatten = [1.0, 0.0, 1.0][round % 3];
            let mut random = || {
                DVec3::from_array(std::array::from_fn(|k| {
                    rng.random_range(-1.0..1.0) * if k == 2 { flatten } else { 1.0 }
                }))
            };
            let count = [12, 7, 2, 1][round % 4];
            let points: Vec<DVec3> = (0..count).map(|_| random()).collect();
            let p = 1.5 * random() + DVec3::Z * (1.0 - flatten);
            let found = Target::new(points.clone(), &mut builder).distance(p).max(0.0);
            // Frank-Wolfe with away steps would be faster; plain steps are accurate enough.
            let mut x = points[0];
            for _ in 0..20_000 {
                let s = points
                    .iter()
                    .copied()
                    .min_by(|a, b| (x - p).dot(*a).total_cmp(&(x - p).dot(*b)))
                    .unwrap_or(x);
                let along = s - x;
                if along.length_squared() < 1e-30 {
                    break;
                }
                x += along * ((p - x).dot(along) / along.length_squared()).clamp(0.0, 1.0);
            }
            assert!((x.distance(p) - found).abs() < 5e-3, "round {round}: {found} {}", x.distance(p));
            outside += usize::from(found > 0.0);
        }
        assert!((50..200).contains(&outside), "{outside}");
    }
}
