//! A small software renderer: triangles in perspective with a depth buffer, two lights, ambient occlusion and
//! nine samples per pixel.
//!
//! Rasterisation stores depth, normal and triangle of each sample. Shading is a second pass over the samples,
//! so its cost does not depend on the number of triangles. A [`Camera`] is fitted to a set of points once and
//! then draws any number of scenes in the same way.

use palpate::TriMesh;
use palpate::glam::{DMat3, DQuat, DVec3, Vec3};
use rayon::prelude::*;

use crate::picture::Picture;

/// Number of samples along each side of a pixel.
const SAMPLES: usize = 3;
/// Vertical field of view, rad.
const FIELD_OF_VIEW: f64 = 0.42;
/// Factor by which the fitted field exceeds the scene, so that there is a margin.
const MARGIN: f64 = 1.08;
/// Cosine of the angle between faces above which they are shaded as one smooth surface (35°).
const CREASE_COSINE: f32 = 0.82;
/// Colour of the inside of a plainly painted surface, linear RGB. It shows where a mesh is not oriented
/// outwards.
const INSIDE: Vec3 = Vec3::new(0.9, 0.05, 0.2);
/// Factor on a face's colour when its inside is visible.
const INSIDE_DIMMED: f32 = 0.4;
/// Factor on a colour under a line.
const LINE_DIMMED: f32 = 0.25;

/// A mesh in the scene.
#[derive(Clone, Copy, Debug)]
pub struct Item<'a> {
    /// Mesh in its own frame.
    pub mesh: &'a TriMesh,
    /// Colours of the mesh.
    pub paint: Paint<'a>,
    /// Rotation from the mesh's frame to the scene's.
    pub rotation: DQuat,
    /// Position of the mesh's origin in the scene, m.
    pub translation: DVec3,
}

impl<'a> Item<'a> {
    /// Returns a mesh at the scene's origin, in one colour (linear RGB, 0 to 1).
    pub const fn new(mesh: &'a TriMesh, color: [f32; 3]) -> Self {
        Self::painted(mesh, Paint::Plain(color))
    }

    /// Returns a mesh at the scene's origin.
    pub const fn painted(mesh: &'a TriMesh, paint: Paint<'a>) -> Self {
        Self { mesh, paint, rotation: DQuat::IDENTITY, translation: DVec3::ZERO }
    }
}

/// Colours of a mesh.
#[derive(Clone, Copy, Debug)]
pub enum Paint<'a> {
    /// One colour: linear RGB, 0 to 1. The inside is red.
    Plain([f32; 3]),
    /// One face for each triangle of the mesh, in order. Triangles without a face are not drawn.
    Faces(&'a [Face]),
}

/// Appearance of a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Face {
    /// Colour, linear RGB, 0 to 1.
    pub color: [f32; 3],
    /// Whether there is a dark line along the edge opposite each corner.
    pub lined: [bool; 3],
}

/// Shading of surfaces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shading {
    /// Smooth shading with creases, without lines.
    Smooth,
    /// Flat shading with dark lines along the marked edges, or along all edges of a plainly painted mesh.
    Flat {
        /// Width of lines, pixels; 0 for no lines.
        line_width: f64,
    },
}

/// Direction of view. The scene is centred and fitted into the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Azimuth of the camera about z, from x towards y, rad.
    pub azimuth: f64,
    /// Elevation of the camera above the horizon, rad.
    pub elevation: f64,
    /// Rotation of the picture, clockwise, rad.
    pub roll: f64,
    /// Magnification relative to the fitted scene.
    pub zoom: f64,
}

impl View {
    /// Returns the view from a direction in degrees.
    pub fn from_degrees(azimuth: f64, elevation: f64) -> Self {
        Self { azimuth: azimuth.to_radians(), elevation: elevation.to_radians(), roll: 0.0, zoom: 1.0 }
    }

