//! A hand holds a spoon: it pushes a stack of boxes from the side, pushes a gear away, and levers up a bar
//! that lies over the edge of a plinth. The spoon is palpate's; all that it touches are bodies of a rapier
//! world.
//!
//! `cargo run --release -p palpate-rapier --example stack_of_boxes`, with `-- FILE` or another model's name
//! in place of the gear, and with `-- --realtime` in real time: the session then runs in threads of its own,
//! and the world in the main thread.

use std::error::Error;
use std::fmt::Write as _;
use std::io::{Write as _, stdout};
use std::path::Path;
use std::time::{Duration, Instant};

use palpate::device::{Emulation, Hand, HapticDevice, IntendedPath};
use palpate::glam::{DMat3, DQuat, DVec3};
use palpate::settings::ContactSettings;
use palpate::{
    HapticRenderer, Object, Pose, Reactions, Record, Scene, SceneEditor, Settings, TriMesh, Twist,
};
use palpate_rapier::rapier3d::prelude::*;
use palpate_rapier::{TouchedBodies, solid_collider};

/// Period of the haptic loop, the contact loop and the world, s.
const STEP: f64 = 1e-3;
const SECONDS: f64 = 10.0;
const GRAVITY: f64 = 9.81;
/// Densities of aluminium (boxes) and wood (bar), kg/m³; mass of the mesh, kg.
const ALUMINIUM: f64 = 2700.0;
const WOOD: f64 = 600.0;
const MESH: f64 = 0.1;
/// Side of a box; sizes of the bar and of the plinth that it lies on, m.
const SIDE: f64 = 0.04;
const BAR: DVec3 = DVec3::new(0.08, 0.04, 0.02);
const PLINTH: DVec3 = DVec3::new(0.05, 0.06, 0.03);
/// Positions along y, m.
const STACK: f64 = -0.12;
const MIDDLE: f64 = 0.0;
const LEVER: f64 = 0.12;
/// Delay from which the world no longer catches up.
const MAX_DELAY: Duration = Duration::from_millis(20);
/// Largest number of hulls of a collider; the finest level within it is used.
const MAX_HULLS: usize = 400;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    let realtime = arguments.iter().any(|argument| argument == "--realtime");
    arguments.retain(|argument| argument != "--realtime");
    let mesh = match arguments.as_slice() {
        [] => "gear@4000",
        [name] if !name.starts_with('-') => name,
        _ => return Err("usage: stack_of_boxes [--realtime] [MESH FILE OR MODEL]".into()),
    };

    let spoon = Object::model("spoon@4000")?;
    let emulation = Emulation { hand: Hand::FIRM, ..Emulation::default() };
    let device = emulation.open(IntendedPath::Function(Box::new(intended)))?;
    let settings = Settings {
        contact: ContactSettings { friction: 0.4, ..ContactSettings::default() },
        ..Settings::default()
    };
    let renderer = HapticRenderer::new(spoon.clone(), Scene::new(), Box::new(device), settings)?;
    let table = Table::new(mesh)?;
    if realtime { in_real_time(renderer, table) } else { in_lockstep(renderer, table, &spoon) }
}

/// Runs both loops, the device and the world in this thread, reproducibly.
fn in_lockstep(mut renderer: HapticRenderer, mut table: Table, spoon: &Object) -> Result<(), Box<dyn Error>> {
    let (mut scene, mut reactions) = (renderer.scene_editor(), renderer.reactions());
    let mass = renderer.settings().tool.mass;
    let (mut haptic, mut contact, mut device) = renderer.into_loops();
    let mut touched = table.touch(&mut scene)?;
    let mut account = Account::new(&table);
    let mut rows = table.header();
    let mut before: Option<Record> = None;
    let steps = (SECONDS / STEP).round() as u32;
    for step in 1..=steps {
        let now = f64::from(step) * STEP;
        let update = contact.step(haptic.body_state(), now - STEP);
        let record = haptic.step_device(device.as_mut() as &mut dyn HapticDevice, now, STEP);
        haptic.update_contacts(&update);
        let exchanged = table.step(&mut touched, &mut scene, &mut reactions)?;
        let state = haptic.body_state();
        let turn = DMat3::from_quat(state.pose.rotation);
        let spin = turn * (spoon.clod.source.unit_inertia * mass) * turn.transpose() * state.twist.angular;
        let spoon_energy = 0.5 * (mass * state.twist.linear.length_squared() + state.twist.angular.dot(spin));
        account.add(&table, &record, before.as_ref(), exchanged, state.pose.translation, spoon_energy);
        if step % 10 == 0 {
            table.row(&mut rows, &record, &account)?;
        }
        if step % 500 == 0 {
            table.show(&record)?;
        }
        before = Some(record);
    }
    device.close()?;
    account.show()?;
    write_rows(&rows)
}

