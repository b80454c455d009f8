//! The gear of Table 4.1 and Fig. 4.11: a disc, convex at coarse resolution, whose rim carries teeth that
//! interlock with the ridges of the [`block`]. Hub, web and spokes are a shallow relief of the flat sides.

use std::f64::consts::TAU;

use palpate_core::{TriMesh, glam::DVec3};

use crate::block;
use crate::relief::{self, smooth_step};
use crate::stitched::{Cap, Stitched, cells, fit, reversed};

pub(crate) const MIN_TRIANGLES: usize = 400;

const TEETH: usize = 24;
/// Radius of the pitch circle, on which teeth are as far apart as the block's ridges, mm.
const RADIUS: f64 = TEETH as f64 * block::PITCH / TAU;
const WIDTH: f64 = 18.0;
/// Radius, as a fraction of the whole, up to which the teeth do not affect the sides.
const WEB: f64 = 0.80;
/// Depth of the recesses in the sides, mm.
const RECESS: f64 = 1.4;

/// Division of the gear.
struct Plan {
    around: usize,
    across: usize,
    /// Rows of each side between the teeth and the web.
    margin: usize,
}

impl Plan {
    fn new(edge: f64, stretch: f64) -> Self {
        let around = cells(TAU * RADIUS, edge * stretch, 12);
        // Whole teeth look alike only if each has equally many vertices.
        let around = if around >= 4 * TEETH { (around + TEETH / 2) / TEETH * TEETH } else { around };
        Self {
            around,
            // Teeth do not change along their length: longer cells there leave more for their profile.
            across: cells(WIDTH, 2.2 * edge / stretch.powi(4), 1),
            margin: cells(RADIUS * (1.0 - WEB), edge / stretch, 1),
        }
    }

    fn web(&self) -> Cap {
        Cap::new(self.around, (self.around as f64 / TAU * 1.25).round() as usize)
    }

    fn triangles(&self) -> usize {
        2 * self.around * (self.across + 2 * self.margin) + 2 * self.web().triangles()
    }
}

pub(crate) fn build(triangles: usize) -> TriMesh {
    let area = TAU * RADIUS * (WIDTH + RADIUS);
    let plan = fit(triangles, area, Plan::new, Plan::triangles);
    let edge = TAU * RADIUS / plan.around as f64;
    let teeth = block::AMPLITUDE * relief::resolved(block::PITCH, edge);
    let recess = RECESS * relief::resolved(0.25 * RADIUS, edge);

    // `radius` is a part of the whole; `side` is -1, 0 (on the rim) or 1.
    let place = |radius: f64, turn: f64, height: f64, side: f64| {
        let tooth = teeth * relief::ridges(TEETH as f64 * turn) * smooth_step(WEB, 1.0, radius);
        let (sin, cos) = (TAU * turn).sin_cos();
        let distance = RADIUS * radius + tooth;
        let sunk = side * recess * sunken(radius, turn);
        DVec3::new(distance * cos, distance * sin, height - sunk)
    };

    let mut mesh = Stitched::default();
    let half = 0.5 * WIDTH;
    let turn = |index: usize| index as f64 / plan.around as f64;
    let bottom = mesh.ring(plan.around, |turn| place(1.0, turn, -half, 0.0));
    let top = mesh.tube(&bottom, plan.across, |row, index| {
        place(1.0, turn(index), -half + WIDTH * row as f64 / plan.across as f64, 0.0)
    });
    for (rim, side) in [(top, 1.0), (bottom, -1.0)] {
        // The lower side is seen from below: its rings run the other way.
        let mirrored = |turn: f64| if side < 0.0 { (1.0 - turn).fract() } else { turn };
        let rim = if side < 0.0 { reversed(&rim) } else { rim };
        let inner = mesh.tube(&rim, plan.margin, |row, index| {
            let radius = 1.0 - (1.0 - WEB) * row as f64 / plan.margin as f64;
            place(radius, mirrored(turn(index)), side * half, side)
        });
        mesh.cap(&inner, &plan.web(), |radius, turn| place(WEB * radius, mirrored(turn), side * half, side));
    }
    mesh.finish(1e-3)
}

/// Depth of the relief of the sides, 0 to 1: openings between six spokes, and a bore in the hub.
fn sunken(radius: f64, turn: f64) -> f64 {
    let between = |low: f64, high: f64| {
        smooth_step(low - 0.05, low + 0.05, radius) * (1.0 - smooth_step(high - 0.05, high + 0.05, radius))
    };
    // Distance from the middle line of the nearest spoke, as a part of the whole radius.
    let spoke = (TAU / 6.0 * ((6.0 * turn) - (6.0 * turn).round())).abs() * radius;
    between(0.40, 0.74) * smooth_step(0.05, 0.14, spoke) + between(-1.0, 0.17)
}
