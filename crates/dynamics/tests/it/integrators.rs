//! The integrators against motions with known answers and against one another.

#![allow(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]

use palpate_core::glam::{DMat3, DQuat, DVec3};
use palpate_core::{Contact, Pose, Twist, Wrench};
use palpate_dynamics::{
    Body, BodyState, ContactParameters, DeviceMotion, Frame, Friction, FullyImplicit, Integrator,
    IntegratorKind, LinearContactModel, QuasiStatic, Step, VirtualCoupling, semi_implicit_step,
};
use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

use IntegratorKind::{ForwardEuler, RungeKutta4, SemiImplicit, SymplecticEuler};

/// The integrators with dynamics, with their orders.
const DYNAMIC: [(IntegratorKind, i32); 5] = [
    (SemiImplicit, 1),
    (IntegratorKind::FullyImplicit, 1),
    (ForwardEuler, 1),
    (SymplecticEuler, 1),
    (RungeKutta4, 4),
];

/// The loads on a body.
struct Scene {
    body: Body,
    device: DeviceMotion,
    coupling: VirtualCoupling,
    contacts: LinearContactModel,
    gravity: DVec3,
}

impl Scene {
    /// A body without a coupling.
    fn free(body: Body) -> Self {
        let mut coupling = VirtualCoupling::critically_damped(&body, Pose::IDENTITY, 0.0, 0.0);
        (coupling.linear_damping, coupling.angular_damping) = (0.0, 0.0);
        Self {
            body,
            device: DeviceMotion::default(),
            coupling,
            contacts: LinearContactModel::empty(&Pose::IDENTITY, 0.0),
            gravity: DVec3::ZERO,
        }
    }

    fn frame(&self) -> Frame<'_> {
        let Self { body, device, coupling, contacts, gravity } = self;
        Frame { body, device, coupling, contacts, gravity: *gravity }
    }

    fn run(&self, by: &impl Integrator, start: BodyState, seconds: f64, steps: u32) -> Step {
        let mut state = start;
        let mut last = None;
        for i in 0..steps {
            let step = by.step(&self.frame(), &state, seconds / f64::from(steps));
            assert!(step.status.is_ok(), "step {i}: {:?}", step.status);
            state = step.state;
            last = Some(step);
        }
        last.expect("there are steps")
    }
}

fn diagonal(mass: f64, moments: [f64; 3]) -> Body {
    Body::new(mass, DMat3::from_diagonal(DVec3::from_array(moments))).unwrap()
}

fn random_vector(rng: &mut StdRng, size: f64) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| rng.random_range(-size..size)))
}

/// The observed order of errors from one number of steps to twice as many.
fn orders(errors: &[f64]) -> Vec<f64> {
    errors.windows(2).map(|pair| (pair[0] / pair[1]).log2()).collect()
}

fn assert_order(name: &str, errors: &[f64], order: i32) {
    let found = orders(errors);
    println!("{name}: errors {errors:?}, orders {found:.3?}");
    let last = found[found.len() - 1];
    assert!((last - f64::from(order)).abs() < 0.2, "{name}: order {last}, not {order}: {errors:?}");
}

#[test]
fn names_are_read_as_they_are_written() {
    for kind in IntegratorKind::ALL {
        assert_eq!(kind.to_string().parse(), Ok(kind));
        let json = serde_json::to_string(&kind).unwrap();
        assert_eq!(json, format!("\"{kind}\""));
        assert_eq!(serde_json::from_str::<IntegratorKind>(&json).unwrap(), kind);
    }
    assert_eq!(IntegratorKind::default(), SemiImplicit);
    for wrong in ["", "rk4", "Semi-Implicit", "semi-implicit "] {
        let said = wrong.parse::<IntegratorKind>().unwrap_err().to_string();
        assert!(said.contains(&format!("\"{wrong}\"")), "{said}");
        for kind in IntegratorKind::ALL {
            assert!(said.contains(kind.name()), "{said}");
        }
    }
}

