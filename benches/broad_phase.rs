//! Time of a scene query with 1 to 10,000 instances, one of them in contact.
//!
//! `cargo bench -p palpate-benches --bench broad_phase`. The probe, an ellipsoid, slides over one of the golf
//! balls that stand in a cubic lattice, 0.1 mm a run.
//!
//! - `still`: nothing else moves. `contact_query` is the query with the touched object alone.
//! - `tenth moves`: so does every tenth instance, to and fro by 1 mm.
//! - `jump`: the probe leaps to and fro across the lattice, so that every object has to be looked at.
//! - `tree/…`: the broad phase alone by parry's tree of boxes: the boxes of the objects that move are changed
//!   and the tree is refitted, then it is asked which reach into the probe's box.

#![allow(missing_docs, reason = "a benchmark")]

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use palpate::collide::{ContactQuery, ObjectHandle, QuerySettings, SceneQuery};
use palpate::glam::DVec3;
use palpate::{Object, Pose};
use parry3d_f64::bounding_volume::Aabb;
use parry3d_f64::math::Vector;
use parry3d_f64::partitioning::{Bvh, BvhBuildStrategy};

const INSTANCES: [usize; 5] = [1, 10, 100, 1000, 10_000];
/// Distance of the instances, in radii.
const SPACING: f64 = 4.0;
/// Displacements per run of the probe and of the moving instances, m.
const STEP: f64 = 1e-4;
const SHIFT: f64 = 1e-3;

struct Setting {
    probe: Object,
    ball: Object,
    settings: QuerySettings,
}

impl Setting {
    fn new() -> Self {
        let probe = Object::model("ellipsoid@500").expect("a model");
        let ball = Object::model("golf-ball@5000").expect("a model");
        let settings = QuerySettings::new(0.01 * probe.bounding_radius());
        Self { probe, ball, settings }
    }

    /// Returns the places of the instances; the first is at the origin, with others all around.
    fn places(&self, count: usize) -> Vec<DVec3> {
        let side = 1 + 2 * (1..).find(|half: &i32| (2 * half + 1).pow(3) as usize >= count).unwrap_or(1);
        let lattice = (0..side.pow(3))
            .map(|i| DVec3::from([i, i / side, i / side / side].map(|i| f64::from(i % side - side / 2))));
        let mut places: Vec<DVec3> =
            lattice.map(|cell| SPACING * self.ball.bounding_radius() * cell).collect();
        places.sort_by(|x, y| x.length().total_cmp(&y.length()));
        places.truncate(count);
        places
    }

    /// Returns a pose of the probe along the first instance, in contact.
    fn probe_pose(&self, run: usize) -> Pose {
        let height = self.touching_height();
        let there_and_back = (run % 200).min(200 - run % 200) as f64 - 50.0;
        Pose::from_translation(DVec3::new(STEP * there_and_back, 0.0, height))
    }

    fn touching_height(&self) -> f64 {
        let low = self.probe.clod.vertices.iter().map(|v| v.z).fold(f64::INFINITY, f64::min);
        0.999 * self.ball.bounding_radius() - low
    }
}

fn moved(place: DVec3, run: usize) -> DVec3 {
    place + SHIFT * (run % 2) as f64 * DVec3::X
}

fn broad_phase(criterion: &mut Criterion) {
    let setting = Setting::new();
    let mut group = criterion.benchmark_group("broad_phase");
    let mut alone = ContactQuery::new(setting.probe.shape(), setting.ball.shape());
    let mut run = 0;
    group.bench_function("contact_query", |bencher| {
        bencher.iter(|| {
            run += 1;
            black_box(
                alone
                    .run(&setting.probe_pose(run), &Pose::IDENTITY, &setting.settings)
                    .expect("valid poses and settings"),
            )
        });
    });
    for count in INSTANCES {
        let places = setting.places(count);
        let mut scene = SceneQuery::new(setting.probe.shape());
        let objects: Vec<ObjectHandle> = places
            .iter()
            .map(|place| scene.add(setting.ball.shape(), &Pose::from_translation(*place)))
            .collect();
        let outcome =
            scene.run(&setting.probe_pose(50), &setting.settings).expect("valid poses and settings");
        assert!(outcome.query.contacts > 0 && outcome.queried == 1, "{outcome:?}");
        let mut run = 0;
        group.bench_function(BenchmarkId::new("still", count), |bencher| {
            bencher.iter(|| {
                run += 1;
                black_box(
                    scene.run(&setting.probe_pose(run), &setting.settings).expect("valid poses and settings"),
                )
            });
        });
        group.bench_function(BenchmarkId::new("tenth moves", count), |bencher| {
            bencher.iter(|| {
                run += 1;
                for (object, place) in objects.iter().zip(&places).skip(9).step_by(10) {
                    scene.set_pose(*object, &Pose::from_translation(moved(*place, run)));
                }
                black_box(
                    scene.run(&setting.probe_pose(run), &setting.settings).expect("valid poses and settings"),
                )
            });
        });
        let far = places.iter().map(|place| place.length()).fold(1.0, f64::max);
        group.bench_function(BenchmarkId::new("jump", count), |bencher| {
            bencher.iter(|| {
                run += 1;
                let far = 2.0 * far * (run % 2) as f64 * DVec3::X;
                black_box(
                    scene
                        .run(&Pose::from_translation(far), &setting.settings)
                        .expect("valid poses and settings"),
                )
            });
        });
    }
    group.finish();
}

fn tree(criterion: &mut Criterion) {
    let setting = Setting::new();
    let aabb = |center: DVec3, radius: f64| {
        let [low, high] = [-radius, radius].map(|r| (center + r).to_array());
        Aabb::new(Vector::from(low), Vector::from(high))
    };
    let reach = setting.probe.bounding_radius() + setting.settings.tolerance;
    let radius = setting.ball.bounding_radius();
    let mut group = criterion.benchmark_group("broad_phase/tree");
    for count in INSTANCES {
        let places = setting.places(count);
        let boxes: Vec<Aabb> = places.iter().map(|place| aabb(*place, radius)).collect();
        let mut tree = Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes);
        let mut run = 0;
        for name in ["still", "tenth moves"] {
            group.bench_function(BenchmarkId::new(name, count), |bencher| {
                bencher.iter(|| {
                    run += 1;
                    if name != "still" {
                        for (index, place) in places.iter().enumerate().skip(9).step_by(10) {
                            tree.insert_or_update_partially(
                                aabb(moved(*place, run), radius),
                                index as u32,
                                0.0,
                            );
                        }
                        tree.refit_without_opt();
                    }
                    let probe = aabb(setting.probe_pose(run).translation, reach);
                    black_box(tree.intersect_aabb(&probe).count())
                });
            });
        }
    }
    group.finish();
}

criterion_group!(benches, broad_phase, tree);
criterion_main!(benches);
