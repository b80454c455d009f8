//! The levels of detail of built-in and real models have the properties that they promise (§3.2, §3.3.5), as
//! far as dense sampling shows: see [`palpate_tests::levels`]. Faults are collected over all models before
//! the test fails.

use std::collections::BTreeMap;
use std::io::Write as _;

use palpate::TriMesh;
use palpate::clod_build::{BuildOptions, build, unwatched};
use palpate::core::clod::{Node, Parts};
use palpate::glam::DVec3;
use palpate::mesh_io::{LoadOptions, load};
use palpate::models::{Model, ModelError};
use palpate_tests::levels::{Examination, Findings};
use palpate_tests::shared;

const SEED: u64 = 0x1e7e15;

fn simplified(mesh: &TriMesh) -> Parts {
    built_with(mesh, &BuildOptions::default())
}

fn built_with(mesh: &TriMesh, options: &BuildOptions) -> Parts {
    match build(mesh, options, &mut unwatched) {
        Ok(clod) => clod.parts(),
        Err(error) => panic!("{error}"),
    }
}

fn examination(samples: usize, hull_samples: usize) -> Examination {
    Examination { samples, hull_samples, tolerance: BuildOptions::default().tolerance, seed: SEED }
}

/// Prints to the stream directly, since the test runner captures the print macros.
fn say(text: &str) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// Builds and examines models one after the other (both use all cores), and fails at the end if there was a
/// fault.
fn examine(models: impl Iterator<Item = (String, TriMesh)>, examination: &Examination) {
    let (mut faults, mut checks) = (Vec::new(), BTreeMap::<&str, usize>::new());
    let mut count = 0;
    for (name, mesh) in models {
        let begun = std::time::Instant::now();
        let clod = simplified(&mesh);
        let (built, begun) = (begun.elapsed(), std::time::Instant::now());
        let found = examination.of(&mesh, &clod);
        let levels = clod.levels.len();
        say(&format!(
            "{name}: {levels} levels built in {built:.1?}, examined in {:.1?}, {} faults\n  {}",
            begun.elapsed(),
            found.faults.len(),
            found.levels.join("\n  ")
        ));
        for fault in &found.faults {
            say(&format!("  FAULT {fault}"));
        }
        faults.extend(found.faults.iter().map(|fault| format!("{name}, {fault}")));
        for (check, times) in found.checks {
            *checks.entry(check).or_default() += times;
        }
        count += 1;
    }
    say(&format!("{count} models, seed {SEED:#x}, checks made: {checks:?}"));
    assert!(count == 0 || checks.len() == 10 && checks.values().all(|n| *n > 0), "{checks:?}");
    assert!(faults.is_empty(), "{} faults:\n{}", faults.len(), faults.join("\n"));
}

/// Returns a model with about so many triangles, or the fewest that it can have.
fn reduced(model: Model, triangles: usize) -> TriMesh {
    match model.generate(triangles) {
        Err(ModelError::OutOfRange { min, .. }) => model.generate(min).expect("the fewest triangles"),
        other => other.expect("in range"),
    }
}

#[test]
fn built_in_models_keep_their_promises() {
    // The low-resolution cup and spoon have the shapes of the cup and the spoon, and the gear's teeth need
    // more triangles than others.
    let models = Model::ALL.into_iter().filter(|model| ![Model::CupLow, Model::SpoonLow].contains(model));
    let sized = models.map(|model| (model, if model == Model::Gear { 6000 } else { 1200 }));
    let models = sized.map(|(model, triangles)| (model.name().to_owned(), reduced(model, triangles)));
    examine(models, &examination(4000, 4));
}

/// Returns whether `PALPATE_LEVELS`, if set, is part of the model's name.
fn is_chosen(name: &str) -> bool {
    std::env::var("PALPATE_LEVELS").map_or(true, |part| name.contains(&part))
}

#[test]
#[ignore = "for a release build: cargo test --release -p palpate-tests --test it levels:: -- --ignored --nocapture"]
fn built_in_models_of_full_size_keep_their_promises() {
    examine_full_size(|triangles| triangles <= MAX_QUICK_TRIANGLES);
}

