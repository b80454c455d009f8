//! Scene objects that move, and that contacts push back.

use palpate::device::{DeviceState, Emulation, IntendedPath, Status};
use palpate::dynamics::BodyState;
use palpate::errors::EditError;
use palpate::glam::{DMat3, DVec3};
use palpate::settings::{ContactSettings, Response, SearchSettings, ToolSettings};
use palpate::{
    ContactLoop, DynamicBody, HapticLoop, HapticRenderer, Object, Pose, Reactions, Record, Scene,
    SceneEditor, SceneId, Settings, Twist,
};
use palpate_measure::Deepest;
use palpate_tests::{FreeBody, model, penalties};

const PERIOD: f64 = 1e-3;
/// Haptic steps per contact step.
const STRIDE: u32 = 2;

type Hand = Box<dyn Fn(f64) -> (Pose, Twist)>;

/// Session that a test steps, with its results.
struct Rig {
    haptic: HapticLoop,
    contact: ContactLoop,
    /// Motion of a perfect hand by time (s).
    hand: Hand,
    scene: SceneEditor,
    reactions: Reactions,
    steps: u32,
    /// Haptic steps per contact step.
    stride: u32,
}

impl Rig {
    fn new(
        probe: Object,
        scene: Scene,
        settings: Settings,
        hand: impl Fn(f64) -> (Pose, Twist) + 'static,
    ) -> Self {
        let hand: Hand = Box::new(hand);
        Self::of(renderer(probe, scene, settings, &hand), hand)
    }

    fn of(mut renderer: HapticRenderer, hand: Hand) -> Self {
        let (scene, reactions) = (renderer.scene_editor(), renderer.reactions());
        let (haptic, contact, _) = renderer.into_loops();
        Self { haptic, contact, hand, scene, reactions, steps: 0, stride: STRIDE }
    }

    fn now(&self) -> f64 {
        PERIOD * f64::from(self.steps)
    }

    fn step(&mut self) -> Record {
        let body: BodyState = *self.haptic.body_state();
        let update = (self.steps.is_multiple_of(self.stride)).then(|| self.contact.step(&body, self.now()));
        self.steps += 1;
        let now = self.now();
        let (pose, twist) = (self.hand)(now);
        let device = DeviceState { time: now, pose, twist, buttons: 0, status: Status::OK };
        let record = self.haptic.step(&device, now, PERIOD);
        if let Some(update) = update {
            self.haptic.update_contacts(&update);
        }
        record
    }
}

fn renderer(probe: Object, scene: Scene, settings: Settings, hand: &Hand) -> HapticRenderer {
    let device = Emulation::default().open(IntendedPath::from(hand(0.0).0)).expect("an emulated device");
    HapticRenderer::new(probe, scene, Box::new(device), settings).expect("renderer")
}

fn still(_: f64) -> (Pose, Twist) {
    (Pose::IDENTITY, Twist::ZERO)
}

/// Each case with penalty contacts, and with constraints.
fn both<C: Copy>(cases: &[C]) -> impl Iterator<Item = (C, Settings)> {
    cases.iter().flat_map(|case| [penalties(), Settings::default()].map(|settings| (*case, settings)))
}

fn bottom(object: &Object) -> f64 {
    object.clod.vertices.iter().map(|v| v.z).fold(f64::INFINITY, f64::min)
}

fn top(object: &Object) -> f64 {
    object.clod.vertices.iter().map(|v| v.z).fold(f64::NEG_INFINITY, f64::max)
}

/// Returns a pose of the object below the probe at the origin, with a gap (m).
fn below(probe: &Object, object: &Object, gap: f64) -> Pose {
    Pose::from_translation((bottom(probe) - top(object) - gap) * DVec3::Z)
}

/// Speed of the lift, m/s, and its number of haptic steps.
const LIFT_SPEED: f64 = 0.01;
const LIFT_STEPS: u32 = 600;

