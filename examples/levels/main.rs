//! Compares variants of the hierarchy of contact levels of detail (§3.6.2): the hierarchy of a model, and the
//! cost of an exact contact query between two models with each.
//!
//! `cargo run --release --example levels` does it for the models of Table 3.2, which takes minutes; `--
//! upper-jaw/lower-jaw spoon@20000` for a pair in contact and for a model in contact with a copy of itself.
//! All numbers are counts or lengths, the same on every machine, except those that `--seconds` adds.

#![allow(clippy::print_stdout, reason = "it prints tables")]

mod encounter;

use std::collections::BTreeMap;
use std::error::Error;
use std::sync::Mutex;
use std::time::Instant;

use palpate::clod_build::{BuildError, BuildOptions, build, unwatched};
use palpate::collide::{ContactQuery, QuerySettings, Shape};
use palpate::core::Clod;
use palpate::models::Model;
use palpate::{Pose, TriMesh};
use palpate_examples::CommandLine;
use palpate_report::{Table32, grouped};

/// Models of Table 3.2 in pairs that come into contact.
const PAIRS: [&str; 4] =
    ["upper-jaw/lower-jaw", "ball-joint-ball/ball-joint-socket", "golf-club/golf-ball", "spoon/cup"];

const HELP: [&str; 2] = [
    "PROBE/SCENE    Two built-in models (NAME or NAME@TRIANGLES) that are brought into contact; or MODEL, with a copy of itself",
    "--seconds      Also measure how long each build takes, one after the other",
];

/// Distance at which contact begins, relative to the probe's bounding radius.
const TOLERANCE: f64 = 0.01;

