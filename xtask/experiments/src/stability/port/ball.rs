//! A ball that is pressed on a table.

use std::f64::consts::{PI, TAU};

use palpate::glam::DVec3;
use palpate::{Object, Pose, Scene, TriMesh};

use super::super::meshes;

/// Radius of the held ball, with its rings and the corners of each; half extents of the table, m. It is no
/// block, since flat faces of a few large triangles that meet are not held apart: a block of twelve sinks in.
const RADIUS: f64 = 0.01;
const RINGS: usize = 24;
const CORNERS: usize = 48;
const TABLE: DVec3 = DVec3::new(0.06, 0.06, 0.02);

/// A ball with a vertex at its lowest point, about the origin.
fn ball() -> Result<Object, String> {
    let mut vertices = vec![DVec3::NEG_Z * RADIUS];
    for ring in 1..RINGS {
        let (sine, cosine) = (PI * ring as f64 / RINGS as f64).sin_cos();
        let corners = (0..CORNERS).map(|corner| (TAU * corner as f64 / CORNERS as f64).sin_cos());
        vertices.extend(corners.map(|(y, x)| DVec3::new(x * sine, y * sine, -cosine) * RADIUS));
    }
    vertices.push(DVec3::Z * RADIUS);
    let last = vertices.len() as u32 - 1;
    let at = |ring: usize, corner: usize| (1 + (ring - 1) * CORNERS + corner % CORNERS) as u32;
    let mut triangles = Vec::new();
    for corner in 0..CORNERS {
        triangles.push([0, at(1, corner + 1), at(1, corner)]);
        triangles.push([last, at(RINGS - 1, corner), at(RINGS - 1, corner + 1)]);
        for ring in 1..RINGS - 1 {
            let [a, b] = [at(ring, corner), at(ring, corner + 1)];
            let [c, d] = [at(ring + 1, corner + 1), at(ring + 1, corner)];
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    let mesh = TriMesh::new(vertices, triangles).map_err(|error| error.to_string())?;
    Object::from_mesh("ball", &mesh).map_err(|error| error.to_string())
}

/// A ball and the table that it is pressed on.
pub struct BallOnTable {
    pub ball: Object,
    pub scene: Scene,
}

impl BallOnTable {
    /// # Errors
    /// If a mesh is refused.
    pub fn new() -> Result<Self, String> {
        let table = meshes::block("table", TABLE)?;
        let scene = Scene::new().with(table, Pose::from_translation(DVec3::NEG_Z * TABLE.z));
        Ok(Self { ball: ball()?, scene })
    }

    /// Pose of the ball a distance above the table, m.
    pub fn above(height: f64) -> Pose {
        Pose::from_translation(DVec3::Z * (RADIUS + height))
    }
}
