//! The triangles of two patches that may be within the tolerance of one another, for pairs that are decided
//! triangle by triangle.
//!
//! Most triangles of large patches are culled by their extent along one direction, the normal of the patches'
//! contact if that is known: a triangle of b is kept if its extent begins before that of a ends, and one of a
//! if its extent ends after that of b begins, with the tolerance as a margin.

use palpate_core::Contact;
use palpate_core::glam::DVec3;

use super::context::PairContext;
use crate::ball::Ball;
use crate::patch::{Patch, Prism, distance_to_triangle, in_box};
use crate::tolerances::TRIANGLE_SPHERE_SLACK;

/// Number of triangles of either patch that there is room for at first: patches have at most a few hundred.
const TRIANGLES: usize = 256;

/// A triangle in a's frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placed {
    /// Index in its patch.
    pub index: u32,
    pub corners: [DVec3; 3],
    /// Extent along the direction, from begin to end, m.
    extent: [f64; 2],
    pub ball: Ball,
    prism: Prism,
}

impl Placed {
    fn new(index: u32, corners: [DVec3; 3], extent: [f64; 2]) -> Self {
        Self { index, corners, extent, ball: Ball::around(&corners), prism: Prism::of(corners) }
    }

    /// Whether a triangle of b is certainly further than a length (m) from this one of a, by quick tests.
    pub fn clears(&self, other: &Self, length: f64) -> bool {
        other.extent[0] - self.extent[1] > length
            || !reaches(&self.ball, &other.ball, length)
            || self.prism.clears(other.corners, length)
            || other.prism.clears(self.corners, length)
    }

    /// Whether a point is within `reach` (m) of the triangle, and another one closer than `distance` (m).
    fn undercuts(&self, point: DVec3, reach: f64, other: DVec3, distance: f64) -> bool {
        in_box(point, self.corners, reach)
            && distance_to_triangle(self.corners, point) <= reach
            && distance_to_triangle(self.corners, other) < distance
    }
}

/// The triangles of two patches that may be within the tolerance of one another.
#[derive(Clone, Debug)]
pub(crate) struct InReach {
    pub of_a: Vec<Placed>,
    pub of_b: Vec<Placed>,
}

impl Default for InReach {
    fn default() -> Self {
        Self { of_a: Vec::with_capacity(TRIANGLES), of_b: Vec::with_capacity(TRIANGLES) }
    }
}

impl InReach {
    pub fn bytes(&self) -> usize {
        (self.of_a.capacity() + self.of_b.capacity()) * size_of::<Placed>()
    }

    /// Gathers the triangles. `towards_b` is a vector from a to b; the closer it is to the normal of their
    /// contact, the more triangles are culled.
    pub fn gather(&mut self, a: &Patch, b: &Patch, towards_b: DVec3, pair: &PairContext) {
        let placement = pair.placement;
        let tolerance = pair.tolerance + pair.precision;
        let direction = towards_b.normalize_or_zero();
        let end_of_a = a.vertices.end(direction);
        let back = -placement.direction_to_b(direction);
        let origin_of_b = placement.translation.dot(direction);
        let sphere_of_a = Ball { center: a.center, radius: a.radius };
        self.of_b.clear();
        for (index, triangle) in (0u32..).zip(b.triangles) {
            let own = b.corners(triangle);
            let begin = origin_of_b - end(&own, back);
            if begin - end_of_a > tolerance {
                continue;
            }
            let placed =
                Placed::new(index, own.map(|corner| placement.point(corner)), [begin, f64::INFINITY]);
            if reaches(&sphere_of_a, &placed.ball, tolerance) {
                self.of_b.push(placed);
            }
        }
        let begin_of_b = self.of_b.iter().map(|placed| placed.extent[0]).fold(f64::INFINITY, f64::min);
        let sphere_of_b = Ball { center: placement.point(b.center), radius: b.radius };
        self.of_a.clear();
        for (index, triangle) in (0u32..).zip(a.triangles) {
            let corners = a.corners(triangle);
            let end = end(&corners, direction);
            if begin_of_b - end > tolerance {
                continue;
            }
            let placed = Placed::new(index, corners, [f64::NEG_INFINITY, end]);
            if reaches(&placed.ball, &sphere_of_b, tolerance) {
                self.of_a.push(placed);
            }
        }
    }

    /// Whether other triangles at a contact's points are closer than the pair `[i, j]`, so that it is no
    /// local minimum. Such triangles are in reach.
    pub fn undercut(&self, contact: &Contact, [i, j]: [u32; 2], same: f64) -> bool {
        let distance = contact.distance() - same;
        let (p, q) = (contact.point, contact.scene_point);
        self.of_a.iter().any(|other| other.index != i && other.undercuts(p, same, q, distance))
            || self.of_b.iter().any(|other| other.index != j && other.undercuts(q, same, p, distance))
    }
}

/// Largest coordinate of three points along a direction, m.
fn end(points: &[DVec3; 3], direction: DVec3) -> f64 {
    points.iter().map(|point| point.dot(direction)).fold(f64::NEG_INFINITY, f64::max)
}

/// Whether two spheres are within a length of one another, m.
fn reaches(a: &Ball, b: &Ball, length: f64) -> bool {
    let reach = a.radius + b.radius + length;
    a.center.distance_squared(b.center) <= reach * reach * (1.0 + TRIANGLE_SPHERE_SLACK)
}
