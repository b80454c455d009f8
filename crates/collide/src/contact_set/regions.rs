//! Connected regions of intersection, with their depths.
//!
//! Pairs of penetrating patches belong to one region when their patches are equal or neighbours on both
//! sides. The depth of one pair is only a lower bound on how deep the objects are in one another, so it is
//! measured over again: by the signed distance of either surface's vertices from the other surface. Vertices
//! are tested from the crossing triangles on, along the mesh as long as they are inside. They join regions
//! that the surface inside connects:
//!
//! - along an edge that lies inside as a whole: its triangle's patch penetrates nothing, or the balls around
//!   its ends that fit into the other solid cover it;
//! - to the pair of patches at the vertex whose other patch is nearest to it.
//!
//! The deepest pair of patches counts as well where both hulls are inside their solids, or no vertex is
//! inside.

use palpate_core::clod::Node;
use palpate_core::glam::DVec3;

use super::inside::{Inside, InsideVertices, Measures};
use super::pairs::{Groups, Pair};
use super::sides::Side;
use crate::contact::PatchContact;
use crate::disjoint_sets::DisjointSets;
use crate::shape::Shape;

/// Number that stands for no node or region.
const NONE: u32 = u32::MAX;

/// A place of large depth in a region.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Deep {
    /// Number of the region.
    pub region: u32,
    /// Depth, m.
    pub depth: f64,
    /// Whether it is the deepest place of the region.
    pub deepest: bool,
    pub at: Place,
}

/// The place at which a depth was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Place {
    /// Index of a contact between patches.
    Patches(u32),
    /// Index of a vertex inside.
    Vertex(u32),
}

/// The workspace.
#[derive(Clone, Debug)]
pub(crate) struct Regions {
    pairs: Vec<Pair>,
    groups: [Groups; 2],
    /// Elements: the pairs, followed by the vertices inside.
    sets: DisjointSets,
    pub inside: InsideVertices,
    /// Region of each element that is a root.
    numbers: Vec<u32>,
    /// Deepest vertex and deepest pair of each region.
    deepest: Vec<[Option<u32>; 2]>,
    deep: Vec<Deep>,
}

impl Regions {
    pub fn new(probe: &Shape, scene: &Shape) -> Self {
        let shapes = [probe, scene];
        Self {
            pairs: Vec::new(),
            groups: shapes.map(|shape| Groups::new(shape.clod().nodes().len())),
            sets: DisjointSets::default(),
            inside: InsideVertices::new(shapes),
            numbers: Vec::new(),
            deepest: Vec::new(),
            deep: Vec::new(),
        }
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        let groups = self.groups.iter().map(Groups::bytes);
        groups.sum::<usize>()
            + self.inside.bytes()
            + 4 * (self.sets.capacity() + self.numbers.capacity())
            + self.pairs.capacity() * size_of::<Pair>()
            + self.deep.capacity() * size_of::<Deep>()
            + self.deepest.capacity() * size_of::<[Option<u32>; 2]>()
    }

    /// Capacity of all buffers, which shows whether one has grown.
    pub fn capacity(&self) -> usize {
        self.bytes() + self.inside.search.capacity()
    }

    /// Number of regions found.
    pub fn len(&self) -> usize {
        self.deepest.len()
    }

    /// Finds the regions of the penetrating contacts, and the deepest places of each. Contacts that are to be
    /// left out are told by `is_left_out`.
    pub fn run(
        &mut self,
        contacts: &[PatchContact],
        sides: &[Side; 2],
        measures: &Measures,
        is_left_out: impl Fn(&PatchContact) -> bool,
    ) -> &[Deep] {
        self.clear();
        self.pair_up(contacts, sides, is_left_out);
        self.connect_pairs(sides);
        for side in sides.iter().filter(|side| side.other.clod().source.solid) {
            self.look_around(side, measures);
        }
        self.connect_vertices(sides);
        self.list_deepest(measures.same);
        if measures.maxima {
            self.list_maxima(sides, measures.same);
        }
        &self.deep
    }

    fn clear(&mut self) {
        for side in 0..2 {
            self.groups[side].clear(&self.pairs, side);
        }
        self.pairs.clear();
        self.inside.clear();
        self.numbers.clear();
        self.deepest.clear();
        self.deep.clear();
    }

    /// Collects the penetrating pairs of patches. Contacts of a pair follow one another.
    fn pair_up(
        &mut self,
        contacts: &[PatchContact],
        sides: &[Side; 2],
        is_left_out: impl Fn(&PatchContact) -> bool,
    ) {
        for (index, found) in (0u32..).zip(contacts) {
            let PatchContact { contact, probe_node, scene_node, .. } = found;
            if contact.depth < 0.0 || is_left_out(found) {
                continue;
            }
            let (nodes, depth) = ([*probe_node, *scene_node], contact.depth);
            if let Some(last) = self.pairs.last_mut().filter(|last| last.nodes == nodes) {
                if depth > last.depth {
                    (last.contact, last.depth) = (index, depth);
                }
                continue;
            }
            let contained = sides.iter().all(|side| side.own.patch(nodes[side.index]).contained);
            self.pairs.push(Pair { nodes, contact: index, depth, contained, surpassed: false });
        }
        self.sets.clear(self.pairs.len());
        for side in 0..2 {
            self.groups[side].fill(&self.pairs, side);
        }
    }

