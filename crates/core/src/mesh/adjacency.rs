//! Connectivity of a triangle mesh: its edges, the triangles at each edge, the neighbour across each side of
//! a triangle, and the triangles around each vertex.
//!
//! Half-edges are grouped by counting sort on their lower vertex, then sorted within the small group of each
//! vertex: linear in the number of triangles for bounded valence, and deterministic. Any mesh is accepted: an
//! edge may belong to any number of triangles. Triangles that name a vertex twice have no sides to share and
//! are left out.

use super::TriMesh;

/// Entry of [`Adjacency::neighbours`] where there is no single neighbour.
pub const NO_NEIGHBOUR: u32 = u32::MAX;

/// A side of a triangle, directed along its orientation: side `k` runs from corner `k` to corner `k + 1` (mod
/// 3).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct HalfEdge(u32);

impl HalfEdge {
    /// Side `side` (0, 1 or 2) of a triangle.
    pub const fn new(triangle: u32, side: u32) -> Self {
        Self(3 * triangle + side)
    }

    /// The triangle that the side belongs to.
    pub const fn triangle(self) -> u32 {
        self.0 / 3
    }

    /// Number of the side in its triangle: 0, 1 or 2. It starts at the corner of that number.
    pub const fn side(self) -> u32 {
        self.0 % 3
    }
}

/// Number of triangles that meet at an edge, and whether they agree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EdgeKind {
    /// One.
    Boundary,
    /// Two, which run along the edge in opposite directions: they agree on which side is outside.
    Manifold,
    /// Two, which run along the edge in the same direction: they disagree on which side is outside.
    Misoriented,
    /// Three or more.
    NonManifold,
}

/// The connectivity of a [`TriMesh`], made by [`TriMesh::adjacency`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Adjacency {
    edges: Vec<[u32; 2]>,
    edge_starts: Vec<u32>,
    edge_sides: Vec<HalfEdge>,
    kinds: Vec<EdgeKind>,
    triangle_edges: Vec<[u32; 3]>,
    neighbours: Vec<[u32; 3]>,
    vertex_starts: Vec<u32>,
    vertex_triangles: Vec<u32>,
}

/// Whether a triangle names a vertex twice.
pub(super) fn is_collapsed([a, b, c]: [u32; 3]) -> bool {
    a == b || b == c || c == a
}

/// Exclusive prefix sums in place: turns counts (with one spare entry at the end) into starts.
fn starts_from_counts(counts: &mut [u32]) {
    let mut sum = 0;
    for count in counts {
        sum += std::mem::replace(count, sum);
    }
}

impl TriMesh {
    /// The vertices that a triangle's side runs from and to.
    pub fn half_edge(&self, side: HalfEdge) -> [u32; 2] {
        let corners = self.triangles[side.triangle() as usize];
        [corners[side.side() as usize], corners[(side.side() as usize + 1) % 3]]
    }

    /// The mesh's connectivity. Linear time and memory in the number of vertices and triangles;
    /// deterministic.
    pub fn adjacency(&self) -> Adjacency {
        let triangles = self.triangles();
        let vertex_count = self.vertices().len();
        let sides = || {
            triangles.iter().enumerate().filter(|(_, corners)| !is_collapsed(**corners)).flat_map(
                |(t, corners)| {
                    (0..3).map(move |k| (HalfEdge::new(t as u32, k as u32), corners[k], corners[(k + 1) % 3]))
                },
            )
        };

        // A triangle has one side that starts at each of its corners, so that the same pass serves the
        // vertices.
        let mut vertex_starts = vec![0u32; vertex_count + 1];
        let mut group_starts = vec![0u32; vertex_count + 1];
        for (_, from, to) in sides() {
            vertex_starts[from as usize] += 1;
            group_starts[from.min(to) as usize] += 1;
        }
        starts_from_counts(&mut vertex_starts);
        starts_from_counts(&mut group_starts);
        let side_count = group_starts[vertex_count] as usize;

        // Each side goes into the group of its lower vertex, under the key (higher vertex, side): sorted, the
        // sides of an edge follow one another.
        let mut vertex_triangles = vec![0u32; side_count];
        let mut grouped = vec![0u64; side_count];
        let mut vertex_next = vertex_starts.clone();
        let mut group_next = group_starts.clone();
        for (side, from, to) in sides() {
            let slot = &mut vertex_next[from as usize];
            vertex_triangles[*slot as usize] = side.triangle();
            *slot += 1;
            let slot = &mut group_next[from.min(to) as usize];
            grouped[*slot as usize] = u64::from(from.max(to)) << 32 | u64::from(side.0);
            *slot += 1;
        }

        let mut adjacency = Adjacency {
            edges: Vec::with_capacity(side_count / 2),
            edge_starts: Vec::with_capacity(side_count / 2 + 1),
            edge_sides: Vec::with_capacity(side_count),
            kinds: Vec::with_capacity(side_count / 2),
            triangle_edges: vec![[NO_NEIGHBOUR; 3]; triangles.len()],
            neighbours: vec![[NO_NEIGHBOUR; 3]; triangles.len()],
            vertex_starts,
            vertex_triangles,
        };
        for low in 0..vertex_count {
            let group = &mut grouped[group_starts[low] as usize..group_starts[low + 1] as usize];
            group.sort_unstable();
            for edge in group.chunk_by(|a, b| a >> 32 == b >> 32) {
                adjacency.push_edge(triangles, [low as u32, (edge[0] >> 32) as u32], edge);
            }
        }
        adjacency.edge_starts.push(adjacency.edge_sides.len() as u32);
        adjacency
    }
}

