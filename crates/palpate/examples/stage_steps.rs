//! Steps of small scenes that differ by one stage each, to be timed and counted by the benchmark `stages`.
//!
//! It is an example of this crate, and not of a crate that links all features, so that it can be built with
//! and without them.
//!
//! - `stage_steps list` prints the names of the scenes.
//! - `stage_steps make FOLDER` writes the objects' hierarchies.
//! - `stage_steps steps SCENE COUNT FOLDER` runs COUNT steps of both loops in one thread, after as many
//!   warm-up steps, and prints median times.
//! - `stage_steps session SCENE SECONDS FOLDER` runs a session in real time, and prints its number of threads
//!   and the backend of textures.
//!
//! Contact steps, haptic steps and clustering alone are separate functions, which a profiler finds by name.

#![allow(clippy::print_stdout, reason = "its output is read by the benchmark")]

use std::error::Error;
use std::f64::consts::TAU;
use std::hint::black_box;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use palpate::collide::{Clustering, ContactQuery, PatchContact, QuerySettings};
use palpate::core::mesh::UvMesh;
use palpate::device::{DeviceState, Emulation, IntendedPath};
use palpate::dynamics::BodyState;
use palpate::glam::{DVec2, DVec3};
use palpate::models::Model;
use palpate::settings::{SearchSettings, TextureBackend};
use palpate::telemetry::Times;
use palpate::texture_pd::{HeightImage, TexturedSurface, Wrap};
use palpate::{
    ContactLoop, ContactUpdate, HapticLoop, HapticRenderer, Object, OpenOptions, Pose, Record, Scene,
    Settings, Twist,
};

type Failure = Box<dyn Error>;

/// Period of both loops, s.
const PERIOD: f64 = 1e-3;
/// Depth by which the hand presses past the first touch, m.
const PRESS: f64 = 1e-3;
/// Radius of the circle on which the hand strokes, m.
const STROKE_RADIUS: f64 = 5e-4;
/// Rate of the strokes, Hz.
const STROKE_RATE: f64 = 2.0;
/// Distance between the ridges of textured plates, m.
const RIDGE_SPACING: f64 = 5e-3;
/// Height of the ridges of textured plates, m.
const RIDGE_HEIGHT: f64 = 5e-4;

/// Probe of all scenes: one convex hull.
const PROBE: &str = "ellipsoid@500";
const BALL: &str = "golf-ball@5000";
const PLATE: &str = "plate";

/// Place of a second object.
#[derive(Clone, Copy, PartialEq)]
enum Second {
    None,
    /// Ten radii away.
    Away,
    /// Above the probe, which touches both objects.
    Touching,
}

/// Objects and settings of a scene.
struct Stage {
    name: &'static str,
    object: &'static str,
    second: Second,
    textured: bool,
    watched: bool,
    /// Changes settings; the argument is the probe's radius, m.
    set: fn(&mut Settings, f64),
}

impl Stage {
    const fn bare(name: &'static str) -> Self {
        Self { name, object: PROBE, second: Second::None, textured: false, watched: false, set: |_, _| {} }
    }

    const fn with(self, set: fn(&mut Settings, f64)) -> Self {
        Self { set, ..self }
    }

    const fn on(self, object: &'static str) -> Self {
        Self { object, ..self }
    }
}

