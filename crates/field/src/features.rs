//! Exact distances by local descent over the features of meshes: vertices, edges and faces that are linked to
//! their neighbours (D. E. Johnson and P. Willemsen, *Six degree-of-freedom haptic rendering of complex
//! polygonal models*, 2003).
//!
//! A search starts where the last one ended, and moves on to a neighbour while that is nearer. Bodies move
//! little from step to step, so that it visits a few features. It finds a local minimum: a thin wall's other
//! side is never taken for the near one.

mod tree;

use std::collections::HashMap;
use std::ops::Range;

use glam::DVec3;
use palpate_core::TriMesh;
use palpate_core::triangle::{TriangleFeature, nearest_on_triangle};

pub use self::tree::{FeatureTree, Node};
use crate::exact::ExactDistance;

/// Index of no face.
const NONE: u32 = u32::MAX;

/// Largest number of faces that a walk visits; one that goes on is ended by a search of the whole surface.
/// With fewer, these searches take longer than walks would.
const MAX_WALK: usize = 32;

/// Smallest downward slope at which a place leaves a vertex. With less, rounding moves places to and fro
/// between parallel faces.
const MIN_SLOPE: f64 = 1e-3;

/// Sine of the angle between edges from which they cross. With less, the place and the normal of both are
/// rounding.
const MIN_ANGLE: f64 = 1e-3;

/// Smallest move along an edge, as a fraction of it. With more, the place where edges cross is found too
/// coarsely; with less, single precision is too coarse.
const MIN_STEP: f64 = 1e-6;

/// Difference of a rise from that of a parabola with the same slopes at both ends, in the difference between
/// these, up to which a distance bends evenly. With more, points take longer to kinks; with less, to minima
/// over faces and vertices.
const EVEN: f64 = 0.05;

/// Share of a way that is tried where the distance is not convex.
const SHORTER: f64 = 0.25;

/// Distance below which the direction from a point of an edge or vertex is rounding, as a fraction of the
/// largest distance of a vertex from the mesh's origin. With less, contacts at touching edges push sideways.
const MIN_DIRECTED: f64 = 1e-10;

/// Smallest cosine of the angle between the normals of faces that are one: the edge between them is no
/// feature. It allows for vertices in single precision.
const FLAT: f64 = 1.0 - 1e-9;

/// A mesh whose features are linked to their neighbours.
#[derive(Clone, Debug)]
pub struct FeatureMesh {
    vertices: Vec<DVec3>,
    /// Angle-weighted pseudonormals of the vertices.
    normals: Vec<DVec3>,
    faces: Vec<Face>,
    /// Ends of the edges.
    edges: Vec<[u32; 2]>,
    /// Faces on both sides of the edges.
    sides: Vec<[u32; 2]>,
    faces_around: Lists,
    edges_around: Lists,
    /// Unit vectors along the entries of `edges_around`, away from the vertex.
    outgoing: Vec<DVec3>,
    pub(crate) exact: ExactDistance,
    tree: FeatureTree,
    is_closed: bool,
    /// Lower and upper bounds, m, and half of their diagonal.
    bounds: [DVec3; 2],
    size: f64,
    /// Distance below which directions are rounding, m.
    min_directed: f64,
}

#[derive(Clone, Copy, Debug)]
struct Face {
    corners: [u32; 3],
    /// Faces across the edges from corner i to i + 1.
    neighbours: [u32; 3],
    edges: [u32; 3],
    normal: DVec3,
    /// Vectors across the edges and along the face, into it.
    inward: [DVec3; 3],
}

impl Face {
    /// The vector across one of its edges, into it.
    #[inline(always)]
    fn inward_from(&self, edge: u32) -> Option<&DVec3> {
        self.edges.iter().zip(&self.inward).find_map(|(own, inward)| (*own == edge).then_some(inward))
    }
}

/// A list for each vertex.
#[derive(Clone, Debug)]
struct Lists {
    starts: Vec<u32>,
    entries: Vec<u32>,
}

/// A place on the vertices and edges of a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Place {
    /// A vertex.
    Vertex(u32),
    /// A point of an edge, at a fraction of its length.
    Edge(u32, f32),
}

/// What a point of a mesh is on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MeshFeature {
    /// The inside of a face.
    Face(u32),
    /// The inside of an edge.
    Edge(u32),
    /// A vertex.
    Vertex(u32),
}

