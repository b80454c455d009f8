//! The bounding volume test tree (§3.4.2) down to its front, kept between queries.
//!
//! A pair of nodes is either on the front, or has been split into pairs with the children of one of its
//! nodes. Each pair's answer is stored with the value of the [motion bound](crate::motion::Motion::bound) up
//! to which it is valid: hulls that are apart by a margin stay so until the bodies have moved by the margin.
//! A split pair is due for a recheck as soon as one below it is, so that a query descends only to pairs that
//! are due.

use super::context::Progress;
use super::separating_axis::SeparatingAxis;
use crate::convex::Distance;

/// Index that stands for no pair.
const NO_PAIR: u32 = u32::MAX;

/// A pair of nodes with the results of its last test. Motion bounds are in m.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pair {
    /// Node of the probe.
    pub a: u32,
    /// Node of the scene object.
    pub b: u32,
    /// Motion bound at which the pair has to be tested again.
    pub recheck_at: f64,
    /// Motion bound until which the refinement test would split the pair again.
    pub split_valid_until: f64,
    /// Motion bound until which its bounding hulls stay in reach.
    pub overlap_valid_until: f64,
    /// Share of its contact, 0 to 1, that is left to the pairs that it is split into.
    pub refined_share: f64,
    /// Whether it is split into others, rather than on the front.
    pub split: bool,
    /// Whether it is out of reach, so that its answer is valid for any error threshold.
    pub out_of_reach: bool,
    /// Start of the next search for the nearest points.
    pub warm_start: WarmStart,
    /// Axis along which the hulls of a pair on the front were out of reach.
    pub separating_axis: Option<SeparatingAxis>,
}

/// Vertices of two hulls from which a search for their nearest points starts: those of the last search.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct WarmStart {
    vertices: [(u32, u32); 4],
    len: u8,
    /// Whether the hulls are those of the patches, rather than the bounding ones.
    of_patches: bool,
}

impl WarmStart {
    /// The vertices of the nearest points found.
    pub fn from_distance(found: &Distance, of_patches: bool) -> Self {
        let mut start = Self { of_patches, ..Self::default() };
        for (kept, vertex) in start.vertices.iter_mut().zip(found.simplex.vertices()) {
            *kept = (vertex.a, vertex.b);
            start.len += 1;
        }
        start
    }

    /// The vertices of a tetrahedron around the origin, of two patches whose hulls overlap.
    pub fn from_tetrahedron(vertices: [(u32, u32); 4]) -> Self {
        Self { vertices, len: 4, of_patches: true }
    }

    /// The vertices; none if they are of the other kind of hulls.
    pub fn vertices(&self, of_patches: bool) -> &[(u32, u32)] {
        if self.of_patches == of_patches { &self.vertices[..usize::from(self.len)] } else { &[] }
    }
}

impl Pair {
    /// A pair that is due for a test.
    pub fn new(a: u32, b: u32) -> Self {
        Self {
            a,
            b,
            recheck_at: f64::NEG_INFINITY,
            split_valid_until: f64::NEG_INFINITY,
            overlap_valid_until: f64::NEG_INFINITY,
            refined_share: 1.0,
            split: false,
            out_of_reach: false,
            warm_start: WarmStart::default(),
            separating_axis: None,
        }
    }
}

/// The part of a pair that a query reads while its answer is valid. It is stored apart from the rest, so that
/// many fit into a cache line.
#[derive(Clone, Copy, Debug)]
struct Link {
    recheck_at: f64,
    /// First of the pairs that this one is split into, or [`NO_PAIR`] on the front.
    first_child: u32,
    /// Next of the pairs that its parent is split into; for a spare slot, the next spare one.
    next: u32,
}

/// The pairs of the tree.
#[derive(Clone, Debug)]
pub(crate) struct Front {
    pairs: Vec<Pair>,
    /// One for each pair.
    links: Vec<Link>,
    /// First of the freed slots, a list by [`Link::next`].
    spare: u32,
    /// Number of pairs.
    used: usize,
    /// Number of pairs that are split.
    split: usize,
    /// Largest number of pairs held at once.
    high_water: usize,
    /// Largest number of pairs allowed.
    limit: usize,
}

impl Front {
    /// The slot of the pair of roots.
    pub const ROOT: u32 = 0;

    /// An empty tree of at most `limit` pairs, with room for a number of them.
    pub fn with_capacity(pairs: usize, limit: usize) -> Self {
        Self {
            pairs: Vec::with_capacity(pairs),
            links: Vec::with_capacity(pairs),
            spare: NO_PAIR,
            used: 0,
            split: 0,
            high_water: 0,
            limit,
        }
    }

    pub fn capacity(&self) -> usize {
        self.pairs.capacity().min(self.links.capacity())
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        self.pairs.capacity() * size_of::<Pair>() + self.links.capacity() * size_of::<Link>()
    }

    /// Number of pairs on the front: those that are not split.
    pub fn len(&self) -> usize {
        self.used - self.split
    }

