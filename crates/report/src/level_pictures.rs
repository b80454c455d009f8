//! Pictures of contact levels of detail, after Figs. 3.7 and 3.8: coloured patches, free levels as hulls, all
//! with one camera, and a contact sheet of them.

use palpate::TriMesh;
use palpate::clod_build::hull_faces;
use palpate::core::Clod;
use palpate::glam::DVec3;

use crate::patches::{self, Side, Surface};
use crate::picture::Picture;
use crate::raster::{Camera, Face, Item, Paint, Shading, View};
use crate::sheet::{Tile, contact_sheet};

/// Colour of the original mesh, linear RGB.
const PLASTER: [f32; 3] = [0.62, 0.60, 0.55];
/// Largest width of lines along boundaries of patches, as a part of the picture's width.
const MAX_LINE_WIDTH: f64 = 1.0 / 640.0;
/// Largest width of lines as a part of the size of a patch. Wider lines would hide the colours of small
/// patches.
const MAX_LINE_SHARE: f64 = 0.06;
/// Cosine of the angle between faces of a hull above which there is no line between them (20°).
const HULL_CREASE_COSINE: f64 = 0.94;
/// Maximum width of a picture on a contact sheet, pixels.
const MAX_TILE_WIDTH: u32 = 400;

/// Pictures of the levels of a hierarchy.
#[derive(Debug)]
pub struct LevelPictures<'a> {
    clod: &'a Clod,
    camera: Camera,
    width: u32,
    height: u32,
    /// Colour number of each node.
    colors: Vec<u8>,
}

impl<'a> LevelPictures<'a> {
    /// Creates pictures `width` pixels wide, and three quarters as high, that the full mesh fills.
    pub fn new(clod: &'a Clod, view: &View, width: u32) -> Self {
        Self::close_up(clod, view, width, clod.leaves().iter().flat_map(|node| clod.hull(node)))
    }

    /// Creates pictures that some points (m) of the mesh fill; other parts are visible around them.
    pub fn close_up<'p>(
        clod: &'a Clod,
        view: &View,
        width: u32,
        points: impl IntoIterator<Item = &'p DVec3>,
    ) -> Self {
        let height = width * 3 / 4;
        let camera = Camera::fit(points, view, width, height);
        Self { clod, camera, width, height, colors: patches::colors(clod) }
    }

    /// Draws the mesh that the hierarchy was built from, smoothly shaded.
    pub fn original(&self) -> Picture {
        let mesh = Surface::of(self.clod, 0).mesh;
        let faces = vec![Face { color: PLASTER, lined: [false; 3] }; mesh.triangles().len()];
        self.camera.render(&[Item::painted(&mesh, Paint::Faces(&faces))], Shading::Smooth)
    }

    /// Draws a level: its surface with a colour per patch or, for a free level, the hulls of its nodes.
    ///
    /// # Panics
    /// If the hierarchy has no such level.
    pub fn level(&self, level: usize) -> Picture {
        let free = self.clod.levels[level].free;
        let (mesh, faces) = if free { self.hulls(level) } else { self.surface(level) };
        let nodes = self.clod.level(level).len().max(1) as f64;
        // The patches that face the camera, about half of them, cover about half of the picture.
        let patch = (f64::from(self.width) * f64::from(self.height) / nodes).sqrt();
        let line_width = (MAX_LINE_WIDTH * f64::from(self.width)).min(MAX_LINE_SHARE * patch);
        self.camera.render(&[Item::painted(&mesh, Paint::Faces(&faces))], Shading::Flat { line_width })
    }

    fn surface(&self, level: usize) -> (TriMesh, Vec<Face>) {
        let surface = Surface::of(self.clod, level);
        let first = self.clod.levels[level].nodes.start;
        let face = |(owner, lined): (&u32, &[bool; 3])| Face {
            color: patches::color(self.colors[(first + owner) as usize]),
            lined: *lined,
        };
        let faces = surface.owners.iter().zip(&surface.boundary).map(face).collect();
        (surface.mesh, faces)
    }

    fn hulls(&self, level: usize) -> (TriMesh, Vec<Face>) {
        let mut vertices = Vec::new();
        let mut triangles = Vec::new();
        let mut faces = Vec::new();
        let first = self.clod.levels[level].nodes.start;
        for (index, node) in (first..).zip(self.clod.level(level)) {
            let points = self.clod.extreme(node).to_vec();
            let hull = hull_faces(&points);
            let color = patches::color(self.colors[index as usize]);
            faces.extend(creases(&points, &hull).into_iter().map(|lined| Face { color, lined }));
            let offset = vertices.len() as u32;
            triangles.extend(hull.iter().map(|triangle| triangle.map(|vertex| offset + vertex)));
            vertices.extend_from_slice(&points);
        }
        // Indices are in range; with too many hulls for a mesh nothing is drawn.
        (TriMesh::new(vertices, triangles).unwrap_or_default(), faces)
    }

    /// Returns the caption of a level's picture.
    pub fn caption(&self, level: usize) -> Vec<String> {
        let data = &self.clod.levels[level];
        let counted = |number: usize, one: &str, many: &str| {
            format!("{} {}", grouped(number), if number == 1 { one } else { many })
        };
        if data.free {
            vec![format!("level {level}, free"), counted(data.nodes.len(), "hull", "hulls")]
        } else {
            vec![
                format!("level {level}"),
                counted(data.triangles as usize, "triangle", "triangles"),
                counted(data.nodes.len(), "patch", "patches"),
            ]
        }
    }

    /// Returns a contact sheet like Fig. 3.7, from left to right and top to bottom: the original mesh, then
    /// the given levels with their pictures.
    pub fn sheet(&self, levels: &[(usize, Picture)]) -> Picture {
        let triangles = grouped(self.clod.source.triangles as usize);
        let caption = vec!["original mesh".to_owned(), format!("{triangles} triangles")];
        let mut tiles = vec![Tile { picture: self.original(), caption }];
        tiles.extend(
            levels
                .iter()
                .map(|(level, picture)| Tile { picture: picture.clone(), caption: self.caption(*level) }),
        );
        let columns = if tiles.len() > 9 { 4 } else { 3 };
        let width = self.width.min(MAX_TILE_WIDTH);
        contact_sheet(&tiles, columns, width, (width / 200).max(1))
    }
}

