//! What repair does to the surface of a mesh: its area and volume before and after, and the area that is
//! lost.

use glam::DVec3;
use palpate_core::TriMesh;
use palpate_core::triangle::nearest_on_triangle;
use serde::Serialize;

use super::orientation::winding_number;
use crate::intersect::{Boxes, normalise};

/// Distance from the repaired surface, in bounding radii, up to which the original one is not lost.
const NEAR: f64 = 1e-3;

/// Number of points at which lost surface is looked for, and the largest number of solid angles for it, a
/// fraction of a second's worth.
const SAMPLES: usize = 500;
const MAX_SOLID_ANGLES: usize = 1 << 23;

/// What [`repair`](super::repair()) did to the surface of a mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct RepairEffect {
    /// Area before, m². Parts that overlap count each, and so do their hidden surfaces.
    pub area_before: f64,
    /// Area after, m².
    pub area_after: f64,
    /// Signed volume before, m³, as in [`ValidationReport`](palpate_core::mesh::ValidationReport): parts that
    /// overlap count each, and triangles that face inwards count negatively.
    pub volume_before: f64,
    /// Signed volume after, m³.
    pub volume_after: f64,
    /// Area, m², of what could be touched before and holds nothing out after: the part of the triangles
    /// dropped for intersecting others that is neither on the repaired surface, to 10⁻³ bounding radii, nor
    /// inside it. Found at up to 500 points.
    pub lost_area: f64,
}

impl RepairEffect {
    /// Whether repair lost surface: more than a thousandth of it, which is more than rounding at seams.
    pub fn lost_surface(&self) -> bool {
        self.lost_area > 1e-3 * self.area_before
    }

    pub(super) fn of(before: &TriMesh, after: &TriMesh, lost: &[[DVec3; 3]]) -> Self {
        Self {
            area_before: area(before),
            area_after: area(after),
            volume_before: before.validate().volume,
            volume_after: after.validate().volume,
            lost_area: if lost.is_empty() { 0.0 } else { lost_area(after, lost) },
        }
    }
}

fn doubled_area([a, b, c]: [DVec3; 3]) -> f64 {
    let doubled = (b - a).cross(c - a).length();
    if doubled.is_finite() { doubled } else { 0.0 }
}

fn area(mesh: &TriMesh) -> f64 {
    0.5 * (0..mesh.triangles().len()).map(|t| doubled_area(mesh.corners(t))).sum::<f64>()
}

/// The area of `lost` triangles that is neither near the surface nor inside it.
fn lost_area(mesh: &TriMesh, lost: &[[DVec3; 3]]) -> f64 {
    let total: f64 = lost.iter().map(|corners| doubled_area(*corners)).sum();
    let near = NEAR * mesh.bounding_sphere().radius;
    let mut points = mesh.vertices().to_vec();
    points.extend(lost.iter().flatten());
    // The tolerance along with the points.
    points.extend([DVec3::splat(near), DVec3::ZERO]);
    normalise(&mut points);
    let near = points[points.len() - 2].x;
    let corners = |t: usize| mesh.triangles()[t].map(|v| points[v as usize]);
    let count = mesh.triangles().len();
    let boxes = Boxes::new(count, |t| Some(corners(t)));
    let tree = boxes.tree();
    let mut found = Vec::new();
    let samples = SAMPLES.min(MAX_SOLID_ANGLES / count.max(1)).max(1);
    let of_lost = points[mesh.vertices().len()..].chunks_exact(3).take(lost.len());
    let (mut tested, mut lost_there) = (0.0, 0.0);
    for (part, original) in of_lost.zip(lost).step_by(lost.len().div_ceil(samples)) {
        let own = doubled_area(*original);
        let share = if total > 0.0 { own / total } else { 0.0 };
        // The middles of the triangles that a division of each side in n gives.
        let n = ((share * samples as f64).sqrt() as usize).max(1);
        let (a, u, v) = (part[0], (part[1] - part[0]) / n as f64, (part[2] - part[0]) / n as f64);
        let mut gone = 0;
        for i in 0..n {
            for j in 0..2 * (n - i) - 1 {
                let third = if j % 2 == 0 { 1.0 / 3.0 } else { 2.0 / 3.0 };
                let point = a + u * (i as f64 + third) + v * ((j / 2) as f64 + third);
                let distance = |corners: [DVec3; 3]| nearest_on_triangle(point, &corners).0.distance(point);
                boxes.touching([point - near, point + near], &tree, &mut found);
                let held = found.iter().any(|t| distance(corners(*t as usize)) <= near)
                    || winding_number((0..count).map(corners), point) > 0.5;
                gone += usize::from(!held);
            }
        }
        tested += own;
        lost_there += own * gone as f64 / (n * n) as f64;
    }
    if tested > 0.0 { 0.5 * total * lost_there / tested } else { 0.0 }
}
