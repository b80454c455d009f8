//! Isotropic remeshing on an implicit surface, with a given number of triangles.
//!
//! Follows Botsch and Kobbelt, *A remeshing approach to multiresolution modeling* (SGP 2004): split long
//! edges, collapse short ones, flip towards valence 6, move vertices tangentially to the centroid of their
//! surroundings. It departs in that vertices are projected on the field's zero set rather than on the old
//! mesh, that any step which turns a triangle away from the surface's normal is refused (the mesh never folds
//! over), and that the count is met exactly in the end by collapsing or splitting the shortest or longest
//! edges.

use palpate_core::{TriMesh, glam::DVec3};

use crate::{
    halfedge::{EditableMesh, next, previous},
    surface::Surface,
};

/// Number of rounds of split, collapse, flip and move before the number of triangles is settled.
const ROUNDS: usize = 6;
/// Shape quality below which a triangle is a sliver (an aspect ratio of about 8).
const SLIVER_QUALITY: f64 = 0.25;
/// Largest number of passes over the edges in one split or collapse step.
const SWEEPS: usize = 4;
/// Number of rounds of flip and move after that.
const POLISH_ROUNDS: usize = 4;
/// Smallest cosine between a triangle's normal and its corners' surface normals that a step may produce,
/// unless it was smaller before: 70 degrees leave room for a crease inside a triangle.
const MIN_UPRIGHTNESS: f64 = 0.34;

pub(crate) struct Remesher<'a, S> {
    surface: &'a S,
    mesh: EditableMesh,
    /// Unit normal of the field at each vertex.
    normals: Vec<DVec3>,
    /// Wanted edge length at each vertex, relative to `length`.
    sizes: Vec<f64>,
    length: f64,
}

/// Twice the area over the sum of squared edges, scaled to 1 for an equilateral triangle, 0 for a degenerate
/// one.
pub(crate) fn shape_quality([a, b, c]: [DVec3; 3]) -> f64 {
    let squares = (b - a).length_squared() + (c - b).length_squared() + (a - c).length_squared();
    2.0 * 3f64.sqrt() * (b - a).cross(c - a).length() / squares
}

impl<'a, S: Surface> Remesher<'a, S> {
    /// `length`: the wanted edge length where the relative size is 1.
    pub(crate) fn new(surface: &'a S, mesh: EditableMesh, length: f64) -> Self {
        let mut remesher = Self { surface, mesh, normals: Vec::new(), sizes: Vec::new(), length };
        for v in 0..remesher.mesh.positions.len() {
            let position = remesher.mesh.positions[v];
            remesher.learn(position);
        }
        remesher
    }

    pub(crate) fn into_mesh(self) -> TriMesh {
        self.mesh.to_mesh()
    }

    /// Remeshes to the number of triangles (one fewer if odd).
    pub(crate) fn reach(&mut self, triangles: usize) {
        for _ in 0..ROUNDS {
            self.split_long();
            self.collapse_short();
            self.flip(Self::improves_valence);
            self.relax();
            // A little at a time: the count lags behind the length.
            self.length *= (self.mesh.triangles() as f64 / triangles as f64).sqrt().clamp(0.93, 1.07);
        }
        self.settle(triangles);
        self.polish();
        for _ in 0..4 {
            let mended = self.gather_strays() + self.unfold();
            self.settle(triangles);
            if mended == 0 {
                break;
            }
            self.polish();
        }
    }

    /// Splits each triangle into four, with the new vertices on the surface.
    pub(crate) fn subdivide(&mut self) {
        self.length *= 0.5;
        let coarse = self.mesh.to_mesh();
        let mut midpoints = std::collections::HashMap::new();
        let mut vertices = coarse.vertices().to_vec();
        let mut triangles = Vec::with_capacity(4 * coarse.triangles().len());
        for &[a, b, c] in coarse.triangles() {
            let mut middle = |p: u32, q: u32| {
                *midpoints.entry((p.min(q), p.max(q))).or_insert_with(|| {
                    vertices.push(vertices[p as usize].midpoint(vertices[q as usize]));
                    vertices.len() as u32 - 1
                })
            };
            let (d, e, f) = (middle(a, b), middle(b, c), middle(c, a));
            triangles.extend([[a, d, f], [d, b, e], [f, e, c], [d, e, f]]);
        }
        let fine = TriMesh::new(vertices, triangles).expect("every index is that of a vertex");
        *self = Self::new(self.surface, EditableMesh::new(&fine), self.length);
        for v in 0..self.mesh.positions.len() as u32 {
            self.move_to(v, self.at(v));
        }
        self.polish();
    }

