//! Contact queries compared with other methods: parry's contact manifolds and pairs of triangles, and shells
//! of points and edges in signed distance grids.
//!
//! `cargo bench -p palpate-benches --bench peers`, or `-- --scenario jaws golf --poses 1000`; with
//! `--anywhere` at unrelated poses anywhere on the scene object. On other files: `-- --probe A.obj --scene
//! B.obj --trajectory T.csv --tolerance 1% --json OUT.json`. With `--continuity` it prints the change of the
//! wrench in small [steps](continuity) instead.
//!
//! Every scenario's path is cut into blocks of consecutive poses, at which the methods take turns, so that
//! all of them see the same machine load. Times are of the query alone. At some of the poses each method is
//! compared with a [reference] that is computed without the engine:
//!
//! - force: by the same law from the method's contacts and from the reference's. The error is their distance,
//!   relative to the larger of the reference's force and its mean: its mean and 95th percentile. The error of
//!   the direction is counted where the reference's force is at least a tenth of its mean. The correlation is
//!   that of the magnitudes.
//! - depth off: the largest difference of the deepest contact's depth, counted where bodies penetrate by
//!   either, in percent of the probe's radius.
//! - at every pose, with `--depths`: the same, compared with the deepest place of either surface.
//! - missed: regions of intersection deeper than 2 EPS ([`MIN_REGION_DEPTH`]) without a penetrating contact,
//!   and their total number.
//!
//! The first run builds hierarchies (kept in the user's cache) and distance grids (kept in the target
//! folder).

#![allow(missing_docs, clippy::print_stdout, reason = "it prints tables")]

use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use clap::Parser;
use palpate::clod_build::{BuildOptions, build, unwatched};
use palpate::glam::DVec3;
use palpate::{Pose, TriMesh};
use palpate_benches::continuity::{self, Window};
use palpate_benches::engine::EngineQuery;
use palpate_benches::method::Method;
use palpate_benches::parry::{Manifolds, TrianglePairs, distance_grid};
use palpate_benches::point_shell::{DistanceGrid, Features, PointShell, ShellInGrid};
use palpate_benches::reference::{Depths, Reference, Truth};
use palpate_benches::representative::Representative;
use palpate_benches::scenarios::{self, Scenario};
use palpate_field::{AreaContact, FieldBody, FieldOptions, FieldSettings};
use palpate_measure::{correlation, mean, quantile};
use serde::Serialize;

#[derive(Parser)]
#[command(about = "Contact queries compared with other methods")]
struct Arguments {
    /// Scenarios; all of them by default
    #[arg(long, num_args = 1.., value_name = "NAME", conflicts_with = "probe")]
    scenario: Vec<String>,
    /// A mesh file or built-in model, with --scene and --trajectory
    #[arg(long, requires = "scene")]
    probe: Option<String>,
    /// The object that it moves over
    #[arg(long, requires = "trajectory")]
    scene: Option<String>,
    /// The probe's path
    #[arg(long, value_name = "FILE", requires = "probe")]
    trajectory: Option<PathBuf>,
    /// d, for --probe: in metres, or in percent of the probe's radius
    #[arg(long, default_value = "1%")]
    tolerance: String,
    /// A JSON file for the figures of every method: with --probe one object, with scenarios a list
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Only methods whose names contain one of these
    #[arg(long, num_args = 1.., value_name = "PART")]
    method: Vec<String>,
    /// Poses of each path
    #[arg(long, default_value_t = 240)]
    poses: usize,
    /// Use poses anywhere on the scene object in place of the path
    #[arg(long)]
    anywhere: bool,
    /// In place of times and errors, print the change of the wrench in steps of this length along the path,
    /// m; by default 1 µm, or 1e-5 R for probes with R > 0.1 m
    #[arg(long, value_name = "STEP", num_args = 0..=1, conflicts_with = "anywhere")]
    continuity: Option<Option<f64>>,
    /// Compare the deepest contact with the deepest place of either surface at every pose of the whole path
    #[arg(long, conflicts_with = "anywhere")]
    depths: bool,
    /// Number of poses that are compared with the reference
    #[arg(long, default_value_t = 40)]
    scored: usize,
    /// Time after which a scenario starts no further block of poses
    #[arg(long, default_value_t = 20.0)]
    seconds: f64,
    /// Use 80 poses, and the small distance grid alone
    #[arg(long)]
    quick: bool,
    /// Argument that cargo passes to every benchmark
    #[arg(long, hide = true)]
    bench: bool,
}

