//! An editable closed triangle mesh: flip, split and collapse of edges in constant time.
//!
//! Half-edge `3t + i` runs from corner `i` of triangle `t` to the next corner; each knows its twin. Every
//! operation keeps the mesh a closed oriented 2-manifold of the same topology, or refuses.

use std::collections::HashMap;

use palpate_core::{TriMesh, glam::DVec3};

const NONE: u32 = u32::MAX;

/// A closed triangle mesh under edit. Half-edges and vertices are plain indices; deleted ones stay until
/// [`EditableMesh::to_mesh`].
pub(crate) struct EditableMesh {
    /// Position of each vertex.
    pub(crate) positions: Vec<DVec3>,
    origin: Vec<u32>,
    twin: Vec<u32>,
    /// A half-edge that leaves each vertex; `NONE` once it is deleted.
    leaving: Vec<u32>,
    live: usize,
}

pub(crate) const fn next(h: u32) -> u32 {
    if h % 3 == 2 { h - 2 } else { h + 1 }
}

pub(crate) const fn previous(h: u32) -> u32 {
    if h.is_multiple_of(3) { h + 2 } else { h - 1 }
}

impl EditableMesh {
    /// # Panics
    /// If the mesh is not closed and consistently oriented.
    pub(crate) fn new(mesh: &TriMesh) -> Self {
        let origin: Vec<u32> = mesh.triangles().iter().flatten().copied().collect();
        let mut twin = vec![NONE; origin.len()];
        let mut open = HashMap::with_capacity(origin.len() / 2);
        let mut leaving = vec![NONE; mesh.vertices().len()];
        for h in 0..origin.len() as u32 {
            let (from, to) = (origin[h as usize], origin[next(h) as usize]);
            leaving[from as usize] = h;
            if let Some(other) = open.remove(&(to, from)) {
                twin[h as usize] = other;
                twin[other as usize] = h;
            } else {
                let before = open.insert((from, to), h);
                assert!(
                    before.is_none(),
                    "two triangles run along the edge {from}-{to} in the same direction"
                );
            }
        }
        assert!(open.is_empty(), "the mesh has {} open edges", open.len());
        Self { positions: mesh.vertices().to_vec(), live: origin.len() / 3, origin, twin, leaving }
    }

    /// Number of triangles.
    pub(crate) const fn triangles(&self) -> usize {
        self.live
    }

    /// One past the greatest half-edge index.
    pub(crate) fn half_edges(&self) -> u32 {
        self.origin.len() as u32
    }

    /// Whether the half-edge exists.
    pub(crate) fn is_live(&self, h: u32) -> bool {
        self.origin[h as usize] != NONE
    }

    /// Whether the half-edge exists and is the one of its pair that edge loops visit.
    pub(crate) fn is_edge(&self, h: u32) -> bool {
        self.origin[h as usize] != NONE && h < self.twin[h as usize]
    }

    pub(crate) fn is_live_vertex(&self, v: u32) -> bool {
        self.leaving[v as usize] != NONE
    }

    pub(crate) fn origin(&self, h: u32) -> u32 {
        self.origin[h as usize]
    }

    pub(crate) fn target(&self, h: u32) -> u32 {
        self.origin[next(h) as usize]
    }

    pub(crate) fn twin(&self, h: u32) -> u32 {
        self.twin[h as usize]
    }

    /// The vertex across from the half-edge in its triangle.
    pub(crate) fn apex(&self, h: u32) -> u32 {
        self.origin[previous(h) as usize]
    }

