//! Convex surface patches: the parts of a hull that are real surface.
//!
//! The hull of a convex surface patch has real faces, the patch's triangles, and virtual ones, as in SWIFT++
//! (Ehmann and Lin 2001). The dissertation does not specify how to treat a witness point on a virtual face;
//! here a witness point counts if it lies on a triangle that faces the other object. A solid cannot be
//! touched at a triangle seen from behind, since the solid itself is in between. An open mesh has no inside,
//! and both sides of its triangles count.

use palpate_core::clod::{Node, Triangles};
use palpate_core::glam::DVec3;
use palpate_core::{Clod, Contact};

use crate::ball::Ball;
use crate::convex::{Hull, SupportMap, nearest_on_triangle};
use crate::incidence::triangles_at_vertices;
use crate::tolerances::{FACING, NORMAL_ROUNDING, ON_TRIANGLE, PRECISION};

/// A convex surface patch with its hull, in its body's frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Patch<'a> {
    pub hull: Hull<'a>,
    /// Hull vertices and the patch's other vertices.
    pub vertices: Hull<'a>,
    pub triangles: Triangles<'a>,
    pub center: DVec3,
    pub radius: f64,
    /// Whether the triangles cover the whole hull.
    pub all_real: bool,
    /// Whether the hull lies in the solid that the patch bounds.
    pub contained: bool,
    /// Whether the mesh bounds no solid, so that both sides of a triangle count.
    pub two_sided: bool,
    /// Triangles at each hull vertex, for a patch that has many.
    pub incidence: Option<&'a Incidence>,
}

/// The plane of a triangle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Plane {
    /// Unit outward normal; zero for a triangle without area.
    pub normal: DVec3,
    /// Signed distance of the plane from the origin along the normal, m.
    pub offset: f64,
}

impl Plane {
    /// The plane through three corners, counter-clockwise seen from outside.
    pub fn of([p, q, r]: [DVec3; 3]) -> Self {
        let normal = (q - p).cross(r - p).normalize_or_zero();
        let offset = normal.dot(p);
        Self { normal, offset }
    }

    /// Height of a point above the plane, m.
    pub fn height(&self, point: DVec3) -> f64 {
        self.normal.dot(point) - self.offset
    }
}

/// The planes through a triangle and, upright on it, through its edges.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Prism {
    plane: Plane,
    edges: [Plane; 3],
}

impl Prism {
    pub fn of(corners: [DVec3; 3]) -> Self {
        let plane = Plane::of(corners);
        let [p, q, r] = corners;
        let edges = [(p, q), (q, r), (r, p)].map(|(from, to)| {
            let normal = (to - from).cross(plane.normal).normalize_or_zero();
            let offset = normal.dot(from);
            Plane { normal, offset }
        });
        Self { plane, edges }
    }

    /// Whether one of the planes shows that another triangle is further away than `reach`, m.
    pub fn clears(&self, corners: [DVec3; 3], reach: f64) -> bool {
        let least = |plane: &Plane, sign: f64| {
            let [p, q, r] = corners.map(|corner| sign * plane.height(corner));
            p.min(q).min(r)
        };
        least(&self.plane, 1.0) > reach
            || least(&self.plane, -1.0) > reach
            || self.edges.iter().any(|edge| least(edge, 1.0) > reach)
    }
}

/// The triangles of a patch of one triangle.
const ONE: &[[u32; 3]] = &[[0, 1, 2]];

/// The triangles at each vertex of a patch: for each vertex the start of its range, with one more at the end,
/// and the triangles of all ranges. Indices take two bytes if that is enough.
#[derive(Clone, Debug)]
pub(crate) enum Incidence {
    Shorts { starts: Box<[u16]>, triangles: Box<[u16]> },
    Words { starts: Box<[u32]>, triangles: Box<[u32]> },
}

impl Incidence {
    /// Smallest number of triangles for which looking them up by vertex is faster than testing all.
    pub const MIN_TRIANGLES: usize = 24;

    pub fn new(vertices: usize, triangles: Triangles) -> Self {
        let (starts, at) = triangles_at_vertices(vertices, triangles.iter());
        let short = |all: Vec<u32>| all.into_iter().map(|index| index as u16).collect();
        if u16::try_from(at.len()).is_ok() {
            Self::Shorts { starts: short(starts), triangles: short(at) }
        } else {
            Self::Words { starts: starts.into(), triangles: at.into() }
        }
    }

