//! Sessions of hosts whose steps vary in length: what the body really moved counts, not what a step of this
//! length would have moved it.
#![expect(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]

use std::collections::VecDeque;
use std::f64::consts::TAU;

use palpate::collide::{ContactQuery, ContactSet, ContactSetSettings, QuerySettings};
use palpate::device::{DeviceState, Emulation, GripperEmulation, GripperPath, IntendedPath, Status};
use palpate::glam::{DQuat, DVec3};

use palpate::settings::{
    ContactSearch, ContactSettings, CouplingSettings, GripperSettings, Response, SearchSettings, ToolSettings,
};
use palpate::tool::{HingedTool, ToolBody};
use palpate::{
    ContactLoop, ContactUpdate, HapticLoop, HapticRenderer, HostedSession, Object, Pose, Record, Scene,
    SceneEditor, SceneId, Settings, Twist,
};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

use super::bodies::{ball, block};

/// Largest overlap that constraints leave, m.
const OVERLAP: f64 = 2e-5;

/// Lengths of a host's steps, s.
type Steps = Box<dyn FnMut() -> f64>;

fn even(dt: f64) -> Steps {
    Box::new(move || dt)
}

/// From 0.2 to 20 ms, each octave as often.
fn random(seed: u64) -> Steps {
    random_up_to(20e-3, seed)
}

/// The same up to another length, s.
fn random_up_to(longest: f64, seed: u64) -> Steps {
    let mut rng = StdRng::seed_from_u64(seed);
    Box::new(move || 2e-4 * (longest / 2e-4).powf(rng.random_range(0.0..1.0)))
}

/// Short ones, and a long one in so many.
fn in_bursts(short: f64, long: f64, every: u32) -> Steps {
    let mut count = 0;
    Box::new(move || {
        count += 1;
        if count % every == 0 { long } else { short }
    })
}

/// Pose of a hand at a time (s).
type Hand = Box<dyn Fn(f64) -> (DVec3, DQuat)>;

/// Depths of a probe in an object, by exact queries at full resolution.
struct Exact(ContactQuery, ContactSet);

impl Exact {
    fn new(probe: &Object, other: &Object) -> Self {
        Self(ContactQuery::new(probe.shape(), other.shape()), ContactSet::new(probe.shape(), other.shape()))
    }

    /// The depth, m; negative if the surfaces are apart, and at least -0.1 mm.
    fn depth(&mut self, probe: &Pose, other: &Pose) -> f64 {
        let Self(query, set) = self;
        query.run(probe, other, &QuerySettings::new(1e-4)).expect("finite");
        let merged = ContactSetSettings::new(1e-6);
        let found = set.run(query.contacts(), probe, other, &merged).expect("finite");
        found.iter().map(|found| found.contact.depth).fold(-1e-4, f64::max)
    }
}

/// Queries at a rate, each of which takes as long as the time to the next.
struct Queries {
    period: f64,
    begun: u64,
    pending: VecDeque<(f64, Vec<ContactUpdate>)>,
}

impl Queries {
    fn new(rate: f64) -> Self {
        Self { period: 1.0 / rate, begun: 0, pending: VecDeque::new() }
    }

    /// Makes the query that is due after a step up to a time (s), if one is: never two of the same state.
    fn begin(&mut self, seen: f64, find: impl FnOnce() -> Vec<ContactUpdate>) {
        if self.begun as f64 * self.period <= seen {
            self.begun = (seen / self.period) as u64 + 1;
            self.pending.push_back((seen + self.period, find()));
        }
    }

    /// The results that have arrived by a time, s.
    fn arrived(&mut self, now: f64) -> Option<Vec<ContactUpdate>> {
        self.pending.pop_front_if(|(arrival, _)| *arrival <= now).map(|(_, updates)| updates)
    }
}

/// State of a device at a time (s), in a hand.
fn held(hand: &Hand, now: f64) -> DeviceState {
    let at = |time: f64| {
        let (translation, rotation) = hand(time);
        Pose::new(translation, rotation)
    };
    let (before, pose, after) = (at(now - 5e-5), at(now), at(now + 5e-5));
    let linear = (after.translation - before.translation) / 1e-4;
    let twist = Twist::new(linear, before.rotation_vector_to(&after) / 1e-4);
    DeviceState { time: now, pose, twist, buttons: 0, status: Status::OK }
}

