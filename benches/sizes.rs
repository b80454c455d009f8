//! Growth of the cost of a contact query with the size of the objects: the golf club on the golf ball, at
//! rising numbers of triangles per body.
//!
//! `cargo bench -p palpate-benches --bench sizes` goes up to 80,000 triangles, `-- --most 1280000` further;
//! hierarchies are built where the cache has none, which takes minutes for the largest. `--representative`
//! leaves them out. The largest club is lowered on the largest ball until it penetrates by a tenth of the
//! tolerance, and then slides and turns; all sizes follow the same path. Forces are those of the area law,
//! and are compared with the largest size's by the same method.

#![allow(clippy::print_stdout, reason = "it prints a table")]

use std::error::Error;
use std::sync::Arc;
use std::time::Instant;

use clap::Parser;
use palpate::core::mesh::Sphere;
use palpate::glam::{DQuat, DVec3};
use palpate::models::Model;
use palpate::{Object, Pose, TriMesh};
use palpate_benches::engine::EngineQuery;
use palpate_benches::method::Method;
use palpate_benches::reference::LAW_REACH;
use palpate_benches::representative::Representative;
use palpate_field::{AreaLaw, FieldBody, FieldOptions, FieldSettings};
use palpate_measure::{mean, quantile};

#[derive(Parser)]
#[command(about = "The cost of contact queries at rising resolutions")]
struct Arguments {
    /// Largest number of triangles of a body
    #[arg(long, default_value_t = 80_000)]
    most: usize,
    /// Representative contacts alone, which need no hierarchies
    #[arg(long)]
    representative: bool,
    /// Argument that cargo passes to every benchmark
    #[arg(long, hide = true)]
    bench: bool,
}

const MIN_TRIANGLES: usize = 5_000;
const FACTOR: usize = 4;
const PROBE: &str = "golf-club";
const SCENE: &str = "golf-ball";
/// Number of poses on the path.
const POSES: u32 = 500;
/// Tolerance, error thresholds, and EPS of representative contacts, relative to the probe's radius; a
/// threshold of 0 is full resolution.
const TOLERANCE: f64 = 0.01;
const ERRORS: [f64; 2] = [0.0, 0.025];
const EPS: f64 = 5e-4;

/// Times and results of a method along the path.
struct Run {
    size: usize,
    method: String,
    /// Query times, µs.
    times: Vec<f64>,
    contacts: Vec<f64>,
    /// Forces by the area law, in units of the stiffness.
    forces: Vec<DVec3>,
}

/// Path, and the spheres that lengths are relative to.
struct Path {
    poses: Vec<Pose>,
    /// Bounding sphere of the largest probe.
    sphere: Sphere,
    tolerance: f64,
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments::parse();
    let mut sizes: Vec<usize> = std::iter::successors(Some(MIN_TRIANGLES), |size| Some(FACTOR * size))
        .take_while(|size| *size <= arguments.most.max(MIN_TRIANGLES))
        .collect();
    sizes.reverse();
    let mut path = None;
    let mut runs = Vec::new();
    for size in sizes {
        let [probe, scene] = [PROBE, SCENE].map(|name| mesh(name, size));
        let (probe, scene) = (probe?, scene?);
        let own = path.as_ref().map_or_else(|| probe.bounding_sphere(), |path: &Path| path.sphere);
        let tolerance = TOLERANCE * own.radius;
        let body = |mesh: &TriMesh| Arc::new(FieldBody::new(mesh, &FieldOptions::new(tolerance)));
        let settings = FieldSettings { error: EPS * own.radius, ..FieldSettings::new(tolerance) };
        let mut representative = Representative::new(body(&probe), body(&scene), settings);
        let path = path.get_or_insert_with(|| {
            let poses = slide(&mut representative, own, scene.bounding_sphere(), tolerance);
            Path { poses, sphere: own, tolerance }
        });
        runs.push(path.run(size, format!("representative, EPS {} %", 100.0 * EPS), &mut representative));
        if !arguments.representative {
            let [probe, scene] = [PROBE, SCENE].map(|name| Object::model(&format!("{name}@{size}")));
            let mut query = EngineQuery::new(&probe?, &scene?, tolerance);
            for error in ERRORS {
                query.settings.error = (error * own.radius).into();
                runs.push(path.run(size, format!("s₀ = {} %", 100.0 * error), &mut query));
            }
        }
    }
    print(&runs);
    Ok(())
}

fn mesh(name: &str, size: usize) -> Result<TriMesh, Box<dyn Error>> {
    let (model, _) = Model::parse(name)?;
    Ok(model.generate(size)?)
}

/// Returns poses of a probe that is lowered on a scene object, and then slides over it.
fn slide(query: &mut Representative, probe: Sphere, scene: Sphere, tolerance: f64) -> Vec<Pose> {
    let above = |height: f64| scene.center - probe.center + height * DVec3::Y;
    let mut found = Vec::new();
    let mut deepest = |height: f64| {
        let pose = Pose::from_translation(above(height));
        query.run(&pose);
        found.clear();
        query.append_contacts(&pose, &mut found);
        found.iter().map(|found| found.contact.depth).fold(-tolerance, f64::max)
    };
    // The club's head is below the middle of its bounding sphere.
    let mut height = probe.radius + scene.radius;
    let lowest = -height;
    while height > lowest && deepest(height) < 0.1 * tolerance {
        height -= 0.05 * tolerance;
    }
    let pose = |index: u32| {
        let along = 2e-4 * scene.radius * f64::from(index);
        let turn = DQuat::from_rotation_y(1e-4 * f64::from(index));
        Pose::new(above(height) + along * DVec3::X, turn)
    };
    (0..POSES).map(pose).collect()
}

impl Path {
    fn run(&self, size: usize, name: String, method: &mut dyn Method) -> Run {
        let mut run = Run { size, method: name, times: Vec::new(), contacts: Vec::new(), forces: Vec::new() };
        let mut law = AreaLaw::new(self.sphere.center, self.sphere.radius, LAW_REACH);
        let mut found = Vec::new();
        for pose in &self.poses {
            let begun = Instant::now();
            method.run(pose);
            run.times.push(1e6 * begun.elapsed().as_secs_f64());
            found.clear();
            method.append_contacts(pose, &mut found);
            run.contacts.push(found.len() as f64);
            run.forces.push(law.wrench(&found, self.tolerance, pose, pose.translation).force);
        }
        run
    }
}

/// Prints a table, from the smallest size to the largest, which is the first.
fn print(runs: &[Run]) {
    println!(
        "| triangles of either | method | query median, µs | p99 | contacts | force off the largest size's, % | p95 |"
    );
    println!("|---|---|---|---|---|---|---|");
    let mut sorted: Vec<&Run> = runs.iter().collect();
    sorted.sort_by_key(|run| run.size);
    for run in sorted {
        let largest =
            runs.iter().find(|other| other.method == run.method).map_or(&run.forces, |run| &run.forces);
        let average = mean(largest.iter().map(|force| force.length()));
        let off =
            |(force, largest): (&DVec3, &DVec3)| force.distance(*largest) / largest.length().max(average);
        let off: Vec<f64> = run.forces.iter().zip(largest).map(off).collect();
        println!(
            "| {} | {} | {:.1} | {:.1} | {:.1} | {:.2} | {:.2} |",
            run.size,
            run.method,
            quantile(&run.times, 0.5),
            quantile(&run.times, 0.99),
            mean(run.contacts.iter().copied()),
            100.0 * mean(off.iter().copied()),
            100.0 * quantile(&off, 0.95)
        );
    }
}
