//! Requirements of a build on its mesh (§3.3.1: an oriented 2-manifold, with or without boundary, that does
//! not intersect itself), checked so as to name the first element that breaks one.
//!
//! Connectivity is determined by vertex indices: surfaces that touch along copies of a vertex or an edge are
//! not connected, and a mesh that is not welded is a set of sheets with borders. Shape is determined by
//! positions: a triangle between copies of one vertex is degenerate, two triangles with the same three
//! positions are duplicates, and triangles that share a position touch there as if they shared the vertex. On
//! a welded mesh both are the same, and the checks are those that `palpate check` counts.
//!
//! Self-intersection is tested in exact arithmetic on the original coordinates; the tree of boxes only
//! proposes pairs, and its rounding of coordinates is monotone, so that it misses none.
//!
//! A closed mesh whose volume is negative is refused: nearly always it was exported inside out, and every
//! contact force would push into the object, with no other symptom. Pieces that face inwards in a mesh of
//! positive volume count as cavities, and open meshes have no inside.

use glam::{DMat3, DVec3};
use palpate_core::TriMesh;
use palpate_core::mesh::{OffendingEdge, ValidationReport};
use rayon::prelude::*;
use robust::{Coord, orient2d};

use crate::BuildError;
use crate::box_tree::{Bounds, BoxTree, meet};
use crate::intersect::intersect;
use crate::surface::{Surface, bounds_of};

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