/// A session that a host steps, with contacts found at a rate.
struct Rig {
    haptic: HapticLoop,
    contact: ContactLoop,
    hand: Hand,
    steps: Steps,
    queries: Queries,
    now: f64,
}

impl Rig {
    fn of(renderer: HapticRenderer, hand: Hand, steps: Steps, rate: f64) -> Self {
        let (haptic, contact, _) = renderer.into_loops();
        Self { haptic, contact, hand, steps, queries: Queries::new(rate), now: 0.0 }
    }

    /// Takes a step; returns its record, and its length, s.
    fn step(&mut self) -> (Record, f64) {
        let Self { haptic, contact, queries, .. } = self;
        let (seen, dt) = (self.now, (self.steps)());
        self.now += dt;
        queries.begin(seen, || vec![contact.step(haptic.body_state(), seen)]);
        while let Some(updates) = queries.arrived(self.now) {
            haptic.update_contacts(&updates[0]);
        }
        (haptic.step(&held(&self.hand, self.now), self.now, dt), dt)
    }
}

fn renderer(probe: &Object, scene: Scene, hand: &Hand, settings: Settings) -> HapticRenderer {
    let start = IntendedPath::Still(held(hand, 0.0).pose);
    let device = Emulation::default().open(start).expect("an emulation");
    HapticRenderer::new(probe.clone(), scene, Box::new(device), settings).expect("a session")
}

fn settings(method: ContactSearch, response: Response) -> Settings {
    Settings {
        search: SearchSettings { tolerance: Some(5e-4), method, ..SearchSettings::default() },
        tool: ToolSettings { mass: 0.05, ..ToolSettings::default() },
        coupling: CouplingSettings { stiffness: Some(500.0), ..CouplingSettings::default() },
        contact: ContactSettings { friction: 0.3, response, ..ContactSettings::default() },
        ..Settings::default()
    }
}

/// A hand that strikes a plate with a ball of 1 cm at 0.3 m/s, from a height (m) of its lowest point.
fn striking(height: f64) -> Hand {
    Box::new(move |time| {
        let down = 0.3 * (time - 0.3).max(0.0);
        (DVec3::new(0.002, 0.003, 0.01 + (height - down).max(-0.004)), DQuat::IDENTITY)
    })
}

/// A hand that presses a box on a plate, and slides, turns and tilts it.
fn rubbing() -> Hand {
    Box::new(move |time| {
        let pressed = (time / 0.3).min(1.0);
        let angle = 4.0 * (time - 0.3).max(0.0);
        let circle = 0.01 * DVec3::new(angle.cos() - 1.0, angle.sin(), 0.0);
        let tilt = DQuat::from_rotation_x(0.2 * (2.3 * angle).sin());
        let turn = DQuat::from_rotation_z(0.3 * angle.sin()) * tilt;
        (circle + DVec3::Z * (0.018 - 0.006 * pressed), turn)
    })
}

fn plate() -> Object {
    block(DVec3::new(0.1, 0.1, 0.005))
}

/// Pose of the plate with its top at a height, m.
fn top_at(height: f64) -> Pose {
    Pose::from_translation(DVec3::Z * (height - 0.0025))
}

/// Steps over a plate for a time (s). Returns the largest depth, m, and the mean force on the hand along z
/// over time, N.
fn over_plate(
    (probe, hand): (&Object, Hand),
    settings: Settings,
    (steps, rate): (Steps, f64),
    seconds: f64,
) -> (f64, f64) {
    let plate = plate();
    let made = renderer(probe, Scene::new().with(plate.clone(), top_at(0.0)), &hand, settings);
    let mut rig = Rig::of(made, hand, steps, rate);
    let mut exact = Exact::new(probe, &plate);
    let (mut deepest, mut impulse) = (f64::NEG_INFINITY, 0.0);
    while rig.now < seconds {
        let (record, dt) = rig.step();
        deepest = deepest.max(exact.depth(&record.object, &top_at(0.0)));
        impulse += record.coupling.force.z * dt;
    }
    (deepest, impulse / rig.now)
}

