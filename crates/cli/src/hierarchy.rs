//! `palpate build` and `palpate inspect`.

use std::collections::BTreeSet;
use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::time::Instant;

use palpate::Object;
use palpate::core::Clod;
use palpate::models::Model;
use palpate_report::{LevelFigures, LevelPictures, Table32, grouped, views};
use serde::Serialize;

use crate::arguments::{BuildArguments, InspectArguments, Json, Pictures};
use crate::failure::Failure;
use crate::output::Table;
use crate::{output, progress};

/// Properties of a hierarchy, as JSON.
#[derive(Serialize)]
struct Inspection {
    name: String,
    vertices: u32,
    triangles: u32,
    patches: usize,
    /// Time to read the mesh and build the hierarchy, s; null from `inspect`.
    seconds: Option<f64>,
    /// Peak memory of the process, bytes; null if the system does not report it.
    peak_rss_bytes: Option<u64>,
    bounding_radius: f64,
    /// Memory of the hierarchy.
    bytes: usize,
    /// Columns of the dissertation's Table 3.2.
    table: Table32,
    /// The dissertation's row for its own model of the same name; null for other objects.
    published: Option<Table32>,
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
    median_deviation: f64,
    median_hausdorff: f64,
    bytes: usize,
}

pub fn build(arguments: &BuildArguments) -> Result<(), Failure> {
    output::check_extension(&arguments.output, "clod")?;
    let written: Vec<&Path> = std::iter::once(&*arguments.output).chain(arguments.json.file()).collect();
    output::check_files(&[Path::new(&arguments.mesh)], &written)?;
    let begun = Instant::now();
    // The command builds even if the cache has the hierarchy.
    let options = palpate::OpenOptions { cache: false, ..arguments.reading.options() };
    if Path::new(&arguments.mesh).extension().is_some_and(|found| found.eq_ignore_ascii_case("clod")) {
        return Err(palpate::errors::OpenError::NotAMesh { path: arguments.mesh.clone() }.into());
    }
    let object = progress::open(&arguments.mesh, &options)?;
    let seconds = begun.elapsed().as_secs_f64();
    object.clod.save(&arguments.output).map_err(|error| Failure::writing(&arguments.output, error))?;
    show(&object, Some(seconds), &arguments.json)
}

pub fn inspect(arguments: &InspectArguments) -> Result<(), Failure> {
    let read = [Path::new(&arguments.hierarchy)];
    output::check_files(&read, arguments.json.file().as_slice())?;
    if let Some(folder) = &arguments.pictures.render {
        output::check_folder(folder)?;
    }
    let object = progress::open(&arguments.hierarchy, &arguments.reading.options())?;
    if let Some(folder) = &arguments.pictures.render {
        draw(&object, folder, arguments)?;
    }
    show(&object, None, &arguments.json)
}

/// Writes a picture of each level in the options, and the contact sheet.
fn draw(object: &Object, folder: &Path, arguments: &InspectArguments) -> Result<(), Failure> {
    let Pictures { size, levels, azimuth, elevation, .. } = &arguments.pictures;
    let clod = &object.clod;
    let last = clod.levels.len() - 1;
    if let Some(level) = levels.iter().find(|level| **level > last) {
        let name = &object.name;
        return Err(Failure::Message(format!("--levels {level}: {name} has the levels 0 to {last}")));
    }
    let levels: BTreeSet<usize> =
        if levels.is_empty() { (0..=last).collect() } else { levels.iter().copied().collect() };

    if !folder.exists() {
        std::fs::create_dir(folder).map_err(|error| Failure::writing(folder, error))?;
    }
    let paths: Vec<PathBuf> =
        levels.iter().map(|level| folder.join(format!("level-{level:02}.png"))).collect();
    let sheet = folder.join("levels.png");
    let written: Vec<&Path> =
        paths.iter().map(PathBuf::as_path).chain([&*sheet]).chain(arguments.json.file()).collect();
    output::check_files(&[Path::new(&arguments.hierarchy)], &written)?;

    let mut view = match model_of(&object.name, clod) {
        Some(model) => views::of_model(model),
        None => views::around(clod.leaves().iter().flat_map(|node| clod.extreme(node))),
    };
    if azimuth.is_some() || elevation.is_some() {
        view.roll = 0.0;
    }
    view.azimuth = azimuth.map_or(view.azimuth, f64::to_radians);
    view.elevation = elevation.map_or(view.elevation, f64::to_radians);

    let bar = progress::bar("drawing");
    let pictures = LevelPictures::new(clod, &view, *size);
    let mut drawn = Vec::new();
    for (level, path) in levels.iter().zip(&paths) {
        let picture = pictures.level(*level);
        picture.save(path).map_err(|error| Failure::writing(path, error))?;
        drawn.push((*level, picture));
        progress::set(&bar, drawn.len() as f64 / levels.len() as f64);
    }
    bar.finish_and_clear();
    pictures.sheet(&drawn).save(&sheet).map_err(|error| Failure::writing(&sheet, error))
}

