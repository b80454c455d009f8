//! The bounding volume test tree (§3.4.2) down to its front, kept between queries.
//!
//! A pair of nodes is either on the front, or has been split into pairs with the children of one of its nodes. Each
//! sleeps until the bodies have moved, relative to one another, so far that its answer could be another one: what
//! separates two hulls, beyond what would matter, is used up by motion alone. A pair that was split sleeps as long as
//! all below it do, so that a query goes down to those that are awake only.

use crate::convex::Distance;
use crate::query::Circumstances;
use crate::query::parting::Parting;

/// Index of a pair that is not there.
pub(crate) const NO_PAIR: u32 = u32::MAX;

/// A pair of nodes, with what the last query found out about it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pair {
    /// Node of the probe.
    pub a: u32,
    /// Node of the scene object.
    pub b: u32,
    /// How far the bodies may have moved, in all ([`Motion`](crate::motion::Motion)), before the pair is looked at again, m.
    pub wake: f64,
    /// Likewise, before it has to be asked again whether a pair that was split would be split.
    pub settled: f64,
    /// Likewise, before its bounding hulls may be out of reach, which they were not when last tested.
    pub within: f64,
    /// How much of its contact is left to the pairs that it is split into.
    pub share: f64,
    /// Whether it is split into others, rather than on the front.
    pub split: bool,
    /// Whether it sleeps because the bodies are too far apart there, whatever the threshold on the error.
    pub apart: bool,
    /// Where the next search for the nearest points starts.
    pub nearest: Nearest,
    /// Of a pair on the front whose hulls were out of reach.
    pub parting: Option<Parting>,
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
            wake: f64::NEG_INFINITY,
            settled: f64::NEG_INFINITY,
            within: f64::NEG_INFINITY,
            share: 1.0,
            split: false,
            apart: false,
            nearest: Nearest::default(),
            parting: None,
        }
    }
}

/// What a query reads of pairs that sleep, apart from the rest, so that many fit into a cache line.
#[derive(Clone, Copy, Debug)]
struct Link {
    /// Of the pair.
    wake: f64,
    /// First of the pairs that this one is split into, or [`NO_PAIR`] on the front.
    first: u32,
    /// Next of the pairs that its parent is split into; of spare pairs, the next spare one.
    next: u32,
}

/// The pairs of the tree.
#[derive(Clone, Debug)]
pub(crate) struct Front {
    pairs: Vec<Pair>,
    /// Of each pair.
    links: Vec<Link>,
    spare: u32,
    used: usize,
    split: usize,
    high_water: usize,
    /// Most pairs that it may hold.
    most: usize,
}

impl Front {
    /// The slot of the pair of roots.
    pub const ROOT: u32 = 0;

    /// An empty tree of at most `most` pairs, with room for a number of them.
    pub fn with_capacity(pairs: usize, most: usize) -> Self {
        Self {
            pairs: Vec::with_capacity(pairs),
            links: Vec::with_capacity(pairs),
            spare: NO_PAIR,
            used: 0,
            split: 0,
            high_water: 0,
            most,
        }
    }

    pub fn capacity(&self) -> usize {
        self.pairs.capacity().min(self.links.capacity())
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        self.pairs.capacity() * size_of::<Pair>() + self.links.capacity() * size_of::<Link>()
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
        self.links.clear();
        self.push(roots, NO_PAIR);
        (self.spare, self.used, self.split) = (NO_PAIR, 1, 0);
        self.high_water = self.high_water.max(1);
    }

    fn push(&mut self, pair: Pair, next: u32) {
        self.pairs.push(pair);
        self.links.push(Link { wake: pair.wake, first: NO_PAIR, next });
    }

    pub fn get(&self, slot: u32) -> Pair {
        Pair { wake: self.wake(slot), ..self.pairs[slot as usize] }
    }

