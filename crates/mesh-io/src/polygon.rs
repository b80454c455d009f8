//! Triangulation of polygons, by ear clipping.
//!
//! Every corner of the polygon stays a corner of some triangle, also one in the middle of a straight side:
//! the polygon next to it may end there, and leaving it out would open a crack. (That is why no
//! general-purpose triangulator is used: they drop such corners.) Signs are exact, so that no ear is missed.

use glam::DVec3;

use crate::intersect::Plane;

/// Corners times inward corners above which a polygon is cut into a fan without a search for ears: below it,
/// the search takes less than a second.
const MAX_WORK: usize = 1 << 28;

/// Outcome of a triangulation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Cut {
    /// The triangles cover the polygon.
    Covered,
    /// The polygon crosses itself, touches itself, has no area or is too large for the search for ears: it,
    /// or part of it, is cut into a fan.
    Fan,
}

/// Appends the triangles of a polygon of at least three corners, given as vertex indices, in its orientation,
/// each as the numbers of three of its corners. There are two fewer triangles than corners. Concave polygons
/// are allowed; one that is not flat is cut as its projection along the coordinate axis closest to its mean
/// normal (Newell's).
pub(crate) fn triangulate(polygon: &[u32], vertices: &[DVec3], triangles: &mut Vec<[usize; 3]>) -> Cut {
    if polygon.len() == 3 {
        triangles.push([0, 1, 2]);
        return Cut::Covered;
    }
    let at = |corner: usize| vertices[polygon[corner] as usize];
    let n = polygon.len();
    // Newell's normal about the first corner, so that a polygon far from the origin loses no digits.
    let normal: DVec3 = (1..n - 1).map(|i| (at(i) - at(0)).cross(at(i + 1) - at(0))).sum();
    let Some(facing) = Facing::of(normal) else {
        return fan(&(0..n).collect::<Vec<_>>(), triangles);
    };
    let mut next: Vec<usize> = (1..n).chain([0]).collect();
    let mut previous: Vec<usize> = [n - 1].into_iter().chain(0..n - 1).collect();
    let turn = |a: usize, b: usize, c: usize| facing.turn(at(a), at(b), at(c));
    // Only corners that do not turn left can lie in an ear. Clipping never makes a corner one of them.
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
                        // A corner at the same place as one of the ear's is where the outline touches itself
                        // (a hole joined by a cut): only corners beyond it can lie in the ear, and they are
                        // tested themselves.
                        && ![at(a), at(b), at(c)].contains(&at(p))
                });
            if is_ear {
                triangles.push([a, b, c]);
                next[a] = c;
                previous[c] = a;
                left -= 1;
                tried = 0;
                inward.retain(|&p| p != b && turn(previous[p], p, next[p]) <= 0);
                // Continuing from the far side gives a fan on a convex polygon.
                corner = c;
            } else {
                corner = c;
                tried += 1;
            }
        }
        if left == 3 {
            let (a, c) = (previous[corner], next[corner]);
            triangles.push([a, corner, c]);
            return if turn(a, corner, c) >= 0 { Cut::Covered } else { Cut::Fan };
        }
    }
    let start = (0..n).find(|&i| next[previous[i]] == i && previous[next[i]] == i).unwrap_or(0);
    let rest: Vec<usize> = std::iter::successors(Some(start), |&i| Some(next[i])).take(left).collect();
    fan(&rest, triangles)
}

fn fan(corners: &[usize], triangles: &mut Vec<[usize; 3]>) -> Cut {
    triangles.extend(corners[1..].windows(2).map(|pair| [corners[0], pair[0], pair[1]]));
    Cut::Fan
}

/// A coordinate plane and the side it is looked at from.
struct Facing {
    plane: Plane,
    up: i8,
}

impl Facing {
    /// The plane most nearly perpendicular to `normal`; `None` if that is zero or not a number.
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

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use glam::{DQuat, DVec2};
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    /// Cuts a flat polygon and checks the triangles: their number is right, all turn in the polygon's
    /// direction, they add up to its area, and their outline is its outline, edge by edge.
    fn check(outline: &[DVec2], case: &str) {
        let n = outline.len();
        let area = |p: &[DVec2]| (0..p.len()).map(|i| p[i].perp_dot(p[(i + 1) % p.len()])).sum::<f64>() / 2.0;
        let whole = area(outline);
        let tilted = DQuat::from_scaled_axis(DVec3::new(0.4, -1.1, 0.3));
        for (place, turn) in [
            ("flat", DQuat::IDENTITY),
            ("upside down", DQuat::from_rotation_x(std::f64::consts::PI)),
            ("tilted", tilted),
        ] {
            let vertices: Vec<DVec3> = outline.iter().map(|p| turn * p.extend(0.0)).collect();
            let polygon: Vec<u32> = (0..n as u32).collect();
            let mut triangles = Vec::new();
            assert_eq!(triangulate(&polygon, &vertices, &mut triangles), Cut::Covered, "{case}, {place}");
            assert_eq!(triangles.len(), n - 2, "{case}, {place}");
            let mut edges: HashMap<[usize; 2], i32> = HashMap::new();
            let mut sum = 0.0;
            for &[a, b, c] in &triangles {
                let part = area(&[a, b, c].map(|i| outline[i])) * whole.signum();
                assert!(part > -1e-12, "{case}, {place}: a triangle is turned over");
                sum += part;
                for [from, to] in [[a, b], [b, c], [c, a]] {
                    *edges.entry([from.min(to), from.max(to)]).or_default() += if from < to { 1 } else { -1 };
                }
            }
            assert!((sum - whole.abs()).abs() < 1e-9, "{case}, {place}: {sum} of {whole}");
            edges.retain(|_, sum| *sum != 0);
            let expected: HashMap<[usize; 2], i32> = (0..n)
                .map(|i| (i, (i + 1) % n))
                .map(|(a, b)| ([a.min(b), a.max(b)], if a < b { 1 } else { -1 }))
                .collect();
            assert_eq!(edges, expected, "{case}, {place}");
        }
    }