/// The point of a surface nearest to another point, among those near by.
#[derive(Clone, Copy, Debug)]
pub struct ClosestPoint {
    /// Its position, m.
    pub point: DVec3,
    /// Signed distance from it, negative inside, m.
    pub distance: f64,
    /// Unit gradient of the distance: out of the surface.
    pub normal: DVec3,
    /// The face that it is on, from which the next walk starts.
    pub face: u32,
    /// What it is on.
    pub feature: MeshFeature,
}

impl From<Place> for MeshFeature {
    fn from(place: Place) -> Self {
        match place {
            Place::Vertex(vertex) => Self::Vertex(vertex),
            Place::Edge(edge, _) => Self::Edge(edge),
        }
    }
}

/// The part of a surface that a place stays in as it descends.
#[derive(Clone, Copy, Debug)]
pub struct Leash {
    /// Centre, in the mesh's frame, m.
    pub home: DVec3,
    /// Largest distance from there, m.
    pub length: f32,
}

impl Leash {
    /// One that lets a place go anywhere.
    pub fn unbounded(&self) -> Self {
        Self { length: f32::INFINITY, ..*self }
    }

    /// Whether a place at a position (m) is on it.
    pub fn holds(&self, position: DVec3) -> bool {
        position.distance_squared(self.home) <= f64::from(self.length).powi(2)
    }

    /// Whether it reaches wherever another one does.
    pub fn covers(&self, other: &Self) -> bool {
        self.home.distance(other.home) + f64::from(other.length) <= self.length.into()
    }

    /// The shortest that covers two.
    #[must_use]
    pub fn joined(&self, other: &Self) -> Self {
        let (a, b) = (f64::from(self.length), f64::from(other.length));
        let away = self.home.distance(other.home);
        if away + b <= a {
            return *self;
        }
        if away + a <= b {
            return *other;
        }
        let length = 0.5 * (away + a + b);
        let home = self.home.lerp(other.home, (length - a) / away);
        Self { home, length: (length as f32).next_up() }
    }
}

/// Share, between 0 and 1, of a way to a place that is no nearer to another surface, at which it is nearest.
/// `risen` is how much further away the place is, `slope` and `beyond` the changes of the distance that its
/// gradients at the beginning and at the end make along the way, all in the same unit.
///
/// The distance is above its tangents at both ends. With a kink, as over another edge, it is least where
/// these meet; where it bends evenly, as over a face, where its slope is 0.
#[inline]
pub fn lowest_share(risen: f64, [slope, beyond]: [f64; 2]) -> f64 {
    let is_even = (risen - 0.5 * (slope + beyond)).abs() < EVEN * (beyond - slope);
    // The end of the way is no lower, so that a parabola's lowest place is at most halfway.
    let share =
        if is_even { (slope / (slope - beyond)).min(0.5) } else { (risen - beyond) / (slope - beyond) };
    if beyond > 0.0 && share > 0.0 && share < 1.0 { share } else { SHORTER }
}

/// Fractions of two segments (m) at which the lines through them are nearest to each other, with the vector
/// across both; `None` for lines along each other.
#[inline]
pub fn where_nearest([a, b]: [DVec3; 2], [c, d]: [DVec3; 2]) -> Option<([f64; 2], DVec3)> {
    let (u, v, w) = (b - a, d - c, a - c);
    let (uu, uv, vv) = (u.dot(u), u.dot(v), v.dot(v));
    let across = u.cross(v);
    let square = across.length_squared();
    let (uw, vw) = (u.dot(w), v.dot(w));
    let at = [(uv * vw - vv * uw) / square, (uu * vw - uv * uw) / square];
    (square > MIN_ANGLE * MIN_ANGLE * uu * vv).then_some((at, across))
}

/// Whether a place leaves a vertex along a slope.
#[inline(always)]
fn is_down(slope: f64) -> bool {
    slope < -MIN_SLOPE
}

impl Lists {
    /// Makes the lists of pairs (vertex, entry).
    fn new(vertices: usize, pairs: impl Iterator<Item = (u32, u32)> + Clone) -> Self {
        let mut starts = vec![0; vertices + 1];
        for (vertex, _) in pairs.clone() {
            starts[vertex as usize + 1] += 1;
        }
        for vertex in 0..vertices {
            starts[vertex + 1] += starts[vertex];
        }
        let mut next = starts.clone();
        let mut entries = vec![0; starts[vertices] as usize];
        for (vertex, entry) in pairs {
            entries[next[vertex as usize] as usize] = entry;
            next[vertex as usize] += 1;
        }
        Self { starts, entries }
    }

