//! The levels of detail that simplification makes: meshes, patches and parameters.

#![allow(
    clippy::print_stdout,
    reason = "seeds, figures and what was skipped, shown by --nocapture or on failure"
)]

use crate::shapes::{mapped, torus};
use glam::{DMat3, DVec3};
use palpate_clod_build::{BuildOptions, Stage, build, unwatched};
use palpate_core::clod::{Node, Parts};
use palpate_core::mesh::TriMesh;
use palpate_mesh_io::{self_intersections, weld};
use palpate_models::Model;
use std::ops::ControlFlow;

fn simplified_with(mesh: &TriMesh, options: &BuildOptions) -> Parts {
    assert!(options.simplify);
    let clod = build(mesh, options, &mut unwatched).expect("the mesh builds").parts();
    clod.validate().expect("the hierarchy is valid");
    clod
}

fn simplified(mesh: &TriMesh) -> Parts {
    simplified_with(mesh, &BuildOptions::default())
}

/// The mesh of a level, put together from its nodes' patches.
fn mesh_of(clod: &Parts, level: usize) -> TriMesh {
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for node in clod.level(level) {
        let first = vertices.len() as u32;
        vertices.extend_from_slice(clod.hull(node));
        triangles.extend(clod.patch(node).iter().map(|t| t.map(|v| v + first)));
    }
    weld(&TriMesh::new(vertices, triangles).expect("indices are in range"))
}

fn regular(clod: &Parts) -> usize {
    clod.levels.iter().filter(|l| !l.free).count()
}

/// Largest height of a vertex of a patch above the plane of one of its triangles.
fn bulge(clod: &Parts, node: &Node) -> f64 {
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
        check_levels(name, &mesh, &BuildOptions::default());
    }
}

#[test]
fn so_is_every_level_that_is_decomposed_anew() {
    for (name, mesh) in models() {
        check_levels(name, &mesh, &BuildOptions { carried: false, ..BuildOptions::default() });
    }
}

fn check_levels(name: &str, mesh: &TriMesh, options: &BuildOptions) {
    let clod = simplified_with(mesh, options);
    let levels = regular(&clod);
    println!(
        "{name}: {:?}",
        clod.levels.iter().map(|l| (l.triangles, l.nodes.len(), l.free)).collect::<Vec<_>>()
    );
    assert!(levels >= if options.carried { 4 } else { 3 }, "{name} has {levels} levels");
    let mut not_halved = 0;
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
        assert_eq!(euler(&surface), euler(mesh), "{name}, level {k}");
        assert_eq!(self_intersections(&surface).count, 0, "{name}, level {k}");
        for node in clod.level(k) {
            assert!(bulge(&clod, node) <= 1.01e-6 * radius, "{name}, level {k}: {}", bulge(&clod, node));
            assert!(node.contained, "{name}, level {k}");
        }
        if k > 0 {
            let finer = &clod.levels[k - 1];
            assert!(level.resolution <= finer.resolution, "{name}, level {k}");
            assert!(level.triangles < finer.triangles, "{name}, level {k}");
            assert!(10 * level.nodes.len() <= 9 * finer.nodes.len(), "{name}, level {k}");
            not_halved += usize::from(2 * level.nodes.len() > finer.nodes.len());
        }
    }
    // The last level, and that where patches could not be carried further.
    assert!(not_halved <= 1 + usize::from(options.carried), "{name}: {not_halved}");
}

/// Distance of a point from the hull of a node by Gilbert's algorithm, slow but plain: its lower bound shows
/// when it has converged.
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

/// The nodes below a node.
fn descendants(clod: &Parts, node: &Node) -> Vec<u32> {
    let (mut found, mut waiting) = (Vec::new(), node.children.clone().collect::<Vec<_>>());
    while let Some(index) = waiting.pop() {
        found.push(index);
        waiting.extend(clod.nodes[index as usize].children.clone());
    }
    found
}

