//! The contact query Q(A, B, d) between two hierarchies (§3.4.1, §3.4.2).
//!
//! Both hierarchies are descended in tandem. A pair of nodes stays where it is when its bounding spheres, or then its
//! hulls, are further apart than d + h(a) + h(b) (Eq. 3.5); otherwise one of them is split, down to pairs whose missing
//! detail is below the threshold s₀ ([`refinement`]), and those are asked for contacts. With such a threshold the one
//! with the coarser children is split (§3.4.2). At full resolution, where s₀ is 0, it is the larger one, down to pairs of
//! leaves. As §3.4.1 has it, they are a superset of the local minima of the distance where the objects are disjoint, and
//! local penetration depths where they overlap. Only surfaces that meet make contacts: an object that has sunk wholly into
//! another, deeper than that one's patches are thick, has none.
//!
//! A query starts from the [front] of the last one (§3.4.2), raised and lowered in place. The answer is that of a query
//! from the roots: a pair is only passed over while the bodies have not moved enough to change its answer, or its hulls
//! are apart along the direction that [parted](parting) them before, and searches that start from old nearest points find
//! the same ones. With a threshold, the two have been seen to end at different levels at one pair in some thousand poses; the
//! reason is not known. Pairs may be examined on several [threads](parallel).
//!
//! At full resolution the contacts are those of all patches within reach, as many as there are, and not spread evenly over the
//! area of contact. That is for inspection, and for measuring what a threshold leaves out. Where time counts, leave some error
//! out: with 2.5 % of the probe's radius a query takes a twenty-fifth to two thirds of the time.
//!
//! With a threshold, what is reported are contacts between the surfaces of coarser levels, each within s of the mesh.
//! Contacts can go over from one level to the next as s* nears s₀ (§3.4.4), and a time-critical query refines the pairs
//! with the largest s*/s₀ first, until its budget is spent.
//!
//! Departures: hulls of many points are not tested above the leaves; hull queries there only decide whether a pair is
//! within reach, and stop as soon as either bound on the distance settles it; nodes with a single child are passed
//! through, as long as they are to be refined anyway. In §3.4.2 every node of the front is tested in every query.

mod bodies;
mod budget;
mod front;
mod leaf;
mod metrics;
mod overlap;
mod parallel;
mod parting;
pub(crate) mod refinement;
mod triangles;

use std::collections::BinaryHeap;

use palpate_core::glam::DVec3;
use palpate_core::{Clod, Contact, Pose};

use self::bodies::{Bodies, Verdict};
use self::budget::{Pace, Urgent};
use self::front::{Front, Pair};
use self::leaf::{Counts, LeafQuery};
use self::parallel::Deferred;
use crate::convex::Placement;
use crate::error::{QueryError, QueryObject};
use crate::motion::Motion;
use crate::shape::Shape;
use crate::tolerances::{COORDINATE_ROUNDING, PAIR_MOTION_LIMIT};

pub use self::budget::Budget;
pub use self::metrics::{Combination, ErrorMetrics, VelocityMetric, ViewMetric};

/// Contacts that a new workspace has room for.
const CONTACTS: usize = 1 << 14;

/// Most contacts that a query reports, some 100 MB. Beyond them the shallowest are dropped and counted
/// ([`QueryOutcome::dropped`]).
pub const MAX_CONTACTS: usize = 1 << 20;

/// Most pairs of nodes, on and above the front, that a workspace keeps, some 0.6 GB. Those beyond are tested anew in
/// every query ([`QueryOutcome::front_overflow`]): the answer is the same, but takes longer.
pub const MAX_PAIRS: usize = 1 << 22;

/// Hulls of more points than this are not tested above the leaves, but split at once: they belong to the upper free
/// levels, where they overlap nearly always, and a support point of theirs costs more than the spheres of their
/// children.
const HULL_TEST_POINTS: usize = 256;

/// Pairs of nodes that a new workspace has room for.
const PAIRS: usize = 1 << 15;

/// Part of s₀ over which interpolated contacts go over from one resolution to the next.
const BAND: f64 = 0.5;

/// How much of what separates two hulls, beyond what would matter, a search has to prove before it stops: the more it
/// does, the longer the pair may sleep.
const SHARE: f64 = 0.5;

/// Pairs are joined again when they may sleep for this part of the radii of the nodes that they were split from.
const RAISE: f64 = 0.05;

