//! The tests of a pair of nodes: whether it is out of reach, whether it has to be split, and which contacts
//! it has. They read only the bodies and the query's context, so that several pairs may be tested at
//! once.

use std::ops::Range;

use palpate_core::glam::DVec3;

use super::context::{Context, PairContext};
use super::front::{Pair, WarmStart};
use super::patch_query::PatchQuery;
use super::refinement::{Refine, refine, refined_for, refined_share, weighted_deviation};
use super::separating_axis::SeparatingAxis;
use crate::convex::{Distance, Hull, Limits, Separation, Start, gjk};
use crate::shape::{Packed, Shape};
use crate::tolerances::{PRECISION, ROUNDING_SLACK};

/// Largest number of points of a hull that is tested above the leaves. Larger ones are split at once: they
/// belong to the upper free levels, where hulls nearly always overlap and a support point costs more than the
/// spheres of their children.
const HULL_TEST_POINTS: usize = 256;

/// Share of the separation beyond the reach that a search has to prove before it stops, 0 to 1.
/// The larger, the longer a search takes and the longer its answer is valid.
const PROVEN_SHARE: f64 = 0.5;

/// Decision about a pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Decision {
    /// The pair stays on the front, or returns to it.
    Stop,
    /// The pair is split.
    Split,
    /// The pair stays on the front, or returns to it, and is examined for contacts.
    Examine,
    /// The pair is examined, which decides whether it is split.
    ExamineToDecide,
}

/// The two bodies of a query.
#[derive(Clone, Debug)]
pub(crate) struct Bodies {
    pub probe: Shape,
    pub scene: Shape,
}

impl Bodies {
    /// Whether contacts of a pair can be reported.
    pub fn is_reportable(&self, pair: &Pair) -> bool {
        !self.probe.is_free(pair.a) && !self.scene.is_free(pair.b)
    }

    /// Sum of the nodes' radii, m.
    pub fn radii(&self, pair: &Pair) -> f64 {
        self.probe.radius(pair.a) + self.scene.radius(pair.b)
    }

    fn nodes(&self, pair: &Pair) -> [Packed; 2] {
        [self.probe.node(pair.a), self.scene.node(pair.b)]
    }

    /// The pairs that a pair is split into: one node with each child of the other.
    pub fn children(
        &self,
        Pair { a, b, .. }: Pair,
        exact: bool,
    ) -> impl ExactSizeIterator<Item = Pair> + DoubleEndedIterator {
        let (of_probe, children) = self.split_node(a, b, exact);
        children.map(move |child| {
            if of_probe {
                Pair::new(self.probe.pass_through(child, exact), b)
            } else {
                Pair::new(a, self.scene.pass_through(child, exact))
            }
        })
    }

    /// Chooses the node of a pair to split. Returns whether it is the probe's, and its children.
    fn split_node(&self, a: u32, b: u32, exact: bool) -> (bool, Range<u32>) {
        let (node_a, node_b) = (self.probe.node(a), self.scene.node(b));
        let [below_a, below_b] = [self.probe.detail(a), self.scene.detail(b)].map(|d| d.child_resolution);
        // With a threshold, the node with the coarser children is split (§3.4.2). Among free levels, whose
        // resolution is 0, and at full resolution, it is the larger node.
        let by_size = exact || below_a == below_b;
        let split_a = if by_size { node_a.radius >= node_b.radius } else { below_a < below_b };
        if node_b.is_leaf() || (!node_a.is_leaf() && split_a) {
            (true, node_a.first_child..node_a.last_child)
        } else {
            (false, node_b.first_child..node_b.last_child)
        }
    }

    /// Decides about a pair that is due for a test. The cheaper tests come first: the bounding spheres, the
    /// cached separating axis, the missing detail, the bounding hulls.
    pub fn decide(&self, pair: &mut Pair, context: &Context, patch_query: &mut PatchQuery) -> Decision {
        let nodes = self.nodes(pair);
        pair.out_of_reach = false;
        // A split pair whose spheres have come apart is joined later, when the descent leaves it, if its
        // hulls stay out of reach for long enough.
        if !pair.split && spheres_are_apart(&nodes, pair, context) {
            return Decision::Stop;
        }
        patch_query.costs.visited += 1;
        if are_still_apart(&nodes, pair, context) {
            return Decision::Stop;
        }
        pair.separating_axis = None;
        let refinement = if nodes.iter().all(Packed::is_leaf) {
            Refine::No
        } else if context.exact {
            Refine::Yes
        } else {
            let [detail_a, detail_b] = [self.probe.detail(pair.a), self.scene.detail(pair.b)];
            refine(&detail_a, &detail_b, self.threshold(pair, context), context.band)
        };
        match refinement {
            Refine::No => Decision::Examine,
            Refine::Yes if !pair.split && self.is_apart(pair, context, patch_query) => Decision::Stop,
            Refine::Yes => {
                pair.split_valid_until = f64::INFINITY;
                pair.refined_share = 1.0;
                Decision::Split
            }
            Refine::Depends => {
                // With a warm start the patches are searched at once, which also decides whether they are in
                // reach.
                let warm = !pair.warm_start.vertices(true).is_empty();
                if !warm && self.is_apart(pair, context, patch_query) {
                    Decision::Stop
                } else {
                    Decision::ExamineToDecide
                }
            }
        }
    }

