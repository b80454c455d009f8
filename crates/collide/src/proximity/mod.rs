//! The smallest distance of two surfaces, and whether two bodies intersect (§3.4.1's exact and disjoint queries).
//!
//! Both answers are about the original triangles, at full resolution. Pairs of nodes are split until a lower bound on
//! their distance (that of the bounding hulls, less what detail may stick out: h(a) + h(b)) is no less than the best
//! distance found between triangles, as in SWIFT++ (Ehmann and Lin 2001). Where that leaves off, the next query goes
//! on: it first measures the pair of triangles that was nearest last time, and then looks again only at pairs whose
//! bound the motion since then has used up ([`front`]).
//!
//! The front only becomes finer. When a query has to look at more pairs than the last one from the roots did, or the
//! front has grown too large, it starts again from the roots. So answers do not depend on earlier queries, except for
//! rounding, but costs do.
//!
//! Distances are between surfaces: a body wholly inside another has a positive distance from it. Whether it is inside
//! is asked by [`ProximityQuery::intersects`], which tests a point of each piece of either surface against the other
//! solid ([`solid`]). While surfaces stay further apart than they move, none can have slipped in or out, and the last
//! answer stands.

mod boxes;
mod facets;
mod front;
mod solid;
mod triangles;

use std::collections::binary_heap::PeekMut;

use palpate_core::glam::DVec3;
use palpate_core::{Clod, Pose};

use self::boxes::OrientedBox;
use self::facets::{FacetSearch, Facets, Leaf};
use self::front::{Front, Pair};
use self::triangles::Nearest;
use crate::convex::{Limits, Placement, Start, gjk};
use crate::error::{QueryError, QueryObject};
use crate::motion::Motion;
use crate::query::check_placed;
use crate::shape::Shape;

/// Distances are found, and surfaces touch, to this fraction of the size of the bodies.
const PRECISION: f64 = 1e-12;

/// A search that goes on may look at twice as many pairs as the last one from the roots, and this many more, before
/// the front is given up.
const SPARE_PAIRS: usize = 256;

/// Pairs to look at, from ever higher up, before surfaces that met are taken to have parted there.
const NEIGHBOURS: [usize; 2] = [24, 96];

/// The front may grow to so many times its size after the last search from the roots, and this many pairs more.
const GROWTH: usize = 4;
const SPARE_FRONT: usize = 1 << 12;

/// Pairs of the front that a new workspace has room for.
const FRONT: usize = 1 << 14;

/// The way after which the front is given up, before rounding tells, in sizes of the bodies.
const LONG_WAY: f64 = 1e3;

/// What distance queries need of a hierarchy besides what contact queries do.
#[derive(Clone, Debug)]
pub(crate) struct SurfaceIndex {
    facets: Facets,
    boxes: Vec<OrientedBox>,
    /// A point of each connected piece, m.
    pieces: Vec<DVec3>,
}

impl SurfaceIndex {
    pub fn new(clod: &Clod) -> Self {
        Self { facets: Facets::new(clod), boxes: OrientedBox::all(clod), pieces: solid::pieces(clod) }
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        self.facets.bytes() + size_of_val(&*self.boxes) + size_of_val(&*self.pieces)
    }
}

/// The nearest points of two surfaces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearestPoints {
    /// Their distance, m; 0 when the surfaces touch or intersect.
    pub distance: f64,
    /// The point on the probe, world frame, m. Where the surfaces intersect, a point of the intersection.
    pub on_probe: DVec3,
    /// The point on the scene object, world frame, m.
    pub on_scene: DVec3,
}

/// How two bodies lie to each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Intersection {
    /// They have no point in common.
    Apart,
    /// Their surfaces meet.
    SurfacesMeet,
    /// The surfaces do not meet, but (a piece of) the probe lies inside the scene object, which is a solid.
    ProbeInside,
    /// The surfaces do not meet, but (a piece of) the scene object lies inside the probe, which is a solid.
    SceneInside,
}

impl Intersection {
    /// Whether the bodies have a point in common.
    pub fn intersects(self) -> bool {
        matches!(self, Self::SurfacesMeet | Self::ProbeInside | Self::SceneInside)
    }
}

/// What the last query cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Effort {
    /// Pairs of nodes looked at.
    pub pairs: usize,
    /// Convex queries made.
    pub convex_queries: usize,
    /// Pairs of triangles compared.
    pub triangle_pairs: usize,
    /// Rays cast, to tell whether one body is inside the other.
    pub inside_tests: usize,
    /// Pairs in the front.
    pub front: usize,
    /// Whether the search started from the roots.
    pub from_roots: bool,
    /// Whether a buffer grew.
    pub reallocated: bool,
}

