//! The contact between two patches whose hulls overlap: a direction along which real surface can be pushed
//! out, and the penetration depth along it.
//!
//! §3.4.1 takes the localized penetration depth of the two convex pieces. A direction that separates two
//! hulls counts only if its features are real surface facing the other object; a hull's virtual faces would
//! often have a shorter but meaningless depth, sideways or backwards through a thin patch. The expanding
//! polytope gives the least depth of all directions. If its features are not real, the normals of real faces
//! are tried and, for patches of a few triangles, the common normals of two real edges that support their
//! hulls there (the separating axis theorem).
//!
//! The depth through real faces only may be much larger than the least one: a peg that touches a plate from
//! above touches the hull of the plate's rim too, whose real faces are at its far sides. So the depth
//! reported is at most the least one. It is then at most the depth of the two solids too, and grows from 0.
//!
//! The depth is that of the two patches only. If an object penetrates by more than the thickness of a patch,
//! it is a lower bound on the distance to the surface.

use std::iter;

use palpate_core::Contact;
use palpate_core::glam::DVec3;

use super::context::PairContext;
use crate::convex::{Distance, Placement, Polytope};
use crate::patch::{Patch, Plane, Surface};
use crate::tolerances::{ACCEPTED_DEPTH_GAP, COMMON_NORMAL, FACING, SAME_CONTACT};

/// Largest product of triangle counts of two patches whose edges' common normals are tried.
const EDGE_TEST_TRIANGLE_PAIRS: usize = 16;
/// Largest number of vertices of either patch for the edge test.
const EDGE_TEST_VERTICES: usize = 24;

/// Number of planes of a patch that there is room for at first: patches have at most a few hundred.
const PLANES: usize = 256;

/// The best direction so far: directions along which both sides face each other come first, then the least
/// depth.
struct Best {
    /// Unit normal out of a, and depth, m.
    direction: Option<(DVec3, f64)>,
    facing: bool,
    /// Difference up to which depths are equal, and the earlier direction stays, m.
    precision: f64,
}

impl Best {
    /// Whether a direction with at least a depth (m) could be better.
    fn may_improve(&self, depth: f64) -> bool {
        !self.facing || self.direction.is_none_or(|(_, best)| depth < best)
    }

    /// Takes a direction if it is better.
    fn offer(&mut self, facing: bool, depth: f64, normal: DVec3) {
        // Hulls that only touch are apart by rounding.
        let depth = depth.max(0.0);
        let better = self.direction.is_none_or(|(_, best)| {
            (facing && !self.facing) || (facing == self.facing && depth < best - self.precision)
        });
        if better {
            self.direction = Some((normal, depth));
            self.facing = facing;
        }
    }
}

/// The workspace.
#[derive(Clone, Debug)]
pub(crate) struct Workspace {
    polytope: Polytope,
    /// Planes of a patch's triangles.
    planes: Vec<Plane>,
}

impl Default for Workspace {
    fn default() -> Self {
        Self { polytope: Polytope::default(), planes: Vec::with_capacity(PLANES) }
    }
}

impl Workspace {
    /// Memory held, bytes, without the polytope, whose size is fixed.
    pub fn bytes(&self) -> usize {
        self.planes.capacity() * size_of::<Plane>()
    }
}

/// Result for two patches whose hulls overlap or touch.
pub(crate) struct Overlap {
    /// The contact, in a's frame.
    pub contact: Contact,
    /// Whether the least depth is exact to within [`ACCEPTED_DEPTH_GAP`].
    pub converged: bool,
    /// Vertices that the next search starts from.
    pub tetrahedron: [(u32, u32); 4],
}