/// Largest depth (m) and mean force (N) of a ball that strikes a plate, from several heights.
fn struck(steps: fn(u64) -> Steps, settings: Settings, rate: f64, times: u64) -> (f64, f64) {
    let probe = ball(0.01, (12, 24));
    let (mut deepest, mut force) = (f64::NEG_INFINITY, 0.0);
    for seed in 0..times {
        let hand = striking(0.01 + 1e-4 * seed as f64);
        let (depth, felt) = over_plate((&probe, hand), settings, (steps(seed), rate), 0.6);
        deepest = deepest.max(depth);
        force += felt / times as f64;
    }
    (deepest, force)
}

/// The same of a box that is rubbed on it.
fn rubbed(steps: fn(u64) -> Steps, settings: Settings, rate: f64) -> (f64, f64) {
    over_plate((&block(DVec3::splat(0.03)), rubbing()), settings, (steps(7), rate), 1.5)
}

const SECOND: fn(u64) -> Steps = |_| even(1e-3);
const BURSTS: fn(u64) -> Steps = |_| in_bursts(1e-3, 11e-3, 10);

/// The cause was that slack lost the length of the step that begins, in place of what the body had moved: a
/// short step after a long one let points through. Struck at 0.3 m/s it was up to 2.2 mm deep, rubbed 0.075.
#[test]
fn steps_of_varying_length_do_not_enter_surfaces() {
    for (search, rates) in [
        (ContactSearch::Levels, [500.0, 200.0, 100.0, 50.0].as_slice()),
        (ContactSearch::Representatives, &[500.0, 50.0]),
    ] {
        for &rate in rates {
            let settings = settings(search, Response::Constraints);
            let ((_, struck_evenly), (_, rubbed_evenly)) =
                (struck(SECOND, settings, rate, 2), rubbed(SECOND, settings, rate));
            for (name, steps) in [("random steps", random as fn(u64) -> Steps), ("bursts", BURSTS)] {
                let (depth, force) = struck(steps, settings, rate, 4);
                let case = format!("{search:?}, {rate} Hz, {name}");
                println!("{case}: struck {depth:.1e} m, {force:.2} N of {struck_evenly:.2} N");
                assert!(depth < OVERLAP, "{case}: struck, {depth} m");
                assert!((force / struck_evenly - 1.0).abs() < 0.25, "{case}: struck, {force} N");
                let (depth, force) = rubbed(steps, settings, rate);
                println!("{case}: rubbed {depth:.1e} m, {force:.2} N of {rubbed_evenly:.2} N");
                assert!(depth < OVERLAP, "{case}: rubbed, {depth} m");
                assert!((force / rubbed_evenly - 1.0).abs() < 0.1, "{case}: rubbed, {force} N");
            }
        }
    }
    let (depth, _) = struck(random, settings(ContactSearch::Levels, Response::Penalty), 100.0, 1);
    assert!(depth > 10.0 * OVERLAP, "with penalties {depth} m, and nothing is shown");
}

/// The same in threads, on a host's own clock.
#[test]
fn a_hosted_session_with_steps_of_varying_length_does_not_enter_surfaces() {
    let (probe, plate, hand) = (ball(0.01, (12, 24)), plate(), striking(0.01));
    let specification = Emulation::default().specification;
    let scene = Scene::new().with(plate.clone(), top_at(0.0));
    let made = settings(ContactSearch::Levels, Response::Constraints);
    let session = HostedSession::new(probe.clone(), scene, specification, held(&hand, 0.0), made);
    let mut session = session.expect("a session");
    let (mut steps, mut exact) = (random(3), Exact::new(&probe, &plate));
    let (mut now, mut deepest, mut most) = (0.0, f64::NEG_INFINITY, 0.0_f64);
    while now < 1.0 {
        let dt = steps();
        std::thread::sleep(std::time::Duration::from_secs_f64(dt));
        now += dt;
        most = most.max(session.step(dt, &held(&hand, now)).force.z);
        deepest = deepest.max(exact.depth(&session.object_pose(), &top_at(0.0)));
    }
    println!("{deepest:.1e} m, {most:.2} N");
    assert!(deepest < OVERLAP, "{deepest} m");
    assert!(most > 1.0, "pressed with {most} N");
}

