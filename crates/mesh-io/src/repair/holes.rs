//! Closing of the holes that dropped triangles leave, and of small openings.
//!
//! The border of a hole is a polygon in space. Of its triangulations without new vertices, the one of least
//! area is found by dynamic programming (Barequet and Sharir 1995), among triangles that have an area,
//! intersect no triangle of the mesh and repeat no edge. If there is none, the triangles around the hole are
//! removed as well and the larger hole is tried, which untangles folds of a few triangles. If that fails too,
//! they stay and the hole stays open.

use std::collections::{HashMap, HashSet};

use glam::DVec3;
use palpate_core::TriMesh;
use palpate_core::mesh::{Adjacency, HalfEdge};

use super::{Piece, Work};
use crate::intersect::{Boxes, cross};
use crate::weld::{self, equal_positions};

/// Number of edges of the largest hole to be closed: the number of triangles that are tried grows with its
/// cube.
const MAX_EDGES: usize = 48;

/// Largest number of rings of triangles around a hole that may be removed to close it.
const MAX_RINGS: usize = 3;

/// Smallest ratio of the area that closes a hole to the area removed around it: with less, the mesh would
/// lose surface.
const MIN_AREA_RATIO: f64 = 0.9;

/// Size of the largest opening that is closed wherever it comes from, in sizes of the mesh. Cracks of exports
/// are smaller, and what is meant to be open is larger.
const SMALL: f64 = 0.02;

/// Largest number of triangles tried in one round, some microseconds each.
const MAX_TRIED: usize = 500_000;

impl Work {
    /// Triangles that close the holes left by the `removed` triangles of the mesh, a list for each hole. Adds
    /// triangles that have to be removed for that to `removed`.
    pub(super) fn fillings(&self, mesh: &TriMesh, removed: &mut [bool], same: &[u32]) -> Vec<Vec<[u32; 3]>> {
        let adjacency = mesh.adjacency();
        let boxes = Boxes::new(removed.len(), |t| (!removed[t]).then(|| mesh.corners(t)));
        let tree = boxes.tree();
        let near = |bounds, found: &mut Vec<u32>| boxes.touching(bounds, &tree, found);
        let mut filler = self.filler(mesh, &adjacency, removed.to_vec(), same, &near);
        let mut fillings = Vec::new();
        for hole in holes(&adjacency, removed) {
            let polygons = borders(mesh, &adjacency, &hole, removed);
            let small = |polygons: &[Vec<u32>]| polygons.iter().all(|p| p.len() <= MAX_EDGES);
            let before = fillings.len();
            fillings.extend(polygons.iter().flatten().filter_map(|polygon| filler.fill(polygon)));
            let Some(mut polygons) = polygons.into_iter().collect::<Option<Vec<_>>>() else { continue };
            if fillings.len() > before || !small(&polygons) {
                continue;
            }
            let mut grown = hole.clone();
            for _ in 0..MAX_RINGS {
                let ring = filler.ring(&polygons);
                ring.iter().for_each(|t| filler.removed[*t as usize] = true);
                grown.extend(ring);
                let found = borders(mesh, &adjacency, &grown, &filler.removed);
                let Some(found) = found.into_iter().collect::<Option<Vec<_>>>() else { break };
                if !small(&found) {
                    break;
                }
                let filled: Vec<_> = found.iter().map_while(|polygon| filler.fill(polygon)).collect();
                let area = |triangles: &mut dyn Iterator<Item = [u32; 3]>| -> f64 {
                    triangles.map(|corners| self.doubled_area(corners)).sum()
                };
                let lost = area(&mut grown[hole.len()..].iter().map(|t| mesh.triangles()[*t as usize]));
                let gained = area(&mut filled.iter().flatten().copied());
                if filled.len() == found.len() && gained >= MIN_AREA_RATIO * lost {
                    fillings.extend(filled);
                    break;
                }
                filler.forget(&filled);
                polygons = found;
            }
            if fillings.len() == before {
                grown[hole.len()..].iter().for_each(|t| filler.removed[*t as usize] = false);
            }
        }
        removed.copy_from_slice(&filler.removed);
        fillings
    }