impl Adjacency {
    fn push_edge(&mut self, triangles: &[[u32; 3]], vertices: [u32; 2], keys: &[u64]) {
        let index = self.edges.len() as u32;
        let first = self.edge_sides.len();
        self.edges.push(vertices);
        self.edge_starts.push(first as u32);
        self.edge_sides.extend(keys.iter().map(|key| HalfEdge(*key as u32)));
        let sides = &self.edge_sides[first..];
        for side in sides {
            self.triangle_edges[side.triangle() as usize][side.side() as usize] = index;
        }
        let start = |side: HalfEdge| triangles[side.triangle() as usize][side.side() as usize];
        self.kinds.push(match *sides {
            [_] => EdgeKind::Boundary,
            [a, b] => {
                self.neighbours[a.triangle() as usize][a.side() as usize] = b.triangle();
                self.neighbours[b.triangle() as usize][b.side() as usize] = a.triangle();
                if start(a) == start(b) { EdgeKind::Misoriented } else { EdgeKind::Manifold }
            }
            _ => EdgeKind::NonManifold,
        });
    }

    /// The edges as pairs of vertices, the lower first, in ascending order. Each edge is there once, however
    /// many triangles share it.
    pub fn edges(&self) -> &[[u32; 2]] {
        &self.edges
    }

    /// The triangle sides that lie at an edge, in ascending order of the triangle.
    pub fn edge_sides(&self, edge: u32) -> &[HalfEdge] {
        let edge = edge as usize;
        &self.edge_sides[self.edge_starts[edge] as usize..self.edge_starts[edge + 1] as usize]
    }

    /// Kind of an edge: the number of triangles that meet at it, and whether two of them agree in
    /// orientation.
    pub fn edge_kind(&self, edge: u32) -> EdgeKind {
        self.kinds[edge as usize]
    }

    /// The kinds of all [`edges`](Self::edges), in their order.
    pub fn edge_kinds(&self) -> &[EdgeKind] {
        &self.kinds
    }

    /// The edge between two vertices, in either order, if there is one.
    pub fn edge_between(&self, a: u32, b: u32) -> Option<u32> {
        self.edges.binary_search(&[a.min(b), a.max(b)]).ok().map(|edge| edge as u32)
    }

    /// The edge at each side of each triangle; [`NO_NEIGHBOUR`] for a triangle that names a vertex twice.
    pub fn triangle_edges(&self) -> &[[u32; 3]] {
        &self.triangle_edges
    }

    /// The other triangle at each side of each triangle, where exactly two share the edge (even if they
    /// disagree in orientation); [`NO_NEIGHBOUR`] at a boundary or a non-manifold edge.
    pub fn neighbours(&self) -> &[[u32; 3]] {
        &self.neighbours
    }

    /// The triangle across side `side` (from corner `side` to the next) of a triangle, where exactly two
    /// share the edge.
    pub fn neighbour(&self, triangle: u32, side: u32) -> Option<u32> {
        let other = self.neighbours[triangle as usize][side as usize];
        (other != NO_NEIGHBOUR).then_some(other)
    }

    /// The connected component of each triangle, numbered from 0 in the order of their first triangles, and
    /// the number of components. Triangles are connected across edges, however many share one; meeting at a
    /// vertex alone does not connect. [`NO_NEIGHBOUR`] for a triangle that names a vertex twice.
    pub fn components(&self) -> (Vec<u32>, u32) {
        let mut component = vec![NO_NEIGHBOUR; self.triangle_edges.len()];
        let mut count = 0;
        let mut pending = Vec::new();
        for seed in 0..component.len() {
            if component[seed] != NO_NEIGHBOUR || self.triangle_edges[seed][0] == NO_NEIGHBOUR {
                continue;
            }
            component[seed] = count;
            pending.push(seed);
            while let Some(t) = pending.pop() {
                for edge in self.triangle_edges[t] {
                    for other in self.edge_sides(edge).iter().map(|side| side.triangle() as usize) {
                        if component[other] == NO_NEIGHBOUR {
                            component[other] = count;
                            pending.push(other);
                        }
                    }
                }
            }
            count += 1;
        }
        (component, count)
    }