/// Number of consecutive poses that a method runs through before the next method's turn.
const BLOCK: usize = 20;
/// Error thresholds s₀, relative to the probe's radius; 0 is full resolution.
const ERRORS: [f64; 5] = [0.0, 0.004, 0.01, 0.025, 0.05];
/// Thresholds that are also measured with queries that start from the roots.
const COLD_ERRORS: [f64; 2] = [0.0, 0.025];
/// Names of methods, and the suffix for those that start each query from the roots.
const FROM_THE_ROOTS: &str = ", from the roots";
const MANIFOLDS: &str = "parry, manifolds";
const PAIRS: &str = "parry, all pairs of triangles";
const BOTH_WAYS: &str = "vertices in 256³ grid, both ways";
/// EPS of representative contacts, relative to the probe's radius, and the EPS that is also measured with
/// cold queries.
const EPS: [f64; 3] = [1e-3, 5e-4, 2e-4];
const COLD_EPS: f64 = 5e-4;
/// Depth, relative to the probe's radius, up to which regions may be missed: 2 EPS, for EPS = 0.05 %.
const MIN_REGION_DEPTH: f64 = 1e-3;
/// Largest error of depths that is asked for: EPS, relative to the probe's radius.
const MAX_DEPTH_ERROR: f64 = 5e-4;
/// Force relative to the mean below which directions do not count.
const MIN_FORCE: f64 = 0.1;

/// Method with its measurements.
struct Row {
    name: String,
    method: Box<dyn Method>,
    /// Build time, s, if known.
    built: Option<f64>,
    times: Vec<f64>,
    contacts: Vec<f64>,
    /// Depth of the deepest contact at every pose, m, with the error that the method says it has.
    path: Vec<(f64, Option<f64>)>,
    /// Forces at the scored poses by the area law, in units of the stiffness.
    forces: Vec<DVec3>,
    /// Depths at the scored poses, m.
    depths: Vec<Option<f64>>,
    missed: usize,
}

impl Row {
    fn new(name: impl Into<String>, method: impl Method + 'static, built: Option<f64>) -> Self {
        Self {
            name: name.into(),
            method: Box::new(method),
            built,
            times: Vec::new(),
            contacts: Vec::new(),
            path: Vec::new(),
            forces: Vec::new(),
            depths: Vec::new(),
            missed: 0,
        }
    }

    /// Runs through consecutive poses, the first of them to warm up, and scores those that have a reference.
    fn run(
        &mut self,
        poses: &[Pose],
        truths: &[Option<Truth>],
        reference: &mut Reference,
        scenario: &Scenario,
    ) {
        let mut found = Vec::new();
        for (index, (pose, truth)) in poses.iter().zip(truths).enumerate() {
            let start = Instant::now();
            self.method.run(pose);
            let time = 1e6 * start.elapsed().as_secs_f64();
            if index == 0 {
                continue;
            }
            found.clear();
            self.method.append_contacts(pose, &mut found);
            self.times.push(time);
            self.contacts.push(found.len() as f64);
            let deepest = found.iter().map(|found| found.contact.depth).fold(0.0, f64::max);
            self.path.push((deepest, self.method.error()));
            if let Some(truth) = truth {
                self.score(&found, pose, truth, reference, scenario);
            }
        }
    }