/// The workspace of distance and intersection queries between a probe and a scene object. Once it has seen as much
/// before, a query does not allocate; it never panics, and the same queries in the same order give the same answers.
///
/// ```
/// use palpate_collide::{Intersection, ProximityQuery, Shape};
/// use palpate_core::Pose;
/// use palpate_core::glam::DVec3;
///
/// # use palpate_clod_build::{BuildOptions, build, unwatched};
/// # use palpate_core::TriMesh;
/// # let corner = |i: u32| DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2)) * 0.1;
/// # let cube = TriMesh::new((0..8).map(corner).collect(), vec![
/// #     [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
/// #     [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
/// # ])?;
/// # let tips = [DVec3::X, -DVec3::X, DVec3::Y, -DVec3::Y, DVec3::Z, -DVec3::Z].map(|tip| 0.05 * tip);
/// # let octahedron = TriMesh::new(tips.to_vec(), vec![
/// #     [0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5],
/// # ])?;
/// # let shape_of = |mesh: &TriMesh| build(mesh, &BuildOptions::default(), &mut unwatched).map(Shape::new);
/// # let (octahedron, cube) = (shape_of(&octahedron)?, shape_of(&cube)?);
/// let mut query = ProximityQuery::new(&octahedron, &cube);
/// let at = |height: f64| Pose::from_translation(DVec3::new(0.04, 0.05, 0.15 + height));
/// let nearest = query.distance(&at(0.3), &Pose::IDENTITY, f64::INFINITY)?.expect("no bound was given");
/// assert!((nearest.distance - 0.3).abs() < 1e-9);
/// assert!(nearest.on_scene.distance(DVec3::new(0.04, 0.05, 0.1)) < 1e-9);
/// assert_eq!(query.distance(&at(0.3), &Pose::IDENTITY, 0.1)?, None); // further than 100 mm
/// assert_eq!(query.intersects(&at(-0.001), &Pose::IDENTITY)?, Intersection::SurfacesMeet);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct ProximityQuery {
    probe: Shape,
    scene: Shape,
    motion: Motion,
    /// With `stack`, all that the search has left behind: together they cover every pair of leaves.
    front: Front,
    stack: Vec<Pair>,
    facets: FacetSearch,
    nodes: Vec<u32>,
    nearest: Option<Witness>,
    /// Whether it touched.
    touching: bool,
    inside: Option<Inside>,
    /// Pairs looked at by, and size of the front after, the last search from the roots.
    pairs_from_roots: usize,
    front_from_roots: usize,
    effort: Effort,
}

/// The pair of triangles that was nearest at the last query.
#[derive(Clone, Copy, Debug)]
struct Witness {
    leaves: [u32; 2],
    triangles: [u32; 2],
}

/// Which body was inside the other, as long as that cannot have changed.
#[derive(Clone, Copy, Debug)]
struct Inside {
    answer: Intersection,
    /// Way up to which the surfaces cannot have met.
    expires: f64,
}

/// The circumstances of one query.
struct Search {
    placement: Placement,
    /// Distances are known to this, m.
    precision: f64,
    /// Squared distance, m², and pair of the nearest triangles so far.
    best: Option<(Nearest, Witness)>,
    /// Pairs further apart than this are of no interest, m.
    limit: f64,
}

impl Search {
    fn touching(&self) -> bool {
        self.best.is_some_and(|(nearest, _)| nearest.squared <= self.precision * self.precision)
    }

    fn offer(&mut self, nearest: Nearest, witness: Witness) {
        if self.best.is_none_or(|(best, _)| nearest.squared < best.squared) {
            self.best = Some((nearest, witness));
            self.lower_limit(self.limit);
        }
    }

    /// Sets the limit, or to what beats the best, if that is less.
    fn lower_limit(&mut self, limit: f64) {
        let best = self.best.map_or(f64::INFINITY, |(nearest, _)| nearest.squared.sqrt() - self.precision);
        self.limit = limit.min(best.max(0.0));
    }
}

impl ProximityQuery {
    /// A workspace for queries between two hierarchies. The first for a shape prepares it further, which all others
    /// share.
    pub fn new(probe: &Shape, scene: &Shape) -> Self {
        for shape in [probe, scene] {
            shape.surface();
        }
        Self {
            motion: Motion::default(),
            front: Front::with_capacity(FRONT),
            stack: Vec::with_capacity(probe.path_width() + scene.path_width() + 1),
            facets: FacetSearch::new(),
            nodes: Vec::with_capacity(probe.path_width().max(scene.path_width()) + 1),
            nearest: None,
            touching: false,
            inside: None,
            pairs_from_roots: 0,
            front_from_roots: 0,
            effort: Effort::default(),
            probe: probe.clone(),
            scene: scene.clone(),
        }
    }

