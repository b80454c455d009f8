//! Generated meshes: blocks, pegs and holes.

use std::f64::consts::TAU;

use palpate::glam::{DVec2, DVec3};
use palpate::{Object, TriMesh};

/// Number of corners of the polygons that approximate circles.
const CORNERS: usize = 48;

/// Returns a block about the origin with given half extents, m.
///
/// # Errors
/// If it cannot be an object.
pub fn block(name: &str, half: DVec3) -> Result<Object, String> {
    let corner = |index: usize| {
        let side = |bit: usize| if index >> bit & 1 == 1 { 1.0 } else { -1.0 };
        DVec3::new(side(0), side(1), side(2)) * half
    };
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    object(name, (0..8).map(corner).collect(), quads.into_iter().flat_map(halves).collect())
}

/// Returns a round peg along z that stands on its tip at the origin.
///
/// # Errors
/// If it cannot be an object.
pub fn peg(radius: f64, length: f64) -> Result<Object, String> {
    let mut vertices: Vec<DVec3> = circle(radius, 0.0).chain(circle(radius, length)).collect();
    let (low, high) = (vertices.len() as u32, vertices.len() as u32 + 1);
    vertices.extend([DVec3::ZERO, DVec3::Z * length]);
    let mut triangles = band(0, CORNERS as u32);
    for (a, b) in ring() {
        triangles.push([low, b, a]);
        triangles.push([high, a + CORNERS as u32, b + CORNERS as u32]);
    }
    object("peg", vertices, triangles)
}

/// Returns a ring about the z axis with its mouth at z = 0, which reaches down by `depth`. The radius of its
/// bore is at least `radius`: the circle touches the middles of the polygon's sides.
///
/// # Errors
/// If it cannot be an object.
pub fn hole(radius: f64, outer: f64, depth: f64) -> Result<Object, String> {
    let bore = radius / (0.5 * TAU / CORNERS as f64).cos();
    let circles = [(outer, -depth), (outer, 0.0), (bore, 0.0), (bore, -depth)];
    let vertices = circles.into_iter().flat_map(|(radius, height)| circle(radius, height)).collect();
    let count = CORNERS as u32;
    let triangles = (0..4).flat_map(|from| band(from * count, (from + 1) % 4 * count)).collect();
    object("hole", vertices, triangles)
}

fn object(name: &str, vertices: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> Result<Object, String> {
    let mesh = TriMesh::new(vertices, triangles).map_err(|error| error.to_string())?;
    Object::from_mesh(name, &mesh).map_err(|error| error.to_string())
}

fn circle(radius: f64, height: f64) -> impl Iterator<Item = DVec3> {
    (0..CORNERS)
        .map(move |corner| (DVec2::from_angle(TAU * corner as f64 / CORNERS as f64) * radius).extend(height))
}

/// Returns pairs of neighbours around a circle.
fn ring() -> impl Iterator<Item = (u32, u32)> {
    let count = CORNERS as u32;
    (0..count).map(move |corner| (corner, (corner + 1) % count))
}

/// Returns triangles between two circles, whose vertices start at `low` and `high`.
fn band(low: u32, high: u32) -> Vec<[u32; 3]> {
    ring().flat_map(|(a, b)| halves([low + a, low + b, high + b, high + a])).collect()
}

fn halves([a, b, c, d]: [u32; 4]) -> [[u32; 3]; 2] {
    [[a, b, c], [a, c, d]]
}
