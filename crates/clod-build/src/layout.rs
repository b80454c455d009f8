//! Layout of the hierarchy for queries: root first, level by level, children and hull vertices contiguous.

use glam::DVec3;
use palpate_core::TriMesh;
use palpate_core::clod::{Level, NO_NODE, Node, Parts, Source};

use crate::decomposition::Decomposition;
use crate::hierarchy::Cluster;

/// A level of the hierarchy, with its mesh and parameters.
pub(crate) struct LevelParts<'a> {
    /// The level's mesh; for a free level, that of the coarsest level that is not free.
    pub mesh: &'a TriMesh,
    /// Its hulls, as vertices of the mesh.
    pub clusters: &'a [Cluster],
    /// D of the mesh's vertices, m².
    pub support_areas: &'a [f64],
    /// r, 1/m.
    pub resolution: f64,
    /// The clusters' patches; `None` for a free level.
    pub patches: Option<PatchParts<'a>>,
}

/// The patches of a level that is not free.
pub(crate) struct PatchParts<'a> {
    pub decomposition: &'a Decomposition,
    /// Flags, one a patch: true if its hull is verified to lie inside the object.
    pub contained: Vec<bool>,
    /// Flags, one a patch: true if it covers its hull.
    pub all_real: Vec<bool>,
    /// s of each patch, m.
    pub deviations: Vec<f64>,
}

/// Lays out the hierarchy. `scale` and `center` convert unit coordinates to metres: p / scale + center.
pub(crate) fn lay_out(levels: &[LevelParts<'_>], source: Source, scale: f64, center: DVec3) -> Parts {
    let count: usize = levels.iter().map(|level| level.clusters.len()).sum();
    let triangles = levels.iter().filter(|l| l.patches.is_some()).map(|l| l.mesh.triangles().len()).sum();
    let mut clod = Parts {
        levels: Vec::with_capacity(levels.len()),
        nodes: Vec::with_capacity(count),
        vertices: Vec::new(),
        support_areas: Vec::new(),
        triangles: Vec::with_capacity(triangles),
        source,
    };
    let most = levels.iter().map(|level| level.mesh.vertices().len()).max().unwrap_or(0);
    let mut local = vec![u32::MAX; most];
    // The clusters of a level in the order of their nodes, with their parents.
    let mut order: Vec<(u32, u32)> = vec![(0, NO_NODE)];
    for (index, level) in levels.iter().enumerate().rev() {
        let start = clod.nodes.len() as u32;
        let mut next_child = start + order.len() as u32;
        let mut next_order = Vec::new();
        for (k, &(cluster, parent)) in order.iter().enumerate() {
            let node = start + k as u32;
            let children = &level.clusters[cluster as usize].children;
            next_order.extend(children.iter().map(|child| (*child, node)));
            push_node(&mut clod, level, cluster, (scale, center), &mut local);
            let pushed = &mut clod.nodes[node as usize];
            pushed.level = index as u32;
            pushed.parent = parent;
            pushed.children = next_child..next_child + children.len() as u32;
            next_child = pushed.children.end;
        }
        clod.levels.push(Level {
            nodes: start..clod.nodes.len() as u32,
            triangles: level.mesh.triangles().len() as u32,
            resolution: level.resolution,
            free: level.patches.is_none(),
        });
        order = next_order;
    }
    clod.levels.reverse();
    clod
}

fn push_node(
    clod: &mut Parts,
    level: &LevelParts<'_>,
    cluster: u32,
    (scale, origin): (f64, DVec3),
    local: &mut [u32],
) {
    let LevelParts { mesh, support_areas, patches, .. } = level;
    let Cluster { extreme, center, radius, .. } = &level.clusters[cluster as usize];
    let first_vertex = clod.vertices.len();
    let first_triangle = clod.triangles.len();
    let mut own = Vec::new();
    for (k, v) in extreme.iter().enumerate() {
        local[*v as usize] = k as u32;
        own.push(*v);
    }
    if let Some(patches) = patches {
        for t in &patches.decomposition.patches[cluster as usize].triangles {
            clod.triangles.push(mesh.triangles()[*t as usize].map(|v| {
                let slot = &mut local[v as usize];
                if *slot == u32::MAX {
                    *slot = own.len() as u32;
                    own.push(v);
                }
                *slot
            }));
        }
    }
    clod.vertices.extend(own.iter().map(|v| mesh.vertices()[*v as usize]));
    clod.support_areas.extend(own.iter().map(|v| support_areas[*v as usize]));
    for v in &own {
        local[*v as usize] = u32::MAX;
    }
    let center = *center / scale + origin;
    // Measured again, since the conversion to metres rounds.
    let reach = clod.vertices[first_vertex..].iter().map(|p| p.distance(center)).fold(0.0, f64::max);
    clod.nodes.push(Node {
        parent: NO_NODE,
        children: 0..0,
        level: 0,
        vertices: first_vertex as u32..clod.vertices.len() as u32,
        extreme: extreme.len() as u32,
        added: 0,
        triangles: first_triangle as u32..clod.triangles.len() as u32,
        center,
        radius: reach.max(*radius / scale),
        deviation: patches.as_ref().map_or(0.0, |p| p.deviations[cluster as usize]),
        hausdorff: 0.0,
        contained: patches.as_ref().is_some_and(|p| p.contained[cluster as usize]),
        all_real: patches.as_ref().is_some_and(|p| p.all_real[cluster as usize]),
    });
}