    #[inline(always)]
    fn range(&self, vertex: u32) -> Range<usize> {
        self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize
    }

    fn of(&self, vertex: u32) -> &[u32] {
        &self.entries[self.range(vertex)]
    }

    fn bytes(&self) -> usize {
        (self.starts.capacity() + self.entries.capacity()) * size_of::<u32>()
    }
}

impl FeatureMesh {
    /// Smallest fraction of the way along an edge that a descent tries first. With less, it follows motion
    /// late.
    pub const MIN_STRIDE: f64 = 1.0 / 64.0;

    /// Links the features of a mesh.
    ///
    /// # Panics
    /// If the mesh has no triangles.
    pub fn new(mesh: &TriMesh) -> Self {
        let corners = mesh.triangles();
        let mut edges = Vec::with_capacity(corners.len() * 3 / 2);
        let mut sides = Vec::with_capacity(corners.len() * 3 / 2);
        let mut known: HashMap<[u32; 2], (u32, u32, usize)> = HashMap::new();
        let mut faces: Vec<Face> = Vec::with_capacity(corners.len());
        for (index, &corners) in corners.iter().enumerate() {
            let [a, b, c] = mesh.corners(index);
            let normal = (b - a).cross(c - a).normalize_or_zero();
            let inward = [b - a, c - b, a - c].map(|edge| normal.cross(edge));
            let mut face = Face { corners, neighbours: [NONE; 3], edges: [0; 3], normal, inward };
            for i in 0..3 {
                let (from, to) = (corners[i], corners[(i + 1) % 3]);
                match known.get(&[from.min(to), from.max(to)]) {
                    Some(&(edge, other, place)) => {
                        face.edges[i] = edge;
                        face.neighbours[i] = other;
                        faces[other as usize].neighbours[place] = index as u32;
                        sides[edge as usize] = [other, index as u32];
                    }
                    None => {
                        face.edges[i] = edges.len() as u32;
                        known.insert([from.min(to), from.max(to)], (edges.len() as u32, index as u32, i));
                        edges.push([from, to]);
                        sides.push([index as u32, NONE]);
                    }
                }
            }
            faces.push(face);
        }
        let count = mesh.vertices().len();
        let around = |index: usize, face: &Face| face.corners.map(|corner| (corner, index as u32));
        let faces_around =
            Lists::new(count, faces.iter().enumerate().flat_map(|(index, face)| around(index, face)));
        let ends = edges.iter().enumerate().flat_map(|(index, ends)| ends.map(|end| (end, index as u32)));
        let edges_around = Lists::new(count, ends);
        let vertices = mesh.vertices();
        let outgoing = (0..count as u32)
            .flat_map(|vertex| edges_around.of(vertex).iter().map(move |&edge| (vertex, edge)));
        let outgoing = outgoing.map(|(vertex, edge)| {
            let [a, b] = edges[edge as usize];
            let to = if a == vertex { b } else { a };
            (vertices[to as usize] - vertices[vertex as usize]).normalize_or_zero()
        });
        let outgoing = outgoing.collect();
        let mut normals = vec![DVec3::ZERO; count];
        for (index, face) in faces.iter().enumerate() {
            let at = mesh.corners(index);
            for i in 0..3 {
                let (next, last) = (at[(i + 1) % 3] - at[i], at[(i + 2) % 3] - at[i]);
                normals[face.corners[i] as usize] += face.normal * next.angle_between(last);
            }
        }
        normals.iter_mut().for_each(|normal| *normal = normal.normalize_or(DVec3::Z));
        let exact = ExactDistance::new(mesh);
        let bound =
            |pick: fn(DVec3, DVec3) -> DVec3| vertices.iter().copied().reduce(pick).unwrap_or_default();
        let bounds = [bound(DVec3::min), bound(DVec3::max)];
        let size = 0.5 * bounds[0].distance(bounds[1]);
        let reach = vertices.iter().map(|vertex| vertex.length()).fold(0.0, f64::max);
        let mut made = Self {
            vertices: mesh.vertices().to_vec(),
            normals,
            faces,
            edges,
            sides,
            faces_around,
            edges_around,
            outgoing,
            exact,
            tree: FeatureTree::default(),
            is_closed: true,
            bounds,
            size,
            min_directed: MIN_DIRECTED * reach,
        };
        made.is_closed = made.sides.iter().all(|sides| sides[1] != NONE);
        made.tree = FeatureTree::new(&made);
        made
    }

    /// Lower and upper bounds, m.
    pub fn bounds(&self) -> [DVec3; 2] {
        self.bounds
    }

