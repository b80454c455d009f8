//! Time of the directional penetration depth of textured surfaces (§4.4): two bumpy plates of 200 triangles
//! each, displaced by ridges, in 7 contacts (the most of Fig. 4.16), by the size of the grid.
//!
//! `cargo bench -p palpate-benches --bench texture_depth`, criterion's group `texture_depth`. The processor's
//! backend is measured; with `-- GPU` the GPU's is instead. `valgrind --tool=callgrind` on the same program
//! with the arguments `count GRID TIMES` counts the instructions of the processor's.

#![allow(missing_docs, clippy::print_stdout, reason = "a program that reports to the console")]

use std::f64::consts::{PI, TAU};
use std::hint::black_box;
use std::sync::Arc;

use criterion::{BenchmarkId, Criterion};
use palpate::core::mesh::UvMesh;
use palpate::glam::{DQuat, DVec2, DVec3};
use palpate::texture_pd::{
    Backend, CpuBackend, DepthQuery, DepthSettings, Domain, HeightImage, SurfaceSet, TextureContact,
    TexturedSurface, Wrap,
};
use palpate::{Pose, TriMesh};

/// Half the side of the plates and of the grid, m.
const HALF: f64 = 0.05;
const WINDOW: f64 = 0.005;
/// Number of cells along a plate's side, and of texels.
const CELLS: u32 = 10;
const TEXELS: u32 = 1024;

struct Scene {
    surfaces: SurfaceSet,
    contacts: Vec<TextureContact>,
}

/// Returns a plate with waves of 1 mm in its mesh and ridges of 0.2 mm in its texture, `length` apart (m), at
/// an angle.
fn plate(length: f64, angle: f64) -> Arc<TexturedSurface> {
    let at = |i: u32| {
        let index = DVec2::new((i % (CELLS + 1)).into(), (i / (CELLS + 1)).into());
        index / f64::from(CELLS)
    };
    let vertices = (0..(CELLS + 1) * (CELLS + 1))
        .map(|i| {
            let place = (at(i) * 2.0 - 1.0) * HALF;
            place.extend(0.001 * (TAU * place.x / 0.03).sin() * (TAU * place.y / 0.04).cos())
        })
        .collect();
    let triangles: Vec<[u32; 3]> = (0..CELLS * CELLS)
        .flat_map(|i| {
            let first = i / CELLS * (CELLS + 1) + i % CELLS;
            [[first, first + 1, first + CELLS + 2], [first, first + CELLS + 2, first + CELLS + 1]]
        })
        .collect();
    let coordinates = triangles.iter().map(|triangle| triangle.map(at)).collect();
    let mesh = TriMesh::new(vertices, triangles).expect("indices are in range");
    let mesh = UvMesh::new(mesh, coordinates).expect("a place for each triangle");
    let along = DVec2::from_angle(angle);
    let height = |i: u32| {
        let texel = DVec2::new((i % TEXELS).into(), (i / TEXELS).into());
        let place = ((texel + 0.5) / f64::from(TEXELS) * 2.0 - 1.0) * HALF;
        (0.0002 * (TAU * place.dot(along) / length).cos()) as f32
    };
    let image =
        HeightImage::new(TEXELS, TEXELS, (0..TEXELS * TEXELS).map(height).collect(), [Wrap::Clamp; 2]);
    Arc::new(TexturedSurface::textured(&mesh, &image.expect("an image"), 1.0).expect("a surface"))
}

impl Scene {
    fn new() -> Self {
        let mut surfaces = SurfaceSet::default();
        let [a, b] = [(0.002, 0.3), (0.003, 1.0)]
            .map(|(length, angle)| surfaces.add(&plate(length, angle)).expect("two small textures"));
        let over = DQuat::from_scaled_axis(DVec3::new(0.02, -0.03, 0.4)) * DQuat::from_rotation_x(PI);
        let pose_a = Pose::new(DVec3::new(0.003, 0.002, 0.001), over);
        let contacts = (0..7).map(|i| {
            let angle = TAU * f64::from(i) / 7.0;
            TextureContact {
                a,
                pose_a,
                center: pose_a.translation,
                b,
                pose_b: Pose::IDENTITY,
                normal: DVec3::new(0.02, 0.01, -1.0).normalize(),
                point: DVec3::new(0.025 * angle.cos(), 0.025 * angle.sin(), 0.0),
                half_size: WINDOW,
                reach: 0.01,
                domain: Domain::WHOLE,
            }
        });
        Self { surfaces, contacts: contacts.collect() }
    }

    fn run(&self, query: &mut DepthQuery, settings: &DepthSettings, backend: &mut dyn Backend) -> f64 {
        let depths = query.run(&self.surfaces, black_box(&self.contacts), settings, backend);
        depths.expect("a backend that works").iter().flatten().map(|found| found.depth).sum()
    }
}

fn methods(grid: u32) -> [(&'static str, DepthSettings); 2] {
    let plain = DepthSettings { grid, ..DepthSettings::default() };
    [("largest", plain), ("smooth", DepthSettings { temperature: 1e-5, ..plain })]
}

fn main() {
    let scene = Scene::new();
    let arguments: Vec<String> = std::env::args().collect();
    let number = |i: usize| arguments.get(i).and_then(|text| text.parse::<u32>().ok());
    if arguments.get(1).is_some_and(|first| first == "count") {
        let settings = DepthSettings { grid: number(2).unwrap_or(50), ..DepthSettings::default() };
        let (mut query, mut backend) = (DepthQuery::new(), CpuBackend::new());
        let sum: f64 =
            (0..number(3).unwrap_or(1)).map(|_| scene.run(&mut query, &settings, &mut backend)).sum();
        println!("{sum}");
        return;
    }
    let (name, mut backend) = backend(&arguments);
    let mut criterion = Criterion::default().configure_from_args();
    let mut group = criterion.benchmark_group("texture_depth");
    for grid in [50, 128, 256] {
        for (method, settings) in methods(grid) {
            let mut query = DepthQuery::new();
            group.bench_function(BenchmarkId::new(format!("{name}/{method}"), grid), |bencher| {
                bencher.iter(|| scene.run(&mut query, &settings, &mut *backend));
            });
        }
    }
    group.finish();
    criterion.final_summary();
}

/// Returns the requested backend, and its name among the measurements, by which criterion's filter selects
/// the GPU's.
fn backend(arguments: &[String]) -> (&'static str, Box<dyn Backend>) {
    #[cfg(feature = "gpu")]
    if arguments.iter().any(|argument| argument.starts_with("GPU")) {
        let gpu = palpate::texture_pd::WgpuBackend::new().expect("a GPU");
        println!("GPU: {}", gpu.name());
        return ("GPU", Box::new(gpu));
    }
    #[cfg(not(feature = "gpu"))]
    assert!(!arguments.iter().any(|argument| argument.starts_with("GPU")), "built without the feature `gpu`");
    ("CPU", Box::new(CpuBackend::new()))
}
