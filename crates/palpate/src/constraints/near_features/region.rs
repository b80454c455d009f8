//! Regions of a body's convex features: the nodes of their hierarchies, and the parts of long edges.

use arrayvec::ArrayVec;
use palpate_core::glam::DVec3;
use palpate_field::{FeatureMesh, FeatureNode, FeatureTree};

/// Number of a part of an edge from which it is not divided.
const LAST_PART: u32 = 1 << 30;

/// Largest number of regions that one is divided into.
pub const CHILDREN: usize = 4;

/// Features of one body within a sphere.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Region {
    pub is_probe: bool,
    pub within: Within,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Within {
    /// A node of the hierarchy of vertices, or of edges.
    Vertices(u32),
    Edges(u32),
    /// A part of a long edge, by its node. The edge is part 1, and the halves of part i are 2 i and 2 i + 1.
    Part(u32, u32),
}

/// The sphere around a region.
#[derive(Clone, Copy, Debug)]
pub struct Sphere {
    pub center: DVec3,
    pub radius: f64,
    /// How far its features are from there, m: edges reach out of it.
    pub extent: f64,
    pub has_tip: bool,
    pub is_single: bool,
}

impl Region {
    /// The region above; `None` above a whole hierarchy.
    pub fn above(&self, tree: &FeatureTree) -> Option<Self> {
        let parent = |nodes: &[FeatureNode], node: u32| (node > 0).then(|| nodes[node as usize].parent);
        let within = match self.within {
            Within::Vertices(node) => Within::Vertices(parent(&tree.vertices, node)?),
            Within::Edges(node) => Within::Edges(parent(&tree.edges, node)?),
            Within::Part(node, 2 | 3) => Within::Edges(node),
            Within::Part(node, part) => Within::Part(node, part / 2),
        };
        Some(Self { within, ..*self })
    }

    /// The regions below, of which edges are longer than `long` (m).
    pub fn below(&self, tree: &FeatureTree, long: f64) -> ArrayVec<Self, CHILDREN> {
        let Self { is_probe, within } = *self;
        let region = |within: Within| Self { is_probe, within };
        match within {
            Within::Vertices(node) => tree.vertices[node as usize]
                .children
                .clone()
                .map(|node| region(Within::Vertices(node)))
                .collect(),
            Within::Edges(node) if tree.edges[node as usize].children.is_empty() => {
                [2, 3].map(|part| region(Within::Part(node, part))).into_iter().collect()
            }
            Within::Edges(node) => {
                let is_long = |node: &u32| is_long(&tree.edges[*node as usize], long);
                let below = tree.edges[node as usize].children.clone().filter(is_long);
                below.map(|node| region(Within::Edges(node))).collect()
            }
            Within::Part(node, part) => {
                [2 * part, 2 * part + 1].map(|part| region(Within::Part(node, part))).into_iter().collect()
            }
        }
    }

    /// The sphere around it, on a surface of which edges longer than `long` (m) are searched by themselves.
    pub fn sphere(&self, own: &FeatureMesh, long: f64) -> Sphere {
        let tree = own.tree();
        match self.within {
            Within::Vertices(node) => {
                let FeatureNode { center, radius, extent, has_tip, ref children, .. } =
                    tree.vertices[node as usize];
                // Edges reach out by half of their length, until another end stands for them.
                let extent = radius + extent.min(0.5 * long);
                Sphere { center, radius, extent, has_tip, is_single: children.is_empty() }
            }
            Within::Edges(node) => {
                let FeatureNode { center, radius, .. } = tree.edges[node as usize];
                Sphere { center, radius, extent: radius, has_tip: false, is_single: false }
            }
            Within::Part(node, part) => {
                let [from, to] = own.ends_of(tree.edges[node as usize].feature);
                let [first, last] = ends_of_part(part);
                let (center, radius) =
                    (from.lerp(to, 0.5 * (first + last)), 0.5 * (last - first) * from.distance(to));
                Sphere { center, radius, extent: radius, has_tip: false, is_single: part >= LAST_PART }
            }
        }
    }
}

/// Whether one of the edges in a node is longer than a length (m).
pub fn is_long(node: &FeatureNode, long: f64) -> bool {
    2.0 * node.extent > long
}

/// The shares of an edge at which a part of it begins and ends.
pub fn ends_of_part(part: u32) -> [f64; 2] {
    let parts = 1 << part.ilog2();
    [part - parts, part - parts + 1].map(|end| f64::from(end) / f64::from(parts))
}