/// Runs the session in threads of its own, and the world 1000 times a second here.
fn in_real_time(renderer: HapticRenderer, mut table: Table) -> Result<(), Box<dyn Error>> {
    let mut session = renderer.spawn()?;
    let mut touched = table.touch(&mut session.scene)?;
    let mut began = Instant::now();
    let (mut step, mut lost) = (0_u32, Duration::ZERO);
    while f64::from(step) * STEP < SECONDS && session.is_running() {
        step += 1;
        let due = began + Duration::from_secs_f64(f64::from(step) * STEP);
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        // Time that cannot be caught up is dropped: the world's clock then falls behind.
        let late = Instant::now().saturating_duration_since(due);
        if late > MAX_DELAY {
            began += late;
            lost += late;
        }
        table.step(&mut touched, &mut session.scene, &mut session.reactions)?;
        if step.is_multiple_of(500)
            && let Some(record) = session.latest().copied()
        {
            table.show(&record)?;
        }
    }
    let summary = session.stop()?.summary();
    say("contact steps", format_args!("{:.0} a second", summary.contact.rate_hz))?;
    say("the world fell behind by", format_args!("{:.0} ms", 1e3 * lost.as_secs_f64()))?;
    Ok(())
}

/// World, and the bodies on the table.
struct Table {
    world: PhysicsWorld,
    things: Vec<Thing>,
}

struct Thing {
    name: String,
    body: RigidBodyHandle,
    object: Object,
    first: Vector,
}

impl Table {
    fn new(mesh: &str) -> Result<Self, Box<dyn Error>> {
        let gravity = Vector::new(0.0, 0.0, -GRAVITY as f32);
        let mut world = PhysicsWorld { gravity, ..PhysicsWorld::default() };
        world.integration_parameters.dt = STEP as f32;
        world.integration_parameters.length_unit = 0.25 * SIDE as f32;
        let mut table = Self { world, things: Vec::new() };

        let floor = cuboid("floor", DVec3::new(0.4, 0.5, 0.04))?;
        table.put("floor", floor, RigidBodyBuilder::fixed(), DVec3::Z * -0.02, 1.0)?;
        let cube = cuboid("box", DVec3::splat(SIDE))?;
        for place in 0..3 {
            let at = DVec3::new(0.0, STACK, SIDE * (0.5 + f64::from(place)));
            let name = format!("box {}", place + 1);
            table.put(&name, cube.clone(), RigidBodyBuilder::dynamic(), at, ALUMINIUM * SIDE.powi(3))?;
        }
        let object = Object::model(mesh)?;
        let low = surface(&object).fold(DVec3::INFINITY, DVec3::min);
        let at = DVec3::new(0.0, MIDDLE, -low.z);
        table.put("mesh", object, RigidBodyBuilder::dynamic(), at, MESH)?;
        let plinth = cuboid("plinth", PLINTH)?;
        let at = DVec3::new(0.5 * (0.02 - PLINTH.x), LEVER, 0.5 * PLINTH.z);
        table.put("plinth", plinth, RigidBodyBuilder::fixed(), at, 1.0)?;
        let at = DVec3::new(0.0, LEVER, PLINTH.z + 0.5 * BAR.z);
        let bar = cuboid("bar", BAR)?;
        table.put("bar", bar, RigidBodyBuilder::dynamic(), at, WOOD * BAR.element_product())?;
        Ok(table)
    }

    /// Places an object with a mass (kg).
    fn put(
        &mut self,
        name: &str,
        object: Object,
        body: RigidBodyBuilder,
        at: DVec3,
        mass: f64,
    ) -> Result<(), Box<dyn Error>> {
        let levels = object.clod.levels.len();
        let level =
            (0..levels).find(|level| object.clod.level(*level).len() <= MAX_HULLS).unwrap_or(levels - 1);
        let first = Vector::new(at.x as f32, at.y as f32, at.z as f32);
        let collider = solid_collider(&object, level, mass)?;
        let (body, _) = self.world.insert(body.translation(first), collider);
        self.things.push(Thing { name: name.to_owned(), body, object, first });
        Ok(())
    }

    /// Lets a session touch all bodies.
    fn touch(&self, scene: &mut SceneEditor) -> Result<TouchedBodies, Box<dyn Error>> {
        let mut touched = TouchedBodies::new(STEP, self.world.gravity);
        for Thing { body, object, .. } in &self.things {
            touched.add(scene, &self.world.bodies, *body, object)?;
        }
        Ok(touched)
    }

