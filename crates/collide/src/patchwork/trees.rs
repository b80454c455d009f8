//! Trees of boxes over the patches of each level, and below each patch over its triangles.
//!
//! (The hierarchy's own spheres are loose around long patches: searches with them take two to three times as
//! long.)

use palpate_core::Clod;
use palpate_core::glam::DVec3;

use super::neighbours::Neighbours;
use crate::tolerances::ROUNDING_SLACK;

/// Largest number of triangles of a box that is not split.
const MAX_BUNCH: usize = 6;
/// Root of a level or node without a tree, because it is free.
pub(super) const NO_TREE: u32 = u32::MAX;

/// The surface of a hierarchy's patches, on every level that is not free.
///
/// Memory, besides that of the neighbours: 64 bytes for each bunch of some 5 triangles and for each inner box
/// above them; 4 a triangle and a node.
#[derive(Clone, Debug, Default)]
pub(crate) struct Patchwork {
    pub neighbours: Neighbours,
    pub(super) trees: Vec<Bunch>,
    /// Triangles in the order of the trees, as indices among all of the hierarchy.
    pub(super) order: Vec<u32>,
    /// Root of the tree of each level and of each node.
    pub(super) of_level: Vec<u32>,
    pub(super) of_node: Vec<u32>,
}

/// A box around triangles. If it is split, its first half is the next box.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bunch {
    low: DVec3,
    high: DVec3,
    /// Range of [`Patchwork::order`], unless it is split.
    pub first: u32,
    pub last: u32,
    /// The second half; 0 if it is not split.
    pub second: u32,
}

impl Bunch {
    /// Squared distance of a point, m².
    pub fn distance_squared(&self, point: DVec3) -> f64 {
        point.distance_squared(point.clamp(self.low, self.high))
    }
}

impl Patchwork {
    /// Makes the surface of a hierarchy.
    pub fn new(clod: &Clod) -> Self {
        let mut surface = Self {
            neighbours: Neighbours::new(clod),
            of_level: vec![NO_TREE; clod.levels.len()],
            of_node: vec![NO_TREE; clod.nodes().len()],
            ..Self::default()
        };
        for (index, level) in clod.levels.iter().enumerate().filter(|(_, level)| !level.free) {
            let mut nodes: Vec<u32> = level.nodes.clone().collect();
            nodes.retain(|node| !clod.node(*node).triangles.is_empty());
            if !nodes.is_empty() {
                surface.of_level[index] = surface.join(clod, &mut nodes);
            }
        }
        surface
    }

    /// Makes a tree over patches, split at the median of their centres along the longest side.
    fn join(&mut self, clod: &Clod, nodes: &mut [u32]) -> u32 {
        if let [node] = *nodes {
            let first = self.order.len();
            self.order.extend(clod.node(node).triangles);
            self.of_node[node as usize] = self.split(first, self.order.len());
            return self.of_node[node as usize];
        }
        let center = |node: &u32| clod.node(*node).center;
        let axis = longest_axis(nodes.iter().map(center));
        let half = nodes.len() / 2;
        nodes.select_nth_unstable_by(half, |x, y| center(x)[axis].total_cmp(&center(y)[axis]));
        let (first, second) = nodes.split_at_mut(half);
        self.halves(|surface| surface.join(clod, first), |surface| surface.join(clod, second))
    }

    /// Makes a tree over a range of the order, of triangles of one patch.
    fn split(&mut self, first: usize, last: usize) -> u32 {
        let triangles = &mut self.order[first..last];
        if triangles.len() <= MAX_BUNCH {
            let neighbours = &self.neighbours;
            let points = || triangles.iter().flat_map(|t| neighbours.corners(*t));
            let (low, high) =
                (points().fold(DVec3::INFINITY, DVec3::min), points().fold(DVec3::NEG_INFINITY, DVec3::max));
            let (first, last) = (first as u32, last as u32);
            self.trees.push(Bunch { low, high, first, last, second: 0 });
            return self.trees.len() as u32 - 1;
        }
        let middle = |t: &u32| self.neighbours.corners(*t).iter().sum::<DVec3>() / 3.0;
        let axis = longest_axis(triangles.iter().map(middle));
        let half = (last - first) / 2;
        triangles.select_nth_unstable_by(half, |s, t| middle(s)[axis].total_cmp(&middle(t)[axis]));
        self.halves(|surface| surface.split(first, first + half), |surface| surface.split(first + half, last))
    }

