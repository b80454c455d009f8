//! The nearest point of a surface to a point, and its outward normal, by branch and bound over the trees.
//!
//! The side of the surface that a point is on follows from the angle-weighted normal at the nearest point
//! (Bærentzen and Aanæs 2005), which is correct at vertices and edges too, for a closed surface that does not
//! intersect itself.

use palpate_core::glam::DVec3;

use super::neighbours::Neighbours;
use super::trees::{Bunch, NO_TREE, Patchwork};
use crate::convex::nearest_on_triangle;
use crate::tolerances::ROUNDING_SLACK;

/// The point of a surface that is nearest to another point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NearestPoint {
    /// Distance between the two, m.
    pub distance: f64,
    /// The point, in the surface's frame, m.
    pub point: DVec3,
    /// Barycentric weights of the triangle's corners; some are 0 on its border.
    weights: [f64; 3],
    /// Index of the triangle among all of the hierarchy.
    pub triangle: u32,
    /// Node whose patch the triangle belongs to.
    pub node: u32,
}

/// The workspace of searches.
#[derive(Clone, Debug, Default)]
pub(crate) struct NearestSearch {
    /// Waiting boxes, with their squared distance from the point.
    stack: Vec<(f64, u32)>,
}

/// The nearest point so far: squared distance, barycentric weights and triangle.
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

    /// Finds the point of a level's surface nearest to a point in the shape's frame. `hint`: a triangle of
    /// that level that may be near.
    pub fn on_level(
        &mut self,
        surface: &Patchwork,
        level: u32,
        point: DVec3,
        hint: u32,
    ) -> Option<NearestPoint> {
        let mut best = Best { point, squared: f64::INFINITY, found: None };
        best.offer(&surface.neighbours, hint);
        self.descend(surface, surface.of_level[level as usize], best, |_| true)
    }

    /// Finds the point nearest to a point on those triangles of level 0 that fulfil a condition. `hint`: one
    /// of them that may be near.
    pub fn among(
        &mut self,
        surface: &Patchwork,
        point: DVec3,
        hint: Option<u32>,
        condition: impl Fn(u32) -> bool,
    ) -> Option<NearestPoint> {
        let mut best = Best { point, squared: f64::INFINITY, found: None };
        hint.into_iter().for_each(|hint| best.offer(&surface.neighbours, hint));
        self.descend(surface, surface.of_level[0], best, condition)
    }

    /// Finds the nearest point of one patch, if it is nearer than `limit`.
    pub fn on_patch(
        &mut self,
        surface: &Patchwork,
        node: u32,
        point: DVec3,
        limit: f64,
    ) -> Option<NearestPoint> {
        let best = Best { point, squared: limit * limit, found: None };
        self.descend(surface, surface.of_node[node as usize], best, |_| true)
    }

    #[inline]
    fn descend(
        &mut self,
        surface: &Patchwork,
        root: u32,
        mut best: Best,
        condition: impl Fn(u32) -> bool,
    ) -> Option<NearestPoint> {
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
                for &triangle in order.iter().filter(|triangle| condition(**triangle)) {
                    best.offer(&surface.neighbours, triangle);
                }
                continue;
            }
            // Lower bound, reduced by rounding.
            let bound = |half: u32| {
                surface.trees[half as usize].distance_squared(best.point) * (1.0 - ROUNDING_SLACK)
            };
            let (x, y) = ((bound(index + 1), index + 1), (bound(second), second));
            // The nearer half is popped first.
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
    /// Unit outward normal of the surface, if the point is in the interior of a triangle.
    pub fn face_normal(&self, surface: &Patchwork) -> Option<DVec3> {
        let [p, q, r] = surface.neighbours.corners(self.triangle);
        self.weights.iter().all(|weight| *weight > 0.0).then(|| (q - p).cross(r - p).normalize())
    }

    /// The mesh vertex at the corner with the largest weight, which all triangles at the point have.
    pub fn nearest_vertex(&self, surface: &Patchwork) -> u32 {
        let ends = surface.neighbours.ends(self.triangle);
        let [u, v, w] = self.weights;
        if u >= v && u >= w {
            ends[0]
        } else if v >= w {
            ends[1]
        } else {
            ends[2]
        }
    }

    /// Whether a point is behind the surface, to which this is the nearest point.
    pub fn is_behind(&self, surface: &Patchwork, point: DVec3) -> bool {
        self.normal(surface).dot(point - self.point) < 0.0
    }

    /// Outward normal of the surface at the point, not of unit length: the sum over the triangles that meet
    /// there, weighted by their angles.
    fn normal(&self, surface: &Patchwork) -> DVec3 {
        let neighbours = &surface.neighbours;
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
                around.map(|t| angle_at(surface, ends[i], *t) * normal(*t)).sum()
            }
            _ => normal(self.triangle),
        }
    }
}

/// The angle of a triangle at one of its mesh vertices, rad.
fn angle_at(surface: &Patchwork, vertex: u32, triangle: u32) -> f64 {
    let neighbours = &surface.neighbours;
    let at = neighbours.ends(triangle).iter().position(|v| *v == vertex).unwrap_or(0);
    let corners = neighbours.corners(triangle);
    let (u, v) = (corners[(at + 1) % 3] - corners[at], corners[(at + 2) % 3] - corners[at]);
    u.cross(v).length().atan2(u.dot(v))
}
