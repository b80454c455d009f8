//! Contact queries compared with what others use for them: parry's contact manifolds and pairs of triangles, and a shell
//! of points in a signed distance grid.
//!
//! `cargo bench -p palpate-benches --bench peers`, or `-- --scenario jaws golf --poses 1000`. Every scenario's path is cut
//! into blocks of consecutive poses, at which the methods take turns, so that all of them see the same machine. Times are
//! of the query alone. The force is the penalty k(δ + d) summed over the clustered contacts; its error is the distance
//! from the force of the engine's contacts at full resolution, relative to that force's mean, and beside it the
//! correlation of both forces' magnitudes.
//!
//! The first run builds hierarchies (kept in the user's cache) and distance grids (kept in the target folder).

#![allow(missing_docs, clippy::print_stdout, reason = "it prints tables")]

mod parry;

use std::error::Error;
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::path::Path;
use std::time::Instant;

use clap::Parser;
use palpate::collide::{Clustering, PatchContact};
use palpate::glam::DVec3;
use palpate::{Contact, Pose};
use palpate_benches::engine::EngineQuery;
use palpate_benches::point_shell::{DistanceGrid, PointShell, ShellContact};
use palpate_benches::scenarios::{self, Body, Scenario};
use parry::{Manifolds, SignedDistance, TrianglePairs};

#[derive(Parser)]
#[command(about = "Contact queries compared with what others use for them")]
struct Arguments {
    /// Scenarios; all of them by default
    #[arg(long, num_args = 1.., value_name = "NAME")]
    scenario: Vec<String>,
    /// Poses of each path
    #[arg(long, default_value_t = 240)]
    poses: usize,
    /// A scenario begins no further block of poses after this long
    #[arg(long, default_value_t = 20.0)]
    seconds: f64,
    /// 80 poses, and the small distance grid alone
    #[arg(long)]
    quick: bool,
    /// What cargo passes to every benchmark
    #[arg(long, hide = true)]
    bench: bool,
}

/// Consecutive poses that a method runs through before it is the next one's turn.
const BLOCK: usize = 20;
/// Errors s₀ that are left out, as parts of the probe's radius; 0 is full resolution.
const ERRORS: [f64; 5] = [0.0, 0.004, 0.01, 0.025, 0.05];
/// Those that are also measured with queries that start from the roots.
const COLD: [f64; 2] = [0.0, 0.025];
/// Samples of distance grids along each axis.
const GRIDS: [usize; 2] = [128, 256];
/// Number of contact clusters (§5.5.1).
const CLUSTERS: usize = 5;

/// A way to find contacts.
trait Method {
    /// Finds the contacts at a pose of the probe; this is timed.
    fn run(&mut self, pose: &Pose);
    /// The contacts of the last query, at the same pose, in scene axes.
    fn contacts(&self, pose: &Pose, found: &mut Vec<PatchContact>);
    /// Bytes of memory held.
    fn bytes(&self) -> usize;
}

impl Method for EngineQuery {
    fn run(&mut self, pose: &Pose) {
        Self::run(self, pose);
    }
    fn contacts(&self, _: &Pose, found: &mut Vec<PatchContact>) {
        found.extend_from_slice(self.contacts());
    }
    fn bytes(&self) -> usize {
        Self::bytes(self)
    }
}

impl Method for Manifolds {
    fn run(&mut self, pose: &Pose) {
        Self::run(self, pose);
    }
    fn contacts(&self, pose: &Pose, found: &mut Vec<PatchContact>) {
        found.extend(Self::contacts(self, pose).map(without_nodes));
    }
    fn bytes(&self) -> usize {
        Self::bytes(self)
    }
}

impl Method for TrianglePairs {
    fn run(&mut self, pose: &Pose) {
        Self::run(self, pose);
    }
    fn contacts(&self, pose: &Pose, found: &mut Vec<PatchContact>) {
        found.extend(Self::contacts(self, pose).map(without_nodes));
    }
    fn bytes(&self) -> usize {
        Self::bytes(self)
    }
}

struct ShellInGrid<'a> {
    shell: &'a PointShell,
    grid: DistanceGrid,
    tolerance: f64,
    found: Vec<ShellContact>,
}

