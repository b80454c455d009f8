//! Displacements of the texels of a chart, by rays to the detailed mesh.

use super::atlas::{Chart, MARGIN};
use super::sheet::{Sheet, is_inside};
use super::smooth::SmoothEdges;
use super::tree::{Hit, Tree};

/// Hits at a smaller cosine between normal and direction are left out beyond the triangle: there the detailed surface
/// turns away, over an edge that the coarse one has as well, and what it does next is not this triangle's.
pub(super) const LEAST_FACING: f64 = 0.1;

/// Directions that are extrapolated beyond the triangle may lean this much more than those of its corners.
const LEAST_LEAN: f64 = 0.5;

/// Hits that are nearer to each other than this part of the reach are one.
const SAME: f64 = 1e-6;

/// Directions that are shorter have none.
const SHORTEST: f64 = 1e-6;

/// More than the distance of two texels that touch, in texels.
const DIAGONAL: f64 = 1.5;

/// What looks from the coarse mesh for the detailed one.
pub(super) struct Caster<'a> {
    pub detailed: &'a Tree<'a>,
    pub sheets: &'a [Sheet],
    pub smooth: &'a SmoothEdges,
    /// Size of a texel, m.
    pub texel: f64,
    /// How far to look, m.
    pub reach: f64,
}

/// What was found for a row of texels of a chart.
#[derive(Clone, Debug, Default)]
pub(super) struct Row {
    /// Column of the first in the chart's grid.
    pub first: usize,
    /// Displacements, m; not a number where no ray hit, and where hits are loose.
    pub heights: Vec<f64>,
    /// Of the detailed mesh, that were hit there.
    pub triangles: Vec<u32>,
    /// All hits at texels past a sharp edge or next to one that is, by column.
    pub loose: Vec<Loose>,
    /// Columns of other texels without a hit, and how far along the direction the nearest point of the detailed mesh is.
    pub holes: Vec<(usize, f64)>,
    /// Texels in the triangle without a hit.
    pub missed: usize,
    /// Texels in the triangle with several.
    pub folded: usize,
}

/// A hit that may belong to another triangle's surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Loose {
    pub column: usize,
    /// Displacement, m.
    pub height: f64,
    /// Of the detailed mesh.
    pub triangle: u32,
    /// Whether its texel is in the triangle.
    pub inside: bool,
}

/// Whether texels of a row, the one before and the one after are past a sharp edge or the border, where that was asked.
struct Ends {
    /// Column of the first.
    first: i32,
    known: Vec<[Option<bool>; 3]>,
}

impl Caster<'_> {
    /// Casts the rays of a row of a chart's grid.
    pub fn row(&self, chart: &Chart, row: i32) -> Row {
        let Some([first, last]) = chart.span(row, MARGIN) else { return Row::default() };
        let sheet = &self.sheets[chart.triangle];
        let mut found = Row { first: first as usize, ..Row::default() };
        let lean = sheet.directions.map(|direction| direction.dot(sheet.normal));
        let least = LEAST_LEAN * lean[0].min(lean[1]).min(lean[2]).max(0.0);
        let mut hits = Vec::new();
        let mut ends = Ends { first: first - 1, known: vec![[None; 3]; (last - first + 3).max(0) as usize] };
        for column in first..=last {
            let at = chart.weights(f64::from(column), f64::from(row));
            let inside = is_inside(at, 0.0);
            let leans = !inside && sheet.direction(at).dot(sheet.normal) <= least;
            let from = if leans { sheet.confined(at) } else { at };
            self.cast(sheet, from, &mut hits);
            found.folded += usize::from(inside && self.several(sheet, at, &hits));
            let is_loose = self.is_loose(chart, [column, row], inside, &mut ends);
            let is_hole = hits.is_empty();
            if !inside || is_loose {
                hits.retain(|hit| hit.facing >= LEAST_FACING);
            }
            found.missed += usize::from(inside && hits.is_empty());
            let hit = nearest(&hits).filter(|_| !is_loose);
            found.heights.push(hit.map_or(f64::NAN, |hit| hit.along));
            found.triangles.push(hit.map_or(0, |hit| hit.triangle));
            let column = column as usize;
            if is_loose {
                let loose = |hit: &Hit| Loose { column, height: hit.along, triangle: hit.triangle, inside };
                found.loose.extend(hits.iter().map(loose));
            } else if is_hole {
                found.holes.extend(self.toward_nearest(sheet, from).map(|height| (column, height)));
            }
        }
        found
    }

    /// Whether a texel, or one next to it, is past a sharp edge or the border of the coarse mesh.
    fn is_loose(&self, chart: &Chart, [column, row]: [i32; 2], inside: bool, ends: &mut Ends) -> bool {
        let sheet = &self.sheets[chart.triangle];
        let at = |[dx, dy]: [i32; 2]| chart.weights(f64::from(column + dx), f64::from(row + dy));
        let deep = |distance: f64| distance > DIAGONAL * self.texel;
        if inside && sheet.distances(at([0, 0])).into_iter().all(deep) {
            return false;
        }
        let mut around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| [dx, dy]));
        around.any(|[dx, dy]| {
            let known = &mut ends.known[(column + dx - ends.first) as usize][(dy + 1) as usize];
            *known.get_or_insert_with(|| !self.smooth.reach(self.sheets, chart.triangle, at([dx, dy])))
        })
    }

    /// How far along the direction the nearest point of the detailed mesh is.
    fn toward_nearest(&self, sheet: &Sheet, at: [f64; 2]) -> Option<f64> {
        let (base, direction) = (sheet.base(at), sheet.direction(at));
        let length = direction.length();
        let nearest = self.detailed.nearest(base).filter(|_| length > SHORTEST)?;
        let along = (nearest.point - base).dot(direction) / (length * length);
        Some(along.clamp(-self.reach / length, self.reach / length))
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

/// The hit that is nearest to the coarse surface; outside of it if there are two.
fn nearest(hits: &[Hit]) -> Option<&Hit> {
    let order =
        |a: &&Hit, b: &&Hit| a.along.abs().total_cmp(&b.along.abs()).then(b.along.total_cmp(&a.along));
    hits.iter().min_by(order)
}