    /// Returns the rotation from the scene's axes to the camera's: x right, y up, z towards the viewer.
    pub(crate) fn to_camera(self) -> DMat3 {
        let (sin_azimuth, cos_azimuth) = self.azimuth.sin_cos();
        let (sin_elevation, cos_elevation) = self.elevation.sin_cos();
        let backward = DVec3::new(cos_elevation * cos_azimuth, cos_elevation * sin_azimuth, sin_elevation);
        let right = DVec3::new(-sin_azimuth, cos_azimuth, 0.0);
        let upright = DMat3::from_cols(right, backward.cross(right), backward).transpose();
        DMat3::from_rotation_z(-self.roll) * upright
    }
}

/// A camera with the size of its picture.
#[derive(Clone, Debug)]
pub struct Camera {
    to_camera: DMat3,
    /// Position of the eye in camera axes, m.
    eye: DVec3,
    /// Half the height of the field at the centre of the scene, m: the camera's unit of length.
    reach: f64,
    /// Samples per unit of (lateral position / depth).
    focal: f64,
    /// Size of the picture, pixels.
    width: usize,
    height: usize,
}

impl Camera {
    /// Creates a camera whose picture of `width` × `height` pixels contains all `points` (m).
    pub fn fit<'p>(
        points: impl IntoIterator<Item = &'p DVec3>,
        view: &View,
        width: u32,
        height: u32,
    ) -> Self {
        let to_camera = view.to_camera();
        let mut lowest = DVec3::INFINITY;
        let mut highest = DVec3::NEG_INFINITY;
        for point in points {
            let seen = to_camera * *point;
            lowest = lowest.min(seen);
            highest = highest.max(seen);
        }
        if !(lowest.is_finite() && highest.is_finite()) {
            (lowest, highest) = (DVec3::ZERO, DVec3::ZERO);
        }
        let center = 0.5 * (lowest + highest);
        let half = 0.5 * (highest - lowest);
        let slope = (0.5 * FIELD_OF_VIEW).tan();
        let (width, height) = (width.max(1) as usize, height.max(1) as usize);
        let aspect = width as f64 / height as f64;
        let reach = MARGIN * half.y.max(half.x / aspect).max(1e-9 * half.z).max(f64::MIN_POSITIVE);
        let eye = center + DVec3::new(0.0, 0.0, half.z + reach / slope);
        let focal = 0.5 * (height * SAMPLES) as f64 / slope * view.zoom;
        Self { to_camera, eye, reach, focal, width, height }
    }

    /// Draws the items as one scene.
    pub fn render(&self, items: &[Item<'_>], shading: Shading) -> Picture {
        let (columns, rows) = (self.width * SAMPLES, self.height * SAMPLES);
        let empty = Sample { depth: f32::INFINITY, normal: Vec3::Z, triangle: 0, line: false };
        let mut frame =
            Frame { samples: vec![empty; columns * rows], columns, rows, focal: self.focal, first: 0 };
        let mut faces: Vec<SeenFace> = Vec::new();
        for item in items {
            let place = |vertex: &DVec3| {
                let placed = self.to_camera * (item.rotation * *vertex + item.translation);
                (placed - self.eye) / self.reach
            };
            let seen: Vec<DVec3> = item.mesh.vertices().iter().map(place).collect();
            frame.first = faces.len() as u32;
            let triangles = item.mesh.triangles();
            match item.paint {
                Paint::Plain(color) => {
                    frame.draw(triangles, &seen, |_| [true; 3], shading);
                    let face = SeenFace { outside: Vec3::from(color), inside: INSIDE };
                    faces.extend(std::iter::repeat_n(face, triangles.len()));
                }
                Paint::Faces(painted) => {
                    let drawn = &triangles[..triangles.len().min(painted.len())];
                    frame.draw(drawn, &seen, |triangle| painted[triangle].lined, shading);
                    faces.extend(painted[..drawn.len()].iter().map(|face| {
                        let outside = Vec3::from(face.color);
                        SeenFace { outside, inside: INSIDE_DIMMED * outside }
                    }));
                }
            }
        }
        frame.picture(&faces)
    }
}

/// Colours of a triangle, linear RGB.
#[derive(Clone, Copy)]
struct SeenFace {
    outside: Vec3,
    inside: Vec3,
}

