//! A tree of axis-aligned boxes over items that may move.
//!
//! It is split at the median of the longest side, so that it is balanced and deterministic. An item that has
//! moved is refitted in place: the boxes from its leaf up are recomputed until one does not change. The
//! splits remain those of the original positions, so that rebuilding pays once many items have moved or were
//! removed.
//!
//! Measured against `obvhs` 0.4 (boxes in f32, widened outwards, one triangle a leaf) and a hashed grid whose
//! cells are as long as an edge. All replay the collapses that reduce a torus to a sixteenth of its
//! triangles, and are rebuilt (except where leaves move) when half are gone. In thousands of instructions, by
//! the command below:
//!
//! | | a query, 10k triangles | 100k | changes of a collapse, 10k | 100k |
//! |---|---|---|---|---|
//! | this tree | 4.3 | 4.4 | 5.7 | 6.6 |
//! | `obvhs`, boxes refitted | 4.3 | 4.6 | 7.7 | 8.0 |
//! | `obvhs`, leaves moved and removed | 4.2 | 5.1 | 21.1 | 25.0 |
//! | grid, made anew | 6.6 | 7.0 | 29.0 | 29.3 |
//! | grid, cells as they were first | 11.5 | 12.7 | 34.4 | 36.6 |
//!
//! A query is of the box around the fan of a merged vertex; in a collapse some eight triangles change and two
//! are removed, and the cost of rebuilding is included in the changes. The two trees do the same, and their
//! cost grows with the logarithm of the mesh's size. Moving leaves to keep a tree good costs more than it
//! saves; a grid pays for the cells of each triangle, and for large triangles in small cells as the surface
//! gets coarser. So this tree is used: it needs no f32, and its [nodes](BoxTree::nodes) are open to
//! traversals that test more than boxes.
//!
//! ```text
//! cargo bench -p palpate-clod-build --bench spatial_index --no-run
//! valgrind --tool=callgrind --toggle-collect='*replay*' target/release/deps/spatial_index-… --bench --test '^ours/10000/tries/1$'
//! ```
//!
//! (likewise with 8 tries; minus the count with a filter that matches nothing; divided by 4,728 collapses of
//! 10,000 triangles and 47,061 of 100,000). The comparison is finished, and its code is not kept: `git
//! checkout b4d5a15` has it.

use glam::DVec3;

/// Largest number of items of a leaf.
const LEAF_ITEMS: usize = 4;
const NONE: u32 = u32::MAX;

/// Number of cells along the longest side of a tree's box to which middles are rounded, so that rounding
/// errors do not decide which of two equal ones comes first.
const CELLS: f64 = 1e9;

/// Lower and upper corner of a box; the lower above the upper for an empty one.
pub(crate) type Bounds = (DVec3, DVec3);

/// The empty box.
pub(crate) const EMPTY: Bounds = (DVec3::INFINITY, DVec3::NEG_INFINITY);

#[derive(Clone, Copy, Debug)]
pub(crate) struct BoxNode {
    pub low: DVec3,
    pub high: DVec3,
    /// First item of a leaf (in `order`), or the index of the second child; the first child follows its
    /// parent.
    pub first: u32,
    /// Number of items of a leaf; 0 for an inner node.
    pub count: u32,
}

/// The tree; node 0 is the root.
#[derive(Clone, Debug, Default)]
pub(crate) struct BoxTree {
    pub nodes: Vec<BoxNode>,
    pub order: Vec<u32>,
    parents: Vec<u32>,
    leaf_of: Vec<u32>,
}

impl BoxTree {
    /// A tree over items with the given boxes. Items whose boxes are empty are left out permanently.
    pub fn new(boxes: &[Bounds]) -> Self {
        let mut order: Vec<u32> =
            (0..boxes.len() as u32).filter(|item| !is_empty(boxes[*item as usize])).collect();
        if order.is_empty() {
            // The root has to be a leaf.
            order.extend(0..boxes.len() as u32);
        }
        let mut tree = Self {
            nodes: Vec::with_capacity(order.len()),
            order: Vec::new(),
            parents: Vec::with_capacity(order.len()),
            leaf_of: vec![NONE; boxes.len()],
        };
        let (low, high) = union(order.iter().map(|item| boxes[*item as usize]));
        let cell = (high - low).max_element() / CELLS;
        let cell = if cell > 0.0 { cell } else { 1.0 };
        let middles: Vec<DVec3> =
            boxes.iter().map(|(from, to)| ((0.5 * (*from + *to) - low) / cell).round()).collect();
        tree.split(boxes, &middles, &mut order, 0, NONE);
        tree.order = order;
        tree
    }

    fn split(&mut self, boxes: &[Bounds], middles: &[DVec3], order: &mut [u32], first: u32, parent: u32) {
        let (low, high) = union(order.iter().map(|item| boxes[*item as usize]));
        let node = self.nodes.len();
        self.nodes.push(BoxNode { low, high, first, count: order.len() as u32 });
        self.parents.push(parent);
        if order.len() <= LEAF_ITEMS {
            for item in order {
                self.leaf_of[*item as usize] = node as u32;
            }
            return;
        }
        let (near, far) =
            order.iter().fold(EMPTY, |(n, f), k| (n.min(middles[*k as usize]), f.max(middles[*k as usize])));
        let axis = (far - near).max_position();
        let half = order.len() / 2;
        order.select_nth_unstable_by(half, |a, b| {
            middles[*a as usize][axis].total_cmp(&middles[*b as usize][axis]).then(a.cmp(b))
        });
        let (left, right) = order.split_at_mut(half);
        self.split(boxes, middles, left, first, node as u32);
        (self.nodes[node].first, self.nodes[node].count) = (self.nodes.len() as u32, 0);
        self.split(boxes, middles, right, first + half as u32, node as u32);
    }

