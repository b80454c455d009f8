//! The mesh and its convex patches during simplification: trying a collapse, keeping it, and joining patches.
//!
//! A collapse is tried in place: the triangles of its fan are moved in the surface, but not yet in the
//! spatial indices, so that they are tested one by one against all others. Conditions of a valid collapse
//! (§3.3.4, step 5):
//!
//! - no triangle of the fan is degenerate, turned over, or intersects another (exact arithmetic);
//! - each patch that has lost or moved a triangle is a convex patch, by the test of the decomposition;
//! - the fan does not reach into the hull of any other patch.

use glam::DVec3;
use palpate_core::TriMesh;

use super::filter::Neighbourhood;
use super::limits::Limits;
use super::member::{Change, Member, Trial};
use super::quadric::Quadric;
use super::star::{Fans, Star};
use crate::box_tree::{BoxTree, EMPTY, meet};
use crate::convexity::{Convexity, JoinBuffers, dependable_planes};
use crate::decomposition::{Decomposition, NO_PATCH};
use crate::hull::Plane;
use crate::intersect::intersect;
use crate::surface::{Surface, reaches_below};

/// Smallest width of a new triangle, as a fraction of its longest side.
const MIN_WIDTH: f64 = 1e-3;

/// Cell size of the grid that vertices move on, as a fraction of the object's radius. Without the grid,
/// rounding, which depends on the unit of length, would accumulate.
const CELL: f64 = 1.0 / (1u64 << 32) as f64;

/// Largest number of triangles of a patch whose neighbours are all tried for a join each time that it
/// changes; larger ones are joined only near the change.
const MAX_TRIANGLES_FOR_ALL_NEIGHBOURS: usize = 64;

/// The mesh without removed vertices and triangles.
pub(crate) struct Snapshot {
    /// The mesh, m.
    pub mesh: TriMesh,
    /// The mesh in unit coordinates.
    pub surface: Surface,
    /// D of its vertices, m².
    pub areas: Vec<f64>,
    /// Index in the snapshot of each vertex of the state.
    pub vertex_of: Vec<u32>,
    /// Index in the snapshot of each triangle of the state.
    pub triangle_of: Vec<u32>,
}

/// The patches that a collapse changes, with their changes.
type Changes = Vec<(u32, Change)>;

pub(crate) struct State {
    pub surface: Surface,
    pub fans: Fans,
    /// The vertices, m.
    pub metres: Vec<DVec3>,
    pub patch_of: Vec<u32>,
    pub members: Vec<Option<Member>>,
    /// The patch that each removed patch was merged into; the patch itself while it exists.
    pub went_into: Vec<u32>,
    pub patches: usize,
    pub triangles: usize,
    /// D of each vertex (m²).
    pub areas: Vec<f64>,
    quadrics: Vec<Quadric>,
    planes: Vec<Plane>,
    tolerance: f64,
    /// Cell size of the grid that vertices move on, in unit coordinates.
    cell: f64,
    hulls: BoxTree,
    indexed_triangles: usize,
    joins: JoinBuffers,
    stack: Vec<u32>,
    near: Vec<u32>,
}