    fn polish(&mut self) {
        for _ in 0..POLISH_ROUNDS {
            self.flip(Self::improves_angles);
            self.relax();
        }
        self.flip(Self::improves_angles);
    }

    /// Records the surface's normal and the wanted size at a new vertex.
    fn learn(&mut self, position: DVec3) {
        let value = self.surface.value(position);
        self.normals.push(self.surface.gradient(position, value).normalize_or(DVec3::Z));
        self.sizes.push(self.surface.sizing(position));
    }

    /// The point of the surface near `p`, by Newton's method along the gradient, with the normal there.
    fn project(&self, mut p: DVec3, reach: f64) -> Option<(DVec3, DVec3)> {
        let close = 1e-4 * reach;
        let mut value = self.surface.value(p);
        let mut gradient = self.surface.gradient(p, value);
        for _ in 0..8 {
            if value.abs() <= close {
                break;
            }
            let slope = gradient.length_squared();
            if slope < 1e-6 {
                return None;
            }
            // Halve the step where it does not help: the field bends within it.
            let mut step = (-gradient * (value / slope)).clamp_length_max(0.5 * reach);
            for attempt in 0.. {
                let there = self.surface.value(p + step);
                if there.abs() < value.abs() {
                    value = there;
                    p += step;
                    break;
                }
                if attempt == 4 {
                    return None;
                }
                step *= 0.5;
            }
            // After a tiny step the gradient is still good.
            if step.length() > 0.03 * reach || value.abs() > close {
                gradient = self.surface.gradient(p, value);
            }
        }
        (value.abs() <= 0.02 * reach).then(|| gradient.try_normalize().map(|n| (p, n)))?
    }

    /// Edge length relative to the wanted one.
    fn relative_length(&self, h: u32) -> f64 {
        let (a, b) = (self.mesh.origin(h), self.mesh.target(h));
        let wanted = 0.5 * self.length * (self.sizes[a as usize] + self.sizes[b as usize]);
        self.at(a).distance(self.at(b)) / wanted
    }

    fn at(&self, v: u32) -> DVec3 {
        self.mesh.positions[v as usize]
    }

    /// Smallest cosine between the triangle's normal and a surface normal of its corners; −1 if degenerate.
    fn uprightness(&self, corners: [DVec3; 3], normals: [DVec3; 3]) -> f64 {
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        normal.try_normalize().map_or(-1.0, |n| normals.into_iter().map(|m| n.dot(m)).fold(1.0, f64::min))
    }

    /// Worst uprightness and worst shape of the vertex's triangles if it were at `position`; triangles that
    /// hold `without` are left out.
    fn fit(&self, v: u32, position: DVec3, normal: DVec3, without: Option<u32>) -> (f64, f64) {
        let mut worst = (1f64, 1f64);
        for h in self.mesh.around(v) {
            let (a, b) = (self.mesh.target(h), self.mesh.apex(h));
            if without == Some(a) || without == Some(b) {
                continue;
            }
            let corners = [position, self.at(a), self.at(b)];
            let normals = [normal, self.normals[a as usize], self.normals[b as usize]];
            worst.0 = worst.0.min(self.uprightness(corners, normals));
            worst.1 = worst.1.min(shape_quality(corners));
        }
        worst
    }

    /// Moves a vertex to the surface near `position`, unless its triangles get too bad.
    fn move_to(&mut self, v: u32, position: DVec3) -> bool {
        let reach = self.length * self.sizes[v as usize];
        let Some((there, normal)) = self.project(position, reach) else { return false };
        let after = self.fit(v, there, normal, None);
        if after.0 < MIN_UPRIGHTNESS || after.1 < 0.5 {
            let before = self.fit(v, self.at(v), self.normals[v as usize], None);
            if after.0 < MIN_UPRIGHTNESS.min(before.0) || after.1 < before.1.min(0.5) {
                return false;
            }
        }
        self.mesh.positions[v as usize] = there;
        self.normals[v as usize] = normal;
        self.sizes[v as usize] = self.surface.sizing(there);
        true
    }