    fn score(
        &mut self,
        found: &[AreaContact],
        pose: &Pose,
        truth: &Truth,
        reference: &mut Reference,
        scenario: &Scenario,
    ) {
        self.forces.push(reference.wrench(found, pose).force);
        self.depths.push(found.iter().map(|found| found.contact.depth).reduce(f64::max));
        let least = MIN_REGION_DEPTH * scenario.probe.object.bounding_radius();
        let margin = DVec3::splat(scenario.tolerance);
        let penetrating = |found: &&AreaContact| found.contact.depth > 0.0;
        self.missed += truth
            .regions
            .iter()
            .filter(|region| region.depth > least)
            .filter(|region| {
                !found.iter().filter(penetrating).any(|AreaContact { contact, .. }| {
                    [contact.point, contact.scene_point].into_iter().any(|point| {
                        point.cmpge(region.low - margin).all() && point.cmple(region.high + margin).all()
                    })
                })
            })
            .count();
    }

    /// Compares the depths along the path with true ones, m.
    fn path_figures(&self, truths: &[f64], radius: f64) -> Option<PathFigures> {
        let poses = || self.path.iter().zip(truths);
        let off: Vec<f64> = poses().map(|((found, _), deepest)| (found - deepest).abs() / radius).collect();
        let is_wrong =
            |limit: f64| poses().filter(|((found, _), deepest)| (found - **deepest).abs() > limit).count();
        let beyond = poses().filter(|((found, error), deepest)| {
            error.is_some_and(|error| **deepest > 0.0 && (found - **deepest).abs() > error)
        });
        (!truths.is_empty()).then(|| PathFigures {
            depth_error_p95: quantile(&off, 0.95),
            depth_error_max: quantile(&off, 1.0),
            poses_off: is_wrong(MAX_DEPTH_ERROR * radius),
            poses_missed: poses()
                .filter(|((found, _), deepest)| *found == 0.0 && **deepest > MIN_REGION_DEPTH * radius)
                .count(),
            poses_beyond_error: beyond.count(),
        })
    }

    fn figures(&self, (truths, path): (&[&Truth], &[f64]), radius: f64) -> Figures {
        let truth: Vec<f64> = truths.iter().map(|truth| truth.wrench.force.length()).collect();
        let average = mean(truth.iter().copied());
        let pairs = || self.forces.iter().zip(truths).map(|(force, truth)| (*force, truth.wrench.force));
        let errors: Vec<f64> =
            pairs().map(|(found, truth)| found.distance(truth) / truth.length().max(average)).collect();
        let directions: Vec<f64> = pairs()
            .filter(|(_, truth)| truth.length() > MIN_FORCE * average)
            .map(
                |(found, truth)| {
                    if found == DVec3::ZERO { 180.0 } else { found.angle_between(truth).to_degrees() }
                },
            )
            .collect();
        let depths = self.depths.iter().zip(truths).map(|(found, truth)| {
            let [found, truth] = [*found, truth.deepest].map(|depth| depth.unwrap_or(0.0).max(0.0));
            (found - truth).abs() / radius
        });
        let own: Vec<f64> = self.forces.iter().map(|force| force.length()).collect();
        Figures {
            name: self.name.clone(),
            median_us: quantile(&self.times, 0.5),
            p99_us: quantile(&self.times, 0.99),
            max_us: quantile(&self.times, 1.0),
            contacts_median: quantile(&self.contacts, 0.5),
            memory_bytes: self.method.bytes(),
            build_s: self.built,
            force_error_mean: mean(errors.iter().copied()),
            force_error_p95: quantile(&errors, 0.95),
            direction_error_p95_deg: quantile(&directions, 0.95),
            correlation: correlation(&own, &truth),
            depth_error_max: depths.fold(0.0, f64::max),
            regions_missed: self.missed,
            path: self.path_figures(path, radius),
        }
    }
}

/// Figures of a method. Errors of the force are relative to it, errors of depths to the probe's radius.
#[derive(Serialize)]
struct Figures {
    name: String,
    median_us: f64,
    p99_us: f64,
    max_us: f64,
    contacts_median: f64,
    memory_bytes: usize,
    build_s: Option<f64>,
    force_error_mean: f64,
    force_error_p95: f64,
    direction_error_p95_deg: f64,
    correlation: f64,
    depth_error_max: f64,
    regions_missed: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    path: Option<PathFigures>,
}