#[test]
#[ignore = "some minutes, for a release build: cargo test --release -p palpate-tests --test it levels:: -- --ignored --nocapture"]
fn large_models_of_full_size_keep_their_promises() {
    examine_full_size(|triangles| triangles > MAX_QUICK_TRIANGLES);
}

/// Triangle count from which models take minutes; their detail is meant for textures, which Table 3.2 does
/// not have.
const MAX_QUICK_TRIANGLES: usize = 200_000;

fn examine_full_size(size: impl Fn(usize) -> bool) {
    let models = Model::ALL.into_iter().filter(|model| is_chosen(model.name()));
    let sized =
        models.map(|model| (model, model.default_triangles())).filter(|(_, triangles)| size(*triangles));
    let meshes = sized.map(|(model, triangles)| {
        (model.name().to_owned(), model.generate(triangles).expect("the default is in range"))
    });
    examine(meshes, &examination(200_000, 4));
}

/// On the optional real models.
#[test]
#[ignore = "for a release build: cargo test --release -p palpate-tests --test it levels:: -- --ignored --nocapture"]
fn real_models_keep_their_promises() {
    let mut files = Vec::new();
    for folder in ["models/good", "models/scenarios"] {
        let Some(folder) = shared(folder) else { continue };
        let entries = folder.read_dir().expect("folder").map(|entry| entry.expect("entry").path());
        files.extend(entries.filter(|path| {
            let extension = path.extension().and_then(|e| e.to_str());
            extension.is_some_and(|e| ["obj", "stl", "glb", "ply"].contains(&e))
                && is_chosen(&path.to_string_lossy())
        }));
    }
    files.sort();
    let models = files.into_iter().map(|path| {
        let loaded = load(&path, &LoadOptions::default()).unwrap_or_else(|error| panic!("{error}"));
        (path.file_name().unwrap_or_default().to_string_lossy().into_owned(), loaded.mesh)
    });
    examine(models, &examination(200_000, 4));
}

fn faults_of(mesh: &TriMesh, clod: &Parts) -> Findings {
    examination(20_000, 4).of(mesh, clod)
}

