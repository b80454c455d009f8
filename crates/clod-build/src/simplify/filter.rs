//! Candidate positions of the merged vertex of a collapse: the position of least surface deviation, the
//! unconstrained filtered position, and the part of the path between them that keeps local convexity (§3.3.4,
//! steps 2 to 4).

use glam::DVec3;

use super::quadric::Quadric;
use super::relax::{Relaxation, difference};
use super::star::{Fans, Star};

/// Largest distance of the position of least deviation from the edge's middle, in lengths of the edge. Beyond
/// it, the middle is used.
const MAX_OFFSET: f64 = 2.0;

/// Fraction of the tolerance that positions on the path may use. With all of it, rounding would decide
/// whether the ends of the feasible range pass the tests that follow.
const TOLERANCE_SHARE: f64 = 0.9;

/// The path on which the position of the merged vertex is searched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Path {
    /// v̂: the position of least quadric error.
    pub least: DVec3,
    /// ṽ: the position of least second-order differences.
    pub filtered: DVec3,
}

impl Path {
    /// u v̂ + (1 − u) ṽ (Eq. 3.3).
    pub fn at(&self, u: f64) -> DVec3 {
        u * self.least + (1.0 - u) * self.filtered
    }
}

/// The mesh around a star.
#[derive(Clone, Copy)]
pub(crate) struct Neighbourhood<'a> {
    pub points: &'a [DVec3],
    pub triangles: &'a [[u32; 3]],
    pub fans: &'a Fans,
}

