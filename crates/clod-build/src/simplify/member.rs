//! A convex patch during simplification, and its change when an edge collapses.
//!
//! Only changes are tested, so that a collapse costs a few plane tests a vertex: the moved triangles have to
//! support the patch and the others the moved vertex; no surface may reach into the growth of its
//! [skin](Skin), and no moved triangle of another patch into the skin. If this does not decide whether the
//! patch remains convex, it is rebuilt, with its hull and all tests.

use glam::DVec3;

use super::star::Star;
use crate::box_tree::{Bounds, EMPTY};
use crate::convexity::{Convexity, HULL_THICKNESS, JoinBuffers, Patch};
use crate::hull::HullBuilder;
use crate::skin::Skin;
use crate::surface::{ReachBuffers, bounds_of, reaches_below};

/// A patch with its skin.
#[derive(Clone, Debug)]
pub(crate) struct Member {
    /// The patch. Once it has been [amended](Self::amend), its extreme points are all of its vertices, and
    /// its bounds may be too large.
    pub patch: Patch,
    pub skin: Skin,
    /// All vertices of its triangles, ascending.
    vertices: Vec<u32>,
    amended: bool,
}

/// The change of a patch in a collapse.
#[derive(Debug)]
pub(crate) enum Change {
    /// All of its triangles are removed.
    Gone,
    /// It is rebuilt.
    Anew(Member),
    /// It loses triangles, and vertices of it move.
    Amended {
        lead: u32,
        /// The skin and the bounds that it grows to, if it grows.
        grown: Option<(Skin, Bounds)>,
    },
}

/// A collapse that is tried; the merged vertex is at its new position.
pub(crate) struct Trial<'a> {
    pub convexity: &'a Convexity<'a>,
    pub star: &'a Star,
    pub patch_of: &'a [u32],
    /// The patch of triangles that are removed.
    pub gone: u32,
}

impl Trial<'_> {
    fn moved(&self, triangle: u32) -> bool {
        self.star.fan.iter().any(|s| s.triangle == triangle)
    }

    /// The change of a patch; `None` if it does not remain a convex patch.
    pub fn change(&self, index: u32, member: &Member, buffers: &mut JoinBuffers) -> Option<Change> {
        let Self { star, .. } = self;
        let lost = star.removed.iter().filter(|t| self.patch_of[**t as usize] == index).count();
        if lost == member.patch.triangles.len() {
            return Some(Change::Gone);
        }
        let mut part = None;
        if member.patch.triangles.len() > lost + 1 {
            match self.amendment(index, member, &mut buffers.reach) {
                Amendment::Decided(change) => return change,
                Amendment::TooWide(new) => part = Some(new),
                Amendment::Undecided => {}
            }
        }
        let left: Vec<u32> =
            member.patch.triangles.iter().copied().filter(|t| !star.removed.contains(t)).collect();
        let moved = (|t: u32| self.moved(t), star.ends[0]);
        let (patch, skin, vertices) = self.convexity.patch(
            &left,
            moved,
            |t| self.is_mine(index, t),
            self.others(index),
            part,
            buffers,
        )?;
        Some(Change::Anew(Member { patch, skin, vertices, amended: false }))
    }

    /// Whether a triangle of the spatial index belongs to the patch, has been removed, or has moved.
    fn is_mine(&self, index: u32, t: u32) -> bool {
        let patch = self.patch_of[t as usize];
        patch == index || patch == self.gone || self.moved(t) || self.star.removed.contains(&t)
    }

    /// The moved triangles of other patches.
    fn others(&self, index: u32) -> impl Iterator<Item = u32> + '_ {
        self.star.fan.iter().map(|s| s.triangle).filter(move |t| self.patch_of[*t as usize] != index)
    }

    fn amendment(&self, index: u32, member: &Member, reach: &mut ReachBuffers) -> Amendment {
        let Self { convexity, star, .. } = self;
        let (surface, tolerance) = (convexity.surface(), convexity.tolerance());
        let apex = surface.points[star.ends[0] as usize];
        let own = || star.fan.iter().map(|s| s.triangle).filter(|t| self.patch_of[*t as usize] == index);
        let touches = own().next().is_some();
        let gone = member.vertices_gone(star, &surface.triangles);
        let stays = |v: &&u32| !gone.contains(v);
        let below = |t: u32| {
            let plane = convexity.plane(t);
            plane.normal != DVec3::ZERO
                && member
                    .vertices
                    .iter()
                    .filter(stays)
                    .all(|v| plane.height(surface.points[*v as usize]) <= tolerance)
        };
        let left = || {
            let triangles = member.patch.triangles.iter().copied();
            triangles.filter(|t| !star.removed.contains(t))
        };
        if touches && !(left().all(|t| convexity.plane(t).height(apex) <= tolerance) && own().all(below)) {
            return Amendment::Decided(None);
        }
        let old = member.patch.lead;
        let lead = if self.moved(old) || star.removed.contains(&old) {
            left().max_by(|a, b| convexity.area(*a).total_cmp(&convexity.area(*b)))
        } else {
            let candidates = own().filter(|t| convexity.area(*t) > convexity.area(old));
            candidates.max_by(|a, b| convexity.area(*a).total_cmp(&convexity.area(*b))).or(Some(old))
        };
        let Some(lead) = lead else { return Amendment::Undecided };
        let plane = convexity.plane(lead);
        let depth = |p: DVec3| -plane.height(p);
        let rest = member.vertices.iter().filter(stays).map(|v| depth(surface.points[*v as usize]));
        let thickness = rest.fold(if touches { depth(apex) } else { 0.0 }, f64::max);
        let flat = thickness <= tolerance;
        if flat != member.patch.flat || !flat && convexity.depth_of(thickness) < member.skin.depth() {
            return Amendment::Undecided;
        }
        let reached = |skin: &Skin, reach: &mut ReachBuffers| {
            self.others(index).any(|t| reaches_below(&surface.corners(t), skin.planes(), skin.depth(), reach))
        };
        match &member.skin {
            Skin::Layer { planes, .. } if planes[0] == plane => {
                let inside = !touches || planes[2..].iter().all(|side| side.height(apex) <= 0.0);
                let upright = own().all(|t| convexity.plane(t).normal.dot(plane.normal) > 0.0);
                if !inside || !upright {
                    return Amendment::Undecided;
                }
                if reached(&member.skin, reach) {
                    return Amendment::TooWide(EMPTY);
                }
                Amendment::Decided(Some(Change::Amended { lead, grown: None }))
            }
            Skin::Polytope(polytope) => {
                let visible = if touches { polytope.visible(apex) } else { Vec::new() };
                if visible.is_empty() {
                    return if reached(&member.skin, reach) {
                        Amendment::TooWide(EMPTY)
                    } else {
                        Amendment::Decided(Some(Change::Amended { lead, grown: None }))
                    };
                }
                let (grown, (low, high)) = polytope.grown(apex, &visible);
                let skin = Skin::Polytope(grown);
                // Surface that is deep in the new skin, but was not deep in the old one, is in the part added
                // or within the tolerance of it.
                let margin = DVec3::splat(2.0 * tolerance);
                let planes = skin.planes().iter().copied();
                let new = (low - margin, high + margin);
                if reached(&skin, reach)
                    || surface.reaches_into(planes, new, skin.depth(), |t| self.is_mine(index, t), reach)
                {
                    return Amendment::TooWide(new);
                }
                let (from, to) = member.patch.bounds;
                let bounds = (from.min(low), to.max(high));
                Amendment::Decided(Some(Change::Amended { lead, grown: Some((skin, bounds)) }))
            }
            _ => Amendment::Undecided,
        }
    }
}

