//! The exact signed distance from a mesh.
//!
//! The sign is that of the angle-weighted pseudonormal of the nearest feature (J. A. Bærentzen and H. Aanæs, *Signed distance
//! computation using the angle weighted pseudonormal*, 2005): right for closed oriented meshes, and the side of the nearest
//! face for open ones.

use std::collections::HashMap;

use glam::DVec3;
use palpate_core::TriMesh;

/// Triangles of a leaf.
const LEAF: usize = 4;

/// A mesh to ask for signed distances.
#[derive(Clone, Debug)]
pub struct ExactDistance {
    /// In the order of the leaves.
    triangles: Vec<Triangle>,
    nodes: Vec<Node>,
}

#[derive(Clone, Copy, Debug)]
struct Triangle {
    corners: [DVec3; 3],
    normal: DVec3,
    /// Pseudonormals of the edges from corner i to i + 1, and of the corners.
    edges: [DVec3; 3],
    vertices: [DVec3; 3],
}

/// Depth first: the first child follows its parent.
#[derive(Clone, Copy, Debug)]
struct Node {
    low: DVec3,
    high: DVec3,
    /// The second child, or the first triangle of a leaf.
    next: u32,
    /// Triangles of a leaf, 0 of others.
    count: u32,
}

/// The nearest point of a surface.
#[derive(Clone, Copy, Debug)]
pub struct Nearest {
    /// m.
    pub point: DVec3,
    /// Negative inside, m.
    pub distance: f64,
    /// Where a search nearby starts best.
    pub hint: u32,
}

impl ExactDistance {
    /// Of a mesh's surface.
    ///
    /// # Panics
    /// If it has no triangles.
    pub fn new(mesh: &TriMesh) -> Self {
        assert!(!mesh.triangles().is_empty(), "a mesh without triangles has no distance");
        let mut triangles = with_pseudonormals(mesh);
        let mut nodes = Vec::with_capacity(triangles.len());
        let end = triangles.len();
        split(&mut triangles, 0, end, &mut nodes);
        Self { triangles, nodes }
    }

    /// The nearest point to a point, m. `hint` is that of a search nearby, or 0.
    pub fn nearest(&self, p: DVec3, hint: u32) -> Nearest {
        let closest = |index: u32| closest(p, &self.triangles[index as usize].corners);
        let mut best = (closest(hint), hint);
        let mut squared = best.0.0.distance_squared(p);
        // 64 levels are more than a tree of 2³² triangles has.
        let mut stack = [(0u32, 0.0f64); 64];
        let mut top = 1;
        while top > 0 {
            top -= 1;
            let (index, bound) = stack[top];
            if bound >= squared {
                continue;
            }
            let node = &self.nodes[index as usize];
            if node.count > 0 {
                for triangle in node.next..node.next + node.count {
                    let found = closest(triangle);
                    let distance = found.0.distance_squared(p);
                    if distance < squared {
                        (best, squared) = ((found, triangle), distance);
                    }
                }
                continue;
            }
            let children = [index + 1, node.next];
            let [one, other] = children.map(|child| (child, self.nodes[child as usize].squared_distance(p)));
            let (near, far) = if one.1 <= other.1 { (one, other) } else { (other, one) };
            stack[top] = far;
            stack[top + 1] = near;
            top += 2;
        }
        let ((point, feature), hint) = best;
        let triangle = &self.triangles[hint as usize];
        let normal = match feature {
            Feature::Face => triangle.normal,
            Feature::Edge(edge) => triangle.edges[edge],
            Feature::Vertex(vertex) => triangle.vertices[vertex],
        };
        let inside = normal.dot(p - point) < 0.0;
        let distance = squared.sqrt();
        Nearest { point, distance: if inside { -distance } else { distance }, hint }
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        size_of::<Self>()
            + self.triangles.capacity() * size_of::<Triangle>()
            + self.nodes.capacity() * size_of::<Node>()
    }
}

impl Node {
    fn squared_distance(&self, p: DVec3) -> f64 {
        (self.low - p).max(p - self.high).max(DVec3::ZERO).length_squared()
    }
}

/// Where on a triangle a point is.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Feature {
    Face,
    Edge(usize),
    Vertex(usize),
}

/// The point of a triangle nearest to a point (Ericson 2005, §5.1.5).
fn closest(p: DVec3, &[a, b, c]: &[DVec3; 3]) -> (DVec3, Feature) {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return (a, Feature::Vertex(0));
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return (b, Feature::Vertex(1));
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return (a + ab * (d1 / (d1 - d3)), Feature::Edge(0));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return (c, Feature::Vertex(2));
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return (a + ac * (d2 / (d2 - d6)), Feature::Edge(2));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return (b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6))), Feature::Edge(1));
    }
    let sum = va + vb + vc;
    (a + ab * (vb / sum) + ac * (vc / sum), Feature::Face)
}

