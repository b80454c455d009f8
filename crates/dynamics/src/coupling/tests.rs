use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

use super::*;
use crate::differences::{
    random_direction, random_pose, random_twist, random_vector, relative_error, wrench_jacobian,
};

fn random_coupling(rng: &mut StdRng) -> VirtualCoupling {
    VirtualCoupling {
        linear_stiffness: rng.random_range(50.0..2000.0),
        linear_damping: rng.random_range(0.1..5.0),
        angular_stiffness: rng.random_range(0.05..5.0),
        angular_damping: rng.random_range(1e-4..0.01),
        grasp: random_pose(rng, 0.1),
        max_force: f64::INFINITY,
        max_torque: f64::INFINITY,
    }
}

/// A device displaced from the body's grasp frame by a random offset and by `angle` about a random axis.
fn device_at(rng: &mut StdRng, coupling: &VirtualCoupling, state: &BodyState, angle: f64) -> DeviceMotion {
    let grasp = state.pose * coupling.grasp;
    let turn = DQuat::from_scaled_axis(random_direction(rng) * angle);
    let pose = Pose::new(grasp.translation + random_vector(rng, 0.05), (turn * grasp.rotation).normalize());
    DeviceMotion { pose, twist: random_twist(rng, 0.3, 3.0) }
}

#[test]
#[expect(clippy::print_stdout, reason = "a measured figure, shown by --nocapture")]
fn jacobian_equals_central_differences_at_any_rotation() {
    let seed = 31;
    let mut rng = StdRng::seed_from_u64(seed);
    let mut worst: f64 = 0.0;
    for case in 0..600 {
        let mut coupling = random_coupling(&mut rng);
        let state = BodyState { pose: random_pose(&mut rng, 0.5), twist: random_twist(&mut rng, 0.3, 5.0) };
        let angle = [0.0, 1e-7, 1e-3, 0.1, 0.5, 1.5, 2.5, 2.9, 3.0][case % 9];
        if case % 3 == 0 {
            // No smaller than the lever arm: the differences then never meet the kink at a zero arm.
            coupling.grasp.translation += DVec3::splat(0.05);
        }
        let device = device_at(&mut rng, &coupling, &state, angle);
        let found = coupling.evaluate(&state, &device).jacobian;
        let expected = wrench_jacobian(|s| coupling.wrenches(s, &device).0, &state);
        let error = relative_error(&found, &expected);
        assert!(error < 1e-6, "seed {seed}, case {case}, angle {angle}: relative error {error}");
        worst = worst.max(error);
    }
    println!("worst relative error {worst:.2e}");
}

#[test]
fn jacobian_of_saturated_springs_equals_central_differences() {
    let seed = 32;
    let mut rng = StdRng::seed_from_u64(seed);
    let mut bent = 0;
    for case in 0..600 {
        let mut coupling = random_coupling(&mut rng);
        let state = BodyState { pose: random_pose(&mut rng, 0.5), twist: random_twist(&mut rng, 0.3, 5.0) };
        let angle = rng.random_range(0.2..2.5);
        let device = device_at(&mut rng, &coupling, &state, angle);
        let offset = coupling.deviation(&state, &device).offset.length();
        // Limits from far beyond to far below the present deviation: linear, bent and flat. The
        // differences must not straddle a joint, where the law has no second derivative.
        let share = [0.2, 0.65, 0.85, 1.0, 1.15, 1.5][case % 6];
        coupling.max_force = coupling.linear_stiffness * offset / share;
        coupling.max_torque = coupling.angular_stiffness * angle / share;
        if offset < 0.03 {
            continue;
        }
        bent += usize::from((0.75..1.25).contains(&share));
        let found = coupling.evaluate(&state, &device).jacobian;
        let expected = wrench_jacobian(|s| coupling.wrenches(s, &device).0, &state);
        let error = relative_error(&found, &expected);
        assert!(error < 1e-6, "seed {seed}, case {case}, share {share}: relative error {error}");
    }
    assert!(bent > 100, "only {bent} cases on the bent piece");
}

#[test]
fn signs_pull_the_body_to_the_device_and_the_device_to_the_body() {
    let body = Body::new(0.1, DMat3::from_diagonal(DVec3::splat(1e-4))).unwrap();
    let coupling = VirtualCoupling::critically_damped(&body, Pose::IDENTITY, 100.0, 2.0);
    let state = BodyState::default();
    let device = DeviceMotion::at_rest(Pose::new(DVec3::X * 0.01, DQuat::from_scaled_axis(DVec3::Z * 0.25)));
    let (on_body, on_device) = coupling.wrenches(&state, &device);
    assert!((on_body.force - DVec3::X).length() < 1e-12);
    assert!((on_body.torque - DVec3::Z * 0.5).length() < 1e-12);
    assert_eq!(on_device, -on_body);
}

