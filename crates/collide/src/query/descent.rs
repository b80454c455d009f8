//! The traversal of the front (§3.4.2): from the roots down to the pairs that are due for a test, splitting
//! and joining pairs on the way.
//!
//! A pair is due when the motion bound has reached the one stored with it, and each inner pair stores the
//! smallest of those below it: parts of the tree that are far apart cost nothing. Pairs that may have
//! contacts go to a [`Sink`], which examines them at once or later.
//!
//! Invariants: a pair on the front is not due before its `recheck_at`; a split pair is entered again when a
//! pair below it is due or its split may no longer be right; after all below it were tested, it is *left*,
//! which updates its `recheck_at` or joins the pairs below it.

use palpate_core::Clod;

use super::bodies::{Bodies, Decision};
use super::context::{Context, FrontUpdate};
use super::front::{Front, Pair};
use super::outcome::QueryOutcome;
use super::patch_query::PatchQuery;

/// Smallest validity of an answer for which pairs are joined, as a fraction of the radii of the nodes that
/// they were split from. The larger, the more pairs are kept; the smaller, the more often pairs are joined
/// and split again.
const JOIN_MARGIN: f64 = 0.05;

/// Flag of a pair on the stack below which all pairs have been tested.
const LEAVE: u32 = 1 << 31;

/// Receiver of the pairs that may have contacts.
pub(crate) trait Sink {
    /// Whether pairs are examined after the descent. The descent then does not leave the pairs that it has
    /// split, since pairs below may still be due; [`Descent::leave_all`] does.
    const DEFERS: bool;

    /// Examines a pair, now or later, and reports its contacts with a weight. `decision` is
    /// [`Examine`](Decision::Examine), or [`ExamineToDecide`](Decision::ExamineToDecide), which is answered
    /// now. `slot` is the pair's place in the front; a pair without one is examined now.
    fn examine(
        &mut self,
        decision: Decision,
        pair: &mut Pair,
        slot: Option<u32>,
        weight: f64,
        tests: (&Bodies, &Context, &mut PatchQuery),
    ) -> Decision;
}

/// The tree of pairs of two bodies, with the workspace of its traversal.
#[derive(Clone, Debug)]
pub(crate) struct Descent {
    pub bodies: Bodies,
    pub front: Front,
    pub patch_query: PatchQuery,
    /// Pairs to enter or [leave](LEAVE): slots of the front with the weight of their contacts.
    stack: Vec<(u32, f64)>,
    /// Pairs that the front has no room for: nodes with the weight of their contacts.
    untracked: Vec<(u32, u32, f64)>,
}

impl Descent {
    /// Makes the descent of two bodies, with room for a number of pairs at first and for at most `limit` in
    /// the front.
    pub fn new(bodies: Bodies, pairs: usize, limit: usize) -> Self {
        let width = bodies.probe.path_width() + bodies.scene.path_width() + 1;
        Self {
            bodies,
            front: Front::with_capacity(pairs, limit),
            patch_query: PatchQuery::default(),
            stack: Vec::with_capacity(2 * width),
            untracked: Vec::with_capacity(width),
        }
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        self.front.bytes()
            + self.stack.capacity() * size_of::<(u32, f64)>()
            + self.untracked.capacity() * size_of::<(u32, u32, f64)>()
            + self.patch_query.bytes()
    }

    /// Capacities of the buffers, which show whether one has grown.
    pub fn capacities(&self) -> [usize; 4] {
        [self.stack.capacity(), self.untracked.capacity(), self.front.capacity(), self.patch_query.bytes()]
    }

    /// Prepares for a query.
    pub fn begin(&mut self, update: FrontUpdate, exact: bool) {
        match update {
            FrontUpdate::Keep => {}
            FrontUpdate::Rebase(bound) => self.front.rebase(bound),
            FrontUpdate::Restart => {
                let Bodies { probe, scene } = &self.bodies;
                let [a, b] = [probe, scene].map(|shape| shape.pass_through(Clod::ROOT, exact));
                self.front.reset(Pair::new(a, b));
            }
        }
        self.patch_query.costs = QueryOutcome::default();
    }