/// Checks that h of every node is the distance of the farthest descendant from its bounding hull, to within
/// `slack`; returns the number of nodes whose h is larger than that.
fn check_hausdorff(clod: &Parts, slack: f64) -> usize {
    let (mut tested, mut above) = (0, 0);
    for node in clod.nodes.iter().filter(|n| !n.children.is_empty()) {
        let mut farthest = 0.0f64;
        for index in descendants(clod, node) {
            for p in clod.extreme(&clod.nodes[index as usize]) {
                let enough = farthest.max(slack);
                farthest = farthest.max(distance_to_hull(clod.bounding_hull(node), *p, enough));
                tested += 1;
            }
        }
        assert!(farthest <= node.hausdorff * 1.0002 + slack, "{farthest} {}", node.hausdorff);
        assert!(node.hausdorff <= farthest + slack, "{farthest} {}", node.hausdorff);
        above += usize::from(node.hausdorff > slack);
    }
    assert!(tested > 1000, "{tested}");
    above
}

#[test]
fn hausdorff_distances_bound_all_descendants_and_are_reached() {
    let mesh = Model::LowerJaw.generate(3000).expect("within range");
    let built = |bounding_points| {
        simplified_with(&mesh, &BuildOptions { bounding_points, ..BuildOptions::default() })
    };
    // As in the dissertation; with points added; and with as many as it takes.
    let (plain, usual, contained) = (built(0), simplified(&mesh), built(u32::MAX));
    let slack = 4e-3 * plain.bounding_radius();
    let above = [&plain, &usual, &contained].map(|clod| check_hausdorff(clod, slack));
    assert!(above[0] > 20 && above[0] > above[1] && above[2] == 0, "{above:?}");
    assert!(contained.nodes.iter().all(|n| n.hausdorff == 0.0));

    let most = BuildOptions::default().bounding_points;
    assert!(plain.nodes.iter().all(|n| n.added == 0) && usual.nodes.iter().all(|n| n.added <= most));
    assert!(usual.nodes.iter().any(|n| n.added == most) && contained.nodes.iter().any(|n| n.added > most));
    // They differ in nothing else, and every point brings h down.
    assert_eq!(plain.levels, usual.levels);
    assert_eq!(plain.levels, contained.levels);
    for ((a, b), c) in plain.nodes.iter().zip(&usual.nodes).zip(&contained.nodes) {
        assert!(plain.hull(a) == usual.hull(b) && plain.hull(a) == contained.hull(c));
        assert!(a.hausdorff >= b.hausdorff && (b.added == 0 || a.hausdorff > b.hausdorff), "{a:?} {b:?}");
        assert!(b.added.min(c.added) == b.added && (b.hausdorff > 0.0) == (c.added > b.added), "{b:?} {c:?}");
    }
}

#[test]
fn spheres_enclose_bounding_hulls_and_all_descendants() {
    for bounding_points in [0, BuildOptions::default().bounding_points, u32::MAX] {
        let mesh = Model::LowerJaw.generate(3000).expect("within range");
        let clod = simplified_with(&mesh, &BuildOptions { bounding_points, ..BuildOptions::default() });
        let (mut loosest, mut beyond) = (0.0f64, 0);
        for node in clod.nodes.iter().filter(|n| !n.children.is_empty()) {
            let reach = |points: &[DVec3]| points.iter().map(|p| p.distance(node.center)).fold(0.0, f64::max);
            let below =
                descendants(&clod, node).into_iter().map(|k| reach(clod.extreme(&clod.nodes[k as usize])));
            let (own, below) = (reach(clod.bounding_hull(node)), below.fold(0.0, f64::max));
            let reached = own.max(below);
            assert!(reached <= node.radius * (1.0 + 1e-12), "{reached} {}", node.radius);
            loosest = loosest.max(node.radius - reached);
            beyond += usize::from(below > own * (1.0 + 1e-9));
        }
        // No sphere is larger than its content, except for the rounding of packing, and descendants do reach
        // beyond their ancestors' own hulls.
        assert!(loosest < 2f64.powi(-22) * clod.bounding_radius(), "{loosest}");
        assert!(beyond > 0 || bounding_points != 0, "{beyond}");
        assert!(beyond == 0 || bounding_points != u32::MAX, "{beyond}");
    }
}

#[test]
fn the_same_bytes_whatever_the_threads_and_the_units() {
    let mesh = Model::Cup.generate(2000).expect("within range");
    let bytes = |clod: &Parts| {
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
fn a_mesh_of_one_patch_is_left_alone() {
    let ellipsoid = Model::Ellipsoid.generate(2000).expect("within range");
    assert_eq!(simplified(&ellipsoid).nodes.len(), 1);
    let mut stages = Vec::new();
    build(&torus(20, 0.4), &BuildOptions::default(), &mut |stage, done| {
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
