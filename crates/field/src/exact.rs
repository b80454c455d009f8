//! Exact signed distances from a mesh.
//!
//! The sign is that of the angle-weighted pseudonormal of the nearest feature (J. A. Bærentzen and H. Aanæs,
//! *Signed distance computation using the angle weighted pseudonormal*, 2005): correct for closed oriented
//! meshes, and the side of the nearest face for open ones.

use std::collections::HashMap;

use arrayvec::ArrayVec;
use glam::DVec3;
use palpate_core::TriMesh;
use palpate_core::triangle::{TriangleFeature, nearest_on_triangle};
use wide::f32x4;

/// Largest number of triangles of a leaf, and of children of a node: one for each SIMD lane.
const LANES: usize = 4;
/// Number of parts of an axis between which triangles may be divided. With fewer, boxes overlap more; with
/// more, the tree takes longer to build.
const BINS: usize = 16;
/// Depth from which triangles are divided into halves: others may be few of many.
const HALVED: u32 = 24;
/// Largest depth: 2³² triangles are halved 32 times.
const MAX_DEPTH: usize = HALVED as usize + 32;
/// Margin of the search, as a fraction of the distance and of the mesh's size: triangles that seem further
/// away than the nearest so far by less than this are measured exactly. It covers the rounding of the search,
/// which is in single precision.
const SEARCH_MARGIN: f64 = 2e-6;

/// A mesh prepared for exact signed distances.
#[derive(Clone, Debug)]
pub struct ExactDistance {
    /// Triangles in the order of the leaves, and their pseudonormals.
    triangles: Vec<[DVec3; 3]>,
    normals: Vec<Pseudonormals>,
    leaves: Vec<Leaf>,
    nodes: Vec<Node>,
    /// Index of the root: a node, or the only leaf.
    root: u32,
    /// Middle and size of the mesh, m.
    middle: DVec3,
    size: f64,
}

/// A point of the surface with its feature and its triangle.
type Found = ((DVec3, TriangleFeature), u32);

/// Corners of up to four triangles: the last one stands for those that are missing.
#[derive(Clone, Copy, Debug)]
struct Leaf {
    corners: [Vec3x4; 3],
    /// Indices of the first and the last.
    first: u32,
    last: u32,
}

#[derive(Clone, Copy, Debug)]
struct Triangle {
    corners: [DVec3; 3],
    normals: Pseudonormals,
}

#[derive(Clone, Copy, Debug)]
struct Pseudonormals {
    /// Index of the triangle in the mesh.
    index: u32,
    face: DVec3,
    /// Those of the edges from corner i to i + 1, and of the corners.
    edges: [DVec3; 3],
    vertices: [DVec3; 3],
}

/// A box around triangles.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    low: DVec3,
    high: DVec3,
}

/// Boxes around four children, and the children's indices: nodes, or leaves with the flag [`IS_LEAF`], or
/// [`NONE`] where there are fewer.
#[derive(Clone, Copy, Debug)]
struct Node {
    low: [f32x4; 3],
    high: [f32x4; 3],
    children: [u32; LANES],
}

/// Flag of a leaf in the index of a child.
const IS_LEAF: u32 = 1 << 31;
/// Index of no child.
const NONE: u32 = u32::MAX;

/// The nearest point of a surface.
#[derive(Clone, Copy, Debug)]
pub struct Nearest {
    /// Its position, m.
    pub point: DVec3,
    /// Signed distance from it, negative inside, m.
    pub distance: f64,
    /// The triangle that it is on, as a hint for a search nearby.
    pub hint: u32,
    /// Index of that triangle in the mesh.
    pub triangle: u32,
}

impl ExactDistance {
    /// Prepares a mesh's surface.
    ///
    /// # Panics
    /// If the mesh has no triangles.
    pub fn new(mesh: &TriMesh) -> Self {
        assert!(!mesh.triangles().is_empty(), "a mesh without triangles has no distance");
        let mut own = with_pseudonormals(mesh);
        let Bounds { low, high } = Bounds::of(&own);
        let (middle, size) = (low.midpoint(high), (high - low).max_element() / 2.0);
        // A mesh that is a single point has no size to scale by.
        let size = if size > 0.0 { size } else { 1.0 };
        let (triangles, normals) = (Vec::with_capacity(own.len()), Vec::with_capacity(own.len()));
        let (leaves, nodes) = (Vec::new(), Vec::new());
        let mut tree = Self { triangles, normals, leaves, nodes, root: 0, middle, size };
        tree.root = tree.split(&mut own, 0);
        tree
    }

