//! Selection of the hits of a chart's rays that belong to its triangle's surface.
//!
//! Past a sharp edge of the coarse mesh, or its border, a ray may hit the surface of another triangle: around
//! the corner of a box it hits the relief of the next face, millimetres below. Such a value next to the
//! triangle's own makes a step that the surface does not have, and the spline rings there. So hits at these
//! texels count only if the surface continues to them from texels that are settled.

use glam::DVec3;
use palpate_core::TriMesh;

use super::atlas::Chart;
use super::rays::{MIN_FACING, Row};
use super::sheet::Sheet;

/// Tolerance of the height against a surface with one bend between two neighbouring rays, texels.
const HEIGHT_TOLERANCE: f64 = 0.5;

/// Distance along rows and columns, in texels, from all settled texels beyond which a texel without a hit
/// gets the height of the nearest point, instead of being extrapolated.
const EXTRAPOLATED_TEXELS: i32 = 2;

/// Smallest cosine between the normals at two neighbouring texels outside of the triangle. At smaller ones
/// the surface ends there.
const MIN_NORMAL_COSINE: f64 = 0.8;

/// Index of a triangle for texels without one.
const NONE: u32 = u32::MAX;

/// Offsets of the eight neighbours of a texel.
const AROUND: [[i32; 2]; 8] = [[-1, -1], [0, -1], [1, -1], [-1, 0], [1, 0], [-1, 1], [0, 1], [1, 1]];

/// Settled texels of a chart.
pub(super) struct Settled {
    /// Displacements, m; NaN where none is known.
    pub heights: Vec<f64>,
    /// Number of texels in the triangle whose hits belong to other triangles.
    pub dropped: usize,
}

/// Settles the hits of a chart's rays; `texel` is the size of a texel, m.
pub(super) fn settle(chart: &Chart, sheet: &Sheet, rows: &[Row], detailed: &TriMesh, texel: f64) -> Settled {
    // Texels with an unambiguous hit are settled from the start.
    let mut grid = Grid::new(chart, sheet, detailed, texel);
    for (y, row) in rows.iter().enumerate() {
        for (x, (height, triangle)) in row.heights.iter().zip(&row.triangles).enumerate() {
            let at = y * grid.width + row.first + x;
            (grid.heights[at], grid.triangles[at]) = (*height, *triangle);
        }
    }
    let holes: Vec<(usize, f64)> = rows
        .iter()
        .enumerate()
        .flat_map(|(y, row)| {
            let first = y * chart.size.x as usize;
            row.holes.iter().map(move |(column, height)| (first + column, *height))
        })
        .collect();
    let mut loose: Vec<Candidate> = rows
        .iter()
        .enumerate()
        .flat_map(|(y, row)| {
            let first = y * chart.size.x as usize;
            row.loose.iter().map(move |hit| Candidate {
                at: first + hit.column,
                height: hit.height,
                triangle: hit.triangle,
                inside: hit.inside,
            })
        })
        .collect();
    // Loose hits are settled from neighbour to neighbour until no more can be reached.
    if grid.heights.iter().all(|height| height.is_nan()) {
        grid.seed(&loose);
    }
    loop {
        loose.retain(|hit| grid.heights[hit.at].is_nan());
        if !grid.settle_neighbours(&loose) {
            break;
        }
    }
    // The rest belongs to other triangles. `loose` is in the order of texels, so duplicates are adjacent.
    let mut dropped: Vec<usize> = loose.iter().filter(|hit| hit.inside).map(|hit| hit.at).collect();
    dropped.dedup();
    let far: Vec<(usize, f64)> = holes.into_iter().filter(|(at, _)| grid.is_far(*at)).collect();
    for (at, height) in far {
        grid.heights[at] = height;
    }
    Settled { heights: grid.heights, dropped: dropped.len() }
}

/// A hit at a texel that is past a sharp edge, or next to such a texel.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    at: usize,
    height: f64,
    triangle: u32,
    inside: bool,
}

/// Texels of a chart while hits are settled.
struct Grid<'a> {
    chart: &'a Chart,
    sheet: &'a Sheet,
    detailed: &'a TriMesh,
    texel: f64,
    width: usize,
    heights: Vec<f64>,
    /// Triangles of the detailed mesh that the heights are on.
    triangles: Vec<u32>,
}

