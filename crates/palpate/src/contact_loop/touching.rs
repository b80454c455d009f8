//! The patches that representative contacts lie in, for contact monitors.

use palpate_core::Clod;
use palpate_core::glam::DVec3;
use palpate_core::triangle::nearest_on_triangle;

use crate::penalties::proxy::ProxyContact;

/// Largest number of contacts in a snapshot; the deepest are kept.
pub(super) const MAX_SHOWN: usize = 16;

/// Search for the patches at contacts, with its workspace.
#[derive(Clone, Debug, Default)]
pub(super) struct Patches {
    waiting: Vec<(u32, f64)>,
    pub deepest: Vec<ProxyContact>,
}

impl Patches {
    pub fn new() -> Self {
        Self { waiting: Vec::with_capacity(1024), deepest: Vec::with_capacity(MAX_SHOWN + 1) }
    }

    /// Keeps the deepest of the contacts, deepest first.
    pub fn choose<'a>(&mut self, contacts: impl Iterator<Item = &'a ProxyContact>) {
        self.deepest.clear();
        for found in contacts {
            let depth = found.contact.contact.depth;
            let at = self.deepest.partition_point(|other| other.contact.contact.depth >= depth);
            if at < MAX_SHOWN {
                self.deepest.insert(at, *found);
                self.deepest.truncate(MAX_SHOWN);
            }
        }
    }

    /// Returns the node whose patch of the full mesh is nearest to a point (m, mesh frame), by branch and
    /// bound; none without triangles.
    pub fn leaf_at(&mut self, clod: &Clod, point: DVec3) -> Option<u32> {
        // Lower bound on the distance to any patch below a node.
        let bound = |node: u32| {
            let node = clod.node(node);
            (point.distance(node.center) - node.radius).max(0.0)
        };
        let coarsest = clod.levels.last()?.nodes.clone();
        let Self { waiting, .. } = self;
        waiting.clear();
        waiting.extend(coarsest.map(|node| (node, bound(node))));
        let mut best = (None, f64::INFINITY);
        while let Some((index, least)) = waiting.pop() {
            if least > best.1 {
                continue;
            }
            let node = clod.node(index);
            if node.children.is_empty() {
                let hull = clod.hull(&node);
                let corners = |triangle: [u32; 3]| triangle.map(|corner| hull[corner as usize]);
                let distance = |triangle| nearest_on_triangle(point, &corners(triangle)).0.distance(point);
                for distance in clod.patch(&node).iter().map(distance) {
                    if distance < best.1 {
                        best = (Some(index), distance);
                    }
                }
                continue;
            }
            let first = waiting.len();
            waiting.extend(node.children.clone().map(|child| (child, bound(child))));
            // The nearest child is popped first.
            waiting[first..].sort_unstable_by(|one, other| other.1.total_cmp(&one.1));
        }
        best.0
    }
}

#[cfg(all(test, feature = "models"))]
mod tests {
    use super::*;
    use crate::scene::object::Object;

    #[test]
    fn a_point_on_a_patch_finds_that_patch() {
        let clod = Object::model("golf-ball@2000").expect("a model").clod;
        let mut patches = Patches::new();
        for leaf in clod.leaves() {
            let hull = clod.hull(&leaf);
            for triangle in clod.patch(&leaf).iter() {
                let [a, b, c] = triangle.map(|corner| hull[corner as usize]);
                let found = patches.leaf_at(&clod, (a + b + c) / 3.0).expect("a leaf");
                assert_eq!(clod.node(found).vertices, leaf.vertices);
            }
        }
    }
}
