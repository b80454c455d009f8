//! The vertices of either surface that are inside the other object, with their depths.

use palpate_core::Contact;
use palpate_core::glam::DVec3;

use super::sides::Side;
use crate::contact::PatchContact;
use crate::patchwork::{NearestPoint, NearestSearch};
use crate::shape::Shape;

/// State of a vertex whose distance has not been measured yet.
const UNSEEN: u32 = u32::MAX;
/// State of a vertex that is outside the other object.
const OUTSIDE: u32 = u32::MAX - 1;

/// A vertex inside the other object.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Inside {
    /// Index of its side.
    pub side: usize,
    /// Mesh vertex.
    pub vertex: u32,
    /// A node whose patch has the vertex.
    pub node: u32,
    /// Level of the other object's surface from which the distance is measured.
    pub level: u32,
    /// Position in its own frame, m.
    pub own: DVec3,
    /// Position in the other body's frame, m.
    pub in_other: DVec3,
    /// Nearest point of the other surface, in its frame.
    pub nearest: NearestPoint,
}

/// Lengths and limits of a run.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Measures {
    /// Largest distance of a vertex that lies on a surface, m.
    pub precision: f64,
    /// Largest difference of equal depths, m.
    pub same: f64,
    /// Largest number of vertices whose distance may be measured.
    pub max_vertices: usize,
    /// Whether to find local maxima besides the deepest.
    pub maxima: bool,
}

/// The vertices inside, and the state of all others.
#[derive(Clone, Debug)]
pub(crate) struct InsideVertices {
    pub found: Vec<Inside>,
    /// For each side and mesh vertex, index into `found`, [`OUTSIDE`] or [`UNSEEN`].
    state: [Vec<u32>; 2],
    /// Vertices whose state was set.
    touched: [Vec<u32>; 2],
    pub search: NearestSearch,
    /// Number of vertices whose distance was measured.
    pub measured: usize,
    /// Whether there were more vertices to measure than allowed.
    pub truncated: bool,
}

impl InsideVertices {
    pub fn new(shapes: [&Shape; 2]) -> Self {
        Self {
            found: Vec::new(),
            state: shapes.map(|shape| vec![UNSEEN; shape.patchwork().neighbours.vertices()]),
            touched: [Vec::new(), Vec::new()],
            search: NearestSearch::default(),
            measured: 0,
            truncated: false,
        }
    }

    /// Memory held, bytes, without the search.
    pub fn bytes(&self) -> usize {
        let vertices = self.state.iter().chain(&self.touched).map(|list| 4 * list.capacity());
        vertices.sum::<usize>() + self.found.capacity() * size_of::<Inside>()
    }

    pub fn clear(&mut self) {
        for (state, touched) in self.state.iter_mut().zip(&mut self.touched) {
            touched.drain(..).for_each(|vertex| state[vertex as usize] = UNSEEN);
        }
        self.found.clear();
        (self.measured, self.truncated) = (0, false);
    }

    /// Depth of a vertex inside, m.
    pub fn depth(&self, index: u32) -> f64 {
        self.found[index as usize].nearest.distance
    }

    /// Measures the signed distance of a vertex of a node's patch from the other surface, once. Returns its
    /// index if it is inside. `level` and `hint`: level of the other surface, and a triangle of it that may
    /// be near.
    pub fn measure(
        &mut self,
        side: &Side,
        measures: &Measures,
        (vertex, node, own): (u32, u32, DVec3),
        (level, hint): (u32, u32),
    ) -> Option<u32> {
        let state = self.state[side.index][vertex as usize];
        if state != UNSEEN {
            return (state != OUTSIDE).then_some(state);
        }
        let in_other = side.to_other.point(own);
        let (ball, surface) = (side.other.ball(), side.other.patchwork());
        let mut found = None;
        if in_other.distance(ball.center) <= ball.radius {
            if self.measured == measures.max_vertices {
                self.truncated = true;
                return None;
            }
            self.measured += 1;
            found = self.search.on_level(surface, level, in_other, hint).filter(|nearest| {
                nearest.distance > measures.precision && nearest.is_behind(surface, in_other)
            });
        }
        self.touched[side.index].push(vertex);
        let Some(nearest) = found else {
            self.state[side.index][vertex as usize] = OUTSIDE;
            return None;
        };
        let index = self.found.len() as u32;
        self.state[side.index][vertex as usize] = index;
        self.found.push(Inside { side: side.index, vertex, node, level, own, in_other, nearest });
        Some(index)
    }

    /// Whether no neighbour of a vertex is deeper by more than `same`, m; vertices of a face that is pressed
    /// in flat are equally deep up to rounding.
    pub fn is_maximum(&self, index: u32, sides: &[Side; 2], same: f64) -> bool {
        let Inside { side, vertex, nearest, .. } = self.found[index as usize];
        let neighbours = &sides[side].own.patchwork().neighbours;
        let around = neighbours.around(vertex).iter().flat_map(|t| neighbours.ends(*t));
        let deepest = nearest.distance + same;
        let states = around.map(|end| self.state[side][end as usize]).filter(|state| *state < OUTSIDE);
        !states.map(|state| self.depth(state)).any(|depth| depth > deepest)
    }

    /// The contact of a vertex inside, in the probe's frame.
    pub fn contact(&self, index: u32, sides: &[Side; 2]) -> PatchContact {
        let Inside { side, node, own, in_other, nearest, .. } = self.found[index as usize];
        let from_other = |point: DVec3| sides[1 - side].to_other.point(point);
        let outward = nearest.face_normal(sides[side].other.patchwork());
        let depth = nearest.distance;
        if side == 0 {
            let scene_point = from_other(nearest.point);
            let normal = match outward {
                Some(outward) => -sides[1].to_other.direction(outward),
                None => (own - scene_point).normalize(),
            };
            let contact = Contact { point: own, scene_point, normal, depth };
            PatchContact { contact, probe_node: node, scene_node: nearest.node, weight: 1.0 }
        } else {
            let normal = outward.unwrap_or_else(|| (nearest.point - in_other).normalize());
            let contact = Contact { point: nearest.point, scene_point: in_other, normal, depth };
            PatchContact { contact, probe_node: nearest.node, scene_node: node, weight: 1.0 }
        }
    }
}
