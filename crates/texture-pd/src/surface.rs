//! Surfaces with a haptic texture: a coarse mesh with its fine detail (§4.2.2).

use glam::{DMat3, DVec2, DVec3, Vec3A};
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};
use palpate_core::mesh::UvMesh;
use palpate_core::{Pose, TriMesh};

use crate::height_image::{HeightImage, Wrap};
use crate::kernels::Triangle;
use crate::normals::corner_directions;
use crate::spline::{self, Level};

/// Cosine of the angle between a triangle's normal and the direction below which it is seen edge-on and left
/// out. Smaller values let its height function grow without bound.
const EDGE_ON: f64 = 1e-3;

/// A mesh for texture contacts: plain, or displaced by an image.
pub struct TexturedSurface {
    triangles: Vec<SurfaceTriangle>,
    tree: Bvh2,
    /// Origin of the boxes in the tree, m.
    middle: DVec3,
    texture: Option<Texture>,
}

impl std::fmt::Debug for TexturedSurface {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let levels = self.texture.as_ref().map_or(&[][..], |texture| &texture.levels);
        f.debug_struct("TexturedSurface")
            .field("triangles", &self.triangles.len())
            .field("levels", &levels)
            .finish_non_exhaustive()
    }
}

#[derive(Clone, Copy, Debug)]
struct SurfaceTriangle {
    corners: [DVec3; 3],
    directions: [DVec3; 3],
    coordinates: [DVec2; 3],
    /// Side of a square texel on the surface, m: infinite where the triangle has no area in the texture.
    texel: f64,
}

#[derive(Clone, Debug)]
pub(crate) struct Texture {
    /// Levels; their first coefficients are counted from the start of this texture's.
    pub levels: Vec<Level>,
    pub coefficients: Vec<f32>,
    wrap: [Wrap; 2],
    /// Range of displacements for each triangle and level, including 0, m.
    ranges: Vec<[f32; 2]>,
}

/// Reason why a mesh was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SurfaceError {
    /// The mesh has no triangles.
    #[error("the mesh has no triangles")]
    Empty,
    /// A vertex is not finite.
    #[error("triangle {triangle} has a vertex that is not finite: repair the mesh")]
    NonFinite {
        /// First triangle with such a vertex.
        triangle: usize,
    },
}

/// Transformation from a mesh's frame to a contact's frame u, v, n.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View {
    rotation: DMat3,
    translation: DVec3,
}

impl View {
    /// Returns the transformation of a mesh at `pose` to the frame with these axes at `origin`, world.
    pub fn new(pose: &Pose, axes: &DMat3, origin: DVec3) -> Self {
        let to_axes = axes.transpose();
        Self {
            rotation: to_axes * DMat3::from_quat(pose.rotation),
            translation: to_axes * (pose.translation - origin),
        }
    }

    fn point(&self, point: DVec3) -> DVec3 {
        self.rotation * point + self.translation
    }
}

/// Part of space that a contact's image shows, in the contact's frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Field {
    /// Half the side of the grid, m.
    pub half: f64,
    /// Largest distance from the frame's origin along n, m.
    pub reach: f64,
    /// 1 for triangles that face along n, −1 for those that face against it.
    pub side: f64,
}

impl TexturedSurface {
    /// Creates a surface without a texture.
    ///
    /// # Errors
    /// If the mesh is empty or has a vertex that is not finite.
    pub fn plain(mesh: &TriMesh) -> Result<Self, SurfaceError> {
        Self::from_triangles((0..mesh.triangles().len()).map(|triangle| mesh.corners(triangle)))
    }

    /// Creates a surface without a texture from the corners (m) of triangles.
    ///
    /// # Errors
    /// If there are no triangles, or a corner is not finite.
    pub fn from_triangles(triangles: impl IntoIterator<Item = [DVec3; 3]>) -> Result<Self, SurfaceError> {
        let flat = |corners| SurfaceTriangle {
            corners,
            directions: [DVec3::ZERO; 3],
            coordinates: [DVec2::ZERO; 3],
            texel: f64::INFINITY,
        };
        Self::new(triangles.into_iter().map(flat).collect(), None)
    }

