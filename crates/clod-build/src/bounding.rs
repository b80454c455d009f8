//! What a node needs to bound its descendants when it is culled: h (§3.3.5), points that bring h down, and a sphere.
//!
//! The hulls of a simplified level need not contain those of the finer levels (§3.6.2). Departing from the dissertation, which
//! makes up for it by h alone, a hull is given a few points of its descendants for culling: each time the one that is farthest from it.
//! The hull of the points and the descendants lies within the hull's neighbourhood of width h, so that every point
//! added makes for tighter culling; what it costs is that supporting points are sought among more. With as many points as it takes
//! h is 0, and each hull contains its descendants.
//!
//! The distance to a convex set is a convex function, so that its maximum over a hull is at one of its extreme points. The
//! maximum over all descendants is found exactly, without visiting most of them: none is further away than the sphere around
//! them.

use glam::DVec3;
use palpate_core::Clod;
use palpate_core::clod::Node;
use rayon::prelude::*;

use crate::convexity::HULL_THICKNESS;
use crate::enclosing::smallest_sphere;
use crate::hull::{Hull, HullBuilder, Plane, Shape};
use crate::nearest::distance_to_triangle;

/// Distances below this, in unit coordinates, are rounding: the hull contains its descendants.
const ROUNDING: f64 = 1e-13;

/// What is added to a distance, as a fraction of it, so that it remains a bound in spite of rounding.
const SLACK: f64 = 1e-9;

/// A convex hull that distances are taken to.
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

    /// How far a point is from the hull; 0 inside.
    pub fn distance(&self, p: DVec3) -> f64 {
        let at = |v: u32| self.points[v as usize];
        let least = |distances: &mut dyn Iterator<Item = f64>| distances.fold(f64::INFINITY, f64::min);
        if self.hull.shape == Shape::Polytope {
            // The nearest point is on a face that is visible from the point.
            let visible = self.hull.faces.iter().zip(&self.planes).filter(|(_, plane)| plane.height(p) > 0.0);
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

/// What bounds a node's descendants; in metres.
struct Bounds {
    /// Points of [`Clod::vertices`] that are added to the hull.
    added: Vec<u32>,
    hausdorff: f64,
    center: DVec3,
    radius: f64,
}

/// Sets the bounding hull of every node, with `most` added points at most, its h and its sphere, level by level from the finest; `scale` makes
/// unit coordinates of metres.
pub(crate) fn bound_descendants(clod: &mut Clod, most: u32, scale: f64) {
    let mut added: Vec<Vec<u32>> = vec![Vec::new(); clod.nodes.len()];
    for level in 1..clod.levels.len() {
        let shared: &Clod = clod;
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
    add(clod, &added);
}

fn bounds(clod: &Clod, node: &Node, most: u32, scale: f64, builder: &mut HullBuilder) -> Bounds {
    let unit = |p: DVec3| (p - clod.source.center) * scale;
    let mut points: Vec<DVec3> = clod.extreme(node).iter().map(|p| unit(*p)).collect();
    let mut added = Vec::new();
    let hausdorff = loop {
        let target = Target::new(points.clone(), builder);
        // The sphere tells how far a descendant can be at most.
        let (distance, farthest) = farthest_descendant(clod, node, scale, |p| target.distance(unit(p)));
        if distance <= ROUNDING {
            break 0.0;
        }
        if added.len() == most as usize {
            break distance * (1.0 + SLACK) / scale;
        }
        added.push(farthest);
        points.push(unit(clod.vertices[farthest as usize]));
    };
    let center = smallest_sphere(&points).0 / scale + clod.source.center;
    let own = clod.extreme(node).iter().map(|p| p.distance(center)).fold(0.0, f64::max);
    let below = farthest_descendant(clod, node, 1.0, |p| p.distance(center)).0;
    Bounds { added, hausdorff, center, radius: own.max(below) }
}

/// How far the farthest extreme point of any descendant is, and which of the vertices that is; `distance` is that of a
/// point, in metres times `scale`.
fn farthest_descendant(clod: &Clod, node: &Node, scale: f64, distance: impl Fn(DVec3) -> f64) -> (f64, u32) {
    let mut farthest = (0.0, node.vertices.start);
    let mut stack: Vec<(f64, u32)> = Vec::new();
    let mut children = node.children.clone();
    loop {
        let first = stack.len();
        stack.extend(children.map(|child| {
            let Node { center, radius, .. } = clod.nodes[child as usize];
            (distance(center) + radius * scale, child)
        }));
        // The most promising is looked at first.
        stack[first..].sort_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
        let next = loop {
            match stack.pop() {
                None => return farthest,
                Some((bound, child)) if bound * (1.0 + SLACK) > farthest.0 => break child,
                Some(_) => {}
            }
        };
        let below = &clod.nodes[next as usize];
        for (vertex, p) in (below.vertices.start..).zip(clod.extreme(below)) {
            let distance = distance(*p);
            if distance > farthest.0 {
                farthest = (distance, vertex);
            }
        }
        children = below.children.clone();
    }
}

/// Puts the points added to each node's hull before its own.
fn add(clod: &mut Clod, added: &[Vec<u32>]) {
    let count = clod.vertices.len() + added.iter().map(Vec::len).sum::<usize>();
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
            let found = Target::new(points.clone(), &mut builder).distance(p);
            // Frank-Wolfe with away steps would be quicker; plain steps get near enough.
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