/// Comparison with the deepest place of either surface at every pose. Errors are relative to the probe's
/// radius.
#[derive(Serialize)]
struct PathFigures {
    depth_error_p95: f64,
    depth_error_max: f64,
    /// Poses with a larger error than [`MAX_DEPTH_ERROR`].
    poses_off: usize,
    /// Poses deeper than [`MIN_REGION_DEPTH`] without a penetrating contact.
    poses_missed: usize,
    /// Poses with a larger error than the method says.
    poses_beyond_error: usize,
}

/// Figures of a scenario.
#[derive(Serialize)]
struct Comparison {
    scenario: String,
    probe_triangles: usize,
    scene_triangles: usize,
    poses: usize,
    poses_scored: usize,
    /// Radius of the probe's bounding sphere, m.
    radius: f64,
    /// Tolerance d, m.
    tolerance: f64,
    /// Number of regions deeper than 2 EPS.
    regions: usize,
    methods: Vec<Figures>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = Arguments::parse();
    if arguments.quick {
        arguments.poses = 80;
    }
    let mut compared = Vec::new();
    if let Some(step) = arguments.continuity {
        return match own(&arguments)? {
            Some(scenario) => print_changes(&scenario, &arguments, step),
            None => {
                scenarios::each(&arguments.scenario, |scenario| print_changes(scenario, &arguments, step))
            }
        };
    }
    let run = |scenario: &Scenario| -> Result<Comparison, Box<dyn Error>> {
        if !arguments.anywhere {
            return compare(scenario, &arguments);
        }
        let poses = scenarios::anywhere(scenario, arguments.poses + 1)?;
        compare(&Scenario { poses, ..scenario.clone() }, &arguments)
    };
    if let Some(scenario) = own(&arguments)? {
        compared.push(run(&scenario)?);
    } else {
        scenarios::each(&arguments.scenario, |scenario| {
            compared.push(run(scenario)?);
            Ok(())
        })?;
    }
    if let Some(file) = &arguments.json {
        let file = std::fs::File::create(file)?;
        match (&arguments.probe, compared.first()) {
            (Some(_), Some(own)) => serde_json::to_writer_pretty(file, own)?,
            _ => serde_json::to_writer_pretty(file, &compared)?,
        }
    }
    Ok(())
}

/// Opens the scenario of `--probe`, if given.
fn own(arguments: &Arguments) -> Result<Option<Scenario>, Box<dyn Error>> {
    let (Some(probe), Some(scene), Some(trajectory)) =
        (&arguments.probe, &arguments.scene, &arguments.trajectory)
    else {
        return Ok(None);
    };
    scenarios::own(probe, scene, trajectory, &arguments.tolerance).map(Some)
}

/// Returns the methods whose names are requested, each with its build time.
fn rows(scenario: &Scenario, arguments: &Arguments) -> Result<Vec<Row>, Box<dyn Error>> {
    let is_requested = |name: &str| {
        arguments.method.is_empty() || arguments.method.iter().any(|part| name.contains(part.as_str()))
    };
    let mut rows = engine_rows(scenario, arguments, &is_requested)?;
    rows.extend(representative_rows(scenario, &is_requested));
    if is_requested(MANIFOLDS) {
        let (manifolds, seconds) = timed(|| Manifolds::new(scenario));
        rows.push(Row::new(MANIFOLDS, manifolds?, Some(seconds)));
    }
    if is_requested(PAIRS) {
        let (pairs, seconds) = timed(|| TrianglePairs::new(scenario));
        rows.push(Row::new(PAIRS, pairs?, Some(seconds)));
    }
    rows.extend(shell_rows(scenario, arguments, &is_requested)?);
    Ok(rows)
}