    /// Creates a surface from a mesh that an image displaces: each point of a triangle by the image's
    /// displacement times the direction at that point ([`corner_directions`] with the angle `crease`, rad).
    ///
    /// # Errors
    /// If the mesh is empty or has a vertex that is not finite.
    pub fn textured(mesh: &UvMesh, image: &HeightImage, crease: f64) -> Result<Self, SurfaceError> {
        let size = DVec2::new(image.width().into(), image.height().into());
        let mut texture = Texture::new(image);
        let directions = corner_directions(mesh.mesh(), crease);
        let triangles = directions.into_iter().zip(mesh.coordinates()).enumerate();
        let triangles = triangles.map(|(triangle, (directions, coordinates))| {
            let corners = mesh.mesh().corners(triangle);
            let area = (corners[1] - corners[0]).cross(corners[2] - corners[0]).length();
            let [a, b, c] = coordinates.map(|uv| uv * size);
            // √ of the ratio of areas on the surface and in texels.
            let texel = (area / (b - a).perp_dot(c - a).abs()).sqrt();
            texture.add_ranges(a.min(b).min(c), a.max(b).max(c));
            SurfaceTriangle { corners, directions, coordinates: *coordinates, texel }
        });
        let triangles = triangles.collect();
        Self::new(triangles, Some(texture))
    }

    fn new(triangles: Vec<SurfaceTriangle>, texture: Option<Texture>) -> Result<Self, SurfaceError> {
        if triangles.is_empty() {
            return Err(SurfaceError::Empty);
        }
        if let Some(triangle) = triangles.iter().position(|t| !t.corners.iter().all(|p| p.is_finite())) {
            return Err(SurfaceError::NonFinite { triangle });
        }
        let corners = || triangles.iter().flat_map(|triangle| triangle.corners);
        let low = corners().fold(DVec3::INFINITY, DVec3::min);
        let high = corners().fold(DVec3::NEG_INFINITY, DVec3::max);
        let middle = low.midpoint(high);
        let boxes: Vec<Aabb> = triangles
            .iter()
            .map(|SurfaceTriangle { corners: [a, b, c], .. }| {
                rounded(a.min(*b).min(*c), a.max(*b).max(*c), middle)
            })
            .collect();
        let indices = (0..boxes.len() as u32).collect();
        let tree = PlocBuilder::new().build(PlocSearchDistance::Low, &boxes, indices, SortPrecision::U64, 0);
        Ok(Self { triangles, tree, middle, texture })
    }

    /// Bounds of the smallest and largest displacement along the surface's directions, m: zero without a
    /// texture.
    pub fn displacement(&self) -> [f64; 2] {
        let widened =
            |[low, high]: [f64; 2], range: &[f32; 2]| [low.min(range[0].into()), high.max(range[1].into())];
        let ranges = self.texture.iter().flat_map(|texture| &texture.ranges);
        ranges.fold([0.0; 2], widened)
    }

    /// Smallest size of a texel on the surface, m: infinite without a texture.
    pub fn texel(&self) -> f64 {
        self.triangles.iter().fold(f64::INFINITY, |least, triangle| least.min(triangle.texel))
    }

    /// Centre of the largest triangle, m, and its unit normal.
    pub fn middle(&self) -> (DVec3, DVec3) {
        let across = |triangle: &SurfaceTriangle| {
            let [a, b, c] = triangle.corners;
            (b - a).cross(c - a)
        };
        let sized = |triangle| across(triangle).length_squared();
        let largest = self.triangles.iter().max_by(|a, b| sized(a).total_cmp(&sized(b)));
        largest.map_or((DVec3::ZERO, DVec3::Z), |triangle| {
            let [a, b, c] = triangle.corners;
            ((a + b + c) / 3.0, across(triangle).normalize_or(DVec3::Z))
        })
    }

    /// Largest magnitude of the displacement, m.
    pub fn amplitude(&self) -> f64 {
        self.displacement().into_iter().fold(0.0, |most, bound| most.max(bound.abs()))
    }

    pub(crate) fn texture(&self) -> Option<&Texture> {
        self.texture.as_ref()
    }

