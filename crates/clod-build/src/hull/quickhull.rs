//! Quickhull proper, in buffers that are kept from one hull to the next.

use glam::DVec3;
use palpate_core::triangle::nearest_on_triangle;

use super::{Hull, Shape, elevation, planar};
use crate::box_tree::bounds_of;

const NONE: u32 = u32::MAX;

/// Largest distance from a face, in thicknesses, of a point that is on it: one whose height above its plane
/// is below the thickness.
const MAX_ON_FACE_DISTANCE: f64 = 1e5;

#[derive(Clone, Copy, Debug)]
struct Face {
    /// Corners, counter-clockwise from outside.
    corners: [u32; 3],
    /// The face across the side from corner k to corner k + 1.
    across: [u32; 3],
    /// The first corner, and the outer normal, whose length is twice the area.
    corner: DVec3,
    normal: DVec3,
    /// Twice the area.
    area: f64,
    /// First of the list of points that are assigned to the face, linked through `HullBuilder::next`.
    outside: u32,
    /// The point of the list that is farthest above the face, and its height.
    farthest: u32,
    height: f64,
    alive: bool,
    /// The last point that it was tested against, and whether it was visible from there.
    tested: u32,
    visible: bool,
}

/// The buffers of quickhull.
#[derive(Debug, Default)]
pub(crate) struct HullBuilder {
    faces: Vec<Face>,
    next: Vec<u32>,
    /// The new face whose side starts at each point.
    fan: Vec<u32>,
    pending: Vec<u32>,
    visible: Vec<u32>,
    horizon: Vec<(u32, u32, u32)>,
    bends: Vec<u32>,
    /// Elevation above which the sign is certain without exact arithmetic.
    doubt: f64,
}

impl HullBuilder {
    /// The convex hull of finite points; `thickness` is the height above the hull below which a point may be
    /// dropped, and the extent below which a dimension counts as absent. No point is further than 10⁵ times
    /// that from the hull.
    ///
    /// # Panics
    /// If there are no points.
    pub fn hull(&mut self, points: &[DVec3], thickness: f64) -> Hull {
        let first = self.first_simplex(points, thickness);
        let mut simplex = match first {
            Err(hull) => return hull,
            Ok(simplex) => simplex,
        };
        let (low, high) = bounds_of(points);
        // The rounding of products of three differences of coordinates, with a margin.
        self.doubt = 1e-14 * (high - low).max_element().powi(3);
        let [a, b, c, d] = simplex.map(|v| points[v as usize]);
        if elevation(a, b, c, d) > 0.0 {
            simplex.swap(1, 2);
        }
        self.start(points, simplex, thickness);
        while let Some(face) = self.pending.pop() {
            if self.faces[face as usize].alive && self.faces[face as usize].outside != NONE {
                self.add_farthest(points, face, thickness);
            }
        }
        self.finish(points)
    }

    /// Four points that span a tetrahedron, or the hull if no four points do.
    fn first_simplex(&self, points: &[DVec3], thickness: f64) -> Result<[u32; 4], Hull> {
        let farthest = |measure: &dyn Fn(DVec3) -> f64| {
            let mut best = (0u32, f64::NEG_INFINITY);
            for (v, p) in points.iter().enumerate() {
                let m = measure(*p);
                if m > best.1 {
                    best = (v as u32, m);
                }
            }
            best
        };
        let (mut a, mut b, mut span) = (0, 0, -1.0);
        for axis in 0..3 {
            let low = farthest(&|p| -p[axis]).0;
            let high = farthest(&|p| p[axis]).0;
            let distance = points[low as usize].distance(points[high as usize]);
            if distance > span {
                (a, b, span) = (low, high, distance);
            }
        }
        if span <= thickness {
            return Err(Hull { shape: Shape::Point, extreme: vec![a.min(b)], faces: Vec::new() });
        }
        let (pa, pb) = (points[a as usize], points[b as usize]);
        let along = (pb - pa) / span;
        let (c, width) = farthest(&|p| (p - pa).cross(along).length());
        if width <= thickness {
            return Err(self.segment(points, along));
        }
        let pc = points[c as usize];
        let normal = (pb - pa).cross(pc - pa);
        let (d, _) = farthest(&|p| normal.dot(p - pa).abs());
        if elevation(pa, pb, pc, points[d as usize]).abs() <= thickness * normal.length() {
            let extreme = planar::polygon(points, (pb - pa).cross(pc - pa));
            if extreme.len() < 3 {
                return Err(self.segment(points, along));
            }
            return Err(Hull { shape: Shape::Polygon, extreme, faces: Vec::new() });
        }
        Ok([a, b, c, d])
    }