/// Lifts the probe out of the hand by a block that rises slowly and is reported at a frame rate, or by a hand
/// that comes down on it; returns the forces and the coupling's stiffness.
fn forces_of_lifting(proxy: bool, block_moves: bool) -> (Vec<f64>, f64) {
    let (probe, plate) = (model("ellipsoid@500"), model("block@300"));
    let start = below(&probe, &plate, 1e-3);
    let (velocity, every) = (DVec3::Z * LIFT_SPEED, 16);
    let down =
        move |time: f64| (Pose::from_translation(-velocity * time), Twist::new(-velocity, DVec3::ZERO));
    let hand: Hand = if block_moves { Box::new(still) } else { Box::new(down) };
    let scene = Scene::new().with(plate, start);
    let mut rig = Rig::new(
        probe,
        scene,
        Settings { search: SearchSettings { proxy, ..SearchSettings::default() }, ..penalties() },
        hand,
    );
    let stiffness = rig.haptic.coupling().linear_stiffness;
    let forces = (0..LIFT_STEPS)
        .map(|_| {
            if block_moves && rig.steps.is_multiple_of(every) {
                let pose = Pose { translation: start.translation + velocity * rig.now(), ..start };
                rig.scene.set_motion(SceneId(0), pose, Twist::new(velocity, DVec3::ZERO)).expect("room");
            }
            rig.step().contact.force.z
        })
        .collect();
    (forces, stiffness)
}

#[test]
fn a_rising_object_feels_like_a_sinking_hand() {
    // A proxy rests on single corners of the probe, and small differences decide which.
    for (proxy, off, rougher) in [(false, 1e-3, 1.01), (true, 0.1, 2.5)] {
        let (lifted, stiffness) = forces_of_lifting(proxy, true);
        let (sinking, _) = forces_of_lifting(proxy, false);
        let most = sinking.iter().copied().fold(0.0, f64::max);
        assert!(most > 0.4 * stiffness * LIFT_SPEED * PERIOD * f64::from(LIFT_STEPS), "{most} N");
        // After the first touch.
        for (step, (one, other)) in lifted.iter().zip(&sinking).enumerate().skip(120) {
            assert!((one - other).abs() < off * most, "step {step}: {one} and {other} N, of {most} N");
        }
        // The force grows as smoothly between frames.
        let steepest = |forces: &[f64]| {
            forces[200..].windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max)
        };
        let (one, other) = (steepest(&lifted), steepest(&sinking));
        assert!(one < rougher * other, "{one} N in a step, and {other} N");
    }
}

/// The force from a moving plate depends by a few hundredths on how often it is reported.
#[test]
fn a_plate_that_slides_below_drags_the_probe_along() {
    let (probe, plate) = (model("ellipsoid@500"), model("block@300"));
    let start = below(&probe, &plate, -1e-3);
    let speed = 0.02;
    let settings =
        Settings { contact: ContactSettings { friction: 0.5, ..penalties().contact }, ..penalties() };
    let dragged = |every: u32, moves: bool| {
        let scene = Scene::new().with(plate.clone(), start);
        let mut rig = Rig::new(probe.clone(), scene, settings, still);
        let mut last = None;
        for _ in 0..600 {
            let velocity = DVec3::X * speed;
            if moves && rig.steps.is_multiple_of(every) {
                let pose = Pose { translation: start.translation + velocity * rig.now(), ..start };
                rig.scene.set_motion(SceneId(0), pose, Twist::new(velocity, DVec3::ZERO)).expect("room");
            }
            last = Some(rig.step());
        }
        last.expect("steps").coupling.force
    };
    let still = dragged(1, false);
    assert!(still.z > 0.1 && still.x.abs() < 0.05 * still.z, "{still}");
    for every in [1, 2, 16] {
        let force = dragged(every, true);
        // It slides by now.
        assert!((force.x / force.z - 0.5).abs() < 0.03, "reported every {every} ms: {force}");
    }
}