    /// The point of the surface nearest to a point, m. `hint` is that of a search nearby, or 0.
    pub fn nearest(&self, p: DVec3, hint: u32) -> Nearest {
        let start = nearest_on_triangle(p, &self.triangles[hint as usize]);
        let start_squared = start.0.distance_squared(p);
        let (((point, feature), hint), squared) =
            self.search(p, start_squared).unwrap_or(((start, hint), start_squared));
        let Pseudonormals { index: triangle, face, edges, vertices } = &self.normals[hint as usize];
        let (triangle, normal) = match feature {
            TriangleFeature::Face => (*triangle, face),
            TriangleFeature::Side(edge) => (*triangle, &edges[edge]),
            TriangleFeature::Corner(vertex) => (*triangle, &vertices[vertex]),
        };
        let inside = normal.dot(p - point) < 0.0;
        let distance = squared.sqrt();
        Nearest { point, distance: if inside { -distance } else { distance }, hint, triangle }
    }

    /// Index in the mesh of the triangle nearest to a point, if one is nearer than a distance, m: a search of
    /// a small ball, whatever the mesh's size.
    pub fn nearer(&self, p: DVec3, distance: f64) -> Option<u32> {
        let ((_, hint), _) = self.search(p, distance * distance)?;
        Some(self.normals[hint as usize].index)
    }

    /// The nearest point with its feature and triangle, and its squared distance, if that is less than one,
    /// m².
    fn search(&self, p: DVec3, mut squared: f64) -> Option<(Found, f64)> {
        let mut best = None;
        let at = ((p - self.middle) / self.size).as_vec3();
        let at = [at.x, at.y, at.z].map(f32x4::splat);
        let limit = |squared: f64| {
            let distance = squared.sqrt() / self.size;
            (distance + SEARCH_MARGIN * (distance + 1.0)).powi(2) as f32
        };
        let mut most = limit(squared);
        // Each level leaves three children on the stack.
        let mut stack = ArrayVec::<(u32, f32), { (LANES - 1) * MAX_DEPTH + LANES }>::new();
        stack.push((self.root, 0.0));
        while let Some((index, bound)) = stack.pop() {
            if bound > most {
                continue;
            }
            if index & IS_LEAF != 0 {
                let Leaf { corners, first, last } = &self.leaves[(index & !IS_LEAF) as usize];
                let distances = squared_distances(corners, &at);
                let own = (2 << (last - first)) - 1;
                let mut near = distances.simd_le(f32x4::splat(most)).to_bitmask() & own;
                let distances = distances.to_array();
                // The nearest first, so that the others need not be measured.
                while near != 0 {
                    let lanes = (0..LANES).filter(|lane| near & 1 << lane != 0);
                    let nearest = lanes.min_by(|a, b| distances[*a].total_cmp(&distances[*b]));
                    let Some(lane) = nearest.filter(|lane| distances[*lane] <= most) else { break };
                    near &= !(1 << lane);
                    let triangle = first + lane as u32;
                    let found = nearest_on_triangle(p, &self.triangles[triangle as usize]);
                    let distance = found.0.distance_squared(p);
                    if distance < squared {
                        (best, squared) = (Some((found, triangle)), distance);
                        most = limit(squared);
                    }
                }
                continue;
            }
            let node = &self.nodes[index as usize];
            let bounds = node.squared_distances(&at);
            let near = bounds.simd_le(f32x4::splat(most)).to_bitmask();
            let bounds = bounds.to_array();
            // Sorted insertion, so that the nearest child is popped first.
            let first = stack.len();
            for lane in (0..LANES).filter(|lane| near & 1 << lane != 0 && node.children[*lane] != NONE) {
                let mut place = stack.len();
                stack.push((node.children[lane], bounds[lane]));
                while place > first && stack[place - 1].1 < bounds[lane] {
                    stack.swap(place - 1, place);
                    place -= 1;
                }
            }
        }
        best.map(|best| (best, squared))
    }

    /// Normal of the triangle that a hint is for; 0 for one without an area.
    pub fn normal(&self, hint: u32) -> DVec3 {
        self.normals[hint as usize].face
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        size_of::<Self>()
            + self.triangles.capacity() * size_of::<[DVec3; 3]>()
            + self.normals.capacity() * size_of::<Pseudonormals>()
            + self.leaves.capacity() * size_of::<Leaf>()
            + self.nodes.capacity() * size_of::<Node>()
    }

