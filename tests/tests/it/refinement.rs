//! Selective refinement (§3.4.3): contacts at the coarsest resolution that an error threshold allows.

use std::sync::{Arc, OnceLock};

use palpate::Pose;
use palpate::collide::{
    Budget, ContactQuery, ErrorMetrics, QueryError, QuerySettings, Shape, VelocityMetric, ViewMetric,
};
use palpate::core::Clod;
use palpate::core::Twist;
use palpate::glam::{DQuat, DVec3};
use palpate::models::Model;
use palpate_tests::hierarchy;

/// Two objects, and poses of the first: from apart to pressed into the second, turning.
type Scene = (&'static str, Arc<Clod>, Arc<Clod>, Vec<Pose>);

fn scenes() -> &'static [Scene] {
    static SCENES: OnceLock<Vec<Scene>> = OnceLock::new();
    SCENES.get_or_init(build_scenes)
}

fn build_scenes() -> Vec<Scene> {
    let path = |from: DVec3, to: DVec3, turn: f64| {
        let at = |t: f64| Pose::new(from.lerp(to, t), DQuat::from_rotation_z(turn * t));
        (0..30).map(|k| at(f64::from(k) / 29.0)).collect()
    };
    // The jaws are closed where both are in their own frames.
    let (lower, upper) = (hierarchy(Model::LowerJaw, 4000), hierarchy(Model::UpperJaw, 4000));
    let jaws =
        path(0.03 * upper.bounding_radius() * DVec3::Z, -0.02 * upper.bounding_radius() * DVec3::Z, 0.02);
    let (ball, torus) = (hierarchy(Model::GolfBall, 4000), hierarchy(Model::Torus, 3000));
    let beside = (torus.bounding_radius() + 1.02 * ball.bounding_radius()) * DVec3::X;
    let balls = path(beside, 0.97 * beside, 1.0);
    vec![("jaws", upper, lower, jaws), ("ball on torus", ball, torus, balls)]
}

fn settings(probe: &Clod, error: f64) -> QuerySettings {
    let radius = probe.bounding_radius();
    QuerySettings { error: (error * radius).into(), ..QuerySettings::new(0.01 * radius) }
}

/// With an error that is exceeded by all patches except those of the full mesh, the surfaces are the full
/// mesh's, visited in another order.
#[test]
fn a_tiny_error_is_full_resolution() {
    for (name, probe, scene, poses) in scenes() {
        let mut query = ContactQuery::new(&Shape::new(probe.clone()), &Shape::new(scene.clone()));
        let (mut apart, mut pressed) = (0, 0);
        for pose in poses {
            let [exact, tiny] = [0.0, 1e-12].map(|error| {
                query.run(pose, &Pose::IDENTITY, &settings(probe, error)).unwrap().smallest_distance
            });
            match (exact, tiny) {
                (Some(a), Some(b)) => {
                    assert!((a - b).abs() < 1e-9 * probe.bounding_radius(), "{name}: {a} {b}")
                }
                _ => assert_eq!(exact, tiny, "{name} at {pose:?}"),
            }
            apart += usize::from(exact.is_some_and(|d| d > 0.0));
            pressed += usize::from(exact == Some(0.0));
        }
        assert!(apart >= 3 && pressed >= 3, "{name}: {apart} {pressed}");
    }
}

/// The surfaces of a pair of nodes are within s of the meshes. So where coarse surfaces are some distance
/// apart, the meshes are no further apart than that plus both s.
#[test]
fn contacts_are_true_to_within_the_deviation_of_their_levels() {
    for (name, probe, scene, poses) in scenes() {
        let mut query = ContactQuery::new(&Shape::new(probe.clone()), &Shape::new(scene.clone()));
        let mut checked = 0;
        for pose in poses {
            let all = QuerySettings::new(0.3 * probe.bounding_radius());
            let nearest = query.run(pose, &Pose::IDENTITY, &all).unwrap().smallest_distance;
            for error in [0.004, 0.025, 0.1] {
                query.run(pose, &Pose::IDENTITY, &settings(probe, error)).unwrap();
                for found in query.contacts() {
                    let (a, b) = (probe.node(found.probe_node), scene.node(found.scene_node));
                    let bound = found.contact.distance() + a.deviation + b.deviation;
                    let reach = all.tolerance.min(bound);
                    let nearest = nearest.unwrap_or(all.tolerance);
                    assert!(nearest <= reach + 1e-9, "{name} at {pose:?}: {nearest} for {found:?}, {bound}");
                    assert!(!scene.levels[b.level as usize].free && !probe.levels[a.level as usize].free);
                    checked += 1;
                }
            }
        }
        assert!(checked > 100, "{name}: {checked} contacts");
    }
}

