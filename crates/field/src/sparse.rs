//! Workspaces as large as what they hold: a body of the scene touches a small part of what surrounds the
//! probe, and few of its samples are ever read.

/// Number of values in a page.
const PAGE: usize = 64;

/// Key of an empty slot of an [`Index`].
const EMPTY: u32 = u32::MAX;

/// Smallest number of slots of an [`Index`].
const MIN_SLOTS: usize = 64;

/// Places in a list by numbers (keys): a hash table with open addressing, at most half full.
#[derive(Clone, Debug, Default)]
pub struct Index {
    /// Keys with their places. Their number is a power of two, or none.
    slots: Vec<(u32, u32)>,
    count: usize,
}

impl Index {
    pub fn clear(&mut self) {
        if self.count > 0 {
            self.slots.fill((EMPTY, 0));
            self.count = 0;
        }
    }

    /// The slot of a key, or the empty one where it belongs. There have to be slots.
    #[inline]
    fn slot(&self, key: u32) -> usize {
        let last = self.slots.len() - 1;
        // Multiplicative hashing: neighbouring keys are spread evenly, by the golden section.
        let hash = key.wrapping_mul(0x9E37_79B9);
        let mut slot = ((u64::from(hash) * self.slots.len() as u64) >> 32) as usize;
        while self.slots[slot].0 != key && self.slots[slot].0 != EMPTY {
            slot = (slot + 1) & last;
        }
        slot
    }

    /// The place of a key.
    #[inline]
    pub fn get(&self, key: u32) -> Option<usize> {
        if self.count == 0 {
            return None;
        }
        let (found, place) = self.slots[self.slot(key)];
        (found == key).then_some(place as usize)
    }

    /// The place of a key; `new`, which becomes its place, if it has none. No key is the largest number.
    #[inline]
    pub fn get_or_insert(&mut self, key: u32, new: usize) -> usize {
        if 2 * self.count >= self.slots.len() {
            self.grow();
        }
        let slot = self.slot(key);
        if self.slots[slot].0 == EMPTY {
            self.slots[slot] = (key, new as u32);
            self.count += 1;
        }
        self.slots[slot].1 as usize
    }

    #[cold]
    fn grow(&mut self) {
        let slots = vec![(EMPTY, 0); (2 * self.slots.len()).max(MIN_SLOTS)];
        for (key, place) in std::mem::replace(&mut self.slots, slots) {
            if key != EMPTY {
                let slot = self.slot(key);
                self.slots[slot] = (key, place);
            }
        }
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        self.slots.capacity() * size_of::<(u32, u32)>()
    }
}

/// A list of values, most of which are never set: it holds the pages with those that are.
#[derive(Clone, Debug)]
pub struct Pages<T> {
    unset: T,
    /// Number of each page among those held, from 1; 0 for those that are not.
    table: Vec<u32>,
    held: Vec<[T; PAGE]>,
}

impl<T: Copy> Pages<T> {
    /// A list of values that are not set.
    pub fn new(count: usize, unset: T) -> Self {
        Self { unset, table: vec![0; count.div_ceil(PAGE)], held: Vec::new() }
    }

    /// Makes all values those of a list that was not set.
    pub fn forget(&mut self) {
        self.table.fill(0);
        self.held.clear();
    }

    #[inline]
    pub fn get(&self, index: usize) -> T {
        match self.table[index / PAGE] {
            0 => self.unset,
            page => self.held[page as usize - 1][index % PAGE],
        }
    }

    #[inline]
    pub fn get_mut(&mut self, index: usize) -> &mut T {
        let page = &mut self.table[index / PAGE];
        if *page == 0 {
            self.held.push([self.unset; PAGE]);
            *page = self.held.len() as u32;
        }
        &mut self.held[*page as usize - 1][index % PAGE]
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        self.table.capacity() * size_of::<u32>() + self.held.capacity() * size_of::<[T; PAGE]>()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use rand::rngs::StdRng;
    use rand::{RngExt as _, SeedableRng as _};

    use super::*;

    #[test]
    fn an_index_is_a_map() {
        let mut rng = StdRng::seed_from_u64(0x1DE5);
        let mut index = Index::default();
        for round in 0..20 {
            let mut known = HashMap::new();
            assert_eq!(index.get(7), None);
            for _ in 0..1 << (round % 14) {
                // Neighbours, multiples of large numbers, and the largest.
                let key = match rng.random_range(0..3) {
                    0 => rng.random_range(0..500),
                    1 => rng.random_range(0..500) << 22,
                    _ => EMPTY - 1 - rng.random_range(0..500),
                };
                let place = known.len();
                assert_eq!(index.get(key), known.get(&key).copied());
                assert_eq!(index.get_or_insert(key, place), *known.entry(key).or_insert(place));
            }
            assert!(known.iter().all(|(key, place)| index.get(*key) == Some(*place)));
            index.clear();
        }
    }

    #[test]
    fn pages_are_a_list_and_take_the_memory_of_what_is_set() {
        let mut rng = StdRng::seed_from_u64(0x9A6E);
        let (mut pages, mut list) = (Pages::new(100_000, [7u64; 2]), vec![[7; 2]; 100_000]);
        for _ in 0..3 {
            for _ in 0..50 {
                let first = rng.random_range(0..99_000);
                let count = rng.random_range(0..9);
                for (index, entry) in list.iter_mut().enumerate().skip(first).take(count) {
                    let value = [rng.random_range(0..9), 0];
                    (*pages.get_mut(index), *entry) = (value, value);
                }
            }
            assert!((0..list.len()).all(|index| pages.get(index) == list[index]));
            assert!(10 * pages.bytes() < list.len() * size_of::<[u64; 2]>() * 2, "{} bytes", pages.bytes());
            pages.forget();
            list.fill([7; 2]);
        }
    }
}
