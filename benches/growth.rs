//! Growth of a hierarchy's build time with the mesh: built-in models at rising resolution, each built once.
//!
//! `cargo bench -p palpate-benches --bench growth`, or `-- --most 1000000 golf-ball` for larger meshes or
//! other models. It prints p of the least squares fit of time as (n log n)^p: with p of at most 1, time grows
//! no faster than n log n.

#![allow(clippy::print_stdout, reason = "it prints a table")]

use std::error::Error;
use std::time::Instant;

use clap::Parser;
use palpate::clod_build::{BuildOptions, build, unwatched};
use palpate::models::Model;

#[derive(Parser)]
#[command(about = "Growth of a hierarchy's build time with the mesh")]
struct Arguments {
    /// Built-in models
    #[arg(default_values = ["golf-ball", "cup", "file"])]
    models: Vec<String>,
    /// Largest number of triangles; the models are built with this many, a quarter of it, and so on down to
    /// 5,000
    #[arg(long, default_value_t = 320_000)]
    most: usize,
    /// Argument that cargo passes to every benchmark
    #[arg(long, hide = true)]
    bench: bool,
}

/// Smallest number of triangles.
const MIN_TRIANGLES: usize = 5_000;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments::parse();
    let mut sizes: Vec<usize> = std::iter::successors(Some(arguments.most), |n| Some(n / 4))
        .take_while(|n| *n >= MIN_TRIANGLES)
        .collect();
    sizes.reverse();
    println!("| model | triangles | s | µs / triangle |");
    println!("|---|---|---|---|");
    for name in &arguments.models {
        let (model, _) = Model::parse(name)?;
        let mut points = Vec::new();
        for size in &sizes {
            let mesh = model.generate(*size)?;
            let triangles = mesh.triangles().len() as f64;
            let start = Instant::now();
            build(&mesh, &BuildOptions { simplify: true, ..BuildOptions::default() }, &mut unwatched)?;
            let seconds = start.elapsed().as_secs_f64();
            println!("| {name} | {triangles} | {seconds:.2} | {:.1} |", 1e6 * seconds / triangles);
            points.push(((triangles * triangles.ln()).ln(), seconds.ln()));
        }
        println!("| {name} | time as (n log n)^p: | p = {:.3} | |", slope(&points));
    }
    Ok(())
}

/// Returns the slope of the least squares line through the points.
fn slope(points: &[(f64, f64)]) -> f64 {
    let count = points.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / count;
    let (x, y) = (mean(|p| p.0), mean(|p| p.1));
    let covariance: f64 = points.iter().map(|p| (p.0 - x) * (p.1 - y)).sum();
    covariance / points.iter().map(|p| (p.0 - x).powi(2)).sum::<f64>()
}
