//! Time of one haptic step (§5.2) by the number of pushing contacts: 0, 1, 5 (the K of §5.5.1) and 16 (the
//! most in a model), without friction and with it, and with 5 while one model blends into the next. Also of a
//! step of a tool of two bodies with a hinge (`articulated`), with as many contacts in all; and of a whole
//! step of a session's haptic loop (`loop`), from a device's reading to the written wrench, with all checks;
//! and of such a step with contacts as constraints and friction (`constraints`), with contact geometry that
//! is found at 500 Hz: a prism that slides on 16 corners, a peg held aslant in its hole, and a free one. For
//! these, percentiles of single steps are printed as well: of all, and of the shortest time that each step
//! took in many replays, which other programs did not interrupt. `contact loop` is a step of the contact loop
//! in these sessions.
//!
//! `cargo bench -p palpate-benches --bench haptic_step`. A line before each measurement prints how many
//! contacts push and how many 6×6 systems a step solves. With the arguments `histogram STEPS`, as in `cargo
//! bench -p palpate-benches --bench haptic_step -- histogram 10000000`, it prints percentiles of single steps
//! with 5 contacts and friction, of a body that is dragged to and fro. `valgrind --tool=callgrind` on the
//! same program with the arguments `count CONTACTS STEPS` (or `count-loop CONTACTS STEPS`, or
//! `count-constraints TASK STEPS`) counts instructions, which are more meaningful than times on a shared
//! machine.

#![allow(missing_docs, clippy::print_stdout, reason = "a program that reports to the console")]

mod constrained;

use std::hint::black_box;
use std::time::{Duration, Instant};

use criterion::{BenchmarkId, Criterion};
use palpate::device::{DeviceState, Emulation, Status};
use palpate::dynamics::{
    ArticulatedBody, ArticulatedFrame, ArticulatedState, ArticulatedStep, Body, BodyState, ContactBlend,
    ContactParameters, DeviceMotion, Friction, GripperCoupling, GripperMotion, Joint, JointLimits,
    LinearContactModel, Step, VirtualCoupling, articulated_step, semi_implicit_step,
};
use palpate::glam::{DMat3, DQuat, DVec3};
use palpate::settings::ToolSettings;
use palpate::telemetry::Times;
use palpate::{Contact, ContactUpdate, HapticLoop, HapticRenderer, Pose, Record, Settings, Twist};
use palpate_tests::model;

use self::constrained::{Replay, Task};

const STEP: f64 = 1e-3;

/// Number of single steps with constraints whose percentiles are printed.
const SINGLE_STEPS: u64 = 200_000;

struct Scene {
    body: Body,
    coupling: VirtualCoupling,
    device: DeviceMotion,
    model: LinearContactModel,
    contacts: ContactBlend,
    state: BodyState,
}

impl Scene {
    /// Returns a 50 g body pressed on a floor at `contacts` points by a device 2 cm lower. After 100 steps,
    /// which bring it into steady pressing, it is given a small velocity, so that no term vanishes.
    fn pressed(contacts: usize, friction: Friction) -> Self {
        let body = Body::new(0.05, DMat3::from_diagonal(DVec3::new(2e-5, 3e-5, 4e-5))).expect("a body");
        let grasp = Pose::new(DVec3::new(0.002, -0.003, 0.004), DQuat::from_rotation_x(0.3));
        let coupling = VirtualCoupling::critically_damped(&body, grasp, 400.0, 0.6);
        let pose = Pose::new(DVec3::new(0.1, 0.0, 0.2), DQuat::from_scaled_axis(DVec3::new(0.3, -0.5, 0.8)));
        let found = (0..contacts).map(|i| {
            let angle = i as f64 * 2.399_963;
            let arm = DVec3::new(0.03 * angle.cos(), 0.03 * angle.sin(), -0.02);
            Contact {
                point: pose.translation + arm,
                scene_point: pose.translation + arm,
                normal: DVec3::NEG_Z,
                depth: 0.0,
            }
        });
        let parameters = ContactParameters { stiffness: 1000.0, damping: 1.0, tolerance: 0.0005, friction };
        let model = LinearContactModel::from_contacts(found, &pose, &parameters, 0.0);
        let held = pose * grasp;
        let turn = DQuat::from_scaled_axis(DVec3::new(0.0, 0.0, 0.005));
        let device = DeviceMotion {
            pose: Pose::new(held.translation + DVec3::new(0.0002, 0.0, -0.02), turn * held.rotation),
            twist: Twist::new(DVec3::X * 0.001, DVec3::Z * 0.01),
        };
        let state = BodyState::at_rest(pose);
        let mut scene = Self { body, coupling, device, model, contacts: ContactBlend::new(), state };
        scene.contacts.arrive(&model, &state, 0.0, 0.0);
        for _ in 0..100 {
            scene.state = scene.step().state;
        }
        scene.state.twist = Twist::new(DVec3::new(0.01, 0.02, -0.01), DVec3::new(0.01, 0.02, 0.5));
        scene
    }

    /// Adds a model that is blended in but never completely.
    fn blending(mut self) -> Self {
        self.contacts.arrive(&self.model, &self.state, 0.0, 1e9);
        self.step();
        self
    }