#[test]
fn force_at_a_grasp_off_centre_makes_a_torque_about_the_centre_of_mass_only() {
    let body = Body::new(0.1, DMat3::from_diagonal(DVec3::splat(1e-4))).unwrap();
    let grasp = Pose::from_translation(DVec3::Y * 0.2);
    let coupling = VirtualCoupling::critically_damped(&body, grasp, 100.0, 2.0);
    // Body turned a quarter about z: the grasp point lies at −x.
    let state =
        BodyState::at_rest(Pose::new(DVec3::ZERO, DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2)));
    let held = state.pose * grasp;
    let device = DeviceMotion::at_rest(Pose::new(held.translation + DVec3::Y * 0.01, held.rotation));
    let (on_body, on_device) = coupling.wrenches(&state, &device);
    assert!((on_body.force - DVec3::Y).length() < 1e-12);
    assert!((on_body.torque - DVec3::Z * -0.2).length() < 1e-12);
    assert!((on_device.force + DVec3::Y).length() < 1e-12 && on_device.torque.length() < 1e-12);
}

#[test]
fn relaxed_coupling_exerts_nothing_wherever_it_holds() {
    let seed = 33;
    let mut rng = StdRng::seed_from_u64(seed);
    for _ in 0..200 {
        let (body, device) = (random_pose(&mut rng, 0.5), random_pose(&mut rng, 0.5));
        let mut coupling = random_coupling(&mut rng);
        coupling.grasp = VirtualCoupling::grasp_at(&body, &device);
        let (on_body, _) = coupling.wrenches(&BodyState::at_rest(body), &DeviceMotion::at_rest(device));
        assert!(on_body.force.length() < 1e-11 && on_body.torque.length() < 1e-12, "seed {seed}");
        let relaxed = coupling.relaxed_pose(&device);
        assert!((relaxed.translation - body.translation).length() < 1e-14, "seed {seed}");
    }
}

#[test]
fn spring_wrench_is_the_gradient_of_the_energy() {
    let seed = 34;
    let mut rng = StdRng::seed_from_u64(seed);
    for case in 0..400 {
        let mut coupling = random_coupling(&mut rng);
        (coupling.linear_damping, coupling.angular_damping) = (0.0, 0.0);
        (coupling.max_force, coupling.max_torque) = (rng.random_range(1.0..30.0), rng.random_range(0.1..2.0));
        let state = BodyState::at_rest(random_pose(&mut rng, 0.5));
        let device = device_at(&mut rng, &coupling, &state, [0.4, 1.2, 2.5, 2.9][case % 4]);
        let motion = random_twist(&mut rng, 0.05, 1.0);
        let energy = |s| {
            let moved = BodyState::at_rest(state.pose.moved(&motion, s));
            coupling.potential_energy(&moved, &device)
        };
        let h = 1e-5;
        let slope = (energy(h) - energy(-h)) / (2.0 * h);
        let power = coupling.wrenches(&state, &device).0.power(&motion);
        assert!((slope + power).abs() < 1e-6 * (1.0 + power.abs()), "seed {seed}, case {case}");
    }
}

#[test]
fn default_damping_is_critical() {
    let body = Body::new(0.04, DMat3::from_diagonal(DVec3::new(1e-5, 2e-5, 2.5e-5))).unwrap();
    let c = VirtualCoupling::critically_damped(&body, Pose::IDENTITY, 400.0, 0.9);
    assert!((c.linear_damping - 8.0).abs() < 1e-12);
    assert!((c.angular_damping - 2.0 * (0.9_f64 * 2.5e-5).sqrt()).abs() < 1e-15);
    // About a grasp point at 5 cm the z moment is 2.5e-5 + 0.04 · 0.05² = 1.25e-4.
    let c = VirtualCoupling::critically_damped(&body, Pose::from_translation(DVec3::X * 0.05), 400.0, 0.9);
    let shared = 1.0 + 0.05 * (0.04 / 1.25e-4_f64).sqrt();
    assert!((c.linear_damping - 8.0 * shared.sqrt()).abs() < 1e-12);
    assert!((c.angular_damping - 2.0 * (0.9 * 1.25e-4 * shared).sqrt()).abs() < 1e-15);
}

/// The smallest damping ratio of the modes in which a rod of `mass` and `moment` (about its centre), held at
/// `arm` from it, moves across its length and turns: by the roots of det(M s² + B s + K), found all at once
/// by the iteration of Durand and Kerner.
fn smallest_ratio(mass: f64, moment: f64, arm: f64, c: &VirtualCoupling) -> f64 {
    let about = moment + mass * arm * arm;
    let (k, t, b, d) = (c.linear_stiffness, c.angular_stiffness, c.linear_damping, c.angular_damping);
    let lead = mass * about - (mass * arm).powi(2);
    let raw = [
        1.0,
        (mass * d + b * about) / lead,
        (mass * t + k * about + b * d) / lead,
        (b * t + k * d) / lead,
        k * t / lead,
    ];
    let rate = raw[4].powf(0.25);
    let scaled: Vec<f64> = (0..5).map(|i| raw[i] / rate.powi(i as i32)).collect();
    let multiply = |a: (f64, f64), b: (f64, f64)| (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0);
    let mut roots = [(1.0, 0.0), (0.4, 0.9), (-0.65, 0.72), (-0.908, -0.297)];
    for _ in 0..500 {
        for i in 0..4 {
            let value = scaled.iter().fold((0.0, 0.0), |sum, x| {
                let next = multiply(sum, roots[i]);
                (next.0 + x, next.1)
            });
            let others = (0..4).filter(|j| *j != i).fold((1.0, 0.0), |product, j| {
                multiply(product, (roots[i].0 - roots[j].0, roots[i].1 - roots[j].1))
            });
            let size = others.0 * others.0 + others.1 * others.1;
            let quotient = multiply(value, (others.0 / size, -others.1 / size));
            roots[i] = (roots[i].0 - quotient.0, roots[i].1 - quotient.1);
        }
    }
    roots.iter().map(|r| -r.0 / r.0.hypot(r.1)).fold(f64::INFINITY, f64::min)
}

