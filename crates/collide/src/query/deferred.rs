//! Deferred examination: pairs are examined together after the descent, on the threads of the current rayon
//! pool.
//!
//! The contacts of a pair depend on that pair alone and are reported in the order of the descent:
//! the answer is the same to the last bit for any number of threads.

use std::ops::Range;

use palpate_core::Contact;
use rayon::prelude::*;

use super::bodies::{Bodies, Decision};
use super::context::Context;
use super::descent::{Descent, Sink};
use super::front::Pair;
use super::outcome::Report;
use super::patch_query::PatchQuery;

/// Smallest number of pairs that are shared by several threads. With fewer, starting them costs more than it
/// saves.
const SHARED_PAIRS: usize = 64;

/// A pair that waits for its examination, or has been examined.
#[derive(Clone, Debug)]
struct Task {
    /// The pair's slot in the front; `None` if it has been examined already.
    slot: Option<u32>,
    pair: Pair,
    /// Weight of its contacts.
    weight: f64,
    /// Range of its contacts among those of its worker, or among those found during the descent.
    contacts: Range<usize>,
}

/// A thread's buffers.
#[derive(Clone, Debug, Default)]
struct Worker {
    patch_query: PatchQuery,
    /// Contacts of its tasks, in their order.
    contacts: Vec<Contact>,
}

/// The pairs that wait, in the order of the descent.
#[derive(Clone, Debug, Default)]
pub(crate) struct Deferred {
    tasks: Vec<Task>,
    /// Contacts of pairs that were examined during the descent.
    found: Vec<Contact>,
    workers: Vec<Worker>,
}

impl Sink for Deferred {
    const DEFERS: bool = true;

    fn examine(
        &mut self,
        decision: Decision,
        pair: &mut Pair,
        slot: Option<u32>,
        weight: f64,
        (bodies, context, patch_query): (&Bodies, &Context, &mut PatchQuery),
    ) -> Decision {
        let decides = decision == Decision::ExamineToDecide;
        if slot.is_some() && !decides {
            self.tasks.push(Task { slot, pair: *pair, weight, contacts: 0..0 });
            pair.recheck_at = f64::NEG_INFINITY;
            return Decision::Stop;
        }
        let decision = bodies.examine(pair, decides, context, patch_query);
        if !patch_query.contacts.is_empty() {
            let start = self.found.len();
            self.found.extend_from_slice(&patch_query.contacts);
            let (weight, contacts) = (weight * (1.0 - pair.refined_share), start..self.found.len());
            self.tasks.push(Task { slot: None, pair: *pair, weight, contacts });
        }
        decision
    }
}

impl Deferred {
    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        let of_worker = |worker: &Worker| {
            worker.patch_query.bytes()
                + worker.contacts.capacity() * size_of::<Contact>()
                + size_of::<Worker>()
        };
        self.tasks.capacity() * size_of::<Task>()
            + self.found.capacity() * size_of::<Contact>()
            + self.workers.iter().map(of_worker).sum::<usize>()
    }

    /// Makes a query: a descent, then the examination of all pairs that wait.
    pub fn run(&mut self, descent: &mut Descent, report: &mut Report, context: &Context) {
        self.tasks.clear();
        self.found.clear();
        descent.run(self, context);
        let per_worker = self.examine_all(descent, context);
        for (tasks, worker) in self.tasks.chunks(per_worker).zip(&self.workers) {
            descent.patch_query.costs.add(&worker.patch_query.costs);
            for task in tasks {
                if let Some(slot) = task.slot {
                    descent.front.set(slot, task.pair);
                }
                let contacts = if task.slot.is_some() { &worker.contacts } else { &self.found };
                for contact in &contacts[task.contacts.clone()] {
                    report.add(contact, [task.pair.a, task.pair.b], task.weight, &context.probe_pose);
                }
            }
        }
        descent.leave_all(context);
    }

    /// Examines all pairs that wait. Returns the number of tasks of each worker.
    fn examine_all(&mut self, descent: &Descent, context: &Context) -> usize {
        let threads = if self.tasks.len() < SHARED_PAIRS { 1 } else { rayon::current_num_threads() };
        if self.workers.len() < threads {
            self.workers.resize_with(threads, Worker::default);
        }
        let per_worker = self.tasks.len().div_ceil(threads).max(1);
        let work = |(tasks, worker): (&mut [Task], &mut Worker)| {
            worker.contacts.clear();
            worker.patch_query.costs = Default::default();
            for task in tasks.iter_mut().filter(|task| task.slot.is_some()) {
                descent.bodies.examine(&mut task.pair, false, context, &mut worker.patch_query);
                let start = worker.contacts.len();
                worker.contacts.extend_from_slice(&worker.patch_query.contacts);
                task.contacts = start..worker.contacts.len();
            }
        };
        if threads == 1 {
            self.tasks.chunks_mut(per_worker).zip(&mut self.workers).for_each(work);
        } else {
            self.tasks.par_chunks_mut(per_worker).zip(&mut self.workers[..threads]).for_each(work);
        }
        per_worker
    }
}
