//! `palpate build` and `palpate inspect`.

use std::path::Path;
use std::time::Instant;

use palpate::Object;
use palpate::core::Clod;
use serde::Serialize;

use crate::arguments::{BuildArguments, InspectArguments};
use crate::failure::Failure;
use crate::{output, progress};

/// The levels of a hierarchy, as JSON.
#[derive(Serialize)]
struct Levels {
    vertices: u32,
    triangles: u32,
    patches: usize,
    /// Time that reading the mesh and building took, s; null from `inspect`.
    seconds: Option<f64>,
    /// Most memory that the process ever held, bytes, where the system tells.
    peak_rss_bytes: Option<u64>,
    bounding_radius: f64,
    levels: Vec<LevelEntry>,
}

#[derive(Serialize)]
struct LevelEntry {
    level: usize,
    triangles: u32,
    patches: u32,
    resolution: f64,
    free: bool,
    max_deviation: f64,
    max_hausdorff: f64,
}

pub fn build(arguments: &BuildArguments) -> Result<(), Failure> {
    output::check_extension(&arguments.output, "clod")?;
    let written: Vec<&Path> = std::iter::once(&*arguments.output).chain(arguments.json.file()).collect();
    output::check_files(&[Path::new(&arguments.mesh)], &written)?;
    let begun = Instant::now();
    // What was asked for is to build, so an earlier result is not looked for.
    let options = palpate::OpenOptions { cache: false, ..arguments.reading.options() };
    if Path::new(&arguments.mesh).extension().is_some_and(|found| found.eq_ignore_ascii_case("clod")) {
        return Err(palpate::OpenError::NotAMesh { path: arguments.mesh.clone() }.into());
    }
    let object = progress::open(&arguments.mesh, &options)?;
    let seconds = begun.elapsed().as_secs_f64();
    object.clod.save(&arguments.output).map_err(|error| Failure::writing(&arguments.output, error))?;
    show(&object, Some(seconds), &arguments.json)
}

pub fn inspect(arguments: &InspectArguments) -> Result<(), Failure> {
    let read = [Path::new(&arguments.hierarchy)];
    output::check_files(&read, arguments.json.file().as_slice())?;
    let object = progress::open(&arguments.hierarchy, &palpate::OpenOptions::default())?;
    show(&object, None, &arguments.json)
}

fn show(object: &Object, seconds: Option<f64>, json: &crate::arguments::Json) -> Result<(), Failure> {
    let levels = levels(&object.clod, seconds);
    output::result(json, &levels, |table| {
        table.row([&"level", &"triangles", &"patches", &"resolution 1/m", &"deviation m", &"Hausdorff m"]);
        for level in &levels.levels {
            let free = if level.free { "free" } else { "" };
            table.row([
                &level.level,
                &level.triangles,
                &level.patches,
                &format!("{:.1}", level.resolution),
                &format!("{:.3e}", level.max_deviation),
                &format!("{:.3e}", level.max_hausdorff),
                &free,
            ]);
        }
    })
}

fn levels(clod: &Clod, seconds: Option<f64>) -> Levels {
    let entry = |(level, data): (usize, &palpate::core::clod::Level)| {
        let nodes = &clod.nodes[data.nodes.start as usize..data.nodes.end as usize];
        LevelEntry {
            level,
            triangles: data.triangles,
            patches: nodes.len() as u32,
            resolution: data.resolution,
            free: data.free,
            max_deviation: nodes.iter().map(|node| node.deviation).fold(0.0, f64::max),
            max_hausdorff: nodes.iter().map(|node| node.hausdorff).fold(0.0, f64::max),
        }
    };
    Levels {
        vertices: clod.source.vertices,
        triangles: clod.source.triangles,
        patches: clod.leaves().len(),
        seconds,
        peak_rss_bytes: peak_memory(),
        bounding_radius: clod.bounding_radius(),
        levels: clod.levels.iter().enumerate().map(entry).collect(),
    }
}

/// The most memory that this process ever held, bytes, where the system tells (Linux).
fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes * 1024)
}
