//! Generalised front tracking (§3.4.2): a query that starts from the last one's front finds the same as one
//! from the roots.

use palpate::Pose;
use palpate::collide::{ContactQuery, PatchContact, QuerySettings, Shape};
use palpate::glam::{DQuat, DVec3};
use palpate::models::Model;
use palpate_tests::hierarchy;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

const SEED: u64 = 0x000F_2047;

fn shape(model: Model, triangles: usize) -> Shape {
    Shape::new(hierarchy(model, triangles))
}

fn vector(rng: &mut StdRng) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)))
}

/// Returns poses of a probe near `at`: slow drifts and turns, rests, and jumps, also far away.
fn wander(rng: &mut StdRng, at: DVec3, radius: f64, count: usize) -> Vec<Pose> {
    let start = Pose::new(at, DQuat::from_scaled_axis(0.1 * vector(rng)));
    let mut poses = vec![start];
    let (mut drift, mut turn) = (DVec3::ZERO, DVec3::ZERO);
    while poses.len() < count {
        let last = *poses.last().unwrap_or(&start);
        if rng.random_bool(0.2) {
            let pace = [1e-4, 2e-3, 2e-2][rng.random_range(0..3)];
            drift = radius * pace * vector(rng) - 0.02 * (last.translation - at);
            turn = pace * vector(rng);
        }
        poses.push(match rng.random_range(0..40) {
            0 => Pose::new(at + 0.3 * radius * vector(rng), DQuat::from_scaled_axis(vector(rng))),
            1 => Pose::new(at + 20.0 * radius * vector(rng), last.rotation),
            2 => start,
            3 => last,
            _ => Pose::new(
                last.translation + drift,
                (DQuat::from_scaled_axis(turn) * last.rotation).normalize(),
            ),
        });
    }
    poses
}

fn agree(tracked: &[PatchContact], cold: &[PatchContact], within: f64) -> bool {
    tracked.len() == cold.len()
        && tracked.iter().zip(cold).all(|(one, other)| {
            (one.probe_node, one.scene_node) == (other.probe_node, other.scene_node)
                && (one.contact.depth - other.contact.depth).abs() <= within
        })
}

#[test]
fn a_tracked_front_finds_what_a_cold_query_does() {
    let mut rng = StdRng::seed_from_u64(SEED);
    let (lower, upper) = (shape(Model::LowerJaw, 4000), shape(Model::UpperJaw, 4000));
    let (ball, torus) = (shape(Model::GolfBall, 4000), shape(Model::Torus, 3000));
    let (spoon, cup) = (shape(Model::Spoon, 3000), shape(Model::Cup, 3000));
    let beside = (torus.clod().bounding_radius() + 0.98 * ball.clod().bounding_radius()) * DVec3::X;
    for (name, probe, scene, at) in [
        ("jaws", &upper, &lower, DVec3::ZERO),
        ("ball on torus", &ball, &torus, beside),
        ("spoon in cup", &spoon, &cup, DVec3::ZERO),
    ] {
        let radius = probe.clod().bounding_radius();
        let mut tracked = ContactQuery::new(probe, scene);
        let mut cold = ContactQuery::new(probe, scene);
        let mut shared = ContactQuery::new(probe, scene);
        let (mut contacts, mut looked_at) = (0, [0, 0]);
        for error in [0.0, 0.004, 0.025] {
            for (index, pose) in wander(&mut rng, at, radius, 400).iter().enumerate() {
                // Tolerance and threshold change now and then.
                let tolerance = radius * if index / 50 % 3 == 2 { 0.02 } else { 0.01 };
                let error = error * radius * if index / 70 % 2 == 1 { 1.5 } else { 1.0 };
                let settings = QuerySettings { error: error.into(), ..QuerySettings::new(tolerance) };
                let scene_pose = Pose::IDENTITY;
                let kept = tracked.run(pose, &scene_pose, &settings).unwrap();
                cold.reset();
                let fresh = cold.run(pose, &scene_pose, &settings).unwrap();
                let context =
                    format!("seed {SEED:#x}, {name}, s₀ {error}, pose {index}: {kept:?}, {fresh:?}");
                assert!(agree(tracked.contacts(), cold.contacts(), 1e-8 * radius), "{context}");
                assert!(kept.dropped == 0 && !kept.front_overflow, "{context}");
                let at_once =
                    shared.run(pose, &scene_pose, &QuerySettings { parallel: true, ..settings }).unwrap();
                assert_eq!(
                    shared.contacts(),
                    tracked.contacts(),
                    "{context}: on several threads, {at_once:?}"
                );
                contacts += kept.contacts;
                looked_at[0] += kept.visited;
                looked_at[1] += fresh.visited;
            }
        }
        assert!(contacts > 1000, "{name}: {contacts} contacts");
        assert!(3 * looked_at[0] < 2 * looked_at[1], "{name}: {looked_at:?} pairs looked at");
    }
}

