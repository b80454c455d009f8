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

use palpate_core::clod::Node;
use palpate_core::glam::DVec3;
use palpate_core::{Clod, Contact, Pose};

use crate::convex::{Hull, Limits, Placement, Separation, Start, SupportTree, gjk};
use crate::leaf::{LeafQuery, Reach};
use crate::patch::{Incidence, Patch};
use crate::refinement::{Detail, Refine, refine, refine_at};

/// Separations and depths are found to this fraction of the size of the hulls involved.
const PRECISION: f64 = 1e-12;

/// A closed patch whose vertices are this fraction of its radius below its triangles' planes is its own hull.
const CONVEX: f64 = 1e-10;

/// Contacts that a new workspace has room for.
const CONTACTS: usize = 1 << 14;

/// Hulls of more points than this are not tested above the leaves, but split at once: they belong to the upper free
/// levels, where they overlap nearly always, and a support point of theirs costs more than the spheres of their
/// children. Mean cost of a query from the roots, relative to no limit, jaws / spoon and cup: 0.90 / 0.79 with 256,
/// 0.77 / 1.03 with 64 but a front some three times as large.
const HULL_TEST_POINTS: usize = 256;

const NONE: u32 = u32::MAX;

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
    probe: Tree,
    scene: Tree,
    stack: Vec<(u32, u32)>,
    leaf: LeafQuery,
    contacts: Vec<PatchContact>,
}

/// What the descent reads of a hierarchy, packed.
#[derive(Clone, Debug)]
struct Tree {
    nodes: Vec<Packed>,
    details: Vec<Detail>,
    supports: Vec<SupportTree>,
    incidences: Vec<Incidence>,
    /// Bound on any coordinate, m.
    coordinates: f64,
}

#[derive(Clone, Copy, Debug)]
struct Packed {
    center: DVec3,
    radius: f64,
    hausdorff: f64,
    first_child: u32,
    last_child: u32,
    /// Index into [`Tree::supports`], or [`NONE`].
    support: u32,
    /// Likewise for the patch alone: the same unless points were added to bound descendants.
    patch_support: u32,
    /// Index into [`Tree::incidences`], or [`NONE`].
    incidence: u32,
    /// A closed patch whose vertices are all below its triangles' planes, to rounding.
    exact: bool,
}

impl Packed {
    fn is_leaf(&self) -> bool {
        self.first_child == self.last_child
    }
}

impl Tree {
    fn new(clod: &Clod) -> Self {
        let (mut supports, mut incidences) = (Vec::new(), Vec::new());
        let nodes = clod
            .nodes
            .iter()
            .map(|node| {
                let mut support_of = |points: &[DVec3]| {
                    if points.len() < SupportTree::WORTHWHILE {
                        return NONE;
                    }
                    supports.push(SupportTree::new(points));
                    supports.len() as u32 - 1
                };
                let support = support_of(clod.bounding_hull(node));
                let patch_support = if node.added > 0 && !node.triangles.is_empty() {
                    support_of(clod.extreme(node))
                } else {
                    support
                };
                let incidence = if node.triangles.len() >= Incidence::WORTHWHILE {
                    incidences.push(Incidence::new(node.vertices.len(), clod.patch(node)));
                    incidences.len() as u32 - 1
                } else {
                    NONE
                };
                Packed {
                    center: node.center,
                    radius: node.radius,
                    hausdorff: node.hausdorff,
                    first_child: node.children.start,
                    last_child: node.children.end,
                    support,
                    patch_support,
                    incidence,
                    exact: node.children.is_empty()
                        && node.all_real
                        && is_convex(clod, node, supports.get(support as usize)),
                }
            })
            .collect();
        let details = clod.nodes.iter().map(|node| Detail::of(clod, node)).collect();
        let coordinates = clod.vertices.iter().map(|v| v.abs().max_element()).fold(0.0, f64::max);
        Self { nodes, details, supports, incidences, coordinates }
    }

    fn fits(&self, clod: &Clod) -> bool {
        self.nodes.len() == clod.nodes.len() && !self.nodes.is_empty()
    }

    fn support(&self, node: u32) -> Option<&SupportTree> {
        self.supports.get(self.nodes[node as usize].support as usize)
    }

    fn hull<'a>(&'a self, clod: &'a Clod, node: u32) -> Hull<'a> {
        Hull::with_tree(clod.bounding_hull(&clod.nodes[node as usize]), self.support(node))
    }

    fn patch<'a>(&'a self, clod: &'a Clod, node: u32) -> Patch<'a> {
        let Packed { patch_support, incidence, exact, .. } = self.nodes[node as usize];
        let (support, incidence) =
            (self.supports.get(patch_support as usize), self.incidences.get(incidence as usize));
        Patch::of_node(clod, &clod.nodes[node as usize], support, incidence, exact)
    }

    /// The first descendant that is a leaf, has several children, or may be fine enough for an error.
    fn pass_through(&self, mut node: u32, error: f64) -> u32 {
        loop {
            let Packed { first_child, last_child, .. } = self.nodes[node as usize];
            let fine_enough = error > 0.0 && !self.details[node as usize].is_free();
            if last_child - first_child != 1 || fine_enough {
                return node;
            }
            node = first_child;
        }
    }