    /// The nearest points of the surfaces with the objects at the given poses (object frame to world); `None` if they are
    /// further apart than `upper` (m, may be infinite).
    ///
    /// # Errors
    /// If a pose is not valid, `upper` is negative or not a number, an object has no triangles, or the objects are so far
    /// apart that the square of their distance overflows.
    pub fn distance(
        &mut self,
        probe_pose: &Pose,
        scene_pose: &Pose,
        upper: f64,
    ) -> Result<Option<NearestPoints>, QueryError> {
        if upper.is_nan() || upper < 0.0 {
            return Err(QueryError::UpperBound { given: upper });
        }
        let search = self.search(probe_pose, scene_pose, upper)?;
        let found = search.best.map(|(nearest, _)| NearestPoints {
            distance: if search.touching() { 0.0 } else { nearest.squared.sqrt() },
            on_probe: probe_pose.transform_point(nearest.on_a),
            on_scene: probe_pose.transform_point(nearest.on_b),
        });
        Ok(found.filter(|found| found.distance <= upper))
    }

    /// Whether the objects at the given poses (object frame to world) have a point in common, and how: of solids all
    /// points count, of open meshes those of the surface.
    ///
    /// # Errors
    /// If a pose is not valid, an object has no triangles, or the objects are so far apart that the square of their
    /// distance overflows.
    pub fn intersects(&mut self, probe_pose: &Pose, scene_pose: &Pose) -> Result<Intersection, QueryError> {
        let search = self.search(probe_pose, scene_pose, 0.0)?;
        if search.touching() {
            return Ok(Intersection::SurfacesMeet);
        }
        let expires = self.expires();
        let answer = match self.inside {
            Some(inside) => inside.answer,
            None => self.enclosed(&search.placement),
        };
        self.inside = Some(Inside { answer, expires });
        Ok(answer)
    }

    /// What the last query cost.
    pub fn effort(&self) -> Effort {
        self.effort
    }

    /// Forgets earlier queries: the next search starts from the roots.
    pub fn reset(&mut self) {
        (self.nearest, self.touching, self.inside) = (None, false, None);
        // An empty front is started anew.
        self.front.clear();
    }

    /// Bytes of memory held by the workspace.
    pub fn bytes(&self) -> usize {
        (self.front.capacity() + self.stack.capacity()) * size_of::<Pair>()
    }

    fn capacity(&self) -> usize {
        self.front.capacity() + self.stack.capacity() + self.facets.capacity() + self.nodes.capacity()
    }

    /// The nearest triangles within `upper`, or any that touch.
    fn search(&mut self, probe_pose: &Pose, scene_pose: &Pose, upper: f64) -> Result<Search, QueryError> {
        self.effort = Effort::default();
        check_placed(&self.probe, probe_pose, QueryObject::Probe)?;
        check_placed(&self.scene, scene_pose, QueryObject::Scene)?;
        let placement = Placement::between(probe_pose, scene_pose);
        if !placement.translation.length_squared().is_finite() {
            return Err(QueryError::TooFarApart);
        }
        let reach = self.probe.coordinates() + self.scene.coordinates();
        let rounding = 4.0 * f64::EPSILON * (reach + placement.translation.abs().max_element());
        let size = self.probe.clod().source.bounding_radius + self.scene.clod().source.bounding_radius;
        let buffers = self.capacity();

        self.motion.step(&self.probe.ball(), &self.scene.ball(), &placement, rounding);
        let precision = PRECISION * size + rounding;
        let mut search = Search { placement, precision, best: None, limit: upper + precision };
        if let Some(witness) = self.nearest {
            self.measure(witness, &mut search);
            if self.touching && !search.touching() {
                self.look_around(witness, &mut search);
            }
        }
        self.inside = self.inside.filter(|inside| inside.expires > self.motion.way());
        let too_large = self.front.len() > GROWTH * self.front_from_roots + SPARE_FRONT;
        if self.front.is_empty() || too_large || self.motion.way() > LONG_WAY * size {
            self.restart();
        }
        self.refine(&mut search);
        self.nearest = search.best.map(|(_, witness)| witness);
        self.touching = search.touching();
        let expires = self.expires();
        self.inside = self.inside.filter(|_| !search.touching()).map(|inside| Inside { expires, ..inside });
        if self.effort.from_roots {
            (self.pairs_from_roots, self.front_from_roots) = (self.effort.pairs, self.front.len());
        }
        self.effort.front = self.front.len();
        self.effort.reallocated = self.capacity() != buffers;
        Ok(search)
    }