    fn segment(&self, points: &[DVec3], along: DVec3) -> Hull {
        let key = |v: &u32| along.dot(points[*v as usize]);
        let all = || 0..points.len() as u32;
        let low = all().min_by(|a, b| key(a).total_cmp(&key(b))).unwrap_or(0);
        let high = all().max_by(|a, b| key(a).total_cmp(&key(b))).unwrap_or(0);
        Hull { shape: Shape::Segment, extreme: vec![low.min(high), low.max(high)], faces: Vec::new() }
    }

    fn push_face(&mut self, points: &[DVec3], corners: [u32; 3], across: [u32; 3]) -> u32 {
        let [a, b, c] = corners.map(|v| points[v as usize]);
        let normal = (b - a).cross(c - a);
        self.faces.push(Face {
            corners,
            across,
            corner: a,
            normal,
            area: normal.length(),
            outside: NONE,
            farthest: NONE,
            height: 0.0,
            alive: true,
            tested: NONE,
            visible: false,
        });
        (self.faces.len() - 1) as u32
    }

    /// Twice the area times the height of a point above a face; the sign is exact.
    fn elevation(&self, points: &[DVec3], face: u32, point: u32) -> f64 {
        let Face { corners, corner, normal, .. } = self.faces[face as usize];
        let rounded = normal.dot(points[point as usize] - corner);
        if rounded.abs() > self.doubt {
            return rounded;
        }
        let [a, b, c] = corners.map(|v| points[v as usize]);
        elevation(a, b, c, points[point as usize])
    }

    fn start(&mut self, points: &[DVec3], [a, b, c, d]: [u32; 4], thickness: f64) {
        self.faces.clear();
        self.pending.clear();
        self.next.clear();
        self.next.resize(points.len(), NONE);
        self.fan.clear();
        self.fan.resize(points.len(), NONE);
        // d lies below (a, b, c).
        self.push_face(points, [a, b, c], [1, 2, 3]);
        self.push_face(points, [b, a, d], [0, 3, 2]);
        self.push_face(points, [c, b, d], [0, 1, 3]);
        self.push_face(points, [a, c, d], [0, 2, 1]);
        for v in 0..points.len() as u32 {
            if ![a, b, c, d].contains(&v) {
                self.assign(points, v, 0, thickness);
            }
        }
        self.pending.extend(0..4);
    }

    /// Assigns a point to one of the faces from `first` on that it lies above, if there is one. A point that
    /// is not above any by more than the thickness is dropped, unless it is beside the faces that it is
    /// above, and not on one: the planes of a hull that is hardly thicker than that pass close to points far
    /// outside its rim.
    fn assign(&mut self, points: &[DVec3], point: u32, first: u32, thickness: f64) {
        let (mut on, mut beside) = (false, None);
        for face in first..self.faces.len() as u32 {
            let elevation = self.elevation(points, face, point);
            let Face { corners, area, .. } = self.faces[face as usize];
            if elevation > thickness * area {
                self.give(point, face, elevation);
                return;
            }
            if elevation > 0.0 && !on {
                let p = points[point as usize];
                let nearest = nearest_on_triangle(p, &corners.map(|v| points[v as usize])).0;
                on = nearest.distance(p) <= MAX_ON_FACE_DISTANCE * thickness;
                beside = Some((face, elevation));
            }
        }
        if let Some((face, elevation)) = beside.filter(|_| !on) {
            self.give(point, face, elevation);
        }
    }