    /// Largest number of pairs held at once.
    pub fn high_water(&self) -> usize {
        self.high_water
    }

    /// Removes all pairs except that of the roots.
    pub fn reset(&mut self, roots: Pair) {
        self.pairs.clear();
        self.links.clear();
        self.push(roots, NO_PAIR);
        (self.spare, self.used, self.split) = (NO_PAIR, 1, 0);
        self.high_water = self.high_water.max(1);
    }

    fn push(&mut self, pair: Pair, next: u32) {
        self.pairs.push(pair);
        self.links.push(Link { recheck_at: pair.recheck_at, first_child: NO_PAIR, next });
    }

    pub fn get(&self, slot: u32) -> Pair {
        Pair { recheck_at: self.recheck_at(slot), ..self.pairs[slot as usize] }
    }

    /// Stores the results of a pair's test; whether it is split does not change.
    pub fn set(&mut self, slot: u32, pair: Pair) {
        self.pairs[slot as usize] = Pair { split: self.is_split(slot), ..pair };
        self.links[slot as usize].recheck_at = pair.recheck_at;
    }

    /// The motion bound at which the pair has to be tested again, m.
    pub fn recheck_at(&self, slot: u32) -> f64 {
        self.links[slot as usize].recheck_at
    }

    pub fn set_recheck_at(&mut self, slot: u32, recheck_at: f64) {
        self.links[slot as usize].recheck_at = recheck_at;
    }

    /// Whether a pair's answer is still valid.
    pub fn is_valid(&self, slot: u32, now: &Progress) -> bool {
        self.recheck_at(slot) > now.motion_bound
            && (!now.threshold_changed || self.pairs[slot as usize].out_of_reach)
    }

    /// The share of its contact that a split pair leaves to those below it, if it would be split again.
    pub fn valid_split(&self, slot: u32, now: &Progress) -> Option<f64> {
        let pair = &self.pairs[slot as usize];
        let valid = pair.split && pair.split_valid_until > now.motion_bound && !now.threshold_changed;
        valid.then_some(pair.refined_share)
    }

    /// The motion bounds until which a pair would be split again, and until which its bounding hulls stay in
    /// reach, m.
    pub fn split_and_overlap_valid_until(&self, slot: u32) -> (f64, f64) {
        let pair = &self.pairs[slot as usize];
        (pair.split_valid_until, pair.overlap_valid_until)
    }

    pub fn is_split(&self, slot: u32) -> bool {
        self.links[slot as usize].first_child != NO_PAIR
    }

    /// The slots of the pairs that a pair is split into; none on the front.
    pub fn below(&self, slot: u32) -> impl Iterator<Item = u32> {
        let known = |slot: u32| (slot != NO_PAIR).then_some(slot);
        std::iter::successors(known(self.links[slot as usize].first_child), move |slot| {
            known(self.links[*slot as usize].next)
        })
    }

