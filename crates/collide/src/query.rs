//! The contact query Q(A, B, d) between two hierarchies (§3.4.1, §3.4.2).
//!
//! Both hierarchies are descended in tandem from their roots. A pair of nodes is dropped when its bounding spheres, or
//! then its hulls, are further apart than d + h(a) + h(b) (Eq. 3.5); otherwise one of them is split, down to pairs
//! whose missing detail is below the threshold s₀ ([`refinement`](crate::refinement)), and those are asked for
//! contacts. Of nodes with such a threshold the one with the coarser children is split (§3.4.2). At full resolution,
//! where s₀ is 0, it is the larger one, down to pairs of leaves. As §3.4.1 has it, they are a superset of the local
//! minima of the distance where the objects are disjoint, and local penetration depths where they overlap. Only
//! surfaces that meet make contacts: an object that has sunk wholly into another, deeper than that one's patches are
//! thick, has none.
//!
//! With a threshold, what is reported are contacts between the surfaces of coarser levels, each within s of the mesh.
//!
//! Departures: hulls of many points are not tested above the leaves; hull queries there only decide whether a pair is
//! within reach, and stop as soon as either bound on the distance settles it; nodes with a single child are passed
//! through, as long as they are to be refined anyway.

use palpate_core::{Clod, Contact, Pose};

use crate::convex::{Limits, Placement, Separation, Start, gjk};
use crate::leaf::{LeafQuery, Reach};
use crate::refinement::{Refine, refine, refine_at};
use crate::shape::Shape;

/// Separations and depths are found to this fraction of the size of the hulls involved.
const PRECISION: f64 = 1e-12;

/// Contacts that a new workspace has room for.
const CONTACTS: usize = 1 << 14;

/// Hulls of more points than this are not tested above the leaves, but split at once: they belong to the upper free
/// levels, where they overlap nearly always, and a support point of theirs costs more than the spheres of their
/// children. Mean cost of a query from the roots, relative to no limit, jaws / spoon and cup: 0.90 / 0.79 with 256,
/// 0.77 / 1.03 with 64 but a front some three times as large.
const HULL_TEST_POINTS: usize = 256;

/// What a query asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuerySettings {
    /// d: surfaces closer than this are in contact, m. Not negative.
    pub tolerance: f64,
    /// Never allocate: contacts beyond the reserved capacity are dropped, and [`QueryOutcome::overflow`] says so.
    /// Otherwise (the default) the buffer grows, and [`QueryOutcome::reallocated`] says so.
    pub fixed_capacity: bool,
    /// How far hulls may stand off the surface that they were built for, as a fraction of an object's bounding radius:
    /// the builder's tolerance. Where this much could decide about a contact, the triangles do.
    pub patch_tolerance: f64,
    /// s₀: detail is left out where its deviation, averaged over the area of contact (s*, Eq. 3.7), is no more than
    /// this, m; 0 for full resolution. §3.5.2 finds 2.5 to 5 % of the objects' radii unnoticed.
    pub error: f64,
}

impl QuerySettings {
    /// Settings with a tolerance (d, m) and defaults for the rest.
    pub fn new(tolerance: f64) -> Self {
        Self { tolerance, fixed_capacity: false, patch_tolerance: 1e-6, error: 0.0 }
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
    /// Pairs of nodes whose bounding spheres were within reach.
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
    /// Whether contacts were dropped for want of capacity: [`ContactQuery::reserve`] more.
    pub overflow: bool,
    /// Whether a buffer grew during this query: it was larger than any before.
    pub reallocated: bool,
    /// The query was refused, and nothing was found: a pose, the tolerance or the error is not finite, one of the latter
    /// is negative, or the hierarchies are not those that the workspace was made for.
    pub refused: bool,
}

/// The workspace of a contact query. It belongs to the pair of hierarchies that it was made for.
#[derive(Clone, Debug)]
pub struct ContactQuery {
    probe: Shape,
    scene: Shape,
    stack: Vec<(u32, u32)>,
    leaf: LeafQuery,
    contacts: Vec<PatchContact>,
}

impl ContactQuery {
    /// A workspace for queries between two hierarchies.
    pub fn new(probe: &Shape, scene: &Shape) -> Self {
        Self::with_capacity(probe, scene, CONTACTS)
    }

    /// A workspace with room for a number of contacts.
    pub fn with_capacity(probe: &Shape, scene: &Shape, contacts: usize) -> Self {
        let (probe, scene) = (probe.clone(), scene.clone());
        let stack = Vec::with_capacity(probe.path_width() + scene.path_width() + 1);
        Self { probe, scene, stack, leaf: LeafQuery::default(), contacts: Vec::with_capacity(contacts) }
    }

    /// Makes room for a number of contacts, so that queries with up to as many do not allocate for them.
    pub fn reserve(&mut self, contacts: usize) {
        self.contacts.reserve(contacts.saturating_sub(self.contacts.len()));
    }

    /// Bytes of memory held by the workspace.
    pub fn bytes(&self) -> usize {
        self.stack.capacity() * size_of::<(u32, u32)>() + self.contacts.capacity() * size_of::<PatchContact>()
    }

