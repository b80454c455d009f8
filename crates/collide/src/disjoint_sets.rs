//! Disjoint sets (Tarjan 1975), by path halving.

/// A partition of the numbers from 0 on.
#[derive(Clone, Debug, Default)]
pub(crate) struct DisjointSets {
    parents: Vec<u32>,
}

impl DisjointSets {
    /// Resets to a number of elements, each a set of its own.
    pub fn clear(&mut self, count: usize) {
        self.parents.clear();
        self.parents.extend(0..count as u32);
    }

    /// Adds an element.
    pub fn add(&mut self) -> u32 {
        let element = self.parents.len() as u32;
        self.parents.push(element);
        element
    }

    /// The representative of an element's set.
    pub fn root(&mut self, mut element: u32) -> u32 {
        while self.parents[element as usize] != element {
            let above = self.parents[self.parents[element as usize] as usize];
            self.parents[element as usize] = above;
            element = above;
        }
        element
    }

    /// Joins the sets of two elements; the earlier root stays.
    pub fn join(&mut self, x: u32, y: u32) {
        let (x, y) = (self.root(x), self.root(y));
        self.parents[x.max(y) as usize] = x.min(y);
    }

    /// Number of elements.
    pub fn len(&self) -> u32 {
        self.parents.len() as u32
    }

    pub fn capacity(&self) -> usize {
        self.parents.capacity()
    }
}
