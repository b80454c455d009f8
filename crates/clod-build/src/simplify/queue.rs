//! The queue of edges in the order in which their collapse is tried: by resolution (§3.3.3).
//!
//! The queue is lazy: when a collapse changes the surroundings of an edge, its resolution is recomputed only
//! when it is popped (at once for the edges of the merged vertex).
//!
//! Resolutions within a thousandth of each other count as equal, and then the vertices decide: regular meshes
//! have many that are equal but for rounding, so that the order would otherwise depend on the unit of length.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

use foldhash::fast::FixedState;

use palpate_core::mesh::Adjacency;
use rayon::prelude::*;

use super::star::Star;
use super::state::State;

/// An edge in the queue: highest rank first, then the lowest vertices; with the stamp of its state.
type Entry = (u64, Reverse<[u32; 2]>, u32);

/// State of an edge besides its entries in the queue.
#[derive(Clone, Copy, Debug, Default)]
struct EdgeState {
    /// Stamp of the valid entry; earlier ones are skipped.
    stamp: u32,
    /// Whether it could not be collapsed in its present surroundings, so that it is not in the queue.
    invalid: bool,
    /// Its resolution as last computed.
    resolution: f64,
    /// The sum of its ends' changes at that time.
    changes: u32,
}

/// The edges by resolution, with the changes of their surroundings.
pub(crate) struct Queue {
    heap: BinaryHeap<Entry>,
    edges: HashMap<[u32; 2], EdgeState, FixedState>,
    /// Radius of the object, in unit coordinates: ranks are those of resolutions times this length.
    radius: f64,
    /// Number of changes of the surroundings of each vertex.
    changes: Vec<u32>,
}

fn ordered([a, b]: [u32; 2]) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

/// Resolution of an edge, if its collapse keeps the topology; else the inverse of its length.
fn resolution(state: &State, ends: [u32; 2], star: &mut Star) -> f64 {
    if state.fans.star(&state.surface.triangles, ends, star) {
        let near = state.neighbourhood();
        near.resolution(star, &near.path(star, &state.quadric(ends)))
    } else {
        let [p, q] = ends.map(|v| state.surface.points[v as usize]);
        p.distance(q).max(1e-300).recip()
    }
}

impl Queue {
    /// A queue of all edges of a mesh; `radius` is the object's, in unit coordinates.
    pub fn new(state: &State, adjacency: &Adjacency, radius: f64) -> Self {
        let mut queue = Self {
            heap: BinaryHeap::new(),
            edges: HashMap::default(),
            radius,
            changes: vec![0; state.surface.points.len()],
        };
        queue.fill(state, adjacency);
        queue
    }

    fn fill(&mut self, state: &State, adjacency: &Adjacency) {
        let entries: Vec<([u32; 2], f64)> = adjacency
            .edges()
            .par_iter()
            .map_init(Star::default, |star, edge| (*edge, resolution(state, *edge, star)))
            .collect();
        for (edge, resolution) in entries {
            self.push(edge, resolution);
        }
    }

    /// Rank of a resolution: its leading bits, which are in its order since it is positive.
    fn rank(&self, resolution: f64) -> u64 {
        (resolution * self.radius).to_bits() >> 42
    }

    fn push(&mut self, edge: [u32; 2], resolution: f64) {
        let changes = self.changes_of(edge);
        let known = self.edges.entry(edge).or_default();
        *known = EdgeState { stamp: known.stamp + 1, invalid: false, resolution, changes };
        let stamp = known.stamp;
        self.heap.push((self.rank(resolution), Reverse(edge), stamp));
    }

    fn changes_of(&self, [a, b]: [u32; 2]) -> u32 {
        self.changes[a as usize].wrapping_add(self.changes[b as usize])
    }

    /// The edge to be tried next, with its resolution.
    pub fn pop(&mut self, state: &State) -> Option<([u32; 2], f64)> {
        let mut star = Star::default();
        while let Some((rank, Reverse(edge), stamp)) = self.heap.pop() {
            let Some(known) = self.edges.get(&edge) else { continue };
            if known.stamp != stamp || known.invalid {
                continue;
            }
            if known.changes != self.changes_of(edge) {
                let now = resolution(state, edge, &mut star);
                if self.rank(now) < rank {
                    self.push(edge, now);
                    continue;
                }
            }
            return Some((edge, known.resolution));
        }
        None
    }

    pub fn invalidate(&mut self, edge: [u32; 2]) {
        let changes = self.changes_of(edge);
        if let Some(known) = self.edges.get_mut(&edge) {
            (known.invalid, known.changes) = (true, changes);
        }
    }

    /// Updates the queue after a collapse: removes the edges of the vertex that is gone, recomputes those of
    /// the merged vertex, and queues invalid edges around it again.
    pub fn collapsed(&mut self, state: &State, star: &Star) {
        let [kept, gone] = star.ends;
        self.edges.remove(&ordered(star.ends));
        let rim = star.rim();
        for v in &rim {
            self.edges.remove(&ordered([gone, *v]));
            self.changes[*v as usize] = self.changes[*v as usize].wrapping_add(1);
        }
        self.changes[kept as usize] = self.changes[kept as usize].wrapping_add(1);
        let mut own = Star::default();
        for v in &rim {
            let edge = ordered([kept, *v]);
            self.push(edge, resolution(state, edge, &mut own));
        }
        let mut next = Vec::new();
        for v in &rim {
            state.fans.neighbours(&state.surface.triangles, *v, &mut next);
            for w in next.iter().filter(|w| **w != kept) {
                let edge = ordered([*v, *w]);
                if let Some(known) = self.edges.get(&edge).filter(|known| known.invalid) {
                    let (resolution, stale) = (known.resolution, known.changes);
                    self.push(edge, resolution);
                    if let Some(known) = self.edges.get_mut(&edge) {
                        known.changes = stale;
                    }
                }
            }
        }
    }
}
