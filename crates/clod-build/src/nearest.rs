//! Nearest points of triangles, and nearest triangles of surfaces.

use glam::DVec3;
use palpate_core::triangle::nearest_on_triangle;

use crate::box_tree::BoxNode;
use crate::surface::Surface;

/// The squared distance of a point from a box; infinite from an empty one.
#[inline]
fn squared_to_box(p: DVec3, node: &BoxNode) -> f64 {
    (node.low - p).max(p - node.high).max(DVec3::ZERO).length_squared()
}

/// Distance of a point from a triangle.
pub(crate) fn distance_to_triangle(p: DVec3, corners: [DVec3; 3]) -> f64 {
    p.distance(nearest_on_triangle(p, &corners).0)
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
        let mut best = (guess, nearest_on_triangle(p, &surface.corners(guess)).0.distance_squared(p));
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
                    let squared = nearest_on_triangle(p, &surface.corners(t)).0.distance_squared(p);
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
