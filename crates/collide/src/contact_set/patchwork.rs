//! The nearest point of a whole surface to a point, and whether that is inside.
//!
//! Branch and bound over a tree of boxes: over the patches of a level, and below each patch over its triangles. (The
//! hierarchy's own spheres are loose around long patches: going through them takes two to three times as long.) The side is
//! told by the angle-weighted normal at the nearest point (Bærentzen and Aanæs 2005), which is right on vertices and edges
//! too, for a closed surface that does not intersect itself.

use palpate_core::Clod;
use palpate_core::glam::DVec3;

use crate::contact_set::neighbours::Neighbours;
use crate::convex::nearest_on_triangle;
use crate::shape::Shape;
use crate::tolerances::ROUNDING_SLACK;

/// Triangles of a patch that are looked at one by one.
const BUNCH: usize = 6;
/// The root of what has no tree: levels and nodes that are free.
const NO_TREE: u32 = u32::MAX;

/// How the patches of a hierarchy make a surface, on every level that is not free.
///
/// Memory, besides that of the neighbours: 64 bytes for each bunch of some 5 triangles and for each inner box above them;
/// 4 a triangle and a node.
#[derive(Clone, Debug, Default)]
pub(crate) struct Patchwork {
    pub neighbours: Neighbours,
    trees: Vec<Bunch>,
    /// Triangles in the order of the trees, as indices among all of the hierarchy.
    order: Vec<u32>,
    /// Per level, and per node: the root of its tree.
    of_level: Vec<u32>,
    of_node: Vec<u32>,
}

/// A box around triangles. If it is split, its first half is the next one.
#[derive(Clone, Copy, Debug)]
struct Bunch {
    low: DVec3,
    high: DVec3,
    /// Range of [`Patchwork::order`], unless it is split.
    first: u32,
    last: u32,
    /// The second half; 0 if it is not split.
    second: u32,
}

impl Bunch {
    /// Squared distance of a point, m².
    fn distance_squared(&self, point: DVec3) -> f64 {
        point.distance_squared(point.clamp(self.low, self.high))
    }
}

impl Patchwork {
    /// Prepares the surface of a hierarchy.
    pub fn new(clod: &Clod) -> Self {
        let mut surface = Self {
            neighbours: Neighbours::new(clod),
            of_level: vec![NO_TREE; clod.levels.len()],
            of_node: vec![NO_TREE; clod.nodes().len()],
            ..Self::default()
        };
        for (index, level) in clod.levels.iter().enumerate().filter(|(_, level)| !level.free) {
            let mut nodes: Vec<u32> = level.nodes.clone().collect();
            nodes.retain(|node| !clod.node(*node).triangles.is_empty());
            if !nodes.is_empty() {
                surface.of_level[index] = surface.join(clod, &mut nodes);
            }
        }
        surface
    }

    /// Makes a tree over patches; halves by the median of their centres along the longest side.
    fn join(&mut self, clod: &Clod, nodes: &mut [u32]) -> u32 {
        if let [node] = *nodes {
            let first = self.order.len();
            self.order.extend(clod.node(node).triangles);
            self.of_node[node as usize] = self.split(first, self.order.len());
            return self.of_node[node as usize];
        }
        let center = |node: &u32| clod.node(*node).center;
        let axis = longest_axis(nodes.iter().map(center));
        let half = nodes.len() / 2;
        nodes.select_nth_unstable_by(half, |x, y| center(x)[axis].total_cmp(&center(y)[axis]));
        let (first, second) = nodes.split_at_mut(half);
        self.halves(|surface| surface.join(clod, first), |surface| surface.join(clod, second))
    }

    /// Makes a tree over a range of the order, of triangles of one patch.
    fn split(&mut self, first: usize, last: usize) -> u32 {
        let triangles = &mut self.order[first..last];
        if triangles.len() <= BUNCH {
            let neighbours = &self.neighbours;
            let points = || triangles.iter().flat_map(|t| neighbours.corners(*t));
            let (low, high) =
                (points().fold(DVec3::INFINITY, DVec3::min), points().fold(DVec3::NEG_INFINITY, DVec3::max));
            let (first, last) = (first as u32, last as u32);
            self.trees.push(Bunch { low, high, first, last, second: 0 });
            return self.trees.len() as u32 - 1;
        }
        let middle = |t: &u32| self.neighbours.corners(*t).iter().sum::<DVec3>() / 3.0;
        let axis = longest_axis(triangles.iter().map(middle));
        let half = (last - first) / 2;
        triangles.select_nth_unstable_by(half, |s, t| middle(s)[axis].total_cmp(&middle(t)[axis]));
        self.halves(|surface| surface.split(first, first + half), |surface| surface.split(first + half, last))
    }