    #[inline(never)]
    fn step(&mut self) -> Step {
        self.contacts.advance(&self.state, STEP);
        let gravity = DVec3::NEG_Z * 9.81;
        semi_implicit_step(
            &self.body,
            &self.state,
            &self.device,
            &self.coupling,
            self.contacts.model(),
            gravity,
            STEP,
        )
    }
}

/// Two bodies of 25 g, 6 cm long along x, hinged at their ends and closed on an object, at half of the
/// contacts each.
struct Tool {
    tool: ArticulatedBody,
    coupling: VirtualCoupling,
    grip: GripperCoupling,
    models: [LinearContactModel; 2],
    state: ArticulatedState,
}

impl Tool {
    /// Returns the tool after 100 steps, with a small velocity.
    fn closed(contacts: usize, friction: Friction) -> Self {
        let body = Body::new(0.025, DMat3::from_diagonal(DVec3::new(1e-6, 8e-6, 8e-6))).expect("a body");
        let hinge = Pose::from_translation(DVec3::X * -0.03);
        let limits = JointLimits { low: 0.0, high: 1.0, stiffness: 100.0 };
        let tool = ArticulatedBody::new(body, body, Joint { in_first: hinge, in_second: hinge, limits })
            .expect("a tool");
        let state = ArticulatedState::at_rest(Pose::IDENTITY, 0.3);
        let (whole, _) = tool.composite(0.3);
        let coupling = VirtualCoupling::critically_damped(&whole, hinge, 400.0, 0.6);
        let parameters = ContactParameters { stiffness: 1000.0, damping: 1.0, tolerance: 0.0005, friction };
        let bodies = [state.first.pose, tool.second(&state).pose];
        let models = [(bodies[0], 1.0, contacts / 2), (bodies[1], -1.0, contacts - contacts / 2)].map(
            |(pose, side, count)| {
                let found = (0..count).map(|i| {
                    let point =
                        pose.transform_point(DVec3::new(0.01, 0.001 * side, 0.002 * i as f64 - 0.008));
                    Contact { point, scene_point: point, normal: DVec3::Y * side, depth: 0.0 }
                });
                LinearContactModel::from_contacts(found, &pose, &parameters, 0.0)
            },
        );
        let grip = GripperCoupling::critically_damped(&tool, 0.5);
        let mut made = Self { tool, coupling, grip, models, state };
        for _ in 0..100 {
            made.state = made.step().state;
        }
        made.state.first.twist = Twist::new(DVec3::new(0.01, 0.002, -0.01), DVec3::new(0.01, 0.02, 0.1));
        made.state.rate = 0.05;
        made
    }

    #[inline(never)]
    fn step(&mut self) -> ArticulatedStep {
        let frame = ArticulatedFrame {
            tool: &self.tool,
            device: &DeviceMotion::at_rest(Pose::from_translation(DVec3::X * -0.03)),
            coupling: &self.coupling,
            gripper: &GripperMotion::at_rest(0.1),
            grip: &self.grip,
            contacts: [&self.models[0], &self.models[1]],
            gravity: DVec3::NEG_Z * 9.81,
        };
        articulated_step(&frame, &self.state, STEP)
    }
}

/// Haptic loop of a session in a host: 50 g pressed on a floor of 1 kN/m by a device that moves slightly.
struct Loop {
    haptic: HapticLoop,
    update: ContactUpdate,
    steps: u64,
}

impl Loop {
    /// Returns the loop after the wrench has come up.
    fn pressed(contacts: u32) -> Self {
        let ball = model("ellipsoid@500");
        let device = Emulation::default().open(Pose::IDENTITY).expect("an emulated device");
        let settings =
            Settings { tool: ToolSettings { mass: 0.05, ..ToolSettings::default() }, ..Settings::default() };
        let renderer = HapticRenderer::new(ball, palpate::Scene::new(), Box::new(device), settings);
        let (haptic, _, _) = renderer.expect("a renderer").into_loops();
        let pose = haptic.body_state().pose;
        let found = (0..contacts).map(|i| {
            let angle = f64::from(i) * 2.399_963;
            let point = pose.translation + DVec3::new(0.03 * angle.cos(), 0.03 * angle.sin(), -0.002);
            Contact { point, scene_point: point, normal: DVec3::NEG_Z, depth: 0.0 }
        });
        let friction = Friction::coulomb(0.3);
        let parameters = ContactParameters { stiffness: 1000.0, damping: 1.0, tolerance: 0.0005, friction };
        let found = LinearContactModel::from_contacts(found, &pose, &parameters, 0.0);
        let update = ContactUpdate::new(found, 0.0, 0.0, contacts);
        let mut made = Self { haptic, update, steps: 0 };
        for _ in 0..500 {
            made.step();
        }
        made
    }

