//! Quality of a baked texture: deviations between the displaced coarse mesh and the detailed mesh.

use std::fmt;

use glam::{DMat2, DVec2, DVec3};
use palpate_core::TriMesh;
use palpate_core::mesh::{Adjacency, UvMesh};
use rayon::prelude::*;

use super::atlas::{Atlas, Chart};
use super::error::BakeError;
use super::sheet::{Place, Sheet, is_inside};
use super::smooth::{Side, SmoothEdges};
use super::tree::Tree;
use crate::HeightImage;

/// Approximate number of points of either surface whose distance from the other is measured.
const MEASURED_POINTS: f64 = 200_000.0;

/// Number of items that are measured between two calls of the progress callback.
const ITEMS_PER_PROGRESS: usize = 2048;

/// Maximum number of points at which the two sides of a coarse edge are compared.
const MAX_EDGE_POINTS: f64 = 4096.0;

/// Quality of a baked texture. Lengths in metres.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BakeReport {
    /// Size of a texel on the coarse surface, m.
    pub texel: f64,
    /// Requested size of a texel, m; smaller than [`texel`](Self::texel) if the image would have been too
    /// large.
    pub asked: f64,
    /// Length of rays to either side, m.
    pub reach: f64,
    /// Number of texels along a row.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// Share of the image's area that is covered by triangles.
    pub used: f64,
    /// Largest factor between a length in the image, at the size of a texel, and on the mesh; 1 is exact.
    pub distortion: f64,
    /// Number of coarse triangles without area, which have no texels.
    pub without_area: usize,
    /// Number of texels in triangles whose rays hit nothing, or only another triangle's surface past a sharp
    /// edge. They are filled from their surroundings.
    pub missed: usize,
    /// Number of texels in triangles whose rays hit the detailed surface several times, so that it is not a
    /// height field there: an overhang, or another part within reach. The nearest hit counts.
    pub folded: usize,
    /// Largest distance from the detailed surface of points on the displaced one, half-way between texels
    /// and at the centre of each triangle, m.
    pub largest_deviation: f64,
    /// Mean of those distances, m.
    pub mean_deviation: f64,
    /// Number of measured points.
    pub points: usize,
    /// Largest distance of the detailed mesh's vertices from the displaced surface along the direction of
    /// displacement, m.
    pub largest_vertex_deviation: f64,
    /// Mean of those distances, m.
    pub mean_vertex_deviation: f64,
    /// Number of measured vertices.
    pub vertices: usize,
    /// Number of vertices that were not measured, because they are not above or below a nearby coarse
    /// triangle, as at sharp edges.
    pub beside: usize,
    /// Number of measured vertices farther than a texel from the displaced surface: detail that no
    /// displacement along the directions reaches, as under overhangs and beside steep walls (§4.6.1).
    pub unreached: usize,
    /// Largest gap between the displaced surfaces of coarse triangles that share a smooth edge, m.
    pub largest_seam: f64,
    /// Number of smooth edges.
    pub smooth_edges: usize,
}

impl fmt::Display for BakeReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { width, height, texel, reach, missed, folded, without_area, .. } = self;
        write!(f, "image: {width} x {height} texels of {texel:.3e} m, {:.1} % in use", 100.0 * self.used)?;
        if *texel > self.asked {
            write!(f, " ({:.3e} m were asked for, but the image would be too large)", self.asked)?;
        }
        writeln!(f, "; distortion {:.6}", self.distortion)?;
        writeln!(
            f,
            "rays: {missed} texels without a hit within {reach:.3e} m, {folded} with several; {without_area} coarse \
             triangles without area"
        )?;
        writeln!(
            f,
            "displaced surface to detailed mesh: {:.3e} m at most, {:.3e} m on average of {} points",
            self.largest_deviation, self.mean_deviation, self.points
        )?;
        writeln!(
            f,
            "detailed vertices to displaced surface: {:.3e} m at most, {:.3e} m on average of {}; {} farther than a texel, {} \
             beside it",
            self.largest_vertex_deviation,
            self.mean_vertex_deviation,
            self.vertices,
            self.unreached,
            self.beside
        )?;
        write!(f, "largest gap at {} smooth coarse edges: {:.3e} m", self.smooth_edges, self.largest_seam)
    }
}

/// Inputs of the measurement.
pub(super) struct Subject<'a> {
    pub coarse: &'a TriMesh,
    pub detailed: &'a TriMesh,
    pub coarse_tree: &'a Tree<'a>,
    pub detailed_tree: &'a Tree<'a>,
    pub sheets: &'a [Sheet],
    pub smooth: &'a SmoothEdges,
    pub atlas: &'a Atlas,
    pub mesh: &'a UvMesh,
    pub image: &'a HeightImage,
}

/// Results of baking that go into the report unchanged.
pub(super) struct Counts {
    pub asked: f64,
    pub reach: f64,
    pub missed: usize,
    pub folded: usize,
}

