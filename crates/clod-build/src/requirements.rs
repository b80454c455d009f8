//! What a mesh has to be for a hierarchy to be built from it (§3.3.1: an oriented 2-manifold, with or without boundary, that
//! does not intersect itself), and the first element that is not.
//!
//! Connectivity is judged by vertex indices: surfaces that touch along copies of a vertex or an edge are apart, and a mesh
//! that is not welded is a heap of sheets with borders. Shapes are judged by positions: a triangle between copies of one
//! vertex is degenerate, two triangles over the same three positions are duplicates, and triangles that share a position
//! touch there as if they shared the vertex. On a welded mesh both are the same, and what is asked here is what `palpate
//! check` counts.
//!
//! Self-intersection is decided in exact arithmetic on the coordinates as they came; the tree of boxes only proposes
//! pairs, and its rounding of coordinates is monotone, so that it misses none.
//!
//! A closed mesh whose volume is negative is refused: nearly always it was exported inside out, and every contact force
//! would push into the object without another sign of it. Pieces that face inwards in a whole of positive volume are cavities
//! (or are taken as such), and open meshes have no inside.

use glam::DVec3;
use palpate_core::TriMesh;
use palpate_core::mesh::{OffendingEdge, ValidationReport};
use rayon::prelude::*;

use crate::BuildError;
use crate::box_tree::meet;
use crate::simplify::intersect::intersect;
use crate::surface::Surface;

/// Refuses a mesh that is not an oriented 2-manifold of triangles with an area, given its validation report.
pub(crate) fn check_surface(mesh: &TriMesh, report: &ValidationReport) -> Result<(), BuildError> {
    let first = &report.first;
    if let Some(triangle) = first.degenerate {
        let position = middle(mesh, triangle);
        return Err(BuildError::Degenerate { count: report.degenerate, triangle, position });
    }
    let [count, triangle] = duplicates(mesh);
    if count > 0 {
        let position = middle(mesh, triangle);
        return Err(BuildError::Duplicate { count: count as usize, triangle, position });
    }
    let halfway = |e: &OffendingEdge| {
        let [a, b] = e.vertices.map(|v| mesh.vertices()[v as usize]);
        0.5 * a + 0.5 * b
    };
    if let Some(edge) = first.nonmanifold_edge {
        let count = report.nonmanifold_edges;
        return Err(BuildError::NonManifoldEdge { count, edge, position: halfway(&edge) });
    }
    if let Some(edge) = first.misoriented_edge {
        let count = report.misoriented_edges;
        return Err(BuildError::Misoriented { count, edge, position: halfway(&edge) });
    }
    if let Some(vertex) = first.nonmanifold_vertex {
        let (count, position) = (report.nonmanifold_vertices, mesh.vertices()[vertex as usize]);
        return Err(BuildError::NonManifoldVertex { count, vertex, position });
    }
    if report.closed && report.volume < 0.0 {
        return Err(BuildError::InsideOut { volume: report.volume });
    }
    Ok(())
}

/// Refuses a mesh of which two triangles intersect; `surface` is made from it. It has passed [`check_surface`].
pub(crate) fn check_intersections(mesh: &TriMesh, surface: &Surface) -> Result<(), BuildError> {
    let same = equal_positions(mesh.vertices());
    let ids: Vec<[u32; 3]> =
        mesh.triangles().par_iter().map(|t| t.map(|v| same.get(v as usize).copied().unwrap_or(v))).collect();
    let crosses = |t: u32, other: u32| {
        other != t
            && meet(surface.bounds(other), surface.bounds(t))
            && intersect(mesh.vertices(), ids[t as usize], ids[other as usize])
    };
    // The first of the triangles after a given one that it intersects.
    let partner = |t: u32, stack: &mut Vec<u32>| {
        let mut found = None;
        surface.tree().any_near(surface.bounds(t), stack, |other| {
            if other > t && found.is_none_or(|f| other < f) && crosses(t, other) {
                found = Some(other);
            }
            false
        });
        found.map(|other| [t, other])
    };
    let count = mesh.triangles().len() as u32;
    let first = (0..count).into_par_iter().map_init(Vec::new, |stack, t| partner(t, stack));
    let Some([a, b]) = first.find_first(Option::is_some).flatten() else { return Ok(()) };
    let cut = |stack: &mut Vec<u32>, t| {
        surface.tree().any_near(surface.bounds(t), stack, |other| crosses(t, other))
    };
    let cut = (0..count).into_par_iter().map_init(Vec::new, cut).filter(|cut| *cut).count();
    let bounds = |t: u32| {
        let [p, q, r] = mesh.corners(t as usize);
        (p.min(q).min(r), p.max(q).max(r))
    };
    let ((low, high), (from, to)) = (bounds(a), bounds(b));
    let position = 0.5 * low.max(from) + 0.5 * high.min(to);
    Err(BuildError::SelfIntersecting { count: cut, triangles: [a, b], position })
}

fn middle(mesh: &TriMesh, triangle: u32) -> DVec3 {
    let [a, b, c] = mesh.corners(triangle as usize);
    a / 3.0 + b / 3.0 + c / 3.0
}

/// For each vertex, the first at its position; empty if all positions differ.
fn equal_positions(vertices: &[DVec3]) -> Vec<u32> {
    // Adding 0 turns −0 into 0 and leaves every other number alone.
    let key = |v: &u32| vertices[*v as usize].to_array().map(|x| (x + 0.0).to_bits());
    let mut order: Vec<u32> = (0..vertices.len() as u32).collect();
    order.par_sort_unstable_by_key(|v| (key(v), *v));
    let equal = |a: &u32, b: &u32| key(a) == key(b);
    if order.windows(2).all(|pair| !equal(&pair[0], &pair[1])) {
        return Vec::new();
    }
    let mut same = vec![0; vertices.len()];
    for group in order.chunk_by(equal) {
        group.iter().for_each(|v| same[*v as usize] = group[0]);
    }
    same
}

/// How many triangles lie on the positions of an earlier one, and the first of them.
fn duplicates(mesh: &TriMesh) -> [u32; 2] {
    let same = equal_positions(mesh.vertices());
    let mut sorted: Vec<([u32; 3], u32)> = (mesh.triangles().iter().zip(0u32..))
        .map(|(corners, t)| {
            let mut corners = corners.map(|v| same.get(v as usize).copied().unwrap_or(v));
            corners.sort_unstable();
            (corners, t)
        })
        .collect();
    sorted.par_sort_unstable();
    let repeats = sorted.chunk_by(|a, b| a.0 == b.0).flat_map(|group| &group[1..]).map(|(_, t)| *t);
    repeats.fold([0, u32::MAX], |[count, first], t| [count + 1, first.min(t)])
}
