//! The features of a surface that may be the first to touch another one, in hierarchies of spheres.
//!
//! Two surfaces that come together touch first where a vertex of one meets the other, or where edges of both
//! cross. Such a vertex, or edge, is convex: over a concave or a flat one, the surface beside it is as near.
//! So all first contacts are at the convex edges of either surface and at their ends. A vertex stands for
//! those edges around it that are short; longer ones are searched by themselves.

use glam::DVec3;

use super::{FeatureMesh, NONE, Place};
use crate::exact::Nearest;

/// Number of children of a node.
const CHILDREN: usize = 4;

/// Cosine of the angle between the pseudonormal of a vertex and its faces' normals below which it is a tip.
/// Corners of boxes are tips; vertices within their edges are not.
const TIP: f64 = 0.7;

/// A sphere around features of a surface.
#[derive(Clone, Debug)]
pub struct Node {
    /// Centre of the sphere in the mesh's frame, m.
    pub center: DVec3,
    /// Radius of the sphere, m.
    pub radius: f64,
    /// Half of the longest convex edge at the vertices, or among the edges, m.
    pub extent: f64,
    /// Whether one of its vertices is a tip: a vertex of whose faces one is steep.
    pub has_tip: bool,
    /// Index of the node above; that of the root is its own.
    pub parent: u32,
    /// The nodes below; none below a single feature.
    pub children: std::ops::Range<u32>,
    /// Index of the vertex or edge, if it is a single one.
    pub feature: u32,
}

/// Convex features of a surface. The root is the first node; without features, there are no nodes.
#[derive(Clone, Debug, Default)]
pub struct FeatureTree {
    /// Ends of convex edges.
    pub vertices: Vec<Node>,
    /// Convex edges.
    pub edges: Vec<Node>,
}

impl FeatureTree {
    /// Makes the hierarchies of a mesh's features.
    pub(super) fn new(mesh: &FeatureMesh) -> Self {
        let convex: Vec<u32> = (0..mesh.edges.len() as u32).filter(|edge| mesh.is_convex(*edge)).collect();
        let mut extents = vec![f64::NAN; mesh.vertices.len()];
        let mut edges = Vec::with_capacity(convex.len());
        for edge in convex {
            let [from, to] = mesh.ends(edge);
            let half = 0.5 * from.distance(to);
            for end in mesh.edges[edge as usize] {
                // The larger of both, or the one that is a number.
                extents[end as usize] = half.max(extents[end as usize]);
            }
            edges.push(Node {
                center: from.midpoint(to),
                radius: half,
                extent: half,
                has_tip: false,
                parent: 0,
                children: 0..0,
                feature: edge,
            });
        }
        let ends = extents.iter().enumerate().filter(|(_, extent)| !extent.is_nan());
        let mut vertices: Vec<Node> = ends
            .map(|(vertex, &extent)| Node {
                center: mesh.vertices[vertex],
                radius: 0.0,
                extent,
                has_tip: mesh.is_tip(vertex as u32),
                parent: 0,
                children: 0..0,
                feature: vertex as u32,
            })
            .collect();
        Self { vertices: hierarchy(&mut vertices), edges: hierarchy(&mut edges) }
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        (self.vertices.capacity() + self.edges.capacity()) * size_of::<Node>()
    }
}

impl FeatureMesh {
    /// Whether the faces at an edge face away from each other, or one is missing.
    fn is_convex(&self, edge: u32) -> bool {
        let [a, b] = self.sides[edge as usize];
        if b == NONE || !self.is_sharp(edge) {
            return b == NONE;
        }
        let ends = self.edges[edge as usize];
        let opposite = self.faces[b as usize].corners.into_iter().find(|corner| !ends.contains(corner));
        let from = self.vertices[ends[0] as usize];
        // A face without an area has no third corner to the side of the edge.
        opposite.is_none_or(|corner| {
            self.faces[a as usize].normal.dot(self.vertices[corner as usize] - from) <= 0.0
        })
    }

    fn is_tip(&self, vertex: u32) -> bool {
        let normal = self.normals[vertex as usize];
        self.faces_around.of(vertex).iter().any(|face| self.faces[*face as usize].normal.dot(normal) < TIP)
    }

    /// The convex features.
    pub fn tree(&self) -> &FeatureTree {
        &self.tree
    }

    /// Whether each edge has faces on both sides, so that there is an inside.
    pub fn is_closed(&self) -> bool {
        self.is_closed
    }

    /// The point of the surface nearest to another one, m. `hint` is that of a search nearby; 0 is one, too.
    pub fn nearest_from(&self, p: DVec3, hint: u32) -> Nearest {
        self.exact.nearest(p, hint)
    }

    /// The face nearest to a point, m; `hint` is that of a [search](Self::nearest_from) nearby.
    pub fn face_near(&self, p: DVec3, hint: u32) -> u32 {
        self.exact.nearest(p, hint).triangle
    }

    /// Normal of the face that a hint is for.
    pub fn normal_of(&self, hint: u32) -> DVec3 {
        self.exact.normal(hint)
    }

    /// A unit direction at a place: the pseudonormal of a vertex, or along an edge.
    pub fn direction(&self, place: &Place) -> DVec3 {
        match *place {
            Place::Vertex(vertex) => self.normals[vertex as usize],
            Place::Edge(edge, _) => {
                let [from, to] = self.ends(edge);
                (to - from).normalize_or(DVec3::Z)
            }
        }
    }

    /// The ends of an edge, m.
    pub fn ends_of(&self, edge: u32) -> [DVec3; 2] {
        self.ends(edge)
    }
}

