//! Time-critical queries (§3.4.3): pairs are tested in the order of s*/s₀, and when the budget is spent the
//! rest is examined without further refinement.

use std::cmp::Ordering;
use std::collections::BinaryHeap;
use std::time::Instant;

use super::bodies::{Bodies, Decision};
use super::context::Context;
use super::descent::{Descent, Sink};
use super::front::{Front, Pair};
use super::immediate::Immediate;
use super::outcome::Report;
use super::refinement::urgency;
use super::settings::Budget;

/// Initial estimate of the time that the examination of a pair takes, s, before it is measured.
const EXAMINATION_TIME: f64 = 1e-6;

/// Number of queries over which measured times are averaged.
const TIMING_QUERIES: f64 = 8.0;

/// Average times of recent time-critical queries, s.
#[derive(Clone, Copy, Debug)]
struct Timing {
    /// Examination of a pair at which the budget was spent.
    examination: f64,
    /// Leaving all pairs at the end.
    leaving: f64,
}

impl Default for Timing {
    fn default() -> Self {
        Self { examination: EXAMINATION_TIME, leaving: 0.0 }
    }
}

/// Moves an average towards a new value.
fn average(mean: &mut f64, value: f64) {
    *mean += (value - *mean) / TIMING_QUERIES;
}

/// A waiting pair, ordered by s*/s₀, the largest first.
#[derive(Clone, Copy, Debug)]
struct Urgent {
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

/// The workspace of time-critical queries.
#[derive(Clone, Debug, Default)]
pub(crate) struct Budgeted {
    waiting: BinaryHeap<Urgent>,
    timing: Timing,
}

impl Budgeted {
    /// A workspace with room for a number of pairs.
    pub fn with_capacity(pairs: usize) -> Self {
        Self { waiting: BinaryHeap::with_capacity(pairs), timing: Timing::default() }
    }

    pub fn capacity(&self) -> usize {
        self.waiting.capacity()
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        self.waiting.capacity() * size_of::<Urgent>()
    }

    /// Makes a query: tests pairs that are due in the order of s*/s₀ until the budget is spent. Pairs that
    /// still wait then are examined without further refinement.
    pub fn run(&mut self, budget: Budget, descent: &mut Descent, report: &mut Report, context: &Context) {
        let begun = Instant::now();
        self.waiting.clear();
        self.waiting.push(Urgent { deviation: f64::INFINITY, slot: Front::ROOT, weight: 1.0 });
        // Number of waiting pairs that can report contacts.
        let mut reportable = usize::from(descent.bodies.is_reportable(&descent.front.get(Front::ROOT)));
        let (mut first_stop, mut stops) = (None, 0);
        while let Some(Urgent { deviation, slot, weight }) = self.waiting.pop() {
            let pair = descent.front.get(slot);
            let is_reportable = descent.bodies.is_reportable(&pair);
            reportable -= usize::from(is_reportable);
            if is_reportable && deviation > 1.0 && self.is_spent(budget, begun, reportable, descent) {
                first_stop.get_or_insert_with(Instant::now);
                stops += 1;
                report.outcome.out_of_budget = true;
                report.outcome.worst_deviation = report.outcome.worst_deviation.max(deviation);
                stop_at(pair, slot, weight, descent, report, context);
                continue;
            }
            let Some(share) = descent.enter(slot, weight, &mut Immediate(report), context) else { continue };
            let Descent { front, bodies, patch_query, .. } = descent;
            for child in front.below(slot).filter(|child| !front.is_valid(*child, &context.now)) {
                let pair = front.get(child);
                let Bodies { probe, scene } = &*bodies;
                let error = bodies.threshold(&pair, context);
                let deviation = urgency(&probe.detail(pair.a), &scene.detail(pair.b), error);
                self.waiting.push(Urgent { deviation, slot: child, weight: weight * share });
                reportable += usize::from(bodies.is_reportable(&pair));
            }
            let high_water = &mut patch_query.costs.stack_high_water;
            *high_water = self.waiting.len().max(*high_water);
        }
        if let Some(first_stop) = first_stop {
            average(&mut self.timing.examination, first_stop.elapsed().as_secs_f64() / f64::from(stops));
        }
        let leaving = Instant::now();
        descent.leave_all(context);
        average(&mut self.timing.leaving, leaving.elapsed().as_secs_f64());
    }

    /// Whether the rest of a budget is only enough to examine the waiting pairs.
    fn is_spent(&self, budget: Budget, begun: Instant, waiting: usize, descent: &Descent) -> bool {
        match budget {
            Budget::Queries(queries) => descent.patch_query.costs.convex_queries + waiting >= queries,
            Budget::Time(time) => {
                let Timing { examination, leaving } = self.timing;
                let left = waiting as f64 * examination + leaving;
                begun.elapsed().as_secs_f64() + left >= time.as_secs_f64()
            }
        }
    }
}

/// Examines a pair without refining it, even if it is split. It stays due for a test.
fn stop_at(
    pair: Pair,
    slot: u32,
    weight: f64,
    Descent { bodies, front, patch_query, .. }: &mut Descent,
    report: &mut Report,
    context: &Context,
) {
    let mut examined = pair;
    let tests = (&*bodies, context, patch_query);
    Immediate(report).examine(Decision::Examine, &mut examined, Some(slot), weight, tests);
    front.set(slot, Pair { warm_start: examined.warm_start, ..pair });
}