/// What a query asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuerySettings {
    /// d: surfaces closer than this are in contact, m; 0 to the probe's [`max_tolerance`](Shape::max_tolerance).
    pub tolerance: f64,
    /// s₀: detail is left out where its deviation, averaged over the area of contact (s*, Eq. 3.7), is no more than
    /// this. [Exact](ErrorMetrics::EXACT) for full resolution.
    pub error: ErrorMetrics,
    /// Where s* nears s₀, report the contacts of the coarser and of the finer patches, with
    /// [weights](PatchContact::weight) that go over from one to the other (§3.4.4).
    pub interpolate: bool,
    /// Time-critical: refine in the order of s*/s₀, and stop when this is spent ([`QueryOutcome::out_of_budget`]).
    pub budget: Option<Budget>,
    /// Examine pairs on all threads of the current rayon pool, where there are many. The answer is the same. A time-critical
    /// query does not.
    pub parallel: bool,
}

impl QuerySettings {
    /// Settings with a tolerance (d, m) and defaults for the rest.
    pub fn new(tolerance: f64) -> Self {
        Self { tolerance, error: ErrorMetrics::EXACT, interpolate: false, budget: None, parallel: false }
    }

    /// Whether queries of a probe can be made with these settings.
    ///
    /// # Errors
    /// If the tolerance is not 0 to the probe's [`max_tolerance`](Shape::max_tolerance), or an error metric is negative
    /// or not finite.
    pub fn check(&self, probe: &Shape) -> Result<(), QueryError> {
        let (given, most) = (self.tolerance, probe.max_tolerance());
        if !(0.0..=most).contains(&given) {
            return Err(QueryError::Tolerance { given, most });
        }
        self.error.check()
    }
}

/// A contact, and the pair of patches that it was found between.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PatchContact {
    /// The contact, in world axes.
    pub contact: Contact,
    /// Node of the probe's hierarchy.
    pub probe_node: u32,
    /// Node of the scene object's hierarchy.
    pub scene_node: u32,
    /// How much of the contact counts: 1, unless contacts of finer patches stand for the rest of it
    /// ([`QuerySettings::interpolate`]).
    pub weight: f64,
}

/// What a query found and what it cost.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct QueryOutcome {
    /// Number of contacts found, those that were [dropped](Self::dropped) included.
    pub contacts: usize,
    /// Smallest separation distance within the tolerance, m; 0 when something penetrates, `None` without contacts.
    pub smallest_distance: Option<f64>,
    /// Largest depth δ, m: negative when all contacts are separated; `None` without contacts.
    pub deepest: Option<f64>,
    /// Pairs of nodes that were looked at, those that the bodies' motion had woken and what they were split into, with
    /// their bounding spheres within reach.
    pub visited: usize,
    /// Size of the front of the bounding volume test tree (§3.4.2): pairs at which the descent ended, being out of
    /// reach, or examined for contacts.
    pub front: usize,
    /// Pairs among them that were examined for contacts: of leaves, or of nodes whose missing detail is below the
    /// threshold.
    pub leaf_pairs: usize,
    /// Convex queries made, pairs of triangles included.
    pub convex_queries: usize,
    /// Convex queries whose answer may be off by more than the precision. Such pairs are never dropped.
    pub not_converged: usize,
    /// Pairs of patches that had to be decided triangle by triangle.
    pub by_triangles: usize,
    /// Most pairs that waited on the stack at once.
    pub stack_high_water: usize,
    /// Most pairs, on and above the front, that were kept at once, by this query or any before.
    pub front_high_water: usize,
    /// Whether there were more pairs than [`MAX_PAIRS`], so that the front is not kept as a whole. The answer is the
    /// same, but the next query starts higher up.
    pub front_overflow: bool,
    /// Whether a time-critical query had to stop before all was fine enough.
    pub out_of_budget: bool,
    /// Largest s*/s₀ that a time-critical query stopped at; where s₀ is 0, it only tells that it did.
    pub worst_deviation: f64,
    /// Number of contacts that were dropped because there were more than [`MAX_CONTACTS`]. Each is shallower than half
    /// of that many that are reported, which are then in no particular order. Ask for a smaller tolerance.
    pub dropped: usize,
    /// Whether a buffer grew during this query: it was larger than any before.
    pub reallocated: bool,
}

