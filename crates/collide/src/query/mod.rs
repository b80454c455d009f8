//! The contact query Q(A, B, d) between two hierarchies (§3.4.1, §3.4.2).
//!
//! Both hierarchies are descended in tandem. A pair of nodes stays where it is when its bounding spheres, or then its
//! hulls, are further apart than d + h(a) + h(b) (Eq. 3.5); otherwise one of them is split, down to pairs whose missing
//! detail is below the threshold s₀ ([`refinement`]), and those are asked for contacts. Of nodes with such a threshold the one with the coarser children is split (§3.4.2). At full resolution, where s₀ is 0, it is
//! the larger one, down to pairs of leaves. As §3.4.1 has it, they are a superset of the local minima of the distance
//! where the objects are disjoint, and local penetration depths where they overlap. Only surfaces that meet make
//! contacts: an object that has sunk wholly into another, deeper than that one's patches are thick, has none.
//!
//! A query starts from the [front] of the last one (§3.4.2), raised and lowered in place. The answer is
//! that of a query from the roots: a pair is only passed over while the bodies have not moved enough to change its
//! answer, and searches that start from old nearest points find the same ones.
//!
//! With a threshold, what is reported are contacts between the surfaces of coarser levels, each within s of the mesh.
//! Contacts can go over from one level to the next as s* nears s₀ (§3.4.4), and a time-critical query refines the pairs
//! with the largest s*/s₀ first, until its budget is spent.
//!
//! Departures: hulls of many points are not tested above the leaves; hull queries there only decide whether a pair is
//! within reach, and stop as soon as either bound on the distance settles it; nodes with a single child are passed
//! through, as long as they are to be refined anyway. In §3.4.2 every node of the front is tested in every query.

mod front;
mod leaf;
mod metrics;
mod overlap;
mod parting;
pub(crate) mod refinement;
mod thinning;

use std::cmp::Ordering;
use std::collections::BinaryHeap;
use std::ops::Range;
use std::time::{Duration, Instant};

use palpate_core::glam::DVec3;
use palpate_core::{Clod, Contact, Pose};

use self::front::{Front, Nearest, Pair};
use self::leaf::{LeafQuery, Reach};
use self::parting::Parting;
use self::refinement::{Refine, refine, refined_share, urgency, weighted_deviation};
use self::thinning::{LEAST_ROOM, thin};
use crate::convex::{Limits, Placement, Separation, Start, gjk};
use crate::motion::Motion;
use crate::shape::Shape;

pub use self::metrics::{Combination, ErrorMetrics, VelocityMetric, ViewMetric};

/// Separations and depths are found to this fraction of the size of the hulls involved.
const PRECISION: f64 = 1e-12;

/// Contacts that a new workspace has room for.
const CONTACTS: usize = 1 << 14;

/// Hulls of more points than this are not tested above the leaves, but split at once: they belong to the upper free
/// levels, where they overlap nearly always, and a support point of theirs costs more than the spheres of their
/// children.
const HULL_TEST_POINTS: usize = 256;

/// Pairs of nodes that a new workspace has room for.
const PAIRS: usize = 1 << 15;

/// The way after which it is counted anew, in radii of the bodies.
const LONG_WAY: f64 = 1e3;

/// What examining a pair is expected to take before it has been measured, s; and queries over which that is averaged.
const PACE: f64 = 1e-6;
const PACE_MEMORY: f64 = 8.0;

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
    /// d: surfaces closer than this are in contact, m. Not negative.
    pub tolerance: f64,
    /// Never allocate for contacts or pairs of nodes: when the reserved room is full, near contacts are merged, the
    /// deepest of them standing for the others ([`QueryOutcome::overflow`]), and pairs that there is no room for are gone
    /// through without being kept ([`QueryOutcome::front_overflow`]). Otherwise (the default) the buffer grows, and [`QueryOutcome::reallocated`] says so.
    pub fixed_capacity: bool,
    /// How far hulls may stand off the surface that they were built for, as a fraction of an object's bounding radius:
    /// the builder's tolerance. Where this much could decide about a contact, the triangles do.
    pub patch_tolerance: f64,
    /// s₀: detail is left out where its deviation, averaged over the area of contact (s*, Eq. 3.7), is no more than
    /// this. [Exact](ErrorMetrics::EXACT) for full resolution.
    pub error: ErrorMetrics,
    /// Where s* nears s₀, report the contacts of the coarser and of the finer patches, with
    /// [weights](PatchContact::weight) that go over from one to the other (§3.4.4).
    pub interpolate: bool,
    /// Time-critical: refine in the order of s*/s₀, and stop when this is spent ([`QueryOutcome::out_of_budget`]).
    pub budget: Option<Budget>,
}

