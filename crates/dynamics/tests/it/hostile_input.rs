//! Steps with unusable inputs: each returns finite numbers and reports when it was not taken.

#![allow(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]

use palpate_core::glam::{DMat3, DQuat, DVec3};
use palpate_core::{Contact, Pose, Twist, Wrench};
use palpate_dynamics::{
    Body, BodyState, ContactParameters, DeviceMotion, Frame, Friction, FrictionAnchor, Integrator,
    IntegratorKind, LinearContactModel, MAX_SOLVES, PenaltyContact, Step, StepFailure, SurfaceMotion,
    VirtualCoupling,
};
use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

struct Inputs {
    body: Body,
    state: BodyState,
    device: DeviceMotion,
    coupling: VirtualCoupling,
    contacts: LinearContactModel,
    gravity: DVec3,
    dt: f64,
}

impl Inputs {
    fn usable() -> Self {
        let body = Body::new(0.05, DMat3::from_diagonal(DVec3::new(1e-5, 2e-5, 2.5e-5))).unwrap();
        let state = BodyState {
            pose: Pose::new(DVec3::new(0.1, 0.0, -0.2), DQuat::from_rotation_y(0.4)),
            twist: Twist::new(DVec3::X * 0.1, DVec3::Y),
        };
        let contact = Contact {
            point: state.pose.translation + DVec3::Z * 0.02,
            scene_point: state.pose.translation + DVec3::Z * 0.019,
            normal: DVec3::Z,
            depth: 0.001,
        };
        let parameters =
            ContactParameters { stiffness: 1000.0, damping: 1.0, tolerance: 0.001, friction: Friction::NONE };
        Self {
            body,
            state,
            device: DeviceMotion::at_rest(state.pose),
            coupling: VirtualCoupling::critically_damped(&body, Pose::IDENTITY, 200.0, 0.6),
            contacts: LinearContactModel::from_contacts([contact], &state.pose, &parameters, 0.0),
            gravity: DVec3::NEG_Z * 9.81,
            dt: 1e-3,
        }
    }

    fn frame(&self) -> Frame<'_> {
        let Self { body, device, coupling, contacts, gravity, .. } = self;
        Frame { body, device, coupling, contacts, gravity: *gravity }
    }

    fn step(&self) -> Step {
        let step = self.step_by(IntegratorKind::SemiImplicit);
        assert!(step.status.solves <= MAX_SOLVES);
        step
    }

    fn step_by(&self, kind: IntegratorKind) -> Step {
        let step = kind.step(&self.frame(), &self.state, self.dt);
        assert!(step.state.is_valid(), "{kind}: {:?}", step.status);
        let wrenches = [step.coupling, step.coupling_on_body, step.contact];
        assert!(wrenches.iter().all(Wrench::is_finite), "{kind}: {wrenches:?}");
        assert!(step.status.solves < 1000, "{kind}: {:?}", step.status);
        if step.status.failure.is_some() {
            assert_eq!(wrenches, [Wrench::ZERO; 3], "{kind}: a step that was not taken gives wrenches");
            if self.state.is_valid() {
                assert_eq!(step.state, self.state, "{kind}: a step that was not taken moved the body");
            }
        }
        step
    }
}

/// Reason for which all integrators hold a step.
fn with(change: impl FnOnce(&mut Inputs)) -> Option<StepFailure> {
    let mut inputs = Inputs::usable();
    change(&mut inputs);
    let held = inputs.step().status.failure;
    for kind in IntegratorKind::ALL {
        assert_eq!(inputs.step_by(kind).status.failure, held, "{kind}");
    }
    held
}

/// Reason for which the implicit steps are held, if others have their own.
fn with_unusable_numbers(change: impl FnOnce(&mut Inputs)) -> Option<StepFailure> {
    let mut inputs = Inputs::usable();
    change(&mut inputs);
    for kind in IntegratorKind::ALL {
        // A quasi-static body has neither dampers nor inertia.
        let held = inputs.step_by(kind).status.failure.is_some();
        assert!(held || kind == IntegratorKind::QuasiStatic, "{kind}");
    }
    assert_eq!(inputs.step_by(IntegratorKind::FullyImplicit).status.failure, Some(StepFailure::Singular));
    inputs.step().status.failure
}

