//! The levels of detail that simplification makes: meshes, patches and parameters.

#![allow(
    clippy::print_stdout,
    reason = "seeds, figures and what was skipped, shown by --nocapture or on failure"
)]

mod shapes;

use glam::{DMat3, DVec3};
use palpate_clod_build::{BuildOptions, Stage, build, unwatched};
use palpate_core::clod::{Clod, Node};
use palpate_core::mesh::TriMesh;
use palpate_mesh_io::{self_intersections, weld};
use palpate_models::Model;
use shapes::{mapped, torus};
use std::ops::ControlFlow;

fn simplified(mesh: &TriMesh) -> Clod {
    let options = BuildOptions { simplify: true, ..BuildOptions::default() };
    let clod = build(mesh, &options, &mut unwatched).expect("the mesh builds");
    clod.validate().expect("the hierarchy is valid");
    clod
}

/// The mesh of a level, put together from its nodes' patches.
fn mesh_of(clod: &Clod, level: usize) -> TriMesh {
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for node in clod.level(level) {
        let first = vertices.len() as u32;
        vertices.extend_from_slice(clod.hull(node));
        triangles.extend(clod.patch(node).iter().map(|t| t.map(|v| v + first)));
    }
    weld(&TriMesh::new(vertices, triangles).expect("indices are in range"))
}

fn regular(clod: &Clod) -> usize {
    clod.levels.iter().filter(|l| !l.free).count()
}

/// How far the farthest vertex of a patch is above the plane of one of its triangles.
fn bulge(clod: &Clod, node: &Node) -> f64 {
    let points = clod.hull(node);
    let planes = clod.patch(node).iter().map(|t| {
        let [a, b, c] = t.map(|v| points[v as usize]);
        (a, (b - a).cross(c - a).normalize_or_zero())
    });
    planes.flat_map(|(a, n)| points.iter().map(move |p| n.dot(*p - a))).fold(0.0, f64::max)
}

fn models() -> Vec<(&'static str, TriMesh)> {
    [
        ("golf ball", Model::GolfBall),
        ("lower jaw", Model::LowerJaw),
        ("cup", Model::Cup),
        ("torus", Model::Torus),
    ]
    .map(|(name, model)| (name, model.generate(4000).expect("within range")))
    .into()
}

#[test]
fn every_level_is_a_sound_surface_of_convex_patches() {
    for (name, mesh) in models() {
        let clod = simplified(&mesh);
        let levels = regular(&clod);
        println!(
            "{name}: {:?}",
            clod.levels.iter().map(|l| (l.triangles, l.nodes.len(), l.free)).collect::<Vec<_>>()
        );
        assert!(levels > 3, "{name} has {levels} levels");
        let radius = clod.bounding_radius();
        let euler = |mesh: &TriMesh| {
            let edges = mesh.adjacency().edges().len();
            mesh.vertices().len() as i64 - edges as i64 + mesh.triangles().len() as i64
        };
        for k in 0..levels {
            let level = &clod.levels[k];
            let surface = mesh_of(&clod, k);
            assert_eq!(surface.triangles().len(), level.triangles as usize, "{name}, level {k}");
            let report = surface.validate();
            assert!(report.is_solid() && report.degenerate == 0, "{name}, level {k}: {report:?}");
            assert_eq!(euler(&surface), euler(&mesh), "{name}, level {k}");
            assert_eq!(self_intersections(&surface).count, 0, "{name}, level {k}");
            for node in clod.level(k) {
                assert!(bulge(&clod, node) <= 1.01e-6 * radius, "{name}, level {k}: {}", bulge(&clod, node));
                assert!(node.contained, "{name}, level {k}");
            }
            if k > 0 {
                let finer = &clod.levels[k - 1];
                assert!(level.resolution <= finer.resolution, "{name}, level {k}");
                assert!(level.triangles < finer.triangles, "{name}, level {k}");
                let last = k + 1 == levels;
                assert!(last || 2 * level.nodes.len() <= finer.nodes.len(), "{name}, level {k}");
            }
        }
    }
}

/// Distance of a point from the hull of a node by projection, as slow as it is plain: Gilbert's algorithm, whose lower bound
/// says when it is done.
fn distance_to_hull(points: &[DVec3], p: DVec3, enough: f64) -> f64 {
    let mut x = points[0];
    for _ in 0..100_000 {
        let toward = p - x;
        let distance = toward.length();
        let s = points.iter().copied().max_by(|a, b| toward.dot(*a).total_cmp(&toward.dot(*b))).unwrap_or(x);
        let lower = toward.dot(p - s) / distance;
        if distance <= enough || distance - lower.max(0.0) <= 1e-4 * distance {
            return distance;
        }
        let along = s - x;
        x += along * (toward.dot(along) / along.length_squared()).clamp(0.0, 1.0);
    }
    p.distance(x)
}

