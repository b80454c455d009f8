//! Contacts between two patches (§3.4.1, §5.4.1): of leaves, or of coarser nodes whose missing detail is not
//! felt.
//!
//! Separated hulls: the nearest points are a contact if both lie on real surface facing the other object.
//! If one lies on a virtual face and both hulls are contained in their solids, the segment between the points
//! leaves a solid through a neighbouring patch that is closer, and the pair is dropped. Otherwise, or when
//! parallel features leave the nearest points undetermined, the pair is decided by its triangles.
//!
//! Patches are convex, and contained, only up to the tolerance that they were built with. Pairs for which
//! this could matter (a nearest point that misses the triangles by no more, features that are parallel to
//! within it, hulls that overlap by no more) are decided by their triangles as well.
//!
//! Overlapping hulls: if both are contained, the solids overlap too, and [`overlap`](super::overlap) finds
//! the contact; if the hulls only touch, they may touch in virtual faces, far from any triangle, and the
//! triangles decide. If one is not contained, the patches themselves have to touch: a triangle of one must
//! intersect a triangle of the other, or the other's hull if that is contained. If not, pairs of triangles
//! within the tolerance are separated contacts.
//!
//! Of the pairs of triangles only local minima are reported: those whose nearest points are not closer to
//! another triangle of the same patch.

use palpate_core::Contact;
use palpate_core::glam::DVec3;

use super::context::PairContext;
use super::outcome::QueryOutcome;
use super::overlap::{Workspace, contact_at, overlap};
use super::triangles::InReach;
use crate::convex::{Distance, Hull, Limits, Placement, Separation, Start, gjk};
use crate::patch::{Patch, Plane, Surface, separated};
use crate::tolerances::{FEATURE_HEIGHT, PARALLEL_EDGES, SAME_CONTACT, SAME_POINT};

/// Number of contacts of a pair of patches that there is room for at first.
const CONTACTS: usize = 512;

/// Buffers for the contacts of one pair of patches, with the costs of a whole query.
#[derive(Clone, Debug)]
pub(crate) struct PatchQuery {
    overlap: Workspace,
    /// Contacts of the pair, in the probe's frame.
    pub contacts: Vec<Contact>,
    /// Vertices that the next search starts from, if the hulls overlap.
    pub tetrahedron: Option<[(u32, u32); 4]>,
    /// Pairs of triangles within the tolerance: contact, and the triangle of each patch.
    near: Vec<(Contact, u32, u32)>,
    in_reach: InReach,
    /// The closest pair of triangles of those examined last, facing each other or not: its distance,
    /// m, and its point on a. The distance is infinite if none is within the tolerance.
    nearest: (f64, DVec3),
    /// Costs so far.
    pub costs: QueryOutcome,
}

impl Default for PatchQuery {
    fn default() -> Self {
        Self {
            overlap: Workspace::default(),
            contacts: Vec::with_capacity(CONTACTS),
            tetrahedron: None,
            near: Vec::with_capacity(CONTACTS),
            in_reach: InReach::default(),
            nearest: (f64::INFINITY, DVec3::ZERO),
            costs: QueryOutcome::default(),
        }
    }
}

impl PatchQuery {
    /// Memory held, bytes, without the polytope, whose size is fixed.
    pub fn bytes(&self) -> usize {
        self.contacts.capacity() * size_of::<Contact>()
            + self.near.capacity() * size_of::<(Contact, u32, u32)>()
            + self.in_reach.bytes()
            + self.overlap.bytes()
    }

    /// Finds the contacts of a pair of patches, given the distance between their hulls, and leaves them in
    /// [`contacts`](Self::contacts).
    pub fn run(&mut self, a: &Patch, b: &Patch, found: &Distance, pair: &PairContext) {
        self.contacts.clear();
        self.tetrahedron = None;
        // The hull of an open patch that is not flat contains space that is not inside any solid: only its
        // triangles count.
        let open = (a.two_sided && !a.is_single_triangle()) || (b.two_sided && !b.is_single_triangle());
        match found.separation {
            Separation::Beyond => {}
            Separation::Overlapping if open || !a.contained || !b.contained => {
                let flat = a.is_single_triangle() && b.is_single_triangle();
                let towards_b = pair.placement.point(b.center) - a.center;
                if flat || self.triangles(a, b, towards_b, pair) {
                    self.penetrating(a, b, found, pair);
                }
            }
            Separation::Overlapping => self.contained_overlap(a, b, found, pair),
            Separation::Within | Separation::NotConverged if open => {
                self.triangles(a, b, -found.axis, pair);
            }
            Separation::Within | Separation::NotConverged => self.nearest_points(a, b, found, pair),
        }
    }

