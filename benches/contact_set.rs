//! Reduction of a query's contacts to contact sets, and its cost, over the scenarios that queries are
//! compared on.
//!
//! `cargo bench -p palpate-benches --bench contact_set`, or `-- --scenario jaws --poses 1000`. Queries follow
//! the path in blocks of poses a millisecond apart. `share` is a set's time relative to its query's at the
//! same pose. `first` has one contact for each region; `spaced` keeps maxima at the noticeable spacing. The
//! last column counts regions whose depth is that of a pair of patches.

#![allow(missing_docs, clippy::print_stdout, reason = "it prints tables")]

use std::error::Error;
use std::time::Instant;

use clap::Parser;
use palpate::Pose;
use palpate::collide::{ContactSet, ContactSetSettings, Shape};
use palpate_benches::engine::EngineQuery;
use palpate_benches::method::Method as _;
use palpate_benches::scenarios::{self, Scenario};
use palpate_measure::quantile;

#[derive(Parser)]
#[command(about = "Reduction of a query's contacts to contact sets, and its cost")]
struct Arguments {
    /// Scenarios
    #[arg(long, num_args = 1.., value_name = "NAME", default_values = ["jaws", "spoon-cup"])]
    scenario: Vec<String>,
    /// Poses of each path
    #[arg(long, default_value_t = 200)]
    poses: usize,
    /// Error threshold, relative to the probe's radius
    #[arg(long, default_value_t = 0.0)]
    error: f64,
    /// Argument that cargo passes to every benchmark
    #[arg(long, hide = true)]
    bench: bool,
}

#[derive(Default)]
struct Row {
    contacts: Vec<f64>,
    times: Vec<f64>,
    shares: Vec<f64>,
    regions: Vec<f64>,
    measured: Vec<f64>,
    by_patches: usize,
    all_regions: usize,
}

impl Row {
    fn print(&self, name: &str) {
        let pair = |values: &[f64]| (quantile(values, 0.5), quantile(values, 1.0));
        let (contacts, most_contacts) = pair(&self.contacts);
        let (regions, most_regions) = pair(&self.regions);
        let (measured, most_measured) = pair(&self.measured);
        let (time, p99) = (1e6 * quantile(&self.times, 0.5), 1e6 * quantile(&self.times, 0.99));
        let share = 100.0 * quantile(&self.shares, 0.5);
        println!(
            "| {name} | {contacts:.0} ({most_contacts:.0}) | {regions:.0} ({most_regions:.0}) | {time:.0} / {p99:.0} | {share:.1} % | {measured:.0} ({most_measured:.0}) | {} of {} |",
            self.by_patches, self.all_regions,
        );
    }
}

fn measure(scenario: &Scenario, arguments: &Arguments) {
    let (probe, scene) = (&scenario.probe.object, &scenario.scene.object);
    let bare = |shape: &Shape| shape.bytes();
    let before = [bare(probe.shape()), bare(scene.shape())];
    let start = Instant::now();
    let mut set = ContactSet::new(probe.shape(), scene.shape());
    let built = start.elapsed().as_secs_f64();
    let added = [probe.shape().bytes() - before[0], scene.shape().bytes() - before[1]];
    let mut query = EngineQuery::new(probe, scene, scenario.tolerance);
    query.settings.error = (arguments.error * probe.bounding_radius()).into();
    let first = ContactSetSettings::new(scenario.tolerance);
    let kinds = [first, ContactSetSettings { spacing: set.noticeable_spacing(), ..first }];
    let mut rows: [Row; 3] = std::array::from_fn(|_| Row::default());
    let stride = scenario.poses.len().div_ceil(arguments.poses.max(1)).max(1);
    // Poses a millisecond apart, in blocks, so that the query follows the motion.
    let block = 10;
    for (index, pose) in scenario.poses.iter().enumerate() {
        if index / block % stride != 0 {
            continue;
        }
        let start = Instant::now();
        query.run(pose);
        let query_time = start.elapsed().as_secs_f64();
        if index % block == 0 || query.contacts().is_empty() {
            continue;
        }
        rows[0].contacts.push(query.contacts().len() as f64);
        rows[0].times.push(query_time);
        for (row, settings) in rows[1..].iter_mut().zip(&kinds) {
            // A run keeps nothing of the last one, so the fastest of three is the least disturbed.
            let times = [(); 3].map(|()| {
                let start = Instant::now();
                set.run(query.contacts(), pose, &Pose::IDENTITY, settings)
                    .expect("the query's contacts are the objects'");
                start.elapsed().as_secs_f64()
            });
            let time = times.into_iter().fold(f64::INFINITY, f64::min);
            let count = set.contacts().len();
            let outcome = set.outcome();
            row.contacts.push(count as f64);
            row.times.push(time);
            row.shares.push(time / query_time);
            row.regions.push(outcome.regions as f64);
            row.measured.push(outcome.measured as f64);
            row.by_patches += outcome.regions - outcome.by_vertices;
            row.all_regions += outcome.regions;
        }
    }
    println!(
        "\n{}: {} poses with contacts; surfaces prepared in {:.0} ms, {} + {} bytes ({} + {} bytes a triangle); workspace {} bytes\n",
        scenario.name,
        rows[0].contacts.len(),
        1e3 * built,
        added[0],
        added[1],
        added[0] / scenario.probe.mesh.triangles().len(),
        added[1] / scenario.scene.mesh.triangles().len(),
        set.bytes(),
    );
    println!(
        "| | contacts, median (max) | regions | time µs, median / p99 | share | vertices measured | deeper by patches |"
    );
    println!("|---|---|---|---|---|---|---|");
    for (row, name) in rows.iter().zip(["query", "first", "spaced"]) {
        row.print(name);
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments::parse();
    scenarios::each(&arguments.scenario, |scenario| {
        measure(scenario, &arguments);
        Ok(())
    })
}
