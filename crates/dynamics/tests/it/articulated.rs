//! Motions of a tool of two bodies with a hinge: derivatives, free motion, a held hinge against one body,
//! stiff contacts with a light tool, stops, and input that no step can use.

#![allow(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]

use palpate_core::glam::{DMat3, DQuat, DVec3};
use palpate_core::{Contact, Pose, Twist, Wrench};
use palpate_dynamics::{
    ArticulatedBody, ArticulatedFrame, ArticulatedState, ArticulatedStep, Body, BodyState, Constraint,
    ContactParameters, DeviceMotion, Frame, Friction, GripperCoupling, GripperMotion, Joint, JointLimits,
    LinearContactModel, MAX_ARTICULATED_SOLVES, MotionBound, PenaltyContact, Recovery, StepFailure,
    VirtualCoupling, articulated_step, constrained_articulated_step, constrained_step, semi_implicit_step,
};
use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

const STEP: f64 = 1e-3;
const FREE: JointLimits = JointLimits { low: f64::NEG_INFINITY, high: f64::INFINITY, stiffness: 0.0 };

fn random_vector(rng: &mut StdRng, size: f64) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| rng.random_range(-size..size)))
}

fn random_pose(rng: &mut StdRng, size: f64) -> Pose {
    Pose::new(random_vector(rng, size), DQuat::from_scaled_axis(random_vector(rng, 1.7)))
}

fn random_body(rng: &mut StdRng, mass: f64) -> Body {
    let squares = DVec3::from_array(std::array::from_fn(|_| rng.random_range(0.1..1.0) * 4e-4 * mass));
    let moments = DVec3::new(squares.y + squares.z, squares.z + squares.x, squares.x + squares.y);
    let turn = DMat3::from_quat(random_pose(rng, 1.0).rotation);
    Body::new(mass, turn * DMat3::from_diagonal(moments) * turn.transpose()).unwrap()
}

fn random_tool(rng: &mut StdRng, mass: f64, limits: JointLimits) -> ArticulatedBody {
    let (first, second) = (mass * rng.random_range(0.3..1.0), mass * rng.random_range(0.3..1.0));
    let joint = Joint { in_first: random_pose(rng, 0.05), in_second: random_pose(rng, 0.05), limits };
    ArticulatedBody::new(random_body(rng, first), random_body(rng, second), joint).unwrap()
}

fn random_state(rng: &mut StdRng, linear: f64, angular: f64) -> ArticulatedState {
    let twist = Twist::new(random_vector(rng, linear), random_vector(rng, angular));
    let first = BodyState { pose: random_pose(rng, 0.3), twist };
    ArticulatedState { first, angle: rng.random_range(-1.5..1.5), rate: rng.random_range(-angular..=angular) }
}

/// A coupling without gains.
fn uncoupled() -> VirtualCoupling {
    VirtualCoupling {
        linear_stiffness: 0.0,
        linear_damping: 0.0,
        angular_stiffness: 0.0,
        angular_damping: 0.0,
        grasp: Pose::IDENTITY,
        max_force: f64::INFINITY,
        max_torque: f64::INFINITY,
    }
}

fn no_contacts() -> LinearContactModel {
    LinearContactModel::empty(&Pose::IDENTITY, 0.0)
}

/// The loads on a tool, owned.
struct Scene {
    tool: ArticulatedBody,
    device: DeviceMotion,
    coupling: VirtualCoupling,
    gripper: GripperMotion,
    grip: GripperCoupling,
    contacts: [LinearContactModel; 2],
    gravity: DVec3,
}

impl Scene {
    /// A tool without loads.
    fn free(tool: ArticulatedBody) -> Self {
        Self {
            tool,
            device: DeviceMotion::default(),
            coupling: uncoupled(),
            gripper: GripperMotion::default(),
            grip: GripperCoupling::NONE,
            contacts: [no_contacts(); 2],
            gravity: DVec3::ZERO,
        }
    }

    fn frame(&self) -> ArticulatedFrame<'_> {
        ArticulatedFrame {
            tool: &self.tool,
            device: &self.device,
            coupling: &self.coupling,
            gripper: &self.gripper,
            grip: &self.grip,
            contacts: [&self.contacts[0], &self.contacts[1]],
            gravity: self.gravity,
        }
    }

    fn step(&self, state: &ArticulatedState, dt: f64) -> ArticulatedStep {
        articulated_step(&self.frame(), state, dt)
    }
}

/// A contact of the point at `arm` (m, world axes, from the centre of mass) with a plane at `depth` behind
/// it.
fn contact(pose: &Pose, arm: DVec3, normal: DVec3, depth: f64) -> Contact {
    let point = pose.translation + arm;
    Contact { point, scene_point: point - normal * depth, normal, depth }
}

/// Random contacts of a body.
fn random_contacts(rng: &mut StdRng, pose: &Pose, parameters: &ContactParameters) -> LinearContactModel {
    let contacts: Vec<_> = (0..3)
        .map(|_| {
            let normal = random_vector(rng, 1.0).normalize();
            contact(pose, random_vector(rng, 0.05), normal, rng.random_range(0.002..0.004))
        })
        .collect();
    LinearContactModel::from_contacts(contacts, pose, parameters, 0.0)
}

/// The solution of a linear system, by Gauss–Jordan elimination.
fn solve(mut matrix: [[f64; 7]; 7], mut right: [f64; 7]) -> [f64; 7] {
    for i in 0..7 {
        let pivot = (i..7).max_by(|&a, &b| matrix[a][i].abs().total_cmp(&matrix[b][i].abs())).unwrap();
        matrix.swap(i, pivot);
        right.swap(i, pivot);
        let (row, value) = (matrix[i], right[i]);
        for k in (0..7).filter(|&k| k != i) {
            let factor = matrix[k][i] / row[i];
            (0..7).for_each(|j| matrix[k][j] -= factor * row[j]);
            right[k] -= factor * value;
        }
    }
    std::array::from_fn(|i| right[i] / matrix[i][i])
}

/// The generalised forces on a tool's centre of mass, about it, and at its hinge, by power: the work of every
/// wrench on a unit velocity of each coordinate.
fn forces(scene: &Scene, state: &ArticulatedState) -> [f64; 7] {
    forces_of(scene, state, [&state.first, &scene.tool.second(state)])
}

