//! The spoon of Table 3.2 and §5.5: 0.2 m long, with bowl, neck and handle.
//!
//! A sheet of varying thickness with a rounded rim, laid over a curved middle surface: upper and lower side
//! are two sides of one lattice, and the rim is its third direction.

use std::f64::consts::PI;

use palpate_core::{
    TriMesh,
    glam::{DVec2, DVec3},
};

use crate::box_lattice::BoxLattice;
use crate::path::stations;
use crate::relief::smooth_step;
use crate::stitched::{Stitched, cells, fit};
use crate::window::disc;

pub(crate) const MIN_TRIANGLES: usize = 250;

const LENGTH: f64 = 200.0;
/// Distance of the rim's middle line from the spoon's two ends.
const INSET: [f64; 2] = [0.75, 1.1];
/// The bowl: its widest place, half its width and its depth, mm. The bowl's front is half an ellipse.
const BOWL: f64 = 31.0;
const BOWL_LENGTH: f64 = BOWL - INSET[0];
const BOWL_HALF_WIDTH: f64 = 19.5;
const BOWL_DEPTH: f64 = 8.5;
/// End of the bowl, and half the width of the neck.
const NECK: f64 = 74.0;
const NECK_HALF_WIDTH: f64 = 2.6;
/// Half the width of the end of the handle, which is rounded.
const END_HALF_WIDTH: f64 = 7.5;
const END: f64 = LENGTH - INSET[1] - END_HALF_WIDTH;

/// Half the width of the sheet between the rounded ends.
fn half_width(x: f64) -> f64 {
    let bowl = ((x - BOWL) / (NECK - BOWL)).clamp(0.0, 1.0);
    let shoulder = (1.0 - bowl * bowl).powi(2);
    let handle = smooth_step(NECK - 10.0, END, x).powf(1.3);
    NECK_HALF_WIDTH
        + (BOWL_HALF_WIDTH - NECK_HALF_WIDTH) * shoulder
        + (END_HALF_WIDTH - NECK_HALF_WIDTH) * handle
}

fn thickness(x: f64) -> f64 {
    1.5 + 1.7 * smooth_step(0.6 * NECK, NECK, x) - 1.0 * smooth_step(NECK, END, x)
}

/// Plan position of a node, and the direction out of the sheet for nodes on its border.
///
/// `along` is x on the middle line, `across` from -1 to 1. At both
/// rounded ends a square is drawn out into a disc, so that there is no pole.
fn plan(along: f64, across: f64) -> (DVec2, DVec2) {
    let round = |center: f64, half: DVec2, forward: f64| {
        let unit = disc(DVec2::new(forward, across));
        (DVec2::new(center, 0.0) + half * unit, (unit / half).normalize_or_zero())
    };
    if along < BOWL {
        round(BOWL, DVec2::new(BOWL_LENGTH, BOWL_HALF_WIDTH), (along - BOWL) / BOWL_LENGTH)
    } else if along > END {
        round(END, DVec2::splat(END_HALF_WIDTH), (along - END) / END_HALF_WIDTH)
    } else {
        let slope = (half_width(along + 0.01) - half_width(along - 0.01)) / 0.02;
        let side = DVec2::new(-slope, across.signum()).normalize();
        (DVec2::new(along, half_width(along) * across), side)
    }
}

/// Height of the middle surface.
fn height(at: DVec2) -> f64 {
    let DVec2 { x, y } = at;
    let handle = 17.0 * smooth_step(0.35 * NECK, 165.0, x) - 5.0 * ((x - 150.0).max(0.0) / 50.0).powi(2);
    let front = ((BOWL - x).max(0.0) / BOWL_LENGTH).powi(2);
    let rear =
        ((half_width(x.max(BOWL)) - NECK_HALF_WIDTH) / (BOWL_HALF_WIDTH - NECK_HALF_WIDTH)).clamp(0.0, 1.0);
    let bowl = if x < BOWL {
        1.0 - front - (y / BOWL_HALF_WIDTH).powi(2)
    } else if x < NECK {
        rear.powf(1.2) * (1.0 - (y / half_width(x)).powi(2))
    } else {
        0.0
    };
    // The handle is slightly arched across.
    let arch = 0.9 * smooth_step(NECK, 170.0, x) * (y / END_HALF_WIDTH).powi(2);
    handle - BOWL_DEPTH * bowl - arch
}

fn lattice(edge: f64, stretch: f64) -> BoxLattice {
    BoxLattice {
        cells: [
            cells(LENGTH, edge * stretch, 8),
            cells(22.0, edge / stretch, 2),
            // The rim's own middle line gives the spoon its length; on the coarsest meshes it would only
            // make slivers.
            cells(4.0, edge * stretch, if edge < 7.0 { 2 } else { 1 }),
        ],
        windows: Vec::new(),
    }
}

pub(crate) fn build(triangles: usize) -> TriMesh {
    let lattice = fit(triangles, 9000.0, lattice, BoxLattice::triangles);
    // Closer together where the spoon is narrow, so that cells keep their shape.
    let stations = stations(INSET[0], LENGTH - INSET[1], lattice.cells[0], |x| {
        half_width(x.clamp(BOWL, END)).powf(-0.5)
    });
    let mut mesh = Stitched::default();
    lattice.build(&mut mesh, |[i, j, k]| {
        let (at, outward) = plan(stations[i], 2.0 * j as f64 / lattice.cells[1] as f64 - 1.0);
        let step = 0.01;
        let slope = DVec2::new(
            height(at + step * DVec2::X) - height(at - step * DVec2::X),
            height(at + step * DVec2::Y) - height(at - step * DVec2::Y),
        ) / (2.0 * step);
        let normal = (DVec3::Z - slope.extend(0.0)).normalize();
        let out = outward.extend(slope.dot(outward)).normalize_or_zero();
        let (sin, cos) = (PI * k as f64 / lattice.cells[2] as f64).sin_cos();
        // Exactly none on the two sides, where `outward` has no meaning inside the border.
        let sin = if k == 0 || k == lattice.cells[2] { 0.0 } else { sin };
        at.extend(height(at)) - DVec3::new(0.5 * LENGTH, 0.0, 0.0)
            + 0.5 * thickness(at.x) * (sin * out - cos * normal)
    });
    mesh.finish(1e-3)
}