/// Built-in model at the size in the dissertation's tables, recognised by the object's or its file's name and
/// triangle count.
fn model_of(name: &str, clod: &Clod) -> Option<Model> {
    let stem = Path::new(name).file_stem()?.to_str()?;
    let model = Model::ALL.into_iter().find(|model| model.name() == stem)?;
    let ratio = f64::from(clod.source.triangles) / model.default_triangles() as f64;
    // Models are generated to within 2 % of their size.
    ((ratio - 1.0).abs() <= 0.02).then_some(model)
}

fn show(object: &Object, seconds: Option<f64>, json: &Json) -> Result<(), Failure> {
    let inspection = inspection(object, seconds);
    output::result(json, &inspection, |table| {
        rows_of_table_3_2(table, &inspection);
        table.row([]);
        rows_of_levels(table, &inspection);
    })
}

fn rows_of_table_3_2(table: &mut Table, inspection: &Inspection) {
    const HEADINGS: [&str; 9] =
        ["", "Orig. Tris", "Orig. BVs", "Simp. Tris", "Simp. BVs", "r_1", "r_λ", "Free CLODs", "Total CLODs"];
    table.row(HEADINGS.each_ref().map(|heading| heading as &dyn Display));
    let mut row = |name: &str, columns: &Table32| {
        let count = |number: u32, width: usize| format!("{:>width$}", grouped(number as usize));
        table.row([
            &name,
            &count(columns.original_triangles, 10),
            &count(columns.original_patches, 9),
            &count(columns.simplified_triangles, 10),
            &count(columns.simplified_patches, 9),
            &columns.finest_resolution.map_or("–".to_owned(), |finest| format!("{finest:.1}")),
            &format!("{:.2}", columns.coarsest_resolution),
            &count(columns.free_levels, 10),
            &count(columns.levels, 11),
        ]);
    };
    row(&inspection.name, &inspection.table);
    if let Some(published) = &inspection.published {
        row("dissertation, Table 3.2", published);
    }
}

fn rows_of_levels(table: &mut Table, inspection: &Inspection) {
    let radius = inspection.bounding_radius;
    table.row([
        &"level",
        &"triangles",
        &" patches",
        &" r·R",
        &"s, % of R: median",
        &"   max",
        &"h, % of R: median",
        &"   max",
        &"      bytes",
    ]);
    for level in &inspection.levels {
        let percent = |length: f64, width: usize| format!("{:>width$.3}", 100.0 * length / radius);
        // The hulls of a free level have no patches to deviate from the surface.
        let deviation = |length: f64, width: usize| {
            if level.free { format!("{:>width$}", "–") } else { percent(length, width) }
        };
        table.row([
            &format!("{:>5}", level.level),
            &format!("{:>9}", grouped(level.triangles as usize)),
            &format!("{:>8}", grouped(level.patches as usize)),
            &format!("{:>5.1}", level.resolution * radius),
            &deviation(level.median_deviation, 17),
            &deviation(level.max_deviation, 6),
            &percent(level.median_hausdorff, 17),
            &percent(level.max_hausdorff, 6),
            &format!("{:>11}", grouped(level.bytes)),
            &if level.free { "free" } else { "" },
        ]);
    }
    table.row([]);
    table.row([&"bounding radius R", &format!("{radius:.6} m")]);
    table.row([&"memory", &format!("{} bytes", grouped(inspection.bytes))]);
    if let Some(seconds) = inspection.seconds {
        table.row([&"built in", &format!("{seconds:.1} s")]);
    }
}

fn inspection(object: &Object, seconds: Option<f64>) -> Inspection {
    let clod = &*object.clod;
    let entry = |(level, figures): (usize, LevelFigures)| LevelEntry {
        level,
        triangles: figures.triangles,
        patches: figures.patches,
        resolution: figures.resolution,
        free: figures.free,
        max_deviation: figures.deviation.max,
        max_hausdorff: figures.hausdorff.max,
        median_deviation: figures.deviation.median,
        median_hausdorff: figures.hausdorff.median,
        bytes: figures.bytes,
    };
    Inspection {
        name: object.name.clone(),
        vertices: clod.source.vertices,
        triangles: clod.source.triangles,
        patches: clod.leaves().len(),
        seconds,
        peak_rss_bytes: peak_memory(),
        bounding_radius: clod.bounding_radius(),
        bytes: clod.total_bytes(),
        table: Table32::of(clod),
        published: model_of(&object.name, clod).and_then(Table32::published),
        levels: LevelFigures::of(clod).into_iter().enumerate().map(entry).collect(),
    }
}

/// Peak memory of this process, bytes; `None` if the system does not report it (Linux does).
fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_are_models_by_name_and_size() {
        let mut clod =
            Object::model("ellipsoid@500").map(|object| Clod::clone(&object.clod)).expect("ellipsoid");
        for (name, triangles, model) in [
            ("spoon", 86_016, Some(Model::Spoon)),
            ("folder/spoon.clod", 85_648, Some(Model::Spoon)),
            ("spoon.obj", 86_016, Some(Model::Spoon)),
            ("spoon.clod", 1_344, None),
            ("spoon@20000", 20_000, None),
            ("fork.clod", 86_016, None),
        ] {
            clod.source.triangles = triangles;
            assert_eq!(model_of(name, &clod), model, "{name}");
        }
    }
}
