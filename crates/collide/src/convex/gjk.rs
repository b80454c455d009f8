//! Distance between two convex hulls: the algorithm of Gilbert, Johnson and Keerthi (1988), cited in §3.4.1,
//! with van den Bergen's bounds (1999).
//!
//! The hulls are apart by the distance of the origin from the Minkowski difference a − b. A simplex of its
//! vertices moves towards the origin. In each iteration **v** is the simplex's point nearest to the origin,
//! and **w** the vertex of a − b furthest along −**v**:
//!
//! - |**v**| is an upper bound on the distance, since **v** is a point of a − b;
//! - **v** · **w** / |**v**| is a lower bound, since all of a − b lies beyond the plane through **w** across
//!   **v**.
//!
//! So the query "further apart than d?" ends as soon as either bound decides it. The search ends when the
//! bounds meet to within [`Limits::precision`], or when no vertex brings the simplex closer to the origin.
//! The number of iterations is bounded, and a gap that remains is reported as [`Separation::NotConverged`].

use palpate_core::glam::DVec3;

use super::placement::Placement;
use super::simplex::{Simplex, Vertex};
use super::support::Hull;
use crate::tolerances::{AXIS_ROUNDING, CONVERGED_GAP};

/// Largest number of iterations. Polyhedra need a few; round hulls of thousands of vertices some thirty.
const MAX_ITERATIONS: u32 = 128;

/// Limits at which a distance query stops.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Stop as soon as the hulls are known to be further apart than this, m. Hulls that touch to within the
    /// precision never are.
    pub beyond: f64,
    /// Share of the distance in excess of `beyond` that has to be proven before the search stops there: 0
    /// for none, near 1 for all of it.
    pub share: f64,
    /// Stop as soon as the hulls are known to be at most this far apart, m. With a negative number the
    /// search goes on to the distance itself.
    pub enough: f64,
    /// Difference below which bounds are equal, and distance below which hulls touch, m.
    pub precision: f64,
}

/// The start of a search.
#[derive(Clone, Copy, Debug)]
pub enum Start<'a> {
    /// An estimate of the vector from b to a, in a's frame.
    Axis(DVec3),
    /// Vertices of a and b at the nearest points of an earlier query at another placement, at most four
    /// pairs. Without any, the search starts along the axis.
    Vertices(&'a [(u32, u32)], DVec3),
}

/// Relation of two hulls.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Separation {
    /// Further apart than [`Limits::beyond`].
    Beyond,
    /// Apart, and not further than that.
    Within,
    /// Touching or overlapping.
    Overlapping,
    /// The iterations ran out; the distance found is only an upper bound.
    NotConverged,
}

/// The answer of a distance query.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distance {
    /// Relation of the hulls.
    pub separation: Separation,
    /// Distance (an upper bound, exact unless the search was stopped early), m. For hulls beyond the limit
    /// it is infinite when the first axis already separates them.
    pub distance: f64,
    /// Lower bound on the distance, m; 0 when overlapping.
    pub lower: f64,
    /// Unit direction from b to a along which the lower bound separates the hulls, in a's frame; zero
    /// without one.
    pub direction: DVec3,
    /// The vector from b to a between the nearest points found, in a's frame, m.
    pub axis: DVec3,
    /// Vertices and weights of the nearest points; a simplex around the origin when overlapping.
    pub simplex: Simplex,
    /// Number of iterations made.
    pub iterations: u32,
}

impl Distance {
    /// The distance of two hulls before the search.
    const UNKNOWN: Self = Self {
        separation: Separation::NotConverged,
        distance: f64::INFINITY,
        lower: 0.0,
        direction: DVec3::ZERO,
        axis: DVec3::ZERO,
        simplex: Simplex {
            vertices: [Vertex { difference: DVec3::ZERO, a: 0, b: 0 }; 4],
            weights: [0.0; 4],
            len: 0,
        },
        iterations: 0,
    };

    /// Raises the lower bound to **v** · **w** / |**v**| for the vertex **w** furthest against the axis
    /// **v**, if that is larger. Returns it, m.
    #[inline]
    fn bound_below(&mut self, vertex: &Vertex) -> f64 {
        let length = self.axis.length();
        let lower = self.axis.dot(vertex.difference) / length;
        if lower > self.lower {
            (self.lower, self.direction) = (lower, self.axis / length);
        }
        lower
    }

    /// The nearest points on a and on b, both in a's frame, m.
    pub fn witnesses(&self, a: &Hull, b: &Hull, placement: &Placement) -> (DVec3, DVec3) {
        let (mut on_a, mut on_b) = (DVec3::ZERO, DVec3::ZERO);
        for (vertex, &weight) in self.simplex.vertices().iter().zip(self.simplex.weights()) {
            on_a += weight * a.point(vertex.a);
            on_b += weight * b.point(vertex.b);
        }
        (on_a, placement.point(on_b))
    }
}