/// A free ball is struck: the momentum that it gains comes from the probe and the hand.
#[test]
fn a_free_object_takes_the_momentum_that_it_is_given() {
    let (probe, ball) = (model("ellipsoid@500"), model("golf-ball@5000"));
    let start = below(&probe, &ball, 2e-3);
    let speed = 0.1;
    // The hand comes down, and stays.
    let path = move |time: f64| {
        let fall = (time - 0.3).clamp(0.0, 0.1);
        let moving = (0.3..0.4).contains(&time);
        let velocity = if moving { DVec3::NEG_Z * speed } else { DVec3::ZERO };
        (Pose::from_translation(DVec3::new(2e-4, 0.0, -speed * fall)), Twist::new(velocity, DVec3::ZERO))
    };
    for (mass, settings) in both(&[0.02, 0.1, 2.0]) {
        let scene = Scene::new().with(ball.clone(), start);
        let mut rig = Rig::new(probe.clone(), scene, settings, path);
        let mut body = FreeBody::new(&ball, SceneId(0), mass, start, (PERIOD, DVec3::ZERO), &mut rig.scene);
        let (mut given, mut taken, mut most) = (DVec3::ZERO, DVec3::ZERO, 0.0_f64);
        for _ in 0..800 {
            let record = rig.step();
            given -= record.contact.force * PERIOD;
            let momentum = body.twist.linear * mass;
            body.step(PERIOD, &mut rig.reactions, &mut rig.scene);
            taken += body.twist.linear * mass - momentum;
            most = most.max(body.twist.linear.length());
        }
        assert!(taken.z < -1e-4, "{mass} kg: {taken} N·s");
        assert!((taken - given).length() < 1e-3 * given.length(), "{mass} kg: {taken} of {given} N·s");
        // It flies off at no more than twice the hand's speed.
        assert!(most < 2.2 * speed, "{mass} kg: {most} m/s");
        assert!(body.twist.linear.z < 0.0, "{mass} kg: {:?}", body.twist);
    }
}

/// An object that the hand presses on a soft floor comes to rest, whether light or heavy, and with worlds
/// that step seldom.
#[test]
fn a_pressed_object_comes_to_rest() {
    let (probe, ball) = (model("ellipsoid@500"), model("golf-ball@5000"));
    let start = below(&probe, &ball, 5e-4);
    let path = |time: f64| {
        let down = 2e-3 * ((time - 0.3) / 0.2).clamp(0.0, 1.0);
        (Pose::from_translation(DVec3::NEG_Z * down), Twist::ZERO)
    };
    let cases = [(1e-3, 1), (1e-2, 1), (0.1, 1), (10.0, 1), (1e-2, 4), (0.1, 4), (0.1, 16), (10.0, 16)];
    for ((mass, every), settings) in both(&cases) {
        let dt = PERIOD * f64::from(every);
        let scene = Scene::new().with(ball.clone(), start);
        let mut rig = Rig::new(probe.clone(), scene, settings, path);
        let mut body = FreeBody::new(&ball, SceneId(0), mass, start, (dt, DVec3::ZERO), &mut rig.scene);
        let floor = body.pose;
        // As soft as an explicit step allows, with matching damping.
        let (stiffness, damping) = (mass * (0.2 / dt).powi(2), 0.4 * mass / dt);
        let (mut energy, mut force) = (Vec::new(), DVec3::ZERO);
        for _ in 0..3000 {
            force = rig.step().coupling.force;
            if rig.steps.is_multiple_of(every) {
                let sunk = body.pose.translation - floor.translation;
                body.push((sunk * -stiffness - body.twist.linear * damping) * dt, DVec3::ZERO);
                let turned = floor.rotation_vector_to(&body.pose);
                let held = turned * -(0.2 / dt).powi(2) - body.twist.angular * (0.4 / dt);
                body.push(DVec3::ZERO, body.inertia * held * dt);
                body.step(dt, &mut rig.reactions, &mut rig.scene);
            }
            energy.push(body.energy());
        }
        let most = |energies: &[f64]| energies.iter().copied().fold(0.0, f64::max);
        let (all, end) = (most(&energy), most(&energy[2800..]));
        assert!(force.z > 1e-4, "{mass} kg every {every} ms: {force} N");
        assert!(end < 1e-2 * all.max(1e-9), "{mass} kg every {every} ms: {end} J of {all} J at the end");
    }
}

