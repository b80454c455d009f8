//! `obvhs`: boxes in f32, widened outwards, one triangle a leaf.

use glam::DVec3;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};

use crate::Index;
use crate::box_tree::{Bounds, EMPTY, meet};

fn widened((low, high): Bounds) -> Aabb {
    let down = |x: f64| if f64::from(x as f32) > x { (x as f32).next_down() } else { x as f32 };
    let each = |p: DVec3, f: &dyn Fn(f64) -> f32| p.to_array().map(f).into();
    Aabb::new(each(low, &down), each(high, &|x| -down(-x)))
}

struct Tree {
    boxes: Vec<Bounds>,
    tree: Bvh2,
}

impl Tree {
    fn new(boxes: Vec<Bounds>) -> Self {
        let (indices, live): (Vec<u32>, Vec<Aabb>) = (0..)
            .zip(&boxes)
            .filter(|(_, bounds)| bounds.0.x <= bounds.1.x)
            .map(|(t, bounds)| (t, widened(*bounds)))
            .unzip();
        let places = (0..live.len() as u32).collect();
        let mut tree = PlocBuilder::with_capacity(live.len()).build(
            PlocSearchDistance::Low,
            &live,
            places,
            SortPrecision::U64,
            0,
        );
        for place in &mut tree.primitive_indices {
            *place = indices[*place as usize];
        }
        tree.primitives_to_nodes = vec![u32::MAX; boxes.len()];
        for (k, node) in tree.nodes.iter().enumerate().filter(|(_, node)| node.is_leaf()) {
            tree.primitives_to_nodes[tree.primitive_indices[node.first_index as usize] as usize] = k as u32;
        }
        tree.init_parents_if_uninit();
        Self { boxes, tree }
    }

    fn count(&self, query: Bounds) -> usize {
        let mut count = 0;
        self.tree.aabb_traverse(widened(query), |tree, node| {
            let t = tree.primitive_indices[tree.nodes[node as usize].first_index as usize];
            count += usize::from(meet(self.boxes[t as usize], query));
            true
        });
        count
    }
}

/// Boxes are refitted where they are, as in our tree.
pub struct Refitted(Tree);

impl Index for Refitted {
    fn new(boxes: &[Bounds]) -> Self {
        Self(Tree::new(boxes.to_vec()))
    }

    fn count(&mut self, query: Bounds) -> usize {
        self.0.count(query)
    }

    fn moved(&mut self, triangle: u32, bounds: Bounds) {
        self.0.boxes[triangle as usize] = bounds;
        let node = self.0.tree.primitives_to_nodes[triangle as usize];
        self.0.tree.resize_node(node as usize, widened(bounds));
    }

    fn removed(&mut self, triangle: u32) {
        self.moved(triangle, EMPTY);
    }

    fn halved(&mut self) {
        self.0 = Tree::new(std::mem::take(&mut self.0.boxes));
    }
}

/// Leaves are put where they fit best, and taken out: the tree never needs to be made anew.
pub struct Moving(Tree);

impl Index for Moving {
    fn new(boxes: &[Bounds]) -> Self {
        Self(Tree::new(boxes.to_vec()))
    }

    fn count(&mut self, query: Bounds) -> usize {
        self.0.count(query)
    }

    fn moved(&mut self, triangle: u32, bounds: Bounds) {
        self.0.boxes[triangle as usize] = bounds;
        self.0.tree.move_primitive(widened(bounds), triangle);
    }

    fn removed(&mut self, triangle: u32) {
        self.0.boxes[triangle as usize] = EMPTY;
        self.0.tree.remove_primitive(triangle);
    }

    fn halved(&mut self) {}
}
