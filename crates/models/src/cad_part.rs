//! The CAD part of Table 4.1 and Fig. 4.13: a machined angle bracket. Its faces carry the cross-hatched arcs
//! that a face mill leaves, its bosses and counterbored holes are turned, and the large bore is threaded.
//!
//! A plate with windows is bent by a right angle; each hole is a turned tube from its window on the inner
//! face (above the base, before the wall) to that on the outer face.

use std::f64::consts::{FRAC_PI_2, TAU};

use palpate_core::{
    TriMesh,
    glam::{DVec2, DVec3},
};

use crate::box_lattice::BoxLattice;
use crate::path::Path;
use crate::relief::{self, smooth_step};
use crate::stitched::{Stitched, cells, fit};
use crate::window::{Opening, Window, disc};

pub(crate) const MIN_TRIANGLES: usize = 8_000;

/// The plate: lengths of base and wall without the bend, width, thickness, and radius of the bend's middle
/// surface, mm.
const BASE: f64 = 85.0;
const WALL: f64 = 97.0;
const WIDTH: f64 = 110.0;
const THICKNESS: f64 = 14.0;
const BEND: f64 = 17.0;
/// Radius of the rounded corners.
const CORNER: f64 = 11.0;
/// Length of the plate before it is bent.
const LENGTH: f64 = BASE + FRAC_PI_2 * BEND + WALL;
/// Height of the wall's bore above the bend.
const BORE: f64 = 50.0;

/// Distance between the arcs left by milling, their radius, and half their height.
const MILLING_PITCH: f64 = 3.2;
const MILLING_RADIUS: f64 = 75.0;
const MILLING_AMPLITUDE: f64 = 0.3;
/// Pitch and half the depth of the thread.
const THREAD_PITCH: f64 = 3.2;
const THREAD_AMPLITUDE: f64 = 0.4;

/// A turned hole through the plate.
struct Hole {
    /// Middle on the flat plate, measured from the base's free end and from the middle line.
    center: DVec2,
    /// Half the side of the square of the grid that makes room for it, and of the square that is drawn out
    /// of shape.
    half: f64,
    room: f64,
    /// Corners of its profile as (radius, height over the middle surface), from the inner to the outer face.
    profile: Vec<DVec2>,
    threaded: bool,
}

fn holes() -> Vec<Hole> {
    let face = 0.5 * THICKNESS;
    let counterbored = |x: f64, y: f64| Hole {
        center: DVec2::new(x, y),
        half: 9.0,
        room: 12.5,
        profile: [
            (11.0, face),
            (10.0, face - 1.0),
            (10.0, face - 6.0),
            (6.0, face - 6.0),
            (6.0, 1.0 - face),
            (7.0, -face),
        ]
        .map(DVec2::from)
        .to_vec(),
        threaded: false,
    };
    let drilled = |x: f64, y: f64| Hole {
        center: DVec2::new(x, y),
        half: 3.6,
        room: 6.4,
        profile: [(5.0, face), (4.2, face - 0.8), (4.2, 0.8 - face), (5.0, -face)].map(DVec2::from).to_vec(),
        threaded: false,
    };
    let bore = LENGTH - WALL + BORE;
    vec![
        counterbored(24.0, -35.0),
        counterbored(24.0, 35.0),
        Hole {
            center: DVec2::new(55.0, 0.0),
            half: 13.0,
            room: 22.0,
            profile: [
                (17.5, face),
                (15.8, face + 1.7),
                (15.0, face + 10.0),
                (13.8, face + 11.2),
                (9.2, face + 11.2),
                (8.0, face + 10.0),
                (8.0, 1.2 - face),
                (9.2, -face),
            ]
            .map(DVec2::from)
            .to_vec(),
            threaded: false,
        },
        Hole {
            center: DVec2::new(bore, 0.0),
            half: 19.0,
            room: 33.0,
            profile: [
                (18.0, face),
                (16.5, face - 1.5),
                (16.5, -face - 7.5),
                (18.0, -face - 9.0),
                (24.0, -face - 9.0),
                (25.2, -face - 7.8),
                (26.0, -face - 2.0),
                (28.0, -face),
            ]
            .map(DVec2::from)
            .to_vec(),
            threaded: true,
        },
        drilled(bore - 34.0, -40.5),
        drilled(bore - 34.0, 40.5),
        drilled(bore + 34.0, -40.5),
        drilled(bore + 34.0, 40.5),
    ]
}