const STAGES: [Stage; 20] = [
    Stage::bare("bare"),
    Stage { second: Second::Away, ..Stage::bare("second-away") },
    Stage { second: Second::Touching, ..Stage::bare("second-touching") },
    Stage::bare("friction").with(|it, _| it.contact.friction = 0.3),
    Stage::bare("no-friction-at-rest").with(|it, _| it.contact.static_friction = Some(0.0)),
    Stage::bare("braking").with(|it, _| it.search.braking = true),
    Stage::bare("proxy").with(|it, _| it.search.proxy = true),
    Stage::bare("passivity").with(|it, _| it.output.passivity_controller = true),
    Stage { watched: true, ..Stage::bare("watch") },
    Stage::bare("error-without-levels").with(|it, radius| it.detail.error = 0.025 * radius),
    Stage::bare("texture-settings").with(|it, _| {
        it.textures.grid = 256;
        it.textures.backend = TextureBackend::Auto;
    }),
    Stage::bare("one-cluster").with(|it, _| it.search.clusters = 1),
    Stage::bare("16-clusters").with(|it, _| it.search.clusters = 16),
    Stage::bare("hierarchy").on(BALL),
    Stage::bare("error").on(BALL).with(|it, radius| it.detail.error = 0.025 * radius),
    Stage::bare("plate").on(PLATE),
    Stage { textured: true, ..Stage::bare("texture").on(PLATE) },
    Stage {
        textured: true,
        ..Stage::bare("texture-auto").on(PLATE).with(|it, _| it.textures.backend = TextureBackend::Auto)
    },
    Stage::bare("defaults").with(|it, _| (it.search.braking, it.search.proxy) = (true, true)),
    Stage::bare("defaults-hierarchy")
        .on(BALL)
        .with(|it, _| (it.search.braking, it.search.proxy) = (true, true)),
];

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match arguments[..] {
        ["list"] => STAGES.iter().for_each(|stage| println!("{}", stage.name)),
        ["make", folder] => {
            for name in [PROBE, BALL, PLATE] {
                Object::model(name)?.clod.save(&Path::new(folder).join(format!("{name}.clod")))?;
            }
        }
        // Names are padded to one length, because the alignment of the stack depends on the arguments'
        // length.
        ["steps", stage, count, folder] => steps(stage_named(stage)?, count.parse()?, folder)?,
        ["session", stage, seconds, folder] => session(stage_named(stage)?, seconds.parse()?, folder)?,
        _ => {
            return Err(
                "give list, make FOLDER, steps SCENE COUNT FOLDER or session SCENE SECONDS FOLDER".into()
            );
        }
    }
    Ok(())
}

fn stage_named(name: &str) -> Result<&'static Stage, String> {
    STAGES
        .iter()
        .find(|stage| stage.name == name.trim_end_matches('_'))
        .ok_or_else(|| format!("there is no scene {name}"))
}

fn open(name: &str, textured: bool, folder: &str) -> Result<Object, Failure> {
    let file = format!("{folder}/{name}.clod");
    let mut object = Object::open(&file, &OpenOptions::default(), &mut palpate::clod_build::unwatched)?;
    name.clone_into(&mut object.name);
    Ok(if textured { object.with_texture(ridges()?) } else { object })
}

/// Surface of the plate with ridges.
fn ridges() -> Result<TexturedSurface, Failure> {
    const TEXELS: u32 = 64;
    let ridge =
        (0..TEXELS).map(|i| 0.5 * RIDGE_HEIGHT * (TAU * (f64::from(i) + 0.5) / f64::from(TEXELS)).cos());
    let image = HeightImage::new(TEXELS, 1, ridge.map(|height| height as f32).collect(), [Wrap::Repeat; 2])?;
    let texel = RIDGE_SPACING / f64::from(TEXELS);
    let mesh = Model::Plate.generate(Model::Plate.default_triangles())?;
    let mesh = UvMesh::projected(mesh, |corner| DVec2::new(corner.x / RIDGE_SPACING, corner.y / texel))?;
    Ok(TexturedSurface::textured(&mesh, &image, 0.5)?)
}

/// Position at which a probe that descends along z onto an object's middle first touches it.
fn first_touch(probe: &Object, object: &Object) -> Result<DVec3, Failure> {
    let settings = QuerySettings::new(0.1 * probe.bounding_radius());
    let mut query = ContactQuery::new(probe.shape(), object.shape());
    let mut place =
        object.clod.source.center + DVec3::Z * (object.bounding_radius() + probe.bounding_radius());
    for _ in 0..1000 {
        let outcome = query.run(&Pose::from_translation(place), &Pose::IDENTITY, &settings)?;
        let distance = outcome.smallest_distance.unwrap_or(settings.tolerance);
        if distance < 1e-6 {
            return Ok(place);
        }
        place.z -= distance;
    }
    Err("the probe never touches".into())
}

/// Makes the session, with a hand that presses the probe on the object and strokes it.
fn renderer(stage: &Stage, folder: &str) -> Result<(HapticRenderer, DVec3), Failure> {
    let probe = open(PROBE, false, folder)?;
    let object = open(stage.object, stage.textured, folder)?;
    let touch = first_touch(&probe, &object)?;
    let radius = probe.bounding_radius();
    let scene = Scene::new().with(object.clone(), Pose::IDENTITY);
    let scene = match stage.second {
        Second::None => scene,
        Second::Away => scene.with(object, Pose::from_translation(DVec3::X * 10.0 * radius)),
        // The probe and the object are symmetrical.
        Second::Touching => scene.with(object, Pose::from_translation(2.0 * touch)),
    };
    let mut settings = Settings {
        search: SearchSettings { braking: false, proxy: false, ..SearchSettings::default() },
        ..Settings::default()
    };
    (stage.set)(&mut settings, radius);
    let device = Emulation::default().open(IntendedPath::function(move |time| motion(touch, time)))?;
    Ok((HapticRenderer::new(probe, scene, Box::new(device), settings)?, touch))
}

