//! Exact tests between two triangles, from the signs of `orient2d` and `orient3d` alone.
//!
//! All sets are closed: touching counts. Two triangles meet if and only if an edge of one meets the other, since the
//! boundary of the intersection of two convex sets lies on one of their boundaries; this holds for coplanar ones too.
//! The result is exact as long as no product of three coordinate differences overflows or underflows; the caller brings
//! the coordinates near 1 by a power of two.

use glam::DVec3;
use robust::{Coord, Coord3D};

/// Whether two triangles, given with the identities of their vertices, intersect in more than what they share:
///
/// - no shared vertex: whether they have a point in common, touching included;
/// - one: whether the edge of one opposite to that vertex meets the other. This is whether they have any other point in
///   common, since a common segment that starts in the shared vertex ends on such an edge;
/// - two: whether they lie in one plane on the same side of the shared edge, that is, are folded flat onto each other;
/// - three: no. Duplicate triangles are a defect of their own kind, and counted as such.
///
/// Both triangles must have an area.
pub(super) fn cross(a: &[DVec3; 3], a_ids: &[u32; 3], b: &[DVec3; 3], b_ids: &[u32; 3]) -> bool {
    let shared_a = a_ids.map(|v| b_ids.contains(&v));
    match shared_a.iter().filter(|&&s| s).count() {
        0 => meet(a, b),
        1 => {
            let i = shared_a.iter().position(|&s| s).unwrap_or(0);
            let j = b_ids.iter().position(|v| *v == a_ids[i]).unwrap_or(0);
            segment_meets_triangle(a[(i + 1) % 3], a[(i + 2) % 3], b)
                || segment_meets_triangle(b[(j + 1) % 3], b[(j + 2) % 3], a)
        }
        2 => {
            let i = shared_a.iter().position(|&s| !s).unwrap_or(0);
            let j = b_ids.iter().position(|v| !a_ids.contains(v)).unwrap_or(0);
            let (p, q) = (a[(i + 1) % 3], a[(i + 2) % 3]);
            orient(p, q, a[i], b[j]) == 0
                && Plane::ALL.iter().any(|plane| {
                    let side = plane.orient(p, q, a[i]);
                    side != 0 && side == plane.orient(p, q, b[j])
                })
        }
        _ => false,
    }
}

/// Whether two triangles have a point in common.
pub(super) fn meet(a: &[DVec3; 3], b: &[DVec3; 3]) -> bool {
    let apart = |t: &[DVec3; 3], u: &[DVec3; 3]| {
        let side = orient(t[0], t[1], t[2], u[0]);
        side != 0 && u[1..].iter().all(|v| orient(t[0], t[1], t[2], *v) == side)
    };
    if apart(a, b) || apart(b, a) {
        return false;
    }
    (0..3).any(|i| segment_meets_triangle(a[i], a[(i + 1) % 3], b))
        || (0..3).any(|i| segment_meets_triangle(b[i], b[(i + 1) % 3], a))
}

/// Whether the segment pq and the triangle t have a point in common.
fn segment_meets_triangle(p: DVec3, q: DVec3, t: &[DVec3; 3]) -> bool {
    let [a, b, c] = *t;
    let (side_p, side_q) = (orient(a, b, c, p), orient(a, b, c, q));
    if side_p == 0 && side_q == 0 {
        return coplanar_segment_meets_triangle(p, q, t);
    }
    if side_p == side_q {
        return false;
    }
    // The segment reaches the plane in one point; the line pq runs inside all three edges or touches them.
    !both_signs([orient(p, q, a, b), orient(p, q, b, c), orient(p, q, c, a)])
}

/// The same, for a segment in the plane of the triangle or a triangle without area.
fn coplanar_segment_meets_triangle(p: DVec3, q: DVec3, t: &[DVec3; 3]) -> bool {
    let [a, b, c] = *t;
    // A projection in which the triangle keeps an area is one-to-one on its plane.
    if let Some(plane) = Plane::ALL.iter().find(|plane| plane.orient(a, b, c) != 0) {
        let inside = |x| !both_signs([plane.orient(a, b, x), plane.orient(b, c, x), plane.orient(c, a, x)]);
        return inside(p)
            || inside(q)
            || [(a, b), (b, c), (c, a)].iter().any(|&(r, s)| plane.segments_meet(p, q, r, s));
    }
    [(a, b), (b, c), (c, a)].iter().any(|&(r, s)| segments_meet(p, q, r, s))
}

/// Whether the segments pq and rs have a point in common, in space.
fn segments_meet(p: DVec3, q: DVec3, r: DVec3, s: DVec3) -> bool {
    if orient(p, q, r, s) != 0 {
        return false;
    }
    let spanning = |plane: &&Plane| {
        [[p, q, r], [p, q, s], [r, s, p], [r, s, q]].iter().any(|&[a, b, c]| plane.orient(a, b, c) != 0)
    };
    match Plane::ALL.iter().find(spanning) {
        Some(plane) => plane.segments_meet(p, q, r, s),
        // All four on a line.
        None => p.min(q).cmple(r.max(s)).all() && r.min(s).cmple(p.max(q)).all(),
    }
}

fn both_signs(signs: [i8; 3]) -> bool {
    signs.contains(&1) && signs.contains(&-1)
}

/// On which side of the plane abc the point d lies: 1, −1, or 0 for in it.
fn orient(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> i8 {
    let [a, b, c, d] = [a, b, c, d].map(|v| Coord3D { x: v.x, y: v.y, z: v.z });
    sign(robust::orient3d(a, b, c, d))
}

fn sign(x: f64) -> i8 {
    i8::from(x > 0.0) - i8::from(x < 0.0)
}

/// Whether three points lie on a line, exactly.
pub(crate) fn collinear(a: DVec3, b: DVec3, c: DVec3) -> bool {
    Plane::ALL.iter().all(|plane| plane.orient(a, b, c) == 0)
}

/// A coordinate plane to project on, which is done without rounding.
#[derive(Clone, Copy)]
pub(crate) enum Plane {
    /// Seen along z.
    Xy,
    /// Seen along x.
    Yz,
    /// Seen along y.
    Zx,
}

impl Plane {
    const ALL: [Self; 3] = [Self::Xy, Self::Yz, Self::Zx];

    /// On which side of the line ab the point c lies in the projection: 1 left, −1 right, 0 on it.
    pub(crate) fn orient(self, a: DVec3, b: DVec3, c: DVec3) -> i8 {
        let [a, b, c] = [a, b, c].map(|v| match self {
            Self::Xy => Coord { x: v.x, y: v.y },
            Self::Yz => Coord { x: v.y, y: v.z },
            Self::Zx => Coord { x: v.z, y: v.x },
        });
        sign(robust::orient2d(a, b, c))
    }

    /// Whether the projections of the segments pq and rs, all four points in one plane, have a point in common.
    fn segments_meet(self, p: DVec3, q: DVec3, r: DVec3, s: DVec3) -> bool {
        let (r_side, s_side) = (self.orient(p, q, r), self.orient(p, q, s));
        let (p_side, q_side) = (self.orient(r, s, p), self.orient(r, s, q));
        if r_side * s_side == 1 || p_side * q_side == 1 {
            return false;
        }
        if [r_side, s_side, p_side, q_side] != [0; 4] {
            return true;
        }
        p.min(q).cmple(r.max(s)).all() && r.min(s).cmple(p.max(q)).all()
    }
}
