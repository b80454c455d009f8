//! The dual hierarchy of contact levels of detail (§3.2): at once a multiresolution representation of an
//! object and a bounding volume hierarchy of convex hulls, laid out for the query that reads it.
//!
//! Nodes are stored root first and level by level, so that the children of a node, and the nodes of a level,
//! are contiguous. A node's hull vertices are contiguous too, first those that only bound its descendants,
//! then the extreme points of its own patch, then the rest. Vertices and triangles stand in the order of the
//! nodes that they belong to, and nodes share none. [`Parts::validate`] lists all that queries rely on.
//!
//! [`Parts`] is the hierarchy as builders make it and as files hold it, at full precision. [`Clod`] is the
//! same hierarchy in little memory, for queries.

mod format;
mod packed;
#[cfg(test)]
mod tests;
mod validation;
mod views;

use std::ops::Range;

use glam::DVec3;
use serde::{Deserialize, Serialize};

pub use format::ClodError;
pub use packed::Clod;
pub use views::{Areas, Nodes, Points, Triangles};

/// Index of no node: the root's parent.
pub const NO_NODE: u32 = u32::MAX;

/// A hierarchy of contact levels of detail in parts that can be changed. Lengths in metres, in the object's
/// own frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parts {
    /// Levels, the full mesh (index 0) first, the root's level last.
    pub levels: Vec<Level>,
    /// Nodes, the root first, level by level down to the leaves (level 0).
    pub nodes: Vec<Node>,
    /// Hull vertices of all nodes, in the nodes' order, m. A vertex that several hulls have is there once
    /// for each.
    pub vertices: Vec<DVec3>,
    /// D, the support area (m²) of each hull vertex (§3.3.5).
    pub support_areas: Vec<f64>,
    /// Surface triangles of all patches, in the nodes' order, as indices into the node's own hull vertices.
    pub triangles: Vec<[u32; 3]>,
    /// The mesh that the hierarchy was built from.
    pub source: Source,
}

/// The mesh that a hierarchy was built from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Source {
    /// Vertices of the mesh.
    pub vertices: u32,
    /// Triangles of the mesh.
    pub triangles: u32,
    /// Tolerance that the patches were built with, as a fraction of the bounding radius, 0 to 1: largest
    /// distance of a patch's surface from its own hull, and largest depth of other surface in that hull.
    pub tolerance: f64,
    /// Whether the mesh is closed, 2-manifold and consistently oriented, so that inside and outside are
    /// defined.
    pub solid: bool,
    /// Radius of the mesh's bounding sphere about its [`center`](Self::center), m.
    pub bounding_radius: f64,
    /// Centre of the bounding sphere, m.
    pub center: DVec3,
    /// Volume, m³; 0 when the mesh is not solid.
    pub volume: f64,
    /// Centre of mass at uniform density, m; the bounding sphere's centre when the mesh is not solid.
    pub center_of_mass: DVec3,
    /// Inertia tensor about the centre of mass, mesh axes, for unit mass (m²): a solid's, or the bounding
    /// ball's when the mesh is not solid.
    pub unit_inertia: glam::DMat3,
}

/// One level of detail.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Level {
    /// The level's nodes.
    pub nodes: Range<u32>,
    /// Triangles of the level's mesh; for a free level, those of the coarsest level that is not free.
    pub triangles: u32,
    /// r: resolution of the level, 1/m (§3.3.3). For a free level that of the coarsest level that is not
    /// free.
    pub resolution: f64,
    /// Whether the level was made by unconstrained merging: it completes the hierarchy and cannot report
    /// contacts.
    pub free: bool,
}

/// A convex hull and, unless its level is free, the convex surface patch it encloses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Node {
    /// Parent node, or [`NO_NODE`].
    pub parent: u32,
    /// Child nodes, one level finer; empty for a leaf.
    pub children: Range<u32>,
    /// Index into [`Parts::levels`].
    pub level: u32,
    /// Vertices of the patch's hull: a range of [`Parts::vertices`], the [`extreme`](Self::extreme) ones
    /// first.
    pub vertices: Range<u32>,
    /// Number of the vertices that are extreme points of the patch's hull. The others are patch vertices
    /// that lie on its faces.
    pub extreme: u32,
    /// Number of points, right before the vertices, that belong to the [bounding hull](Parts::bounding_hull)
    /// besides the extreme ones.
    pub added: u32,
    /// The patch's triangles, which are real surface: a range of [`Parts::triangles`]; empty for a free
    /// node. Hull faces not covered by them are virtual.
    pub triangles: Range<u32>,
    /// Centre of a sphere around the bounding hull and all descendants' hulls, m.
    pub center: DVec3,
    /// Radius of that sphere, m.
    pub radius: f64,
    /// s: surface deviation of the patch from the original mesh, m (§3.3.5).
    pub deviation: f64,
    /// h: maximum directed Hausdorff distance from the descendants' hulls to this node's bounding hull, m
    /// (§3.3.5).
    pub hausdorff: f64,
    /// Whether the hull was verified not to protrude from the object (§3.3.1, global constraint), so that a
    /// witness on a virtual face can be left to a neighbouring patch.
    pub contained: bool,
    /// Whether the patch covers the whole hull (a closed convex component): no face is virtual.
    pub all_real: bool,
}

