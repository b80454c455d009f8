//! A small software renderer: triangles with a depth buffer in perspective, two lights and ambient occlusion, nine
//! samples a pixel.
//!
//! Rasterisation leaves depth, normal and item of each sample; shading is a second pass over the samples, so that
//! its cost does not depend on the number of triangles.

use glam::{DMat3, DQuat, DVec3, Vec3};
use image::{Rgb, RgbImage};
use palpate_core::TriMesh;

const WIDTH: usize = 640;
const HEIGHT: usize = 480;
/// Samples a pixel, along each side.
const SAMPLES: usize = 3;
const COLUMNS: usize = WIDTH * SAMPLES;
const ROWS: usize = HEIGHT * SAMPLES;
/// Vertical field of view, rad.
const FIELD_OF_VIEW: f64 = 0.42;
/// Faces that meet at less than this angle are shaded as one smooth surface: its cosine (35°).
const CREASE_COSINE: f32 = 0.82;
/// Colour of a surface seen from inside: it shows where a mesh is not oriented outwards.
const INSIDE: Vec3 = Vec3::new(0.9, 0.05, 0.2);

/// A mesh in the scene.
#[derive(Clone, Copy)]
pub struct Item<'a> {
    pub mesh: &'a TriMesh,
    /// Linear RGB, 0 to 1.
    pub color: [f32; 3],
    pub rotation: DQuat,
    /// m
    pub translation: DVec3,
}

impl<'a> Item<'a> {
    /// A mesh in its own frame.
    pub const fn new(mesh: &'a TriMesh, color: [f32; 3]) -> Self {
        Self { mesh, color, rotation: DQuat::IDENTITY, translation: DVec3::ZERO }
    }
}

/// How surfaces are drawn.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Shading {
    /// Smooth, with creases.
    Smooth,
    /// Flat triangles with dark edges.
    Edges,
}

/// From where the scene is seen. It is centred and fitted into the picture.
#[derive(Clone, Copy)]
pub struct View {
    /// Direction of the camera about z, from x towards y, rad.
    pub azimuth: f64,
    /// Angle of the camera above the horizon, rad.
    pub elevation: f64,
    /// Turn of the picture, clockwise, rad.
    pub roll: f64,
    /// Magnification over the fitted scene.
    pub zoom: f64,
    pub shading: Shading,
}

impl View {
    /// A smoothly shaded view from a direction in degrees.
    pub fn from_degrees(azimuth: f64, elevation: f64) -> Self {
        Self {
            azimuth: azimuth.to_radians(),
            elevation: elevation.to_radians(),
            roll: 0.0,
            zoom: 1.0,
            shading: Shading::Smooth,
        }
    }
}

/// What the rasteriser leaves at a sample.
#[derive(Clone, Copy)]
struct Sample {
    /// Distance along the view direction; infinite for the background.
    depth: f32,
    normal: Vec3,
    item: u32,
    edge: bool,
}

struct Frame {
    samples: Vec<Sample>,
    /// Samples per unit of (lateral position / depth).
    focal: f64,
}

