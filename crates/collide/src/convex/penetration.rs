//! Penetration depth of two overlapping convex hulls: the shortest translation that separates them.
//!
//! The expanding polytope algorithm (van den Bergen 2001): a polytope inside the Minkowski difference a − b
//! grows towards the boundary point that is nearest to the origin. With **n** the outward unit normal of the
//! polytope's nearest face and **w** the vertex of a − b furthest along **n**:
//!
//! - the face's distance from the origin is a lower bound on the depth;
//! - **n** · **w**, the extent of a − b along **n**, is an upper bound, as b moved that far along **n**
//!   touches a only.
//!
//! If they differ, **w** becomes a vertex of the polytope: the faces that see it are replaced by a fan around
//! it.
//!
//! The caller may give a tetrahedron to start from: the last GJK simplex or, for bodies that have moved a
//! little, that of the last answer, with the face that was nearest then. If that face is still the nearest,
//! and the origin lies deep below the other three, a single support point confirms it.
//!
//! Departures: without such a tetrahedron, or if it is thin, the first one is built from support points
//! in all directions, so that touching and flat hulls are no special case (the origin may start outside it;
//! faces that see it have negative distances and grow first). A Minkowski difference that is flat has
//! depth 0 across its plane. And since the extent of a − b along *any* direction is an upper bound on the
//! depth, the smallest one seen is the answer, even if the polytope is spoilt by rounding.

use palpate_core::glam::DVec3;

use super::gjk::{difference, support};
use super::placement::Placement;
use super::simplex::{Vertex, nearest_on_triangle};
use super::support::Hull;
use crate::tolerances::{COPLANAR_HEIGHT, SLIVER_FACE, THIN_TETRAHEDRON, VISIBLE_HEIGHT};

/// Largest number of vertices of the polytope. With fewer, round hulls have inexact depths.
const MAX_VERTICES: usize = 256;
/// Largest number of faces of the polytope: a closed triangulated surface with v vertices has 2v − 4 (Euler).
const MAX_FACES: usize = 2 * MAX_VERTICES;
/// Index that stands for no face.
const NONE: u16 = u16::MAX;

/// The answer of a penetration query. Points and directions are in a's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Penetration {
    /// Depth along [`normal`](Self::normal), m: the distance that b has to move along it until the hulls
    /// only touch. 0 if they touch or the Minkowski difference is flat; negative if the hulls are apart
    /// along the normal.
    pub depth: f64,
    /// Unit normal, pointing out of a.
    pub normal: DVec3,
    /// The point of a that lies deepest in b, m.
    pub on_a: DVec3,
    /// The point of b that lies deepest in a, m.
    pub on_b: DVec3,
    /// Bound on the difference between the depth and the least depth, m.
    pub gap: f64,
    /// Whether the gap closed to within the requested precision.
    pub converged: bool,
    /// Whether the Minkowski difference is flat (or less): then the opposite normal is equally valid.
    pub flat: bool,
    /// Vertices of a and b whose differences are a tetrahedron that the next query may start from; the first
    /// three are the nearest face. Meaningless if flat.
    pub tetrahedron: [(u32, u32); 4],
}

/// A triangle of the polytope.
#[derive(Clone, Copy, Debug)]
struct Face {
    /// Vertices, counter-clockwise seen from outside.
    vertices: [u16; 3],
    /// Neighbour across the edge from vertex i to vertex i + 1.
    neighbours: [u16; 3],
    /// Unit outward normal.
    normal: DVec3,
    /// Signed distance of the plane from the origin, m; infinite for a sliver without a plane.
    distance: f64,
    /// Whether the face is part of the polytope, rather than replaced.
    alive: bool,
    /// Whether the face sees the vertex that is being added.
    visible: bool,
}

/// An edge of the horizon, in the direction of the visible face.
#[derive(Clone, Copy, Debug)]
struct HorizonEdge {
    from: u16,
    to: u16,
    /// The face beyond the horizon, and the number of this edge in it.
    beyond: u16,
    back: u8,
}