/// A scene with a coupling and some contacts at the body, most of them touching.
fn random_scene(rng: &mut StdRng) -> (Scene, BodyState) {
    let squares: [f64; 3] = std::array::from_fn(|_| rng.random_range(0.05..1.0));
    let moments = [squares[1] + squares[2], squares[2] + squares[0], squares[0] + squares[1]];
    let mass = 10_f64.powf(rng.random_range(-3.0..0.0));
    let body = diagonal(mass, moments.map(|m| m * 1e-3 * mass));
    let turn = DQuat::from_scaled_axis(random_vector(rng, 1.0));
    let pose = Pose::new(random_vector(rng, 0.2), turn);
    let twist = Twist::new(random_vector(rng, 0.3), random_vector(rng, 3.0));
    let grasp = Pose::new(random_vector(rng, 0.05), DQuat::from_scaled_axis(random_vector(rng, 1.0)));
    let coupling = VirtualCoupling::critically_damped(&body, grasp, 200.0, 0.6);
    let pull = Twist::new(random_vector(rng, 0.005), random_vector(rng, 0.2));
    let device = DeviceMotion {
        pose: (pose * grasp).moved(&pull, 1.0),
        twist: Twist::new(random_vector(rng, 0.3), random_vector(rng, 1.0)),
    };
    let contacts: Vec<_> = (0..rng.random_range(0..6))
        .map(|_| {
            let normal = random_vector(rng, 1.0).normalize();
            let point = pose.translation + random_vector(rng, 0.04);
            let depth = rng.random_range(-0.001..0.001);
            Contact { point, scene_point: point - normal * depth, normal, depth }
        })
        .collect();
    let parameters = ContactParameters {
        stiffness: rng.random_range(200.0..5_000.0),
        damping: rng.random_range(0.0..2.0),
        tolerance: 0.0005,
        friction: Friction::NONE,
    };
    let contacts = LinearContactModel::from_contacts(contacts, &pose, &parameters, 0.0);
    (Scene { body, device, coupling, contacts, gravity: DVec3::NEG_Z * 9.81 }, BodyState { pose, twist })
}

#[test]
fn the_default_is_the_semi_implicit_step_bit_for_bit() {
    let seed = 81;
    let mut rng = StdRng::seed_from_u64(seed);
    for case in 0..2000 {
        let (scene, state) = random_scene(&mut rng);
        let Scene { body, device, coupling, contacts, gravity } = &scene;
        let direct = semi_implicit_step(body, &state, device, coupling, contacts, *gravity, 1e-3);
        let chosen = IntegratorKind::default().step(&scene.frame(), &state, 1e-3);
        assert_eq!(direct, chosen, "seed {seed}, case {case}");
    }
}

/// The motion of a free body by Euler's equations in body axes, with the quaternion as four numbers: the
/// classical Runge–Kutta method in steps of negligible error.
fn euler_equations(moments: DVec3, start: &BodyState, seconds: f64) -> BodyState {
    type Y = (DQuat, DVec3);
    let rate = |(q, w): Y| -> Y {
        let spin = q * DQuat::from_xyzw(w.x, w.y, w.z, 0.0);
        (spin * 0.5, (moments * w).cross(w) / moments)
    };
    let plus = |a: Y, b: Y, h: f64| (a.0 + b.0 * h, a.1 + b.1 * h);
    let steps = 40_000;
    let h = seconds / f64::from(steps);
    let q = start.pose.rotation;
    let mut y = (q, q.conjugate() * start.twist.angular);
    for _ in 0..steps {
        let k1 = rate(y);
        let k2 = rate(plus(y, k1, 0.5 * h));
        let k3 = rate(plus(y, k2, 0.5 * h));
        let k4 = rate(plus(y, k3, h));
        for (k, part) in [(k1, 1.0), (k2, 2.0), (k3, 2.0), (k4, 1.0)] {
            y = plus(y, k, part * h / 6.0);
        }
    }
    let rotation = y.0.normalize();
    BodyState {
        pose: Pose::new(start.pose.translation + start.twist.linear * seconds, rotation),
        twist: Twist::new(start.twist.linear, rotation * y.1),
    }
}

