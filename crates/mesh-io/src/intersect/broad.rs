//! Broad phase: finds pairs of triangles whose bounding boxes overlap.
//!
//! Boxes are moved to the middle of all and rounded to f32 for the hierarchy (crate `obvhs`). Both roundings
//! are monotone, so that boxes that overlap still do after them, without padding; the f64 boxes are compared
//! before a pair is passed on.

use glam::{DMat3, DVec3, Vec3A};
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};

/// The bounding boxes of a mesh's triangles, by triangle index.
pub(crate) struct Boxes {
    boxes: Vec<[DVec3; 2]>,
    /// Middle of all boxes, subtracted before rounding so that a mesh far from the origin keeps its digits.
    middle: DVec3,
}

impl Boxes {
    /// Boxes of `count` triangles. A triangle that is to be left out, or has a coordinate that is not finite,
    /// gets an empty box, which overlaps nothing.
    pub(crate) fn new(count: usize, corners: impl Fn(usize) -> Option<[DVec3; 3]>) -> Self {
        let empty = [DVec3::INFINITY, DVec3::NEG_INFINITY];
        let boxes: Vec<[DVec3; 2]> = (0..count)
            .map(|t| match corners(t) {
                Some([a, b, c]) if a.is_finite() && b.is_finite() && c.is_finite() => {
                    [a.min(b).min(c), a.max(b).max(c)]
                }
                _ => empty,
            })
            .collect();
        let [low, high] = boxes.iter().fold(empty, |[low, high], b| [low.min(b[0]), high.max(b[1])]);
        let middle = if low.is_finite() { 0.5 * low + 0.5 * high } else { DVec3::ZERO };
        Self { boxes, middle }
    }

    /// Boxes of the triangles of one mesh, with coordinates up to 1, to be compared with each other: along
    /// the coordinate axes, or along the main direction of the triangles' sides where that makes the boxes
    /// much smaller, as for long parts that are not aligned with an axis.
    pub(crate) fn of_one_mesh(count: usize, corners: impl Fn(usize) -> Option<[DVec3; 3]>) -> Self {
        /// Padding of rotated boxes, in coordinates up to 1: more than the rounding of a rotation.
        const ROUNDING: f64 = 16.0 * f64::EPSILON;
        let plain = Self::new(count, &corners);
        let mut sides = DMat3::ZERO;
        for [a, b, c] in (0..count).filter_map(&corners).filter(|t| t.iter().all(|p| p.is_finite())) {
            for side in [b - a, c - b, a - c] {
                sides += DMat3::from_cols(side * side.x, side * side.y, side * side.z);
            }
        }
        let size = sides.to_cols_array().iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        if size == 0.0 {
            return plain;
        }
        // Power iteration for the main direction of the sides. It need not converge: any axes are valid.
        let start = DVec3::new(0.6, 0.5, 0.4);
        let along = (0..32).fold(start, |v, _| (sides * (1.0 / size) * v).normalize_or(start)).normalize();
        let (across, up) = along.any_orthonormal_pair();
        let turn = DMat3::from_cols(along, across, up).transpose();
        let mut turned = Self::new(count, |t| corners(t).map(|t| t.map(|p| turn * (p - plain.middle))));
        for [low, high] in &mut turned.boxes {
            (*low, *high) = (*low - ROUNDING, *high + ROUNDING);
        }
        if turned.area() < 0.25 * plain.area() { turned } else { plain }
    }

    /// Half the surface area of all boxes.
    fn area(&self) -> f64 {
        let filled = self.boxes.iter().filter(|b| b[0].is_finite());
        filled.map(|[low, high]| *high - *low).map(|d| d.x * d.y + d.y * d.z + d.z * d.x).sum()
    }

    fn rounded(&self, [low, high]: [DVec3; 2]) -> Aabb {
        let rounded = |p: DVec3| Vec3A::from((p - self.middle).as_vec3());
        Aabb::new(rounded(low), rounded(high))
    }

    /// The hierarchy over the boxes that are not empty. Built on one thread and without hashing, hence
    /// deterministic.
    pub(crate) fn tree(&self) -> Bvh2 {
        let filled: Vec<u32> =
            (0..self.boxes.len() as u32).filter(|&t| self.boxes[t as usize][0].is_finite()).collect();
        let boxes: Vec<Aabb> = filled.iter().map(|&t| self.rounded(self.boxes[t as usize])).collect();
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

    /// Collects the triangles in `tree` (of the boxes `of`) whose boxes overlap that of `triangle` of this
    /// set.
    pub(crate) fn overlapping(&self, triangle: usize, of: &Self, tree: &Bvh2, found: &mut Vec<u32>) {
        of.touching(self.boxes[triangle], tree, found);
    }

    /// Collects the triangles in `tree` (of this set) whose boxes overlap one given by its corners.
    pub(crate) fn touching(&self, [low, high]: [DVec3; 2], tree: &Bvh2, found: &mut Vec<u32>) {
        found.clear();
        if !low.is_finite() || tree.nodes.is_empty() {
            return;
        }
        tree.aabb_traverse(self.rounded([low, high]), |tree, node| {
            let node = &tree.nodes[node as usize];
            let first = node.first_index as usize;
            for &other in &tree.primitive_indices[first..first + node.prim_count as usize] {
                let [other_low, other_high] = self.boxes[other as usize];
                if low.cmple(other_high).all() && other_low.cmple(high).all() {
                    found.push(other);
                }
            }
            true
        });
    }
}
