//! Closed solids of flat faces, whose triangulation is drawn at random while their shape stays the same.
//!
//! Each solid knows the convex pieces that it is the union of, so that its shape can be judged without its
//! triangles.

use std::collections::HashMap;
use std::f64::consts::TAU;

use palpate::glam::{DVec2, DVec3};
use palpate::{Object, TriMesh};
use rand::RngExt as _;
use rand::rngs::StdRng;

/// Smallest altitude of a triangle relative to its longest side, and smallest side relative to the solid's
/// size, below which a triangle is not divided further.
const SLIMMEST: f64 = 4e-3;
const SHORTEST: f64 = 2e-3;
/// Cosine of the angle between two triangles up to which their common edge may be turned.
const SAME_PLANE: f64 = 1.0 - 1e-13;

/// Closed solid.
#[derive(Clone, Debug, Default)]
pub struct Solid {
    pub vertices: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    /// Corners of convex pieces whose union is the solid.
    pub pieces: Vec<Vec<DVec3>>,
}

/// Division of a solid's triangles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tessellation {
    /// Times that each triangle is divided into four.
    pub quarters: u32,
    /// Number of places at which an edge or a triangle is divided, and share of them that are given to the
    /// largest of some triangles in place of any.
    pub splits: usize,
    pub evenness: f64,
    /// Distance of divisions from the ends of edges, relative to the edge: small ones make slivers.
    pub margin: f64,
}

impl Solid {
    /// Returns the solid that is bounded by loops, from the lowest to the highest. A loop is a point or
    /// has as many points as the others, counter-clockwise as seen from above. The first and the last, where
    /// they are not points, are flat, and are divided at random. The solid is convex, unless its `pieces` are
    /// set.
    pub fn loft(loops: &[Vec<DVec3>], rng: &mut StdRng) -> Self {
        let mut solid = Self::sides(loops, false);
        solid.pieces = vec![solid.vertices.clone()];
        let count = solid.vertices.len() as u32;
        for (first, upward) in [(loops.first(), false), (loops.last(), true)] {
            let Some(points) = first.filter(|points| points.len() > 2) else { continue };
            let start = if upward { count - points.len() as u32 } else { 0 };
            for [a, b, c] in divided(points, rng) {
                let corner = [start + a, start + b, start + c];
                solid.triangles.push(if upward { corner } else { [corner[2], corner[1], corner[0]] });
            }
        }
        solid
    }

    /// Returns the ring that is bounded by sections around the z axis, each counter-clockwise as seen against
    /// the direction of the turn. The part between two sections is convex.
    fn ring(sections: &[Vec<DVec3>]) -> Self {
        let mut solid = Self::sides(sections, true);
        let following = |index: usize| &sections[(index + 1) % sections.len()];
        solid.pieces = (0..sections.len()).map(|it| [&sections[it][..], following(it)].concat()).collect();
        solid
    }

    fn sides(loops: &[Vec<DVec3>], closed: bool) -> Self {
        let starts: Vec<u32> = loops
            .iter()
            .scan(0, |next, points| {
                let start = *next;
                *next += points.len() as u32;
                Some(start)
            })
            .collect();
        let mut triangles = Vec::new();
        for low in 0..loops.len() - usize::from(!closed) {
            let high = (low + 1) % loops.len();
            let count = loops[low].len().max(loops[high].len());
            let at = |index: usize, corner: usize| starts[index] + (corner % loops[index].len()) as u32;
            for corner in 0..count {
                let [a, b] = [at(low, corner), at(low, corner + 1)];
                let [c, d] = [at(high, corner + 1), at(high, corner)];
                triangles.extend(
                    [[a, b, c], [a, c, d]].into_iter().filter(|[a, b, c]| a != b && b != c && a != c),
                );
            }
        }
        Self { vertices: loops.concat(), triangles, pieces: Vec::new() }
    }

    /// Returns a prism along z about the origin.
    pub fn prism(section: &[DVec2], height: f64, rng: &mut StdRng) -> Self {
        let at = |z: f64| section.iter().map(|point| point.extend(z)).collect::<Vec<_>>();
        Self::loft(&[at(-0.5 * height), at(0.5 * height)], rng)
    }