    /// Half of the diagonal of its bounds, m.
    pub fn size(&self) -> f64 {
        self.size
    }

    /// Whether the surface is not flat across an edge.
    fn is_sharp(&self, edge: u32) -> bool {
        let [a, b] = self.sides[edge as usize];
        b == NONE || self.faces[a as usize].normal.dot(self.faces[b as usize].normal) <= FLAT
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        size_of::<Self>()
            + (self.vertices.capacity() + self.normals.capacity() + self.outgoing.capacity())
                * size_of::<DVec3>()
            + self.faces.capacity() * size_of::<Face>()
            + (self.edges.capacity() + self.sides.capacity()) * size_of::<[u32; 2]>()
            + self.faces_around.bytes()
            + self.edges_around.bytes()
            + self.exact.bytes()
            + self.tree.bytes()
    }

    #[inline(always)]
    fn corners(&self, face: u32) -> [DVec3; 3] {
        let [a, b, c] = self.faces[face as usize].corners;
        [self.vertices[a as usize], self.vertices[b as usize], self.vertices[c as usize]]
    }

    /// The point of the surface nearest to a point (m), found from a face near it by a walk over neighbours.
    #[inline]
    pub fn walk(&self, p: DVec3, face: u32) -> ClosestPoint {
        self.over(p, face).unwrap_or_else(|| self.walk_over_faces(p, face))
    }

    fn walk_over_faces(&self, p: DVec3, face: u32) -> ClosestPoint {
        let at = |face: u32| {
            let (point, feature) = nearest_on_triangle(p, &self.corners(face));
            (point, feature, point.distance_squared(p))
        };
        let mut current = face;
        let (mut point, mut feature, mut squared) = at(face);
        for _ in 0..MAX_WALK {
            let (from, on, before) = (point, feature, squared);
            let Face { corners, neighbours, normal, .. } = &self.faces[current as usize];
            let mut visit = |candidate: u32| {
                let found = at(candidate);
                if found.2 < squared {
                    (point, feature, squared) = found;
                    current = candidate;
                }
            };
            match on {
                // From inside, a face next to it may be nearer without an edge between being so.
                TriangleFeature::Face if normal.dot(p - from) < 0.0 => {
                    let around = corners.iter().flat_map(|corner| self.faces_around.of(*corner));
                    around.for_each(|face| visit(*face));
                }
                TriangleFeature::Face => {}
                TriangleFeature::Side(edge) if neighbours[edge] == NONE => {}
                TriangleFeature::Side(edge) => {
                    // Not nearer than the edge on its own side of it.
                    let [start, end] = [edge, (edge + 1) % 3].map(|i| self.vertices[corners[i] as usize]);
                    let across = self.faces[neighbours[edge] as usize].normal;
                    if across == DVec3::ZERO || (end - start).cross(across).dot(p - from) > 0.0 {
                        visit(neighbours[edge]);
                    }
                }
                TriangleFeature::Corner(vertex) => {
                    let vertex = corners[vertex];
                    // If no edge leads nearer, no face between them does.
                    let outgoing = &self.outgoing[self.edges_around.range(vertex)];
                    if outgoing.iter().any(|outgoing| outgoing.dot(p - from) > 0.0) {
                        self.faces_around.of(vertex).iter().for_each(|face| visit(*face));
                    }
                }
            }
            if squared >= before {
                return self.conclude(p, current, point, feature, squared.sqrt());
            }
        }
        self.search(p)
    }

    /// What a walk ends at that starts at the nearest face of all.
    #[cold]
    fn search(&self, p: DVec3) -> ClosestPoint {
        let face = self.exact.nearest(p, 0).triangle;
        let (point, feature) = nearest_on_triangle(p, &self.corners(face));
        self.conclude(p, face, point, feature, point.distance(p))
    }

    /// The foot of a point on a face that it is over and outside of; a walk from there would end there.
    #[inline(always)]
    pub fn over(&self, p: DVec3, face: u32) -> Option<ClosestPoint> {
        let Face { normal, inward, .. } = self.faces[face as usize];
        let off = self.corners(face).map(|corner| p - corner);
        let distance = normal.dot(off[0]);
        let is_within = |edge: usize| inward[edge].dot(off[edge]) > 0.0;
        (distance >= 0.0 && is_within(0) && is_within(1) && is_within(2)).then(|| ClosestPoint {
            point: p - normal * distance,
            distance,
            normal,
            face,
            feature: MeshFeature::Face(face),
        })
    }