impl Method for ShellInGrid<'_> {
    fn run(&mut self, pose: &Pose) {
        self.shell.query(pose, &self.grid, self.tolerance, &mut self.found);
    }
    fn contacts(&self, _: &Pose, found: &mut Vec<PatchContact>) {
        found.extend(self.found.iter().map(|contact| {
            let (point, normal) = (contact.point.as_dvec3(), contact.normal.as_dvec3());
            let depth = f64::from(contact.depth);
            without_nodes(Contact { point, scene_point: point - depth * normal, normal, depth })
        }));
    }
    fn bytes(&self) -> usize {
        self.shell.bytes() + self.grid.bytes()
    }
}

/// A contact that was not found between nodes of hierarchies.
fn without_nodes(contact: Contact) -> PatchContact {
    PatchContact { contact, probe_node: 0, scene_node: 0, weight: 1.0 }
}

/// A method with what was measured of it.
struct Row<'a> {
    name: String,
    method: Box<dyn Method + 'a>,
    clustering: Clustering,
    times: Vec<f64>,
    contacts: Vec<f64>,
    /// In units of the stiffness.
    forces: Vec<DVec3>,
}

impl<'a> Row<'a> {
    fn new(name: impl Into<String>, method: impl Method + 'a) -> Self {
        Self {
            name: name.into(),
            method: Box::new(method),
            clustering: Clustering::new(CLUSTERS),
            times: Vec::new(),
            contacts: Vec::new(),
            forces: Vec::new(),
        }
    }