impl State {
    /// The state of a surface and its patches; `metres` are its vertices, m, `neighbours` the triangles
    /// across the sides of each triangle.
    pub fn new(
        surface: Surface,
        metres: Vec<DVec3>,
        neighbours: &[[u32; 3]],
        decomposition: &Decomposition,
        areas: Vec<f64>,
        limits: &Limits,
    ) -> Self {
        let tolerance = limits.tolerance;
        let fans = Fans::new(surface.points.len(), &surface.triangles);
        let planes = dependable_planes(&surface, neighbours, tolerance);
        let mut joins = JoinBuffers::default();
        let convexity = Convexity::with_planes(&surface, &planes, tolerance);
        let members: Vec<_> = decomposition
            .patches
            .iter()
            .map(|patch| Some(Member::new(&convexity, patch.clone(), &mut joins.hulls)))
            .collect();
        let boxes: Vec<_> = decomposition.patches.iter().map(|p| p.bounds).collect();
        let mut quadrics = vec![Quadric::NONE; surface.points.len()];
        for (corners, plane) in surface.triangles.iter().zip(&planes) {
            let [a, b, c] = corners.map(|v| surface.points[v as usize]);
            let area = (b - a).cross(c - a).length();
            let quadric = Quadric::plane(plane.normal, plane.offset, area);
            for v in corners {
                quadrics[*v as usize] = quadrics[*v as usize].plus(&quadric);
            }
            for side in 0..3 {
                let [from, to] = [corners[side], corners[(side + 1) % 3]];
                if from != to && fans.across(&surface.triangles, to, from).is_none() {
                    let [p, q] = [from, to].map(|v| surface.points[v as usize]);
                    let border = Quadric::border(p, q, plane.normal);
                    for v in [from, to] {
                        quadrics[v as usize] = quadrics[v as usize].plus(&border);
                    }
                }
            }
        }
        let triangles = decomposition.patch_of.iter().filter(|p| **p != NO_PATCH).count();
        Self {
            fans,
            metres,
            patch_of: decomposition.patch_of.clone(),
            went_into: (0..members.len() as u32).collect(),
            patches: members.len(),
            triangles,
            indexed_triangles: triangles,
            members,
            areas,
            quadrics,
            planes,
            tolerance,
            cell: CELL * limits.radius,
            hulls: BoxTree::new(&boxes),
            surface,
            joins,
            stack: Vec::new(),
            near: Vec::new(),
        }
    }

    /// The present mesh; brings the patches' extreme points and bounds up to date.
    pub fn snapshot(&mut self) -> Snapshot {
        self.tighten();
        let Self { surface: all, .. } = self;
        let mut vertex_of = vec![u32::MAX; all.points.len()];
        let mut triangle_of = vec![u32::MAX; all.triangles.len()];
        let (mut points, mut metres, mut areas) = (Vec::new(), Vec::new(), Vec::new());
        let mut triangles = Vec::with_capacity(self.triangles);
        for (t, corners) in all.triangles.iter().enumerate() {
            if self.patch_of[t] == NO_PATCH {
                continue;
            }
            triangle_of[t] = triangles.len() as u32;
            triangles.push(corners.map(|v| {
                let slot = &mut vertex_of[v as usize];
                if *slot == u32::MAX {
                    *slot = points.len() as u32;
                    points.push(all.points[v as usize]);
                    metres.push(self.metres[v as usize]);
                    areas.push(self.areas[v as usize]);
                }
                *slot
            }));
        }
        let surface = Surface::from_parts(points, triangles.clone(), all.scale, all.center);
        let mesh = TriMesh::new(metres, triangles).expect("the indices were counted");
        Snapshot { mesh, surface, areas, vertex_of, triangle_of }
    }

    fn tighten(&mut self) {
        let convexity = Convexity::with_planes(&self.surface, &self.planes, self.tolerance);
        for member in self.members.iter_mut().flatten().filter(|m| m.is_loose()) {
            member.tighten(&convexity, &mut self.joins.hulls);
        }
    }