/// Callback that gets the share of the work that is done.
type Progress<'a> = dyn FnMut(f64) -> Result<(), BakeError> + 'a;

/// Measures the deviations of a baked texture.
pub(super) fn measure(
    subject: &Subject,
    counts: Counts,
    progress: &mut Progress,
) -> Result<BakeReport, BakeError> {
    let Subject { sheets, atlas, .. } = subject;
    let [width, height] = atlas.size.to_array().map(|side| side as u32);
    let surface = Displaced::new(subject);
    let outward = outward_deviation(subject, &surface, &mut |done| progress(0.5 * done))?;
    let inward = inward_deviation(subject, &surface, &mut |done| progress(0.5 + 0.5 * done))?;
    Ok(BakeReport {
        texel: atlas.texel,
        asked: counts.asked,
        reach: counts.reach,
        width,
        height,
        used: atlas.charts.iter().map(Chart::area).sum::<f64>() / (f64::from(width) * f64::from(height)),
        distortion: distortion(subject),
        without_area: sheets.iter().filter(|sheet| !sheet.has_area()).count(),
        missed: counts.missed,
        folded: counts.folded,
        largest_deviation: outward.largest,
        mean_deviation: outward.mean(),
        points: outward.count,
        largest_vertex_deviation: inward.largest,
        mean_vertex_deviation: inward.mean(),
        vertices: inward.count,
        beside: inward.beside,
        unreached: inward.unreached,
        largest_seam: largest_seam(subject, &surface),
        smooth_edges: subject.smooth.edges.len(),
    })
}

/// The displaced surface, from the image, as at run time.
struct Displaced<'a> {
    sheets: &'a [Sheet],
    /// Chart of each triangle.
    charts: Vec<Option<&'a Chart>>,
    spline: crate::spline::Spline,
}

impl<'a> Displaced<'a> {
    fn new(subject: &Subject<'a>) -> Self {
        let mut charts = vec![None; subject.sheets.len()];
        for chart in &subject.atlas.charts {
            charts[chart.triangle] = Some(chart);
        }
        Self { sheets: subject.sheets, charts, spline: crate::spline::Spline::through(subject.image) }
    }

    /// Returns the displacement on a triangle, m; `None` without area.
    fn height(&self, triangle: usize, at: [f64; 2]) -> Option<f64> {
        let texel = self.charts[triangle]?.texel(at);
        Some(self.spline.at(texel.x, texel.y))
    }

    fn point(&self, triangle: usize, at: [f64; 2]) -> Option<DVec3> {
        Some(self.sheets[triangle].point(Place { at, height: self.height(triangle, at)? }))
    }
}

/// Statistics of deviations: largest, mean, and counts.
#[derive(Clone, Copy, Default)]
struct Deviation {
    largest: f64,
    sum: f64,
    count: usize,
    beside: usize,
    unreached: usize,
}

impl Deviation {
    fn add(mut self, length: f64) -> Self {
        self.largest = self.largest.max(length);
        self.sum += length;
        self.count += 1;
        self
    }

    /// Returns the statistics of both.
    fn and(self, other: Self) -> Self {
        Self {
            largest: self.largest.max(other.largest),
            sum: self.sum + other.sum,
            count: self.count + other.count,
            beside: self.beside + other.beside,
            unreached: self.unreached + other.unreached,
        }
    }

    fn mean(&self) -> f64 {
        self.sum / self.count.max(1) as f64
    }
}

/// Measures items in parallel and combines the results in order, so they do not depend on the number of
/// threads.
fn measured<T: Sync>(
    work: &[T],
    measure: impl Fn(&T) -> Deviation + Sync,
    progress: &mut Progress,
) -> Result<Deviation, BakeError> {
    let mut total = Deviation::default();
    for (at, batch) in work.chunks(ITEMS_PER_PROGRESS).enumerate() {
        progress((at * ITEMS_PER_PROGRESS) as f64 / work.len() as f64)?;
        let parts: Vec<Deviation> = batch.par_iter().map(&measure).collect();
        total = parts.into_iter().fold(total, Deviation::and);
    }
    Ok(total)
}

/// Measures the distances of points of the displaced surface from the detailed one.
fn outward_deviation(
    subject: &Subject,
    surface: &Displaced,
    progress: &mut Progress,
) -> Result<Deviation, BakeError> {
    let charts = &subject.atlas.charts;
    let texels: f64 = charts.iter().map(Chart::area).sum();
    let stride = (texels / MEASURED_POINTS).sqrt().ceil().max(1.0) as usize;
    let work: Vec<(&Chart, i32)> = charts
        .iter()
        .flat_map(|chart| (0..chart.size.y).step_by(stride).map(move |row| (chart, row)))
        .collect();
    let measure = |(chart, row): &(&Chart, i32)| {
        let [first, last] = chart.span(*row, 1).unwrap_or([0, -1]);
        let middles = (first..=last).step_by(stride);
        let middles = middles.map(|column| chart.weights(f64::from(column) + 0.5, f64::from(*row) + 0.5));
        // The triangle's centre counts as well, since a small triangle has no other points.
        middles
            .filter(|at| is_inside(*at, 0.0))
            .chain((*row == 0).then_some([1.0 / 3.0; 2]))
            .filter_map(|at| subject.detailed_tree.nearest(surface.point(chart.triangle, at)?))
            .fold(Deviation::default(), |deviation, nearest| deviation.add(nearest.distance))
    };
    measured(&work, measure, progress)
}

