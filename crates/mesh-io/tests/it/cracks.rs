//! Repair of T-junctions and cracks: shapes whose edges are cut on one side alone, in rounded coordinates.

#![expect(clippy::print_stdout, reason = "seeds are part of the tests' report")]

use std::f64::consts::PI;

use palpate_core::TriMesh;
use palpate_core::glam::DVec3;
use palpate_mesh_io::weld;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

use crate::shapes::{ball, repaired};

/// Cuts the sides of triangles at points of their own, which the neighbour across the side does not have:
/// each triangle becomes a fan about its middle.
fn cut_sides(mesh: &TriMesh, parts: &mut dyn FnMut() -> u32) -> TriMesh {
    let mut vertices = mesh.vertices().to_vec();
    let mut triangles = Vec::new();
    for (t, corners) in mesh.triangles().iter().enumerate() {
        let [a, b, c] = mesh.corners(t);
        let mut rim = Vec::new();
        for (corner, [from, to]) in corners.iter().zip([[a, b], [b, c], [c, a]]) {
            rim.push(*corner);
            let count = parts();
            for k in 1..count {
                rim.push(vertices.len() as u32);
                vertices.push(from.lerp(to, f64::from(k) / f64::from(count)));
            }
        }
        if rim.len() == 3 {
            triangles.push(*corners);
            continue;
        }
        let middle = vertices.len() as u32;
        vertices.push((a + b + c) / 3.0);
        triangles.extend((0..rim.len()).map(|i| [rim[i], rim[(i + 1) % rim.len()], middle]));
    }
    TriMesh::new(vertices, triangles).unwrap()
}

/// Rounds coordinates as files hold them, and joins those that are equal then.
fn written(mesh: &TriMesh, format: &dyn Fn(f64) -> String) -> TriMesh {
    let rounded =
        mesh.vertices().iter().map(|p| DVec3::from_array(p.to_array().map(|x| format(x).parse().unwrap())));
    weld(&TriMesh::new(rounded.collect(), mesh.triangles().to_vec()).unwrap())
}

fn six_digits(x: f64) -> String {
    format!("{x:.5e}")
}

fn micrometres(x: f64) -> String {
    format!("{x:.6}")
}

/// An upright prism over a regular polygon, m.
fn prism(sides: u32, radius: f64, height: f64, turn: f64) -> TriMesh {
    let mut vertices = vec![DVec3::ZERO, DVec3::Z * height];
    for i in 0..sides {
        let (sin, cos) = (turn + 2.0 * PI * f64::from(i) / f64::from(sides)).sin_cos();
        vertices.extend([0.0, height].map(|z| DVec3::new(radius * cos, radius * sin, z)));
    }
    let triangles = (0..sides).flat_map(|i| {
        let (a, b) = (2 + 2 * i, 2 + 2 * ((i + 1) % sides));
        [[0, b, a], [1, a + 1, b + 1], [a, b, b + 1], [a, b + 1, a + 1]]
    });
    TriMesh::new(vertices, triangles.collect()).unwrap()
}

fn volume(mesh: &TriMesh) -> f64 {
    mesh.validate().volume
}

/// The mesh closes, and encloses the volume that the shape has.
fn assert_closes(broken: &TriMesh, expected: f64, name: &str) {
    assert!(!broken.validate().closed, "{name}: nothing to mend");
    let (mended, summary) = repaired(broken, name);
    let report = mended.validate();
    assert!(report.is_solid(), "{name}: {} open edges: {summary}", report.boundary_edges);
    let error = (report.volume / expected - 1.0).abs();
    assert!(error < 1e-3, "{name}: {} m³, not {expected}: {summary}", report.volume);
}

#[test]
fn prisms_cut_on_one_side_close() {
    for turn in 0..24 {
        for (radius, height) in [(0.011, 0.0065), (0.0035, 0.0024)] {
            let whole = prism(6, radius, height, 0.1 * f64::from(turn));
            // The analytic volume, so that the shape itself is right.
            let expected = 1.5 * 3f64.sqrt() * radius * radius * height;
            assert!((volume(&whole) / expected - 1.0).abs() < 1e-12);
            // Caps are cut and the sides are not.
            let mut next = 0;
            let broken = cut_sides(&whole, &mut || {
                next += 1;
                if (next - 1) / 3 % 4 < 2 { 4 } else { 1 }
            });
            for (name, format) in
                [("six digits", six_digits as fn(f64) -> String), ("micrometres", micrometres)]
            {
                assert_closes(
                    &written(&broken, &format),
                    expected,
                    &format!("{name}, turn {turn}, {radius} m"),
                );
            }
        }
    }
}

