//! Exact tests between two triangles, from the signs of `orient2d` and `orient3d` alone.
//!
//! All sets are closed: touching counts. Two triangles meet if and only if an edge of one meets the other,
//! since the boundary of the intersection of two convex sets lies on one of their boundaries; this holds for
//! coplanar ones too. The result is exact as long as no product of three coordinate differences overflows or
//! underflows; the caller brings the coordinates near 1 by a power of two.

use glam::DVec3;
use robust::{Coord, Coord3D};

/// Whether two triangles, given with the identities of their vertices, intersect beyond the vertices that
/// they share. By the number of shared vertices:
///
/// - none: true if they have a point in common, touching included;
/// - one: true if the edge of one opposite to that vertex meets the other, which is equivalent to any other
///   point in common, since a common segment that starts in the shared vertex ends on such an edge;
/// - two: true if they lie in one plane on the same side of the shared edge, that is, are folded flat onto
///   each other;
/// - three: false. Duplicate triangles are a defect of their own kind, and counted as such.
///
/// Both triangles must have an area.
pub(crate) fn cross(a: &[DVec3; 3], a_ids: &[u32; 3], b: &[DVec3; 3], b_ids: &[u32; 3]) -> bool {
    let shared_a = a_ids.map(|v| b_ids.contains(&v));
    match shared_a.iter().filter(|&&s| s).count() {
        0 => meet(a, b),
        1 => {
            let i = shared_a.iter().position(|&s| s).unwrap_or(0);
            let j = b_ids.iter().position(|v| *v == a_ids[i]).unwrap_or(0);
            let (a_next, a_last) = (a[(i + 1) % 3], a[(i + 2) % 3]);
            let (b_next, b_last) = (b[(j + 1) % 3], b[(j + 2) % 3]);
            if Plane::ALL.iter().any(|plane| plane.separates_at(a[i], [a_next, a_last], [b_next, b_last])) {
                return false;
            }
            segment_meets_triangle(a_next, a_last, b) || segment_meets_triangle(b_next, b_last, a)
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

/// Whether two triangles have a point in common. Either may be without area.
pub(super) fn meet(a: &[DVec3; 3], b: &[DVec3; 3]) -> bool {
    // Cheapest first. In flat regions, many candidates lie in one plane without meeting, and `orient3d` is
    // slow to find a zero: hence the projections before it.
    if clearly_one_sided(a, b)
        || clearly_one_sided(b, a)
        || Plane::ALL.iter().any(|plane| plane.separates(a, b))
    {
        return false;
    }
    let one_sided = |t: &[DVec3; 3], u: &[DVec3; 3]| {
        let side = orient(t[0], t[1], t[2], u[0]);
        side != 0 && u[1..].iter().all(|v| orient(t[0], t[1], t[2], *v) == side)
    };
    if one_sided(a, b) || one_sided(b, a) {
        return false;
    }
    (0..3).any(|i| segment_meets_triangle(a[i], a[(i + 1) % 3], b))
        || (0..3).any(|i| segment_meets_triangle(b[i], b[(i + 1) % 3], a))
}

/// Whether plain arithmetic shows that u lies on one side of t's plane: the first, filtered stage of
/// Shewchuk's orient3d with its error bound. False if u does not lie on one side, or rounding leaves the sign
/// undecided.
fn clearly_one_sided(t: &[DVec3; 3], u: &[DVec3; 3]) -> bool {
    /// Error bound of the determinant in units of the permanent: (7 + 56 ε) ε with ε = 2⁻⁵³.
    const BOUND: f64 = (7.0 + 28.0 * f64::EPSILON) * (0.5 * f64::EPSILON);
    let side = |d: DVec3| {
        let [a, b, c] = t.map(|p| p - d);
        let (bc, cb, ca, ac, ab, ba) = (b.x * c.y, c.x * b.y, c.x * a.y, a.x * c.y, a.x * b.y, b.x * a.y);
        let volume = a.z * (bc - cb) + b.z * (ca - ac) + c.z * (ab - ba);
        let permanent = (bc.abs() + cb.abs()) * a.z.abs()
            + (ca.abs() + ac.abs()) * b.z.abs()
            + (ab.abs() + ba.abs()) * c.z.abs();
        if volume.abs() > BOUND * permanent { sign(volume) } else { 0 }
    };
    let first = side(u[0]);
    first != 0 && side(u[1]) == first && side(u[2]) == first
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

/// Whether a segment in the plane of the triangle meets it; also for triangles without area.
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

/// Side of the plane abc on which the point d lies: 1, −1, or 0 for in the plane.
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

/// A coordinate plane to project on. Projection is exact.
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

    /// Side of the line ab on which the point c lies in the projection: 1 left, −1 right, 0 on it.
    pub(crate) fn orient(self, a: DVec3, b: DVec3, c: DVec3) -> i8 {
        let [a, b, c] = [a, b, c].map(|v| match self {
            Self::Xy => Coord { x: v.x, y: v.y },
            Self::Yz => Coord { x: v.y, y: v.z },
            Self::Zx => Coord { x: v.z, y: v.x },
        });
        sign(robust::orient2d(a, b, c))
    }

    /// Whether the line through an edge of one triangle separates their projections, so that they have no
    /// point in common.
    fn separates(self, a: &[DVec3; 3], b: &[DVec3; 3]) -> bool {
        let separates = |t: &[DVec3; 3], u: &[DVec3; 3]| {
            (0..3).any(|i| {
                let (p, q, r) = (t[i], t[(i + 1) % 3], t[(i + 2) % 3]);
                let other_side = -self.orient(p, q, r);
                other_side != 0 && u.iter().all(|x| self.orient(p, q, *x) == other_side)
            })
        };
        separates(a, b) || separates(b, a)
    }

    /// Whether an edge at `v` separates the projections of the triangles v a₀ a₁ and v b₀ b₁, so that they
    /// have only v in common.
    fn separates_at(self, v: DVec3, a: [DVec3; 2], b: [DVec3; 2]) -> bool {
        let separates = |[p, q]: [DVec3; 2], u: [DVec3; 2]| {
            let other_side = -self.orient(v, p, q);
            other_side != 0 && u.iter().all(|x| self.orient(v, p, *x) == other_side)
        };
        separates(a, b) || separates([a[1], a[0]], b) || separates(b, a) || separates([b[1], b[0]], a)
    }

    /// Whether the projections of the segments pq and rs, all four points in one plane, have a point in
    /// common.
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

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    type Point = [i64; 3];

    fn cross_product(a: Point, b: Point) -> Point {
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    }

    fn minus(a: Point, b: Point) -> Point {
        [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
    }

    /// The separating-axis theorem in whole numbers: two closed convex polygons are disjoint if and only if
    /// they are apart along a normal of a face of their Minkowski difference: a normal of either, a product
    /// of two edges, or (when both lie in one plane) a normal of an edge within it.
    fn apart(a: &[Point], b: &[Point]) -> bool {
        let edges =
            |p: &[Point]| -> Vec<Point> { (0..p.len()).map(|i| minus(p[(i + 1) % p.len()], p[i])).collect() };
        // The vector from one to the other replaces an edge where all edges are parallel.
        let all: Vec<Point> = edges(a).into_iter().chain(edges(b)).chain([minus(b[0], a[0])]).collect();
        let mut axes: Vec<Point> = vec![[1, 0, 0], [0, 1, 0], [0, 0, 1]];
        axes.extend(all.iter().copied());
        for e in &all {
            for f in &all {
                let normal = cross_product(*e, *f);
                axes.push(normal);
                axes.extend(all.iter().map(|g| cross_product(normal, *g)));
            }
        }
        axes.iter().any(|axis| {
            let along = |p: &Point| p[0] * axis[0] + p[1] * axis[1] + p[2] * axis[2];
            let range =
                |p: &[Point]| (p.iter().map(along).min().unwrap(), p.iter().map(along).max().unwrap());
            let ((low_a, high_a), (low_b, high_b)) = (range(a), range(b));
            high_a < low_b || high_b < low_a
        })
    }

    fn real(p: Point) -> DVec3 {
        DVec3::new(p[0] as f64, p[1] as f64, p[2] as f64)
    }

    /// Random triangles on a small grid, where touching, coplanar, folded and degenerate cases abound.
    #[test]
    fn agrees_with_separating_axes_in_whole_numbers() {
        let seed = 7;
        let mut random = StdRng::seed_from_u64(seed);
        let mut outcomes = [[0; 2]; 3];
        for case in 0..60_000 {
            // Flat, shallow and full grids.
            let size = [[4, 4, 1], [4, 4, 2], [5, 5, 5]][case % 3];
            let mut point = || -> Point { size.map(|n| random.random_range(0..n)) };
            let a = [point(), point(), point()];
            let b = [point(), point(), point()];
            let (ra, rb) = (a.map(real), b.map(real));
            let expected = !apart(&a, &b);
            assert_eq!(meet(&ra, &rb), expected, "seed {seed}, case {case}: {a:?} {b:?}");
            assert_eq!(meet(&rb, &ra), expected, "seed {seed}, case {case}: {a:?} {b:?}");
            let id = |p: Point| ((p[0] * 5 + p[1]) * 5 + p[2]) as u32;
            let (ia, ib) = (a.map(id), b.map(id));
            if collinear(ra[0], ra[1], ra[2]) || collinear(rb[0], rb[1], rb[2]) {
                continue;
            }
            let shared: Vec<Point> = a.iter().copied().filter(|p| b.contains(p)).collect();
            let expected = match *shared {
                [] => !apart(&a, &b),
                // Cut off near the shared corner, each triangle becomes a trapezium; in the limit the common
                // points of two triangles that share only a corner reach the far edge of one.
                [v] => {
                    let far =
                        |t: &[Point; 3]| -> Vec<Point> { t.iter().copied().filter(|p| *p != v).collect() };
                    !apart(&far(&a), &b) || !apart(&far(&b), &a)
                }
                // Folded: shrunk towards the shared edge's far side (tenfold grid), both still have a point
                // in common.
                [p, q] => {
                    let towards = |t: &[Point; 3]| -> [Point; 3] {
                        let apex = *t.iter().find(|x| **x != p && **x != q).unwrap();
                        let middle = [0, 1, 2].map(|k| p[k] + q[k]);
                        // Scaled by 40; the base is moved a little towards the apex from the edge's middle
                        // half.
                        let base = |end: Point| {
                            [0, 1, 2].map(|k| 10 * (middle[k] + 2 * end[k]) + (apex[k] - end[k]))
                        };
                        [base(p), base(q), [0, 1, 2].map(|k| 40 * apex[k])]
                    };
                    let flat = {
                        let normal = cross_product(
                            minus(q, p),
                            minus(a.into_iter().find(|x| !shared.contains(x)).unwrap(), p),
                        );
                        let d = minus(b.into_iter().find(|x| !shared.contains(x)).unwrap(), p);
                        normal[0] * d[0] + normal[1] * d[1] + normal[2] * d[2] == 0
                    };
                    flat && !apart(&towards(&a), &towards(&b))
                }
                _ => false,
            };
            assert_eq!(cross(&ra, &ia, &rb, &ib), expected, "seed {seed}, case {case}: {a:?} {b:?}");
            if shared.len() < 3 {
                outcomes[shared.len()][usize::from(expected)] += 1;
            }
        }
        assert!(outcomes.iter().flatten().all(|&n| n > 200), "every outcome must be met: {outcomes:?}");
    }

    /// One unit in the last place decides.
    #[test]
    fn distinguishes_touching_from_one_ulp_apart() {
        let floor = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let above = |z: f64| [DVec3::new(0.2, 0.2, z), DVec3::new(0.3, 0.2, 1.0), DVec3::new(0.2, 0.3, 1.0)];
        assert!(meet(&floor, &above(0.0)));
        assert!(!meet(&floor, &above(f64::MIN_POSITIVE)));
        let beyond =
            |x: f64| [DVec3::new(x, 0.0, 0.0), DVec3::new(2.0, 0.0, -1.0), DVec3::new(2.0, 0.0, 1.0)];
        assert!(meet(&floor, &beyond(1.0)));
        assert!(!meet(&floor, &beyond(1.0 + f64::EPSILON)));
    }
}