    /// Splits a pair into others; returns `false` without a change if there would be too many.
    pub fn split(&mut self, slot: u32, into: impl ExactSizeIterator<Item = Pair>) -> bool {
        if self.used + into.len() > self.limit {
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
                self.links[first as usize] = Link { recheck_at: pair.recheck_at, first_child: NO_PAIR, next };
            }
            self.used += 1;
        }
        self.links[slot as usize].first_child = first;
        self.pairs[slot as usize].split = true;
        self.split += 1;
        self.high_water = self.high_water.max(self.used);
        true
    }

    /// Undoes the split of a pair and of those below it.
    pub fn join(&mut self, slot: u32) {
        let first = std::mem::replace(&mut self.links[slot as usize].first_child, NO_PAIR);
        if first == NO_PAIR {
            return;
        }
        self.pairs[slot as usize].split = false;
        self.split -= 1;
        // The pairs to be freed form a list; the children of each are inserted before the rest.
        let mut list = first;
        while list != NO_PAIR {
            let slot = list as usize;
            let Link { first_child, next, .. } = self.links[slot];
            list = next;
            if first_child != NO_PAIR {
                self.split -= 1;
                let mut last = first_child as usize;
                while self.links[last].next != NO_PAIR {
                    last = self.links[last].next as usize;
                }
                self.links[last].next = list;
                list = first_child;
            }
            self.links[slot].next = self.spare;
            self.spare = slot as u32;
            self.used -= 1;
        }
    }

    /// Subtracts a motion bound (m), which counts from zero again, from all answers.
    pub fn rebase(&mut self, bound: f64) {
        for (pair, link) in self.pairs.iter_mut().zip(&mut self.links) {
            for at in [&mut link.recheck_at, &mut pair.split_valid_until, &mut pair.overlap_valid_until] {
                *at -= bound;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    const NOW: Progress = Progress { motion_bound: 0.0, turn: 0.0, threshold_changed: false };

    fn pairs(count: u32) -> impl ExactSizeIterator<Item = Pair> {
        (0..count as usize).map(|index| Pair::new(index as u32, 0))
    }

    /// Number of leaves of the same tree, kept as plain lists of children.
    fn leaves(children: &std::collections::HashMap<u32, Vec<u32>>, slot: u32) -> usize {
        children.get(&slot).map_or(1, |below| below.iter().map(|child| leaves(children, *child)).sum())
    }

    #[test]
    fn agrees_with_a_plain_tree() {
        let mut rng = StdRng::seed_from_u64(0x0F40_0001);
        let mut front = Front::with_capacity(4, 500);
        front.reset(Pair::new(7, 9));
        let mut children = std::collections::HashMap::<u32, Vec<u32>>::new();
        let mut joined = 0;
        for step in 0..5000 {
            // A random walk down from the root, so that pairs on all levels are joined.
            let mut slot = Front::ROOT;
            while let Some(below) = children.get(&slot).filter(|_| rng.random_bool(0.85)) {
                slot = below[rng.random_range(0..below.len())];
            }
            if front.is_split(slot) {
                if rng.random_bool(0.92) {
                    continue;
                }
                front.join(slot);
                let mut list = vec![slot];
                while let Some(next) = list.pop() {
                    list.extend(children.remove(&next).unwrap_or_default());
                }
                joined += 1;
            } else {
                let count = rng.random_range(1..6);
                if front.split(slot, pairs(count)) {
                    let below: Vec<u32> = front.below(slot).collect();
                    // The last child comes first.
                    let nodes: Vec<u32> = below.iter().map(|child| front.get(*child).a).collect();
                    assert_eq!(nodes, (0..count).rev().collect::<Vec<_>>(), "step {step}");
                    children.insert(slot, below);
                }
            }
            assert_eq!(front.len(), leaves(&children, Front::ROOT), "step {step}");
            assert_eq!((front.get(Front::ROOT).a, front.get(Front::ROOT).b), (7, 9));
        }
        let high_water = front.high_water();
        assert!(
            joined > 100 && high_water > 200 && high_water <= 500,
            "{joined} joined, {high_water} pairs at once"
        );
        front.reset(Pair::new(0, 0));
        assert_eq!(front.len(), 1);
        assert!(!front.is_split(Front::ROOT));
    }

    #[test]
    fn a_full_front_refuses_a_split_without_a_change() {
        let mut front = Front::with_capacity(1, 4);
        front.reset(Pair::new(0, 0));
        assert!(front.split(Front::ROOT, pairs(3)));
        let child = front.below(Front::ROOT).next().unwrap();
        assert!(!front.split(child, pairs(1)) && !front.is_split(child));
        assert_eq!((front.len(), front.high_water()), (3, 4));
        front.join(Front::ROOT);
        assert!(front.split(Front::ROOT, pairs(3)), "joined pairs make room");
    }

    #[test]
    fn answers_are_valid_until_the_motion_bound() {
        let mut front = Front::with_capacity(4, 4);
        let root = Pair { recheck_at: 1.0, split_valid_until: 2.0, ..Pair::new(0, 0) };
        front.reset(root);
        let at = |motion_bound: f64| Progress { motion_bound, ..NOW };
        assert!(front.is_valid(Front::ROOT, &at(0.5)) && !front.is_valid(Front::ROOT, &at(1.0)));
        // With another threshold only pairs that are out of reach at any threshold keep their answer.
        let changed = Progress { threshold_changed: true, ..NOW };
        assert!(!front.is_valid(Front::ROOT, &changed));
        front.set(Front::ROOT, Pair { out_of_reach: true, ..root });
        assert!(front.is_valid(Front::ROOT, &changed));
        // A split is kept only while the pair is split.
        assert_eq!(front.valid_split(Front::ROOT, &NOW), None);
        front.split(Front::ROOT, pairs(2));
        front.set(Front::ROOT, Pair { refined_share: 0.25, ..root });
        assert_eq!(front.valid_split(Front::ROOT, &at(1.5)), Some(0.25));
        assert_eq!(front.valid_split(Front::ROOT, &at(2.0)), None);
        assert_eq!(front.valid_split(Front::ROOT, &changed), None);
    }

    #[test]
    fn a_rebased_front_is_valid_for_as_long_as_before() {
        let mut front = Front::with_capacity(4, 8);
        front.reset(Pair { recheck_at: 5.0, ..Pair::new(0, 0) });
        front.split(
            Front::ROOT,
            [3.0, f64::INFINITY].into_iter().map(|recheck_at| Pair {
                recheck_at,
                split_valid_until: 6.0,
                overlap_valid_until: 7.0,
                ..Pair::new(1, 1)
            }),
        );
        front.rebase(2.0);
        assert_eq!(front.recheck_at(Front::ROOT), 3.0);
        let below: Vec<Pair> = front.below(Front::ROOT).map(|child| front.get(child)).collect();
        assert_eq!(below.iter().map(|pair| pair.recheck_at).collect::<Vec<_>>(), [f64::INFINITY, 1.0]);
        assert!(below.iter().all(|pair| (pair.split_valid_until, pair.overlap_valid_until) == (4.0, 5.0)));
    }
}