/// A plate that a host moves up and down under a ball that is held: how deep, m, and the mean force on the
/// hand, N.
fn moved_plate(steps: Steps, rate: f64) -> (f64, f64) {
    let (probe, plate) = (ball(0.01, (12, 24)), plate());
    let hand: Hand = Box::new(|_| (DVec3::new(0.002, 0.003, 0.0105), DQuat::IDENTITY));
    let height = |time: f64| 1e-3 * (TAU * (time - 0.3).max(0.0) / 0.4).sin();
    let speed = |time: f64| (height(time + 1e-5) - height(time - 1e-5)) / 2e-5;
    let scene = Scene::new().with(plate.clone(), top_at(0.0));
    let mut made = renderer(&probe, scene, &hand, settings(ContactSearch::Levels, Response::Constraints));
    let mut editor: SceneEditor = made.scene_editor();
    let mut rig = Rig::of(made, hand, steps, rate);
    let mut exact = Exact::new(&probe, &plate);
    let (mut deepest, mut impulse) = (f64::NEG_INFINITY, 0.0);
    while rig.now < 1.5 {
        let twist = Twist::new(DVec3::Z * speed(rig.now), DVec3::ZERO);
        editor.set_motion(SceneId(0), top_at(height(rig.now)), twist).expect("room");
        let (record, dt) = rig.step();
        deepest = deepest.max(exact.depth(&record.object, &top_at(height(rig.now))));
        impulse += record.coupling.force.z * dt;
    }
    (deepest, impulse / rig.now)
}

#[test]
fn a_plate_that_a_host_moves_in_steps_of_varying_length_holds_the_body() {
    for rate in [500.0, 100.0] {
        for (name, steps) in [("1 ms", SECOND), ("random", random), ("bursts", BURSTS)] {
            let (depth, force) = moved_plate(steps(1), rate);
            println!("{rate} Hz, {name}: {depth:.1e} m, {force:.2} N");
            assert!(depth < OVERLAP && force > 0.03, "{rate} Hz, {name}: {depth} m, {force} N");
        }
    }
}

/// A tool of two bars, which closes on a block: how deep, m.
fn gripped(steps: Steps, rate: f64) -> f64 {
    let bar = block(DVec3::new(0.08, 0.006, 0.01));
    let tool = HingedTool {
        first: bar.clone(),
        second: bar.clone(),
        hinge: [0.006, -0.006].map(|y| Pose::from_translation(DVec3::new(-0.04, y, 0.0))),
        limits: [0.0, 0.8],
        masses: [0.05; 2],
        stop_stiffness: 100.0,
    };
    let asked = |time: f64| 0.5 - 0.45 * ((time - 0.3) / 0.2).clamp(0.0, 1.0);
    let hand: Hand = Box::new(|_| (DVec3::ZERO, DQuat::IDENTITY));
    let (jam, at) = (block(DVec3::splat(0.02)), Pose::from_translation(DVec3::new(0.02, 0.0136, 0.0)));
    let device = Emulation::default().open(held(&hand, 0.0).pose).expect("a device");
    let fingers = GripperPath::function(move |time| (asked(time), 0.0));
    let device = device.with_gripper(GripperEmulation::default(), fingers).expect("a gripper");
    let made = settings(ContactSearch::Levels, Response::Constraints);
    let scene = Scene::new().with(jam.clone(), at);
    let made = HapticRenderer::hinged(&tool, scene, Box::new(device), made, &GripperSettings::default());
    let (mut haptic, mut contacts, _) = made.expect("a session").into_loops();
    let (mut queries, mut steps, mut now) = (Queries::new(rate), steps, 0.0);
    let mut exact = Exact::new(&bar, &jam);
    let mut deepest = f64::NEG_INFINITY;
    while now < 1.0 {
        let (seen, dt) = (now, steps());
        now += dt;
        let bodies = [ToolBody::First, ToolBody::Second];
        queries.begin(seen, || {
            let both = contacts.iter_mut().zip(bodies);
            both.map(|(contact, body)| contact.step(&haptic.body_state(body), seen)).collect()
        });
        while let Some(updates) = queries.arrived(now) {
            updates.iter().zip(bodies).for_each(|(update, body)| haptic.update_contacts(body, update));
        }
        haptic.step(&held(&hand, now), asked(now), now, dt);
        for pose in haptic.object_poses() {
            deepest = deepest.max(exact.depth(&pose, &at));
        }
    }
    deepest
}

