//! Openings of a surface.

use std::collections::HashMap;

use glam::DVec3;
use palpate_core::TriMesh;
use serde::Serialize;

/// The openings of a surface: sets of edges of a single triangle that are connected at vertices.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Openings {
    /// Number of openings.
    pub count: usize,
    /// Longest diagonal of an opening's bounding box, m. A ball that is larger does not pass.
    pub largest: f64,
}

/// Finds the openings of a surface. A surface without is closed, or has edges of three triangles and more.
pub fn openings(mesh: &TriMesh) -> Openings {
    let adjacency = mesh.adjacency();
    let mut target: Vec<u32> = (0..mesh.vertices().len() as u32).collect();
    let border: Vec<[u32; 2]> = (0..adjacency.edges().len() as u32)
        .filter(|edge| adjacency.edge_sides(*edge).len() == 1)
        .map(|edge| adjacency.edges()[edge as usize])
        .collect();
    for ends in &border {
        let [a, b] = ends.map(|v| crate::repair::root(&mut target, v));
        target[a.max(b) as usize] = a.min(b);
    }
    let mut boxes: HashMap<u32, [DVec3; 2]> = HashMap::new();
    for &v in border.iter().flatten() {
        let p = mesh.vertices()[v as usize];
        let [low, high] = boxes
            .entry(crate::repair::root(&mut target, v))
            .or_insert([DVec3::INFINITY, DVec3::NEG_INFINITY]);
        (*low, *high) = (low.min(p), high.max(p));
    }
    let extents = boxes.values().map(|[low, high]| low.distance(*high)).filter(|extent| extent.is_finite());
    Openings { count: boxes.len(), largest: extents.fold(0.0, f64::max) }
}
