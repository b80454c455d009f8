//! Scene queries of one probe with many objects: the contacts are those of a query with each.

use crate::solids::{Kind, clusters, hierarchy, pose, rotation, singles, star, torus, vector};
use allocation_counter::measure;
use palpate_clod_build::{BuildOptions, build, unwatched};
use palpate_collide::{
    Budget, ContactQuery, ObjectHandle, PatchContact, QueryOutcome, QuerySettings, SceneQuery, Shape,
};
use palpate_core::glam::{DQuat, DVec3};
use palpate_core::{Clod, Pose};
use rand::{RngExt, SeedableRng, rngs::StdRng};

const SEED: u64 = 0x005C_E4E5;
const TOLERANCE: f64 = 0.08;

fn bumpy() -> Shape {
    let mesh = star(2, |v| 1.0 + 0.12 * (7.0 * v.x).sin() * (6.0 * v.y + 1.0).sin());
    Shape::new(hierarchy(&mesh, &clusters(&mesh, 4), Kind::Loose).0)
}

/// Shapes: round, long and flat, ring-shaped, open, and a smaller one.
fn shapes() -> Vec<Shape> {
    let egg = star(2, |v| 1.0 + 0.2 * v.x);
    let ring = torus(1.0, 0.25, 12, 6);
    let rod = torus(3.0, 0.1, 4, 3);
    let (egg, _) = hierarchy(&egg, &singles(&egg), Kind::Contained);
    let (ring, _) = hierarchy(&ring, &clusters(&ring, 5), Kind::Open);
    let (rod, _) = hierarchy(&rod, &singles(&rod), Kind::Loose);
    let small = egg.scaled(0.3).expect("a factor");
    let off_centre = {
        let mut parts = egg.parts().scaled(0.5).expect("a factor");
        let shift = DVec3::new(2.0, -1.0, 0.5);
        parts.vertices.iter_mut().for_each(|vertex| *vertex += shift);
        parts.nodes.iter_mut().for_each(|node| node.center += shift);
        parts.source.center += shift;
        Clod::pack(&parts).expect("it is valid")
    };
    vec![
        bumpy(),
        Shape::new(egg),
        Shape::new(ring),
        Shape::new(rod),
        Shape::new(small),
        Shape::new(off_centre),
    ]
}

fn agree(found: &[PatchContact], expected: &[PatchContact]) -> bool {
    found.len() == expected.len()
        && found.iter().zip(expected).all(|(one, other)| {
            (one.probe_node, one.scene_node, one.weight) == (other.probe_node, other.scene_node, other.weight)
                && one.contact.point.distance(other.contact.point) < 1e-7
                && (one.contact.depth - other.contact.depth).abs() < 1e-8
        })
}

/// A scene query beside a contact query with each object.
struct Both {
    probe: Shape,
    scene: SceneQuery,
    plain: Vec<(ObjectHandle, Pose, ContactQuery)>,
    contacts: usize,
    tested: usize,
    queried: usize,
}

impl Both {
    fn new(probe: &Shape) -> Self {
        let (scene, plain) = (SceneQuery::new(probe), Vec::new());
        Self { probe: probe.clone(), scene, plain, contacts: 0, tested: 0, queried: 0 }
    }

    fn add(&mut self, shape: &Shape, pose: Pose) {
        let handle = self.scene.add(shape, &pose);
        self.plain.push((handle, pose, ContactQuery::new(&self.probe, shape)));
        self.plain.sort_by_key(|(handle, ..)| *handle);
    }

    fn check(&mut self, probe_pose: &Pose, settings: &QuerySettings, context: &str) {
        let outcome = self.scene.run(probe_pose, settings).unwrap();
        let mut sum = QueryOutcome::default();
        let mut found = self.scene.contacts().peekable();
        let mut last = None;
        for (handle, pose, query) in &mut self.plain {
            let expected = query.run(probe_pose, pose, settings).unwrap();
            let of_object = found.next_if(|found| found.object == *handle);
            let contacts = of_object.map_or(&[][..], |found| found.contacts);
            assert!(agree(contacts, query.contacts()), "{context}, {handle:?}: {contacts:?}");
            assert!(last < Some(*handle));
            last = Some(*handle);
            sum.contacts += expected.contacts;
            sum.deepest = [sum.deepest, expected.deepest].into_iter().flatten().reduce(f64::max);
        }
        assert!(found.next().is_none(), "{context}");
        drop(found);
        assert_eq!(outcome.query.contacts, sum.contacts, "{context}");
        assert_eq!(outcome.query.deepest.is_some(), sum.deepest.is_some());
        let off = outcome.query.deepest.zip(sum.deepest).map_or(0.0, |(x, y)| (x - y).abs());
        assert!(off < 1e-8 && outcome.invalid == 0, "{context}: {outcome:?}");
        // The objects within reach are the same without queries.
        let queried: Vec<_> = self.scene.contacts().map(|with| with.object).collect();
        assert_eq!(self.scene.find_near(probe_pose, settings.tolerance), Ok(0), "{context}");
        assert!(self.scene.near().eq(queried.iter().copied()), "{context}");
        assert_eq!(self.scene.contacts().count(), 0);
        self.contacts += sum.contacts;
        self.tested += outcome.tested;
        self.queried += outcome.queried;
    }
}

