//! The scenario of the two jaws along its path, against every pair of triangles.

mod oracle;

use std::path::{Path, PathBuf};

use palpate_clod_build::BuildOptions;
use palpate_collide::{ContactQuery, QuerySettings};
use palpate_core::glam::{DQuat, DVec3};
use palpate_core::{Clod, Pose, TriMesh};

fn shared() -> Option<PathBuf> {
    let shared = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    shared.is_dir().then_some(shared)
}

fn load(path: &Path) -> (TriMesh, Clod) {
    let mesh = palpate_mesh_io::load(path, &palpate_mesh_io::LoadOptions::default()).unwrap().mesh;
    let clod = palpate_clod_build::build(&mesh, &BuildOptions::default(), &mut |_, _| {}).unwrap();
    (mesh, clod)
}

fn path_of_poses(path: &Path) -> Vec<Pose> {
    let text = std::fs::read_to_string(path).unwrap();
    text.lines()
        .skip(1)
        .map(|line| {
            let x: Vec<f64> = line.split(',').map(|x| x.parse().unwrap()).collect();
            Pose::new(DVec3::new(x[1], x[2], x[3]), DQuat::from_xyzw(x[4], x[5], x[6], x[7]).normalize())
        })
        .collect()
}

/// CPU time of this thread, µs; 0 where there is no such file.
fn cpu_time() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split_whitespace().next().and_then(|x| x.parse::<f64>().ok()).unwrap_or(0.0) / 1e3
}

fn run(probe: &str, scene: &str, path: &str, every: usize) {
    let Some(shared) = shared() else {
        println!("skipped: no ../shared folder with models beside the repository");
        return;
    };
    let models = shared.join("models/scenarios");
    let (probe_mesh, probe) = load(&models.join(probe));
    let (scene_mesh, scene) = load(&models.join(scene));
    let poses = path_of_poses(&shared.join("trajectories").join(path));
    let radius = probe.bounding_radius();
    let tolerance = 0.01 * radius;
    let mut query = ContactQuery::new(&probe, &scene);
    let settings = QuerySettings::new(tolerance);
    let mut times = Vec::new();
    let mut last = Default::default();
    for pose in poses.iter().step_by(20) {
        let start = cpu_time();
        let outcome = query.run(&probe, pose, &scene, &Pose::IDENTITY, &settings);
        times.push((cpu_time() - start, outcome));
        last = outcome;
    }
    times.sort_by(|x, y| x.0.total_cmp(&y.0));
    println!(
        "CPU time, where the system tells it: median {:.0} us, max {:.0} us; median's {:?}",
        times[times.len() / 2].0,
        times.last().unwrap().0,
        times[times.len() / 2].1
    );
    println!("last {last:?}");
    let scene_triangles = oracle::placed(&scene_mesh, &Pose::IDENTITY);
    let mut compared = 0;
    for pose in poses.iter().step_by(every) {
        let outcome = query.run(&probe, pose, &scene, &Pose::IDENTITY, &settings);
        assert!(!outcome.refused && !outcome.overflow);
        let plain = oracle::pairs_within(&oracle::placed(&probe_mesh, pose), &scene_triangles, tolerance);
        let least = plain.iter().map(|p| p.2).reduce(f64::min);
        let meet = plain.iter().filter(|p| p.2 == 0.0).count();
        println!(
            "{} triangle pairs within d, {meet} intersecting, least {least:?}; {} contacts, least {:?}, deepest {:?}, unsure {}",
            plain.len(),
            outcome.contacts,
            outcome.smallest_distance,
            outcome.deepest,
            outcome.not_converged
        );
        match (least, outcome.smallest_distance) {
            (Some(x), Some(y)) if meet == 0 => assert!((x - y).abs() <= 1e-9 * radius, "{x} {y}"),
            (Some(_), Some(y)) => assert_eq!(y, 0.0),
            (x, y) => assert_eq!(x, y),
        }
        compared += 1;
    }
    assert!(compared > 2);
}

#[test]
fn jaws_along_their_path() {
    run("jaw_lower.obj", "jaw_upper.obj", "jaws.csv", 250);
}

#[test]
fn spoon_in_the_cup() {
    run("spoon.obj", "cup.obj", "spooncup.csv", 250);
}