    /// Finds the contacts between the probe and the scene object at the given poses (object frame to world).
    ///
    /// The cost grows with the number of pairs of patches within the tolerance.
    pub fn run(&mut self, probe_pose: &Pose, scene_pose: &Pose, settings: &QuerySettings) -> QueryOutcome {
        self.contacts.clear();
        let mut outcome = QueryOutcome::default();
        let tolerance = settings.tolerance;
        let valid = probe_pose.is_valid() && scene_pose.is_valid();
        let error = settings.error;
        let asked = [tolerance, error].iter().all(|length| length.is_finite() && *length >= 0.0);
        if !valid || !asked || self.probe.is_empty() || self.scene.is_empty() {
            outcome.refused = true;
            return outcome;
        }
        let placement = Placement::between(probe_pose, scene_pose);
        let rounding = 4.0
            * f64::EPSILON
            * (self.probe.coordinates()
                + self.scene.coordinates()
                + placement.translation.abs().max_element());
        // Either side may stand off, on either body.
        let looseness = 2.0
            * settings.patch_tolerance.max(0.0)
            * (self.probe.clod().source.bounding_radius + self.scene.clod().source.bounding_radius);
        let buffers = self.leaf.capacity() + self.contacts.capacity() + self.stack.capacity();
        (self.leaf.convex_queries, self.leaf.not_converged, self.leaf.by_triangles) = (0, 0, 0);

        self.stack.clear();
        let roots = (self.probe.pass_through(Clod::ROOT, error), self.scene.pass_through(Clod::ROOT, error));
        let sphere_tolerance = tolerance + rounding;
        if self.spheres_reach(roots, &placement, sphere_tolerance) {
            self.stack.push(roots);
        } else {
            outcome.front = 1;
        }
        while let Some((a, b)) = self.stack.pop() {
            outcome.visited += 1;
            let (node_a, node_b) = (*self.probe.node(a), *self.scene.node(b));
            let precision = PRECISION * (node_a.radius + node_b.radius) + rounding;
            let mut examine = node_a.is_leaf() && node_b.is_leaf();
            if !examine {
                let (hull_a, hull_b) = (self.probe.hull(a), self.scene.hull(b));
                let (detail_a, detail_b) = (self.probe.detail(a), self.scene.detail(b));
                let refine = if error > 0.0 { refine(detail_a, detail_b, error) } else { Refine::Yes };
                let depends = refine == Refine::Depends;
                examine = refine == Refine::No;
                if depends || hull_a.points().len().max(hull_b.points().len()) <= HULL_TEST_POINTS {
                    outcome.convex_queries += 1;
                    let reach = tolerance + node_a.hausdorff + node_b.hausdorff;
                    let limits =
                        Limits { beyond: reach, enough: if depends { -1.0 } else { reach }, precision };
                    let axis = node_a.center - placement.point(node_b.center);
                    let found = gjk::distance(&hull_a, &hull_b, &placement, Start::Axis(axis), &limits);
                    if found.separation == Separation::Beyond {
                        outcome.front += 1;
                        continue;
                    }
                    if depends {
                        let areas = (self.probe.bounding_areas(a), self.scene.bounding_areas(b));
                        examine = !refine_at(&found.simplex, (detail_a, areas.0), (detail_b, areas.1), error);
                    }
                }
            }
            if examine {
                outcome.leaf_pairs += 1;
                outcome.front += 1;
                let (patch_a, patch_b) = (self.probe.patch(a), self.scene.patch(b));
                let reach = Reach { placement: &placement, tolerance, precision, looseness };
                self.leaf.run(&patch_a, &patch_b, &reach);
                for contact in &self.leaf.contacts {
                    outcome.count(contact);
                    if settings.fixed_capacity && self.contacts.len() == self.contacts.capacity() {
                        outcome.overflow = true;
                    } else {
                        self.contacts.push(PatchContact {
                            contact: placed(contact, probe_pose),
                            probe_node: a,
                            scene_node: b,
                        });
                    }
                }
                continue;
            }
            let (below_a, below_b) = (self.probe.detail(a).below, self.scene.detail(b).below);
            // Among free levels, and at full resolution, the larger one.
            let by_size = error == 0.0 || below_a == below_b;
            let split_a = if by_size { node_a.radius >= node_b.radius } else { below_a < below_b };
            if node_b.is_leaf() || (!node_a.is_leaf() && split_a) {
                for child in (node_a.first_child..node_a.last_child).rev() {
                    let pair = (self.probe.pass_through(child, error), b);
                    if self.spheres_reach(pair, &placement, sphere_tolerance) {
                        self.stack.push(pair);
                    } else {
                        outcome.front += 1;
                    }
                }
            } else {
                for child in (node_b.first_child..node_b.last_child).rev() {
                    let pair = (a, self.scene.pass_through(child, error));
                    if self.spheres_reach(pair, &placement, sphere_tolerance) {
                        self.stack.push(pair);
                    } else {
                        outcome.front += 1;
                    }
                }
            }
            outcome.stack_high_water = outcome.stack_high_water.max(self.stack.len());
        }
        outcome.convex_queries += self.leaf.convex_queries;
        outcome.not_converged = self.leaf.not_converged;
        outcome.by_triangles = self.leaf.by_triangles;
        outcome.reallocated =
            self.leaf.capacity() + self.contacts.capacity() + self.stack.capacity() != buffers;
        outcome
    }

    fn spheres_reach(&self, (a, b): (u32, u32), placement: &Placement, tolerance: f64) -> bool {
        let (a, b) = (self.probe.node(a), self.scene.node(b));
        let reach = a.radius + b.radius + tolerance;
        // A little slack for rounding in the spheres.
        a.center.distance_squared(placement.point(b.center)) <= reach * reach * (1.0 + 1e-9)
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
fn placed(contact: &Contact, pose: &Pose) -> Contact {
    Contact {
        point: pose.transform_point(contact.point),
        scene_point: pose.transform_point(contact.scene_point),
        normal: pose.transform_vector(contact.normal),
        depth: contact.depth,
    }
}
