//! The mesh in coordinates of unit size about the origin, with the planes of its triangles and a tree of
//! boxes over them.
//!
//! Unit coordinates are those of the mesh, relative to the centre of its bounding sphere, times a power of
//! two: only the subtraction rounds, and tolerances can be plain numbers. The [tree](BoxTree) is our own, in
//! f64 and refitted as the mesh is simplified: `obvhs` holds its boxes in f32, which would have to be widened
//! for exactness, and the traversal here needs more than a box or ray test at each node (see
//! [`Surface::reaches_into`]).

use glam::DVec3;
use palpate_core::TriMesh;

pub(crate) use crate::box_tree::bounds_of;
use crate::box_tree::{Bounds, BoxTree, EMPTY};
use crate::hull::Plane;

/// Quantum of distances, as a fraction of the object's radius: costs are rounded to it, so that rounding
/// errors do not decide which of two equal ones comes first.
pub(crate) const GRAIN: f64 = 1e-7;

/// A mesh in unit coordinates with its spatial index.
#[derive(Clone, Debug)]
pub(crate) struct Surface {
    /// Vertices in unit coordinates.
    pub points: Vec<DVec3>,
    /// Triangles as vertex indices.
    pub triangles: Vec<[u32; 3]>,
    /// The triangles' planes; a zero normal for a degenerate triangle.
    pub planes: Vec<Plane>,
    /// Unit coordinates per metre.
    pub scale: f64,
    /// Origin of unit coordinates, m.
    pub center: DVec3,
    tree: BoxTree,
}

/// Buffers of [`Surface::reaches_into`].
#[derive(Debug, Default)]
pub(crate) struct ReachBuffers {
    lowered: Vec<Plane>,
    stack: Vec<u32>,
    clipped: Vec<DVec3>,
    spare: Vec<DVec3>,
}

impl Surface {
    /// Indexes a mesh with a bounding sphere of radius above 0.
    pub fn new(mesh: &TriMesh, center: DVec3, radius: f64) -> Self {
        let scale = 2f64.powi(-(radius.log2().ceil() as i32));
        let points: Vec<DVec3> = mesh.vertices().iter().map(|p| (*p - center) * scale).collect();
        Self::from_parts(points, mesh.triangles().to_vec(), scale, center)
    }

    /// Indexes a mesh in unit coordinates: metres less `center`, times `scale`.
    pub fn from_parts(points: Vec<DVec3>, triangles: Vec<[u32; 3]>, scale: f64, center: DVec3) -> Self {
        let planes = triangles.iter().map(|t| plane_of(t.map(|v| points[v as usize]))).collect();
        let mut surface = Self { points, triangles, planes, scale, center, tree: BoxTree::default() };
        surface.index();
        surface
    }

    /// Rebuilds the spatial index.
    pub fn index(&mut self) {
        let boxes: Vec<_> = (0..self.triangles.len() as u32).map(|t| self.bounds(t)).collect();
        self.tree = BoxTree::new(&boxes);
    }

    /// Refits the spatial index after a triangle has moved or was removed; a removed one names one vertex
    /// three times.
    pub fn moved(&mut self, triangle: u32) {
        let Self { tree, triangles, points, .. } = self;
        tree.refit(triangle, |t| bounds_in(triangles[t as usize], points));
    }

    /// The spatial index over the triangles.
    pub fn tree(&self) -> &BoxTree {
        &self.tree
    }

    /// The box of a triangle; empty if it has collapsed to a vertex.
    pub fn bounds(&self, triangle: u32) -> Bounds {
        bounds_in(self.triangles[triangle as usize], &self.points)
    }

    /// The corners of a triangle, in unit coordinates.
    pub fn corners(&self, triangle: u32) -> [DVec3; 3] {
        self.triangles[triangle as usize].map(|v| self.points[v as usize])
    }

