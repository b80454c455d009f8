//! The patches that representative contacts lie in, for those who look on.

use palpate_core::Clod;
use palpate_core::glam::DVec3;

use crate::contact::proxy::ProxyContact;

/// So many of the deepest contacts are shown, at most.
pub(super) const SHOWN: usize = 16;

/// Finds patches. It keeps its memory.
#[derive(Clone, Debug, Default)]
pub(super) struct Patches {
    waiting: Vec<(u32, f64)>,
    pub deepest: Vec<ProxyContact>,
}

impl Patches {
    pub fn new() -> Self {
        Self { waiting: Vec::with_capacity(1024), deepest: Vec::with_capacity(SHOWN + 1) }
    }

    /// Keeps the deepest of contacts.
    pub fn choose<'a>(&mut self, contacts: impl Iterator<Item = &'a ProxyContact>) {
        self.deepest.clear();
        for found in contacts {
            let depth = found.contact.contact.depth;
            let at = self.deepest.partition_point(|other| other.contact.contact.depth >= depth);
            if at < SHOWN {
                self.deepest.insert(at, *found);
                self.deepest.truncate(SHOWN);
            }
        }
    }

    /// The node whose patch of the full mesh is nearest to a point of its frame; none without triangles.
    pub fn leaf_at(&mut self, clod: &Clod, point: DVec3) -> Option<u32> {
        // No point of what is below a node is nearer than this.
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
                for distance in clod.patch(&node).iter().map(|triangle| distance(point, corners(triangle))) {
                    if distance < best.1 {
                        best = (Some(index), distance);
                    }
                }
                continue;
            }
            let first = waiting.len();
            waiting.extend(node.children.clone().map(|child| (child, bound(child))));
            // The nearest is next.
            waiting[first..].sort_unstable_by(|one, other| other.1.total_cmp(&one.1));
        }
        best.0
    }
}

/// From a triangle.
fn distance(point: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let sides = [(a, b), (b, c), (c, a)];
    let normal = (b - a).cross(c - a).normalize_or_zero();
    let is_above = sides.iter().all(|(from, to)| (*to - *from).cross(point - *from).dot(normal) >= 0.0);
    if normal != DVec3::ZERO && is_above {
        return (point - a).dot(normal).abs();
    }
    let to_side = |(from, to): (DVec3, DVec3)| {
        let way = to - from;
        let part = (point - from).dot(way) / way.length_squared().max(f64::MIN_POSITIVE);
        point.distance(from + way * part.clamp(0.0, 1.0))
    };
    sides.into_iter().map(to_side).fold(f64::INFINITY, f64::min)
}

#[cfg(all(test, feature = "models"))]
mod tests {
    use super::*;
    use crate::scene::object::Object;

    #[test]
    fn a_place_in_a_patch_is_of_that_patch() {
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