/// The workspace of a contact query. It belongs to the pair of objects that it was made for, and keeps the front of the
/// last query, from which the next one starts: keep one workspace for a pair of objects, and run it at pose after pose.
///
/// ```
/// use palpate_collide::{ContactQuery, QueryError, QuerySettings, Shape};
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
/// // An octahedron, 50 mm from centre to tip, comes down on a cube whose top is at z = 100 mm.
/// let mut query = ContactQuery::new(&octahedron, &cube);
/// let settings = QuerySettings::new(0.002);
/// let at = |height: f64| Pose::from_translation(DVec3::new(0.04, 0.05, 0.15 + height));
/// for step in 0..100 {
///     let height = 0.005 - 1e-4 * f64::from(step);
///     let outcome = query.run(&at(height), &Pose::IDENTITY, &settings)?;
///     match outcome.deepest {
///         None => assert!(height > 0.002, "no contact within the tolerance"),
///         Some(depth) => assert!((depth + height).abs() < 1e-9),
///     }
/// }
///
/// // What a query cannot do is an error, and the next query works again.
/// let most = octahedron.max_tolerance();
/// let refused = query.run(&at(0.0), &Pose::IDENTITY, &QuerySettings::new(1.0));
/// assert_eq!(refused, Err(QueryError::Tolerance { given: 1.0, most }));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct ContactQuery {
    bodies: Bodies,
    front: Front,
    motion: Motion,
    /// Of the last query.
    last: Option<QuerySettings>,
    /// Pairs on the way: slots of the front, entered or [left](LEAVE), with the weight of their contacts.
    stack: Vec<(u32, f64)>,
    /// Pairs that the front has no room for, likewise.
    unrecorded: Vec<(u32, u32, f64)>,
    /// Pairs on the way of a time-critical query.
    urgent: BinaryHeap<Urgent>,
    pace: Pace,
    leaf: LeafQuery,
    deferred: Deferred,
    contacts: Vec<PatchContact>,
    outcome: QueryOutcome,
}

/// Marks a pair on the stack below which all has been looked at.
const LEAVE: u32 = 1 << 31;

/// The circumstances of a query.
#[derive(Clone, Copy, Debug)]
struct Circumstances {
    placement: Placement,
    probe_pose: Pose,
    settings: QuerySettings,
    /// Of coordinates, m.
    rounding: f64,
    /// How far a hull may stand off the surface that it was built for, on either body, m.
    looseness: f64,
    /// How far the bodies have moved, m.
    way: f64,
    /// How far they have turned, rad.
    turn: f64,
    /// Full resolution.
    exact: bool,
    /// s₀ where it is the same everywhere, m.
    constant: Option<f64>,
    /// Part of s₀ over which contacts go over from one resolution to the next.
    band: f64,
    /// The threshold is, or may be, another one than it was.
    threshold_changed: bool,
    /// Pairs are examined at once, after the descent.
    parallel: bool,
}

impl ContactQuery {
    /// A workspace for queries between two objects.
    pub fn new(probe: &Shape, scene: &Shape) -> Self {
        Self::with_capacity(probe, scene, CONTACTS, PAIRS)
    }

    /// A workspace that has room for a number of contacts, and of pairs of nodes on and above the front, at first.
    pub fn with_capacity(probe: &Shape, scene: &Shape, contacts: usize, pairs: usize) -> Self {
        let (probe, scene) = (probe.clone(), scene.clone());
        let width = probe.path_width() + scene.path_width() + 1;
        Self {
            front: Front::with_capacity(pairs.clamp(1, MAX_PAIRS), MAX_PAIRS),
            motion: Motion::default(),
            last: None,
            stack: Vec::with_capacity(2 * width),
            unrecorded: Vec::with_capacity(width),
            // No more wait than are kept.
            urgent: BinaryHeap::with_capacity(pairs),
            pace: Pace::default(),
            leaf: LeafQuery::default(),
            deferred: Deferred::default(),
            contacts: Vec::with_capacity(contacts),
            outcome: QueryOutcome::default(),
            bodies: Bodies { probe, scene },
        }
    }

    /// Bytes of memory held by the workspace.
    pub fn bytes(&self) -> usize {
        self.front.bytes()
            + self.stack.capacity() * size_of::<(u32, f64)>()
            + self.unrecorded.capacity() * size_of::<(u32, u32, f64)>()
            + self.urgent.capacity() * size_of::<Urgent>()
            + self.leaf.bytes()
            + self.deferred.bytes()
            + self.contacts.capacity() * size_of::<PatchContact>()
    }

