//! Puts the levels together: those of the mesh and its simplifications, with their parameters (§3.3.5), and the free ones
//! above them.

use palpate_core::clod::Source;
use palpate_core::{Clod, TriMesh};

use crate::containment::{all_real, contained};
use crate::decomposition::{Decomposition, NO_PATCH};
use crate::deviation::surface_deviations;
use crate::hierarchy::{Cluster, leaves};
use crate::layout::{LevelParts, PatchParts, lay_out};
use crate::simplify::SimplifiedLevel;
use crate::surface::Surface;

/// A level that is not free.
pub(crate) struct Regular<'a> {
    pub mesh: &'a TriMesh,
    /// The mesh in unit coordinates.
    pub surface: &'a Surface,
    pub decomposition: &'a Decomposition,
    /// D of the mesh's vertices, m².
    pub areas: &'a [f64],
    /// Which of its patches each patch of the next finer level went into; `None` for the finest.
    pub parent_of: Option<&'a [u32]>,
}

impl<'a> From<&'a SimplifiedLevel> for Regular<'a> {
    fn from(level: &'a SimplifiedLevel) -> Self {
        Self {
            mesh: &level.mesh,
            surface: &level.surface,
            decomposition: &level.decomposition,
            areas: &level.areas,
            parent_of: Some(&level.parent_of),
        }
    }
}

/// The hierarchy of levels with their resolutions (1/m), finest first, and of the free levels above the last of them (of which
/// the first stands for that last level itself). Hausdorff distances are left at 0.
pub(crate) fn assemble(
    regular: &[(Regular<'_>, f64)],
    free: &[Vec<Cluster>],
    source: Source,
    tolerance: f64,
) -> Clod {
    let finest = &regular[0].0;
    // Per patch of the finest level, where it is on the level at hand.
    let mut place: Vec<u32> = (0..finest.decomposition.patches.len() as u32).collect();
    let mut clusters: Vec<Vec<Cluster>> = Vec::new();
    let mut patches: Vec<PatchParts<'_>> = Vec::new();
    for (level, resolution) in regular {
        let Regular { mesh, surface, decomposition, parent_of, .. } = level;
        let mut own = leaves(&surface.points, decomposition);
        let mut deviations = vec![0.0; own.len()];
        if let Some(parent_of) = parent_of {
            for (child, parent) in (0u32..).zip(*parent_of) {
                own[*parent as usize].children.push(child);
            }
            place.iter_mut().for_each(|p| *p = parent_of[*p as usize]);
            deviations = deviations_of(level, *resolution, finest, &place);
        }
        clusters.push(own);
        patches.push(PatchParts {
            decomposition,
            contained: contained(surface, decomposition, source.solid, tolerance),
            all_real: all_real(decomposition, &mesh.adjacency()),
            deviations,
        });
    }
    let mut parts: Vec<LevelParts<'_>> = regular
        .iter()
        .zip(&clusters)
        .zip(patches)
        .map(|(((level, resolution), clusters), patches)| LevelParts {
            mesh: level.mesh,
            clusters,
            support_areas: level.areas,
            resolution: *resolution,
            patches: Some(patches),
        })
        .collect();
    if let Some((coarsest, resolution)) = regular.last() {
        parts.extend(free[1..].iter().map(|clusters| LevelParts {
            mesh: coarsest.mesh,
            clusters,
            support_areas: coarsest.areas,
            resolution: *resolution,
            patches: None,
        }));
    }
    lay_out(&parts, source, finest.surface.scale, finest.surface.center)
}

/// s of the patches, m, of a level of a resolution (1/m).
fn deviations_of(level: &Regular<'_>, resolution: f64, finest: &Regular<'_>, place: &[u32]) -> Vec<f64> {
    let patches: Vec<Vec<u32>> = level.decomposition.patches.iter().map(|p| p.triangles.clone()).collect();
    let mut origins: Vec<Vec<u32>> = vec![Vec::new(); patches.len()];
    // In the order of the tree, so that triangles that are near each other follow each other.
    for t in &finest.surface.tree().order {
        let patch = finest.decomposition.patch_of[*t as usize];
        if patch != NO_PATCH {
            origins[place[patch as usize] as usize].push(*t);
        }
    }
    let spacing = finest.surface.scale / resolution;
    let mut deviations = surface_deviations(finest.surface, &origins, level.surface, &patches, spacing);
    deviations.iter_mut().for_each(|s| *s /= finest.surface.scale);
    deviations
}