    /// Finds the contact of two contained hulls that overlap.
    fn contained_overlap(&mut self, a: &Patch, b: &Patch, found: &Distance, pair: &PairContext) {
        self.penetrating(a, b, found, pair);
        let shallow = self.contacts.iter().all(|c| c.depth <= pair.looseness);
        if !shallow || (a.is_single_triangle() && b.is_single_triangle()) {
            return;
        }
        // If the triangles are apart, their distances replace the contact. Hulls may touch in virtual faces;
        // the contact is put where the triangles touch.
        let touching = self.contacts.pop();
        let towards_b = touching.map_or(DVec3::ZERO, |contact| contact.normal);
        let penetrating = self.triangles(a, b, towards_b, pair);
        let (distance, at) = self.nearest;
        if penetrating || (self.contacts.is_empty() && distance <= pair.looseness) {
            self.contacts.extend(touching.map(|contact| contact_at(at, contact.normal, contact.depth)));
        }
    }

    /// Finds the contact at the nearest points of two hulls that are apart, if these lie on real surface.
    fn nearest_points(&mut self, a: &Patch, b: &Patch, found: &Distance, pair: &PairContext) {
        let (on_a, on_b) = witnesses(a, b, found);
        let (contact, slack) = separated(on_a, pair.placement.point(on_b), found.axis, pair.precision);
        // A patch point that is further than the hull (distance d) by the looseness l lies on a circle about
        // the other point of radius d + l, and so up to √((d + l)² − d²) = √(l (2d + l)) to the side.
        let aside = (pair.looseness * (2.0 * contact.distance() + pair.looseness)).sqrt();
        let near = [pair.precision, pair.looseness + aside];
        let carriers = found.simplex.vertices();
        let n = contact.normal;
        let at_a = a.surface_at(on_a, n, slack, carriers.iter().map(|v| v.a), near);
        let n = -pair.placement.direction_to_b(n);
        let at_b = b.surface_at(on_b, n, slack, carriers.iter().map(|v| v.b), near);
        match (at_a, at_b) {
            (Surface::Front, Surface::Front) => self.contacts.push(contact),
            (Surface::Near, _) | (_, Surface::Near) => {
                self.triangles(a, b, contact.normal, pair);
            }
            (Surface::Virtual, _) | (_, Surface::Virtual)
                if !(a.contained && b.contained) || ambiguous(a, b, contact.normal, pair) =>
            {
                self.triangles(a, b, contact.normal, pair);
            }
            _ => {}
        }
    }

    fn distance(&mut self, a: &Patch, b: &Patch, axis: DVec3, pair: &PairContext) -> Distance {
        self.costs.convex_queries += 1;
        let limits = Limits { beyond: pair.tolerance, share: 0.0, enough: -1.0, precision: pair.precision };
        let found = gjk::distance(&a.hull, &b.hull, pair.placement, Start::Axis(axis), &limits);
        self.costs.not_converged += usize::from(found.separation == Separation::NotConverged);
        found
    }

    fn penetrating(&mut self, a: &Patch, b: &Patch, found: &Distance, pair: &PairContext) {
        self.costs.convex_queries += 1;
        let overlap = overlap(a, b, pair, found, &mut self.overlap);
        self.costs.not_converged += usize::from(!overlap.converged);
        self.contacts.push(overlap.contact);
        self.tetrahedron = Some(overlap.tetrahedron);
    }

    /// Decides the pair by its triangles, given a vector from a to b, which is the contact's normal if that
    /// is known. Returns `true` if the patches penetrate; otherwise the separated contacts are reported.
    fn triangles(&mut self, a: &Patch, b: &Patch, towards_b: DVec3, pair: &PairContext) -> bool {
        self.costs.by_triangles += 1;
        self.near.clear();
        self.nearest = (f64::INFINITY, DVec3::ZERO);
        self.in_reach.gather(a, b, towards_b, pair);
        for on_a in 0..self.in_reach.of_a.len() {
            for on_b in 0..self.in_reach.of_b.len() {
                let (one, other) = (&self.in_reach.of_a[on_a], &self.in_reach.of_b[on_b]);
                if !one.clears(other, pair.tolerance + pair.precision)
                    && self.triangle_pair(a, b, on_a, on_b, pair)
                {
                    return true;
                }
            }
        }
        if a.contained != b.contained && self.sunk(a, b, pair) {
            return true;
        }
        let same = SAME_POINT * (a.radius + b.radius) + pair.precision;
        for index in 0..self.near.len() {
            let (contact, i, j) = self.near[index];
            if !self.in_reach.undercut(&contact, [i, j], same) && !self.repeated(&contact, pair) {
                self.contacts.push(contact);
            }
        }
        false
    }

