//! The levels that simplification puts out.
//!
//! Departing from §3.3.3, where the parent of a hull is the hull that it was merged into: patches drift as edges collapse, and
//! one whose last triangle goes was merged into none. The parent is the hull of the coarser level to which the hull has the
//! least directed Hausdorff distance, since h is what culling pays (Eq. 3.5). Each hull is the parent of one at least.

use glam::DVec3;
use palpate_core::TriMesh;
use rayon::prelude::*;

use super::state::{Snapshot, State};
use crate::bounding::Target;
use crate::box_tree::BoxTree;
use crate::convexity::Patch;
use crate::decomposition::{Decomposition, NO_PATCH};
use crate::hull::HullBuilder;
use crate::nearest::NearestSearch;
use crate::surface::{Surface, bounds_of};

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

/// Distances that differ by less than this part of the radius count as equal, so that rounding decides nothing.
pub(crate) const GRAIN: f64 = 1e-7;

/// Collects them.
pub(crate) struct Levels {
    grain: f64,
    levels: Vec<SimplifiedLevel>,
    /// For each patch of the last level, the patch of the first one that it was made of and is named by in the state.
    names: Vec<u32>,
    /// The extreme points of its patches' hulls.
    hulls: Vec<Vec<DVec3>>,
}

impl Levels {
    /// Before any; the surface's patches are the first level's. `radius` is that of the object, in unit coordinates.
    pub fn new(surface: &Surface, decomposition: &Decomposition, radius: f64) -> Self {
        Self {
            grain: GRAIN * radius,
            levels: Vec::new(),
            hulls: decomposition
                .patches
                .iter()
                .map(|patch| patch.extreme.iter().map(|v| surface.points[*v as usize]).collect())
                .collect(),
            names: (0..decomposition.patches.len() as u32).collect(),
        }
    }

    /// How many patches the last level has.
    pub fn patches(&self) -> usize {
        self.names.len()
    }

    /// The last one put out.
    pub fn last(&self) -> Option<&SimplifiedLevel> {
        self.levels.last()
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
        self.push(snapshot, Decomposition { patches, patch_of }, resolution, Some(&heirs));
        self.names = names;
    }

    /// Puts out a level. `heirs` are the patches that those of the level before went into, where that is known.
    pub fn push(
        &mut self,
        snapshot: Snapshot,
        decomposition: Decomposition,
        resolution: f64,
        heirs: Option<&[u32]>,
    ) {
        let Snapshot { mesh, surface, areas, .. } = snapshot;
        let hulls: Vec<Vec<DVec3>> = decomposition
            .patches
            .iter()
            .map(|patch| patch.extreme.iter().map(|v| surface.points[*v as usize]).collect())
            .collect();
        let nearest: Vec<u32>;
        let heirs = match heirs {
            Some(heirs) => heirs,
            None => {
                let middle = |points: &Vec<DVec3>| points.iter().sum::<DVec3>() / points.len() as f64;
                nearest = self
                    .hulls
                    .par_iter()
                    .map_init(
                        || NearestSearch::new(&surface),
                        |search, points| decomposition.patch_of[search.nearest(middle(points), 0).0 as usize],
                    )
                    .collect();
                &nearest
            }
        };
        let parent_of = nearest_parents(&self.hulls, &hulls, heirs, self.grain);
        self.names = (0..hulls.len() as u32).collect();
        self.hulls = hulls;
        self.levels.push(SimplifiedLevel { mesh, surface, decomposition, areas, resolution, parent_of });
    }

    /// All of them.
    pub fn finish(self) -> Vec<SimplifiedLevel> {
        self.levels
    }
}

/// For each hull (given by its points) the one among `coarser` to which it has the least directed Hausdorff distance; of
/// equal ones, to within half a `grain`, that which `heirs` names, or the first. Then each of `coarser` that has got none takes the nearest that is
/// not an only child.
fn nearest_parents(finer: &[Vec<DVec3>], coarser: &[Vec<DVec3>], heirs: &[u32], grain: f64) -> Vec<u32> {
    let targets: Vec<Target> = coarser
        .par_iter()
        .map_init(HullBuilder::default, |builder, points| Target::new(points.clone(), builder))
        .collect();
    let boxes: Vec<_> = coarser.iter().map(|points| bounds_of(points)).collect();
    let tree = BoxTree::new(&boxes);
    let farthest = |points: &[DVec3], target: u32, limit: f64| {
        let mut most = 0.0f64;
        for p in points {
            most = most.max(grain * (targets[target as usize].distance(*p) / grain).round());
            if most > limit {
                break;
            }
        }
        most
    };
    let mut parents: Vec<(u32, f64)> = finer
        .par_iter()
        .zip(heirs)
        .map_init(Vec::new, |stack, (points, heir)| {
            let mut best = (*heir, farthest(points, *heir, f64::INFINITY));
            let (low, high) = bounds_of(points);
            let reach = DVec3::splat(best.1 + grain);
            tree.any_near((low - reach, high + reach), stack, |candidate| {
                let distance = farthest(points, candidate, best.1);
                if distance < best.1 || distance == best.1 && candidate < best.0 && best.0 != *heir {
                    best = (candidate, distance);
                }
                best.1 == 0.0 && best.0 == *heir
            });
            best
        })
        .collect();
    let mut children = vec![0u32; coarser.len()];
    parents.iter().for_each(|(parent, _)| children[*parent as usize] += 1);
    let mut heirs_of: Vec<Vec<u32>> = vec![Vec::new(); coarser.len()];
    for (child, heir) in (0u32..).zip(heirs) {
        heirs_of[*heir as usize].push(child);
    }
    let finer_boxes: Vec<_> = finer.iter().map(|points| bounds_of(points)).collect();
    let finer_tree = BoxTree::new(&finer_boxes);
    let mut stack = Vec::new();
    for lonely in 0..coarser.len() as u32 {
        if children[lonely as usize] > 0 {
            continue;
        }
        // From the nearest that was merged into it to any other that is nearer, of those that are not an only child.
        let mut best: Option<(f64, u32)> = None;
        let consider = |best: &mut Option<(f64, u32)>, child: u32| {
            if children[parents[child as usize].0 as usize] > 1 {
                let limit = best.map_or(f64::INFINITY, |b| b.0);
                let distance = farthest(&finer[child as usize], lonely, limit);
                if best.is_none_or(|b| (distance, child) < b) {
                    *best = Some((distance, child));
                }
            }
        };
        heirs_of[lonely as usize].iter().for_each(|child| consider(&mut best, *child));
        let (low, high) = boxes[lonely as usize];
        let reach = high.distance(low);
        finer_tree.any_near((low - reach, high + reach), &mut stack, |child| {
            consider(&mut best, child);
            false
        });
        if best.is_none() {
            (0..finer.len() as u32).for_each(|child| consider(&mut best, child));
        }
        if let Some((distance, child)) = best {
            children[parents[child as usize].0 as usize] -= 1;
            children[lonely as usize] = 1;
            parents[child as usize] = (lonely, distance);
        }
    }
    parents.into_iter().map(|(parent, _)| parent).collect()
}