/// Small steps, large ones, and rests.
fn wander(rng: &mut StdRng, pose: &Pose) -> Pose {
    let pace = [0.0, 1e-3, 0.02, 0.3][rng.random_range(0..4)];
    let turn = DQuat::from_scaled_axis(pace * vector(rng));
    Pose::new(pose.translation + pace * vector(rng), (turn * pose.rotation).normalize())
}

#[test]
fn the_contacts_are_those_of_a_query_with_each_object() {
    let mut rng = StdRng::seed_from_u64(SEED);
    let (probe, shapes) = (bumpy(), shapes());
    let mut runs = 0;
    let (mut contacts, mut tested, mut queried) = (0, 0, 0);
    for round in 0..6 {
        let mut both = Both::new(&probe);
        for index in 0..60 {
            let at = 6.0 * vector(&mut rng);
            both.add(&shapes[index % shapes.len()], pose(&mut rng, at));
        }
        let mut probe_pose = pose(&mut rng, DVec3::ZERO);
        for step in 0..150 {
            let context = format!("seed {SEED:#x}, round {round}, step {step}");
            probe_pose = match rng.random_range(0..40) {
                0 => Pose::new(8.0 * vector(&mut rng), rotation(&mut rng)),
                _ => wander(&mut rng, &probe_pose),
            };
            // A quaternion may be a little off unit length.
            probe_pose.rotation *= 1.0 + 4e-7 * vector(&mut rng).x;
            for _ in 0..rng.random_range(0..8) {
                let moved = rng.random_range(0..both.plain.len());
                let (handle, pose, _) = &mut both.plain[moved];
                *pose = match rng.random_range(0..20) {
                    0 => Pose::new(6.0 * vector(&mut rng), rotation(&mut rng)),
                    _ => wander(&mut rng, pose),
                };
                assert!(both.scene.set_pose(*handle, pose));
            }
            if round % 2 == 1 && step % 7 == 0 {
                let removed = rng.random_range(0..both.plain.len());
                let (handle, ..) = both.plain.remove(removed);
                assert!(both.scene.remove(handle) && !both.scene.remove(handle));
                assert!(!both.scene.set_pose(handle, &Pose::IDENTITY) && both.scene.pose(handle).is_none());
                let at = 6.0 * vector(&mut rng);
                both.add(&shapes[step % shapes.len()], pose(&mut rng, at));
                assert_eq!(both.scene.len(), 60);
            }
            let tolerance = TOLERANCE * [1.0, 1.5][step / 30 % 2];
            let error = [0.0, 0.03][step / 50 % 2];
            let settings = QuerySettings { error: error.into(), ..QuerySettings::new(tolerance) };
            both.check(&probe_pose, &settings, &context);
            runs += 60;
        }
        contacts += both.contacts;
        tested += both.tested;
        queried += both.queried;
    }
    assert!(contacts > 20_000, "{contacts} contacts");
    assert!(5 * tested < 2 * runs && queried < tested, "of {runs}, {tested} tested, {queried} queried");
}

#[test]
fn removed_objects_are_not_touched() {
    let shape = bumpy();
    let mut scene = SceneQuery::new(&shape);
    let settings = QuerySettings::new(TOLERANCE);
    let poses = [DVec3::X, -DVec3::X].map(|at| Pose::from_translation(1.9 * at));
    let [right, left] = poses.map(|pose| scene.add(&shape, &pose));
    let touched = |scene: &SceneQuery| scene.contacts().map(|found| found.object).collect::<Vec<_>>();
    scene.run(&Pose::IDENTITY, &settings).unwrap();
    assert_eq!(touched(&scene), [right, left]);
    assert!(scene.set_pose(right, &poses[1]) && scene.set_pose(left, &poses[0]));
    assert_eq!(scene.run(&Pose::IDENTITY, &settings).unwrap().queried, 2);
    assert!(scene.remove(right) && scene.shape(right).is_none());
    assert_eq!(touched(&scene), [left]);
    assert_eq!(scene.run(&Pose::IDENTITY, &settings).unwrap().queried, 1);
    let again = scene.add(&shape, &poses[1]);
    assert!(again > right && scene.len() == 2, "a handle of its own");
    scene.run(&Pose::IDENTITY, &settings).unwrap();
    assert_eq!(touched(&scene), [again, left]);
}

