//! The golf club of Table 3.2: a seven iron with a hollowed back, a scored face, a hosel and the lower end of
//! the shaft.
//!
//! Real size, to suit the ball. The frame: z up, the shot goes along +x, the toe points along −y (a
//! right-hander's club), the origin is the middle of the face. The blade is an outline in the plane of the
//! face, thicker towards the sole; the hosel rises from its heel at the lie angle.

use palpate_core::{
    TriMesh,
    glam::{DVec2, DVec3},
};

use crate::surface::{Surface, smooth_max, smooth_min, smooth_step, triangulate};

pub(crate) const MIN_TRIANGLES: usize = 4_000;

/// Backward slope of the face, degrees.
const LOFT: f64 = 33.0;
/// Slope of the shaft against the ground, degrees.
const LIE: f64 = 62.5;
/// Length of hosel and shaft from the heel, mm.
const LENGTH: f64 = 175.0;
/// Score lines on the face: their number, distance, half width and depth, mm.
const LINES: i32 = 12;
const SPACING: f64 = 3.0;
const HALF_LINE: f64 = 0.75;
const LINE_DEPTH: f64 = 0.55;
/// The blade's outline in the face's plane (toe right, up along the face), mm, before it is rounded by
/// [`CORNER`].
const OUTLINE: [DVec2; 9] = [
    DVec2::new(-31.0, -15.0),
    DVec2::new(-10.0, -17.5),
    DVec2::new(12.0, -17.5),
    DVec2::new(27.0, -14.0),
    DVec2::new(33.0, -4.0),
    DVec2::new(34.0, 12.0),
    DVec2::new(30.0, 23.0),
    DVec2::new(22.0, 24.0),
    DVec2::new(-32.0, -1.0),
];
const CORNER: f64 = 5.0;

/// The golf club, m.
pub(crate) fn build(triangles: usize) -> TriMesh {
    triangulate(&Club { outline: cut_corners(cut_corners(OUTLINE.to_vec())) }, triangles, 1e-3)
}

struct Club {
    /// [`OUTLINE`] with its corners cut twice.
    outline: Vec<DVec2>,
}

/// Chaikin's step towards a smooth closed curve.
fn cut_corners(polygon: Vec<DVec2>) -> Vec<DVec2> {
    let next = polygon.iter().cycle().skip(1);
    polygon.iter().zip(next).flat_map(|(a, b)| [a.lerp(*b, 0.25), a.lerp(*b, 0.75)]).collect()
}

/// Signed distance to a counter-clockwise polygon.
fn polygon_distance(polygon: &[DVec2], p: DVec2) -> f64 {
    let mut nearest = f64::INFINITY;
    let mut inside = false;
    for (i, &a) in polygon.iter().enumerate() {
        let b = polygon[(i + 1) % polygon.len()];
        let t = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
        nearest = nearest.min(p.distance_squared(a.lerp(b, t)));
        if (a.y > p.y) != (b.y > p.y) && p.x < a.x + (p.y - a.y) * (b.x - a.x) / (b.y - a.y) {
            inside = !inside;
        }
    }
    if inside { -nearest.sqrt() } else { nearest.sqrt() }
}

/// Into the face's axes: x towards the toe, y up along the face, z out of it (left-handed: a mirror image).
fn to_face(p: DVec3) -> DVec3 {
    let (sin, cos) = LOFT.to_radians().sin_cos();
    DVec3::new(-p.y, cos * p.z - sin * p.x, sin * p.z + cos * p.x)
}

/// The blade, from a point in the face's axes and its distance from the outline.
fn blade(q: DVec3, outline: f64) -> f64 {
    let rim = outline - CORNER;
    // From the top line down to the sole the blade gets thicker.
    let depth = 4.5 + 13.0 * smooth_step(20.0, -24.0, q.y);
    let tilt = 0.94;
    let face = q.z + scores(q, outline);
    let solid = smooth_max(smooth_max(rim, face, 1.6), tilt * (-q.z - depth), 3.0);
    // The hollow leaves a rim and a plate behind the face.
    let hollow = smooth_max(rim + 6.0, tilt * (q.z + 3.4 + 1.6 * smooth_step(8.0, -16.0, q.y)), 3.0);
    smooth_max(solid, -hollow, 2.0)
}

/// Depth of the score lines at a point of the face.
fn scores(q: DVec3, outline: f64) -> f64 {
    let row = ((q.y + 15.0) / SPACING).round().clamp(0.0, f64::from(LINES - 1));
    let across = (q.y + 15.0 - row * SPACING).abs();
    // They end along the outline, at the heel on a line.
    let ends = smooth_step(-1.0, -2.5, outline) * smooth_step(-23.0, -21.5, q.x);
    let profile = 1.0 - smooth_step(0.15 * HALF_LINE, HALF_LINE, across);
    LINE_DEPTH * profile * ends * smooth_step(-2.0, -1.0, q.z)
}

fn hosel(p: DVec3) -> f64 {
    let (sin, cos) = LIE.to_radians().sin_cos();
    let axis = DVec3::new(0.0, cos, sin);
    let heel = DVec3::new(-1.0, 35.0, -16.0);
    let along = (p - heel).dot(axis);
    let around = (p - heel - along * axis).length();
    let lower =
        smooth_max(around - 6.6 - 0.5 * smooth_step(20.0, 0.0, along), (along - 32.0).abs() - 34.0, 3.0);
    // The ferrule narrows from the hosel to the shaft. It begins where the hosel is still wide: a slit
    // between their ends would be narrower than the edges of any mesh.
    let ferrule =
        smooth_max(around - 6.4 + 1.4 * smooth_step(66.0, 84.0, along), (along - 73.0).abs() - 11.0, 0.8);
    let steps = 0.25 * smooth_step(118.0, 119.0, along) + 0.25 * smooth_step(150.0, 151.0, along);
    let shaft =
        smooth_max(around - 4.7 - steps, (along - 0.5 * (40.0 + LENGTH)).abs() - 0.5 * (LENGTH - 40.0), 1.0);
    smooth_min(smooth_min(lower, ferrule, 0.6), shaft, 0.6)
}

impl Surface for Club {
    fn value(&self, p: DVec3) -> f64 {
        let q = to_face(p);
        // Up the shaft the blade is far away, and its distance to a box will do.
        let blade =
            if p.z > 60.0 { p.z - 40.0 } else { blade(q, polygon_distance(&self.outline, q.truncate())) };
        smooth_min(blade, hosel(p), 9.0)
    }

    fn bounds(&self) -> (DVec3, DVec3) {
        (DVec3::new(-35.0, -42.0, -36.0), DVec3::new(26.0, 128.0, 150.0))
    }

    fn feature(&self) -> f64 {
        1.5
    }

    fn sizing(&self, p: DVec3) -> f64 {
        // Fine on the face, where the ball is struck.
        let q = to_face(p);
        if q.z.abs() > 2.5 {
            return 1.0;
        }
        let inside = smooth_step(3.0, -1.0, polygon_distance(&self.outline, q.truncate()));
        1.0 - 0.45 * inside * smooth_step(2.5, 1.0, q.z.abs())
    }
}