/// Range of the points of a node's bounding hull among all vertices.
fn bounding_range(node: &Node) -> Range<usize> {
    let start = node.vertices.start;
    (start - node.added) as usize..(start + node.extreme) as usize
}

impl Parts {
    /// Index of the root node.
    pub const ROOT: u32 = 0;

    /// All hull vertices of a node, m, extreme points first.
    pub fn hull(&self, node: &Node) -> &[DVec3] {
        &self.vertices[node.vertices.start as usize..node.vertices.end as usize]
    }

    /// The extreme points of a node's hull, m.
    pub fn extreme(&self, node: &Node) -> &[DVec3] {
        &self.hull(node)[..node.extreme as usize]
    }

    /// The points, m, whose convex hull bounds a node, and its descendants to within h, for culling: the
    /// extreme points of its own hull, and others that reduce h (§3.6.2). Not all of them need be extreme.
    pub fn bounding_hull(&self, node: &Node) -> &[DVec3] {
        &self.vertices[bounding_range(node)]
    }

    /// D, the support areas (m²) of the points of a node's [`bounding_hull`](Self::bounding_hull), in their
    /// order.
    pub fn bounding_areas(&self, node: &Node) -> &[f64] {
        &self.support_areas[bounding_range(node)]
    }

    /// The surface triangles of a node's patch, as indices into [`hull`](Self::hull).
    pub fn patch(&self, node: &Node) -> &[[u32; 3]] {
        &self.triangles[node.triangles.start as usize..node.triangles.end as usize]
    }

    /// Radius of the bounding sphere of the mesh that the hierarchy was built from, m.
    pub fn bounding_radius(&self) -> f64 {
        self.source.bounding_radius
    }

    /// The nodes of a level, by its index in [`levels`](Self::levels).
    pub fn level(&self, level: usize) -> &[Node] {
        let nodes = &self.levels[level].nodes;
        &self.nodes[nodes.start as usize..nodes.end as usize]
    }

    /// The nodes of the full mesh, level 0.
    pub fn leaves(&self) -> &[Node] {
        self.level(0)
    }

    /// The children of a node; empty for a leaf.
    pub fn children(&self, node: &Node) -> &[Node] {
        &self.nodes[node.children.start as usize..node.children.end as usize]
    }

    /// D, the support areas (m²) of a node's hull vertices, in the order of [`hull`](Self::hull).
    pub fn support_areas(&self, node: &Node) -> &[f64] {
        &self.support_areas[node.vertices.start as usize..node.vertices.end as usize]
    }

    /// The hierarchy of the object made larger by a factor about its frame's origin; `None` if the factor is
    /// not positive and finite, or so large or small that lengths or areas are lost.
    pub fn scaled(&self, factor: f64) -> Option<Self> {
        let areas = factor * factor;
        let volumes = areas * factor;
        if ![factor, areas, volumes].iter().all(|x| x.is_normal() && *x > 0.0) {
            return None;
        }
        let mut scaled = self.clone();
        scaled.levels.iter_mut().for_each(|level| level.resolution /= factor);
        scaled.vertices.iter_mut().for_each(|vertex| *vertex *= factor);
        scaled.support_areas.iter_mut().for_each(|area| *area *= areas);
        for node in &mut scaled.nodes {
            node.center *= factor;
            node.radius *= factor;
            node.deviation *= factor;
            node.hausdorff *= factor;
        }
        let source = &mut scaled.source;
        source.bounding_radius *= factor;
        source.center *= factor;
        source.volume *= volumes;
        source.center_of_mass *= factor;
        source.unit_inertia *= areas;
        scaled.validate().is_ok().then_some(scaled)
    }
}
