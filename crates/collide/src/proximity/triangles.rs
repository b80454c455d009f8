//! The nearest points of two triangles.
//!
//! Triangles that do not cross are nearest at a corner of one and a point of the other, or at two edges (Ericson 2005,
//! §5.1.10). Edges are compared by the common normal of their lines, which stays accurate for nearly parallel ones; the
//! ends of parallel ones are corners, and tried as such. Triangles without area are their edges.

use palpate_core::glam::DVec3;

pub(crate) type Triangle = [DVec3; 3];

/// Sines below this are zero: edges are parallel, and a triangle has no area.
const FLAT: f64 = 1e-12;

/// The nearest points of two triangles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Nearest {
    /// Squared distance, m².
    pub squared: f64,
    pub on_a: DVec3,
    pub on_b: DVec3,
}

impl Nearest {
    fn offer(&mut self, on_a: DVec3, on_b: DVec3) {
        let squared = on_a.distance_squared(on_b);
        if squared < self.squared {
            *self = Self { squared, on_a, on_b };
        }
    }
}

/// A triangle with what is computed from its corners once.
#[derive(Clone, Copy, Debug)]
struct Facet {
    corners: Triangle,
    edges: [DVec3; 3],
    squares: [f64; 3],
    /// Normal, twice the area long.
    normal: DVec3,
    /// Squared length of the normal; 0 without an area.
    area: f64,
}

impl Facet {
    fn new(corners: &Triangle) -> Self {
        let [p, q, r] = *corners;
        let edges = [q - p, r - q, p - r];
        let squares = edges.map(DVec3::length_squared);
        let normal = edges[0].cross(-edges[2]);
        let area = normal.length_squared();
        let longest = squares[0].max(squares[1]).max(squares[2]);
        let area = if area > FLAT * FLAT * longest * longest { area } else { 0.0 };
        Self { corners: *corners, edges, squares, normal, area }
    }

    /// Heights of another triangle's corners over the plane, times the normal's length; 0 without an
    /// area.
    fn heights(&self, other: &Self) -> [f64; 3] {
        // Without an area there is no plane, and the normal is rounding.
        let normal = if self.area > 0.0 { self.normal } else { DVec3::ZERO };
        other.corners.map(|p| normal.dot(p - self.corners[0]))
    }

    /// Whether the foot of a point on the plane lies in the triangle.
    fn covers(&self, point: DVec3) -> bool {
        (0..3).all(|i| self.normal.cross(self.edges[i]).dot(point - self.corners[i]) >= 0.0)
    }
}

/// The nearest points of two triangles, if their squared distance is less than `limit` (m²).
pub(crate) fn nearest(a: &Triangle, b: &Triangle, limit: f64) -> Option<Nearest> {
    let (a, b) = (Facet::new(a), Facet::new(b));
    let (over_a, over_b) = (a.heights(&b), b.heights(&a));
    let (aside_a, aside_b) = (one_side(over_a), one_side(over_b));
    if beyond(aside_a, a.area, limit) || beyond(aside_b, b.area, limit) {
        return None;
    }
    let mut best = Nearest { squared: limit, on_a: a.corners[0], on_b: b.corners[0] };
    if aside_a == 0.0
        && aside_b == 0.0
        && let Some(point) = crossing(&a, &b, over_a).or_else(|| crossing(&b, &a, over_b))
    {
        return Some(Nearest { squared: 0.0, on_a: point, on_b: point });
    }
    corners_over(&a, &b, over_a, limit, |foot, corner| best.offer(foot, corner));
    corners_over(&b, &a, over_b, limit, |foot, corner| best.offer(corner, foot));
    corners_at_edges(&a, &b, |foot, corner| best.offer(foot, corner));
    corners_at_edges(&b, &a, |foot, corner| best.offer(corner, foot));
    edges(&a, &b, &mut best);
    (best.squared < limit).then_some(best)
}

/// The least of three heights, if all are on one side, else 0.
fn one_side([p, q, r]: [f64; 3]) -> f64 {
    if (p > 0.0 && q > 0.0 && r > 0.0) || (p < 0.0 && q < 0.0 && r < 0.0) {
        p.abs().min(q.abs()).min(r.abs())
    } else {
        0.0
    }
}

fn beyond(height: f64, area: f64, limit: f64) -> bool {
    area > 0.0 && height * height >= limit * area
}

/// A point where an edge of `other`, whose corners lie at `heights` over the triangle's plane, passes through it.
fn crossing(triangle: &Facet, other: &Facet, heights: [f64; 3]) -> Option<DVec3> {
    if triangle.area == 0.0 {
        return None;
    }
    (0..3).find_map(|i| {
        let (from, to) = (heights[i], heights[(i + 1) % 3]);
        if from * to > 0.0 || from == to {
            return None;
        }
        let point = other.corners[i] + other.edges[i] * (from / (from - to));
        triangle.covers(point).then_some(point)
    })
}

