//! Baking haptic textures: a detailed mesh as an image of displacements of a coarse one (§4.2.2, §4.4.1).
//!
//! # The surface
//!
//! On a coarse triangle the textured surface is p(s, t) = b(s, t) + h(u(s, t)) N(s, t): b is the point of the flat triangle,
//! N the linear interpolation of its [corner directions](crate::corner_directions), and h the cubic B-spline through the
//! texels of the image. The displacement of a texel is thus how far along the ray b + h N the detailed surface is, outside
//! of the coarse one (h > 0) or below it; of several places where the detailed surface faces along the ray the nearest.
//!
//! # The atlas: one chart for each triangle
//!
//! A smooth surface that is coarsely triangulated has no smooth h across a coarse edge: b bends there, the surface does
//! not, so h bends as well. A spline across the edge would round the bend off, with an error proportional to the size of a
//! texel. Within one triangle h is as smooth as the surface is, and stays so where the triangle's plane and the directions
//! are continued beyond its sides. So every triangle has a chart of its own, laid out isometrically (no distortion, all
//! triangles at one scale), and the texels around it get their values from rays from its continued plane to the same
//! surface: the error falls with the fourth power of the texel up to the very edge, and there is no parametrisation to be
//! computed that could fail. Larger charts would only save gutters, which here cost two texels around each triangle.
//!
//! Two texels, since what charts must not share is the spline's coefficients, not its values. The coefficients of each
//! chart are computed by themselves, on a grid that reaches five texels beyond the triangle; those that its points use go
//! into the image, and the texels of the image are then the values of all coefficients together. Filtering the image, as
//! the run time does, gives back exactly these coefficients. A texel between two triangles therefore may have a value that
//! belongs to neither.
//!
//! # Edges
//!
//! Past a sharp edge a ray may meet what belongs to the triangles around the corner. What it meets there is taken only where
//! the surface goes on to it from the triangle without a sharp bend; elsewhere texels are extrapolated. Across smooth edges
//! the two sides' splines differ by their errors, which are large at steps; they are made to meet by the smallest changes of
//! coefficients that do it.
//!
//! # What is no height field
//!
//! Where no ray hits (a hole, or an edge that is sharp in both meshes) texels are filled from those around, within a slope:
//! a triangle's border by extrapolation, larger holes by the height of the nearest point, so that both sides of an edge
//! agree. Where several places face along a ray the nearest is taken, and steep walls get as steep as texels allow. The
//! report counts both, and the vertices of the detailed mesh that the displaced surface does not come near.
//!
//! # Contact levels of detail
//!
//! Each level of a hierarchy is a mesh of its own, so that it gets its texture by a call with that level as the coarse
//! mesh and the full one as the detailed: all levels then have the same displaced surface, to within what the report of
//! each says (§4.2.2, Integration).

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

/// How to bake.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BakeOptions {
    /// Size of a texel on the coarse surface, m. It is made coarser if the image would exceed
    /// [`MAX_SIDE`](crate::MAX_SIDE) texels a side; the report tells.
    pub texel: f64,
    /// How far along the direction of displacement the detailed surface is looked for, to either side, m. `None`: twice
    /// the deviation of the two meshes as far as some thousand points tell, within 1/1000 and 1/4 of the coarse mesh's
    /// bounding radius.
    pub reach: Option<f64>,
    /// Coarse edges whose triangles' normals differ by more are sharp, rad; see
    /// [`corner_directions`](crate::corner_directions).
    pub crease: f64,
}

/// A coarse mesh with the image that displaces it.
#[derive(Clone, Debug, PartialEq)]
pub struct Baked {
    /// The coarse mesh with its places in the image. Triangles without area are all at a texel that is 0.
    pub mesh: UvMesh,
    /// Displacements, m.
    pub image: HeightImage,
    /// How good they are.
    pub report: BakeReport,
}

/// Bounding radii (m) of meshes that are taken: products of lengths then stay far within the range of f64.
const RADII: Range<f64> = 1e-9..1e9;

/// Texels of the charts that are worked on together.
const GROUP: usize = 1 << 22;

/// Rows of texels between two calls of the progress callback.
const ROWS: usize = 512;

/// The progress when all rays have been cast; the report is the rest.
const CAST: f64 = 0.6;

