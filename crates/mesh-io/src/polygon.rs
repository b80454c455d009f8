//! Polygons into triangles, by ear clipping.
//!
//! Every corner of the polygon stays a corner of some triangle, also one in the middle of a straight side: the polygon
//! next to it may end there, and leaving it out would open a crack. (That is why no general-purpose triangulator is used:
//! they drop such corners.) Signs are exact, so that a polygon with an ear is never taken for one without.

use glam::DVec3;

use crate::intersect::Plane;

/// Corners times inward corners above which a polygon is cut without looking for ears: with fewer, the search takes
/// below a second.
const MAX_WORK: usize = 1 << 28;

/// How a polygon came apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Cut {
    /// Into triangles that cover it.
    Covered,
    /// It crosses itself, touches itself or has no area, or is far too large to look for ears: a fan stands in for (part of) it.
    Fan,
}

/// Appends the triangles of a polygon of at least three corners, given as vertex indices, in its orientation. There are two fewer
/// triangles than corners. Concave polygons are allowed; one that is not flat is cut as its projection along the
/// coordinate axis closest to its mean normal (Newell's).
pub(crate) fn triangulate(polygon: &[u32], vertices: &[DVec3], triangles: &mut Vec<[u32; 3]>) -> Cut {
    if let &[a, b, c] = polygon {
        triangles.push([a, b, c]);
        return Cut::Covered;
    }
    let at = |corner: usize| vertices[polygon[corner] as usize];
    let n = polygon.len();
    // Newell's normal about the first corner, so that a polygon far from the origin loses no digits.
    let normal: DVec3 = (1..n - 1).map(|i| (at(i) - at(0)).cross(at(i + 1) - at(0))).sum();
    let Some(facing) = Facing::of(normal) else {
        return fan(&(0..n).collect::<Vec<_>>(), polygon, triangles);
    };
    let mut next: Vec<usize> = (1..n).chain([0]).collect();
    let mut previous: Vec<usize> = [n - 1].into_iter().chain(0..n - 1).collect();
    let turn = |a: usize, b: usize, c: usize| facing.turn(at(a), at(b), at(c));
    // Only corners that do not turn left can lie in an ear. A corner never becomes one of them when others are clipped.
    let mut inward: Vec<usize> = (0..n).filter(|&i| turn(previous[i], i, next[i]) <= 0).collect();
    let mut left = n;
    if n.saturating_mul(inward.len()) <= MAX_WORK {
        let mut corner = 1 % n;
        let mut tried = 0;
        while left > 3 && tried < left {
            let (a, b, c) = (previous[corner], corner, next[corner]);
            let is_ear = turn(a, b, c) > 0
                && !inward.iter().any(|&p| {
                    ![a, b, c].contains(&p)
                        && turn(a, b, p) >= 0
                        && turn(b, c, p) >= 0
                        && turn(c, a, p) >= 0
                        // A corner at the same place as one of the ear's is where the outline touches itself (a hole
                        // joined by a cut): only what lies beyond it could stand in the way, and is looked at itself.
                        && ![at(a), at(b), at(c)].contains(&at(p))
                });
            if is_ear {
                triangles.push([a, b, c].map(|i| polygon[i]));
                next[a] = c;
                previous[c] = a;
                left -= 1;
                tried = 0;
                inward.retain(|&p| p != b && turn(previous[p], p, next[p]) <= 0);
                // Going on from the far side gives a fan on a convex polygon.
                corner = c;
            } else {
                corner = c;
                tried += 1;
            }
        }
        if left == 3 {
            let (a, c) = (previous[corner], next[corner]);
            triangles.push([a, corner, c].map(|i| polygon[i]));
            return if turn(a, corner, c) >= 0 { Cut::Covered } else { Cut::Fan };
        }
    }
    let start = (0..n).find(|&i| next[previous[i]] == i && previous[next[i]] == i).unwrap_or(0);
    let rest: Vec<usize> = std::iter::successors(Some(start), |&i| Some(next[i])).take(left).collect();
    fan(&rest, polygon, triangles)
}

fn fan(corners: &[usize], polygon: &[u32], triangles: &mut Vec<[u32; 3]>) -> Cut {
    let first = polygon[corners[0]];
    triangles.extend(corners[1..].windows(2).map(|pair| [first, polygon[pair[0]], polygon[pair[1]]]));
    Cut::Fan
}

/// A coordinate plane and the side it is looked at from.
struct Facing {
    plane: Plane,
    up: i8,
}

impl Facing {
    /// The plane most nearly across `normal`; none if that is zero or not a number.
    fn of(normal: DVec3) -> Option<Self> {
        let size = normal.abs();
        let largest = size.max_element();
        if !(largest > 0.0 && largest.is_finite()) {
            return None;
        }
        let (plane, along) = if size.z == largest {
            (Plane::Xy, normal.z)
        } else if size.x == largest {
            (Plane::Yz, normal.x)
        } else {
            (Plane::Zx, normal.y)
        };
        Some(Self { plane, up: if along > 0.0 { 1 } else { -1 } })
    }

    /// 1 if the path abc turns left seen from the side that the normal points to, −1 if right, 0 if straight.
    fn turn(&self, a: DVec3, b: DVec3, c: DVec3) -> i8 {
        self.up * self.plane.orient(a, b, c)
    }
}
