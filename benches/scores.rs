//! Accuracy of contacts: those of palpate, of parry, and of a shell of points in a signed distance grid,
//! compared with all pairs of triangles within d and the signed distances of vertices.
//!
//! `cargo bench -p palpate-benches --bench scores -- --scenario jaws --poses 60`; `--build` also times
//! building, with hierarchies and grids built anew, which takes minutes. Poses are evenly spaced on the path.
//! The methods of palpate are the contact sets, with one contact for each region of intersection and with
//! further ones at the noticeable spacing, and the query's contacts that they are made from. The scores:
//!
//! - smallest distance: its largest error, in percent of the probe's radius. For a false contact at 0 the
//!   error is the separation of the surfaces; without a contact within d it is d minus the true distance.
//! - recall: the share found of the local minima of the distance (no pair of triangles at their nearest
//!   points is closer, and both are seen from outside) and of the connected regions of intersection. The
//!   closest minimum represents those within [`MERGE_DISTANCE`] of it on both surfaces. A minimum is found if
//!   a contact is that near it on both surfaces, and a region if a contact penetrates in its box, grown by as
//!   much.
//! - validity: the share of contacts whose points are on both surfaces, and whose distance is that of one of
//!   its points from the other surface, negative inside, each to within [`MAX_ERROR`]; of at most
//!   [`MAX_CHECKED`] contacts per pose.
//! - coverage: the share of all pairs of triangles within d that have a contact within [`COVER_DISTANCE`] on
//!   the probe.
//! - depth: the error of the deepest contact in a region's box against the largest signed distance of the
//!   vertices in the region, of either object from the other, in percent of the radius: mean and largest.
//!   Regions without a vertex inside have no such depth.

#![allow(missing_docs, clippy::print_stdout, reason = "it prints tables")]

use std::collections::HashMap;
use std::error::Error;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use clap::Parser;
use palpate::Pose;
use palpate::clod_build::{BuildOptions, build, unwatched};
use palpate::glam::{DVec3, IVec3};
use palpate_benches::engine::{EngineQuery, EngineSet};
use palpate_benches::method::Method;
use palpate_benches::parry::{Manifolds, TrianglePairs, distance_grid};
use palpate_benches::point_shell::{Features, PointShell, ShellInGrid};
use palpate_benches::scenarios::{self, Scenario};
use palpate_field::AreaContact;
use palpate_measure::{mean, quantile};
use palpate_tests::close_pairs::{ClosePairs, Intersection, Surface};

#[derive(Parser)]
#[command(about = "Accuracy of the contacts of several methods")]
struct Arguments {
    /// Scenarios; all of them by default
    #[arg(long, num_args = 1.., value_name = "NAME")]
    scenario: Vec<String>,
    /// Poses of each path
    #[arg(long, default_value_t = 60)]
    poses: usize,
    /// Build everything anew, and print the build times
    #[arg(long)]
    build: bool,
    /// Argument that cargo passes to every benchmark
    #[arg(long, hide = true)]
    bench: bool,
}

/// Threshold s₀ of the coarser queries, relative to the probe's radius.
const COARSE_ERROR: f64 = 0.025;
/// Numbers of samples of distance grids along each axis.
const GRIDS: [usize; 2] = [128, 256];
/// Distance up to which contacts count as one, in units of d.
const MERGE_DISTANCE: f64 = 1.0;
/// Largest error of a valid contact, in units of d.
const MAX_ERROR: f64 = 0.1;
/// Distance up to which a contact covers close pairs, in units of d.
const COVER_DISTANCE: f64 = 5.0;
/// Largest number of contacts per pose that are checked for validity.
const MAX_CHECKED: usize = 500;
/// Length below which distances count as equal, relative to the probe's radius.
const EQUAL_LENGTH: f64 = 1e-9;

/// Expected contacts at a pose.
struct Truth {
    close: ClosePairs,
    /// Points on both surfaces.
    minima: Vec<[DVec3; 2]>,
    regions: Vec<Intersection>,
    /// Smallest distance, or d where nothing is closer.
    smallest: f64,
}

impl Truth {
    fn new([probe, scene]: &[Surface; 2], pose: &Pose, tolerance: f64, radius: f64) -> Self {
        let close = ClosePairs::new(probe, pose, scene, tolerance);
        let regions = close.intersections(probe, pose, scene);
        let mut found = close.minima(probe, pose, scene, EQUAL_LENGTH * radius);
        found.sort_by(|x, y| x.pair.distance.total_cmp(&y.pair.distance));
        let mut kept: Vec<[DVec3; 2]> = regions.iter().map(|region| [region.deepest; 2]).collect();
        for points in found.into_iter().map(|minimum| minimum.pair.points) {
            if !kept.iter().any(|other| near(*other, points, MERGE_DISTANCE * tolerance)) {
                kept.push(points);
            }
        }
        let minima = kept.split_off(regions.len());
        let smallest = close.pairs.iter().map(|pair| pair.distance).fold(tolerance, f64::min);
        Self { close, minima, regions, smallest }
    }
}

