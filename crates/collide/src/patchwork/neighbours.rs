//! Adjacency of the patches and triangles of a level: the level's mesh, welded from its patches.
//!
//! Nodes share no vertices in a hierarchy's layout. But patches of one level are pieces of one mesh, and
//! their common vertices have the same coordinates to the last bit, by which they are welded here. Vertices
//! of different levels are never welded, so each level is a surface of its own.

use palpate_core::Clod;
use palpate_core::clod::NO_NODE;
use palpate_core::glam::DVec3;

use crate::incidence::triangles_at_vertices;

/// Mesh vertex of points that belong to no patch and only bound descendants.
const NO_VERTEX: u32 = u32::MAX;

/// Adjacency of patches, on every level that is not free.
///
/// Memory: 28 bytes a vertex of a level's mesh; 28 a triangle; 4 a node, and for every ordered pair of
/// neighbouring patches.
#[derive(Clone, Debug, Default)]
pub(crate) struct Neighbours {
    /// First node that has a patch.
    first_node: u32,
    /// Mesh vertices, m.
    points: Vec<DVec3>,
    /// Mesh vertices at the corners of each triangle.
    ends: Vec<[u32; 3]>,
    /// Start of each mesh vertex's triangles; one more at the end.
    starts: Vec<u32>,
    /// Triangles around the mesh vertices, as indices among all of the hierarchy.
    around: Vec<u32>,
    /// The node that each triangle belongs to.
    owner: Vec<u32>,
    /// Start of each node's neighbours, from the first node on; one more at the end.
    node_starts: Vec<u32>,
    /// Nodes of the same level that share a vertex, in ascending order.
    nodes: Vec<u32>,
}

impl Neighbours {
    /// Finds the neighbours of all patches.
    pub fn new(clod: &Clod) -> Self {
        let regular = || clod.levels.iter().filter(|level| !level.free);
        let Some(first_node) = regular().map(|level| level.nodes.start).min() else {
            return Self::default();
        };
        let first_vertex = clod.node(first_node).vertices.start;
        let last_vertex = clod.nodes().map(|node| node.vertices.end).max().unwrap_or(0);
        let mut found = Self {
            first_node,
            ends: vec![[NO_VERTEX; 3]; clod.patch_triangles()],
            owner: vec![NO_NODE; clod.patch_triangles()],
            ..Self::default()
        };
        // The mesh vertex that each vertex of the hierarchy, from the first on, is.
        let mut mesh_vertex = vec![NO_VERTEX; (last_vertex - first_vertex) as usize];
        for level in (0..clod.levels.len()).filter(|level| !clod.levels[*level].free) {
            found.weld(clod, level, &mut mesh_vertex, first_vertex);
        }
        for (index, node) in (0u32..).zip(clod.nodes()).skip(first_node as usize) {
            let triangles = node.triangles.start as usize..node.triangles.end as usize;
            found.owner[triangles.clone()].fill(index);
            let start = (node.vertices.start - first_vertex) as usize;
            for (ends, corners) in found.ends[triangles].iter_mut().zip(clod.patch(&node)) {
                *ends = corners.map(|corner| mesh_vertex[start + corner as usize]);
            }
        }
        (found.starts, found.around) = triangles_at_vertices(found.points.len(), found.ends.iter().copied());
        found.meet(clod);
        found
    }

    /// Welds equal vertices of a level and numbers them.
    fn weld(&mut self, clod: &Clod, level: usize, mesh_vertex: &mut [u32], first: u32) {
        let mut vertices: Vec<([u64; 3], u32)> = clod
            .level(level)
            .flat_map(|node| clod.hull(&node).iter().map(|point| bits(*point)).zip(node.vertices))
            .collect();
        vertices.sort_unstable();
        let mut last = None;
        for (key, vertex) in vertices {
            if last.replace(key) != Some(key) {
                self.points.push(DVec3::from_array(key.map(f64::from_bits)));
            }
            mesh_vertex[(vertex - first) as usize] = self.points.len() as u32 - 1;
        }
    }

    /// Lists the neighbours of every node.
    fn meet(&mut self, clod: &Clod) {
        let mut of_node = Vec::new();
        self.node_starts.push(0);
        for (index, node) in (0u32..).zip(clod.nodes()).skip(self.first_node as usize) {
            of_node.clear();
            for triangle in node.triangles.clone() {
                for vertex in self.ends(triangle) {
                    of_node.extend(self.around(vertex).iter().map(|t| self.owner(*t)));
                }
            }
            of_node.sort_unstable();
            of_node.dedup();
            self.nodes.extend(of_node.iter().filter(|other| **other != index));
            self.node_starts.push(self.nodes.len() as u32);
        }
    }

    /// A mesh vertex, m.
    pub fn point(&self, vertex: u32) -> DVec3 {
        self.points[vertex as usize]
    }

    /// Number of mesh vertices, over all levels.
    pub fn vertices(&self) -> usize {
        self.points.len()
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        let Self { points, ends, starts, around, owner, node_starts, nodes, .. } = self;
        let lists = [starts, around, owner, node_starts, nodes].map(|list| size_of_val(&**list));
        size_of_val(&**points) + size_of_val(&**ends) + lists.iter().sum::<usize>()
    }

    /// The node whose patch a triangle belongs to.
    pub fn owner(&self, triangle: u32) -> u32 {
        self.owner[triangle as usize]
    }

    /// The mesh vertices at the corners of a triangle.
    pub fn ends(&self, triangle: u32) -> [u32; 3] {
        self.ends[triangle as usize]
    }

    /// The corners of a triangle, m.
    pub fn corners(&self, triangle: u32) -> [DVec3; 3] {
        // Written out, since a map is not inlined.
        let [i, j, k] = self.ends(triangle);
        [self.points[i as usize], self.points[j as usize], self.points[k as usize]]
    }

    /// The triangles around a mesh vertex.
    pub fn around(&self, vertex: u32) -> &[u32] {
        let range = self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize;
        &self.around[range]
    }

    /// The nodes of the same level whose patches share a vertex with a node's, in ascending order; none for a
    /// free one.
    pub fn of(&self, node: u32) -> &[u32] {
        let Some(index) = node.checked_sub(self.first_node).map(|index| index as usize) else {
            return &[];
        };
        let range = self.node_starts[index] as usize..self.node_starts[index + 1] as usize;
        &self.nodes[range]
    }

    /// Whether two nodes are the same patch or neighbours. For nodes of different levels, the finer one is
    /// replaced by its ancestor on the coarser one's level.
    pub fn meets(&self, clod: &Clod, x: u32, y: u32) -> bool {
        let level = |node: u32| clod.node(node).level;
        let coarser = level(x).max(level(y));
        let lifted = |mut node: u32| {
            while level(node) < coarser {
                node = clod.node(node).parent;
            }
            node
        };
        let (x, y) = (lifted(x), lifted(y));
        x == y || self.of(x).binary_search(&y).is_ok()
    }
}

/// Coordinates as bits; −0 becomes 0.
fn bits(point: DVec3) -> [u64; 3] {
    point.to_array().map(|x| (x + 0.0).to_bits())
}