    /// Builds the subtree of some triangles at a depth, and returns its index.
    fn split(&mut self, own: &mut [Triangle], depth: u32) -> u32 {
        let scaled = |corner: DVec3| ((corner - self.middle) / self.size).as_vec3();
        if own.len() <= LANES {
            let first = self.triangles.len() as u32;
            let four: [&Triangle; LANES] = std::array::from_fn(|lane| &own[lane.min(own.len() - 1)]);
            let corners = four.map(|triangle| triangle.corners.map(scaled));
            let corners = [0, 1, 2].map(|corner| {
                [0, 1, 2].map(|axis| f32x4::new(std::array::from_fn(|lane| corners[lane][corner][axis])))
            });
            self.leaves.push(Leaf { corners, first, last: first + own.len() as u32 - 1 });
            self.triangles.extend(own.iter().map(|triangle| triangle.corners));
            self.normals.extend(own.iter().map(|triangle| triangle.normals));
            return (self.leaves.len() - 1) as u32 | IS_LEAF;
        }
        let (left, right) = divide(own, depth);
        let mut parts = ArrayVec::<&mut [Triangle], LANES>::new();
        for half in [left, right] {
            if half.len() > LANES {
                parts.extend(<[_; 2]>::from(divide(half, depth + 1)));
            } else {
                parts.push(half);
            }
        }
        // The boxes are rounded outwards.
        let around: ArrayVec<_, LANES> = parts
            .iter()
            .map(|own| {
                let Bounds { low, high } = Bounds::of(own);
                (scaled(low) - f32::EPSILON, scaled(high) + f32::EPSILON)
            })
            .collect();
        let lanes = |of: &dyn Fn(&(glam::Vec3, glam::Vec3)) -> f32| {
            f32x4::new(std::array::from_fn(|lane| of(&around[lane.min(around.len() - 1)])))
        };
        let index = self.nodes.len();
        self.nodes.push(Node {
            low: [0, 1, 2].map(|axis| lanes(&|bounds| bounds.0[axis])),
            high: [0, 1, 2].map(|axis| lanes(&|bounds| bounds.1[axis])),
            children: [NONE; LANES],
        });
        for (lane, own) in parts.into_iter().enumerate() {
            self.nodes[index].children[lane] = self.split(own, depth + 2);
        }
        index as u32
    }
}

impl Bounds {
    const NONE: Self = Self { low: DVec3::INFINITY, high: DVec3::NEG_INFINITY };

    fn of(own: &[Triangle]) -> Self {
        own.iter().map(Triangle::bounds).fold(Self::NONE, Self::joined)
    }

    fn joined(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    /// Half of its surface area, m².
    fn area(&self) -> f64 {
        let DVec3 { x, y, z } = self.high - self.low;
        x * y + y * z + z * x
    }
}

impl Triangle {
    fn bounds(&self) -> Bounds {
        let [a, b, c] = self.corners;
        Bounds { low: a.min(b).min(c), high: a.max(b).max(c) }
    }