/// Returns whether both points are near both others.
fn near(points: [DVec3; 2], others: [DVec3; 2], reach: f64) -> bool {
    points.iter().zip(others).all(|(p, q)| p.distance(q) <= reach)
}

/// Points in cubes, to find those near a place.
struct Near {
    size: f64,
    cubes: HashMap<IVec3, Vec<DVec3>>,
}

impl Near {
    fn new(size: f64, points: impl Iterator<Item = DVec3>) -> Self {
        let mut cubes: HashMap<IVec3, Vec<DVec3>> = HashMap::new();
        for point in points {
            cubes.entry((point / size).floor().as_ivec3()).or_default().push(point);
        }
        Self { size, cubes }
    }

    /// Returns whether there is a point no further than the size of the cubes.
    fn any(&self, place: DVec3) -> bool {
        let middle = (place / self.size).floor().as_ivec3();
        (0..27).any(|index| {
            let cube = self.cubes.get(&(middle + IVec3::new(index % 3, index / 3 % 3, index / 9) - 1));
            cube.is_some_and(|points| points.iter().any(|point| point.distance(place) <= self.size))
        })
    }
}

/// Method with its scores.
struct Row<'a> {
    name: String,
    method: Box<dyn Method + 'a>,
    /// Build time, s.
    built: Option<f64>,
    distance_errors: Vec<f64>,
    /// Counts of what was found, and of what there is.
    recall: [usize; 2],
    valid: [usize; 2],
    covered: [usize; 2],
    depth_errors: Vec<f64>,
}

impl<'a> Row<'a> {
    fn new(name: impl Into<String>, method: impl Method + 'a, built: Option<f64>) -> Self {
        Self {
            name: name.into(),
            method: Box::new(method),
            built,
            distance_errors: Vec::new(),
            recall: [0; 2],
            valid: [0; 2],
            covered: [0; 2],
            depth_errors: Vec::new(),
        }
    }

    fn score(&mut self, truth: &Truth, surfaces: &[Surface; 2], pose: &Pose, tolerance: f64) {
        self.method.run(pose);
        let mut found = Vec::new();
        self.method.append_contacts(pose, &mut found);

        let smallest = found.iter().map(|found| found.contact.distance()).fold(tolerance, f64::min);
        self.distance_errors.push((smallest - truth.smallest).abs());

        let merge = MERGE_DISTANCE * tolerance;
        let points = |found: &AreaContact| [found.contact.point, found.contact.scene_point];
        let in_box = |region: &Intersection, found: &AreaContact| {
            let point = found.contact.point;
            point.cmpge(region.low - merge).all() && point.cmple(region.high + merge).all()
        };
        self.recall[1] += truth.minima.len() + truth.regions.len();
        self.recall[0] += truth
            .minima
            .iter()
            .filter(|minimum| found.iter().any(|found| near(points(found), **minimum, merge)))
            .count();
        for region in &truth.regions {
            let own = found.iter().filter(|found| found.contact.depth >= 0.0 && in_box(region, found));
            let deepest = own.map(|found| found.contact.depth).reduce(f64::max);
            self.recall[0] += usize::from(deepest.is_some());
            if region.depth > 0.0 {
                self.depth_errors.push((deepest.unwrap_or(0.0) - region.depth).abs());
            }
        }

        for found in found.iter().step_by(found.len().div_ceil(MAX_CHECKED).max(1)) {
            self.valid[0] += usize::from(is_valid(found, surfaces, pose, MAX_ERROR * tolerance));
            self.valid[1] += 1;
        }

        let contacts = Near::new(COVER_DISTANCE * tolerance, found.iter().map(|found| found.contact.point));
        self.covered[0] += truth.close.pairs.iter().filter(|pair| contacts.any(pair.points[0])).count();
        self.covered[1] += truth.close.pairs.len();
    }
}

fn is_valid(found: &AreaContact, [probe, scene]: &[Surface; 2], pose: &Pose, reach: f64) -> bool {
    let contact = &found.contact;
    let in_probe = [contact.point, contact.scene_point].map(|point| pose.inverse().transform_point(point));
    let signed = |surface: &Surface, point: DVec3| {
        let distance = surface.tree.distance(point);
        if surface.solid && distance > 0.0 && surface.tree.winding(point) > 0 { -distance } else { distance }
    };
    let on_both =
        probe.tree.distance(in_probe[0]) <= reach && scene.tree.distance(contact.scene_point) <= reach;
    let as_deep = |distance: f64| (distance + contact.depth).abs() <= reach;
    on_both && (as_deep(signed(scene, contact.point)) || as_deep(signed(probe, in_probe[1])))
}

/// Returns the time of a function, s, with its result.
fn timed<T>(make: impl FnOnce() -> T) -> (T, f64) {
    let begun = Instant::now();
    let made = make();
    (made, begun.elapsed().as_secs_f64())
}