    /// Adds the costs of the descent and the size of its front to an outcome.
    pub fn add_costs(&self, outcome: &mut QueryOutcome) {
        outcome.add(&self.patch_query.costs);
        outcome.front += self.front.len();
        outcome.front_high_water = self.front.high_water();
    }

    /// Tests all pairs that are due, depth first.
    pub fn run<S: Sink>(&mut self, sink: &mut S, context: &Context) {
        self.stack.push((Front::ROOT, 1.0));
        while let Some((entry, weight)) = self.stack.pop() {
            if entry & LEAVE != 0 {
                self.leave(entry ^ LEAVE, context);
                continue;
            }
            let Some(share) = self.enter(entry, weight, sink, context) else { continue };
            if !S::DEFERS {
                self.stack.push((entry | LEAVE, weight));
            }
            let from = self.stack.len();
            let due = self.front.below(entry).filter(|child| !self.front.is_valid(*child, &context.now));
            self.stack.extend(due.map(|child| (child, weight * share)));
            // The first child has to be on top.
            self.stack[from..].reverse();
            let high_water = &mut self.patch_query.costs.stack_high_water;
            *high_water = self.stack.len().max(*high_water);
        }
    }

    /// Leaves all pairs that were split, after a descent that did not leave them one by one.
    pub fn leave_all(&mut self, context: &Context) {
        self.stack.push((Front::ROOT, 1.0));
        while let Some((entry, weight)) = self.stack.pop() {
            if entry & LEAVE != 0 {
                self.leave(entry ^ LEAVE, context);
                continue;
            }
            if !self.front.is_split(entry) || self.front.is_valid(entry, &context.now) {
                continue;
            }
            self.stack.push((entry | LEAVE, weight));
            self.stack.extend(self.front.below(entry).map(|child| (child, weight)));
        }
    }

    /// Tests a pair if it is due, and splits it if it has to be refined. If it is split, returns the share of
    /// its contact that is left to the pairs below it.
    pub fn enter<S: Sink>(&mut self, slot: u32, weight: f64, sink: &mut S, context: &Context) -> Option<f64> {
        if self.front.is_valid(slot, &context.now) {
            return None;
        }
        if let Some(share) = self.front.valid_split(slot, &context.now) {
            return Some(share);
        }
        let mut pair = self.front.get(slot);
        let decision = self.test(&mut pair, Some(slot), weight, sink, context);
        if decision != Decision::Split {
            self.front.join(slot);
            self.front.set(slot, pair);
            return None;
        }
        self.front.set(slot, pair);
        if !pair.split {
            let into = self.bodies.children(pair, context.exact).rev();
            if !self.front.split(slot, into) {
                self.patch_query.costs.front_overflow = true;
                self.front.set_recheck_at(slot, f64::NEG_INFINITY);
                self.run_untracked(&pair, weight, sink, context);
                return None;
            }
        }
        Some(pair.refined_share)
    }

    /// Decides about a pair and passes it to the sink if it has to be examined.
    fn test<S: Sink>(
        &mut self,
        pair: &mut Pair,
        slot: Option<u32>,
        weight: f64,
        sink: &mut S,
        context: &Context,
    ) -> Decision {
        let Self { bodies, patch_query, .. } = self;
        match bodies.decide(pair, context, patch_query) {
            decision @ (Decision::Stop | Decision::Split) => decision,
            decision => sink.examine(decision, pair, slot, weight, (bodies, context, patch_query)),
        }
    }

