//! Time of distance and intersection queries along recorded trajectories, pose by pose.
//!
//! `cargo bench -p palpate-benches --bench proximity` prints the median and the 99th percentile of a query in
//! microseconds: of the built-in jaws along the recorded trajectory, and of the jaws and the spoon and cup of the
//! `../shared` folder where there is one. `tracked` queries follow the path with one workspace, `fresh` ones forget
//! what the last one found.

#![allow(missing_docs, reason = "a benchmark")]
#![expect(clippy::print_stdout, reason = "prints its results")]

use std::hint::black_box;
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;

use palpate::collide::ProximityQuery;
use palpate::device::{Interpolation, MotionPath};
use palpate::{Object, OpenOptions, Pose};

const VALID: &str = "valid poses";

/// Times that a path is followed; of each pose the least time counts, which other processes disturb least.
const PASSES: usize = 5;

fn open(name: &str) -> Object {
    Object::open(name, &OpenOptions::default(), &mut |_, _| ControlFlow::Continue(())).expect("model")
}

fn poses(path: &Path) -> Vec<Pose> {
    let path = MotionPath::load(path, Interpolation::Linear).expect("trajectory");
    path.keyframes().iter().map(|keyframe| keyframe.pose).collect()
}

/// Prints the time of `ask` along a path, and its effort.
fn time(
    name: &str,
    query: &mut ProximityQuery,
    poses: &[Pose],
    mut ask: impl FnMut(&mut ProximityQuery, &Pose),
) {
    let mut least = vec![f64::INFINITY; poses.len()];
    let (mut pairs, mut triangles, mut restarts, mut front) = (0, 0, 0, 0);
    for _ in 0..PASSES {
        query.reset();
        for (pose, least) in poses.iter().zip(&mut least) {
            let start = Instant::now();
            ask(query, pose);
            *least = least.min(1e6 * start.elapsed().as_secs_f64());
            let effort = query.effort();
            pairs += effort.pairs;
            triangles += effort.triangle_pairs;
            restarts += usize::from(effort.from_roots);
            front = front.max(effort.front);
        }
    }
    least.sort_by(f64::total_cmp);
    let at = |part: f64| least[(part * (least.len() - 1) as f64) as usize];
    let per_query = |count: usize| count as f64 / (PASSES * poses.len()) as f64;
    println!(
        "{name:32} {:9.2} {:9.2} {:9.2} | {:8.1} {:8.1} {:8.3} {front:8}",
        at(0.5),
        at(0.99),
        at(1.0),
        per_query(pairs),
        per_query(triangles),
        per_query(restarts),
    );
}

fn scenario(name: &str, probe: &str, scene: &str, path: &Path) {
    let (probe, scene) = (open(probe), open(scene));
    let poses = poses(path);
    let mut query = ProximityQuery::new(probe.shape(), scene.shape());
    let unbounded = |query: &mut ProximityQuery, pose: &Pose| {
        black_box(query.distance(pose, &Pose::IDENTITY, f64::INFINITY).expect(VALID));
    };
    let meeting = |query: &mut ProximityQuery, pose: &Pose| {
        black_box(query.intersects(pose, &Pose::IDENTITY).expect(VALID));
    };
    let mut meet = 0;
    for pose in &poses {
        meet += usize::from(query.intersects(pose, &Pose::IDENTITY).expect(VALID).intersects());
    }
    println!("{name}: {} poses, {meet} of them intersecting", poses.len());
    time("  distance, tracked", &mut query, &poses, unbounded);
    time("  intersects, tracked", &mut query, &poses, meeting);
    time("  distance, fresh", &mut query, &poses, |query, pose| {
        query.reset();
        unbounded(query, pose);
    });
    time("  intersects, fresh", &mut query, &poses, |query, pose| {
        query.reset();
        meeting(query, pose);
    });
}

fn main() {
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    println!(
        "{:32} {:>9} {:>9} {:>9} | per query: pairs, triangle pairs, restarts; largest front",
        "µs", "median", "p99", "max"
    );
    scenario("built-in jaws", "upper-jaw", "lower-jaw", &root.join("assets/trajectories/jaws.csv"));
    let shared = root.join("../shared");
    for (name, probe, scene, path) in [
        ("jaws", "jaw_lower.obj", "jaw_upper.obj", "jaws.csv"),
        ("spoon and cup", "spoon.obj", "cup.obj", "spooncup.csv"),
    ] {
        let model = |file: &str| shared.join("models/scenarios").join(file).to_string_lossy().into_owned();
        let path = shared.join("trajectories").join(path);
        if path.exists() {
            scenario(name, &model(probe), &model(scene), &path);
        } else {
            println!("{name}: skipped, no {}", path.display());
        }
    }
}