    /// Middle of its box, twice.
    fn middle(&self) -> DVec3 {
        let Bounds { low, high } = self.bounds();
        low + high
    }
}

/// Divides triangles so that the boxes of both parts, by the leaves in each, have the smallest area (the
/// surface area heuristic in bins: I. Wald, *On fast construction of SAH-based bounding volume hierarchies*,
/// 2007).
fn divide(own: &mut [Triangle], depth: u32) -> (&mut [Triangle], &mut [Triangle]) {
    let middles = || own.iter().map(Triangle::middle);
    let low = middles().fold(DVec3::INFINITY, DVec3::min);
    let extent = middles().fold(DVec3::NEG_INFINITY, DVec3::max) - low;
    let bin = |triangle: &Triangle, axis: usize| {
        let share = (triangle.middle()[axis] - low[axis]) / extent[axis];
        ((BINS as f64 * share) as usize).min(BINS - 1)
    };
    let mut best = (f64::INFINITY, 0, 0);
    for axis in (0..3).filter(|axis| extent[*axis] > 0.0 && depth < HALVED) {
        let mut bins = [(0, Bounds::NONE); BINS];
        for triangle in &*own {
            let (count, bounds) = &mut bins[bin(triangle, axis)];
            (*count, *bounds) = (*count + 1, bounds.joined(triangle.bounds()));
        }
        let join = |all: &mut (usize, Bounds), next: &(usize, Bounds)| {
            *all = (all.0 + next.0, all.1.joined(next.1));
            Some(*all)
        };
        let cost = |(count, bounds): &(usize, Bounds)| bounds.area() * count.div_ceil(LANES) as f64;
        let below: ArrayVec<_, BINS> = bins.iter().scan((0, Bounds::NONE), join).collect();
        let above: ArrayVec<_, BINS> = bins.iter().rev().scan((0, Bounds::NONE), join).collect();
        for next in 1..BINS {
            let (left, right) = (&below[next - 1], &above[BINS - 1 - next]);
            if left.0 > 0 && right.0 > 0 && cost(left) + cost(right) < best.0 {
                best = (cost(left) + cost(right), axis, next);
            }
        }
    }
    let (cost, axis, next) = best;
    if cost < f64::INFINITY {
        let mut count = 0;
        for index in 0..own.len() {
            if bin(&own[index], axis) < next {
                own.swap(count, index);
                count += 1;
            }
        }
        return own.split_at_mut(count);
    }
    let (axis, half) = (extent.max_position(), own.len() / 2);
    own.select_nth_unstable_by(half, |s, t| s.middle()[axis].total_cmp(&t.middle()[axis]));
    own.split_at_mut(half)
}

type Vec3x4 = [f32x4; 3];

fn minus(a: &Vec3x4, b: &Vec3x4) -> Vec3x4 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: &Vec3x4, b: &Vec3x4) -> f32x4 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: &Vec3x4, b: &Vec3x4) -> Vec3x4 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Squared distances of a point from four triangles: from a triangle's plane where the point projects into
/// the triangle, else from its nearest edge.
fn squared_distances(corners: &[Vec3x4; 3], p: &Vec3x4) -> f32x4 {
    let zero = f32x4::ZERO;
    let edges = [0, 1, 2].map(|i| minus(&corners[(i + 1) % 3], &corners[i]));
    let to = [0, 1, 2].map(|i| minus(p, &corners[i]));
    let normal = cross(&edges[0], &edges[1]);
    let tiny = f32x4::splat(f32::MIN_POSITIVE);
    let mut inside = !zero;
    let mut nearest = f32x4::splat(f32::INFINITY);
    for (edge, to) in edges.iter().zip(&to) {
        inside &= dot(&cross(&normal, edge), to).simd_ge(zero);
        let along = (dot(edge, to) / dot(edge, edge).fast_max(tiny)).fast_max(zero).fast_min(f32x4::ONE);
        let off = [to[0] - edge[0] * along, to[1] - edge[1] * along, to[2] - edge[2] * along];
        nearest = nearest.fast_min(dot(&off, &off));
    }
    let above = dot(&normal, &to[0]);
    inside.select(above * above / dot(&normal, &normal).fast_max(tiny), nearest)
}

impl Node {
    fn squared_distances(&self, p: &Vec3x4) -> f32x4 {
        let off = [0, 1, 2]
            .map(|axis| (self.low[axis] - p[axis]).fast_max(p[axis] - self.high[axis]).fast_max(f32x4::ZERO));
        dot(&off, &off)
    }
}

fn with_pseudonormals(mesh: &TriMesh) -> Vec<Triangle> {
    let normal = |corners: [DVec3; 3]| (corners[1] - corners[0]).cross(corners[2] - corners[0]);
    let mut of_vertex = vec![DVec3::ZERO; mesh.vertices().len()];
    let mut of_edge: HashMap<[u32; 2], DVec3> = HashMap::new();
    let edge = |a: u32, b: u32| [a.min(b), a.max(b)];
    // A triangle without an area has no normal, and its points are on its neighbours too.
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
        let of_edge = |i: usize| of_edge.get(&edge(indices[i], indices[(i + 1) % 3])).copied();
        let normals = Pseudonormals {
            index: t as u32,
            face: normal(corners).normalize_or_zero(),
            edges: [0, 1, 2].map(|i| of_edge(i).unwrap_or_default()),
            vertices: indices.map(|v| of_vertex[v as usize]),
        };
        Triangle { corners, normals }
    };
    if solid.is_empty() {
        (0..mesh.triangles().len()).map(of).collect()
    } else {
        solid.into_iter().map(of).collect()
    }
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
                // Half of the points are near the surface.
                let on = mesh.corners(rng.random_range(0..mesh.triangles().len()))[0];
                let point = if round % 2 == 0 {
                    sphere.center + sphere.radius * direction
                } else {
                    on + 0.02 * sphere.radius * direction
                };
                let found = distance.nearest(point, hint);
                hint = found.hint;
                let all = (0..mesh.triangles().len())
                    .map(|t| nearest_on_triangle(point, &mesh.corners(t)).0.distance(point))
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
}