    pub fn block(half: DVec3, rng: &mut StdRng) -> Self {
        Self::prism(&rectangle(half.truncate()), 2.0 * half.z, rng)
    }

    /// Returns a body of revolution of a profile from its lowest point (radius, height) to its highest.
    /// Points on the axis are its poles; circles are polygons of `corners`.
    pub fn turned(profile: &[DVec2], corners: usize, rng: &mut StdRng) -> Self {
        let around = |point: &DVec2| match point.x {
            0.0 => vec![DVec3::Z * point.y],
            radius => polygon(corners, radius).iter().map(|corner| corner.extend(point.y)).collect(),
        };
        Self::loft(&profile.iter().map(around).collect::<Vec<_>>(), rng)
    }

    pub fn ball(radius: f64, rings: usize, corners: usize, rng: &mut StdRng) -> Self {
        let at = |ring: usize| match ring {
            0 => DVec2::new(0.0, -radius),
            ring if ring == rings => DVec2::new(0.0, radius),
            ring => DVec2::from_angle((ring as f64 / rings as f64 - 0.5) * 0.5 * TAU) * radius,
        };
        Self::turned(&(0..=rings).map(at).collect::<Vec<_>>(), corners, rng)
    }

    /// Returns a ring about the z axis whose section is a polygon: a torus, or a tube. `section` has the
    /// distance from the axis and the height, counter-clockwise.
    pub fn turned_ring(section: &[DVec2], corners: usize) -> Self {
        let at = |corner: usize| {
            let out = DVec2::from_angle(TAU * corner as f64 / corners as f64);
            section.iter().rev().map(|point| (out * point.x).extend(point.y)).collect()
        };
        Self::ring(&(0..corners).map(at).collect::<Vec<_>>())
    }

    /// Returns a channel along x with its floor at z = 0: half its length, half its inner width, the
    /// thickness of its walls, and their height.
    pub fn channel(length: f64, inner: f64, wall: f64, height: f64, rng: &mut StdRng) -> Self {
        let outer = inner + wall;
        let section = [
            [-outer, -wall],
            [outer, -wall],
            [outer, height],
            [inner, height],
            [inner, 0.0],
            [-inner, 0.0],
            [-inner, height],
            [-outer, height],
        ];
        // The section's y and z: seen from above, along −x, it is counter-clockwise.
        let at = |x: f64| section.iter().map(|[y, z]| DVec3::new(x, *y, *z)).collect::<Vec<_>>();
        let mut solid = Self::loft(&[at(-length), at(length)], rng);
        let part = |low: DVec2, high: DVec2| {
            let corners = [low, DVec2::new(high.x, low.y), high, DVec2::new(low.x, high.y)];
            [-length, length].iter().flat_map(|x| corners.map(|c| DVec3::new(*x, c.x, c.y))).collect()
        };
        solid.pieces = vec![
            part(DVec2::new(-outer, -wall), DVec2::new(outer, 0.0)),
            part(DVec2::new(-outer, -wall), DVec2::new(-inner, height)),
            part(DVec2::new(inner, -wall), DVec2::new(outer, height)),
        ];
        solid
    }

    /// Returns both solids as one, which must not touch each other.
    #[must_use]
    pub fn and(mut self, other: &Self) -> Self {
        let count = self.vertices.len() as u32;
        self.vertices.extend_from_slice(&other.vertices);
        self.triangles.extend(other.triangles.iter().map(|corners| corners.map(|corner| corner + count)));
        self.pieces.extend_from_slice(&other.pieces);
        self
    }

    /// Returns the solid with its points mapped, by a map that keeps faces flat and the orientation.
    #[must_use]
    pub fn mapped(mut self, map: impl Fn(DVec3) -> DVec3) -> Self {
        let points = self.vertices.iter_mut().chain(self.pieces.iter_mut().flatten());
        points.for_each(|point| *point = map(*point));
        self
    }

    /// Returns the largest distance of a point from the origin, m.
    pub fn radius(&self) -> f64 {
        self.vertices.iter().map(|point| point.length()).fold(0.0, f64::max)
    }

