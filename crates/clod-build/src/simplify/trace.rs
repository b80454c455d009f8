//! What a level owes to the finer ones: the tree of its patches, and how far they deviate from the original mesh.
//!
//! Departing from §3.3.3, where the parent of a hull is the hull that it was merged into: patches drift as edges
//! collapse, and one whose last triangle goes was merged into none. The parent is the hull of the coarser level to
//! which the hull has the least directed Hausdorff distance, since h is what culling pays (Eq. 3.5). Each hull is the
//! parent of one at least.
//!
//! The loop needs nothing of it. So the levels are traced one after the other in the background, on a thread that the
//! loop leaves idle.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use glam::DVec3;
use rayon::Scope;
use rayon::prelude::*;

use super::level::SimplifiedLevel;
use crate::bounding::Target;
use crate::box_tree::BoxTree;
use crate::decomposition::{Decomposition, NO_PATCH};
use crate::deviation::surface_deviations;
use crate::hull::HullBuilder;
use crate::nearest::NearestSearch;
use crate::surface::{GRAIN, Surface, bounds_of};

/// What is known of a level's patches from the finer levels.
#[derive(Debug)]
pub(crate) struct Trace {
    /// Which of its patches each patch of the next finer level is a child of.
    pub parent_of: Vec<u32>,
    /// s of each patch, in unit coordinates.
    pub deviations: Vec<f64>,
}

/// Traces levels in the order in which they come.
pub(crate) struct Tracer<'a> {
    waiting: Mutex<Waiting>,
    done: Mutex<Done<'a>>,
}

struct Waiting {
    levels: VecDeque<(Arc<SimplifiedLevel>, Option<Vec<u32>>)>,
    /// Whether a task is at work, which will see to all that wait.
    at_work: bool,
}

struct Done<'a> {
    finest: (&'a Surface, &'a Decomposition),
    grain: f64,
    /// The extreme points of the last level's hulls.
    hulls: Vec<Vec<DVec3>>,
    /// For each patch of the finest level its ancestor among them.
    place: Vec<u32>,
    traces: Vec<Trace>,
}

impl<'a> Tracer<'a> {
    /// From the finest level; `radius` is that of the object, in unit coordinates.
    pub fn new(surface: &'a Surface, decomposition: &'a Decomposition, radius: f64) -> Self {
        let done = Done {
            finest: (surface, decomposition),
            grain: GRAIN * radius,
            hulls: hulls(surface, decomposition),
            place: (0..decomposition.patches.len() as u32).collect(),
            traces: Vec::new(),
        };
        let waiting = Waiting { levels: VecDeque::new(), at_work: false };
        Self { waiting: Mutex::new(waiting), done: Mutex::new(done) }
    }

    /// Traces one more level in the background. `heirs` are the patches that those of the level before went into, where
    /// that is known.
    pub fn add<'s>(&'s self, scope: &Scope<'s>, level: Arc<SimplifiedLevel>, heirs: Option<Vec<u32>>)
    where
        'a: 's,
    {
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        waiting.levels.push_back((level, heirs));
        if !std::mem::replace(&mut waiting.at_work, true) {
            scope.spawn(|_| self.work());
        }
    }

    fn work(&self) {
        loop {
            let next = {
                let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
                let next = waiting.levels.pop_front();
                waiting.at_work = next.is_some();
                next
            };
            let Some((level, heirs)) = next else { return };
            self.done.lock().unwrap_or_else(PoisonError::into_inner).trace(&level, heirs);
        }
    }

    /// The traces, once the scope has ended.
    pub fn finish(self) -> Vec<Trace> {
        self.done.into_inner().unwrap_or_else(PoisonError::into_inner).traces
    }
}

impl Done<'_> {
    fn trace(&mut self, level: &SimplifiedLevel, heirs: Option<Vec<u32>>) {
        let SimplifiedLevel { surface, decomposition, resolution, .. } = level;
        let hulls = hulls(surface, decomposition);
        let heirs = heirs.unwrap_or_else(|| self.nearest_patches(level));
        let parent_of = nearest_parents(&self.hulls, &hulls, &heirs, self.grain);
        self.place.iter_mut().for_each(|p| *p = parent_of[*p as usize]);
        let patches: Vec<Vec<u32>> = decomposition.patches.iter().map(|p| p.triangles.clone()).collect();
        let mut origins: Vec<Vec<u32>> = vec![Vec::new(); patches.len()];
        let (finest, first) = self.finest;
        // In the order of the tree, so that triangles that are near each other follow each other.
        for t in &finest.tree().order {
            let patch = first.patch_of[*t as usize];
            if patch != NO_PATCH {
                origins[self.place[patch as usize] as usize].push(*t);
            }
        }
        let deviations = surface_deviations(finest, &origins, surface, &patches, 1.0 / resolution);
        self.hulls = hulls;
        self.traces.push(Trace { parent_of, deviations });
    }

    /// For each hull of the level before the patch that is nearest to its middle.
    fn nearest_patches(&self, level: &SimplifiedLevel) -> Vec<u32> {
        let SimplifiedLevel { surface, decomposition, .. } = level;
        let middle = |points: &Vec<DVec3>| points.iter().sum::<DVec3>() / points.len() as f64;
        self.hulls
            .par_iter()
            .map_init(
                || NearestSearch::new(surface),
                |search, points| decomposition.patch_of[search.nearest(middle(points), 0).0 as usize],
            )
            .collect()
    }
}

/// The extreme points of each patch's hull.
fn hulls(surface: &Surface, decomposition: &Decomposition) -> Vec<Vec<DVec3>> {
    let point = |v: &u32| surface.points[*v as usize];
    decomposition.patches.iter().map(|patch| patch.extreme.iter().map(point).collect()).collect()
}

/// For each hull (given by its points) the one among `coarser` to which it has the least directed Hausdorff distance;
/// of equal ones, to within half a `grain`, that which `heirs` names, or the first. Then each of `coarser` that has got
/// none takes the nearest that is not an only child.
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