/// Damage of each kind is found, so that the examination is not vacuous.
#[test]
fn damage_is_found() {
    let mesh = Model::Torus.generate(1500).expect("in range");
    let sound = simplified(&mesh);
    assert_eq!(faults_of(&mesh, &sound).faults, Vec::<String>::new());
    let regular = sound.levels.iter().filter(|level| !level.free).count();
    assert!(regular > 2, "{regular} levels");
    let coarsest = sound.levels[regular - 1].nodes.clone();
    let radius = sound.bounding_radius();

    type Damage<'a> = &'a dyn Fn(&mut Parts);
    let shrink = |value: &mut f64| *value *= 0.5;
    let damages: [(&str, Damage<'_>); 10] = [
        ("surface deviation", &|c| {
            coarsest.clone().for_each(|n| shrink(&mut c.nodes[n as usize].deviation));
        }),
        ("Hausdorff distance", &|c| {
            coarsest.clone().for_each(|n| shrink(&mut c.nodes[n as usize].hausdorff));
        }),
        // A sphere so large that it is nearly a plane, which touches a node's hull where a descendant's hull
        // protrudes.
        ("spheres", &|c| {
            let beyond = c.nodes.iter().enumerate().find_map(|(k, node)| {
                let middle = node.center;
                let reach = |node: &Node, d: DVec3| {
                    c.bounding_hull(node).iter().map(|p| d.dot(*p - middle)).fold(f64::MIN, f64::max)
                };
                let directions = [-1.0, 0.0, 1.0].map(|x| [-1.0, 0.0, 1.0].map(|y| [x, y]));
                directions
                    .into_iter()
                    .flatten()
                    .flat_map(|[x, y]| [-1.0, 1.0].map(|z| DVec3::new(x, y, z)))
                    .find_map(|d| {
                        let d = d.normalize();
                        let below = c.children(node).iter().map(|n| reach(n, d)).fold(f64::MIN, f64::max);
                        (below > reach(node, d) + 1e-3 * radius).then_some((k, middle - 1e4 * radius * d))
                    })
            });
            let (k, center) = beyond.expect("hulls reach beyond their parents'");
            let own = c.bounding_hull(&c.nodes[k]).iter().map(|p| p.distance(center)).fold(0.0, f64::max);
            (c.nodes[k].center, c.nodes[k].radius) = (center, own);
        }),
        ("added points", &|c| {
            let node = c.nodes.iter_mut().find(|n| n.added > 0).expect("points are added");
            node.radius += radius;
            c.vertices[(node.vertices.start - node.added) as usize] += DVec3::splat(0.01 * radius);
        }),
        // One copy of a vertex that several patches share is displaced, which makes a crack.
        ("surface", &|c| {
            let node = &mut c.nodes[coarsest.start as usize];
            node.radius += radius;
            c.vertices[node.vertices.start as usize] += DVec3::splat(0.01 * radius);
        }),
        // All vertices of a level are moved towards the middle of the object's hole.
        ("surface deviation", &|c| {
            let [first, last] =
                [coarsest.start, coarsest.end - 1].map(|n| c.nodes[n as usize].vertices.clone());
            for n in coarsest.clone() {
                c.nodes[n as usize].radius += radius;
            }
            for v in first.start..last.end {
                c.vertices[v as usize] *= 0.8;
            }
        }),
        ("hulls said to be contained", &|c| c.nodes[coarsest.start as usize].contained = false),
        ("surface", &|c| c.levels[1].resolution = 2.0 * c.levels[0].resolution),
        // Leaves turned inside out: their corners are above the planes, and the object is empty.
        ("convex patches", &|c| {
            let node =
                c.nodes[coarsest.start as usize..].iter().find(|n| n.triangles.len() > 2).expect("a patch");
            let triangles = node.triangles.start as usize..node.triangles.end as usize;
            c.triangles[triangles].iter_mut().for_each(|t| t.swap(0, 1));
        }),
        ("is not the mesh", &|c| {
            let first = c.leaves()[0].triangles.start as usize;
            c.triangles[first].swap(0, 1);
        }),
    ];
    for (what, damage) in damages {
        let mut clod = sound.clone();
        damage(&mut clod);
        let faults = faults_of(&mesh, &clod).faults;
        assert!(faults.iter().any(|fault| fault.contains(what)), "{what}: {faults:?}");
    }
}

fn bytes_of(clod: &Parts) -> Vec<u8> {
    let mut bytes = Vec::new();
    clod.write(&mut bytes).expect("the hierarchy is valid");
    bytes
}

#[test]
fn the_bytes_do_not_depend_on_the_number_of_threads() {
    for model in [Model::LowerJaw, Model::Cup, Model::Gear, Model::BallJointSocket] {
        let mesh = reduced(model, 2000);
        let built = [1, 2, 5].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start");
            bytes_of(&pool.install(|| simplified(&mesh)))
        });
        assert!(built[0] == built[1] && built[0] == built[2], "{}", model.name());
    }
}

