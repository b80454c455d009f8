//! Sensation preserving simplification (§3.3): the levels of detail of a mesh and of its convex patches.
//!
//! The loop of Algorithm 3.3.1: the edge of the highest resolution is collapsed and filtered, the patches around it are joined
//! where their union is a convex patch, and a level is put out each time that the number of patches has halved.
//!
//! Departures. The queue is lazy: when a collapse changes the surroundings of an edge, its resolution is computed again only
//! when it comes up (at once for the edges of the merged vertex). A last level is put out when no edge is left, if it has
//! noticeably fewer patches than the one before, since all of the work that went into it would otherwise be lost. Where the
//! position v̂ is not feasible itself, the search starts from the last feasible position on the way to it. Where none is
//! valid on the way from v̂ to ṽ, the ways from the middle of the edge and from its ends are tried: the surface of a
//! lathe or an extrusion, whose patches have flat quadrilaterals inside, leaves the vertex hardly any other place (a cup of
//! 20,000 triangles comes down to 144 of them instead of 9,054). The hull that a hull's parent in the tree is chosen to be
//! near to is explained with the levels.

mod filter;
pub(crate) mod intersect;
mod levels;
mod member;
mod quadric;
mod relax;
mod star;
mod state;

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

use palpate_core::TriMesh;
use palpate_core::mesh::Adjacency;
use rayon::prelude::*;

use crate::decomposition::Decomposition;
use crate::progress::{Cancelled, Progress};
use crate::surface::Surface;
use filter::Path;
use levels::Levels;
pub(crate) use levels::SimplifiedLevel;
use star::Star;
use state::State;

/// K: steps of the bisection for a valid position (§3.3.4).
const BISECTIONS: usize = 3;

/// The last level is put out if its patches are fewer than those of the level before by this part of them.
const NOTICEABLE: f64 = 0.1;

/// An edge in the queue: highest resolution first, then the lowest vertices.
type Entry = (u64, Reverse<[u32; 2]>, u32);

/// What is known of an edge that is not only in the queue as it was put there.
#[derive(Clone, Copy, Debug, Default)]
struct EdgeState {
    /// Of the entry that counts; earlier ones are passed over.
    stamp: u32,
    /// Whether it could not be collapsed as things are, so that it is not in the queue.
    invalid: bool,
    /// Its resolution, when it was last computed, as bits.
    resolution: u64,
    /// The sum of its ends' changes at that time.
    changes: u32,
}

/// What bounds a simplification.
pub(crate) struct Limits {
    /// Heights up to this count as convex, in unit coordinates.
    pub tolerance: f64,
    /// Edges of a lower resolution are left alone; in the inverse of the unit of unit coordinates.
    pub least_resolution: f64,
}

/// Simplifies a mesh that is 2-manifold and oriented. `surface` is the same in unit coordinates, `areas` are the support
/// areas of its vertices; the levels come out finest first, without the mesh itself.
pub(crate) fn simplify(
    mesh: &TriMesh,
    surface: &Surface,
    decomposition: &Decomposition,
    areas: &[f64],
    limits: &Limits,
    progress: &mut Progress<'_>,
) -> Result<Vec<SimplifiedLevel>, Cancelled> {
    let mut queue =
        Queue { heap: BinaryHeap::new(), edges: HashMap::new(), changes: vec![0; surface.points.len()] };
    let mut levels = Levels::new(surface, decomposition);
    let adjacency = mesh.adjacency();
    let mut state = State::new(
        surface.clone(),
        mesh.vertices().to_vec(),
        adjacency.neighbours(),
        decomposition,
        areas.to_vec(),
        limits.tolerance,
    );
    queue.fill(&state, &adjacency);

    let all = state.triangles as f64;
    let (mut lowest, mut steps) = (f64::INFINITY, 0u32);
    let mut star = Star::default();
    while state.patches > 1
        && let Some((ends, resolution)) = queue.pop(&state)
        && resolution >= limits.least_resolution
    {
        if steps.is_multiple_of(256) {
            progress.at(1.0 - (state.triangles as f64 / all).sqrt())?;
        }
        steps = steps.wrapping_add(1);
        let Some(changed) = collapse(&mut state, ends, &mut star) else {
            queue.invalidate(ends);
            continue;
        };
        lowest = lowest.min(resolution);
        queue.collapsed(&state, &star);
        let around: Vec<u32> = star.fan.iter().map(|s| s.triangle).collect();
        state.join_around(changed, &around);
        if 2 * state.patches <= levels.patches() {
            levels.put_out(&mut state, lowest);
        }
    }
    if (state.patches as f64) <= (1.0 - NOTICEABLE) * levels.patches() as f64 {
        levels.put_out(&mut state, lowest);
    }
    Ok(levels.finish())
}