    /// Returns the smallest and the largest coordinates, m.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        let all = || self.vertices.iter().copied();
        (all().fold(DVec3::INFINITY, DVec3::min), all().fold(DVec3::NEG_INFINITY, DVec3::max))
    }

    /// Returns the solid about the middle of its bounds, with a radius about it.
    #[must_use]
    pub fn of_radius(self, radius: f64) -> Self {
        let (low, high) = self.bounds();
        let solid = self.mapped(|point| point - 0.5 * (low + high));
        let scale = radius / solid.radius();
        solid.mapped(|point| point * scale)
    }

    pub fn mesh(&self) -> Result<TriMesh, String> {
        TriMesh::new(self.vertices.clone(), self.triangles.clone()).map_err(|error| error.to_string())
    }

    /// Builds the object.
    ///
    /// # Errors
    /// If the mesh is refused.
    pub fn object(&self, name: &str) -> Result<Object, String> {
        Object::from_mesh(name, &self.mesh()?).map_err(|error| error.to_string())
    }

    /// Divides the triangles. The surface stays the same.
    #[must_use]
    pub fn tessellated(self, tessellation: &Tessellation, rng: &mut StdRng) -> Self {
        let mut division = Division::new(self);
        for _ in 0..tessellation.quarters {
            division = Division::new(division.quartered());
        }
        let shortest = SHORTEST * division.solid.radius();
        for _ in 0..tessellation.splits {
            let candidates = if rng.random_bool(tessellation.evenness) { 6 } else { 1 };
            let count = division.solid.triangles.len();
            let place = (0..candidates)
                .map(|_| rng.random_range(0..count))
                .max_by(|a, b| division.area(*a).total_cmp(&division.area(*b)));
            let (Some(triangle), margin) = (place, tessellation.margin) else { continue };
            match rng.random_range(0..5) {
                0 | 1 => division.split_edge(triangle, rng.random_range(0..3), margin, shortest, rng),
                2 => division.split_face(triangle, margin, shortest, rng),
                _ => division.flip(triangle, rng.random_range(0..3), shortest),
            }
        }
        division.solid
    }
}

/// Returns the corners of a regular polygon, counter-clockwise.
pub fn polygon(corners: usize, radius: f64) -> Vec<DVec2> {
    (0..corners).map(|corner| DVec2::from_angle(TAU * corner as f64 / corners as f64) * radius).collect()
}

pub fn rectangle(half: DVec2) -> Vec<DVec2> {
    vec![DVec2::new(-half.x, -half.y), DVec2::new(half.x, -half.y), half, DVec2::new(-half.x, half.y)]
}

/// Divides a flat polygon into triangles, by cutting off its ears in a random order.
fn divided(points: &[DVec3], rng: &mut StdRng) -> Vec<[u32; 3]> {
    let normal = (0..points.len()).fold(DVec3::ZERO, |sum, at| {
        sum + (points[at] - points[0]).cross(points[(at + 1) % points.len()] - points[0])
    });
    let turn = |a: u32, b: u32, c: u32| {
        let [a, b, c] = [a, b, c].map(|corner| points[corner as usize]);
        (b - a).cross(c - a).dot(normal)
    };
    let least = 1e-9 * normal.length_squared() / (points.len() * points.len()) as f64;
    let mut left: Vec<u32> = (0..points.len() as u32).collect();
    let mut triangles = Vec::new();
    while left.len() > 2 {
        let count = left.len();
        let ear = |at: usize| [left[(at + count - 1) % count], left[at], left[(at + 1) % count]];
        let is_ear = |at: &usize| {
            let [a, b, c] = ear(*at);
            let holds = |p: u32| turn(a, b, p) >= 0.0 && turn(b, c, p) >= 0.0 && turn(c, a, p) >= 0.0;
            turn(a, b, c) > least && !left.iter().any(|p| ![a, b, c].contains(p) && holds(*p))
        };
        let ears: Vec<usize> = (0..count).filter(is_ear).collect();
        // A simple polygon has two.
        let Some(at) = ears.get(rng.random_range(0..ears.len().max(1))).copied() else { break };
        triangles.push(ear(at));
        left.remove(at);
    }
    triangles
}