/// Returns the engine's contact queries with levels of detail.
fn engine_rows(
    scenario: &Scenario,
    arguments: &Arguments,
    is_requested: &dyn Fn(&str) -> bool,
) -> Result<Vec<Row>, Box<dyn Error>> {
    let Scenario { probe, scene, tolerance, .. } = scenario;
    let radius = probe.object.bounding_radius();
    let modes = ERRORS.iter().flat_map(|error| {
        let mode = if *error == 0.0 { "exact".to_owned() } else { format!("s₀ = {} %", 100.0 * error) };
        let cold =
            COLD_ERRORS.contains(error).then(|| (format!("palpate, {mode}{FROM_THE_ROOTS}"), *error, true));
        std::iter::once((format!("palpate, {mode}"), *error, false)).chain(cold)
    });
    let modes: Vec<(String, f64, bool)> = modes.filter(|(name, ..)| is_requested(name)).collect();
    // Hierarchies come from the cache, and are built again if their build time is needed.
    let built = if arguments.json.is_some() && !modes.is_empty() {
        let hierarchies = |mesh: &TriMesh| build(mesh, &BuildOptions::default(), &mut unwatched);
        let (built, seconds) = timed(|| [&probe.mesh, &scene.mesh].map(hierarchies));
        built.into_iter().collect::<Result<Vec<_>, _>>()?;
        Some(seconds)
    } else {
        None
    };
    let rows = modes.into_iter().map(|(name, error, cold)| {
        let mut query = EngineQuery::new(&probe.object, &scene.object, *tolerance);
        query.settings.error = (error * radius).into();
        query.cold = cold;
        Row::new(name, query, built)
    });
    Ok(rows.collect())
}

/// Returns representative contacts.
fn representative_rows(scenario: &Scenario, is_requested: &dyn Fn(&str) -> bool) -> Vec<Row> {
    let Scenario { probe, scene, tolerance, .. } = scenario;
    let modes = EPS.iter().flat_map(|eps| {
        let name = format!("palpate, representative, EPS {} %", 100.0 * eps);
        let cold = (*eps == COLD_EPS).then(|| (format!("{name}{FROM_THE_ROOTS}"), *eps, true));
        std::iter::once((name, *eps, false)).chain(cold)
    });
    let named: Vec<(String, f64, bool)> = modes.filter(|(name, ..)| is_requested(name)).collect();
    if named.is_empty() {
        return Vec::new();
    }
    let body = |body: &scenarios::Body| Arc::new(FieldBody::new(&body.mesh, &FieldOptions::new(*tolerance)));
    let ([own, other], seconds) = timed(|| [body(probe), body(scene)]);
    let row = |(name, eps, cold)| {
        let settings =
            FieldSettings { error: eps * probe.object.bounding_radius(), ..FieldSettings::new(*tolerance) };
        let mut query = Representative::new(own.clone(), other.clone(), settings);
        query.cold = cold;
        Row::new(name, query, Some(seconds))
    };
    named.into_iter().map(row).collect()
}

/// Returns shells of points in distance grids.
fn shell_rows(
    scenario: &Scenario,
    arguments: &Arguments,
    is_requested: &dyn Fn(&str) -> bool,
) -> Result<Vec<Row>, Box<dyn Error>> {
    let Scenario { probe, scene, tolerance, .. } = scenario;
    let shell = |body: &scenarios::Body, features| timed(|| Arc::new(PointShell::new(&body.mesh, features)));
    let grid = |body: &scenarios::Body, samples| -> Result<(Arc<DistanceGrid>, f64), Box<dyn Error>> {
        let grid = distance_grid(body, samples, *tolerance, Some(Path::new(env!("CARGO_TARGET_TMPDIR"))))?;
        let seconds = grid.build_seconds();
        Ok((Arc::new(grid), seconds))
    };
    let mut rows = Vec::new();
    for (features, word) in
        [(Features::Vertices, "vertices"), (Features::VerticesAndEdges, "vertices and edges")]
    {
        let samples = if features == Features::Vertices { [128, 256] } else { [256, 512] };
        for samples in samples {
            let name = format!("{word} in {samples}³ grid");
            if !is_requested(&name) || arguments.quick && samples > 128 {
                continue;
            }
            let ((shell, own), (grid, seconds)) = (shell(probe, features), grid(scene, samples)?);
            rows.push(Row::new(name, ShellInGrid::new(shell, grid, *tolerance), Some(own + seconds)));
        }
    }
    if is_requested(BOTH_WAYS) && !arguments.quick {
        let [forth, back] = [(probe, scene), (scene, probe)].map(|(points, field)| {
            let ((shell, own), (grid, seconds)) = (shell(points, Features::Vertices), grid(field, 256)?);
            Ok::<_, Box<dyn Error>>((shell, grid, own + seconds))
        });
        let (forth, back) = (forth?, back?);
        let method = ShellInGrid::new(forth.0, forth.1, *tolerance).both_ways(back.0, back.1);
        rows.push(Row::new(BOTH_WAYS, method, Some(forth.2 + back.2)));
    }
    Ok(rows)
}

