//! The common result of all readers: the surface as it stands in the file, and counts of what was left out.

use glam::{DVec2, DVec3};

use crate::polygon::{self, Cut};
use crate::{HeightTexture, LoadWarning};

/// The content that a reader is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Wanted {
    /// The surface alone; textures are ignored.
    Surface,
    /// The surface with texture coordinates for every triangle, or an error.
    Textured,
}

/// A surface as it stands in the file.
#[derive(Default)]
pub(crate) struct Surface {
    /// Positions in the file's unit; may be infinite or not a number.
    pub vertices: Vec<DVec3>,
    /// Indices of `vertices`, all in range.
    pub triangles: Vec<[u32; 3]>,
    /// Texture coordinates of each triangle's corners, v = 0 on the image's first row; may be infinite or
    /// not a number. Empty unless asked for.
    pub coordinates: Vec<[DVec2; 3]>,
    /// The image of fine detail, if asked for and present.
    pub height_texture: Option<HeightTexture>,
    pub warnings: Vec<LoadWarning>,
}

/// Counts of elements that a reader left out or only approximated.
#[derive(Default)]
pub(crate) struct Skipped {
    pub lines: usize,
    pub points: usize,
    pub freeform: usize,
    /// Faces of fewer than three corners, by line or face number.
    pub incomplete: Vec<usize>,
    /// Polygons that could only be cut into a fan.
    pub fans: usize,
    collapsed: usize,
    kept: Vec<usize>,
    outline: Vec<u32>,
    cuts: Vec<[usize; 3]>,
}

impl Skipped {
    /// Cuts a polygon of three or more corners into triangles, each handed to `emit` as the numbers of three
    /// of its corners. In a larger one, corners that repeat their predecessor are left out first.
    pub(crate) fn cut(&mut self, polygon: &[u32], vertices: &[DVec3], mut emit: impl FnMut([usize; 3])) {
        if polygon.len() == 3 {
            return emit([0, 1, 2]);
        }
        self.kept.clear();
        self.kept.extend(0..polygon.len());
        self.kept.dedup_by_key(|corner| polygon[*corner]);
        if self.kept.len() > 1 && polygon.first() == self.kept.last().map(|corner| &polygon[*corner]) {
            self.kept.pop();
        }
        if self.kept.len() < 3 {
            self.collapsed += 1;
            return;
        }
        self.outline.clear();
        self.outline.extend(self.kept.iter().map(|corner| polygon[*corner]));
        self.cuts.clear();
        if polygon::triangulate(&self.outline, vertices, &mut self.cuts) == Cut::Fan {
            self.fans += 1;
        }
        self.cuts.iter().for_each(|corners| emit(corners.map(|corner| self.kept[corner])));
    }

    /// A warning for each kind of element skipped. `place` says whether the numbers of `incomplete` are lines
    /// or faces.
    pub(crate) fn warnings(&self, place: &str) -> Vec<LoadWarning> {
        let counted = |count, warning: fn(usize) -> LoadWarning| (count > 0).then(|| warning(count));
        let incomplete = self.incomplete.first().map(|first| LoadWarning::IncompleteFaces {
            count: self.incomplete.len(),
            first: format!("{place} {first}"),
        });
        [
            counted(self.lines, |count| LoadWarning::Lines { count }),
            counted(self.points, |count| LoadWarning::Points { count }),
            counted(self.freeform, |count| LoadWarning::FreeForm { count }),
            incomplete,
            counted(self.collapsed, |count| LoadWarning::CollapsedPolygons { count }),
            counted(self.fans, |count| LoadWarning::FannedPolygons { count }),
        ]
        .into_iter()
        .flatten()
        .collect()
    }
}