    fn halves(&mut self, first: impl FnOnce(&mut Self) -> u32, second: impl FnOnce(&mut Self) -> u32) -> u32 {
        let index = self.trees.len();
        let (low, high) = (DVec3::ZERO, DVec3::ZERO);
        self.trees.push(Bunch { low, high, first: 0, last: 0, second: 0 });
        let first = first(self);
        let second = second(self);
        let [x, y] = [first, second].map(|half| self.trees[half as usize]);
        self.trees[index] =
            Bunch { low: x.low.min(y.low), high: x.high.max(y.high), second, ..self.trees[index] };
        index as u32
    }

    /// Calls `each` with the triangles of a node's patch whose boxes reach into a sphere, in the shape's frame.
    pub fn in_reach(&self, node: u32, center: DVec3, radius: f64, each: &mut impl FnMut(u32)) {
        let root = self.of_node[node as usize];
        if root != NO_TREE {
            self.bunch_in_reach(root, (center, radius * radius * (1.0 + ROUNDING_SLACK)), each);
        }
    }

    fn bunch_in_reach(
        &self,
        bunch: u32,
        sphere @ (center, squared): (DVec3, f64),
        each: &mut impl FnMut(u32),
    ) {
        let found = &self.trees[bunch as usize];
        if found.distance_squared(center) > squared {
            return;
        }
        if found.second != 0 {
            self.bunch_in_reach(bunch + 1, sphere, each);
            self.bunch_in_reach(found.second, sphere, each);
            return;
        }
        for &triangle in &self.order[found.first as usize..found.last as usize] {
            let [p, q, r] = self.neighbours.corners(triangle);
            let nearest = center.clamp(p.min(q).min(r), p.max(q).max(r));
            if nearest.distance_squared(center) <= squared {
                each(triangle);
            }
        }
    }

    /// The box around a node's patch: its lowest and its highest corner, m; empty if it has none.
    pub fn box_of(&self, node: u32) -> [DVec3; 2] {
        let root = self.trees.get(self.of_node[node as usize] as usize);
        root.map_or([DVec3::INFINITY, DVec3::NEG_INFINITY], |root| [root.low, root.high])
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        let Self { neighbours, trees, order, of_level, of_node } = self;
        neighbours.bytes()
            + size_of_val(&**trees)
            + size_of_val(&**order)
            + size_of_val(&**of_level)
            + size_of_val(&**of_node)
    }
}

fn longest_axis(points: impl Iterator<Item = DVec3>) -> usize {
    let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let (low, high) = points.fold(start, |(low, high), p| (low.min(p), high.max(p)));
    (high - low).max_position()
}

/// The point of a surface that is nearest to another.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NearestPoint {
    /// m.
    pub distance: f64,
    /// In the surface's frame, m.
    pub point: DVec3,
    /// Weights of the triangle's corners; some are 0 on its border.
    weights: [f64; 3],
    /// Index among all triangles of the hierarchy.
    pub triangle: u32,
    /// Node whose patch that belongs to.
    pub node: u32,
}

/// The workspace of searches.
#[derive(Clone, Debug, Default)]
pub(crate) struct NearestSearch {
    /// Boxes that wait, with the point's squared distance from them.
    stack: Vec<(f64, u32)>,
}

/// The best so far: squared distance, and where.
struct Best {
    point: DVec3,
    squared: f64,
    found: Option<([f64; 3], u32)>,
}

impl Best {
    fn offer(&mut self, neighbours: &Neighbours, triangle: u32) {
        let [p, q, r] = neighbours.corners(triangle);
        let (low, high) = (p.min(q).min(r), p.max(q).max(r));
        if self.point.distance_squared(self.point.clamp(low, high)) * (1.0 - ROUNDING_SLACK) >= self.squared {
            return;
        }
        let (p, q, r) = (p - self.point, q - self.point, r - self.point);
        let weights = nearest_on_triangle(p, q, r);
        let squared = (weights[0] * p + weights[1] * q + weights[2] * r).length_squared();
        if squared < self.squared {
            self.squared = squared;
            self.found = Some((weights, triangle));
        }
    }
}

impl NearestSearch {
    pub fn capacity(&self) -> usize {
        self.stack.capacity()
    }

