//! Contacts between two leaf patches (§3.4.1, §5.4.1).
//!
//! Separated hulls: the nearest points are a contact when both lie on real surface facing the other object. If one lies
//! on a virtual face and both hulls are contained in their solids, the segment between the points leaves a solid
//! through a neighbouring patch that is closer, and the pair is dropped. Otherwise, or when parallel features leave the
//! nearest points undetermined, the triangles themselves decide.
//!
//! Patches are convex, and contained, only up to the tolerance they were built with. Wherever that could decide (a
//! nearest point that misses the triangles by no more, features that are parallel to within it, hulls that overlap by
//! no more) the triangles decide as well.
//!
//! Overlapping hulls: when both are contained, so do the solids, and [`overlap`](crate::query::overlap) finds the contact; if
//! they only touch, they may do so in virtual faces, far from any triangle, and the triangles decide. When one is not
//! contained the patches must truly touch first: a triangle of one must intersect a triangle of the other, or the
//! other's hull if that is contained. If not, pairs of triangles within the tolerance are separated contacts.
//!
//! Of the pairs of triangles only local minima are reported: those whose nearest points are not closer to another
//! triangle of the same patch.

use palpate_core::Contact;
use palpate_core::glam::DVec3;

use crate::convex::{Distance, Hull, Limits, Placement, Separation, Start, gjk};
use crate::patch::{Patch, Plane, Surface, separated};
use crate::query::overlap::{Workspace, contact_at, overlap};
use crate::query::triangles::InReach;
use crate::tolerances::{FEATURE_HEIGHT, PARALLEL_EDGES, SAME_CONTACT, SAME_POINT};

/// Contacts of a pair of patches that there is room for at first.
const CONTACTS: usize = 512;

/// Buffers for the contacts of one pair of leaves, with counts over a whole query.
#[derive(Clone, Debug)]
pub(crate) struct LeafQuery {
    overlap: Workspace,
    /// Contacts of the pair, in the probe's frame.
    pub contacts: Vec<Contact>,
    /// Vertices to start from the next time, if the hulls overlap.
    pub tetrahedron: Option<[(u32, u32); 4]>,
    /// Pairs of triangles within the tolerance: contact, and the triangle of each patch.
    near: Vec<(Contact, u32, u32)>,
    in_reach: InReach,
    /// Of the pairs of triangles examined last, the smallest distance within the tolerance (otherwise infinite),
    /// whichever way they face, and the point on a.
    nearest: (f64, DVec3),
    pub counts: Counts,
}

/// What pairs took.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Counts {
    /// Pairs looked at, with their bounding spheres within reach.
    pub visited: usize,
    /// Pairs examined for contacts.
    pub leaf_pairs: usize,
    pub convex_queries: usize,
    pub not_converged: usize,
    /// Pairs that had to be decided triangle by triangle.
    pub by_triangles: usize,
}

impl Counts {
    pub fn add(&mut self, other: &Self) {
        self.visited += other.visited;
        self.leaf_pairs += other.leaf_pairs;
        self.convex_queries += other.convex_queries;
        self.not_converged += other.not_converged;
        self.by_triangles += other.by_triangles;
    }
}

/// The pair's circumstances.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reach<'a> {
    pub placement: &'a Placement,
    /// d, m.
    pub tolerance: f64,
    /// Smallest length that is told from zero, m.
    pub precision: f64,
    /// How far a hull may stand off the surface that it was built for, m.
    pub looseness: f64,
}

impl Default for LeafQuery {
    fn default() -> Self {
        Self {
            overlap: Workspace::default(),
            contacts: Vec::with_capacity(CONTACTS),
            tetrahedron: None,
            near: Vec::with_capacity(CONTACTS),
            in_reach: InReach::default(),
            nearest: (f64::INFINITY, DVec3::ZERO),
            counts: Counts::default(),
        }
    }
}

impl LeafQuery {
    /// Bytes of memory held, but for the polytope, whose size is fixed.
    pub fn bytes(&self) -> usize {
        self.contacts.capacity() * size_of::<Contact>()
            + self.near.capacity() * size_of::<(Contact, u32, u32)>()
            + self.in_reach.bytes()
            + self.overlap.bytes()
    }

