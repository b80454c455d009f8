//! Convex hulls of small and large point sets in three dimensions.
//!
//! Quickhull (Barber, Dobkin, Huhdanpaa 1996) with exact visibility tests (Shewchuk 1997, the `robust`
//! crate). A face is visible from a point only if the point lies strictly above it. With exact tests, the
//! visible region of a convex polytope is then a disc with a simple closed horizon, and no new face can
//! degenerate, even where points are coplanar, collinear or repeated: no merging of facets and no
//! perturbation is needed. Departing from the paper, coplanar facets stay triangulated, and vertices that
//! turn out to lie on a facet or an edge are left out of the extreme points at the end.
//!
//! Points on a face up to a given thickness are dropped, since rounding noise on flat facets would otherwise
//! become vertices. Sets without thickness give a point, a segment or a polygon.

mod planar;
mod quickhull;

use glam::DVec3;
use robust::{Coord3D, orient3d};

pub(crate) use planar::polygon;
pub(crate) use quickhull::HullBuilder;

/// Dimension of a hull.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Shape {
    /// One extreme point.
    Point,
    /// Two extreme points.
    Segment,
    /// Extreme points in order around a planar polygon.
    Polygon,
    /// A polytope bounded by triangles.
    Polytope,
}

/// A convex hull, as indices into the points that it was made of.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Hull {
    /// Its dimension.
    pub shape: Shape,
    /// The extreme points: ascending, but around the boundary for a polygon.
    pub extreme: Vec<u32>,
    /// The triangles of a polytope's boundary, counter-clockwise seen from outside; neighbours may be
    /// coplanar. Empty for the other shapes.
    pub faces: Vec<[u32; 3]>,
}

/// The half-space n·x ≤ d.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Plane {
    /// n, the unit normal; zero for a plane through points on a line.
    pub normal: DVec3,
    /// d, its distance from the origin.
    pub offset: f64,
}

impl Plane {
    /// A plane that everything is below.
    pub const NONE: Self = Self { normal: DVec3::ZERO, offset: f64::INFINITY };

    /// The plane through three points, counter-clockwise seen from its outer side.
    pub fn through([a, b, c]: [DVec3; 3]) -> Self {
        let normal = (b - a).cross(c - a).normalize_or_zero();
        Self { normal, offset: normal.dot(a).max(normal.dot(b)).max(normal.dot(c)) }
    }

    /// The plane through three points; `None` if they are too close to a line to define one.
    pub fn dependable([a, b, c]: [DVec3; 3]) -> Option<Self> {
        let longest = (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
        ((b - a).cross(c - a).length() > 1e-7 * longest).then(|| Self::through([a, b, c]))
    }

    /// Height of a point above the plane, on its outer side.
    pub fn height(&self, point: DVec3) -> f64 {
        self.normal.dot(point) - self.offset
    }
}

impl Hull {
    /// The planes of a polytope's faces. Faces too narrow to have a dependable normal are left out: the
    /// remaining planes enclose a polytope that is larger by about the width of the face.
    pub fn planes<'a>(&'a self, points: &'a [DVec3]) -> impl Iterator<Item = Plane> + 'a {
        self.faces.iter().filter_map(|face| Plane::dependable(face.map(|v| points[v as usize])))
    }
}

/// The boundary of the convex hull of finite points, as triangles of indices into them, counter-clockwise
/// seen from outside, for drawing. The polygon of points in a plane is there once for each of its sides;
/// points on a line have no faces. A hull that is thinner than 1e-12 of its extent counts as flat.
pub fn hull_faces(points: &[DVec3]) -> Vec<[u32; 3]> {
    let Some(&first) = points.first() else { return Vec::new() };
    let extent = points.iter().map(|point| point.distance(first)).fold(0.0, f64::max);
    let hull = HullBuilder::default().hull(points, 1e-12 * extent);
    match hull.shape {
        Shape::Polytope => hull.faces,
        Shape::Polygon => {
            let fan =
                (2..hull.extreme.len()).map(|k| [hull.extreme[0], hull.extreme[k - 1], hull.extreme[k]]);
            fan.flat_map(|[a, b, c]| [[a, b, c], [a, c, b]]).collect()
        }
        Shape::Point | Shape::Segment => Vec::new(),
    }
}

/// Six times the signed volume of the tetrahedron (a, b, c, p): positive where p lies above the plane through
/// a, b, c, which are counter-clockwise seen from above. The sign is exact.
pub(crate) fn elevation(a: DVec3, b: DVec3, c: DVec3, p: DVec3) -> f64 {
    let coord = |v: DVec3| Coord3D { x: v.x, y: v.y, z: v.z };
    -orient3d(coord(a), coord(b), coord(c), coord(p))
}

#[cfg(test)]
mod tests;