/// A solid with the triangle on each side of its edges.
struct Division {
    solid: Solid,
    /// Triangle by the ends of its side, in its order.
    sides: HashMap<[u32; 2], usize>,
}

impl Division {
    fn new(solid: Solid) -> Self {
        let mut division = Self { sides: HashMap::new(), solid };
        (0..division.solid.triangles.len()).for_each(|triangle| division.note(triangle));
        division
    }

    fn note(&mut self, triangle: usize) {
        let [a, b, c] = self.solid.triangles[triangle];
        self.sides.extend([([a, b], triangle), ([b, c], triangle), ([c, a], triangle)]);
    }

    fn points(&self, corners: [u32; 3]) -> [DVec3; 3] {
        corners.map(|corner| self.solid.vertices[corner as usize])
    }

    fn normal(&self, corners: [u32; 3]) -> DVec3 {
        let [a, b, c] = self.points(corners);
        (b - a).cross(c - a)
    }

    fn area(&self, triangle: usize) -> f64 {
        0.5 * self.normal(self.solid.triangles[triangle]).length()
    }

    /// Returns whether triangles are neither too slim nor too small.
    fn fit(&self, triangles: &[[u32; 3]], shortest: f64) -> bool {
        triangles.iter().all(|corners| {
            let [a, b, c] = self.points(*corners);
            let sides = [a.distance(b), b.distance(c), c.distance(a)];
            let longest = sides.into_iter().fold(0.0, f64::max);
            let altitude = self.normal(*corners).length() / longest;
            altitude > SLIMMEST * longest && sides.into_iter().all(|side| side > shortest)
        })
    }

    /// Replaces triangles by at least as many others, if these are fit; else removes a new vertex.
    fn replace(&mut self, places: &[usize], by: &[[u32; 3]], shortest: f64, vertices: usize) {
        if !self.fit(by, shortest) {
            self.solid.vertices.truncate(vertices);
            return;
        }
        for place in places {
            let [a, b, c] = self.solid.triangles[*place];
            for side in [[a, b], [b, c], [c, a]] {
                self.sides.remove(&side);
            }
        }
        for (index, corners) in by.iter().enumerate() {
            let place = places.get(index).copied().unwrap_or(self.solid.triangles.len());
            if place == self.solid.triangles.len() {
                self.solid.triangles.push(*corners);
            } else {
                self.solid.triangles[place] = *corners;
            }
            self.note(place);
        }
    }

    /// Returns a side of a triangle with the corners opposite to it on both sides, and the other triangle.
    fn across(&self, triangle: usize, side: usize) -> Option<([u32; 4], usize)> {
        let corners = self.solid.triangles[triangle];
        let [a, b, c] = [0, 1, 2].map(|corner| corners[(side + corner) % 3]);
        let other = *self.sides.get(&[b, a])?;
        let far = self.solid.triangles[other].into_iter().find(|corner| *corner != a && *corner != b)?;
        Some(([a, b, c, far], other))
    }

    fn split_edge(&mut self, triangle: usize, side: usize, margin: f64, shortest: f64, rng: &mut StdRng) {
        let Some(([a, b, c, far], other)) = self.across(triangle, side) else { return };
        let at = rng.random_range(margin..=1.0 - margin);
        let ends = self.points([a, b, c]);
        let new = self.solid.vertices.len();
        self.solid.vertices.push(ends[0].lerp(ends[1], at));
        let middle = new as u32;
        let by = [[a, middle, c], [a, far, middle], [middle, b, c], [far, b, middle]];
        self.replace(&[triangle, other], &by, shortest, new);
    }

    fn split_face(&mut self, triangle: usize, margin: f64, shortest: f64, rng: &mut StdRng) {
        let corners = self.solid.triangles[triangle];
        let [a, b, c] = self.points(corners);
        let [u, v] = [(); 2].map(|()| rng.random_range(margin..=1.0 - margin));
        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
        let new = self.solid.vertices.len();
        self.solid.vertices.push(a + (b - a) * u + (c - a) * v);
        let [[a, b, c], m] = [corners, [new as u32; 3]];
        self.replace(&[triangle], &[[a, b, m[0]], [b, c, m[0]], [c, a, m[0]]], shortest, new);
    }