/// Offers the feet of `other`'s corners on the triangle, where they have one.
fn corners_over(
    triangle: &Facet,
    other: &Facet,
    heights: [f64; 3],
    limit: f64,
    mut offer: impl FnMut(DVec3, DVec3),
) {
    if triangle.area == 0.0 {
        return;
    }
    for (height, corner) in heights.into_iter().zip(other.corners) {
        if height * height < limit * triangle.area && triangle.covers(corner) {
            offer(corner - triangle.normal * (height / triangle.area), corner);
        }
    }
}

/// Offers the points of the triangle's edges that are nearest to `other`'s corners.
fn corners_at_edges(triangle: &Facet, other: &Facet, mut offer: impl FnMut(DVec3, DVec3)) {
    for i in 0..3 {
        let (start, edge, square) = (triangle.corners[i], triangle.edges[i], triangle.squares[i]);
        let scale = if square > 0.0 { 1.0 / square } else { 0.0 };
        for corner in other.corners {
            let along = ((corner - start).dot(edge) * scale).clamp(0.0, 1.0);
            offer(start + edge * along, corner);
        }
    }
}

/// Tries the points where the common normal of two edges' lines meets them, where it meets both edges inside.
fn edges(a: &Facet, b: &Facet, best: &mut Nearest) {
    for i in 0..3 {
        for j in 0..3 {
            let normal = a.edges[i].cross(b.edges[j]);
            let square = normal.length_squared();
            if square <= FLAT * FLAT * a.squares[i] * b.squares[j] {
                continue;
            }
            let between = b.corners[j] - a.corners[i];
            let gap = between.dot(normal);
            if gap * gap >= best.squared * square {
                continue;
            }
            let along_a = between.cross(b.edges[j]).dot(normal) / square;
            let along_b = between.cross(a.edges[i]).dot(normal) / square;
            if (0.0..=1.0).contains(&along_a) && (0.0..=1.0).contains(&along_b) {
                best.offer(a.corners[i] + a.edges[i] * along_a, b.corners[j] + b.edges[j] * along_b);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::convex::{Hull, Limits, Placement, Start, gjk};
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    /// Against the convex query; on a grid, where touching, parallel and degenerate triangles abound.
    #[test]
    fn agrees_with_the_distance_of_convex_hulls() {
        const SEED: u64 = 0x7217;
        let mut rng = StdRng::seed_from_u64(SEED);
        let mut touching = 0;
        for round in 0..60_000 {
            let grid = round % 2 == 0;
            let mut point = || {
                let p = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-2.0..2.0f64)));
                if grid { p.round() } else { p }
            };
            let (a, b) = ([point(), point(), point()], [point(), point(), point()]);
            // Some with three corners on a line but for rounding.
            let b = if round % 7 == 1 { [b[0], b[1], b[0] + (b[1] - b[0]) / 3.0] } else { b };
            let limits = Limits { beyond: f64::INFINITY, share: 0.0, enough: -1.0, precision: 1e-13 };
            let plain = gjk::distance(
                &Hull::new(&a),
                &Hull::new(&b),
                &Placement::IDENTITY,
                Start::Axis(a[0] - b[0]),
                &limits,
            )
            .distance;
            let found = nearest(&a, &b, f64::INFINITY).unwrap();
            let distance = found.squared.sqrt();
            let context = format!("seed {SEED:#x}, round {round}: {a:?} {b:?} {distance} {plain}");
            assert!((distance - plain).abs() < 1e-9, "{context}");
            assert!((found.on_a.distance(found.on_b) - distance).abs() < 1e-12, "{context}");
            assert!(nearest(&a, &b, found.squared * 0.99).is_none(), "{context}");
            touching += usize::from(distance < 1e-12);
        }
        assert!((1_000..59_000).contains(&touching), "{touching}");
    }

    /// Lines at 10⁻⁷ rad that cross in the middle.
    #[test]
    fn nearly_parallel_edges() {
        let tilt = 1e-7;
        let a = [DVec3::new(-1.0, 0.0, 0.0), DVec3::new(1.0, 0.0, 0.0), DVec3::new(0.0, 0.0, -1.0)];
        let gap = 1e-9;
        let b = [DVec3::new(-1.0, -tilt, gap), DVec3::new(1.0, tilt, gap), DVec3::new(0.0, 0.0, 1.0)];
        let found = nearest(&a, &b, f64::INFINITY).unwrap().squared.sqrt();
        assert!((found - gap).abs() < 1e-15, "{found}");
    }
}