#[test]
fn a_free_asymmetric_body_precesses_with_the_order_of_each() {
    let moments = DVec3::new(1e-4, 2e-4, 2.6e-4);
    let scene = Scene::free(diagonal(0.2, moments.to_array()));
    let start = BodyState {
        pose: Pose::new(DVec3::X, DQuat::from_scaled_axis(DVec3::new(0.3, 0.8, -0.2))),
        twist: Twist::new(DVec3::new(0.1, -0.2, 0.3), DVec3::new(5.0, -12.0, 6.0)),
    };
    let seconds = 0.5;
    let expected = euler_equations(moments, &start, seconds);
    let momentum = scene.body.angular_momentum(&start);
    let kept = (scene.body.angular_momentum(&expected) - momentum).length() / momentum.length();
    assert!(kept < 1e-12, "the reference loses momentum: {kept}");
    for (kind, order) in DYNAMIC {
        let counts = if order == 4 { [50, 100, 200, 400] } else { [1000, 2000, 4000, 8000] };
        // Without forces the symplectic method is its own adjoint.
        let order = if kind == SymplecticEuler { 2 } else { order };
        let errors = counts.map(|steps| {
            let end = scene.run(&kind, start, seconds, steps).state;
            assert!((end.pose.translation - expected.pose.translation).length() < 1e-12);
            end.pose.rotation_vector_to(&expected.pose).length()
                + (end.twist.angular - expected.twist.angular).length() / 10.0
        });
        assert_order(kind.name(), &errors, order);
    }
}

#[test]
fn a_damped_spring_follows_the_analytic_solution_with_the_order_of_each() {
    let body = diagonal(0.1, [1e-4; 3]);
    for ratio in [0.0, 0.5, 1.0] {
        let mut scene = Scene::free(body);
        scene.coupling = VirtualCoupling::critically_damped(&body, Pose::IDENTITY, 90.0, 0.4);
        scene.coupling.linear_damping *= ratio;
        scene.coupling.angular_damping *= ratio;
        let axis = DVec3::new(0.0, 0.6, 0.8);
        let start = BodyState::at_rest(Pose::new(DVec3::X * 0.01, DQuat::from_scaled_axis(axis * 0.5)));
        let seconds = 0.04;
        // The deviation and its rate over w, of a start at 1 and rest.
        let at = |w: f64| {
            let s = seconds * w;
            let damped = (1.0 - ratio * ratio).sqrt();
            let decayed = (-ratio * s).exp();
            let (sine, cosine) = if damped == 0.0 {
                (s, 1.0)
            } else {
                let (sine, cosine) = (s * damped).sin_cos();
                (sine / damped, cosine)
            };
            ((cosine + ratio * sine) * decayed, -sine * decayed)
        };
        let error = |deviation: f64, rate: f64, w: f64| {
            let expected = at(w);
            (deviation - expected.0).hypot(rate / w - expected.1)
        };
        for (kind, order) in DYNAMIC {
            let counts = if order == 4 { [10, 20, 40, 80] } else { [400, 800, 1600, 3200] };
            let errors = counts.map(|steps| {
                let end = scene.run(&kind, start, seconds, steps).state;
                let angle = end.pose.rotation_vector_to(&Pose::IDENTITY).dot(-axis);
                let spin = end.twist.angular.dot(axis);
                [
                    error(end.pose.translation.x / 0.01, end.twist.linear.x / 0.01, (90.0_f64 / 0.1).sqrt()),
                    error(angle / 0.5, spin / 0.5, (0.4_f64 / 1e-4).sqrt()),
                ]
            });
            for (i, what) in ["translation", "rotation"].into_iter().enumerate() {
                assert_order(&format!("{kind}, damping {ratio}, {what}"), &errors.map(|e| e[i]), order);
            }
        }
    }
}