    /// Steps the world; returns the momentum that the spoon gave its bodies, and the angular momentum about
    /// the world's origin.
    fn step(
        &mut self,
        touched: &mut TouchedBodies,
        scene: &mut SceneEditor,
        reactions: &mut Reactions,
    ) -> Result<(DVec3, DVec3), Box<dyn Error>> {
        let before = self.momentum();
        touched.before_step(reactions, &mut self.world.bodies);
        let after = self.momentum();
        self.world.step();
        touched.after_step(scene, &self.world.bodies)?;
        Ok((after.0 - before.0, after.1 - before.1))
    }

    fn dynamic(&self) -> impl Iterator<Item = &RigidBody> {
        self.things.iter().map(|thing| &self.world.bodies[thing.body]).filter(|body| body.is_dynamic())
    }

    fn momentum(&self) -> (DVec3, DVec3) {
        self.dynamic().fold((DVec3::ZERO, DVec3::ZERO), |(linear, angular), body| {
            let gained = vector(body.linvel()) * f64::from(body.mass());
            let inertia = body.mass_properties().local_mprops.reconstruct_inertia_matrix();
            let spin = *body.rotation() * (inertia * (body.rotation().inverse() * body.angvel()));
            (linear + gained, angular + vector(spin) + vector(body.center_of_mass()).cross(gained))
        })
    }

    /// Returns the sum of kinetic and potential energy, J.
    fn energy(&self) -> f64 {
        let of = |body: &RigidBody| {
            let height = f64::from(body.center_of_mass().z);
            f64::from(body.kinetic_energy()) + f64::from(body.mass()) * GRAVITY * height
        };
        self.dynamic().map(of).sum()
    }

    /// Prints the time, the force at the hand, and all that has moved by more than half a millimetre.
    fn show(&self, record: &Record) -> std::io::Result<()> {
        let mut moved = String::new();
        for Thing { name, body, first, .. } in &self.things {
            let body = &self.world.bodies[*body];
            let offset = (vector(body.translation()) - vector(*first)) * 1e3;
            let turn = body.rotation().to_scaled_axis().length();
            if offset.length() > 0.5 || turn > 0.02 {
                let turn = turn.to_degrees();
                let _ =
                    write!(moved, "  {name} ({:.0} {:.0} {:.0}) mm {turn:.0}°", offset.x, offset.y, offset.z);
            }
        }
        let DVec3 { x, y, z } = record.coupling.force;
        writeln!(stdout(), "{:5.1} s  force ({x:6.2} {y:6.2} {z:6.2}) N{moved}", record.time)
    }

    fn header(&self) -> String {
        let mut rows = String::from(
            "t,force_x,force_y,force_z,torque_x,torque_y,torque_z,spoon_x,spoon_y,spoon_z,work,energy",
        );
        for Thing { name, .. } in &self.things {
            let name = name.replace(' ', "_");
            for column in ["x", "y", "z", "qx", "qy", "qz", "qw"] {
                let _ = write!(rows, ",{name}_{column}");
            }
        }
        rows.push('\n');
        rows
    }

    fn row(&self, rows: &mut String, record: &Record, account: &Account) -> Result<(), std::fmt::Error> {
        let (force, torque) = (record.coupling.force, record.coupling.torque);
        write!(rows, "{:.3}", record.time)?;
        for value in [force, torque, record.object.translation].map(|v| v.to_array()).concat() {
            write!(rows, ",{value:.6}")?;
        }
        write!(rows, ",{:.9},{:.9}", account.work, account.energy)?;
        for thing in &self.things {
            let pose = self.world.bodies[thing.body].position();
            let rotation = pose.rotation.to_array();
            for value in pose.translation.to_array().into_iter().chain(rotation) {
                write!(rows, ",{value:.6}")?;
            }
        }
        rows.push('\n');
        Ok(())
    }
}

/// Balance of momentum and energy between hand, spoon and bodies.
struct Account {
    /// Impulses (N·s) and angular impulses (N·m·s, about the world's origin) of the spoon's contact wrenches
    /// on dynamic bodies, and as the bodies received them.
    given: (DVec3, DVec3),
    taken: (DVec3, DVec3),
    /// Work of the hand now and at most, J.
    work: f64,
    /// Energy of bodies and spoon, J: at first, now, and its largest excess over the hand's work.
    first: f64,
    energy: f64,
    excess: f64,
}

impl Account {
    fn new(table: &Table) -> Self {
        let (energy, none) = (table.energy(), (DVec3::ZERO, DVec3::ZERO));
        Self { given: none, taken: none, work: 0.0, first: energy, energy, excess: f64::NEG_INFINITY }
    }