    /// Forgets the front: the next query starts from the roots.
    pub fn reset(&mut self) {
        self.last = None;
    }

    /// Finds the contacts between the probe and the scene object at the given poses (object frame to world).
    ///
    /// The cost grows with the number of pairs of patches within the tolerance, and with the way that the objects have
    /// come since the last query.
    ///
    /// # Errors
    /// If a pose is not valid, or the tolerance or an error metric is out of bounds. There are no
    /// contacts then, and the next query goes on from the last one that succeeded.
    pub fn run(
        &mut self,
        probe_pose: &Pose,
        scene_pose: &Pose,
        settings: &QuerySettings,
    ) -> Result<QueryOutcome, QueryError> {
        self.contacts.clear();
        self.outcome = QueryOutcome::default();
        check_placed(probe_pose, QueryObject::Probe)?;
        check_placed(scene_pose, QueryObject::Scene)?;
        settings.check(&self.bodies.probe)?;
        let now = self.circumstances(probe_pose, scene_pose, settings);
        let buffers = self.buffers();
        self.leaf.counts = Counts::default();
        match settings.budget {
            None => {
                self.traverse(&now);
                if now.parallel {
                    self.examine_deferred(&now);
                }
            }
            Some(budget) => self.traverse_within(budget, &now),
        }
        self.outcome.front += self.front.len();
        self.outcome.front_high_water = self.front.high_water();
        let Counts { visited, leaf_pairs, convex_queries, not_converged, by_triangles } = self.leaf.counts;
        self.outcome =
            QueryOutcome { visited, leaf_pairs, convex_queries, not_converged, by_triangles, ..self.outcome };
        self.outcome.reallocated = self.buffers() != buffers;
        Ok(self.outcome)
    }

    fn buffers(&self) -> [usize; 7] {
        let Self { leaf, contacts, stack, unrecorded, urgent, front, deferred, .. } = self;
        [
            stack.capacity(),
            unrecorded.capacity(),
            urgent.capacity(),
            leaf.bytes(),
            contacts.capacity(),
            front.capacity(),
            deferred.bytes(),
        ]
    }

    /// Notes how the bodies have moved, and whether what is kept of the last query still holds.
    fn circumstances(
        &mut self,
        probe_pose: &Pose,
        scene_pose: &Pose,
        settings: &QuerySettings,
    ) -> Circumstances {
        let placement = Placement::between(probe_pose, scene_pose);
        let Bodies { probe, scene } = &self.bodies;
        let balls = [probe.ball(), scene.ball()];
        let coordinates =
            probe.coordinates() + scene.coordinates() + placement.translation.abs().max_element();
        let rounding = COORDINATE_ROUNDING * coordinates;
        let radii = probe.clod().bounding_radius() + scene.clod().bounding_radius();
        let built_to = probe.clod().source.tolerance.max(scene.clod().source.tolerance);
        let mut threshold_changed = false;
        match self.last {
            Some(last) => {
                self.motion.step(&balls[0], &balls[1], &placement, rounding);
                self.motion.add((settings.tolerance - last.tolerance).abs());
                threshold_changed = last.error != settings.error
                    || !settings.error.is_constant()
                    || last.interpolate != settings.interpolate;
                // At full resolution other bodies are split than with a threshold.
                if last.error.is_exact() != settings.error.is_exact() {
                    self.start(settings.error.is_exact());
                }
            }
            None => {
                self.motion.reset();
                self.motion.step(&balls[0], &balls[1], &placement, rounding);
                self.start(settings.error.is_exact());
            }
        }
        self.last = Some(*settings);
        // Before rounding tells.
        let way = self.motion.way();
        if way > PAIR_MOTION_LIMIT * radii || way.is_nan() {
            self.motion.restart();
            if way.is_finite() {
                self.front.rebase(way);
            } else {
                self.start(settings.error.is_exact());
            }
        }
        Circumstances {
            placement,
            probe_pose: *probe_pose,
            settings: *settings,
            rounding,
            looseness: 2.0 * built_to * radii,
            way: self.motion.way(),
            turn: self.motion.turn(),
            exact: settings.error.is_exact(),
            constant: settings.error.is_constant().then(|| settings.error.threshold(DVec3::ZERO, probe_pose)),
            band: if settings.interpolate { BAND } else { 0.0 },
            threshold_changed,
            parallel: settings.parallel && settings.budget.is_none(),
        }
    }

