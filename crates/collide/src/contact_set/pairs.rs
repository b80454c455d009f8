//! Penetrating pairs of patches, grouped by node.

use crate::disjoint_sets::DisjointSets;

/// A penetrating pair of patches.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pair {
    /// Nodes of the probe and of the scene object.
    pub nodes: [u32; 2],
    /// Index of its deepest contact.
    pub contact: u32,
    /// Depth, m.
    pub depth: f64,
    /// Whether both hulls are inside their solids, so that the depth is at most that of the solids.
    pub contained: bool,
    /// Whether a neighbouring pair is deeper.
    pub surpassed: bool,
}

/// The pairs of each node of one side.
#[derive(Clone, Debug)]
pub(crate) struct Groups {
    /// Range of each node in the order.
    of_node: Vec<(u32, u32)>,
    /// Pairs, by node.
    order: Vec<u32>,
    /// For the first place of each group in the order, whether its pairs are all in one region.
    uniform: Vec<bool>,
}

impl Groups {
    /// No pairs, of a number of nodes.
    pub fn new(nodes: usize) -> Self {
        Self { of_node: vec![(0, 0); nodes], order: Vec::new(), uniform: Vec::new() }
    }

    /// The pairs of a node.
    pub fn of(&self, node: u32) -> &[u32] {
        let (first, last) = self.of_node[node as usize];
        &self.order[first as usize..last as usize]
    }

    /// Removes the pairs, which must be those of the last [`fill`](Self::fill).
    pub fn clear(&mut self, pairs: &[Pair], side: usize) {
        pairs.iter().for_each(|pair| self.of_node[pair.nodes[side] as usize] = (0, 0));
        self.order.clear();
        self.uniform.clear();
    }

    /// Groups pairs by their nodes on a side.
    pub fn fill(&mut self, pairs: &[Pair], side: usize) {
        self.order.extend(0..pairs.len() as u32);
        self.order.sort_unstable_by_key(|pair| (pairs[*pair as usize].nodes[side], *pair));
        self.uniform.resize(pairs.len(), false);
        for (at, pair) in (0u32..).zip(&self.order) {
            let range = &mut self.of_node[pairs[*pair as usize].nodes[side] as usize];
            *range = if range.1 == 0 { (at, at + 1) } else { (range.0, at + 1) };
        }
    }

    /// Marks the nodes whose pairs are all in one set.
    pub fn mark_uniform(&mut self, pairs: &[Pair], side: usize, sets: &mut DisjointSets) {
        for (at, &pair) in self.order.iter().enumerate() {
            let first = self.of_node[pairs[pair as usize].nodes[side] as usize].0 as usize;
            let same = sets.root(pair) == sets.root(self.order[first]);
            self.uniform[first] = same && (at == first || self.uniform[first]);
        }
    }

    /// Whether all pairs of a node are in one set. The node must have pairs.
    pub fn is_uniform(&self, node: u32) -> bool {
        self.uniform[self.of_node[node as usize].0 as usize]
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        self.of_node.capacity() * size_of::<(u32, u32)>()
            + self.order.capacity() * size_of::<u32>()
            + self.uniform.capacity()
    }
}
