//! Broad phase: which triangles' bounding boxes overlap.
//!
//! Boxes are rounded to f32 for the hierarchy (crate `obvhs`). Rounding is monotone, so that boxes that overlap still do
//! after it, without padding; the f64 boxes are compared before a pair is passed on.

use glam::{DVec3, Vec3A};
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};

/// The bounding boxes of a mesh's triangles, by triangle index.
pub(super) struct Boxes {
    boxes: Vec<[DVec3; 2]>,
}

impl Boxes {
    /// Boxes of `count` triangles. A triangle that is to be left out, or has a coordinate that is not finite, gets an empty
    /// box, which overlaps nothing.
    pub(super) fn new(count: usize, corners: impl Fn(usize) -> Option<[DVec3; 3]>) -> Self {
        let empty = [DVec3::INFINITY, DVec3::NEG_INFINITY];
        let boxes = (0..count)
            .map(|t| match corners(t) {
                Some([a, b, c]) if a.is_finite() && b.is_finite() && c.is_finite() => {
                    [a.min(b).min(c), a.max(b).max(c)]
                }
                _ => empty,
            })
            .collect();
        Self { boxes }
    }

    fn rounded(&self, triangle: usize) -> Aabb {
        let [low, high] = self.boxes[triangle];
        Aabb::new(Vec3A::from(low.as_vec3()), Vec3A::from(high.as_vec3()))
    }

    /// The hierarchy over the boxes that are not empty. Built on one thread and without hashing, hence deterministic.
    pub(super) fn tree(&self) -> Bvh2 {
        let filled: Vec<u32> =
            (0..self.boxes.len() as u32).filter(|&t| self.boxes[t as usize][0].is_finite()).collect();
        let boxes: Vec<Aabb> = filled.iter().map(|&t| self.rounded(t as usize)).collect();
        let mut tree = PlocBuilder::new().build(
            PlocSearchDistance::Low,
            &boxes,
            (0..boxes.len() as u32).collect(),
            SortPrecision::U64,
            0,
        );
        for index in &mut tree.primitive_indices {
            *index = filled[*index as usize];
        }
        tree
    }

    /// Collects the triangles in `tree` (of the boxes `of`) whose boxes overlap that of `triangle` of this set.
    pub(super) fn overlapping(&self, triangle: usize, of: &Self, tree: &Bvh2, found: &mut Vec<u32>) {
        found.clear();
        let [low, high] = self.boxes[triangle];
        if !low.is_finite() {
            return;
        }
        tree.aabb_traverse(self.rounded(triangle), |tree, node| {
            let node = &tree.nodes[node as usize];
            let first = node.first_index as usize;
            for &other in &tree.primitive_indices[first..first + node.prim_count as usize] {
                let [other_low, other_high] = of.boxes[other as usize];
                if low.cmple(other_high).all() && other_low.cmple(high).all() {
                    found.push(other);
                }
            }
            true
        });
    }
}