/// Jumps so long that the motion bound, which defers pairs, is reset between slow drifts.
#[test]
fn long_jumps_change_nothing() {
    let mut rng = StdRng::seed_from_u64(SEED + 3);
    let (ball, torus) = (shape(Model::GolfBall, 4000), shape(Model::Torus, 3000));
    let radius = ball.clod().bounding_radius();
    let beside = (torus.clod().bounding_radius() + 0.98 * radius) * DVec3::X;
    let [mut tracked, mut cold, mut shared] = [0; 3].map(|_| ContactQuery::new(&ball, &torus));
    let mut contacts = 0;
    for (index, pose) in wander(&mut rng, beside, radius, 600).iter().enumerate() {
        let far = Pose::from_translation(400.0 * radius * vector(&mut rng));
        for pose in [far, *pose].iter().skip(usize::from(index % 10 != 0)) {
            let run = |query: &mut ContactQuery, parallel| {
                let settings = QuerySettings { parallel, ..QuerySettings::new(0.01 * radius) };
                query.run(pose, &Pose::IDENTITY, &settings).unwrap()
            };
            cold.reset();
            contacts += run(&mut tracked, false).contacts;
            run(&mut shared, true);
            run(&mut cold, false);
            let same = agree(tracked.contacts(), cold.contacts(), 1e-8 * radius);
            assert!(same && shared.contacts() == tracked.contacts(), "pose {index}");
        }
    }
    assert!(contacts > 1000, "{contacts}");
}

/// Powers of two change no rounding; other factors must not change the contacts either.
#[test]
fn the_scale_changes_no_contact() {
    let mut rng = StdRng::seed_from_u64(SEED + 2);
    let (lower, upper) = (shape(Model::LowerJaw, 3000), shape(Model::UpperJaw, 3000));
    let radius = upper.clod().bounding_radius();
    let poses = wander(&mut rng, DVec3::ZERO, radius, 100);
    for factor in [0.125, 1e-3, 0.0254, 1e3] {
        let scaled = |shape: &Shape| Shape::new(shape.clod().scaled(factor).expect("a factor"));
        let mut query = ContactQuery::new(&upper, &lower);
        let mut other = ContactQuery::new(&scaled(&upper), &scaled(&lower));
        let mut contacts = 0;
        for (index, pose) in poses.iter().enumerate() {
            let error = if index % 2 == 0 { 0.0 } else { 0.025 };
            let settings = |radius: f64| QuerySettings {
                error: (error * radius).into(),
                ..QuerySettings::new(0.01 * radius)
            };
            let moved = Pose::new(factor * pose.translation, pose.rotation);
            let one = query.run(pose, &Pose::IDENTITY, &settings(radius)).unwrap();
            let two = other.run(&moved, &Pose::IDENTITY, &settings(factor * radius)).unwrap();
            let context = format!("seed {:#x}, factor {factor}, pose {index}: {one:?} {two:?}", SEED + 2);
            assert_eq!(query.contacts().len(), other.contacts().len(), "{context}");
            for (one, two) in query.contacts().iter().zip(other.contacts()) {
                assert_eq!((one.probe_node, one.scene_node), (two.probe_node, two.scene_node), "{context}");
                let off = (factor * one.contact.depth - two.contact.depth).abs();
                assert!(off <= 1e-8 * factor * radius, "{context}: {one:?} {two:?}");
            }
            contacts += query.contacts().len();
        }
        assert!(contacts > 500, "{contacts}");
    }
    for factor in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-200, 1e200] {
        assert!(upper.clod().scaled(factor).is_none(), "{factor}");
    }
}

#[test]
fn two_convex_bodies_are_one_pair() {
    let ball = shape(Model::Ellipsoid, 2000);
    let radius = ball.clod().bounding_radius();
    let mut query = ContactQuery::new(&ball, &ball);
    let settings = QuerySettings::new(0.01 * radius);
    let mut touching = 0;
    for step in 0..100 {
        let pose = Pose::from_translation(radius * (2.1 - 0.002 * f64::from(step)) * DVec3::X);
        let outcome = query.run(&pose, &Pose::IDENTITY, &settings).unwrap();
        assert!(outcome.visited <= 1 && outcome.front == 1 && outcome.contacts <= 1, "{outcome:?}");
        touching += outcome.contacts;
    }
    assert!(touching > 10, "{touching}");
}

#[test]
fn the_same_motion_gives_the_same_bits() {
    let mut rng = StdRng::seed_from_u64(SEED + 1);
    let (lower, upper) = (shape(Model::LowerJaw, 3000), shape(Model::UpperJaw, 3000));
    let radius = upper.clod().bounding_radius();
    let poses = wander(&mut rng, DVec3::ZERO, radius, 200);
    let settings = QuerySettings { error: (0.01 * radius).into(), ..QuerySettings::new(0.01 * radius) };
    let run = |query: &mut ContactQuery| {
        poses
            .iter()
            .map(|pose| {
                let outcome = query.run(pose, &Pose::IDENTITY, &settings).unwrap();
                (query.contacts().to_vec(), outcome.visited, outcome.front)
            })
            .collect::<Vec<_>>()
    };
    let mut query = ContactQuery::new(&upper, &lower);
    let once = run(&mut query);
    query.reset();
    assert!(once == run(&mut query), "seed {:#x}", SEED + 1);
    assert!(once == run(&mut ContactQuery::new(&upper, &lower)), "seed {:#x}", SEED + 1);
}
