//! Separation of sheets that meet at an edge or a vertex.
//!
//! Triangles are glued across each edge that exactly two share, if they agree on the outside; of three or
//! more at an edge, those are glued that enclose a wedge of material between them, seen around the edge. Then
//! each fan of triangles that are glued together around a vertex gets a copy of the vertex of its own
//! (Guéziec et al. 2001, "Cutting and stitching").

use glam::DVec3;
use palpate_core::TriMesh;
use palpate_core::mesh::{Adjacency, EdgeKind, HalfEdge};

use super::Work;
use crate::intersect::unnormalised;

impl Work {
    pub(super) fn part(&mut self) {
        loop {
            let mesh = self.mesh();
            let adjacency = mesh.adjacency();
            let mut fans = Fans { parent: (0..3 * self.pieces.len() as u32).collect() };
            for edge in 0..adjacency.edges().len() as u32 {
                match (adjacency.edge_kind(edge), adjacency.edge_sides(edge)) {
                    (EdgeKind::Manifold, &[a, b]) => fans.glue(&mesh, a, b),
                    (EdgeKind::NonManifold, _) => {
                        for [a, b] in wedges(&mesh, &adjacency, edge) {
                            fans.glue(&mesh, a, b);
                        }
                    }
                    _ => {}
                }
            }
            // The first fan of a vertex keeps it.
            let mut owner = vec![u32::MAX; self.points.len()];
            let mut vertex_of = vec![u32::MAX; fans.parent.len()];
            for corner in 0..fans.parent.len() as u32 {
                let (piece, k) = (corner as usize / 3, corner as usize % 3);
                let vertex = mesh.triangles()[piece][k];
                let fan = fans.root(corner) as usize;
                if vertex_of[fan] == u32::MAX {
                    vertex_of[fan] =
                        if owner[vertex as usize] == u32::MAX { vertex } else { self.copy_of(vertex) };
                    owner[vertex as usize] = fan as u32;
                }
                self.pieces[piece].corners[k] = vertex_of[fan];
            }
            if !self.separate() {
                return;
            }
        }
    }

    /// Where copies of vertices did not help, since the sheets are connected around both ends of the edge:
    /// cuts the edge in its middle, where they are not, if its triangles enclose wedges of material in pairs;
    /// else drops triangles. Returns whether there were any.
    fn separate(&mut self) -> bool {
        let mesh = self.mesh();
        let adjacency = mesh.adjacency();
        let mut gone = vec![false; self.pieces.len()];
        let mut cut = vec![false; self.pieces.len()];
        for edge in 0..adjacency.edges().len() as u32 {
            let kind = adjacency.edge_kind(edge);
            if !matches!(kind, EdgeKind::NonManifold | EdgeKind::Misoriented) {
                continue;
            }
            let sides = adjacency.edge_sides(edge);
            if sides.len() % 2 == 0 && wedges(&mesh, &adjacency, edge).len() == sides.len() / 2 {
                // One edge of a triangle at a time: the next call cuts the others.
                if !sides.iter().any(|s| cut[s.triangle() as usize] || gone[s.triangle() as usize]) {
                    sides.iter().for_each(|side| cut[side.triangle() as usize] = true);
                    self.cut_edge(adjacency.edges()[edge as usize], sides);
                }
                continue;
            }
            let left: Vec<HalfEdge> =
                sides.iter().copied().filter(|side| !gone[side.triangle() as usize]).collect();
            let Some(first) = left.first() else { continue };
            let opposite = left.iter().find(|side| mesh.half_edge(**side) != mesh.half_edge(*first));
            for side in left.iter().filter(|side| *side != first && Some(*side) != opposite) {
                gone[side.triangle() as usize] = !cut[side.triangle() as usize];
            }
        }
        self.note_loss(&gone);
        let count = self.retain(|i| i >= gone.len() || !gone[i]);
        self.summary.unparted_triangles += count;
        count > 0 || cut.contains(&true)
    }

    /// Cuts triangles at the middle of an edge that they share.
    fn cut_edge(&mut self, [u, v]: [u32; 2], sides: &[HalfEdge]) {
        let middle = 0.5 * (self.points[u as usize] + self.points[v as usize]);
        self.add_vertex(unnormalised(middle, self.exponent), middle, true);
        let middle = self.points.len() as u32 - 1;
        for side in sides {
            let piece = &mut self.pieces[side.triangle() as usize];
            let mut rest = *piece;
            piece.corners[(side.side() as usize + 1) % 3] = middle;
            rest.corners[side.side() as usize] = middle;
            self.pieces.push(rest);
        }
        self.changed = true;
    }
}

/// The corners of triangles (3 t + k), as a union-find forest whose trees are fans.
struct Fans {
    parent: Vec<u32>,
}

impl Fans {
    fn root(&mut self, mut corner: u32) -> u32 {
        while self.parent[corner as usize] != corner {
            let above = self.parent[self.parent[corner as usize] as usize];
            self.parent[corner as usize] = above;
            corner = above;
        }
        corner
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }

    /// Glues two triangles together along the sides that they share.
    fn glue(&mut self, mesh: &TriMesh, a: HalfEdge, b: HalfEdge) {
        for end in mesh.half_edge(a) {
            let corner = |side: HalfEdge| {
                let corners = mesh.triangles()[side.triangle() as usize];
                let k = (0..3).find(|k| corners[*k as usize] == end);
                3 * side.triangle() + k.unwrap_or(0)
            };
            self.join(corner(a), corner(b));
        }
    }
}

/// The pairs of triangles around an edge that enclose wedges of material; no two wedges cut each other.
fn wedges(mesh: &TriMesh, adjacency: &Adjacency, edge: u32) -> Vec<[HalfEdge; 2]> {
    let [u, v] = adjacency.edges()[edge as usize].map(|v| mesh.vertices()[v as usize]);
    let axis = (v - u).normalize_or(DVec3::X);
    let (across, up) = axis.any_orthonormal_pair();
    let (across, up) = if across.cross(up).dot(axis) > 0.0 { (across, up) } else { (up, across) };
    let mut around: Vec<(f64, HalfEdge, bool)> = (adjacency.edge_sides(edge).iter())
        .map(|side| {
            let corners = mesh.triangles()[side.triangle() as usize];
            let apex = mesh.vertices()[corners[(side.side() as usize + 2) % 3] as usize] - u;
            // A triangle that runs along the edge's direction has its material clockwise of it.
            let closes = mesh.half_edge(*side)[0] == adjacency.edges()[edge as usize][0];
            (apex.dot(up).atan2(apex.dot(across)), *side, closes)
        })
        .collect();
    around.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    // Matching parentheses on a circle: sides that are open at the end of the first round are open at the
    // start of the next.
    let mut matched = vec![false; around.len()];
    let mut open: Vec<usize> = Vec::new();
    let mut pairs: Vec<[HalfEdge; 2]> = Vec::new();
    for round in 0..2 {
        for (i, (_, side, closes)) in around.iter().enumerate().filter(|(_, s)| round == 0 || s.2) {
            if !closes {
                open.push(i);
            } else if !matched[i]
                && let Some(opening) = open.pop()
            {
                (matched[i], matched[opening]) = (true, true);
                pairs.push([around[opening].1, *side]);
            }
        }
    }
    pairs
}