    /// The mesh, for the filter.
    pub fn neighbourhood(&self) -> Neighbourhood<'_> {
        Neighbourhood { points: &self.surface.points, triangles: &self.surface.triangles, fans: &self.fans }
    }

    /// The quadric of the merged vertex.
    pub fn quadric(&self, [a, b]: [u32; 2]) -> Quadric {
        self.quadrics[a as usize].plus(&self.quadrics[b as usize])
    }

    /// Largest height that counts as convex, in unit coordinates.
    pub fn tolerance(&self) -> f64 {
        self.tolerance
    }

    /// Collapses an edge to the last valid position of a search: `next` gets whether the position before was
    /// valid, and returns another to try or `None`. Returns the patches that have changed, if the edge was
    /// collapsed.
    pub fn collapse(
        &mut self,
        star: &Star,
        mut next: impl FnMut(Option<bool>) -> Option<DVec3>,
    ) -> Option<Vec<u32>> {
        let affected = self.affected(star);
        let kept = star.ends[0] as usize;
        let before = (self.surface.points[kept], self.metres[kept]);
        let old: Vec<([u32; 3], Plane)> = star
            .fan
            .iter()
            .map(|s| (self.surface.triangles[s.triangle as usize], self.planes[s.triangle as usize]))
            .collect();
        for spoke in &star.fan {
            let [a, b] = spoke.rim;
            self.surface.triangles[spoke.triangle as usize] = [star.ends[0], a, b];
        }
        let mut best: Option<(DVec3, Changes)> = None;
        let mut valid = None;
        while let Some(position) = next(valid) {
            let changes = self.try_at(star, &affected, &old, position);
            valid = Some(changes.is_some());
            if let Some(changes) = changes {
                best = Some((position, changes));
            }
        }
        let Some((position, changes)) = best else {
            (self.surface.points[kept], self.metres[kept]) = before;
            for (spoke, (corners, plane)) in star.fan.iter().zip(&old) {
                self.surface.triangles[spoke.triangle as usize] = *corners;
                self.planes[spoke.triangle as usize] = *plane;
            }
            return None;
        };
        self.place(star, position);
        self.keep(star, changes);
        Some(affected)
    }

    fn affected(&self, star: &Star) -> Vec<u32> {
        let triangles = star.fan.iter().map(|s| s.triangle).chain(star.removed.iter().copied());
        let mut affected: Vec<u32> = triangles.map(|t| self.patch_of[t as usize]).collect();
        affected.sort_unstable();
        affected.dedup();
        affected
    }

    fn place(&mut self, star: &Star, position: DVec3) {
        let position = (position / self.cell).round() * self.cell;
        // The position is rounded as the mesh in metres stores it, so that tests hold for the stored one.
        let metres = position / self.surface.scale + self.surface.center;
        self.metres[star.ends[0] as usize] = metres;
        self.surface.points[star.ends[0] as usize] = (metres - self.surface.center) * self.surface.scale;
        for spoke in &star.fan {
            self.planes[spoke.triangle as usize] = Plane::through(self.surface.corners(spoke.triangle));
        }
    }

    fn try_at(
        &mut self,
        star: &Star,
        affected: &[u32],
        old: &[([u32; 3], Plane)],
        position: DVec3,
    ) -> Option<Changes> {
        self.place(star, position);
        let sound = star.fan.iter().zip(old).all(|(spoke, (_, before))| {
            let [a, b, c] = self.surface.corners(spoke.triangle);
            let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
            let width = (b - a).cross(c - a).length() / longest;
            let turned = self.planes[spoke.triangle as usize].normal.dot(before.normal) <= 0.0;
            width > self.tolerance && width > MIN_WIDTH * longest && (!turned || before.normal == DVec3::ZERO)
        });
        if !sound {
            return None;
        }
        let mut changes = Vec::with_capacity(affected.len());
        let convexity = Convexity::with_planes(&self.surface, &self.planes, self.tolerance);
        let trial = Trial { convexity: &convexity, star, patch_of: &self.patch_of, gone: NO_PATCH };
        for &p in affected {
            let member = self.members[p as usize].as_ref()?;
            changes.push((p, trial.change(p, member, &mut self.joins)?));
        }
        (!self.reaches_into_others(star, affected) && !self.intersects(star)).then_some(changes)
    }

    /// Whether the fan reaches into the hull of a patch that is not affected.
    fn reaches_into_others(&mut self, star: &Star, affected: &[u32]) -> bool {
        let Self { surface, planes, hulls, members, joins, stack, tolerance, .. } = self;
        let JoinBuffers { hulls: builder, reach, .. } = joins;
        let convexity = Convexity::with_planes(surface, planes, *tolerance);
        let (low, high) = star.bounds(|t| surface.bounds(t));
        let around = (low - convexity.layer(), high + convexity.layer());
        let mut reached = |member: &Member| {
            let (planes, depth) = (member.skin.planes(), member.skin.depth());
            let fan = &star.fan;
            fan.iter().any(|s| reaches_below(&surface.corners(s.triangle), planes, depth, reach))
        };
        hulls.any_near(around, stack, |p| {
            let Some(member) = members[p as usize].as_mut().filter(|m| !m.skin.planes().is_empty()) else {
                return false;
            };
            if !meet(member.patch.bounds, around) || affected.contains(&p) || !reached(member) {
                return false;
            }
            if !member.is_loose() {
                return true;
            }
            member.tighten(&convexity, builder);
            reached(member)
        })
    }

    /// Whether a triangle of the fan intersects another of the surface.
    fn intersects(&mut self, star: &Star) -> bool {
        let Self { surface, stack, near, patch_of, .. } = self;
        for (k, spoke) in star.fan.iter().enumerate() {
            let own = surface.triangles[spoke.triangle as usize];
            let crosses = |t: u32| intersect(&surface.points, own, surface.triangles[t as usize]);
            if star.fan[..k].iter().any(|s| crosses(s.triangle)) {
                return true;
            }
        }
        let around = star.bounds(|t| surface.bounds(t));
        near.clear();
        surface.tree().any_near(around, stack, |t| {
            let other = patch_of[t as usize] != NO_PATCH
                && !star.removed.contains(&t)
                && star.fan.iter().all(|s| s.triangle != t);
            if other && meet(surface.bounds(t), around) {
                near.push(t);
            }
            false
        });
        star.fan.iter().any(|spoke| {
            let (own, bounds) = (surface.triangles[spoke.triangle as usize], surface.bounds(spoke.triangle));
            near.iter().any(|t| {
                meet(surface.bounds(*t), bounds)
                    && intersect(&surface.points, own, surface.triangles[*t as usize])
            })
        })
    }

    /// Makes a collapse that has been tried permanent.
    fn keep(&mut self, star: &Star, changes: Changes) {
        let [kept, gone] = star.ends.map(|v| v as usize);
        self.quadrics[kept] = self.quadric(star.ends);
        self.areas[kept] = self.areas[kept].min(self.areas[gone]);
        for (p, change) in changes {
            if matches!(change, Change::Gone) {
                // The patch merges into that of a neighbour, whose triangle of the fan takes its place.
                let heir = star.removed.iter().find(|t| self.patch_of[**t as usize] == p).and_then(|t| {
                    let corners = self.surface.triangles[*t as usize];
                    let apex = corners.into_iter().find(|v| !star.ends.contains(v))?;
                    star.fan
                        .iter()
                        .filter(|s| s.rim.contains(&apex))
                        .map(|s| self.patch_of[s.triangle as usize])
                        .find(|q| *q != p)
                });
                if let Some(heir) = heir {
                    self.went_into[p as usize] = heir;
                    self.patches -= 1;
                }
            }
            let touches = star.fan.iter().any(|s| self.patch_of[s.triangle as usize] == p);
            let slot = &mut self.members[p as usize];
            match (change, slot.as_mut()) {
                (Change::Amended { lead, grown }, Some(member)) => {
                    member.amend(star, (lead, grown), touches, &self.surface.triangles);
                    if member.skin.worn() {
                        let convexity = Convexity::with_planes(&self.surface, &self.planes, self.tolerance);
                        member.tighten(&convexity, &mut self.joins.hulls);
                    }
                }
                (Change::Anew(member), _) => *slot = Some(member),
                _ => *slot = None,
            }
            self.reindex_hull(p);
        }
        let rim = {
            let mut rim = star.rim();
            let apexes = star.removed.iter().flat_map(|t| self.surface.triangles[*t as usize]);
            rim.extend(apexes.filter(|v| !star.ends.contains(v)));
            rim.sort_unstable();
            rim.dedup();
            rim
        };
        self.fans.collapse(star, &rim);
        for &t in &star.removed {
            self.patch_of[t as usize] = NO_PATCH;
            self.surface.triangles[t as usize] = [star.ends[0]; 3];
            self.surface.moved(t);
        }
        self.triangles -= star.removed.len();
        for spoke in &star.fan {
            self.surface.moved(spoke.triangle);
        }
        if self.triangles < self.indexed_triangles / 2 {
            self.indexed_triangles = self.triangles;
            self.surface.index();
            self.index_hulls();
        }
    }

    fn reindex_hull(&mut self, p: u32) {
        let members = &self.members;
        self.hulls.refit(p, |p| members[p as usize].as_ref().map_or(EMPTY, |m| m.patch.bounds));
    }

    /// Takes apart the patches that span a notch of the surface by now, and joins their pieces again as far
    /// as possible: collapses are tested only for surface that reaches deep into hulls.
    pub fn take_apart(&mut self) {
        self.tighten();
        let convexity = Convexity::with_planes(&self.surface, &self.planes, self.tolerance);
        let mut apart = Vec::new();
        for (p, member) in (0u32..).zip(&self.members) {
            let mine = |t: u32| [p, NO_PATCH].contains(&self.patch_of[t as usize]);
            if member.as_ref().is_some_and(|m| convexity.may_span_notch(&m.patch, mine, &mut self.joins)) {
                apart.push(p);
            }
        }
        let mut pieces = Vec::new();
        for p in apart {
            let Some(member) = self.members[p as usize].take() else { continue };
            for (k, t) in member.patch.triangles.into_iter().enumerate() {
                let piece = if k == 0 { p } else { self.members.len() as u32 };
                if k > 0 {
                    self.members.push(None);
                    self.went_into.push(piece);
                    self.patches += 1;
                }
                self.patch_of[t as usize] = piece;
                self.members[piece as usize] =
                    Some(Member::new(&convexity, convexity.single(t), &mut self.joins.hulls));
                pieces.push(piece);
            }
        }
        if !pieces.is_empty() {
            self.index_hulls();
            self.join_around(pieces, &[]);
        }
    }

    fn index_hulls(&mut self) {
        let boxes: Vec<_> =
            self.members.iter().map(|m| m.as_ref().map_or(EMPTY, |m| m.patch.bounds)).collect();
        self.hulls = BoxTree::new(&boxes);
    }

    /// Joins patches that have changed with their neighbours, and the unions with theirs, as long as the
    /// unions are convex patches. `around` are the triangles of the fan: large patches are joined only with
    /// patches there.
    pub fn join_around(&mut self, mut changed: Vec<u32>, around: &[u32]) {
        let mut failed: Vec<(u32, u32)> = Vec::new();
        while let Some(p) = changed.pop() {
            let Some(member) = &self.members[p as usize] else { continue };
            let (fans, triangles) = (&self.fans, &self.surface.triangles);
            // Patches across the sides of its triangles.
            let mut neighbours = Vec::new();
            let few = member.patch.triangles.len() <= MAX_TRIANGLES_FOR_ALL_NEIGHBOURS;
            for t in if few { &member.patch.triangles } else { around } {
                let c = triangles[*t as usize];
                for k in 0..3 {
                    if let Some((_, other)) = fans.across(triangles, c[(k + 1) % 3], c[k]) {
                        let sides = [*t, other].map(|t| self.patch_of[t as usize]);
                        neighbours.extend(sides.iter().filter(|_| sides.contains(&p)));
                    }
                }
            }
            neighbours.retain(|q| *q != p);
            neighbours.sort_unstable();
            neighbours.dedup();
            for q in neighbours {
                let pair = (p.min(q), p.max(q));
                if failed.contains(&pair) {
                    continue;
                }
                if let Some(union) = self.join(p, q) {
                    failed.retain(|f| f.0 != union && f.1 != union);
                    changed.push(union);
                    break;
                }
                failed.push(pair);
            }
        }
    }

    /// Joins two patches if their union is a convex patch; returns the index of the union.
    fn join(&mut self, p: u32, q: u32) -> Option<u32> {
        let (first, second) = (self.members[p as usize].as_ref()?, self.members[q as usize].as_ref()?);
        let patch_of = &self.patch_of;
        let mine = |t: u32| [p, q, NO_PATCH].contains(&patch_of[t as usize]);
        let convexity = Convexity::with_planes(&self.surface, &self.planes, self.tolerance);
        let join = convexity.join(&first.patch, &second.patch, mine, &mut self.joins)?;
        let (kept, gone) =
            if first.patch.triangles.len() >= second.patch.triangles.len() { (p, q) } else { (q, p) };
        let gone_member = self.members[gone as usize].take()?;
        for t in &gone_member.patch.triangles {
            self.patch_of[*t as usize] = kept;
        }
        let slot = &mut self.members[kept as usize];
        let mut patch = slot.take()?.patch;
        patch.take_in(gone_member.patch, join, &convexity);
        *slot = Some(Member::new(&convexity, patch, &mut self.joins.hulls));
        self.went_into[gone as usize] = kept;
        self.patches -= 1;
        self.reindex_hull(gone);
        self.reindex_hull(kept);
        Some(kept)
    }
}
