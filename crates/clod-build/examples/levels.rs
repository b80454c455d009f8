//! Prints the columns of Table 3.2 for models that are built in: `cargo run --release --example levels -- [MODEL[@N] …]`,
//! and with `--levels` a line a level.

#![allow(clippy::print_stdout, reason = "it prints a table")]

use std::time::Instant;

use palpate_clod_build::{BuildOptions, build, unwatched};
use palpate_models::Model;

const TABLE: [&str; 7] =
    ["lower-jaw", "upper-jaw", "ball-joint-ball", "golf-club", "golf-ball", "cup", "spoon"];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    let each_level = arguments.iter().any(|a| a == "--levels");
    arguments.retain(|a| a != "--levels");
    if arguments.is_empty() {
        arguments = TABLE.map(str::to_owned).to_vec();
    }
    println!(
        "| model | triangles | patches | simplified triangles | patches | r₁ | r_λ | free | levels | MB | s |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    for text in &arguments {
        let (model, triangles) = Model::parse(text)?;
        let mesh = model.generate(triangles)?;
        let start = Instant::now();
        let clod = build(&mesh, &BuildOptions::default(), &mut unwatched)?;
        let seconds = start.elapsed().as_secs_f64();
        let radius = clod.bounding_radius();
        let free = clod.levels.iter().filter(|l| l.free).count();
        let coarsest = clod.levels.len() - free - 1;
        let (first, last) = (&clod.levels[1.min(coarsest)], &clod.levels[coarsest]);
        println!(
            "| {text} | {} | {} | {} | {} | {:.1} | {:.2} | {free} | {} | {:.0} | {seconds:.1} |",
            mesh.triangles().len(),
            clod.leaves().len(),
            last.triangles,
            last.nodes.len(),
            first.resolution * radius,
            last.resolution * radius,
            clod.levels.len(),
            clod.total_bytes() as f64 / 1e6,
        );
        if each_level {
            for (k, level) in clod.levels.iter().enumerate() {
                let nodes = clod.level(k);
                let most =
                    |f: &dyn Fn(&palpate_core::clod::Node) -> f64| nodes.iter().map(f).fold(0.0, f64::max);
                println!(
                    "    level {k}: {} triangles, {} nodes ({} contained), r {:.2}, s {:.4}, h {:.4}{}",
                    level.triangles,
                    nodes.len(),
                    nodes.iter().filter(|n| n.contained).count(),
                    level.resolution * radius,
                    most(&|n| n.deviation) / radius,
                    most(&|n| n.hausdorff) / radius,
                    if level.free { ", free" } else { "" },
                );
            }
        }
    }
    Ok(())
}
