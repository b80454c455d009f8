//! Removal of triangles that intersect others, where these could not be united.
//!
//! At least one triangle of each intersecting pair has to be removed: a vertex cover of the graph of
//! conflicts. The cover of least area is NP-hard to find. The greedy cover (most conflicts per area first,
//! Chvátal 1979), without its redundant triangles, is close to it.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::Work;
use crate::intersect::crossing_pairs;
use crate::weld::equal_positions;

/// Largest number of intersections of a triangle that one round handles, and number of all after which it
/// handles no further triangles, so that memory stays bounded. The rest is left to the next round.
const MAX_PARTNERS: usize = 6_000;
const MAX_PAIRS: usize = 2_000_000;

impl Work {
    /// The pairs of triangles that intersect.
    pub(super) fn crossings(&self) -> Vec<[u32; 2]> {
        let mesh = self.mesh();
        let same = equal_positions(&self.points);
        crossing_pairs(&self.points, mesh.triangles(), &same, MAX_PARTNERS, MAX_PAIRS)
    }

    /// Drops triangles until none of the intersecting `pairs` is left; closes the holes where it can if
    /// `fill` is set.
    pub(super) fn cut_crossings(&mut self, pairs: &[[u32; 2]], fill: bool) {
        if pairs.is_empty() {
            return;
        }
        let mesh = self.mesh();
        let same = equal_positions(&self.points);
        let areas: Vec<f64> =
            self.pieces.iter().map(|p| self.doubled_area(p.corners).max(f64::MIN_POSITIVE)).collect();
        let mut removed = cover(&areas, pairs);
        let crossing = removed.iter().filter(|r| **r).count();
        let fillings = if fill { self.fillings(&mesh, &mut removed, &same) } else { Vec::new() };
        self.note_loss(&removed);
        let around = self.retain(|i| !removed[i]) - crossing;
        self.summary.intersecting_triangles += crossing;
        self.summary.surrounding_triangles += around;
        self.add_fillings(fillings);
    }
}

/// Chooses at least one of each pair, such that the sum of the weights (above 0) is small and no choice is
/// redundant.
fn cover(weights: &[f64], pairs: &[[u32; 2]]) -> Vec<bool> {
    let mut partners: Vec<Vec<u32>> = vec![Vec::new(); weights.len()];
    for [a, b] in pairs {
        partners[*a as usize].push(*b);
        partners[*b as usize].push(*a);
    }
    let mut conflicts: Vec<usize> = partners.iter().map(Vec::len).collect();
    let mut chosen = vec![false; weights.len()];
    // Positive floats are in the order of their bits.
    let key = |conflicts: &[usize], i: u32| {
        let gain = conflicts[i as usize] as f64 / weights[i as usize];
        (gain.to_bits(), Reverse(i))
    };
    let mut heap: BinaryHeap<_> = (0..weights.len() as u32)
        .filter(|i| conflicts[*i as usize] > 0)
        .map(|i| key(&conflicts, i))
        .collect();
    let mut order = Vec::new();
    while let Some((gain, Reverse(i))) = heap.pop() {
        if conflicts[i as usize] == 0 || chosen[i as usize] {
            continue;
        }
        let current = key(&conflicts, i);
        if current.0 != gain {
            heap.push(current);
            continue;
        }
        chosen[i as usize] = true;
        order.push(i);
        for other in &partners[i as usize] {
            conflicts[*other as usize] -= usize::from(conflicts[*other as usize] > 0);
        }
    }
    order.sort_by(|a, b| weights[*b as usize].total_cmp(&weights[*a as usize]).then(a.cmp(b)));
    for i in order {
        if partners[i as usize].iter().all(|other| chosen[*other as usize]) {
            chosen[i as usize] = false;
        }
    }
    chosen
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    #[test]
    fn covers_are_complete_minimal_and_near_the_best() {
        let seed = 71;
        let mut random = StdRng::seed_from_u64(seed);
        let (mut ours, mut best) = (0.0, 0.0);
        for round in 0..300 {
            let count = 3 + round % 8;
            let weights: Vec<f64> = (0..count).map(|_| random.random_range(0.1..2.0)).collect();
            let mut pairs = Vec::new();
            for a in 0..count as u32 {
                pairs.extend((a + 1..count as u32).filter(|_| random.random_bool(0.3)).map(|b| [a, b]));
            }
            let covers = |set: &dyn Fn(u32) -> bool| pairs.iter().all(|[a, b]| set(*a) || set(*b));
            let weight = |set: &dyn Fn(u32) -> bool| -> f64 {
                (0..count as u32).filter(|i| set(*i)).map(|i| weights[i as usize]).sum()
            };
            let chosen = cover(&weights, &pairs);
            let in_ours = |i: u32| chosen[i as usize];
            assert!(covers(&in_ours), "seed {seed}, round {round}");
            for needed in (0..count as u32).filter(|i| in_ours(*i)) {
                assert!(!covers(&|i| in_ours(i) && i != needed), "seed {seed}, round {round}: {needed}");
            }
            ours += weight(&in_ours);
            best += (0..1u32 << count)
                .map(|mask| move |i: u32| mask >> i & 1 == 1)
                .filter(|set| covers(set))
                .map(|set| weight(&set))
                .fold(f64::MAX, f64::min);
        }
        assert!(ours <= 1.05 * best, "seed {seed}: {ours} against {best}");
    }
}
