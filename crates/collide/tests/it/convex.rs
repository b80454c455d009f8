//! The convex queries against brute-force enumeration: distances by every pair of hull faces' features,
//! depths by every direction that could separate two hulls.

use crate::solids::{pose, vector};
use palpate_collide::convex::{Hull, Limits, Placement, Polytope, Separation, Start, gjk};
use palpate_core::Pose;
use palpate_core::glam::DVec3;
use rand::{RngExt, SeedableRng, rngs::StdRng};

const SEED: u64 = 0x00C0_FFEE;

/// A random hull of few points, often degenerate, with the triangles of all its triples: a superset of its
/// faces.
fn random_hull(rng: &mut StdRng) -> Vec<DVec3> {
    let count = rng.random_range(1..9);
    let squash = match rng.random_range(0..6) {
        0 => DVec3::new(1.0, 1.0, 0.0),
        1 => DVec3::new(1.0, 0.0, 0.0),
        2 => DVec3::new(1.0, 1e-6, 1e-3),
        3 => DVec3::new(1.0, 1.0, 1e-9),
        _ => DVec3::ONE,
    };
    let grid = rng.random_range(0..4) == 0;
    (0..count)
        .map(|_| {
            let p = vector(rng) * squash;
            if grid { (p * 2.0).round() / 2.0 } else { p }
        })
        .collect()
}

fn triples(points: &[DVec3]) -> Vec<crate::oracle::Triangle> {
    let n = points.len();
    let at = |i: usize| points[i.min(n - 1)];
    let mut out = Vec::new();
    for i in 0..n.max(1) {
        for j in i + 1..n.max(i + 2) {
            for k in j + 1..n.max(j + 2) {
                out.push([at(i), at(j), at(k)]);
            }
        }
    }
    out
}

/// Distance of two hulls that do not overlap: the least over all triangles of hull vertices, which lie in the
/// hulls and include their faces.
fn plain_distance(a: &[DVec3], b: &[DVec3]) -> f64 {
    let (a, b) = (triples(a), triples(b));
    let mut best = f64::INFINITY;
    for t in &a {
        for u in &b {
            let (x, y) = crate::oracle::nearest(*t, *u);
            best = best.min(x.distance(y));
        }
    }
    best
}

fn extent(a: &[DVec3], b: &[DVec3], n: DVec3) -> f64 {
    let top = a.iter().map(|p| p.dot(n)).fold(f64::NEG_INFINITY, f64::max);
    let bottom = b.iter().map(|p| p.dot(n)).fold(f64::INFINITY, f64::min);
    top - bottom
}

/// Depth of two overlapping hulls: the least extent of a − b over all face normals and edge pairs. Positive
/// means overlap.
fn plain_depth(a: &[DVec3], b: &[DVec3]) -> f64 {
    let mut best = f64::INFINITY;
    let mut offer = |n: DVec3| {
        if n.length() > 1e-9 {
            let n = n.normalize();
            best = best.min(extent(a, b, n)).min(extent(a, b, -n));
        }
    };
    let edges = |p: &[DVec3]| -> Vec<DVec3> {
        (0..p.len()).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| p[i] - p[j]).collect()
    };
    let (ea, eb) = (edges(a), edges(b));
    for e in &ea {
        ea.iter().for_each(|f| offer(e.cross(*f)));
        eb.iter().for_each(|f| offer(e.cross(*f)));
    }
    for e in &eb {
        eb.iter().for_each(|f| offer(e.cross(*f)));
    }
    best
}

