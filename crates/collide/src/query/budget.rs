//! Time-critical queries: what is refined first, and when they stop.

use std::cmp::Ordering;
use std::time::{Duration, Instant};

use super::bodies::{Bodies, Verdict};
use super::front::{Front, Pair};
use super::refinement::urgency;
use super::{Circumstances, ContactQuery};

/// What examining a pair is expected to take before it has been measured, s; and queries over which that is averaged.
const PACE: f64 = 1e-6;
const PACE_MEMORY: f64 = 8.0;

/// What a time-critical query took lately, s.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    /// To examine a pair for want of time.
    examining: f64,
    /// To tidy up in the end.
    leaving: f64,
}

impl Default for Pace {
    fn default() -> Self {
        Self { examining: PACE, leaving: 0.0 }
    }
}

/// Goes a part of the way from a mean to a new value.
fn follow(mean: &mut f64, value: f64) {
    *mean += (value - *mean) / PACE_MEMORY;
}

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
        let mut waiting = usize::from(self.bodies.is_reportable(&roots));
        let mut stopped: Option<Instant> = None;
        let mut stops = 0;
        while let Some(Urgent { deviation, slot, weight }) = self.urgent.pop() {
            let pair = self.front.get(slot);
            let reportable = self.bodies.is_reportable(&pair);
            waiting -= usize::from(reportable);
            if reportable && deviation > 1.0 && self.is_spent(budget, begun, waiting) {
                stopped = stopped.or_else(|| Some(Instant::now()));
                stops += 1;
                self.outcome.out_of_budget = true;
                self.outcome.worst_deviation = self.outcome.worst_deviation.max(deviation);
                let mut examined = pair;
                self.examined(Verdict::Examine, &mut examined, weight, now);
                self.front.set(slot, Pair { nearest: examined.nearest, ..pair });
                continue;
            }
            let Some(share) = self.enter(slot, weight, now) else { continue };
            let Self { front, bodies, urgent, .. } = self;
            for child in front.below(slot).filter(|child| !front.sleeps(*child, now)) {
                let pair = front.get(child);
                let Bodies { probe, scene } = &*bodies;
                let error = bodies.threshold(&pair, now);
                let deviation = urgency(&probe.detail(pair.a), &scene.detail(pair.b), error);
                urgent.push(Urgent { deviation, slot: child, weight: weight * share });
                waiting += usize::from(bodies.is_reportable(&pair));
            }
            self.outcome.stack_high_water = self.outcome.stack_high_water.max(self.urgent.len());
        }
        if let Some(stopped) = stopped {
            follow(&mut self.pace.examining, stopped.elapsed().as_secs_f64() / f64::from(stops));
        }
        let leaving = Instant::now();
        self.leave_all(now);
        follow(&mut self.pace.leaving, leaving.elapsed().as_secs_f64());
    }

    /// Whether a budget is spent, but for examining the pairs that wait.
    fn is_spent(&self, budget: Budget, begun: Instant, waiting: usize) -> bool {
        let made = self.leaf.counts.convex_queries;
        match budget {
            Budget::Queries(queries) => made + waiting >= queries,
            Budget::Time(time) => {
                let Pace { examining, leaving } = self.pace;
                let left = waiting as f64 * examining + leaving;
                begun.elapsed().as_secs_f64() + left >= time.as_secs_f64()
            }
        }
    }
}