/// A block lies on the handle of a spoon that is thinner than the block sinks in: the proxy stays below.
#[test]
fn an_object_on_a_thin_tool_stays_there() {
    let (probe, block) = (model("spoon@2000"), model("block@300"));
    let start = Pose::from_translation((top(&probe) - bottom(&block) + 5e-4) * DVec3::Z);
    let gravity = DVec3::NEG_Z * 9.81;
    for (mass, settings) in both(&[0.02, 0.1]) {
        let scene = Scene::new().with(block.clone(), start);
        let mut rig = Rig::new(probe.clone(), scene, settings, still);
        let mut body = FreeBody::new(&block, SceneId(0), mass, start, (PERIOD, gravity), &mut rig.scene);
        let mut force = 0.0;
        for _ in 0..2000 {
            force = -rig.step().contact.force.z;
            body.push(gravity * (mass * PERIOD), DVec3::ZERO);
            body.step(PERIOD, &mut rig.reactions, &mut rig.scene);
            // It can only rise and sink.
            body.twist = Twist::new(DVec3::Z * body.twist.linear.z, DVec3::ZERO);
            body.pose.translation =
                body.pose.translation.with_x(start.translation.x).with_y(start.translation.y);
        }
        assert!((force - 9.81 * mass).abs() < 0.02 * 9.81 * mass, "{mass} kg: {force} N");
        let sunk = start.translation.z - body.mesh_pose().translation.z;
        assert!(sunk < 0.03, "{mass} kg: sunk by {sunk} m");
    }
}

/// How deep the probe comes into a block of 0.2 kg on a rough table, m, and the force at the end (N). The
/// hand starts above the block by a gap (m), presses the probe 4 mm down and then moves it aside; the host
/// steps at 60 Hz.
fn pressed_on_a_table(gap: f64, settings: Settings) -> (f64, DVec3) {
    let (probe, block) = (model("ellipsoid@500"), model("block@300"));
    let (start, every, gravity) = (below(&probe, &block, gap), 17, DVec3::NEG_Z * 9.81);
    let path = move |time: f64| {
        let (down, aside) = (((time - 0.3) / 0.3).clamp(0.0, 1.0), (time - 1.0).clamp(0.0, 1.0));
        (Pose::from_translation(DVec3::new(0.03 * aside, 0.0, -(gap + 4e-3) * down)), Twist::ZERO)
    };
    let (dt, mass, friction) = (PERIOD * f64::from(every), 0.2, 0.3);
    let settings = Settings { contact: ContactSettings { friction: 0.5, ..settings.contact }, ..settings };
    let mut rig = Rig::new(probe.clone(), Scene::new().with(block.clone(), start), settings, path);
    let mut body = FreeBody::new(&block, SceneId(0), mass, start, (dt, gravity), &mut rig.scene);
    let (mut deepest, mut force) = (0.0_f64, DVec3::ZERO);
    for _ in 0..2500 {
        force = rig.step().coupling.force;
        if rig.steps.is_multiple_of(every) {
            body.push(gravity * (mass * dt), DVec3::ZERO);
            body.take(&mut rig.reactions);
            // The table carries all weight, and rubs.
            let load = (-body.twist.linear.z).max(0.0);
            let along = body.twist.linear.with_z(0.0);
            let kept = (1.0 - friction * load / along.length().max(1e-12)).max(0.0);
            body.twist = Twist::new((along * kept).with_z(body.twist.linear.z.max(0.0)), DVec3::ZERO);
            body.step(dt, &mut rig.reactions, &mut rig.scene);
        }
        let lowest = bottom(&probe) + rig.haptic.object_pose().translation.z;
        deepest = deepest.max(top(&block) + body.mesh_pose().translation.z - lowest);
    }
    (deepest, force)
}

