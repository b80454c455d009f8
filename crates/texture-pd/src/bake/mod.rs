//! Baking of haptic textures: a detailed mesh becomes an image of displacements of a coarse mesh (§4.2.2,
//! §4.4.1).
//!
//! # The surface
//!
//! On a coarse triangle the textured surface is p(s, t) = b(s, t) + h(u(s, t)) N(s, t): b is the point of the
//! flat triangle, N the linear interpolation of its [corner directions](crate::corner_directions), and h the
//! cubic B-spline through the texels of the image. The displacement of a texel is thus the distance to the
//! detailed surface along the ray b + h N, positive outside of the coarse surface. If the ray hits the
//! detailed surface's front several times, the nearest hit counts.
//!
//! # The atlas: one chart for each triangle
//!
//! On a smooth surface that is coarsely triangulated, h is not smooth across a coarse edge: b bends there and
//! the surface does not, so h bends as well. A spline across the edge would round off the bend, with an error
//! proportional to the size of a texel. Within one triangle h is as smooth as the surface, and remains so
//! where the triangle's plane and the directions are continued beyond its sides. So every triangle has its
//! own chart, laid out isometrically (no distortion, all triangles at one scale). The texels around the
//! triangle get their values from rays from its continued plane to the same surface. The error then falls
//! with the fourth power of the texel right up to the edge, and there is no parametrisation whose computation
//! could fail. Larger charts would only save gutters, which here cost two texels around each triangle.
//!
//! Two texels are enough because charts must not share the spline's coefficients; they may share its values.
//! The coefficients of each chart are computed independently, on a grid that reaches five texels beyond the
//! triangle. Those that the triangle's points use go into the image; the texels of the image are then the
//! values of all coefficients together. Filtering the image, as at run time, gives back exactly these
//! coefficients. A texel between two triangles may therefore have a value that belongs to neither.
//!
//! # Edges
//!
//! Past a sharp edge a ray may hit a surface that belongs to the triangles around the corner. Such a hit
//! counts only if the surface continues to it from the triangle without a sharp bend; elsewhere texels are
//! extrapolated. Across smooth edges the splines of the two sides differ by their errors, which are large at
//! steps. They are made to meet by the smallest change of coefficients.
//!
//! # Surfaces that are not height fields
//!
//! Where no ray hits (a hole, or an edge that is sharp in both meshes) texels are filled from their
//! surroundings, within a slope limit: a triangle's border by extrapolation, larger holes by the height of
//! the nearest point, so that both sides of an edge agree. Where a ray has several hits the nearest counts,
//! and walls become as steep as texels allow. The report counts both cases, and the vertices of the detailed
//! mesh that are far from the displaced surface.
//!
//! # Contact levels of detail
//!
//! Each level of a hierarchy is a separate mesh. It gets its texture by a call with that level as the coarse
//! mesh and the full mesh as the detailed one. All levels then have the same displaced surface, to within the
//! errors that their reports give (§4.2.2, Integration).

mod atlas;
mod bspline;
mod error;
mod fill;
mod rays;
mod report;
mod settle;
mod sheet;
mod smooth;
mod stitch;
#[cfg(test)]
mod tests;
mod tree;

use std::ops::{ControlFlow, Range};

use glam::DVec2;
use palpate_core::TriMesh;
use palpate_core::mesh::{MeshError, UvMesh};
use rayon::prelude::*;

use self::atlas::{Atlas, Chart, SUPPORT};
use self::rays::{Caster, Row};
use self::settle::Settled;
use self::sheet::Sheet;
use self::smooth::SmoothEdges;
use self::tree::Tree;
use crate::{HeightImage, Wrap};

pub use self::error::BakeError;
pub use self::report::BakeReport;

/// Settings of baking.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BakeOptions {
    /// Size of a texel on the coarse surface, m. It is made coarser if the image would exceed
    /// [`MAX_SIDE`](crate::MAX_SIDE) texels a side; the report gives the size used.
    pub texel: f64,
    /// Length of rays along the direction of displacement, to either side, m. `None`: twice the deviation of
    /// the two meshes, estimated from some thousand points, but between 1/1000 and 1/4 of the coarse mesh's
    /// bounding radius.
    pub reach: Option<f64>,
    /// Angle between the normals of neighbouring triangles above which their edge is sharp, rad; see
    /// [`corner_directions`](crate::corner_directions).
    pub crease: f64,
}

/// Result of baking: a coarse mesh with the image that displaces it.
#[derive(Clone, Debug, PartialEq)]
pub struct Baked {
    /// The coarse mesh with texture coordinates. Those of triangles without area are all at a texel with
    /// displacement 0.
    pub mesh: UvMesh,
    /// Displacements, m.
    pub image: HeightImage,
    /// Quality of the displacements.
    pub report: BakeReport,
}