/// The workspace of [`penetration`](Polytope::penetration): the growing polytope. Allocates once.
#[derive(Clone, Debug)]
pub struct Polytope {
    vertices: Vec<Vertex>,
    faces: Vec<Face>,
    /// Indices of faces that were replaced.
    free: Vec<u16>,
    /// Visible faces of the current expansion.
    visible: Vec<u16>,
    /// Edges between the visible and the other faces.
    horizon: Vec<HorizonEdge>,
    /// For each vertex, the new face whose edge on the horizon starts there, or [`NONE`].
    starts: Vec<u16>,
}

impl Default for Polytope {
    fn default() -> Self {
        Self::new()
    }
}

impl Polytope {
    /// An empty workspace.
    pub fn new() -> Self {
        Self {
            vertices: Vec::with_capacity(MAX_VERTICES),
            faces: Vec::with_capacity(MAX_FACES),
            free: Vec::with_capacity(MAX_FACES),
            visible: Vec::with_capacity(MAX_FACES),
            horizon: Vec::with_capacity(MAX_FACES),
            starts: vec![NONE; MAX_VERTICES],
        }
    }

    /// Finds depth and direction of the penetration of hulls a and b as placed, to within `precision` (m).
    /// Hulls that do not overlap have a depth that is not positive. `start`: vertices of a and b whose
    /// differences are a tetrahedron around the origin, or nearly so; anything else is ignored.
    ///
    /// Invariant: distance of the nearest face ≤ depth ≤ best extent; the loop ends when the two meet.
    pub fn penetration(
        &mut self,
        a: &Hull,
        b: &Hull,
        placement: &Placement,
        start: &[(u32, u32)],
        precision: f64,
    ) -> Penetration {
        self.vertices.clear();
        self.faces.clear();
        self.free.clear();
        let (extent, normal, gap) = (f64::INFINITY, DVec3::X, f64::INFINITY);
        let mut best = Candidate { extent, normal, face: [0; 3], gap, converged: false, flat: false };
        if !self.start_from(a, b, placement, start)
            && let Err(flat_normal) = self.first_tetrahedron(a, b, placement, precision)
        {
            let (vertex, normal) = smaller_extent(a, b, placement, flat_normal);
            self.vertices.clear();
            self.vertices.push(vertex);
            let extent = vertex.difference.dot(normal);
            best = Candidate { extent, normal, gap: 0.0, converged: true, flat: true, ..best };
            return self.answer(a, b, placement, &best, precision);
        }
        while let Some(index) = self.nearest_face() {
            let Face { normal, distance, vertices, .. } = self.faces[index as usize];
            let vertex = support(a, b, placement, normal);
            let extent = vertex.difference.dot(normal);
            if extent < best.extent {
                best = Candidate { extent, normal, face: vertices, ..best };
            }
            best.gap = best.extent - distance;
            if best.gap <= precision {
                best.converged = true;
                break;
            }
            let known = self.vertices.iter().any(|v| v.a == vertex.a && v.b == vertex.b);
            if known || self.vertices.len() == MAX_VERTICES || !self.expand(index, vertex, precision) {
                // A known vertex beyond its own face, or a torn horizon, is due to rounding. The gap bounds
                // the error.
                break;
            }
        }
        self.answer(a, b, placement, &best, precision)
    }

