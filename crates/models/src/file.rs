//! The file (hand tool) of Table 4.1 and Fig. 4.13: a flat blade with cross-cut teeth on both faces, and a
//! tang.

use std::f64::consts::TAU;

use palpate_core::{TriMesh, glam::DVec3};

use crate::box_lattice::BoxLattice;
use crate::path::stations;
use crate::relief::{self, smooth_step};
use crate::stitched::{Stitched, cells, fit};

pub(crate) const MIN_TRIANGLES: usize = 300;

/// The blade runs from the shoulder at x = 0 to the point; the tang to the other side, mm.
const BLADE: f64 = 180.0;
const TANG: f64 = 55.0;
const WIDTH: f64 = 24.0;
const THICKNESS: f64 = 5.5;
/// Distance between teeth and their height, mm.
const PITCH: f64 = 2.6;
const HEIGHT: f64 = 0.7;
/// Directions of the two cuts against the x axis, degrees: the first cut is the flatter.
const CUTS: [f64; 2] = [48.0, -62.0];

/// Width and thickness at x.
fn section(x: f64) -> (f64, f64) {
    let shoulder = smooth_step(-9.0, 0.0, x);
    let tang = (x + TANG) / TANG;
    let point = smooth_step(0.45 * BLADE, 1.3 * BLADE, x);
    let tang_width = 3.0 + 7.5 * tang.min(1.0);
    let tang_thickness = 2.4 + (THICKNESS - 2.4) * smooth_step(0.0, 0.9, tang);
    (
        tang_width + (WIDTH * (1.0 - 0.25 * point) - tang_width) * shoulder,
        tang_thickness + (THICKNESS * (1.0 - 0.2 * point) - tang_thickness) * shoulder,
    )
}

/// The rows of teeth that one cut leaves, a turn of `phase` each, 0 to 1: rounded ridges between sharp
/// grooves, steeper on one side.
fn cut(phase: f64) -> f64 {
    let angle = TAU * phase;
    (0.5 * (angle + 0.5 * angle.sin())).cos().abs()
}

pub(crate) fn build(triangles: usize) -> TriMesh {
    let area = 2.0 * BLADE * (WIDTH + THICKNESS) + 2.0 * TANG * 10.0;
    let plan = |edge: f64, stretch: f64| BoxLattice {
        cells: [
            cells(1.18 * (TANG + BLADE), edge * stretch, 4),
            cells(WIDTH, edge / stretch, 2),
            cells(THICKNESS, edge / stretch, 1),
        ],
        windows: Vec::new(),
    };
    let lattice = fit(triangles, area, plan, BoxLattice::triangles);
    // Closer together where the file is narrow, so that cells keep their shape.
    let stations = stations(-TANG, BLADE, lattice.cells[0], |x| (WIDTH / section(x).0).sqrt());
    let height = HEIGHT * relief::resolved(PITCH, WIDTH / lattice.cells[1] as f64);

    let mut mesh = Stitched::default();
    lattice.build(&mut mesh, |[i, j, k]| {
        let x = stations[i];
        let (width, thickness) = section(x);
        let (across, up) =
            (2.0 * j as f64 / lattice.cells[1] as f64 - 1.0, 2.0 * k as f64 / lattice.cells[2] as f64 - 1.0);
        let y = 0.5 * width * across;
        let teeth: f64 = CUTS
            .iter()
            .map(|degrees| {
                let (sin, cos) = degrees.to_radians().sin_cos();
                cut((x * sin + y * cos) / PITCH)
            })
            .product();
        let edge = 0.5 * width - y.abs();
        let toothed =
            smooth_step(4.0, 9.0, x) * smooth_step(0.3, 2.0, BLADE - x) * smooth_step(0.3, 1.6, edge);
        let on_face = if up.abs() == 1.0 { up } else { 0.0 };
        DVec3::new(x, y, 0.5 * thickness * up + on_face * height * teeth * toothed)
    });
    mesh.finish(1e-3)
}