/// Accepted bounding radii of meshes, m. Products of lengths then stay far within the range of f64.
const ACCEPTED_RADII: Range<f64> = 1e-9..1e9;

/// Maximum number of texels of the charts that are processed together. It bounds the memory for their rays.
const MAX_GROUP_TEXELS: usize = 1 << 22;

/// Number of rows of texels between two calls of the progress callback.
const ROWS_PER_PROGRESS: usize = 512;

/// Progress at which all rays have been cast; the rest is for the report.
const CAST_PROGRESS: f64 = 0.6;

/// Bakes a detailed mesh into a texture of a coarse one. Both are oriented outwards and in the same frame, in
/// metres.
///
/// `progress` is called from time to time with the share of the work that is done, and may cancel it. The
/// result does not depend on the number of threads.
///
/// Texels should be smaller than the coarse triangles: a triangle within one texel gets little more than one
/// displacement.
///
/// ```
/// use std::ops::ControlFlow;
///
/// use palpate_core::TriMesh;
/// use palpate_core::glam::DVec3;
/// use palpate_texture_pd::{BakeOptions, bake};
///
/// // A plate, and one 0.2 mm above it, twice as wide.
/// let plate = |size: f64, height: f64| {
///     let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
///     let vertices = corners.map(|[x, y]| DVec3::new(size * x, size * y, height)).to_vec();
///     TriMesh::new(vertices, vec![[0, 1, 2], [0, 2, 3]])
/// };
/// let options = BakeOptions { texel: 0.001, reach: None, crease: 0.8 };
/// let baked = bake(&plate(0.01, 0.0)?, &plate(0.02, 2e-4)?, &options, &mut |_| ControlFlow::Continue(()))?;
/// assert!(baked.report.largest_deviation < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// If a mesh has no triangle with an area, a vertex that is not finite, or a bounding radius outside of 1 nm
/// to 1e9 m; if an option is out of range; if the coarse mesh has too many triangles for one image; if no ray
/// hits the detailed mesh; or if `progress` cancels the work.
pub fn bake(
    coarse: &TriMesh,
    detailed: &TriMesh,
    options: &BakeOptions,
    progress: &mut dyn FnMut(f64) -> ControlFlow<()>,
) -> Result<Baked, BakeError> {
    check_options(options)?;
    check(coarse, "coarse", BakeError::Coarse)?;
    check(detailed, "detailed", BakeError::Detailed)?;
    if options.texel > coarse.bounding_sphere().radius {
        let wanted = "it has to be smaller than the coarse mesh's bounding radius";
        return Err(BakeError::BadOption { option: "a texel", value: options.texel, unit: "m", wanted });
    }
    // A chart for each coarse triangle, and rays from its texels to the detailed mesh.
    let sheets = sheet::sheets(coarse, options.crease);
    if !sheets.iter().any(Sheet::has_area) {
        return Err(BakeError::NoSurface { which: "coarse" });
    }
    let atlas = Atlas::new(&sheets, options.texel)?;
    let (coarse_tree, detailed_tree) = (Tree::new(coarse), Tree::new(detailed));
    let reach = options.reach.unwrap_or_else(|| reach_of(&coarse_tree, coarse, &detailed_tree, detailed));
    let smooth = SmoothEdges::new(coarse, &sheets);
    let caster =
        Caster { detailed: &detailed_tree, sheets: &sheets, smooth: &smooth, texel: atlas.texel, reach };
    let texels =
        texels(&atlas, &caster, detailed, &mut |done| report_progress(progress, CAST_PROGRESS * done))?;
    if texels.found == 0 {
        return Err(BakeError::NothingWithinReach { reach });
    }
    let [width, height] = atlas.size.to_array().map(|side| side as u32);
    // The image, and its quality as the run time would render it.
    let image = HeightImage::new(width, height, texels.displacements, [Wrap::Clamp; 2])?.into_atlas();
    let mesh = UvMesh::new(coarse.clone(), coordinates(&atlas, sheets.len()))?;
    let subject = report::Subject {
        coarse,
        detailed,
        coarse_tree: &coarse_tree,
        detailed_tree: &detailed_tree,
        sheets: &sheets,
        smooth: &smooth,
        atlas: &atlas,
        mesh: &mesh,
        image: &image,
    };
    let counts = report::Counts { asked: options.texel, reach, missed: texels.missed, folded: texels.folded };
    let report = report::measure(&subject, counts, &mut |done| {
        report_progress(progress, CAST_PROGRESS + (1.0 - CAST_PROGRESS) * done)
    })?;
    report_progress(progress, 1.0)?;
    Ok(Baked { mesh, image, report })
}