/// Puts single features into a hierarchy.
fn hierarchy(features: &mut [Node]) -> Vec<Node> {
    let mut nodes = Vec::with_capacity(4 * features.len() / 3 + 1);
    if !features.is_empty() {
        nodes.push(around(features));
        divide(features, 0, &mut nodes);
    }
    nodes
}

/// Appends the nodes below one, which is around more than one feature.
fn divide(features: &mut [Node], node: usize, nodes: &mut Vec<Node>) {
    if features.len() < 2 {
        return;
    }
    let first = nodes.len();
    let own: Vec<&mut [Node]> =
        if features.len() <= CHILDREN { features.chunks_mut(1).collect() } else { quarters(features) };
    nodes.extend(own.iter().map(|own| Node { parent: node as u32, ..around(own) }));
    nodes[node].children = first as u32..nodes.len() as u32;
    for (index, own) in own.into_iter().enumerate() {
        divide(own, first + index, nodes);
    }
}

fn quarters(features: &mut [Node]) -> Vec<&mut [Node]> {
    let (left, right) = halves(features);
    [left, right].into_iter().flat_map(|half| <[_; 2]>::from(halves(half))).collect()
}

/// Reorders features along the longest axis of their centres' box, so that those of one half are before those
/// of the other, and divides them.
fn halves(features: &mut [Node]) -> (&mut [Node], &mut [Node]) {
    let centers = || features.iter().map(|node| node.center);
    let low = centers().fold(DVec3::INFINITY, DVec3::min);
    let high = centers().fold(DVec3::NEG_INFINITY, DVec3::max);
    let axis = (high - low).max_position();
    let middle = features.len() / 2;
    features.select_nth_unstable_by(middle, |a, b| {
        a.center[axis].total_cmp(&b.center[axis]).then(a.feature.cmp(&b.feature))
    });
    features.split_at_mut(middle)
}

/// The node around some features.
fn around(features: &[Node]) -> Node {
    if let [single] = features {
        return single.clone();
    }
    let low = features.iter().fold(DVec3::INFINITY, |low, node| low.min(node.center - node.radius));
    let high = features.iter().fold(DVec3::NEG_INFINITY, |high, node| high.max(node.center + node.radius));
    let center = low.midpoint(high);
    let farthest = |most: f64, node: &Node| most.max(center.distance(node.center) + node.radius);
    Node {
        center,
        radius: features.iter().fold(0.0, farthest),
        extent: features.iter().fold(0.0, |most: f64, node| most.max(node.extent)),
        has_tip: features.iter().any(|node| node.has_tip),
        parent: 0,
        children: 0..0,
        feature: 0,
    }
}

#[cfg(test)]
mod tests {
    use palpate_core::TriMesh;
    use palpate_models::Model;

    use super::*;

    /// All nodes below one that stand for single features.
    fn singles<'a>(nodes: &'a [Node], node: &'a Node) -> Vec<&'a Node> {
        if node.children.is_empty() {
            return vec![node];
        }
        let below = &nodes[node.children.start as usize..node.children.end as usize];
        below.iter().flat_map(|node| singles(nodes, node)).collect()
    }

    #[test]
    fn spheres_hold_what_is_below_them() {
        for model in [Model::Gear, Model::Torus, Model::Cup] {
            let mesh = model.generate(3000).expect("in range");
            let features = FeatureMesh::new(&mesh);
            let tree = features.tree();
            for nodes in [&tree.vertices, &tree.edges] {
                let mut seen: Vec<u32> = singles(nodes, &nodes[0]).iter().map(|node| node.feature).collect();
                seen.sort_unstable();
                seen.dedup();
                assert_eq!(seen.len(), nodes.iter().filter(|node| node.children.is_empty()).count());
                for node in nodes {
                    for child in node.children.clone() {
                        assert!(std::ptr::eq(&nodes[nodes[child as usize].parent as usize], node));
                    }
                    for single in singles(nodes, node) {
                        let far = node.center.distance(single.center) + single.radius;
                        assert!(far <= node.radius * (1.0 + 1e-12) && single.extent <= node.extent);
                    }
                }
            }
        }
    }

    /// Of a block with a pit, the floor's edges and the upright ones in it are no convex features, and
    /// neither are the diagonals of its faces.
    #[test]
    fn convex_edges_of_a_block_with_a_pit() {
        let mesh = pit();
        let features = FeatureMesh::new(&mesh);
        let tree = features.tree();
        let edges = tree.edges.iter().filter(|node| node.children.is_empty()).count();
        let tips = tree.vertices.iter().filter(|node| node.children.is_empty() && node.has_tip).count();
        // Twelve edges outside and four around the pit; eight corners outside.
        assert_eq!((edges, tree.vertices.iter().filter(|node| node.children.is_empty()).count()), (16, 12));
        assert!(tips >= 8, "{tips}");
    }

    /// A block of 2 m with a pit of 1 m in its top.
    fn pit() -> TriMesh {
        let square = |half: f64, z: f64| {
            [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
                .map(|(x, y)| DVec3::new(half * x, half * y, z))
        };
        let vertices = [square(1.0, -1.0), square(1.0, 1.0), square(0.5, 1.0), square(0.5, 0.0)].concat();
        let mut triangles = vec![[0, 2, 1], [0, 3, 2], [12, 13, 14], [12, 14, 15]];
        for i in 0..4 {
            let j = (i + 1) % 4;
            for (low, high) in [(0, 4), (4, 8), (8, 12)] {
                triangles.extend([[low + i, low + j, high + j], [low + i, high + j, high + i]]);
            }
        }
        TriMesh::new(vertices, triangles).expect("a mesh")
    }
}
