//! Time of a contact query and of clustering its contacts: the upper jaw on the lower one, along a recorded
//! trajectory.
//!
//! `cargo bench -p palpate-benches --bench contact_query`. An iteration of `contact_query/jaws` runs through
//! all poses; the throughput is in poses. `contact_query/jaws_closed` is the pose with the most contacts
//! alone, from the roots. `…/2.5%` leaves out detail below that error, as a part of the probe's radius. With
//! the environment variables `PALPATE_PROBE`, `PALPATE_SCENE` and `PALPATE_TRAJECTORY` (mesh or `.clod` files
//! by their whole paths, or built-in models, and poses as of `palpate query`) it measures these, as `own` in
//! place of `jaws`.

#![allow(missing_docs, reason = "a benchmark")]

use std::hint::black_box;
use std::path::Path;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use palpate::clod_build::unwatched;
use palpate::collide::{Clustering, ContactQuery, QuerySettings};
use palpate::device::{Interpolation, MotionPath};
use palpate::{Object, OpenOptions, Pose};

/// Step between the poses of the trajectory that are used.
const STRIDE: usize = 10;
/// Tolerance relative to the probe's radius.
const TOLERANCE: f64 = 0.01;
/// Error threshold relative to the probe's radius (§3.5.2).
const ERROR: f64 = 0.025;
/// Number of contact clusters (§5.5.1).
const CLUSTERS: usize = 5;

/// Returns the name of the measurements, and the probe, the scene object and the trajectory.
fn subject() -> (&'static str, [String; 3]) {
    let given = ["PALPATE_PROBE", "PALPATE_SCENE", "PALPATE_TRAJECTORY"].map(|name| std::env::var(name).ok());
    if let [Some(probe), Some(scene), Some(trajectory)] = given {
        return ("own", [probe, scene, trajectory]);
    }
    assert!(
        given.iter().all(Option::is_none),
        "give PALPATE_PROBE, PALPATE_SCENE and PALPATE_TRAJECTORY together"
    );
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../assets/trajectories/jaws.csv");
    ("jaws", ["upper-jaw", "lower-jaw", file].map(str::to_owned))
}

fn queries(criterion: &mut Criterion) {
    let (subject, [probe, scene, file]) = subject();
    let [probe, scene] = [probe, scene].map(|name| {
        let opened = Object::open(&name, &OpenOptions::default(), &mut unwatched);
        opened.expect("an object")
    });
    let path = MotionPath::load(Path::new(&file), Interpolation::Linear).expect("trajectory");
    let poses: Vec<Pose> = path.keyframes().iter().step_by(STRIDE).map(|keyframe| keyframe.pose).collect();
    let settings = QuerySettings::new(TOLERANCE * probe.bounding_radius());
    let mut query = ContactQuery::new(probe.shape(), scene.shape());
    let mut run = |pose: &Pose| {
        query.run(pose, &Pose::IDENTITY, &settings).expect("valid poses and settings");
        query.contacts().to_vec()
    };
    let closed = poses.iter().map(|pose| (run(pose), *pose)).max_by_key(|(contacts, _)| contacts.len());
    let (contacts, closed) = closed.expect("the trajectory has poses");

    let mut group = criterion.benchmark_group("contact_query");
    group.throughput(Throughput::Elements(poses.len() as u64)).sample_size(10);
    let mut query = ContactQuery::new(probe.shape(), scene.shape());
    let coarse = QuerySettings { error: (ERROR * probe.bounding_radius()).into(), ..settings };
    for (error, settings) in [("", &settings), ("/2.5%", &coarse)] {
        group.bench_function(format!("{subject}{error}"), |bencher| {
            bencher.iter(|| {
                for pose in &poses {
                    black_box(query.run(pose, &Pose::IDENTITY, settings).expect("valid poses and settings"));
                }
            });
        });
    }
    group.throughput(Throughput::Elements(1));
    for (error, settings) in [("", &settings), ("/2.5%", &coarse)] {
        group.bench_function(format!("{subject}_closed{error}"), |bencher| {
            bencher.iter(|| {
                query.reset();
                black_box(query.run(&closed, &Pose::IDENTITY, settings).expect("valid poses and settings"))
            });
        });
    }
    group.finish();

    let mut clustering = Clustering::new(CLUSTERS);
    let mut group = criterion.benchmark_group("clustering");
    group.throughput(Throughput::Elements(contacts.len() as u64));
    group.bench_function(format!("{subject}_closed"), |bencher| {
        bencher.iter(|| black_box(clustering.run(&contacts, settings.tolerance, &closed).len()));
    });
    group.finish();
}

criterion_group!(benches, queries);
criterion_main!(benches);