    fn add(
        &mut self,
        table: &Table,
        record: &Record,
        before: Option<&Record>,
        (linear, angular): (DVec3, DVec3),
        center: DVec3,
        spoon: f64,
    ) {
        let contact = record.contact;
        self.taken = (self.taken.0 + linear, self.taken.1 + angular);
        if let Some(before) = before {
            // Work against the wrench that the hand feels.
            let offset = record.handle.translation - before.handle.translation;
            let turn = before.handle.rotation_vector_to(&record.handle);
            self.work -= before.coupling.force.dot(offset) + before.coupling.torque.dot(turn);
        }
        self.given.0 -= contact.force * STEP;
        self.given.1 -= (contact.torque + center.cross(contact.force)) * STEP;
        self.energy = table.energy() + spoon;
        self.excess = self.excess.max(self.energy - self.first - self.work);
    }

    fn show(&self) -> std::io::Result<()> {
        let share = |given: DVec3, taken: DVec3| 100.0 * (given - taken).length() / given.length();
        let ((given, turning), (taken, turned)) = (self.given, self.taken);
        say("impulse of contact wrenches", format_args!("{given:.6} N·s, {turning:.7} N·m·s"))?;
        say("momentum that the bodies took", format_args!("{taken:.6} N·s, {turned:.7} N·m·s"))?;
        let (linear, angular) = (share(given, taken), share(turning, turned));
        say("difference", format_args!("{linear:.4} %, {angular:.4} %"))?;
        say("work of the hand", format_args!("{:.3} mJ", 1e3 * self.work))?;
        say("energy gained by bodies and spoon", format_args!("{:.3} mJ", 1e3 * (self.energy - self.first)))?;
        say("most gained beyond the hand's work", format_args!("{:.3} mJ", 1e3 * self.excess))
    }
}

/// Returns the intended pose and twist of the spoon: its bowl points along -x.
fn intended(time: f64) -> (Pose, Twist) {
    let pose = |time: f64| {
        let go = |from: f64, to: f64| smooth((time - from) / (to - from));
        // Against the middle box, on to the mesh, and under the bar; each time in along -x and out again.
        let across = STACK + (MIDDLE - STACK) * go(3.0, 4.0) + (LEVER - MIDDLE) * go(5.5, 6.5);
        let inwards = 0.065 * (go(0.5, 2.0) - go(2.2, 3.0))
            + 0.075 * (go(4.0, 4.8) - go(4.9, 5.5))
            + 0.042 * (go(6.5, 7.2) - go(9.3, 9.9));
        let lift = go(7.3, 8.3) - go(8.5, 9.3);
        let height = 1.5 * SIDE - (1.5 * SIDE - 0.02) * go(3.0, 4.0) - 0.002 * go(5.5, 6.5) + 0.045 * lift;
        let tip = DVec3::new(0.06 - inwards, across, height);
        let rotation = DQuat::from_rotation_y(0.25 * lift);
        Pose::new(tip + rotation * (0.1 * DVec3::X), rotation)
    };
    const STEP: f64 = 1e-4;
    let (before, after) = (pose(time - STEP), pose(time + STEP));
    let rate = 0.5 / STEP;
    let linear = (after.translation - before.translation) * rate;
    (pose(time), Twist::new(linear, before.rotation_vector_to(&after) * rate))
}

/// Returns a smooth step from 0 at 0 to 1 at 1, with zero slope at both.
fn smooth(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

/// Returns a box about its frame's origin.
fn cuboid(name: &str, size: DVec3) -> Result<Object, Box<dyn Error>> {
    let sign = |bit: usize| if bit == 0 { -0.5 } else { 0.5 };
    let vertices = (0..8).map(|i| size * DVec3::new(sign(i & 1), sign(i >> 1 & 1), sign(i >> 2))).collect();
    let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let triangles = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    Ok(Object::from_mesh(name, &TriMesh::new(vertices, triangles)?)?)
}

/// Returns the vertices of an object's surface, m.
fn surface(object: &Object) -> impl Iterator<Item = DVec3> {
    object.clod.leaves().iter().flat_map(|leaf| object.clod.hull(leaf)).copied()
}

fn vector(v: Vector) -> DVec3 {
    DVec3::new(v.x.into(), v.y.into(), v.z.into())
}

fn say(name: &str, value: impl std::fmt::Display) -> std::io::Result<()> {
    writeln!(stdout(), "{name:36}{value}")
}

fn write_rows(rows: &str) -> Result<(), Box<dyn Error>> {
    let folder = Path::new("target/stack_of_boxes");
    let file = folder.join("motion.csv");
    std::fs::create_dir_all(folder)
        .and_then(|()| std::fs::write(&file, rows))
        .map_err(|error| format!("{}: {error}", file.display()))?;
    Ok(say("written", file.display())?)
}
