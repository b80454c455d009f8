//! The atlas: a chart in the image for each triangle with area.
//!
//! Each triangle is laid out separately in its true shape (isometrically, all at one scale), with its longest
//! side along a row. Triangles are sorted by height and packed onto shelves. Each is pushed against the one
//! before, upright or upside down, whichever takes less space, so that slanted sides lie side by side. No two
//! triangles share a spline *coefficient* that their points use, those within two texels. Two rows and
//! columns of zeros surround all of them, so the image continues in the same way in every wrap mode.

use glam::{DVec2, IVec2};

use super::error::BakeError;
use super::sheet::Sheet;
use crate::MAX_SIDE;

/// Width of the border around a triangle with values of its own, texels. The spline is then accurate up to
/// the triangle's sides.
pub(super) const MARGIN: i32 = 5;

/// Width of the border around a triangle whose coefficients its points use, texels.
pub(super) const SUPPORT: i32 = 2;

/// Width of the border of zeros around the image, texels.
const BORDER: i32 = 2;

/// Factor by which texels are enlarged until the atlas fits.
const TEXEL_GROWTH: f64 = 1.05;

/// Maximum number of texel sizes that are tried.
const MAX_ATTEMPTS: usize = 200;

/// Expected share of the shelves' area that is in use, from which their length is estimated.
const EXPECTED_SHARE: f64 = 0.85;

/// Chart of a triangle. Its grid of texels reaches [`MARGIN`] beyond the triangle.
#[derive(Clone, Debug)]
pub(super) struct Chart {
    pub triangle: usize,
    /// Corners in texels of the grid; the first texel's centre is at (0, 0).
    pub corners: [DVec2; 3],
    /// Columns and rows of the grid.
    pub size: IVec2,
    /// Position of the grid's first texel in the image.
    pub place: IVec2,
}

/// All charts, and the image that holds them.
#[derive(Clone, Debug)]
pub(super) struct Atlas {
    pub charts: Vec<Chart>,
    /// Columns and rows of the image.
    pub size: IVec2,
    /// Size of a texel on the coarse mesh, m.
    pub texel: f64,
}

impl Chart {
    fn new(triangle: usize, sheet: &Sheet, texel: f64) -> Self {
        let lengths = [0, 1, 2].map(|k| sheet.corners[k].distance(sheet.corners[(k + 1) % 3]));
        let base = (1..3).fold(0, |longest, k| if lengths[k] > lengths[longest] { k } else { longest });
        let [a, b, c] = [0, 1, 2].map(|k| sheet.corners[(base + k) % 3]);
        let along = (b - a).normalize_or_zero();
        let apex = DVec2::new((c - a).dot(along), (c - a).reject_from(along).length()) / texel;
        // Rows go down, so that the image shows the surface as it is seen from outside.
        let laid =
            [DVec2::new(0.0, apex.y), DVec2::new(lengths[base] / texel, apex.y), DVec2::new(apex.x, 0.0)];
        let mut corners = [DVec2::ZERO; 3];
        for (k, corner) in laid.into_iter().enumerate() {
            corners[(base + k) % 3] = corner + f64::from(MARGIN);
        }
        let size = laid[1].ceil().as_ivec2() + 1 + 2 * MARGIN;
        Self { triangle, corners, size, place: IVec2::ZERO }
    }

    /// Returns the chart rotated by 180°.
    fn turned(&self) -> Self {
        let [a, b, c] = self.corners;
        let sum = a.max(b).max(c) + f64::from(MARGIN);
        Self { corners: self.corners.map(|p| sum - p), ..self.clone() }
    }

    /// Returns the first and the last texel of a row within `reach` texels of the triangle, along the row and
    /// across.
    pub fn span(&self, row: i32, reach: i32) -> Option<[i32; 2]> {
        let (y, reach) = (f64::from(row), f64::from(reach) + 1e-9);
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        let mut include = |x: f64| (low, high) = (low.min(x), high.max(x));
        for k in 0..3 {
            let (p, q) = (self.corners[k], self.corners[(k + 1) % 3]);
            if (p.y - y).abs() <= reach {
                include(p.x);
            }
            for limit in [y - reach, y + reach] {
                if (p.y - limit) * (q.y - limit) < 0.0 {
                    include(p.x + (q.x - p.x) * ((limit - p.y) / (q.y - p.y)));
                }
            }
        }
        let [first, last] = [(low - reach).ceil(), (high + reach).floor()].map(|x| x as i32);
        (low <= high).then(|| [first.max(0), last.min(self.size.x - 1)])
    }

    /// Returns the weights of the second and the third corner at a point of the grid.
    pub fn weights(&self, x: f64, y: f64) -> [f64; 2] {
        let [a, b, c] = self.corners;
        let (from, area) = (DVec2::new(x, y) - a, (b - a).perp_dot(c - a));
        [from.perp_dot(c - a) / area, (b - a).perp_dot(from) / area]
    }