/// Finds the contact between patches whose hulls overlap or touch, as `found`, in a's frame. The point of a
/// contact no deeper than the looseness is where the hulls touch.
pub(crate) fn overlap(
    a: &Patch,
    b: &Patch,
    pair: &PairContext,
    found: &Distance,
    Workspace { polytope, planes }: &mut Workspace,
) -> Overlap {
    let PairContext { placement, precision, looseness, .. } = *pair;
    let (touch, _) = found.witnesses(&a.hull, &b.hull, &Placement::IDENTITY);
    let mut best = Best { direction: None, facing: false, precision: SAME_CONTACT * precision };
    let mut start = [(0, 0); 4];
    for (pair, vertex) in start.iter_mut().zip(found.simplex.vertices()) {
        *pair = (vertex.a, vertex.b);
    }
    let start = &start[..found.simplex.vertices().len()];
    let least = polytope.penetration(&a.hull, &b.hull, placement, start, precision);
    let sides = if least.flat { [least.normal, -least.normal] } else { [least.normal; 2] };
    // A face of the hull represents the triangles that it was built from.
    let near = [precision + looseness, 0.0];
    for normal in sides {
        if best.facing {
            break;
        }
        let (on_a, on_b) = if least.flat { (touch, touch) } else { (least.on_a, least.on_b) };
        let in_b = -placement.direction_to_b(normal);
        let back = placement.direction_to_b(on_b - placement.translation);
        if a.surface_at(on_a, normal, FACING, iter::empty(), near) == Surface::Front
            && b.surface_at(back, in_b, FACING, iter::empty(), near) == Surface::Front
        {
            best.offer(true, least.depth, normal);
        }
    }
    if !best.facing {
        faces(a, b, placement, [touch, least.on_a, least.on_b], planes, &mut best);
        let few = a.triangles.len() * b.triangles.len() <= EDGE_TEST_TRIANGLE_PAIRS;
        if few && a.vertices.len() <= EDGE_TEST_VERTICES && b.vertices.len() <= EDGE_TEST_VERTICES {
            edges(a, b, placement, &mut best);
        }
    }
    // If all triangles have no area, there is no real direction.
    let (normal, depth) = best.direction.unwrap_or((least.normal, least.depth));
    let depth = depth.min(least.depth).max(0.0);
    // The points of the least depth lie where the hulls overlap; a face's deepest point may be anywhere on
    // its plane.
    let point = if least.flat || depth <= looseness { touch } else { least.on_a };
    let converged = least.converged || least.gap <= ACCEPTED_DEPTH_GAP * (a.radius + b.radius);
    Overlap { contact: contact_at(point, normal, depth), converged, tetrahedron: least.tetrahedron }
}

/// A contact at a point of a.
pub(crate) fn contact_at(point: DVec3, normal: DVec3, depth: f64) -> Contact {
    Contact { point, scene_point: point - depth * normal, normal, depth }
}

/// Tries the normals of both patches' triangles. The depth along a normal is that of the other hull's deepest
/// point below the triangle's plane. It is at least that of the known points of the hull: one that both hulls
/// share, one of its own, and those found for planes before. So most planes need not be tried; the one
/// nearest to the points comes first.
fn faces(
    a: &Patch,
    b: &Patch,
    placement: &Placement,
    [shared, on_a, on_b]: [DVec3; 3],
    planes: &mut Vec<Plane>,
    best: &mut Best,
) {
    each_plane(a, planes, [shared, on_b], best, |best, normal, top| {
        let in_b = placement.direction_to_b(normal);
        let (deepest, on_b) = b.hull.furthest(-in_b);
        let on_b = placement.point(on_b);
        best.offer(b.vertex_faces(deepest, -in_b), top - on_b.dot(normal), normal);
        on_b
    });
    let to_b = |point| placement.direction_to_b(point - placement.translation);
    each_plane(b, planes, [shared, on_a].map(to_b), best, |best, in_b, top| {
        let normal = -placement.direction(in_b);
        let (deepest, on_a) = a.hull.furthest(normal);
        best.offer(a.vertex_faces(deepest, normal), top + (on_a - placement.translation).dot(normal), normal);
        to_b(on_a)
    });
}