    /// Memory held, bytes, without itself.
    pub fn bytes(&self) -> usize {
        match self {
            Self::Shorts { starts, triangles } => size_of_val(&**starts) + size_of_val(&**triangles),
            Self::Words { starts, triangles } => size_of_val(&**starts) + size_of_val(&**triangles),
        }
    }

    /// Whether some triangle at a vertex fulfils a condition.
    fn any_around(&self, vertex: u32, mut condition: impl FnMut(usize) -> bool) -> bool {
        let at = vertex as usize;
        match self {
            Self::Shorts { starts, triangles } => {
                let around = &triangles[usize::from(starts[at])..usize::from(starts[at + 1])];
                around.iter().any(|triangle| condition(usize::from(*triangle)))
            }
            Self::Words { starts, triangles } => {
                let around = &triangles[starts[at] as usize..starts[at + 1] as usize];
                around.iter().any(|triangle| condition(*triangle as usize))
            }
        }
    }
}

/// Kind of surface at a point of a hull.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Surface {
    /// A triangle that faces the direction.
    Front,
    /// Triangles that all face away.
    Back,
    /// No triangle, but one so close that the patch's deviation from convexity decides.
    Near,
    /// No triangle.
    Virtual,
}

impl<'a> Patch<'a> {
    /// The patch of a node. `exact`: no vertex is above its triangles' planes, up to rounding.
    pub fn of_node(
        clod: &'a Clod,
        node: &Node,
        map: Option<&'a SupportMap>,
        incidence: Option<&'a Incidence>,
        exact: bool,
    ) -> Self {
        let solid = clod.source.solid;
        // A single triangle's hull is the triangle.
        let contained = node.contained || node.all_real || node.triangles.len() == 1;
        Self {
            hull: Hull::with_map(clod.extreme(node), map),
            vertices: Hull::new(clod.hull(node)),
            triangles: clod.patch(node),
            center: node.center,
            radius: node.radius,
            all_real: node.all_real && solid && exact,
            contained: contained && solid,
            two_sided: !solid,
            incidence,
        }
    }

