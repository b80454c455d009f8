//! Support mapping: the extreme point of a hull in a direction.
//!
//! Small hulls are scanned. Larger ones carry a [`SupportTree`], a bounding-box tree over their points that is searched
//! by branch and bound: unlike hill climbing it needs no hull faces, which a hierarchy does not store, and it cannot
//! get stuck on coplanar points.

use palpate_core::glam::DVec3;

/// Points of a leaf of a [`SupportTree`].
const LEAF_POINTS: usize = 8;

/// Enough for a balanced tree over 2³² points.
const STACK: usize = 64;

/// A convex hull as the set of its extreme points, in its own frame.
#[derive(Clone, Copy, Debug)]
pub struct Hull<'a> {
    points: &'a [DVec3],
    tree: Option<&'a SupportTree>,
}

impl<'a> Hull<'a> {
    /// The hull of some points (m), at least one. Points that are not extreme do no harm.
    pub fn new(points: &'a [DVec3]) -> Self {
        debug_assert!(!points.is_empty());
        Self { points, tree: None }
    }

    /// The hull of some points with a tree that was built over the same points.
    pub fn with_tree(points: &'a [DVec3], tree: Option<&'a SupportTree>) -> Self {
        debug_assert!(tree.is_none_or(|tree| tree.order.len() == points.len()));
        Self { points, tree }
    }

    /// The points, m.
    pub fn points(&self) -> &'a [DVec3] {
        self.points
    }

    /// Index of a point that lies furthest in a direction (of any length). `hint`: a point that may lie far along it,
    /// such as the last answer.
    pub fn support(&self, direction: DVec3, hint: u32) -> u32 {
        match self.tree {
            Some(tree) => tree.support(direction, hint, self.points[hint as usize].dot(direction)),
            None => scan(self.points, direction).0,
        }
    }
}

/// Index of the first point that lies furthest in a direction, and how far.
fn scan(points: &[DVec3], direction: DVec3) -> (u32, f64) {
    let mut best = (0, f64::NEG_INFINITY);
    for (index, point) in (0u32..).zip(points) {
        let reach = point.dot(direction);
        if reach > best.1 {
            best = (index, reach);
        }
    }
    best
}

/// A tree of bounding boxes over a hull's points.
#[derive(Clone, Debug, Default)]
pub struct SupportTree {
    /// Points, in the order of the leaves.
    points: Vec<DVec3>,
    /// Index of each of them in the hull.
    order: Vec<u32>,
    /// Nodes in depth-first order: the first child follows its parent.
    nodes: Vec<Box3>,
}

#[derive(Clone, Copy, Debug)]
struct Box3 {
    center: DVec3,
    half: DVec3,
    /// Second child, or 0 for a leaf.
    second: u32,
    start: u32,
    end: u32,
}

impl SupportTree {
    /// From this many points on, a tree is faster than a scan.
    pub const WORTHWHILE: usize = 48;

    /// A tree over a hull's points.
    pub fn new(points: &[DVec3]) -> Self {
        let mut order: Vec<u32> = (0u32..).take(points.len()).collect();
        let mut nodes = Vec::with_capacity(2 * points.len() / LEAF_POINTS + 1);
        split(points, &mut order, 0, &mut nodes);
        Self { points: order.iter().map(|&i| points[i as usize]).collect(), order, nodes }
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        self.points.len() * (size_of::<DVec3>() + size_of::<u32>()) + self.nodes.len() * size_of::<Box3>()
    }

    /// `hint`: a point of the hull, and how far it lies in the direction.
    fn support(&self, direction: DVec3, hint: u32, reach: f64) -> u32 {
        let magnitude = direction.abs();
        let bound = |node: u32| {
            let node = &self.nodes[node as usize];
            node.center.dot(direction) + node.half.dot(magnitude)
        };
        let mut best = (hint, reach);
        let mut stack = [(0u32, f64::INFINITY); STACK];
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let (index, reach) = stack[depth];
            if reach <= best.1 {
                continue;
            }
            let node = &self.nodes[index as usize];
            if node.second == 0 {
                let (offset, reach) = scan(&self.points[node.start as usize..node.end as usize], direction);
                if reach > best.1 {
                    best = (self.order[(node.start + offset) as usize], reach);
                }
                continue;
            }
            let (first, second) = ((index + 1, bound(index + 1)), (node.second, bound(node.second)));
            let (near, far) = if first.1 >= second.1 { (first, second) } else { (second, first) };
            stack[depth] = far;
            stack[depth + 1] = near;
            depth += 2;
        }
        best.0
    }
}

/// Appends the subtree over `order`, which holds the points from `start` on in the final order.
fn split(points: &[DVec3], order: &mut [u32], start: u32, nodes: &mut Vec<Box3>) {
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for &index in order.iter() {
        low = low.min(points[index as usize]);
        high = high.max(points[index as usize]);
    }
    let node = nodes.len();
    nodes.push(Box3 {
        center: (low + high) / 2.0,
        // Rounding up a little keeps the bound above every point's own dot product.
        half: (high - low) / 2.0 + (low.abs() + high.abs()) * (2.0 * f64::EPSILON),
        second: 0,
        start,
        end: start + order.len() as u32,
    });
    if order.len() <= LEAF_POINTS {
        return;
    }
    let extent = high - low;
    let axis = if extent.x >= extent.y && extent.x >= extent.z {
        0
    } else if extent.y >= extent.z {
        1
    } else {
        2
    };
    let middle = order.len() / 2;
    order.select_nth_unstable_by(middle, |&i, &j| {
        points[i as usize][axis].total_cmp(&points[j as usize][axis]).then(i.cmp(&j))
    });
    let (first, second) = order.split_at_mut(middle);
    split(points, first, start, nodes);
    nodes[node].second = nodes.len() as u32;
    split(points, second, start + middle as u32, nodes);
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    #[test]
    fn a_tree_finds_what_a_scan_finds() {
        let mut rng = StdRng::seed_from_u64(0x5EED_0001);
        for round in 0..200 {
            let count = rng.random_range(1..400);
            let flat = round % 3 == 0;
            let points: Vec<DVec3> = (0..count)
                .map(|_| {
                    let p = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
                    if flat { p * DVec3::new(1.0, 1.0, 0.0) } else { p.normalize_or_zero() * 3.0 }
                })
                .collect();
            let tree = SupportTree::new(&points);
            let hull = Hull::with_tree(&points, Some(&tree));
            for _ in 0..50 {
                let direction = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
                let hint = rng.random_range(0..count);
                let found = points[hull.support(direction, hint) as usize].dot(direction);
                assert!(found >= scan(&points, direction).1 - 1e-14, "seed 0x5EED_0001, round {round}");
            }
        }
    }

    #[test]
    fn equal_points_do_not_unbalance_the_tree() {
        let points = vec![DVec3::ONE; 1000];
        let tree = SupportTree::new(&points);
        assert!(Hull::with_tree(&points, Some(&tree)).support(DVec3::X, 999) < 1000);
    }
}