    /// The foot of a point on an edge that it is over and outside of: it is nearer than all else on the faces
    /// beside it. A walk from one of these would end there; the one given is named if it is one of them.
    #[inline]
    pub fn over_edge(&self, p: DVec3, edge: u32, face: u32) -> Option<ClosestPoint> {
        let [from, to] = self.ends(edge);
        let (along, off) = (to - from, p - from);
        let at = off.dot(along) / along.length_squared();
        let away = off - along * at;
        let distance = away.length();
        let sides = self.sides[edge as usize];
        let is_beside = |side: u32| {
            let face = &self.faces[side as usize];
            let is_beyond = face.inward_from(edge).is_some_and(|inward| inward.dot(away) <= 0.0);
            face.normal.dot(away) > 0.0 && is_beyond
        };
        let is_over = at > 0.0
            && at < 1.0
            && distance >= self.min_directed
            && sides.iter().all(|side| *side != NONE && is_beside(*side));
        is_over.then(|| ClosestPoint {
            point: from + along * at,
            distance,
            normal: away / distance,
            face: if sides[1] == face { face } else { sides[0] },
            feature: MeshFeature::Edge(edge),
        })
    }

    /// The place on an edge that is nearest to a line through two points (m), if that is inside of the edge
    /// and of the leash; `None` for an edge along the line, too.
    #[inline]
    pub fn place_nearest(&self, edge: u32, line: [DVec3; 2], leash: &Leash) -> Option<Place> {
        let ([at, _], _) = where_nearest(self.ends(edge), line)?;
        let is_within = |place: &Place| matches!(place, Place::Edge(..)) && leash.holds(self.position(place));
        (0.0..=1.0).contains(&at).then(|| self.on_edge(edge, at)).filter(is_within)
    }

    fn conclude(
        &self,
        p: DVec3,
        face: u32,
        point: DVec3,
        feature: TriangleFeature,
        distance: f64,
    ) -> ClosestPoint {
        let own = &self.faces[face as usize];
        let outward = match feature {
            TriangleFeature::Face => own.normal,
            TriangleFeature::Side(edge) => {
                let other = own.neighbours[edge];
                let across = if other == NONE { own.normal } else { self.faces[other as usize].normal };
                (own.normal + across).normalize_or(own.normal)
            }
            TriangleFeature::Corner(vertex) => self.normals[own.corners[vertex] as usize],
        };
        let sign = if outward.dot(p - point) < 0.0 { -1.0 } else { 1.0 };
        // Over a face the direction is the face's normal, at any distance.
        let normal = match feature {
            TriangleFeature::Face => outward,
            _ if distance >= self.min_directed => (p - point) * (sign / distance),
            _ => outward,
        };
        let feature = match feature {
            TriangleFeature::Face => MeshFeature::Face(face),
            TriangleFeature::Side(edge) => MeshFeature::Edge(own.edges[edge]),
            TriangleFeature::Corner(vertex) => MeshFeature::Vertex(own.corners[vertex]),
        };
        ClosestPoint { point, distance: sign * distance, normal, face, feature }
    }

    /// The point of the whole surface nearest to a point, m.
    pub fn nearest(&self, p: DVec3) -> ClosestPoint {
        self.walk(p, self.exact.nearest(p, 0).triangle)
    }

    /// The point of the whole surface nearest to a point, m, if it is nearer than a distance, m.
    pub fn nearer(&self, p: DVec3, distance: f64) -> Option<ClosestPoint> {
        self.exact.nearer(p, distance).map(|face| self.walk(p, face))
    }

    /// How far a direction, a unit vector, is outside of the normals that a feature can have: the sine of the
    /// steepest slope with which the surface beside the feature goes on along the direction. At most 0
    /// inside, and on a face 0 for its normal alone.
    ///
    /// The normals of a convex edge are those between the normals of the faces beside it, and those of a
    /// convex vertex the cone of its faces'. A concave edge has none.
    #[inline]
    pub fn rise(&self, feature: MeshFeature, direction: DVec3) -> f64 {
        match feature {
            MeshFeature::Face(face) => self.faces[face as usize].normal.cross(direction).length(),
            MeshFeature::Vertex(vertex) => -self.steepest(vertex, -direction),
            MeshFeature::Edge(edge) => {
                let [from, to] = self.ends(edge);
                let along = to - from;
                let mut rise = direction.dot(along).abs();
                for &face in self.sides[edge as usize].iter().filter(|face| **face != NONE) {
                    // As long as the edge.
                    if let Some(inward) = self.faces[face as usize].inward_from(edge) {
                        rise = rise.max(direction.dot(*inward));
                    }
                }
                rise / along.length()
            }
        }
    }

