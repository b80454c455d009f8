//! A tree of boxes around a mesh's triangles (S. Gottschalk, M. C. Lin and D. Manocha, *OBBTree*, 1996), and
//! lower bounds on the distance between two surfaces from the triangles themselves (E. Larsen et al., *Fast
//! distance queries with rectangular swept sphere volumes*, 2000).
//!
//! Boxes contain their triangles, and the bounds are those of boxes and of triangles, so that they hold for
//! any shape: samples would miss what is thinner than their spacing. In place of swept spheres there are
//! boxes, whose faces bound flat parts as closely. The search goes on where the bound is least, so that it
//! may end at any time with the best bound so far.

use arrayvec::ArrayVec;
use glam::{DMat3, DVec3, Mat3, Vec3};
use palpate_core::{Pose, TriMesh};

use crate::exact::closest;
use crate::format::{FormatError, Reader, Writer};

/// Largest number of leaves. A mesh with more triangles has leaves of several, of which only the box is kept:
/// memory and time to build stay bounded.
const MAX_LEAVES: usize = 32_768;

/// Flag of a leaf in the link of a node; the rest is the index of its triangle, or [`NO_TRIANGLE`].
const IS_LEAF: u32 = 1 << 31;
/// A leaf whose triangles are not kept.
const NO_TRIANGLE: u32 = IS_LEAF - 1;

/// Rounding of positions in single precision and of boxes, as a fraction of the surface's size.
const ROUNDING: f64 = 1e-6;

/// Fraction of the distance found that is enough as a bound on it. With more, a search takes longer; with
/// less, bodies wait that are apart.
const ENOUGH_SHARE: f64 = 0.95;

/// Largest number of pairs of boxes that are taken apart. With more, a search in a close fit takes as long as
/// a query of contacts.
const MAX_PAIRS: usize = 2048;

/// Largest number of pairs that wait.
const MAX_WAITING: usize = 1024;

/// A surface as a tree of boxes.
#[derive(Clone, Debug)]
pub struct SurfaceTree {
    /// Centre of the surface in the mesh's frame, m: all positions are about it, in single precision.
    center: DVec3,
    /// Nodes, the root first; the children of a node are neighbours.
    nodes: Vec<Node>,
    triangles: Vec<[Vec3; 3]>,
    /// A vertex of each connected part of the surface.
    parts: Vec<Vec3>,
}

/// A box, in any direction.
#[derive(Clone, Copy, Debug)]
struct Node {
    center: Vec3,
    axes: [Vec3; 3],
    /// Half of its edges, m.
    half: Vec3,
    /// Index of the first of two children, or a leaf.
    link: u32,
}

impl Node {
    fn is_leaf(&self) -> bool {
        self.link & IS_LEAF != 0
    }

    fn triangle(&self) -> Option<usize> {
        let index = self.link & !IS_LEAF;
        (self.is_leaf() && index != NO_TRIANGLE).then_some(index as usize)
    }

    /// Radius of the sphere around it, m.
    fn radius(&self) -> f64 {
        self.half.as_dvec3().length()
    }
}

/// What a part of a surface is in: a node, or a piece of a triangle.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Piece {
    Node(u32),
    Triangle([DVec3; 3]),
}

/// Two nodes of two trees that wait for being taken apart.
#[derive(Clone, Copy, Debug)]
struct Pair {
    /// Lower bound on their distance, m.
    bound: f64,
    /// Sum of their radii, m.
    size: f64,
    nodes: [u32; 2],
}

impl Pair {
    /// Whether it is taken apart before another one. Of those that overlap the smaller one is: so a search
    /// soon comes to triangles.
    fn is_before(&self, other: &Self) -> bool {
        self.bound < other.bound || self.bound == other.bound && self.size < other.size
    }
}

/// Pairs as a binary heap: the first is before all others. It stands on the stack, so that a search does not
/// allocate.
struct Waiting(ArrayVec<Pair, MAX_WAITING>);

impl Waiting {
    /// Adds a pair; `false` if there is no room.
    fn push(&mut self, pair: Pair) -> bool {
        let mut at = self.0.len();
        if self.0.try_push(pair).is_err() {
            return false;
        }
        while at > 0 && self.0[at].is_before(&self.0[(at - 1) / 2]) {
            self.0.swap(at, (at - 1) / 2);
            at = (at - 1) / 2;
        }
        true
    }

