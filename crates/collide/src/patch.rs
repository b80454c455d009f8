//! Which part of a hull is real surface.
//!
//! The hull of a convex surface patch has real faces, the patch's triangles, and virtual ones, as in SWIFT++ (Ehmann and
//! Lin 2001). The dissertation does not say what to do with a witness point on a virtual face; here a witness counts
//! when it lies on a triangle that faces the other object. A solid's triangle seen from behind is no place of
//! contact: the solid itself is in between. An open mesh has no inside, and both sides of its triangles count.

use palpate_core::clod::Node;
use palpate_core::glam::DVec3;
use palpate_core::{Clod, Contact};

use crate::ball::Ball;
use crate::convex::{Hull, SupportMap, nearest_on_triangle};

/// A witness within this fraction of a patch's radius of a triangle lies on it. Patches are convex, and contained, only
/// up to the tolerance that they were built with; a witness that misses the triangles by no more than that is
/// [`Surface::Near`] them.
const ON_TRIANGLE: f64 = 1e-9;

/// Sine of the angle by which a triangle may be turned away and still count as facing.
pub(crate) const FACING: f64 = 1e-9;

/// A convex surface patch with its hull, in its body's frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Patch<'a> {
    pub hull: Hull<'a>,
    /// Hull vertices and the patch's other vertices.
    pub vertices: &'a [DVec3],
    pub triangles: &'a [[u32; 3]],
    /// The triangles' planes; none for a patch that was made of a [single](Patch::single) one.
    pub planes: &'a [Plane],
    pub center: DVec3,
    pub radius: f64,
    /// The triangles cover the hull, to the last bit.
    pub all_real: bool,
    /// The hull lies in the solid that the patch bounds.
    pub contained: bool,
    /// The mesh bounds no solid.
    pub two_sided: bool,
    /// Triangles at each hull vertex, for a patch that has many.
    pub incidence: Option<&'a Incidence>,
}

/// The plane of a triangle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Plane {
    /// Unit outward normal; zero for a triangle without area.
    pub normal: DVec3,
    /// How far the plane lies from the origin along the normal, m.
    pub offset: f64,
    /// How far the hull that the triangle belongs to reaches along the normal, m: a little further where a patch is convex
    /// up to a tolerance.
    pub top: f64,
}

impl Plane {
    pub fn of([p, q, r]: [DVec3; 3]) -> Self {
        let normal = (q - p).cross(r - p).normalize_or_zero();
        let offset = normal.dot(p);
        Self { normal, offset, top: offset }
    }

    /// How far a point lies above the plane, m.
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
            Plane { normal, offset, top: offset }
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

/// The triangles at each vertex of a patch.
#[derive(Clone, Debug, Default)]
pub(crate) struct Incidence {
    /// Per vertex, where its triangles start; one more at the end.
    starts: Vec<u32>,
    triangles: Vec<u32>,
}

impl Incidence {
    /// From this many triangles on, looking them up by vertex is faster than going through them.
    pub const WORTHWHILE: usize = 24;

    pub fn new(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        let mut starts = vec![0u32; vertices + 1];
        for vertex in triangles.iter().flatten() {
            starts[*vertex as usize + 1] += 1;
        }
        for index in 0..vertices {
            starts[index + 1] += starts[index];
        }
        let mut next = starts.clone();
        let mut at = vec![0u32; 3 * triangles.len()];
        for (index, corners) in (0u32..).zip(triangles) {
            for vertex in corners {
                at[next[*vertex as usize] as usize] = index;
                next[*vertex as usize] += 1;
            }
        }
        Self { starts, triangles: at }
    }

    pub fn bytes(&self) -> usize {
        (self.starts.len() + self.triangles.len()) * size_of::<u32>()
    }

    fn around(&self, vertex: u32) -> &[u32] {
        let range = self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize;
        &self.triangles[range]
    }
}

/// What lies at a point of a hull.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Surface {
    /// A triangle that faces the direction asked about.
    Front,
    /// Triangles, all turned away.
    Back,
    /// No triangle, but one so close that it depends on how exactly the patch is convex.
    Near,
    /// No triangle.
    Virtual,
}

impl<'a> Patch<'a> {
    /// The patch of a node. `exact`: its triangles' planes have all of its vertices below them, to rounding.
    pub fn of_node(
        clod: &'a Clod,
        node: &'a Node,
        planes: &'a [Plane],
        map: Option<&'a SupportMap>,
        incidence: Option<&'a Incidence>,
        exact: bool,
    ) -> Self {
        let solid = clod.source.solid;
        // A single triangle's hull is the triangle.
        let contained = node.contained || node.all_real || node.triangles.len() == 1;
        Self {
            hull: Hull::with_map(clod.extreme(node), map),
            vertices: clod.hull(node),
            triangles: clod.patch(node),
            planes,
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
            vertices: corners,
            triangles: &[[0, 1, 2]],
            planes: &[],
            center,
            radius,
            all_real: false,
            contained: !self.two_sided,
            two_sided: self.two_sided,
            incidence: None,
        }
    }

