//! The surface convex decomposition (§3.3.1), compared with its definition.

#![allow(
    clippy::print_stdout,
    reason = "seeds, figures and what was skipped, shown by --nocapture or on failure"
)]

use std::collections::HashMap;

use crate::shapes::{
    built, cube, globe, inverted, l_prism, mapped, shared_mesh, spiral, together, torus, winding,
};
use glam::{DMat3, DVec3};
use palpate_clod_build::BuildOptions;
use palpate_core::TriMesh;
use palpate_core::clod::{Node, Parts};
use palpate_models::Model;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

type Key = [u64; 3];

fn key(p: DVec3) -> Key {
    p.to_array().map(|x| (x + 0.0).to_bits())
}

fn tolerance(clod: &Parts) -> f64 {
    BuildOptions::default().tolerance * clod.bounding_radius()
}

fn corners(clod: &Parts, node: &Node) -> Vec<[DVec3; 3]> {
    clod.patch(node).iter().map(|t| t.map(|v| clod.hull(node)[v as usize])).collect()
}

/// Unit normal of a triangle; `None` if the triangle is so narrow that its normal is meaningless.
fn normal([a, b, c]: [DVec3; 3], narrow: f64) -> Option<DVec3> {
    let cross = (b - a).cross(c - a);
    let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
    (cross.length() > narrow * longest).then(|| cross.normalize())
}

/// Checks that each triangle of the mesh is in exactly one patch, with its orientation.
fn check_partition(mesh: &TriMesh, clod: &Parts) {
    let rotated = |t: [Key; 3]| {
        let first = (0..3).min_by_key(|k| t[*k]).unwrap_or(0);
        [t[first], t[(first + 1) % 3], t[(first + 2) % 3]]
    };
    let mut count: HashMap<[Key; 3], i32> = HashMap::new();
    for t in 0..mesh.triangles().len() {
        *count.entry(rotated(mesh.corners(t).map(key))).or_default() += 1;
    }
    for node in clod.leaves() {
        for t in corners(clod, node) {
            *count.entry(rotated(t.map(key))).or_default() -= 1;
        }
    }
    assert!(count.values().all(|n| *n == 0), "the patches are not a partition of the triangles");
}

/// Checks, by brute force over all pairs, that the hull lies below the plane of each triangle and interior
/// edges are convex (Eq. 3.2).
fn check_local_constraint(clod: &Parts) {
    let tolerance = tolerance(clod);
    for (k, node) in clod.leaves().iter().enumerate() {
        for t in corners(clod, node) {
            let Some(n) = normal(t, tolerance) else { continue };
            let above = clod.hull(node).iter().map(|p| n.dot(*p - t[0])).fold(0.0, f64::max);
            assert!(
                above <= 1.01 * tolerance,
                "patch {k}: a vertex is {above:e} above the plane of a triangle"
            );
        }
        let mut sides = HashMap::new();
        for t in corners(clod, node) {
            for side in 0..3 {
                sides.insert((key(t[side]), key(t[(side + 1) % 3])), (t, t[(side + 2) % 3]));
            }
        }
        for ((from, to), (t, _)) in &sides {
            if let Some((_, opposite)) = sides.get(&(*to, *from))
                && let Some(n) = normal(*t, tolerance)
            {
                assert!(n.dot(*opposite - t[0]) <= 1.01 * tolerance, "patch {k}: an interior edge is reflex");
            }
        }
    }
}