    /// Leaves a split pair, after all below it have been tested. It is due again with the first of them, or
    /// when its split may no longer be right: recheck_at = min(min of the children's, split_valid_until). If
    /// none of them is split and the pair itself has come out of reach, they are joined.
    fn leave(&mut self, slot: u32, context: &Context) {
        let (mut recheck_at, mut all_on_front) = (f64::INFINITY, true);
        for child in self.front.below(slot) {
            recheck_at = recheck_at.min(self.front.recheck_at(child));
            all_on_front &= !self.front.is_split(child);
        }
        let now = context.now.motion_bound;
        if recheck_at > now {
            let (split_valid_until, overlap_valid_until) = self.front.split_and_overlap_valid_until(slot);
            recheck_at = recheck_at.min(split_valid_until);
            if all_on_front && now >= overlap_valid_until && self.join(slot, recheck_at, context) {
                return;
            }
        }
        self.front.set_recheck_at(slot, recheck_at);
    }

    /// Joins the pairs below one that is not due until `recheck_at`, if that is far enough ahead and its
    /// bounding hulls are out of reach.
    fn join(&mut self, slot: u32, recheck_at: f64, context: &Context) -> bool {
        let pair = self.front.get(slot);
        if recheck_at <= context.now.motion_bound + JOIN_MARGIN * self.bodies.radii(&pair) {
            return false;
        }
        let mut joined = pair;
        let apart = self.bodies.is_apart(&mut joined, context, &mut self.patch_query);
        if apart {
            self.front.join(slot);
            self.front.set(slot, joined);
        } else {
            let overlap_valid_until = joined.overlap_valid_until;
            self.front.set(slot, Pair { overlap_valid_until, ..pair });
        }
        apart
    }