#[test]
fn a_free_needle_keeps_its_momentum_and_energy() {
    // Moments 1 : 1 : 1e-4, spun about its axis, across it and both.
    let scene = Scene::free(diagonal(0.01, [1e-5, 1e-5, 1e-9]));
    for spin in [DVec3::Z * 100.0, DVec3::X * 20.0, DVec3::new(3.0, -2.0, 60.0)] {
        let turned = DQuat::from_scaled_axis(DVec3::new(0.4, -0.3, 0.9));
        let start = BodyState {
            pose: Pose::new(DVec3::ZERO, turned),
            twist: Twist::new(DVec3::X * 0.2, turned * spin),
        };
        let momentum = scene.body.angular_momentum(&start);
        let energy = scene.body.kinetic_energy(&start);
        for (kind, momentum_bound, energy_bound) in [
            (SemiImplicit, 1e-2, 1e-2),
            (IntegratorKind::FullyImplicit, 1e-9, 1e-2),
            (RungeKutta4, 1e-9, 1e-4),
            (SymplecticEuler, 1e-9, 1e-2),
        ] {
            let end = scene.run(&kind, start, 10.0, 10_000).state;
            let drift = (scene.body.angular_momentum(&end) - momentum).length() / momentum.length();
            let gain = scene.body.kinetic_energy(&end) / energy - 1.0;
            println!("{kind}, spin {spin}: momentum drift {drift:.1e}, energy {gain:+.1e}");
            assert!(drift < momentum_bound, "{kind}, spin {spin}: momentum drift {drift}");
            assert!(gain.abs() < energy_bound, "{kind}, spin {spin}: energy {gain}");
        }
    }
}

#[test]
fn the_implicit_ones_hold_any_mass() {
    // A thin tool whose moments are 1 : 1 : 1e-4, held off its centre; the hand jumps, turns and stops.
    let hand = |i: u32| {
        let side = if (i / 250).is_multiple_of(2) { 1.0 } else { -1.0 };
        let turn = DVec3::new(0.3, -0.5, 0.8) * side;
        let pose = Pose::new(DVec3::new(0.02, -0.01, 0.03) * side, DQuat::from_scaled_axis(turn));
        DeviceMotion::at_rest(pose)
    };
    for mass in [1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0] {
        let body = diagonal(mass, [3e-3 * mass, 3e-3 * mass, 3e-7 * mass]);
        let grasp = Pose::from_translation(DVec3::new(0.001, 0.0, 0.06));
        let coupling = VirtualCoupling::critically_damped(&body, grasp, 200.0, 0.6);
        for kind in [SemiImplicit, IntegratorKind::FullyImplicit] {
            let mut scene = Scene { coupling, ..Scene::free(body) };
            let mut state = BodyState::at_rest(coupling.relaxed_pose(&Pose::IDENTITY));
            let (mut furthest, mut unconverged): (f64, u32) = (0.0, 0);
            for i in 0..1000 {
                scene.device = hand(i);
                let step = kind.step(&scene.frame(), &state, 1e-3);
                assert!(step.status.failure.is_none(), "{mass} kg, {kind}: {:?}", step.status);
                unconverged += u32::from(step.status.unconverged);
                state = step.state;
                let held = state.pose.transform_point(grasp.translation);
                furthest = furthest.max((held - scene.device.pose.translation).length());
            }
            // Then the hand rests for six times as long as the slowest mode takes.
            let slowest = (mass / 200.0_f64).sqrt().max((7e-3 * mass / 0.6_f64).sqrt());
            for _ in 0..(20.0 * slowest / 1e-3).ceil() as u32 + 200 {
                state = kind.step(&scene.frame(), &state, 1e-3).state;
            }
            let rest = coupling.relaxed_pose(&scene.device.pose);
            let left = (state.pose.translation - rest.translation).length();
            println!(
                "{mass} kg, {kind}: furthest {furthest:.3} m, left {left:.1e} m, unconverged {unconverged}"
            );
            assert!(furthest < 0.2, "{mass} kg, {kind}: {furthest} m from the hand");
            assert!(left < 1e-5, "{mass} kg, {kind}: {left} m from rest");
            assert_eq!(unconverged, 0, "{mass} kg, {kind}");
        }
    }
}

