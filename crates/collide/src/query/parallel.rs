//! Pairs that are examined at once, on the threads of the current rayon pool, after the descent has come to all of them.
//!
//! What a pair's examination finds depends on that pair alone, and is reported in the order of the descent: the answer is
//! the same to the last bit, however many threads there are.

use std::ops::Range;

use palpate_core::Contact;
use rayon::prelude::*;

use super::Circumstances;
use super::bodies::Bodies;
use super::front::Pair;
use super::leaf::LeafQuery;

/// Fewer pairs than this are not worth sharing out.
const WORTHWHILE: usize = 64;

/// A pair that is to be examined, or was.
#[derive(Clone, Debug)]
pub(crate) struct Task {
    /// Its slot in the front; none if it is examined already, or not kept.
    pub slot: Option<u32>,
    pub pair: Pair,
    /// Of its contacts.
    pub weight: f64,
    contacts: Range<usize>,
}

/// A thread's buffers.
#[derive(Clone, Debug, Default)]
struct Worker {
    leaf: LeafQuery,
    /// Of its tasks, one after the other.
    contacts: Vec<Contact>,
}

/// The pairs that wait, in the order of the descent.
#[derive(Clone, Debug, Default)]
pub(crate) struct Deferred {
    tasks: Vec<Task>,
    /// Contacts of pairs that could not wait.
    found: Vec<Contact>,
    workers: Vec<Worker>,
    /// Tasks that each of them had, in the last run.
    share: usize,
}

impl Deferred {
    /// Bytes of buffer, for telling whether a query allocated.
    pub fn bytes(&self) -> usize {
        let of_worker = |worker: &Worker| {
            worker.leaf.bytes() + worker.contacts.capacity() * size_of::<Contact>() + size_of::<Worker>()
        };
        self.tasks.capacity() * size_of::<Task>()
            + self.found.capacity() * size_of::<Contact>()
            + self.workers.iter().map(of_worker).sum::<usize>()
    }

    /// A pair that waits.
    pub fn defer(&mut self, slot: u32, pair: Pair, weight: f64) {
        self.tasks.push(Task { slot: Some(slot), pair, weight, contacts: 0..0 });
    }

    /// The contacts of a pair that was examined on the way.
    pub fn report(&mut self, pair: Pair, weight: f64, contacts: &[Contact]) {
        if !contacts.is_empty() {
            let start = self.found.len();
            self.found.extend_from_slice(contacts);
            self.tasks.push(Task { slot: None, pair, weight, contacts: start..self.found.len() });
        }
    }

    /// Examines all pairs that wait. What it took is added to that of `leaf`.
    pub fn run(&mut self, bodies: &Bodies, now: &Circumstances, leaf: &mut LeafQuery) {
        let threads = if self.tasks.len() < WORTHWHILE { 1 } else { rayon::current_num_threads() };
        if self.workers.len() < threads {
            self.workers.resize_with(threads, Worker::default);
        }
        self.workers.iter_mut().for_each(|worker| worker.contacts.clear());
        self.share = self.tasks.len().div_ceil(threads).max(1);
        let work = |(tasks, worker): (&mut [Task], &mut Worker)| {
            worker.leaf.counts = Default::default();
            for task in tasks.iter_mut().filter(|task| task.slot.is_some()) {
                bodies.examine(&mut task.pair, false, now, &mut worker.leaf);
                let start = worker.contacts.len();
                worker.contacts.extend_from_slice(&worker.leaf.contacts);
                task.contacts = start..worker.contacts.len();
            }
        };
        if threads == 1 {
            self.tasks.chunks_mut(self.share).zip(&mut self.workers).for_each(work);
        } else {
            self.tasks.par_chunks_mut(self.share).zip(&mut self.workers[..threads]).for_each(work);
        }
        for (_, worker) in self.tasks.chunks(self.share).zip(&self.workers) {
            leaf.counts.add(&worker.leaf.counts);
        }
    }

    /// All that was found by [`run`](Self::run), in the order of the descent.
    pub fn found(&self) -> impl Iterator<Item = (&Task, &[Contact])> {
        self.tasks.chunks(self.share.max(1)).zip(&self.workers).flat_map(|(tasks, worker)| {
            tasks.iter().map(|task| {
                let contacts = if task.slot.is_some() { &worker.contacts } else { &self.found };
                (task, &contacts[task.contacts.clone()])
            })
        })
    }

    /// Forgets all of it.
    pub fn clear(&mut self) {
        self.tasks.clear();
        self.found.clear();
    }
}