    /// Appends the triangles that may be visible in a field.
    pub(crate) fn gather(&self, view: &View, field: &Field, found: &mut Vec<u32>) {
        let [low, high] = [-1.0, 1.0].map(|sign| sign * DVec3::new(field.half, field.half, field.reach));
        // Bounding box, in the mesh's frame, of the field's box, which is rotated there.
        let back = view.rotation.transpose();
        let middle = back * -view.translation;
        let extent = DMat3::from_cols(back.x_axis.abs(), back.y_axis.abs(), back.z_axis.abs()) * high;
        let bounds = rounded(middle - extent, middle + extent, self.middle);
        self.tree.aabb_traverse(bounds, |tree, leaf| {
            let node = &tree.nodes[leaf as usize];
            let first = node.first_index as usize;
            for &index in &tree.primitive_indices[first..first + node.prim_count as usize] {
                let [a, b, c] = self.triangles[index as usize].corners.map(|corner| view.point(corner));
                let inside = a.min(b).min(c).cmple(high).all() && a.max(b).max(c).cmpge(low).all();
                if inside && field.side * facing(a, b, c) > EDGE_ON {
                    found.push(index);
                }
            }
            true
        });
    }

    /// Returns the bounds of triangles along u and v in a contact's frame, m.
    pub(crate) fn extent(&self, triangles: &[u32], view: &View) -> [DVec2; 2] {
        let corners = triangles.iter().flat_map(|&index| self.triangles[index as usize].corners);
        corners.fold([DVec2::INFINITY, DVec2::NEG_INFINITY], |[low, high], corner| {
            let place = view.point(corner).truncate();
            [low.min(place), high.max(place)]
        })
    }

    /// Returns a triangle in a contact's frame, with the texture's level for texels of size `footprint` (m; 0
    /// for the finest). Indices of levels are counted from `first_level`, the texture's first. `None` if the
    /// triangle is seen edge-on or from behind.
    pub(crate) fn triangle(
        &self,
        index: u32,
        view: &View,
        side: f64,
        footprint: f64,
        first_level: u32,
    ) -> Option<Triangle> {
        let SurfaceTriangle { corners, directions, coordinates, texel } = self.triangles[index as usize];
        let [p0, p1, p2] = corners.map(|corner| view.point(corner));
        if side * facing(p0, p1, p2) <= EDGE_ON {
            return None;
        }
        let (e1, e2) = (p1 - p0, p2 - p0);
        // Edges and their changes, so that the kernels interpolate with s and t alone.
        let mut triangle = Triangle {
            plane: [p0, e1, e2].map(|edge| edge.truncate().as_vec2().to_array()),
            rise: [p0, e1, e2].map(|edge| edge.z as f32),
            inverse_area: (1.0 / (e1.x * e2.y - e1.y * e2.x)) as f32,
            ..Triangle::default()
        };
        if let Some(texture) = &self.texture {
            let [n0, n1, n2] = directions.map(|direction| view.rotation * direction);
            let level = texture.level(texel, footprint);
            let [uv0, uv1, uv2] = texture.texels(level, coordinates);
            triangle.directions = [n0, n1 - n0, n2 - n0].map(|direction| direction.as_vec3().to_array());
            triangle.texture = [uv0, uv1 - uv0, uv2 - uv0].map(|uv| uv.as_vec2().to_array());
            triangle.level = (first_level + level as u32 + 1) as f32;
            let [low, high] = texture.ranges[index as usize * texture.levels.len() + level];
            (triangle.max_displacement, triangle.max_outwards) = (high.max(-low), high);
        }
        Some(triangle)
    }
}

/// Returns the component along n of a triangle's unit normal.
fn facing(a: DVec3, b: DVec3, c: DVec3) -> f64 {
    (b - a).cross(c - a).normalize_or_zero().z
}

fn rounded(low: DVec3, high: DVec3, middle: DVec3) -> Aabb {
    let single = |p: DVec3| Vec3A::from((p - middle).as_vec3());
    Aabb::new(single(low), single(high))
}

impl Texture {
    fn new(image: &HeightImage) -> Self {
        let (mut levels, mut coefficients) = (Vec::new(), Vec::new());
        spline::push_levels(image, &mut levels, &mut coefficients);
        Self { levels, coefficients, wrap: image.wrap(), ranges: Vec::new() }
    }