    /// The answer for the best direction: its witness points by the barycentric weights of the origin's
    /// projection on its face, and the next start.
    fn answer(
        &self,
        a: &Hull,
        b: &Hull,
        placement: &Placement,
        best: &Candidate,
        precision: f64,
    ) -> Penetration {
        // Of coplanar faces, the one that the origin projects into has the witness points.
        let near = |face: [u16; 3]| {
            let corners = face.map(|v| self.vertices[v as usize]);
            let [p, q, r] = corners.map(|v| v.difference);
            let weights = nearest_on_triangle(p, q, r);
            ((weights[0] * p + weights[1] * q + weights[2] * r).length_squared(), corners, weights)
        };
        let on_plane = |face: &&Face| {
            face.alive
                && face.vertices.iter().all(|v| {
                    let height = self.vertices[*v as usize].difference.dot(best.normal);
                    best.extent - height <= COPLANAR_HEIGHT * precision
                })
        };
        let faces = self.faces.iter().filter(on_plane).map(|face| near(face.vertices));
        let closer = |x: &(f64, _, _), y: &(f64, _, _)| x.0.total_cmp(&y.0);
        let (_, corners, weights) = faces.min_by(closer).unwrap_or_else(|| near(best.face));
        let apex = self.apex(corners.map(|v| v.difference));
        let (mut on_a, mut on_b) = (DVec3::ZERO, DVec3::ZERO);
        for (vertex, weight) in corners.iter().zip(weights) {
            on_a += weight * a.point(vertex.a);
            on_b += weight * b.point(vertex.b);
        }
        Penetration {
            depth: best.extent,
            normal: best.normal,
            on_a,
            on_b: placement.point(on_b),
            gap: best.gap.max(0.0),
            converged: best.converged,
            flat: best.flat,
            tetrahedron: [corners[0], corners[1], corners[2], apex].map(|v| (v.a, v.b)),
        }
    }

    /// The vertex that best makes a tetrahedron around the origin with a face: the one furthest inside the
    /// cone of rays from the face's corners through the origin, whose sides are the planes through the origin
    /// and two corners.
    fn apex(&self, [p, q, r]: [DVec3; 3]) -> Vertex {
        let sides = [q.cross(r), r.cross(p), p.cross(q)].map(DVec3::normalize_or_zero);
        let inside =
            |v: &Vertex| sides.iter().map(|side| -side.dot(v.difference)).fold(f64::INFINITY, f64::min);
        let mut best = (self.vertices[0], f64::NEG_INFINITY);
        for vertex in &self.vertices {
            let inside = inside(vertex);
            if inside > best.1 {
                best = (*vertex, inside);
            }
        }
        best.0
    }

    /// The face with the smallest distance from the origin.
    fn nearest_face(&self) -> Option<u16> {
        let mut best = (None, f64::INFINITY);
        for (index, face) in (0u16..).zip(&self.faces) {
            if face.alive && face.distance < best.1 {
                best = (Some(index), face.distance);
            }
        }
        best.0
    }

    /// Starts from a given tetrahedron; `false` if it is thin or not valid.
    fn start_from(&mut self, a: &Hull, b: &Hull, placement: &Placement, start: &[(u32, u32)]) -> bool {
        let (count_a, count_b) = (a.len(), b.len());
        let &[first, second, third, apex] = start else { return false };
        let known = |(on_a, on_b): (u32, u32)| (on_a as usize) < count_a && (on_b as usize) < count_b;
        if !start.iter().all(|&pair| known(pair)) {
            return false;
        }
        let [first, second, third, apex] =
            [first, second, third, apex].map(|(on_a, on_b)| difference(a, b, placement, on_a, on_b));
        // A thin tetrahedron has little volume for its longest edge (volume as a product of edges, six times
        // as large).
        let edges = [second, third, apex].map(|v| v.difference - first.difference);
        let normal = edges[0].cross(edges[1]);
        let volume = normal.dot(edges[2]);
        let longest = edges.iter().map(|edge| edge.length_squared()).fold(0.0, f64::max).sqrt();
        let thin = volume.abs() <= THIN_TETRAHEDRON * longest * longest * longest;
        if thin || volume.is_nan() {
            return false;
        }
        // The apex has to be below the base, whose corners are then counter-clockwise seen from outside.
        if volume < 0.0 {
            self.vertices.extend([first, second, third, apex]);
        } else {
            self.vertices.extend([first, third, second, apex]);
        }
        self.first_faces();
        true
    }