/// Surface at a sample.
#[derive(Clone, Copy)]
struct Sample {
    /// Distance along the view direction; infinite for the background.
    depth: f32,
    normal: Vec3,
    /// Index of the triangle among all items.
    triangle: u32,
    line: bool,
}

/// Samples of a picture, in camera axes with the eye as origin and the camera's reach as the unit of length.
struct Frame {
    samples: Vec<Sample>,
    columns: usize,
    rows: usize,
    /// Samples per unit of (lateral position / depth).
    focal: f64,
    /// Index of the current item's first triangle.
    first: u32,
}

impl Frame {
    /// Rasterises the triangles of an item.
    fn draw(
        &mut self,
        triangles: &[[u32; 3]],
        seen: &[DVec3],
        lined: impl Fn(usize) -> [bool; 3],
        shading: Shading,
    ) {
        let normals = corner_normals(triangles, seen, shading);
        let line_reach = match shading {
            Shading::Smooth => 0.0,
            Shading::Flat { line_width } => 0.5 * line_width * SAMPLES as f64,
        };
        for (index, (triangle, corner_normals)) in triangles.iter().zip(&normals).enumerate() {
            let corners = triangle.map(|vertex| seen[vertex as usize]);
            let nearest = -1e-6;
            if corners.iter().any(|corner| corner.z > nearest) {
                continue;
            }
            // Project the corners onto the grid of samples.
            let lined = lined(index);
            let screen = corners.map(|corner| {
                let scale = self.focal / -corner.z;
                (corner.x * scale + 0.5 * self.columns as f64, 0.5 * self.rows as f64 - corner.y * scale)
            });
            let twice_area = (screen[1].0 - screen[0].0) * (screen[2].1 - screen[0].1)
                - (screen[2].0 - screen[0].0) * (screen[1].1 - screen[0].1);
            if twice_area == 0.0 || !twice_area.is_finite() {
                continue;
            }
            let bounds = |values: [f64; 3], limit: usize| {
                let low = values.iter().copied().fold(f64::INFINITY, f64::min);
                let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                // Casts saturate, so a triangle outside of the picture has an empty range.
                ((low - 0.5).ceil().max(0.0) as usize, ((high + 0.5).floor().max(0.0) as usize).min(limit))
            };
            let (left, stop_x) = bounds(screen.map(|point| point.0), self.columns);
            let (top, stop_y) = bounds(screen.map(|point| point.1), self.rows);
            // Heights of the triangle over its sides, in samples: barycentric weight times height is the
            // distance from the side.
            let heights = [0, 1, 2].map(|k| {
                let (a, b) = (screen[(k + 1) % 3], screen[(k + 2) % 3]);
                twice_area.abs() / (a.0 - b.0).hypot(a.1 - b.1)
            });
            for y in top..stop_y {
                for x in left..stop_x {
                    let (px, py) = (x as f64 + 0.5, y as f64 + 0.5);
                    let weight = |a: (f64, f64), b: (f64, f64)| {
                        ((a.0 - px) * (b.1 - py) - (b.0 - px) * (a.1 - py)) / twice_area
                    };
                    let weights = [
                        weight(screen[1], screen[2]),
                        weight(screen[2], screen[0]),
                        weight(screen[0], screen[1]),
                    ];
                    if weights.iter().any(|weight| *weight < 0.0) {
                        continue;
                    }
                    // Perspective correction: weights are linear in the picture; divided by depth they are
                    // linear on the triangle.
                    let inverse = [0, 1, 2].map(|k| weights[k] / -corners[k].z);
                    let depth = (1.0 / inverse.iter().sum::<f64>()) as f32;
                    let sample = &mut self.samples[y * self.columns + x];
                    if depth < sample.depth {
                        let normal = (0..3).map(|k| inverse[k] as f32 * corner_normals[k]).sum::<Vec3>();
                        let line = (0..3).any(|k| lined[k] && weights[k] * heights[k] < line_reach);
                        let triangle = self.first + index as u32;
                        *sample = Sample { depth, normal: normal.normalize_or_zero(), triangle, line };
                    }
                }
            }
        }
    }

