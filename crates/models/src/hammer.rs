//! The textured hammer of Table 4.1 and Fig. 4.12: a ball-peen hammer with a knurled grip and a milled face.
//!
//! The head is turned on a lathe along x, with a window below for the handle, a tube along -z.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI, TAU};

use palpate_core::{
    TriMesh,
    glam::{DVec2, DVec3},
};

use crate::lathe::{Lathe, Profile};
use crate::path::Path;
use crate::relief::{self, smooth_step};
use crate::stitched::{Cap, Stitched, cells, fit, reversed};
use crate::window::{Opening, Window};

pub(crate) const MIN_TRIANGLES: usize = 800;

/// Radii of the head's body, of its peen, and of its face, mm.
const BODY: f64 = 17.0;
const PEEN: f64 = 14.0;
const FACE: f64 = 16.5;
/// Half the length of the head's body around the handle.
const BODY_HALF: f64 = 19.0;
/// Centre of the ball of the peen, and the plane of the face.
const PEEN_CENTER: f64 = -44.0;
const FACE_PLANE: f64 = 52.0;
const CHAMFER: f64 = 1.8;
/// z of the handle's end, and the length over which it is rounded, mm.
const HANDLE_END: f64 = -265.0;
const END_ROUNDING: f64 = 9.0;
/// Half axes of the handle where it meets the head: along x and along y.
const JOINT: DVec2 = DVec2::new(11.5, 9.0);
/// Distance from the handle's middle within which the head's grid is displaced.
const JOINT_ROOM: f64 = 16.0;
/// The knurled part of the handle.
const GRIP: [f64; 2] = [-250.0, -135.0];
/// Ridges around the grip in each of the two directions, the length along the grip of one ridge, and half its
/// height.
const KNURL_AROUND: f64 = 16.0;
const KNURL_PITCH: f64 = 5.0;
const KNURL_AMPLITUDE: f64 = 0.55;
/// Pitch and height of the milling of the face.
const MILLING_PITCH: f64 = 3.6;
const MILLING_HEIGHT: f64 = 0.7;

/// Index of the body among the pieces of the profile.
const BODY_PIECE: usize = 2;

/// The head's profile as (radius, x), from the equator of the peen to the rim of the face.
fn pieces() -> Vec<Path> {
    let peen_end = DVec2::new(PEEN * FRAC_PI_4.cos(), PEEN_CENTER + PEEN * FRAC_PI_4.sin());
    let body_start = DVec2::new(BODY, -BODY_HALF);
    let body_end = DVec2::new(BODY, BODY_HALF);
    let face_start = DVec2::new(FACE, FACE_PLANE - 16.0);
    let neck = DVec2::new(11.0, 0.5 * (BODY_HALF + face_start.y));
    vec![
        Path::arc(DVec2::new(0.0, PEEN_CENTER), PEEN, 0.0, FRAC_PI_4),
        Path::cubic(peen_end, DVec2::new(-8.0, 8.0), body_start, DVec2::new(16.0, 6.0)),
        Path::line(body_start, body_end),
        Path::cubic(body_end, DVec2::new(-12.0, 4.0), neck, DVec2::new(0.0, 10.0)),
        Path::cubic(neck, DVec2::new(0.0, 10.0), face_start, DVec2::new(12.0, 4.0)),
        Path::line(face_start, DVec2::new(FACE, FACE_PLANE - CHAMFER)),
        Path::line(DVec2::new(FACE, FACE_PLANE - CHAMFER), DVec2::new(FACE - CHAMFER, FACE_PLANE)),
    ]
}

/// Half axes of the handle (along x, along y) at a height.
fn handle(z: f64) -> DVec2 {
    let slim = DVec2::new(9.0, 6.8);
    let grip = DVec2::new(13.0, 9.6);
    let knob = DVec2::new(14.8, 11.2);
    let shaft = JOINT.lerp(slim, smooth_step(-BODY, -75.0, z));
    let held = shaft.lerp(grip, smooth_step(-95.0, -165.0, z));
    let waist = 1.0 - 0.07 * smooth_step(-195.0, -222.0, z) * (1.0 - smooth_step(-222.0, -248.0, z));
    (held * waist).lerp(knob, smooth_step(-232.0, HANDLE_END + END_ROUNDING, z))
}

struct Plan {
    lathe: Lathe,
    profile: Profile,
    opening: Opening,
    peen: Cap,
    face: Cap,
    /// Rows along the handle, and its rounded end.
    handle: usize,
    end: Cap,
}

impl Plan {
    fn new(edge: f64, stretch: f64) -> Self {
        let around = cells(TAU * BODY, edge * stretch, 8).next_multiple_of(2);
        let profile = Profile::new(pieces(), edge / stretch, 1);
        let (first, rows) = profile.piece(BODY_PIECE);
        let step = 2.0 * BODY_HALF / rows as f64;
        let arc = TAU * BODY / around as f64;
        // Short of the window's reach, so that the grid gives way within the body.
        let half_columns = cells(0.82 * JOINT.y, arc, 1);
        let half_rows = cells(0.82 * JOINT.x, step, 1).min(((rows - 1) / 2).saturating_sub(1).max(1));
        let middle = first + rows / 2;
        let window = Window {
            low: [around / 2 - half_columns, middle - half_rows],
            high: [around / 2 + half_columns, middle + half_rows],
        };
        let center = DVec2::new(0.0, -BODY_HALF + (middle - first) as f64 * step);
        let half = DVec2::new(half_columns as f64 * arc, half_rows as f64 * step);
        let radii = DVec2::new(BODY * (JOINT.y / BODY).asin(), JOINT.x);
        let opening = Opening::new([center - half, center + half], window.size(), center, radii, JOINT_ROOM);
        let border = window.border();
        Self {
            lathe: Lathe { around, rows: profile.rows(), windows: vec![window] },
            profile,
            opening,
            peen: Cap::new(around, cells(FRAC_PI_2 * PEEN, edge / stretch, 2)),
            face: Cap::new(around, cells(FACE, edge / stretch, 2)),
            handle: cells(-BODY - HANDLE_END - END_ROUNDING, edge * stretch, 6),
            end: Cap::new(border, cells(18.0, edge, 2)),
        }
    }