/// Calls `attempt` with the normals of a patch's triangles (both, if it has two sides) and the extent of its
/// hull along each, unless known points of the other hull show that the direction cannot be better. `attempt`
/// returns another point of the other hull. All in the patch's frame.
fn each_plane(
    patch: &Patch,
    planes: &mut Vec<Plane>,
    [p, q]: [DVec3; 2],
    best: &mut Best,
    attempt: impl Fn(&mut Best, DVec3, f64) -> DVec3,
) {
    let sides = if patch.two_sided { &[1.0, -1.0][..] } else { &[1.0] };
    planes.clear();
    patch.triangles.any(|triangle| {
        let plane = patch.plane(triangle);
        if plane.normal != DVec3::ZERO {
            planes.push(plane);
        }
        false
    });
    for side in sides {
        let planes = || planes.iter().map(|plane| (side * plane.normal, side * plane.offset));
        // The extent is that of the plane, a little more if the patch is convex only up to a tolerance, and
        // much more on its other side.
        let top = |normal: DVec3, offset: f64| patch.hull.end(normal).max(offset);
        let deep =
            |(normal, offset): (DVec3, f64)| (offset - normal.dot(p).min(normal.dot(q)), normal, offset);
        let deeper = |x: &(f64, DVec3, f64), y: &(f64, DVec3, f64)| x.0.total_cmp(&y.0);
        let Some((_, normal, offset)) = planes().map(deep).min_by(deeper) else { continue };
        let mut known = [p, q, attempt(best, normal, top(normal, offset)), p];
        for (normal, offset) in planes() {
            let lowest = known.iter().map(|point| normal.dot(*point)).fold(f64::INFINITY, f64::min);
            // Depths are compared up to rounding.
            let least = lowest + best.precision;
            if best.may_improve(offset - least) {
                let top = top(normal, offset);
                if best.may_improve(top - least) {
                    known[3] = attempt(best, normal, top);
                }
            }
        }
    }
}

/// Tries the common normals of two triangle edges, one of each patch, that support their hulls along it.
fn edges(a: &Patch, b: &Patch, placement: &Placement, best: &mut Best) {
    let mut placed = [DVec3::ZERO; EDGE_TEST_VERTICES];
    let placed = &mut placed[..b.vertices.len()];
    for (target, vertex) in placed.iter_mut().zip(0..) {
        *target = placement.point(b.vertices.point(vertex));
    }
    for on_a in a.triangles {
        let normal_a = a.plane(on_a).normal;
        for on_b in b.triangles {
            let normal_b = placement.direction(b.plane(on_b).normal);
            for (i, j) in [(0, 1), (1, 2), (2, 0)] {
                let (p, q) = (a.vertices.point(on_a[i]), a.vertices.point(on_a[j]));
                for (k, l) in [(0, 1), (1, 2), (2, 0)] {
                    let (r, s) = (placed[on_b[k] as usize], placed[on_b[l] as usize]);
                    let across = (q - p).cross(s - r);
                    let length = across.length();
                    if length <= COMMON_NORMAL * p.distance(q) * r.distance(s) {
                        continue;
                    }
                    // (p − r) · n: the edges' distance along their common normal. Hulls that overlap are not
                    // apart along any direction, so a negative depth means that the normal does not support
                    // both hulls.
                    let depth = (p - r).dot(across) / length;
                    for (side, depth) in [(1.0, depth), (-1.0, -depth)] {
                        if depth < -best.precision || !best.may_improve(depth) {
                            continue;
                        }
                        let normal = side * across / length;
                        if !a.faces(normal_a, normal, FACING) || !b.faces(normal_b, -normal, FACING) {
                            continue;
                        }
                        let (edge_a, edge_b) = (normal.dot(p), normal.dot(r));
                        // The normal supports both hulls: no vertex of a lies beyond a's edge, none of b
                        // before b's.
                        let supports = a.hull.all_points(|v| normal.dot(v) <= edge_a + best.precision)
                            && placed.iter().all(|v| normal.dot(*v) >= edge_b - best.precision);
                        if supports {
                            best.offer(true, edge_a - edge_b, normal);
                        }
                    }
                }
            }
        }
    }
}