/// Draws the items as one scene.
pub fn render(items: &[Item<'_>], view: &View) -> RgbImage {
    // Camera axes: x right, y up, z towards the viewer.
    let (sin_azimuth, cos_azimuth) = view.azimuth.sin_cos();
    let (sin_elevation, cos_elevation) = view.elevation.sin_cos();
    let backward = DVec3::new(cos_elevation * cos_azimuth, cos_elevation * sin_azimuth, sin_elevation);
    let right = DVec3::new(-sin_azimuth, cos_azimuth, 0.0);
    let upright = DMat3::from_cols(right, backward.cross(right), backward).transpose();
    let to_camera = DMat3::from_rotation_z(-view.roll) * upright;

    let placed: Vec<Vec<DVec3>> = items
        .iter()
        .map(|item| {
            let place = |vertex: &DVec3| to_camera * (item.rotation * *vertex + item.translation);
            item.mesh.vertices().iter().map(place).collect()
        })
        .collect();
    let mut lowest = DVec3::INFINITY;
    let mut highest = DVec3::NEG_INFINITY;
    for position in placed.iter().flatten() {
        lowest = lowest.min(*position);
        highest = highest.max(*position);
    }
    if !(lowest.is_finite() && highest.is_finite()) {
        return background(&[]);
    }
    let center = 0.5 * (lowest + highest);
    let half = 0.5 * (highest - lowest);
    let slope = (0.5 * FIELD_OF_VIEW).tan();
    let aspect = WIDTH as f64 / HEIGHT as f64;
    let reach = 1.08 * half.y.max(half.x / aspect).max(1e-9);
    let distance = half.z + reach / slope;
    let eye = center + DVec3::new(0.0, 0.0, distance);

    let empty = Sample { depth: f32::INFINITY, normal: Vec3::Z, item: 0, edge: false };
    let mut frame =
        Frame { samples: vec![empty; COLUMNS * ROWS], focal: 0.5 * ROWS as f64 / slope * view.zoom };
    for (index, (item, positions)) in (0..).zip(items.iter().zip(&placed)) {
        let seen: Vec<DVec3> = positions.iter().map(|position| *position - eye).collect();
        frame.draw(item.mesh.triangles(), &seen, index, view.shading);
    }
    let colors: Vec<Vec3> = items.iter().map(|item| Vec3::from(item.color)).collect();
    let light = frame.shade(&colors, reach as f32);
    background(&light)
}

impl Frame {
    fn draw(&mut self, triangles: &[[u32; 3]], seen: &[DVec3], item: u32, shading: Shading) {
        let normals = corner_normals(triangles, seen, shading);
        for (triangle, corner_normals) in triangles.iter().zip(&normals) {
            let corners = triangle.map(|vertex| seen[vertex as usize]);
            let nearest = -1e-6;
            if corners.iter().any(|corner| corner.z > nearest) {
                continue;
            }
            let screen = corners.map(|corner| {
                let scale = self.focal / -corner.z;
                (corner.x * scale + 0.5 * COLUMNS as f64, 0.5 * ROWS as f64 - corner.y * scale)
            });
            let twice_area = (screen[1].0 - screen[0].0) * (screen[2].1 - screen[0].1)
                - (screen[2].0 - screen[0].0) * (screen[1].1 - screen[0].1);
            if twice_area == 0.0 || !twice_area.is_finite() {
                continue;
            }
            let bounds = |values: [f64; 3], limit: usize| {
                let low = values.iter().copied().fold(f64::INFINITY, f64::min);
                let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                // Casts saturate, so what lies off the picture gives an empty range.
                ((low - 0.5).ceil().max(0.0) as usize, ((high + 0.5).floor().max(0.0) as usize).min(limit))
            };
            let (left, stop_x) = bounds(screen.map(|point| point.0), COLUMNS);
            let (top, stop_y) = bounds(screen.map(|point| point.1), ROWS);
            // Heights of the triangle over its sides, in samples: they turn barycentric into distance from an edge.
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
                    // Weights are linear on the picture; divided by depth they are linear on the triangle.
                    let inverse = [0, 1, 2].map(|k| weights[k] / -corners[k].z);
                    let depth = (1.0 / inverse.iter().sum::<f64>()) as f32;
                    let sample = &mut self.samples[y * COLUMNS + x];
                    if depth < sample.depth {
                        let normal = (0..3).map(|k| inverse[k] as f32 * corner_normals[k]).sum::<Vec3>();
                        let edge = shading == Shading::Edges
                            && (0..3).any(|k| weights[k] * heights[k] < 0.5 * SAMPLES as f64);
                        *sample = Sample { depth, normal: normal.normalize_or_zero(), item, edge };
                    }
                }
            }
        }
    }

    /// Colour of each sample in linear light; the background stays transparent (negative).
    fn shade(&self, colors: &[Vec3], reach: f32) -> Vec<Vec3> {
        let key = Vec3::new(-0.45, 0.65, 0.62).normalize();
        let fill = Vec3::new(0.75, 0.10, 0.65).normalize();
        let mut light = vec![Vec3::splat(-1.0); self.samples.len()];
        for row in 0..ROWS {
            for column in 0..COLUMNS {
                let sample = &self.samples[row * COLUMNS + column];
                if !sample.depth.is_finite() {
                    continue;
                }
                let seen = self.position(column, row, sample.depth);
                let towards_eye = (-seen).normalize();
                let mut normal = sample.normal;
                let mut color = colors[sample.item as usize];
                if normal.dot(towards_eye) < -0.15 {
                    normal = -normal;
                    color = INSIDE;
                }
                let openness = self.openness(column, row, seen, normal, reach);
                let ambient = 0.24 + 0.14 * normal.y;
                let diffuse = 0.72 * normal.dot(key).max(0.0) + 0.24 * normal.dot(fill).max(0.0);
                let gloss = 0.22 * normal.dot((key + towards_eye).normalize()).max(0.0).powi(40);
                let mut shown =
                    color * (ambient * openness + diffuse * (0.4 + 0.6 * openness)) + gloss * openness;
                if sample.edge {
                    shown *= 0.25;
                }
                light[row * COLUMNS + column] = shown;
            }
        }
        light
    }

    /// Position in camera axes of what is seen at a sample.
    fn position(&self, column: usize, row: usize, depth: f32) -> Vec3 {
        let scale = depth / self.focal as f32;
        Vec3::new(
            (column as f32 + 0.5 - 0.5 * COLUMNS as f32) * scale,
            (0.5 * ROWS as f32 - row as f32 - 0.5) * scale,
            -depth,
        )
    }

    /// The part of the sky over a surface point that nothing nearby hides, 0 to 1, from the depths around its sample.
    fn openness(&self, column: usize, row: usize, seen: Vec3, normal: Vec3, reach: f32) -> f32 {
        const DIRECTIONS: usize = 12;
        let radius = 0.10 * reach;
        let extent = radius * self.focal as f32 / -seen.z;
        // Turning the star of directions from sample to sample trades banding for noise, which averaging removes.
        let turn = ((column * 7 + row * 13) % 9) as f32 / 9.0;
        let mut hidden = 0.0;
        for direction in 0..DIRECTIONS {
            let angle = (direction as f32 + turn) / DIRECTIONS as f32 * std::f32::consts::TAU;
            let far =
                extent * (0.25 + 0.75 * ((direction * 5 % DIRECTIONS) as f32 + turn) / DIRECTIONS as f32);
            let x = column as f32 + far * angle.cos();
            let y = row as f32 + far * angle.sin();
            if x < 0.0 || y < 0.0 || x >= COLUMNS as f32 || y >= ROWS as f32 {
                continue;
            }
            let (x, y) = (x as usize, y as usize);
            let depth = self.samples[y * COLUMNS + x].depth;
            if depth.is_finite() {
                let offset = self.position(x, y, depth) - seen;
                let length = offset.length().max(1e-9);
                let rise = (normal.dot(offset) / length - 0.12).max(0.0);
                hidden += rise / (1.0 + (length / radius).powi(2));
            }
        }
        (1.0 - 1.9 * hidden / DIRECTIONS as f32).clamp(0.15, 1.0)
    }
}

