//! The surface of a box divided into cells, with windows: the common topology of plates, bars and blocks.

use palpate_core::glam::DVec3;

use crate::stitched::{Stitched, cells};
use crate::window::Window;

/// The cells of a box along its three axes, and its windows, which pierce both bottom and top at the same
/// cells.
pub(crate) struct BoxLattice {
    pub(crate) cells: [usize; 3],
    pub(crate) windows: Vec<Window>,
}

/// The borders of a window in the finished surface, in the order of [`Window::nodes`].
pub(crate) struct Borders {
    pub(crate) bottom: Vec<u32>,
    pub(crate) top: Vec<u32>,
}

impl BoxLattice {
    /// Divides a box of a size into about cubic cells. With three whole numbers to choose, the number of
    /// triangles can be met closely: for each choice of the first two the third follows.
    pub(crate) fn of(size: [f64; 3], triangles: usize) -> Self {
        let area = 2.0 * (size[0] * size[1] + size[1] * size[2] + size[2] * size[0]);
        let edge = (2.0 * area / triangles as f64).sqrt();
        let near = |axis: usize| cells(size[axis], 1.5 * edge, 1)..=cells(size[axis], edge / 1.5, 1);
        let mut best = Self { cells: [1; 3], windows: Vec::new() };
        let mut least = f64::INFINITY;
        for a in near(0) {
            for b in near(1) {
                let c = (triangles as f64 / 4.0 - (a * b) as f64) / (a + b) as f64;
                let lattice = Self { cells: [a, b, c.round().max(1.0) as usize], windows: Vec::new() };
                let off = (lattice.triangles() as f64 / triangles as f64).ln().abs();
                let stretch: f64 =
                    (0..3).map(|axis| (size[axis] / (lattice.cells[axis] as f64 * edge)).ln().powi(2)).sum();
                // Half a percent off in number weighs as much as cells that are a tenth off in length.
                let badness = (off / 0.005).powi(2) + stretch / 0.01;
                if badness < least {
                    (least, best) = (badness, lattice);
                }
            }
        }
        best
    }

    /// Number of triangles, without those that fill the windows.
    pub(crate) fn triangles(&self) -> usize {
        let [a, b, c] = self.cells;
        4 * (a * b + b * c + c * a) - 4 * self.windows.iter().map(Window::cells).sum::<usize>()
    }

    /// Adds the surface to a mesh. `place` gets the node, from 0 to the number of cells along each axis.
    pub(crate) fn build(&self, mesh: &mut Stitched, place: impl Fn([usize; 3]) -> DVec3) -> Vec<Borders> {
        let [a, b, c] = self.cells;
        let mut sheets = [vec![u32::MAX; (a + 1) * (b + 1)], vec![u32::MAX; (a + 1) * (b + 1)]];
        let at = |i: usize, j: usize| i * (b + 1) + j;
        for (sheet, k) in sheets.iter_mut().zip([0, c]) {
            for i in 0..=a {
                for j in 0..=b {
                    if !self.windows.iter().any(|window| window.holds_node(i, j)) {
                        sheet[at(i, j)] = mesh.vertex(place([i, j, k]));
                    }
                }
            }
            for i in 0..a {
                for j in 0..b {
                    if self.windows.iter().any(|window| window.holds_cell(i, j)) {
                        continue;
                    }
                    let quad = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)].map(|(i, j)| sheet[at(i, j)]);
                    let [p, q, r, s] = quad;
                    mesh.quad(if k == 0 { [s, r, q, p] } else { quad });
                }
            }
        }
        let rim = Window { low: [0, 0], high: [a, b] };
        let nodes: Vec<[usize; 2]> = rim.nodes().collect();
        let of = |sheet: &[u32], window: &Window| window.nodes().map(|[i, j]| sheet[at(i, j)]).collect();
        let (first, last): (Vec<u32>, Vec<u32>) = (of(&sheets[0], &rim), of(&sheets[1], &rim));
        let below_top = mesh.tube(&first, c - 1, |row, index| place([nodes[index][0], nodes[index][1], row]));
        mesh.band(&below_top, &last);
        self.windows
            .iter()
            .map(|window| Borders { bottom: of(&sheets[0], window), top: of(&sheets[1], window) })
            .collect()
    }
}