fn rows<'a>(
    scenario: &'a Scenario,
    shell: &'a (Arc<PointShell>, f64),
    anew: bool,
) -> Result<Vec<Row<'a>>, Box<dyn Error>> {
    let Scenario { probe, scene, tolerance, .. } = scenario;
    let radius = probe.object.bounding_radius();
    let hierarchies = if anew {
        let mut seconds = 0.0;
        for body in [probe, scene] {
            let (built, time) = timed(|| build(&body.mesh, &BuildOptions::default(), &mut unwatched));
            built?;
            seconds += time;
        }
        Some(seconds)
    } else {
        None
    };
    let mut rows = Vec::new();
    let modes = [("exact", 0.0), ("s₀ = 2.5 %", COARSE_ERROR)].map(|(mode, error)| {
        let mut query = EngineQuery::new(&probe.object, &scene.object, *tolerance);
        query.settings.error = (error * radius).into();
        (mode, query)
    });
    for (mode, query) in modes {
        for (kind, spaced) in [("one a region", false), ("spaced in regions", true)] {
            let set = EngineSet::new(query.clone(), &probe.object, &scene.object, spaced);
            rows.push(Row::new(format!("palpate, {mode}, {kind}"), set, hierarchies));
        }
        rows.push(Row::new(format!("palpate, {mode}, all of the query"), query, hierarchies));
    }
    for samples in GRIDS {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
        let (grid, seconds) = timed(|| distance_grid(scene, samples, *tolerance, (!anew).then_some(folder)));
        let seconds = anew.then_some(seconds + shell.1);
        let method = ShellInGrid::new(shell.0.clone(), Arc::new(grid?), *tolerance);
        rows.push(Row::new(format!("point shell in {samples}³ grid"), method, seconds));
    }
    let (manifolds, seconds) = timed(|| Manifolds::new(scenario));
    rows.push(Row::new("parry, manifolds", manifolds?, Some(seconds)));
    let (pairs, seconds) = timed(|| TrianglePairs::new(scenario));
    rows.push(Row::new("parry, all pairs of triangles", pairs?, Some(seconds)));
    Ok(rows)
}

fn score(scenario: &Scenario, arguments: &Arguments) -> Result<(), Box<dyn Error>> {
    let Scenario { name, probe, scene, poses, tolerance } = scenario;
    let radius = probe.object.bounding_radius();
    let surfaces = [probe, scene].map(|body| Surface::new(body.mesh.clone()));
    let shell = timed(|| Arc::new(PointShell::new(&probe.mesh, Features::Vertices)));
    let mut rows = rows(scenario, &shell, arguments.build)?;
    let count = arguments.poses.clamp(1, poses.len());
    let (mut close, mut minima, mut regions) = (Vec::new(), 0, 0);
    for pose in (0..count).map(|index| &poses[(2 * index + 1) * poses.len() / (2 * count)]) {
        let truth = Truth::new(&surfaces, pose, *tolerance, radius);
        if !truth.close.pairs.is_empty() {
            close.push(truth.close.pairs.len() as f64);
        }
        minima += truth.minima.len();
        regions += truth.regions.len();
        for row in &mut rows {
            row.score(&truth, &surfaces, pose, *tolerance);
        }
    }
    println!(
        "## {name}: {} ({} triangles) on {} ({}), {count} poses\n",
        probe.short_name(),
        probe.mesh.triangles().len(),
        scene.short_name(),
        scene.mesh.triangles().len(),
    );
    println!(
        "{} poses with pairs of triangles within d (median {}), {minima} local minima, {regions} regions of intersection\n",
        close.len(),
        quantile(&close, 0.5)
    );
    println!(
        "| method | smallest distance off, % | recall, % | validity, % | coverage, % | depth off, mean, % | largest | MB | built in, s |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for row in &rows {
        let percent = |value: f64, digits| {
            if value.is_finite() { format!("{value:.digits$}") } else { "–".to_owned() }
        };
        let share = |[part, all]: [usize; 2]| percent(100.0 * part as f64 / all as f64, 1);
        let depth = |error: f64| {
            if row.depth_errors.is_empty() { "–".to_owned() } else { percent(100.0 * error / radius, 4) }
        };
        println!(
            "| {} | {:.4} | {} | {} | {} | {} | {} | {:.1} | {} |",
            row.name,
            100.0 * quantile(&row.distance_errors, 1.0) / radius,
            share(row.recall),
            share(row.valid),
            share(row.covered),
            depth(mean(row.depth_errors.iter().copied())),
            depth(quantile(&row.depth_errors, 1.0)),
            row.method.bytes() as f64 / 1e6,
            percent(row.built.unwrap_or(f64::NAN), 2),
        );
    }
    println!();
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments::parse();
    scenarios::each(&arguments.scenario, |scenario| score(scenario, &arguments))
}