/// The same with the wrenches of bodies at other poses.
fn forces_of(scene: &Scene, state: &ArticulatedState, [first, second]: [&BodyState; 2]) -> [f64; 7] {
    let on_first = scene.contacts[0].wrench(first) + scene.coupling.wrenches(first, &scene.device).0;
    let on_second = scene.contacts[1].wrench(second);
    let still = ArticulatedState::at_rest(state.first.pose, state.angle);
    std::array::from_fn(|i| {
        let mut unit = still;
        match i {
            0..3 => unit.first.twist.linear[i] = 1.0,
            3..6 => unit = with_angular(&scene.tool, &unit, DVec3::AXES[i - 3]),
            _ => unit = with_rate(&scene.tool, &unit),
        }
        let power = on_first.power(&unit.first.twist) + on_second.power(&scene.tool.second(&unit).twist);
        power + if i == 6 { scene.grip.torque(state, &scene.gripper) } else { 0.0 }
    })
}

/// The tool turning about its centre of mass.
fn with_angular(tool: &ArticulatedBody, state: &ArticulatedState, angular: DVec3) -> ArticulatedState {
    let arm = state.first.pose.transform_vector(tool.composite(state.angle).1);
    let twist = Twist::new(arm.cross(angular), angular);
    ArticulatedState { first: BodyState { twist, ..state.first }, ..*state }
}

/// The hinge turning while the centre of mass stays where it is and the first body does not turn.
fn with_rate(tool: &ArticulatedBody, state: &ArticulatedState) -> ArticulatedState {
    let moving = ArticulatedState { rate: 1.0, ..*state };
    let centre_velocity = tool.momenta(&moving).0 / tool.mass();
    let twist = Twist::new(-centre_velocity, DVec3::ZERO);
    ArticulatedState { first: BodyState { twist, ..state.first }, ..moving }
}

/// Velocity of the centre of mass.
fn centre_velocity(tool: &ArticulatedBody, state: &ArticulatedState) -> DVec3 {
    tool.momenta(state).0 / tool.mass()
}

/// A state with its coordinates changed by (δX of the centre of mass, φ, δq) and its velocities (V, ω, q̇) by
/// as many numbers.
fn changed(
    tool: &ArticulatedBody,
    state: &ArticulatedState,
    place: &[f64; 7],
    speed: &[f64; 7],
) -> ArticulatedState {
    let vector = |of: &[f64; 7], i: usize| DVec3::new(of[i], of[i + 1], of[i + 2]);
    let pose = &state.first.pose;
    let centre = pose.transform_point(tool.composite(state.angle).1) + vector(place, 0);
    let angle = state.angle + place[6];
    let rotation = (DQuat::from_scaled_axis(vector(place, 3)) * pose.rotation).normalize();
    let arm = rotation * tool.composite(angle).1;
    let angular = state.first.twist.angular + vector(speed, 3);
    let wanted = centre_velocity(tool, state) + vector(speed, 0);
    let first = BodyState {
        pose: Pose::new(centre - arm, rotation),
        twist: Twist::new(wanted - angular.cross(arm), angular),
    };
    let next = ArticulatedState { first, angle, rate: state.rate + speed[6] };
    // Velocity of the centre of mass by the hinge's rate.
    let off = centre_velocity(tool, &next) - wanted;
    let mut next = next;
    next.first.twist.linear -= off;
    next
}

