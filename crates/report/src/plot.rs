//! Plots of curves as SVG.

use plotters::coord::Shift;
use plotters::prelude::*;

/// A curve.
#[derive(Clone, Debug)]
pub struct Curve {
    /// Text of the legend.
    pub name: String,
    /// Points in order of the first value.
    pub points: Vec<(f64, f64)>,
}

/// A plot.
#[derive(Clone, Debug)]
pub struct Figure {
    /// Caption below the plot.
    pub caption: String,
    /// Label of the horizontal axis with its unit: `s` for time.
    pub across: String,
    /// Unit of the vertical axis.
    pub axis: String,
    /// Curves, at most six, the number of colours.
    pub curves: Vec<Curve>,
}

/// Error: a plot could not be drawn.
#[derive(Debug, thiserror::Error)]
#[error("a plot could not be drawn: {0}")]
pub struct PlotError(String);

impl PlotError {
    pub(crate) fn new(why: String) -> Self {
        Self(why)
    }
}

const SIZE: (u32, u32) = (960, 260);
/// Height of the legend above a plot with several curves, pixels.
const LEGEND_HEIGHT: i32 = 24;
pub(crate) const COLOURS: [RGBColor; 6] = [
    RGBColor(31, 96, 168),
    RGBColor(205, 97, 30),
    RGBColor(46, 139, 87),
    RGBColor(148, 68, 158),
    RGBColor(166, 124, 0),
    RGBColor(90, 107, 123),
];

/// Draws figures below one another as an SVG document, without their captions.
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
        return Err(format!("{} curves, but only {} colours", figure.curves.len(), COLOURS.len()).into());
    }
    let finite: Vec<Curve> = figure.curves.iter().map(only_finite).collect();
    let points = || finite.iter().flat_map(|curve| &curve.points);
    let (start, end) = range(points().map(|point| point.0));
    let (_, top) = range(points().map(|point| point.1));
    // The legend is above the plot, where it hides no curve.
    let (legend, area) = if figure.curves.len() > 1 {
        let (above, below) = area.split_vertically(LEGEND_HEIGHT);
        (Some(above), below)
    } else {
        (None, area.clone())
    };
    if let Some(legend) = legend {
        draw_legend(&legend, &finite)?;
    }
    let mut chart = ChartBuilder::on(&area)
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
        chart.draw_series(LineSeries::new(curve.points, &colour))?;
    }
    Ok(())
}

/// Draws the names of the curves in a row, each after a piece of its line.
fn draw_legend(
    area: &DrawingArea<SVGBackend<'_>, Shift>,
    curves: &[Curve],
) -> Result<(), Box<dyn std::error::Error>> {
    /// Approximate width of a letter, pixels.
    const LETTER_WIDTH: i32 = 8;
    let (mut x, y) = (72, LEGEND_HEIGHT / 2);
    for (Curve { name, .. }, colour) in curves.iter().zip(COLOURS) {
        area.draw(&PathElement::new([(x, y), (x + 20, y)], colour.stroke_width(2)))?;
        area.draw(&Text::new(name.as_str(), (x + 26, y - 7), ("sans-serif", 13)))?;
        x += 26 + LETTER_WIDTH * name.chars().count() as i32 + 20;
    }
    Ok(())
}

pub(crate) fn only_finite(curve: &Curve) -> Curve {
    let points = curve.points.iter().copied().filter(|(x, y)| x.is_finite() && y.is_finite());
    Curve { name: curve.name.clone(), points: points.collect() }
}

/// Returns the range of `values`, widened if an axis would have no length.
fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) =
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    match (low.is_finite(), high > low) {
        (true, true) => (low, if high > 0.0 { high } else { 1.0 }),
        (true, false) => (low, low.max(0.0) + 1.0),
        _ => (0.0, 1.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The text of the legend is above the highest point of the curves.
    #[test]
    fn legend_hides_no_curve() {
        let curve =
            |name: &str, top: f64| Curve { name: name.to_owned(), points: vec![(0.0, top), (1.0, 0.0)] };
        let figure = Figure {
            caption: String::new(),
            across: "s".to_owned(),
            axis: "N".to_owned(),
            curves: vec![curve("coupling", 3.0), curve("contact", 2.0)],
        };
        let svg = draw(&[figure]).expect("drawn");
        let lines: Vec<&str> = svg.lines().collect();
        let legend = |name: &str| {
            let at = lines
                .iter()
                .position(|line| line.trim() == name)
                .unwrap_or_else(|| panic!("no {name}: {svg}"));
            let (_, rest) = lines[at - 1].split_once(" y=\"").expect("a place");
            rest.split_once('"').expect("a number").0.parse::<f64>().expect("a number")
        };
        let top = lines
            .iter()
            .filter(|line| line.starts_with("<polyline") && line.contains("stroke-width=\"1\""))
            .filter(|line| {
                COLOURS[..2].iter().any(|c| line.contains(&format!("#{:02X}{:02X}{:02X}", c.0, c.1, c.2)))
            })
            .flat_map(|line| line.split_once("points=\"").map(|(_, rest)| rest.split_once('"').unwrap().0))
            .flat_map(|points| {
                points.split_whitespace().filter_map(|point| point.split_once(',')?.1.parse().ok())
            })
            .fold(f64::INFINITY, f64::min);
        assert!(top.is_finite(), "{svg}");
        for name in ["coupling", "contact"] {
            assert!(legend(name) < top, "{name} at {}, curves from {top}", legend(name));
        }
    }
}