    /// Finds the contacts of a pair and leaves them in `patch_query`. If the examination `decides` whether
    /// the pair is split, and finer pairs have all of its contact, there are none.
    pub fn examine(
        &self,
        pair: &mut Pair,
        decides: bool,
        context: &Context,
        patch_query: &mut PatchQuery,
    ) -> Decision {
        patch_query.contacts.clear();
        let tolerance = context.settings.tolerance;
        let nodes = self.nodes(pair);
        let precision = precision(&nodes, context);
        let hulls = [self.probe.patch_hull(pair.a), self.scene.patch_hull(pair.b)];
        let found = patch_distance(pair, &nodes, &hulls, context, patch_query);
        let beyond = found.separation == Separation::Beyond || found.distance > tolerance.max(precision);
        pair.refined_share = if decides { self.refined_share(pair, &found, context) } else { 0.0 };
        let decision = if pair.refined_share > 0.0 { Decision::Split } else { Decision::Stop };
        pair.split_valid_until =
            context.now.motion_bound + self.valid_motion(pair, &found, beyond, &hulls, context);
        pair.recheck_at = f64::NEG_INFINITY;
        if pair.refined_share == 1.0 {
            return decision;
        }
        patch_query.costs.leaf_pairs += 1;
        if beyond {
            if decision == Decision::Stop {
                pair.separating_axis =
                    SeparatingAxis::from_distance(&found, &nodes, &context.placement, context.now.turn, true);
                pair.recheck_at = pair.split_valid_until;
                pair.out_of_reach = nodes.iter().all(Packed::is_leaf);
            }
            return decision;
        }
        let placement = &context.placement;
        let near = PairContext { placement, tolerance, precision, looseness: context.looseness };
        patch_query.run(&self.probe.patch(pair.a), &self.scene.patch(pair.b), &found, &near);
        if let Some(tetrahedron) = patch_query.tetrahedron {
            pair.warm_start = WarmStart::from_tetrahedron(tetrahedron);
        }
        decision
    }

    /// Motion, m, for which the answer of an examined pair stays valid; −∞ if it has contacts.
    fn valid_motion(
        &self,
        pair: &Pair,
        found: &Distance,
        beyond: bool,
        hulls: &[Hull; 2],
        context: &Context,
    ) -> f64 {
        let all_refined = pair.refined_share == 1.0;
        // Hulls apart by at least `lower` stay beyond the tolerance, and overlapping hulls keep overlapping
        // until they have moved by the depth of the simplex around the origin. Nearest points within the
        // tolerance change with every motion.
        let relation_valid = match (beyond, all_refined) {
            (true, _) => found.lower - context.settings.tolerance,
            (false, true) => found.simplex.depth(),
            (false, false) => f64::NEG_INFINITY,
        };
        if all_refined {
            relation_valid.max(self.refined_for(pair, found, hulls, context))
        } else {
            relation_valid
        }
    }

    /// The share of a pair's contact, at the nearest points found, that is left to finer pairs.
    fn refined_share(&self, pair: &Pair, found: &Distance, context: &Context) -> f64 {
        let [detail_a, detail_b] = [self.probe.detail(pair.a), self.scene.detail(pair.b)];
        let side_a = (&detail_a, self.probe.support_area(pair.a));
        let side_b = (&detail_b, self.scene.support_area(pair.b));
        let error = self.threshold(pair, context);
        let deviation = weighted_deviation(found, side_a, side_b, context.settings.tolerance, error);
        refined_share(deviation, context.band)
    }

    /// Motion, m, for which all of a pair's contact stays left to finer pairs.
    fn refined_for(&self, pair: &Pair, found: &Distance, hulls: &[Hull; 2], context: &Context) -> f64 {
        let [hull_a, hull_b] = hulls;
        let [detail_a, detail_b] = [self.probe.detail(pair.a), self.scene.detail(pair.b)];
        let side_a = (&detail_a, hull_a, self.probe.support_area(pair.a));
        let side_b = (&detail_b, hull_b, self.scene.support_area(pair.b));
        let error = self.threshold(pair, context);
        refined_for(found, side_a, side_b, &context.placement, error, context.rounding)
    }

    /// s₀ at the centre of a pair's smaller node, m.
    pub fn threshold(&self, pair: &Pair, context: &Context) -> f64 {
        context.constant_error.unwrap_or_else(|| {
            let [a, b] = self.nodes(pair);
            let at = if a.radius <= b.radius { a.center } else { context.placement.point(b.center) };
            context.settings.error.threshold(context.probe_pose.transform_point(at), &context.probe_pose)
        })
    }