/// What a time-critical query may cost. Pairs above the coarsest level that is not free have to be gone through in any
/// case, and every pair that the query stops at costs one convex query more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Budget {
    /// Time.
    Time(Duration),
    /// Convex queries.
    Queries(usize),
}

impl QuerySettings {
    /// Settings with a tolerance (d, m) and defaults for the rest.
    pub fn new(tolerance: f64) -> Self {
        Self {
            tolerance,
            fixed_capacity: false,
            patch_tolerance: 1e-6,
            error: ErrorMetrics::EXACT,
            interpolate: false,
            budget: None,
        }
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
    /// Contacts found, whether or not there was room for them.
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
    /// Whether there was no room to keep the whole front. The answer is the same, but the next query starts higher up.
    pub front_overflow: bool,
    /// Whether a time-critical query had to stop before all was fine enough.
    pub out_of_budget: bool,
    /// Largest s*/s₀ that a time-critical query stopped at; where s₀ is 0, it only tells that it did.
    pub worst_deviation: f64,
    /// Whether contacts were merged for want of room: [`ContactQuery::reserve`] more.
    pub overflow: bool,
    /// Side of the cubes, m, of which each holds one contact for every octant that normals point to, if contacts were
    /// merged.
    pub merged_within: f64,
    /// Whether a buffer grew during this query: it was larger than any before.
    pub reallocated: bool,
    /// The query was refused, and nothing was found: a pose, the tolerance or the error is not finite, one of the latter
    /// is negative, or an object has no nodes.
    pub refused: bool,
}

/// The workspace of a contact query. It belongs to the pair of objects that it was made for, and keeps the front of the
/// last query, from which the next one starts.
#[derive(Clone, Debug)]
pub struct ContactQuery {
    probe: Shape,
    scene: Shape,
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
    /// What it took lately to examine a pair for want of time, s.
    pace: f64,
    leaf: LeafQuery,
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
}

/// A pair on the way of a time-critical query.
#[derive(Clone, Copy, Debug)]
struct Urgent {
    /// s*/s₀.
    deviation: f64,
    slot: u32,
    weight: f64,
}

impl Ord for Urgent {
    fn cmp(&self, other: &Self) -> Ordering {
        self.deviation.total_cmp(&other.deviation).then(other.slot.cmp(&self.slot))
    }
}

impl PartialOrd for Urgent {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Urgent {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Urgent {}

/// What becomes of a pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    /// It stays on the front, or comes back to it.
    Stop,
    /// It is split.
    Refine,
}

impl ContactQuery {
    /// A workspace for queries between two objects.
    pub fn new(probe: &Shape, scene: &Shape) -> Self {
        Self::with_capacity(probe, scene, CONTACTS, PAIRS)
    }

    /// A workspace with room for a number of contacts, and of pairs of nodes on and above the front.
    pub fn with_capacity(probe: &Shape, scene: &Shape, contacts: usize, pairs: usize) -> Self {
        let (probe, scene) = (probe.clone(), scene.clone());
        let width = probe.path_width() + scene.path_width() + 1;
        Self {
            front: Front::with_capacity(pairs.clamp(1, LEAVE as usize)),
            motion: Motion::default(),
            last: None,
            stack: Vec::with_capacity(2 * width),
            unrecorded: Vec::with_capacity(width),
            // No more wait than are kept.
            urgent: BinaryHeap::with_capacity(pairs),
            pace: PACE,
            leaf: LeafQuery::default(),
            contacts: Vec::with_capacity(contacts.max(LEAST_ROOM)),
            outcome: QueryOutcome::default(),
            probe,
            scene,
        }
    }