    /// Closes the small openings of a surface whose edges have one triangle or two.
    pub(super) fn close_openings(&mut self) {
        let mesh = self.mesh();
        let adjacency = mesh.adjacency();
        // A filling runs along a border against the triangles there.
        let mut next: HashMap<u32, u32> = HashMap::new();
        for edge in (0..adjacency.edges().len() as u32).filter(|e| adjacency.edge_sides(*e).len() == 1) {
            let [from, to] = mesh.half_edge(adjacency.edge_sides(edge)[0]);
            next.insert(to, from);
        }
        if next.is_empty() {
            return;
        }
        let small = 2.0 * SMALL * weld::drop_unreferenced(&mesh).bounding_sphere().radius;
        let mut polygons = Vec::new();
        let mut starts: Vec<u32> = next.keys().copied().collect();
        starts.sort_unstable();
        for start in starts {
            let (mut polygon, mut v) = (Vec::new(), start);
            while let Some(after) = next.remove(&v) {
                polygon.push(v);
                v = after;
            }
            let corners = || polygon.iter().map(|v| self.points[*v as usize]);
            let extent =
                corners().fold(DVec3::NEG_INFINITY, DVec3::max) - corners().fold(DVec3::INFINITY, DVec3::min);
            if v == start && extent.length() <= small {
                polygons.push(polygon);
            }
        }
        let same = equal_positions(&self.points);
        let boxes = Boxes::new(self.pieces.len(), |t| Some(mesh.corners(t)));
        let tree = boxes.tree();
        let near = |bounds, found: &mut Vec<u32>| boxes.touching(bounds, &tree, found);
        let mut filler = self.filler(&mesh, &adjacency, vec![false; self.pieces.len()], &same, &near);
        let fillings: Vec<_> = polygons.iter().filter_map(|polygon| filler.fill(polygon)).collect();
        self.add_fillings(fillings);
    }

    fn filler<'a>(
        &'a self,
        mesh: &'a TriMesh,
        adjacency: &'a Adjacency,
        removed: Vec<bool>,
        same: &'a [u32],
        near: &'a Near<'a>,
    ) -> Filler<'a> {
        Filler {
            work: self,
            mesh,
            adjacency,
            removed,
            same,
            negligible: self.negligible(),
            near,
            found: Vec::new(),
            made: Vec::new(),
            made_edges: HashSet::new(),
            tried: 0,
        }
    }

    /// Adds triangles that close holes, a list for each.
    pub(super) fn add_fillings(&mut self, fillings: Vec<Vec<[u32; 3]>>) {
        for filling in fillings {
            self.summary.filled_holes += 1;
            self.summary.filling_triangles += filling.len();
            self.pieces.extend(filling.into_iter().map(|corners| Piece { corners, turned: false }));
            self.changed = true;
        }
    }
}

/// The dropped triangles, in pieces that are connected across edges.
fn holes(adjacency: &Adjacency, removed: &[bool]) -> Vec<Vec<u32>> {
    let mut seen = vec![false; removed.len()];
    let mut holes = Vec::new();
    for seed in (0..removed.len() as u32).filter(|t| removed[*t as usize]) {
        if std::mem::replace(&mut seen[seed as usize], true) {
            continue;
        }
        let mut hole = vec![seed];
        let mut next = 0;
        while next < hole.len() {
            let t = hole[next];
            for other in (0..3).filter_map(|side| adjacency.neighbour(t, side)) {
                if removed[other as usize] && !std::mem::replace(&mut seen[other as usize], true) {
                    hole.push(other);
                }
            }
            next += 1;
        }
        holes.push(hole);
    }
    holes
}

/// The borders of a piece of the surface, as polygons in the direction of its triangles. `None` stands for a
/// border that is not surrounded by triangles that are left.
fn borders(mesh: &TriMesh, adjacency: &Adjacency, piece: &[u32], removed: &[bool]) -> Vec<Option<Vec<u32>>> {
    let members: HashSet<u32> = piece.iter().copied().collect();
    let across = |side: HalfEdge| adjacency.neighbour(side.triangle(), side.side());
    let is_border = |side: HalfEdge| across(side).is_none_or(|t| !members.contains(&t));
    // The next side of the border, by turning around the end of this one through the piece.
    let next = |side: HalfEdge| {
        let end = mesh.half_edge(side)[1];
        let mut side = HalfEdge::new(side.triangle(), (side.side() + 1) % 3);
        while !is_border(side) {
            let t = across(side).unwrap_or(side.triangle());
            let starts_here = |k: &u32| mesh.triangles()[t as usize][*k as usize] == end;
            side = HalfEdge::new(t, (0..3).find(starts_here).unwrap_or(0));
        }
        side
    };
    let mut seen = HashSet::new();
    let mut polygons = Vec::new();
    for start in piece.iter().flat_map(|t| (0..3).map(move |k| HalfEdge::new(*t, k))) {
        if !is_border(start) || seen.contains(&start) {
            continue;
        }
        let (mut polygon, mut closed, mut side) = (Vec::new(), true, start);
        while seen.insert(side) {
            polygon.push(mesh.half_edge(side)[0]);
            closed &= across(side).is_some_and(|t| !removed[t as usize]);
            side = next(side);
        }
        polygons.push(closed.then_some(polygon));
    }
    polygons
}

/// A function that finds the triangles whose boxes overlap a given one.
type Near<'a> = dyn Fn([DVec3; 2], &mut Vec<u32>) + 'a;

