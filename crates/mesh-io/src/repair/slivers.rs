//! Removal of triangles without area, and closing of cracks, by splitting triangles at vertices that lie on
//! their edges.
//!
//! A triangle without area is a needle, two of whose corners are closer than rounding, or a cap, one of whose
//! corners lies on the opposite side. A needle goes when its two corners are merged. A cap goes when the
//! triangles across its longest side are split at the vertex that lies on it: the surface keeps its shape,
//! and stays closed if it was. A crack is a cap that is missing: a vertex of a border that lies on an edge of
//! a border, or beside it by what rounding in a file moves it. So are seams, along which the two borders have
//! vertices of their own.

use std::collections::{HashMap, HashSet};

use super::{Piece, Work, root};
use crate::intersect::Boxes;

/// Largest number of rounds of removing caps, each of which may make others; then the remaining ones are
/// dropped.
const MAX_ROUNDS: usize = 16;

/// Widths of the cracks that are closed, in bounding radii, one after the other. Files have six decimals or
/// six digits: in a part of 4 mm that is written in metres, vertices are up to 0.9 µm off, and so are edges.
const CRACKS: [f64; 4] = [1e-6, 1e-5, 1e-4, 5e-4];

/// A side of a triangle at which there is no other.
struct Side {
    /// Its vertices, in the direction of the triangle.
    ends: [u32; 2],
    triangle: u32,
}

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
        let chosen = self.pieces.iter().zip(some).filter(|(_, some)| **some).map(|(piece, _)| piece);
        let mut count: HashMap<[u32; 2], usize> =
            chosen.flat_map(|piece| sides(piece.corners)).map(|side| (side, 0)).collect();
        for side in self.pieces.iter().flat_map(|piece| sides(piece.corners)) {
            count.entry(side).and_modify(|n| *n += 1);
        }
        count.into_iter().filter(|(_, n)| *n > 1).map(|(side, _)| side).collect()
    }

    /// Closes cracks of borders: joins vertices of borders that run along each other, and splits triangles of
    /// a border at another border's vertices that lie on it. Files hold rounded coordinates, so that vertices
    /// are beside edges that they should be on: the nearest are taken first, then those further away if
    /// `wide` is set.
    pub(super) fn close_cracks(&mut self, wide: bool) {
        let exact = 2.0 * self.negligible();
        let radius = exact / (2.0 * palpate_core::mesh::NEGLIGIBLE_HEIGHT);
        let single = 4.0 * f64::from(f32::EPSILON);
        let rounded = CRACKS.map(|crack| crack * radius);
        let tolerances = [exact, single.min(rounded[rounded.len() - 1])].into_iter().chain(rounded);
        for tolerance in tolerances.filter(|t| *t == exact || wide && *t > exact) {
            let mut shortest = f64::INFINITY;
            for _ in 0..MAX_ROUNDS {
                let Some(border) = self.border() else { return };
                // What closes nothing is not repeated.
                let length: f64 = border.iter().map(|side| self.length(side.ends)).sum();
                if length >= shortest {
                    break;
                }
                shortest = length;
                let joined = tolerance > exact && self.join_seams(&border, tolerance);
                if joined {
                    self.remove_slivers();
                    self.drop_duplicates();
                    continue;
                }
                let (splits, caps) = self.cracks(&border, tolerance, exact);
                let count = self.retain(|i| !caps.contains(&(i as u32)));
                self.summary.degenerate_triangles += count;
                if !self.split(&splits) && count == 0 {
                    break;
                }
                self.remove_slivers();
                self.drop_duplicates();
            }
        }
    }

    fn length(&self, [p, q]: [u32; 2]) -> f64 {
        self.points[p as usize].distance(self.points[q as usize])
    }

    /// The sides of triangles at which there is no other, in the direction of their triangle, and that
    /// triangle; `None` if there are none.
    fn border(&self) -> Option<Vec<Side>> {
        let mesh = self.mesh();
        let adjacency = mesh.adjacency();
        let border: Vec<Side> = (0..adjacency.edges().len() as u32)
            .filter_map(|edge| match adjacency.edge_sides(edge) {
                [side] => Some(Side { ends: mesh.half_edge(*side), triangle: side.triangle() }),
                _ => None,
            })
            .collect();
        (!border.is_empty()).then_some(border)
    }

    /// Joins the ends of sides of borders that run against each other, each end within `tolerance` of the
    /// other's. Returns whether there were any.
    fn join_seams(&mut self, border: &[Side], tolerance: f64) -> bool {
        let at = |v: u32| self.points[v as usize];
        let ends: HashSet<u32> = border.iter().flat_map(|side| side.ends).collect();
        // Two vertices of one triangle are apart on purpose: a narrow ribbon is not a crack.
        let connected: HashSet<[u32; 2]> = (self.pieces.iter().flat_map(|piece| sides(piece.corners)))
            .filter(|side| side.iter().all(|v| ends.contains(v)))
            .collect();
        let middle = |side: &Side| 0.5 * (at(side.ends[0]) + at(side.ends[1]));
        let boxes = Boxes::new(border.len(), |i| Some([middle(&border[i]); 3]));
        let tree = boxes.tree();
        let mut found = Vec::new();
        let nearest: Vec<Option<(f64, u32)>> = (border.iter())
            .map(|side| {
                let [p, q] = side.ends;
                let here = middle(side);
                boxes.touching([here - tolerance, here + tolerance], &tree, &mut found);
                let near = found.iter().filter_map(|&i| {
                    let [r, s] = border[i as usize].ends;
                    let distance = at(p).distance(at(s)).max(at(q).distance(at(r)));
                    let apart = |v: u32, w: u32| !connected.contains(&[v.min(w), v.max(w)]);
                    // Copies at the same positions were made on purpose, to separate sheets.
                    let fits = distance > 0.0 && distance <= tolerance && apart(p, s) && apart(q, r);
                    fits.then_some((distance, i))
                });
                near.min_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)))
            })
            .collect();
        let mut target: Vec<u32> = (0..self.points.len() as u32).collect();
        let mut joined = 0;
        for (i, near) in (0u32..).zip(&nearest) {
            let Some((_, other)) = *near else { continue };
            if i < other && nearest[other as usize].is_some_and(|(_, back)| back == i) {
                let ([p, q], [r, s]) = (border[i as usize].ends, border[other as usize].ends);
                for (v, w) in [(p, s), (q, r)] {
                    let (v, w) = (root(&mut target, v), root(&mut target, w));
                    joined += usize::from(v != w);
                    target[v.max(w) as usize] = v.min(w);
                }
            }
        }
        if joined == 0 {
            return false;
        }
        self.summary.merged_vertices += joined;
        self.changed = true;
        for piece in &mut self.pieces {
            piece.corners = piece.corners.map(|v| root(&mut target, v));
        }
        true
    }

    /// The vertices of borders that lie within `tolerance` of a border's edge, by that edge; and the
    /// triangles at such an edge that are so low that they would fold over when split, and go.
    fn cracks(&self, border: &[Side], tolerance: f64, exact: f64) -> (Splits, HashSet<u32>) {
        let at = |v: u32| self.points[v as usize];
        let mut vertices: Vec<u32> = border.iter().flat_map(|side| side.ends).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let mut sides_at: HashMap<u32, Vec<&Side>> = HashMap::new();
        for side in border {
            side.ends.iter().for_each(|v| sides_at.entry(*v).or_default().push(side));
        }
        let edges = Boxes::new(border.len(), |e| {
            let [p, q] = border[e].ends.map(at);
            Some([p, q, q])
        });
        let tree = edges.tree();
        // A vertex near an end is a copy of it rather, to be joined when wider cracks are closed.
        let widest = CRACKS[CRACKS.len() - 1] * exact / (2.0 * palpate_core::mesh::NEGLIGIBLE_HEIGHT);
        let margin = |length: f64| {
            (2.0 * tolerance).max(if tolerance > exact { (0.2 * length).min(2.0 * widest) } else { 0.0 })
        };
        // The distance of a point from an edge, and whether it is beside the edge's inner part.
        let beside = |v: u32, [p, q]: [u32; 2]| {
            let (from, line) = (at(v) - at(p), at(q) - at(p));
            let share = from.dot(line) / line.length_squared();
            let distance = if (0.0..=1.0).contains(&share) {
                (from - share * line).length()
            } else {
                at(v).distance(at(p)).min(at(v).distance(at(q)))
            };
            let ends = at(v).distance(at(p)).min(at(v).distance(at(q)));
            (distance, (0.0..=1.0).contains(&share) && ends > margin(line.length()))
        };
        let (mut splits, mut caps) = (Splits::new(), HashSet::new());
        let mut found = Vec::new();
        for &v in &vertices {
            edges.touching([at(v) - tolerance, at(v) + tolerance], &tree, &mut found);
            found.sort_unstable();
            for side in found.iter().map(|e| &border[*e as usize]) {
                let [p, q] = side.ends;
                let (distance, inner) = beside(v, side.ends);
                if !inner || distance > tolerance || [p, q].contains(&v) {
                    continue;
                }
                // Beyond exact coincidence, the vertex's own border must run along the edge, against it.
                let runs_along = sides_at[&v].iter().any(|own| {
                    let other = if own.ends[0] == v { own.ends[1] } else { own.ends[0] };
                    let against = (at(own.ends[1]) - at(own.ends[0])).dot(at(q) - at(p)) < 0.0;
                    against
                        && (beside(other, side.ends).0 <= tolerance || {
                            // The edge may end first.
                            [p, q].iter().any(|end| beside(*end, own.ends).0 <= tolerance)
                        })
                });
                if tolerance > exact && !runs_along {
                    continue;
                }
                let corners = self.pieces[side.triangle as usize].corners;
                let apex = corners.into_iter().find(|c| *c != p && *c != q).unwrap_or(p);
                if v == apex {
                    continue;
                }
                if tolerance > exact && beside(apex, side.ends).0 <= tolerance {
                    caps.insert(side.triangle);
                } else {
                    splits.entry([p.min(q), p.max(q)]).or_default().push(v);
                }
            }
        }
        // The sides of a triangle that goes are borders of others then.
        (splits, caps)
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

/// The sides of a triangle, each with the smaller vertex first.
fn sides([a, b, c]: [u32; 3]) -> [[u32; 2]; 3] {
    [[a, b], [b, c], [c, a]].map(|[p, q]| [p.min(q), p.max(q)])
}