    /// The nearest point, on the surface of a level, to a point in the shape's frame. `hint`: a triangle of that level
    /// that may be near.
    pub fn on_level(&mut self, shape: &Shape, level: u32, point: DVec3, hint: u32) -> Option<NearestPoint> {
        let mut best = Best { point, squared: f64::INFINITY, found: None };
        best.offer(&shape.patchwork().neighbours, hint);
        self.descend(shape, shape.patchwork().of_level[level as usize], best)
    }

    /// The nearest point of one patch, if it is nearer than `limit`.
    pub fn on_patch(&mut self, shape: &Shape, node: u32, point: DVec3, limit: f64) -> Option<NearestPoint> {
        let best = Best { point, squared: limit * limit, found: None };
        self.descend(shape, shape.patchwork().of_node[node as usize], best)
    }

    fn descend(&mut self, shape: &Shape, root: u32, mut best: Best) -> Option<NearestPoint> {
        let surface = shape.patchwork();
        self.stack.clear();
        if root != NO_TREE {
            self.stack.push((0.0, root));
        }
        while let Some((bound, index)) = self.stack.pop() {
            if bound >= best.squared {
                continue;
            }
            let Bunch { first, last, second, .. } = surface.trees[index as usize];
            if second == 0 {
                let order = &surface.order[first as usize..last as usize];
                order.iter().for_each(|triangle| best.offer(&surface.neighbours, *triangle));
                continue;
            }
            // A little less than it is, for rounding.
            let bound = |half: u32| {
                surface.trees[half as usize].distance_squared(best.point) * (1.0 - ROUNDING_SLACK)
            };
            let (x, y) = ((bound(index + 1), index + 1), (bound(second), second));
            // The nearer one is looked at first.
            for half in if x.0 < y.0 { [y, x] } else { [x, y] } {
                if half.0 < best.squared {
                    self.stack.push(half);
                }
            }
        }
        let (weights, triangle) = best.found?;
        let node = surface.neighbours.owner(triangle);
        let [p, q, r] = surface.neighbours.corners(triangle).map(|corner| corner - best.point);
        let offset = weights[0] * p + weights[1] * q + weights[2] * r;
        let (distance, point) = (offset.length(), best.point + offset);
        Some(NearestPoint { distance, point, weights, triangle, node })
    }
}

impl NearestPoint {
    /// Unit outward normal of the surface, if the point is in the middle of a triangle.
    pub fn face_normal(&self, shape: &Shape) -> Option<DVec3> {
        let [p, q, r] = shape.patchwork().neighbours.corners(self.triangle);
        self.weights.iter().all(|weight| *weight > 0.0).then(|| (q - p).cross(r - p).normalize())
    }

    /// The mesh vertex at the corner of the triangle that counts most: one that all triangles at the point have.
    pub fn nearest_vertex(&self, shape: &Shape) -> u32 {
        let ends = shape.patchwork().neighbours.ends(self.triangle);
        let [u, v, w] = self.weights;
        if u >= v && u >= w {
            ends[0]
        } else if v >= w {
            ends[1]
        } else {
            ends[2]
        }
    }

    /// Outward normal of the surface at the point, not of unit length: the sum over the triangles that meet there,
    /// weighted by their angles.
    pub fn normal(&self, shape: &Shape) -> DVec3 {
        let neighbours = &shape.patchwork().neighbours;
        let ends = neighbours.ends(self.triangle);
        let normal = |triangle: u32| {
            let [p, q, r] = neighbours.corners(triangle);
            (q - p).cross(r - p).normalize_or_zero()
        };
        let mut carriers = (0..3).filter(|i| self.weights[*i] > 0.0);
        match [carriers.next(), carriers.next(), carriers.next()] {
            [Some(i), Some(j), None] => {
                let both = neighbours.around(ends[i]).iter();
                let both = both.filter(|t| neighbours.ends(**t).contains(&ends[j]));
                both.map(|t| normal(*t)).sum()
            }
            [Some(i), None, None] => {
                let around = neighbours.around(ends[i]).iter();
                around.map(|t| angle_at(shape, ends[i], *t) * normal(*t)).sum()
            }
            _ => normal(self.triangle),
        }
    }
}

/// The angle of a triangle at one of its mesh vertices, rad.
fn angle_at(shape: &Shape, vertex: u32, triangle: u32) -> f64 {
    let neighbours = &shape.patchwork().neighbours;
    let at = neighbours.ends(triangle).iter().position(|v| *v == vertex).unwrap_or(0);
    let corners = neighbours.corners(triangle);
    let (u, v) = (corners[(at + 1) % 3] - corners[at], corners[(at + 2) % 3] - corners[at]);
    u.cross(v).length().atan2(u.dot(v))
}
