//! Collision events of hosts that step through time, interpolated between levels of detail (§3.4.4).
//!
//! Such a host searches the instant in a step at which surfaces meet that were apart at its beginning and
//! penetrate at its end. If the resolution changes within the step there may be none: a pair of coarse
//! patches is apart at both ends, the finer one that it is refined to penetrates at both, and a search for
//! the instant finds nothing or does not end. The dissertation estimates it instead, from the separation
//! distance s of the coarse pair at the beginning and the penetration depth δ of the fine pair at the end,
//! both taken to change linearly: at s / (s + δ) of the step. The response is applied then, as if the patches
//! that were active at the beginning still were.
//!
//! Here all events are estimated this way, whether or not the resolution has changed, without further
//! queries. For surfaces that approach at a constant rate along the normal the instant is exact; otherwise
//! its error is of second order in the step. Patches belong together if one equals the other or was refined
//! to it, on both bodies.

use palpate_core::clod::NO_NODE;
use palpate_core::glam::DVec3;
use palpate_core::{Clod, Contact};

use crate::contact::PatchContact;
use crate::shape::Shape;

/// A collision: an instant at which surfaces that were apart meet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CollisionEvent {
    /// Instant, as a fraction of the step: 0 at its beginning, 1 at its end.
    pub fraction: f64,
    /// Point of contact, interpolated between the beginning and the end; world axes, m.
    pub point: DVec3,
    /// Unit normal that points out of the probe, at the end; world axes.
    pub normal: DVec3,
    /// The probe's node that was active at the beginning, if there was one, otherwise at the end.
    pub probe_node: u32,
    /// The scene object's node that was active at the beginning, if there was one, otherwise at the end.
    pub scene_node: u32,
    /// Whether other nodes were active at the end: the resolution has changed within the step.
    pub switched: bool,
}

/// A contact at one end of a step.
#[derive(Clone, Copy, Debug)]
struct StepContact {
    /// The coarsest patches that contain its own, on either body.
    tops: [u32; 2],
    /// Its own patches.
    nodes: [u32; 2],
    depth: f64,
    point: DVec3,
    normal: DVec3,
}

/// Search for collision events, from the contacts at the ends of a host's time steps.
#[derive(Clone, Debug)]
pub struct CollisionEvents {
    shapes: [Shape; 2],
    /// Contacts at the beginning of a step, if it is known, and at its end, by their coarsest patches.
    before: Vec<StepContact>,
    known: bool,
    after: Vec<StepContact>,
    events: Vec<CollisionEvent>,
}

impl CollisionEvents {
    /// Makes a workspace for the contacts of queries between two objects, without a beginning yet.
    pub fn new(probe: &Shape, scene: &Shape) -> Self {
        Self {
            shapes: [probe.clone(), scene.clone()],
            before: Vec::new(),
            known: false,
            after: Vec::new(),
            events: Vec::new(),
        }
    }

    /// Discards the beginning of the next step, after the host has moved a body to another place.
    pub fn reset(&mut self) {
        self.known = false;
    }

    /// Finds the events of a step, the earliest first, given the contacts of a query at its end with
    /// tolerance d (m): one for each contact that penetrates and did not at the beginning, which is the end
    /// of the step before. Surfaces that were further apart than d then count as d apart. Contacts with nodes
    /// that are not the objects', or that are not finite, are ignored.
    ///
    /// Without a beginning there are no events. Allocates only while there are more contacts than ever
    /// before.
    pub fn step(&mut self, contacts: &[PatchContact], tolerance: f64) -> &[CollisionEvent] {
        self.events.clear();
        self.after.clear();
        let [probe, scene] = &self.shapes;
        self.after.extend(contacts.iter().filter_map(|found| StepContact::of(found, probe, scene)));
        self.after.sort_unstable_by(|x, y| {
            let key = |one: &StepContact| (one.tops, one.nodes);
            key(x).cmp(&key(y)).then(y.depth.total_cmp(&x.depth))
        });
        for end in self.after.iter().filter(|end| self.known && end.depth > 0.0) {
            let beginning = match beginning_of(end, &self.before, [probe.clod(), scene.clod()]) {
                Some(beginning) if beginning.depth > 0.0 => continue,
                beginning => beginning,
            };
            let separation = beginning.map_or(tolerance, |beginning| -beginning.depth);
            let fraction = separation / (separation + end.depth);
            let from = beginning.unwrap_or(end);
            self.events.push(CollisionEvent {
                fraction,
                point: from.point.lerp(end.point, fraction),
                normal: end.normal,
                probe_node: from.nodes[0],
                scene_node: from.nodes[1],
                switched: from.nodes != end.nodes,
            });
        }
        self.events.sort_unstable_by(|x, y| {
            let nodes = |event: &CollisionEvent| (event.probe_node, event.scene_node);
            x.fraction.total_cmp(&y.fraction).then(nodes(x).cmp(&nodes(y)))
        });
        std::mem::swap(&mut self.before, &mut self.after);
        self.known = true;
        &self.events
    }

    /// The events of the last step.
    pub fn events(&self) -> &[CollisionEvent] {
        &self.events
    }
}

impl StepContact {
    fn of(found: &PatchContact, probe: &Shape, scene: &Shape) -> Option<Self> {
        let Contact { point, depth, normal, .. } = found.contact;
        let tops = [top(probe, found.probe_node)?, top(scene, found.scene_node)?];
        let nodes = [found.probe_node, found.scene_node];
        let finite = point.is_finite() && depth.is_finite() && normal.is_finite();
        finite.then_some(Self { tops, nodes, depth, point, normal })
    }
}

/// The coarsest patch that contains a node's patch; none if there is no such node, or it has no patch.
fn top(shape: &Shape, node: u32) -> Option<u32> {
    let mut top = shape.has_patch(node).then_some(node)?;
    loop {
        // The root's parent is not a node.
        let parent = shape.clod().node(top).parent;
        if !shape.has_patch(parent) {
            return Some(top);
        }
        top = parent;
    }
}

/// The deepest of the contacts at the beginning whose patches belong together with those of one at the end.
fn beginning_of<'r>(
    end: &StepContact,
    before: &'r [StepContact],
    clods: [&Clod; 2],
) -> Option<&'r StepContact> {
    let first = before.partition_point(|one| one.tops < end.tops);
    let near = before[first..].iter().take_while(|one| one.tops == end.tops);
    let related = |one: &&StepContact| {
        (0..2).all(|body| {
            let (own, other) = (end.nodes[body], one.nodes[body]);
            descends(clods[body], own, other) || descends(clods[body], other, own)
        })
    };
    near.filter(related).max_by(|x, y| x.depth.total_cmp(&y.depth))
}

/// Whether a node equals another one or is below it.
fn descends(clod: &Clod, mut node: u32, from: u32) -> bool {
    while node != from {
        node = clod.node(node).parent;
        if node == NO_NODE {
            return false;
        }
    }
    true
}
