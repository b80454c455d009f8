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

use crate::ball::Ball;
use crate::convex::{Distance, Limits, Placement, Polytope, Separation, Start, gjk};
use crate::patch::{Patch, Plane, Prism, Surface, distance_to_triangle, separated};
use crate::query::overlap::{contact_at, overlap};

/// Contacts, and triangles, of a pair of patches that there is room for at first: patches have at most a few hundred.
const CONTACTS: usize = 512;
const TRIANGLES: usize = 256;

/// Buffers for the contacts of one pair of leaves, with counts over a whole query.
#[derive(Clone, Debug)]
pub(crate) struct LeafQuery {
    pub polytope: Polytope,
    /// Contacts of the pair, in the probe's frame.
    pub contacts: Vec<Contact>,
    /// Vertices to start from the next time, if the hulls overlap.
    pub tetrahedron: Option<[(u32, u32); 4]>,
    /// Pairs of triangles within the tolerance: contact, and the triangle of each patch.
    near: Vec<(Contact, u32, u32)>,
    /// Triangles of b that are within the tolerance of a's sphere.
    in_reach: Vec<Placed>,
    /// Of the pairs of triangles examined last, the smallest distance within the tolerance (otherwise infinite),
    /// whichever way they face, and the point on a.
    nearest: (f64, DVec3),
    pub counts: Counts,
}