#[test]
fn a_hinged_tool_closes_in_steps_of_varying_length() {
    for rate in [500.0, 50.0] {
        for (name, steps) in [("1 ms", SECOND), ("random", random), ("bursts", BURSTS)] {
            let depth = gripped(steps(2), rate);
            println!("{rate} Hz, {name}: {depth:.1e} m");
            assert!(depth < OVERLAP && depth > -OVERLAP, "{rate} Hz, {name}: {depth} m, and they touch");
        }
    }
}

/// Joins the session of an upper and of a lower hand.
type Join = fn(&mut HapticRenderer, &mut HapticRenderer) -> Option<(SceneId, SceneId)>;

/// Each of the two finds the contacts between their objects.
const JOINS: [Join; 2] = [|above, below| above.join(below), |above, below| below.join(above)];

/// Two hands strike their objects together, each host with its own steps. Returns how deep, m, and the mean
/// force on the upper hand, N.
fn hands_meet(steps: impl Fn(u64) -> Steps, seed: u64, rate: f64, join: Join) -> (f64, f64) {
    let objects = [ball(0.01, (12, 24)), plate()];
    let upper: Hand = striking(0.01);
    let lower: Hand =
        Box::new(|time| (DVec3::Z * (-0.0025 + 0.3 * (time - 0.31).clamp(0.0, 0.01)), DQuat::IDENTITY));
    let made = |object: &Object, hand: &Hand| {
        renderer(object, Scene::new(), hand, settings(ContactSearch::Levels, Response::Constraints))
    };
    let (mut above, mut below) = (made(&objects[0], &upper), made(&objects[1], &lower));
    let _ = join(&mut above, &mut below);
    let mut rigs = [Rig::of(above, upper, steps(seed), rate), Rig::of(below, lower, steps(seed + 1), rate)];
    let mut exact = Exact::new(&objects[0], &objects[1]);
    let (mut deepest, mut impulse) = (f64::NEG_INFINITY, 0.0);
    while rigs[0].now < 0.8 {
        let next = usize::from(rigs[1].now < rigs[0].now);
        let (record, dt) = rigs[next].step();
        if next == 0 {
            impulse += record.coupling.force.z * dt;
        }
        let [above, below] = rigs.each_ref().map(|rig| rig.haptic.object_pose());
        deepest = deepest.max(exact.depth(&above, &below));
    }
    (deepest, impulse / rigs[0].now)
}

/// Thickness of the plate, m.
const THICKNESS: f64 = 5e-3;

/// Speed at which the hands meet, m/s.
const CLOSING: f64 = 0.6;

/// Each session knows how the other hand moves when that takes a step: they may overlap by how far both move
/// in the longest step, but the slack of points adds nothing to that. For longer steps see below.
#[test]
fn two_hands_meet_in_steps_of_varying_length() {
    for rate in [500.0, 50.0] {
        for (name, steps, longest) in [("1 ms", SECOND, 1e-3), ("bursts", BURSTS, 11e-3)] {
            for (order, join) in JOINS.into_iter().enumerate() {
                let (depth, force) = hands_meet(steps, 4, rate, join);
                let case = format!("{rate} Hz, {name}, order {order}");
                println!("{case}: {depth:.1e} m, {force:.2} N");
                assert!(
                    depth < (CLOSING * longest).min(THICKNESS) && force > 0.5,
                    "{case}: {depth} m, {force} N"
                );
            }
        }
    }
}

/// With random steps up to 20 ms, in which the hands come nearer by more than the plate is thick, the ball
/// mostly stays on its side. One seed tells nothing: of 100, 24 pass. The limits were set after what was
/// found: up to a third pass.
#[test]
fn two_hands_meet_in_long_steps_of_varying_length() {
    for rate in [500.0, 50.0] {
        for (order, join) in JOINS.into_iter().enumerate() {
            let mut depths = [0.0; 30];
            for (seed, depth) in (0..).zip(&mut depths) {
                let (deepest, force) = hands_meet(random, 2 * seed, rate, join);
                assert!(
                    force > 0.5 || deepest > THICKNESS,
                    "{rate} Hz, order {order}, seed {seed}: {force} N"
                );
                *depth = deepest;
            }
            depths.sort_by(f64::total_cmp);
            let (median, passed) = (depths[15], depths.iter().filter(|depth| **depth > THICKNESS).count());
            println!("{rate} Hz, order {order}: {median:.1e} m, {passed} of 30 pass the plate");
            assert!(median < 0.5 * CLOSING * 20e-3 && passed <= 12, "{rate} Hz, order {order}");
        }
    }
}

