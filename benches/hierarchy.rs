//! Time of building the hierarchy of a mesh, from triangles to the root.
//!
//! `cargo bench -p palpate-benches --bench hierarchy`. Throughput is in triangles.

#![allow(missing_docs, reason = "a benchmark")]

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use palpate::clod_build::{BuildOptions, build, unwatched};
use palpate::models::Model;

fn hierarchies(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("build");
    group.sample_size(10);
    for (model, triangles) in
        [(Model::LowerJaw, 10_000), (Model::LowerJaw, 40_180), (Model::GolfBall, 40_000)]
    {
        let mesh = model.generate(triangles).expect("a model");
        group.throughput(Throughput::Elements(mesh.triangles().len() as u64));
        group.bench_function(BenchmarkId::new(model.name(), triangles), |bencher| {
            bencher.iter(|| black_box(build(&mesh, &BuildOptions::default(), &mut unwatched)));
        });
    }
    group.finish();
}

criterion_group!(benches, hierarchies);
criterion_main!(benches);
