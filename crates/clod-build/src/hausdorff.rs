//! h: the maximum directed Hausdorff distance from the descendants' hulls to each hull (§3.3.5), which makes culling on the
//! hierarchy conservative (Eq. 3.5).
//!
//! The distance to a convex set is a convex function, so that its maximum over a hull is at one of its extreme points. The
//! maximum over all descendants is found exactly, without visiting most of them: no descendant of a node is further away
//! than the node plus the node's own h.

use glam::DVec3;
use palpate_core::Clod;
use palpate_core::clod::Node;
use rayon::prelude::*;

use crate::convexity::HULL_THICKNESS;
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

/// Sets h of every node, level by level from the finest; `scale` makes unit coordinates of metres.
pub(crate) fn set_hausdorff_distances(clod: &mut Clod, scale: f64) {
    for level in 1..clod.levels.len() {
        let shared: &Clod = clod;
        let found: Vec<f64> = shared
            .level(level)
            .par_iter()
            .map_init(HullBuilder::default, |builder, node| farthest_descendant(shared, node, scale, builder))
            .collect();
        let nodes = clod.levels[level].nodes.clone();
        for (node, h) in nodes.zip(found) {
            clod.nodes[node as usize].hausdorff = h;
        }
    }
}

/// h of a node, m, whose descendants' are known.
fn farthest_descendant(clod: &Clod, node: &Node, scale: f64, builder: &mut HullBuilder) -> f64 {
    let center = clod.source.center;
    let unit = |p: &DVec3| (*p - center) * scale;
    let target = Target::new(clod.extreme(node).iter().map(unit).collect(), builder);
    let mut farthest = 0.0f64;
    let mut stack: Vec<u32> = node.children.clone().collect();
    while let Some(index) = stack.pop() {
        let below = &clod.nodes[index as usize];
        let own = clod.extreme(below).iter().map(|p| target.distance(unit(p))).fold(0.0, f64::max);
        farthest = farthest.max(own);
        if own + below.hausdorff * scale > farthest {
            stack.extend(below.children.clone());
        }
    }
    if farthest <= ROUNDING { 0.0 } else { farthest * (1.0 + SLACK) / scale }
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