/// The step solves the linear system that central differences of momenta and forces give: every derivative is
/// right.
#[test]
fn the_step_is_that_of_a_system_by_central_differences() {
    let seed = 121;
    let mut rng = StdRng::seed_from_u64(seed);
    let (mut compared, mut worst) = (0, 0.0_f64);
    for case in 0..300 {
        let tool = random_tool(&mut rng, 0.1, FREE);
        let state = random_state(&mut rng, 0.2, 3.0);
        let mut scene = Scene::free(tool);
        let (composite, centre) = tool.composite(state.angle);
        let grasp = random_pose(&mut rng, 0.05);
        let about_centre = Pose::new(grasp.translation - centre, grasp.rotation);
        scene.coupling = VirtualCoupling {
            grasp,
            ..VirtualCoupling::critically_damped(&composite, about_centre, 300.0, 0.5)
        };
        let displaced = Twist::new(random_vector(&mut rng, 0.008), random_vector(&mut rng, 0.3));
        scene.device = DeviceMotion {
            pose: (state.first.pose * grasp).moved(&displaced, 1.0),
            twist: Twist::new(random_vector(&mut rng, 0.1), random_vector(&mut rng, 1.0)),
        };
        scene.grip = GripperCoupling::critically_damped(&tool, 0.3);
        scene.gripper = GripperMotion {
            angle: state.angle + rng.random_range(-0.5..0.5),
            rate: rng.random_range(-1.0..1.0),
        };
        // Linear, bent and flat springs, away from the joints of their law, across which differences are not
        // exact.
        if case % 2 == 1 {
            let share = [0.4, 0.9, 1.1, 1.5][case / 2 % 4];
            let turn = displaced.angular.length();
            scene.coupling.max_force = scene.coupling.linear_stiffness * displaced.linear.length() / share;
            scene.coupling.max_torque = scene.coupling.angular_stiffness * turn / share;
            scene.grip.max_torque = scene.grip.stiffness * (scene.gripper.angle - state.angle).abs() / share;
        }
        let parameters =
            ContactParameters { stiffness: 500.0, damping: 0.3, tolerance: 0.001, friction: Friction::NONE };
        let poses = [state.first.pose, tool.second(&state).pose];
        scene.contacts = poses.map(|pose| random_contacts(&mut rng, &pose, &parameters));

        let step = scene.step(&state, STEP);
        let now = [
            scene.contacts[0].evaluate(&state.first).active,
            scene.contacts[1].evaluate(&tool.second(&state)).active,
        ];
        if step.status.failure.is_some() || step.active != now || step.status.geometric_stiffness_dropped {
            continue;
        }
        compared += 1;
        let zero = [0.0; 7];
        let along =
            |i: usize, size: f64| -> [f64; 7] { std::array::from_fn(|j| if i == j { size } else { 0.0 }) };
        let derivative = |f: &dyn Fn(f64) -> [f64; 7], h: f64| -> [f64; 7] {
            let (a, b, c, d) = (f(h), f(-h), f(2.0 * h), f(-2.0 * h));
            std::array::from_fn(|k| ((a[k] - b[k]) * 8.0 - (c[k] - d[k])) / (12.0 * h))
        };
        // Momenta at the end for a velocity, by the exponential: M V, L and p less h T_q.
        let momenta = |speed: &[f64; 7]| -> [f64; 7] {
            let moved = changed(&tool, &state, &zero, speed);
            let turn = DQuat::from_scaled_axis(moved.first.twist.angular * STEP);
            let ahead = |angle: f64| ArticulatedState { angle, ..moved };
            // In the axes of the start, at the angle of the end; the angular velocity stays in place under
            // its own turn.
            let end = ahead(state.angle + STEP * moved.rate);
            let (linear, _) = tool.momenta(&moved);
            let (_, angular) = tool.momenta(&end);
            let hinge = tool.momenta_of_hinge(&end);
            let e = 1e-5;
            let energy = |angle: f64| tool.energy_about_centre(&ahead(angle));
            let middle = state.angle + 0.5 * STEP * state.rate;
            let slope = (energy(middle + e) - energy(middle - e)) / (2.0 * e);
            let carried = turn * angular;
            [linear.x, linear.y, linear.z, carried.x, carried.y, carried.z, hinge - STEP * slope]
        };
        let start = {
            let (linear, angular) = tool.momenta(&state);
            [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z, tool.momenta_of_hinge(&state)]
        };
        let speeds = {
            let v = centre_velocity(&tool, &state);
            let w = state.first.twist.angular;
            [v.x, v.y, v.z, w.x, w.y, w.z, state.rate]
        };
        let (load, ahead) = (forces(&scene, &state), momenta(&zero));
        let (mut matrix, mut right) = ([[0.0; 7]; 7], [0.0; 7]);
        for i in 0..7 {
            right[i] = STEP * load[i] - (ahead[i] - start[i]);
        }
        for j in 0..7 {
            let by_speed =
                derivative(&|s| forces(&scene, &changed(&tool, &state, &zero, &along(j, s))), 1e-2);
            let by_place =
                derivative(&|s| forces(&scene, &changed(&tool, &state, &along(j, s), &zero)), 3e-5);
            let by_momentum = derivative(&|s| momenta(&along(j, s)), 1e-2);
            // The bodies are displaced by h times their twists at the end, which change with the placement.
            let bodies = |place: &[f64; 7]| {
                let state = changed(&tool, &state, place, &zero);
                [state.first, tool.second(&state)]
            };
            let e = 1e-4;
            let (low, high) = (bodies(&along(j, -e)), bodies(&along(j, e)));
            let arc = |i: usize| {
                let (low, high) = (low[i].twist, high[i].twist);
                Twist::new((high.linear - low.linear) * (0.5 / e), (high.angular - low.angular) * (0.5 / e))
            };
            let by_arc = derivative(
                &|s| {
                    let [first, second] = bodies(&zero);
                    let moved =
                        |body: BodyState, i: usize| BodyState { pose: body.pose.moved(&arc(i), s), ..body };
                    forces_of(&scene, &state, [&moved(first, 0), &moved(second, 1)])
                },
                2e-5,
            );
            let by_place: [f64; 7] = std::array::from_fn(|i| by_place[i] + STEP * by_arc[i]);
            for i in 0..7 {
                matrix[i][j] += by_momentum[i] - STEP * by_speed[i] - STEP * STEP * by_place[i];
                right[i] += STEP * STEP * by_place[i] * speeds[j];
            }
        }
        let expected = solve(matrix, right);
        let found = {
            let v = centre_velocity(&tool, &step.state) - centre_velocity(&tool, &state);
            let w = step.state.first.twist.angular - state.first.twist.angular;
            [v.x, v.y, v.z, w.x, w.y, w.z, step.state.rate - state.rate]
        };
        // In velocities of points: 5 cm from the centre of mass.
        let scale = |i: usize| if i < 3 { 1.0 } else { 0.05 };
        let size = (0..7).fold(0.0, |most: f64, i| most.max(expected[i].abs() * scale(i)));
        let error =
            (0..7).fold(0.0, |most: f64, i| most.max((found[i] - expected[i]).abs() * scale(i))) / size;
        worst = worst.max(error);
        assert!(error < 1e-6, "seed {seed}, case {case}: relative error {error}");
    }
    println!("worst relative error {worst:.1e} of {compared}");
    assert!(compared > 100, "only {compared} cases kept their contacts");
}

/// Quantities of the test of derivatives beside [`ArticulatedBody::momenta`].
trait Hinged {
    fn momenta_of_hinge(&self, state: &ArticulatedState) -> f64;
    fn energy_about_centre(&self, state: &ArticulatedState) -> f64;
}

impl Hinged for ArticulatedBody {
    /// The derivative of the kinetic energy by the hinge's rate.
    fn momenta_of_hinge(&self, state: &ArticulatedState) -> f64 {
        let still =
            ArticulatedState { rate: 0.0, first: BodyState::at_rest(state.first.pose), angle: state.angle };
        let hinge = with_rate(self, &still);
        // The energy is a quadratic form: its polarisation on the two motions.
        let twice = |a: &ArticulatedState| 2.0 * self.energy_about_centre(a);
        let mut both = *state;
        both.rate += 1.0;
        0.5 * (twice(&both) - twice(state) - twice(&hinge))
    }

    fn energy_about_centre(&self, state: &ArticulatedState) -> f64 {
        self.kinetic_energy(state) - 0.5 * self.momenta(state).0.length_squared() / self.mass()
    }
}

#[test]
fn a_free_tool_keeps_its_momentum_and_gains_no_energy() {
    let seed = 122;
    let mut rng = StdRng::seed_from_u64(seed);
    let mut most: f64 = f64::NEG_INFINITY;
    for case in 0..50 {
        let tool = random_tool(&mut rng, 0.1, FREE);
        let start = random_state(&mut rng, 0.5, [5.0, 30.0][case % 2]);
        let scene = Scene::free(tool);
        let ((linear, _), mut energy) = (tool.momenta(&start), tool.kinetic_energy(&start));
        let mut state = start;
        for i in 0..2000 {
            let step = scene.step(&state, STEP);
            assert!(step.status.is_ok());
            state = step.state;
            let drift = (tool.momenta(&state).0 - linear).length();
            assert!(drift < 1e-13 * f64::from(i + 1), "seed {seed}, case {case}, step {i}: {drift} kg·m/s");
            let next = tool.kinetic_energy(&state);
            most = most.max(next / energy - 1.0);
            assert!(
                next <= energy * (1.0 + 1e-6),
                "seed {seed}, case {case}, step {i}: {energy} J to {next} J"
            );
            energy = next;
        }
    }
    println!("largest relative gain in a step {most:.1e}");
}