/// Refuses a mesh with two triangles that intersect; `surface` is made from it. It must have passed
/// [`check_surface`].
pub(crate) fn check_intersections(mesh: &TriMesh, surface: &Surface) -> Result<(), BuildError> {
    let same = equal_positions(mesh.vertices());
    let ids: Vec<[u32; 3]> =
        mesh.triangles().par_iter().map(|t| t.map(|v| same.get(v as usize).copied().unwrap_or(v))).collect();
    let plain: Vec<Bounds> = (0..mesh.triangles().len() as u32).map(|t| surface.bounds(t)).collect();
    let turned = turned_boxes(surface, &plain);
    let turned_tree = turned.as_ref().map(|boxes| BoxTree::new(boxes));
    let bounds = turned.as_ref().unwrap_or(&plain);
    let tree = turned_tree.as_ref().unwrap_or(surface.tree());
    let crosses = |t: u32, other: u32| {
        other != t
            && meet(bounds[other as usize], bounds[t as usize])
            && !clearly_apart(mesh.vertices(), ids[t as usize], ids[other as usize])
            && intersect(mesh.vertices(), ids[t as usize], ids[other as usize])
    };
    // The first of the triangles after a given one that it intersects.
    let partner = |t: u32, stack: &mut Vec<u32>| {
        let mut found = None;
        tree.any_near(bounds[t as usize], stack, |other| {
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
    let cut = |stack: &mut Vec<u32>, t| tree.any_near(bounds[t as usize], stack, |other| crosses(t, other));
    let cut = (0..count).into_par_iter().map_init(Vec::new, cut).filter(|cut| *cut).count();
    let extent = |t: u32| {
        let [p, q, r] = mesh.corners(t as usize);
        (p.min(q).min(r), p.max(q).max(r))
    };
    let ((low, high), (from, to)) = (extent(a), extent(b));
    let position = 0.5 * low.max(from) + 0.5 * high.min(to);
    Err(BuildError::SelfIntersecting { count: cut, triangles: [a, b], position })
}

/// The triangles' boxes along the main direction of their sides, if that makes them much smaller than the
/// `plain` ones, as for long parts that are not aligned with an axis.
fn turned_boxes(surface: &Surface, plain: &[Bounds]) -> Option<Vec<Bounds>> {
    /// Padding of the boxes: more than the rounding of unit coordinates and of a rotation.
    const ROUNDING: f64 = 16.0 * f64::EPSILON;
    let corners = (0..plain.len() as u32).map(|t| surface.corners(t));
    let mut sides = DMat3::ZERO;
    for [a, b, c] in corners.clone() {
        for side in [b - a, c - b, a - c] {
            sides += DMat3::from_cols(side * side.x, side * side.y, side * side.z);
        }
    }
    // Power iteration for the main direction of the sides. It need not converge: any axes are valid.
    let start = DVec3::new(0.6, 0.5, 0.4);
    let along = (0..32).fold(start, |v, _| (sides * v).normalize_or(start)).normalize();
    let (across, up) = along.any_orthonormal_pair();
    let turn = DMat3::from_cols(along, across, up).transpose();
    let turned: Vec<Bounds> = corners
        .map(|t| bounds_of(&t.map(|p| turn * p)))
        .map(|(low, high)| (low - ROUNDING, high + ROUNDING))
        .collect();
    let area = |boxes: &[Bounds]| -> f64 {
        boxes.iter().map(|(low, high)| *high - *low).map(|d| d.x * d.y + d.y * d.z + d.z * d.x).sum()
    };
    (area(&turned) < 0.25 * area(plain)).then_some(turned)
}

/// Whether a cheap test shows that two triangles have nothing in common but their common vertices and the
/// edge between them. It pays, since it succeeds for nearly all neighbours, and in flat regions [`intersect`]
/// needs exact arithmetic throughout.
fn clearly_apart(points: &[DVec3], a: [u32; 3], b: [u32; 3]) -> bool {
    let (p, q) = (a.map(|v| points[v as usize]), b.map(|v| points[v as usize]));
    let (own_a, own_b) = (a.map(|v| !b.contains(&v)), b.map(|v| !a.contains(&v)));
    if clearly_one_sided(p, q, own_b) || clearly_one_sided(q, p, own_a) {
        return true;
    }
    let flat = [|v: DVec3| (v.x, v.y), |v: DVec3| (v.y, v.z), |v: DVec3| (v.z, v.x)];
    flat.iter().any(|f| {
        let (p, q) = (p.map(f), q.map(f));
        separated(&p, own_a, &q, own_b) || separated(&q, own_b, &p, own_a)
    })
}

/// Whether plain arithmetic shows that the chosen corners of `u` lie on one side of t's plane: the first,
/// filtered stage of Shewchuk's orient3d with its error bound.
fn clearly_one_sided(t: [DVec3; 3], u: [DVec3; 3], chosen: [bool; 3]) -> bool {
    /// Error bound of the determinant in units of the permanent: (7 + 56 ε) ε with ε = 2⁻⁵³.
    const BOUND: f64 = (7.0 + 28.0 * f64::EPSILON) * (0.5 * f64::EPSILON);
    let side = |d: DVec3| {
        let [a, b, c] = t.map(|p| p - d);
        let (bc, cb, ca, ac, ab, ba) = (b.x * c.y, c.x * b.y, c.x * a.y, a.x * c.y, a.x * b.y, b.x * a.y);
        let volume = a.z * (bc - cb) + b.z * (ca - ac) + c.z * (ab - ba);
        let permanent = (bc.abs() + cb.abs()) * a.z.abs()
            + (ca.abs() + ac.abs()) * b.z.abs()
            + (ab.abs() + ba.abs()) * c.z.abs();
        if volume.abs() > BOUND * permanent { volume.signum() } else { 0.0 }
    };
    let (mut above, mut below) = (true, true);
    for (corner, _) in u.into_iter().zip(chosen).filter(|(_, chosen)| *chosen) {
        let side = side(corner);
        (above, below) = (above && side > 0.0, below && side < 0.0);
    }
    (above || below) && chosen.contains(&true)
}

/// Whether the line through an edge of one projected triangle, on which their common vertices lie, separates
/// the other vertices of the two; then they have no other point in common in space either.
fn separated(t: &[(f64, f64); 3], own_t: [bool; 3], u: &[(f64, f64); 3], own_u: [bool; 3]) -> bool {
    let turn = |a: (f64, f64), b: (f64, f64), c: (f64, f64)| {
        let coord = |(x, y)| Coord { x, y };
        orient2d(coord(a), coord(b), coord(c))
    };
    (0..3).any(|k| {
        let (next, apex) = ((k + 1) % 3, (k + 2) % 3);
        if !own_t[apex] {
            return false;
        }
        let side = turn(t[k], t[next], t[apex]);
        side != 0.0 && (0..3).all(|i| !own_u[i] || turn(t[k], t[next], u[i]) * side.signum() < 0.0)
    })
}

fn middle(mesh: &TriMesh, triangle: u32) -> DVec3 {
    let [a, b, c] = mesh.corners(triangle as usize);
    a / 3.0 + b / 3.0 + c / 3.0
}

/// The first vertex at the position of each vertex; empty if all positions differ.
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

/// Number of triangles with the same positions as an earlier one, and the first of them.
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

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    #[test]
    fn clearly_separate_triangles_do_not_intersect() {
        let seed = 83;
        println!("seed {seed}");
        let mut rng = StdRng::seed_from_u64(seed);
        let mut seen = [[0; 2]; 3];
        for round in 0..60_000 {
            // On a lattice (every other one flat), where triangles touch, line up and share planes; or
            // anywhere.
            let (lattice, flat) = (round % 3 != 0, round % 2 == 0);
            let mut coordinate =
                || if lattice { f64::from(rng.random_range(-2..=2)) } else { rng.random_range(-1.0..1.0) };
            let points: Vec<DVec3> = (0..6)
                .map(|_| DVec3::new(coordinate(), coordinate(), if flat { 0.0 } else { coordinate() }))
                .collect();
            let shared = round / 6 % 3;
            let (a, b) = ([0, 1, 2], [[3, 4, 5], [5, 1, 4], [1, 0, 4]][shared]);
            let no_area = |t: [u32; 3]| {
                let [p, q, r] = t.map(|v| points[v as usize]);
                (q - p).cross(r - p).length() < 1e-12
            };
            let distinct = (0..6).all(|i| (0..i).all(|j| points[i] != points[j]));
            if no_area(a) || no_area(b) || !distinct {
                continue;
            }
            let meets = intersect(&points, a, b);
            let apart = clearly_apart(&points, a, b);
            assert!(!(apart && meets), "round {round}: {points:?}");
            seen[shared][0] += usize::from(!meets);
            seen[shared][1] += usize::from(apart);
        }
        println!("{seen:?}");
        assert!(seen.iter().all(|[clear, found]| *clear > 1000 && 5 * found > 4 * clear), "{seen:?}");
    }
}