struct Plan {
    lattice: BoxLattice,
    /// Rows along each straight piece of each hole's profile.
    pieces: Vec<Vec<(Path, usize)>>,
}

impl Plan {
    fn new(edge: f64, stretch: f64) -> Self {
        let divided = [
            cells(LENGTH, edge * stretch, 30),
            // Even, so that the middle line is a line of the grid.
            2 * cells(0.5 * WIDTH, edge / stretch, 9),
            cells(THICKNESS, edge, 1),
        ];
        let steps = DVec2::new(LENGTH / divided[0] as f64, WIDTH / divided[1] as f64);
        let holes = holes();
        let windows = holes
            .iter()
            .map(|hole| {
                let node = |along: f64, step: f64| (along / step).round() as usize;
                let (i, j) = (node(hole.center.x, steps.x), node(hole.center.y + 0.5 * WIDTH, steps.y));
                let (di, dj) = (cells(hole.half, steps.x, 1), cells(hole.half, steps.y, 1));
                Window { low: [i - di, j - dj], high: [i + di, j + dj] }
            })
            .collect();
        let pieces = holes
            .iter()
            .map(|hole| {
                let piece = |ends: &[DVec2]| {
                    (Path::line(ends[0], ends[1]), cells(ends[0].distance(ends[1]), edge, 1))
                };
                hole.profile.windows(2).map(piece).collect()
            })
            .collect();
        Self { lattice: BoxLattice { cells: divided, windows }, pieces }
    }

    fn triangles(&self) -> usize {
        let rows = |pieces: &[(Path, usize)]| pieces.iter().map(|(_, rows)| rows).sum::<usize>();
        let tubes = self.lattice.windows.iter().zip(&self.pieces);
        self.lattice.triangles()
            + tubes.map(|(window, pieces)| 2 * window.border() * rows(pieces)).sum::<usize>()
    }

    /// A node on the flat plate, before anything is drawn out of shape.
    fn plain(&self, [i, j]: [usize; 2]) -> DVec2 {
        let [length, width, _] = self.lattice.cells;
        DVec2::new(LENGTH * i as f64 / length as f64, WIDTH * (j as f64 / width as f64 - 0.5))
    }

    /// The opening of a hole whose profile meets the face at a radius.
    fn opening(&self, hole: &Hole, window: &Window, radius: f64) -> Opening {
        let (low, high) = (self.plain(window.low), self.plain(window.high));
        Opening::new([low, high], window.size(), hole.center, DVec2::splat(radius), hole.room)
    }
}

/// Deforms the corners of the flat plate into quarter discs.
fn round_corners(at: DVec2) -> DVec2 {
    let middle = DVec2::new(0.5 * LENGTH, 0.0);
    let from = at - middle;
    let block = DVec2::new(0.5 * LENGTH - CORNER, 0.5 * WIDTH - CORNER);
    let local = (from.abs() - block) / CORNER;
    if local.min_element() <= 0.0 {
        return at;
    }
    let round = disc(local);
    middle + (block + CORNER * round) * from.signum()
}

/// Bends the flat plate: `height` is that over its middle surface, towards the inside of the bend.
fn bend(at: DVec2, height: f64) -> DVec3 {
    let angle = (at.x - BASE) / BEND;
    if angle <= 0.0 {
        return at.extend(height);
    }
    let (sin, cos) = angle.min(FRAC_PI_2).sin_cos();
    let beyond = (at.x - BASE - FRAC_PI_2 * BEND).max(0.0);
    DVec3::new(BASE + (BEND - height) * sin, at.y, BEND - (BEND - height) * cos + beyond)
}