    /// One triangle of the patch, as a patch of its own with its corners in `corners`.
    pub fn single<'b>(&self, corners: &'b [DVec3; 3]) -> Patch<'b> {
        let Ball { center, radius } = Ball::around(corners);
        Patch {
            hull: Hull::new(corners),
            vertices: Hull::new(corners),
            triangles: Triangles::of(ONE),
            center,
            radius,
            all_real: false,
            contained: !self.two_sided,
            two_sided: self.two_sided,
            incidence: None,
        }
    }

    /// A triangle's corners, m.
    #[inline]
    pub fn corners(&self, triangle: [u32; 3]) -> [DVec3; 3] {
        // Written out, since a map is not inlined.
        let [i, j, k] = triangle;
        [self.vertices.point(i), self.vertices.point(j), self.vertices.point(k)]
    }

    /// A triangle's plane.
    pub fn plane(&self, triangle: [u32; 3]) -> Plane {
        Plane::of(self.corners(triangle))
    }

    /// Whether the patch is a single triangle, so that the hull is real surface only (on both sides).
    pub fn is_single_triangle(&self) -> bool {
        self.triangles.len() == 1 && self.vertices.len() == 3
    }

    /// Whether a triangle with this normal can be touched from the side that `direction` (unit, known to
    /// within the angle `slack`) points to.
    pub fn faces(&self, normal: DVec3, direction: DVec3, slack: f64) -> bool {
        self.two_sided || normal.dot(direction) >= -slack
    }

    /// The kind of surface at a point of the hull (body frame, m), seen from a direction (unit, body axes,
    /// known to within the angle `slack`). `carriers`: hull vertices that the point is a combination of, if
    /// known. `near`: largest distance of a triangle that is near, m.
    pub fn surface_at(
        &self,
        point: DVec3,
        direction: DVec3,
        slack: f64,
        carriers: impl Iterator<Item = u32> + Clone,
        [precision, near]: [f64; 2],
    ) -> Surface {
        if self.all_real || self.carried(direction, slack, carriers) {
            return Surface::Front;
        }
        let on = ON_TRIANGLE * self.radius + precision;
        let near = near.max(on);
        let mut surface = Surface::Virtual;
        // A triangle that is near has a corner at least as high along the direction as the point minus
        // `near`, up to rounding.
        let low = direction.dot(point) - near - PRECISION * self.radius - precision;
        self.each_high(direction, low, |triangle| {
            let corners = self.corners(triangle);
            if surface == Surface::Front || !in_box(point, corners, near) {
                return;
            }
            let distance = distance_to_triangle(corners, point);
            if distance <= on {
                let faces = self.faces(Plane::of(corners).normal, direction, slack);
                surface = if faces { Surface::Front } else { Surface::Back };
            } else if distance <= near && surface == Surface::Virtual {
                surface = Surface::Near;
            }
        });
        surface
    }

    /// Calls `each` once with every triangle that has a corner at least as high along a direction as `low`,
    /// m.
    #[inline]
    fn each_high(&self, direction: DVec3, low: f64, mut each: impl FnMut([u32; 3])) {
        match self.incidence {
            Some(incidence) => {
                let is_high = |vertex: u32| self.vertices.point(vertex).dot(direction) >= low;
                self.vertices.each_beyond(direction, low, |vertex, _| {
                    incidence.any_around(vertex, |index| {
                        // Each triangle is passed at the first of its corners that is high.
                        let triangle = self.triangles.at(index);
                        let mut earlier = triangle.into_iter().take_while(|corner| *corner != vertex);
                        if !earlier.any(is_high) {
                            each(triangle);
                        }
                        false
                    });
                });
            }
            None => {
                // One bit for each vertex: patches without incidence have few.
                let mut high = 0u128;
                self.vertices
                    .each_beyond(direction, low, |vertex, _| high |= 1u128.checked_shl(vertex).unwrap_or(0));
                let is_high = |vertex: u32| vertex >= u128::BITS || high >> vertex & 1 != 0;
                self.triangles.any(|triangle| {
                    let [i, j, k] = triangle;
                    if is_high(i) || is_high(j) || is_high(k) {
                        each(triangle);
                    }
                    false
                });
            }
        }
    }

    /// Whether some triangle that faces a direction has all of these vertices, and so every convex
    /// combination of them.
    fn carried(&self, direction: DVec3, slack: f64, mut carriers: impl Iterator<Item = u32> + Clone) -> bool {
        let Some(first) = carriers.next() else { return false };
        self.any_at(first, |triangle| {
            carriers.clone().all(|vertex| triangle.contains(&vertex))
                && self.faces(self.plane(triangle).normal, direction, slack)
        })
    }

    /// Whether some triangle at a vertex of the hull can be touched from a direction (unit, body axes).
    pub fn vertex_faces(&self, vertex: u32, direction: DVec3) -> bool {
        self.two_sided
            || self.any_at(vertex, |triangle| self.plane(triangle).normal.dot(direction) >= -FACING)
    }

    /// Whether some triangle at a vertex fulfils a condition.
    fn any_at(&self, vertex: u32, mut condition: impl FnMut([u32; 3]) -> bool) -> bool {
        match self.incidence {
            Some(incidence) => incidence.any_around(vertex, |index| condition(self.triangles.at(index))),
            None => self.triangles.any(|triangle| triangle.contains(&vertex) && condition(triangle)),
        }
    }
}

/// Whether a point may be within `reach` (m) of a triangle, by the triangle's bounding box.
pub(crate) fn in_box(point: DVec3, [p, q, r]: [DVec3; 3], reach: f64) -> bool {
    let (low, high) = (p.min(q).min(r) - reach, p.max(q).max(r) + reach);
    !(point.cmplt(low).any() || point.cmpgt(high).any())
}

/// Distance from a point to a triangle, m.
pub(crate) fn distance_to_triangle(corners: [DVec3; 3], point: DVec3) -> f64 {
    let [p, q, r] = corners.map(|c| c - point);
    let [u, v, w] = nearest_on_triangle(p, q, r);
    (u * p + v * q + w * r).length()
}

/// Makes a contact in the probe's frame from the two nearest points of separated surfaces and the vector from
/// b to a between them, whose direction may be more accurate than that of the points. Also returns the
/// accuracy of the normal, rad.
pub(crate) fn separated(on_a: DVec3, on_b: DVec3, axis: DVec3, precision: f64) -> (Contact, f64) {
    let distance = on_a.distance(on_b);
    let contact = Contact { point: on_a, scene_point: on_b, normal: -axis.normalize(), depth: -distance };
    (contact, FACING + NORMAL_ROUNDING * precision / distance)
}