    /// The items of a leaf.
    pub fn items(&self, leaf: &BoxNode) -> &[u32] {
        &self.order[leaf.first as usize..(leaf.first + leaf.count) as usize]
    }

    /// Refits the boxes after an item has moved; `bounds` returns the box of any item.
    pub fn refit(&mut self, item: u32, bounds: impl Fn(u32) -> Bounds) {
        let mut node = self.leaf_of[item as usize];
        while node != NONE {
            let here = self.nodes[node as usize];
            let (low, high) = if here.count > 0 {
                union(self.items(&here).iter().map(|item| bounds(*item)))
            } else {
                union([node + 1, here.first].map(|c| {
                    let child = &self.nodes[c as usize];
                    (child.low, child.high)
                }))
            };
            if low == here.low && high == here.high {
                return;
            }
            let here = &mut self.nodes[node as usize];
            (here.low, here.high) = (low, high);
            node = self.parents[node as usize];
        }
    }

    /// Calls `visit` with each item of the leaves that meet a box, until one call returns true; returns
    /// whether one did. The item itself may lie outside the box.
    pub fn any_near(
        &self,
        (low, high): Bounds,
        stack: &mut Vec<u32>,
        mut visit: impl FnMut(u32) -> bool,
    ) -> bool {
        stack.clear();
        if !self.nodes.is_empty() {
            stack.push(0);
        }
        while let Some(index) = stack.pop() {
            let node = &self.nodes[index as usize];
            if node.low.cmpgt(high).any() || node.high.cmplt(low).any() {
                continue;
            }
            if node.count == 0 {
                stack.extend([node.first, index + 1]);
            } else if self.items(node).iter().any(|item| visit(*item)) {
                return true;
            }
        }
        false
    }
}

fn is_empty((low, high): Bounds) -> bool {
    low.cmpgt(high).any()
}

fn union(boxes: impl IntoIterator<Item = Bounds>) -> Bounds {
    boxes.into_iter().fold(EMPTY, |a, b| (a.0.min(b.0), a.1.max(b.1)))
}

/// Whether two boxes have a point in common.
pub(crate) fn meet(a: Bounds, b: Bounds) -> bool {
    a.0.cmple(b.1).all() && b.0.cmple(a.1).all()
}

/// The smallest box around points.
pub(crate) fn bounds_of(points: &[DVec3]) -> Bounds {
    points.iter().fold(EMPTY, |(low, high), p| (low.min(*p), high.max(*p)))
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    #[test]
    fn moved_items_are_found_where_they_are() {
        let seed = 51;
        println!("seed {seed}");
        let mut rng = StdRng::seed_from_u64(seed);
        let mut random_box = || {
            let p = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
            (p, p + DVec3::splat(rng.random_range(0.0..0.5)))
        };
        let mut boxes: Vec<Bounds> = (0..300).map(|_| random_box()).collect();
        let mut tree = BoxTree::new(&boxes);
        let mut stack = Vec::new();
        let mut found_any = 0;
        for round in 0..600 {
            let item = (round * 7) % 300;
            boxes[item] = if round % 5 == 0 { EMPTY } else { random_box() };
            tree.refit(item as u32, |k| boxes[k as usize]);
            let query = random_box();
            let mut found = Vec::new();
            tree.any_near(query, &mut stack, |k| {
                if meet(boxes[k as usize], query) {
                    found.push(k);
                }
                false
            });
            found.sort_unstable();
            let expected: Vec<u32> = (0..300).filter(|k| meet(boxes[*k as usize], query)).collect();
            assert_eq!(found, expected, "round {round}");
            found_any += found.len();
        }
        assert!(found_any > 300);
    }

    #[test]
    fn empty_items_are_left_out() {
        let point = |x: f64| (DVec3::splat(x), DVec3::splat(x));
        let boxes: Vec<Bounds> =
            (0..100).map(|k| if k % 3 == 0 { point(f64::from(k)) } else { EMPTY }).collect();
        let mut tree = BoxTree::new(&boxes);
        assert_eq!(tree.order.len(), 34);
        // Refitting one of them does nothing.
        tree.refit(1, |k| boxes[k as usize]);
        let mut found = Vec::new();
        tree.any_near((DVec3::ZERO, DVec3::splat(99.0)), &mut Vec::new(), |k| {
            found.push(k);
            false
        });
        found.sort_unstable();
        assert_eq!(found, (0..100).step_by(3).collect::<Vec<_>>());
        let nothing = BoxTree::new(&[EMPTY; 5]);
        assert!(!nothing.any_near((DVec3::NEG_ONE, DVec3::ONE), &mut Vec::new(), |_| true));
    }
}