    fn triangles(&self) -> usize {
        self.lathe.triangles()
            + 2 * self.lathe.windows[0].border() * self.handle
            + self.peen.triangles()
            + self.face.triangles()
            + self.end.triangles()
    }
}

/// A point at a distance from the x axis; the turn of a half points down.
fn around_x(radius: f64, arc: f64, x: f64) -> DVec3 {
    let (sin, cos) = arc.sin_cos();
    DVec3::new(x, radius * sin, -radius * cos)
}

pub(crate) fn build(triangles: usize) -> TriMesh {
    let plan = fit(triangles, 40_000.0, Plan::new, Plan::triangles);
    let mut mesh = Stitched::default();
    let around = plan.lathe.around as f64;
    let (first, rows) = plan.profile.piece(BODY_PIECE);
    let head = plan.lathe.build(&mut mesh, |column, row| {
        let arc = TAU * (column as f64 / around - 0.5);
        let at = plan.profile.at(row as f64);
        if (first + 1..first + rows).contains(&row) {
            let moved = plan.opening.displace(DVec2::new(arc * BODY, at.y));
            return around_x(BODY, moved.x / BODY, moved.y);
        }
        around_x(at.x, arc, at.y)
    });
    mesh.cap(&reversed(&head.first), &plan.peen, |part, turn| {
        let (sin, cos) = (FRAC_PI_2 * part).sin_cos();
        around_x(PEEN * sin, TAU * (0.5 - turn), PEEN_CENTER - PEEN * cos)
    });
    let milling = MILLING_HEIGHT * relief::resolved(MILLING_PITCH, TAU * FACE / around);
    let face = FACE - CHAMFER;
    mesh.cap(&head.last, &plan.face, |part, turn| {
        let flat = around_x(face * part, TAU * (turn - 0.5), FACE_PLANE);
        let wave = |along: f64| 0.5 + 0.5 * (TAU * along / MILLING_PITCH).cos();
        let pyramids = (wave(flat.y) * wave(flat.z)).sqrt();
        flat - milling * (1.0 - pyramids) * smooth_step(0.0, 1.0, face * (1.0 - part)) * DVec3::X
    });
    join_handle(&mut mesh, &plan, &head.windows[0]);
    mesh.finish(1e-3)
}

fn join_handle(mesh: &mut Stitched, plan: &Plan, border: &[u32]) {
    let window = plan.lathe.windows[0];
    let middle =
        DVec2::new((window.low[0] + window.high[0]) as f64, (window.low[1] + window.high[1]) as f64) / 2.0;
    let on_grid = Opening {
        center: middle,
        half: DVec2::new(window.high[0] as f64, window.high[1] as f64) - middle,
        ..plan.opening
    };
    // Below the head columns run along y, rows along x.
    let directions: Vec<DVec2> = window
        .nodes()
        .map(|[column, row]| on_grid.direction(DVec2::new(column as f64, row as f64)))
        .map(|direction| DVec2::new(direction.y, direction.x))
        .collect();
    let ring_edge = PI * 2.0 * 11.3 / border.len() as f64;
    let length = -BODY - HANDLE_END - END_ROUNDING;
    let knurl = KNURL_AMPLITUDE * relief::resolved(4.2, ring_edge.max(length / plan.handle as f64));
    let center = plan.opening.center.y;
    let section = |z: f64, direction: DVec2| {
        let held = smooth_step(GRIP[0], GRIP[0] + 5.0, z) * (1.0 - smooth_step(GRIP[1] - 5.0, GRIP[1], z));
        let turn = direction.to_angle() / TAU;
        let along = z / KNURL_PITCH;
        let ridge = |phase: f64| (TAU * phase).cos();
        let diamonds = ridge(KNURL_AROUND * turn + along) * ridge(KNURL_AROUND * turn - along);
        let at = handle(z) * direction;
        let outward = (direction / handle(z)).normalize_or_zero();
        at + knurl * held * diamonds * outward + DVec2::new(center, 0.0)
    };
    let deviation: Vec<DVec3> = border
        .iter()
        .zip(&directions)
        .map(|(vertex, direction)| mesh.position(*vertex) - section(-BODY, *direction).extend(-BODY))
        .collect();
    let last = mesh.tube(border, plan.handle, |row, index| {
        let z = -BODY - length * row as f64 / plan.handle as f64;
        let fades = (1.0 + (z + BODY) / 22.0).max(0.0).powi(2);
        section(z, directions[index]).extend(z) + fades * deviation[index]
    });
    // The end: part of the way down the rounding, part across the bottom.
    mesh.cap(&last, &plan.end, |part, turn| {
        let index = turn * directions.len() as f64;
        let (a, b) = (
            directions[index as usize % directions.len()],
            directions[(index as usize + 1) % directions.len()],
        );
        let direction = a.lerp(b, index.fract()).normalize_or_zero();
        let angle = FRAC_PI_2 * (1.0 - part);
        let (sin, cos) = angle.sin_cos();
        let flat = cos.powf(0.75);
        let at = handle(HANDLE_END + END_ROUNDING) * direction * flat;
        DVec3::new(at.x + center, at.y, HANDLE_END + END_ROUNDING - END_ROUNDING * sin)
    });
}