    /// Most nodes that can wait on the stack below any node: siblings along one path from root to leaf.
    fn path_width(&self) -> usize {
        let mut width = vec![0usize; self.nodes.len()];
        for (index, node) in self.nodes.iter().enumerate().rev() {
            let below = (node.first_child..node.last_child).map(|c| width[c as usize]).max().unwrap_or(0);
            width[index] = below + (node.last_child - node.first_child) as usize;
        }
        width.first().copied().unwrap_or(0)
    }
}

impl ContactQuery {
    /// A workspace for queries between two hierarchies.
    pub fn new(probe: &Clod, scene: &Clod) -> Self {
        Self::with_capacity(probe, scene, CONTACTS)
    }

    /// A workspace with room for a number of contacts.
    pub fn with_capacity(probe: &Clod, scene: &Clod, contacts: usize) -> Self {
        let (probe, scene) = (Tree::new(probe), Tree::new(scene));
        let stack = Vec::with_capacity(probe.path_width() + scene.path_width() + 1);
        Self { probe, scene, stack, leaf: LeafQuery::default(), contacts: Vec::with_capacity(contacts) }
    }

    /// Makes room for a number of contacts, so that queries with up to as many do not allocate for them.
    pub fn reserve(&mut self, contacts: usize) {
        self.contacts.reserve(contacts.saturating_sub(self.contacts.len()));
    }

    /// Bytes of memory held by the workspace.
    pub fn bytes(&self) -> usize {
        let tree = |tree: &Tree| {
            tree.nodes.capacity() * size_of::<Packed>()
                + tree.details.capacity() * size_of::<Detail>()
                + tree.supports.iter().map(SupportTree::bytes).sum::<usize>()
                + tree.incidences.iter().map(Incidence::bytes).sum::<usize>()
        };
        tree(&self.probe)
            + tree(&self.scene)
            + self.stack.capacity() * size_of::<(u32, u32)>()
            + self.contacts.capacity() * size_of::<PatchContact>()
    }

    /// Finds the contacts between the probe and the scene object at the given poses (object frame to world).
    ///
    /// The cost grows with the number of pairs of patches within the tolerance.
    pub fn run(
        &mut self,
        probe: &Clod,
        probe_pose: &Pose,
        scene: &Clod,
        scene_pose: &Pose,
        settings: &QuerySettings,
    ) -> QueryOutcome {
        self.contacts.clear();
        let mut outcome = QueryOutcome::default();
        let tolerance = settings.tolerance;
        let valid = probe_pose.is_valid() && scene_pose.is_valid();
        let error = settings.error;
        let asked = [tolerance, error].iter().all(|length| length.is_finite() && *length >= 0.0);
        if !valid || !asked || !self.fits(probe, scene) {
            outcome.refused = true;
            return outcome;
        }
        let placement = Placement::between(probe_pose, scene_pose);
        let rounding = 4.0
            * f64::EPSILON
            * (self.probe.coordinates + self.scene.coordinates + placement.translation.abs().max_element());
        // Either side may stand off, on either body.
        let looseness = 2.0
            * settings.patch_tolerance.max(0.0)
            * (probe.source.bounding_radius + scene.source.bounding_radius);
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
            let (node_a, node_b) = (self.probe.nodes[a as usize], self.scene.nodes[b as usize]);
            let precision = PRECISION * (node_a.radius + node_b.radius) + rounding;
            let mut examine = node_a.is_leaf() && node_b.is_leaf();
            if !examine {
                let (hull_a, hull_b) = (self.probe.hull(probe, a), self.scene.hull(scene, b));
                let (detail_a, detail_b) = (&self.probe.details[a as usize], &self.scene.details[b as usize]);
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
                        let side_a = (probe, &probe.nodes[a as usize], detail_a);
                        let side_b = (scene, &scene.nodes[b as usize], detail_b);
                        examine = !refine_at(&found.simplex, side_a, side_b, error);
                    }
                }
            }
            if examine {
                outcome.leaf_pairs += 1;
                outcome.front += 1;
                let (patch_a, patch_b) = (self.probe.patch(probe, a), self.scene.patch(scene, b));
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
            let (below_a, below_b) =
                (self.probe.details[a as usize].below, self.scene.details[b as usize].below);
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

    fn fits(&self, probe: &Clod, scene: &Clod) -> bool {
        self.probe.fits(probe) && self.scene.fits(scene)
    }

    fn spheres_reach(&self, (a, b): (u32, u32), placement: &Placement, tolerance: f64) -> bool {
        let (a, b) = (&self.probe.nodes[a as usize], &self.scene.nodes[b as usize]);
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

/// Whether no vertex of a patch's hull is above the planes of its triangles, to rounding.
fn is_convex(clod: &Clod, node: &Node, tree: Option<&SupportTree>) -> bool {
    let points = clod.hull(node);
    let hull = Hull::with_tree(clod.extreme(node), tree);
    clod.patch(node).iter().all(|corners| {
        let [p, q, r] = corners.map(|v| points[v as usize]);
        let normal = (q - p).cross(r - p).normalize_or_zero();
        let top =
            hull.points()[hull.support(normal, corners[0].min(hull.points().len() as u32 - 1)) as usize];
        normal.dot(top - p) <= CONVEX * node.radius
    })
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
