//! The queue of objects by when they are due for a recheck: a binary heap whose entries can be changed and
//! removed.

/// Place of an object that is not in the heap.
const NONE: u32 = u32::MAX;

/// Objects by number, each with the motion bound at which it is due for a recheck, m. Only
/// [`reserve`](Self::reserve) allocates.
#[derive(Clone, Debug, Default)]
pub(crate) struct RecheckQueue {
    /// Invariant: the children 2 i + 1 and 2 i + 2 of entry i are due no earlier than it.
    heap: Vec<(f64, u32)>,
    /// For each object, its place in the heap, or [`NONE`].
    places: Vec<u32>,
}

impl RecheckQueue {
    /// Makes room for the objects with numbers below a bound.
    pub fn reserve(&mut self, bound: usize) {
        self.heap.reserve(bound.saturating_sub(self.heap.len()));
        if self.places.len() < bound {
            self.places.resize(bound, NONE);
        }
    }

    pub fn bytes(&self) -> usize {
        self.heap.capacity() * size_of::<(f64, u32)>() + self.places.capacity() * size_of::<u32>()
    }

    /// Motion bound at which an object is due, m; infinite if it is not in the queue.
    pub fn recheck_at(&self, object: u32) -> f64 {
        self.heap.get(self.places[object as usize] as usize).map_or(f64::INFINITY, |entry| entry.0)
    }

    /// Inserts an object, or changes when it is due.
    pub fn set(&mut self, object: u32, recheck_at: f64) {
        let place = self.places[object as usize];
        if place == NONE {
            self.heap.push((recheck_at, object));
            self.rise(self.heap.len() - 1);
        } else {
            self.heap[place as usize].0 = recheck_at;
            self.restore(place as usize);
        }
    }

    /// Removes an object.
    pub fn remove(&mut self, object: u32) {
        let place = std::mem::replace(&mut self.places[object as usize], NONE) as usize;
        if place < self.heap.len() {
            self.heap.swap_remove(place);
            if place < self.heap.len() {
                self.restore(place);
            }
        }
    }

    /// Makes all objects due.
    pub fn recheck_all(&mut self) {
        self.heap.iter_mut().for_each(|entry| entry.0 = f64::NEG_INFINITY);
    }

    /// Lists the objects that are due at a motion bound, in no particular order.
    pub fn due(&self, motion_bound: f64, list: &mut Vec<u32>) {
        self.due_below(0, motion_bound, list);
    }

    fn due_below(&self, place: usize, motion_bound: f64, list: &mut Vec<u32>) {
        if let Some((_, object)) = self.heap.get(place).filter(|entry| entry.0 <= motion_bound) {
            list.push(*object);
            self.due_below(2 * place + 1, motion_bound, list);
            self.due_below(2 * place + 2, motion_bound, list);
        }
    }

    /// Restores the order of the heap after the entry at a place has changed.
    fn restore(&mut self, place: usize) {
        let place = self.rise(place);
        self.sink(place);
    }

    fn rise(&mut self, mut place: usize) -> usize {
        while place > 0 && self.heap[place].0 < self.heap[(place - 1) / 2].0 {
            self.swap(place, (place - 1) / 2);
            place = (place - 1) / 2;
        }
        self.places[self.heap[place].1 as usize] = place as u32;
        place
    }

    fn sink(&mut self, mut place: usize) {
        loop {
            let children = 2 * place + 1..(2 * place + 3).min(self.heap.len());
            let first = children.min_by(|x, y| self.heap[*x].0.total_cmp(&self.heap[*y].0));
            let Some(child) = first.filter(|child| self.heap[*child].0 < self.heap[place].0) else {
                return;
            };
            self.swap(place, child);
            place = child;
        }
    }

    fn swap(&mut self, x: usize, y: usize) {
        self.heap.swap(x, y);
        for place in [x, y] {
            self.places[self.heap[place].1 as usize] = place as u32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    #[test]
    fn agrees_with_a_plain_list() {
        let mut rng = StdRng::seed_from_u64(0x0057_AE01);
        let mut queue = RecheckQueue::default();
        queue.reserve(50);
        let mut plain = [None; 50];
        let mut list = Vec::new();
        for step in 0..20_000 {
            let object: u32 = rng.random_range(0..50);
            if rng.random_range(0..4) == 0 {
                queue.remove(object);
                plain[object as usize] = None;
            } else {
                let times = [rng.random_range(0.0..1.0), f64::NEG_INFINITY];
                let recheck_at = times[usize::from(rng.random_range(0..5) == 0)];
                queue.set(object, recheck_at);
                plain[object as usize] = Some(recheck_at);
            }
            if rng.random_range(0..200) == 0 {
                queue.recheck_all();
                plain.iter_mut().flatten().for_each(|recheck_at| *recheck_at = f64::NEG_INFINITY);
            }
            let bound = rng.random_range(-0.1..1.1);
            list.clear();
            queue.due(bound, &mut list);
            list.sort_unstable();
            let expected: Vec<u32> =
                (0..50).filter(|i| plain[*i as usize].is_some_and(|at| at <= bound)).collect();
            assert_eq!(list, expected, "step {step}");
            assert_eq!(queue.recheck_at(object), plain[object as usize].unwrap_or(f64::INFINITY));
        }
    }
}