fn report_progress(progress: &mut dyn FnMut(f64) -> ControlFlow<()>, done: f64) -> Result<(), BakeError> {
    match progress(done) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(BakeError::Cancelled),
    }
}

fn check_options(options: &BakeOptions) -> Result<(), BakeError> {
    let length = "it has to be a finite number above 0";
    for (option, value) in [("a texel", Some(options.texel)), ("a reach", options.reach)] {
        if let Some(value) = value.filter(|value| !(value.is_finite() && *value > 0.0)) {
            return Err(BakeError::BadOption { option, value, unit: "m", wanted: length });
        }
    }
    let value = options.crease;
    if !(value.is_finite() && value >= 0.0) {
        let wanted = "it has to be a finite number, not negative";
        return Err(BakeError::BadOption { option: "a crease angle", value, unit: "rad", wanted });
    }
    Ok(())
}

/// Refuses meshes that are not finite, have no extent, or are out of scale.
fn check(mesh: &TriMesh, which: &'static str, wrong: fn(MeshError) -> BakeError) -> Result<(), BakeError> {
    for (triangle, corners) in mesh.triangles().iter().enumerate() {
        if let Some(&vertex) = corners.iter().find(|v| !mesh.vertices()[**v as usize].is_finite()) {
            return Err(wrong(MeshError::NonFinite { triangle, vertex }));
        }
    }
    let radius = mesh.bounding_sphere().radius;
    if radius == 0.0 {
        return Err(BakeError::NoSurface { which });
    }
    if ACCEPTED_RADII.contains(&radius) { Ok(()) } else { Err(wrong(MeshError::OutOfRange)) }
}

/// Number of points from which the deviation of two meshes is estimated.
const DEVIATION_POINTS: usize = 4096;

/// Returns the default length of rays to either side, m.
fn reach_of(coarse_tree: &Tree, coarse: &TriMesh, detailed_tree: &Tree, detailed: &TriMesh) -> f64 {
    let deviation = deviation(coarse, detailed_tree).max(deviation(detailed, coarse_tree));
    let radius = coarse.bounding_sphere().radius;
    (2.0 * deviation).clamp(1e-3 * radius, 0.25 * radius)
}

/// Returns the largest distance from another mesh of the corners and centres of some triangles, m.
fn deviation(mesh: &TriMesh, other: &Tree) -> f64 {
    let stride = mesh.triangles().len().div_ceil(DEVIATION_POINTS / 4).max(1);
    let probes = (0..mesh.triangles().len()).step_by(stride).flat_map(|t| {
        let [a, b, c] = mesh.corners(t);
        [a, b, c, (a + b + c) / 3.0]
    });
    probes.filter_map(|p| other.nearest(p)).map(|nearest| nearest.distance).fold(0.0, f64::max)
}

/// Texels of the image, with counts of the rays.
struct Texels {
    displacements: Vec<f32>,
    found: usize,
    missed: usize,
    folded: usize,
}

/// Largest distance of coefficients from the range of their chart's displacements, as a part of that range.
/// Extrapolation over holes could otherwise grow without bound.
const MAX_OVERSHOOT: f64 = 0.5;

/// Largest slope of extrapolated displacements.
const MAX_SLOPE: f64 = 2.0;

/// Casts the rays of all charts and computes the image of their splines.
fn texels(
    atlas: &Atlas,
    caster: &Caster,
    detailed: &TriMesh,
    progress: &mut dyn FnMut(f64) -> Result<(), BakeError>,
) -> Result<Texels, BakeError> {
    let (width, height) = (atlas.size.x as usize, atlas.size.y as usize);
    let mut coefficients = vec![0.0; width * height];
    let mut texels = Texels { displacements: Vec::new(), found: 0, missed: 0, folded: 0 };
    let total: usize = atlas.charts.iter().map(|chart| chart.size.y as usize).sum();
    let mut done = 0;
    for group in groups(&atlas.charts) {
        let work: Vec<(&Chart, i32)> =
            group.iter().flat_map(|chart| (0..chart.size.y).map(move |row| (chart, row))).collect();
        // Rays are cast in parallel and collected in the order of charts and rows.
        let mut rows: Vec<Row> = Vec::with_capacity(work.len());
        for batch in work.chunks(ROWS_PER_PROGRESS) {
            progress(done as f64 / total as f64)?;
            rows.par_extend(batch.par_iter().map(|(chart, row)| caster.row(chart, *row)));
            done += batch.len();
        }
        for row in &rows {
            texels.found += row.heights.iter().filter(|height| height.is_finite()).count() + row.loose.len();
            texels.missed += row.missed;
            texels.folded += row.folded;
        }
        // Each chart settles its own rows, and computes its coefficients independently of the others.
        let mut rest = rows.as_slice();
        let jobs: Vec<(&Chart, &[Row])> = group
            .iter()
            .map(|chart| {
                let (own, others) = rest.split_at(chart.size.y as usize);
                rest = others;
                (chart, own)
            })
            .collect();
        let grid = |(chart, rows): &(&Chart, &[Row])| {
            let sheet = &caster.sheets[chart.triangle];
            let Settled { heights, dropped } = settle::settle(chart, sheet, rows, detailed, atlas.texel);
            (coefficients_of(chart, heights, atlas.texel), dropped)
        };
        let grids: Vec<(Vec<f64>, usize)> = jobs.par_iter().map(grid).collect();
        for (chart, (grid, dropped)) in group.iter().zip(grids) {
            texels.missed += dropped;
            put(chart, &grid, &mut coefficients, width);
        }
    }
    stitch::stitch(atlas, caster.sheets, caster.smooth, &mut coefficients, width);
    texels.displacements = values(&coefficients, width);
    Ok(texels)
}

