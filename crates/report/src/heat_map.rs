//! Heat maps in SVG.

use plotters::coord::Shift;
use plotters::prelude::*;

use crate::plot::PlotError;

/// Axis of a heat map, with one column or row of cells per value.
#[derive(Clone, Debug, PartialEq)]
pub struct CellAxis {
    /// Quantity and unit.
    pub name: String,
    /// Values, ascending or descending.
    pub values: Vec<f64>,
}

impl CellAxis {
    /// Returns the position of a value among the cells, whose centres are at ½, 1½ and so on. Between
    /// neighbours it is linear, or logarithmic if both are positive. Values beyond the ends are at the edges.
    pub fn position(&self, value: f64) -> f64 {
        let count = self.values.len() as f64;
        for (index, pair) in self.values.windows(2).enumerate() {
            let (low, high) = (pair[0], pair[1]);
            if (low.min(high)..=low.max(high)).contains(&value) {
                let share = if low > 0.0 && high > 0.0 {
                    (value / low).ln() / (high / low).ln()
                } else {
                    (value - low) / (high - low)
                };
                return index as f64 + 0.5 + share;
            }
        }
        match (self.values.first(), self.values.last()) {
            (Some(first), Some(last)) if (value - first).abs() < (value - last).abs() => 0.0,
            _ => count,
        }
    }
}

/// A line across a heat map, in the units of its axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Boundary {
    /// Text of the legend.
    pub name: String,
    /// Points of the line.
    pub points: Vec<(f64, f64)>,
}

/// A heat map.
#[derive(Clone, Debug, PartialEq)]
pub struct HeatMap {
    /// Title above the map.
    pub title: String,
    /// Axis from left to right.
    pub x: CellAxis,
    /// Axis from bottom to top.
    pub y: CellAxis,
    /// Value of each cell from 0 (good) to 1 (bad), row by row from the bottom, from left to right. Values
    /// that are not finite are white.
    pub cells: Vec<f64>,
    /// Legend: values with their meaning.
    pub legend: Vec<(f64, String)>,
    /// Lines across the map, at most three, the number of line colours.
    pub boundaries: Vec<Boundary>,
}

/// Size of a heat map, pixels.
const SIZE: (u32, u32) = (430, 330);
/// Height of the legend below it, pixels.
const LEGEND_HEIGHT: u32 = 62;
/// Maximum number of labels on an axis.
const MAX_LABELS: usize = 8;
/// Colours from good to bad, distinguishable without hue.
const SCALE: [RGBColor; 3] = [RGBColor(214, 234, 248), RGBColor(245, 176, 65), RGBColor(123, 36, 28)];
/// Colours of boundaries.
const LINES: [RGBColor; 3] = [RGBColor(20, 60, 140), RGBColor(0, 120, 70), RGBColor(90, 20, 110)];
/// Colour of axes and text.
const INK: RGBColor = RGBColor(60, 70, 80);

/// Draws heat maps in rows of `columns`, as an SVG document.
///
/// # Errors
/// If a map has not one value per cell, has more boundaries than there are colours, or cannot be drawn.
pub fn draw_heat_maps(maps: &[HeatMap], columns: usize) -> Result<String, PlotError> {
    let mut svg = String::new();
    draw_into(&mut svg, maps, columns.clamp(1, maps.len().max(1)))
        .map_err(|error| PlotError::new(error.to_string()))?;
    Ok(svg)
}

type Drawn = Result<(), Box<dyn std::error::Error>>;

fn draw_into(svg: &mut String, maps: &[HeatMap], columns: usize) -> Drawn {
    let rows = maps.len().div_ceil(columns).max(1);
    let size = (SIZE.0 * columns as u32, (SIZE.1 + LEGEND_HEIGHT) * rows as u32);
    let root = SVGBackend::with_string(svg, size).into_drawing_area();
    root.fill(&WHITE)?;
    for (area, map) in root.split_evenly((rows, columns)).iter().zip(maps) {
        draw_one(area, map)?;
    }
    root.present()?;
    Ok(())
}