/// Returns a value with the seconds that it took to make.
fn timed<T>(make: impl FnOnce() -> T) -> (T, f64) {
    let begun = Instant::now();
    let made = make();
    (made, begun.elapsed().as_secs_f64())
}

fn compare(scenario: &Scenario, arguments: &Arguments) -> Result<Comparison, Box<dyn Error>> {
    let Scenario { name, probe, scene, poses, tolerance } = scenario;
    let radius = probe.object.bounding_radius();
    let mut reference = Reference::new(scenario)?;
    let mut true_depths = if arguments.depths { Some(Depths::new(scenario)?) } else { None };
    let mut depths = Vec::new();
    let mut rows = rows(scenario, arguments)?;
    if rows.is_empty() {
        return Err(format!("no method's name contains {}", arguments.method.join(" or ")).into());
    }

    let starts: Vec<usize> = blocks(poses.len(), arguments.poses).collect();
    let every = (starts.len() * BLOCK).div_ceil(arguments.scored.max(1)).max(1);
    let (mut truths, mut scored, mut spent) = (Vec::new(), 0, 0.0);
    for (block, start) in starts.into_iter().enumerate() {
        if spent > arguments.seconds {
            break;
        }
        let poses = &poses[start..(start + 1 + BLOCK).min(poses.len())];
        let own: Vec<Option<Truth>> = (0..poses.len())
            .map(|index| {
                let chosen = index > 0 && (block * BLOCK + index).is_multiple_of(every);
                chosen.then(|| reference.at(&poses[index]))
            })
            .collect();
        scored += own.iter().flatten().count();
        let begun = Instant::now();
        for row in &mut rows {
            row.run(poses, &own, &mut reference, scenario);
        }
        spent += begun.elapsed().as_secs_f64();
        if let Some(truths) = &mut true_depths {
            depths.extend(poses.iter().skip(1).map(|pose| truths.next(pose)));
        }
        truths.extend(own.into_iter().flatten());
    }
    let truths: Vec<&Truth> = truths.iter().collect();
    let deep = truths
        .iter()
        .flat_map(|truth| &truth.regions)
        .filter(|region| region.depth > MIN_REGION_DEPTH * radius);
    let comparison = Comparison {
        scenario: name.clone(),
        probe_triangles: probe.mesh.triangles().len(),
        scene_triangles: scene.mesh.triangles().len(),
        poses: rows[0].times.len(),
        poses_scored: scored,
        radius,
        tolerance: *tolerance,
        regions: deep.count(),
        methods: rows.iter().map(|row| row.figures((&truths, &depths), radius)).collect(),
    };
    print(&comparison, &truths, radius, [probe.short_name(), scene.short_name()]);
    Ok(comparison)
}