    /// Tests whether the bounding hulls of a pair are out of reach. Stores in the pair the motion bound until
    /// which the answer is valid.
    pub fn is_apart(&self, pair: &mut Pair, context: &Context, patch_query: &mut PatchQuery) -> bool {
        let (hull_a, hull_b) = (self.probe.hull(pair.a), self.scene.hull(pair.b));
        let nodes = self.nodes(pair);
        let [a, b] = &nodes;
        let untested = |node: &Packed, hull: &Hull| !node.is_leaf() && hull.len() > HULL_TEST_POINTS;
        if untested(a, &hull_a) || untested(b, &hull_b) {
            return false;
        }
        patch_query.costs.convex_queries += 1;
        let reach = reach(&nodes, context);
        let precision = precision(&nodes, context);
        let limits = Limits { beyond: reach, share: PROVEN_SHARE, enough: reach, precision };
        let start = Start::Vertices(pair.warm_start.vertices(false), between_centers(&nodes, context));
        let found = gjk::distance(&hull_a, &hull_b, &context.placement, start, &limits);
        let apart = found.separation == Separation::Beyond;
        let now = context.now.motion_bound;
        if apart {
            pair.warm_start = WarmStart::from_distance(&found, false);
            pair.separating_axis =
                SeparatingAxis::from_distance(&found, &nodes, &context.placement, context.now.turn, false);
            pair.recheck_at = now + (found.lower - reach);
            pair.out_of_reach = true;
        } else {
            pair.overlap_valid_until = now + (reach - found.distance).max(0.0) + found.simplex.depth();
        }
        apart
    }
}

/// Finds the distance between the hulls of a pair's patches.
fn patch_distance(
    pair: &mut Pair,
    nodes: &[Packed; 2],
    hulls: &[Hull; 2],
    context: &Context,
    patch_query: &mut PatchQuery,
) -> Distance {
    let (beyond, precision) = (context.settings.tolerance, precision(nodes, context));
    let limits = Limits { beyond, share: PROVEN_SHARE, enough: -1.0, precision };
    let start = Start::Vertices(pair.warm_start.vertices(true), between_centers(nodes, context));
    let found = gjk::distance(&hulls[0], &hulls[1], &context.placement, start, &limits);
    patch_query.costs.convex_queries += 1;
    patch_query.costs.not_converged += usize::from(found.separation == Separation::NotConverged);
    pair.warm_start = WarmStart::from_distance(&found, true);
    found
}

/// The vector from the centre of b's node to that of a's, in a's frame, m.
fn between_centers([a, b]: &[Packed; 2], context: &Context) -> DVec3 {
    a.center - context.placement.point(b.center)
}

/// Smallest length that counts as more than zero, m.
fn precision([a, b]: &[Packed; 2], context: &Context) -> f64 {
    PRECISION * (a.radius + b.radius) + context.rounding
}

/// Distance up to which the bounding hulls of two nodes are in reach, d_ab = d + h_a + h_b, m (Eq. 3.5).
fn reach([a, b]: &[Packed; 2], context: &Context) -> f64 {
    context.settings.tolerance + a.hausdorff + b.hausdorff
}

/// Tests whether the bounding spheres of a pair's nodes are out of reach: |c_a − c_b| − r_a − r_b > d. If so,
/// stores in the pair the motion bound until which they are.
fn spheres_are_apart([a, b]: &[Packed; 2], pair: &mut Pair, context: &Context) -> bool {
    let distance = a.center.distance(context.placement.point(b.center));
    let gap = distance * (1.0 - ROUNDING_SLACK)
        - (a.radius + b.radius)
        - context.settings.tolerance
        - context.rounding;
    if gap > 0.0 {
        pair.recheck_at = context.now.motion_bound + gap;
        pair.out_of_reach = true;
    }
    gap > 0.0
}

/// Tests whether the cached separating axis still separates a pair's hulls. If so, stores in the pair the
/// motion bound until which it does.
fn are_still_apart(nodes: &[Packed; 2], pair: &mut Pair, context: &Context) -> bool {
    let Some(axis) = pair.separating_axis.filter(|_| !pair.split) else { return false };
    // With another threshold, a pair whose patches are apart may have to be split.
    if axis.of_patches && context.now.threshold_changed {
        return false;
    }
    let reach = if axis.of_patches { context.settings.tolerance } else { reach(nodes, context) };
    let lower = axis.separation(nodes, &context.placement, context.now.turn, context.rounding);
    let apart = lower > reach.max(precision(nodes, context));
    if apart {
        pair.recheck_at = context.now.motion_bound + (lower - reach);
        pair.out_of_reach = !axis.of_patches || nodes.iter().all(Packed::is_leaf);
    }
    apart
}