fn draw_one(area: &DrawingArea<SVGBackend<'_>, Shift>, map: &HeatMap) -> Drawn {
    let (columns, rows) = (map.x.values.len(), map.y.values.len());
    if map.cells.len() != columns * rows {
        return Err(format!("{} values for {columns} × {rows} cells", map.cells.len()).into());
    }
    if map.boundaries.len() > LINES.len() {
        return Err(format!("{} lines, but only {} colours", map.boundaries.len(), LINES.len()).into());
    }
    let (plot, legend) = area.split_vertically(SIZE.1);
    let mut chart = ChartBuilder::on(&plot)
        .margin(8)
        .caption(&map.title, ("sans-serif", 14))
        .x_label_area_size(36)
        .y_label_area_size(62)
        .build_cartesian_2d(0.0..columns as f64, 0.0..rows as f64)?;
    chart.configure_mesh().disable_mesh().axis_style(INK).disable_x_axis().disable_y_axis().draw()?;
    for (index, value) in map.cells.iter().enumerate() {
        let (column, row) = ((index % columns) as f64, (index / columns) as f64);
        let cell = [(column, row), (column + 1.0, row + 1.0)];
        chart.draw_series([Rectangle::new(cell, colour(*value).filled())])?;
    }
    for (boundary, line) in map.boundaries.iter().zip(LINES) {
        let points = boundary.points.iter().map(|&(x, y)| (map.x.position(x), map.y.position(y)));
        chart.draw_series(LineSeries::new(points, line.stroke_width(2)))?;
    }
    let plotted = chart.plotting_area();
    label_axes(&plot, map, |x, y| plotted.map_coordinate(&(x, y)))?;
    draw_legend(&legend, map)
}

/// Writes the axes' names, and their values at the centres of cells.
fn label_axes(
    area: &DrawingArea<SVGBackend<'_>, Shift>,
    map: &HeatMap,
    pixel: impl Fn(f64, f64) -> (i32, i32),
) -> Drawn {
    use plotters::style::text_anchor::{HPos, Pos, VPos};
    let origin = area.get_pixel_range();
    let local = |(x, y): (i32, i32)| (x - origin.0.start, y - origin.1.start);
    let style = |across, down| TextStyle::from(("sans-serif", 12)).color(&INK).pos(Pos::new(across, down));
    let (columns, rows) = (map.x.values.len(), map.y.values.len());
    for (index, value) in map.x.values.iter().enumerate().step_by(columns.div_ceil(MAX_LABELS).max(1)) {
        let (x, y) = local(pixel(index as f64 + 0.5, 0.0));
        area.draw_text(&number(*value), &style(HPos::Center, VPos::Top), (x, y + 4))?;
    }
    for (index, value) in map.y.values.iter().enumerate().step_by(rows.div_ceil(MAX_LABELS).max(1)) {
        let (x, y) = local(pixel(0.0, index as f64 + 0.5));
        area.draw_text(&number(*value), &style(HPos::Right, VPos::Center), (x - 4, y))?;
    }
    let (x, y) = local(pixel(0.5 * columns as f64, 0.0));
    area.draw_text(&map.x.name, &style(HPos::Center, VPos::Top), (x, y + 20))?;
    let (_, y) = local(pixel(0.0, 0.5 * rows as f64));
    let turned = style(HPos::Center, VPos::Top).transform(FontTransform::Rotate270);
    area.draw_text(&map.y.name, &turned, (4, y))?;
    Ok(())
}

