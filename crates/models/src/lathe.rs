//! Surfaces turned on a lathe: a grid around an axis and along a profile, with windows that handles can be
//! joined to.

use palpate_core::glam::{DVec2, DVec3};

use crate::path::Path;
use crate::stitched::{Stitched, cells};
use crate::window::Window;

/// The profile of a turned surface: curves of (radius, height) that follow one another, divided separately so
/// that the edges between them stay sharp.
pub(crate) struct Profile {
    pieces: Vec<(Path, usize)>,
}

impl Profile {
    /// Divides the curves into steps of about `edge`, each into at least `fewest`.
    pub(crate) fn new(pieces: Vec<Path>, edge: f64, fewest: usize) -> Self {
        let divide = |path: Path| {
            let steps = cells(path.length(), edge, fewest);
            (path, steps)
        };
        Self { pieces: pieces.into_iter().map(divide).collect() }
    }

    /// Rows of cells.
    pub(crate) fn rows(&self) -> usize {
        self.pieces.iter().map(|(_, steps)| steps).sum()
    }

    /// The first row of a piece, and its number of rows.
    pub(crate) fn piece(&self, index: usize) -> (usize, usize) {
        (self.pieces[..index].iter().map(|(_, steps)| steps).sum(), self.pieces[index].1)
    }

    /// The (radius, height) of a node row; rows may be fractions.
    pub(crate) fn at(&self, row: f64) -> DVec2 {
        let mut within = row;
        for (path, steps) in &self.pieces {
            if within <= *steps as f64 {
                return path.at(within / *steps as f64).0;
            }
            within -= *steps as f64;
        }
        self.pieces.last().map_or(DVec2::ZERO, |(path, _)| path.at(1.0).0)
    }
}

/// A grid around an axis.
pub(crate) struct Lathe {
    pub(crate) around: usize,
    pub(crate) rows: usize,
    /// Cells left out, as (around, row); a window does not reach over the first column.
    pub(crate) windows: Vec<Window>,
}

/// The borders of a turned surface.
pub(crate) struct Borders {
    pub(crate) first: Vec<u32>,
    pub(crate) last: Vec<u32>,
    /// In the order of [`Window::nodes`].
    pub(crate) windows: Vec<Vec<u32>>,
}

impl Lathe {
    /// Number of triangles.
    pub(crate) fn triangles(&self) -> usize {
        2 * self.around * self.rows - 2 * self.windows.iter().map(Window::cells).sum::<usize>()
    }

    /// Adds the surface to a mesh. `place` gets the column (its turn is column / `around`) and the row of a
    /// node.
    pub(crate) fn build(&self, mesh: &mut Stitched, place: impl Fn(usize, usize) -> DVec3) -> Borders {
        let rings: Vec<Vec<u32>> = (0..=self.rows)
            .map(|row| {
                (0..self.around)
                    .map(|column| {
                        let open = self.windows.iter().any(|window| window.holds_node(column, row));
                        if open { u32::MAX } else { mesh.vertex(place(column, row)) }
                    })
                    .collect()
            })
            .collect();
        for row in 0..self.rows {
            for column in 0..self.around {
                if !self.windows.iter().any(|window| window.holds_cell(column, row)) {
                    let next = (column + 1) % self.around;
                    let (low, high) = (&rings[row], &rings[row + 1]);
                    mesh.quad([low[column], low[next], high[next], high[column]]);
                }
            }
        }
        let border = |window: &Window| window.nodes().map(|[column, row]| rings[row][column]).collect();
        Borders {
            windows: self.windows.iter().map(border).collect(),
            first: rings[0].clone(),
            last: rings[self.rows].clone(),
        }
    }
}