/// Points of a contained hull that are deeper than the tolerance lie inside the object; for a flat hull,
/// points just below it.
fn check_global_constraint(mesh: &TriMesh, clod: &Parts, samples: usize) {
    let seed = 21;
    let mut rng = StdRng::seed_from_u64(seed);
    let tolerance = tolerance(clod);
    for (k, node) in clod.leaves().iter().enumerate() {
        let hull = clod.extreme(node);
        let planes = planes_by_brute_force(hull);
        let middle = hull.iter().sum::<DVec3>() / hull.len() as f64;
        let outward = corners(clod, node).iter().map(|[a, b, c]| (b - a).cross(c - a)).sum::<DVec3>();
        let outward = outward.normalize_or_zero();
        let thickness = hull.iter().map(|p| outward.dot(middle - p).abs()).fold(0.0, f64::max);
        let flat = thickness <= tolerance && outward != DVec3::ZERO && node.triangles.len() > 1;
        for sample in 0..samples {
            let weights: Vec<f64> = hull.iter().map(|_| -rng.random_range(1e-9..1.0f64).ln()).collect();
            let sum: f64 = weights.iter().sum();
            let mut p = hull.iter().zip(&weights).map(|(p, w)| *p * (*w / sum)).sum::<DVec3>();
            if sample == 0 {
                p = middle;
            }
            let depth = planes.iter().map(|(n, d)| d - n.dot(p)).fold(f64::INFINITY, f64::min);
            if flat {
                // Well inside of the outline.
                p = 0.95 * p + 0.05 * middle - 4.0 * tolerance * outward;
            } else if planes.is_empty() || depth <= 2.0 * tolerance {
                continue;
            }
            let inside = winding(mesh, p) > 0.5;
            assert!(
                inside || !node.contained,
                "seed {seed}, patch {k}: {p} is in the hull, but outside of the object"
            );
        }
        // No vertex of the mesh lies deep in the hull.
        for v in mesh.vertices() {
            let depth = planes.iter().map(|(n, d)| d - n.dot(*v)).fold(f64::INFINITY, f64::min);
            assert!(
                planes.is_empty() || depth <= 1.01 * tolerance,
                "patch {k}: {v} is {depth:e} deep in the hull"
            );
        }
    }
}

/// The planes through any three points that have all others on one side; empty for points in a plane.
fn planes_by_brute_force(points: &[DVec3]) -> Vec<(DVec3, f64)> {
    let size = points.iter().map(|p| p.distance(points[0])).fold(0.0, f64::max);
    let mut planes = Vec::new();
    for a in 0..points.len() {
        for b in a + 1..points.len() {
            for c in b + 1..points.len() {
                let Some(n) = normal([points[a], points[b], points[c]], 1e-7 * size) else { continue };
                for n in [n, -n] {
                    let d = n.dot(points[a]);
                    if points.iter().all(|p| n.dot(*p) <= d + 1e-12 * size) {
                        planes.push((n, d));
                    }
                }
            }
        }
    }
    let flat = planes.iter().any(|(n, d)| points.iter().all(|p| (n.dot(*p) - d).abs() <= 1e-9 * size));
    if flat { Vec::new() } else { planes }
}

fn check(mesh: &TriMesh, clod: &Parts) {
    check_partition(mesh, clod);
    check_local_constraint(clod);
}

#[test]
fn cube_is_one_patch() {
    for n in [1, 2, 7] {
        let mesh = cube(n);
        let clod = built(&mesh);
        check(&mesh, &clod);
        let [leaf] = clod.leaves() else { panic!("{} patches", clod.leaves().len()) };
        assert!(leaf.contained && leaf.all_real);
        assert_eq!((leaf.extreme, clod.levels.len()), (8, 1));
        assert_eq!(leaf.triangles.len(), mesh.triangles().len());
        assert!(clod.source.solid && (clod.source.volume - 8.0).abs() < 1e-12);
    }
}

#[test]
fn convex_bodies_are_one_patch() {
    let ellipsoid = DMat3::from_diagonal(DVec3::new(3.0, 1.0, 0.2));
    let turn = DMat3::from_rotation_x(0.7) * DMat3::from_rotation_y(1.1);
    for mesh in [
        globe(24, |_| 0.0),
        mapped(&globe(16, |_| 0.0), turn * ellipsoid, DVec3::new(100.0, -20.0, 3.0)),
        mapped(&cube(9), turn, DVec3::splat(5.0)),
        Model::Ellipsoid.generate(2000).expect("within range"),
    ] {
        let clod = built(&mesh);
        check(&mesh, &clod);
        assert_eq!(clod.leaves().len(), 1);
        assert!(clod.leaves()[0].contained && clod.leaves()[0].all_real);
    }
}