#[test]
fn distance_agrees_with_all_features() {
    let mut rng = StdRng::seed_from_u64(SEED);
    let limits = Limits { beyond: f64::INFINITY, share: 0.0, enough: -1.0, precision: 1e-12 };
    let mut worst: f64 = 0.0;
    let (mut apart, mut overlapping) = (0, 0);
    for round in 0..12_000 {
        let (a, b) = (random_hull(&mut rng), random_hull(&mut rng));
        let shift = vector(&mut rng) * rng.random_range(0.0..4.0);
        let pose_b = if round % 4 == 0 { Pose::from_translation(shift) } else { pose(&mut rng, shift) };
        let placement = Placement::between(&Pose::IDENTITY, &pose_b);
        let placed: Vec<DVec3> = b.iter().map(|p| placement.point(*p)).collect();
        let found =
            gjk::distance(&Hull::new(&a), &Hull::new(&b), &placement, Start::Axis(vector(&mut rng)), &limits);
        let context = format!("seed {SEED:#x}, round {round}: {found:?}\n{a:?}\n{placed:?}");
        match found.separation {
            Separation::Within => {
                apart += 1;
                let plain = plain_distance(&a, &placed);
                worst = worst.max((found.distance - plain).abs());
                assert!((found.distance - plain).abs() < 1e-10, "{plain} {context}");
                let (x, y) = found.witnesses(&Hull::new(&a), &Hull::new(&b), &placement);
                assert!((x.distance(y) - found.distance).abs() < 1e-12, "{context}");
            }
            Separation::Overlapping => {
                overlapping += 1;
                // No direction separates them.
                let n = found.axis.normalize_or_zero();
                assert!(extent(&a, &placed, n) > -1e-11, "{context}");
                assert!(plain_depth(&a, &placed) > -1e-10, "{context}");
            }
            _ => panic!("{context}"),
        }
    }
    assert!(apart > 3_000 && overlapping > 500, "{apart} {overlapping}");
    assert!(worst < 1e-10, "{worst}");
}

/// Too many pairs for enumeration: the bounds themselves prove the distance, since the lower one is a
/// separating axis and the upper one a pair of points.
#[test]
fn bounds_meet_on_hundreds_of_thousands_of_pairs() {
    let mut rng = StdRng::seed_from_u64(SEED + 1);
    let limits = Limits { beyond: f64::INFINITY, share: 0.0, enough: -1.0, precision: 1e-12 };
    let mut most = 0;
    for round in 0..300_000 {
        let (a, b) = (random_hull(&mut rng), random_hull(&mut rng));
        let shift = vector(&mut rng) * rng.random_range(0.0..4.0);
        let placement = Placement::between(&Pose::IDENTITY, &pose(&mut rng, shift));
        let start = Start::Axis(shift);
        let found = gjk::distance(&Hull::new(&a), &Hull::new(&b), &placement, start, &limits);
        most = most.max(found.iterations);
        let placed = || b.iter().map(|p| placement.point(*p)).collect::<Vec<_>>();
        let context = || format!("seed {:#x}, round {round}: {found:?}\n{a:?}\n{:?}", SEED + 1, placed());
        match found.separation {
            Separation::Within => {
                let gap = -extent(&a, &placed(), -found.axis.normalize());
                assert!(found.distance - gap < 1e-10, "{gap} {}", context());
                // A warm start from the answer finds the same distance at once.
                let vertices: Vec<_> = found.simplex.vertices().iter().map(|v| (v.a, v.b)).collect();
                let again = gjk::distance(
                    &Hull::new(&a),
                    &Hull::new(&b),
                    &placement,
                    Start::Vertices(&vertices, DVec3::X),
                    &limits,
                );
                assert!((again.distance - found.distance).abs() < 1e-10, "{}", context());
                assert!(again.iterations <= 3, "{again:?} {}", context());
            }
            Separation::Overlapping => {}
            _ => panic!("{}", context()),
        }
    }
    assert!(most < 64, "{most}");
}

#[test]
fn limits_stop_the_search_on_the_right_side() {
    let mut rng = StdRng::seed_from_u64(SEED + 2);
    for round in 0..20_000 {
        let (a, b) = (random_hull(&mut rng), random_hull(&mut rng));
        let shift = vector(&mut rng) * rng.random_range(0.0..4.0);
        let placement = Placement::between(&Pose::IDENTITY, &pose(&mut rng, shift));
        let (a, b) = (Hull::new(&a), Hull::new(&b));
        let exact = Limits { beyond: f64::INFINITY, share: 0.0, enough: -1.0, precision: 1e-12 };
        let truth = gjk::distance(&a, &b, &placement, Start::Axis(shift), &exact).distance;
        let d = rng.random_range(0.0..2.0);
        if (truth - d).abs() < 1e-9 {
            continue;
        }
        let decide = Limits { beyond: d, share: 0.0, enough: d, precision: 1e-12 };
        let found = gjk::distance(&a, &b, &placement, Start::Axis(vector(&mut rng)), &decide);
        let beyond = found.separation == Separation::Beyond;
        assert_eq!(beyond, truth > d, "seed {:#x}, round {round}: {truth} {d} {found:?}", SEED + 2);
        let to_d = Limits { beyond: d, share: 0.0, enough: -1.0, precision: 1e-12 };
        let found = gjk::distance(&a, &b, &placement, Start::Axis(vector(&mut rng)), &to_d);
        assert_eq!(found.separation == Separation::Beyond, truth > d, "round {round}: {truth} {d} {found:?}");
        if truth <= d {
            assert!((found.distance - truth).abs() < 1e-10, "round {round}: {truth} {found:?}");
        }
    }
}