    fn pop(&mut self) -> Option<Pair> {
        if self.0.is_empty() {
            return None;
        }
        let first = self.0.swap_remove(0);
        let mut at = 0;
        loop {
            let children = [2 * at + 1, 2 * at + 2].into_iter().filter(|child| *child < self.0.len());
            let least = children.reduce(|a, b| if self.0[b].is_before(&self.0[a]) { b } else { a });
            let Some(least) = least.filter(|least| self.0[*least].is_before(&self.0[at])) else {
                return Some(first);
            };
            self.0.swap(at, least);
            at = least;
        }
    }
}

/// A relative place of two surfaces, about their centres.
struct Placed {
    turn: DMat3,
    shift: DVec3,
}

impl Placed {
    fn point(&self, point: Vec3) -> DVec3 {
        self.turn * point.as_dvec3() + self.shift
    }

    /// Lower bound on the distance between a box and another one, m: between each and the box around the
    /// other along its axes, and between the spheres around them.
    fn apart(&self, own: &Node, other: &Node) -> f64 {
        let between = self.point(own.center) - other.center.as_dvec3();
        let (own_half, other_half) = (own.half.as_dvec3(), other.half.as_dvec3());
        let own_axes = own.axes.map(|axis| self.turn * axis.as_dvec3());
        let other_axes = other.axes.map(Vec3::as_dvec3);
        // Rows: the own axes along the other ones, without signs.
        let along = own_axes.map(|own| DVec3::from_array(other_axes.map(|axis| axis.dot(own).abs())));
        let off = |axes: &[DVec3; 3]| DVec3::from_array(axes.map(|axis| axis.dot(between).abs()));
        let own_reach = along[0] * own_half.x + along[1] * own_half.y + along[2] * own_half.z;
        let other_reach = DVec3::from_array(along.map(|row| row.dot(other_half)));
        let of_other = (off(&other_axes) - other_half - own_reach).max(DVec3::ZERO).length_squared();
        let of_own = (off(&own_axes) - own_half - other_reach).max(DVec3::ZERO).length_squared();
        let of_spheres = between.length() - own.radius() - other.radius();
        of_other.max(of_own).sqrt().max(of_spheres)
    }
}

impl SurfaceTree {
    /// Makes the tree of a mesh's surface.
    ///
    /// # Panics
    /// If the mesh has no triangles.
    pub fn new(mesh: &TriMesh) -> Self {
        let count = mesh.triangles().len();
        assert!(count > 0, "a mesh without triangles has no surface");
        let center = mesh.bounding_sphere().center;
        let place = |corner: DVec3| (corner - center).as_vec3();
        let mut corners: Vec<[Vec3; 3]> = (0..count).map(|t| mesh.corners(t).map(place)).collect();
        let leaf = count.div_ceil(MAX_LEAVES);
        let parts = connected(mesh).into_iter().map(|vertex| place(mesh.vertices()[vertex as usize]));
        let mut tree = Self { center, nodes: Vec::new(), triangles: Vec::new(), parts: parts.collect() };
        tree.nodes.push(around(&corners));
        tree.split(0, &mut corners, leaf);
        tree
    }

    /// Divides a node whose triangles are given until leaves have at most `leaf` of them.
    fn split(&mut self, node: usize, own: &mut [[Vec3; 3]], leaf: usize) {
        if own.len() <= leaf {
            self.nodes[node].link = IS_LEAF
                | if let [triangle] = own {
                    self.triangles.push(*triangle);
                    self.triangles.len() as u32 - 1
                } else {
                    NO_TRIANGLE
                };
            return;
        }
        let Node { axes, half, .. } = self.nodes[node];
        let axis = axes[half.max_position()];
        let key = |[a, b, c]: &[Vec3; 3]| axis.dot(*a + *b + *c);
        let middle = own.len() / 2;
        own.select_nth_unstable_by(middle, |s, t| key(s).total_cmp(&key(t)));
        let (low, high) = own.split_at_mut(middle);
        let first = self.nodes.len();
        self.nodes[node].link = first as u32;
        self.nodes.extend([around(low), around(high)]);
        self.split(first, low, leaf);
        self.split(first + 1, high, leaf);
    }

    /// Radius of the surface, m: of the sphere around the root.
    fn radius(&self) -> f64 {
        f64::from(self.nodes[0].center.length()) + self.nodes[0].radius()
    }

    /// Largest rounding of a position, m.
    fn rounding(&self) -> f64 {
        ROUNDING * self.radius()
    }

    fn placed(&self, other: &Self, to_other: &Pose) -> Placed {
        let shift = to_other.transform_point(self.center) - other.center;
        Placed { turn: DMat3::from_quat(to_other.rotation), shift }
    }

