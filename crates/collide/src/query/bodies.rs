//! What is asked of a pair of nodes: whether it is out of reach, and which contacts it has. Reads nothing but the bodies and
//! the circumstances, so that several pairs may be asked at once.

use std::ops::Range;

use super::front::{Nearest, Pair};
use super::leaf::{LeafQuery, Reach};
use super::parting::Parting;
use super::refinement::{Refine, refine, refined_for, refined_share, weighted_deviation};
use super::{Circumstances, HULL_TEST_POINTS, SHARE};
use crate::convex::{Distance, Hull, Limits, Separation, Start, gjk};
use crate::shape::{Packed, Shape};
use crate::tolerances::{PRECISION, ROUNDING_SLACK};

/// What becomes of a pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// It stays on the front, or comes back to it.
    Stop,
    /// It is split.
    Refine,
    /// It stays on the front, or comes back to it, and is to be examined for contacts.
    Examine,
    /// It is to be examined, which will tell whether it is split.
    Ask,
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

    /// The sum of the nodes' radii, m.
    pub fn radii(&self, pair: &Pair) -> f64 {
        self.probe.radius(pair.a) + self.scene.radius(pair.b)
    }

    fn nodes(&self, pair: &Pair) -> [Packed; 2] {
        [self.probe.node(pair.a), self.scene.node(pair.b)]
    }

    /// The pairs that a pair is split into.
    pub fn below(
        &self,
        Pair { a, b, .. }: Pair,
        exact: bool,
    ) -> impl ExactSizeIterator<Item = Pair> + DoubleEndedIterator {
        let (of_probe, children) = self.children(a, b, exact);
        children.map(move |child| {
            if of_probe {
                Pair::new(self.probe.pass_through(child, exact), b)
            } else {
                Pair::new(a, self.scene.pass_through(child, exact))
            }
        })
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

    /// Decides about a pair that is awake.
    pub fn look_at(&self, pair: &mut Pair, now: &Circumstances, leaf: &mut LeafQuery) -> Verdict {
        let nodes = self.nodes(pair);
        pair.apart = false;
        if !pair.split && spheres_are_apart(&nodes, pair, now) {
            return Verdict::Stop;
        }
        leaf.counts.visited += 1;
        if are_still_apart(&nodes, pair, now) {
            return Verdict::Stop;
        }
        pair.parting = None;
        let refinement = if nodes.iter().all(Packed::is_leaf) {
            Refine::No
        } else if now.exact {
            Refine::Yes
        } else {
            let [detail_a, detail_b] = [self.probe.detail(pair.a), self.scene.detail(pair.b)];
            refine(&detail_a, &detail_b, self.threshold(pair, now), now.band)
        };
        match refinement {
            Refine::No => Verdict::Examine,
            Refine::Yes if !pair.split && self.is_apart(pair, now, leaf) => Verdict::Stop,
            Refine::Yes => {
                pair.settled = f64::INFINITY;
                pair.share = 1.0;
                Verdict::Refine
            }
            Refine::Depends => {
                let warm = !pair.nearest.vertices(true).is_empty();
                if !warm && self.is_apart(pair, now, leaf) { Verdict::Stop } else { Verdict::Ask }
            }
        }
    }

    /// Finds the contacts of a pair, unless it is to be refined, which `asks` whether it is. They are left in `leaf`.
    pub fn examine(&self, pair: &mut Pair, asks: bool, now: &Circumstances, leaf: &mut LeafQuery) -> Verdict {
        leaf.contacts.clear();
        let tolerance = now.settings.tolerance;
        let nodes = self.nodes(pair);
        let precision = precision(&nodes, now);
        let hulls = [self.probe.patch_hull(pair.a), self.scene.patch_hull(pair.b)];
        let limits = Limits { beyond: tolerance, share: SHARE, enough: -1.0, precision };
        let [a, b] = &nodes;
        let start = Start::Vertices(pair.nearest.vertices(true), a.center - now.placement.point(b.center));
        let found = gjk::distance(&hulls[0], &hulls[1], &now.placement, start, &limits);
        leaf.counts.convex_queries += 1;
        leaf.counts.not_converged += usize::from(found.separation == Separation::NotConverged);
        pair.nearest = Nearest::of(&found, true);
        let beyond = found.separation == Separation::Beyond || found.distance > tolerance.max(precision);
        pair.share = if asks { self.share(pair, &found, now) } else { 0.0 };
        let verdict = if pair.share > 0.0 { Verdict::Refine } else { Verdict::Stop };
        let all_refined = pair.share == 1.0;
        // Nearest points count where there are any within the tolerance only, and hulls that overlap go on to do so until
        // they have moved by their depth.
        let mut settled = if beyond {
            found.lower - tolerance
        } else if all_refined {
            found.simplex.depth()
        } else {
            f64::NEG_INFINITY
        };
        if all_refined {
            settled = settled.max(self.refined_for(pair, &found, &hulls, now));
        }
        pair.settled = now.way + settled;
        pair.wake = f64::NEG_INFINITY;
        if all_refined {
            return verdict;
        }
        leaf.counts.leaf_pairs += 1;
        if beyond {
            if verdict == Verdict::Stop {
                pair.parting = Parting::of(&found, &nodes, &now.placement, now.turn, true);
                pair.wake = now.way + settled;
                pair.apart = nodes.iter().all(Packed::is_leaf);
            }
            return verdict;
        }
        let reach = Reach { placement: &now.placement, tolerance, precision, looseness: now.looseness };
        let (patch_a, patch_b) = (self.probe.patch(pair.a), self.scene.patch(pair.b));
        leaf.run(&patch_a, &patch_b, &found, &reach);
        if let Some(tetrahedron) = leaf.tetrahedron {
            pair.nearest = Nearest::around(tetrahedron);
        }
        verdict
    }

    /// How much of a pair's contact, found at these nearest points, is left to finer ones.
    fn share(&self, pair: &Pair, found: &Distance, now: &Circumstances) -> f64 {
        let [detail_a, detail_b] = [self.probe.detail(pair.a), self.scene.detail(pair.b)];
        let side_a = (&detail_a, self.probe.support_area(pair.a));
        let side_b = (&detail_b, self.scene.support_area(pair.b));
        let error = self.threshold(pair, now);
        refined_share(weighted_deviation(found, side_a, side_b, now.settings.tolerance, error), now.band)
    }

    /// How far the bodies may move with all of a pair's contact left to finer ones still, m.
    fn refined_for(&self, pair: &Pair, found: &Distance, hulls: &[Hull; 2], now: &Circumstances) -> f64 {
        let [hull_a, hull_b] = hulls;
        let [detail_a, detail_b] = [self.probe.detail(pair.a), self.scene.detail(pair.b)];
        let side_a = (&detail_a, hull_a, self.probe.support_area(pair.a));
        let side_b = (&detail_b, hull_b, self.scene.support_area(pair.b));
        refined_for(found, side_a, side_b, &now.placement, self.threshold(pair, now), now.rounding)
    }

    /// s₀ at a pair, m.
    pub fn threshold(&self, pair: &Pair, now: &Circumstances) -> f64 {
        now.constant.unwrap_or_else(|| {
            let [a, b] = self.nodes(pair);
            let at = if a.radius <= b.radius { a.center } else { now.placement.point(b.center) };
            now.settings.error.threshold(now.probe_pose.transform_point(at), &now.probe_pose)
        })
    }

    /// Whether the bounding hulls are out of reach; if so, until when.
    pub fn is_apart(&self, pair: &mut Pair, now: &Circumstances, leaf: &mut LeafQuery) -> bool {
        let (hull_a, hull_b) = (self.probe.hull(pair.a), self.scene.hull(pair.b));
        let nodes = self.nodes(pair);
        let [a, b] = &nodes;
        let untested = |node: &Packed, hull: &Hull| !node.is_leaf() && hull.len() > HULL_TEST_POINTS;
        if untested(a, &hull_a) || untested(b, &hull_b) {
            return false;
        }
        leaf.counts.convex_queries += 1;
        let reach = reach(&nodes, now);
        let limits = Limits { beyond: reach, share: SHARE, enough: reach, precision: precision(&nodes, now) };
        let start = Start::Vertices(pair.nearest.vertices(false), a.center - now.placement.point(b.center));
        let found = gjk::distance(&hull_a, &hull_b, &now.placement, start, &limits);
        let apart = found.separation == Separation::Beyond;
        if apart {
            pair.nearest = Nearest::of(&found, false);
            pair.parting = Parting::of(&found, &nodes, &now.placement, now.turn, false);
            pair.wake = now.way + (found.lower - reach);
            pair.apart = true;
        } else {
            pair.within = now.way + (reach - found.distance).max(0.0) + found.simplex.depth();
        }
        apart
    }
}