    /// A point of the surface up to a `reach` (m) away from a point on an edge or a vertex: on the way to
    /// that vertex of the faces beside it to which it rises most along a direction; on a face, the point
    /// itself.
    pub fn beside(&self, feature: MeshFeature, point: DVec3, direction: DVec3, reach: f64) -> DVec3 {
        let corner = |vertex: u32| self.vertices[vertex as usize] - point;
        let slope = |way: &DVec3| direction.dot(*way) / way.length();
        let ways = |vertices: &mut dyn Iterator<Item = u32>| {
            let ways = vertices.map(corner).filter(|way| *way != DVec3::ZERO);
            ways.max_by(|a, b| slope(a).total_cmp(&slope(b)))
        };
        let way = match feature {
            MeshFeature::Face(_) => None,
            MeshFeature::Vertex(vertex) => ways(&mut self.edges_around.of(vertex).iter().map(|edge| {
                let [from, to] = self.edges[*edge as usize];
                if from == vertex { to } else { from }
            })),
            MeshFeature::Edge(edge) => {
                let sides = self.sides[edge as usize].into_iter().filter(|face| *face != NONE);
                ways(&mut sides.flat_map(|face| self.faces[face as usize].corners))
            }
        };
        point + way.map_or(DVec3::ZERO, |way| way.clamp_length_max(reach))
    }

    /// Cosine of the angle between a direction, a unit vector, and the nearest of the normals of the faces
    /// beside a feature.
    #[inline]
    pub fn facing(&self, feature: MeshFeature, direction: DVec3) -> f64 {
        direction.dot(self.normal_near(feature, direction))
    }

    /// How sharp a feature is: 0 on a flat part of the surface. For an edge the sine of the angle between the
    /// normals of its faces, for a vertex that of its steepest edge to its tangent plane.
    pub fn sharpness(&self, feature: MeshFeature) -> f64 {
        match feature {
            MeshFeature::Face(_) => 0.0,
            MeshFeature::Edge(edge) => {
                let [a, b] = self.sides[edge as usize];
                let normal = |face: u32| self.faces[face as usize].normal;
                if b == NONE { 1.0 } else { normal(a).cross(normal(b)).length() }
            }
            MeshFeature::Vertex(vertex) => {
                let normal = self.normals[vertex as usize];
                let outgoing = &self.outgoing[self.edges_around.range(vertex)];
                outgoing.iter().fold(0.0, |most, outgoing| outgoing.dot(normal).abs().max(most))
            }
        }
    }

    /// Distance of a point from those edges of a face, and of those around its corners, that are sharper than
    /// `least`, m; infinite without any.
    pub fn to_sharp_edge(&self, face: u32, p: DVec3, least: f64) -> f64 {
        let corners = self.edges_of(face).into_iter().flat_map(|edge| self.edges[edge as usize]);
        let edges = corners.flat_map(|corner| self.edges_around.of(corner));
        let sharp = edges.filter(|edge| self.sharpness(MeshFeature::Edge(**edge)) >= least);
        let apart = sharp.map(|edge| {
            let [from, to] = self.ends(*edge);
            from.lerp(to, self.along(*edge, p)).distance(p)
        });
        apart.fold(f64::INFINITY, f64::min)
    }

    /// The edges of a face.
    pub fn edges_of(&self, face: u32) -> [u32; 3] {
        self.faces[face as usize].edges
    }

    /// A face beside a feature.
    pub fn face_at(&self, feature: MeshFeature) -> u32 {
        match feature {
            MeshFeature::Face(face) => face,
            MeshFeature::Edge(edge) => self.sides[edge as usize][0],
            MeshFeature::Vertex(vertex) => self.faces_around.of(vertex).first().copied().unwrap_or(0),
        }
    }

    /// That of the normals of the faces beside a feature that is nearest to a direction, a unit vector.
    pub fn normal_near(&self, feature: MeshFeature, direction: DVec3) -> DVec3 {
        let normal = |face: u32| self.faces[face as usize].normal;
        let nearer = |a: DVec3, b: DVec3| if b.dot(direction) > a.dot(direction) { b } else { a };
        match feature {
            MeshFeature::Face(face) => normal(face),
            MeshFeature::Edge(edge) => {
                let sides = self.sides[edge as usize].into_iter().filter(|face| *face != NONE);
                sides.map(normal).reduce(nearer).unwrap_or_default()
            }
            MeshFeature::Vertex(vertex) => self
                .faces_around
                .of(vertex)
                .iter()
                .map(|face| normal(*face))
                .reduce(nearer)
                .unwrap_or_default(),
        }
    }