    fn halves(&mut self, first: impl FnOnce(&mut Self) -> u32, second: impl FnOnce(&mut Self) -> u32) -> u32 {
        let index = self.trees.len();
        let (low, high) = (DVec3::ZERO, DVec3::ZERO);
        self.trees.push(Bunch { low, high, first: 0, last: 0, second: 0 });
        let first = first(self);
        let second = second(self);
        let [x, y] = [first, second].map(|half| self.trees[half as usize]);
        self.trees[index] =
            Bunch { low: x.low.min(y.low), high: x.high.max(y.high), second, ..self.trees[index] };
        index as u32
    }

    /// Calls `each` with the triangles of a node's patch whose boxes reach into a sphere, in the shape's
    /// frame.
    pub fn in_reach(&self, node: u32, center: DVec3, radius: f64, each: &mut impl FnMut(u32)) {
        let root = self.of_node[node as usize];
        if root != NO_TREE {
            self.bunch_in_reach(root, (center, radius * radius * (1.0 + ROUNDING_SLACK)), each);
        }
    }

    fn bunch_in_reach(
        &self,
        bunch: u32,
        sphere @ (center, squared): (DVec3, f64),
        each: &mut impl FnMut(u32),
    ) {
        let found = &self.trees[bunch as usize];
        if found.distance_squared(center) > squared {
            return;
        }
        if found.second != 0 {
            self.bunch_in_reach(bunch + 1, sphere, each);
            self.bunch_in_reach(found.second, sphere, each);
            return;
        }
        for &triangle in &self.order[found.first as usize..found.last as usize] {
            let [p, q, r] = self.neighbours.corners(triangle);
            let nearest = center.clamp(p.min(q).min(r), p.max(q).max(r));
            if nearest.distance_squared(center) <= squared {
                each(triangle);
            }
        }
    }

    /// The triangles of a level, those of a box one after the other.
    pub fn of_level(&self, level: usize) -> &[u32] {
        let Some(root) = self.of_level.get(level).filter(|root| **root != NO_TREE) else { return &[] };
        let is_split = |bunch: &u32| self.trees[*bunch as usize].second != 0;
        let ends = [
            std::iter::successors(Some(*root), |bunch| is_split(bunch).then_some(bunch + 1)).last(),
            std::iter::successors(Some(*root), |b| is_split(b).then_some(self.trees[*b as usize].second))
                .last(),
        ];
        let [first, last] = ends.map(|end| self.trees[end.unwrap_or(*root) as usize]);
        &self.order[first.first as usize..last.last as usize]
    }

    /// Whether some triangle of level 0 whose box meets another box fulfils a condition. The box is given by
    /// its lowest and its highest corner, m.
    pub fn any_in_box(&self, [low, high]: [DVec3; 2], condition: &mut impl FnMut(u32) -> bool) -> bool {
        let root = self.of_level[0];
        root != NO_TREE && self.any_of_bunch(root, [low, high], condition)
    }

    fn any_of_bunch(
        &self,
        bunch: u32,
        [low, high]: [DVec3; 2],
        condition: &mut impl FnMut(u32) -> bool,
    ) -> bool {
        let found = &self.trees[bunch as usize];
        if found.low.cmpgt(high).any() || found.high.cmplt(low).any() {
            return false;
        }
        if found.second != 0 {
            return self.any_of_bunch(bunch + 1, [low, high], condition)
                || self.any_of_bunch(found.second, [low, high], condition);
        }
        self.order[found.first as usize..found.last as usize].iter().any(|triangle| condition(*triangle))
    }

    /// The box around a node's patch: its lowest and its highest corner, m; empty if it has none.
    pub fn box_of(&self, node: u32) -> [DVec3; 2] {
        let root = self.trees.get(self.of_node[node as usize] as usize);
        root.map_or([DVec3::INFINITY, DVec3::NEG_INFINITY], |root| [root.low, root.high])
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        let Self { neighbours, trees, order, of_level, of_node } = self;
        neighbours.bytes()
            + size_of_val(&**trees)
            + size_of_val(&**order)
            + size_of_val(&**of_level)
            + size_of_val(&**of_node)
    }
}

fn longest_axis(points: impl Iterator<Item = DVec3>) -> usize {
    let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let (low, high) = points.fold(start, |(low, high), p| (low.min(p), high.max(p)));
    (high - low).max_position()
}