    /// Builds a tetrahedron of support points: two that are far apart, the furthest from their line, and the
    /// furthest from their plane. If the Minkowski difference is flat, returns the normal of a plane that it
    /// lies in.
    fn first_tetrahedron(
        &mut self,
        a: &Hull,
        b: &Hull,
        placement: &Placement,
        precision: f64,
    ) -> Result<(), DVec3> {
        let [first, second] = longest_extent(a, b, placement);
        let along = second.difference - first.difference;
        if along.length() <= precision {
            return Err(DVec3::X);
        }
        let along = along.normalize();
        let (side, up) = along.any_orthonormal_pair();
        let mut third = (first, 0.0);
        for direction in [side, -side, up, -up] {
            let vertex = support(a, b, placement, direction);
            let height = (vertex.difference - first.difference).reject_from_normalized(along).length();
            if height > third.1 {
                third = (vertex, height);
            }
        }
        if third.1 <= precision {
            return Err(side);
        }
        let (third, _) = third;
        let normal = along.cross(third.difference - first.difference).normalize();
        let (above, below) = (support(a, b, placement, normal), support(a, b, placement, -normal));
        let height = |v: &Vertex| (v.difference - first.difference).dot(normal);
        let (high, low) = (height(&above), -height(&below));
        if high.max(low) <= precision {
            return Err(normal);
        }
        // `first, second, third` is counter-clockwise seen from `normal`; the apex goes to the other side of
        // the base.
        if low >= high {
            self.vertices.extend([first, second, third, below]);
        } else {
            self.vertices.extend([first, third, second, above]);
        }
        self.first_faces();
        Ok(())
    }

    /// Adds the faces of a tetrahedron whose first three vertices are counter-clockwise seen from outside.
    fn first_faces(&mut self) {
        for (vertices, neighbours) in [
            ([0, 1, 2], [1, 2, 3]), // base; edge 01 to face 1, 12 to face 2, 20 to face 3
            ([1, 0, 3], [0, 3, 2]),
            ([2, 1, 3], [0, 1, 3]),
            ([0, 2, 3], [0, 2, 1]),
        ] {
            let face = self.face(vertices, neighbours);
            self.faces.push(face);
        }
    }

    /// Makes a face with its plane. A sliver has none: its normal would be noise.
    fn face(&self, vertices: [u16; 3], neighbours: [u16; 3]) -> Face {
        let [p, q, r] = vertices.map(|v| self.vertices[v as usize].difference);
        let normal = (q - p).cross(r - p);
        let longest = (q - p).length_squared().max((r - p).length_squared()).max((r - q).length_squared());
        let (normal, distance) = if normal.length_squared() > SLIVER_FACE * longest * longest {
            let normal = normal.normalize();
            (normal, normal.dot(p).max(normal.dot(q)).max(normal.dot(r)))
        } else {
            (DVec3::ZERO, f64::INFINITY)
        };
        Face { vertices, neighbours, normal, distance, alive: true, visible: false }
    }

    /// Adds a vertex: replaces the faces that see it, one of which is `start`, by a fan around it. Returns
    /// `false`, with the polytope unusable, if these faces do not form a disc.
    fn expand(&mut self, start: u16, vertex: Vertex, precision: f64) -> bool {
        let apex = self.vertices.len() as u16;
        self.vertices.push(vertex);
        self.find_visible(start, vertex.difference, precision);
        self.find_horizon() && {
            self.remove_visible();
            self.add_fan(apex)
        }
    }

    /// Lists the faces that see a point, by flood fill from one that does.
    fn find_visible(&mut self, start: u16, point: DVec3, precision: f64) {
        self.visible.clear();
        self.visible.push(start);
        self.faces[start as usize].visible = true;
        let mut next = 0;
        while next < self.visible.len() {
            let index = self.visible[next];
            next += 1;
            for beyond in self.faces[index as usize].neighbours {
                let across = &mut self.faces[beyond as usize];
                if across.visible {
                    continue;
                }
                // A sliver counts as visible next to a visible face.
                if across.normal.dot(point) > across.distance + VISIBLE_HEIGHT * precision
                    || across.distance == f64::INFINITY
                {
                    across.visible = true;
                    self.visible.push(beyond);
                }
            }
        }
    }

