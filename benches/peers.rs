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

use std::error::Error;
use std::path::Path;
use std::time::Instant;

use clap::Parser;
use palpate::Pose;
use palpate::collide::PatchContact;
use palpate::glam::DVec3;
use palpate_benches::engine::EngineQuery;
use palpate_benches::method::Method;
use palpate_benches::parry::{Manifolds, TrianglePairs, distance_grid};
use palpate_benches::penalty::Penalty;
use palpate_benches::point_shell::{PointShell, ShellInGrid};
use palpate_benches::scenarios::{self, Scenario};
use palpate_benches::statistics::{correlation, mean, quantile};

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
/// A method with what was measured of it.
struct Row<'a> {
    name: String,
    method: Box<dyn Method + 'a>,
    penalty: Penalty,
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
            penalty: Penalty::default(),
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
            self.method.append_contacts(pose, found);
            let force = self.penalty.wrench(found, tolerance, pose, DVec3::ZERO).force;
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
    scenarios::each(&arguments.scenario, |scenario| compare(scenario, &arguments))
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
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
        let grid = distance_grid(scene, samples, *tolerance, Some(folder))?;
        let method = ShellInGrid::new(&shell, grid, *tolerance);
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
        probe.short_name(),
        probe.mesh.triangles().len(),
        scene.short_name(),
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
        let correlation = correlation(&own, &reference);
        Self { mean: mean(&errors), p99: quantile(&errors, 0.99), correlation }
    }
}