    /// A direction out of the surface at an edge, between the normals of its faces.
    pub fn out_of(&self, edge: u32) -> DVec3 {
        let sides = self.sides[edge as usize].iter().filter(|face| **face != NONE);
        sides.map(|face| self.faces[*face as usize].normal).sum()
    }

    /// The place on vertices and edges nearest to a point of the surface, m.
    pub fn place_near(&self, p: DVec3) -> Place {
        self.place_beside(self.exact.nearest(p, 0).triangle, p)
    }

    /// The place on the vertices and edges of a face nearest to a point, m.
    pub fn place_beside(&self, face: u32, p: DVec3) -> Place {
        self.place_on(&self.faces[face as usize].edges, p)
    }

    /// The place on edges nearest to a point, m.
    fn place_on(&self, edges: &[u32], p: DVec3) -> Place {
        let mut best = (f64::INFINITY, Place::Vertex(0));
        for &edge in edges {
            let place = self.on_edge(edge, self.along(edge, p));
            let squared = self.position(&place).distance_squared(p);
            if squared < best.0 {
                best = (squared, place);
            }
        }
        best.1
    }

    /// The place of an edge at a fraction of its length, 0 to 1.
    pub fn place_at(&self, edge: u32, at: f64) -> Place {
        self.on_edge(edge, at)
    }

    /// The vertices next to a vertex, or those at the ends of an edge.
    pub fn vertices_beside(&self, place: Place) -> impl Iterator<Item = u32> {
        let (around, ends): (&[u32], _) = match place {
            Place::Vertex(vertex) => (self.edges_around.of(vertex), None),
            Place::Edge(edge, _) => (&[], Some(self.edges[edge as usize])),
        };
        let of = match place {
            Place::Vertex(vertex) => vertex,
            Place::Edge(..) => NONE,
        };
        let across = around.iter().map(move |edge| {
            let [a, b] = self.edges[*edge as usize];
            if a == of { b } else { a }
        });
        across.chain(ends.into_iter().flatten())
    }

    /// Position of a place, m.
    #[inline]
    pub fn position(&self, place: &Place) -> DVec3 {
        match *place {
            Place::Vertex(vertex) => self.vertices[vertex as usize],
            Place::Edge(edge, at) => {
                let [from, to] = self.ends(edge);
                from + (to - from) * f64::from(at)
            }
        }
    }

    /// Ends of an edge, m.
    pub fn ends(&self, edge: u32) -> [DVec3; 2] {
        self.edges[edge as usize].map(|end| self.vertices[end as usize])
    }

    /// Fraction of an edge at which it is nearest to a point, 0 to 1.
    fn along(&self, edge: u32, p: DVec3) -> f64 {
        let [from, to] = self.ends(edge);
        let along = to - from;
        ((p - from).dot(along) / along.length_squared()).clamp(0.0, 1.0)
    }

    /// The place at a fraction of an edge: a vertex at its ends.
    fn on_edge(&self, edge: u32, at: f64) -> Place {
        let [from, to] = self.edges[edge as usize];
        let at = at as f32;
        if at <= 0.0 {
            Place::Vertex(from)
        } else if at >= 1.0 {
            Place::Vertex(to)
        } else {
            Place::Edge(edge, at)
        }
    }

    /// Whether a place is a local minimum: [`Self::descend`] then leads nowhere from it.
    #[inline(always)]
    pub fn is_lowest(&self, place: &Place, normal: DVec3, stride: f64, leash: &Leash) -> bool {
        match *place {
            Place::Vertex(vertex) => !is_down(self.steepest(vertex, normal)),
            Place::Edge(edge, at) => self.descend_edge((edge, at), normal, stride, leash).is_none(),
        }
    }

    /// The least slope along the edges around a vertex, for a gradient there.
    #[inline(always)]
    fn steepest(&self, vertex: u32, normal: DVec3) -> f64 {
        self.outgoing[self.edges_around.range(vertex)].iter().fold(f64::INFINITY, |steepest, outgoing| {
            let slope = normal.dot(*outgoing);
            if slope < steepest { slope } else { steepest }
        })
    }