    fn split_long(&mut self) {
        for _ in 0..SWEEPS {
            let before = self.mesh.half_edges();
            for h in 0..before {
                // Only the longest edge of both its triangles: halving others would never end in slivers.
                if self.mesh.is_edge(h)
                    && self.relative_length(h) > 4.0 / 3.0
                    && self.is_longest(h)
                    && self.is_longest(self.mesh.twin(h))
                {
                    self.split(h);
                }
            }
            if self.mesh.half_edges() == before {
                break;
            }
        }
    }

    fn is_longest(&self, h: u32) -> bool {
        let length = |h: u32| self.at(self.mesh.origin(h)).distance_squared(self.at(self.mesh.target(h)));
        length(h) >= length(next(h)).max(length(previous(h)))
    }

    fn split(&mut self, h: u32) {
        let middle = self.at(self.mesh.origin(h)).midpoint(self.at(self.mesh.target(h)));
        let v = self.mesh.split(h, middle);
        self.learn(middle);
        self.move_to(v, middle);
    }

    fn collapse_short(&mut self) {
        for _ in 0..SWEEPS {
            let before = self.mesh.triangles();
            for h in 0..self.mesh.half_edges() {
                if self.mesh.is_edge(h) && self.relative_length(h) < 0.8 {
                    self.collapse(h, 4.0 / 3.0);
                }
            }
            if self.mesh.triangles() == before {
                break;
            }
        }
    }

    /// Collapses the edge if topology, normals and shapes allow and no edge comes out longer than `longest`.
    fn collapse(&mut self, h: u32, longest: f64) -> bool {
        if !self.mesh.can_collapse(h) {
            return false;
        }
        let (a, b) = (self.mesh.origin(h), self.mesh.target(h));
        let reach = self.length * self.sizes[b as usize];
        let Some((there, normal)) = self.project(self.at(a).midpoint(self.at(b)), reach) else {
            return false;
        };
        let size = self.surface.sizing(there);
        for (v, other) in [(a, b), (b, a)] {
            let (upright, shape) = self.fit(v, there, normal, Some(other));
            let before = self.fit(v, self.at(v), self.normals[v as usize], None);
            if upright < MIN_UPRIGHTNESS.min(before.0) || shape < before.1.min(0.3) {
                return false;
            }
            for e in self.mesh.around(v) {
                let far = self.mesh.target(e);
                let wanted = 0.5 * self.length * (size + self.sizes[far as usize]);
                if far != other && self.at(far).distance(there) > longest * wanted {
                    return false;
                }
            }
        }
        self.mesh.collapse(h, there);
        self.normals[b as usize] = normal;
        self.sizes[b as usize] = size;
        true
    }

    fn flip(&mut self, improves: fn(&Self, u32) -> bool) {
        for h in 0..self.mesh.half_edges() {
            if self.mesh.is_edge(h) && self.may_flip(h) && improves(self, h) {
                self.mesh.flip(h);
            }
        }
    }

    fn may_flip(&self, h: u32) -> bool {
        let g = self.mesh.twin(h);
        let (a, b, c, d) = (self.mesh.origin(h), self.mesh.origin(g), self.mesh.apex(h), self.mesh.apex(g));
        if self.mesh.valence(a) <= 3 || self.mesh.valence(b) <= 3 || self.mesh.are_neighbours(c, d) {
            return false;
        }
        let upright =
            |t: [u32; 3]| self.uprightness(t.map(|v| self.at(v)), t.map(|v| self.normals[v as usize]));
        let before = upright([a, b, c]).min(upright([b, a, d]));
        let after = upright([d, c, a]).min(upright([c, d, b]));
        after >= before.min(0.8)
    }

    fn improves_valence(&self, h: u32) -> bool {
        let g = self.mesh.twin(h);
        let excess = |v: u32, change: i64| (self.mesh.valence(v) as i64 + change - 6).pow(2);
        let ends = [self.mesh.origin(h), self.mesh.origin(g)];
        let apexes = [self.mesh.apex(h), self.mesh.apex(g)];
        let before: i64 = ends.iter().chain(&apexes).map(|v| excess(*v, 0)).sum();
        let after: i64 =
            ends.iter().map(|v| excess(*v, -1)).chain(apexes.iter().map(|v| excess(*v, 1))).sum();
        after < before
    }

    /// Delaunay's criterion: the angles across the edge add up to more than half a turn.
    fn improves_angles(&self, h: u32) -> bool {
        let angle = |h: u32| {
            let (a, b, c) =
                (self.at(self.mesh.origin(h)), self.at(self.mesh.target(h)), self.at(self.mesh.apex(h)));
            (a - c).angle_between(b - c)
        };
        angle(h) + angle(self.mesh.twin(h)) > std::f64::consts::PI + 1e-3
    }