    /// Assigns a point to a face.
    fn give(&mut self, point: u32, face: u32, elevation: f64) {
        let face = &mut self.faces[face as usize];
        let height = elevation / face.area;
        self.next[point as usize] = std::mem::replace(&mut face.outside, point);
        if height > face.height {
            (face.height, face.farthest) = (height, point);
        }
    }

    /// Adds the farthest point above a face.
    fn add_farthest(&mut self, points: &[DVec3], face: u32, thickness: f64) {
        let apex = self.faces[face as usize].farthest;
        self.find_horizon(points, face, apex);
        let first = self.faces.len() as u32;
        for k in 0..self.horizon.len() {
            let (from, to, outer) = self.horizon[k];
            let new = self.push_face(points, [from, to, apex], [outer, NONE, NONE]);
            let outer = &mut self.faces[outer as usize];
            for side in 0..3 {
                if outer.corners[side] == to && outer.corners[(side + 1) % 3] == from {
                    outer.across[side] = new;
                }
            }
            self.fan[from as usize] = new;
        }
        for new in first..self.faces.len() as u32 {
            let next = self.fan[self.faces[new as usize].corners[1] as usize];
            self.faces[new as usize].across[1] = next;
            self.faces[next as usize].across[2] = new;
        }
        for k in 0..self.visible.len() {
            let old = &mut self.faces[self.visible[k] as usize];
            old.alive = false;
            let mut point = std::mem::replace(&mut old.outside, NONE);
            while point != NONE {
                let next = self.next[point as usize];
                if point != apex {
                    self.assign(points, point, first, thickness);
                }
                point = next;
            }
        }
        self.pending.extend(first..self.faces.len() as u32);
    }

    /// Finds the faces that are visible from a point above `face`, and the sides between visible and other
    /// faces.
    fn find_horizon(&mut self, points: &[DVec3], face: u32, apex: u32) {
        self.visible.clear();
        self.horizon.clear();
        self.visible.push(face);
        (self.faces[face as usize].tested, self.faces[face as usize].visible) = (apex, true);
        let mut done = 0;
        while done < self.visible.len() {
            let here = self.faces[self.visible[done] as usize];
            done += 1;
            for side in 0..3 {
                let other = here.across[side];
                if self.faces[other as usize].tested != apex {
                    let visible = self.elevation(points, other, apex) > 0.0;
                    (self.faces[other as usize].tested, self.faces[other as usize].visible) = (apex, visible);
                    if visible {
                        self.visible.push(other);
                    }
                }
                if !self.faces[other as usize].visible {
                    self.horizon.push((here.corners[side], here.corners[(side + 1) % 3], other));
                }
            }
        }
    }

    /// Collects the faces, and the extreme points: vertices with at least three sides at which the surface
    /// bends. On a facet there is no such side, on an edge there are two.
    fn finish(&mut self, points: &[DVec3]) -> Hull {
        self.bends.clear();
        self.bends.resize(points.len(), 0);
        let mut faces = Vec::new();
        for (index, face) in (0u32..).zip(&self.faces).filter(|(_, face)| face.alive) {
            faces.push(face.corners);
            for side in 0..3 {
                let (from, to) = (face.corners[side], face.corners[(side + 1) % 3]);
                let other = &self.faces[face.across[side] as usize];
                let Some(opposite) = other.corners.iter().find(|v| **v != from && **v != to) else {
                    continue;
                };
                if self.elevation(points, index, *opposite) != 0.0 {
                    // Each side is visited twice, once from each of its faces, and counted at its start each
                    // time.
                    self.bends[from as usize] += 1;
                }
            }
        }
        let extreme = (0..points.len() as u32).filter(|v| self.bends[*v as usize] >= 3).collect();
        Hull { shape: Shape::Polytope, extreme, faces }
    }
}