    /// Makes room for a number of contacts, so that queries with up to as many do not allocate for them.
    pub fn reserve(&mut self, contacts: usize) {
        self.contacts.reserve(contacts.saturating_sub(self.contacts.len()));
    }

    /// Bytes of memory held by the workspace.
    pub fn bytes(&self) -> usize {
        self.front.bytes()
            + self.stack.capacity() * size_of::<(u32, f64)>()
            + self.unrecorded.capacity() * size_of::<(u32, u32, f64)>()
            + self.urgent.capacity() * size_of::<Urgent>()
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
    pub fn run(&mut self, probe_pose: &Pose, scene_pose: &Pose, settings: &QuerySettings) -> QueryOutcome {
        self.contacts.clear();
        self.outcome = QueryOutcome::default();
        let asked = settings.tolerance.is_finite() && settings.tolerance >= 0.0 && settings.error.is_valid();
        let valid = probe_pose.is_valid() && scene_pose.is_valid();
        if !valid || !asked || self.probe.is_empty() || self.scene.is_empty() {
            self.outcome.refused = true;
            return self.outcome;
        }
        let now = self.circumstances(probe_pose, scene_pose, settings);
        let buffers = self.buffers();
        (self.leaf.convex_queries, self.leaf.not_converged, self.leaf.by_triangles) = (0, 0, 0);
        match settings.budget {
            None => {
                self.stack.push((Front::ROOT, 1.0));
                self.traverse(&now);
            }
            Some(budget) => self.traverse_within(budget, &now),
        }
        self.outcome.front += self.front.len();
        self.outcome.front_high_water = self.front.high_water();
        self.outcome.convex_queries += self.leaf.convex_queries;
        self.outcome.not_converged = self.leaf.not_converged;
        self.outcome.by_triangles = self.leaf.by_triangles;
        self.outcome.reallocated = self.buffers() != buffers;
        self.outcome
    }

    fn buffers(&self) -> [usize; 6] {
        let Self { leaf, contacts, stack, unrecorded, urgent, front, .. } = self;
        let waiting = [stack.capacity(), unrecorded.capacity(), urgent.capacity()];
        [waiting[0], waiting[1], waiting[2], leaf.capacity(), contacts.capacity(), front.capacity()]
    }

    /// Notes how the bodies have moved, and whether what is kept of the last query still holds.
    fn circumstances(
        &mut self,
        probe_pose: &Pose,
        scene_pose: &Pose,
        settings: &QuerySettings,
    ) -> Circumstances {
        let placement = Placement::between(probe_pose, scene_pose);
        let coordinates =
            self.probe.coordinates() + self.scene.coordinates() + placement.translation.abs().max_element();
        let rounding = 4.0 * f64::EPSILON * coordinates;
        let radii = self.probe.clod().bounding_radius() + self.scene.clod().bounding_radius();
        let mut threshold_changed = false;
        match self.last.filter(|last| last.patch_tolerance == settings.patch_tolerance) {
            Some(last) => {
                self.motion.step(&self.probe.ball(), &self.scene.ball(), &placement, rounding);
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
                self.motion.step(&self.probe.ball(), &self.scene.ball(), &placement, rounding);
                self.start(settings.error.is_exact());
            }
        }
        self.last = Some(*settings);
        // Before rounding tells.
        let way = self.motion.way();
        if way > LONG_WAY * radii || way.is_nan() {
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
            looseness: 2.0 * settings.patch_tolerance.max(0.0) * radii,
            way: self.motion.way(),
            turn: self.motion.turn(),
            exact: settings.error.is_exact(),
            constant: settings.error.is_constant().then(|| settings.error.threshold(DVec3::ZERO, probe_pose)),
            band: if settings.interpolate { BAND } else { 0.0 },
            threshold_changed,
        }
    }

    /// Starts anew from the roots.
    fn start(&mut self, exact: bool) {
        let [a, b] = [&self.probe, &self.scene].map(|shape| shape.pass_through(Clod::ROOT, exact));
        self.front.reset(Pair::new(a, b));
    }

    /// Looks at all pairs below those on the stack that are awake, depth first.
    fn traverse(&mut self, now: &Circumstances) {
        while let Some((entry, weight)) = self.stack.pop() {
            if entry & LEAVE != 0 {
                self.leave(entry ^ LEAVE, now);
                continue;
            }
            let Some(share) = self.enter(entry, weight, now) else { continue };
            self.stack.push((entry | LEAVE, weight));
            let from = self.stack.len();
            // When the threshold has changed, how long pairs may sleep does not tell whether they do.
            let (way, all) = (now.way, now.threshold_changed);
            let awake = self.front.below(entry).filter(|child| all || self.front.wake(*child) <= way);
            self.stack.extend(awake.map(|child| (child, weight * share)));
            self.stack[from..].reverse();
            self.outcome.stack_high_water = self.outcome.stack_high_water.max(self.stack.len());
        }
    }

    /// Looks at pairs that are awake in the order of s*/s₀, as far as the budget goes. What is left then is examined as it
    /// is.
    fn traverse_within(&mut self, budget: Budget, now: &Circumstances) {
        let begun = Instant::now();
        self.urgent.clear();
        self.urgent.push(Urgent { deviation: f64::INFINITY, slot: Front::ROOT, weight: 1.0 });
        // Pairs that wait, and could be examined as they are.
        let roots = self.front.get(Front::ROOT);
        let mut waiting = usize::from(self.is_reportable(roots.a, roots.b));
        let mut stopped: Option<Instant> = None;
        let mut examined = 0;
        while let Some(Urgent { deviation, slot, weight }) = self.urgent.pop() {
            let pair = *self.front.get(slot);
            let reportable = self.is_reportable(pair.a, pair.b);
            waiting -= usize::from(reportable);
            if self.sleeps(slot, now) {
                continue;
            }
            if reportable && deviation > 1.0 && self.is_spent(budget, begun, waiting) {
                stopped = stopped.or_else(|| Some(Instant::now()));
                examined += 1;
                self.outcome.out_of_budget = true;
                self.outcome.worst_deviation = self.outcome.worst_deviation.max(deviation);
                self.examine(&mut { pair }, false, weight, now);
                continue;
            }
            let Some(share) = self.enter(slot, weight, now) else { continue };
            for child in self.front.below(slot) {
                let Pair { a, b, .. } = *self.front.get(child);
                let (detail_a, detail_b) = (self.probe.detail(a), self.scene.detail(b));
                let deviation = urgency(detail_a, detail_b, self.threshold(a, b, now));
                self.urgent.push(Urgent { deviation, slot: child, weight: weight * share });
                waiting += usize::from(self.is_reportable(a, b));
            }
            self.outcome.stack_high_water = self.outcome.stack_high_water.max(self.urgent.len());
        }
        if let Some(stopped) = stopped {
            let pace = stopped.elapsed().as_secs_f64() / f64::from(examined);
            self.pace += (pace - self.pace) / PACE_MEMORY;
        }
        self.leave_all(now);
    }

    /// Whether contacts of a pair can be reported.
    fn is_reportable(&self, a: u32, b: u32) -> bool {
        !self.probe.detail(a).is_free() && !self.scene.detail(b).is_free()
    }

    /// Whether a budget is spent, but for examining the pairs that wait.
    fn is_spent(&self, budget: Budget, begun: Instant, waiting: usize) -> bool {
        let made = self.outcome.convex_queries + self.leaf.convex_queries;
        match budget {
            Budget::Queries(queries) => made + waiting >= queries,
            Budget::Time(time) => {
                begun.elapsed().as_secs_f64() + waiting as f64 * self.pace >= time.as_secs_f64()
            }
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
            if !self.front.is_split(entry) || self.sleeps(entry, now) {
                continue;
            }
            self.stack.push((entry | LEAVE, weight));
            self.stack.extend(self.front.below(entry).map(|child| (child, weight)));
        }
    }

    /// Whether a pair's answer cannot have changed.
    fn sleeps(&self, slot: u32, now: &Circumstances) -> bool {
        self.front.wake(slot) > now.way && (!now.threshold_changed || self.front.get(slot).apart)
    }

    /// Looks at a pair if it is awake, and splits it if it is to be refined. Then: how much of its contact is left to the
    /// pairs that it is split into.
    fn enter(&mut self, slot: u32, weight: f64, now: &Circumstances) -> Option<f64> {
        if self.sleeps(slot, now) {
            return None;
        }
        let mut pair = *self.front.get(slot);
        let settled = pair.split && pair.settled > now.way && !now.threshold_changed;
        let verdict = if settled { Verdict::Refine } else { self.look_at(&mut pair, weight, now) };
        if verdict == Verdict::Stop {
            self.front.join(slot);
            self.front.set(slot, pair);
            return None;
        }
        self.front.set(slot, pair);
        if !pair.split {
            let (of_probe, children) = self.children(pair.a, pair.b, now.exact);
            let (probe, scene) = (&self.probe, &self.scene);
            let into = children.rev().map(|child| {
                if of_probe {
                    Pair::new(probe.pass_through(child, now.exact), pair.b)
                } else {
                    Pair::new(pair.a, scene.pass_through(child, now.exact))
                }
            });
            if !self.front.split(slot, into, !now.settings.fixed_capacity) {
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
            let pair = *self.front.get(slot);
            wake = wake.min(pair.settled);
            let radii = self.probe.node(pair.a).radius + self.scene.node(pair.b).radius;
            if quiet && wake > now.way + RAISE * radii && now.way >= pair.within {
                let mut raised = pair;
                if self.is_apart(&mut raised, now) {
                    self.front.join(slot);
                    self.front.set(slot, raised);
                    return;
                }
                self.front.set(slot, Pair { within: raised.within, ..pair });
            }
        }
        self.front.set_wake(slot, wake);
    }

    /// Looks at all below a pair, of which nothing is kept.
    fn descend(&mut self, pair: &Pair, weight: f64, now: &Circumstances) {
        self.unrecorded.clear();
        self.push_children(pair.a, pair.b, weight, now.exact);
        while let Some((a, b, weight)) = self.unrecorded.pop() {
            let mut pair = Pair::new(a, b);
            if self.look_at(&mut pair, weight, now) == Verdict::Refine {
                self.push_children(a, b, weight * pair.share, now.exact);
            } else {
                self.outcome.front += 1;
            }
        }
        // The pair itself is counted among those that are kept.
        self.outcome.front -= 1;
    }

    fn push_children(&mut self, a: u32, b: u32, weight: f64, exact: bool) {
        let (of_probe, children) = self.children(a, b, exact);
        for child in children.rev() {
            self.unrecorded.push(if of_probe {
                (self.probe.pass_through(child, exact), b, weight)
            } else {
                (a, self.scene.pass_through(child, exact), weight)
            });
        }
    }

    /// The children that a pair is split into: whether they are the probe's, and which.
    fn children(&self, a: u32, b: u32, exact: bool) -> (bool, Range<u32>) {
        let (node_a, node_b) = (self.probe.node(a), self.scene.node(b));
        let (below_a, below_b) = (self.probe.detail(a).below, self.scene.detail(b).below);
        // Among free levels, and at full resolution, the larger one.
        let by_size = exact || below_a == below_b;
        let split_a = if by_size { node_a.radius >= node_b.radius } else { below_a < below_b };
        if node_b.is_leaf() || (!node_a.is_leaf() && split_a) {
            (true, node_a.first_child..node_a.last_child)
        } else {
            (false, node_b.first_child..node_b.last_child)
        }
    }

    /// Decides about a pair that is awake, and finds its contacts if it is not to be refined.
    fn look_at(&mut self, pair: &mut Pair, weight: f64, now: &Circumstances) -> Verdict {
        let (a, b) = (pair.a, pair.b);
        let leaves = self.probe.node(a).is_leaf() && self.scene.node(b).is_leaf();
        let refinement = if leaves {
            Refine::No
        } else if now.exact {
            Refine::Yes
        } else {
            refine(self.probe.detail(a), self.scene.detail(b), self.threshold(a, b, now), now.band)
        };
        pair.apart = false;
        if !pair.split && self.spheres_are_apart(pair, now) {
            return Verdict::Stop;
        }
        self.outcome.visited += 1;
        if self.are_still_apart(pair, now) {
            return Verdict::Stop;
        }
        pair.parting = None;
        if refinement == Refine::Yes {
            if !pair.split && self.is_apart(pair, now) {
                return Verdict::Stop;
            }
            pair.settled = f64::INFINITY;
            pair.share = 1.0;
            return Verdict::Refine;
        }
        let depends = refinement == Refine::Depends;
        let warm = !pair.nearest.vertices(true).is_empty();
        if depends && !warm && self.is_apart(pair, now) {
            return Verdict::Stop;
        }
        self.examine(pair, depends, weight, now)
    }

    /// Finds the contacts of a pair, unless it is to be refined, which `depends` on where its nearest points are.
    fn examine(&mut self, pair: &mut Pair, depends: bool, weight: f64, now: &Circumstances) -> Verdict {
        let (a, b) = (pair.a, pair.b);
        let tolerance = now.settings.tolerance;
        let precision = self.precision(pair, now);
        let (patch_a, patch_b) = (self.probe.patch(a), self.scene.patch(b));
        let limits = Limits { beyond: tolerance, share: SHARE, enough: -1.0, precision };
        let axis = patch_a.center - now.placement.point(patch_b.center);
        let start = Start::Vertices(pair.nearest.vertices(true), axis);
        let found = gjk::distance(&patch_a.hull, &patch_b.hull, &now.placement, start, &limits);
        self.outcome.convex_queries += 1;
        self.outcome.not_converged += usize::from(found.separation == Separation::NotConverged);
        pair.nearest = Nearest::of(&found, true);
        let beyond = found.separation == Separation::Beyond || found.distance > tolerance.max(precision);
        pair.share = 0.0;
        if depends {
            let side_a = (self.probe.detail(a), self.probe.support_areas(a));
            let side_b = (self.scene.detail(b), self.scene.support_areas(b));
            let error = self.threshold(a, b, now);
            pair.share =
                refined_share(weighted_deviation(&found, side_a, side_b, tolerance, error), now.band);
        }
        let verdict = if pair.share > 0.0 { Verdict::Refine } else { Verdict::Stop };
        // Nearest points count where there are any within the tolerance only, and hulls that overlap go on to do so until
        // they have moved by their depth.
        let settled = if beyond { found.lower - tolerance } else { found.simplex.depth() };
        let all_refined = pair.share == 1.0;
        pair.settled = if beyond || all_refined { now.way + settled } else { f64::NEG_INFINITY };
        pair.wake = f64::NEG_INFINITY;
        if all_refined {
            return verdict;
        }
        self.outcome.leaf_pairs += 1;
        if beyond {
            if verdict == Verdict::Stop {
                let nodes = [self.probe.node(a), self.scene.node(b)];
                pair.parting = Parting::of(&found, nodes, &now.placement, now.turn, true);
                pair.wake = now.way + settled;
                pair.apart = self.probe.node(a).is_leaf() && self.scene.node(b).is_leaf();
            }
            return verdict;
        }
        let reach = Reach { placement: &now.placement, tolerance, precision, looseness: now.looseness };
        self.leaf.run(&patch_a, &patch_b, &found, &reach);
        if let Some(tetrahedron) = self.leaf.tetrahedron {
            pair.nearest = Nearest::around(tetrahedron);
        }
        let weight = weight * (1.0 - pair.share);
        for contact in &self.leaf.contacts {
            self.outcome.count(contact);
            if now.settings.fixed_capacity && self.contacts.len() == self.contacts.capacity() {
                let finest = now.settings.tolerance.max(self.outcome.merged_within);
                self.outcome.merged_within = thin(&mut self.contacts, finest);
                self.outcome.overflow = true;
            }
            let contact = placed(contact, &now.probe_pose);
            self.contacts.push(PatchContact { contact, probe_node: a, scene_node: b, weight });
        }
        verdict
    }

    /// s₀ at a pair, m.
    fn threshold(&self, a: u32, b: u32, now: &Circumstances) -> f64 {
        now.constant.unwrap_or_else(|| {
            let (a, b) = (self.probe.node(a), self.scene.node(b));
            let at = if a.radius <= b.radius { a.center } else { now.placement.point(b.center) };
            now.settings.error.threshold(now.probe_pose.transform_point(at), &now.probe_pose)
        })
    }

    /// Smallest length that is told from zero, m.
    fn precision(&self, pair: &Pair, now: &Circumstances) -> f64 {
        PRECISION * (self.probe.node(pair.a).radius + self.scene.node(pair.b).radius) + now.rounding
    }

    /// d_ab, m (Eq. 3.5).
    fn reach(&self, pair: &Pair, now: &Circumstances) -> f64 {
        now.settings.tolerance + self.probe.node(pair.a).hausdorff + self.scene.node(pair.b).hausdorff
    }

    /// Whether the bounding spheres are out of reach; if so, until when.
    fn spheres_are_apart(&self, pair: &mut Pair, now: &Circumstances) -> bool {
        let (a, b) = (self.probe.node(pair.a), self.scene.node(pair.b));
        let distance = a.center.distance(now.placement.point(b.center));
        // A little slack for rounding in the spheres.
        let gap = distance * (1.0 - 1e-9) - (a.radius + b.radius) - now.settings.tolerance - now.rounding;
        if gap > 0.0 {
            pair.wake = now.way + gap;
            pair.apart = true;
        }
        gap > 0.0
    }

    /// Whether hulls that were out of reach are so still, along the same direction; if so, until when.
    fn are_still_apart(&self, pair: &mut Pair, now: &Circumstances) -> bool {
        let Some(parting) = pair.parting else { return false };
        // With another threshold, the pair may have to be split.
        if parting.of_patches && now.threshold_changed {
            return false;
        }
        let (a, b) = (self.probe.node(pair.a), self.scene.node(pair.b));
        let reach = if parting.of_patches { now.settings.tolerance } else { self.reach(pair, now) };
        let lower = parting.lower([a, b], &now.placement, now.turn, now.rounding);
        let apart = lower > reach.max(self.precision(pair, now));
        if apart {
            pair.wake = now.way + (lower - reach);
            pair.apart = !parting.of_patches || (a.is_leaf() && b.is_leaf());
        }
        apart
    }

    /// Whether the bounding hulls are out of reach; if so, until when.
    fn is_apart(&mut self, pair: &mut Pair, now: &Circumstances) -> bool {
        let (hull_a, hull_b) = (self.probe.hull(pair.a), self.scene.hull(pair.b));
        if hull_a.points().len().max(hull_b.points().len()) > HULL_TEST_POINTS {
            return false;
        }
        self.outcome.convex_queries += 1;
        let reach = self.reach(pair, now);
        let limits =
            Limits { beyond: reach, share: SHARE, enough: reach, precision: self.precision(pair, now) };
        let axis = self.probe.node(pair.a).center - now.placement.point(self.scene.node(pair.b).center);
        let start = Start::Vertices(pair.nearest.vertices(false), axis);
        let found = gjk::distance(&hull_a, &hull_b, &now.placement, start, &limits);
        let apart = found.separation == Separation::Beyond;
        if apart {
            pair.nearest = Nearest::of(&found, false);
            let nodes = [self.probe.node(pair.a), self.scene.node(pair.b)];
            pair.parting = Parting::of(&found, nodes, &now.placement, now.turn, false);
            pair.wake = now.way + (found.lower - reach);
            pair.apart = true;
        } else {
            pair.within = now.way + (reach - found.distance).max(0.0) + found.simplex.depth();
        }
        apart
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

/// A contact in a body's frame, in world axes.
pub(crate) fn placed(contact: &Contact, pose: &Pose) -> Contact {
    Contact {
        point: pose.transform_point(contact.point),
        scene_point: pose.transform_point(contact.scene_point),
        normal: pose.transform_vector(contact.normal),
        depth: contact.depth,
    }
}