    /// Finds the contacts of a pair of patches, given the distance between their hulls. They are left in
    /// [`contacts`](Self::contacts).
    pub fn run(&mut self, a: &Patch, b: &Patch, found: &Distance, reach: &Reach) {
        self.contacts.clear();
        self.tetrahedron = None;
        let sheet = (a.two_sided && !a.is_single_triangle()) || (b.two_sided && !b.is_single_triangle());
        match found.separation {
            Separation::Beyond => {}
            Separation::Overlapping if sheet || !a.contained || !b.contained => {
                let flat = a.is_single_triangle() && b.is_single_triangle();
                let towards_b = reach.placement.point(b.center) - a.center;
                if flat || self.triangles(a, b, towards_b, reach) {
                    self.penetrating(a, b, found, reach);
                }
            }
            Separation::Overlapping => {
                self.penetrating(a, b, found, reach);
                let shallow = self.contacts.iter().all(|c| c.depth <= reach.looseness);
                if shallow && !(a.is_single_triangle() && b.is_single_triangle()) {
                    // If the triangles are apart, their distances replace the contact. Hulls may touch where they are
                    // virtual; the contact is where the triangles do.
                    let touching = self.contacts.pop();
                    let towards_b = touching.map_or(DVec3::ZERO, |contact| contact.normal);
                    let penetrating = self.triangles(a, b, towards_b, reach);
                    let (distance, at) = self.nearest;
                    if penetrating || (self.contacts.is_empty() && distance <= reach.looseness) {
                        self.contacts
                            .extend(touching.map(|contact| contact_at(at, contact.normal, contact.depth)));
                    }
                }
            }
            Separation::Within | Separation::NotConverged if sheet => {
                self.triangles(a, b, -found.axis, reach);
            }
            Separation::Within | Separation::NotConverged => {
                let (on_a, on_b) = witnesses(a, b, found);
                let (contact, slack) =
                    separated(on_a, reach.placement.point(on_b), found.axis, reach.precision);
                // A patch point that is further than the hull by the looseness may lie this far to the side.
                let aside = (reach.looseness * (2.0 * contact.distance() + reach.looseness)).sqrt();
                let near = [reach.precision, reach.looseness + aside];
                let carriers = found.simplex.vertices();
                let n = contact.normal;
                let at_a = a.surface_at(on_a, n, slack, carriers.iter().map(|v| v.a), near);
                let n = -reach.placement.direction_to_b(n);
                let at_b = b.surface_at(on_b, n, slack, carriers.iter().map(|v| v.b), near);
                match (at_a, at_b) {
                    (Surface::Front, Surface::Front) => self.contacts.push(contact),
                    (Surface::Near, _) | (_, Surface::Near) => {
                        self.triangles(a, b, contact.normal, reach);
                    }
                    (Surface::Virtual, _) | (_, Surface::Virtual)
                        if !(a.contained && b.contained) || ambiguous(a, b, contact.normal, reach) =>
                    {
                        self.triangles(a, b, contact.normal, reach);
                    }
                    _ => {}
                }
            }
        }
    }

    fn distance(&mut self, a: &Patch, b: &Patch, axis: DVec3, reach: &Reach) -> Distance {
        self.counts.convex_queries += 1;
        let limits = Limits { beyond: reach.tolerance, share: 0.0, enough: -1.0, precision: reach.precision };
        let found = gjk::distance(&a.hull, &b.hull, reach.placement, Start::Axis(axis), &limits);
        self.counts.not_converged += usize::from(found.separation == Separation::NotConverged);
        found
    }

    fn penetrating(&mut self, a: &Patch, b: &Patch, found: &Distance, reach: &Reach) {
        self.counts.convex_queries += 1;
        let overlap = overlap(a, b, reach, found, &mut self.overlap);
        self.counts.not_converged += usize::from(!overlap.sure);
        self.contacts.push(overlap.contact);
        self.tetrahedron = Some(overlap.tetrahedron);
    }

