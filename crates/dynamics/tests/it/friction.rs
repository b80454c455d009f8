//! Friction through whole motions: sticking, sliding, spinning, resting.

use glam::{DMat3, DQuat, DVec3};
use palpate_core::{Contact, Pose, Twist};
use palpate_dynamics::{
    Body, BodyState, ContactParameters, ContactPatch, DeviceMotion, Friction, LinearContactModel,
    VirtualCoupling, semi_implicit_step,
};

const STEP: f64 = 1e-3;
const GRAVITY: f64 = 9.81;
const HALF: f64 = 0.02;

/// A 100 g cube on a plane through the origin, whose contacts are found anew every few steps.
struct Resting {
    body: Body,
    state: BodyState,
    /// Normal of the plane, up.
    up: DVec3,
    parameters: ContactParameters,
    contacts: LinearContactModel,
    coupling: VirtualCoupling,
    device: DeviceMotion,
    gravity: DVec3,
}

impl Resting {
    /// Puts the cube on a plane that slopes down towards +x by `slope` (rad).
    fn new(slope: f64, friction: Friction) -> Self {
        let mass = 0.1;
        let moment = mass * (2.0 * HALF).powi(2) / 6.0;
        let body = Body::new(mass, DMat3::from_diagonal(DVec3::splat(moment))).expect("a cube");
        let turn = DQuat::from_rotation_y(slope);
        let up = turn * DVec3::Z;
        let pose = Pose::new(up * (HALF - 1e-5), turn);
        let mut resting = Self {
            body,
            state: BodyState::at_rest(pose),
            up,
            parameters: ContactParameters { stiffness: 5000.0, damping: 20.0, tolerance: 0.0, friction },
            contacts: LinearContactModel::empty(&pose, 0.0),
            coupling: VirtualCoupling::critically_damped(&body, Pose::IDENTITY, 0.0, 0.0),
            device: DeviceMotion::at_rest(pose),
            gravity: DVec3::NEG_Z * GRAVITY,
        };
        resting.find_contacts();
        resting
    }

    /// The cube's corners on the plane, found at its present pose.
    fn find_contacts(&mut self) {
        let pose = self.state.pose;
        let corner = |x: f64, y: f64| {
            let point = pose.transform_point(DVec3::new(x, y, -1.0) * HALF);
            let depth = -self.up.dot(point);
            Contact { point, scene_point: point + self.up * depth, normal: -self.up, depth }
        };
        let corners = [corner(1.0, 1.0), corner(-1.0, 1.0), corner(-1.0, -1.0), corner(1.0, -1.0)];
        let mut found = LinearContactModel::from_contacts(corners, &pose, &self.parameters, 0.0);
        found.take_over_friction(&self.contacts, &self.state);
        self.contacts = found;
    }

    fn step(&mut self) -> DVec3 {
        let Self { body, state, device, coupling, contacts, gravity, .. } = self;
        let step = semi_implicit_step(body, state, device, coupling, contacts, *gravity, STEP);
        assert!(step.status.is_ok(), "{:?}", step.status);
        self.state = step.state;
        self.contacts.settle(&self.state);
        step.contact.force
    }
}

/// On a slope below the angle of friction the cube stays; above it slides with the acceleration of
/// Coulomb's law.
#[test]
fn a_cube_on_a_slope_sticks_or_slides() {
    for coefficient in [0.2, 0.5, 1.0] {
        let angle = f64::atan(coefficient);
        let travel = |slope: f64| {
            let mut cube = Resting::new(slope, Friction::coulomb(coefficient));
            for _ in 0..200 {
                cube.step();
            }
            let start = cube.state;
            for index in 0..500 {
                if index % 3 == 0 {
                    cube.find_contacts();
                }
                cube.step();
            }
            let moved = cube.state.pose.translation - start.pose.translation;
            (moved.length(), start.twist.linear.length(), cube.state.twist.linear.length())
        };
        let (stuck, ..) = travel(0.97 * angle);
        assert!(stuck < 1e-7, "{coefficient}: stuck but moved by {stuck} m");
        let slope = 1.1 * angle;
        let (_, before, after) = travel(slope);
        let acceleration = GRAVITY * (slope.sin() - coefficient * slope.cos());
        let found = (after - before) / 0.5;
        assert!(
            (found - acceleration).abs() < 0.01 * GRAVITY * slope.sin(),
            "{coefficient}: {found} {acceleration}"
        );
    }
}

