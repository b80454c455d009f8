//! Meshes in Rerun's form.

use std::collections::BTreeSet;

use palpate::core::Clod;
use palpate::core::clod::Node;
use palpate::glam::Vec3;
use palpate::level_color;
use re_sdk_types::archetypes::Mesh3D;

/// Offset of touching patches from their mesh, in its radii.
const LIFT: f64 = 2e-3;

/// Returns the full mesh of a hierarchy, in its own frame.
pub fn whole(clod: &Clod, color: [u8; 4]) -> Mesh3D {
    mesh(clod, clod.leaves().iter().map(|leaf| (leaf, color)), 0.0)
}

/// Returns patches of a hierarchy, each in the colour of its level; `None` if they have no triangles.
pub fn patches(clod: &Clod, nodes: &BTreeSet<u32>) -> Option<Mesh3D> {
    let nodes = nodes.iter().filter_map(|node| clod.get(*node));
    let nodes = nodes.filter(|node| !clod.patch(node).is_empty());
    nodes.clone().next()?;
    let colored = nodes.map(|node| {
        let color = level_color(clod, node.level);
        (node, color)
    });
    Some(mesh(clod, colored, (LIFT * clod.bounding_radius()) as f32))
}

/// Returns patches with their normals, displaced along these by `lift` (m).
fn mesh(clod: &Clod, patches: impl Iterator<Item = (Node, [u8; 4])>, lift: f32) -> Mesh3D {
    let (mut corners, mut normals) = (Vec::new(), Vec::new());
    let (mut triangles, mut colors) = (Vec::new(), Vec::new());
    for (node, color) in patches {
        let first = corners.len();
        corners.extend(clod.hull(&node).iter().map(|corner| corner.as_vec3()));
        normals.resize(corners.len(), Vec3::ZERO);
        colors.resize(corners.len(), color);
        for triangle in clod.patch(&node) {
            let triangle = triangle.map(|corner| first + corner as usize);
            let [a, b, c] = triangle.map(|corner| corners[corner]);
            for corner in triangle {
                normals[corner] += (b - a).cross(c - a);
            }
            triangles.push(triangle.map(|corner| corner as u32));
        }
        for (corner, normal) in corners.iter_mut().zip(&mut normals).skip(first) {
            *normal = normal.normalize_or_zero();
            *corner += *normal * lift;
        }
    }
    Mesh3D::new(corners.into_iter().map(|corner| corner.to_array()))
        .with_triangle_indices(triangles)
        .with_vertex_normals(normals.into_iter().map(|normal| normal.to_array()))
        .with_vertex_colors(colors)
}