    /// Returns the position in the image, in texels, at weights of the second and the third corner.
    pub fn texel(&self, [s, t]: [f64; 2]) -> DVec2 {
        let [a, b, c] = self.corners;
        a + (b - a) * s + (c - a) * t + self.place.as_dvec2()
    }

    /// Returns the triangle's area in texels.
    pub fn area(&self) -> f64 {
        let [a, b, c] = self.corners;
        (b - a).perp_dot(c - a).abs() / 2.0
    }
}

impl Atlas {
    /// Creates an atlas with texels of the given size (m) on the coarse mesh, or the next larger size that
    /// fits into the largest image.
    pub fn new(sheets: &[Sheet], texel: f64) -> Result<Self, BakeError> {
        // Lower bounds of the texel: the longest side has to fit into a row, and all triangles into the
        // image's area.
        let room = f64::from(MAX_SIDE as i32 - 2 * BORDER - 2 * MARGIN - 2);
        let longest = sheets
            .iter()
            .flat_map(|sheet| (0..3).map(|k| sheet.corners[k].distance(sheet.corners[(k + 1) % 3])));
        let mut texel = texel.max(longest.fold(0.0, f64::max) / room);
        let area: f64 = sheets
            .iter()
            .map(|sheet| {
                (sheet.corners[1] - sheet.corners[0]).cross(sheet.corners[2] - sheet.corners[0]).length()
                    / 2.0
            })
            .sum();
        texel = texel.max((area / f64::from(MAX_SIDE).powi(2)).sqrt());
        for _ in 0..MAX_ATTEMPTS {
            let charts = sheets.iter().enumerate().filter(|(_, sheet)| sheet.has_area());
            let charts: Vec<Chart> = charts.map(|(t, sheet)| Chart::new(t, sheet, texel)).collect();
            let smallest = charts.iter().all(|chart| chart.size.max_element() <= 2 + 2 * MARGIN);
            if let Some((charts, size)) = packed(charts) {
                return Ok(Self { charts, size, texel });
            }
            if smallest {
                break;
            }
            texel *= TEXEL_GROWTH;
        }
        Err(BakeError::TooManyTriangles { triangles: sheets.len() })
    }
}

/// Widths of images that are tried, as multiples of the expected side of a square image.
const WIDTH_FACTORS: [f64; 9] = [1.0, 0.8, 0.9, 1.1, 1.2, 1.3, 1.5, 1.8, f64::INFINITY];

/// Packs charts into images of several widths and returns the smallest result. `None` if all would be too
/// large.
fn packed(mut charts: Vec<Chart>) -> Option<(Vec<Chart>, IVec2)> {
    charts.sort_by_key(|chart| (std::cmp::Reverse(chart.size.y), chart.triangle));
    let forms: Vec<[Form; 2]> = charts
        .into_iter()
        .map(|chart| {
            let turned = Form::new(chart.turned());
            [Form::new(chart), turned]
        })
        .collect();
    let used: f64 = forms.iter().map(|[upright, _]| upright.texels()).sum();
    let largest = MAX_SIDE as i32;
    let widest = forms.iter().map(|[upright, _]| upright.chart.size.x).max().unwrap_or(0) + 2 * BORDER;
    if widest > largest || used > f64::from(largest).powi(2) {
        return None;
    }
    let square = (used / EXPECTED_SHARE).sqrt();
    let widths = WIDTH_FACTORS.map(|factor| (square * factor).ceil().min(f64::from(largest)) as i32);
    let shelves = widths.into_iter().map(|width| shelved(&forms, width.max(widest)));
    let fitting = shelves.filter(|(_, size)| size.max_element() <= largest);
    let (places, size) = fitting.min_by_key(|(_, size)| i64::from(size.x) * i64::from(size.y))?;
    let placed =
        |(forms, (form, place)): (&[Form; 2], (usize, IVec2))| Chart { place, ..forms[form].chart.clone() };
    Some((forms.iter().zip(places).map(placed).collect(), size))
}

/// A chart in one of its two orientations on a shelf.
struct Form {
    chart: Chart,
    /// Number of unused rows of the grid above the first used one.
    skipped: i32,
    /// First and last used coefficient of each row from there.
    spans: Vec<[i32; 2]>,
}

impl Form {
    fn new(chart: Chart) -> Self {
        let rows = || (0..chart.size.y).map(|row| chart.span(row, SUPPORT));
        let skipped = rows().take_while(Option::is_none).count() as i32;
        let spans = rows().flatten().collect();
        Self { chart, skipped, spans }
    }

    fn texels(&self) -> f64 {
        self.spans.iter().map(|[first, last]| f64::from(last - first + 1)).sum()
    }

    /// Pushes the grid to the left on a shelf as far as the free columns of each row allow. Returns its first
    /// column, and the first column after it.
    fn pushed(&self, free: &[i32]) -> (i32, i32) {
        let left = self.spans.iter().zip(free).map(|([first, _], free)| free - first).max().unwrap_or(BORDER);
        (left, left + self.spans.iter().map(|[_, last]| last + 1).max().unwrap_or(0))
    }
}

