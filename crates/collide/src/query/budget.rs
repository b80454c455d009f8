//! Time-critical queries: what is refined first, and when they stop.

use std::cmp::Ordering;
use std::time::{Duration, Instant};

use super::bodies::{Bodies, Verdict};
use super::front::Front;
use super::refinement::urgency;
use super::{Circumstances, ContactQuery};

/// What examining a pair is expected to take before it has been measured, s; and queries over which that is averaged.
pub(super) const PACE: f64 = 1e-6;
const PACE_MEMORY: f64 = 8.0;

/// What a time-critical query may cost. Pairs above the coarsest level that is not free have to be gone through in any
/// case, and every pair that the query stops at costs one convex query more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Budget {
    /// Time.
    Time(Duration),
    /// Convex queries.
    Queries(usize),
}

/// A pair on the way of a time-critical query.
#[derive(Clone, Copy, Debug)]
pub(super) struct Urgent {
    /// s*/s₀.
    deviation: f64,
    slot: u32,
    weight: f64,
}

impl Ord for Urgent {
    fn cmp(&self, other: &Self) -> Ordering {
        self.deviation.total_cmp(&other.deviation).then(other.slot.cmp(&self.slot))
    }
}

impl PartialOrd for Urgent {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Urgent {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Urgent {}

impl ContactQuery {
    /// Looks at pairs that are awake in the order of s*/s₀, as far as the budget goes. What is left then is examined as it
    /// is.
    pub(super) fn traverse_within(&mut self, budget: Budget, now: &Circumstances) {
        let begun = Instant::now();
        self.urgent.clear();
        self.urgent.push(Urgent { deviation: f64::INFINITY, slot: Front::ROOT, weight: 1.0 });
        // Pairs that wait, and could be examined as they are.
        let roots = self.front.get(Front::ROOT);
        let mut waiting = usize::from(self.bodies.is_reportable(roots));
        let mut stopped: Option<Instant> = None;
        let mut examined = 0;
        while let Some(Urgent { deviation, slot, weight }) = self.urgent.pop() {
            let pair = *self.front.get(slot);
            let reportable = self.bodies.is_reportable(&pair);
            waiting -= usize::from(reportable);
            if self.sleeps(slot, now) {
                continue;
            }
            if reportable && deviation > 1.0 && self.is_spent(budget, begun, waiting) {
                stopped = stopped.or_else(|| Some(Instant::now()));
                examined += 1;
                self.outcome.out_of_budget = true;
                self.outcome.worst_deviation = self.outcome.worst_deviation.max(deviation);
                self.examined(Verdict::Examine, &mut { pair }, weight, now);
                continue;
            }
            let Some(share) = self.enter(slot, weight, now) else { continue };
            for child in self.front.below(slot) {
                let pair = self.front.get(child);
                let Bodies { probe, scene } = &self.bodies;
                let error = self.bodies.threshold(pair, now);
                let deviation = urgency(probe.detail(pair.a), scene.detail(pair.b), error);
                self.urgent.push(Urgent { deviation, slot: child, weight: weight * share });
                waiting += usize::from(self.bodies.is_reportable(pair));
            }
            self.outcome.stack_high_water = self.outcome.stack_high_water.max(self.urgent.len());
        }
        if let Some(stopped) = stopped {
            let pace = stopped.elapsed().as_secs_f64() / f64::from(examined);
            self.pace += (pace - self.pace) / PACE_MEMORY;
        }
        self.leave_all(now);
    }

    /// Whether a budget is spent, but for examining the pairs that wait.
    fn is_spent(&self, budget: Budget, begun: Instant, waiting: usize) -> bool {
        let made = self.leaf.counts.convex_queries;
        match budget {
            Budget::Queries(queries) => made + waiting >= queries,
            Budget::Time(time) => {
                begun.elapsed().as_secs_f64() + waiting as f64 * self.pace >= time.as_secs_f64()
            }
        }
    }
}