    /// A place further down on the way to the one that is nearest to another surface, or `None` if this is a
    /// local minimum. `normal` is the gradient of the distance from the other surface at the place, in this
    /// mesh's frame; `stride` is the fraction of the way along an edge.
    #[inline]
    pub fn descend(&self, place: &Place, normal: DVec3, stride: f64, leash: &Leash) -> Option<Place> {
        match *place {
            Place::Edge(edge, at) => self.descend_edge((edge, at), normal, stride, leash),
            Place::Vertex(vertex) => {
                let around = self.edges_around.range(vertex);
                let edges = &self.edges_around.entries[around.clone()];
                // Along the steepest edge the leash may end near the vertex, and go on along another one.
                let mut best = (0.0, None);
                for (outgoing, &edge) in self.outgoing[around].iter().zip(edges) {
                    let slope = normal.dot(*outgoing);
                    if !is_down(slope) || slope >= best.0 {
                        continue;
                    }
                    let (at, end) =
                        if self.edges[edge as usize][0] == vertex { (0.0, 1.0) } else { (1.0, 0.0) };
                    let way = self.leashed(edge, end, leash) - at;
                    let next = at + way * stride;
                    if slope * way.abs() < best.0 && (next - at).abs() > MIN_STEP {
                        best = (slope * way.abs(), Some(self.on_edge(edge, next)));
                    }
                }
                best.1
            }
        }
    }

    /// The same for a place on an edge. Not inlined: most places that are asked for are vertices.
    #[inline(never)]
    fn descend_edge(
        &self,
        (edge, at): (u32, f32),
        normal: DVec3,
        stride: f64,
        leash: &Leash,
    ) -> Option<Place> {
        let at = f64::from(at);
        let [from, to] = self.ends(edge);
        let along = to - from;
        let rise = normal.dot(along);
        if rise * rise > MIN_SLOPE * MIN_SLOPE * along.length_squared() {
            let way = self.leashed(edge, if rise > 0.0 { 0.0 } else { 1.0 }, leash) - at;
            let step = way * stride;
            if step.abs() > MIN_STEP {
                return Some(self.on_edge(edge, at + step));
            }
            // Near the end the first stride may be shorter than a step, and the end is lower all the same.
            if stride >= Self::MIN_STRIDE && way.abs() > MIN_STEP {
                return Some(self.on_edge(edge, at + way));
            }
        }
        self.across_a_face(edge, at, normal, leash)
    }

    /// The place on another edge of a face beside an edge that is straight down from there.
    fn across_a_face(&self, edge: u32, at: f64, normal: DVec3, leash: &Leash) -> Option<Place> {
        let [from, to] = self.ends(edge);
        let position = from + (to - from) * at;
        let mut best = (-MIN_SLOPE, None);
        for &face in self.sides[edge as usize].iter().filter(|face| **face != NONE) {
            let face = &self.faces[face as usize];
            let Face { edges, normal: outward, .. } = face;
            // Down may be out of the face, as at the lowest edge of a wall.
            if face.inward_from(edge).is_some_and(|inward| inward.dot(normal) >= 0.0) {
                continue;
            }
            let down = -normal.reject_from(*outward);
            if down.length_squared() <= MIN_SLOPE * MIN_SLOPE {
                continue;
            }
            // The wall through the place along `down` and the face's normal.
            let across = down.cross(*outward);
            for &other in edges.iter().filter(|other| **other != edge) {
                let [a, b] = self.ends(other);
                let (before, after) = (across.dot(a - position), across.dot(b - position));
                if before * after > 0.0 || before == after {
                    continue;
                }
                let place = self.on_edge(other, before / (before - after));
                let there = self.position(&place) - position;
                let slope = normal.dot(there) / there.length();
                if slope < best.0 {
                    best = (slope, Some(place));
                }
            }
        }
        best.1.filter(|place| leash.holds(self.position(place)))
    }

    /// A fraction of an edge, moved to where the edge is within a leash.
    fn leashed(&self, edge: u32, at: f64, leash: &Leash) -> f64 {
        let [from, to] = self.ends(edge);
        let (along, off) = (to - from, from - leash.home);
        if (off + along * at).length_squared() <= f64::from(leash.length).powi(2) {
            return at;
        }
        let (square, half) = (along.length_squared(), along.dot(off));
        let root = half * half - square * (off.length_squared() - f64::from(leash.length).powi(2));
        let middle = -half / square;
        let reach = root.max(0.0).sqrt() / square;
        at.clamp((middle - reach).clamp(0.0, 1.0), (middle + reach).clamp(0.0, 1.0))
    }
}

#[cfg(test)]
mod tests;