#[test]
fn usable_inputs_are_used() {
    assert_eq!(with(|_| ()), None);
}

#[test]
fn an_unusable_device_holds_the_body() {
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        assert_eq!(with(|i| i.device.pose.translation.y = bad), Some(StepFailure::Device));
        assert_eq!(with(|i| i.device.pose.rotation.w = bad), Some(StepFailure::Device));
        assert_eq!(with(|i| i.device.twist.linear.x = bad), Some(StepFailure::Device));
        assert_eq!(with(|i| i.device.twist.angular.z = bad), Some(StepFailure::Device));
    }
    assert_eq!(
        with(|i| i.device.pose.rotation = DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0)),
        Some(StepFailure::Device)
    );
}

#[test]
fn an_unusable_time_step_holds_the_body() {
    for bad in [0.0, -1e-3, f64::NAN, f64::INFINITY] {
        assert_eq!(with(|i| i.dt = bad), Some(StepFailure::TimeStep));
    }
}

#[test]
fn an_unusable_state_is_replaced_by_the_relaxed_one() {
    for bad in [f64::NAN, f64::INFINITY] {
        let mut inputs = Inputs::usable();
        inputs.state.twist.angular.x = bad;
        let step = inputs.step();
        assert_eq!(step.status.failure, Some(StepFailure::State));
        assert_eq!(step.state.twist, Twist::ZERO);
        assert!((step.state.pose.translation - inputs.device.pose.translation).length() < 1e-15);
        inputs.device.pose.translation.x = bad;
        assert_eq!(inputs.step().state, BodyState::default());
    }
}

#[test]
fn unusable_gains_contacts_and_gravity_hold_the_body() {
    for bad in [f64::NAN, f64::INFINITY] {
        assert_eq!(with_unusable_numbers(|i| i.coupling.linear_stiffness = bad), Some(StepFailure::Singular));
        assert_eq!(with_unusable_numbers(|i| i.coupling.angular_damping = bad), Some(StepFailure::Singular));
        assert_eq!(
            with_unusable_numbers(|i| i.coupling.grasp.translation.x = bad),
            Some(StepFailure::Singular)
        );
        assert_eq!(with_unusable_numbers(|i| i.gravity.z = bad), Some(StepFailure::Singular));
        assert_eq!(with_unusable_numbers(|i| i.body.mass = bad), Some(StepFailure::Singular));
        assert_eq!(with_unusable_numbers(|i| i.body.inertia.x_axis.x = bad), Some(StepFailure::Singular));
        let constraint = PenaltyContact {
            point: DVec3::Z * bad,
            scene_point: DVec3::ZERO,
            normal: DVec3::Z,
            stiffness: 1000.0,
            ..PenaltyContact::default()
        };
        // A contact with a NaN position is never closed, so it may also do nothing.
        let mut inputs = Inputs::usable();
        inputs.contacts.push_contact(constraint);
        for kind in IntegratorKind::ALL {
            let _ = inputs.step_by(kind);
        }
    }
    let body_without_mass = |i: &mut Inputs| {
        i.body.mass = 0.0;
        i.coupling.linear_stiffness = 0.0;
        i.coupling.linear_damping = 0.0;
        i.contacts = LinearContactModel::empty(&Pose::IDENTITY, 0.0);
    };
    assert_eq!(with_unusable_numbers(body_without_mass), Some(StepFailure::Singular));
}

#[test]
fn numbers_that_overflow_hold_the_body() {
    let too_far = |i: &mut Inputs| {
        (i.state.twist, i.dt) = (Twist::new(DVec3::X * 1e300, DVec3::ZERO), 1e10);
        (i.coupling.linear_stiffness, i.coupling.linear_damping) = (0.0, 0.0);
        i.contacts = LinearContactModel::empty(&Pose::IDENTITY, 0.0);
    };
    let mut inputs = Inputs::usable();
    too_far(&mut inputs);
    for kind in IntegratorKind::ALL {
        let expected = match kind {
            IntegratorKind::QuasiStatic => StepFailure::Singular,
            _ => StepFailure::Overflow,
        };
        assert_eq!(inputs.step_by(kind).status.failure, Some(expected), "{kind}");
    }
}