enum Amendment {
    Decided(Option<Change>),
    /// Surface reaches into the skin, which may be too large: the hull is needed. Surface other than the
    /// moved triangles can reach into it only in this box.
    TooWide(Bounds),
    /// The patch may have become flat, or no longer be.
    Undecided,
}

impl Member {
    /// A patch with its skin.
    pub fn new(convexity: &Convexity<'_>, patch: Patch, hulls: &mut HullBuilder) -> Self {
        let surface = convexity.surface();
        let mut vertices: Vec<u32> =
            patch.triangles.iter().flat_map(|t| surface.triangles[*t as usize]).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let points: Vec<DVec3> = patch.extreme.iter().map(|v| surface.points[*v as usize]).collect();
        let hull = hulls.hull(&points, HULL_THICKNESS);
        let skin = convexity.skin(&patch, &hull, &points);
        Self { patch, skin, vertices, amended: false }
    }

    /// The vertices of the edge that collapses, and those without any triangle left.
    fn vertices_gone(&self, star: &Star, triangles: &[[u32; 3]]) -> Vec<u32> {
        let is_left = |v: &u32| {
            let mut left = self.patch.triangles.iter().filter(|t| !star.removed.contains(t));
            left.any(|t| triangles[*t as usize].contains(v))
        };
        let corners = star.removed.iter().flat_map(|t| triangles[*t as usize]);
        let alone = corners.filter(|v| !star.ends.contains(v) && !is_left(v));
        star.ends.into_iter().chain(alone).collect()
    }

    /// Updates the patch after a collapse for which [`Trial::change`] has shown that it remains convex.
    /// `triangles` are the corners of all triangles.
    pub fn amend(
        &mut self,
        star: &Star,
        (lead, grown): (u32, Option<(Skin, Bounds)>),
        touches: bool,
        triangles: &[[u32; 3]],
    ) {
        let gone = self.vertices_gone(star, triangles);
        self.vertices.retain(|v| !gone.contains(v));
        self.patch.triangles.retain(|t| !star.removed.contains(t));
        if touches && let Err(k) = self.vertices.binary_search(&star.ends[0]) {
            self.vertices.insert(k, star.ends[0]);
        }
        self.patch.extreme.clone_from(&self.vertices);
        self.patch.lead = lead;
        if let Some((skin, bounds)) = grown {
            (self.skin, self.patch.bounds) = (skin, bounds);
        }
        self.amended = true;
    }

    /// Whether its skin, bounds and extreme points may be larger than needed.
    pub fn is_loose(&self) -> bool {
        self.amended
    }

    /// Recomputes the skin, bounds and extreme points.
    pub fn tighten(&mut self, convexity: &Convexity<'_>, hulls: &mut HullBuilder) {
        let surface = convexity.surface();
        let points: Vec<DVec3> = self.vertices.iter().map(|v| surface.points[*v as usize]).collect();
        let hull = hulls.hull(&points, HULL_THICKNESS);
        self.patch.extreme = hull.extreme.iter().map(|k| self.vertices[*k as usize]).collect();
        self.patch.bounds = bounds_of(&points);
        self.skin = convexity.skin(&self.patch, &hull, &points);
        self.amended = false;
    }
}