    /// Shades the picture: each pixel is the mean of its samples, over a light background.
    fn picture(&self, faces: &[SeenFace]) -> Picture {
        let (width, height) = (self.columns / SAMPLES, self.rows / SAMPLES);
        let mut picture = Picture::filled(width as u32, height as u32, [0; 3]);
        // Rows are independent, so the picture does not depend on the number of threads.
        picture.pixels_mut().par_chunks_exact_mut(width).enumerate().for_each(|(y, row)| {
            let down = y as f32 / height as f32;
            let paper = Vec3::new(0.80, 0.82, 0.85) * (1.0 - 0.35 * down * down);
            for (x, pixel) in row.iter_mut().enumerate() {
                let mut sum = Vec3::ZERO;
                for sample in 0..SAMPLES * SAMPLES {
                    let column = x * SAMPLES + sample % SAMPLES;
                    let row = y * SAMPLES + sample / SAMPLES;
                    sum += self.shade(column, row, faces).unwrap_or(paper).min(Vec3::ONE);
                }
                let mean = sum / (SAMPLES * SAMPLES) as f32;
                *pixel = encode(mean);
            }
        });
        picture
    }

    /// Returns the linear colour of a sample; `None` for the background.
    fn shade(&self, column: usize, row: usize, faces: &[SeenFace]) -> Option<Vec3> {
        let sample = &self.samples[row * self.columns + column];
        if !sample.depth.is_finite() {
            return None;
        }
        let key = Vec3::new(-0.45, 0.65, 0.62).normalize();
        let fill = Vec3::new(0.75, 0.10, 0.65).normalize();
        let seen = self.position(column, row, sample.depth);
        let towards_eye = (-seen).normalize();
        let mut normal = sample.normal;
        let face = faces[sample.triangle as usize];
        let mut color = face.outside;
        if normal.dot(towards_eye) < -0.15 {
            normal = -normal;
            color = face.inside;
        }
        let openness = self.openness(column, row, seen, normal);
        let ambient = 0.24 + 0.14 * normal.y;
        let diffuse = 0.72 * normal.dot(key).max(0.0) + 0.24 * normal.dot(fill).max(0.0);
        let gloss = 0.22 * normal.dot((key + towards_eye).normalize()).max(0.0).powi(40);
        let shown = color * (ambient * openness + diffuse * (0.4 + 0.6 * openness)) + gloss * openness;
        Some(if sample.line { LINE_DIMMED * shown } else { shown })
    }

    /// Returns the position of the surface at a sample, in camera axes.
    fn position(&self, column: usize, row: usize, depth: f32) -> Vec3 {
        let scale = depth / self.focal as f32;
        Vec3::new(
            (column as f32 + 0.5 - 0.5 * self.columns as f32) * scale,
            (0.5 * self.rows as f32 - row as f32 - 0.5) * scale,
            -depth,
        )
    }

    /// Returns the part of the sky over a surface point that is not occluded nearby, 0 to 1, from the depths
    /// around its sample (screen-space ambient occlusion).
    fn openness(&self, column: usize, row: usize, seen: Vec3, normal: Vec3) -> f32 {
        const DIRECTIONS: usize = 12;
        const RADIUS: f32 = 0.10;
        let extent = RADIUS * self.focal as f32 / -seen.z;
        // Rotating the directions from sample to sample turns banding into noise, which averaging removes.
        let turn = ((column * 7 + row * 13) % 9) as f32 / 9.0;
        let mut hidden = 0.0;
        for direction in 0..DIRECTIONS {
            let angle = (direction as f32 + turn) / DIRECTIONS as f32 * std::f32::consts::TAU;
            let far =
                extent * (0.25 + 0.75 * ((direction * 5 % DIRECTIONS) as f32 + turn) / DIRECTIONS as f32);
            let x = column as f32 + far * angle.cos();
            let y = row as f32 + far * angle.sin();
            if x < 0.0 || y < 0.0 || x >= self.columns as f32 || y >= self.rows as f32 {
                continue;
            }
            let (x, y) = (x as usize, y as usize);
            let depth = self.samples[y * self.columns + x].depth;
            if depth.is_finite() {
                let offset = self.position(x, y, depth) - seen;
                let length = offset.length().max(1e-9);
                let rise = (normal.dot(offset) / length - 0.12).max(0.0);
                hidden += rise / (1.0 + (length / RADIUS).powi(2));
            }
        }
        (1.0 - 1.9 * hidden / DIRECTIONS as f32).clamp(0.15, 1.0)
    }
}

