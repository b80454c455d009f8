//! Shared by the tests: a world and a session that touches it, stepped in one thread.

#![allow(dead_code, reason = "not every test needs everything")]

use palpate::clod_build::unwatched;
use palpate::device::{DeviceState, Emulation, IntendedPath, Status};
use palpate::dynamics::{BodyState, DeviceMotion};
use palpate::glam::{DMat3, DVec3};
use palpate::settings::{ContactSettings, Response};
use palpate::{
    ContactLoop, HapticLoop, HapticRenderer, Object, OpenOptions, Pose, Reactions, Record, Scene,
    SceneEditor, Settings, TriMesh, Twist,
};
use palpate_rapier::TouchedBodies;
use palpate_rapier::rapier3d::prelude::{PhysicsWorld, RigidBodyHandle, Vector};

/// Period of the haptic loop, s.
pub const PERIOD: f64 = 1e-3;
/// Haptic steps per contact step.
const STRIDE: u32 = 2;

type Hand = Box<dyn Fn(f64) -> (Pose, Twist)>;

/// World, and a session with it.
pub struct Session {
    pub world: PhysicsWorld,
    pub touched: TouchedBodies,
    pub scene: SceneEditor,
    pub reactions: Reactions,
    haptic: HapticLoop,
    contact: ContactLoop,
    probe: Object,
    mass: f64,
    hand: Hand,
    /// Haptic steps per step of the world, and their number so far.
    pub every: u32,
    pub steps: u32,
}

impl Session {
    /// Returns a session with a world that is stepped every so many milliseconds, and a hand with a position
    /// (m) and velocity (m/s) at a time (s).
    pub fn new(
        world: PhysicsWorld,
        every: u32,
        probe: &Object,
        hand: impl Fn(f64) -> (DVec3, DVec3) + 'static,
    ) -> Self {
        Self::with(Response::default(), world, every, probe, hand)
    }

    /// The same with a response to contacts.
    pub fn with(
        response: Response,
        mut world: PhysicsWorld,
        every: u32,
        probe: &Object,
        hand: impl Fn(f64) -> (DVec3, DVec3) + 'static,
    ) -> Self {
        let dt = f64::from(every) * PERIOD;
        world.integration_parameters.dt = dt as f32;
        let hand = move |time: f64| {
            let (place, velocity) = hand(time);
            (Pose::from_translation(place), Twist::new(velocity, DVec3::ZERO))
        };
        let device = Emulation::default().open(IntendedPath::from(hand(0.0).0)).expect("an emulated device");
        let contact = ContactSettings { response, ..ContactSettings::default() };
        let settings = Settings { contact, ..Settings::default() };
        let renderer = HapticRenderer::new(probe.clone(), Scene::new(), Box::new(device), settings);
        let mut renderer = renderer.expect("a session");
        let (scene, reactions) = (renderer.scene_editor(), renderer.reactions());
        let (haptic, contact, _) = renderer.into_loops();
        let (probe, mass, hand) = (probe.clone(), settings.tool.mass, Box::new(hand));
        let touched = TouchedBodies::new(dt, world.gravity);
        Self { world, touched, scene, reactions, haptic, contact, probe, mass, hand, every, steps: 0 }
    }

    /// Adds a body to the session.
    pub fn touch(&mut self, body: RigidBodyHandle, object: &Object) {
        self.touched.add(&mut self.scene, &self.world.bodies, body, object).expect("it can be added");
    }

    pub fn now(&self) -> f64 {
        PERIOD * f64::from(self.steps)
    }

    /// Takes a haptic step, and one of the world when it is due.
    pub fn step(&mut self) -> Record {
        let body: BodyState = *self.haptic.body_state();
        let update = self.steps.is_multiple_of(STRIDE).then(|| self.contact.step(&body, self.now()));
        self.steps += 1;
        let now = self.now();
        let (pose, twist) = (self.hand)(now);
        let device = DeviceState { time: now, pose, twist, buttons: 0, status: Status::OK };
        let record = self.haptic.step(&device, now, PERIOD);
        if let Some(update) = update {
            self.haptic.update_contacts(&update);
        }
        if self.steps.is_multiple_of(self.every) {
            self.touched.before_step(&mut self.reactions, &mut self.world.bodies);
            self.world.step();
            self.touched.after_step(&mut self.scene, &self.world.bodies).expect("room");
        }
        record
    }

    /// Returns the grasped object's centre of mass, m.
    pub fn probe_center(&self) -> DVec3 {
        self.haptic.body_state().pose.translation
    }

    /// Returns the kinetic energy of the grasped object plus the energy in its coupling to the hand, J.
    pub fn hand_energy(&self) -> f64 {
        let state = self.haptic.body_state();
        let turn = DMat3::from_quat(state.pose.rotation);
        let inertia = self.probe.clod.source.unit_inertia * self.mass;
        let spin = turn * inertia * turn.transpose() * state.twist.angular;
        let moving = 0.5 * (self.mass * state.twist.linear.length_squared() + state.twist.angular.dot(spin));
        let (pose, twist) = (self.hand)(self.now());
        let grasp = pose * Pose::from_translation(self.probe.clod.source.center_of_mass);
        moving + self.haptic.coupling().potential_energy(state, &DeviceMotion { pose: grasp, twist })
    }

    /// Returns the kinetic energy of all dynamic bodies, J.
    pub fn world_energy(&self) -> f64 {
        self.world.bodies.iter().map(|(_, body)| f64::from(body.kinetic_energy())).sum()
    }

    /// Returns momentum of a body, and its angular momentum about the world's origin.
    pub fn momentum(&self, body: RigidBodyHandle) -> (DVec3, DVec3) {
        let body = &self.world.bodies[body];
        let properties = body.mass_properties();
        let linear = vector(body.linvel()) * f64::from(body.mass());
        let inertia = properties.local_mprops.reconstruct_inertia_matrix();
        let angular = *body.rotation() * (inertia * (body.rotation().inverse() * body.angvel()));
        (linear, vector(angular) + vector(properties.world_com).cross(linear))
    }
}

pub fn vector(v: Vector) -> DVec3 {
    DVec3::new(v.x.into(), v.y.into(), v.z.into())
}

/// Returns a world of small objects.
pub fn world(gravity: f32) -> PhysicsWorld {
    let mut world = PhysicsWorld { gravity: Vector::new(0.0, 0.0, -gravity), ..PhysicsWorld::default() };
    world.integration_parameters.length_unit = 0.02;
    world
}

/// Returns a box about the origin.
pub fn cuboid(size: DVec3) -> Object {
    let half = size * 0.5;
    let sign = |bit: usize| if bit == 0 { -1.0 } else { 1.0 };
    let vertices = (0..8).map(|i| half * DVec3::new(sign(i & 1), sign(i >> 1 & 1), sign(i >> 2))).collect();
    let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let triangles = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    let mesh = TriMesh::new(vertices, triangles).expect("a mesh");
    Object::from_mesh("box", &mesh).expect("a hierarchy")
}

/// Returns a built-in model with a newly built hierarchy.
pub fn model(name: &str) -> Object {
    let options = OpenOptions { cache: false, ..OpenOptions::default() };
    Object::open(name, &options, &mut unwatched).expect("a model")
}

/// Returns how far an object extends below its frame along z, m.
pub fn bottom(object: &Object) -> f64 {
    let surface = object.clod.leaves().iter().flat_map(|leaf| object.clod.hull(leaf));
    surface.map(|v| v.z).fold(f64::INFINITY, f64::min)
}
