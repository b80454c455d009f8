//! How the cost of a contact query grows with the size of the objects: the golf club on the golf ball, at rising numbers
//! of triangles a body.
//!
//! `cargo bench -p palpate-benches --bench sizes` goes up to 80,000 triangles, `-- --most 1280000` further; hierarchies are
//! built where the cache has none, which takes minutes for the largest. The club is lowered on the ball until it is
//! pressed in by a tenth of the tolerance, and then slides and turns.

#![allow(clippy::print_stdout, reason = "it prints a table")]

use std::error::Error;
use std::time::Instant;

use clap::Parser;
use palpate::collide::{ContactQuery, QueryOutcome, QuerySettings};
use palpate::glam::{DQuat, DVec3};
use palpate::{Object, Pose};
use palpate_benches::statistics::quantile;

#[derive(Parser)]
#[command(about = "The cost of contact queries at rising resolutions")]
struct Arguments {
    /// Largest number of triangles of either
    #[arg(long, default_value_t = 80_000)]
    most: usize,
    /// What cargo passes to every benchmark
    #[arg(long, hide = true)]
    bench: bool,
}

const FEWEST: usize = 5_000;
const FACTOR: usize = 4;
/// Poses of the path.
const POSES: u32 = 500;
/// Tolerance, and errors that are left out, as parts of the probe's radius; 0 is full resolution.
const TOLERANCE: f64 = 0.01;
const ERRORS: [f64; 2] = [0.0, 0.025];

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments::parse();
    println!("| triangles of either | s₀ | query median, µs | p99 | contacts | front |");
    println!("|---|---|---|---|---|---|");
    let sizes = std::iter::successors(Some(FEWEST), |size| Some(FACTOR * size));
    for size in sizes.take_while(|size| *size <= arguments.most) {
        let probe = Object::model(&format!("golf-club@{size}"))?;
        let scene = Object::model(&format!("golf-ball@{size}"))?;
        for error in ERRORS {
            let (times, outcomes) = slide(&probe, &scene, error);
            let mean = |count: fn(&QueryOutcome) -> usize| {
                outcomes.iter().map(count).sum::<usize>() as f64 / outcomes.len() as f64
            };
            println!(
                "| {size} | {} % | {:.1} | {:.1} | {:.1} | {:.1} |",
                100.0 * error,
                quantile(&times, 0.5),
                quantile(&times, 0.99),
                mean(|outcome| outcome.contacts),
                mean(|outcome| outcome.front)
            );
        }
    }
    Ok(())
}

/// Times, µs, and what was found.
fn slide(probe: &Object, scene: &Object, error: f64) -> (Vec<f64>, Vec<QueryOutcome>) {
    let (radius, scene_radius) = (probe.bounding_radius(), scene.bounding_radius());
    let tolerance = TOLERANCE * radius;
    let settings = QuerySettings { error: (error * radius).into(), ..QuerySettings::new(tolerance) };
    let mut query = ContactQuery::new(probe.shape(), scene.shape());
    let concentric = scene.clod.source.center - probe.clod.source.center;
    let above = |height: f64| concentric + height * DVec3::Y;
    let mut height = radius + scene_radius;
    let mut touch = |height: f64| {
        let outcome = query
            .run(&Pose::from_translation(above(height)), &Pose::IDENTITY, &settings)
            .expect("valid poses and settings");
        outcome.deepest.unwrap_or(-1.0)
    };
    // The club's head is below the middle of its bounding sphere.
    let lowest = -height;
    while height > lowest && touch(height) < 0.1 * tolerance {
        height -= 0.05 * tolerance;
    }
    let poses = (0..POSES).map(|index| {
        let along = 2e-4 * scene_radius * f64::from(index);
        let turn = DQuat::from_rotation_y(1e-4 * f64::from(index));
        Pose::new(above(height) + along * DVec3::X, turn)
    });
    poses
        .map(|pose| {
            let begun = Instant::now();
            let outcome = query.run(&pose, &Pose::IDENTITY, &settings).expect("valid poses and settings");
            (1e6 * begun.elapsed().as_secs_f64(), outcome)
        })
        .unzip()
}
