//! Properties of the patches of a level: whether their hulls lie inside the object, and whether they cover
//! their hulls.

use glam::DVec3;
use palpate_core::mesh::{Adjacency, NO_NEIGHBOUR};
use rayon::prelude::*;

use crate::convexity::{HULL_THICKNESS, Patch, layer_below, permitted_depth};
use crate::decomposition::Decomposition;
use crate::hull::{HullBuilder, Plane};
use crate::surface::Surface;

/// Number of faces of a thin hull below which a deep point is searched. With fewer, a hull inside the object
/// may not be recognised.
const MAX_FACES_TRIED: usize = 64;

/// Flags, one a patch: true if its hull is verified not to protrude from the object, which must be `solid`.
pub(crate) fn contained(
    surface: &Surface,
    decomposition: &Decomposition,
    solid: bool,
    tolerance: f64,
) -> Vec<bool> {
    decomposition
        .patches
        .par_iter()
        .map_init(HullBuilder::default, |hulls, patch| solid && lies_inside(surface, patch, tolerance, hulls))
        .collect()
}

/// Flags, one a patch: true if it covers its whole hull.
pub(crate) fn all_real(decomposition: &Decomposition, adjacency: &Adjacency) -> Vec<bool> {
    (0..decomposition.patches.len()).map(|patch| is_closed(decomposition, patch, adjacency)).collect()
}

/// Whether the hull of a patch lies inside a solid. No surface reaches deeper into it than is permitted, so
/// that one point deeper than that decides for all; a hull without such a point is part of the surface. For a
/// flat hull, one point in the layer below it decides, which no surface reaches into either. A single
/// triangle is its own hull.
fn lies_inside(surface: &Surface, patch: &Patch, tolerance: f64, hulls: &mut HullBuilder) -> bool {
    if patch.triangles.len() == 1 {
        return true;
    }
    let points: Vec<DVec3> = patch.extreme.iter().map(|v| surface.points[*v as usize]).collect();
    if patch.flat {
        let plane = surface.planes[patch.lead as usize];
        let middle = surface.corners(patch.lead).iter().sum::<DVec3>() / 3.0;
        let below = middle - 1.5 * tolerance * plane.normal;
        let narrow = layer_below(&plane, &points, 3.0 * tolerance).any(|p| p.height(below) >= -tolerance);
        return narrow || surface.winding_number(below).is_some_and(|turns| turns > 0);
    }
    let planes: Vec<Plane> = hulls.hull(&points, HULL_THICKNESS).planes(&points).collect();
    let below = |planes: &mut dyn Iterator<Item = &Plane>, p: DVec3| {
        planes.map(|plane| -plane.height(p)).fold(f64::INFINITY, f64::min)
    };
    // The patch itself may lie as deep in its hull as the tolerance: points above it there are outside the
    // object, but count as convex.
    let depth = |p: DVec3| {
        let in_hull = below(&mut planes.iter(), p);
        if in_hull > tolerance {
            return in_hull;
        }
        in_hull.min(below(&mut patch.triangles.iter().map(|t| &surface.planes[*t as usize]), p))
    };
    let below_faces = patch.triangles.iter().take(MAX_FACES_TRIED).map(|t| {
        let plane = surface.planes[*t as usize];
        let thickness = points.iter().map(|p| -plane.height(*p)).fold(0.0, f64::max);
        surface.corners(*t).iter().sum::<DVec3>() / 3.0 - 0.5 * thickness * plane.normal
    });
    let middle = points.iter().sum::<DVec3>() / points.len() as f64;
    let mut deepest = (middle, depth(middle));
    // In a hull that is thick nearly everywhere the middle is deep enough; in a sheet it may be near the
    // surface.
    if deepest.1 <= 4.0 * tolerance {
        for p in below_faces {
            let depth = depth(p);
            if depth > deepest.1 {
                deepest = (p, depth);
            }
        }
    }
    let top = surface.planes[patch.lead as usize];
    let thickness = points.iter().map(|p| -top.height(*p)).fold(0.0, f64::max);
    deepest.1 <= permitted_depth(tolerance, thickness)
        || surface.winding_number(deepest.0).is_some_and(|turns| turns > 0)
}

/// Whether a patch has no boundary, so that it covers its whole hull.
fn is_closed(decomposition: &Decomposition, patch: usize, adjacency: &Adjacency) -> bool {
    let own = &decomposition.patches[patch];
    !own.flat
        && own.triangles.iter().all(|t| {
            adjacency.neighbours()[*t as usize]
                .iter()
                .all(|n| *n != NO_NEIGHBOUR && decomposition.patch_of[*n as usize] == patch as u32)
        })
}