    /// Lists the edges between the visible faces and the others. Returns `false` if links between faces are
    /// broken.
    fn find_horizon(&mut self) -> bool {
        self.horizon.clear();
        for &index in &self.visible {
            let face = self.faces[index as usize];
            for edge in 0..3 {
                let beyond = face.neighbours[edge];
                let across = &self.faces[beyond as usize];
                if across.visible {
                    continue;
                }
                let (from, to) = (face.vertices[edge], face.vertices[(edge + 1) % 3]);
                let Some(back) = (0..3).find(|&e| across.vertices[e] == to && across.neighbours[e] == index)
                else {
                    return false;
                };
                self.horizon.push(HorizonEdge { from, to, beyond, back: back as u8 });
            }
        }
        self.horizon.len() >= 3
    }

    fn remove_visible(&mut self) {
        for &index in &self.visible {
            let face = &mut self.faces[index as usize];
            face.alive = false;
            face.visible = false;
            self.free.push(index);
        }
    }

    /// Adds a face from each edge of the horizon to the apex and links the faces. Returns `false` if the
    /// horizon is not a single loop.
    fn add_fan(&mut self, apex: u16) -> bool {
        for &HorizonEdge { from, to, .. } in &self.horizon {
            self.starts[from as usize] = NONE;
            self.starts[to as usize] = NONE;
        }
        for step in 0..self.horizon.len() {
            let HorizonEdge { from, to, beyond, back } = self.horizon[step];
            let face = self.face([from, to, apex], [beyond, NONE, NONE]);
            let index = match self.free.pop() {
                Some(index) => {
                    self.faces[index as usize] = face;
                    index
                }
                None if self.faces.len() < MAX_FACES => {
                    self.faces.push(face);
                    (self.faces.len() - 1) as u16
                }
                None => return false,
            };
            self.faces[beyond as usize].neighbours[back as usize] = index;
            if self.starts[from as usize] != NONE {
                return false;
            }
            self.starts[from as usize] = index;
        }
        // Edge 1 of a face [from, to, apex] is edge 2 of the face that starts at `to`.
        for step in 0..self.horizon.len() {
            let HorizonEdge { from, to, .. } = self.horizon[step];
            let (index, next) = (self.starts[from as usize], self.starts[to as usize]);
            if next == NONE || self.faces[next as usize].vertices[0] != to {
                return false;
            }
            self.faces[index as usize].neighbours[1] = next;
            self.faces[next as usize].neighbours[2] = index;
        }
        true
    }
}

/// The best direction so far, with the extent of a − b along it, m.
struct Candidate {
    extent: f64,
    normal: DVec3,
    /// Vertices of the face whose normal it is.
    face: [u16; 3],
    /// Extent minus the distance of the polytope's nearest face, m.
    gap: f64,
    converged: bool,
    flat: bool,
}

/// Of a direction and its opposite, the one along which a − b extends less, with the support point.
fn smaller_extent(a: &Hull, b: &Hull, placement: &Placement, direction: DVec3) -> (Vertex, DVec3) {
    let forward = support(a, b, placement, direction);
    let backward = support(a, b, placement, -direction);
    if forward.difference.dot(direction) <= -backward.difference.dot(direction) {
        (forward, direction)
    } else {
        (backward, -direction)
    }
}

/// The two support points along one of the axes that are furthest apart.
fn longest_extent(a: &Hull, b: &Hull, placement: &Placement) -> [Vertex; 2] {
    let mut ends = [Vertex::default(); 2];
    let mut extent = -1.0;
    for axis in DVec3::AXES {
        let (high, low) = (support(a, b, placement, axis), support(a, b, placement, -axis));
        let length = high.difference.distance_squared(low.difference);
        if length > extent {
            extent = length;
            ends = [high, low];
        }
    }
    ends
}