/// Measures the distances of the detailed mesh's vertices from the displaced surface along the direction of
/// displacement.
fn inward_deviation(
    subject: &Subject,
    surface: &Displaced,
    progress: &mut Progress,
) -> Result<Deviation, BakeError> {
    let adjacency = subject.coarse.adjacency();
    let detailed = subject.detailed;
    let mut used = vec![false; detailed.vertices().len()];
    for vertex in detailed.triangles().iter().flatten() {
        used[*vertex as usize] = true;
    }
    let vertices: Vec<DVec3> =
        detailed.vertices().iter().zip(used).filter_map(|(vertex, used)| used.then_some(*vertex)).collect();
    let stride = (vertices.len() as f64 / MEASURED_POINTS).ceil().max(1.0) as usize;
    let vertices: Vec<DVec3> = vertices.into_iter().step_by(stride).collect();
    let measure = |vertex: &DVec3| match vertex_deviation(subject, surface, &adjacency, *vertex) {
        Some(length) => {
            let unreached = usize::from(length > subject.atlas.texel);
            Deviation { unreached, ..Deviation::default() }.add(length)
        }
        None => Deviation { beside: 1, ..Deviation::default() },
    };
    measured(&vertices, measure, progress)
}

/// Returns the smallest distance of a vertex, along the direction, from the surface over the nearest coarse
/// triangle or one of that triangle's neighbours.
fn vertex_deviation(
    subject: &Subject,
    surface: &Displaced,
    adjacency: &Adjacency,
    vertex: DVec3,
) -> Option<f64> {
    let nearest = subject.coarse_tree.nearest(vertex)?.triangle;
    let corners = subject.coarse.triangles()[nearest];
    let around = corners.iter().flat_map(|corner| adjacency.vertex_triangles(*corner)).map(|t| *t as usize);
    let lengths = std::iter::once(nearest).chain(around).filter_map(|triangle| {
        let sheet = &surface.sheets[triangle];
        let place = sheet.locate(vertex)?;
        let height = surface.height(triangle, place.at)?;
        Some((place.height - height).abs() * sheet.direction(place.at).length())
    });
    lengths.min_by(f64::total_cmp)
}

/// Returns the largest gap at smooth edges, m.
fn largest_seam(subject: &Subject, surface: &Displaced) -> f64 {
    let gaps = subject.smooth.edges.par_iter().map(|sides| gap(subject, surface, sides));
    gaps.reduce(|| 0.0, f64::max)
}

/// Returns the largest gap along an edge between two triangles, m.
fn gap(subject: &Subject, surface: &Displaced, sides: &[Side; 2]) -> f64 {
    let [from, to] = sides[0].ends.map(|corner| subject.sheets[sides[0].triangle].corners[corner]);
    let steps = (2.0 * from.distance(to) / subject.atlas.texel).ceil().clamp(2.0, MAX_EDGE_POINTS);
    let gaps = (0..=steps as usize).filter_map(|step| {
        let [p, q] = sides.map(|side| surface.point(side.triangle, side.along(step as f64 / steps)));
        Some(p?.distance(q?))
    });
    gaps.fold(0.0, f64::max)
}

/// Returns the largest factor between lengths in the image and on the coarse mesh.
fn distortion(subject: &Subject) -> f64 {
    let size = subject.atlas.size.as_dvec2() * subject.atlas.texel;
    let with_area =
        subject.sheets.iter().zip(subject.mesh.coordinates()).filter(|(sheet, _)| sheet.has_area());
    with_area.map(|(sheet, uv)| stretch(sheet, uv.map(|uv| uv * size))).fold(1.0, f64::max)
}

/// Returns the larger of the stretch and the compression from a triangle to its image in the plane.
fn stretch(sheet: &Sheet, [a, b, c]: [DVec2; 3]) -> f64 {
    let [p, q, r] = sheet.corners;
    let along = (q - p).normalize_or_zero();
    let across = sheet.normal.cross(along);
    let flat = |side: DVec3| DVec2::new(side.dot(along), side.dot(across));
    let map = DMat2::from_cols(b - a, c - a) * DMat2::from_cols(flat(q - p), flat(r - p)).inverse();
    // The squares of the singular values are the eigenvalues of MᵀM.
    let square = map.transpose() * map;
    let [xx, yy, xy] = [square.x_axis.x, square.y_axis.y, square.x_axis.y];
    let largest = ((xx + yy) / 2.0 + ((xx - yy) / 2.0).hypot(xy)).sqrt();
    largest.max(largest / map.determinant().abs())
}