    /// Adds the ranges of displacements of a triangle, for each level; it lies in this box of texels of the
    /// finest level. A spline lies within the range of its coefficients.
    fn add_ranges(&mut self, low: DVec2, high: DVec2) {
        let finest = DVec2::new(self.levels[0][1].into(), self.levels[0][2].into());
        for level in &self.levels {
            let scale = DVec2::new(level[1].into(), level[2].into()) / finest;
            let (from, to) = ((low * scale).floor() - 2.0, (high * scale).ceil() + 2.0);
            let columns = indices(from.x, to.x, level[1], self.wrap[0]);
            let mut range = [0.0_f32; 2];
            for row in indices(from.y, to.y, level[2], self.wrap[1]) {
                for column in columns.clone() {
                    let value = spline::coefficient(level, &self.coefficients, column, row);
                    range = [range[0].min(value), range[1].max(value)];
                }
            }
            self.ranges.push(range);
        }
    }

    /// Returns the coarsest level whose texels are no larger than `footprint` (m).
    fn level(&self, texel: f64, footprint: f64) -> usize {
        let ratio = footprint / texel;
        let level = if ratio >= 1.0 { ratio.log2() as usize } else { 0 };
        level.min(self.levels.len() - 1)
    }

    /// Returns texture coordinates in texels of a level. Whole repetitions are subtracted, so f32 is accurate
    /// enough.
    fn texels(&self, level: usize, coordinates: [DVec2; 3]) -> [DVec2; 3] {
        let whole = |least: f64, wrap: Wrap| match wrap {
            Wrap::Repeat => least.floor(),
            Wrap::Clamp => 0.0,
            Wrap::Mirror => 2.0 * (0.5 * least).floor(),
        };
        let least = coordinates[0].min(coordinates[1]).min(coordinates[2]);
        let off = DVec2::new(whole(least.x, self.wrap[0]), whole(least.y, self.wrap[1]));
        let [_, width, height, _] = self.levels[level];
        let size = DVec2::new(width.into(), height.into());
        coordinates.map(|uv| (uv - off) * size)
    }
}

/// Returns the indices from one to another, shifted by whole periods; one whole period if there are more.
fn indices(from: f64, to: f64, count: u32, wrap: Wrap) -> std::ops::Range<i32> {
    // A mirrored period contains each index twice.
    let period = 2.0 * f64::from(count);
    if wrap == Wrap::Clamp {
        let [from, to] = [from, to].map(|at| at.clamp(-1.0, f64::from(count) + 1.0));
        return from as i32..to as i32 + 1;
    }
    if to - from >= period {
        return 0..period as i32;
    }
    let whole = (from / period).floor() * period;
    (from - whole) as i32..(to - whole) as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn range_of_a_box_is_the_range_of_its_texels_in_any_period() {
        // A single raised texel.
        let (width, height) = (32_u32, 16_u32);
        let (column, row) = (20, 3);
        for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror] {
            let mut heights = vec![0.0; (width * height) as usize];
            heights[(row * width + column) as usize] = 1.0;
            let image = HeightImage::new(width, height, heights, [wrap; 2]).unwrap().into_atlas();
            let mut texture = Texture::new(&image);
            let mut highest = |low: DVec2, high: DVec2| {
                texture.add_ranges(low, high);
                texture.ranges.pop().unwrap()[1]
            };
            let mut around = |x: f64, y: f64| highest(DVec2::new(x, y) - 0.5, DVec2::new(x, y) + 0.5);
            let (x, y) = (f64::from(column) + 0.5, f64::from(row) + 0.5);
            assert!(around(x, y) >= 1.0);
            assert!(around(x - 12.0, y + 8.0) < 1e-3);
            let period = if wrap == Wrap::Mirror { 64.0 } else { 32.0 };
            let expected = if wrap == Wrap::Clamp { 0.0..1e-3 } else { 1.0..4.0 };
            for periods in [1.0, -3.0, 1e9] {
                let found = around(x + period * periods, y);
                assert!(expected.contains(&found), "{wrap:?}, {periods}: {found}");
            }
            assert!(highest(DVec2::splat(-1e12), DVec2::splat(1e12)) >= 1.0);
        }
    }
}