/// A tool in the corner of two walls.
fn corner() -> (Scene, BodyState) {
    let body = diagonal(0.05, [1e-5, 2e-5, 2.5e-5]);
    let grasp = Pose::new(DVec3::new(0.02, 0.0, 0.01), DQuat::from_rotation_x(0.3));
    let coupling = VirtualCoupling::critically_damped(&body, grasp, 200.0, 0.6);
    let state = BodyState {
        pose: Pose::new(DVec3::new(0.1, 0.0, -0.2), DQuat::from_rotation_y(0.4)),
        twist: Twist::new(DVec3::X * 0.1, DVec3::Y),
    };
    let pull = Twist::new(DVec3::new(0.004, -0.002, -0.006), DVec3::new(0.1, 0.0, -0.05));
    let device = DeviceMotion::at_rest((state.pose * grasp).moved(&pull, 1.0));
    let touch = |arm: DVec3, normal: DVec3| {
        let point = state.pose.translation + arm;
        Contact { point, scene_point: point - normal * 5e-4, normal, depth: 5e-4 }
    };
    let contacts = [
        touch(DVec3::new(-0.02, 0.01, -0.02), DVec3::NEG_Z),
        touch(DVec3::new(0.03, -0.01, 0.0), DVec3::new(0.8, -0.6, 0.0)),
    ];
    let parameters =
        ContactParameters { stiffness: 2000.0, damping: 2.0, tolerance: 0.0, friction: Friction::NONE };
    let contacts = LinearContactModel::from_contacts(contacts, &state.pose, &parameters, 0.0);
    (Scene { body, device, coupling, contacts, gravity: DVec3::NEG_Z * 9.81 }, state)
}

#[test]
fn integrators_agree_in_contact_when_steps_are_small() {
    let (scene, start) = corner();
    let (seconds, steps) = (0.02, 20_000);
    let expected = scene.run(&RungeKutta4, start, seconds, steps);
    assert_eq!(expected.active, 0b11, "both contacts press");
    let moved = (expected.state.pose.translation - start.pose.translation).length();
    assert!(moved > 5e-4, "the case does not move: {moved}");
    for (kind, _) in DYNAMIC {
        let found = scene.run(&kind, start, seconds, steps);
        let apart = (found.state.pose.translation - expected.state.pose.translation).length();
        let turned = found.state.pose.rotation_vector_to(&expected.state.pose).length();
        let faster = (found.state.twist.linear - expected.state.twist.linear).length();
        let force = (found.coupling.force - expected.coupling.force).length();
        println!("{kind}: {apart:.1e} m, {turned:.1e} rad, {faster:.1e} m/s, {force:.1e} N apart");
        assert!(apart < 1e-6 && turned < 1e-4 && faster < 1e-4 && force < 1e-3, "{kind}");
    }
}

#[test]
fn the_quasi_static_body_is_where_the_others_come_to_rest() {
    let (scene, start) = corner();
    let balanced = QuasiStatic::default().step(&scene.frame(), &start, 1e-3);
    println!("{:?}", balanced.status);
    assert!(balanced.status.is_ok(), "{:?}", balanced.status);
    let rest = balanced.coupling_on_body
        + balanced.contact
        + Wrench::new(scene.gravity * scene.body.mass, DVec3::ZERO);
    assert!(rest.force.length() < 1e-9 && rest.torque.length() < 1e-10, "{rest:?}");
    let moved = (balanced.state.pose.translation - start.pose.translation) / 1e-3;
    assert!((balanced.state.twist.linear - moved).length() < 1e-12);
    for (kind, _) in DYNAMIC {
        let last = scene.run(&kind, start, 3.0, 30_000);
        let apart = (last.state.pose.translation - balanced.state.pose.translation).length();
        let turned = last.state.pose.rotation_vector_to(&balanced.state.pose).length();
        let force = (last.coupling.force - balanced.coupling.force).length();
        assert!(apart < 1e-9 && turned < 1e-8 && force < 1e-6, "{kind}: {apart} m, {turned} rad, {force} N");
    }
}