    /// Turns the edge between two triangles of one plane.
    fn flip(&mut self, triangle: usize, side: usize, shortest: f64) {
        let Some(([a, b, c, far], other)) = self.across(triangle, side) else { return };
        let (normal, beyond) = (self.normal([a, b, c]), self.normal([b, a, far]));
        let by = [[c, a, far], [far, b, c]];
        let is_flat = |turned: DVec3| turned.dot(normal) > SAME_PLANE * turned.length() * normal.length();
        let is_convex = by.iter().all(|corners| is_flat(self.normal(*corners)));
        if is_flat(beyond) && is_convex && !self.sides.contains_key(&[c, far]) {
            let vertices = self.solid.vertices.len();
            self.replace(&[triangle, other], &by, shortest, vertices);
        }
    }

    /// Divides each triangle into four.
    fn quartered(mut self) -> Solid {
        let mut middles = HashMap::new();
        let triangles = std::mem::take(&mut self.solid.triangles);
        for [a, b, c] in triangles {
            let [ab, bc, ca] = [[a, b], [b, c], [c, a]].map(|[from, to]| {
                *middles.entry([from.min(to), from.max(to)]).or_insert_with(|| {
                    let [from, to] = [from, to].map(|end| self.solid.vertices[end as usize]);
                    self.solid.vertices.push(0.5 * (from + to));
                    self.solid.vertices.len() as u32 - 1
                })
            });
            self.solid.triangles.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        self.solid
    }
}

#[cfg(test)]
mod tests {
    use palpate::glam::DQuat;
    use rand::SeedableRng as _;

    use super::*;

    fn solids(rng: &mut StdRng) -> Vec<(&'static str, Solid, f64)> {
        let section = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
        let section = section.map(|[x, y]| DVec2::new(3.0 + 0.5 * x, 0.5 * y));
        let tube = 8.0 * 0.5 * (TAU / 8.0).sin() * (3.5_f64.powi(2) - 2.5_f64.powi(2));
        let circle: Vec<DVec2> = polygon(6, 1.0).iter().map(|point| *point + DVec2::new(3.0, 0.0)).collect();
        // By Pappus, with the regular polygon in place of the circle that the middle goes around.
        let torus = 16.0 * (TAU / 16.0).sin() * 0.5 * 6.0 * 0.5 * (TAU / 6.0).sin() * 2.0 * 3.0;
        vec![
            ("block", Solid::block(DVec3::new(1.0, 2.0, 3.0), rng), 48.0),
            ("prism", Solid::prism(&polygon(3, 1.0), 2.0, rng), 2.0 * 0.75 * 3.0_f64.sqrt()),
            ("cone", Solid::turned(&[DVec2::new(0.0, -3.0), DVec2::new(1.0, 0.0)], 4, rng), 2.0),
            ("tube", Solid::turned_ring(&section, 8), tube),
            ("torus", Solid::turned_ring(&circle, 16), torus),
            ("channel", Solid::channel(2.0, 1.0, 0.5, 1.0, rng), 4.0 * (1.5 + 2.0 * 0.5)),
        ]
    }

    /// However a solid is divided, it stays closed, and its volume the same.
    #[test]
    fn triangulations_of_a_solid_bound_the_same_volume() {
        let mut rng = StdRng::seed_from_u64(1);
        for (name, solid, volume) in solids(&mut rng) {
            for (quarters, splits, margin) in [(0, 0, 0.1), (0, 300, 0.02), (1, 60, 0.3), (2, 0, 0.3)] {
                let how = Tessellation { quarters, splits, evenness: 0.5, margin };
                let mesh = solid.clone().tessellated(&how, &mut rng).mesh().expect("a mesh");
                assert!(mesh.validate().is_solid(), "{name} {how:?}: {:?}", mesh.validate());
                let measured = mesh.mass_properties(1.0).expect("a volume").mass;
                assert!((measured - volume).abs() < 1e-9 * volume, "{name} {how:?}: {measured} of {volume}");
                assert!(splits == 0 || mesh.triangles().len() > 80, "{name}: divided");
            }
        }
    }