/// Name of a variant, and its build options.
type Variant = (&'static str, fn(BuildOptions) -> BuildOptions);

const VARIANTS: [Variant; 5] = [
    ("default", |options| options),
    ("plain h", |options| BuildOptions { bounding_points: 0, ..options }),
    ("containing", |options| BuildOptions { bounding_points: u32::MAX, ..options }),
    ("renewed", |options| BuildOptions { carried: false, ..options }),
    ("not simplified", |options| BuildOptions { simplify: false, ..options }),
];

/// Hierarchy, and its build time, s.
struct Built {
    clod: Clod,
    seconds: f64,
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut line =
        CommandLine::new("Compares the variants of the hierarchy of contact levels of detail", &HELP);
    let seconds = line.flag("--seconds");
    let named = line.others()?;
    let names = if named.is_empty() { PAIRS.map(str::to_owned).to_vec() } else { named };
    let pairs: Vec<[&str; 2]> = names
        .iter()
        .map(|text| text.split_once('/').map_or([&**text; 2], |(probe, scene)| [probe, scene]))
        .collect();
    let mut meshes: BTreeMap<&str, (Model, TriMesh)> = BTreeMap::new();
    for name in pairs.iter().flatten().copied() {
        let (model, triangles) = Model::parse(name)?;
        meshes.insert(name, (model, model.generate(triangles)?));
    }

    let (mut hierarchies, mut queries) = (Vec::new(), Vec::new());
    for pair in &pairs {
        let names = if pair[0] == pair[1] { &pair[..1] } else { &pair[..] };
        let built = build_variants(names, &meshes, seconds)?;
        for (of_model, name) in built.iter().zip(names) {
            for (built, (variant, _)) in of_model.iter().zip(&VARIANTS) {
                hierarchies.push(row_of_hierarchy(name, variant, built, seconds));
            }
        }
        let models = pair.map(|name| meshes[name].0);
        let (probes, scenes) = (&built[0], &built[built.len() - 1]);
        let poses = encounter::poses(models, &probes[0].clod, &scenes[0].clod)
            .map_err(|problem| format!("{} and {}: {problem}", pair[0], pair[1]))?;
        let mut contacts = None;
        for ((probe, scene), (variant, _)) in probes.iter().zip(scenes).zip(&VARIANTS) {
            let cost = Cost::of(&probe.clod, &scene.clod, &poses);
            // The variants differ above the leaves, which report the contacts.
            if contacts.is_some_and(|contacts| contacts != cost.contacts) {
                return Err(format!("{} on {}: {variant} has other contacts", pair[0], pair[1]).into());
            }
            contacts = Some(cost.contacts);
            queries.push(cost.row(&format!("{} on {}", pair[0], pair[1]), variant));
        }
    }

    let column = if seconds { " s |" } else { "" };
    println!(
        "| model | variant | triangles | patches | r₁·R | r_λ·R | free levels | levels | MB | median h, % of R | greatest h |{column}"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|{}", if seconds { "---|" } else { "" });
    hierarchies.iter().for_each(|row| println!("{row}"));
    println!();
    println!("| query | variant | visited pairs | convex queries | front | contacts |");
    println!("|---|---|---|---|---|---|");
    queries.iter().for_each(|row| println!("{row}"));
    Ok(())
}

/// Builds all variants of some models, on all cores or one after the other.
fn build_variants(
    names: &[&str],
    meshes: &BTreeMap<&str, (Model, TriMesh)>,
    one_by_one: bool,
) -> Result<Vec<Vec<Built>>, BuildError> {
    let jobs: Vec<(&TriMesh, BuildOptions)> = names
        .iter()
        .flat_map(|name| {
            let mesh = &meshes[name].1;
            let simplified = BuildOptions { simplify: true, ..BuildOptions::default() };
            VARIANTS.iter().map(move |(_, of)| (mesh, of(simplified.clone())))
        })
        .collect();
    let cores = if one_by_one { 1 } else { std::thread::available_parallelism().map_or(1, usize::from) };
    let waiting = Mutex::new(jobs.iter().enumerate());
    let done = Mutex::new(BTreeMap::new());
    std::thread::scope(|scope| {
        for _ in 0..cores {
            scope.spawn(|| {
                loop {
                    let next = waiting.lock().ok().and_then(|mut jobs| jobs.next());
                    let Some((index, (mesh, options))) = next else { break };
                    let start = Instant::now();
                    let built = build(mesh, options, &mut unwatched)
                        .map(|clod| Built { clod, seconds: start.elapsed().as_secs_f64() });
                    if let Ok(mut done) = done.lock() {
                        done.insert(index, built);
                    }
                }
            });
        }
    });
    let mut built = done.into_inner().unwrap_or_default().into_values();
    names.iter().map(|_| built.by_ref().take(VARIANTS.len()).collect()).collect()
}

fn row_of_hierarchy(name: &str, variant: &str, built: &Built, seconds: bool) -> String {
    let Built { clod, seconds: took } = built;
    let table = Table32::of(clod);
    let regular = clod.levels.iter().filter(|level| !level.free).count();
    // Leaves have no descendants, so no h.
    let mut hausdorff: Vec<f64> =
        (1..regular).flat_map(|level| clod.level(level)).map(|node| node.hausdorff).collect();
    hausdorff.sort_unstable_by(f64::total_cmp);
    let percent = |h: Option<&f64>| {
        h.map_or("–".to_owned(), |h| format!("{:.2}", 100.0 * h / clod.bounding_radius()))
    };
    let mut row = format!(
        "| {name} | {variant} | {} | {} | {} | {:.2} | {} | {} | {:.1} | {} | {} |",
        grouped(table.simplified_triangles as usize),
        grouped(table.simplified_patches as usize),
        table.finest_resolution.map_or("–".to_owned(), |r| format!("{r:.1}")),
        table.coarsest_resolution,
        table.free_levels,
        table.levels,
        clod.total_bytes() as f64 / 1e6,
        percent(hausdorff.get(hausdorff.len() / 2)),
        percent(hausdorff.last()),
    );
    if seconds {
        row += &format!(" {took:.1} |");
    }
    row
}

/// Total cost of the queries at some poses.
#[derive(Default)]
struct Cost {
    poses: usize,
    visited: usize,
    convex_queries: usize,
    front: usize,
    contacts: usize,
}

impl Cost {
    fn of(probe: &Clod, scene: &Clod, poses: &[Pose]) -> Self {
        let settings = QuerySettings::new(TOLERANCE * probe.bounding_radius());
        let mut query = ContactQuery::new(&Shape::new(probe.clone()), &Shape::new(scene.clone()));
        let mut cost = Self { poses: poses.len(), ..Self::default() };
        for pose in poses {
            query.reset();
            let outcome = query.run(pose, &Pose::IDENTITY, &settings).expect("valid poses and settings");
            cost.visited += outcome.visited;
            cost.convex_queries += outcome.convex_queries;
            cost.front += outcome.front;
            cost.contacts += outcome.contacts;
        }
        cost
    }

    /// Returns the means over the poses as a table row.
    fn row(&self, pair: &str, variant: &str) -> String {
        let [visited, convex_queries, front, contacts] =
            [self.visited, self.convex_queries, self.front, self.contacts]
                .map(|sum| grouped((sum + self.poses / 2) / self.poses));
        format!("| {pair} | {variant} | {visited} | {convex_queries} | {front} | {contacts} |")
    }
}
