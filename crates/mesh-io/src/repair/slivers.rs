//! Removal of triangles without area, and closing of cracks, by splitting triangles at vertices that lie on
//! their edges.
//!
//! A triangle without area is a needle, two of whose corners are closer than rounding, or a cap, one of whose
//! corners lies on the opposite side. A needle goes when its two corners are merged. A cap goes when the
//! triangles across its longest side are split at the vertex that lies on it: the surface keeps its shape,
//! and stays closed if it was. A crack is a cap that is missing: a vertex of a border that lies on an edge of
//! a border.

use std::collections::{HashMap, HashSet};

use super::{Piece, Work};
use crate::intersect::Boxes;

/// Largest number of rounds of removing caps, each of which may make others; then the remaining ones are
/// dropped.
const MAX_ROUNDS: usize = 16;

/// Vertices that lie on an edge, at which to split it, by the edge (its vertices in ascending order).
type Splits = HashMap<[u32; 2], Vec<u32>>;

impl Work {
    pub(super) fn remove_slivers(&mut self) {
        for _ in 0..MAX_ROUNDS {
            let negligible = self.negligible();
            let bad: Vec<bool> =
                self.pieces.iter().map(|p| self.has_no_area(p.corners, negligible)).collect();
            if !bad.contains(&true) {
                return;
            }
            let shared = self.sides_shared_with(&bad);
            let mut splits = Splits::new();
            let mut target: Vec<u32> = (0..self.points.len() as u32).collect();
            let mut merged = 0;
            for piece in self.pieces.iter().zip(&bad).filter(|(_, bad)| **bad).map(|(piece, _)| piece) {
                let [a, b, c] = piece.corners;
                if a == b || b == c || c == a {
                    continue;
                }
                let length = |[p, q]: [u32; 2]| self.points[p as usize].distance(self.points[q as usize]);
                let mut sides = [[a, b], [b, c], [c, a]];
                sides.sort_by(|x, y| length(*x).total_cmp(&length(*y)));
                if length(sides[0]) <= 4.0 * negligible {
                    let [p, q] = sides[0].map(|v| root(&mut target, v));
                    merged += usize::from(p != q);
                    target[p.max(q) as usize] = p.min(q);
                } else {
                    let [p, q] = sides[2];
                    let on = piece.corners.into_iter().find(|v| *v != p && *v != q).unwrap_or(p);
                    // A triangle that connects no others leaves no gap to close.
                    let holds = |end: u32| shared.contains(&[end.min(on), end.max(on)]);
                    if holds(p) || holds(q) {
                        splits.entry([p.min(q), p.max(q)]).or_default().push(on);
                    }
                }
            }
            self.summary.degenerate_triangles += self.retain(|i| !bad[i]);
            self.split(&splits);
            if merged > 0 {
                self.summary.merged_vertices += merged;
                for piece in &mut self.pieces {
                    piece.corners = piece.corners.map(|v| root(&mut target, v));
                }
            }
            self.drop_duplicates();
        }
        self.drop_degenerate();
    }

    /// Sides of some pieces that are sides of another piece as well.
    fn sides_shared_with(&self, some: &[bool]) -> HashSet<[u32; 2]> {
        let sides = |[a, b, c]: [u32; 3]| [[a, b], [b, c], [c, a]].map(|[p, q]| [p.min(q), p.max(q)]);
        let chosen = self.pieces.iter().zip(some).filter(|(_, some)| **some).map(|(piece, _)| piece);
        let mut count: HashMap<[u32; 2], usize> =
            chosen.flat_map(|piece| sides(piece.corners)).map(|side| (side, 0)).collect();
        for side in self.pieces.iter().flat_map(|piece| sides(piece.corners)) {
            count.entry(side).and_modify(|n| *n += 1);
        }
        count.into_iter().filter(|(_, n)| *n > 1).map(|(side, _)| side).collect()
    }

    /// Splits triangles of a border at the border's vertices that lie on it.
    pub(super) fn close_cracks(&mut self) {
        for _ in 0..MAX_ROUNDS {
            let splits = self.cracks();
            if splits.is_empty() || !self.split(&splits) {
                return;
            }
            self.remove_slivers();
            self.drop_duplicates();
        }
    }

    fn cracks(&self) -> Splits {
        let negligible = self.negligible();
        let mesh = self.mesh();
        let adjacency = mesh.adjacency();
        let border: Vec<[u32; 2]> = (0..)
            .zip(adjacency.edges())
            .filter(|(edge, _)| adjacency.edge_sides(*edge).len() == 1)
            .map(|(_, ends)| *ends)
            .collect();
        let mut vertices: Vec<u32> = border.iter().flatten().copied().collect();
        vertices.sort_unstable();
        vertices.dedup();
        let at = |v: u32| self.points[v as usize];
        let reach = glam::DVec3::splat(2.0 * negligible);
        let edges =
            Boxes::new(border.len(), |e| Some([at(border[e][0]), at(border[e][1]), at(border[e][1])]));
        let around = Boxes::new(vertices.len(), |i| {
            let p = at(vertices[i]);
            Some([p - reach, p + reach, p])
        });
        let tree = edges.tree();
        let mut splits = Splits::new();
        let mut found = Vec::new();
        for (i, &v) in vertices.iter().enumerate() {
            around.overlapping(i, &edges, &tree, &mut found);
            found.sort_unstable();
            for &e in &found {
                let [p, q] = border[e as usize];
                let along = (at(q) - at(p)).length();
                let (from, to) = (at(p).distance(at(v)), at(q).distance(at(v)));
                // A vertex at an end of the edge, or at a copy of it, does not split it.
                let inside = from.max(to) < along && from.min(to) > 4.0 * negligible;
                if inside && self.has_no_area([p, v, q], negligible) {
                    splits.entry([p, q]).or_default().push(v);
                }
            }
        }
        splits
    }

    /// Splits the triangles at each edge at vertices that lie on it. A triangle is split at one of its edges
    /// only, so that another round may be needed. Returns whether any was split.
    fn split(&mut self, splits: &Splits) -> bool {
        let mut made = Vec::new();
        let mut gone = vec![false; self.pieces.len()];
        for (index, piece) in self.pieces.iter().enumerate() {
            let [a, b, c] = piece.corners;
            let cut = [[a, b, c], [b, c, a], [c, a, b]].into_iter().find_map(|[p, q, apex]| {
                let mut on: Vec<u32> = splits.get(&[p.min(q), p.max(q)])?.clone();
                let at = |v: u32| self.points[v as usize];
                on.retain(|v| ![p, q, apex].contains(v));
                on.sort_by(|x, y| {
                    at(p).distance_squared(at(*x)).total_cmp(&at(p).distance_squared(at(*y))).then(x.cmp(y))
                });
                // One of several copies is enough.
                on.dedup_by(|x, y| at(*x) == at(*y));
                (!on.is_empty()).then_some((p, q, apex, on))
            });
            let Some((p, q, apex, on)) = cut else { continue };
            gone[index] = true;
            let mut from = p;
            for to in on.into_iter().chain([q]) {
                made.push(Piece { corners: [from, to, apex], turned: piece.turned });
                from = to;
            }
        }
        let count = self.retain(|i| !gone[i]);
        self.pieces.extend(made);
        self.summary.split_triangles += count;
        count > 0
    }
}

/// The vertex that `vertex` is merged into: the root of its tree. Shortens the path to it.
fn root(target: &mut [u32], mut vertex: u32) -> u32 {
    while target[vertex as usize] != vertex {
        target[vertex as usize] = target[target[vertex as usize] as usize];
        vertex = target[vertex as usize];
    }
    vertex
}
