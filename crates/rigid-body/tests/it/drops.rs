//! Spoons dropped into a cup from random states above it.
//!
//! A few drops by default; more than a thousand with
//! `cargo test --release -p palpate-rigid-body --test it drops:: -- --ignored`.

#![allow(clippy::print_stdout)] // The long test prints its counts.

use std::f64::consts::TAU;

use palpate_collide::{ContactQuery, ErrorMetrics, QuerySettings, Shape, VelocityMetric};
use palpate_core::glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist};
use palpate_models::Model;
use palpate_rigid_body::{BodyState, RigidBody, Settings, Simulation, fly};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

const SEED: u64 = 341;
const SECONDS: f64 = 0.8;
const STEP: f64 = 1e-3;

/// Dimensions of the cup's wall as in the model: outer radius at the foot and at the rim, height, thickness,
/// m.
const MILLIMETRE: f64 = 0.08 / 78.9;
const FOOT: f64 = 36.0 * MILLIMETRE;
const RIM: f64 = 43.0 * MILLIMETRE;
const HEIGHT: f64 = 104.0 * MILLIMETRE;
const WALL: f64 = 4.5 * MILLIMETRE;

/// Returns whether a point is inside of a surface in the cup's wall at the depth `below` the outer one (m).
fn is_inside(point: DVec3, below: f64) -> bool {
    let outer = FOOT + (RIM - FOOT) * (point.z / HEIGHT).clamp(0.0, 1.0).powf(0.8);
    point.z > below && point.z < HEIGHT && point.truncate().length() < outer - below
}

/// Side of the wall on which a point is.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Side {
    /// At or above the rim.
    Over,
    Inside,
    Outside,
}

impl Side {
    /// Returns the side of a point that was on side `before`. Between two depths (m) below the wall's outer
    /// surface it stays on that side.
    fn of(point: DVec3, [from, to]: [f64; 2], before: Self) -> Self {
        if point.z > HEIGHT - 1.5 * MILLIMETRE {
            Self::Over
        } else if is_inside(point, to) {
            Self::Inside
        } else if is_inside(point, from) {
            before
        } else {
            Self::Outside
        }
    }

    /// Returns whether a point has changed sides without passing over the rim.
    fn has_passed_the_wall(self, to: Self) -> bool {
        self != to && self != Self::Over && to != Self::Over
    }
}

/// Depths in the wall between which sides are not determined. At full resolution spoons do not reach half of
/// the wall. Coarse surfaces deviate from the fine ones, but nothing comes out of the other side.
const HALF: [f64; 2] = [0.5 * WALL; 2];
const WHOLE: [f64; 2] = [0.0, WALL];

/// Numbers of triangles of spoon and cup. The first level of the coarse cup deviates from its surface by up
/// to 5.8 mm, more than the thickness of the wall: with the constant metric one of a few hundred spoons
/// passes through. At full resolution none does.
const COARSE: [usize; 2] = [1_344, 4_000];
const FINE: [usize; 2] = [20_000, 16_000];

struct World {
    spoon: Shape,
    cup: Shape,
    body: RigidBody,
    /// Vertices of the spoon, and the observed ones, in its frame.
    points: Vec<DVec3>,
    watched: Vec<DVec3>,
}

/// Error metric of a world.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Metric {
    Exact,
    Constant,
    Velocity,
}

#[derive(Clone, Copy, Debug, Default)]
struct Found {
    impacts: usize,
    switched: usize,
    estimated: usize,
    exhausted: usize,
    resting: usize,
    gone: usize,
    /// Depth in the simulation, m.
    own_depth: f64,
    /// Depth at full resolution, m.
    depth: f64,
    passed: usize,
    queries: usize,
    most_queries: usize,
}

impl World {
    fn new(triangles: [usize; 2]) -> Self {
        let [spoon_mesh, cup_mesh] = [(Model::Spoon, triangles[0]), (Model::Cup, triangles[1])]
            .map(|(model, triangles)| model.generate(triangles).expect("in range"));
        let (spoon, cup) = (crate::worlds::shape(&spoon_mesh), crate::worlds::shape(&cup_mesh));
        let body = RigidBody::solid(&spoon, 0.05).unwrap();
        let points = spoon.clod().vertices.clone();
        let vertices = spoon_mesh.vertices();
        let watched = vertices.iter().step_by(vertices.len().div_ceil(100)).copied().collect();
        Self { spoon, cup, body, points, watched }
    }

    fn settings(&self, metric: Metric) -> Settings {
        let radius = self.spoon.clod().bounding_radius();
        let part = 0.035 * radius;
        let velocity = VelocityMetric { time: part, twist: Twist::ZERO };
        let error = match metric {
            Metric::Exact => ErrorMetrics::EXACT,
            Metric::Constant => part.into(),
            // The same error at 1 m/s.
            Metric::Velocity => ErrorMetrics { velocity: Some(velocity), ..ErrorMetrics::EXACT },
        };
        Settings { error, ..Settings::new(1e-3 * radius) }
    }

    /// Returns a random state over the mouth, upright to lying, rotating and falling.
    fn start(&self, rng: &mut StdRng) -> BodyState {
        let mut vector =
            |size: f64| DVec3::from_array(std::array::from_fn(|_| rng.random_range(-size..size)));
        let (tilt, spin, sideways) = (vector(0.6), vector(6.0), vector(0.3));
        let [about, around, away] = [TAU, TAU, 1.0].map(|most| rng.random_range(0.0..most));
        let up = if rng.random_bool(0.5) { -TAU / 4.0 } else { TAU / 4.0 };
        let rotation =
            DQuat::from_scaled_axis(tilt) * DQuat::from_rotation_z(about) * DQuat::from_rotation_y(up);
        let over = 0.025 * away * DVec3::new(around.cos(), around.sin(), 0.0);
        let fall = rng.random_range(0.0..1.0) * DVec3::NEG_Z;
        let lowest = self.points.iter().map(|point| (rotation * (*point - self.body.center_of_mass())).z);
        let height = HEIGHT + 5e-3 - lowest.fold(f64::INFINITY, f64::min);
        let pose = Pose::new(over + height * DVec3::Z, rotation);
        BodyState { pose, twist: Twist::new(fall + sideways.with_z(0.0), spin) }
    }