    pub fn corners(&self, triangle: [u32; 3]) -> [DVec3; 3] {
        triangle.map(|v| self.vertices[v as usize])
    }

    /// Whether the hull is nothing but real surface (of either side).
    pub fn is_single_triangle(&self) -> bool {
        self.triangles.len() == 1 && self.vertices.len() == 3
    }

    /// Whether a triangle with this normal can be touched from the side that `direction` (unit, known to within the angle
    /// `slack`) points to.
    pub fn faces(&self, normal: DVec3, direction: DVec3, slack: f64) -> bool {
        self.two_sided || normal.dot(direction) >= -slack
    }

    /// What lies at a point of the hull (body frame, m), seen from a direction (unit, body axes, known to within the
    /// angle `slack`). `carriers`: hull vertices that the point is a combination of, if known. `near`: how far a
    /// triangle may be to be near.
    pub fn surface_at(
        &self,
        point: DVec3,
        direction: DVec3,
        slack: f64,
        carriers: impl Iterator<Item = u32> + Clone,
        [precision, near]: [f64; 2],
    ) -> Surface {
        if self.all_real {
            return Surface::Front;
        }
        if self.carried(direction, slack, carriers) {
            return Surface::Front;
        }
        let on = ON_TRIANGLE * self.radius + precision;
        let near = near.max(on);
        let mut surface = Surface::Virtual;
        // The height is known to rounding only.
        let high = near + 1e-12 * self.radius + precision;
        for (plane, &triangle) in self.planes.iter().zip(self.triangles) {
            if plane.height(point).abs() > high || !self.in_box(point, triangle, near) {
                continue;
            }
            let distance = distance_to_triangle(self.corners(triangle), point);
            if distance <= on {
                if self.faces(plane.normal, direction, slack) {
                    return Surface::Front;
                }
                surface = Surface::Back;
            } else if distance <= near && surface == Surface::Virtual {
                surface = Surface::Near;
            }
        }
        surface
    }

    /// Whether some triangle that faces a direction has all of these vertices, and so whatever point they combine to.
    fn carried(&self, direction: DVec3, slack: f64, mut carriers: impl Iterator<Item = u32> + Clone) -> bool {
        let Some(first) = carriers.next() else { return false };
        let carries = |(triangle, plane): (&[u32; 3], &Plane)| {
            triangle.contains(&first)
                && carriers.clone().all(|vertex| triangle.contains(&vertex))
                && self.faces(plane.normal, direction, slack)
        };
        match self.incidence {
            Some(incidence) => {
                let at = |&index: &u32| (&self.triangles[index as usize], &self.planes[index as usize]);
                incidence.around(first).iter().map(at).any(carries)
            }
            None => self.triangles.iter().zip(self.planes).any(carries),
        }
    }

    /// Whether a point (body frame, m) may be within `reach` of a triangle.
    fn in_box(&self, point: DVec3, triangle: [u32; 3], reach: f64) -> bool {
        let [p, q, r] = self.corners(triangle);
        let (low, high) = (p.min(q).min(r) - reach, p.max(q).max(r) + reach);
        !(point.cmplt(low).any() || point.cmpgt(high).any())
    }

    /// Whether some triangle at vertex `vertex` of the hull can be touched from a direction (unit, body axes).
    pub fn vertex_faces(&self, vertex: u32, direction: DVec3) -> bool {
        let facing = |plane: &Plane| plane.normal.dot(direction) >= -FACING;
        if self.two_sided {
            return true;
        }
        match self.incidence {
            Some(incidence) => {
                incidence.around(vertex).iter().any(|index| facing(&self.planes[*index as usize]))
            }
            None => self.triangles.iter().zip(self.planes).any(|(t, p)| t.contains(&vertex) && facing(p)),
        }
    }
}

/// Distance from a point to a triangle.
pub(crate) fn distance_to_triangle(corners: [DVec3; 3], point: DVec3) -> f64 {
    let [p, q, r] = corners.map(|c| c - point);
    let [u, v, w] = nearest_on_triangle(p, q, r);
    (u * p + v * q + w * r).length()
}

/// A contact in the probe's frame from the two nearest points of separated surfaces, and the vector from b to a between
/// them, whose direction may be known better than from the points; with the angle to which it is known.
pub(crate) fn separated(on_a: DVec3, on_b: DVec3, axis: DVec3, precision: f64) -> (Contact, f64) {
    let distance = on_a.distance(on_b);
    let contact = Contact { point: on_a, scene_point: on_b, normal: -axis.normalize(), depth: -distance };
    (contact, FACING + 1e-3 * precision / distance)
}