#[test]
fn l_prism_splits_at_its_reflex_edge() {
    let mesh = l_prism();
    let clod = built(&mesh);
    check(&mesh, &clod);
    check_global_constraint(&mesh, &clod, 200);
    // Two arms: neither floor nor ceiling can be in one patch, since its hull would fill the notch.
    assert!((2..=4).contains(&clod.leaves().len()), "{} patches", clod.leaves().len());
    assert!(clod.leaves().iter().all(|n| n.contained && !n.all_real));
}

#[test]
fn flat_faces_keep_out_of_their_holes() {
    // A square plate with a round hole: its faces are flat everywhere, and nowhere is the hull of much of one
    // in the plate.
    let n = 24;
    let rim = |k: u32| {
        let turn = std::f64::consts::TAU * f64::from(k) / f64::from(n);
        let (y, x) = turn.sin_cos();
        let outer = 1.0 / x.abs().max(y.abs());
        [(outer * x, outer * y), (0.6 * x, 0.6 * y)]
    };
    let level = |z: f64| (0..n).flat_map(move |k| rim(k).map(|(x, y)| DVec3::new(x, y, z)));
    let vertices: Vec<DVec3> = level(0.0).chain(level(0.2)).collect();
    // Outer and inner corner of each level at a turn.
    let at = |k: u32| [0, 1, 2 * n, 2 * n + 1].map(|which| which + 2 * (k % n));
    let triangles: Vec<[u32; 3]> = (0..n)
        .flat_map(|k| {
            let ([a, b, c, d], [e, f, g, h]) = (at(k), at(k + 1));
            let quads = [[c, g, h, d], [a, b, f, e], [a, e, g, c], [b, d, h, f]];
            quads.into_iter().flat_map(|[p, q, r, s]| [[p, q, r], [p, r, s]])
        })
        .collect();
    let mesh = TriMesh::new(vertices, triangles).unwrap();
    assert!(mesh.validate().is_solid());
    let clod = built(&mesh);
    check(&mesh, &clod);
    check_global_constraint(&mesh, &clod, 200);
    assert!(clod.leaves().iter().all(|n| n.contained));
    assert!(clod.leaves().len() <= 60, "{} patches", clod.leaves().len());
}

#[test]
fn torus_keeps_out_of_its_hole() {
    let mesh = torus(16, 0.4);
    let clod = built(&mesh);
    check(&mesh, &clod);
    check_global_constraint(&mesh, &clod, 20);
    assert!(clod.leaves().iter().all(|n| n.contained));
    // The inner half is saddle-shaped: there, patches are strips across the quads at best.
    assert!((16..600).contains(&clod.leaves().len()), "{} patches", clod.leaves().len());
}

#[test]
fn spiral_is_convex_only_in_part() {
    let mesh = spiral(150);
    let clod = built(&mesh);
    check(&mesh, &clod);
    assert!(!clod.source.solid && clod.leaves().iter().all(|n| !n.contained));
    let count = clod.leaves().len();
    assert!((6..=20).contains(&count), "three turns of a spiral in {count} patches");
}

#[test]
fn hulls_keep_out_of_a_cavity() {
    // The small sphere's surface does not touch the faces of the cube's hull, but the hull is not inside the
    // object.
    let cavity = inverted(&mapped(&globe(6, |_| 0.0), DMat3::IDENTITY * 0.3, DVec3::ZERO));
    let mesh = together(&[cube(4), cavity]);
    let clod = built(&mesh);
    check(&mesh, &clod);
    check_global_constraint(&mesh, &clod, 50);
    assert!(clod.leaves().len() > 2);
    assert!(clod.leaves().iter().all(|n| n.contained && !n.all_real));
}

