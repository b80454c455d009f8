//! Time of one haptic step (§5.2) by the number of contacts that push: 0, 1, 5 (the K of §5.5.1) and 16 (the
//! most a model holds).
//!
//! `cargo bench -p palpate-benches --bench haptic_step`. A line before each measurement says how many
//! contacts push and how many 6×6 systems a step solves; `valgrind --tool=callgrind` on the same program with
//! the arguments `count CONTACTS STEPS` counts instructions, where the clock of a shared machine says little.

#![allow(missing_docs, clippy::print_stdout, reason = "a program that reports to the console")]

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion};
use palpate::dynamics::{
    Body, BodyState, ContactParameters, DeviceMotion, Friction, LinearContactModel, Step, VirtualCoupling,
    semi_implicit_step,
};
use palpate::glam::{DMat3, DQuat, DVec3};
use palpate::{Contact, Pose, Twist};

struct Scene {
    body: Body,
    coupling: VirtualCoupling,
    device: DeviceMotion,
    contacts: LinearContactModel,
    state: BodyState,
}

impl Scene {
    /// A 50 g body pressed on a floor at `contacts` points by a device 2 cm lower, after 100 steps, which
    /// bring it into steady pressing; then it is set moving a little, so that no term vanishes.
    fn pressed(contacts: usize) -> Self {
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
        let parameters = ContactParameters {
            stiffness: 1000.0,
            damping: 1.0,
            tolerance: 0.0005,
            friction: Friction::NONE,
        };
        let contacts = LinearContactModel::from_contacts(found, &pose, &parameters, 0.0);
        let held = pose * grasp;
        let turn = DQuat::from_scaled_axis(DVec3::new(0.0, 0.0, 0.005));
        let device = DeviceMotion {
            pose: Pose::new(held.translation + DVec3::new(0.0002, 0.0, -0.02), turn * held.rotation),
            twist: Twist::new(DVec3::X * 0.001, DVec3::Z * 0.01),
        };
        let mut scene = Self { body, coupling, device, contacts, state: BodyState::at_rest(pose) };
        for _ in 0..100 {
            scene.state = scene.step().state;
        }
        scene.state.twist = Twist::new(DVec3::new(0.01, 0.02, -0.01), DVec3::new(0.01, 0.02, 0.5));
        scene
    }

    #[inline(never)]
    fn step(&self) -> Step {
        let gravity = DVec3::NEG_Z * 9.81;
        semi_implicit_step(
            &self.body,
            &self.state,
            &self.device,
            &self.coupling,
            &self.contacts,
            gravity,
            1e-3,
        )
    }
}

fn main() {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    if let [command, contacts, steps] = &arguments[..]
        && command == "count"
    {
        let scene = Scene::pressed(contacts.parse().expect("a number of contacts"));
        for _ in 0..steps.parse().expect("a number of steps") {
            black_box(black_box(&scene).step());
        }
        return;
    }

    let mut criterion = Criterion::default().configure_from_args();
    let mut group = criterion.benchmark_group("haptic_step");
    for contacts in [0, 1, 5, 16] {
        let scene = Scene::pressed(contacts);
        let step = scene.step();
        assert!(step.status.held.is_none());
        assert_eq!(step.active.count_ones(), contacts as u32, "a contact does not push");
        println!("{contacts} contacts: {} push, {} solves", step.active.count_ones(), step.status.solves);
        group.bench_function(BenchmarkId::new("contacts", contacts), |b| b.iter(|| black_box(&scene).step()));
    }
    group.finish();
    criterion.final_summary();
}
