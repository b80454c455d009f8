//! The plate of §5.5.4, to be given a texture: 35 cm by 35 cm by 2 cm, its upper face in the plane z = 0.

use palpate_core::{TriMesh, glam::DVec3};

use crate::box_lattice::BoxLattice;
use crate::stitched::Stitched;

pub(crate) const MIN_TRIANGLES: usize = 12;

/// Size along x, y and z, mm.
const SIZE: [f64; 3] = [350.0, 350.0, 20.0];

pub(crate) fn build(triangles: usize) -> TriMesh {
    let lattice = BoxLattice::of(SIZE, triangles);
    let mut mesh = Stitched::default();
    lattice.build(&mut mesh, |node| {
        let part: [f64; 3] = std::array::from_fn(|axis| node[axis] as f64 / lattice.cells[axis] as f64);
        DVec3::new((part[0] - 0.5) * SIZE[0], (part[1] - 0.5) * SIZE[1], (part[2] - 1.0) * SIZE[2])
    });
    mesh.finish(1e-3)
}