/// Every side is cut in halves, thirds or quarters, and differently by its two triangles.
#[test]
fn sides_cut_in_different_ways_close() {
    let seed = 103;
    println!("seed {seed}");
    let mut random = StdRng::seed_from_u64(seed);
    for round in 0..60 {
        let shift = if round % 3 == 0 { DVec3::new(0.05, -0.02, 0.01) } else { DVec3::ZERO };
        let whole = ball(4 + round % 5, shift, 0.01);
        let broken = cut_sides(&whole, &mut || [1, 1, 2, 3, 4, 8][random.random_range(0..6)]);
        let format = if round % 2 == 0 { six_digits } else { micrometres };
        assert_closes(&written(&broken, &format), volume(&whole), &format!("seed {seed}, round {round}"));
    }
}

/// Threads: long thin triangles along a helix, whose sides are cut on one side alone.
#[test]
fn threads_cut_on_one_side_close() {
    let seed = 107;
    let mut random = StdRng::seed_from_u64(seed);
    for (around, crest) in [(24, 0.3), (40, 0.05)] {
        // Rings whose radius goes up and down along a helix, closed by caps.
        let turns = 5;
        let rings = 6 * turns;
        let mut vertices = Vec::new();
        for ring in 0..=rings {
            for i in 0..around {
                let (angle, z) = (2.0 * PI * f64::from(i) / f64::from(around), f64::from(ring) / 6.0);
                let phase = (z - angle / (2.0 * PI)).rem_euclid(1.0);
                let radius = 0.004 * (1.0 + crest * (2.0 * phase - 1.0).abs());
                vertices.push(DVec3::new(radius * angle.cos(), radius * angle.sin(), 0.00125 * z));
            }
        }
        let at = |ring: u32, i: u32| ring * around + i % around;
        let mut triangles: Vec<[u32; 3]> = (0..rings)
            .flat_map(|r| (0..around).map(move |i| [at(r, i), at(r, i + 1), at(r + 1, i + 1), at(r + 1, i)]))
            .flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]])
            .collect();
        let ends = vertices.len() as u32;
        vertices.extend([DVec3::ZERO, DVec3::Z * 0.00125 * f64::from(turns)]);
        triangles.extend(
            (0..around)
                .flat_map(|i| [[ends, at(0, i + 1), at(0, i)], [ends + 1, at(rings, i), at(rings, i + 1)]]),
        );
        let whole = TriMesh::new(vertices, triangles).unwrap();
        let before = whole.validate();
        assert!(before.is_solid());
        let broken = cut_sides(&whole, &mut || [1, 1, 1, 2, 4, 8][random.random_range(0..6)]);
        assert_closes(&written(&broken, &micrometres), before.volume, &format!("{around} around"));
    }
}

/// Corners that differ in the last digit between the parts that meet there.
#[test]
fn seams_whose_corners_differ_by_rounding_close() {
    let seed = 109;
    let mut random = StdRng::seed_from_u64(seed);
    let whole = ball(8, DVec3::ZERO, 0.02);
    // Every triangle has corners of its own, each off by up to a micrometre.
    let mut vertices = Vec::new();
    for t in 0..whole.triangles().len() {
        let mut off = || random.random_range(-5e-7..5e-7);
        vertices.extend(whole.corners(t).map(|p| p + DVec3::new(off(), off(), off())));
    }
    let triangles = (0..vertices.len() as u32 / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    let broken = TriMesh::new(vertices, triangles).unwrap();
    assert_closes(&broken, volume(&whole), "seams");
}

/// The control: a real hole is not a crack.
#[test]
fn a_hole_stays_open() {
    let whole = ball(8, DVec3::ZERO, 0.01);
    let mut triangles = whole.triangles().to_vec();
    triangles.remove(20);
    let open = TriMesh::new(whole.vertices().to_vec(), triangles).unwrap();
    let broken = cut_sides(&open, &mut {
        let mut next = 0;
        move || {
            next += 1;
            1 + next % 3
        }
    });
    let (mended, summary) = repaired(&written(&broken, &six_digits), "a ball with a hole");
    // The hole's own rim, whose three sides may have been cut.
    let edges = mended.validate().boundary_edges;
    assert!((3..=9).contains(&edges), "{edges} open edges: {summary}");
}