#[test]
fn a_block_on_a_table_holds_the_probe() {
    // Twice what was found from 1 mm, 0.093 mm. 4 mm of the coupling's spring push back. From 1.5 mm on, the
    // session first searches the block while the hand moves, and has to know by then that it rests.
    for gap in [5e-4, 1e-3, 1.5e-3, 5e-3] {
        let (deepest, force) = pressed_on_a_table(gap, Settings::default());
        assert!(deepest < 2e-4 && force.z > 1.5, "from {gap} m: {deepest} m, {force} N");
    }
    // A penalty contact with such a host has to be so soft that the probe comes through.
    let (deepest, force) = pressed_on_a_table(1e-3, penalties());
    assert!(deepest > 3.9e-3 && force.z < 0.05, "{deepest} m, {force} N");
}

/// Two hands that move along z, each with an object; the first session finds the contacts.
struct TwoHands {
    upper: Rig,
    lower: Rig,
    objects: [Object; 2],
    /// Poses of the upper object's mesh in the frame of the lower one's.
    poses: Vec<Pose>,
}

/// Heights of the hands above where their objects would touch, by time (s), m.
type Heights = [fn(f64) -> f64; 2];

impl TwoHands {
    fn new(settings: Settings, heights: Heights) -> Self {
        let objects = [model("ellipsoid@500"), model("golf-ball@5000")];
        let apart = top(&objects[1]) - bottom(&objects[0]);
        let hands = [0, 1].map(|which| -> Hand {
            let (middle, height) = ([0.5, -0.5][which] * apart, heights[which]);
            Box::new(move |time| (Pose::from_translation(DVec3::Z * (middle + height(time))), Twist::ZERO))
        });
        // Contact begins at the same distance for both.
        let settings = Settings {
            search: SearchSettings { tolerance: Some(2e-4), ..SearchSettings::default() },
            tool: ToolSettings { grasp: Some(Pose::IDENTITY), ..settings.tool },
            ..settings
        };
        let mut upper = renderer(objects[0].clone(), Scene::new(), settings, &hands[0]);
        let mut lower = renderer(objects[1].clone(), Scene::new(), settings, &hands[1]);
        upper.join(&mut lower).expect("not textured");
        let [above, below] = hands;
        Self { upper: Rig::of(upper, above), lower: Rig::of(lower, below), objects, poses: Vec::new() }
    }

    /// Takes a step of both; returns the forces of the contacts on both objects, N.
    fn step(&mut self) -> [DVec3; 2] {
        let forces = [self.upper.step().contact.force, self.lower.step().contact.force];
        self.poses.push(self.lower.haptic.object_pose().inverse() * self.upper.haptic.object_pose());
        forces
    }

    /// Deepest overlap of all steps, by exact queries, m.
    fn deepest(&self) -> f64 {
        let [one, other] = &self.objects;
        let scene = Scene::new().with(other.clone(), Pose::IDENTITY);
        Deepest::of(&self.poses, one, &scene, 0.01).expect("closed surfaces").depth
    }
}

/// Two hands press their objects together: they feel opposite forces, and both come to rest.
#[test]
fn two_hands_feel_each_other() {
    fn near(time: f64) -> f64 {
        2e-3 * ((time - 0.3) / 0.2).clamp(0.0, 1.0) - 5e-4
    }
    for settings in [penalties(), Settings::default()] {
        let mut hands = TwoHands::new(settings, [|time| -near(time), near]);
        let felt: Vec<_> = (0..3000).map(|_| hands.step()).collect();
        let [above, below] = felt[felt.len() - 1];
        assert!(above.z > 0.05, "{above} N");
        assert!((above + below).length() < 0.02 * above.length(), "{above} and {below} N");
        let restless = felt[2500..].iter().map(|[force, _]| force.distance(above)).fold(0.0, f64::max);
        // Penalty contacts with so light an object are soft. Of constraints the sideways force of single
        // steps changes a little, by 1.1 % when this was written.
        let (most, wanted) = match settings.contact.response {
            Response::Constraints => (0.02, 0.0..5e-6),
            Response::Penalty => (1e-3, 5e-4..2e-3),
        };
        assert!(restless < most * above.length(), "{restless} N of {above} N");
        let deepest = hands.deepest();
        assert!(wanted.contains(&deepest), "{deepest} m");
    }
}