/// Larger errors give contacts from coarser levels, and smaller fronts.
#[test]
fn larger_errors_cost_less() {
    for (name, probe, scene, poses) in scenes() {
        let mut query = ContactQuery::new(&Shape::new(probe.clone()), &Shape::new(scene.clone()));
        let mut cost = |error: f64| {
            let (mut front, mut triangles, mut contacts) = (0, 0, 0);
            for pose in poses {
                let outcome = query.run(pose, &Pose::IDENTITY, &settings(probe, error)).unwrap();
                front += outcome.front;
                contacts += outcome.contacts;
                triangles += query
                    .contacts()
                    .iter()
                    .map(|c| probe.levels[probe.node(c.probe_node).level as usize].triangles as usize)
                    .sum::<usize>();
            }
            (front, triangles / contacts.max(1))
        };
        let exact = cost(0.0);
        let costs = [0.025, 0.1, 0.5].map(&mut cost);
        assert!(costs.windows(2).all(|w| w[1].0 <= w[0].0 && w[1].1 <= w[0].1), "{name}: {costs:?}");
        assert!(2 * costs[2].0 < exact.0 && 2 * costs[2].1 < exact.1, "{name}: {costs:?} {exact:?}");
    }
}

/// Faster motion and a more distant camera leave out more detail, and at rest none is left out (§3.4.3).
#[test]
fn fast_or_distant_objects_are_coarse() {
    for (name, probe, scene, poses) in scenes() {
        let mut query = ContactQuery::new(&Shape::new(probe.clone()), &Shape::new(scene.clone()));
        let radius = probe.bounding_radius();
        let mut triangles = |error: ErrorMetrics| {
            let settings = QuerySettings { error, ..QuerySettings::new(0.01 * radius) };
            let (mut triangles, mut contacts) = (0, 0);
            for pose in poses {
                assert!(query.run(pose, &Pose::IDENTITY, &settings).is_ok());
                contacts += query.contacts().len();
                let level = |c: u32| &probe.levels[probe.node(c).level as usize];
                triangles +=
                    query.contacts().iter().map(|c| level(c.probe_node).triangles as usize).sum::<usize>();
            }
            triangles / contacts.max(1)
        };
        let at_speed = |speed: f64| ErrorMetrics {
            velocity: Some(VelocityMetric {
                time: 0.01,
                twist: Twist::new(speed * radius * DVec3::X, DVec3::ZERO),
            }),
            ..ErrorMetrics::EXACT
        };
        let from = |distance: f64| ErrorMetrics {
            view: Some(ViewMetric {
                pixels: 1.0,
                camera: distance * radius * DVec3::Z,
                near: 0.1,
                frustum: 0.1,
                image: 1000.0,
            }),
            ..ErrorMetrics::EXACT
        };
        let exact = triangles(ErrorMetrics::EXACT);
        let speeds = [0.0, 2.5, 10.0, 50.0].map(|speed| triangles(at_speed(speed)));
        assert!(speeds.windows(2).all(|w| w[1] <= w[0]), "{name}: {speeds:?}");
        // Flat patches are not refined, since their detail is complete.
        assert!(10 * speeds[0] > 9 * exact && 2 * speeds[3] < exact, "{name}: {speeds:?} of {exact}");
        let distances = [25.0, 100.0, 500.0].map(|distance| triangles(from(distance)));
        assert!(distances.windows(2).all(|w| w[1] <= w[0]), "{name}: {distances:?}");
        assert!(2 * distances[2] < exact, "{name}: {distances:?} of {exact}");
    }
}

