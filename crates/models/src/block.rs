//! The textured block of Table 4.1 and Fig. 4.11: striped with ridges, so that two blocks, or a block and a
//! [`gear`](crate::gear), interlock. The sides carry a fine dimpled relief.

use palpate_core::{TriMesh, glam::DVec3};

use crate::box_lattice::BoxLattice;
use crate::relief::{self, smooth_step};
use crate::stitched::Stitched;

pub(crate) const MIN_TRIANGLES: usize = 300;

/// Size along x, y and z, mm.
const SIZE: [f64; 3] = [80.0, 64.0, 36.0];
/// Distance between ridges on top and bottom, which run along x, mm.
pub(crate) const PITCH: f64 = 8.0;
/// Half the height of a ridge, mm.
pub(crate) const AMPLITUDE: f64 = 1.4;
/// Wavelength and amplitude of the relief on the sides, mm.
const DIMPLE_PITCH: f64 = 6.0;
const DIMPLE_AMPLITUDE: f64 = 0.5;
/// Width of the plain border of each face, mm.
const BORDER: f64 = 2.0;

pub(crate) fn build(triangles: usize) -> TriMesh {
    let lattice = BoxLattice::of(SIZE, triangles);
    let edge: [f64; 3] = std::array::from_fn(|axis| SIZE[axis] / lattice.cells[axis] as f64);
    let ridges = AMPLITUDE * relief::resolved(PITCH, edge[1]);
    let dimples = DIMPLE_AMPLITUDE * relief::resolved(DIMPLE_PITCH, edge[0].max(edge[1]).max(edge[2]));

    let mut mesh = Stitched::default();
    lattice.build(&mut mesh, |node| {
        let plain: [f64; 3] = std::array::from_fn(|axis| node[axis] as f64 * edge[axis] - 0.5 * SIZE[axis]);
        let inside = |axis: usize| smooth_step(0.0, BORDER, 0.5 * SIZE[axis] - plain[axis].abs());
        let side = |axis: usize| match node[axis] {
            0 => -1.0,
            last if last == lattice.cells[axis] => 1.0,
            _ => 0.0,
        };
        let dimple = |a: usize, b: usize| {
            let wave = |axis: usize| (std::f64::consts::TAU * plain[axis] / DIMPLE_PITCH).cos();
            dimples * wave(a) * wave(b) * inside(a) * inside(b)
        };
        // A valley at the middle of the bottom and a crest at the middle of the top: stacked blocks
        // interlock.
        let ridge = ridges * side(2) * relief::ridges(plain[1] / PITCH) * inside(0) * inside(1);
        DVec3::new(
            plain[0] + side(0) * dimple(1, 2),
            plain[1] + side(1) * dimple(0, 2),
            plain[2] + ridge * side(2),
        )
    });
    mesh.finish(1e-3)
}