    /// Whether any triangle, except those to skip, reaches deeper than `depth` into a convex polytope: has a
    /// point more than `depth` below all of its planes. `low` and `high` bound the polytope.
    ///
    /// Most triangles that do not reach in are above one of the planes. So the plane that separated the last
    /// triangle is tried first, and boxes are tested against that plane only: most triangles near a hull are
    /// its own and skipped, so that testing their boxes against many planes does not pay.
    pub fn reaches_into(
        &self,
        planes: impl Iterator<Item = Plane>,
        (low, high): (DVec3, DVec3),
        depth: f64,
        skip: impl Fn(u32) -> bool,
        buffers: &mut ReachBuffers,
    ) -> bool {
        let ReachBuffers { lowered, stack, clipped, spare } = buffers;
        lowered.clear();
        lowered.extend(planes.map(|p| Plane { normal: p.normal, offset: p.offset - depth }));
        let mut last = lowered.first().copied().unwrap_or(Plane::NONE);
        stack.clear();
        stack.push(0);
        while let Some(index) = stack.pop() {
            let node = &self.tree.nodes[index as usize];
            if node.low.cmpgt(high).any() || node.high.cmplt(low).any() {
                continue;
            }
            let (middle, half) = (0.5 * (node.low + node.high), 0.5 * (node.high - node.low));
            if last.height(middle) - last.normal.abs().dot(half) >= 0.0 {
                continue;
            }
            if node.count == 0 {
                stack.extend([node.first, index + 1]);
                continue;
            }
            for &t in self.tree.items(node) {
                if skip(t) {
                    continue;
                }
                let corners = self.corners(t);
                let (from, to) = bounds_of(&corners);
                if from.cmpgt(high).any() || to.cmplt(low).any() {
                    continue;
                }
                let is_above = |p: &&Plane| corners.iter().all(|c| p.height(*c) >= 0.0);
                if is_above(&&last) {
                    continue;
                }
                if let Some(plane) = lowered.iter().find(is_above) {
                    last = *plane;
                } else if cuts(&corners, lowered, clipped, spare) {
                    return true;
                }
            }
        }
        false
    }
}

/// Ray directions, not aligned with anything, to be tried one after the other.
const RAYS: [DVec3; 4] = [
    DVec3::new(0.483_177_129, 0.262_349_887, 0.835_304_761),
    DVec3::new(-0.719_532_871, 0.601_128_313, 0.347_720_917),
    DVec3::new(0.211_934_117, -0.911_383_549, 0.352_812_733),
    DVec3::new(-0.357_391_273, -0.204_817_739, -0.911_218_457),
];

impl Surface {
    /// Winding number of the surface about a point: 1 inside a closed surface that faces outwards, 0 outside.
    /// `None` if all rays from the point pass too close to edges to decide it.
    pub fn winding_number(&self, point: DVec3) -> Option<i32> {
        RAYS.iter().find_map(|ray| self.crossings(point, *ray))
    }