#[test]
fn numbers_of_any_size_give_finite_numbers() {
    let seed = 71;
    let mut rng = StdRng::seed_from_u64(seed);
    let mut taken = [0; IntegratorKind::ALL.len()];
    let cases = 100_000;
    for case in 0..cases {
        let widest = [3.0, 30.0, 300.0][case % 3];
        let mut any = || {
            let special = [0.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MIN_POSITIVE, f64::MAX];
            if rng.random_bool(0.002) {
                return special[rng.random_range(0..special.len())];
            }
            let size: f64 = 10_f64.powf(rng.random_range(-widest..widest));
            if rng.random_bool(0.5) { size } else { -size }
        };
        let mut inputs = Inputs::usable();
        let mut vector = || DVec3::new(any(), any(), any());
        (inputs.state.pose.translation, inputs.device.pose.translation) = (vector(), vector());
        inputs.state.twist = Twist::new(vector(), vector());
        inputs.device.twist = Twist::new(vector(), vector());
        inputs.gravity = vector();
        inputs.coupling.grasp.translation = vector();
        let (point, scene_point, normal) = (vector(), vector(), vector());
        let surface = SurfaceMotion { velocity: vector(), angular: vector(), ..SurfaceMotion::STILL };
        inputs.coupling.linear_stiffness = any();
        inputs.coupling.linear_damping = any();
        inputs.coupling.angular_stiffness = any();
        inputs.coupling.angular_damping = any();
        inputs.coupling.max_force = any();
        inputs.coupling.max_torque = any();
        let friction = Friction { static_coefficient: any(), dynamic_coefficient: any() };
        let constraint = PenaltyContact {
            point,
            scene_point,
            normal,
            stiffness: any(),
            damping: any(),
            tolerance: any(),
            braking_time: any(),
            friction,
            radius: any(),
            anchor: FrictionAnchor { point: scene_point, rotation: inputs.state.pose.rotation },
            surface,
        };
        inputs.contacts.push_contact(constraint);
        inputs.contacts.advance(any());
        let contact = Contact { point, scene_point, normal, depth: any() };
        let parameters = ContactParameters { stiffness: any(), damping: any(), tolerance: any(), friction };
        let more = LinearContactModel::from_contacts([contact], &inputs.state.pose, &parameters, any());
        for c in more.contacts() {
            inputs.contacts.push_contact(*c);
        }
        inputs.dt = any().abs();
        for (taken, kind) in taken.iter_mut().zip(IntegratorKind::ALL) {
            *taken += usize::from(inputs.step_by(kind).status.failure.is_none());
        }
    }
    for (taken, kind) in taken.into_iter().zip(IntegratorKind::ALL) {
        println!("seed {seed}, {kind}: {taken} steps taken of {cases}");
        assert!(taken > 1000 && cases - taken > 1000, "{kind}");
    }
}

#[test]
fn integrators_that_diverge_end_held_or_finite() {
    for kind in IntegratorKind::ALL {
        let mut inputs = Inputs::usable();
        inputs.body = Body::new(1e-6, DMat3::from_diagonal(DVec3::new(1e-12, 2e-9, 2e-9))).unwrap();
        let mut fastest: f64 = 0.0;
        let mut held = 0;
        for _ in 0..2000 {
            let step = inputs.step_by(kind);
            held += u32::from(step.status.failure.is_some());
            inputs.state = step.state;
            fastest = fastest.max(step.state.twist.linear.length());
        }
        println!("{kind}: fastest {fastest:.1e} m/s, held {held} times");
        let explicit =
            [IntegratorKind::ForwardEuler, IntegratorKind::SymplecticEuler, IntegratorKind::RungeKutta4];
        if explicit.contains(&kind) {
            assert!(fastest > 1e6 && held > 0, "{kind} does not diverge");
        } else {
            // A quasi-static body is out of the wall in one step.
            assert!(fastest < 5.0 && held == 0, "{kind}");
        }
    }
}