/// Splits charts into groups of at most [`MAX_GROUP_TEXELS`] texels, or a single chart.
fn groups(charts: &[Chart]) -> Vec<&[Chart]> {
    let (mut groups, mut first, mut size) = (Vec::new(), 0, 0);
    for (at, chart) in charts.iter().enumerate() {
        let texels = chart.size.x as usize * chart.size.y as usize;
        if at > first && size + texels > MAX_GROUP_TEXELS {
            groups.push(&charts[first..at]);
            (first, size) = (at, 0);
        }
        size += texels;
    }
    groups.push(&charts[first..]);
    groups
}

/// Returns the coefficients of a chart's spline on its grid, from the known displacements.
fn coefficients_of(chart: &Chart, mut grid: Vec<f64>, texel: f64) -> Vec<f64> {
    let width = chart.size.x as usize;
    let known = grid.iter().filter(|height| height.is_finite());
    let range = [f64::INFINITY, f64::NEG_INFINITY];
    let [low, high] = known.fold(range, |[low, high], &height| [low.min(height), high.max(height)]);
    let supports: Vec<_> = (0..chart.size.y).map(|row| chart.span(row, SUPPORT)).collect();
    let matters = |at: usize| {
        let column = (at % width) as i32;
        supports[at / width].is_some_and(|[first, last]| (first..=last).contains(&column))
    };
    fill::fill(&mut grid, width, MAX_SLOPE * texel, matters);
    bspline::prefilter(&mut grid, width);
    // Values extrapolated over a hole or past a sharp edge are limited.
    if low <= high {
        let margin = MAX_OVERSHOOT * (high - low);
        grid.iter_mut().for_each(|value| *value = value.clamp(low - margin, high + margin));
    }
    grid
}

/// Copies the coefficients that points of a chart's triangle use into the image's.
fn put(chart: &Chart, grid: &[f64], coefficients: &mut [f64], width: usize) {
    for row in 0..chart.size.y {
        if let Some([first, last]) = chart.span(row, SUPPORT) {
            let from = (row * chart.size.x + first) as usize;
            let to = (chart.place.y + row) as usize * width + (chart.place.x + first) as usize;
            let count = (last - first + 1) as usize;
            coefficients[to..to + count].copy_from_slice(&grid[from..from + count]);
        }
    }
}

/// Returns the texels of the image whose spline has these coefficients, and zeros around them.
fn values(coefficients: &[f64], width: usize) -> Vec<f32> {
    let height = coefficients.len() / width;
    let at = |row: usize, column: usize| match (row.checked_sub(1), column.checked_sub(1)) {
        (Some(row), Some(column)) if row < height && column < width => coefficients[row * width + column],
        _ => 0.0,
    };
    let row_of = |row: usize| {
        (0..width).map(move |column| {
            let around = [0, 1, 2].map(|j| [0, 1, 2].map(|i| at(row + j, column + i)));
            bspline::value_at_node(around) as f32
        })
    };
    (0..height).into_par_iter().flat_map_iter(row_of).collect()
}

/// Returns the texture coordinates of all triangles. Those without area get the centre of the image's first
/// texel.
fn coordinates(atlas: &Atlas, triangles: usize) -> Vec<[DVec2; 3]> {
    let size = atlas.size.as_dvec2();
    let mut coordinates = vec![[0.5 / size; 3]; triangles];
    for chart in &atlas.charts {
        coordinates[chart.triangle] =
            [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]].map(|at| (chart.texel(at) + 0.5) / size);
    }
    coordinates
}