#[test]
fn hausdorff_distances_bound_all_descendants_and_are_reached() {
    let clod = simplified(&Model::LowerJaw.generate(3000).expect("within range"));
    let slack = 1e-3 * clod.bounding_radius();
    let (mut tested, mut above) = (0, 0);
    for node in clod.nodes.iter().filter(|n| !n.children.is_empty()) {
        let mut farthest = 0.0f64;
        let mut below: Vec<u32> = node.children.clone().collect();
        while let Some(index) = below.pop() {
            let descendant = &clod.nodes[index as usize];
            below.extend(descendant.children.clone());
            for p in clod.extreme(descendant) {
                farthest = farthest.max(distance_to_hull(clod.extreme(node), *p, farthest.max(slack)));
                tested += 1;
            }
        }
        assert!(farthest <= node.hausdorff * 1.0002 + slack, "{farthest} {}", node.hausdorff);
        assert!(node.hausdorff <= farthest + slack, "{farthest} {}", node.hausdorff);
        above += usize::from(node.hausdorff > slack);
    }
    assert!(tested > 1000 && above > 20, "{tested} {above}");
}

#[test]
fn the_same_bytes_whatever_the_threads_and_the_units() {
    let mesh = Model::Cup.generate(2000).expect("within range");
    let bytes = |clod: &Clod| {
        let mut out = Vec::new();
        clod.write(&mut out).expect("memory can be written to");
        out
    };
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start");
        pool.install(|| simplified(&mesh))
    };
    let one = with(1);
    assert!(bytes(&one) == bytes(&with(3)));
    // Powers of two change nothing at all but the units.
    for scale in [1.0 / 1024.0, 1024.0] {
        let other = simplified(&mapped(&mesh, DMat3::IDENTITY * scale, DVec3::ZERO));
        assert_eq!(one.nodes.len(), other.nodes.len());
        for (a, b) in one.nodes.iter().zip(&other.nodes) {
            assert_eq!((a.deviation * scale, a.hausdorff * scale), (b.deviation, b.hausdorff));
        }
        for (a, b) in one.levels.iter().zip(&other.levels) {
            assert_eq!((a.resolution / scale, a.triangles), (b.resolution, b.triangles));
        }
    }
}

#[test]
fn support_areas_never_grow() {
    let clod = simplified(&Model::GolfBall.generate(4000).expect("within range"));
    let most =
        |k: usize| clod.level(k).iter().flat_map(|n| clod.support_areas(n)).copied().fold(0.0, f64::max);
    for k in 1..regular(&clod) {
        assert!(most(k) <= most(k - 1) && most(k) > 0.0);
    }
}

#[test]
fn borders_are_kept() {
    // A bowl: the lower part of a torus' outside would do; here a bumpy square with a border.
    let n = 24u32;
    let at = |k: u32| f64::from(k) / f64::from(n) - 0.5;
    let vertices = (0..=n)
        .flat_map(|y| (0..=n).map(move |x| (x, y)))
        .map(|(x, y)| DVec3::new(at(x), at(y), 0.02 * (17.0 * at(x)).sin() * (13.0 * at(y)).cos()))
        .collect();
    let triangles = (0..n * n)
        .flat_map(|k| {
            let v = k / n * (n + 1) + k % n;
            [[v, v + 1, v + n + 1], [v + 1, v + n + 2, v + n + 1]]
        })
        .collect();
    let mesh = TriMesh::new(vertices, triangles).expect("indices are in range");
    let clod = simplified(&mesh);
    let coarsest = regular(&clod) - 1;
    assert!(coarsest > 2);
    for k in 0..=coarsest {
        let surface = mesh_of(&clod, k);
        let report = surface.validate();
        assert!(report.manifold && report.oriented && report.components == 1, "level {k}");
        assert_eq!(self_intersections(&surface).count, 0, "level {k}");
        assert!(clod.level(k).iter().all(|n| !n.contained));
    }
    let corner = |s: f64, t: f64| {
        let coarse = mesh_of(&clod, 1);
        coarse.vertices().iter().map(|p| (p.x - s).hypot(p.y - t)).fold(f64::INFINITY, f64::min)
    };
    for (s, t) in [(0.5, 0.5), (-0.5, 0.5), (0.5, -0.5), (-0.5, -0.5)] {
        assert!(corner(s, t) < 0.02, "the corner at {s}, {t} has moved by {}", corner(s, t));
    }
}

#[test]
fn what_is_one_patch_is_left_alone() {
    let ellipsoid = Model::Ellipsoid.generate(2000).expect("within range");
    assert_eq!(simplified(&ellipsoid).nodes.len(), 1);
    let mut stages = Vec::new();
    let options = BuildOptions { simplify: true, ..BuildOptions::default() };
    build(&torus(20, 0.4), &options, &mut |stage, done| {
        assert!((0.0..=1.0).contains(&done));
        stages.push(stage);
        ControlFlow::Continue(())
    })
    .expect("a torus builds");
    stages.dedup();
    assert_eq!(
        stages,
        [Stage::Mesh, Stage::Decomposition, Stage::Simplification, Stage::Hierarchy, Stage::Parameters]
    );
}