    /// Takes a step; every other one has a new contact model.
    #[inline(never)]
    fn step(&mut self) -> Record {
        self.steps += 1;
        let now = STEP * self.steps as f64;
        let phase = 0.01 * self.steps as f64;
        let (sine, cosine) = phase.sin_cos();
        let state = DeviceState {
            time: now,
            pose: Pose::from_translation(DVec3::new(5e-4 * sine, 0.0, -0.005)),
            twist: Twist::new(DVec3::X * 0.005 * cosine, DVec3::ZERO),
            buttons: 0,
            status: Status::OK,
        };
        if self.steps.is_multiple_of(2) {
            self.update.time = now;
            self.haptic.update_contacts(&self.update);
        }
        self.haptic.step(&state, now, STEP)
    }
}

/// Prints percentiles of single steps, while the device drags the body to and fro and a model arrives every
/// other step.
fn histogram(steps: u64) {
    let mut scene = Scene::pressed(5, Friction::coulomb(0.3));
    let middle = scene.device.pose.translation.x;
    let mut times = Times::new();
    let mut solves = 0;
    for index in 0..steps {
        let phase = index as f64 * 0.01;
        scene.device.pose.translation.x = middle + 0.005 * phase.sin();
        scene.device.twist.linear.x = 0.05 * phase.cos();
        let begun = Instant::now();
        if index % 2 == 0 {
            scene.contacts.arrive(&scene.model, &scene.state, 0.0, 2.0 * STEP);
        }
        let step = black_box(&mut scene).step();
        times.record(begun.elapsed().as_nanos() as u64);
        scene.state = step.state;
        solves += u64::from(step.status.solves);
    }
    println!(
        "{steps} steps, {:.2} solves each, ns: {:?}",
        solves as f64 / steps as f64,
        times.percentiles(1.0)
    );
}

fn main() {
    let arguments: Vec<_> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    match &arguments[..] {
        [command, contacts, steps] if command == "count" => {
            let mut scene =
                Scene::pressed(contacts.parse().expect("a number of contacts"), Friction::coulomb(0.3));
            for _ in 0..steps.parse().expect("a number of steps") {
                black_box(black_box(&mut scene).step());
            }
        }
        [command, contacts, steps] if command == "count-loop" => {
            let mut session = Loop::pressed(contacts.parse().expect("a number of contacts"));
            for _ in 0..steps.parse().expect("a number of steps") {
                black_box(black_box(&mut session).step());
            }
        }
        [command, task, steps] if command == "count-constraints" => {
            let task = Task::ALL.into_iter().find(|known| known.name() == task).expect("a task");
            let mut replay = Replay::record(task);
            for _ in 0..steps.parse().expect("a number of steps") {
                black_box(replay.step());
            }
        }
        [command, steps] if command == "histogram" => histogram(steps.parse().expect("a number of steps")),
        _ => measure(),
    }
}

fn measure() {
    let mut criterion = Criterion::default().configure_from_args();
    let mut group = criterion.benchmark_group("haptic_step");
    let mut one = |name: &str, contacts: usize, mut scene: Scene| {
        let step = scene.step();
        assert!(step.status.failure.is_none());
        println!("{contacts} contacts: {} push, {} solves", step.active.count_ones(), step.status.solves);
        group.bench_function(BenchmarkId::new(name, contacts), |b| b.iter(|| black_box(&mut scene).step()));
    };
    for contacts in [0, 1, 5, 16] {
        one("frictionless", contacts, Scene::pressed(contacts, Friction::NONE));
        one("friction", contacts, Scene::pressed(contacts, Friction::coulomb(0.3)));
    }
    one("friction, blending", 5, Scene::pressed(5, Friction::coulomb(0.3)).blending());
    for contacts in [0, 2, 10] {
        let mut tool = Tool::closed(contacts, Friction::coulomb(0.3));
        let step = tool.step();
        assert!(step.status.failure.is_none());
        let push = step.active.map(u64::count_ones);
        println!("articulated, {contacts} contacts: {push:?} push, {} solves", step.status.solves);
        group.bench_function(BenchmarkId::new("articulated", contacts), |b| {
            b.iter(|| black_box(&mut tool).step())
        });
    }
    for contacts in [0, 1, 5, 16] {
        let mut session = Loop::pressed(contacts);
        let force = session.step().coupling.force.length();
        println!("loop, {contacts} contacts: {force:.3} N");
        group.bench_function(BenchmarkId::new("loop", contacts), |b| {
            b.iter(|| black_box(&mut session).step())
        });
    }
    for task in Task::ALL {
        let mut replay = Replay::record(task);
        println!("constraints, {}: {:.1} contacts, {:.2} N", task.name(), replay.contacts, replay.force);
        let [all, shortest] = replay.percentiles(SINGLE_STEPS);
        println!("{SINGLE_STEPS} single steps, us: {all:?}");
        println!("shortest time of each step in all replays, us: {shortest:?}");
        group.bench_function(BenchmarkId::new("constraints", task.name()), |b| {
            b.iter_custom(|steps| (0..steps).map(|_| replay.step()).sum::<Duration>())
        });
        group.bench_function(BenchmarkId::new("contact loop", task.name()), |b| {
            b.iter_custom(|steps| (0..steps).map(|_| replay.query()).sum::<Duration>())
        });
    }
    group.finish();
    criterion.final_summary();
}