    /// A lower bound on the distance between this surface and another one at a relative pose (m): at most
    /// `enough` (m), and 0 if they may touch. It is `enough` or at least 0.95 of the distance, but
    ///
    /// - where the distance is less than `least` (m),
    /// - where surfaces lie along each other so closely that it would take too long,
    /// - where a mesh of more than 32,768 triangles is curved: boxes around several are not as close to them.
    ///
    /// A surface inside another one is as far from it as one outside of it.
    pub fn clearance(&self, other: &Self, to_other: &Pose, (least, enough): (f64, f64)) -> f64 {
        let placed = self.placed(other, to_other);
        let rounding = self.rounding() + other.rounding();
        let pair = |a: u32, b: u32| {
            let (own, of_other) = (&self.nodes[a as usize], &other.nodes[b as usize]);
            Pair { bound: placed.apart(own, of_other), size: own.radius() + of_other.radius(), nodes: [a, b] }
        };
        let mut waiting = Waiting(ArrayVec::new());
        waiting.push(pair(0, 0));
        // The distance between two points found so far, and the least bound of pairs that stay together.
        let mut found = enough / ENOUGH_SHARE + rounding;
        let (mut bound, least) = (found, least.min(enough));
        let mut count = 0;
        while let Some(next) = waiting.pop() {
            count += 1;
            let known = found.min(bound);
            if next.bound >= ENOUGH_SHARE * known || known < least || count > MAX_PAIRS {
                // All others have larger bounds.
                bound = bound.min(next.bound);
                break;
            }
            let [a, b] = next.nodes;
            let (own, of_other) = (&self.nodes[a as usize], &other.nodes[b as usize]);
            if own.is_leaf() && of_other.is_leaf() {
                if let (Some(t), Some(u)) = (own.triangle(), of_other.triangle()) {
                    let corners = self.triangles[t].map(|corner| placed.point(corner));
                    found = found.min(apart(&corners, &other.triangles[u].map(Vec3::as_dvec3)));
                } else {
                    bound = bound.min(next.bound);
                }
                continue;
            }
            let is_own = of_other.is_leaf() || !own.is_leaf() && own.radius() >= of_other.radius();
            let children = if is_own {
                [pair(own.link, b), pair(own.link + 1, b)]
            } else {
                [pair(a, of_other.link), pair(a, of_other.link + 1)]
            };
            for child in children {
                if child.bound < found.min(bound) && !waiting.push(child) {
                    bound = bound.min(child.bound);
                }
            }
        }
        (found.min(bound) - rounding).clamp(0.0, enough.max(0.0))
    }

    /// A point of each connected part of the surface, in the mesh's frame, m.
    pub fn parts(&self) -> impl Iterator<Item = DVec3> {
        self.parts.iter().map(|point| self.center + point.as_dvec3())
    }

    /// Whether the box of one surface may reach into that of another one at a relative pose.
    pub(crate) fn may_contain(&self, other: &Self, to_other: &Pose) -> bool {
        self.placed(other, to_other).apart(&self.nodes[0], &other.nodes[0])
            <= self.rounding() + other.rounding()
    }

    /// The whole surface.
    pub(crate) fn whole(&self) -> Piece {
        Piece::Node(0)
    }

    /// The sphere around a piece: its centre in the mesh's frame and its radius, m.
    pub(crate) fn sphere(&self, piece: &Piece) -> (DVec3, f64) {
        let (center, radius) = match piece {
            Piece::Node(node) => {
                let node = &self.nodes[*node as usize];
                (node.center.as_dvec3(), node.radius())
            }
            Piece::Triangle(corners) => smallest_sphere(corners),
        };
        (self.center + center, radius + self.rounding())
    }

    /// The two halves of a piece; `None` for a leaf whose triangles are not kept.
    pub(crate) fn halves(&self, piece: &Piece) -> Option<[Piece; 2]> {
        let [a, b, c] = match piece {
            Piece::Node(node) => {
                let node = &self.nodes[*node as usize];
                if !node.is_leaf() {
                    return Some([Piece::Node(node.link), Piece::Node(node.link + 1)]);
                }
                self.triangles[node.triangle()?].map(Vec3::as_dvec3)
            }
            Piece::Triangle(corners) => *corners,
        };
        let [ab, bc, ca] = [a.distance_squared(b), b.distance_squared(c), c.distance_squared(a)];
        let [p, q, r] = if ab >= bc && ab >= ca {
            [a, b, c]
        } else if bc >= ca {
            [b, c, a]
        } else {
            [c, a, b]
        };
        let middle = p.midpoint(q);
        Some([Piece::Triangle([p, middle, r]), Piece::Triangle([middle, q, r])])
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        self.nodes.capacity() * size_of::<Node>()
            + self.triangles.capacity() * size_of::<[Vec3; 3]>()
            + self.parts.capacity() * size_of::<Vec3>()
    }