/// Returns the unit normals at the corners of each triangle.
fn corner_normals(triangles: &[[u32; 3]], seen: &[DVec3], shading: Shading) -> Vec<[Vec3; 3]> {
    let weighted: Vec<Vec3> = triangles
        .iter()
        .map(|triangle| {
            let [a, b, c] = triangle.map(|vertex| seen[vertex as usize]);
            let cross = (b - a).cross(c - a);
            // Scaled up before the cast, because squared areas of fine meshes underflow in f32.
            (cross * 1e6).as_vec3()
        })
        .collect();
    let faces: Vec<Vec3> = weighted.iter().map(|normal| normal.normalize_or_zero()).collect();
    if shading != Shading::Smooth {
        return faces.iter().map(|face| [*face; 3]).collect();
    }
    // Triangles around each vertex, as a counting sort: `first` has the offset of each vertex in `around`.
    let mut first = vec![0_usize; seen.len() + 1];
    for vertex in triangles.iter().flatten() {
        first[*vertex as usize + 1] += 1;
    }
    for vertex in 0..seen.len() {
        first[vertex + 1] += first[vertex];
    }
    let mut next = first.clone();
    let mut around = vec![0_usize; 3 * triangles.len()];
    for (index, triangle) in triangles.iter().enumerate() {
        for vertex in triangle {
            around[next[*vertex as usize]] = index;
            next[*vertex as usize] += 1;
        }
    }
    let corner = |index: usize, vertex: u32| {
        let face = faces[index];
        let sum: Vec3 = around[first[vertex as usize]..first[vertex as usize + 1]]
            .iter()
            .filter(|other| faces[**other].dot(face) > CREASE_COSINE)
            .map(|other| weighted[*other])
            .sum();
        let smooth = sum.normalize_or_zero();
        if smooth == Vec3::ZERO { face } else { smooth }
    };
    triangles
        .iter()
        .enumerate()
        .map(|(index, triangle)| triangle.map(|vertex| corner(index, vertex)))
        .collect()
}

