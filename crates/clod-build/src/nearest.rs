//! Nearest points of triangles, and nearest triangles of surfaces.

use glam::DVec3;

use crate::box_tree::BoxNode;
use crate::surface::Surface;

/// The point of a triangle that is nearest to a point (Ericson 2005, §5.1.5); triangles without area too.
pub(crate) fn nearest_on_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> DVec3 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    // Barycentric coordinates of the projection, times their sum.
    let inner = [d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2];
    let sum = inner[0] + inner[1] + inner[2];
    // In a sliver, rounding may put the projection on the wrong side of an edge.
    let sliver = sum.is_nan() || sum <= 1e-8 * ab.length_squared() * ac.length_squared();
    if !sliver && inner[0] > 0.0 && inner[1] > 0.0 && inner[2] > 0.0 {
        return a + ab * (inner[1] / sum) + ac * (inner[2] / sum);
    }
    // The projection is outside: the nearest point is on one of the sides that it is beyond.
    let mut best = (a, f64::INFINITY);
    for (beyond, from, to) in [(inner[0], b, c), (inner[1], c, a), (inner[2], a, b)] {
        if !sliver && beyond > 0.0 {
            continue;
        }
        let along = to - from;
        let t = along.dot(p - from) / along.length_squared();
        let point = from + along * if t.is_finite() { t.clamp(0.0, 1.0) } else { 0.0 };
        let squared = point.distance_squared(p);
        if squared < best.1 {
            best = (point, squared);
        }
    }
    best.0
}

/// The squared distance of a point from a box; infinite from an empty one.
#[inline]
fn squared_to_box(p: DVec3, node: &BoxNode) -> f64 {
    (node.low - p).max(p - node.high).max(DVec3::ZERO).length_squared()
}

/// Distance of a point from a triangle.
pub(crate) fn distance_to_triangle(p: DVec3, corners: [DVec3; 3]) -> f64 {
    p.distance(nearest_on_triangle(p, corners))
}

/// Difference, in unit coordinates, up to which distances count as equal.
pub(crate) const ROUNDING: f64 = 1e-12;

/// A search for the nearest triangles of a surface.
pub(crate) struct NearestSearch<'a> {
    surface: &'a Surface,
    /// Nodes of the surface's tree yet to be visited, and the squared distances of their boxes.
    stack: Vec<(u32, f64)>,
}

impl<'a> NearestSearch<'a> {
    /// A search in the triangles of a surface.
    pub fn new(surface: &'a Surface) -> Self {
        Self { surface, stack: Vec::new() }
    }

    /// The surface.
    pub fn surface(&self) -> &'a Surface {
        self.surface
    }

    /// The triangle that is nearest to a point, and its distance; of those equally near but for rounding, the
    /// first. Any triangle may be the `guess`; the search is short if it is near.
    pub fn nearest(&mut self, p: DVec3, guess: u32) -> (u32, f64) {
        let Self { surface, stack } = self;
        let tree = surface.tree();
        let mut best = (guess, nearest_on_triangle(p, surface.corners(guess)).distance_squared(p));
        let no_further = |squared: f64| (squared.sqrt() + ROUNDING).powi(2);
        let mut limit = no_further(best.1);
        stack.clear();
        stack.push((0, 0.0));
        while let Some((index, squared)) = stack.pop() {
            if squared >= limit {
                continue;
            }
            let node = &tree.nodes[index as usize];
            if node.count > 0 {
                for &t in tree.items(node) {
                    // No point of a triangle is nearer than its plane; the factor is for rounding.
                    let height = surface.planes[t as usize].height(p);
                    if t == guess || height * height * (1.0 - 1e-9) >= limit {
                        continue;
                    }
                    let squared = nearest_on_triangle(p, surface.corners(t)).distance_squared(p);
                    if no_further(squared) < best.1 || squared < limit && t < best.0 {
                        best = (t, squared);
                        limit = no_further(squared);
                    }
                }
            } else {
                let one = (index + 1, squared_to_box(p, &tree.nodes[index as usize + 1]));
                let other = (node.first, squared_to_box(p, &tree.nodes[node.first as usize]));
                let (near, far) = if one.1 <= other.1 { (one, other) } else { (other, one) };
                if far.1 < limit {
                    stack.push(far);
                }
                stack.push(near);
            }
        }
        (best.0, best.1.sqrt())
    }
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    #[test]
    fn nearest_points_against_a_grid() {
        let seed = 81;
        println!("seed {seed}");
        let mut rng = StdRng::seed_from_u64(seed);
        for round in 0..300 {
            let mut random = || DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
            let (p, a, b) = (2.0 * random(), random(), random());
            // Some triangles are segments or points.
            let c = [random(), a + 0.3 * (b - a), a][round % 3];
            let b = if round % 9 == 2 { a } else { b };
            let found = distance_to_triangle(p, [a, b, c]);
            let n = 60;
            let mut least = f64::INFINITY;
            for i in 0..=n {
                for j in 0..=n - i {
                    let (u, v) = (f64::from(i) / f64::from(n), f64::from(j) / f64::from(n));
                    least = least.min(p.distance(a + (b - a) * u + (c - a) * v));
                }
            }
            assert!(found <= least + 1e-12 && found >= least - 0.05, "round {round}: {found} {least}");
        }
    }

    #[test]
    fn nearest_triangle_agrees_with_trying_all() {
        let seed = 82;
        println!("seed {seed}");
        let mut rng = StdRng::seed_from_u64(seed);
        let mesh = palpate_models::Model::Torus.generate(1000).expect("within range");
        let sphere = mesh.bounding_sphere();
        let surface = Surface::new(&mesh, sphere.center, sphere.radius);
        let mut search = NearestSearch::new(&surface);
        for _ in 0..200 {
            let p = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
            let all = (0..surface.triangles.len() as u32)
                .map(|t| distance_to_triangle(p, surface.corners(t)))
                .fold(f64::INFINITY, f64::min);
            let (t, distance) = search.nearest(p, rng.random_range(0..surface.triangles.len() as u32));
            assert!((distance - all).abs() < 2.0 * ROUNDING, "{distance} {all}");
            assert_eq!(distance_to_triangle(p, surface.corners(t)), distance);
        }
    }
}