#[test]
fn the_quasi_static_body_finds_balance_from_anywhere_near() {
    let seed = 82;
    let mut rng = StdRng::seed_from_u64(seed);
    let (mut unconverged, mut most) = (0, 0);
    let cases = 2000;
    for case in 0..cases {
        let (mut scene, state) = random_scene(&mut rng);
        if case % 2 == 1 {
            // Saturated springs; a weight beyond them would have no balance.
            (scene.coupling.max_force, scene.coupling.max_torque) = (3.0, 0.3);
            scene.gravity = DVec3::ZERO;
        }
        let step = QuasiStatic::default().step(&scene.frame(), &state, 1e-3);
        assert!(step.status.failure.is_none(), "seed {seed}, case {case}: {:?}", step.status);
        if step.status.unconverged {
            unconverged += 1;
            continue;
        }
        most = most.max(step.status.solves);
        let weight = Wrench::new(scene.gravity * scene.body.mass, DVec3::ZERO);
        let rest = step.coupling_on_body + step.contact + weight;
        let error = rest.force.length() + rest.torque.length();
        assert!(error < 1e-5, "seed {seed}, case {case}: off balance by {error}");
    }
    println!("most solves {most}; {unconverged} of {cases} did not converge");
    assert!(unconverged * 50 < cases);
}

#[test]
fn the_fully_implicit_step_solves_its_equations() {
    let seed = 83;
    let mut rng = StdRng::seed_from_u64(seed);
    let (mut unconverged, mut most, mut pressed) = (0, 0, 0);
    let cases = 5000;
    for case in 0..cases {
        let (scene, state) = random_scene(&mut rng);
        let dt = 1e-3;
        let step = FullyImplicit::default().step(&scene.frame(), &state, dt);
        assert!(step.status.failure.is_none(), "seed {seed}, case {case}: {:?}", step.status);
        most = most.max(step.status.solves);
        if step.status.unconverged {
            unconverged += 1;
            continue;
        }
        // A contact that was left to the next step pushes at the end, but not in the equations.
        let touch = scene.contacts.evaluate(&step.state);
        if touch.active != step.active {
            continue;
        }
        pressed += usize::from(touch.active != 0);
        let end = step.state;
        let force = step.coupling_on_body.force + step.contact.force + scene.gravity * scene.body.mass;
        let torque = step.coupling_on_body.torque + step.contact.torque;
        let momentum = scene.body.angular_momentum(&end) - scene.body.angular_momentum(&state);
        let linear = (end.twist.linear - state.twist.linear) * scene.body.mass - force * dt;
        let angular = momentum - torque * dt;
        let placed = end.pose.translation - state.pose.translation - end.twist.linear * dt;
        let error = linear.length() / (force.length() * dt) + angular.length() / (torque.length() * dt);
        assert!(error < 1e-5, "seed {seed}, case {case}: residual {error}");
        assert!(placed.length() < 1e-15);
    }
    println!("most solves {most}; {pressed} pressed, {unconverged} of {cases} did not converge");
    assert!(pressed > 1000 && unconverged * 50 < cases);
}

#[test]
fn a_search_that_may_not_iterate_says_so() {
    let (scene, state) = corner();
    let given_up = FullyImplicit { iterations: 0, tolerance: 1e-9 }.step(&scene.frame(), &state, 1e-3);
    let semi_implicit = SemiImplicit.step(&scene.frame(), &state, 1e-3);
    assert!(given_up.status.unconverged && !given_up.status.is_ok());
    assert_eq!((given_up.state, given_up.coupling), (semi_implicit.state, semi_implicit.coupling));
    let once = QuasiStatic { iterations: 1, ..QuasiStatic::default() }.step(&scene.frame(), &state, 1e-3);
    assert!(once.status.unconverged && once.status.failure.is_none() && once.state != state);
}