#[test]
fn the_angular_momentum_of_a_free_tool_is_kept_to_second_order() {
    let seed = 123;
    let mut rng = StdRng::seed_from_u64(seed);
    for case in 0..20 {
        let tool = random_tool(&mut rng, 0.1, FREE);
        let start = random_state(&mut rng, 0.5, 6.0);
        let scene = Scene::free(tool);
        let (_, momentum) = tool.momenta(&start);
        let drift = |steps: u32| {
            let mut state = start;
            for _ in 0..steps {
                state = scene.step(&state, 0.2 / f64::from(steps)).state;
            }
            (tool.momenta(&state).1 - momentum).length() / momentum.length()
        };
        let drifts = [200, 400, 800].map(drift);
        for pair in drifts.windows(2) {
            assert!(pair[0] / pair[1] > 3.4 || pair[1] < 1e-12, "seed {seed}, case {case}: {drifts:?}");
        }
    }
}

/// Free motion converges at first order to that by steps much shorter.
#[test]
fn free_motion_converges_at_first_order() {
    let seed = 124;
    let mut rng = StdRng::seed_from_u64(seed);
    for case in 0..10 {
        let tool = random_tool(&mut rng, 0.1, FREE);
        let start = random_state(&mut rng, 0.5, 8.0);
        let scene = Scene::free(tool);
        let run = |steps: u32| {
            let mut state = start;
            for _ in 0..steps {
                state = scene.step(&state, 0.1 / f64::from(steps)).state;
            }
            state
        };
        let exact = run(51_200);
        let error = |steps: u32| {
            let found = run(steps);
            let turn = found.first.pose.rotation_vector_to(&exact.first.pose).length();
            turn + (found.angle - exact.angle).abs()
        };
        let errors = [100, 200, 400, 800].map(error);
        for pair in errors.windows(2) {
            assert!((1.7..2.4).contains(&(pair[0] / pair[1])), "seed {seed}, case {case}: {errors:?}");
        }
    }
}

/// A tool whose hinge is held, and the one body that it then is.
struct Whole {
    scene: Scene,
    body: Body,
    /// Centre of mass from the first body's, in its axes, m.
    centre: DVec3,
    coupling: VirtualCoupling,
    state: BodyState,
}

impl Whole {
    /// A tool at a state, at a random grasp and off the device. The grip is given by its stiffness and
    /// damping, N·m/rad and N·m·s/rad.
    fn random(
        rng: &mut StdRng,
        tool: ArticulatedBody,
        state: &ArticulatedState,
        (stiffness, damping): (f64, f64),
    ) -> Self {
        let (body, centre) = tool.composite(state.angle);
        let mut scene = Scene::free(tool);
        let grasp = random_pose(rng, 0.05);
        let about_centre = Pose::new(grasp.translation - centre, grasp.rotation);
        let coupling = VirtualCoupling::critically_damped(&body, about_centre, 300.0, 0.5);
        scene.coupling = VirtualCoupling { grasp, ..coupling };
        let displaced = Twist::new(random_vector(rng, 0.01), random_vector(rng, 0.4));
        scene.device = DeviceMotion::at_rest((state.first.pose * grasp).moved(&displaced, 1.0));
        scene.grip = GripperCoupling { stiffness, damping, max_torque: f64::INFINITY };
        scene.gripper = GripperMotion::at_rest(state.angle);
        let BodyState { pose, twist } = state.first;
        let arm = pose.transform_vector(centre);
        let state = BodyState {
            pose: Pose::new(pose.translation + arm, pose.rotation),
            twist: Twist { linear: twist.velocity_at(arm), ..twist },
        };
        Self { scene, body, centre, coupling, state }
    }
}

/// With its hinge held, the tool moves as the composite body does: against the step of one body.
#[test]
fn with_its_hinge_held_the_tool_moves_as_one_body() {
    let seed = 125;
    let mut rng = StdRng::seed_from_u64(seed);
    let mut worst = (0.0_f64, 0.0_f64);
    for case in 0..60 {
        let tool = random_tool(&mut rng, 0.05, FREE);
        let mut state = ArticulatedState { rate: 0.0, ..random_state(&mut rng, 0.2, 2.0) };
        let Whole { mut scene, body, centre, coupling: one, state: mut whole } =
            Whole::random(&mut rng, tool, &state, (1e7, 1e5));
        scene.gravity = DVec3::NEG_Z * 9.81;
        let friction = Friction::coulomb([0.0, 0.0, 0.3][case % 3]);
        let parameters = ContactParameters { stiffness: 2000.0, damping: 1.0, tolerance: 0.001, friction };
        let second = tool.second_in_first(state.angle);
        let poses = [state.first.pose, state.first.pose * second];
        scene.contacts = poses.map(|pose| random_contacts(&mut rng, &pose, &parameters));
        // The same contacts on the one body.
        let from_first = |point: DVec3| point - centre;
        let mut contacts = LinearContactModel::empty(&state.first.pose, 0.0);
        let axes = state.first.pose.rotation;
        for c in scene.contacts[0].contacts() {
            contacts.push_contact(PenaltyContact { point: from_first(c.point), ..*c });
        }
        for c in scene.contacts[1].contacts() {
            let mut c = PenaltyContact { point: from_first(second.transform_point(c.point)), ..*c };
            c.anchor.rotation = axes;
            contacts.push_contact(c);
        }
        let (mut pushed, mut off, mut apart) = (false, 0.0_f64, 0.0);
        for _ in 0..2000 {
            let step = scene.step(&state, STEP);
            let single =
                semi_implicit_step(&body, &whole, &scene.device, &one, &contacts, scene.gravity, STEP);
            assert!(step.status.failure.is_none() && single.status.failure.is_none());
            pushed |= single.active != 0;
            (state, whole) = (step.state, single.state);
            apart = (state.first.pose.translation - whole.pose.transform_point(-centre)).length();
            apart = apart.max(0.05 * whole.pose.rotation_vector_to(&state.first.pose).length());
            off = off.max(apart);
        }
        assert!(pushed, "seed {seed}, case {case}");
        // While moving, the two differ in the order of the step; at rest they agree except for friction,
        // which depends on the path, and the hinge, which yields by the torque over 1e7 N·m/rad.
        assert!(off < 5e-5, "seed {seed}, case {case}: {off} m apart");
        assert!(friction.is_some() || apart < 1e-8, "seed {seed}, case {case}: {apart} m apart at rest");
        worst = (worst.0.max(off), worst.1.max(if friction.is_some() { 0.0 } else { apart }));
    }
    println!("at most {:.1e} m apart, and {:.1e} m at rest", worst.0, worst.1);
}