    /// Looks at pairs until none can be nearer than the best, or surfaces touch.
    fn refine(&mut self, search: &mut Search) {
        while !search.touching() {
            let Some(mut top) = self.front.peek_mut() else { return };
            if top.expires >= self.motion.way() + search.limit {
                return;
            }
            let mut pair = *top;
            // The cheap bounds are enough to keep most in place.
            let gap = cheap_gap(&self.probe, &self.scene, (pair.a, pair.b), search);
            if gap >= search.limit {
                top.expires = self.motion.way() + gap;
                self.effort.pairs += 1;
                continue;
            }
            PeekMut::pop(top);
            pair.expires = pair.expires.max(self.motion.way() + gap);
            self.stack.push(pair);
            self.descend(search);
            let stale = self.effort.pairs > 2 * self.pairs_from_roots + SPARE_PAIRS;
            if stale && !self.effort.from_roots && !search.touching() {
                self.restart();
            }
        }
    }

    /// Where surfaces no longer meet at the pair of triangles where they did, they often do next to it: looks below common
    /// ancestors of the two patches, ever higher, and leaves the front alone.
    fn look_around(&mut self, witness: Witness, search: &mut Search) {
        let limit = search.limit;
        search.limit = search.precision;
        let [mut a, mut b] = witness.leaves;
        for pairs in NEIGHBOURS {
            for _ in 0..2 {
                // The root's parent is the largest index of all.
                a = self.probe.clod().nodes[a as usize].parent.min(a);
                b = self.scene.clod().nodes[b as usize].parent.min(b);
            }
            let most = self.effort.pairs + pairs;
            self.stack.push(Pair { expires: f64::NEG_INFINITY, a, b, axis: [0.0; 3] });
            while let Some(mut pair) = self.stack.pop() {
                if self.effort.pairs == most || search.touching() {
                    self.stack.clear();
                } else if pair.expires < self.motion.way() + search.limit {
                    self.effort.pairs += 1;
                    if !self.separated(&mut pair, search) {
                        self.split(pair, search, false);
                    }
                }
            }
        }
        search.lower_limit(limit);
    }

    /// Gives the front up for the pair of roots.
    fn restart(&mut self) {
        self.front.clear();
        self.stack.clear();
        if let Some(inside) = &mut self.inside {
            inside.expires -= self.motion.way();
        }
        self.motion.restart();
        self.effort.from_roots = true;
        let (a, b) = (self.probe.pass_through(Clod::ROOT, true), self.scene.pass_through(Clod::ROOT, true));
        self.front.push(Pair { expires: f64::NEG_INFINITY, a, b, axis: [0.0; 3] });
    }

    /// Looks at the pairs on the stack and, depth first and near ones first, at those that they are split into.
    fn descend(&mut self, search: &mut Search) {
        while let Some(mut pair) = self.stack.pop() {
            if search.touching() || pair.expires >= self.motion.way() + search.limit {
                self.front.push(pair);
                continue;
            }
            self.effort.pairs += 1;
            if self.separated(&mut pair, search) {
                self.front.push(pair);
            } else {
                self.split(pair, search, true);
            }
        }
    }

    /// Improves a pair's bound. Whether it need not be split: it is far enough apart, or one of leaves and measured.
    fn separated(&mut self, pair: &mut Pair, search: &mut Search) -> bool {
        let (node_a, node_b) = (self.probe.node(pair.a), self.scene.node(pair.b));
        let leaves = node_a.is_leaf() && node_b.is_leaf();
        let detail = node_a.hausdorff + node_b.hausdorff + search.precision;
        let axis = pair.axis();
        let axis =
            if axis == DVec3::ZERO { node_a.center - search.placement.point(node_b.center) } else { axis };
        self.effort.convex_queries += 1;
        let reach = search.limit + detail;
        // Proving more, for later queries to use up, takes longer than it saves.
        let limits = Limits { beyond: reach, share: 0.0, enough: reach, precision: search.precision };
        let (hull_a, hull_b) = (self.probe.hull(pair.a), self.scene.hull(pair.b));
        let found = gjk::distance(&hull_a, &hull_b, &search.placement, Start::Axis(axis), &limits);
        pair.set_axis(found.axis);
        let bound = found.lower - detail;
        pair.expires = pair.expires.max(self.motion.way() + bound);
        if bound >= search.limit {
            return true;
        }
        if leaves {
            let distance = self.leaves((pair.a, pair.b), search);
            pair.expires = pair.expires.max(self.motion.way() + distance);
        }
        leaves
    }