    /// Decides the pair by its triangles, given a vector from a to b, which is that of the contact if it is known. `true` if
    /// the patches penetrate; otherwise the separated contacts are reported.
    fn triangles(&mut self, a: &Patch, b: &Patch, towards_b: DVec3, reach: &Reach) -> bool {
        self.counts.by_triangles += 1;
        self.near.clear();
        self.nearest = (f64::INFINITY, DVec3::ZERO);
        self.in_reach.gather(a, b, towards_b, reach);
        for on_a in 0..self.in_reach.of_a.len() {
            for on_b in 0..self.in_reach.of_b.len() {
                let (one, other) = (&self.in_reach.of_a[on_a], &self.in_reach.of_b[on_b]);
                if !one.clears(other, reach.tolerance + reach.precision)
                    && self.triangle_pair(a, b, on_a, on_b, reach)
                {
                    return true;
                }
            }
        }
        if a.contained != b.contained && self.sunk(a, b, reach) {
            return true;
        }
        let same = SAME_POINT * (a.radius + b.radius) + reach.precision;
        for index in 0..self.near.len() {
            let (contact, i, j) = self.near[index];
            if !self.in_reach.undercut(&contact, [i, j], same) && !self.repeated(&contact, reach) {
                self.contacts.push(contact);
            }
        }
        false
    }

    /// Notes the contact of two triangles in reach. `true` if they intersect.
    fn triangle_pair(&mut self, a: &Patch, b: &Patch, on_a: usize, on_b: usize, reach: &Reach) -> bool {
        let (on_a, on_b) = (&self.in_reach.of_a[on_a], &self.in_reach.of_b[on_b]);
        let (i, j, axis) = (on_a.index, on_b.index, on_a.ball.center - on_b.ball.center);
        let corners_a = on_a.corners;
        let corners_b = b.corners(b.triangles.at(j as usize));
        let (one, other) = (a.single(&corners_a), b.single(&corners_b));
        let found = self.distance(&one, &other, axis, reach);
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
        let (contact, slack) = separated(p, reach.placement.point(q), found.axis, reach.precision);
        let n = contact.normal;
        if one.faces(Plane::of(corners_a).normal, n, slack)
            && other.faces(Plane::of(corners_b).normal, -reach.placement.direction_to_b(n), slack)
        {
            self.near.push((contact, i, j));
        }
        false
    }

    /// Whether a triangle of the patch that is not contained lies (partly) inside the hull of the one that is.
    fn sunk(&mut self, a: &Patch, b: &Patch, reach: &Reach) -> bool {
        let touching = Reach { tolerance: 0.0, ..*reach };
        let (loose, hull_is_a) = if a.contained { (b, true) } else { (a, false) };
        loose.triangles.iter().any(|triangle| {
            let corners = loose.corners(triangle);
            let one = loose.single(&corners);
            let found = if hull_is_a {
                self.distance(a, &one, a.center - reach.placement.point(one.center), &touching)
            } else {
                self.distance(&one, b, one.center - reach.placement.point(b.center), &touching)
            };
            found.separation == Separation::Overlapping
        })
    }

    /// Whether an equal contact was reported for this pair already: triangles that share the nearest vertex or edge.
    fn repeated(&self, contact: &Contact, reach: &Reach) -> bool {
        let same = SAME_CONTACT * reach.precision;
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

/// Whether the hulls' features along a normal (a's frame) are parallel, so that their nearest points are not unique.
fn ambiguous(a: &Patch, b: &Patch, normal: DVec3, reach: &Reach) -> bool {
    let placement = reach.placement;
    let on_a = || Feature::of(&a.hull, normal, FEATURE_HEIGHT * a.radius + reach.looseness);
    let on_b = || {
        Feature::of(&b.hull, -placement.direction_to_b(normal), FEATURE_HEIGHT * b.radius + reach.looseness)
    };
    // That of the smaller hull may do.
    let (on_a, on_b) = if a.hull.len() <= b.hull.len() {
        let on_a = on_a();
        if matches!(on_a, Feature::Vertex) {
            return false;
        }
        (on_a, on_b())
    } else {
        let on_b = on_b();
        if matches!(on_b, Feature::Vertex) {
            return false;
        }
        (on_a(), on_b)
    };
    match (on_a, on_b) {
        (Feature::Vertex, _) | (_, Feature::Vertex) => false,
        (Feature::Edge(u), Feature::Edge(v)) => u.cross(placement.direction(v)).length() < PARALLEL_EDGES,
        _ => true,
    }
}

/// The feature of a hull that lies furthest in a direction.
enum Feature {
    Vertex,
    /// With its unit direction.
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