    /// How much of its contact is left to the pairs that a pair is split into, if it would be split again.
    pub fn settled_share(&self, slot: u32, now: &Circumstances) -> Option<f64> {
        let pair = &self.pairs[slot as usize];
        (pair.split && pair.settled > now.way && !now.threshold_changed).then_some(pair.share)
    }

    /// How far the bodies may have moved before it has to be asked again whether a pair would be split, and before its
    /// bounding hulls may be out of reach, m.
    pub fn settled_and_within(&self, slot: u32) -> (f64, f64) {
        let pair = &self.pairs[slot as usize];
        (pair.settled, pair.within)
    }

    /// Changes what is known of a pair, but not whether it is split.
    pub fn set(&mut self, slot: u32, pair: Pair) {
        self.pairs[slot as usize] = Pair { split: self.is_split(slot), ..pair };
        self.links[slot as usize].wake = pair.wake;
    }

    /// How far the bodies may have moved before the pair is looked at again, m.
    pub fn wake(&self, slot: u32) -> f64 {
        self.links[slot as usize].wake
    }

    /// Whether a pair's answer cannot have changed.
    pub fn sleeps(&self, slot: u32, now: &Circumstances) -> bool {
        self.wake(slot) > now.way && (!now.threshold_changed || self.pairs[slot as usize].apart)
    }

    pub fn set_wake(&mut self, slot: u32, wake: f64) {
        self.links[slot as usize].wake = wake;
    }

    pub fn is_split(&self, slot: u32) -> bool {
        self.links[slot as usize].first != NO_PAIR
    }

    /// The slots of the pairs that a pair is split into; none on the front.
    pub fn below(&self, slot: u32) -> impl Iterator<Item = u32> {
        let known = |slot: u32| (slot != NO_PAIR).then_some(slot);
        std::iter::successors(known(self.links[slot as usize].first), move |slot| {
            known(self.links[*slot as usize].next)
        })
    }

    /// Splits a pair into others; `false`, and nothing done, if there would be too many.
    pub fn split(&mut self, slot: u32, into: impl ExactSizeIterator<Item = Pair>) -> bool {
        if self.used + into.len() > self.most {
            return false;
        }
        let mut first = NO_PAIR;
        for pair in into {
            let next = first;
            if self.spare == NO_PAIR {
                first = self.pairs.len() as u32;
                self.push(pair, next);
            } else {
                first = self.spare;
                self.spare = self.links[first as usize].next;
                self.pairs[first as usize] = pair;
                self.links[first as usize] = Link { wake: pair.wake, first: NO_PAIR, next };
            }
            self.used += 1;
        }
        self.links[slot as usize].first = first;
        self.pairs[slot as usize].split = true;
        self.split += 1;
        self.high_water = self.high_water.max(self.used);
        true
    }

    /// Counts the way from another beginning, this much further on, m.
    pub fn rebase(&mut self, way: f64) {
        for (pair, link) in self.pairs.iter_mut().zip(&mut self.links) {
            for at in [&mut link.wake, &mut pair.settled, &mut pair.within] {
                *at -= way;
            }
        }
    }

    /// Undoes the split of a pair, and of those below it.
    pub fn join(&mut self, slot: u32) {
        let first = std::mem::replace(&mut self.links[slot as usize].first, NO_PAIR);
        if first == NO_PAIR {
            return;
        }
        self.pairs[slot as usize].split = false;
        self.split -= 1;
        // The pairs to be freed are a list; what one is split into is put before the rest.
        let mut list = first;
        while list != NO_PAIR {
            let slot = list as usize;
            let Link { first: below, next, .. } = self.links[slot];
            list = next;
            if below != NO_PAIR {
                self.split -= 1;
                let mut last = below as usize;
                while self.links[last].next != NO_PAIR {
                    last = self.links[last].next as usize;
                }
                self.links[last].next = list;
                list = below;
            }
            self.links[slot].next = self.spare;
            self.spare = slot as u32;
            self.used -= 1;
        }
    }
}