fn print(comparison: &Comparison, truths: &[&Truth], radius: f64, [probe, scene]: [&str; 2]) {
    let Comparison { scenario, probe_triangles, scene_triangles, poses, poses_scored, regions, .. } =
        comparison;
    println!(
        "## {scenario}: {probe} ({probe_triangles} triangles) on {scene} ({scene_triangles}), {poses} poses, {poses_scored} \
         scored\n"
    );
    let of = |value: fn(&Truth) -> f64| truths.iter().map(|truth| value(truth)).collect::<Vec<f64>>();
    let depths = of(|truth| truth.deepest.unwrap_or(0.0).max(0.0));
    let (samples, changes) = (of(|truth| truth.samples as f64), of(|truth| truth.change));
    println!(
        "The reference has {} samples (median), and its force changed by {:.2} % (largest) as they were refined for the last \
         time; {regions} regions, the deepest of {:.3} % of R.\n",
        quantile(&samples, 0.5),
        100.0 * quantile(&changes, 1.0),
        100.0 * quantile(&depths, 1.0) / radius
    );
    println!(
        "| method | query median, µs | p99 | largest | contacts | MB | built in, s | force error mean, % | p95 | direction p95, ° | correlation | depth off, % | missed |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|");
    for row in &comparison.methods {
        println!(
            "| {} | {:.1} | {:.1} | {:.0} | {} | {:.1} | {} | {:.2} | {:.1} | {:.1} | {:.4} | {:.3} | {} |",
            row.name,
            row.median_us,
            row.p99_us,
            row.max_us,
            row.contacts_median,
            row.memory_bytes as f64 / 1e6,
            row.build_s.map_or(String::new(), |seconds| format!("{seconds:.2}")),
            100.0 * row.force_error_mean,
            100.0 * row.force_error_p95,
            row.direction_error_p95_deg,
            row.correlation,
            100.0 * row.depth_error_max,
            row.regions_missed
        );
    }
    println!();
    if comparison.methods.iter().all(|row| row.path.is_none()) {
        return;
    }
    println!(
        "| method | depth off at every pose, p95, % | largest | poses off | missed | beyond the method's own error |"
    );
    println!("|---|---|---|---|---|---|");
    for (name, path) in comparison.methods.iter().filter_map(|row| Some((&row.name, row.path.as_ref()?))) {
        println!(
            "| {name} | {:.3} | {:.3} | {} | {} | {} |",
            100.0 * path.depth_error_p95,
            100.0 * path.depth_error_max,
            path.poses_off,
            path.poses_missed,
            path.poses_beyond_error
        );
    }
    println!();
}

/// Prints the change of the wrench by each method in small steps along a scenario's path.
fn print_changes(
    scenario: &Scenario,
    arguments: &Arguments,
    step: Option<f64>,
) -> Result<(), Box<dyn Error>> {
    let step = step.unwrap_or((1e-5 * scenario.probe.object.bounding_radius()).max(1e-6));
    if !(step > 0.0 && step.is_finite()) {
        return Err("--continuity has to be a length above 0 in metres".into());
    }
    let windows = continuity::windows(scenario, step);
    let steps: usize = windows.iter().map(Window::len).sum();
    println!("## {}: {steps} steps of {:.1} µm in {} windows\n", scenario.name, 1e6 * step, windows.len());
    println!(
        "| method | steps in contact | force, median | p99 | largest | in tenths of that step | torque, largest |"
    );
    println!("|---|---|---|---|---|---|---|");
    // Poses are closely spaced, as in a session, where each query continues from the last.
    let mut rows = rows(scenario, arguments)?;
    rows.retain(|row| !row.name.ends_with(FROM_THE_ROOTS));
    for row in &mut rows {
        let changes = continuity::changes(scenario, row.method.as_mut(), &windows);
        let [largest, within] = continuity::largest(scenario, row.method.as_mut(), &changes);
        let force: Vec<f64> = changes.iter().map(|change| change.force).collect();
        println!(
            "| {} | {} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} |",
            row.name,
            changes.len(),
            quantile(&force, 0.5),
            quantile(&force, 0.99),
            largest,
            within,
            changes.iter().map(|change| change.torque).fold(0.0, f64::max),
        );
    }
    println!();
    Ok(())
}

/// Returns the starts of a path's blocks, one pose before the first that counts: at the middles of equal
/// parts, in an order in which the first few are spread over the path. If all blocks are run, they are in the
/// order of the path, without jumps.
fn blocks(path: usize, poses: usize) -> impl Iterator<Item = usize> {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    let all = path.saturating_sub(1) / BLOCK;
    let chosen = poses.div_ceil(BLOCK).clamp(1, all.max(1));
    let mut order: Vec<usize> = (0..chosen).collect();
    let key = |block: usize| (GOLDEN * (block as f64 - (chosen / 2) as f64)).rem_euclid(1.0);
    if chosen < all {
        order.sort_by(|a, b| key(*a).total_cmp(&key(*b)));
    }
    order.into_iter().map(move |block| (2 * block + 1) * all / (2 * chosen) * BLOCK)
}