#[test]
fn depth_agrees_with_all_directions() {
    let mut rng = StdRng::seed_from_u64(SEED + 3);
    let mut polytope = Polytope::new();
    let mut worst: f64 = 0.0;
    let mut checked = 0;
    for round in 0..20_000 {
        let (a, b) = (random_hull(&mut rng), random_hull(&mut rng));
        let shift = vector(&mut rng) * rng.random_range(0.0..1.0);
        let pose_b = if round % 4 == 0 { Pose::from_translation(shift) } else { pose(&mut rng, shift) };
        let placement = Placement::between(&Pose::IDENTITY, &pose_b);
        let placed: Vec<DVec3> = b.iter().map(|p| placement.point(*p)).collect();
        let limits = Limits { beyond: f64::INFINITY, share: 0.0, enough: -1.0, precision: 1e-12 };
        let (hull_a, hull_b) = (Hull::new(&a), Hull::new(&b));
        let distance = gjk::distance(&hull_a, &hull_b, &placement, Start::Axis(shift), &limits);
        if distance.separation != Separation::Overlapping {
            continue;
        }
        checked += 1;
        let found = polytope.penetration(&hull_a, &hull_b, &placement, &[], 1e-12);
        let plain = plain_depth(&a, &placed);
        let context = format!("seed {:#x}, round {round}: {found:?}\n{a:?}\n{placed:?}", SEED + 3);
        assert!((found.normal.length() - 1.0).abs() < 1e-12, "{context}");
        // Whatever the direction, b moved along it by the depth just touches.
        assert!((extent(&a, &placed, found.normal) - found.depth).abs() < 1e-11, "{context}");
        if plain.is_finite() {
            // The enumeration misses directions of hulls thinner than its own threshold.
            let tolerance = if found.flat { 1e-8 } else { 1e-9 };
            worst = worst.max(found.depth - plain);
            assert!(found.depth <= plain + tolerance, "{plain} {context}");
        }
        if !found.flat && plain.is_finite() && plain > 1e-6 {
            assert!((found.depth - plain).abs() < 1e-9, "{plain} {context}");
            assert!((found.on_a - found.on_b - found.depth * found.normal).length() < 1e-8, "{context}");
        }
    }
    assert!(checked > 2_000, "{checked}");
    assert!(worst < 1e-8, "{worst}");
}

#[test]
fn ball_in_ball_has_the_depth_of_two_spheres() {
    let ball = crate::solids::star(4, |_| 1.0);
    let map = palpate_collide::convex::SupportMap::new(ball.vertices());
    let hull = Hull::with_map(ball.vertices(), Some(&map));
    let mut polytope = Polytope::new();
    let mut rng = StdRng::seed_from_u64(SEED + 4);
    for _ in 0..300 {
        let direction = vector(&mut rng).normalize();
        let overlap = rng.random_range(1e-4..0.5);
        let pose_b = Pose::new(direction * (2.0 - overlap), crate::solids::rotation(&mut rng));
        let placement = Placement::between(&Pose::IDENTITY, &pose_b);
        let found = polytope.penetration(&hull, &hull, &placement, &[], 1e-12);
        // The inscribed polyhedra are thinner than the spheres by at most their facets' sagitta.
        assert!(found.depth <= overlap + 1e-12 && found.depth > overlap - 0.01, "{overlap} {found:?}");
        assert!(found.normal.dot(direction) > 0.98, "{direction} {found:?}");
        assert!(found.converged, "{found:?}");
    }
}