#[test]
fn invalid_objects_are_counted_and_invalid_queries_refused() {
    let shape = bumpy();
    let mut scene = SceneQuery::new(&shape);
    let settings = QuerySettings::new(TOLERANCE);
    let good = scene.add(&shape, &Pose::from_translation(1.9 * DVec3::X));
    let bad = scene.add(&shape, &Pose::from_translation(DVec3::NAN));
    let far = scene.add(&shape, &Pose::from_translation(1e300 * DVec3::ONE));
    let outcome = scene.run(&Pose::IDENTITY, &settings).unwrap();
    assert!(outcome.invalid == 1 && outcome.query.contacts > 0, "{outcome:?}");
    assert!(scene.contacts().all(|found| found.object == good || found.contacts.is_empty()));
    assert!(scene.set_pose(bad, &Pose::from_translation(-1.9 * DVec3::X)));
    assert!(scene.set_pose(far, &Pose::from_translation(1e3 * DVec3::ONE)));
    let outcome = scene.run(&Pose::IDENTITY, &settings).unwrap();
    assert!(outcome.invalid == 0 && outcome.queried == 2, "{outcome:?}");
    for (pose, settings) in [
        (Pose::from_translation(DVec3::INFINITY), settings),
        (Pose::new(DVec3::ZERO, DQuat::from_xyzw(1.0, 1.0, 0.0, 0.0)), settings),
        (Pose::IDENTITY, QuerySettings::new(f64::NAN)),
        (Pose::IDENTITY, QuerySettings::new(-1.0)),
        (Pose::IDENTITY, QuerySettings::new(1.001 * shape.max_tolerance())),
        (Pose::IDENTITY, QuerySettings { error: f64::NAN.into(), ..settings }),
    ] {
        let refused = scene.run(&pose, &settings);
        assert!(refused.is_err() && scene.contacts().next().is_none(), "{pose:?}, {settings:?}");
    }
    assert_eq!(scene.run(&Pose::IDENTITY, &settings).unwrap().queried, 2);
    let empty = SceneQuery::new(&shape).run(&Pose::IDENTITY, &settings).unwrap();
    assert!(empty.invalid == 0 && empty.query.contacts == 0, "{empty:?}");
}

/// Thousands of instances, of which few are within reach at once.
#[test]
fn workspaces_go_from_object_to_object() {
    let shape = bumpy();
    let mut scene = SceneQuery::new(&shape);
    for index in 0..3000 {
        scene.add(&shape, &Pose::from_translation(3.0 * f64::from(index) * DVec3::X));
    }
    scene.reserve(&shape, 2);
    let bytes = scene.bytes();
    let settings = QuerySettings::new(TOLERANCE);
    let mut contacts = 0;
    let mut pass = |steps: std::ops::Range<i32>| {
        for step in steps {
            let pose = Pose::from_translation(0.5 * f64::from(step) * DVec3::X + 1.1 * DVec3::Y);
            let outcome = scene.run(&pose, &settings).unwrap();
            assert!(outcome.queried <= 2, "{outcome:?}");
            contacts += outcome.query.contacts;
        }
    };
    pass(0..100);
    assert_eq!(measure(|| pass(100..3000)).count_total, 0);
    assert!(contacts > 10_000 && scene.bytes() == bytes, "{contacts} contacts, {bytes} bytes");
    // The third object has no workspace, and gets one.
    for offset in [-1.0, 0.0, 1.0] {
        scene.add(&shape, &Pose::new(1e4 * DVec3::X + 0.1 * offset * DVec3::Y, DQuat::IDENTITY));
    }
    let pose = Pose::from_translation(1e4 * DVec3::X);
    let outcome = scene.run(&pose, &settings).unwrap();
    assert!(outcome.queried == 3 && outcome.query.reallocated, "{outcome:?}");
}

