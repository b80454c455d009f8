//! Reduction of the contacts of a query to the few that take impulses.
//!
//! A query reports every pair of patches within reach, and many are close together: at full resolution dozens
//! where one coarse pair would do. Of contacts that are close together with similar normals, the deepest
//! represents all.
//!
//! A query reports only the deepest point of each pair, but faces that lie on one another touch along an
//! area. So corners of large patches that are equally near to the plane of contact and to the other's hull
//! become contacts as well. With impulses at the deepest point only, a body that rests on a face would rock
//! from corner to corner.

use glam::DVec3;
use palpate_collide::convex::{Hull, Limits, Placement, Start, gjk};
use palpate_collide::{CollisionEvent, PatchContact, Shape};
use palpate_core::Pose;
use palpate_core::clod::Node;

use crate::body::BodyState;
use crate::impact::{MAX_CONTACTS, Touch};

/// Distance between contacts that may be merged, as a part of the body's radius.
const MERGE_DISTANCE: f64 = 0.02;
/// Smallest cosine between the normals of merged contacts.
const MERGE_COSINE: f64 = 0.95;

/// The touching contacts of a state.
#[derive(Clone, Debug)]
pub struct Touching {
    touches: Vec<Touch>,
    /// Depths of the touches, m: negative where there is a gap.
    depths: Vec<f64>,
    order: Vec<u32>,
    shapes: [Shape; 2],
    /// Distance between contacts that may be merged, m.
    merge_distance: f64,
}

impl Touching {
    /// Creates a workspace for contacts of a body with a scene object.
    pub fn new(body: &Shape, scene: &Shape) -> Self {
        Self {
            touches: Vec::with_capacity(MAX_CONTACTS),
            depths: Vec::with_capacity(MAX_CONTACTS),
            order: Vec::with_capacity(1024),
            shapes: [body.clone(), scene.clone()],
            merge_distance: MERGE_DISTANCE * body.clod().bounding_radius(),
        }
    }

    /// Collects a query's contacts with gaps of at most `gap` (m), deepest first, and then corners of faces
    /// that touch. `poses` are those of both frames.
    pub fn gather(&mut self, contacts: &[PatchContact], gap: f64, state: &BodyState, poses: [&Pose; 2]) {
        self.clear();
        let touches = (0..).zip(contacts).filter(|(_, found)| found.contact.depth >= -gap);
        self.order.extend(touches.map(|(index, _)| index));
        let depth = |index: u32| contacts[index as usize].contact.depth;
        self.order.sort_unstable_by(|x, y| depth(*y).total_cmp(&depth(*x)).then(x.cmp(y)));
        for position in 0..self.order.len() {
            let contact = &contacts[self.order[position] as usize].contact;
            self.add(contact.point - state.pose.translation, -contact.normal, contact.depth);
        }
        // Corners come last, so that they take only the places that contacts leave.
        for position in 0..self.order.len() {
            if self.touches.len() == MAX_CONTACTS {
                break;
            }
            let found = &contacts[self.order[position] as usize];
            self.add_corners(found, gap, state, poses);
        }
    }

    /// Adds corners of a contact's patches that touch the other patch.
    fn add_corners(&mut self, found: &PatchContact, gap: f64, state: &BodyState, poses: [&Pose; 2]) {
        let shapes = self.shapes.clone();
        let Some(nodes) = node(&shapes[0], found.probe_node).zip(node(&shapes[1], found.scene_node)) else {
            return;
        };
        let nodes: [Node; 2] = nodes.into();
        if nodes.iter().any(|node| node.radius < self.merge_distance) {
            return;
        }
        let contact = &found.contact;
        // For each body: a point of the other's plane of contact, and the direction out of this body.
        for (own, plane, outwards) in
            [(0, contact.scene_point, contact.normal), (1, contact.point, -contact.normal)]
        {
            let other = Hull::new(shapes[1 - own].clod().extreme(&nodes[1 - own]));
            let placement = Placement::between(poses[own], poses[1 - own]);
            for corner in shapes[own].clod().extreme(&nodes[own]) {
                let point = poses[own].transform_point(*corner);
                let depth = (point - plane).dot(outwards);
                let near = |depth: f64| depth >= -gap && depth <= contact.depth.max(0.0) + gap;
                if near(depth) && touches(*corner, &other, &placement, gap) {
                    self.add(point - state.pose.translation, -contact.normal, depth);
                }
            }
        }
    }

    /// Adds the contact of a collision event, at its instant.
    pub fn add_event(&mut self, event: &CollisionEvent, state: &BodyState) {
        self.add(event.point - state.pose.translation, -event.normal, 0.0);
    }

    fn add(&mut self, arm: DVec3, normal: DVec3, depth: f64) {
        let represents = |kept: &Touch| {
            kept.arm.distance(arm) < self.merge_distance && kept.normal.dot(normal) > MERGE_COSINE
        };
        let finite = arm.is_finite() && normal.is_normalized();
        if finite && self.touches.len() < MAX_CONTACTS && !self.touches.iter().any(represents) {
            self.touches.push(Touch::plastic(arm, normal));
            self.depths.push(depth);
        }
    }

    pub fn clear(&mut self) {
        self.touches.clear();
        self.depths.clear();
        self.order.clear();
    }

    pub fn touches(&self) -> &[Touch] {
        &self.touches
    }

    pub fn touches_mut(&mut self) -> &mut [Touch] {
        &mut self.touches
    }

    /// Touches with their depths, m.
    pub fn with_depths(&mut self) -> impl Iterator<Item = (&mut Touch, f64)> {
        self.touches.iter_mut().zip(self.depths.iter().copied())
    }

    /// Largest depth, m; negative infinity if nothing touches.
    pub fn deepest(&self) -> f64 {
        self.depths.iter().copied().fold(f64::NEG_INFINITY, f64::max)
    }
}

fn node(shape: &Shape, index: u32) -> Option<Node> {
    shape.clod().get(index)
}

/// Returns whether a point is within a gap (m) of a hull that is placed in the point's frame.
fn touches(point: DVec3, hull: &Hull, placement: &Placement, gap: f64) -> bool {
    let limits = Limits { beyond: gap, share: 0.0, enough: gap, precision: 1e-6 * gap };
    let points = [point];
    let start = Start::Axis(point - placement.point(hull.point(0)));
    gjk::distance(&Hull::new(&points), hull, placement, start, &limits).distance <= gap
}