    /// The distance of two leaf patches, if less than the limit, else the limit.
    fn leaves(&mut self, (a, b): (u32, u32), search: &mut Search) -> f64 {
        let reach = search.limit + search.precision;
        let leaf_a = Leaf::new(self.probe.clod(), &self.probe.surface().facets, a);
        let leaf_b = Leaf::new(self.scene.clod(), &self.scene.surface().facets, b);
        self.facets.compared = 0;
        let enough = search.precision * search.precision;
        let found = self.facets.run(&leaf_a, &leaf_b, &search.placement, reach * reach, enough);
        self.effort.triangle_pairs += self.facets.compared;
        let Some(found) = found else { return search.limit };
        search.offer(found.nearest, Witness { leaves: [a, b], triangles: found.triangles });
        found.nearest.squared.sqrt() - search.precision
    }

    /// The distance of one pair of triangles.
    fn measure(&mut self, witness: Witness, search: &mut Search) {
        let leaf_a = Leaf::new(self.probe.clod(), &self.probe.surface().facets, witness.leaves[0]);
        let leaf_b = Leaf::new(self.scene.clod(), &self.scene.surface().facets, witness.leaves[1]);
        let a = leaf_a.corners(witness.triangles[0]);
        let b = leaf_b.corners(witness.triangles[1]).map(|corner| search.placement.point(corner));
        self.effort.triangle_pairs += 1;
        if let Some(nearest) = triangles::nearest(&a, &b, f64::INFINITY) {
            search.offer(nearest, witness);
        }
    }

    /// Replaces a pair by those of one node's children and the other node; those that are far apart are left in the front
    /// (`keep`) or forgotten.
    fn split(&mut self, pair: Pair, search: &Search, keep: bool) {
        let (node_a, node_b) = (self.probe.node(pair.a), self.scene.node(pair.b));
        let split_a = node_b.is_leaf() || (!node_a.is_leaf() && node_a.radius >= node_b.radius);
        let parent = if split_a { node_a } else { node_b };
        let start = self.stack.len();
        for child in parent.first_child..parent.last_child {
            let (a, b) = if split_a {
                (self.probe.pass_through(child, true), pair.b)
            } else {
                (pair.a, self.scene.pass_through(child, true))
            };
            let gap = cheap_gap(&self.probe, &self.scene, (a, b), search);
            let expires = pair.expires.max(self.motion.way() + gap);
            let child = Pair { a, b, expires, ..pair };
            if gap < search.limit {
                self.stack.push(child);
            } else if keep {
                self.front.push(child);
            }
        }
        // The nearest, which is the first to expire, is the next to be looked at.
        self.stack[start..].sort_unstable();
    }

    /// Way before which the surfaces cannot meet, after a search that found none touching.
    fn expires(&self) -> f64 {
        self.front.peek().map_or(f64::INFINITY, |pair| pair.expires)
    }

    /// Which solid encloses a piece of the other surface, given that the surfaces do not meet.
    fn enclosed(&mut self, placement: &Placement) -> Intersection {
        self.effort.inside_tests += 1;
        let (probe, scene) = (&self.probe, &self.scene);
        let to_scene = |p: DVec3| placement.direction_to_b(p - placement.translation);
        let (probe_pieces, scene_pieces) = (&probe.surface().pieces, &scene.surface().pieces);
        if probe_pieces.iter().any(|p| solid::contains(scene, to_scene(*p), &mut self.nodes)) {
            Intersection::ProbeInside
        } else if scene_pieces.iter().any(|p| solid::contains(probe, placement.point(*p), &mut self.nodes)) {
            Intersection::SceneInside
        } else {
            Intersection::Apart
        }
    }
}

/// Lower bound on the distance of two nodes' surfaces by their bounding spheres and, where these do not settle it, by
/// oriented boxes, m; negative where those overlap.
fn cheap_gap(probe: &Shape, scene: &Shape, (a, b): (u32, u32), search: &Search) -> f64 {
    let (node_a, node_b) = (probe.node(a), scene.node(b));
    let apart = node_a.center.distance(search.placement.point(node_b.center));
    let gap = apart - (node_a.radius + node_b.radius) * (1.0 + 1e-9) - search.precision;
    if gap >= search.limit {
        return gap;
    }
    let (box_a, box_b) = (&probe.surface().boxes[a as usize], &scene.surface().boxes[b as usize]);
    gap.max(boxes::gap(box_a, box_b, &search.placement, search.limit + search.precision) - search.precision)
}