/// Smallest length that is told from zero, m.
fn precision([a, b]: &[Packed; 2], now: &Circumstances) -> f64 {
    PRECISION * (a.radius + b.radius) + now.rounding
}

/// d_ab, m (Eq. 3.5).
fn reach([a, b]: &[Packed; 2], now: &Circumstances) -> f64 {
    now.settings.tolerance + a.hausdorff + b.hausdorff
}

/// Whether the bounding spheres of a pair's nodes are out of reach; if so, until when.
fn spheres_are_apart([a, b]: &[Packed; 2], pair: &mut Pair, now: &Circumstances) -> bool {
    let distance = a.center.distance(now.placement.point(b.center));
    // A little slack for rounding in the spheres.
    let gap =
        distance * (1.0 - ROUNDING_SLACK) - (a.radius + b.radius) - now.settings.tolerance - now.rounding;
    if gap > 0.0 {
        pair.wake = now.way + gap;
        pair.apart = true;
    }
    gap > 0.0
}

/// Whether hulls that were out of reach are so still, along the same direction; if so, until when.
fn are_still_apart(nodes: &[Packed; 2], pair: &mut Pair, now: &Circumstances) -> bool {
    let Some(parting) = pair.parting.filter(|_| !pair.split) else { return false };
    // With another threshold, the pair may have to be split.
    if parting.of_patches && now.threshold_changed {
        return false;
    }
    let reach = if parting.of_patches { now.settings.tolerance } else { reach(nodes, now) };
    let lower = parting.lower(nodes, &now.placement, now.turn, now.rounding);
    let apart = lower > reach.max(precision(nodes, now));
    if apart {
        pair.wake = now.way + (lower - reach);
        pair.apart = !parting.of_patches || nodes.iter().all(Packed::is_leaf);
    }
    apart
}