    /// Joins pairs that are neighbours on both sides.
    fn connect_pairs(&mut self, sides: &[Side; 2]) {
        let coarsest = [0, 1].map(|side| {
            let level = |pair: &Pair| sides[side].own.clod().node(pair.nodes[side]).level;
            self.pairs.iter().map(level).max().unwrap_or(0)
        });
        for index in 0..self.pairs.len() {
            let Pair { nodes, depth, .. } = self.pairs[index];
            let candidates = [0, 1].map(|side| {
                let groups = &self.groups[side];
                around(sides[side].own, nodes[side], coarsest[side])
                    .map(|node| groups.of(node).len())
                    .sum::<usize>()
            });
            // Candidates are neighbours on one side already; the side with fewer of them is searched.
            let side = usize::from(candidates[1] < candidates[0]);
            let other = sides[1 - side].own;
            for node in around(sides[side].own, nodes[side], coarsest[side]) {
                for &candidate in self.groups[side].of(node) {
                    let found = &self.pairs[candidate as usize];
                    let meets = other.patchwork().neighbours.meets(
                        other.clod(),
                        nodes[1 - side],
                        found.nodes[1 - side],
                    );
                    if meets && candidate as usize != index {
                        let deeper = found.depth;
                        self.sets.join(index as u32, candidate);
                        self.pairs[index].surpassed |= deeper > depth;
                        self.pairs[candidate as usize].surpassed |= depth > deeper;
                    }
                }
            }
        }
        for side in 0..2 {
            self.groups[side].mark_uniform(&self.pairs, side, &mut self.sets);
        }
    }

    /// Measures the vertices of a side's triangles that may cross the other surface, and floods along the
    /// mesh from those inside. An edge between two vertices inside joins them if its triangle's patch
    /// penetrates nothing, or if the balls around its ends cover it: depth + depth' ≥ length.
    fn look_around(&mut self, side: &Side, measures: &Measures) {
        let (own, other, index) = (side.own, side.other, side.index);
        let neighbours = &own.patchwork().neighbours;
        let from = self.inside.found.len();
        for at in 0..self.pairs.len() {
            let nodes = self.pairs[at].nodes;
            let node = nodes[index];
            let Node { center, radius, level, triangles, .. } = other.clod().node(nodes[1 - index]);
            let hint = triangles.start;
            let center = side.to_other.direction_to_b(center - side.to_other.translation);
            let [low, high] = other.patchwork().box_of(nodes[1 - index]);
            own.patchwork().in_reach(node, center, radius, &mut |triangle| {
                let [p, q, r] = neighbours.corners(triangle);
                let (p, q, r) = (side.to_other.point(p), side.to_other.point(q), side.to_other.point(r));
                let below = p.max(q).max(r).cmplt(low - measures.same);
                let above = p.min(q).min(r).cmpgt(high + measures.same);
                if (below | above).any() {
                    return;
                }
                for (vertex, point) in neighbours.ends(triangle).into_iter().zip(neighbours.corners(triangle))
                {
                    self.measure(side, measures, (vertex, node, point), (level, hint));
                }
            });
        }
        let mut next = from;
        while next < self.inside.found.len() {
            let Inside { vertex, level, own: at, nearest, .. } = self.inside.found[next];
            let element = (self.pairs.len() + next) as u32;
            next += 1;
            for &triangle in neighbours.around(vertex) {
                let node = neighbours.owner(triangle);
                let crossing = !self.groups[index].of(node).is_empty();
                for (end, point) in neighbours.ends(triangle).into_iter().zip(neighbours.corners(triangle)) {
                    if end == vertex {
                        continue;
                    }
                    let Some(found) =
                        self.measure(side, measures, (end, node, point), (level, nearest.triangle))
                    else {
                        continue;
                    };
                    let covered = nearest.distance + self.inside.depth(found);
                    if !crossing || covered >= at.distance(point) {
                        self.sets.join(element, self.pairs.len() as u32 + found);
                    }
                }
            }
        }
    }

    /// Measures a vertex's distance once. Returns its index if it is inside.
    fn measure(
        &mut self,
        side: &Side,
        measures: &Measures,
        vertex: (u32, u32, DVec3),
        near: (u32, u32),
    ) -> Option<u32> {
        let found = self.inside.measure(side, measures, vertex, near)?;
        if self.sets.len() == self.pairs.len() as u32 + found {
            self.sets.add();
        }
        Some(found)
    }

    /// Joins the vertices inside to the pairs of patches at them.
    fn connect_vertices(&mut self, sides: &[Side; 2]) {
        for index in 0..self.inside.found.len() {
            if let Some(pair) = self.pair_of(&sides[self.inside.found[index].side], index) {
                self.sets.join((self.pairs.len() + index) as u32, pair);
            }
        }
    }

