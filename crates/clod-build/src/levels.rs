//! Assembly of the levels: those of the mesh and its simplifications, with their parameters (§3.3.5), and the
//! free ones above them.

use palpate_core::TriMesh;
use palpate_core::clod::{Parts, Source};

use crate::containment::{all_real, contained};
use crate::decomposition::Decomposition;
use crate::hierarchy::{Cluster, leaves};
use crate::layout::{LevelParts, PatchParts, lay_out};
use crate::simplify::{SimplifiedLevel, Trace};
use crate::surface::Surface;

/// A level that is not free.
pub(crate) struct Regular<'a> {
    pub mesh: &'a TriMesh,
    /// The mesh in unit coordinates.
    pub surface: &'a Surface,
    pub decomposition: &'a Decomposition,
    /// D of the mesh's vertices, m².
    pub areas: &'a [f64],
    /// Parents and deviations of its patches, from the finer levels; `None` for the finest.
    pub trace: Option<&'a Trace>,
}

impl<'a> Regular<'a> {
    /// A level that simplification has put out.
    pub fn simplified(level: &'a SimplifiedLevel, trace: &'a Trace) -> Self {
        Self {
            mesh: &level.mesh,
            surface: &level.surface,
            decomposition: &level.decomposition,
            areas: &level.areas,
            trace: Some(trace),
        }
    }
}

/// Assembles the hierarchy from levels with their resolutions (1/m), finest first, and the free levels above
/// the last of them; the first entry of `free` stands for that last level itself. Hausdorff distances are
/// left at 0.
pub(crate) fn assemble(
    regular: &[(Regular<'_>, f64)],
    free: &[Vec<Cluster>],
    source: Source,
    tolerance: f64,
) -> Parts {
    let finest = &regular[0].0;
    let mut clusters: Vec<Vec<Cluster>> = Vec::new();
    let mut patches: Vec<PatchParts<'_>> = Vec::new();
    for (level, _) in regular {
        let Regular { mesh, surface, decomposition, trace, .. } = level;
        let mut own = leaves(&surface.points, decomposition);
        let mut deviations = vec![0.0; own.len()];
        if let Some(trace) = trace {
            for (child, parent) in (0u32..).zip(&trace.parent_of) {
                own[*parent as usize].children.push(child);
            }
            deviations = trace.deviations.iter().map(|s| s / finest.surface.scale).collect();
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
