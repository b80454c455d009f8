//! Haptic steps of sessions whose contacts are constraints, recorded once and replayed: with contact geometry
//! as queries at 500 Hz found it, so that only haptic steps are timed.

use std::hint::black_box;
use std::time::{Duration, Instant};

use palpate::device::{DeviceState, Emulation, Status};
use palpate::dynamics::BodyState;
use palpate::glam::{DQuat, DVec3};
use palpate::models::{Model, PegFit};
use palpate::settings::{ContactSettings, Response, ToolSettings};
use palpate::telemetry::{Percentiles, Times};
use palpate::{
    ContactLoop, ContactUpdate, HandlePlacement, HapticLoop, HapticRenderer, Object, Pose, Record, Scene,
    Settings, TriMesh, Twist,
};

/// Period of the haptic loop, s.
const STEP: f64 = 1e-3;
/// Density of steel, kg/m³.
const STEEL: f64 = 7850.0;
/// Number of steps that are replayed.
const REPLAYED: u32 = 1000;
/// Height of a golf ball over another one, 42.7 mm in diameter, m.
const DEEP_HEIGHT: f64 = 0.0377;
/// Triangles of a body that overlaps with another one.
const DETAIL: usize = 20_000;

/// What a hand does with an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Task {
    /// A peg that touches nothing.
    Free,
    /// A prism that is pressed on a plate at 16 corners and moved in a circle.
    Sliding,
    /// A peg that is held aslant in its hole and moved up and down.
    Peg,
    /// A golf ball that starts 5 mm deep in another one, and is turned there.
    Deep,
    /// An ellipsoid that starts where another one is.
    Inside,
}

impl Task {
    /// All tasks.
    pub const ALL: [Self; 5] = [Self::Free, Self::Sliding, Self::Peg, Self::Deep, Self::Inside];

    /// Name of the task.
    pub fn name(self) -> &'static str {
        match self {
            Self::Free => "free",
            Self::Sliding => "sliding",
            Self::Peg => "peg",
            Self::Deep => "deep",
            Self::Inside => "inside",
        }
    }

    /// Steps before those that are replayed.
    fn before(self) -> u32 {
        match self {
            Self::Free | Self::Sliding | Self::Peg => 500,
            Self::Deep | Self::Inside => 0,
        }
    }

    /// Object in the hand, and the scene's.
    fn objects(self) -> [Object; 2] {
        let fit = PegFit::LOOSE_8_MM;
        let generated = |model: Model, triangles: usize| model.generate(triangles).expect("a model");
        let [held, fixed] = match self {
            Self::Sliding => [prism(16), generated(Model::Plate, Model::Plate.default_triangles())],
            Self::Deep => [generated(Model::GolfBall, DETAIL), generated(Model::GolfBall, DETAIL)],
            Self::Inside => [generated(Model::Ellipsoid, 500), generated(Model::Ellipsoid, 500)],
            Self::Free | Self::Peg => [fit.peg(1000).expect("a peg"), fit.hole(1200).expect("a hole")],
        };
        [("held", held), ("fixed", fixed)]
            .map(|(name, mesh)| Object::from_mesh(name, &mesh).expect("a solid"))
    }

    /// Pose of the object's mesh that the hand intends at a time (s).
    fn intended(self, time: f64) -> Pose {
        let phase = 2.0 * std::f64::consts::TAU * time;
        let (sin, cos) = phase.sin_cos();
        let lowered = (time / 0.3).min(1.0);
        match self {
            Self::Free => Pose::from_translation(DVec3::new(1e-3 * cos, 1e-3 * sin, 0.01)),
            // Beside the diagonal of the plate's upper side, so that only the corners are contacts.
            Self::Sliding => Pose::new(
                DVec3::new(0.01 + 5e-3 * cos, -0.01 + 5e-3 * sin, 1e-3 - 3e-3 * lowered),
                DQuat::from_rotation_z(0.1 * sin),
            ),
            Self::Peg => Pose::new(
                DVec3::Z * (1e-3 - 0.011 * lowered + 1e-3 * sin),
                DQuat::from_rotation_z(0.1 * cos) * DQuat::from_rotation_y(2_f64.to_radians()),
            ),
            Self::Deep => Pose::new(DVec3::Z * DEEP_HEIGHT, DQuat::from_rotation_z(0.1 * sin)),
            Self::Inside => Pose::IDENTITY,
        }
    }
}

/// A prism of 16 mm across and high with a base of some corners at z = 0, m.
fn prism(corners: u32) -> TriMesh {
    let around =
        |i: u32| DQuat::from_rotation_z(std::f64::consts::TAU * f64::from(i) / f64::from(corners)) * DVec3::X;
    let rings = [0.0, 0.016].map(|height| (0..corners).map(move |i| around(i) * 0.008 + DVec3::Z * height));
    let vertices: Vec<DVec3> = rings.into_iter().flatten().collect();
    let sides = (0..corners).flat_map(|i| {
        let (next, up) = ((i + 1) % corners, corners);
        [[i, next, next + up], [i, next + up, i + up]]
    });
    let caps = (1..corners - 1).flat_map(|i| [[0, i + 1, i], [corners, corners + i, corners + i + 1]]);
    TriMesh::new(vertices, sides.chain(caps).collect()).expect("a mesh")
}