/// Forceps of a gram: two jaws 5 cm long along x, hinged at the origin about z.
fn light_forceps(limits: JointLimits) -> ArticulatedBody {
    let jaw = Body::new(0.0005, DMat3::from_diagonal(DVec3::new(2e-9, 1.1e-7, 1.1e-7))).unwrap();
    let hinge = Pose::from_translation(DVec3::X * -0.025);
    ArticulatedBody::new(jaw, jaw, Joint { in_first: hinge, in_second: hinge, limits }).unwrap()
}

/// A gram of forceps, held at the hinge, closes on a stiff ball between its jaws while the hand shakes, and
/// comes to rest; forces and torques then balance, and the gripper feels the contacts' moment about the
/// hinge.
#[test]
fn a_one_gram_forceps_on_a_stiff_ball_settles() {
    for stiffness in [2000.0, 10_000.0, 100_000.0] {
        for damping in [0.0, 0.1, 5.0] {
            let limits = JointLimits { low: 0.0, high: 1.0, stiffness: 100.0 };
            let tool = light_forceps(limits);
            let mut scene = Scene::free(tool);
            let mut state = ArticulatedState::at_rest(Pose::from_translation(DVec3::X * 0.025), 0.6);
            let (composite, centre) = tool.composite(0.6);
            let grasp = Pose::from_translation(DVec3::X * -0.025);
            let about_centre = Pose::from_translation(grasp.translation - centre);
            scene.coupling = VirtualCoupling {
                grasp,
                ..VirtualCoupling::critically_damped(&composite, about_centre, 200.0, 0.6)
            };
            scene.grip =
                GripperCoupling { max_torque: 0.2, ..GripperCoupling::critically_damped(&tool, 0.5) };
            scene.gravity = DVec3::NEG_Z * 9.81;
            // Planes of a ball of 5 mm: the tips are pressed apart, along and across.
            let parameters =
                ContactParameters { stiffness, damping, tolerance: 0.0005, friction: Friction::coulomb(0.4) };
            let touch = |normal: DVec3| {
                let at = Pose::IDENTITY;
                let point = DVec3::new(0.04, 0.008, 0.0) - normal * 0.005;
                (0..3).map(move |i| {
                    contact(&at, point + DVec3::new(0.002, 0.0, 0.003) * f64::from(i - 1), normal, 0.0)
                })
            };
            // The first jaw lies along x below the ball, the second comes down on it from above.
            let at_closing = ArticulatedState::at_rest(Pose::from_translation(DVec3::X * 0.025), 0.3);
            let second = tool.second(&at_closing).pose;
            scene.contacts = [
                LinearContactModel::from_contacts(touch(DVec3::Y), &at_closing.first.pose, &parameters, 0.0),
                LinearContactModel::from_contacts(touch(DVec3::NEG_Y), &second, &parameters, 0.0),
            ];
            let (mut fastest, mut last, mut least) = (0.0_f64, None, f64::INFINITY);
            for i in 0..4000 {
                let t = f64::from(i) * STEP;
                let shake = if t < 1.0 { (6.0 * std::f64::consts::PI * t).sin() } else { 0.0 };
                let pose = Pose::new(DVec3::new(0.0, 0.01 * shake, 0.0), DQuat::from_rotation_x(0.3 * shake));
                scene.device = DeviceMotion::at_rest(pose);
                scene.gripper = GripperMotion::at_rest((0.6 - 1.2 * t).max(0.0));
                let step = scene.step(&state, STEP);
                assert!(step.status.failure.is_none(), "{:?} at {t} s", step.status);
                assert!(step.status.solves <= MAX_ARTICULATED_SOLVES);
                state = step.state;
                fastest = fastest.max(state.first.twist.linear.length()).max(0.05 * state.rate.abs());
                least = least.min(state.angle);
                last = Some(step);
            }
            let last = last.unwrap();
            let speed = state.first.twist.linear.length() + 0.05 * state.rate.abs();
            println!(
                "k {stiffness}, b {damping}: fastest {fastest:.2} m/s, at the end {speed:.1e} m/s, angle {:.3}, gripper {:.4} N·m, {:?}",
                state.angle, last.gripper, last.status
            );
            assert!(fastest < 5.0, "the tool reached {fastest} m/s");
            assert!(speed < 1e-6, "k {stiffness}, b {damping}: the tool does not settle");
            assert!(least > -0.01 && state.angle > 0.1, "closed to {least}, {} on the ball", state.angle);
            let weight = scene.gravity * tool.mass();
            let rest = last.coupling_on_body.force + last.contacts[0].force + last.contacts[1].force + weight;
            assert!(rest.length() < 1e-5, "{rest} N are left");
            // About the hinge, which the second body turns around.
            let second = tool.second(&state);
            let hinge = second.pose.transform_point(tool.joint.in_second.translation);
            let on_second = last.contacts[1] + Wrench::new(scene.gravity * tool.second.mass, DVec3::ZERO);
            let moment = on_second.about(hinge - second.pose.translation).torque;
            let axis = second.pose.transform_vector(tool.joint.in_second.rotation * DVec3::Z);
            let felt = last.gripper - last.stop;
            assert!(
                (felt - moment.dot(axis)).abs() < 1e-6,
                "{felt} N·m felt, {} N·m there",
                moment.dot(axis)
            );
            assert!(last.gripper > 0.02, "{} N·m", last.gripper);
        }
    }
}

#[test]
fn the_hinge_stays_within_its_limits() {
    for stiffness in [10.0, 100.0, 1e5] {
        let limits = JointLimits { low: 0.05, high: 0.8, stiffness };
        let tool = light_forceps(limits);
        let mut scene = Scene::free(tool);
        let (composite, centre) = tool.composite(0.3);
        let about_centre = Pose::from_translation(-centre);
        scene.coupling = VirtualCoupling {
            grasp: Pose::IDENTITY,
            ..VirtualCoupling::critically_damped(&composite, about_centre, 200.0, 0.6)
        };
        scene.grip = GripperCoupling { max_torque: 0.1, ..GripperCoupling::critically_damped(&tool, 0.5) };
        let mut state = ArticulatedState { rate: 20.0, ..ArticulatedState::at_rest(Pose::IDENTITY, 0.3) };
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for i in 0..3000 {
            scene.gripper = GripperMotion::at_rest(if i % 1000 < 500 { 3.0 } else { -3.0 });
            let step = scene.step(&state, STEP);
            assert!(step.status.is_ok(), "{:?}", step.status);
            state = step.state;
            if i > 100 {
                (low, high) = (low.min(state.angle), high.max(state.angle));
            }
            if i % 500 == 499 {
                // At rest against a stop, it holds the gripper's torque.
                assert!((step.stop - step.gripper).abs() < 1e-9, "{} and {} N·m", step.stop, step.gripper);
                assert!((step.stop.abs() - 0.1).abs() < 1e-9, "{} N·m", step.stop);
            }
        }
        // The torque over the stop's stiffness, and as much again for the impact.
        let give = 2.0 * 0.1 / stiffness + 1e-6;
        assert!(
            low > limits.low - give && high < limits.high + give,
            "{low} to {high} at {stiffness} N·m/rad"
        );
    }
}

