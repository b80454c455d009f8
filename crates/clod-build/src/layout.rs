//! Lays the hierarchy out for the query that reads it: root first, level by level, children and hull vertices contiguous.

use glam::DVec3;
use palpate_core::TriMesh;
use palpate_core::clod::{Clod, Level, NO_NODE, Node, Source};

use crate::decomposition::Decomposition;
use crate::hierarchy::Cluster;

/// What the layout draws on.
pub(crate) struct Parts<'a> {
    pub mesh: &'a TriMesh,
    pub decomposition: &'a Decomposition,
    /// Levels of clusters, patches first.
    pub levels: &'a [Vec<Cluster>],
    /// D of the mesh's vertices, m².
    pub support_areas: &'a [f64],
    /// r of the full mesh, 1/m.
    pub resolution: f64,
    /// Per patch, whether its hull is verified to lie inside the object.
    pub contained: &'a [bool],
    /// Per patch, whether it covers its hull.
    pub all_real: &'a [bool],
    /// From unit coordinates to metres: p / scale + center.
    pub scale: f64,
    pub center: DVec3,
}

/// The hierarchy.
pub(crate) fn lay_out(parts: &Parts<'_>, source: Source) -> Clod {
    let count: usize = parts.levels.iter().map(Vec::len).sum();
    let mut clod = Clod {
        levels: Vec::with_capacity(parts.levels.len()),
        nodes: Vec::with_capacity(count),
        vertices: Vec::new(),
        support_areas: Vec::new(),
        triangles: Vec::with_capacity(parts.mesh.triangles().len()),
        source,
    };
    let mut local = vec![u32::MAX; parts.mesh.vertices().len()];
    // The clusters of a level in the order of their nodes, with their parents.
    let mut order: Vec<(u32, u32)> = vec![(0, NO_NODE)];
    for (level, clusters) in parts.levels.iter().enumerate().rev() {
        let start = clod.nodes.len() as u32;
        let mut next_child = start + order.len() as u32;
        let mut next_order = Vec::new();
        for (k, &(cluster, parent)) in order.iter().enumerate() {
            let node = start + k as u32;
            let children = &clusters[cluster as usize].children;
            next_order.extend(children.iter().map(|child| (*child, node)));
            push_node(&mut clod, parts, level, cluster, &mut local);
            let pushed = &mut clod.nodes[node as usize];
            pushed.parent = parent;
            pushed.children = next_child..next_child + children.len() as u32;
            next_child = pushed.children.end;
        }
        clod.levels.push(Level {
            nodes: start..clod.nodes.len() as u32,
            triangles: parts.mesh.triangles().len() as u32,
            resolution: parts.resolution,
            free: level > 0,
        });
        order = next_order;
    }
    clod.levels.reverse();
    clod
}

fn push_node(clod: &mut Clod, parts: &Parts<'_>, level: usize, cluster: u32, local: &mut [u32]) {
    let Cluster { extreme, center, radius, .. } = &parts.levels[level][cluster as usize];
    let first_vertex = clod.vertices.len();
    let first_triangle = clod.triangles.len();
    let mut own = Vec::new();
    for (k, v) in extreme.iter().enumerate() {
        local[*v as usize] = k as u32;
        own.push(*v);
    }
    if level == 0 {
        for t in &parts.decomposition.patches[cluster as usize].triangles {
            clod.triangles.push(parts.mesh.triangles()[*t as usize].map(|v| {
                let slot = &mut local[v as usize];
                if *slot == u32::MAX {
                    *slot = own.len() as u32;
                    own.push(v);
                }
                *slot
            }));
        }
    }
    clod.vertices.extend(own.iter().map(|v| parts.mesh.vertices()[*v as usize]));
    clod.support_areas.extend(own.iter().map(|v| parts.support_areas[*v as usize]));
    for v in &own {
        local[*v as usize] = u32::MAX;
    }
    let center = *center / parts.scale + parts.center;
    // Measured again, for the vertices as they are stored.
    let reach = clod.vertices[first_vertex..].iter().map(|p| p.distance(center)).fold(0.0, f64::max);
    clod.nodes.push(Node {
        parent: NO_NODE,
        children: 0..0,
        level: level as u32,
        vertices: first_vertex as u32..clod.vertices.len() as u32,
        extreme: extreme.len() as u32,
        triangles: first_triangle as u32..clod.triangles.len() as u32,
        center,
        radius: reach.max(*radius / parts.scale),
        deviation: 0.0,
        hausdorff: 0.0,
        contained: level == 0 && parts.contained[cluster as usize],
        all_real: level == 0 && parts.all_real[cluster as usize],
    });
}