/// The vertex of a − b that lies furthest in a direction (of any length, a's frame).
pub(super) fn support(a: &Hull, b: &Hull, placement: &Placement, direction: DVec3) -> Vertex {
    let (on_a, point_a) = a.furthest(direction);
    let (on_b, point_b) = b.furthest(-placement.direction_to_b(direction));
    Vertex { difference: point_a - placement.point(point_b), a: on_a, b: on_b }
}

/// The vertex of a − b for two vertices of the hulls.
pub(super) fn difference(a: &Hull, b: &Hull, placement: &Placement, on_a: u32, on_b: u32) -> Vertex {
    Vertex { difference: a.point(on_a) - placement.point(b.point(on_b)), a: on_a, b: on_b }
}

/// Finds the distance between hull a and hull b as placed, up to `limits`.
///
/// Invariant: lower bound ≤ distance ≤ |**v**|, and |**v**| decreases in every iteration.
pub fn distance(a: &Hull, b: &Hull, placement: &Placement, start: Start, limits: &Limits) -> Distance {
    let mut found = Distance::UNKNOWN;
    if start_overlaps(&mut found, a, b, placement, start, limits.precision) {
        return overlapping(found);
    }
    // A lower bound that exceeds 0 by rounding does not separate hulls.
    let beyond = limits.beyond.max(limits.precision);
    while found.iterations < MAX_ITERATIONS {
        if found.distance <= limits.enough {
            found.separation = Separation::Within;
            return found;
        }
        found.iterations += 1;
        let vertex = support(a, b, placement, -found.axis);
        let lower = found.bound_below(&vertex);
        if lower > beyond {
            // While the simplex is empty, the vertex is the only known point of a − b.
            let upper = found.distance.min(vertex.difference.length());
            if lower - beyond >= limits.share * (upper - beyond) {
                found.separation = Separation::Beyond;
                return found;
            }
        }
        // The bounds meet, or the vertex is already in the simplex: no other one is closer.
        if found.distance - lower <= limits.precision || found.simplex.contains(&vertex) {
            break;
        }
        let mut simplex = found.simplex;
        simplex.push(vertex);
        let Some(nearest) = simplex.reduce() else {
            found.simplex = simplex;
            return overlapping(found);
        };
        let length = nearest.length();
        if length <= limits.precision {
            found.simplex = simplex;
            return overlapping(found);
        }
        // In exact arithmetic each vertex brings the simplex closer. If it does not because of rounding, the
        // previous simplex is kept.
        if length >= found.distance {
            break;
        }
        found.simplex = simplex;
        found.axis = simplex.axis(nearest);
        found.distance = length;
    }
    found.separation = separation_at_end(&found, beyond, limits.precision);
    found
}

/// Sets up the start of a search. Returns whether the start simplex contains the origin.
#[inline]
fn start_overlaps(
    found: &mut Distance,
    a: &Hull,
    b: &Hull,
    placement: &Placement,
    start: Start,
    precision: f64,
) -> bool {
    let (cached, axis) = match start {
        Start::Axis(axis) => (&[][..], axis),
        Start::Vertices(cached, axis) => (cached, axis),
    };
    found.axis = axis;
    let (last_a, last_b) = (a.len() as u32 - 1, b.len() as u32 - 1);
    for &(on_a, on_b) in cached.iter().take(4) {
        let vertex = difference(a, b, placement, on_a.min(last_a), on_b.min(last_b));
        if !found.simplex.contains(&vertex) {
            found.simplex.push(vertex);
        }
    }
    if found.simplex.len > 0 {
        let Some(nearest) = found.simplex.reduce() else { return true };
        found.axis = found.simplex.axis(nearest);
        found.distance = nearest.length();
        if found.distance <= precision {
            return true;
        }
    }
    if found.axis.length_squared() < f64::MIN_POSITIVE {
        found.axis = DVec3::X;
    }
    false
}

/// The relation of two hulls after no vertex brought the simplex closer, or the iterations ran out.
///
/// The axis between hulls that almost touch at a vertex or an edge is only accurate to rounding / distance,
/// and so is the lower bound: the gap between the bounds may be as large, although the distance itself is
/// exact.
fn separation_at_end(found: &Distance, beyond: f64, precision: f64) -> Separation {
    let rounding = AXIS_ROUNDING * precision * precision / found.distance;
    if found.distance - found.lower > CONVERGED_GAP * precision + rounding {
        Separation::NotConverged
    } else if found.distance > beyond {
        Separation::Beyond
    } else {
        Separation::Within
    }
}

fn overlapping(mut found: Distance) -> Distance {
    found.separation = Separation::Overlapping;
    found.distance = 0.0;
    (found.lower, found.direction) = (0.0, DVec3::ZERO);
    found
}