impl Neighbourhood<'_> {
    /// The path from v̂ to ṽ. On the border the vertex is not filtered, so that the border keeps its shape.
    pub fn path(&self, star: &Star, quadric: &Quadric) -> Path {
        let [p, q] = star.ends.map(|v| self.points[v as usize]);
        let middle = 0.5 * (p + q);
        let mut least = quadric.minimum(middle);
        if least.distance(middle) > MAX_OFFSET * p.distance(q) {
            least = middle;
        }
        let filtered = if star.border { least } else { self.relaxed(star, least).unwrap_or(least) };
        Path { least, filtered }
    }

    fn relaxed(&self, star: &Star, at: DVec3) -> Option<DVec3> {
        let point = |v: u32| self.points[v as usize];
        let mut sum = Relaxation::default();
        for spoke in &star.fan {
            let [a, b] = spoke.rim.map(point);
            if let Some((m, _)) = self.beyond(star, spoke.rim)
                && let Some([cj, ck, own, cm]) = difference(a, b, at, point(m))
            {
                sum.add(own, cj * a + ck * b + cm * point(m));
            }
            if let Some(before) = star.fan.iter().find(|s| s.rim[1] == spoke.rim[0])
                && let Some([own, ck, cl, cm]) = difference(at, a, b, point(before.rim[0]))
            {
                sum.add(own, ck * a + cl * b + cm * point(before.rim[0]));
            }
        }
        sum.position()
    }

    /// The corner, and its triangle, beyond an edge of the rim; `None` on the border, or if that triangle is
    /// of the star.
    fn beyond(&self, star: &Star, [a, b]: [u32; 2]) -> Option<(u32, u32)> {
        self.fans.across(self.triangles, b, a).filter(|(v, _)| !star.ends.contains(v))
    }

    /// Resolution of the edge (Eq. 3.1), in the inverse of the coordinates' unit: the inverse of its length
    /// in projection on the tangent plane of the filtered surface.
    pub fn resolution(&self, star: &Star, path: &Path) -> f64 {
        let [p, q] = star.ends.map(|v| self.points[v as usize]);
        let normals = star.fan.iter().map(|s| {
            let [a, b] = s.rim.map(|v| self.points[v as usize] - path.filtered);
            a.cross(b).normalize_or_zero()
        });
        let normal = normals.sum::<DVec3>().normalize_or_zero();
        let edge = p - q;
        let projected = (edge - edge.dot(normal) * normal).length();
        // An edge along the normal has no extent on the surface: its detail is finer than any other.
        1.0 / projected.max(1e-9 * edge.length()).max(1e-300)
    }

    /// The part of the path, as a range of u, on which the edges inside patches remain convex: the linear
    /// program of Eq. 3.4, whose solution is the lower end. Departing from the dissertation the range's upper
    /// end is found too, since v̂ itself need not be feasible. `patch` names each triangle's patch; heights
    /// up to `tolerance` count as convex.
    pub fn feasible(&self, star: &Star, path: &Path, patch: &[u32], tolerance: f64) -> Option<(f64, f64)> {
        let point = |v: u32| self.points[v as usize];
        let (mut low, mut high) = (0.0f64, 1.0f64);
        let mut hold = |volume: &dyn Fn(DVec3) -> (f64, f64)| {
            let ((filtered, area_f), (least, area_l)) = (volume(path.filtered), volume(path.least));
            let slack = TOLERANCE_SHARE * tolerance * area_f.min(area_l);
            // The height is linear in u: filtered + (least − filtered) u ≤ slack.
            let slope = least - filtered;
            let room = slack - filtered;
            if slope > 0.0 {
                high = high.min(room / slope);
            } else if slope < 0.0 {
                low = low.max(room / slope);
            } else if room < 0.0 {
                high = -1.0;
            }
        };
        for spoke in &star.fan {
            let own = patch[spoke.triangle as usize];
            let [a, b] = spoke.rim.map(point);
            if let Some((m, t)) = self.beyond(star, spoke.rim)
                && patch[t as usize] == own
            {
                let m = point(m);
                hold(&|x| {
                    let normal = (a - x).cross(b - x);
                    (normal.dot(m - a), normal.length())
                });
            }
            if let Some(before) = star.fan.iter().find(|s| s.rim[1] == spoke.rim[0])
                && patch[before.triangle as usize] == own
            {
                let m = point(before.rim[0]);
                hold(&|x| {
                    let normal = (a - x).cross(b - x);
                    (normal.dot(m - x), normal.length())
                });
            }
        }
        (low <= high).then_some((low, high))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grid of nine by nine vertices with a bump of the given height in the middle.
    fn cap(height: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let n = 9;
        let mut points = Vec::new();
        for y in 0..n {
            for x in 0..n {
                let (x, y) = (f64::from(x) - 4.0, f64::from(y) - 4.0);
                points.push(DVec3::new(x + 0.2 * y, y, height * (-0.3 * (x * x + y * y)).exp()));
            }
        }
        let mut triangles = Vec::new();
        for y in 0..n as u32 - 1 {
            for x in 0..n as u32 - 1 {
                let v = y * n as u32 + x;
                triangles.extend([[v, v + 1, v + n as u32], [v + 1, v + n as u32 + 1, v + n as u32]]);
            }
        }
        (points, triangles)
    }

    #[test]
    fn flat_stays_flat_and_resolution_is_one_over_length() {
        let (points, triangles) = cap(0.0);
        let fans = Fans::new(points.len(), &triangles);
        let near = Neighbourhood { points: &points, triangles: &triangles, fans: &fans };
        let mut star = Star::default();
        assert!(fans.star(&triangles, [40, 41], &mut star));
        let path = near.path(&star, &Quadric::plane(DVec3::Z, 0.0, 1.0));
        assert!(path.least.z.abs() < 1e-12 && path.filtered.z.abs() < 1e-12);
        assert!((near.resolution(&star, &path) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn filtering_lowers_a_bump_and_the_program_holds_convexity() {
        let (points, triangles) = cap(1.0);
        let fans = Fans::new(points.len(), &triangles);
        let near = Neighbourhood { points: &points, triangles: &triangles, fans: &fans };
        let mut star = Star::default();
        assert!(fans.star(&triangles, [40, 41], &mut star));
        let top = points[40].z;
        let path = Path { least: points[40], ..near.path(&star, &Quadric::plane(DVec3::Z, top, 1.0)) };
        assert!(path.filtered.z < 0.95 * top, "{}", path.filtered);
        // All of one patch: the range is where no edge is reflex, as a scan along the path finds it.
        let one = vec![0; triangles.len()];
        let range = near.feasible(&star, &path, &one, 0.0);
        let convex = |x: DVec3| {
            let point = |v: u32| points[v as usize];
            star.fan.iter().all(|s| {
                let [a, b] = s.rim.map(point);
                let normal = (a - x).cross(b - x);
                let outer = fans.across(&triangles, s.rim[1], s.rim[0]).map(|(v, _)| point(v));
                let before = star.fan.iter().find(|o| o.rim[1] == s.rim[0]).map(|o| point(o.rim[0]));
                outer.into_iter().chain(before).all(|m| normal.dot(m - x) <= 1e-12)
            })
        };
        for k in 0..=1000 {
            let u = f64::from(k) / 1000.0;
            let inside = range.is_some_and(|(low, high)| (low..=high).contains(&u));
            let near_end = range.is_some_and(|(low, high)| (u - low).abs() < 2e-3 || (u - high).abs() < 2e-3);
            assert!(near_end || inside == convex(path.at(u)), "u = {u}, {range:?}");
        }
        // Each triangle its own patch: nothing to hold.
        let each: Vec<u32> = (0..triangles.len() as u32).collect();
        assert_eq!(near.feasible(&star, &path, &each, 0.0), Some((0.0, 1.0)));
    }
}