    /// Number of times that a ray leaves the surface, minus those that it enters it; `None` if it passes too
    /// close to an edge.
    fn crossings(&self, from: DVec3, ray: DVec3) -> Option<i32> {
        let inverse = ray.recip();
        let mut stack = vec![0u32];
        let mut sum = 0;
        while let Some(index) = stack.pop() {
            let node = &self.tree.nodes[index as usize];
            let (s, t) = ((node.low - from) * inverse, (node.high - from) * inverse);
            let (enter, leave) = (s.min(t).max_element(), s.max(t).min_element());
            // Widened by more than rounding, so that no triangle at the edge of the box is missed.
            if enter > leave + 1e-12 || leave < -1e-12 {
                continue;
            }
            if node.count == 0 {
                stack.extend([node.first, index + 1]);
                continue;
            }
            for &t in self.tree.items(node) {
                let corners = self.corners(t).map(|c| c - from);
                let sides: [f64; 3] =
                    std::array::from_fn(|k| ray.dot(corners[k].cross(corners[(k + 1) % 3])));
                let longest = (0..3).map(|k| corners[k].distance(corners[(k + 1) % 3])).fold(0.0, f64::max);
                let doubt = 1e-14 * longest.max(1e-14) * corners[0].length().max(longest);
                if sides.iter().any(|x| *x > doubt) && sides.iter().any(|x| *x < -doubt) {
                    continue;
                }
                if (corners[1] - corners[0]).cross(corners[2] - corners[0]).dot(ray).abs() <= 3.0 * doubt {
                    // The triangle is seen edge on: undecided unless it is behind.
                    if corners.iter().all(|c| ray.dot(*c) < 0.0) {
                        continue;
                    }
                    return None;
                }
                let along: f64 = (0..3).map(|k| sides[(k + 1) % 3] * ray.dot(corners[k])).sum::<f64>()
                    / sides.iter().sum::<f64>();
                if sides.iter().any(|x| x.abs() <= doubt) {
                    if along < 0.0 {
                        continue;
                    }
                    return None;
                }
                if along > 0.0 {
                    sum += if sides[0] > 0.0 { 1 } else { -1 };
                }
            }
        }
        Some(sum)
    }
}

fn bounds_in(triangle: [u32; 3], points: &[DVec3]) -> Bounds {
    let [a, b, c] = triangle;
    if a == b && b == c { EMPTY } else { bounds_of(&triangle.map(|v| points[v as usize])) }
}