impl<'a> Grid<'a> {
    fn new(chart: &'a Chart, sheet: &'a Sheet, detailed: &'a TriMesh, texel: f64) -> Self {
        let (width, texels) = (chart.size.x as usize, (chart.size.x * chart.size.y) as usize);
        let (heights, triangles) = (vec![f64::NAN; texels], vec![NONE; texels]);
        Self { chart, sheet, detailed, texel, width, heights, triangles }
    }

    fn weights(&self, at: usize) -> [f64; 2] {
        self.chart.weights((at % self.width) as f64, (at / self.width) as f64)
    }

    /// Settles the nearest hits in the triangle, if no texel is settled.
    fn seed(&mut self, loose: &[Candidate]) {
        for hit in loose.iter().filter(|hit| hit.inside) {
            let known = &mut self.heights[hit.at];
            if known.is_nan() || hit.height.abs() < known.abs() {
                (*known, self.triangles[hit.at]) = (hit.height, hit.triangle);
            }
        }
    }

    /// Settles the hits to which the surface continues from neighbouring texels. Returns whether there were
    /// any.
    fn settle_neighbours(&mut self, loose: &[Candidate]) -> bool {
        let mut best: Vec<(f64, Candidate)> = Vec::new();
        for hit in loose {
            let Some(step) = self.smallest_step(hit) else { continue };
            match best.last_mut().filter(|(_, last)| last.at == hit.at) {
                Some(last) if step < last.0 => *last = (step, *hit),
                Some(_) => {}
                None => best.push((step, *hit)),
            }
        }
        for (_, hit) in &best {
            (self.heights[hit.at], self.triangles[hit.at]) = (hit.height, hit.triangle);
        }
        !best.is_empty()
    }

    /// Returns the smallest step in height from a neighbouring texel from which the surface continues to a
    /// hit, m.
    fn smallest_step(&self, hit: &Candidate) -> Option<f64> {
        let neighbours = AROUND.iter().filter_map(|step| self.toward(hit.at, *step));
        let steps = neighbours.filter_map(|from| {
            let (height, triangle) = (self.heights[from], self.triangles[from]);
            if height.is_nan() || triangle == NONE {
                return None;
            }
            if !hit.inside && self.normal(triangle).dot(self.normal(hit.triangle)) < MIN_NORMAL_COSINE {
                return None;
            }
            // Rise of the surface from one texel to the other, along the triangle of each.
            let along = self.height_of(triangle, hit.at)? - height;
            let back = hit.height - self.height_of(hit.triangle, from)?;
            self.height_of(triangle, from)?;
            let rise = hit.height - height;
            let slack = HEIGHT_TOLERANCE * self.texel;
            let continues = rise >= along.min(back) - slack && rise <= along.max(back) + slack;
            continues.then_some(rise.abs())
        });
        steps.min_by(f64::total_cmp)
    }

    /// Returns the displacement to the plane of a detailed triangle at a texel, m; `None` if it is seen
    /// edge-on.
    fn height_of(&self, triangle: u32, at: usize) -> Option<f64> {
        let weights = self.weights(at);
        let (base, direction) = (self.sheet.base(weights), self.sheet.direction(weights));
        let (normal, corner) = (self.normal(triangle), self.detailed.corners(triangle as usize)[0]);
        let rate = normal.dot(direction);
        (rate >= MIN_FACING * direction.length()).then(|| normal.dot(corner - base) / rate)
    }

    fn normal(&self, triangle: u32) -> DVec3 {
        let [a, b, c] = self.detailed.corners(triangle as usize);
        (b - a).cross(c - a).normalize_or_zero()
    }

    /// Returns a texel's neighbour, if it is in the grid.
    fn toward(&self, at: usize, [dx, dy]: [i32; 2]) -> Option<usize> {
        let (x, y) = ((at % self.width) as i32 + dx, (at / self.width) as i32 + dy);
        let inside = (0..self.chart.size.x).contains(&x) && (0..self.chart.size.y).contains(&y);
        inside.then(|| y as usize * self.width + x as usize)
    }

    /// Returns whether no texel within [`EXTRAPOLATED_TEXELS`] of one is settled.
    fn is_far(&self, at: usize) -> bool {
        let steps = || -EXTRAPOLATED_TEXELS..=EXTRAPOLATED_TEXELS;
        let mut near = steps().flat_map(|dy| steps().map(move |dx| [dx, dy]));
        near.all(|step| self.toward(at, step).is_none_or(|at| self.heights[at].is_nan()))
    }
}