/// Bakes a detailed mesh into a texture of a coarse one. Both are oriented outwards and in the same frame, in metres.
///
/// `progress` gets the share of the work that is done, now and then, and may break it off. The result does not depend on
/// the number of threads.
///
/// Texels are to be smaller than the coarse triangles: a triangle within one texel gets little more than one displacement.
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
/// If a mesh has no triangle with an area, a vertex that is not finite or a size far from that of objects; if an option
/// makes no sense; if the coarse mesh has too many triangles for one image; if nothing of the detailed mesh is within
/// reach of the coarse one; or if `progress` breaks off.
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
    let texels = texels(&atlas, &caster, detailed, &mut |done| report_progress(progress, CAST * done))?;
    if texels.found == 0 {
        return Err(BakeError::NothingWithinReach { reach });
    }
    let [width, height] = atlas.size.to_array().map(|side| side as u32);
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
    let report =
        report::measure(&subject, counts, &mut |done| report_progress(progress, CAST + (1.0 - CAST) * done))?;
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

/// Refuses what cannot be computed with.
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
    if RADII.contains(&radius) { Ok(()) } else { Err(wrong(MeshError::OutOfRange)) }
}

/// Points by which the deviation of two meshes is estimated.
const PROBES: usize = 4096;

/// How far to look where the caller does not say, m.
fn reach_of(coarse_tree: &Tree, coarse: &TriMesh, detailed_tree: &Tree, detailed: &TriMesh) -> f64 {
    let deviation = deviation(coarse, detailed_tree).max(deviation(detailed, coarse_tree));
    let radius = coarse.bounding_sphere().radius;
    (2.0 * deviation).clamp(1e-3 * radius, 0.25 * radius)
}

/// The largest distance of some triangles' corners and middles from another mesh, m.
fn deviation(mesh: &TriMesh, other: &Tree) -> f64 {
    let stride = mesh.triangles().len().div_ceil(PROBES / 4).max(1);
    let probes = (0..mesh.triangles().len()).step_by(stride).flat_map(|t| {
        let [a, b, c] = mesh.corners(t);
        [a, b, c, (a + b + c) / 3.0]
    });
    probes.filter_map(|p| other.nearest(p)).map(|nearest| nearest.distance).fold(0.0, f64::max)
}

/// The texels of the image.
struct Texels {
    displacements: Vec<f32>,
    found: usize,
    missed: usize,
    folded: usize,
}

/// How far coefficients may go beyond the displacements that rays found for their chart, as a part of the range of those.
const BEYOND: f64 = 0.5;

/// Slope to which displacements are extrapolated.
const STEEPEST: f64 = 2.0;

/// Casts the rays of all charts and makes the image of their splines.
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
        let mut rows: Vec<Row> = Vec::with_capacity(work.len());
        for batch in work.chunks(ROWS) {
            progress(done as f64 / total as f64)?;
            rows.par_extend(batch.par_iter().map(|(chart, row)| caster.row(chart, *row)));
            done += batch.len();
        }
        for row in &rows {
            texels.found += row.heights.iter().filter(|height| height.is_finite()).count() + row.loose.len();
            texels.missed += row.missed;
            texels.folded += row.folded;
        }
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

/// Splits charts into groups with not too many texels.
fn groups(charts: &[Chart]) -> Vec<&[Chart]> {
    let (mut groups, mut first, mut size) = (Vec::new(), 0, 0);
    for (at, chart) in charts.iter().enumerate() {
        let texels = chart.size.x as usize * chart.size.y as usize;
        if at > first && size + texels > GROUP {
            groups.push(&charts[first..at]);
            (first, size) = (at, 0);
        }
        size += texels;
    }
    groups.push(&charts[first..]);
    groups
}

/// The coefficients of a chart's spline on its grid, from the displacements that are known there.
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
    fill::fill(&mut grid, width, STEEPEST * texel, matters);
    bspline::prefilter(&mut grid, width);
    // What is extrapolated far, over a hole or past a sharp edge, is kept from going wild.
    if low <= high {
        let margin = BEYOND * (high - low);
        grid.iter_mut().for_each(|value| *value = value.clamp(low - margin, high + margin));
    }
    grid
}

/// Puts the coefficients that points of a chart's triangle use into the image's.
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

/// The texels whose spline has given coefficients, with zeros all round.
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

/// The texture coordinates of all triangles; of those without area the middle of the image's first texel.
fn coordinates(atlas: &Atlas, triangles: usize) -> Vec<[DVec2; 3]> {
    let size = atlas.size.as_dvec2();
    let mut coordinates = vec![[0.5 / size; 3]; triangles];
    for chart in &atlas.charts {
        coordinates[chart.triangle] =
            [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]].map(|at| (chart.texel(at) + 0.5) / size);
    }
    coordinates
}