    fn relax(&mut self) {
        for v in 0..self.mesh.positions.len() as u32 {
            if !self.mesh.is_live_vertex(v) {
                continue;
            }
            let here = self.at(v);
            // Centroid of the surroundings, weighted with area over squared edge length wanted.
            let (mut sum, mut weight) = (DVec3::ZERO, 0.0);
            for h in self.mesh.around(v) {
                let (a, c) = (self.mesh.target(h), self.mesh.apex(h));
                let area = (self.at(a) - here).cross(self.at(c) - here).length();
                let size = self.sizes[a as usize] + self.sizes[c as usize] + self.sizes[v as usize];
                let w = area / (size * size);
                sum += w * (here + self.at(a) + self.at(c)) / 3.0;
                weight += w;
            }
            if weight <= 0.0 {
                continue;
            }
            let normal = self.normals[v as usize];
            let offset = sum / weight - here;
            let tangential = offset - normal * offset.dot(normal);
            if !self.move_to(v, here + tangential) {
                self.move_to(v, here + 0.3 * tangential);
            }
        }
    }

    /// Moves vertices that are still off the surface onto it, since none could move alone without folding its
    /// triangles: all at once; folds are relaxed and unfolded later. Returns their number.
    fn gather_strays(&mut self) -> usize {
        let mut strays = 0;
        for v in 0..self.mesh.positions.len() as u32 {
            let reach = self.length * self.sizes[v as usize];
            if !self.mesh.is_live_vertex(v) || self.surface.value(self.at(v)).abs() < 0.02 * reach {
                continue;
            }
            strays += 1;
            if let Some((there, normal)) = self.project(self.at(v), reach) {
                self.mesh.positions[v as usize] = there;
                self.normals[v as usize] = normal;
                self.sizes[v as usize] = self.surface.sizing(there);
            }
        }
        if strays > 0 {
            self.flip(Self::improves_angles);
            self.relax();
        }
        strays
    }

    /// Collapses an edge of every sliver and of every triangle that faces away from the surface's normals,
    /// such as remain in a slit too narrow for the edge length. Returns the number of such triangles.
    fn unfold(&mut self) -> usize {
        let mut folded = 0;
        for h in (0..self.mesh.half_edges()).step_by(3) {
            if !self.mesh.is_live(h) {
                continue;
            }
            let corners = [self.mesh.origin(h), self.mesh.target(h), self.mesh.apex(h)];
            let upright =
                self.uprightness(corners.map(|v| self.at(v)), corners.map(|v| self.normals[v as usize]));
            let shape = shape_quality(corners.map(|v| self.at(v)));
            if upright >= 0.5 * MIN_UPRIGHTNESS && shape >= SLIVER_QUALITY {
                continue;
            }
            folded += 1;
            let mut edges = [h, next(h), previous(h)];
            edges.sort_by(|a, b| self.relative_length(*a).total_cmp(&self.relative_length(*b)));
            let _ = edges.into_iter().any(|e| self.collapse(e, 3.0));
        }
        folded
    }

    /// Collapses the shortest or splits the longest edges until the number of triangles is as requested.
    fn settle(&mut self, triangles: usize) {
        let wanted = triangles & !1;
        for attempt in 0..20 {
            let have = self.mesh.triangles();
            if have == wanted {
                return;
            }
            let mut edges: Vec<(f64, u32)> = (0..self.mesh.half_edges())
                .filter(|h| self.mesh.is_edge(*h))
                .map(|h| (self.relative_length(h), h))
                .collect();
            edges.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            if have > wanted {
                // Collapses delete and shorten other edges: collapse a share of them, then sort again.
                let share = ((have - wanted) / 2).min(edges.len() / 10 + 1);
                let mut done = 0;
                for (_, h) in edges {
                    if done == share {
                        break;
                    }
                    if self.mesh.is_edge(h) && self.collapse(h, 1.6 + 0.1 * f64::from(attempt)) {
                        done += 1;
                    }
                }
            } else {
                let share = ((wanted - have) / 2).min(edges.len() / 10 + 1);
                for (_, h) in edges.into_iter().rev().take(share) {
                    self.split(h);
                }
            }
            self.flip(Self::improves_angles);
            self.relax();
        }
    }
}
