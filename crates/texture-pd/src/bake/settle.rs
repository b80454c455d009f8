//! Which hits of a chart's rays belong to its triangle's surface.
//!
//! Past a sharp edge of the coarse mesh, or its border, a ray may meet a surface that is another triangle's: around the
//! corner of a box it meets the relief of the next face, millimetres below. Such a value next to those of the triangle
//! itself is a step where there is none, and the spline rings and sags there. So what is found at these texels is taken
//! only where the surface goes on to it from texels that are settled.

use glam::DVec3;
use palpate_core::TriMesh;

use super::atlas::Chart;
use super::rays::{LEAST_FACING, Row};
use super::sheet::Sheet;

/// By how much, in texels, the height may differ from that on a surface with one bend between two rays.
const SLACK: f64 = 0.5;

/// Texels without a hit that are farther (along rows and columns) from all with one get the height of the nearest point.
const EXTRAPOLATED: i32 = 2;

/// Past the triangle the surface ends where its normals at two texels turn by more (cosine).
const STRAIGHT: f64 = 0.8;

const NONE: u32 = u32::MAX;

/// The eight texels around one.
const AROUND: [[i32; 2]; 8] = [[-1, -1], [0, -1], [1, -1], [-1, 0], [1, 0], [-1, 1], [0, 1], [1, 1]];

/// A chart's texels.
pub(super) struct Settled {
    /// Displacements, m; not a number where none is known.
    pub heights: Vec<f64>,
    /// Texels in the triangle whose hits belong elsewhere.
    pub dropped: usize,
}

/// Settles what the rays of a chart have found, with texels of a size, m.
pub(super) fn settle(chart: &Chart, sheet: &Sheet, rows: &[Row], detailed: &TriMesh, texel: f64) -> Settled {
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
    if grid.heights.iter().all(|height| height.is_nan()) {
        grid.seed(&loose);
    }
    loop {
        loose.retain(|hit| grid.heights[hit.at].is_nan());
        if !grid.go_on(&loose) {
            break;
        }
    }
    let mut dropped: Vec<usize> = loose.iter().filter(|hit| hit.inside).map(|hit| hit.at).collect();
    dropped.dedup();
    let far: Vec<(usize, f64)> = holes.into_iter().filter(|(at, _)| grid.is_far(*at)).collect();
    for (at, height) in far {
        grid.heights[at] = height;
    }
    Settled { heights: grid.heights, dropped: dropped.len() }
}

/// A hit at a texel past a sharp edge or next to one that is.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    at: usize,
    height: f64,
    triangle: u32,
    inside: bool,
}

struct Grid<'a> {
    chart: &'a Chart,
    sheet: &'a Sheet,
    detailed: &'a TriMesh,
    texel: f64,
    width: usize,
    heights: Vec<f64>,
    /// Of the detailed mesh, where the height is.
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

    /// Settles the nearest hits in the triangle, for want of others.
    fn seed(&mut self, loose: &[Candidate]) {
        for hit in loose.iter().filter(|hit| hit.inside) {
            let known = &mut self.heights[hit.at];
            if known.is_nan() || hit.height.abs() < known.abs() {
                (*known, self.triangles[hit.at]) = (hit.height, hit.triangle);
            }
        }
    }

    /// Settles those hits to which the surface goes on from texels next to theirs; tells whether there were any.
    fn go_on(&mut self, loose: &[Candidate]) -> bool {
        let mut best: Vec<(f64, Candidate)> = Vec::new();
        for hit in loose {
            let Some(off) = self.off(hit) else { continue };
            match best.last_mut().filter(|(_, last)| last.at == hit.at) {
                Some(last) if off < last.0 => *last = (off, *hit),
                Some(_) => {}
                None => best.push((off, *hit)),
            }
        }
        for (_, hit) in &best {
            (self.heights[hit.at], self.triangles[hit.at]) = (hit.height, hit.triangle);
        }
        !best.is_empty()
    }

    /// The least difference in height from a texel next to a hit's from which the surface goes on to it.
    fn off(&self, hit: &Candidate) -> Option<f64> {
        let neighbours = AROUND.iter().filter_map(|step| self.toward(hit.at, *step));
        let offs = neighbours.filter_map(|from| {
            let (height, triangle) = (self.heights[from], self.triangles[from]);
            if height.is_nan() || triangle == NONE {
                return None;
            }
            if !hit.inside && self.normal(triangle).dot(self.normal(hit.triangle)) < STRAIGHT {
                return None;
            }
            // How far the surface rises from the one texel to the other along either's triangle.
            let along = self.height_of(triangle, hit.at)? - height;
            let back = hit.height - self.height_of(hit.triangle, from)?;
            self.height_of(triangle, from)?;
            let rise = hit.height - height;
            let slack = SLACK * self.texel;
            let goes_on = rise >= along.min(back) - slack && rise <= along.max(back) + slack;
            goes_on.then_some(rise.abs())
        });
        offs.min_by(f64::total_cmp)
    }

    /// The displacement to the plane of a detailed triangle at a texel, m; none if it is seen too much edge on.
    fn height_of(&self, triangle: u32, at: usize) -> Option<f64> {
        let weights = self.weights(at);
        let (base, direction) = (self.sheet.base(weights), self.sheet.direction(weights));
        let (normal, corner) = (self.normal(triangle), self.detailed.corners(triangle as usize)[0]);
        let rate = normal.dot(direction);
        (rate >= LEAST_FACING * direction.length()).then(|| normal.dot(corner - base) / rate)
    }

    fn normal(&self, triangle: u32) -> DVec3 {
        let [a, b, c] = self.detailed.corners(triangle as usize);
        (b - a).cross(c - a).normalize_or_zero()
    }

    fn toward(&self, at: usize, [dx, dy]: [i32; 2]) -> Option<usize> {
        let (x, y) = ((at % self.width) as i32 + dx, (at / self.width) as i32 + dy);
        let inside = (0..self.chart.size.x).contains(&x) && (0..self.chart.size.y).contains(&y);
        inside.then(|| y as usize * self.width + x as usize)
    }

    /// Whether no texel near one is settled.
    fn is_far(&self, at: usize) -> bool {
        let steps = || -EXTRAPOLATED..=EXTRAPOLATED;
        let mut near = steps().flat_map(|dy| steps().map(move |dx| [dx, dy]));
        near.all(|step| self.toward(at, step).is_none_or(|at| self.heights[at].is_nan()))
    }
}
