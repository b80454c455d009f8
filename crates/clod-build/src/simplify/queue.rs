//! The edges in the order in which their collapse is tried: by resolution (§3.3.3).
//!
//! The queue is lazy: when a collapse changes the surroundings of an edge, its resolution is computed again only when it
//! comes up (at once for the edges of the merged vertex).
//!
//! Resolutions within a thousandth of each other count as equal, and then the vertices decide: on regular meshes there
//! are many that are equal but for rounding, which would otherwise make the order another one in other units.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

use foldhash::fast::FixedState;

use palpate_core::mesh::Adjacency;
use rayon::prelude::*;

use super::star::Star;
use super::state::State;

/// An edge in the queue: highest rank first, then the lowest vertices; with the stamp of its state.
type Entry = (u64, Reverse<[u32; 2]>, u32);

/// What is known of an edge that is not only in the queue as it was put there.
#[derive(Clone, Copy, Debug, Default)]
struct EdgeState {
    /// Of the entry that counts; earlier ones are passed over.
    stamp: u32,
    /// Whether it could not be collapsed as things are, so that it is not in the queue.
    invalid: bool,
    /// Its resolution, when it was last computed.
    resolution: f64,
    /// The sum of its ends' changes at that time.
    changes: u32,
}

/// The edges by resolution, with the changes of their surroundings.
pub(crate) struct Queue {
    heap: BinaryHeap<Entry>,
    edges: HashMap<[u32; 2], EdgeState, FixedState>,
    /// Ranks are of resolutions times this length.
    radius: f64,
    /// How often the surroundings of each vertex have changed.
    changes: Vec<u32>,
}

fn ordered([a, b]: [u32; 2]) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

/// Resolution of an edge, if it can be collapsed topologically; else that of an edge seen face on.
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
    /// With all edges of a mesh; `radius` is that of the object.
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

    /// Resolutions are positive, so that their bits are in their order; the first ones matter.
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

    /// After a collapse: the edges of the vertex that is gone go, those of the merged one are computed again, and those
    /// around it that were invalid are tried again.
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