pub(crate) fn build(triangles: usize) -> TriMesh {
    let plan = fit(triangles, 58_000.0, Plan::new, Plan::triangles);
    let holes = holes();
    let edge = LENGTH / plan.lattice.cells[0] as f64;
    let milling = MILLING_AMPLITUDE * relief::resolved(MILLING_PITCH, edge);
    let thread = THREAD_AMPLITUDE * relief::resolved(THREAD_PITCH, edge);

    // Openings of the outer (0) and the inner face (1).
    let meets = |hole: &Hole, inner: bool| {
        if inner { hole.profile[0].x } else { hole.profile[hole.profile.len() - 1].x }
    };
    let openings = [false, true].map(|inner| -> Vec<Opening> {
        let each = holes.iter().zip(&plan.lattice.windows);
        each.map(|(hole, window)| plan.opening(hole, window, meets(hole, inner))).collect()
    });
    let milled = |at: DVec2, inner: bool| {
        let arc = MILLING_RADIUS - (MILLING_RADIUS * MILLING_RADIUS - at.y * at.y).sqrt();
        let wave = |phase: f64| (TAU * phase / MILLING_PITCH).cos();
        let hatched = 0.5 * (wave(at.x + arc) + wave(at.x - arc));
        // Plain at the edges and around holes.
        let from_edge = (0.5 * WIDTH - at.y.abs()).min(at.x).min(LENGTH - at.x);
        let from_corner = {
            let beyond =
                (at - DVec2::new(0.5 * LENGTH, 0.0)).abs() - DVec2::new(0.5 * LENGTH, 0.5 * WIDTH) + CORNER;
            if beyond.min_element() > 0.0 { CORNER - beyond.length() } else { from_edge }
        };
        let from_holes = holes
            .iter()
            .map(|hole| at.distance(hole.center) - meets(hole, inner))
            .fold(from_edge.min(from_corner), f64::min);
        milling * hatched * smooth_step(0.2, 2.2, from_holes)
    };

    let mut mesh = Stitched::default();
    let thick = plan.lattice.cells[2];
    let borders = plan.lattice.build(&mut mesh, |[i, j, k]| {
        let height = THICKNESS * (k as f64 / thick as f64 - 0.5);
        let plain = plan.plain([i, j]);
        let on_face = k == 0 || k == thick;
        let inner = k == thick;
        let mut at = plain;
        if on_face {
            for opening in &openings[usize::from(inner)] {
                at = opening.displace(plain);
                if at != plain {
                    break;
                }
            }
        }
        let at = round_corners(at);
        let raised = if on_face { milled(at, inner) * height.signum() } else { 0.0 };
        bend(at, height + raised)
    });

    for (((hole, window), pieces), border) in
        holes.iter().zip(&plan.lattice.windows).zip(&plan.pieces).zip(&borders)
    {
        let opening = plan.opening(hole, window, meets(hole, true));
        let directions: Vec<DVec2> = window.nodes().map(|node| opening.direction(plan.plain(node))).collect();
        let place = |path: &Path, part: f64, direction: DVec2| {
            let at = path.at(part).0;
            let cut = if hole.threaded && path.length() > THICKNESS {
                let turn = direction.to_angle() / TAU;
                let from_end = path.length() * part.min(1.0 - part);
                thread * relief::ridges(at.y / THREAD_PITCH + turn) * smooth_step(0.0, 2.0, from_end)
            } else {
                0.0
            };
            bend(hole.center + (at.x + cut) * direction, at.y)
        };
        let mut ring = border.top.clone();
        for (index, (path, rows)) in pieces.iter().enumerate() {
            let last = index + 1 == pieces.len();
            let new_rows = if last { rows - 1 } else { *rows };
            ring = mesh.tube(&ring, new_rows, |row, index| {
                place(path, row as f64 / *rows as f64, directions[index])
            });
        }
        mesh.band(&ring, &border.bottom);
    }
    mesh.finish(1e-3)
}