struct Filler<'a> {
    work: &'a Work,
    mesh: &'a TriMesh,
    adjacency: &'a Adjacency,
    removed: Vec<bool>,
    same: &'a [u32],
    negligible: f64,
    near: &'a Near<'a>,
    found: Vec<u32>,
    /// Triangles that close holes, made so far.
    made: Vec<[u32; 3]>,
    made_edges: HashSet<[u32; 2]>,
    tried: usize,
}

impl Filler<'_> {
    /// The triangles that are left at the vertices of polygons.
    fn ring(&self, polygons: &[Vec<u32>]) -> Vec<u32> {
        let mut ring: Vec<u32> = (polygons.iter().flatten())
            .flat_map(|v| self.adjacency.vertex_triangles(*v))
            .copied()
            .filter(|t| !self.removed[*t as usize])
            .collect();
        ring.sort_unstable();
        ring.dedup();
        ring
    }

    /// Closes a hole; `None` if that is not possible.
    fn fill(&mut self, polygon: &[u32]) -> Option<Vec<[u32; 3]>> {
        let n = polygon.len();
        if !(3..=MAX_EDGES).contains(&n) {
            return None;
        }
        let mut positions: Vec<u32> = polygon.iter().map(|v| self.same[*v as usize]).collect();
        positions.sort_unstable();
        positions.dedup();
        if positions.len() < n || self.tried + n * n * n / 6 > MAX_TRIED {
            return None;
        }
        // Least area A(i, j) that closes the part of the polygon from i to j, and the third corner k of the
        // triangle at that chord: A(i, j) = min over k of A(i, k) + A(k, j) + area(i, k, j).
        let mut best = vec![(f64::INFINITY, usize::MAX); n * n];
        for i in 0..n - 1 {
            best[i * n + i + 1].0 = 0.0;
        }
        for width in 2..n {
            for i in 0..n - width {
                let j = i + width;
                let chord = width < n - 1;
                if chord && self.has_edge(polygon[i], polygon[j]) {
                    continue;
                }
                for k in i + 1..j {
                    let rest = best[i * n + k].0 + best[k * n + j].0;
                    if rest >= best[i * n + j].0 {
                        continue;
                    }
                    let corners = [polygon[i], polygon[k], polygon[j]];
                    let area = rest + self.work.doubled_area(corners);
                    if area < best[i * n + j].0 && self.fits(corners) {
                        best[i * n + j] = (area, k);
                    }
                }
            }
        }
        if best[n - 1].0 == f64::INFINITY {
            return None;
        }
        let mut filling = Vec::with_capacity(n - 2);
        let mut open = vec![(0, n - 1)];
        while let Some((i, j)) = open.pop() {
            if j > i + 1 {
                let k = best[i * n + j].1;
                filling.push([polygon[i], polygon[k], polygon[j]]);
                open.extend([(k, j), (i, k)]);
            }
        }
        let clean = (0..filling.len()).all(|i| (0..i).all(|j| !self.cross(filling[i], filling[j])));
        if !clean {
            return None;
        }
        self.made.extend(&filling);
        self.made_edges.extend(filling.iter().flat_map(edges));
        Some(filling)
    }

    /// Undoes the latest fillings.
    fn forget(&mut self, fillings: &[Vec<[u32; 3]>]) {
        let count: usize = fillings.iter().map(Vec::len).sum();
        self.made.truncate(self.made.len() - count);
        self.made_edges = self.made.iter().flat_map(edges).collect();
    }

    fn has_edge(&self, a: u32, b: u32) -> bool {
        let edge = self.adjacency.edge_between(a, b);
        let kept =
            |edge| self.adjacency.edge_sides(edge).iter().any(|s| !self.removed[s.triangle() as usize]);
        edge.is_some_and(kept) || self.made_edges.contains(&[a.min(b), a.max(b)])
    }

    /// Whether a triangle has an area and neither intersects nor repeats any other.
    fn fits(&mut self, corners: [u32; 3]) -> bool {
        self.tried += 1;
        if self.work.has_no_area(corners, self.negligible) {
            return false;
        }
        let [a, b, c] = self.work.positions(corners);
        let mut found = std::mem::take(&mut self.found);
        (self.near)([a.min(b).min(c), a.max(b).max(c)], &mut found);
        let fits = (found.iter().filter(|t| !self.removed[**t as usize]))
            .map(|t| &self.mesh.triangles()[*t as usize])
            .chain(&self.made)
            .all(|other| !self.cross(corners, *other));
        self.found = found;
        fits
    }

    fn cross(&self, a: [u32; 3], b: [u32; 3]) -> bool {
        let ids = |t: [u32; 3]| t.map(|v| self.same[v as usize]);
        let (ia, ib) = (ids(a), ids(b));
        ia.iter().all(|v| ib.contains(v)) || cross(&self.work.positions(a), &ia, &self.work.positions(b), &ib)
    }
}

fn edges([a, b, c]: &[u32; 3]) -> [[u32; 2]; 3] {
    [[a, b], [b, c], [c, a]].map(|[p, q]| [*p.min(q), *p.max(q)])
}
