//! Selective refinement (§3.4.3): contacts at the coarsest resolution that a threshold on the error allows.

use palpate::Pose;
use palpate::clod_build::{BuildOptions, build, unwatched};
use palpate::collide::{ContactQuery, QueryOutcome, QuerySettings, Shape};
use palpate::core::Clod;
use palpate::glam::{DQuat, DVec3};
use palpate::models::Model;

fn hierarchy(model: Model, triangles: usize) -> Clod {
    let mesh = model.generate(triangles).expect("in range");
    build(&mesh, &BuildOptions::default(), &mut unwatched).expect("built-in models can be built")
}

/// Two objects and poses of the first: from apart to pressed into the second, turning.
fn scenes() -> Vec<(&'static str, Clod, Clod, Vec<Pose>)> {
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
    QuerySettings { error: error * radius, ..QuerySettings::new(0.01 * radius) }
}

/// With an error that only patches keep below that are the mesh's own, the surfaces are the full mesh's, descended in
/// another order.
#[test]
fn a_tiny_error_is_full_resolution() {
    for (name, probe, scene, poses) in scenes() {
        let mut query = ContactQuery::new(&Shape::new(probe.clone()), &Shape::new(scene.clone()));
        let (mut apart, mut pressed) = (0, 0);
        for pose in &poses {
            let [exact, tiny] = [0.0, 1e-12]
                .map(|error| query.run(pose, &Pose::IDENTITY, &settings(&probe, error)).smallest_distance);
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

/// The surfaces of a pair of nodes are within s of the meshes. So where coarse surfaces are some distance apart, the
/// meshes are no further apart than that and both s.
#[test]
fn contacts_are_true_to_within_the_deviation_of_their_levels() {
    for (name, probe, scene, poses) in scenes() {
        let mut query = ContactQuery::new(&Shape::new(probe.clone()), &Shape::new(scene.clone()));
        let mut checked = 0;
        for pose in &poses {
            let all = QuerySettings::new(0.3 * probe.bounding_radius());
            let nearest = query.run(pose, &Pose::IDENTITY, &all).smallest_distance;
            for error in [0.004, 0.025, 0.1] {
                query.run(pose, &Pose::IDENTITY, &settings(&probe, error));
                for found in query.contacts() {
                    let (a, b) =
                        (&probe.nodes[found.probe_node as usize], &scene.nodes[found.scene_node as usize]);
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

/// The larger the error, the coarser the levels that contacts come from, and the fewer pairs are visited for them.
#[test]
fn larger_errors_cost_less() {
    for (name, probe, scene, poses) in scenes() {
        let mut query = ContactQuery::new(&Shape::new(probe.clone()), &Shape::new(scene.clone()));
        let mut cost = |error: f64| {
            let (mut visited, mut triangles, mut contacts) = (0, 0, 0);
            for pose in &poses {
                let outcome = query.run(pose, &Pose::IDENTITY, &settings(&probe, error));
                visited += outcome.visited;
                contacts += outcome.contacts;
                triangles += query
                    .contacts()
                    .iter()
                    .map(|c| {
                        probe.levels[probe.nodes[c.probe_node as usize].level as usize].triangles as usize
                    })
                    .sum::<usize>();
            }
            (visited, triangles / contacts.max(1))
        };
        let exact = cost(0.0);
        let costs = [0.004, 0.025, 0.1].map(&mut cost);
        assert!(costs.windows(2).all(|w| w[1].0 <= w[0].0 && w[1].1 <= w[0].1), "{name}: {costs:?}");
        assert!(2 * costs[2].0 < exact.0 && 2 * costs[2].1 < exact.1, "{name}: {costs:?} {exact:?}");
    }
}

#[test]
fn errors_that_are_no_lengths_are_refused() {
    let torus = hierarchy(Model::Torus, 1000);
    let mut query = {
        let torus = Shape::new(torus.clone());
        ContactQuery::new(&torus, &torus)
    };
    for error in [f64::NAN, f64::INFINITY, -1e-3] {
        let asked = QuerySettings { error, ..QuerySettings::new(0.01) };
        let outcome: QueryOutcome = query.run(&Pose::IDENTITY, &Pose::IDENTITY, &asked);
        assert!(outcome.refused && query.contacts().is_empty(), "{error}");
    }
}