    pub(crate) fn write(&self, to: &mut Writer) {
        to.vec(self.center);
        to.u32([self.nodes.len() as u32, self.triangles.len() as u32, self.parts.len() as u32]);
        for node in &self.nodes {
            let [x, y, z] = node.axes;
            to.f32([node.center, x, y, z, node.half].into_iter().flat_map(|vector| vector.to_array()));
            to.u32([node.link]);
        }
        let points = self.triangles.iter().flatten().chain(&self.parts);
        to.f32(points.flat_map(|point| point.to_array()));
    }

    pub(crate) fn read_from(from: &mut Reader) -> Result<Self, FormatError> {
        const FLOATS: usize = 15;
        let center = from.vec()?;
        let [nodes, triangles, parts] = [from.u32()?, from.u32()?, from.u32()?];
        let vectors = |numbers: Vec<f32>| -> Vec<Vec3> {
            numbers.as_chunks::<3>().0.iter().map(|vector| Vec3::from_array(*vector)).collect()
        };
        let mut all = Vec::new();
        for index in 0..nodes {
            let [center, x, y, z, half] =
                vectors(from.f32s(FLOATS)?).try_into().map_err(|_| FormatError::Damaged)?;
            let node = Node { center, axes: [x, y, z], half, link: from.u32()? };
            // A node's children come after it, so that there are no cycles.
            let fits = match node.triangle() {
                Some(triangle) => triangle < triangles as usize,
                None => node.is_leaf() || (node.link > index && node.link < nodes - 1),
            };
            if !fits {
                return Err(FormatError::Damaged);
            }
            all.push(node);
        }
        let corners = vectors(from.f32s((triangles as usize).checked_mul(9).ok_or(FormatError::Damaged)?)?);
        let parts = vectors(from.f32s((parts as usize).checked_mul(3).ok_or(FormatError::Damaged)?)?);
        if all.is_empty() {
            return Err(FormatError::Damaged);
        }
        Ok(Self { center, nodes: all, triangles: corners.as_chunks().0.to_vec(), parts })
    }
}

/// The smallest of two boxes around triangles: along the mean normal, or along the axes.
fn around(own: &[[Vec3; 3]]) -> Node {
    let corners = || own.iter().flatten().map(|corner| corner.as_dvec3());
    let normal: DVec3 = own
        .iter()
        .map(|triangle| {
            let [a, b, c] = triangle.map(Vec3::as_dvec3);
            (b - a).cross(c - a)
        })
        .sum();
    let straight = boxed(corners, DMat3::IDENTITY);
    let Some(normal) = normal.try_normalize() else { return straight };
    // In the plane across the normal, the axes of the largest and the smallest spread.
    let (u, v) = normal.any_orthonormal_pair();
    let mean = corners().sum::<DVec3>() / (3 * own.len()) as f64;
    let (mut uu, mut uv, mut vv) = (0.0, 0.0, 0.0);
    for corner in corners() {
        let (x, y) = ((corner - mean).dot(u), (corner - mean).dot(v));
        (uu, uv, vv) = (uu + x * x, uv + x * y, vv + y * y);
    }
    let (sine, cosine) = (0.5 * (2.0 * uv).atan2(uu - vv)).sin_cos();
    let turned = boxed(corners, DMat3::from_cols(u * cosine + v * sine, v * cosine - u * sine, normal));
    let size = |node: &Node| {
        let half = node.half;
        half.x * half.y + half.y * half.z + half.z * half.x
    };
    if size(&turned) < size(&straight) { turned } else { straight }
}

/// The box around points along axes.
fn boxed<I: Iterator<Item = DVec3>>(points: impl Fn() -> I, axes: DMat3) -> Node {
    // What is kept is in single precision, and the box is around the points as seen from there.
    let kept = Mat3::from_cols_array(&axes.to_cols_array().map(|x| x as f32));
    let axes = [kept.x_axis, kept.y_axis, kept.z_axis].map(Vec3::as_dvec3);
    let along = |point: DVec3| DVec3::from_array(axes.map(|axis| axis.dot(point)));
    let low = points().map(along).fold(DVec3::INFINITY, DVec3::min);
    let high = points().map(along).fold(DVec3::NEG_INFINITY, DVec3::max);
    let middle = low.midpoint(high);
    let center = (axes[0] * middle.x + axes[1] * middle.y + axes[2] * middle.z).as_vec3();
    let from = along(center.as_dvec3());
    let half = (high - from).max(from - low);
    Node {
        center,
        axes: [kept.x_axis, kept.y_axis, kept.z_axis],
        half: half.as_vec3(),
        link: IS_LEAF | NO_TRIANGLE,
    }
}

