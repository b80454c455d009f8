//! Draws figures as SVG.

use plotters::coord::Shift;
use plotters::prelude::*;

/// One curve.
#[derive(Clone, Debug)]
pub struct Curve {
    /// What the legend says.
    pub name: String,
    /// In the order of the first value.
    pub points: Vec<(f64, f64)>,
}

/// One plot.
#[derive(Clone, Debug)]
pub struct Figure {
    /// What it shows, to be written below it.
    pub caption: String,
    /// What the values are over, with its unit: `s` for time.
    pub across: String,
    /// Unit of the values.
    pub axis: String,
    /// At most as many as there are colours: six.
    pub curves: Vec<Curve>,
}

/// A plot could not be drawn.
#[derive(Debug, thiserror::Error)]
#[error("a plot could not be drawn: {0}")]
pub struct PlotError(String);

impl PlotError {
    pub(crate) fn new(why: String) -> Self {
        Self(why)
    }
}

const SIZE: (u32, u32) = (960, 260);
pub(crate) const COLOURS: [RGBColor; 6] = [
    RGBColor(31, 96, 168),
    RGBColor(205, 97, 30),
    RGBColor(46, 139, 87),
    RGBColor(148, 68, 158),
    RGBColor(166, 124, 0),
    RGBColor(90, 107, 123),
];

/// Figures below one another as one SVG document, without their captions.
///
/// # Errors
/// If a figure has more curves than there are colours, or cannot be drawn.
pub fn draw(figures: &[Figure]) -> Result<String, PlotError> {
    let mut svg = String::new();
    draw_into(&mut svg, figures).map_err(|error| PlotError(error.to_string()))?;
    Ok(svg)
}

fn draw_into(svg: &mut String, figures: &[Figure]) -> Result<(), Box<dyn std::error::Error>> {
    let root = SVGBackend::with_string(svg, (SIZE.0, SIZE.1 * figures.len() as u32)).into_drawing_area();
    for (area, figure) in root.split_evenly((figures.len(), 1)).iter().zip(figures) {
        draw_one(area, figure)?;
    }
    root.present()?;
    Ok(())
}

fn draw_one(
    area: &DrawingArea<SVGBackend<'_>, Shift>,
    figure: &Figure,
) -> Result<(), Box<dyn std::error::Error>> {
    if figure.curves.len() > COLOURS.len() {
        return Err(
            format!("{} curves, of which {} can be told apart", figure.curves.len(), COLOURS.len()).into()
        );
    }
    let finite: Vec<Curve> = figure.curves.iter().map(only_finite).collect();
    let points = || finite.iter().flat_map(|curve| &curve.points);
    let (start, end) = range(points().map(|point| point.0));
    let (_, top) = range(points().map(|point| point.1));
    let mut chart = ChartBuilder::on(area)
        .margin(8)
        .x_label_area_size(34)
        .y_label_area_size(64)
        .build_cartesian_2d(start..end, 0.0..1.05 * top)?;
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .bold_line_style(RGBColor(227, 232, 237))
        .axis_style(RGBColor(90, 107, 123))
        .label_style(("sans-serif", 13))
        .x_desc(&figure.across)
        .y_desc(&figure.axis)
        .draw()?;
    for (curve, colour) in finite.into_iter().zip(COLOURS) {
        let Curve { name, points } = curve;
        chart
            .draw_series(LineSeries::new(points, &colour))?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour));
    }
    if figure.curves.len() > 1 {
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperRight)
            .background_style(WHITE.mix(0.8))
            .label_font(("sans-serif", 13))
            .draw()?;
    }
    Ok(())
}

pub(crate) fn only_finite(curve: &Curve) -> Curve {
    let points = curve.points.iter().copied().filter(|(x, y)| x.is_finite() && y.is_finite());
    Curve { name: curve.name.clone(), points: points.collect() }
}

/// The least and greatest of `values`, widened where an axis would have no length.
fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) =
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    match (low.is_finite(), high > low) {
        (true, true) => (low, if high > 0.0 { high } else { 1.0 }),
        (true, false) => (low, low.max(0.0) + 1.0),
        _ => (0.0, 1.0),
    }
}