/// Random tools, contacts and states, as harsh as those that one body is tested with: steps end and nothing
/// attracts.
#[test]
fn the_active_set_never_attracts_and_always_ends() {
    let seed = 126;
    let mut rng = StdRng::seed_from_u64(seed);
    let (mut most, mut unsettled, mut dropped) = (0, 0, 0);
    let cases = 4000;
    for case in 0..cases {
        let limits = JointLimits { low: -0.2, high: 0.2, stiffness: 100.0 };
        let mass = rng.random_range(0.001..0.2);
        let tool = random_tool(&mut rng, mass, limits);
        let state = random_state(&mut rng, 1.0, 30.0);
        let mut scene = Scene::free(tool);
        let (composite, centre) = tool.composite(state.angle);
        let grasp = random_pose(&mut rng, 0.1);
        let about_centre = Pose::new(grasp.translation - centre, grasp.rotation);
        scene.coupling = VirtualCoupling {
            grasp,
            ..VirtualCoupling::critically_damped(&composite, about_centre, 200.0, 0.6)
        };
        let displaced = Twist::new(random_vector(&mut rng, 0.03), random_vector(&mut rng, 1.0));
        scene.device = DeviceMotion::at_rest((state.first.pose * grasp).moved(&displaced, 1.0));
        scene.grip = GripperCoupling::critically_damped(&tool, 0.5);
        scene.gripper = GripperMotion::at_rest(rng.random_range(-1.0..1.0));
        let parameters = ContactParameters {
            stiffness: rng.random_range(100.0..20_000.0),
            damping: rng.random_range(0.0..30.0),
            tolerance: 0.001,
            friction: Friction::coulomb([0.0, 0.4, 2.0][case % 3]),
        };
        let poses = [state.first.pose, tool.second(&state).pose];
        scene.contacts = poses.map(|pose| {
            let contacts: Vec<_> = (0..rng.random_range(0..=16))
                .map(|_| {
                    let normal = random_vector(&mut rng, 1.0).normalize();
                    contact(&pose, random_vector(&mut rng, 0.1), normal, rng.random_range(-0.003..0.003))
                })
                .collect();
            LinearContactModel::from_contacts(contacts, &pose, &parameters, 0.0)
        });
        let step = scene.step(&state, STEP);
        assert!(step.status.failure.is_none(), "seed {seed}, case {case}: {:?}", step.status);
        most = most.max(step.status.solves);
        unsettled += usize::from(step.status.active_set_unsettled);
        dropped += usize::from(step.status.geometric_stiffness_dropped);
        // With no friction, a body is only ever pushed along its contacts' normals.
        if !parameters.friction.is_some() {
            let second = tool.second(&step.state);
            for (body, wrench, model) in [
                (step.state.first, step.contacts[0], &scene.contacts[0]),
                (second, step.contacts[1], &scene.contacts[1]),
            ] {
                assert!(
                    model.evaluate(&body).wrench == wrench
                        || (model.evaluate(&body).wrench - wrench).force.length() < 1e-9
                );
            }
        }
    }
    println!(
        "most solves {most}, unsettled {unsettled} and geometric stiffness dropped {dropped} of {cases}"
    );
    assert!(most <= MAX_ARTICULATED_SOLVES);
    assert!(unsettled * 50 < cases, "{unsettled} of {cases} active sets did not settle");
}

/// From rest, springs, contacts and weight give the tool no more energy than they hold.
#[test]
fn energy_never_grows_in_contact_from_rest() {
    let seed = 127;
    let mut rng = StdRng::seed_from_u64(seed);
    let mut touched = 0;
    for case in 0..100 {
        let mass = [0.001, 0.05][case % 2];
        let limits = JointLimits { low: -0.1, high: 0.1, stiffness: 50.0 };
        let tool = random_tool(&mut rng, mass, limits);
        let start = ArticulatedState::at_rest(random_pose(&mut rng, 0.2), rng.random_range(-0.12..0.12));
        let mut scene = Scene::free(tool);
        let (composite, centre) = tool.composite(start.angle);
        let grasp = random_pose(&mut rng, 0.03);
        let about_centre = Pose::new(grasp.translation - centre, grasp.rotation);
        scene.coupling = VirtualCoupling {
            grasp,
            ..VirtualCoupling::critically_damped(&composite, about_centre, 200.0, 0.6)
        };
        let displaced = Twist::new(random_vector(&mut rng, 0.005), random_vector(&mut rng, 0.1));
        scene.device = DeviceMotion::at_rest((start.first.pose * grasp).moved(&displaced, 1.0));
        scene.grip = GripperCoupling::critically_damped(&tool, 0.5);
        scene.gripper = GripperMotion::at_rest(start.angle + rng.random_range(-0.2..0.2));
        scene.gravity = DVec3::NEG_Z * 9.81;
        let parameters = ContactParameters {
            stiffness: rng.random_range(200.0..10_000.0),
            damping: rng.random_range(0.0..2.0),
            tolerance: 0.0005,
            friction: Friction::NONE,
        };
        let poses = [start.first.pose, tool.second(&start).pose];
        scene.contacts = poses.map(|pose| random_contacts(&mut rng, &pose, &parameters));
        let stored = |s: &ArticulatedState| {
            let beyond = (s.angle - limits.high).max(limits.low - s.angle).max(0.0);
            scene.contacts[0].potential_energy(&s.first.pose)
                + scene.contacts[1].potential_energy(&tool.second(s).pose)
                + scene.coupling.potential_energy(&s.first, &scene.device)
                + scene.grip.potential_energy(s, &scene.gripper)
                + 0.5 * limits.stiffness * beyond * beyond
        };
        let energy_of = |s: &ArticulatedState| {
            let second = tool.second(s);
            let height =
                tool.first.mass * s.first.pose.translation.z + tool.second.mass * second.pose.translation.z;
            tool.kinetic_energy(s) + stored(s) + 9.81 * height
        };
        let (scale, first) = (stored(&start), energy_of(&start));
        let mut state = start;
        for i in 0..1000 {
            let step = scene.step(&state, STEP);
            assert!(step.status.failure.is_none());
            state = step.state;
            touched += usize::from(step.active != [0; 2]);
            let gain = energy_of(&state) - first;
            assert!(gain <= 1e-9 * scale, "seed {seed}, case {case}, step {i}: gained {gain} J of {scale} J");
        }
        let speed = state.first.twist.linear.length();
        assert!(speed < 1e-3, "seed {seed}, case {case}: {speed} m/s at the end");
    }
    assert!(touched > 10_000);
}

