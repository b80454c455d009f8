//! Stitching: makes the displaced surfaces of neighbouring triangles meet.
//!
//! Each chart samples the detailed surface at its own texels, so the splines of two charts differ at a shared
//! edge: by little where the surface is smooth, and by up to the height of a step. Kaczmarz's method makes
//! them meet by the smallest change of the coefficients on both sides of all smooth edges (as for the seams
//! of colour textures: Liu, Ferguson, Jacobson, Gingold, *Seamless*, 2017).

use super::atlas::{Atlas, Chart};
use super::sheet::Sheet;
use super::smooth::{Side, SmoothEdges};

/// Number of points per texel of the length of a shared edge.
const POINTS_PER_TEXEL: f64 = 2.0;

/// Maximum number of points along an edge.
const MAX_POINTS: f64 = 65_536.0;

/// Number of passes over all points, each forwards and backwards. Fewer leave larger gaps.
const PASSES: usize = 16;

/// A point of a chart in terms of the image's coefficients.
#[derive(Clone, Copy)]
struct Spot {
    /// Index of the first of the 4 × 4 coefficients around it.
    first: u32,
    /// Position between the second and the third coefficient, from 0 to 1, along a row and across.
    part: [f64; 2],
}

/// Changes the coefficients of an image with rows of `width` so that surfaces meet.
pub(super) fn stitch(
    atlas: &Atlas,
    sheets: &[Sheet],
    smooth: &SmoothEdges,
    coefficients: &mut [f64],
    width: usize,
) {
    let mut charts: Vec<Option<&Chart>> = vec![None; sheets.len()];
    for chart in &atlas.charts {
        charts[chart.triangle] = Some(chart);
    }
    let points: Vec<[Spot; 2]> = smooth
        .edges
        .iter()
        .flat_map(|sides| {
            let [from, to] = sides[0].ends.map(|corner| sheets[sides[0].triangle].corners[corner]);
            let steps =
                (POINTS_PER_TEXEL * from.distance(to) / atlas.texel).ceil().clamp(2.0, MAX_POINTS) as usize;
            let charts = &charts;
            (0..=steps).filter_map(move |step| {
                let share = step as f64 / steps as f64;
                let spot = |side: &Side| Some(Spot::new(charts[side.triangle]?, side.along(share), width));
                Some([spot(&sides[0])?, spot(&sides[1])?])
            })
        })
        .collect();
    for _ in 0..PASSES {
        for point in points.iter().chain(points.iter().rev()) {
            close(point, coefficients, width);
        }
    }
}

/// Makes both sides meet at a point by the smallest change of coefficients.
///
/// The constraint is w_a · c_a − w_b · c_b = 0. Kaczmarz's projection adds (h_b − h_a) / (|w_a|² + |w_b|²)
/// times w_a to c_a, and subtracts that times w_b from c_b.
fn close(sides: &[Spot; 2], coefficients: &mut [f64], width: usize) {
    let weights = sides.map(|spot| spot.part.map(weights));
    let [here, there] = [0, 1].map(|side| sides[side].value(&weights[side], coefficients, width));
    let square = |line: &[f64; 4]| line.iter().map(|weight| weight * weight).sum::<f64>();
    let squares: f64 = weights.iter().map(|[along, across]| square(along) * square(across)).sum();
    let change = (there - here) / squares;
    sides[0].change(&weights[0], coefficients, width, change);
    sides[1].change(&weights[1], coefficients, width, -change);
}

impl Spot {
    fn new(chart: &Chart, at: [f64; 2], width: usize) -> Self {
        let texel = chart.texel(at);
        let corner = texel.floor();
        let first = corner.as_ivec2() - 1;
        Self {
            first: (first.y as usize * width + first.x as usize) as u32,
            part: (texel - corner).to_array(),
        }
    }

    /// Returns the spline's value from the weights of coefficients along a row and across.
    fn value(self, [along, across]: &[[f64; 4]; 2], coefficients: &[f64], width: usize) -> f64 {
        let mut value = 0.0;
        for (row, across) in across.iter().enumerate() {
            let first = self.first as usize + row * width;
            let line = &coefficients[first..first + 4];
            value +=
                across * line.iter().zip(along).map(|(coefficient, along)| coefficient * along).sum::<f64>();
        }
        value
    }

    /// Adds to each coefficient its weight times a change.
    fn change(self, [along, across]: &[[f64; 4]; 2], coefficients: &mut [f64], width: usize, change: f64) {
        for (row, across) in across.iter().enumerate() {
            let first = self.first as usize + row * width;
            for (coefficient, along) in coefficients[first..first + 4].iter_mut().zip(along) {
                *coefficient += change * across * along;
            }
        }
    }
}

/// Returns the B-spline weights of the four coefficients around a point at x between the second and the
/// third.
fn weights(x: f64) -> [f64; 4] {
    let y = 1.0 - x;
    [
        y * y * y / 6.0,
        2.0 / 3.0 - x * x * (1.0 - x / 2.0),
        2.0 / 3.0 - y * y * (1.0 - y / 2.0),
        x * x * x / 6.0,
    ]
}
