//! What every reader gives: the surface as it stands in the file, and what was left out of it.

use glam::DVec3;

use crate::polygon::{self, Cut};

/// A surface as it stands in the file.
#[derive(Default)]
pub(crate) struct Surface {
    /// In the file's unit; may be infinite or not a number.
    pub vertices: Vec<DVec3>,
    /// Indices of `vertices`, all in range.
    pub triangles: Vec<[u32; 3]>,
    pub warnings: Vec<String>,
}

/// What a reader left out or could not do justice to.
#[derive(Default)]
pub(crate) struct Skipped {
    pub lines: usize,
    pub points: usize,
    pub freeform: usize,
    /// Where there are faces of fewer than three (different) corners: line or face numbers.
    pub incomplete: Vec<usize>,
    /// Polygons that could only be cut into a fan.
    pub fans: usize,
    collapsed: usize,
    scratch: Vec<u32>,
}

impl Skipped {
    /// Cuts a polygon of three or more corners into triangles. In a larger one, corners that repeat their predecessor
    /// are left out first.
    pub(crate) fn cut(&mut self, polygon: &[u32], vertices: &[DVec3], triangles: &mut Vec<[u32; 3]>) {
        let mut polygon = polygon;
        if polygon.len() > 3 {
            self.scratch.clear();
            self.scratch.extend_from_slice(polygon);
            self.scratch.dedup();
            if self.scratch.len() > 1 && self.scratch.first() == self.scratch.last() {
                self.scratch.pop();
            }
            if self.scratch.len() < 3 {
                self.collapsed += 1;
                return;
            }
            polygon = &self.scratch;
        }
        if polygon::triangulate(polygon, vertices, triangles) == Cut::Fan {
            self.fans += 1;
        }
    }

    /// One line for each kind of thing skipped. `place` is what `incomplete` counts: lines or faces.
    pub(crate) fn warnings(&self, place: &str) -> Vec<String> {
        let first = self.incomplete.first().copied().unwrap_or(0);
        [
            (self.lines, "line elements skipped, being no surface".into()),
            (self.points, "point elements skipped, being no surface".into()),
            (self.freeform, "free-form curves or surfaces skipped (convert them to polygons)".into()),
            (
                self.incomplete.len(),
                format!("faces of fewer than three corners skipped, the first at {place} {first}"),
            ),
            (self.collapsed, "polygons of fewer than three different corners skipped".into()),
            (
                self.fans,
                "polygons that cross or touch themselves or have no area cut into fans (check the result)"
                    .into(),
            ),
        ]
        .into_iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, what)| format!("{what}: {count}"))
        .collect()
    }
}