/// Returns a difference between the hierarchies of a mesh in two units, apart from the unit. Numbers may
/// differ by a relative `rounding`, and lengths also by `rounding` times the bounding radius.
fn difference(one: &Parts, other: &Parts, scale: f64, rounding: f64) -> Option<String> {
    let shape =
        |clod: &Parts| clod.levels.iter().map(|l| (l.nodes.len(), l.triangles, l.free)).collect::<Vec<_>>();
    if shape(one) != shape(other) {
        return Some(format!("levels of {:?} and {:?} nodes and triangles", shape(one), shape(other)));
    }
    let links = |clod: &Parts| {
        let link =
            |n: &Node| (n.parent, n.children.clone(), n.vertices.clone(), n.extreme, n.contained, n.all_real);
        (clod.triangles.clone(), clod.nodes.iter().map(link).collect::<Vec<_>>())
    };
    if links(one) != links(other) {
        return Some("the same numbers of nodes, but not the same nodes".to_owned());
    }
    let size = one.bounding_radius();
    // Every number with its meaning and its power of the unit.
    let numbers = |clod: &Parts| {
        let mut numbers: Vec<(f64, i32, &str)> = Vec::new();
        numbers.extend(clod.vertices.iter().flat_map(|v| v.to_array()).map(|x| (x, 1, "vertex")));
        numbers.extend(clod.levels.iter().map(|level| (level.resolution, -1, "resolution")));
        numbers.extend(clod.nodes.iter().flat_map(|n| [(n.deviation, 1, "s"), (n.hausdorff, 1, "h")]));
        numbers.extend(clod.support_areas.iter().map(|area| (*area, 2, "support area")));
        for node in &clod.nodes {
            numbers.extend(node.center.to_array().map(|x| (x, 1, "centre")));
            numbers.push((node.radius, 1, "radius"));
        }
        numbers
    };
    let mut found = numbers(one).into_iter().zip(numbers(other)).filter_map(|((a, power, what), (b, ..))| {
        let b = b / scale.powi(power);
        let near = rounding * (a.abs() + size.powi(power));
        ((a - b).abs() > near).then(|| format!("{what} {a:e} and {b:e} in unit^{power}"))
    });
    let first = found.next()?;
    Some(format!("{first}, and {} others", found.count()))
}

fn in_other_unit(mesh: &TriMesh, scale: f64) -> TriMesh {
    let vertices = mesh.vertices().iter().map(|v| *v * scale).collect();
    TriMesh::new(vertices, mesh.triangles().to_vec()).expect("the same triangles")
}

/// Scaling by powers of two is exact.
#[test]
fn powers_of_two_change_only_the_units() {
    for model in [Model::Cup, Model::LowerJaw, Model::Hammer] {
        let mesh = reduced(model, 1000);
        let one = simplified(&mesh);
        for scale in [1.0 / 1024.0, 0.125, 1024.0] {
            let found = difference(&one, &simplified(&in_other_unit(&mesh, scale)), scale, 0.0);
            assert_eq!(found, None, "{} times {scale}", model.name());
        }
    }
}

/// Other factors round the coordinates and packed values, which changes numbers by as much, but no decision
/// and no promise.
#[test]
fn other_units_change_only_rounding() {
    for model in [Model::LowerJaw, Model::Cup, Model::Hammer, Model::GolfBall] {
        let mesh = reduced(model, 1000);
        let one = simplified(&mesh);
        for scale in [0.001, 0.0254, 1000.0] {
            let place = format!("{} times {scale}", model.name());
            let scaled = in_other_unit(&mesh, scale);
            let other = simplified(&scaled);
            assert_eq!(difference(&one, &other, scale, 5e-7), None, "{place}");
            assert_eq!(examination(2000, 1).of(&scaled, &other).faults, Vec::<String>::new(), "{place}");
        }
    }
}

/// Hierarchies built with other options keep their promises too.
#[test]
fn other_options_keep_their_promises() {
    let mesh = reduced(Model::LowerJaw, 1500);
    let usual = BuildOptions::default();
    let choices = [
        ("plain hulls", BuildOptions { bounding_points: 0, ..usual.clone() }),
        ("containing hulls", BuildOptions { bounding_points: u32::MAX, ..usual.clone() }),
        ("patches made anew", BuildOptions { carried: false, ..usual.clone() }),
        ("not simplified", BuildOptions { simplify: false, ..usual }),
    ];
    for (name, options) in choices {
        let clod = built_with(&mesh, &options);
        let faults = examination(4000, 4).of(&mesh, &clod).faults;
        assert_eq!(faults, Vec::<String>::new(), "{name}");
        let reach = clod.nodes.iter().map(|n| n.hausdorff).fold(0.0, f64::max);
        let contained = options.bounding_points == u32::MAX || !options.simplify;
        assert_eq!(reach == 0.0, contained, "{name}: {reach}");
    }
}