/// The plane of a triangle; with a zero normal where the corners are too close to a line to define one.
pub(crate) fn plane_of([a, b, c]: [DVec3; 3]) -> Plane {
    let longest = (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
    if (b - a).cross(c - a).length() > 1e-12 * longest {
        Plane::through([a, b, c])
    } else {
        Plane { normal: DVec3::ZERO, offset: 0.0 }
    }
}

/// Whether a triangle reaches deeper than `depth` below all planes.
pub(crate) fn reaches_below(
    corners: &[DVec3; 3],
    planes: &[Plane],
    depth: f64,
    buffers: &mut ReachBuffers,
) -> bool {
    let ReachBuffers { lowered, clipped, spare, .. } = buffers;
    lowered.clear();
    for plane in planes {
        let plane = Plane { normal: plane.normal, offset: plane.offset - depth };
        let heights = corners.map(|c| plane.height(c));
        if heights.iter().all(|h| *h >= 0.0) {
            return false;
        }
        if heights.iter().any(|h| *h >= 0.0) {
            lowered.push(plane);
        }
    }
    cuts(corners, lowered, clipped, spare)
}

/// Whether a polygon has points below all planes, by Sutherland and Hodgman's clipping.
fn cuts(polygon: &[DVec3], planes: &[Plane], clipped: &mut Vec<DVec3>, spare: &mut Vec<DVec3>) -> bool {
    clipped.clear();
    clipped.extend_from_slice(polygon);
    for plane in planes {
        spare.clear();
        for k in 0..clipped.len() {
            let (p, q) = (clipped[k], clipped[(k + 1) % clipped.len()]);
            let (hp, hq) = (plane.height(p), plane.height(q));
            if hp < 0.0 {
                spare.push(p);
            }
            if (hp < 0.0) != (hq < 0.0) {
                spare.push(p + (q - p) * (hp / (hp - hq)));
            }
        }
        std::mem::swap(clipped, spare);
        if clipped.is_empty() {
            return false;
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use palpate_models::Model;
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;
    use crate::hull::HullBuilder;

    fn surface(model: Model, triangles: usize) -> Surface {
        let mesh = model.generate(triangles).expect("within range");
        let sphere = mesh.bounding_sphere();
        Surface::new(&mesh, sphere.center, sphere.radius)
    }

    fn random(rng: &mut StdRng) -> DVec3 {
        DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)))
    }

    #[test]
    fn unit_coordinates() {
        let surface = surface(Model::Torus, 2000);
        let reach = surface.points.iter().map(|p| p.length()).fold(0.0, f64::max);
        assert!((0.5..=1.0 + 1e-12).contains(&reach), "{reach}");
        assert_eq!(surface.scale.log2().fract(), 0.0);
    }

    /// Depth of a triangle's deepest point in a polytope, on a fine grid of points.
    fn deepest_on_grid([a, b, c]: [DVec3; 3], planes: &[Plane]) -> f64 {
        let n = 24;
        let mut deepest = f64::MIN;
        for i in 0..=n {
            for j in 0..=n - i {
                let (u, v) = (f64::from(i) / f64::from(n), f64::from(j) / f64::from(n));
                let p = a + (b - a) * u + (c - a) * v;
                deepest = deepest.max(planes.iter().map(|plane| -plane.height(p)).fold(f64::MAX, f64::min));
            }
        }
        deepest
    }

    #[test]
    fn reach_agrees_with_points_on_every_triangle() {
        let seed = 41;
        println!("seed {seed}");
        let mut rng = StdRng::seed_from_u64(seed);
        let surface = surface(Model::Torus, 2000);
        let (mut hulls, mut buffers) = (HullBuilder::default(), ReachBuffers::default());
        let mut hits = 0;
        for round in 0..150 {
            let size = [0.02, 0.1, 0.5][round % 3];
            let middle = random(&mut rng) * 0.8;
            let points: Vec<DVec3> = (0..4 + round % 30).map(|_| middle + size * random(&mut rng)).collect();
            let hull = hulls.hull(&points, 1e-14);
            let planes: Vec<Plane> = hull.planes(&points).collect();
            let depth = 0.1 * size;
            let skip = |t: u32| t.is_multiple_of(3);
            let found =
                surface.reaches_into(planes.iter().copied(), bounds_of(&points), depth, skip, &mut buffers);
            let deepest = (0..surface.triangles.len() as u32)
                .filter(|t| !skip(*t))
                .map(|t| deepest_on_grid(surface.corners(t), &planes))
                .fold(f64::MIN, f64::max);
            if deepest > depth {
                assert!(found, "round {round}: a point is {deepest} deep");
            } else if deepest < depth - 0.02 {
                // No two points of the grid are farther apart than that.
                assert!(!found, "round {round}: the deepest point is at {deepest}");
            }
            hits += usize::from(found);
        }
        assert!((20..130).contains(&hits), "{hits} of 150 is no test");
    }

    #[test]
    fn winding_number_agrees_with_the_solid_angle() {
        let seed = 42;
        println!("seed {seed}");
        let mut rng = StdRng::seed_from_u64(seed);
        let surface = surface(Model::Torus, 2000);
        let (mut inside, mut undecided) = (0, 0);
        for _ in 0..500 {
            // Near the surface; sometimes at a multiple of a vertex, from where rays may meet edges.
            let near = surface.points[rng.random_range(0..surface.points.len())];
            let p = near * rng.random_range(0.8..1.1)
                + if inside % 7 == 0 { DVec3::ZERO } else { 0.1 * random(&mut rng) };
            let angle: f64 = (0..surface.triangles.len() as u32)
                .map(|t| {
                    let [a, b, c] = surface.corners(t).map(|q| q - p);
                    let (la, lb, lc) = (a.length(), b.length(), c.length());
                    let under = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
                    2.0 * a.dot(b.cross(c)).atan2(under)
                })
                .sum();
            let expected = (angle / (4.0 * std::f64::consts::PI)).round() as i32;
            match surface.winding_number(p) {
                Some(turns) => assert_eq!(turns, expected, "at {p}"),
                None => undecided += 1,
            }
            inside += expected as usize;
        }
        assert!(inside > 20 && undecided < 5, "{inside} inside, {undecided} undecided");
    }
}
