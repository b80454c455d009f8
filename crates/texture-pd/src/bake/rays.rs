//! Displacements of the texels of a chart, by rays to the detailed mesh.

use super::atlas::{Chart, MARGIN};
use super::sheet::{Sheet, is_inside};
use super::tree::{Hit, Tree};

/// Hits at a smaller cosine between normal and direction are left out beyond the triangle: there the detailed surface
/// turns away, over an edge that the coarse one has as well, and what it does next is not this triangle's.
const LEAST_FACING: f64 = 0.1;

/// Directions that are extrapolated beyond the triangle may lean this much more than those of its corners.
const LEAST_LEAN: f64 = 0.5;

/// Hits that are nearer to each other than this part of the reach are one.
const SAME: f64 = 1e-6;

/// Directions that are shorter have none.
const SHORTEST: f64 = 1e-6;

/// What looks from the coarse mesh for the detailed one.
pub(super) struct Caster<'a> {
    pub detailed: &'a Tree<'a>,
    /// How far to look, m.
    pub reach: f64,
}

/// What was found for a row of texels of a chart.
#[derive(Clone, Debug, Default)]
pub(super) struct Row {
    /// Column of the first in the chart's grid.
    pub first: usize,
    /// Displacements, m; not a number where no ray hit.
    pub heights: Vec<f64>,
    /// Texels in the triangle without a hit.
    pub missed: usize,
    /// Texels in the triangle with several.
    pub folded: usize,
}

impl Caster<'_> {
    /// Casts the rays of a row of a chart's grid.
    pub fn row(&self, chart: &Chart, sheet: &Sheet, row: i32) -> Row {
        let Some([first, last]) = chart.span(row, MARGIN) else { return Row::default() };
        let mut found = Row { first: first as usize, ..Row::default() };
        let lean = sheet.directions.map(|direction| direction.dot(sheet.normal));
        let least = LEAST_LEAN * lean[0].min(lean[1]).min(lean[2]).max(0.0);
        let mut hits = Vec::new();
        for column in first..=last {
            let at = chart.weights(f64::from(column), f64::from(row));
            let inside = is_inside(at, 0.0);
            let leans = !inside && sheet.direction(at).dot(sheet.normal) <= least;
            self.cast(sheet, if leans { sheet.confined(at) } else { at }, &mut hits);
            if !inside {
                hits.retain(|hit| hit.facing >= LEAST_FACING);
            }
            let height = nearest(&hits);
            found.missed += usize::from(inside && height.is_none());
            found.folded += usize::from(inside && self.several(sheet, at, &hits));
            found.heights.push(height.unwrap_or(f64::NAN));
        }
        found
    }

    fn cast(&self, sheet: &Sheet, at: [f64; 2], hits: &mut Vec<Hit>) {
        let direction = sheet.direction(at);
        let length = direction.length();
        if length > SHORTEST {
            self.detailed.hits(sheet.base(at), direction, self.reach / length, hits);
        } else {
            hits.clear();
        }
    }

    /// Whether hits are apart, so that there the surface is no height field.
    fn several(&self, sheet: &Sheet, at: [f64; 2], hits: &[Hit]) -> bool {
        let range = hits.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], hit| {
            [low.min(hit.along), high.max(hit.along)]
        });
        (range[1] - range[0]) * sheet.direction(at).length() > SAME * self.reach
    }
}

/// The displacement to the hit that is nearest to the coarse surface; outside of it if there are two.
fn nearest(hits: &[Hit]) -> Option<f64> {
    let order =
        |a: &&Hit, b: &&Hit| a.along.abs().total_cmp(&b.along.abs()).then(b.along.total_cmp(&a.along));
    hits.iter().min_by(order).map(|hit| hit.along)
}