/// Returns for each face of a hull, by the opposite corner, whether its edges separate faces that meet at an
/// angle.
fn creases(points: &[DVec3], hull: &[[u32; 3]]) -> Vec<[bool; 3]> {
    let normals: Vec<DVec3> = hull
        .iter()
        .map(|face| {
            let [a, b, c] = face.map(|vertex| points[vertex as usize]);
            (b - a).cross(c - a).normalize_or_zero()
        })
        .collect();
    let mut lined = vec![[false; 3]; hull.len()];
    for edge in patches::sides(hull).chunk_by(|a, b| a.edge == b.edge) {
        let normal = |side: &Side| normals[side.triangle as usize];
        let smooth = edge.len() == 2 && normal(&edge[0]).dot(normal(&edge[1])) > HULL_CREASE_COSINE;
        for side in edge {
            lined[side.triangle as usize][side.corner as usize] = !smooth;
        }
    }
    lined
}

/// Formats a number with commas between thousands.
pub fn grouped(number: usize) -> String {
    let digits = number.to_string();
    let groups: Vec<&str> =
        digits.as_bytes().rchunks(3).rev().filter_map(|group| str::from_utf8(group).ok()).collect();
    groups.join(",")
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use palpate::clod_build::{BuildOptions, build, unwatched};
    use palpate::models::Model;

    use super::*;

    /// Coarse hues in a picture, without the grey background.
    fn hues(picture: &Picture) -> HashSet<[u8; 3]> {
        let vivid = |pixel: &[u8; 3]| {
            let (low, high) = (pixel.iter().min(), pixel.iter().max());
            high.zip(low).is_some_and(|(high, low)| high - low > 60)
        };
        picture.pixels().iter().copied().filter(vivid).map(|pixel| pixel.map(|value| value / 64)).collect()
    }

    #[test]
    fn every_level_is_drawn_with_its_patches_in_colours() {
        let mesh = Model::Torus.generate(1_000).expect("torus");
        let clod = build(&mesh, &BuildOptions::default(), &mut unwatched).expect("hierarchy");
        let pictures = LevelPictures::new(&clod, &View::from_degrees(-70.0, 40.0), 200);
        assert!(
            clod.levels.iter().any(|level| level.free)
                && clod.levels.iter().filter(|level| !level.free).count() > 1
        );
        assert!(hues(&pictures.original()).is_empty(), "the original mesh has no colours");
        let mut drawn = Vec::new();
        for (index, level) in clod.levels.iter().enumerate() {
            let picture = pictures.level(index);
            assert_eq!((picture.width(), picture.height()), (200, 150));
            let hues = hues(&picture).len();
            // Neighbouring patches differ in colour; a hull may hide the others.
            let several = !level.free && level.nodes.len() > 8;
            let wanted = if index == 0 { 3 } else { 1 + usize::from(several) };
            assert!(hues >= wanted, "level {index}: {hues} hues");
            drawn.push((index, picture));
        }
        let sheet = pictures.sheet(&drawn);
        assert_eq!(sheet.width() % 200, 0);
        assert!(hues(&sheet).len() > 3);
        let ink = sheet.pixels().iter().filter(|pixel| **pixel == [40; 3]).count();
        assert!(ink > 100 * clod.levels.len(), "the captions have {ink} dots");
    }

    #[test]
    fn close_up_is_filled_by_its_points() {
        let mesh = Model::Torus.generate(1_000).expect("torus");
        let clod = build(&mesh, &BuildOptions::default(), &mut unwatched).expect("hierarchy");
        let view = View::from_degrees(-70.0, 40.0);
        let whole = LevelPictures::new(&clod, &view, 200).original();
        let side: Vec<DVec3> = mesh.vertices().iter().copied().filter(|point| point.x > 0.0).collect();
        let half = LevelPictures::close_up(&clod, &view, 200, &side).original();
        let border = |picture: &Picture, column| -> Vec<_> {
            (0..150).map(|row| picture.pixel(column, row)).collect()
        };
        // The whole torus leaves a frame of background; in the close-up it reaches the picture's border.
        assert!(border(&whole, 0) == border(&whole, 199));
        assert!(border(&half, 0) != border(&whole, 0) || border(&half, 199) != border(&whole, 199));
    }

    #[test]
    fn cube_has_lines_along_its_edges_and_none_across_its_sides() {
        let corners: Vec<DVec3> =
            (0..8).map(|k| DVec3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2))).collect();
        let hull = hull_faces(&corners);
        assert_eq!(hull.len(), 12);
        let lined = creases(&corners, &hull).iter().flatten().filter(|lined| **lined).count();
        assert_eq!(lined, 24, "twelve edges, each seen from two sides");
    }

    #[test]
    fn thousands_are_grouped() {
        for (number, text) in [(0, "0"), (999, "999"), (1_000, "1,000"), (1_234_567, "1,234,567")] {
            assert_eq!(grouped(number), text);
        }
    }
}