/// A sufficient budget changes nothing; a small one is kept, is reported, and still finds where objects
/// touch.
#[test]
fn a_time_critical_query_keeps_its_budget() {
    for (name, probe, scene, poses) in scenes() {
        let shapes = [Shape::new(probe.clone()), Shape::new(scene.clone())];
        let [mut free, mut bound, mut large] = [(); 3].map(|()| ContactQuery::new(&shapes[0], &shapes[1]));
        let (mut kept, mut touching, mut met) = (0, 0, 0);
        for pose in poses {
            let settings = settings(probe, 0.004);
            let all = free.run(pose, &Pose::IDENTITY, &settings).unwrap();
            let much = QuerySettings { budget: Some(Budget::Queries(1_000_000)), ..settings };
            let same = large.run(pose, &Pose::IDENTITY, &much).unwrap();
            assert!(!same.out_of_budget && same.contacts == all.contacts, "{name}: {same:?} {all:?}");
            assert_eq!(same.deepest.is_some(), all.deepest.is_some());
            // The descent through the free levels, and contacts decided by triangles, are not part of the
            // budget.
            let little = QuerySettings { budget: Some(Budget::Queries(400)), ..settings };
            bound.reset();
            let some = bound.run(pose, &Pose::IDENTITY, &little).unwrap();
            if some.out_of_budget {
                assert!(some.worst_deviation > 1.0, "{name}: {some:?}");
                kept += usize::from(some.convex_queries <= 440);
                touching += usize::from(all.contacts > 0);
                met += usize::from(all.contacts > 0 && some.contacts > 0);
            }
        }
        assert!(kept >= 5 && touching >= 3, "{name}: {kept} within the budget, {touching} touching");
        assert!(10 * met >= 8 * touching, "{name}: {met} of {touching}");
    }
}

/// With interpolation (§3.4.4) the force of a probe that slides in tiny steps changes by a small multiple of
/// the stiffness times the step; without, it jumps where the level of detail is switched.
#[test]
fn interpolated_forces_do_not_jump_at_level_switches() {
    let (probe, scene) = (hierarchy(Model::Ellipsoid, 2000), hierarchy(Model::GolfBall, 20_000));
    let radius = probe.bounding_radius();
    let shapes = [Shape::new(probe.clone()), Shape::new(scene.clone())];
    let d = 0.01 * radius;
    let step = 1e-5 * radius;
    let largest_change = |interpolate: bool| {
        let mut query = ContactQuery::new(&shapes[0], &shapes[1]);
        let settings = QuerySettings { interpolate, ..settings(&probe, 0.025) };
        let mut height = radius + scene.bounding_radius() + 2.0 * d;
        let pose = |height: f64, along: f64| Pose::from_translation(DVec3::new(height, along, 0.0));
        while query.run(&pose(height, 0.0), &Pose::IDENTITY, &settings).unwrap().deepest.unwrap_or(-1.0)
            < -0.3 * d
        {
            height -= 0.1 * d;
        }
        // Force over stiffness, m: Σ w (δ + d) n.
        let mut force = |along: f64| {
            query.run(&pose(height, along), &Pose::IDENTITY, &settings).unwrap();
            let found = query.contacts().iter();
            found.map(|c| c.contact.normal * (c.weight * (c.contact.depth + d).max(0.0))).sum::<DVec3>()
        };
        let mut last = force(0.0);
        let mut largest: f64 = 0.0;
        for index in 1..4000 {
            let now = force(f64::from(index) * step);
            largest = largest.max(now.distance(last) / step);
            last = now;
        }
        largest
    };
    let (smooth, switched) = (largest_change(true), largest_change(false));
    assert!(smooth < 6.0, "{smooth}");
    assert!(switched > 50.0, "the path goes through level switches: {switched}");
}

#[test]
fn invalid_errors_are_refused() {
    let torus = hierarchy(Model::Torus, 1000);
    let mut query = {
        let torus = Shape::new(torus.clone());
        ContactQuery::new(&torus, &torus)
    };
    for error in [f64::NAN, f64::INFINITY, -1e-3] {
        let asked = QuerySettings { error: error.into(), ..QuerySettings::new(0.01) };
        let refused = query.run(&Pose::IDENTITY, &Pose::IDENTITY, &asked);
        assert!(matches!(refused, Err(QueryError::HapticMetric { .. })), "{error}: {refused:?}");
        assert!(query.contacts().is_empty(), "{error}");
    }
}
