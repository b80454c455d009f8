//! Plots with two logarithmic axes, in SVG.

use std::ops::Range;

use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint, Ranged};
use plotters::prelude::*;

use crate::plot::{COLOURS, Curve, PlotError, only_finite};

/// A logarithmic axis.
#[derive(Clone, Debug, PartialEq)]
pub struct LogAxis {
    /// Quantity and unit.
    pub name: String,
    /// Marked values, ascending. The axis covers them and the curves.
    pub marks: Vec<f64>,
}

/// Curves of positive values on logarithmic axes.
#[derive(Clone, Debug)]
pub struct LogPlot {
    /// Title above the plot.
    pub title: String,
    /// Axis from left to right.
    pub x: LogAxis,
    /// Axis from bottom to top.
    pub y: LogAxis,
    /// Curves; points that are not positive and finite are left out.
    pub curves: Vec<Curve>,
    /// Series of separate points. Together with the curves at most six, the number of colours.
    pub scattered: Vec<Curve>,
}

const SIZE: (u32, u32) = (640, 480);

/// Draws a plot as an SVG document.
///
/// # Errors
/// If there are more curves than colours, there is no point, or the plot cannot be drawn.
pub fn draw_log_log(plot: &LogPlot) -> Result<String, PlotError> {
    let mut svg = String::new();
    draw_into(&mut svg, plot).map_err(|error| PlotError::new(error.to_string()))?;
    Ok(svg)
}

/// Margin beyond the outermost points of a curve, as a factor.
const MARGIN: f64 = 1.1;

/// Range of a logarithmic axis.
struct LogRange {
    range: Range<f64>,
    marks: Vec<f64>,
}

impl LogRange {
    fn new(axis: &LogAxis, values: impl Iterator<Item = f64>) -> Result<Self, String> {
        let (low, high) = values
            .flat_map(|value| [value / MARGIN, value * MARGIN])
            .chain(axis.marks.iter().copied())
            .fold((f64::INFINITY, 0.0_f64), |(low, high), value| (low.min(value), high.max(value)));
        if low > 0.0 && low < high && high.is_finite() {
            Ok(Self { range: low..high, marks: axis.marks.clone() })
        } else {
            Err(format!("no point on the axis {}", axis.name))
        }
    }
}

impl Ranged for LogRange {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let share = (value / self.range.start).ln() / (self.range.end / self.range.start).ln();
        limit.0 + (share * f64::from(limit.1 - limit.0)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        // There are no light grid lines.
        if hint.weight().allow_light_points() { Vec::new() } else { self.marks.clone() }
    }

    fn range(&self) -> Range<f64> {
        self.range.clone()
    }
}

fn draw_into(svg: &mut String, plot: &LogPlot) -> Result<(), Box<dyn std::error::Error>> {
    let count = plot.curves.len() + plot.scattered.len();
    if count > COLOURS.len() {
        return Err(format!("{count} curves, but only {} colours", COLOURS.len()).into());
    }
    let curves: Vec<Curve> = plot.curves.iter().map(only_positive).collect();
    let scattered: Vec<Curve> = plot.scattered.iter().map(only_positive).collect();
    let points = || curves.iter().chain(&scattered).flat_map(|curve| &curve.points);
    let x = LogRange::new(&plot.x, points().map(|point| point.0))?;
    let y = LogRange::new(&plot.y, points().map(|point| point.1))?;
    let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    let mut chart = ChartBuilder::on(&root)
        .caption(&plot.title, ("sans-serif", 16))
        .margin(10)
        .x_label_area_size(40)
        .y_label_area_size(60)
        .build_cartesian_2d(x, y)?;
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .bold_line_style(RGBColor(227, 232, 237))
        .axis_style(RGBColor(90, 107, 123))
        .label_style(("sans-serif", 13))
        .x_desc(&plot.x.name)
        .y_desc(&plot.y.name)
        .draw()?;
    let mut colours = COLOURS.into_iter();
    for (Curve { name, points }, colour) in curves.into_iter().zip(&mut colours) {
        chart
            .draw_series(LineSeries::new(points, colour.stroke_width(2)))?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour));
    }
    for (Curve { name, points }, colour) in scattered.into_iter().zip(colours) {
        chart
            .draw_series(points.into_iter().map(|point| Circle::new(point, 4, colour.filled())))?
            .label(name)
            .legend(move |(x, y)| Circle::new((x + 8, y), 4, colour.filled()));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::LowerMiddle)
        .background_style(WHITE.mix(0.8))
        .label_font(("sans-serif", 13))
        .draw()?;
    drop(chart);
    root.present()?;
    Ok(())
}

fn only_positive(curve: &Curve) -> Curve {
    let mut curve = only_finite(curve);
    curve.points.retain(|(x, y)| *x > 0.0 && *y > 0.0);
    curve
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(points: Vec<(f64, f64)>) -> LogPlot {
        let axis = |name: &str| LogAxis { name: name.to_owned(), marks: vec![1.0, 10.0] };
        let curves = vec![Curve { name: "curve".to_owned(), points }];
        LogPlot { title: "title".to_owned(), x: axis("x, m"), y: axis("y, N"), curves, scattered: Vec::new() }
    }

    #[test]
    fn power_law_is_a_straight_line() {
        let svg = draw_log_log(&plot(vec![(1.0, 1.0), (2.0, 2.0), (10.0, 10.0), (0.0, 3.0)])).unwrap();
        for text in ["title", "x, m", "y, N", "curve"] {
            assert!(svg.contains(text), "{text}");
        }
        let line = svg.lines().find(|line| line.contains("stroke-width=\"2\"")).unwrap();
        let (_, rest) = line.split_once("points=\"").unwrap();
        let numbers = rest.split_once('"').unwrap().0.split([' ', ',']).filter(|text| !text.is_empty());
        let numbers: Vec<f64> = numbers.map(|text| text.parse().unwrap()).collect();
        assert_eq!(numbers.len(), 6, "{line}");
        let share = |from: usize| (numbers[2 + from] - numbers[from]) / (numbers[4 + from] - numbers[from]);
        for axis in [0, 1] {
            assert!((share(axis) - 2.0_f64.log10()).abs() < 0.01, "{line}");
        }
    }

    #[test]
    fn scattered_points_are_drawn_as_circles() {
        let mut scattered = plot(vec![(1.0, 1.0), (10.0, 10.0)]);
        let points = vec![(2.0, 3.0), (4.0, 5.0), (-1.0, 2.0)];
        scattered.scattered = vec![Curve { name: "points".to_owned(), points }];
        let svg = draw_log_log(&scattered).unwrap();
        // The legend has one more.
        assert_eq!(svg.matches("<circle").count(), 3, "{svg}");
        assert!(svg.contains("points"));
    }

    #[test]
    fn too_many_curves_are_refused() {
        let mut many = plot(vec![(1.0, 1.0)]);
        many.curves = vec![many.curves[0].clone(); 7];
        assert!(draw_log_log(&many).is_err());
    }
}
