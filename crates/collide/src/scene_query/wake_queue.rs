//! Which objects wake first: a binary heap whose entries can be moved and taken out.

const NONE: u32 = u32::MAX;

/// Numbers, each with the way at which it wakes, m. Nothing allocates but [`reserve`](Self::reserve).
#[derive(Clone, Debug, Default)]
pub(crate) struct WakeQueue {
    /// The children of entry i are 2 i + 1 and 2 i + 2, and wake no earlier.
    heap: Vec<(f64, u32)>,
    /// Per number: its place in the heap, or [`NONE`].
    places: Vec<u32>,
}

impl WakeQueue {
    /// Makes room for the numbers below a bound.
    pub fn reserve(&mut self, bound: usize) {
        self.heap.reserve(bound.saturating_sub(self.heap.len()));
        if self.places.len() < bound {
            self.places.resize(bound, NONE);
        }
    }

    pub fn bytes(&self) -> usize {
        self.heap.capacity() * size_of::<(f64, u32)>() + self.places.capacity() * size_of::<u32>()
    }

    /// When a number wakes; never, if it is not there.
    pub fn wake(&self, number: u32) -> f64 {
        self.heap.get(self.places[number as usize] as usize).map_or(f64::INFINITY, |entry| entry.0)
    }

    /// Puts a number in, or changes when it wakes.
    pub fn set(&mut self, number: u32, wake: f64) {
        let place = self.places[number as usize];
        if place == NONE {
            self.heap.push((wake, number));
            self.rise(self.heap.len() - 1);
        } else {
            self.heap[place as usize].0 = wake;
            self.settle(place as usize);
        }
    }

    /// Takes a number out.
    pub fn remove(&mut self, number: u32) {
        let place = std::mem::replace(&mut self.places[number as usize], NONE) as usize;
        if place < self.heap.len() {
            self.heap.swap_remove(place);
            if place < self.heap.len() {
                self.settle(place);
            }
        }
    }

    /// Wakes all.
    pub fn wake_all(&mut self) {
        self.heap.iter_mut().for_each(|entry| entry.0 = f64::NEG_INFINITY);
    }

    /// Lists those that are awake after some way, in no particular order.
    pub fn awake(&self, way: f64, list: &mut Vec<u32>) {
        self.awake_below(0, way, list);
    }

    fn awake_below(&self, place: usize, way: f64, list: &mut Vec<u32>) {
        if let Some((_, number)) = self.heap.get(place).filter(|entry| entry.0 <= way) {
            list.push(*number);
            self.awake_below(2 * place + 1, way, list);
            self.awake_below(2 * place + 2, way, list);
        }
    }

    /// Puts an entry where it belongs.
    fn settle(&mut self, place: usize) {
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
        let mut queue = WakeQueue::default();
        queue.reserve(50);
        let mut plain = [None; 50];
        let mut list = Vec::new();
        for step in 0..20_000 {
            let number: u32 = rng.random_range(0..50);
            if rng.random_range(0..4) == 0 {
                queue.remove(number);
                plain[number as usize] = None;
            } else {
                let wakes = [rng.random_range(0.0..1.0), f64::NEG_INFINITY];
                let wake = wakes[usize::from(rng.random_range(0..5) == 0)];
                queue.set(number, wake);
                plain[number as usize] = Some(wake);
            }
            let way = rng.random_range(-0.1..1.1);
            list.clear();
            queue.awake(way, &mut list);
            list.sort_unstable();
            let expected: Vec<u32> =
                (0..50).filter(|i| plain[*i as usize].is_some_and(|wake| wake <= way)).collect();
            assert_eq!(list, expected, "step {step}");
            assert_eq!(queue.wake(number), plain[number as usize].unwrap_or(f64::INFINITY));
        }
    }
}