    /// The pair of patches at a vertex whose other patch is nearest to the vertex.
    fn pair_of(&mut self, side: &Side, index: usize) -> Option<u32> {
        let Inside { vertex, in_other, nearest, .. } = self.inside.found[index];
        let neighbours = &side.own.patchwork().neighbours;
        let groups = &self.groups[side.index];
        let around = neighbours.around(vertex).iter().map(|t| neighbours.owner(*t));
        let around = around.filter(|node| !groups.of(*node).is_empty());
        let mut regions = around.clone().map(|node| {
            let pair = groups.of(node)[0];
            (groups.is_uniform(node), pair)
        });
        let (uniform, first) = regions.next()?;
        if uniform && regions.all(|(uniform, pair)| uniform && self.sets.root(pair) == self.sets.root(first))
        {
            return Some(first);
        }
        let mut best = None;
        let mut limit = f64::INFINITY;
        let mut last = NONE;
        for node in around {
            if std::mem::replace(&mut last, node) == node {
                continue;
            }
            for &pair in groups.of(node) {
                let other = self.pairs[pair as usize].nodes[1 - side.index];
                if other == nearest.node {
                    return Some(pair);
                }
                let sphere = side.other.node(other);
                if sphere.center.distance(in_other) - sphere.radius >= limit {
                    continue;
                }
                if let Some(found) =
                    self.inside.search.on_patch(side.other.patchwork(), other, in_other, limit)
                {
                    (best, limit) = (Some(pair), found.distance);
                }
            }
        }
        best
    }

    /// The region of an element.
    fn region(&mut self, element: u32) -> u32 {
        let root = self.sets.root(element);
        self.numbers[root as usize]
    }

    /// Numbers the regions and finds the deepest place of each: its deepest vertex, unless a pair is deeper
    /// by more than `same`.
    fn list_deepest(&mut self, same: f64) {
        let elements = self.sets.len();
        self.numbers.resize(elements as usize, NONE);
        for element in 0..elements {
            let root = self.sets.root(element) as usize;
            if self.numbers[root] == NONE {
                self.numbers[root] = self.deepest.len() as u32;
                self.deepest.push([None, None]);
            }
        }
        for index in 0..self.inside.found.len() as u32 {
            let region = self.region(self.pairs.len() as u32 + index) as usize;
            let depth = |i: u32| self.inside.depth(i);
            let best = &mut self.deepest[region][0];
            if best.is_none_or(|best| depth(index) > depth(best)) {
                *best = Some(index);
            }
        }
        for index in 0..self.pairs.len() as u32 {
            let region = self.region(index) as usize;
            // A hull that protrudes from its solid may be deeper than the solid.
            let by_vertices = self.deepest[region][0].is_some();
            if by_vertices && !self.pairs[index as usize].contained {
                continue;
            }
            let depth = |i: u32| self.pairs[i as usize].depth;
            let best = &mut self.deepest[region][1];
            if best.is_none_or(|best| depth(index) > depth(best)) {
                *best = Some(index);
            }
        }
        for (region, [vertex, pair]) in (0u32..).zip(&self.deepest) {
            let of_vertex = vertex.map(|v| (self.inside.depth(v), Place::Vertex(v)));
            let of_pair = pair.map(|p| {
                let pair = &self.pairs[p as usize];
                (pair.depth, Place::Patches(pair.contact))
            });
            let best = match (of_vertex, of_pair) {
                (Some(v), Some(p)) => Some(if p.0 > v.0 + same { p } else { v }),
                (v, p) => v.or(p),
            };
            if let Some((depth, at)) = best {
                self.deep.push(Deep { region, depth, deepest: true, at });
            }
        }
    }

    /// Lists the local maxima of the depth: vertices without a deeper neighbour and, in regions without
    /// vertices, pairs of patches without one.
    fn list_maxima(&mut self, sides: &[Side; 2], same: f64) {
        for index in 0..self.inside.found.len() as u32 {
            if self.inside.is_maximum(index, sides, same) {
                let region = self.region(self.pairs.len() as u32 + index);
                let depth = self.inside.depth(index);
                self.deep.push(Deep { region, depth, deepest: false, at: Place::Vertex(index) });
            }
        }
        for index in 0..self.pairs.len() {
            let Pair { contact, depth, surpassed, .. } = self.pairs[index];
            let region = self.region(index as u32);
            if !surpassed && self.deepest[region as usize][0].is_none() {
                self.deep.push(Deep { region, depth, deepest: false, at: Place::Patches(contact) });
            }
        }
    }
}

/// A node with its neighbours, and its ancestors up to a level with theirs.
fn around(shape: &Shape, node: u32, coarsest: u32) -> impl Iterator<Item = u32> + Clone {
    let above = move |node: &u32| {
        let node = shape.clod().node(*node);
        (node.level < coarsest).then_some(node.parent)
    };
    std::iter::successors(Some(node), above)
        .flat_map(|node| std::iter::once(node).chain(shape.patchwork().neighbours.of(node).iter().copied()))
}