/// The hands meet at 1 m/s, and one of them goes on: its object pushes the other one.
#[test]
fn the_objects_of_two_hands_do_not_pass() {
    let heights: Heights = [
        |time| 0.02 - 0.5 * (time - 0.2).clamp(0.0, 0.08),
        |time| -0.02 + 0.5 * (time - 0.2).clamp(0.0, 0.04),
    ];
    // Limits are twice what was found, with contacts at 500 and 50 Hz; penalty contacts are passed.
    let cases = [
        (Settings::default(), 2, 0.0..3.2e-4),
        (Settings::default(), 20, 0.0..1.1e-3),
        (penalties(), 2, 5e-3..0.1),
        (penalties(), 20, 5e-3..0.1),
    ];
    for (settings, stride, wanted) in cases {
        let mut hands = TwoHands::new(settings, heights);
        (hands.upper.stride, hands.lower.stride) = (stride, stride);
        let felt: Vec<_> = (0..2000).map(|_| hands.step()).collect();
        let case = format!("{:?}, {stride} steps", settings.contact.response);
        let deepest = hands.deepest();
        assert!(wanted.contains(&deepest), "{case}: {deepest} m");
        for [above, below] in felt {
            assert!(above.dot(below) <= 0.0, "{case}: {above} and {below} N");
        }
    }
}

/// Invalid motions and bodies are refused where they are given.
#[test]
fn motions_and_bodies_are_checked() {
    let (probe, ball) = (model("ellipsoid@500"), model("golf-ball@2000"));
    let scene = Scene::new().with(ball, Pose::IDENTITY);
    let mut rig = Rig::new(probe, scene, penalties(), still);
    let id = SceneId(0);
    let good = DynamicBody {
        mass: 0.1,
        inertia: DMat3::IDENTITY * 1e-4,
        center_of_mass: DVec3::ZERO,
        gravity: DVec3::ZERO,
        period: 1e-3,
    };
    let bad = [
        DynamicBody { mass: 0.0, ..good },
        DynamicBody { mass: f64::NAN, ..good },
        DynamicBody { inertia: DMat3::ZERO, ..good },
        DynamicBody { inertia: DMat3::IDENTITY * -1.0, ..good },
        DynamicBody { center_of_mass: DVec3::NAN, ..good },
        DynamicBody { gravity: DVec3::INFINITY, ..good },
        DynamicBody { period: 0.0, ..good },
        DynamicBody { period: f64::INFINITY, ..good },
    ];
    for mobility in bad {
        assert!(rig.scene.set_dynamics(id, Some(mobility)).is_err(), "{mobility:?}");
    }
    let nan = Twist::new(DVec3::NAN, DVec3::ZERO);
    assert!(rig.scene.set_motion(id, Pose::IDENTITY, nan).is_err());
    assert!(rig.scene.set_motion(id, Pose::from_translation(DVec3::NAN), Twist::ZERO).is_err());
    rig.scene.set_dynamics(id, Some(good)).expect("a mobility");
    rig.scene.set_dynamics(id, None).expect("none");
    let unknown = EditError::Unknown(SceneId(7));
    assert_eq!(rig.scene.set_dynamics(SceneId(7), Some(good)), Err(unknown));
    rig.step();
    assert_eq!(rig.contact.telemetry().events.edit_refused, 0);
    // As fast as floating-point numbers allow.
    rig.scene.set_motion(id, Pose::IDENTITY, Twist::new(DVec3::X * 1e300, DVec3::ONE * 1e300)).expect("room");
    for _ in 0..100 {
        let record = rig.step();
        assert!(record.coupling.is_finite() && record.object.is_valid());
    }
}
