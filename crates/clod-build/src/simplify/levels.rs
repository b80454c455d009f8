//! The levels that simplification puts out.

use std::sync::Arc;

use rayon::Scope;

use super::level::SimplifiedLevel;
use super::state::{Snapshot, State};
use super::trace::Tracer;
use crate::convexity::Patch;
use crate::decomposition::{Decomposition, NO_PATCH};

/// Collects them, and has them traced meanwhile.
pub(crate) struct Levels<'r, 's, 'a> {
    levels: Vec<Arc<SimplifiedLevel>>,
    /// For each patch of the last level, the patch of the first one that it was made of and is named by in the state.
    names: Vec<u32>,
    tracer: &'s Tracer<'a>,
    scope: &'r Scope<'s>,
}

impl<'r, 's, 'a: 's> Levels<'r, 's, 'a> {
    /// Before any; the first level has this number of patches.
    pub fn new(patches: usize, tracer: &'s Tracer<'a>, scope: &'r Scope<'s>) -> Self {
        Self { levels: Vec::new(), names: (0..patches as u32).collect(), tracer, scope }
    }

    /// How many patches the last level has.
    pub fn patches(&self) -> usize {
        self.names.len()
    }

    /// The last one put out.
    pub fn last(&self) -> Option<&SimplifiedLevel> {
        self.levels.last().map(|level| &**level)
    }

    /// Puts out a level as things are.
    pub fn put_out(&mut self, state: &mut State, resolution: f64) {
        let snapshot = state.snapshot();
        let Snapshot { triangle_of, vertex_of, .. } = &snapshot;
        let mut names = Vec::new();
        let mut place = vec![NO_PATCH; state.members.len()];
        let mut patches: Vec<Patch> = Vec::new();
        for (name, member) in (0u32..).zip(&state.members) {
            let Some(member) = member else { continue };
            let mut patch = member.patch.clone();
            patch.triangles.iter_mut().for_each(|t| *t = triangle_of[*t as usize]);
            patch.triangles.sort_unstable();
            patch.extreme.iter_mut().for_each(|v| *v = vertex_of[*v as usize]);
            patch.lead = triangle_of[patch.lead as usize];
            place[name as usize] = patches.len() as u32;
            names.push(name);
            patches.push(patch);
        }
        let mut patch_of = vec![NO_PATCH; snapshot.mesh.triangles().len()];
        for (k, patch) in patches.iter().enumerate() {
            for t in &patch.triangles {
                patch_of[*t as usize] = k as u32;
            }
        }
        let heirs = self.names.iter().map(|name| {
            let mut here = *name;
            while state.went_into[here as usize] != here {
                here = state.went_into[here as usize];
            }
            place[here as usize]
        });
        let heirs: Vec<u32> = heirs.collect();
        self.push(snapshot, Decomposition { patches, patch_of }, resolution, Some(heirs));
        self.names = names;
    }

    /// Puts out a level. `heirs` are the patches that those of the level before went into, where that is known.
    pub fn push(
        &mut self,
        snapshot: Snapshot,
        decomposition: Decomposition,
        resolution: f64,
        heirs: Option<Vec<u32>>,
    ) {
        let Snapshot { mesh, surface, areas, .. } = snapshot;
        self.names = (0..decomposition.patches.len() as u32).collect();
        let level = Arc::new(SimplifiedLevel { mesh, surface, decomposition, areas, resolution });
        self.tracer.add(self.scope, Arc::clone(&level), heirs);
        self.levels.push(level);
    }

    /// All of them.
    pub fn finish(self) -> Vec<Arc<SimplifiedLevel>> {
        self.levels
    }
}