/// The vertex that stands for the part of a vertex.
fn root(of: &mut [u32], mut vertex: u32) -> u32 {
    while of[vertex as usize] != vertex {
        // Halves the path.
        of[vertex as usize] = of[of[vertex as usize] as usize];
        vertex = of[vertex as usize];
    }
    vertex
}

/// A vertex of each connected part of a mesh.
fn connected(mesh: &TriMesh) -> Vec<u32> {
    // Each vertex belongs to the part of the one it refers to.
    let mut of: Vec<u32> = (0..mesh.vertices().len() as u32).collect();
    for &[a, b, c] in mesh.triangles() {
        let first = root(&mut of, a);
        for other in [b, c] {
            let other = root(&mut of, other);
            of[other as usize] = first;
        }
    }
    let mut used = vec![false; of.len()];
    mesh.triangles().iter().flatten().for_each(|vertex| used[*vertex as usize] = true);
    (0..of.len() as u32).filter(|vertex| used[*vertex as usize] && of[*vertex as usize] == *vertex).collect()
}

/// Centre and radius of the smallest sphere around a triangle.
fn smallest_sphere(&[a, b, c]: &[DVec3; 3]) -> (DVec3, f64) {
    for [p, q, r] in [[a, b, c], [b, c, a], [c, a, b]] {
        // At a blunt or right corner the opposite edge is the diameter.
        if (p - r).dot(q - r) <= 0.0 {
            return (p.midpoint(q), 0.5 * p.distance(q));
        }
    }
    let (ab, ac) = (b - a, c - a);
    let normal = ab.cross(ac);
    let to = (normal.cross(ab) * ac.length_squared() + ac.cross(normal) * ab.length_squared())
        / (2.0 * normal.length_squared());
    if to.is_finite() { (a + to, to.length()) } else { (a, ab.length().max(ac.length())) }
}

/// Distance between two triangles, 0 if they intersect, m.
fn apart(own: &[DVec3; 3], other: &[DVec3; 3]) -> f64 {
    let edges = |[a, b, c]: &[DVec3; 3]| [[*a, *b], [*b, *c], [*c, *a]];
    // Triangles that intersect without touching edges have an edge of one that goes through the other.
    let through = |edges: [[DVec3; 2]; 3], triangle: &[DVec3; 3]| {
        edges.into_iter().any(|edge| goes_through(edge, triangle))
    };
    if through(edges(own), other) || through(edges(other), own) {
        return 0.0;
    }
    let mut least = f64::INFINITY;
    for [p, q] in edges(own) {
        for [r, s] in edges(other) {
            least = least.min(between_segments([p, q], [r, s]));
        }
    }
    for corner in own {
        least = least.min(closest(*corner, other).0.distance_squared(*corner));
    }
    for corner in other {
        least = least.min(closest(*corner, own).0.distance_squared(*corner));
    }
    least.sqrt()
}

/// Whether a segment goes from one side of a triangle to the other, inside its edges.
fn goes_through([p, q]: [DVec3; 2], &[a, b, c]: &[DVec3; 3]) -> bool {
    let volume = |a: DVec3, b: DVec3, c: DVec3, d: DVec3| (b - a).cross(c - a).dot(d - a);
    let (above, below) = (volume(a, b, c, p), volume(a, b, c, q));
    if above * below > 0.0 || above == below {
        return false;
    }
    let sides = [volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)];
    sides.iter().all(|side| *side >= 0.0) || sides.iter().all(|side| *side <= 0.0)
}

/// Squared distance between two segments (Ericson 2005, §5.1.9), m².
fn between_segments([p, q]: [DVec3; 2], [r, s]: [DVec3; 2]) -> f64 {
    let (u, v, w) = (q - p, s - r, p - r);
    let (uu, vv, uv, uw, vw) = (u.dot(u), v.dot(v), u.dot(v), u.dot(w), v.dot(w));
    let across = uu * vv - uv * uv;
    let share = |part: f64, whole: f64| if whole > 0.0 { (part / whole).clamp(0.0, 1.0) } else { 0.0 };
    let mut on_own = share(uv * vw - uw * vv, across);
    let on_other = if vv > 0.0 { (uv * on_own + vw) / vv } else { 0.0 };
    if !(0.0..=1.0).contains(&on_other) {
        on_own = share(uv * on_other.clamp(0.0, 1.0) - uw, uu);
    }
    (w + u * on_own - v * on_other.clamp(0.0, 1.0)).length_squared()
}

#[cfg(test)]
mod tests;