#[test]
fn a_warm_scene_does_not_allocate() {
    let mut rng = StdRng::seed_from_u64(SEED + 1);
    let (probe, shapes) = (bumpy(), shapes());
    let mut scene = SceneQuery::new(&probe);
    let objects: Vec<(ObjectHandle, Pose)> = (0..40)
        .map(|index| {
            let at = 4.0 * vector(&mut rng);
            let pose = pose(&mut rng, at);
            (scene.add(&shapes[index % shapes.len()], &pose), pose)
        })
        .collect();
    let mut pass = || {
        let mut contacts = 0;
        for step in 0..60 {
            let t = f64::from(step) / 60.0;
            let pose = Pose::new(DVec3::new(4.0 - 8.0 * t, t, 0.0), DQuat::from_rotation_y(t));
            for (object, pose) in &objects[..20] {
                let turned = Pose::new(pose.translation, DQuat::from_rotation_x(t) * pose.rotation);
                scene.set_pose(*object, &turned);
            }
            contacts += scene.run(&pose, &QuerySettings::new(TOLERANCE)).unwrap().query.contacts;
        }
        contacts
    };
    let mut warm = 0;
    assert!(measure(|| warm = pass()).count_total > 0, "the counter counts");
    // Which object gets which workspace changes from pass to pass, until each has seen the most contacts.
    (0..8).for_each(|_| assert_eq!(pass(), warm));
    assert_eq!(measure(|| assert_eq!(pass(), warm)).count_total, 0);
    assert!(warm > 1000, "{warm}");
}

/// Four objects with a common budget take no more than one with the same budget, except for tests that are
/// always made.
#[test]
fn a_budget_is_shared() {
    let mesh = star(4, |v| 1.0 + 0.05 * (7.0 * v.x).sin() * (6.0 * v.y + 1.0).sin());
    let clod = build(&mesh, &BuildOptions::default(), &mut unwatched).expect("a good mesh");
    let shape = Shape::new(clod);
    let mut scene = SceneQuery::new(&shape);
    for at in [DVec3::X, -DVec3::X, DVec3::Y, DVec3::Z] {
        scene.add(&shape, &Pose::from_translation(1.95 * at));
    }
    let fine = QuerySettings { error: 1e-6.into(), ..QuerySettings::new(TOLERANCE) };
    let mut made = |budget| {
        scene.reset();
        let outcome = scene.run(&Pose::IDENTITY, &QuerySettings { budget, ..fine }).unwrap();
        assert_eq!(outcome.queried, 4);
        (outcome.query.convex_queries, outcome.query.out_of_budget)
    };
    let (all, _) = made(None);
    let (least, stopped) = made(Some(Budget::Queries(0)));
    assert!(stopped && 2 * least < all, "{least} of {all}");
    for part in [0.25, 0.5, 0.75] {
        let budget = least + (part * (all - least) as f64) as usize;
        let (queries, stopped) = made(Some(Budget::Queries(budget)));
        assert!(stopped && queries > least, "{queries} of {budget}, from {least} to {all}");
        assert!(queries as f64 <= 1.1 * budget as f64, "{queries} of {budget}, from {least} to {all}");
    }
    let (queries, stopped) = made(Some(Budget::Queries(4 * all)));
    assert!(!stopped && queries == all, "{queries} of {all}");
}

/// However many shapes are added and removed, only those in the scene take memory, and they are found as
/// before.
#[test]
fn shapes_go_with_their_last_object() {
    let (probe, settings) = (bumpy(), QuerySettings::new(TOLERANCE));
    let shapes = shapes();
    let mut scene = SceneQuery::new(&probe);
    let stays = scene.add(&shapes[2], &Pose::IDENTITY);
    let contacts = |scene: &mut SceneQuery| {
        scene.run(&Pose::IDENTITY, &settings).unwrap();
        scene.contacts().map(|with| (with.object, with.contacts.to_vec())).collect::<Vec<_>>()
    };
    let alone = contacts(&mut scene);
    assert!(!alone[0].1.is_empty());
    let mut after = Vec::new();
    for round in 1..=50 {
        let scaled = shapes[1].clod().scaled(1.0 + 0.01 * f64::from(round)).expect("a factor");
        let shape = Shape::new(scaled);
        let [one, other] = [DVec3::X, -DVec3::X].map(|at| scene.add(&shape, &Pose::from_translation(at)));
        let all = contacts(&mut scene);
        assert_eq!(all.len(), 3, "round {round}");
        assert!(scene.remove(one) && scene.shape(other).is_some());
        assert!(scene.remove(other) && scene.shape(other).is_none());
        let again = contacts(&mut scene);
        assert!(again.len() == 1 && again[0].0 == stays && agree(&again[0].1, &alone[0].1));
        after.push(scene.bytes());
    }
    assert_eq!(after[0], after[49], "memory grows");
    assert_eq!(scene.len(), 1);
}