    /// Runs through consecutive poses, the first of them to warm up.
    fn run(&mut self, poses: &[Pose], tolerance: f64, found: &mut Vec<PatchContact>) {
        for (index, pose) in poses.iter().enumerate() {
            let start = Instant::now();
            self.method.run(pose);
            let time = 1e6 * start.elapsed().as_secs_f64();
            found.clear();
            self.method.contacts(pose, found);
            let clusters = self.clustering.run(found, tolerance, pose);
            let force: DVec3 = clusters
                .iter()
                .map(|cluster| -cluster.contact.normal * (cluster.contact.depth + tolerance).max(0.0))
                .sum();
            if index > 0 {
                self.times.push(time);
                self.contacts.push(found.len() as f64);
                self.forces.push(force);
            }
        }
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = Arguments::parse();
    if arguments.quick {
        arguments.poses = 80;
    }
    let names = if arguments.scenario.is_empty() {
        scenarios::names().map(str::to_owned).collect()
    } else {
        arguments.scenario.clone()
    };
    for name in &names {
        match scenarios::open(name)? {
            None => println!("## {name}\n\nskipped: its files are absent\n"),
            Some(scenario) => compare(&scenario, &arguments)?,
        }
    }
    Ok(())
}

fn compare(scenario: &Scenario, arguments: &Arguments) -> Result<(), Box<dyn Error>> {
    let Scenario { name, probe, scene, poses, tolerance } = scenario;
    let radius = probe.object.bounding_radius();
    let shell = PointShell::new(&probe.mesh);
    let mut rows = Vec::new();
    for error in ERRORS {
        let mut query = EngineQuery::new(&probe.object, &scene.object, *tolerance);
        query.settings.error = (error * radius).into();
        let mode = if error == 0.0 { "exact".to_owned() } else { format!("s₀ = {} %", 100.0 * error) };
        let cold = COLD.contains(&error).then(|| {
            let mut cold = query.clone();
            cold.cold = true;
            cold
        });
        rows.push(Row::new(format!("palpate, {mode}"), query));
        rows.extend(cold.map(|query| Row::new(format!("palpate, {mode}, from the roots"), query)));
    }
    let first_peer = rows.len();
    rows.push(Row::new("parry, manifolds", Manifolds::new(scenario)?));
    rows.push(Row::new("parry, all pairs of triangles", TrianglePairs::new(scenario)?));
    for samples in GRIDS.into_iter().take(if arguments.quick { 1 } else { GRIDS.len() }) {
        let grid = distance_grid(scene, samples, *tolerance)?;
        let method = ShellInGrid { shell: &shell, grid, tolerance: *tolerance, found: Vec::new() };
        rows.push(Row::new(format!("point shell in {samples}³ grid"), method));
    }

    let mut found = Vec::new();
    let begun = Instant::now();
    for start in blocks(poses.len(), arguments.poses) {
        if begun.elapsed().as_secs_f64() > arguments.seconds {
            break;
        }
        let block = &poses[start..(start + 1 + BLOCK).min(poses.len())];
        for row in &mut rows {
            row.run(block, *tolerance, &mut found);
        }
    }

    println!(
        "## {name}: {} ({} triangles) on {} ({}), {} poses\n",
        short_name(probe),
        probe.mesh.triangles().len(),
        short_name(scene),
        scene.mesh.triangles().len(),
        rows[0].times.len()
    );
    println!(
        "| method | query median, µs | p99 | contacts median | max | MB | force error mean, % | p99 | correlation |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for row in &rows {
        let error = ForceError::of(&row.forces, &rows[0].forces);
        println!(
            "| {} | {:.1} | {:.1} | {} | {} | {:.1} | {:.2} | {:.1} | {:.4} |",
            row.name,
            quantile(&row.times, 0.5),
            quantile(&row.times, 0.99),
            quantile(&row.contacts, 0.5),
            quantile(&row.contacts, 1.0),
            row.method.bytes() as f64 / 1e6,
            100.0 * error.mean,
            100.0 * error.p99,
            error.correlation
        );
    }
    println!();
    let ratio =
        |fraction: f64, row: &Row| quantile(&rows[0].times, fraction) / quantile(&row.times, fraction);
    for row in &rows[first_peer..] {
        println!(
            "{}: palpate's exact query takes {:.3} times as long (median), {:.3} times (p99)",
            row.name,
            ratio(0.5, row),
            ratio(0.99, row)
        );
    }
    println!();
    Ok(())
}

/// A model's name, or that of a file without its folder.
fn short_name(body: &Body) -> &str {
    let name = &body.object.name;
    name.rsplit_once('/').map_or(name, |(_, file)| file)
}

/// Where blocks of a path begin, one pose before the first that counts: at the middles of equal parts, and in such an
/// order that the first few are spread over the path.
fn blocks(path: usize, poses: usize) -> impl Iterator<Item = usize> {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    let all = path.saturating_sub(1) / BLOCK;
    let chosen = poses.div_ceil(BLOCK).clamp(1, all.max(1));
    let mut order: Vec<usize> = (0..chosen).collect();
    let key = |block: usize| (GOLDEN * (block as f64 - (chosen / 2) as f64)).rem_euclid(1.0);
    order.sort_by(|a, b| key(*a).total_cmp(&key(*b)));
    order.into_iter().map(move |block| (2 * block + 1) * all / (2 * chosen) * BLOCK)
}

/// The distance grid of a body, kept in the target folder.
fn distance_grid(body: &Body, samples: usize, tolerance: f64) -> Result<DistanceGrid, Box<dyn Error>> {
    let mut hasher = DefaultHasher::new();
    body.mesh.triangles().hash(&mut hasher);
    for vertex in body.mesh.vertices() {
        vertex.to_array().map(f64::to_bits).hash(&mut hasher);
    }
    tolerance.to_bits().hash(&mut hasher);
    let name = format!("distance-{samples}-{:016x}.grid", hasher.finish());
    let distance = SignedDistance::new(body)?;
    // Three cells' diagonals, of which there are about as many across the bounding sphere.
    let band = 2.0 * tolerance + 6.0 * body.object.bounding_radius() / samples as f64;
    Ok(DistanceGrid::cached(&Path::new(env!("CARGO_TARGET_TMPDIR")).join(name), || {
        DistanceGrid::new(&body.mesh, samples, tolerance, band, |point| distance.at(point))
    })?)
}

/// How far forces are from those at full resolution, relative to the mean of the latter.
struct ForceError {
    mean: f64,
    p99: f64,
    /// Of the magnitudes.
    correlation: f64,
}

impl ForceError {
    fn of(forces: &[DVec3], exact: &[DVec3]) -> Self {
        let lengths = |forces: &[DVec3]| forces.iter().map(|f| f.length()).collect::<Vec<_>>();
        let (own, reference) = (lengths(forces), lengths(exact));
        let scale = mean(&reference);
        let errors: Vec<f64> = forces.iter().zip(exact).map(|(f, g)| f.distance(*g) / scale).collect();
        let (center, reference_center) = (mean(&own), scale);
        let covariance = |x: &[f64], x0: f64, y: &[f64], y0: f64| {
            x.iter().zip(y).map(|(x, y)| (x - x0) * (y - y0)).sum::<f64>()
        };
        let correlation = covariance(&own, center, &reference, reference_center)
            / (covariance(&own, center, &own, center)
                * covariance(&reference, reference_center, &reference, reference_center))
            .sqrt();
        Self { mean: mean(&errors), p99: quantile(&errors, 0.99), correlation }
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// By the nearest rank; 0 when there are no values.
fn quantile(values: &[f64], fraction: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (fraction * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied().unwrap_or(0.0)
}