    /// The half-edges that leave a vertex, in order.
    pub(crate) fn around(&self, v: u32) -> impl Iterator<Item = u32> + '_ {
        let first = self.leaving[v as usize];
        std::iter::successors(Some(first), move |h| {
            let h = self.twin[previous(*h) as usize];
            (h != first).then_some(h)
        })
    }

    pub(crate) fn valence(&self, v: u32) -> usize {
        self.around(v).count()
    }

    pub(crate) fn are_neighbours(&self, a: u32, b: u32) -> bool {
        self.around(a).any(|h| self.target(h) == b)
    }

    fn pair(&mut self, a: u32, b: u32) {
        self.twin[a as usize] = b;
        self.twin[b as usize] = a;
    }

    fn set(&mut self, h: u32, origin: u32) {
        self.origin[h as usize] = origin;
        self.leaving[origin as usize] = h;
    }

    /// Turns the edge in the quadrilateral of its two triangles. The caller has seen that the far corners are
    /// not neighbours yet and that no valence falls below 3.
    pub(crate) fn flip(&mut self, h: u32) {
        let g = self.twin(h);
        let (a, b, c, d) = (self.origin(h), self.origin(g), self.apex(h), self.apex(g));
        let (bc, ca) = (self.twin(next(h)), self.twin(previous(h)));
        let (ad, db) = (self.twin(next(g)), self.twin(previous(g)));
        // h's triangle becomes d c a, g's becomes c d b.
        self.set(h, d);
        self.set(next(h), c);
        self.set(previous(h), a);
        self.set(g, c);
        self.set(next(g), d);
        self.set(previous(g), b);
        self.pair(next(h), ca);
        self.pair(previous(h), ad);
        self.pair(next(g), db);
        self.pair(previous(g), bc);
    }

    /// Puts a new vertex on the edge; gives its index.
    pub(crate) fn split(&mut self, h: u32, position: DVec3) -> u32 {
        let g = self.twin(h);
        let (b, c, d) = (self.target(h), self.apex(h), self.apex(g));
        let m = self.positions.len() as u32;
        self.positions.push(position);
        self.leaving.push(NONE);
        let first = self.half_edges();
        self.origin.extend([NONE; 6]);
        self.twin.extend([NONE; 6]);
        let (p, q) = (first, first + 3);
        let (bc, db) = (self.twin(next(h)), self.twin(previous(g)));
        // h: a b c -> a m c; p: m b c. g: b a d -> m a d; q: b m d.
        self.set(next(h), m);
        self.set(p, m);
        self.set(next(p), b);
        self.set(previous(p), c);
        self.set(g, m);
        self.set(q, b);
        self.set(next(q), m);
        self.set(previous(q), d);
        self.pair(next(h), previous(p));
        self.pair(next(p), bc);
        self.pair(previous(g), next(q));
        self.pair(previous(q), db);
        self.pair(p, q);
        self.live += 2;
        m
    }

    /// Whether the edge can be collapsed without a change of topology: its ends have no common neighbours but
    /// the two across from it, and those keep at least three neighbours.
    pub(crate) fn can_collapse(&self, h: u32) -> bool {
        let (a, b) = (self.origin(h), self.target(h));
        let (c, d) = (self.apex(h), self.apex(self.twin(h)));
        let common = self.around(a).filter(|e| self.are_neighbours(b, self.target(*e))).count();
        common == 2
            && c != d
            && self.valence(c) > 3
            && self.valence(d) > 3
            && self.valence(a) + self.valence(b) > 6
    }

    /// Merges the half-edge's origin into its target, which moves to `position`. See
    /// [`EditableMesh::can_collapse`].
    pub(crate) fn collapse(&mut self, h: u32, position: DVec3) {
        let g = self.twin(h);
        let (a, b, c, d) = (self.origin(h), self.target(h), self.apex(h), self.apex(g));
        let ring: Vec<u32> = self.around(a).collect();
        for e in ring {
            self.origin[e as usize] = b;
        }
        let (bc, ca) = (self.twin(next(h)), self.twin(previous(h)));
        let (ad, db) = (self.twin(next(g)), self.twin(previous(g)));
        self.pair(bc, ca);
        self.pair(ad, db);
        for e in [h, next(h), previous(h), g, next(g), previous(g)] {
            self.origin[e as usize] = NONE;
        }
        self.leaving[a as usize] = NONE;
        // These are twins of the deleted ones: ca runs from a (now b) to c, bc from c to b, ad from d to b.
        self.leaving[b as usize] = ca;
        self.leaving[c as usize] = bc;
        self.leaving[d as usize] = ad;
        self.positions[b as usize] = position;
        self.live -= 2;
    }

    /// The mesh as it stands, without the deleted vertices and triangles.
    pub(crate) fn to_mesh(&self) -> TriMesh {
        let mut index = vec![NONE; self.positions.len()];
        let mut vertices = Vec::new();
        for (v, position) in self.positions.iter().enumerate() {
            if self.leaving[v] != NONE {
                index[v] = vertices.len() as u32;
                vertices.push(*position);
            }
        }
        let triangles = self
            .origin
            .chunks_exact(3)
            .filter(|corners| corners[0] != NONE)
            .map(|corners| [0, 1, 2].map(|i| index[corners[i] as usize]))
            .collect();
        TriMesh::new(vertices, triangles).expect("every corner is a live vertex")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn octahedron() -> TriMesh {
        let vertices = [DVec3::X, DVec3::Y, -DVec3::X, -DVec3::Y, DVec3::Z, -DVec3::Z].to_vec();
        let triangles = [0, 1, 2, 3].into_iter().flat_map(|i| [[i, (i + 1) % 4, 4], [(i + 1) % 4, i, 5]]);
        TriMesh::new(vertices, triangles.collect()).unwrap()
    }

    #[test]
    fn any_sequence_of_edits_leaves_a_closed_oriented_sphere() {
        let mut mesh = EditableMesh::new(&octahedron());
        // A linear congruential generator, seed 1.
        let mut state = 1_u64;
        let mut random = move |below: u32| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 33) % u64::from(below)) as u32
        };
        let mut done = [0; 3];
        for _ in 0..20_000 {
            let h = random(mesh.half_edges());
            if !mesh.is_edge(h) {
                continue;
            }
            let middle =
                mesh.positions[mesh.origin(h) as usize].midpoint(mesh.positions[mesh.target(h) as usize]);
            let choice = random(3) as usize;
            let ends = [mesh.origin(h), mesh.target(h)];
            match choice {
                0 if mesh.triangles() < 400 => _ = mesh.split(h, middle),
                1 if mesh.can_collapse(h) => mesh.collapse(h, middle),
                2 if ends.iter().all(|v| mesh.valence(*v) > 3)
                    && !mesh.are_neighbours(mesh.apex(h), mesh.apex(mesh.twin(h))) =>
                {
                    mesh.flip(h);
                }
                _ => continue,
            }
            done[choice] += 1;
            let sum: usize = done.iter().sum();
            if sum.is_multiple_of(50) {
                let now = mesh.to_mesh();
                assert_eq!(now.triangles().len(), mesh.triangles());
                let report = now.validate();
                assert!(report.closed && report.manifold && report.oriented, "{report:?}");
                assert_eq!(report.vertices as i64 - now.triangles().len() as i64 / 2, 2);
                // The links agree with those that the triangles alone imply.
                assert_eq!(EditableMesh::new(&now).half_edges() as usize, 3 * now.triangles().len());
            }
        }
        assert!(done.iter().all(|n| *n > 500), "{done:?}");
    }
}