    /// Starts anew from the roots.
    fn start(&mut self, exact: bool) {
        let [a, b] =
            [&self.bodies.probe, &self.bodies.scene].map(|shape| shape.pass_through(Clod::ROOT, exact));
        self.front.reset(Pair::new(a, b));
    }

    /// Looks at all pairs that are awake, depth first.
    fn traverse(&mut self, now: &Circumstances) {
        self.stack.push((Front::ROOT, 1.0));
        while let Some((entry, weight)) = self.stack.pop() {
            if entry & LEAVE != 0 {
                self.leave(entry ^ LEAVE, now);
                continue;
            }
            let Some(share) = self.enter(entry, weight, now) else { continue };
            // Pairs that are examined later may keep it awake.
            if !now.parallel {
                self.stack.push((entry | LEAVE, weight));
            }
            let from = self.stack.len();
            let awake = self.front.below(entry).filter(|child| !self.front.sleeps(*child, now));
            self.stack.extend(awake.map(|child| (child, weight * share)));
            self.stack[from..].reverse();
            self.outcome.stack_high_water = self.outcome.stack_high_water.max(self.stack.len());
        }
    }

    /// Puts all split pairs to sleep that may, when they were not left one by one.
    fn leave_all(&mut self, now: &Circumstances) {
        self.stack.push((Front::ROOT, 1.0));
        while let Some((entry, weight)) = self.stack.pop() {
            if entry & LEAVE != 0 {
                self.leave(entry ^ LEAVE, now);
                continue;
            }
            if !self.front.is_split(entry) || self.front.sleeps(entry, now) {
                continue;
            }
            self.stack.push((entry | LEAVE, weight));
            self.stack.extend(self.front.below(entry).map(|child| (child, weight)));
        }
    }

    /// Looks at a pair if it is awake, and splits it if it is to be refined. Then: how much of its contact is left to the
    /// pairs that it is split into.
    fn enter(&mut self, slot: u32, weight: f64, now: &Circumstances) -> Option<f64> {
        if self.front.sleeps(slot, now) {
            return None;
        }
        if let Some(share) = self.front.settled_share(slot, now) {
            return Some(share);
        }
        let mut pair = self.front.get(slot);
        let mut verdict = self.bodies.look_at(&mut pair, now, &mut self.leaf);
        if verdict == Verdict::Examine && now.parallel {
            self.deferred.defer(slot, pair, weight);
            pair.wake = f64::NEG_INFINITY;
        } else {
            verdict = self.examined(verdict, &mut pair, weight, now);
        }
        if verdict != Verdict::Refine {
            self.front.join(slot);
            self.front.set(slot, pair);
            return None;
        }
        self.front.set(slot, pair);
        if !pair.split {
            let into = self.bodies.below(pair, now.exact).rev();
            if !self.front.split(slot, into) {
                self.outcome.front_overflow = true;
                self.front.set_wake(slot, f64::NEG_INFINITY);
                self.descend(&pair, weight * pair.share, now);
                return None;
            }
        }
        Some(pair.share)
    }

    /// All pairs below have been looked at: how long may they sleep, or are they too far apart to be told from one
    /// another?
    fn leave(&mut self, slot: u32, now: &Circumstances) {
        let (mut wake, mut quiet) = (f64::INFINITY, true);
        for child in self.front.below(slot) {
            wake = wake.min(self.front.wake(child));
            quiet &= !self.front.is_split(child);
        }
        if wake > now.way {
            let (settled, within) = self.front.settled_and_within(slot);
            wake = wake.min(settled);
            if quiet && now.way >= within && self.raise(slot, wake, now) {
                return;
            }
        }
        self.front.set_wake(slot, wake);
    }

    /// Joins the pairs below one that sleep until `wake`, if that is long and the pair's bounding hulls are out of reach.
    fn raise(&mut self, slot: u32, wake: f64, now: &Circumstances) -> bool {
        let pair = self.front.get(slot);
        if wake <= now.way + RAISE * self.bodies.radii(&pair) {
            return false;
        }
        let mut raised = pair;
        let apart = self.bodies.is_apart(&mut raised, now, &mut self.leaf);
        if apart {
            self.front.join(slot);
            self.front.set(slot, raised);
        } else {
            self.front.set(slot, Pair { within: raised.within, ..pair });
        }
        apart
    }