/// Pose and velocity of the hand.
fn motion(touch: DVec3, time: f64) -> (Pose, Twist) {
    let (sin, cos) = (TAU * STROKE_RATE * time).sin_cos();
    let pose = Pose::from_translation(touch + DVec3::new(STROKE_RADIUS * cos, STROKE_RADIUS * sin, -PRESS));
    (pose, Twist::new(TAU * STROKE_RATE * STROKE_RADIUS * DVec3::new(-sin, cos, 0.0), DVec3::ZERO))
}

#[inline(never)]
fn counted_contact_step(contact: &mut ContactLoop, body: &BodyState, time: f64) -> ContactUpdate {
    contact.step(body, time)
}

#[inline(never)]
fn counted_haptic_step(haptic: &mut HapticLoop, update: &ContactUpdate, device: &DeviceState) -> Record {
    haptic.update_contacts(update);
    haptic.step(device, device.time, PERIOD)
}

#[inline(never)]
fn counted_clustering(clustering: &mut Clustering, contacts: &[PatchContact], pose: &Pose) -> usize {
    clustering.run(contacts, 1e-3, pose).len()
}

/// Runs warm-up steps, then measured steps, and prints median times.
fn steps(stage: &Stage, count: u32, folder: &str) -> Result<(), Failure> {
    let (mut renderer, touch) = renderer(stage, folder)?;
    let mut monitor = stage.watched.then(|| renderer.contact_monitor());
    let clusters = renderer.settings().search.clusters;
    let (mut haptic, mut contact, mut device) = renderer.into_loops();
    let mut clustering = Clustering::new(clusters);
    let mut state = device.read(0.0)?;
    drop(device);
    let (mut contact_times, mut haptic_times, mut contacts) = (Times::new(), Times::new(), 0);
    for step in 0..2 * count {
        let time = f64::from(step + 1) * PERIOD;
        (state.pose, state.twist) = motion(touch, time);
        state.time = time;
        let body = *haptic.body_state();
        if step < count {
            let update = contact.step(&body, time);
            haptic.update_contacts(&update);
            haptic.step(&state, time, PERIOD);
            continue;
        }
        let begun = Instant::now();
        let update = black_box(counted_contact_step(&mut contact, &body, time));
        contact_times.record(begun.elapsed().as_nanos() as u64);
        let begun = Instant::now();
        black_box(counted_haptic_step(&mut haptic, &update, &state));
        haptic_times.record(begun.elapsed().as_nanos() as u64);
        contacts += update.contacts;
        let contacts: Vec<_> = contact.contacts().copied().collect();
        black_box(counted_clustering(&mut clustering, &contacts, &body.pose));
        if let Some(monitor) = &mut monitor {
            black_box(monitor.latest());
        }
    }
    println!("contact_ns {}", contact_times.percentiles(1.0).p50);
    println!("haptic_ns {}", haptic_times.percentiles(1.0).p50);
    println!("contacts {}", f64::from(contacts) / f64::from(count));
    Ok(())
}

/// Runs a session in real time, and prints its number of threads and the backend of textures.
fn session(stage: &Stage, seconds: f64, folder: &str) -> Result<(), Failure> {
    let before = threads();
    let (mut renderer, _) = renderer(stage, folder)?;
    let _monitor = stage.watched.then(|| renderer.contact_monitor());
    println!("textures {}", renderer.stages()["textures"]);
    let mut most = 0;
    renderer.run_realtime(seconds, &AtomicBool::new(false), |_| {
        most = most.max(threads());
        Ok::<(), std::convert::Infallible>(())
    })?;
    if let Some(more) = most.checked_sub(before).filter(|_| before > 0) {
        println!("threads {more}");
    }
    Ok(())
}

/// Number of threads of this process; 0 if the system does not report it.
fn threads() -> usize {
    std::fs::read_dir("/proc/self/task").map_or(0, Iterator::count)
}
