//! Time of one pair of convex hulls (§3.4.1), the elementary operation of contact queries: by the number of
//! vertices of each hull, apart, touching and overlapping, without a start (`cold`) and from the answer at
//! the pose before (`warm`).
//!
//! `cargo bench -p palpate-benches --bench convex_pairs`. Hulls are points spread over an ellipsoid, with a
//! support map from the size at which queries use one. An iteration turns the second hull slightly and
//! computes the distance and, where the hulls overlap, the depth. A line before each measurement prints the
//! number of iterations of the distance, and checks that the pair is what its name says.

#![allow(missing_docs, clippy::print_stdout, reason = "a program that reports to the console")]

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion};
use palpate::Pose;
use palpate::collide::convex::gjk;
use palpate::collide::convex::{Hull, Limits, Placement, Polytope, Separation, Start, SupportMap};
use palpate::glam::{DQuat, DVec3};

/// Half axes of the hulls, m.
const AXES: DVec3 = DVec3::new(0.01, 0.008, 0.006);
/// Limits of a query with a tolerance of 0.1 mm.
const LIMITS: Limits = Limits { beyond: f64::INFINITY, share: 0.0, enough: -1.0, precision: 1e-8 };
/// Rotation of the second hull from pose to pose, rad: 1 rad/s at 1 kHz.
const TURN: f64 = 1e-3;
/// Number of poses that are cycled through.
const POSES: usize = 64;
/// Numbers of vertices of each hull.
const SIZES: [usize; 4] = [8, 32, 128, 512];

/// Returns points spread evenly over the ellipsoid, in a spiral from pole to pole.
fn ellipsoid(count: usize) -> Vec<DVec3> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let point = |index: usize| {
        let z = 1.0 - (2.0 * index as f64 + 1.0) / count as f64;
        let (sin, cos) = (golden * index as f64).sin_cos();
        let radius = (1.0 - z * z).sqrt();
        AXES * DVec3::new(radius * cos, radius * sin, z)
    };
    (0..count).map(point).collect()
}

/// Two hulls, the second at a number of poses.
struct Pair<'a> {
    a: Hull<'a>,
    b: Hull<'a>,
    placements: Vec<Placement>,
    polytope: Polytope,
    /// Vertices of the last answer, and the axis.
    vertices: Vec<(u32, u32)>,
    axis: DVec3,
    tetrahedron: Vec<(u32, u32)>,
}

impl<'a> Pair<'a> {
    /// Returns a pair with a gap (m) at the first pose; if negative, the hulls overlap.
    fn new(a: Hull<'a>, b: Hull<'a>, gap: f64) -> Self {
        let direction = DVec3::new(0.5, 0.3, 0.8).normalize();
        // Bisection along the direction for the place at which they touch.
        let (mut near, mut far) = (0.0, 1.0);
        let placement = |distance: f64, angle: f64| {
            let rotation = DQuat::from_scaled_axis(DVec3::new(0.3, 1.0, -0.4).normalize() * (0.7 + angle));
            Placement::between(&Pose::IDENTITY, &Pose::new(direction * distance, rotation))
        };
        while far - near > 1e-12 {
            let middle = 0.5 * (near + far);
            let found = gjk::distance(&a, &b, &placement(middle, 0.0), Start::Axis(-direction), &LIMITS);
            let apart = found.separation == Separation::Within;
            *(if apart && found.distance > gap.max(0.0) { &mut far } else { &mut near }) = middle;
        }
        let distance = far + gap.min(0.0);
        let angle = |index: usize| TURN * (std::f64::consts::TAU * index as f64 / POSES as f64).sin();
        let placements = (0..POSES).map(|index| placement(distance, angle(index))).collect();
        let (vertices, tetrahedron) = (Vec::with_capacity(4), Vec::with_capacity(4));
        Self { a, b, placements, polytope: Polytope::new(), vertices, axis: -direction, tetrahedron }
    }

    fn query(&mut self, index: usize, warm: bool) -> (Separation, f64, u32) {
        let placement = &self.placements[index % POSES];
        let start = if warm {
            Start::Vertices(&self.vertices, self.axis)
        } else {
            Start::Axis(-placement.point(DVec3::ZERO))
        };
        let found = gjk::distance(&self.a, &self.b, placement, start, &LIMITS);
        self.vertices.clear();
        self.vertices.extend(found.simplex.vertices().iter().map(|vertex| (vertex.a, vertex.b)));
        if found.separation != Separation::Overlapping {
            self.axis = found.axis;
            return (found.separation, found.distance, found.iterations);
        }
        let start = if warm { &self.tetrahedron } else { &self.vertices };
        let deepest = self.polytope.penetration(&self.a, &self.b, placement, start, LIMITS.precision);
        self.axis = -deepest.normal;
        self.tetrahedron.clear();
        self.tetrahedron.extend(deepest.tetrahedron);
        (found.separation, -deepest.depth, found.iterations)
    }
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    let mut group = criterion.benchmark_group("convex_pairs");
    for size in SIZES {
        let points = ellipsoid(size);
        let map = (size >= SupportMap::MIN_POINTS).then(|| SupportMap::new(&points));
        let hull = || Hull::with_map(&points, map.as_ref());
        for (name, gap) in [("separated", 1e-3), ("touching", 0.0), ("penetrating", -2e-4)] {
            let mut pair = Pair::new(hull(), hull(), gap);
            for (start, warm) in [("cold", false), ("warm", true)] {
                let found: Vec<_> = (0..2 * POSES).map(|index| pair.query(index, warm)).collect();
                let found = &found[POSES..];
                check(name, found);
                let iterations = found.iter().map(|(.., iterations)| iterations).sum::<u32>();
                println!("{name}, {start}: {:.1} iterations", f64::from(iterations) / POSES as f64);
                let mut index = 0;
                group.bench_function(BenchmarkId::new(format!("{name}/{start}"), size), |bencher| {
                    bencher.iter(|| {
                        index += 1;
                        black_box(pair.query(index, warm))
                    });
                });
            }
        }
    }
    group.finish();
    criterion.final_summary();
}

/// Checks that pairs are what their names say.
fn check(name: &str, found: &[(Separation, f64, u32)]) {
    for (separation, distance, _) in found {
        assert!(*separation != Separation::NotConverged, "{name}: {found:?}");
        let fits = match name {
            "separated" => (5e-4..2e-3).contains(distance),
            // By this rotation, the surface of a hull of this size moves by some micrometres.
            "touching" => distance.abs() < 2e-5,
            _ => (-4e-4..-5e-5).contains(distance),
        };
        assert!(fits, "{name}: {distance} m, {separation:?}");
    }
}
