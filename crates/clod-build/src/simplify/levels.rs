//! The levels that simplification puts out.

use palpate_core::TriMesh;

use super::state::State;
use crate::convexity::Patch;
use crate::decomposition::{Decomposition, NO_PATCH};
use crate::surface::Surface;

/// A level of detail with its patches.
#[derive(Debug)]
pub(crate) struct SimplifiedLevel {
    /// Its mesh, m.
    pub mesh: TriMesh,
    /// The same in unit coordinates.
    pub surface: Surface,
    /// Its convex patches.
    pub decomposition: Decomposition,
    /// D of its vertices, m².
    pub areas: Vec<f64>,
    /// r, in the inverse of the unit of unit coordinates.
    pub resolution: f64,
    /// Which of its patches each patch of the next finer level went into.
    pub parent_of: Vec<u32>,
}

/// Collects them.
pub(crate) struct Levels {
    levels: Vec<SimplifiedLevel>,
    /// For each patch of the last level, the patch of the first one that it was made of and is named by in the state.
    names: Vec<u32>,
    scale: f64,
    center: glam::DVec3,
}

impl Levels {
    /// Before any; the surface's patches are the first level's.
    pub fn new(surface: &Surface, decomposition: &Decomposition) -> Self {
        Self {
            levels: Vec::new(),
            names: (0..decomposition.patches.len() as u32).collect(),
            scale: surface.scale,
            center: surface.center,
        }
    }

    /// How many patches the last level has.
    pub fn patches(&self) -> usize {
        self.names.len()
    }

    /// Puts out a level as things are.
    pub fn put_out(&mut self, state: &mut State, resolution: f64) {
        let mut vertex = vec![u32::MAX; state.surface.points.len()];
        let mut points = Vec::new();
        let mut metres = Vec::new();
        let mut areas = Vec::new();
        let mut triangles = Vec::with_capacity(state.triangles);
        let mut triangle = vec![u32::MAX; state.surface.triangles.len()];
        for (t, corners) in state.surface.triangles.iter().enumerate() {
            if state.patch_of[t] == NO_PATCH {
                continue;
            }
            triangle[t] = triangles.len() as u32;
            triangles.push(corners.map(|v| {
                let slot = &mut vertex[v as usize];
                if *slot == u32::MAX {
                    *slot = points.len() as u32;
                    points.push(state.surface.points[v as usize]);
                    metres.push(state.metres[v as usize]);
                    areas.push(state.areas[v as usize]);
                }
                *slot
            }));
        }
        let mut names = Vec::new();
        let mut place = vec![NO_PATCH; state.members.len()];
        let mut patches: Vec<Patch> = Vec::new();
        for (name, member) in (0u32..).zip(&state.members) {
            let Some(member) = member else { continue };
            let mut patch = member.patch.clone();
            patch.triangles.iter_mut().for_each(|t| *t = triangle[*t as usize]);
            patch.triangles.sort_unstable();
            patch.extreme.iter_mut().for_each(|v| *v = vertex[*v as usize]);
            patch.lead = triangle[patch.lead as usize];
            place[name as usize] = patches.len() as u32;
            names.push(name);
            patches.push(patch);
        }
        let mut patch_of = vec![NO_PATCH; triangles.len()];
        for (k, patch) in patches.iter().enumerate() {
            for t in &patch.triangles {
                patch_of[*t as usize] = k as u32;
            }
        }
        let parent_of = self
            .names
            .iter()
            .map(|name| {
                let mut here = *name;
                while state.went_into[here as usize] != here {
                    here = state.went_into[here as usize];
                }
                place[here as usize]
            })
            .collect();
        let surface = Surface::from_parts(points, triangles.clone(), self.scale, self.center);
        let Ok(mesh) = TriMesh::new(metres, triangles) else { return };
        self.levels.push(SimplifiedLevel {
            mesh,
            surface,
            decomposition: Decomposition { patches, patch_of },
            areas,
            resolution,
            parent_of,
        });
        self.names = names;
    }

    /// All of them.
    pub fn finish(self) -> Vec<SimplifiedLevel> {
        self.levels
    }
}