/// Packs charts onto shelves of a width. Returns the chosen orientation and position of each chart, and the
/// size of the image.
fn shelved(charts: &[[Form; 2]], width: i32) -> (Vec<(usize, IVec2)>, IVec2) {
    let mut places = Vec::with_capacity(charts.len());
    // First free column of each row of the shelf.
    let mut free: Vec<i32> = Vec::new();
    let (mut top, mut right) = (BORDER, BORDER);
    for forms in charts {
        let best = |free: &[i32]| {
            let [upright, turned] = [0, 1].map(|form| (form, forms[form].pushed(free)));
            if turned.1.1 < upright.1.1 { turned } else { upright }
        };
        // A chart that does not fit starts a new shelf, as high as its higher orientation.
        let mut chosen = best(&free);
        if free.is_empty() || chosen.1.1 > width - BORDER {
            top += free.len() as i32;
            free = vec![BORDER; forms[0].spans.len().max(forms[1].spans.len())];
            chosen = best(&free);
        }
        let (form, (left, end)) = chosen;
        let missing = forms[form].spans.len().saturating_sub(free.len());
        free.extend(std::iter::repeat_n(BORDER, missing));
        for ([_, last], free) in forms[form].spans.iter().zip(&mut free) {
            *free = left + last + 1;
        }
        right = right.max(end);
        places.push((form, IVec2::new(left, top - forms[form].skipped)));
    }
    (places, IVec2::new(right + BORDER, top + free.len() as i32 + BORDER))
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    fn random_sheets(seed: u64, count: usize) -> Vec<Sheet> {
        let mut rng = StdRng::seed_from_u64(seed);
        (0..count)
            .map(|_| {
                let corners = [0; 3].map(|_| DVec3::from_array([0; 3].map(|_| rng.random_range(-1.0..1.0))));
                Sheet::new(corners, [DVec3::Z; 3])
            })
            .collect()
    }

    #[test]
    fn no_coefficient_is_shared_and_the_border_is_free() {
        for (seed, count, texel) in [(1, 60, 0.02), (2, 200, 0.05), (3, 40, 3.0), (4, 1, 0.01)] {
            let sheets = random_sheets(seed, count);
            let atlas = Atlas::new(&sheets, texel).unwrap();
            assert_eq!(atlas.texel, texel);
            let mut owner = vec![None; (atlas.size.x * atlas.size.y) as usize];
            for chart in &atlas.charts {
                for k in 0..3 {
                    let sides =
                        [&chart.corners.map(|p| p.extend(0.0) * texel), &sheets[chart.triangle].corners];
                    let [there, here] = sides.map(|corners| corners[k].distance(corners[(k + 1) % 3]));
                    assert!((there - here).abs() < 1e-12, "seed {seed}: {chart:?}");
                }
                let [a, b, c] = chart.corners;
                assert!((b - a).perp_dot(c - a) < 0.0, "seed {seed}, seen from inside: {chart:?}");
                for row in 0..chart.size.y {
                    for column in chart.span(row, SUPPORT).map_or(0..0, |[first, last]| first..last + 1) {
                        let at = chart.place + IVec2::new(column, row);
                        assert!(at.cmpge(IVec2::splat(BORDER)).all() && at.cmplt(atlas.size - BORDER).all());
                        let owner = &mut owner[(at.y * atlas.size.x + at.x) as usize];
                        assert_eq!(*owner, None, "seed {seed}");
                        *owner = Some(chart.triangle);
                    }
                }
                // The spans contain all coefficients that points of the triangle use.
                for (s, t) in (0..21).flat_map(|i| (0..21 - i).map(move |j| (f64::from(i), f64::from(j)))) {
                    let at = chart.texel([s / 20.0, t / 20.0]).floor().as_ivec2();
                    for tap in (-1..3).flat_map(|y| (-1..3).map(move |x| at + IVec2::new(x, y))) {
                        assert_eq!(owner[(tap.y * atlas.size.x + tap.x) as usize], Some(chart.triangle));
                    }
                }
            }
        }
    }

    #[test]
    fn charts_that_do_not_fit_get_coarser_texels() {
        let sheets = random_sheets(5, 30);
        let atlas = Atlas::new(&sheets, 1e-9).unwrap();
        assert!(atlas.size.max_element() <= MAX_SIDE as i32 && atlas.texel > 1e-9);
        let used: f64 = atlas.charts.iter().map(Chart::area).sum();
        assert!(used > 0.5 * f64::from(MAX_SIDE).powi(2), "{used}");
        let tiny = vec![sheets[0].clone(); 700_000];
        assert!(matches!(Atlas::new(&tiny, 1e3), Err(BakeError::TooManyTriangles { triangles: 700_000 })));
    }
}