    /// Stores the contact of two triangles within reach. Returns `true` if they intersect.
    fn triangle_pair(&mut self, a: &Patch, b: &Patch, on_a: usize, on_b: usize, pair: &PairContext) -> bool {
        let (on_a, on_b) = (&self.in_reach.of_a[on_a], &self.in_reach.of_b[on_b]);
        let (i, j, axis) = (on_a.index, on_b.index, on_a.ball.center - on_b.ball.center);
        let corners_a = on_a.corners;
        let corners_b = b.corners(b.triangles.at(j as usize));
        let (one, other) = (a.single(&corners_a), b.single(&corners_b));
        let found = self.distance(&one, &other, axis, pair);
        if found.separation == Separation::Beyond {
            return false;
        }
        let (p, q) = witnesses(&one, &other, &found);
        if found.separation == Separation::Overlapping {
            self.nearest = (0.0, p);
            return true;
        }
        if found.distance < self.nearest.0 {
            self.nearest = (found.distance, p);
        }
        let (contact, slack) = separated(p, pair.placement.point(q), found.axis, pair.precision);
        let n = contact.normal;
        if one.faces(Plane::of(corners_a).normal, n, slack)
            && other.faces(Plane::of(corners_b).normal, -pair.placement.direction_to_b(n), slack)
        {
            self.near.push((contact, i, j));
        }
        false
    }

    /// Whether a triangle of the patch that is not contained lies (partly) inside the hull of the one that
    /// is.
    fn sunk(&mut self, a: &Patch, b: &Patch, pair: &PairContext) -> bool {
        let touching = PairContext { tolerance: 0.0, ..*pair };
        let (loose, hull_is_a) = if a.contained { (b, true) } else { (a, false) };
        loose.triangles.iter().any(|triangle| {
            let corners = loose.corners(triangle);
            let one = loose.single(&corners);
            let found = if hull_is_a {
                self.distance(a, &one, a.center - pair.placement.point(one.center), &touching)
            } else {
                self.distance(&one, b, one.center - pair.placement.point(b.center), &touching)
            };
            found.separation == Separation::Overlapping
        })
    }

    /// Whether an equal contact was reported for this pair already, by a triangle that shares the nearest
    /// vertex or edge.
    fn repeated(&self, contact: &Contact, pair: &PairContext) -> bool {
        let same = SAME_CONTACT * pair.precision;
        self.contacts.iter().any(|other| {
            other.point.distance(contact.point) <= same
                && other.scene_point.distance(contact.scene_point) <= same
        })
    }
}

/// The nearest points, each in its own body's frame.
fn witnesses(a: &Patch, b: &Patch, found: &Distance) -> (DVec3, DVec3) {
    found.witnesses(&a.hull, &b.hull, &Placement::IDENTITY)
}

/// Whether the hulls' features along a normal (a's frame) are parallel, so that their nearest points are not
/// unique.
fn ambiguous(a: &Patch, b: &Patch, normal: DVec3, pair: &PairContext) -> bool {
    let placement = pair.placement;
    let on_a = || Feature::of(&a.hull, normal, FEATURE_HEIGHT * a.radius + pair.looseness);
    let on_b = || {
        Feature::of(&b.hull, -placement.direction_to_b(normal), FEATURE_HEIGHT * b.radius + pair.looseness)
    };
    // The smaller hull's feature is found faster and comes first: a vertex decides.
    let first_is_a = a.hull.len() <= b.hull.len();
    let first = if first_is_a { on_a() } else { on_b() };
    if matches!(first, Feature::Vertex) {
        return false;
    }
    let (on_a, on_b) = if first_is_a { (first, on_b()) } else { (on_a(), first) };
    match (on_a, on_b) {
        (Feature::Vertex, _) | (_, Feature::Vertex) => false,
        (Feature::Edge(u), Feature::Edge(v)) => u.cross(placement.direction(v)).length() < PARALLEL_EDGES,
        _ => true,
    }
}

/// The feature of a hull that lies furthest in a direction.
enum Feature {
    Vertex,
    /// An edge with its unit direction.
    Edge(DVec3),
    Face,
}

impl Feature {
    fn of(hull: &Hull, direction: DVec3, tolerance: f64) -> Self {
        let low = hull.end(direction) - tolerance;
        let (mut ends, mut count) = ([DVec3::ZERO; 2], 0);
        hull.each_beyond(direction, low, |_, point| {
            if let Some(end) = ends.get_mut(count) {
                *end = point;
            }
            count += 1;
        });
        match count {
            0 | 1 => Self::Vertex,
            2 => Self::Edge((ends[1] - ends[0]).normalize_or_zero()),
            _ => Self::Face,
        }
    }
}