    fn places(&self, state: &BodyState) -> Vec<DVec3> {
        let frame = self.body.frame(state);
        self.watched.iter().map(|point| frame.transform_point(*point)).collect()
    }

    /// Simulates the drop of a spoon.
    fn drop(&self, metric: Metric, start: BodyState) -> Found {
        let settings = self.settings(metric);
        let mut simulation =
            Simulation::new(self.body, &self.spoon, &self.cup, Pose::IDENTITY, start, settings).unwrap();
        let mut exact = ContactQuery::new(&self.spoon, &self.cup);
        let mut found = Found::default();
        let wall = if metric == Metric::Exact { HALF } else { WHOLE };
        let mut sides = vec![Side::Over; self.watched.len()];
        let steps = (SECONDS / STEP).round() as usize;
        for step in 0..steps {
            let outcome = simulation.step(STEP).expect("a spoon falls at a few m/s");
            assert!(simulation.state().is_valid());
            for impact in simulation.impacts() {
                assert!(impact.energy_after <= impact.energy_before, "{impact:?}");
            }
            found.impacts += outcome.impacts;
            found.own_depth = found.own_depth.max(outcome.depth);
            found.switched += outcome.switched;
            found.estimated += outcome.estimated;
            found.exhausted += outcome.exhausted;
            found.queries += outcome.queries;
            found.most_queries = found.most_queries.max(outcome.queries);
            for (side, point) in sides.iter_mut().zip(self.places(simulation.state())) {
                let now = Side::of(point, wall, *side);
                found.passed += usize::from(side.has_passed_the_wall(now));
                *side = now;
            }
            if step % 10 == 0 {
                let frame = self.body.frame(simulation.state());
                let depth = exact.run(&frame, &Pose::IDENTITY, &QuerySettings::new(0.0)).unwrap().deepest;
                found.depth = found.depth.max(depth.unwrap_or(0.0));
            }
        }
        assert!((simulation.time() - SECONDS).abs() < 1e-9, "time went on");
        found.resting += usize::from(simulation.still_for() > 0.1);
        found.gone += usize::from(simulation.state().pose.translation.z < -0.1);
        found
    }
}

/// Drops `count` spoons and checks each.
fn drops(world: &World, metric: Metric, count: usize) {
    let mut rng = StdRng::seed_from_u64(SEED);
    let (mut all, mut missed) = (Found::default(), 0);
    for drop in 0..count {
        let found = world.drop(metric, world.start(&mut rng));
        assert_eq!(found.passed, 0, "{metric:?}, seed {SEED}, drop {drop}: through the wall, {found:?}");
        // Coarse surfaces deviate from those of the meshes.
        let deep = metric == Metric::Exact && found.depth > world.settings(metric).tolerance;
        assert!(!deep, "{metric:?}, seed {SEED}, drop {drop}: {found:?}");
        missed += usize::from(found.impacts == 0);
        all.impacts += found.impacts;
        all.switched += found.switched;
        all.estimated += found.estimated;
        all.exhausted += found.exhausted;
        all.resting += found.resting;
        all.gone += found.gone;
        all.own_depth = all.own_depth.max(found.own_depth);
        all.depth = all.depth.max(found.depth);
        all.queries += found.queries;
        all.most_queries = all.most_queries.max(found.most_queries);
    }
    println!("{metric:?}: {count} drops, {missed} of them past the cup, {all:?}");
    assert!(missed * 10 <= count && all.gone < count, "{missed} passed, {} fell out again", all.gone);
    // Only with changes of resolution is there no time at which surfaces meet.
    let without_instant = all.switched + all.estimated > 0;
    assert_eq!(without_instant, metric != Metric::Exact, "{metric:?}: {all:?}");
}

#[test]
fn spoons_stay_out_of_the_wall() {
    let world = World::new(COARSE);
    for metric in [Metric::Exact, Metric::Constant, Metric::Velocity] {
        drops(&world, metric, 6);
    }
}

/// More than a thousand.
#[test]
#[ignore = "takes minutes: run it in release"]
fn a_thousand_spoons_stay_out_of_the_wall() {
    let world = World::new(FINE);
    drops(&world, Metric::Constant, 500);
    drops(&world, Metric::Velocity, 500);
    drops(&world, Metric::Exact, 50);
}

/// A spoon without contacts falls through the bottom, and the check finds it.
#[test]
fn spoons_that_fall_freely_pass_the_wall() {
    let world = World::new(COARSE);
    let mut rng = StdRng::seed_from_u64(SEED);
    for drop in 0..6 {
        let start = world.start(&mut rng);
        for wall in [HALF, WHOLE] {
            let (mut passed, mut state) = (0, start);
            let mut sides = vec![Side::Over; world.watched.len()];
            for _ in 0..400 {
                state = fly(&world.body, &state, Settings::new(1e-4).gravity, STEP);
                for (side, point) in sides.iter_mut().zip(world.places(&state)) {
                    let now = Side::of(point, wall, *side);
                    passed += usize::from(side.has_passed_the_wall(now));
                    *side = now;
                }
            }
            assert!(passed > 0, "drop {drop}");
        }
    }
}