    /// Looks at all below a pair, of which nothing is kept.
    fn descend(&mut self, pair: &Pair, weight: f64, now: &Circumstances) {
        self.unrecorded.clear();
        let below = |pair: Pair, weight: f64| move |child: Pair| (child.a, child.b, weight * pair.share);
        self.unrecorded.extend(self.bodies.below(*pair, now.exact).rev().map(below(*pair, weight)));
        while let Some((a, b, weight)) = self.unrecorded.pop() {
            let mut pair = Pair::new(a, b);
            let verdict = self.bodies.look_at(&mut pair, now, &mut self.leaf);
            if self.examined(verdict, &mut pair, weight, now) == Verdict::Refine {
                self.unrecorded.extend(self.bodies.below(pair, now.exact).rev().map(below(pair, weight)));
            } else {
                self.outcome.front += 1;
            }
        }
        // The pair itself is counted among those that are kept.
        self.outcome.front -= 1;
    }

    /// What becomes of a pair, after it has been examined if need be.
    fn examined(&mut self, verdict: Verdict, pair: &mut Pair, weight: f64, now: &Circumstances) -> Verdict {
        if !matches!(verdict, Verdict::Examine | Verdict::Ask) {
            return verdict;
        }
        let verdict = self.bodies.examine(pair, verdict == Verdict::Ask, now, &mut self.leaf);
        let weight = weight * (1.0 - pair.share);
        if now.parallel {
            self.deferred.report(*pair, weight, &self.leaf.contacts);
        } else {
            let Self { leaf, contacts, outcome, .. } = self;
            leaf.contacts.iter().for_each(|contact| report(contacts, outcome, contact, pair, weight, now));
        }
        verdict
    }

    /// Examines the pairs that wait for it.
    fn examine_deferred(&mut self, now: &Circumstances) {
        let Self { bodies, deferred, leaf, front, contacts, outcome, .. } = self;
        deferred.run(bodies, now, leaf);
        for (task, found) in deferred.found() {
            if let Some(slot) = task.slot {
                front.set(slot, task.pair);
            }
            for contact in found {
                report(contacts, outcome, contact, &task.pair, task.weight, now);
            }
        }
        deferred.clear();
        self.leave_all(now);
    }

    /// The contacts of the last query, in world axes, in the order of the descent.
    pub fn contacts(&self) -> &[PatchContact] {
        &self.contacts
    }
}

impl QueryOutcome {
    fn count(&mut self, contact: &Contact) {
        self.contacts += 1;
        let distance = contact.distance();
        self.smallest_distance = Some(self.smallest_distance.map_or(distance, |d| d.min(distance)));
        self.deepest = Some(self.deepest.map_or(contact.depth, |d| d.max(contact.depth)));
    }
}

/// Whether an object can be queried at a pose.
pub(crate) fn check_placed(pose: &Pose, object: QueryObject) -> Result<(), QueryError> {
    if pose.is_valid() { Ok(()) } else { Err(QueryError::Pose { object }) }
}

/// Adds a contact of a pair, given in the probe's frame, to what is reported.
fn report(
    contacts: &mut Vec<PatchContact>,
    outcome: &mut QueryOutcome,
    contact: &Contact,
    pair: &Pair,
    weight: f64,
    now: &Circumstances,
) {
    outcome.count(contact);
    if contacts.len() == MAX_CONTACTS {
        outcome.dropped += drop_shallower_half(contacts);
    }
    let contact = placed(contact, &now.probe_pose);
    contacts.push(PatchContact { contact, probe_node: pair.a, scene_node: pair.b, weight });
}

/// Keeps the deeper half of some contacts, in no particular order. Returns how many are dropped. Does not allocate.
fn drop_shallower_half(contacts: &mut Vec<PatchContact>) -> usize {
    let kept = contacts.len() / 2;
    contacts.select_nth_unstable_by(kept, |x, y| y.contact.depth.total_cmp(&x.contact.depth));
    let dropped = contacts.len() - kept;
    contacts.truncate(kept);
    dropped
}

/// A contact in a body's frame, in world axes.
pub(crate) fn placed(contact: &Contact, pose: &Pose) -> Contact {
    Contact {
        point: pose.transform_point(contact.point),
        scene_point: pose.transform_point(contact.scene_point),
        normal: pose.transform_vector(contact.normal),
        depth: contact.depth,
    }
}