/// With steps up to 10 ms the objects do not come through each other, whichever session finds their contacts.
/// The limit was set after what was found: up to 0.35 of how far both move in the longest step.
#[test]
fn objects_of_two_hands_do_not_pass_in_steps_of_varying_length() {
    for longest in [2e-3, 5e-3, 10e-3] {
        for (order, join) in JOINS.into_iter().enumerate() {
            let (depth, force) = hands_meet(|seed| random_up_to(longest, seed), 20, 500.0, join);
            let case = format!("up to {longest} s, order {order}");
            println!("{case}: {depth:.1e} m, {force:.2} N");
            assert!(depth < 0.6 * CLOSING * longest && force > 0.5, "{case}: {depth} m, {force} N");
        }
    }
    // Negative control: hands that do not know of each other pass.
    let (depth, force) = hands_meet(|_| even(1e-3), 20, 500.0, |_, _| None);
    assert!(depth > 0.005 && force < 0.1, "{depth} m, {force} N, and nothing is shown");
}

/// A hand lets a ball fall on half of a plate and lifts it again, time after time. Another hand strikes it
/// from below with a plate of its own beside that, which lifts the ball or is held by it. Returns how deep
/// the ball is in the first plate, m, and the heights of what is in both hands, m.
fn struck_at_a_plate(steps: fn(u64) -> Steps, rate: f64, response: Response, join: Join) -> (f64, Vec<f64>) {
    let (probe, half) = (ball(0.01, (12, 24)), block(DVec3::new(0.1, 0.05, 0.005)));
    let own = Pose::from_translation(DVec3::new(0.0, 0.026, -0.0025));
    let falling: Hand =
        Box::new(|time| (DVec3::Z * (0.012 + 0.006 * (TAU * time / 0.2).cos()), DQuat::IDENTITY));
    let beside = |time: f64| DVec3::new(0.0, -0.026, -0.004 + 0.004 * (TAU * time / 0.13).sin());
    let striking: Hand = Box::new(move |time| (beside(time), DQuat::IDENTITY));
    let made = settings(ContactSearch::Levels, response);
    let mut above = renderer(&probe, Scene::new().with(half.clone(), own), &falling, made);
    let mut below = renderer(&half, Scene::new(), &striking, made);
    let _ = join(&mut above, &mut below);
    let mut rigs = [Rig::of(above, falling, steps(0), rate), Rig::of(below, striking, steps(1), rate)];
    let mut exact = Exact::new(&probe, &half);
    let (mut deepest, mut heights) = (f64::NEG_INFINITY, Vec::new());
    while rigs[0].now < 0.8 {
        let next = usize::from(rigs[1].now < rigs[0].now);
        let (record, _) = rigs[next].step();
        if next == 0 {
            deepest = deepest.max(exact.depth(&record.object, &own));
        }
        heights.push(record.object.translation.z);
    }
    (deepest, heights)
}

/// The blows of another hand change the speed of a body before its own contacts are found. What it has moved
/// is known all the same.
#[test]
fn a_body_that_another_hand_strikes_does_not_enter_surfaces() {
    let [_, below_finds] = JOINS;
    for rate in [500.0, 50.0] {
        for (name, steps) in [("random", random as fn(u64) -> Steps), ("bursts", BURSTS)] {
            let [(depth, heights), (_, alone)] = [below_finds, |_: &mut _, _: &mut _| None]
                .map(|join| struck_at_a_plate(steps, rate, Response::Constraints, join));
            let struck = heights.iter().zip(&alone).map(|(z, alone)| (z - alone).abs()).fold(0.0, f64::max);
            println!("{rate} Hz, {name}: {depth:.1e} m, struck by {struck:.1e} m");
            assert!(depth.abs() < OVERLAP, "{rate} Hz, {name}: {depth} m");
            assert!(struck > 5e-4, "{rate} Hz, {name}: nothing strikes it, {struck} m");
        }
    }
    let (depth, _) = struck_at_a_plate(random, 500.0, Response::Penalty, below_finds);
    assert!(depth > 10.0 * OVERLAP, "with penalties {depth} m, and nothing is shown");
}