fn draw_legend(area: &DrawingArea<SVGBackend<'_>, Shift>, map: &HeatMap) -> Drawn {
    const PITCH: i32 = 15;
    let text = TextStyle::from(("sans-serif", 12)).color(&INK);
    for (index, (value, meaning)) in map.legend.iter().enumerate() {
        let y = index as i32 * PITCH;
        area.draw(&Rectangle::new([(30, y + 2), (42, y + 12)], colour(*value).filled()))?;
        area.draw_text(meaning, &text, (48, y))?;
    }
    for ((index, boundary), line) in map.boundaries.iter().enumerate().zip(LINES) {
        let y = index as i32 * PITCH;
        area.draw(&PathElement::new([(190, y + 7), (206, y + 7)], line.stroke_width(2)))?;
        area.draw_text(&boundary.name, &text, (212, y))?;
    }
    Ok(())
}

fn colour(value: f64) -> RGBColor {
    if !value.is_finite() {
        return WHITE;
    }
    let place = value.clamp(0.0, 1.0) * (SCALE.len() - 1) as f64;
    let index = (place as usize).min(SCALE.len() - 2);
    let share = place - index as f64;
    let mix = |from: u8, to: u8| (f64::from(from) * (1.0 - share) + f64::from(to) * share).round() as u8;
    let (a, b) = (SCALE[index], SCALE[index + 1]);
    RGBColor(mix(a.0, b.0), mix(a.1, b.1), mix(a.2, b.2))
}

/// Formats a value with three significant digits and the SI prefixes k and M.
fn number(value: f64) -> String {
    let (scaled, prefix) = match value.abs() {
        size if size >= 1e6 => (value * 1e-6, "M"),
        size if size >= 1e3 => (value * 1e-3, "k"),
        _ => (value, ""),
    };
    if scaled == 0.0 {
        return "0".to_owned();
    }
    let digits = (2 - scaled.abs().log10().floor() as i32).clamp(0, 9) as usize;
    let text = format!("{scaled:.digits$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{text}{prefix}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(values: &[f64]) -> CellAxis {
        CellAxis { name: "a <b>".to_owned(), values: values.to_vec() }
    }

    #[test]
    fn positions_are_those_of_the_cells_centres() {
        let logarithmic = axis(&[1.0, 100.0, 1000.0]);
        for (value, expected) in
            [(1.0, 0.5), (10.0, 1.0), (100.0, 1.5), (1000.0, 2.5), (0.1, 0.0), (1e9, 3.0)]
        {
            assert!((logarithmic.position(value) - expected).abs() < 1e-12, "{value}");
        }
        assert!((axis(&[0.0, 4.0]).position(1.0) - 0.75).abs() < 1e-12);
        assert!((axis(&[4.0, 0.0]).position(1.0) - 1.25).abs() < 1e-12);
    }

    #[test]
    fn numbers_are_short() {
        for (value, text) in [
            (0.0, "0"),
            (20.0, "20"),
            (100.0, "100"),
            (0.0001, "0.0001"),
            (12_500.0, "12.5k"),
            (1.5e6, "1.5M"),
            (-0.25, "-0.25"),
        ] {
            assert_eq!(number(value), text);
        }
    }

    #[test]
    fn a_map_has_a_rectangle_a_cell_and_its_words() {
        let map = HeatMap {
            title: "walls".to_owned(),
            x: axis(&[1.0, 2.0]),
            y: axis(&[1.0, 2.0, 3.0]),
            cells: vec![0.0, 0.5, 1.0, 0.0, f64::NAN, 0.2],
            legend: vec![(0.0, "stable".to_owned())],
            boundaries: vec![Boundary { name: "limit".to_owned(), points: vec![(1.0, 1.0), (2.0, 3.0)] }],
        };
        let svg = draw_heat_maps(std::slice::from_ref(&map), 2).unwrap();
        for words in ["walls", "a &lt;b&gt;", "stable", "limit", "#7B241C"] {
            assert!(svg.contains(words), "{words} is not in {svg}");
        }
        let wrong = HeatMap { cells: vec![0.0], ..map };
        assert!(draw_heat_maps(&[wrong], 1).is_err());
    }
}
