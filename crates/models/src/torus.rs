//! The helicoidal torus of Table 4.1 and Fig. 4.12: a torus wrinkled by ridges that wind around it helically.

use std::f64::consts::TAU;

use palpate_core::{TriMesh, glam::DVec3};

use crate::relief;
use crate::stitched::{Stitched, cells, fit};

pub(crate) const MIN_TRIANGLES: usize = 400;

/// Radius of the centre line and of the tube, mm.
const MAJOR: f64 = 60.0;
const MINOR: f64 = 24.0;
/// Number of ridges around the tube, and around the centre line.
const AROUND_TUBE: f64 = 14.0;
const AROUND_AXIS: f64 = 32.0;
/// Half the height from valley to crest, mm.
const AMPLITUDE: f64 = 1.1;

pub(crate) fn build(triangles: usize) -> TriMesh {
    let plan = |edge: f64, stretch: f64| {
        (cells(TAU * MAJOR, edge / stretch, 3), cells(TAU * MINOR, edge * stretch, 3))
    };
    let (along, around) =
        fit(triangles, TAU * MAJOR * TAU * MINOR, plan, |(along, around)| 2 * along * around);
    let edge = (TAU * (MAJOR + MINOR) / along as f64).max(TAU * MINOR / around as f64);
    let wavelength = TAU / (AROUND_TUBE / MINOR).hypot(AROUND_AXIS / MAJOR);
    let amplitude = AMPLITUDE * relief::resolved(wavelength, edge);

    let mut mesh = Stitched::default();
    let rings: Vec<Vec<u32>> = (0..along)
        .map(|index| {
            let turn = index as f64 / along as f64;
            let outward = DVec3::new((TAU * turn).cos(), (TAU * turn).sin(), 0.0);
            mesh.ring(around, |around_turn| {
                let ridges = (TAU * (AROUND_TUBE * around_turn + AROUND_AXIS * turn)).cos();
                let radius = MINOR + amplitude * ridges;
                let (sin, cos) = (TAU * around_turn).sin_cos();
                (MAJOR + radius * cos) * outward + radius * sin * DVec3::Z
            })
        })
        .collect();
    for index in 0..along {
        mesh.band(&rings[(index + 1) % along], &rings[index]);
    }
    mesh.finish(1e-3)
}