#[test]
fn piece_that_is_inside_out_is_not_contained() {
    // Far from the cube, with a dent so that the patches of the inverted piece have thick hulls.
    let dented = globe(10, |p| -0.6 * (-8.0 * p.distance_squared(DVec3::X)).exp());
    let mesh = together(&[
        mapped(&cube(1), DMat3::IDENTITY * 4.0, DVec3::ZERO),
        mapped(&inverted(&dented), DMat3::IDENTITY, DVec3::X * 9.0),
    ]);
    let clod = built(&mesh);
    check(&mesh, &clod);
    assert!(clod.source.solid, "its signed volume is positive");
    check_global_constraint(&mesh, &clod, 50);
    assert!(clod.leaves().iter().any(|n| !n.contained), "the dent's patches fill what is outside");
    assert!(clod.leaves().iter().any(|n| n.contained && n.all_real), "the cube is one");
}

#[test]
fn two_cubes_are_two_patches_and_an_inverted_one_is_six() {
    let mesh = together(&[cube(3), mapped(&cube(2), DMat3::IDENTITY, DVec3::X * 3.0)]);
    let clod = built(&mesh);
    check(&mesh, &clod);
    assert_eq!((clod.leaves().len(), clod.levels.len()), (2, 2));
    assert!(clod.leaves().iter().all(|n| n.all_real && n.contained));

    // Open, since a closed one would be refused.
    let mesh = inverted(&cube(3));
    let mesh =
        TriMesh::new(mesh.vertices().to_vec(), mesh.triangles()[1..].to_vec()).expect("the same vertices");
    let clod = built(&mesh);
    check(&mesh, &clod);
    assert_eq!(clod.leaves().len(), 6, "each side is flat");
    assert!(!clod.source.solid && clod.leaves().iter().all(|n| !n.contained && !n.all_real));
}

#[test]
fn models_at_low_resolution() {
    for (model, triangles) in [
        (Model::GolfBall, 3000),
        (Model::Cup, 1500),
        (Model::Spoon, 1500),
        (Model::Gear, 3000),
        (Model::Torus, 2000),
        (Model::BallJointBall, 1500),
        (Model::LowerJaw, 3000),
    ] {
        let Ok(mesh) = model.generate(triangles).or_else(|_| model.generate(4 * triangles)) else { continue };
        let clod = built(&mesh);
        println!("{}: {} triangles, {} patches", model.name(), mesh.triangles().len(), clod.leaves().len());
        check(&mesh, &clod);
        assert!(clod.source.solid && clod.leaves().iter().all(|n| n.contained), "{}", model.name());
        let small = TriMesh::new(mesh.vertices().to_vec(), mesh.triangles().to_vec()).expect("the same mesh");
        if small.triangles().len() <= 4000 {
            check_global_constraint(&small, &clod, 2);
        }
    }
}

#[test]
fn scans_and_parts() {
    decomposed(&[
        ("models/good/ycb_golf_ball.obj", 3_400),
        ("models/good/dental_cast_lower.obj", 8_500),
        ("models/good/gear_medium.obj", 8_500),
    ]);
}

#[test]
#[ignore = "for a release build: cargo test --release -p palpate-clod-build --test it -- --ignored"]
fn models_of_full_size() {
    decomposed(&[
        ("models/scenarios/jaw_lower.obj", 5_200),
        ("models/scenarios/spoon.obj", 13_000),
        ("models/scenarios/cup.obj", 15_500),
    ]);
}

/// Decomposes files, each with its largest permitted number of patches.
fn decomposed(files: &[(&str, usize)]) {
    for &(file, most) in files {
        let Some(mesh) = shared_mesh(file) else { continue };
        let clod = built(&mesh);
        println!("{file}: {} triangles, {} patches", mesh.triangles().len(), clod.leaves().len());
        check(&mesh, &clod);
        assert!(clod.leaves().iter().all(|n| n.contained), "{file}");
        assert!(clod.leaves().len() <= most, "{file}: {} patches", clod.leaves().len());
    }
}

#[test]
fn decomposition_does_not_depend_on_size() {
    let mesh = torus(10, 0.3);
    let count = built(&mesh).leaves().len();
    for scale in [2f64.powi(-100), 2f64.powi(-20), 2f64.powi(120)] {
        let clod = built(&mapped(&mesh, DMat3::IDENTITY * scale, DVec3::ZERO));
        assert_eq!(clod.leaves().len(), count, "times {scale:e}");
    }
}