fn with_pseudonormals(mesh: &TriMesh) -> Vec<Triangle> {
    let normal = |corners: [DVec3; 3]| (corners[1] - corners[0]).cross(corners[2] - corners[0]);
    let mut of_vertex = vec![DVec3::ZERO; mesh.vertices().len()];
    let mut of_edge: HashMap<[u32; 2], DVec3> = HashMap::new();
    let edge = |a: u32, b: u32| [a.min(b), a.max(b)];
    // What has no area has no side, and is where its neighbours are.
    let solid = (0..mesh.triangles().len()).filter(|t| normal(mesh.corners(*t)) != DVec3::ZERO);
    let solid: Vec<usize> = solid.collect();
    for &t in &solid {
        let (corners, indices) = (mesh.corners(t), mesh.triangles()[t]);
        let n = normal(corners).normalize();
        for i in 0..3 {
            let [at, next, last] = [corners[i], corners[(i + 1) % 3], corners[(i + 2) % 3]];
            of_vertex[indices[i] as usize] += n * (next - at).angle_between(last - at);
            *of_edge.entry(edge(indices[i], indices[(i + 1) % 3])).or_default() += n;
        }
    }
    let of = |t: usize| {
        let (corners, indices) = (mesh.corners(t), mesh.triangles()[t]);
        Triangle {
            corners,
            normal: normal(corners).normalize_or_zero(),
            edges: [0, 1, 2]
                .map(|i| of_edge.get(&edge(indices[i], indices[(i + 1) % 3])).copied().unwrap_or_default()),
            vertices: indices.map(|v| of_vertex[v as usize]),
        }
    };
    let all = solid.is_empty();
    if all { (0..mesh.triangles().len()).map(of).collect() } else { solid.into_iter().map(of).collect() }
}

fn split(triangles: &mut [Triangle], first: usize, end: usize, nodes: &mut Vec<Node>) {
    let own = &mut triangles[first..end];
    let points = || own.iter().flat_map(|triangle| triangle.corners);
    let low = points().fold(DVec3::INFINITY, DVec3::min);
    let high = points().fold(DVec3::NEG_INFINITY, DVec3::max);
    let index = nodes.len();
    nodes.push(Node { low, high, next: first as u32, count: own.len() as u32 });
    if own.len() <= LEAF {
        return;
    }
    let axis = (high - low).max_position();
    let middle = own.len() / 2;
    let key = |triangle: &Triangle| triangle.corners.iter().map(|corner| corner[axis]).sum::<f64>();
    own.select_nth_unstable_by(middle, |s, t| key(s).total_cmp(&key(t)));
    split(triangles, first, first + middle, nodes);
    nodes[index].next = nodes.len() as u32;
    nodes[index].count = 0;
    split(triangles, first + middle, end, nodes);
}

#[cfg(test)]
mod tests {
    use palpate_models::Model;
    use rand::rngs::StdRng;
    use rand::{RngExt as _, SeedableRng as _};

    use super::*;

    /// Whether a point is inside a closed mesh, by its winding number (Van Oosterom and Strackee 1983).
    fn is_inside(mesh: &TriMesh, point: DVec3) -> bool {
        let angle = |t: usize| {
            let [a, b, c] = mesh.corners(t).map(|corner| corner - point);
            let (x, y, z) = (a.length(), b.length(), c.length());
            let below = x * y * z + a.dot(b) * z + b.dot(c) * x + c.dot(a) * y;
            2.0 * a.dot(b.cross(c)).atan2(below)
        };
        (0..mesh.triangles().len()).map(angle).sum::<f64>() > std::f64::consts::TAU
    }

    #[test]
    fn agrees_with_all_triangles_and_the_winding_number() {
        let mut rng = StdRng::seed_from_u64(0xE8AC);
        for model in [Model::Torus, Model::Cup, Model::Gear] {
            let mesh = model.generate(6000).expect("in range");
            let sphere = mesh.bounding_sphere();
            let distance = ExactDistance::new(&mesh);
            let (mut hint, mut inside) = (0, 0);
            for round in 0..300 {
                let direction = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
                // Half of them near the surface.
                let on = mesh.corners(rng.random_range(0..mesh.triangles().len()))[0];
                let point = if round % 2 == 0 {
                    sphere.center + sphere.radius * direction
                } else {
                    on + 0.02 * sphere.radius * direction
                };
                let found = distance.nearest(point, hint);
                hint = found.hint;
                let all = (0..mesh.triangles().len())
                    .map(|t| closest(point, &mesh.corners(t)).0.distance(point))
                    .fold(f64::INFINITY, f64::min);
                assert!((found.distance.abs() - all).abs() < 1e-12 * sphere.radius, "{found:?}, {all}");
                assert!((found.point.distance(point) - all).abs() < 1e-12 * sphere.radius);
                assert_eq!(
                    found.distance < 0.0,
                    is_inside(&mesh, point),
                    "{model:?}, round {round}: {found:?}"
                );
                inside += usize::from(found.distance < 0.0);
            }
            assert!((50..250).contains(&inside), "{inside} inside");
        }
    }

    #[test]
    fn closest_points_against_a_grid() {
        let mut rng = StdRng::seed_from_u64(0xE8AD);
        for round in 0..300 {
            let mut random = || DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
            let (p, corners) = (2.0 * random(), [random(), random(), random()]);
            let (point, feature) = closest(p, &corners);
            let [a, b, c] = corners;
            let n = 60;
            let mut least = f64::INFINITY;
            for i in 0..=n {
                for j in 0..=n - i {
                    let (u, v) = (f64::from(i) / f64::from(n), f64::from(j) / f64::from(n));
                    least = least.min(p.distance(a + (b - a) * u + (c - a) * v));
                }
            }
            let found = point.distance(p);
            assert!(found <= least + 1e-12 && found >= least - 0.05, "round {round}: {found} {least}");
            if let Feature::Vertex(vertex) = feature {
                assert_eq!(point, corners[vertex]);
            }
        }
    }
}