/// Numbers of every kind in every input: each step is finite or reports why it was not taken, and none
/// panics.
#[test]
fn unusable_inputs_are_refused() {
    let limits = JointLimits { low: 0.0, high: 1.0, stiffness: 100.0 };
    let tool = light_forceps(limits);
    let usable = || {
        let mut scene = Scene::free(tool);
        scene.coupling =
            VirtualCoupling::critically_damped(&tool.composite(0.3).0, Pose::IDENTITY, 200.0, 0.6);
        scene.grip = GripperCoupling::critically_damped(&tool, 0.5);
        scene
    };
    let state = ArticulatedState::at_rest(Pose::IDENTITY, 0.3);
    assert!(usable().step(&state, STEP).status.is_ok());
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let mut scene = usable();
        scene.gripper.angle = bad;
        let step = scene.step(&state, STEP);
        assert_eq!((step.status.failure, step.state, step.gripper), (Some(StepFailure::Device), state, 0.0));
        scene.gripper = GripperMotion { angle: 0.0, rate: bad };
        assert_eq!(scene.step(&state, STEP).status.failure, Some(StepFailure::Device));
        let mut scene = usable();
        scene.device.twist.linear.y = bad;
        assert_eq!(scene.step(&state, STEP).status.failure, Some(StepFailure::Device));
        let mut scene = usable();
        scene.grip.stiffness = bad;
        assert!(scene.step(&state, STEP).status.failure.is_some());
        let mut scene = usable();
        scene.gravity.x = bad;
        assert!(scene.step(&state, STEP).status.failure.is_some());
        assert_eq!(usable().step(&state, bad).status.failure, Some(StepFailure::TimeStep));
        let lost = usable().step(&ArticulatedState { angle: bad, ..state }, STEP);
        assert_eq!(lost.status.failure, Some(StepFailure::State));
        assert!(lost.state.is_valid() && (limits.low..=limits.high).contains(&lost.state.angle));
    }
    let seed = 128;
    let mut rng = StdRng::seed_from_u64(seed);
    let (mut taken, cases) = (0, 20_000);
    for _ in 0..cases {
        let mut any = || {
            let size = [1e-3, 1.0, 1e3, 1e9, 1e150, 1e308][rng.random_range(0..6)];
            match rng.random_range(0..60) {
                0 => f64::NAN,
                1 => f64::INFINITY,
                2 => 0.0,
                _ => rng.random_range(-1.0..1.0) * size,
            }
        };
        let mut scene = usable();
        let mut state = state;
        (state.angle, state.rate, state.first.twist.angular.x) = (any(), any(), any());
        (scene.gripper.angle, scene.gripper.rate) = (any(), any());
        (scene.grip.stiffness, scene.grip.damping, scene.grip.max_torque) = (any(), any(), any());
        let touch = contact(&Pose::IDENTITY, DVec3::new(any(), 0.01, 0.0), DVec3::Y, any());
        let parameters = ContactParameters {
            stiffness: any(),
            damping: any(),
            tolerance: any(),
            friction: Friction::NONE,
        };
        scene.contacts[1] = LinearContactModel::from_contacts([touch], &Pose::IDENTITY, &parameters, 0.0);
        let step = scene.step(&state, any().abs());
        assert!(
            step.state.is_valid()
                && step.coupling.is_finite()
                && step.gripper.is_finite()
                && step.stop.is_finite()
        );
        assert!(step.contacts.iter().all(Wrench::is_finite));
        taken += usize::from(step.status.failure.is_none());
    }
    println!("{taken} steps taken of {cases}");
    assert!(taken > 1000 && cases - taken > 1000);
}

/// Constraints of a body at a pose, with gaps that a step may close, and overlaps.
fn random_constraints(rng: &mut StdRng, count: usize, friction: f64) -> Vec<Constraint> {
    let random = |rng: &mut StdRng| Constraint {
        arm: random_vector(rng, 0.03),
        normal: random_vector(rng, 1.0).normalize(),
        gap: rng.random_range(-2e-5..1e-4),
        velocity: random_vector(rng, 0.02),
        friction,
        ..Constraint::new(DVec3::ZERO, DVec3::ZERO, 0.0)
    };
    (0..count).map(|_| random(rng)).collect()
}

const NO_BOUNDS: [MotionBound; 2] = [MotionBound::NONE; 2];

/// A tool whose hinge is held moves as one body does under the same constraints.
#[test]
fn with_its_hinge_held_a_tool_meets_surfaces_as_one_body() {
    let seed = 131;
    let mut rng = StdRng::seed_from_u64(seed);
    let mut pushing = 0;
    for case in 0..200 {
        let tool = random_tool(&mut rng, 0.05, FREE);
        let state = ArticulatedState { rate: 0.0, ..random_state(&mut rng, 0.1, 2.0) };
        let Whole { scene, body, centre, coupling: one, state: whole } =
            Whole::random(&mut rng, tool, &state, (1e9, 1e7));
        let friction = [0.0, 0.3][case % 2];
        let [mut first, mut second] = [0, 1].map(|_| random_constraints(&mut rng, 4, friction));
        let from_centre = |center: DVec3| {
            move |contact: &Constraint| Constraint {
                arm: contact.arm + center - whole.pose.translation,
                ..*contact
            }
        };
        let centers = [state.first.pose.translation, tool.second(&state).pose.translation];
        let mut all: Vec<_> = first.iter().map(from_centre(centers[0])).collect();
        all.extend(second.iter().map(from_centre(centers[1])));
        let recovery = Recovery { speed: rng.random_range(0.0..0.02), scale: 1.0 };
        let found = constrained_articulated_step(
            &scene.frame(),
            &state,
            [&mut first, &mut second],
            &[],
            &NO_BOUNDS,
            &recovery,
            STEP,
        );
        let contacts = no_contacts();
        let frame = Frame {
            body: &body,
            device: &scene.device,
            coupling: &one,
            contacts: &contacts,
            gravity: DVec3::ZERO,
        };
        let single = constrained_step(&frame, &whole, &mut all, &[], &MotionBound::NONE, &recovery, STEP);
        let (found, single) = (found.step, single.step);
        assert!(found.status.failure.is_none() && single.status.failure.is_none());
        let here = found.state.first.twist.velocity_at(found.state.first.pose.transform_vector(centre));
        let size = single.state.twist.linear.length() + 0.03 * single.state.twist.angular.length();
        let off = here.distance(single.state.twist.linear)
            + 0.03 * found.state.first.twist.angular.distance(single.state.twist.angular);
        assert!(off < 2e-3 * size, "seed {seed}, case {case}: off by {off} of {size} m/s");
        pushing += all.iter().filter(|contact| contact.impulse != DVec3::ZERO).count();
    }
    assert!(pushing > 300, "{pushing} contacts push");
}

