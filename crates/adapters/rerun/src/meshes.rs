//! Meshes as Rerun draws them.

use std::collections::BTreeSet;

use palpate::core::Clod;
use palpate::core::clod::Node;
use palpate::level_color;
use re_sdk_types::archetypes::Mesh3D;

/// The full mesh of a hierarchy, in its own frame.
pub fn whole(clod: &Clod, color: [u8; 4]) -> Mesh3D {
    mesh(clod, clod.leaves().iter().map(|leaf| (leaf, color)))
}

/// Patches of a hierarchy, each in the colour of its level; `None` if they have no triangles.
pub fn patches(clod: &Clod, nodes: &BTreeSet<u32>) -> Option<Mesh3D> {
    let nodes = nodes.iter().filter_map(|node| clod.nodes.get(*node as usize));
    let nodes = nodes.filter(|node| !clod.patch(node).is_empty());
    nodes.clone().next()?;
    Some(mesh(clod, nodes.map(|node| (node, level_color(clod, node.level)))))
}

fn mesh<'a>(clod: &'a Clod, patches: impl Iterator<Item = (&'a Node, [u8; 4])>) -> Mesh3D {
    let (mut corners, mut triangles, mut colors) = (Vec::new(), Vec::new(), Vec::new());
    for (node, color) in patches {
        let first = corners.len() as u32;
        corners.extend(clod.hull(node).iter().map(|corner| corner.as_vec3().to_array()));
        triangles.extend(clod.patch(node).iter().map(|corners| corners.map(|corner| first + corner)));
        colors.resize(corners.len(), color);
    }
    Mesh3D::new(corners).with_triangle_indices(triangles).with_vertex_colors(colors)
}
