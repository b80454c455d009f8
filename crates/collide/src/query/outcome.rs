//! Results and costs of a query. Contacts beyond the largest number that it reports are dropped here.

use palpate_core::{Contact, Pose};

use crate::contact::{PatchContact, to_world};

/// Largest number of contacts that a query reports, some 100 MB. Beyond it the shallowest are dropped and
/// counted ([`QueryOutcome::dropped`]).
pub const MAX_CONTACTS: usize = 1 << 20;

/// Results and costs of a query.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct QueryOutcome {
    /// Number of contacts found, including those that were [dropped](Self::dropped).
    pub contacts: usize,
    /// Smallest separation distance within the tolerance, m; 0 when something penetrates, `None` without
    /// contacts.
    pub smallest_distance: Option<f64>,
    /// Largest depth δ, m: negative when all contacts are separated; `None` without contacts.
    pub deepest: Option<f64>,
    /// Number of contacts that were dropped because there were more than [`MAX_CONTACTS`]. Each is shallower
    /// than at least half of that many that are reported, which are then in no particular order. A smaller
    /// tolerance finds fewer.
    pub dropped: usize,
    /// Number of pairs of nodes tested: those that were due by the bodies' motion, and those that they were
    /// split into, with their bounding spheres within reach.
    pub visited: usize,
    /// Size of the front of the bounding volume test tree (§3.4.2): pairs at which the descent ended because
    /// they are out of reach or were examined for contacts.
    pub front: usize,
    /// Number of pairs among them that were examined for contacts: of leaves, or of nodes whose missing
    /// detail is below the threshold.
    pub leaf_pairs: usize,
    /// Number of convex queries made, including those of pairs of triangles.
    pub convex_queries: usize,
    /// Number of convex queries whose error may exceed the precision. Such pairs are never
    /// dropped.
    pub not_converged: usize,
    /// Number of pairs of patches that had to be decided triangle by triangle.
    pub by_triangles: usize,
    /// Largest number of pairs that waited on the stack at once.
    pub stack_high_water: usize,
    /// Largest number of pairs, on and above the front, that were kept at once, in this query or any before.
    pub front_high_water: usize,
    /// Whether there were more pairs than [`MAX_PAIRS`](crate::MAX_PAIRS), so that the front is only partly
    /// kept. The answer is the same, but the next query starts higher up.
    pub front_overflow: bool,
    /// Whether a time-critical query had to stop before all pairs were fine enough.
    pub out_of_budget: bool,
    /// Largest s*/s₀ at which a time-critical query stopped. If s₀ is 0, it only shows whether there was
    /// any.
    pub worst_deviation: f64,
    /// Whether a buffer grew during this query, which was larger than any before.
    pub reallocated: bool,
}

impl QueryOutcome {
    /// Adds the results and costs of another query: sums, largest values, and the smallest distance.
    pub(crate) fn add(&mut self, other: &Self) {
        let either = |x: Option<f64>, y: Option<f64>, of: fn(f64, f64) -> f64| match (x, y) {
            (Some(x), Some(y)) => Some(of(x, y)),
            (x, y) => x.or(y),
        };
        self.contacts += other.contacts;
        self.smallest_distance = either(self.smallest_distance, other.smallest_distance, f64::min);
        self.deepest = either(self.deepest, other.deepest, f64::max);
        self.dropped += other.dropped;
        self.visited += other.visited;
        self.front += other.front;
        self.leaf_pairs += other.leaf_pairs;
        self.convex_queries += other.convex_queries;
        self.not_converged += other.not_converged;
        self.by_triangles += other.by_triangles;
        self.stack_high_water = self.stack_high_water.max(other.stack_high_water);
        self.front_high_water = self.front_high_water.max(other.front_high_water);
        self.front_overflow |= other.front_overflow;
        self.out_of_budget |= other.out_of_budget;
        self.worst_deviation = self.worst_deviation.max(other.worst_deviation);
        self.reallocated |= other.reallocated;
    }
}

/// The contacts that a query reports, and its outcome so far.
#[derive(Clone, Debug)]
pub(crate) struct Report {
    /// The contacts, in world axes.
    pub contacts: Vec<PatchContact>,
    pub outcome: QueryOutcome,
}

impl Report {
    /// An empty report with room for a number of contacts.
    pub fn with_capacity(contacts: usize) -> Self {
        Self { contacts: Vec::with_capacity(contacts), outcome: QueryOutcome::default() }
    }

    pub fn clear(&mut self) {
        self.contacts.clear();
        self.outcome = QueryOutcome::default();
    }

    /// Adds a contact of a pair of nodes, given in the probe's frame.
    pub fn add(
        &mut self,
        contact: &Contact,
        [probe_node, scene_node]: [u32; 2],
        weight: f64,
        probe_pose: &Pose,
    ) {
        let Self { contacts, outcome } = self;
        outcome.contacts += 1;
        let distance = contact.distance();
        outcome.smallest_distance = Some(outcome.smallest_distance.map_or(distance, |d| d.min(distance)));
        outcome.deepest = Some(outcome.deepest.map_or(contact.depth, |d| d.max(contact.depth)));
        if contacts.len() == MAX_CONTACTS {
            outcome.dropped += drop_shallower_half(contacts);
        }
        let contact = to_world(contact, probe_pose);
        contacts.push(PatchContact { contact, probe_node, scene_node, weight });
    }
}

/// Keeps the deeper half of some contacts, in no particular order. Returns the number of dropped ones. Does
/// not allocate.
///
/// Half of the contacts are dropped at once, so that each contact costs a constant time on average.
fn drop_shallower_half(contacts: &mut Vec<PatchContact>) -> usize {
    let kept = contacts.len() / 2;
    contacts.select_nth_unstable_by(kept, |x, y| y.contact.depth.total_cmp(&x.contact.depth));
    let dropped = contacts.len() - kept;
    contacts.truncate(kept);
    dropped
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_core::glam::DVec3;
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    #[test]
    fn the_shallowest_are_dropped() {
        let mut rng = StdRng::seed_from_u64(0xD509);
        for count in [2, 3, 64, 1001] {
            let mut contacts: Vec<PatchContact> = (0..count)
                .map(|_| {
                    let depth = rng.random_range(-1.0..1.0);
                    let contact =
                        Contact { point: DVec3::ZERO, scene_point: DVec3::ZERO, normal: DVec3::Z, depth };
                    PatchContact { contact, probe_node: 0, scene_node: 0, weight: 1.0 }
                })
                .collect();
            let mut depths: Vec<f64> = contacts.iter().map(|found| found.contact.depth).collect();
            depths.sort_by(|x, y| y.total_cmp(x));
            let capacity = contacts.capacity();
            assert_eq!(drop_shallower_half(&mut contacts), count - count / 2);
            let mut kept: Vec<f64> = contacts.iter().map(|found| found.contact.depth).collect();
            kept.sort_by(|x, y| y.total_cmp(x));
            assert_eq!(kept, depths[..count / 2], "{count} contacts");
            assert_eq!(contacts.capacity(), capacity, "nothing is allocated");
        }
    }
}