    /// The triangles around a vertex, in ascending order; without those that name a vertex twice.
    pub fn vertex_triangles(&self, vertex: u32) -> &[u32] {
        let vertex = vertex as usize;
        &self.vertex_triangles[self.vertex_starts[vertex] as usize..self.vertex_starts[vertex + 1] as usize]
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use rand::{RngExt, SeedableRng, rngs::StdRng};

    use super::super::test_shapes::{cuboid, sphere, tangle, tetrahedron, together};
    use super::*;

    #[test]
    fn a_tetrahedron_is_fully_connected() {
        let adjacency = tetrahedron().adjacency();
        assert_eq!(adjacency.edges(), [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]);
        assert!(adjacency.edge_kinds().iter().all(|kind| *kind == EdgeKind::Manifold));
        // Triangle [0, 2, 1] meets [0, 3, 2] at 0–2, [1, 2, 3] at 2–1 and [0, 1, 3] at 1–0.
        assert_eq!(adjacency.neighbours()[0], [2, 3, 1]);
        assert_eq!(adjacency.vertex_triangles(3), [1, 2, 3]);
        assert_eq!(adjacency.edge_between(3, 1), Some(4));
        assert_eq!(adjacency.edge_between(1, 1), None);
        assert_eq!(adjacency.components(), (vec![0; 4], 1));
    }

    #[test]
    fn a_closed_surface_has_the_edges_that_euler_counts() {
        let mesh = sphere(1.0, 4);
        let adjacency = mesh.adjacency();
        assert_eq!(mesh.vertices().len() + mesh.triangles().len(), adjacency.edges().len() + 2);
    }

    #[test]
    fn components_are_numbered_in_order() {
        let block = cuboid(glam::DVec3::ZERO, glam::DVec3::ONE);
        let (labels, count) = together(&[tetrahedron(), block, tetrahedron()]).adjacency().components();
        assert_eq!(count, 3);
        assert_eq!(labels, [vec![0; 4], vec![1; 12], vec![2; 4]].concat());
    }

    #[test]
    fn any_tangle_agrees_with_a_dictionary_of_edges() {
        const SEED: u64 = 22;
        let random = &mut StdRng::seed_from_u64(SEED);
        for round in 0..2000 {
            let (vertices, triangles) = (random.random_range(1..12), random.random_range(0..25));
            let mesh = tangle(random, vertices, triangles);
            let adjacency = mesh.adjacency();
            let mut expected: BTreeMap<[u32; 2], Vec<HalfEdge>> = BTreeMap::new();
            for (t, corners) in mesh.triangles().iter().enumerate() {
                let collapsed = is_collapsed(*corners);
                assert_eq!(adjacency.triangle_edges()[t][0] == NO_NEIGHBOUR, collapsed);
                for k in (0..3).filter(|_| !collapsed) {
                    let (a, b) = (corners[k], corners[(k + 1) % 3]);
                    expected.entry([a.min(b), a.max(b)]).or_default().push(HalfEdge::new(t as u32, k as u32));
                }
            }
            let context = format!("seed {SEED}, round {round}: {:?}", mesh.triangles());
            assert!(adjacency.edges().iter().eq(expected.keys()), "{context}");
            for (edge, (vertices, sides)) in (0..).zip(&expected) {
                assert_eq!(adjacency.edge_sides(edge), sides, "{context}");
                assert_eq!(adjacency.edge_between(vertices[1], vertices[0]), Some(edge));
                let kind = match **sides {
                    [_] => EdgeKind::Boundary,
                    [a, b] if mesh.half_edge(a) == mesh.half_edge(b) => EdgeKind::Misoriented,
                    [_, _] => EdgeKind::Manifold,
                    _ => EdgeKind::NonManifold,
                };
                assert_eq!(adjacency.edge_kind(edge), kind, "{context}");
                for side in sides {
                    let (t, k) = (side.triangle(), side.side());
                    assert_eq!(adjacency.triangle_edges()[t as usize][k as usize], edge, "{context}");
                    let other = sides.iter().find(|other| *other != side).map(|other| other.triangle());
                    assert_eq!(adjacency.neighbour(t, k), other.filter(|_| sides.len() == 2), "{context}");
                }
            }
            for v in 0..vertices {
                let around: Vec<u32> = (0u32..)
                    .zip(mesh.triangles())
                    .filter(|(_, corners)| corners.contains(&v) && !is_collapsed(**corners))
                    .map(|(t, _)| t)
                    .collect();
                assert_eq!(adjacency.vertex_triangles(v), around, "{context}");
            }
            let (labels, count) = adjacency.components();
            for sides in expected.values() {
                let label = |side: &HalfEdge| labels[side.triangle() as usize];
                assert!(sides.iter().all(|side| label(side) == label(&sides[0])), "{context}");
            }
            // Labels that edges join are equal; their number shows that no others are.
            let mut parents: Vec<usize> = (0..triangles).collect();
            let mut separate =
                mesh.triangles().iter().filter(|corners| !is_collapsed(**corners)).count() as u32;
            for pair in expected.values().flat_map(|sides| sides.windows(2)) {
                let [a, b] = [pair[0], pair[1]].map(|side| parents[side.triangle() as usize]);
                separate -= u32::from(a != b);
                parents.iter_mut().filter(|p| **p == b).for_each(|p| *p = a);
            }
            assert_eq!(count, separate, "{context}");
        }
    }
}
