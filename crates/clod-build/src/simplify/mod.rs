//! Sensation preserving simplification (§3.3): the levels of detail of a mesh and of its convex patches.
//!
//! The parts of the generic construction (§3.2.3) are separate: the loop, here, knows of the atomic operation
//! only whether it collapsed an edge, and which patches that changed; the queue orders the edges; the
//! clusters are made by one of two functions, of which one carries convex patches through the collapses and
//! joins them (Algorithm 3.3.1), and the other decomposes each level anew; the levels put out are traced to
//! the finer ones in the background; and the bounding volumes are made from them in the end
//! (`crate::bounding`).
//!
//! Departures. A last level is put out when no edge is left, if it has noticeably fewer patches than the one
//! before, since all work on it would otherwise be lost. Then the simplification continues without regard to
//! patches, and decomposes each further level anew: fewer free levels are needed to complete the hierarchy
//! (§3.6.2).

mod collapse;
mod filter;
mod level;
mod levels;
mod limits;
mod member;
mod quadric;
mod queue;
mod relax;
mod star;
mod state;
mod trace;

use std::sync::Arc;

use palpate_core::TriMesh;

use crate::convexity::Convexity;
use crate::decomposition::{Decomposition, decompose};
use crate::progress::{Cancelled, Progress};
use crate::surface::Surface;
use collapse::collapse;
pub(crate) use level::SimplifiedLevel;
use levels::Levels;
pub(crate) use limits::Limits;
use queue::Queue;
use star::Star;
use state::State;
pub(crate) use trace::Trace;
use trace::Tracer;

/// Smallest reduction of the number of patches, as a fraction of that of the level before, at which a last
/// level is put out.
const MIN_REDUCTION: f64 = 0.1;

/// Fraction of the triangles that is left from one decomposition to the next, where each level is decomposed
/// anew. A larger one finds levels sooner, and takes longer.
const RENEWAL_RATIO: f64 = 0.85;

/// Simplifies a mesh that is 2-manifold and oriented. `surface` is the same in unit coordinates, `areas` are
/// the support areas of its vertices; the levels come out finest first, without the mesh itself.
pub(crate) fn simplify(
    mesh: &TriMesh,
    surface: &Surface,
    decomposition: &Decomposition,
    areas: &[f64],
    limits: &Limits,
    progress: &mut Progress<'_>,
) -> Result<Vec<(Arc<SimplifiedLevel>, Trace)>, Cancelled> {
    let tracer = Tracer::new(surface, decomposition, limits.radius);
    let levels = rayon::in_place_scope(|scope| {
        let mut levels = Levels::new(decomposition.patches.len(), &tracer, scope);
        let mut simplification = Simplification::new(mesh, surface, decomposition, areas, limits);
        if limits.carried {
            simplification.carry_patches(&mut levels, progress)?;
        }
        if levels.patches() > 1 {
            let (mesh, surface, areas) =
                levels.last().map_or((mesh, surface, areas), |l| (&l.mesh, &l.surface, &l.areas));
            let lowest = simplification.lowest;
            simplification = Simplification::new(mesh, surface, &single_triangles(surface), areas, limits);
            simplification.lowest = lowest;
            simplification.renew_patches(&mut levels, progress)?;
        }
        Ok(levels.finish())
    })?;
    Ok(levels.into_iter().zip(tracer.finish()).collect())
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
            limits,
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

    /// Collapses the next edge for which that is possible; returns the patches that changed. `None` once no
    /// edge of sufficient resolution is left.
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

    /// Simplifies by Algorithm 3.3.1: patches are kept convex, and joined.
    fn carry_patches(
        &mut self,
        levels: &mut Levels<'_, '_, '_>,
        progress: &mut Progress<'_>,
    ) -> Result<(), Cancelled> {
        while self.state.patches > 1
            && let Some(changed) = self.collapse_next(progress)?
        {
            let around: Vec<u32> = self.star.fan.iter().map(|s| s.triangle).collect();
            self.state.join_around(changed, &around);
            if 2 * self.state.patches <= levels.patches() {
                self.state.take_apart();
                if 2 * self.state.patches <= levels.patches() {
                    levels.put_out(&mut self.state, self.lowest);
                }
            }
        }
        self.state.take_apart();
        if is_noticeable(self.state.patches, levels) {
            levels.put_out(&mut self.state, self.lowest);
        }
        Ok(())
    }

    /// Simplifies without regard to patches: each level is decomposed anew.
    fn renew_patches(
        &mut self,
        levels: &mut Levels<'_, '_, '_>,
        progress: &mut Progress<'_>,
    ) -> Result<(), Cancelled> {
        let mut next = self.state.triangles;
        loop {
            let more = self.collapse_next(progress)?.is_some();
            if more && self.state.triangles > next {
                continue;
            }
            next = (RENEWAL_RATIO * self.state.triangles as f64) as usize;
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

/// Whether a level with this number of patches is worth putting out as the last.
fn is_noticeable(patches: usize, levels: &Levels<'_, '_, '_>) -> bool {
    patches as f64 <= (1.0 - MIN_REDUCTION) * levels.patches() as f64
}