#[test]
#[expect(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]
fn no_mode_of_a_rod_is_underdamped() {
    let seed = 35;
    let mut rng = StdRng::seed_from_u64(seed);
    let (mut worst, mut separate) = (f64::INFINITY, f64::INFINITY);
    for case in 0..2000 {
        let (mass, length) =
            (10_f64.powf(rng.random_range(-4.0..2.0)), 10_f64.powf(rng.random_range(-2.0..0.0)));
        let arm = length * rng.random_range(0.0..0.5);
        // From weight at the middle to a thicker end: 1/12 for a rod.
        let moment = mass * length * length * rng.random_range(0.02..0.12);
        let body = Body::new(mass, DMat3::from_diagonal(DVec3::new(0.1, 1.0, 1.0)) * moment).unwrap();
        let grasp = Pose::from_translation(DVec3::X * arm);
        let stiffness = 10_f64.powf(rng.random_range(1.5..3.5));
        let angular = 10_f64.powf(rng.random_range(-1.0..1.5));
        let mut coupling = VirtualCoupling::critically_damped(&body, grasp, stiffness, angular);
        let ratio = smallest_ratio(mass, moment, arm, &coupling);
        assert!(ratio > 0.9, "seed {seed}, case {case}: damping ratio {ratio}");
        worst = worst.min(ratio);
        let shared = (1.0 + arm * (mass / (moment + mass * arm * arm)).sqrt()).sqrt();
        coupling.linear_damping /= shared;
        coupling.angular_damping /= shared;
        separate = separate.min(smallest_ratio(mass, moment, arm, &coupling));
    }
    println!("smallest damping ratio {worst:.3}, {separate:.3} if translation and rotation were separate");
    assert!(separate < 0.75, "the factor is needed: {separate}");
}

#[test]
fn torque_is_continuous_through_a_half_turn() {
    let axis = DVec3::new(0.3, -0.5, 0.8).normalize();
    for max_torque in [0.1, 1.0, f64::INFINITY] {
        let body = Body::new(0.1, DMat3::from_diagonal(DVec3::splat(1e-4))).unwrap();
        let mut coupling = VirtualCoupling::critically_damped(&body, Pose::IDENTITY, 100.0, 0.5);
        coupling.max_torque = max_torque;
        let torque = |angle: f64| {
            let device = Pose::new(DVec3::ZERO, DQuat::from_axis_angle(axis, angle));
            coupling.wrenches(&BodyState::default(), &DeviceMotion::at_rest(device)).0.torque
        };
        let (step, mut previous, mut largest) = (1e-3, torque(0.0), 0.0_f64);
        for i in 1..=6283 {
            let next = torque(f64::from(i) * step);
            // The steepest part of the fade falls three times as fast as the spring rose to 150°, at most.
            assert!((next - previous).length() < 8.0 * 0.5 * step, "limit {max_torque}, step {i}");
            largest = largest.max(next.length());
            previous = next;
        }
        assert!(largest > 0.99 * max_torque.min(0.5 * 2.6), "limit {max_torque}: {largest}");
        assert!(torque(std::f64::consts::PI).length() < 1e-9);
    }
}

#[test]
fn a_body_let_go_anywhere_near_a_half_turn_comes_to_rest_at_the_device() {
    let body = Body::new(1e-3, DMat3::from_diagonal(DVec3::new(1e-8, 2e-8, 2.5e-8))).unwrap();
    let coupling = VirtualCoupling::critically_damped(&body, Pose::IDENTITY, 400.0, 10.0);
    let contacts = crate::LinearContactModel::empty(&Pose::IDENTITY, 0.0);
    for past in [-0.4, -0.1, -0.01, -1e-4, 1e-4, 0.01, 0.4] {
        let angle = std::f64::consts::PI + past;
        let device = DeviceMotion::at_rest(Pose::new(DVec3::ZERO, DQuat::from_rotation_y(angle)));
        let mut state = BodyState::default();
        for step in 0..2000 {
            let next =
                crate::semi_implicit_step(&body, &state, &device, &coupling, &contacts, DVec3::ZERO, 1e-3);
            assert!(next.status.is_ok(), "angle {angle}, step {step}: {:?}", next.status);
            state = next.state;
        }
        let left = state.pose.rotation_vector_to(&device.pose).length();
        assert!(left < 1e-6, "angle {angle}: {left} rad left");
    }
}