    /// Tests all pairs below one that the front has no room for. Their answers are not kept, so all are due
    /// again in the next query.
    fn run_untracked<S: Sink>(&mut self, pair: &Pair, weight: f64, sink: &mut S, context: &Context) {
        let exact = context.exact;
        self.untracked.clear();
        let with = |weight: f64| move |child: Pair| (child.a, child.b, weight);
        self.untracked
            .extend(self.bodies.children(*pair, exact).rev().map(with(weight * pair.refined_share)));
        while let Some((a, b, weight)) = self.untracked.pop() {
            let mut pair = Pair::new(a, b);
            if self.test(&mut pair, None, weight, sink, context) == Decision::Split {
                let children = self.bodies.children(pair, exact).rev();
                self.untracked.extend(children.map(with(weight * pair.refined_share)));
            } else {
                self.patch_query.costs.front += 1;
            }
        }
        // The pair itself is already counted as part of the front.
        self.patch_query.costs.front -= 1;
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::super::context::Tracking;
    use super::super::deferred::Deferred;
    use super::super::immediate::Immediate;
    use super::super::outcome::Report;
    use super::super::settings::QuerySettings;
    use super::*;
    use crate::shape::Shape;
    use palpate_clod_build::{BuildOptions, build, unwatched};
    use palpate_core::glam::{DQuat, DVec3};
    use palpate_core::{Pose, TriMesh};

    /// A bumpy ring, 1 m from centre to centre.
    fn ring() -> Shape {
        let (around, across) = (32, 12);
        let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
        for i in 0..around {
            for j in 0..across {
                let u = f64::from(i) / f64::from(around) * TAU;
                let v = f64::from(j) / f64::from(across) * TAU;
                let radius = 0.3 + 0.03 * (5.0 * u).sin() * (2.0 * v).cos();
                let r = 1.0 + radius * v.cos();
                vertices.push(DVec3::new(r * u.cos(), r * u.sin(), radius * v.sin()));
                let at = |i: u32, j: u32| i % around * across + j % across;
                triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
                triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
            }
        }
        let mesh = TriMesh::new(vertices, triangles).unwrap();
        Shape::new(build(&mesh, &BuildOptions::default(), &mut unwatched).unwrap())
    }

    /// A query with room for a number of pairs in its front.
    struct Query(Descent, Tracking, Report);

    impl Query {
        fn new(shape: &Shape, limit: usize) -> Self {
            let bodies = Bodies { probe: shape.clone(), scene: shape.clone() };
            Self(Descent::new(bodies, 1, limit), Tracking::default(), Report::with_capacity(0))
        }

        fn run(&mut self, pose: &Pose, settings: &QuerySettings, deferred: bool) -> &Report {
            let Self(descent, tracking, report) = self;
            let shapes = [&descent.bodies.probe, &descent.bodies.scene];
            let (context, update) = tracking.advance(shapes, [pose, &Pose::IDENTITY], settings);
            report.clear();
            descent.begin(update, context.exact);
            if deferred {
                Deferred::default().run(descent, report, &context);
            } else {
                descent.run(&mut Immediate(report), &context);
            }
            descent.add_costs(&mut report.outcome);
            report
        }
    }

    /// However little room the front has, the contacts are those of a query with a complete front.
    #[test]
    fn contacts_do_not_depend_on_the_room_of_the_front() {
        let shape = ring();
        let exact = QuerySettings::new(0.05);
        let coarse = QuerySettings { error: 0.3.into(), ..exact };
        for settings in [exact, coarse, QuerySettings { interpolate: true, ..coarse }] {
            let mut whole = Query::new(&shape, usize::MAX);
            let mut cramped = [1, 2, 30, 100].map(|most| (most, Query::new(&shape, most)));
            let (mut contacts, mut overflows, mut partial) = (0, 0, 0);
            for step in 0..60 {
                let t = f64::from(step) / 60.0;
                let pose = Pose::new(DVec3::new(1.6 - t, 0.3 * t, 0.1), DQuat::from_rotation_x(t));
                let expected = whole.run(&pose, &settings, false);
                assert!(!expected.outcome.front_overflow);
                contacts += expected.contacts.len();
                partial += expected.contacts.iter().filter(|found| found.weight < 1.0).count();
                for (most, query) in &mut cramped {
                    let found = query.run(&pose, &settings, step % 2 == 1);
                    let context = format!("{settings:?}, step {step}, room for {most}: {:?}", found.outcome);
                    assert!(found.outcome.front_high_water <= *most, "{context}");
                    overflows += usize::from(found.outcome.front_overflow);
                    assert_eq!(found.contacts.len(), expected.contacts.len(), "{context}");
                    for (one, other) in found.contacts.iter().zip(&expected.contacts) {
                        assert_eq!((one.probe_node, one.scene_node), (other.probe_node, other.scene_node));
                        let off = (one.contact.depth - other.contact.depth).abs();
                        assert!(off < 1e-9 && (one.weight - other.weight).abs() < 1e-9, "{context}: {off}");
                    }
                }
            }
            assert!(contacts > 500 && overflows > 60, "{contacts} contacts, {overflows} overflows");
            assert!(!settings.interpolate || partial > 50, "{partial} contacts with a weight");
        }
    }

    /// While nothing moves nothing is tested; far apart, the front shrinks to a few pairs.
    #[test]
    fn the_front_rests_and_is_joined() {
        let shape = ring();
        let mut query = Query::new(&shape, usize::MAX);
        let settings = QuerySettings::new(0.05);
        let near = Pose::new(DVec3::new(1.9, 0.0, 0.0), DQuat::from_rotation_y(0.5));
        let first = query.run(&near, &settings, false).outcome;
        let again = query.run(&near, &settings, false).outcome;
        assert!(first.contacts > 0 && again.contacts == first.contacts);
        assert!(again.visited < first.visited && again.front == first.front, "{first:?}, {again:?}");
        let far = Pose::from_translation(DVec3::X * 10.0);
        let mut outcome = query.run(&far, &settings, false).outcome;
        assert_eq!((outcome.contacts, outcome.front), (0, 1), "{outcome:?}");
        outcome = query.run(&far, &settings, false).outcome;
        assert_eq!((outcome.visited, outcome.convex_queries), (0, 0), "{outcome:?}");
    }
}