/// A triangle of b in a's frame.
#[derive(Clone, Copy, Debug)]
struct Placed {
    index: u32,
    corners: [DVec3; 3],
    /// How far it begins along the direction from a to b, m.
    begin: f64,
    ball: Ball,
    prism: Prism,
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
            polytope: Polytope::default(),
            contacts: Vec::with_capacity(CONTACTS),
            tetrahedron: None,
            near: Vec::with_capacity(CONTACTS),
            in_reach: Vec::with_capacity(TRIANGLES),
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
            + self.in_reach.capacity() * size_of::<Placed>()
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
        let overlap = overlap(a, b, reach, found, &mut self.polytope);
        self.counts.not_converged += usize::from(!overlap.sure);
        self.contacts.push(overlap.contact);
        self.tetrahedron = Some(overlap.tetrahedron);
    }

    /// Places the triangles of b that may be within the tolerance of a, given a unit vector from a to b, or zero.
    fn place(&mut self, a: &Patch, b: &Patch, towards_b: DVec3, reach: &Reach) {
        let placement = reach.placement;
        let tolerance = reach.tolerance + reach.precision;
        let ends = a.triangles.iter().map(|&on_a| end_along(&a.corners(on_a), towards_b));
        let end = ends.fold(f64::NEG_INFINITY, f64::max);
        let back = -placement.direction_to_b(towards_b);
        let from = placement.translation.dot(towards_b);
        self.in_reach.clear();
        for (j, &on_b) in (0u32..).zip(b.triangles) {
            let own = b.corners(on_b);
            let begin = from - end_along(&own, back);
            if begin - end > tolerance {
                continue;
            }
            let corners = own.map(|corner| placement.point(corner));
            let ball = Ball::around(&corners);
            if reaches(a.center, a.radius, ball.center, ball.radius, tolerance) {
                self.in_reach.push(Placed { index: j, corners, begin, ball, prism: Prism::of(corners) });
            }
        }
    }

    /// Decides the pair by its triangles. `true` if the patches penetrate; otherwise the separated contacts are reported.
    /// Triangles that a vector from a to b tells apart are passed over: the closer it is to the normal, the more.
    fn triangles(&mut self, a: &Patch, b: &Patch, towards_b: DVec3, reach: &Reach) -> bool {
        self.counts.by_triangles += 1;
        self.near.clear();
        self.nearest = (f64::INFINITY, DVec3::ZERO);
        let placement = reach.placement;
        let tolerance = reach.tolerance + reach.precision;
        let towards_b = towards_b.normalize_or_zero();
        self.place(a, b, towards_b, reach);
        let begin = self.in_reach.iter().map(|placed| placed.begin).fold(f64::INFINITY, f64::min);
        let center_of_b = placement.point(b.center);
        for (i, &on_a) in (0u32..).zip(a.triangles) {
            let corners_a = a.corners(on_a);
            let end = end_along(&corners_a, towards_b);
            if begin - end > tolerance {
                continue;
            }
            let one = a.single(&corners_a);
            if !reaches(one.center, one.radius, center_of_b, b.radius, tolerance) {
                continue;
            }
            let prism = Prism::of(corners_a);
            for index in 0..self.in_reach.len() {
                let Placed { index: j, corners, begin, ball, prism: ref prism_b } = self.in_reach[index];
                if begin - end > tolerance
                    || !reaches(one.center, one.radius, ball.center, ball.radius, tolerance)
                    || prism.clears(corners, tolerance)
                    || prism_b.clears(corners_a, tolerance)
                {
                    continue;
                }
                let corners_b = b.corners(b.triangles[j as usize]);
                let other = b.single(&corners_b);
                let found = self.distance(&one, &other, one.center - ball.center, reach);
                match found.separation {
                    Separation::Beyond => {}
                    Separation::Overlapping => {
                        self.nearest = (0.0, witnesses(&one, &other, &found).0);
                        return true;
                    }
                    Separation::Within | Separation::NotConverged => {
                        let (p, q) = witnesses(&one, &other, &found);
                        if found.distance < self.nearest.0 {
                            self.nearest = (found.distance, p);
                        }
                        let (contact, slack) = separated(p, placement.point(q), found.axis, reach.precision);
                        let n = contact.normal;
                        if one.faces(Plane::of(corners_a).normal, n, slack)
                            && other.faces(Plane::of(corners_b).normal, -placement.direction_to_b(n), slack)
                        {
                            self.near.push((contact, i, j));
                        }
                    }
                }
            }
        }
        if a.contained != b.contained && self.sunk(a, b, reach) {
            return true;
        }
        for index in 0..self.near.len() {
            let (contact, i, j) = self.near[index];
            if local_minimum(a, b, &contact, [i, j], reach) && !self.repeated(&contact, reach) {
                self.contacts.push(contact);
            }
        }
        false
    }

    /// Whether a triangle of the patch that is not contained lies (partly) inside the hull of the one that is.
    fn sunk(&mut self, a: &Patch, b: &Patch, reach: &Reach) -> bool {
        let touching = Reach { tolerance: 0.0, ..*reach };
        let (loose, hull_is_a) = if a.contained { (b, true) } else { (a, false) };
        loose.triangles.iter().any(|&triangle| {
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
        let same = 16.0 * reach.precision;
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

/// How far a triangle reaches along a direction.
fn end_along([p, q, r]: &[DVec3; 3], direction: DVec3) -> f64 {
    direction.dot(*p).max(direction.dot(*q)).max(direction.dot(*r))
}

fn reaches(a: DVec3, radius_a: f64, b: DVec3, radius_b: f64, tolerance: f64) -> bool {
    let reach = radius_a + radius_b + tolerance;
    a.distance_squared(b) <= reach * reach * (1.0 + 1e-12)
}

/// Whether other triangles of the patches at the contact's points undercut the pair `[i, j]`.
fn local_minimum(a: &Patch, b: &Patch, contact: &Contact, [i, j]: [u32; 2], reach: &Reach) -> bool {
    let same = 1e-9 * (a.radius + b.radius) + reach.precision;
    let distance = contact.distance() - same;
    let to_b = |p: DVec3| reach.placement.direction_to_b(p - reach.placement.translation);
    let (q_in_b, p_in_b) = (to_b(contact.scene_point), to_b(contact.point));
    let undercut_a = (0u32..).zip(a.triangles).any(|(index, &triangle)| {
        index != i
            && a.lies_on(contact.point, triangle, same)
            && distance_to_triangle(a.corners(triangle), contact.scene_point) < distance
    });
    let undercut_b = || {
        (0u32..).zip(b.triangles).any(|(index, &triangle)| {
            index != j
                && b.lies_on(q_in_b, triangle, same)
                && distance_to_triangle(b.corners(triangle), p_in_b) < distance
        })
    };
    !undercut_a && !undercut_b()
}

/// Whether the hulls' features along a normal (a's frame) are parallel, so that their nearest points are not unique.
fn ambiguous(a: &Patch, b: &Patch, normal: DVec3, reach: &Reach) -> bool {
    let placement = reach.placement;
    let on_a = Feature::of(a.hull.points(), normal, 1e-7 * a.radius + reach.looseness);
    let on_b =
        Feature::of(b.hull.points(), -placement.direction_to_b(normal), 1e-7 * b.radius + reach.looseness);
    match (on_a, on_b) {
        (Feature::Vertex, _) | (_, Feature::Vertex) => false,
        (Feature::Edge(u), Feature::Edge(v)) => u.cross(placement.direction(v)).length() < 1e-6,
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
    fn of(points: &[DVec3], direction: DVec3, tolerance: f64) -> Self {
        let top = points.iter().map(|p| p.dot(direction)).fold(f64::NEG_INFINITY, f64::max);
        let mut ends = points.iter().filter(|p| p.dot(direction) >= top - tolerance);
        match (ends.next(), ends.next(), ends.next()) {
            (Some(p), Some(q), None) => Self::Edge((*q - *p).normalize_or_zero()),
            (Some(_), Some(_), Some(_)) => Self::Face,
            _ => Self::Vertex,
        }
    }
}
