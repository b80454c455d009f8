//! Displacements of the texels of a chart, from rays to the detailed mesh.

use super::atlas::{Chart, MARGIN};
use super::sheet::{Sheet, is_inside};
use super::smooth::SmoothEdges;
use super::tree::{Hit, Tree};

/// Smallest cosine between a hit's normal and the ray's direction outside of the triangle. At smaller ones
/// the detailed surface turns away over an edge that the coarse mesh has as well, and belongs to another
/// triangle.
pub(super) const MIN_FACING: f64 = 0.1;

/// Smallest ratio of the normal component of an extrapolated direction to that of the triangle's corners.
/// Beyond the triangle directions lean more, and rays along the plane would hit far away.
const MIN_LEAN_RATIO: f64 = 0.5;

/// Distance between hits below which they count as one, as a part of the reach.
const MIN_HIT_DISTANCE: f64 = 1e-6;

/// Length of a direction below which no ray is cast.
const MIN_DIRECTION_LENGTH: f64 = 1e-6;

/// Upper bound of the distance between neighbouring texels, √2, in texels.
const MAX_NEIGHBOUR_DISTANCE: f64 = 1.5;

/// Casts rays from the coarse mesh to the detailed one.
pub(super) struct Caster<'a> {
    pub detailed: &'a Tree<'a>,
    pub sheets: &'a [Sheet],
    pub smooth: &'a SmoothEdges,
    /// Size of a texel, m.
    pub texel: f64,
    /// Length of rays to either side, m.
    pub reach: f64,
}

/// Hits for a row of texels of a chart.
#[derive(Clone, Debug, Default)]
pub(super) struct Row {
    /// Column of the first texel in the chart's grid.
    pub first: usize,
    /// Displacements, m; NaN where the ray hit nothing, and where hits are loose.
    pub heights: Vec<f64>,
    /// Triangles of the detailed mesh that were hit.
    pub triangles: Vec<u32>,
    /// Hits at texels that are past a sharp edge, or next to such a texel, by column.
    pub loose: Vec<Loose>,
    /// Columns of other texels without a hit, and the height of the nearest point of the detailed mesh along
    /// the direction.
    pub holes: Vec<(usize, f64)>,
    /// Number of texels in the triangle without a hit.
    pub missed: usize,
    /// Number of texels in the triangle with several hits.
    pub folded: usize,
}

/// A hit that may belong to another triangle's surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Loose {
    pub column: usize,
    /// Displacement, m.
    pub height: f64,
    /// Triangle of the detailed mesh.
    pub triangle: u32,
    /// Whether the texel is in the coarse triangle.
    pub inside: bool,
}

/// Cache for texels of a row and of the rows before and after: whether each is past a sharp edge or the
/// border.
struct Ends {
    /// Column of the first texel.
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
        let least = MIN_LEAN_RATIO * lean[0].min(lean[1]).min(lean[2]).max(0.0);
        let mut hits = Vec::new();
        let mut ends = Ends { first: first - 1, known: vec![[None; 3]; (last - first + 3).max(0) as usize] };
        for column in first..=last {
            let at = chart.weights(f64::from(column), f64::from(row));
            let inside = is_inside(at, 0.0);
            // Outside of the triangle extrapolated directions may lean too far; the ray then starts at its
            // border.
            let leans = !inside && sheet.direction(at).dot(sheet.normal) <= least;
            let from = if leans { sheet.confined(at) } else { at };
            self.cast(sheet, from, &mut hits);
            found.folded += usize::from(inside && self.several(sheet, at, &hits));
            let is_loose = self.is_loose(chart, [column, row], inside, &mut ends);
            // Where the surface may belong to another triangle, hits have to face the ray more directly.
            let is_hole = hits.is_empty();
            if !inside || is_loose {
                hits.retain(|hit| hit.facing >= MIN_FACING);
            }
            found.missed += usize::from(inside && hits.is_empty());
            let hit = nearest(&hits).filter(|_| !is_loose);
            found.heights.push(hit.map_or(f64::NAN, |hit| hit.along));
            found.triangles.push(hit.map_or(0, |hit| hit.triangle));
            // Loose hits are settled later, with the whole chart; holes fall back on the nearest point.
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

    /// Returns whether a texel or one of its neighbours is past a sharp edge or the border of the coarse
    /// mesh.
    fn is_loose(&self, chart: &Chart, [column, row]: [i32; 2], inside: bool, ends: &mut Ends) -> bool {
        let sheet = &self.sheets[chart.triangle];
        let at = |[dx, dy]: [i32; 2]| chart.weights(f64::from(column + dx), f64::from(row + dy));
        let deep = |distance: f64| distance > MAX_NEIGHBOUR_DISTANCE * self.texel;
        if inside && sheet.distances(at([0, 0])).into_iter().all(deep) {
            return false;
        }
        let mut around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| [dx, dy]));
        around.any(|[dx, dy]| {
            let known = &mut ends.known[(column + dx - ends.first) as usize][(dy + 1) as usize];
            *known.get_or_insert_with(|| !self.smooth.reach(self.sheets, chart.triangle, at([dx, dy])))
        })
    }

    /// Returns the height along the direction of the nearest point of the detailed mesh, in lengths of the
    /// direction.
    fn toward_nearest(&self, sheet: &Sheet, at: [f64; 2]) -> Option<f64> {
        let (base, direction) = (sheet.base(at), sheet.direction(at));
        let length = direction.length();
        let nearest = self.detailed.nearest(base).filter(|_| length > MIN_DIRECTION_LENGTH)?;
        let along = (nearest.point - base).dot(direction) / (length * length);
        Some(along.clamp(-self.reach / length, self.reach / length))
    }

    /// Collects the hits of the ray at a point of the triangle's plane.
    fn cast(&self, sheet: &Sheet, at: [f64; 2], hits: &mut Vec<Hit>) {
        let direction = sheet.direction(at);
        let length = direction.length();
        if length > MIN_DIRECTION_LENGTH {
            self.detailed.hits(sheet.base(at), direction, self.reach / length, hits);
        } else {
            hits.clear();
        }
    }

    /// Returns whether hits are apart, so that the surface is not a height field there.
    fn several(&self, sheet: &Sheet, at: [f64; 2], hits: &[Hit]) -> bool {
        let range = hits.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], hit| {
            [low.min(hit.along), high.max(hit.along)]
        });
        (range[1] - range[0]) * sheet.direction(at).length() > MIN_HIT_DISTANCE * self.reach
    }
}

/// Returns the hit nearest to the coarse surface; of two, the one outside.
fn nearest(hits: &[Hit]) -> Option<&Hit> {
    let order =
        |a: &&Hit, b: &&Hit| a.along.abs().total_cmp(&b.along.abs()).then(b.along.total_cmp(&a.along));
    hits.iter().min_by(order)
}