/// The filtered edge collapse (§3.3.4). Tells the patches that it has changed, if there is a position that is valid.
fn collapse(state: &mut State, ends: [u32; 2], star: &mut Star) -> Option<Vec<u32>> {
    if !state.fans.star(&state.surface.triangles, ends, star) {
        return None;
    }
    let near = state.neighbourhood();
    let path = near.path(star, &state.quadric(ends));
    let filtered = path.filtered;
    let [p, q] = ends.map(|v| state.surface.points[v as usize]);
    // On the border only the quadrics know of its shape.
    let starts = if star.border { 1 } else { 4 };
    [path.least, 0.5 * (p + q), p, q]
        .into_iter()
        .take(starts)
        .find_map(|least| along(state, star, &Path { least, filtered }))
}

/// Collapses to the position nearest to the filtered one that is valid, among those tried on a path.
fn along(state: &mut State, star: &Star, path: &Path) -> Option<Vec<u32>> {
    let (low, high) = state.neighbourhood().feasible(star, path, &state.patch_of, state.tolerance())?;
    // u of the best valid position and of an invalid one that is nearer to the goal; the last one tried.
    let (mut good, mut bad, mut last, mut steps) = (high, low, low, 0);
    state.collapse(star, |valid| {
        let next = match valid {
            None => Some(low),
            Some(true) if last == low => None,
            Some(false) if last == low && high > low => Some(high),
            Some(false) if last == low || last == high => None,
            Some(valid) => {
                *(if valid { &mut good } else { &mut bad }) = last;
                (steps < BISECTIONS).then(|| {
                    steps += 1;
                    0.5 * (good + bad)
                })
            }
        };
        last = next.unwrap_or(last);
        next.map(|u| path.at(u))
    })
}

/// The edges by resolution, with the changes of their surroundings.
struct Queue {
    heap: BinaryHeap<Entry>,
    edges: HashMap<[u32; 2], EdgeState>,
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
    fn fill(&mut self, state: &State, adjacency: &Adjacency) {
        let entries: Vec<([u32; 2], f64)> = adjacency
            .edges()
            .par_iter()
            .map_init(Star::default, |star, edge| (*edge, resolution(state, *edge, star)))
            .collect();
        for (edge, resolution) in entries {
            self.push(edge, resolution.to_bits());
        }
    }

    /// Resolutions are positive, so that their bits are in their order.
    fn push(&mut self, edge: [u32; 2], resolution: u64) {
        let changes = self.changes_of(edge);
        let known = self.edges.entry(edge).or_default();
        *known = EdgeState { stamp: known.stamp + 1, invalid: false, resolution, changes };
        self.heap.push((resolution, Reverse(edge), known.stamp));
    }

    fn changes_of(&self, [a, b]: [u32; 2]) -> u32 {
        self.changes[a as usize].wrapping_add(self.changes[b as usize])
    }

    /// The edge to be tried next, with its resolution.
    fn pop(&mut self, state: &State) -> Option<([u32; 2], f64)> {
        let mut star = Star::default();
        while let Some((bits, Reverse(edge), stamp)) = self.heap.pop() {
            let Some(known) = self.edges.get(&edge) else { continue };
            if known.stamp != stamp || known.invalid {
                continue;
            }
            if known.changes != self.changes_of(edge) {
                let now = resolution(state, edge, &mut star).to_bits();
                if now < bits {
                    self.push(edge, now);
                    continue;
                }
            }
            return Some((edge, f64::from_bits(bits)));
        }
        None
    }

    fn invalidate(&mut self, edge: [u32; 2]) {
        let changes = self.changes_of(edge);
        if let Some(known) = self.edges.get_mut(&edge) {
            (known.invalid, known.changes) = (true, changes);
        }
    }

    /// After a collapse: the edges of the vertex that is gone go, those of the merged one are computed again, and those
    /// around it that were invalid are tried again.
    fn collapsed(&mut self, state: &State, star: &Star) {
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
            self.push(edge, resolution(state, edge, &mut own).to_bits());
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