    fn points(list: &[[f64; 2]]) -> Vec<DVec2> {
        list.iter().map(|&p| p.into()).collect()
    }

    #[test]
    fn concave_and_straight_corners() {
        let dart = points(&[[0.0, 0.0], [2.0, 1.0], [0.0, 2.0], [1.0, 1.0]]);
        let comb = points(&[
            [0., 0.],
            [5., 0.],
            [5., 3.],
            [4., 3.],
            [4., 1.],
            [3., 1.],
            [3., 3.],
            [2., 3.],
            [2., 1.],
            [1., 1.],
            [1., 3.],
            [0., 3.],
        ]);
        let split_sides =
            points(&[[0., 0.], [1., 0.], [2., 0.], [2., 1.], [2., 2.], [1., 2.], [0., 2.], [0., 1.]]);
        // A square with a square hole, joined to the outside by a cut that is passed twice.
        let holed = points(&[
            [0., 0.],
            [4., 0.],
            [4., 4.],
            [0., 4.],
            [0., 0.],
            [1., 1.],
            [1., 3.],
            [3., 3.],
            [3., 1.],
            [1., 1.],
        ]);
        for (case, outline) in
            [("dart", dart), ("comb", comb), ("split sides", split_sides), ("holed", holed)]
        {
            for start in 0..outline.len() {
                let mut outline = outline.clone();
                outline.rotate_left(start);
                check(&outline, &format!("{case} from {start}"));
                outline.reverse();
                check(&outline, &format!("{case} backwards from {start}"));
            }
        }
    }

    #[test]
    fn random_stars() {
        let seed = 5;
        let mut random = StdRng::seed_from_u64(seed);
        for case in 0..300 {
            let n = random.random_range(4..60);
            let outline: Vec<DVec2> = (0..n)
                .map(|i| {
                    let angle = std::f64::consts::TAU * f64::from(i) / f64::from(n);
                    DVec2::from_angle(angle) * random.random_range(0.1..1.0)
                })
                .collect();
            check(&outline, &format!("seed {seed}, case {case}"));
        }
    }

    #[test]
    fn invalid_outlines_become_fans() {
        let mut triangles = Vec::new();
        let line: Vec<DVec3> = (0..5).map(|i| DVec3::X * f64::from(i)).collect();
        assert_eq!(triangulate(&[0, 1, 2, 3, 4], &line, &mut triangles), Cut::Fan);
        assert_eq!(triangles, [[0, 1, 2], [0, 2, 3], [0, 3, 4]]);
        triangles.clear();
        let nan = vec![DVec3::NAN; 4];
        assert_eq!(triangulate(&[0, 1, 2, 3], &nan, &mut triangles), Cut::Fan);
        assert_eq!(triangles.len(), 2);
        triangles.clear();
        let star: Vec<DVec3> = (0..5)
            .map(|i| DVec2::from_angle(f64::from(i) * 0.8 * std::f64::consts::PI).extend(0.0))
            .collect();
        triangulate(&[0, 1, 2, 3, 4], &star, &mut triangles);
        assert_eq!(triangles.len(), 3);
    }

    /// A hostile outline: a comb of a hundred thousand teeth must not take a hundred thousand squared.
    #[test]
    fn large_outlines_are_cut_in_time() {
        let teeth = 100_000;
        let mut vertices = vec![DVec3::new(f64::from(teeth), -1.0, 0.0), DVec3::new(0.0, -1.0, 0.0)];
        vertices.extend((0..teeth).flat_map(|i| {
            [DVec3::new(f64::from(i) + 0.5, 1.0, 0.0), DVec3::new(f64::from(i) + 0.7, 0.0, 0.0)]
        }));
        let polygon: Vec<u32> = (0..vertices.len() as u32).collect();
        let mut triangles = Vec::new();
        let start = std::time::Instant::now();
        assert_eq!(triangulate(&polygon, &vertices, &mut triangles), Cut::Fan);
        assert_eq!(triangles.len(), vertices.len() - 2);
        // A circle of as many corners is convex, and cheap to cut.
        let circle: Vec<DVec3> = (0..teeth)
            .map(|i| DVec2::from_angle(f64::from(i) / f64::from(teeth) * std::f64::consts::TAU).extend(0.0))
            .collect();
        triangles.clear();
        let polygon: Vec<u32> = (0..circle.len() as u32).collect();
        assert_eq!(triangulate(&polygon, &circle, &mut triangles), Cut::Covered);
        assert!(start.elapsed().as_secs_f64() < 5.0);
    }
}