/// 60 s at rest on a slope under load, contacts found anew every other step.
#[test]
fn a_cube_at_rest_neither_creeps_nor_trembles() {
    let mut cube = Resting::new(0.3, Friction { static_coefficient: 0.6, dynamic_coefficient: 0.4 });
    for _ in 0..1000 {
        cube.step();
    }
    let start = cube.state.pose;
    let (mut sum, mut squares, mut farthest) = (DVec3::ZERO, 0.0, 0.0_f64);
    let steps = 60_000;
    for index in 0..steps {
        if index % 2 == 0 {
            cube.find_contacts();
        }
        let force = cube.step();
        sum += force;
        squares += force.length_squared();
        farthest = farthest.max(cube.state.pose.translation.distance(start.translation));
    }
    let mean = sum / f64::from(steps);
    let noise = (squares / f64::from(steps) - mean.length_squared()).max(0.0).sqrt();
    assert!((mean - DVec3::Z * (0.1 * GRAVITY)).length() < 1e-3, "{mean} N");
    assert!(noise < 1e-3, "force noise {noise} N rms");
    assert!(farthest < 1e-6, "creeps by {farthest} m");
}

/// A single contact that represents a disc: its friction torque brings a spinning body to rest like that of
/// the disc.
#[test]
fn a_patch_resists_spinning() {
    let mut cube = Resting::new(0.0, Friction::coulomb(0.5));
    let (radius, spin) = (0.01, 20.0);
    let pose = cube.state.pose;
    let point = pose.translation - cube.up * HALF;
    let depth = 0.1 * GRAVITY / cube.parameters.stiffness;
    let contact = Contact { point, scene_point: point + cube.up * depth, normal: -cube.up, depth };
    let model =
        |patch: ContactPatch| LinearContactModel::from_contacts([patch], &pose, &cube.parameters, 0.0);
    let (patch, point) = (model(ContactPatch { contact, radius }), model(contact.into()));
    for (contacts, friction_torque) in [(patch, 0.5 * 0.1 * GRAVITY * radius), (point, 0.0)] {
        cube.contacts = contacts;
        cube.state = BodyState { pose, twist: Twist::new(DVec3::ZERO, DVec3::Z * spin) };
        for _ in 0..20 {
            cube.step();
        }
        let slowed = spin - cube.state.twist.angular.z;
        let expected = friction_torque * 0.02 / cube.body.inertia.z_axis.z;
        assert!((slowed - expected).abs() < 0.05 * expected.max(0.1), "{slowed} rad/s, not {expected}");
    }
}

/// Dragged slowly by a spring until it slides and beyond: the force rises and does not jump when the contact
/// breaks away.
#[test]
fn breaking_away_makes_no_jump() {
    let mut cube = Resting::new(0.0, Friction { static_coefficient: 0.6, dynamic_coefficient: 0.45 });
    cube.coupling = VirtualCoupling::critically_damped(&cube.body, Pose::IDENTITY, 300.0, 3.0);
    for _ in 0..200 {
        cube.step();
    }
    let speed = 0.02;
    cube.device = DeviceMotion { pose: cube.state.pose, twist: Twist::new(DVec3::X * speed, DVec3::ZERO) };
    let (mut last, mut largest, mut most) = (cube.step(), 0.0_f64, 0.0_f64);
    for index in 0..1000 {
        cube.device.pose.translation.x += speed * STEP;
        if index % 2 == 0 {
            cube.find_contacts();
        }
        let force = cube.step();
        largest = largest.max((force - last).length());
        most = most.max(-force.x);
        last = force;
    }
    let weight = 0.1 * GRAVITY;
    assert!(cube.state.twist.linear.x > 0.5 * speed, "it slides");
    assert!(most < 0.62 * weight && most > 0.5 * weight, "{most} N at most");
    assert!((-last.x / weight - 0.46).abs() < 0.03, "{} of its weight", -last.x / weight);
    assert!(largest < 0.08 * weight, "a jump of {largest} N");
}

/// Thrown about on the plane without a hand, a cube never gains energy.
#[test]
fn friction_takes_energy_away() {
    let mut cube = Resting::new(0.0, Friction { static_coefficient: 0.8, dynamic_coefficient: 0.5 });
    for _ in 0..200 {
        cube.step();
    }
    cube.state.twist = Twist::new(DVec3::new(0.3, -0.2, 0.0), DVec3::new(0.0, 0.0, 8.0));
    let kinetic = |cube: &Resting| cube.body.kinetic_energy(&cube.state);
    let start = kinetic(&cube);
    let mut least = start;
    for index in 0..2000 {
        if index % 4 == 0 {
            cube.find_contacts();
        }
        cube.step();
        let now = kinetic(&cube);
        // The energy of the springs at the Coulomb limit, (μ m g)² / 2 k, may come back.
        assert!(now < start * 1.001 && now < least + 5e-5, "step {index}: {now} J after {least}");
        least = least.min(now);
    }
    assert!(least < 1e-9, "{least} J left");
}