/// Two blades close on a plate that stands still: no contact is passed, in any step, and the hinge holds.
#[test]
fn blades_that_close_do_not_pass() {
    let limits = JointLimits { low: -1.0, high: 1.0, stiffness: 10.0 };
    let tool = light_forceps(limits);
    let mut scene = Scene::free(tool);
    scene.coupling = VirtualCoupling::critically_damped(&tool.first, Pose::IDENTITY, 500.0, 0.5);
    scene.grip = GripperCoupling::critically_damped(&tool, 0.5);
    let mut state = ArticulatedState { first: BodyState::default(), angle: 0.2, rate: 0.0 };
    scene.device = DeviceMotion::at_rest(state.first.pose);
    scene.gripper = GripperMotion::at_rest(-0.3);
    // A surface in the way of a point of each body, in the direction in which it moves with the hinge.
    let axis = tool.joint.in_first.rotation * DVec3::Z;
    let hinge = tool.joint.in_first.translation;
    let start = tool.second(&state);
    let tip = start.pose.translation;
    let along = -axis.cross(tip - hinge).normalize();
    let surface = tip + along * 1e-3;
    let (mut impulse, mut recovery) = (DVec3::ZERO, Recovery::at_scale(1.0));
    let (mut deepest, mut force) = (f64::INFINITY, 0.0);
    for _ in 0..1000 {
        let second = tool.second(&state).pose.translation;
        let gap = (surface - second).dot(along);
        let mut contacts = [Constraint { impulse, ..Constraint::new(DVec3::ZERO, along, gap) }];
        let found = constrained_articulated_step(
            &scene.frame(),
            &state,
            [&mut [], &mut contacts],
            &[],
            &NO_BOUNDS,
            &recovery,
            STEP,
        );
        let step = found.step;
        assert!(step.status.failure.is_none());
        (state, impulse, recovery.speed) = (step.state, contacts[0].impulse, found.recovery);
        deepest = deepest.min((surface - tool.second(&state).pose.translation).dot(along));
        force = step.contacts[1].force.length();
    }
    // A contact yields by a ten-thousandth of the velocity that it takes off in a step.
    assert!(deepest > -4e-5, "{deepest} m");
    let lever = axis.cross(tool.second(&state).pose.translation - hinge).length();
    let torque = scene.grip.torque(&state, &scene.gripper).abs();
    assert!((force * lever - torque).abs() < 0.01 * torque, "{force} N at {lever} m, and {torque} N·m");
}

/// Blades that walls overlap on opposite sides, with normals that are a little off, are held without force;
/// if each is overlapped from inside alone, they open.
#[test]
fn blades_in_a_press_fit_stay_and_blades_that_overlap_what_they_grip_open() {
    let tool = light_forceps(FREE);
    let start = ArticulatedState { first: BodyState::default(), angle: 0.2, rate: 0.0 };
    let axis = tool.joint.in_first.rotation * DVec3::Z;
    let hinge = tool.joint.in_first.translation;
    // The directions in which the blades close: that of the first is opposite.
    let closing = |state: &ArticulatedState| {
        let second = tool.second(state).pose.translation;
        -axis.cross(second - hinge).normalize()
    };
    let wall = |side: f64, along: DVec3, overlap: f64, off: f64| {
        Constraint::new(DVec3::ZERO, (along * side + axis * off).normalize(), -overlap)
    };
    for pressed in [true, false] {
        let mut scene = Scene::free(tool);
        scene.coupling = VirtualCoupling::critically_damped(&tool.first, Pose::IDENTITY, 500.0, 0.5);
        scene.grip = GripperCoupling::critically_damped(&tool, 0.5);
        scene.device = DeviceMotion::at_rest(start.first.pose);
        scene.gripper = GripperMotion::at_rest(start.angle);
        let (mut state, mut recovery, mut strongest) = (start, Recovery::at_scale(1.0), 0.0_f64);
        let along = closing(&start);
        let tips = [start.first.pose.translation, tool.second(&start).pose.translation];
        for _ in 0..200 {
            let now = [state.first.pose.translation, tool.second(&state).pose.translation];
            let contacts = |body: usize, inner: f64| {
                let gone = (now[body] - tips[body]).dot(along);
                let inside = wall(inner, along, 1e-5 + inner * gone, 0.02);
                let outside = wall(-inner, along, 1e-5 - inner * gone, 0.02);
                [inside, if pressed { outside } else { inside }]
            };
            let [mut first, mut second] = [contacts(0, -1.0), contacts(1, 1.0)];
            let found = constrained_articulated_step(
                &scene.frame(),
                &state,
                [&mut first, &mut second],
                &[],
                &NO_BOUNDS,
                &recovery,
                STEP,
            );
            assert!(found.step.status.failure.is_none());
            (state, recovery.speed) = (found.step.state, found.recovery);
            let forces = first.iter().chain(&second).map(|contact| contact.impulse.length() / STEP);
            strongest = strongest.max(forces.sum());
        }
        let strayed = state.first.pose.translation.distance(tips[0]);
        if pressed {
            assert!(strayed < 1e-7 && strongest < 0.1, "strays by {strayed} m, {strongest} N");
        } else {
            let gone = (tool.second(&state).pose.translation - tips[1]).dot(-along);
            assert!(gone > 0.8e-5 && gone < 1.2e-5, "{gone} m of 10 µm");
            assert!(strongest < 10.0, "{strongest} N");
        }
    }
}
