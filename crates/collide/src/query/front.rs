//! The bounding volume test tree (§3.4.2) down to its front, kept between queries.
//!
//! A pair of nodes is either on the front, or has been split into pairs with the children of one of its nodes. Each
//! sleeps until the bodies have moved, relative to one another, so far that its answer could be another one: what
//! separates two hulls, beyond what would matter, is used up by motion alone. A pair that was split sleeps as long as
//! all below it do, so that a query goes down to those that are awake only.

use crate::convex::Distance;

/// Index of a pair that is not there.
pub(crate) const NO_PAIR: u32 = u32::MAX;

/// A pair of nodes, with what the last query found out about it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pair {
    /// Node of the probe.
    pub a: u32,
    /// Node of the scene object.
    pub b: u32,
    /// First of the pairs that this one is split into, or [`NO_PAIR`] on the front.
    pub first: u32,
    /// Next of the pairs that its parent is split into; of spare pairs, the next spare one.
    pub next: u32,
    /// How far the bodies may have moved, in all ([`Motion`](crate::motion::Motion)), before the pair is looked at again, m.
    pub wake: f64,
    /// Likewise, before it has to be asked again whether a pair that was split would be split.
    pub settled: f64,
    /// Likewise, before its bounding hulls may be out of reach, which they were not when last tested.
    pub within: f64,
    /// How much of its contact is left to the pairs that it is split into.
    pub share: f64,
    /// Whether it sleeps because the bodies are too far apart there, whatever the threshold on the error.
    pub apart: bool,
    /// Where the next search for the nearest points starts.
    pub nearest: Nearest,
}

/// Vertices of two hulls between which their nearest points were.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Nearest {
    vertices: [(u32, u32); 4],
    len: u8,
    /// Whether the hulls are those of the patches, rather than the bounding ones.
    of_patches: bool,
}

impl Nearest {
    pub fn of(found: &Distance, of_patches: bool) -> Self {
        let mut nearest = Self { of_patches, ..Self::default() };
        for (kept, vertex) in nearest.vertices.iter_mut().zip(found.simplex.vertices()) {
            *kept = (vertex.a, vertex.b);
            nearest.len += 1;
        }
        nearest
    }

    /// Vertices of two patches' hulls that overlap.
    pub fn around(vertices: [(u32, u32); 4]) -> Self {
        Self { vertices, len: 4, of_patches: true }
    }

    /// The vertices; none if they are of the other kind of hulls.
    pub fn vertices(&self, of_patches: bool) -> &[(u32, u32)] {
        if self.of_patches == of_patches { &self.vertices[..usize::from(self.len)] } else { &[] }
    }
}

impl Pair {
    /// A pair that is to be looked at.
    pub fn new(a: u32, b: u32) -> Self {
        Self {
            a,
            b,
            first: NO_PAIR,
            next: NO_PAIR,
            wake: f64::NEG_INFINITY,
            settled: f64::NEG_INFINITY,
            within: f64::NEG_INFINITY,
            share: 1.0,
            apart: false,
            nearest: Nearest::default(),
        }
    }

    pub fn is_split(&self) -> bool {
        self.first != NO_PAIR
    }
}

/// The pairs of the tree.
#[derive(Clone, Debug)]
pub(crate) struct Front {
    pairs: Vec<Pair>,
    spare: u32,
    used: usize,
    split: usize,
    high_water: usize,
}

impl Front {
    /// The slot of the pair of roots.
    pub const ROOT: u32 = 0;

    /// A tree of nothing, with room for a number of pairs.
    pub fn with_capacity(pairs: usize) -> Self {
        Self { pairs: Vec::with_capacity(pairs), spare: NO_PAIR, used: 0, split: 0, high_water: 0 }
    }

    pub fn capacity(&self) -> usize {
        self.pairs.capacity()
    }

    /// Pairs on the front: those that are not split.
    pub fn len(&self) -> usize {
        self.used - self.split
    }

    /// Most pairs held at once.
    pub fn high_water(&self) -> usize {
        self.high_water
    }

    /// Forgets all pairs but one, the roots'.
    pub fn reset(&mut self, roots: Pair) {
        self.pairs.clear();
        self.pairs.push(roots);
        (self.spare, self.used, self.split) = (NO_PAIR, 1, 0);
        self.high_water = self.high_water.max(1);
    }

    pub fn get(&self, slot: u32) -> &Pair {
        &self.pairs[slot as usize]
    }

    pub fn get_mut(&mut self, slot: u32) -> &mut Pair {
        &mut self.pairs[slot as usize]
    }

    /// The slots of the pairs that a pair is split into; none on the front.
    pub fn below(&self, slot: u32) -> impl Iterator<Item = u32> {
        let known = |slot: u32| (slot != NO_PAIR).then_some(slot);
        std::iter::successors(known(self.get(slot).first), move |slot| known(self.get(*slot).next))
    }

    /// Splits a pair into others; `false`, and nothing done, if there is no room for them. `grow`: make room.
    pub fn split(&mut self, slot: u32, into: impl ExactSizeIterator<Item = Pair>, grow: bool) -> bool {
        let spare = self.pairs.len() - self.used;
        let room = self.pairs.capacity() - self.pairs.len();
        if !grow && into.len() > spare + room {
            return false;
        }
        let mut first = NO_PAIR;
        for pair in into {
            let pair = Pair { next: first, ..pair };
            if self.spare == NO_PAIR {
                first = self.pairs.len() as u32;
                self.pairs.push(pair);
            } else {
                first = self.spare;
                self.spare = self.pairs[first as usize].next;
                self.pairs[first as usize] = pair;
            }
            self.used += 1;
        }
        self.pairs[slot as usize].first = first;
        self.split += 1;
        self.high_water = self.high_water.max(self.used);
        true
    }

    /// Counts the way from another beginning, this much further on, m.
    pub fn rebase(&mut self, way: f64) {
        for pair in &mut self.pairs {
            for at in [&mut pair.wake, &mut pair.settled, &mut pair.within] {
                *at -= way;
            }
        }
    }

    /// Undoes the split of a pair, and of those below it.
    pub fn join(&mut self, slot: u32) {
        let first = std::mem::replace(&mut self.pairs[slot as usize].first, NO_PAIR);
        if first == NO_PAIR {
            return;
        }
        self.split -= 1;
        // The pairs to be freed are a list; what one is split into is put before the rest.
        let mut list = first;
        while list != NO_PAIR {
            let slot = list as usize;
            list = self.pairs[slot].next;
            let below = self.pairs[slot].first;
            if below != NO_PAIR {
                self.split -= 1;
                let mut last = below as usize;
                while self.pairs[last].next != NO_PAIR {
                    last = self.pairs[last].next as usize;
                }
                self.pairs[last].next = list;
                list = below;
            }
            self.pairs[slot].next = self.spare;
            self.spare = slot as u32;
            self.used -= 1;
        }
    }
}