/// Unit normals at the corners of each triangle.
fn corner_normals(triangles: &[[u32; 3]], seen: &[DVec3], shading: Shading) -> Vec<[Vec3; 3]> {
    let weighted: Vec<Vec3> = triangles
        .iter()
        .map(|triangle| {
            let [a, b, c] = triangle.map(|vertex| seen[vertex as usize]);
            let cross = (b - a).cross(c - a);
            // Scaled up before the cast: areas of fine meshes in m² underflow when they are squared in f32.
            (cross * 1e6).as_vec3()
        })
        .collect();
    let faces: Vec<Vec3> = weighted.iter().map(|normal| normal.normalize_or_zero()).collect();
    if shading == Shading::Edges {
        return faces.iter().map(|face| [*face; 3]).collect();
    }
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

/// Averages the samples of each pixel over a light background and encodes them as sRGB.
fn background(light: &[Vec3]) -> RgbImage {
    RgbImage::from_fn(WIDTH as u32, HEIGHT as u32, |x, y| {
        let height = y as f32 / HEIGHT as f32;
        let paper = Vec3::new(0.80, 0.82, 0.85) * (1.0 - 0.35 * height * height);
        let mut sum = Vec3::ZERO;
        for sample in 0..SAMPLES * SAMPLES {
            let column = x as usize * SAMPLES + sample % SAMPLES;
            let row = y as usize * SAMPLES + sample / SAMPLES;
            let shown = light.get(row * COLUMNS + column).copied().filter(|shown| shown.x >= 0.0);
            sum += shown.unwrap_or(paper).min(Vec3::ONE);
        }
        let mean = sum / (SAMPLES * SAMPLES) as f32;
        Rgb(mean.to_array().map(|value| {
            let encoded =
                if value <= 0.003_130_8 { 12.92 * value } else { 1.055 * value.powf(1.0 / 2.4) - 0.055 };
            (255.0 * encoded + 0.5) as u8
        }))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const RED: [f32; 3] = [0.8, 0.1, 0.1];
    const GREEN: [f32; 3] = [0.1, 0.8, 0.1];

    /// A square in the plane x = `x` with a given half side, facing along x.
    fn square(x: f64, half: f64) -> TriMesh {
        let corners = [(-half, -half), (half, -half), (half, half), (-half, half)];
        let vertices = corners.map(|(y, z)| DVec3::new(x, y, z)).to_vec();
        TriMesh::new(vertices, vec![[0, 1, 2], [0, 2, 3]]).unwrap()
    }

    fn middle(items: &[Item<'_>], azimuth: f64) -> [u8; 3] {
        render(items, &View::from_degrees(azimuth, 0.0)).get_pixel(320, 240).0
    }

    #[test]
    fn the_nearer_surface_hides_the_further_in_either_order() {
        let (near, far) = (square(0.5, 0.3), square(-0.5, 1.0));
        let (near, far) = (Item::new(&near, RED), Item::new(&far, GREEN));
        for items in [[near, far], [far, near]] {
            let [r, g, _] = middle(&items, 0.0);
            assert!(r > 2 * g, "red in front, but the middle is ({r}, {g}, _)");
        }
    }

    #[test]
    fn a_square_covers_its_share_of_the_picture() {
        let mesh = square(0.0, 1.0);
        let picture = render(&[Item::new(&mesh, GREEN)], &View::from_degrees(0.0, 0.0));
        let covered = picture.pixels().filter(|pixel| pixel.0[1] / 3 > pixel.0[0] / 2).count();
        // Fitted to the height with a margin of 8 %.
        let expected = (HEIGHT as f64 / 1.08).powi(2);
        assert!((covered as f64 / expected - 1.0).abs() < 0.01, "{covered} pixels, not {expected}");
    }

    #[test]
    fn a_surface_seen_from_inside_stands_out() {
        let mesh = square(0.0, 1.0);
        let [r, g, _] = middle(&[Item::new(&mesh, GREEN)], 180.0);
        assert!(r > 2 * g, "({r}, {g}, _)");
    }

    #[test]
    fn nothing_to_draw_gives_the_background() {
        let mesh = TriMesh::default();
        let picture = render(&[Item::new(&mesh, RED)], &View::from_degrees(0.0, 0.0));
        assert_eq!((picture.width(), picture.height()), (640, 480));
    }
}