/// A recorded session.
#[derive(Debug)]
pub struct Replay {
    start: HapticLoop,
    haptic: HapticLoop,
    steps: Vec<(DeviceState, Option<ContactUpdate>)>,
    next: usize,
    /// Mean number of contacts in a step.
    pub contacts: f64,
    /// Mean force of the contacts on the object, N.
    pub force: f64,
    /// The contact loop, and the states of the object for which it was asked.
    contact: ContactLoop,
    states: Vec<BodyState>,
    asked: u32,
}

impl Replay {
    /// Records a session of a task. In every other step a query ends that began in the one before.
    pub fn record(task: Task) -> Self {
        let [held, fixed] = task.objects();
        let mass = STEEL * held.clod.source.volume;
        let settings = Settings {
            contact: ContactSettings {
                response: Response::Constraints,
                friction: 0.1,
                ..ContactSettings::default()
            },
            tool: ToolSettings { mass, ..ToolSettings::default() },
            ..Settings::default()
        };
        let placement = HandlePlacement::new(&settings, &held, &Emulation::default().specification);
        let state = |time: f64| {
            let at = |time: f64| placement.device_pose(&task.intended(time));
            let (pose, before) = (at(time), at(time - STEP));
            let moved = (pose.translation - before.translation) / STEP;
            let twist = Twist::new(moved, before.rotation_vector_to(&pose) / STEP);
            DeviceState { time, pose, twist, buttons: 0, status: Status::OK }
        };
        let device = Emulation::default().open(state(0.0).pose).expect("an emulated device");
        let scene = Scene::new().with(fixed, Pose::IDENTITY);
        let renderer = HapticRenderer::new(held, scene, Box::new(device), settings).expect("a renderer");
        let (mut haptic, contact, _) = renderer.into_loops();
        let mut made = Self {
            start: haptic.clone(),
            haptic: haptic.clone(),
            steps: Vec::new(),
            next: 0,
            contacts: 0.0,
            force: 0.0,
            contact,
            states: Vec::new(),
            asked: 0,
        };
        let mut found = None;
        for step in 1..=task.before() + REPLAYED {
            let time = STEP * f64::from(step);
            let state = state(time);
            let update = found.take();
            if step % 2 == 0 {
                let body = *haptic.body_state();
                found = Some(made.contact.step(&body, time - STEP));
                made.asked = step;
                if step > task.before() {
                    made.states.push(body);
                }
            }
            if step == task.before() + 1 {
                made.start = haptic.clone();
            }
            let record = take(&mut haptic, &state, update.as_ref());
            if step > task.before() {
                made.contacts += f64::from(record.contacts) / f64::from(REPLAYED);
                made.force += record.contact.force.length() / f64::from(REPLAYED);
                made.steps.push((state, update));
            }
        }
        made.haptic = made.start.clone();
        made
    }

    /// Replays the next step, with the contact geometry that arrives in it. Returns the time that it took.
    pub fn step(&mut self) -> Duration {
        if self.next == self.steps.len() {
            self.haptic.clone_from(&self.start);
            // What was copied is not in the caches that a session's steps find it in: not timed.
            let (state, update) = &self.steps[0];
            take(&mut self.haptic, state, update.as_ref());
            self.next = 1;
        }
        let (state, update) = &self.steps[self.next];
        self.next += 1;
        let begun = Instant::now();
        black_box(take(black_box(&mut self.haptic), state, update.as_ref()));
        begun.elapsed()
    }

    /// Takes the contact loop's next step, for the states to and fro. Returns the time that it took.
    pub fn query(&mut self) -> Duration {
        self.asked += 2;
        let count = self.states.len();
        let index = (self.asked / 2) as usize % (2 * count);
        let body = &self.states[index.min(2 * count - 1 - index)];
        let begun = Instant::now();
        black_box(self.contact.step(black_box(body), STEP * f64::from(self.asked)));
        begun.elapsed()
    }

    /// Percentiles of the times of single steps, µs: of all, and of the shortest time that each step took in
    /// all replays, which is without interruptions by other programs.
    pub fn percentiles(&mut self, steps: u64) -> [Percentiles; 2] {
        let mut all = Times::new();
        let mut shortest = vec![u64::MAX; self.steps.len()];
        for _ in 0..steps {
            let time = self.step().as_nanos() as u64;
            all.record(time);
            let shortest = &mut shortest[self.next - 1];
            *shortest = time.min(*shortest);
        }
        let mut of_steps = Times::new();
        shortest.into_iter().filter(|time| *time < u64::MAX).for_each(|time| of_steps.record(time));
        [all.percentiles(1e3), of_steps.percentiles(1e3)]
    }
}

/// Takes a step of a session's haptic loop, with contact geometry that has arrived.
#[inline(never)]
fn take(haptic: &mut HapticLoop, state: &DeviceState, update: Option<&ContactUpdate>) -> Record {
    if let Some(update) = update {
        haptic.update_contacts(update);
    }
    haptic.step(state, state.time, STEP)
}