    /// The pieces are the solid: points drawn at random are in a piece where they are in the mesh, by the
    /// number of times that a ray crosses it.
    #[test]
    fn the_pieces_are_the_solid() {
        let mut rng = StdRng::seed_from_u64(2);
        for (name, solid, volume) in solids(&mut rng) {
            let (low, high) = solid.bounds();
            let turn = DQuat::from_euler(palpate::glam::EulerRot::XYZ, 0.3, 0.5, 0.7);
            let pieces: Vec<TriMesh> = solid.pieces.iter().map(|piece| hull(piece)).collect();
            let parts: f64 = pieces.iter().map(|it| it.mass_properties(1.0).expect("a volume").mass).sum();
            // Those of a channel overlap below its walls.
            let doubled = if name == "channel" { 4.0 * 2.0 * 0.25 } else { 0.0 };
            assert!((parts - doubled - volume).abs() < 1e-9 * volume, "{name}: {parts} of {volume}");
            let mesh = solid.mesh().expect("a mesh");
            for _ in 0..300 {
                let unit = DVec3::from_array([(); 3].map(|()| rng.random_range(0.0..1.0)));
                let point = low + unit * (high - low);
                let inside = crossings(&mesh, point, turn * DVec3::X) % 2 == 1;
                let held = pieces.iter().any(|piece| crossings(piece, point, turn * DVec3::X) % 2 == 1);
                assert_eq!(inside, held, "{name} at {point}");
            }
        }
    }

    /// Convex hull of a few points, by all their planes.
    fn hull(points: &[DVec3]) -> TriMesh {
        let mut triangles = Vec::new();
        let mut planes: Vec<(DVec3, f64)> = Vec::new();
        let count = points.len();
        for (a, b, c) in (0..count)
            .flat_map(|a| (0..count).flat_map(move |b| (0..count).map(move |c| (a, b, c))))
            .filter(|(a, b, c)| a < b && b < c)
        {
            let normal = (points[b] - points[a]).cross(points[c] - points[a]);
            let Some(normal) = normal.try_normalize() else { continue };
            for normal in [normal, -normal] {
                let height = normal.dot(points[a]);
                let known =
                    planes.iter().any(|(n, h)| n.distance(normal) < 1e-9 && (h - height).abs() < 1e-9);
                if known || points.iter().any(|point| normal.dot(*point) > height + 1e-9) {
                    continue;
                }
                planes.push((normal, height));
                let middle = |of: &[usize]| of.iter().map(|at| points[*at]).sum::<DVec3>() / of.len() as f64;
                let mut face: Vec<usize> =
                    (0..count).filter(|at| (normal.dot(points[*at]) - height).abs() < 1e-9).collect();
                let (center, first) = (middle(&face), points[face[0]]);
                let (u, v) = ((first - center), normal.cross(first - center));
                let angle = |at: &usize| {
                    let out = points[*at] - center;
                    out.dot(v).atan2(out.dot(u))
                };
                face.sort_by(|x, y| angle(x).total_cmp(&angle(y)));
                triangles.extend(
                    (1..face.len() - 1).map(|at| [face[0] as u32, face[at] as u32, face[at + 1] as u32]),
                );
            }
        }
        TriMesh::new(points.to_vec(), triangles).expect("a mesh")
    }

    /// Number of triangles that a ray crosses.
    fn crossings(mesh: &TriMesh, from: DVec3, along: DVec3) -> usize {
        let crosses = |triangle: &usize| {
            let [a, b, c] = mesh.corners(*triangle).map(|corner| corner - from);
            let sides = [a.cross(b).dot(along), b.cross(c).dot(along), c.cross(a).dot(along)];
            let normal = (b - a).cross(c - a);
            let same = sides.iter().all(|side| *side > 0.0) || sides.iter().all(|side| *side < 0.0);
            same && a.dot(normal) / along.dot(normal) > 0.0
        };
        (0..mesh.triangles().len()).filter(crosses).count()
    }
}
