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
mod queue;
mod relax;
mod star;
mod state;

use palpate_core::TriMesh;

use crate::convexity::Convexity;
use crate::decomposition::{Decomposition, decompose};
use crate::progress::{Cancelled, Progress};
use crate::surface::Surface;
use filter::Path;
use levels::Levels;
pub(crate) use levels::{GRAIN, SimplifiedLevel};
use queue::Queue;
use star::Star;
use state::State;

/// K: steps of the bisection for a valid position (§3.3.4).
const BISECTIONS: usize = 3;

/// The last level is put out if its patches are fewer than those of the level before by this part of them.
const NOTICEABLE: f64 = 0.1;

/// Where patches are made anew for each level, that is tried each time this part of the triangles is left.
const RENEWED_FROM: f64 = 0.85;

/// What bounds a simplification.
pub(crate) struct Limits {
    /// Heights up to this count as convex, in unit coordinates.
    pub tolerance: f64,
    /// Radius of the object's bounding sphere, in unit coordinates.
    pub radius: f64,
    /// Edges of a lower resolution are left alone; in the inverse of the radius.
    pub coarsest: f64,
    /// Whether patches are carried through collapses as long as those allow it; else they are made anew for each level.
    pub carried: bool,
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
    let mut levels = Levels::new(surface, decomposition, limits.radius);
    let mut simplification = Simplification::new(mesh, surface, decomposition, areas, limits);
    if limits.carried {
        simplification.carry_patches(&mut levels, progress)?;
    }
    if levels.patches() > 1 {
        if let Some(last) = levels.last() {
            let decomposition = single_triangles(&last.surface);
            simplification =
                Simplification::new(&last.mesh, &last.surface, &decomposition, &last.areas, limits);
        } else {
            simplification = Simplification::new(mesh, surface, &single_triangles(surface), areas, limits);
        }
        simplification.renew_patches(&mut levels, progress)?;
    }
    Ok(levels.finish())
}

/// Each triangle as a patch of its own, which constrains nothing.
fn single_triangles(surface: &Surface) -> Decomposition {
    let convexity = Convexity::with_planes(surface, &surface.planes, 0.0);
    let count = surface.triangles.len() as u32;
    Decomposition {
        patches: (0..count).map(|t| convexity.single(t)).collect(),
        patch_of: (0..count).collect(),
    }
}

/// A mesh with its edges in the order of their collapse.
struct Simplification<'a> {
    state: State,
    queue: Queue,
    limits: &'a Limits,
    /// The lowest resolution of the edges collapsed so far.
    lowest: f64,
    triangles: usize,
    star: Star,
    steps: u32,
}

impl<'a> Simplification<'a> {
    fn new(
        mesh: &TriMesh,
        surface: &Surface,
        decomposition: &Decomposition,
        areas: &[f64],
        limits: &'a Limits,
    ) -> Self {
        let adjacency = mesh.adjacency();
        let state = State::new(
            surface.clone(),
            mesh.vertices().to_vec(),
            adjacency.neighbours(),
            decomposition,
            areas.to_vec(),
            limits.tolerance,
        );
        Self {
            queue: Queue::new(&state, &adjacency, limits.radius),
            limits,
            lowest: f64::INFINITY,
            triangles: state.triangles,
            star: Star::default(),
            steps: 0,
            state,
        }
    }

    /// Collapses the next edge that can be; tells the patches that it has changed. `None` once none is left whose resolution is high enough.
    fn collapse_next(&mut self, progress: &mut Progress<'_>) -> Result<Option<Vec<u32>>, Cancelled> {
        while let Some((ends, resolution)) = self.queue.pop(&self.state)
            && resolution * self.limits.radius >= self.limits.coarsest
        {
            if self.steps.is_multiple_of(256) {
                progress.at(1.0 - (self.state.triangles as f64 / self.triangles as f64).sqrt())?;
            }
            self.steps = self.steps.wrapping_add(1);
            if let Some(changed) = collapse(&mut self.state, ends, &mut self.star) {
                self.lowest = self.lowest.min(resolution);
                self.queue.collapsed(&self.state, &self.star);
                return Ok(Some(changed));
            }
            self.queue.invalidate(ends);
        }
        Ok(None)
    }

    /// Algorithm 3.3.1: the patches are kept convex, and joined.
    fn carry_patches(&mut self, levels: &mut Levels, progress: &mut Progress<'_>) -> Result<(), Cancelled> {
        while self.state.patches > 1
            && let Some(changed) = self.collapse_next(progress)?
        {
            let around: Vec<u32> = self.star.fan.iter().map(|s| s.triangle).collect();
            self.state.join_around(changed, &around);
            if 2 * self.state.patches <= levels.patches() {
                levels.put_out(&mut self.state, self.lowest);
            }
        }
        if is_noticeable(self.state.patches, levels) {
            levels.put_out(&mut self.state, self.lowest);
        }
        Ok(())
    }

    /// The patches are no constraint: they are made anew for each level.
    fn renew_patches(&mut self, levels: &mut Levels, progress: &mut Progress<'_>) -> Result<(), Cancelled> {
        let mut next = self.state.triangles;
        loop {
            let more = self.collapse_next(progress)?.is_some();
            if more && self.state.triangles > next {
                continue;
            }
            next = (RENEWED_FROM * self.state.triangles as f64) as usize;
            let snapshot = self.state.snapshot();
            let adjacency = snapshot.mesh.adjacency();
            let decomposition =
                decompose(&snapshot.surface, &adjacency, self.limits.tolerance, &mut progress.muted())?;
            let patches = decomposition.patches.len();
            if 2 * patches <= levels.patches() || !more && is_noticeable(patches, levels) {
                levels.push(snapshot, decomposition, self.lowest, None);
            }
            if !more || patches == 1 {
                return Ok(());
            }
        }
    }
}

/// Whether so few patches make a last level worth while.
fn is_noticeable(patches: usize, levels: &Levels) -> bool {
    patches as f64 <= (1.0 - NOTICEABLE) * levels.patches() as f64
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