/// Converts linear RGB to sRGB.
fn encode(linear: Vec3) -> [u8; 3] {
    linear.to_array().map(|value| {
        let encoded =
            if value <= 0.003_130_8 { 12.92 * value } else { 1.055 * value.powf(1.0 / 2.4) - 0.055 };
        (255.0 * encoded + 0.5) as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (u32, u32) = (320, 240);
    const RED: [f32; 3] = [0.8, 0.1, 0.1];
    const GREEN: [f32; 3] = [0.1, 0.8, 0.1];

    /// A square in the plane x = `x` with a given half side, facing along x.
    fn square(x: f64, half: f64) -> TriMesh {
        let corners = [(-half, -half), (half, -half), (half, half), (-half, half)];
        let vertices = corners.map(|(y, z)| DVec3::new(x, y, z)).to_vec();
        TriMesh::new(vertices, vec![[0, 1, 2], [0, 2, 3]]).unwrap()
    }

    fn render(items: &[Item<'_>], azimuth: f64) -> Picture {
        let points = items.iter().flat_map(|item| item.mesh.vertices());
        let view = View::from_degrees(azimuth, 0.0);
        Camera::fit(points, &view, SIZE.0, SIZE.1).render(items, Shading::Smooth)
    }

    fn middle(items: &[Item<'_>], azimuth: f64) -> [u8; 3] {
        render(items, azimuth).pixel(SIZE.0 / 2, SIZE.1 / 2)
    }

    #[test]
    fn nearer_surface_hides_the_farther_in_either_order() {
        let (near, far) = (square(0.5, 0.3), square(-0.5, 1.0));
        let (near, far) = (Item::new(&near, RED), Item::new(&far, GREEN));
        for items in [[near, far], [far, near]] {
            let [r, g, _] = middle(&items, 0.0);
            assert!(r > 2 * g, "red in front, but the middle is ({r}, {g}, _)");
        }
    }

    #[test]
    fn square_covers_its_share_of_the_picture() {
        let mesh = square(0.0, 1.0);
        let picture = render(&[Item::new(&mesh, GREEN)], 0.0);
        let covered = picture.pixels().iter().filter(|pixel| pixel[1] / 3 > pixel[0] / 2).count();
        let expected = (f64::from(SIZE.1) / MARGIN).powi(2);
        assert!((covered as f64 / expected - 1.0).abs() < 0.01, "{covered} pixels, not {expected}");
    }

    #[test]
    fn surface_seen_from_inside_stands_out() {
        let mesh = square(0.0, 1.0);
        let [r, g, _] = middle(&[Item::new(&mesh, GREEN)], 180.0);
        assert!(r > 2 * g, "({r}, {g}, _)");
    }

    #[test]
    fn nothing_to_draw_gives_the_background() {
        let mesh = TriMesh::default();
        let picture = render(&[Item::new(&mesh, RED)], 0.0);
        assert_eq!((picture.width(), picture.height()), SIZE);
    }

    #[test]
    fn lines_run_along_marked_edges_only() {
        let mesh = square(0.0, 1.0);
        let camera = Camera::fit(mesh.vertices(), &View::from_degrees(0.0, 0.0), SIZE.0, SIZE.1);
        // Number of dark pixels if the two triangles have lines along the given edges.
        let dark = |lined: [[bool; 3]; 2], line_width: f64| {
            let faces = lined.map(|lined| Face { color: GREEN, lined });
            let item = Item::painted(&mesh, Paint::Faces(&faces));
            let picture = camera.render(&[item], Shading::Flat { line_width });
            picture.pixels().iter().filter(|pixel| pixel[1] < 160).count() as f64
        };
        let none = [false; 3];
        assert_eq!(dark([none, none], 4.0), 0.0);
        assert_eq!(dark([[true; 3]; 2], 0.0), 0.0);
        let side = f64::from(SIZE.1) / MARGIN;
        // The first triangle's edge opposite its first corner is a side of the square, the one opposite its
        // second corner the diagonal; half of a line's width lies in each of its triangles.
        let straight = dark([[true, false, false], none], 10.0);
        assert!((straight / (5.0 * side) - 1.0).abs() < 0.05, "{straight} pixels");
        let diagonal = dark([[false, true, false], [false, false, true]], 10.0);
        // The diagonal's ends are clipped to the square's corners, by a triangle as high as half the line's
        // width.
        let covered = 10.0 * (2.0_f64.sqrt() * side - 5.0);
        assert!((diagonal / covered - 1.0).abs() < 0.08, "{diagonal} pixels, not {covered}");
    }

    #[test]
    fn unit_of_length_has_no_influence() {
        let pictures = [1.0, 1e-6, 1e6].map(|scale| {
            let mesh = square(0.3 * scale, scale);
            render(&[Item::new(&mesh, GREEN)], 30.0)
        });
        let differing = |other: &Picture| {
            pictures[0]
                .pixels()
                .iter()
                .zip(other.pixels())
                .filter(|(a, b)| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > 2))
                .count()
        };
        // Rounding may move a sample across the square's rim.
        assert!(pictures[1..].iter().all(|other| differing(other) < 20));
    }

    #[test]
    fn painted_face_seen_from_inside_keeps_its_hue() {
        let mesh = square(0.0, 1.0);
        let faces = [Face { color: GREEN, lined: [false; 3] }; 2];
        let [r, g, _] = middle(&[Item::painted(&mesh, Paint::Faces(&faces))], 180.0);
        assert!(g > 2 * r, "({r}, {g}, _)");
    }
}
