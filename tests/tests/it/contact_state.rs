//! Experiments of the dissertation in contact (§5.5.3): depth of light objects in stiff surfaces, and
//! stability there, with contacts found at various rates.
//!
//! With the contact force of the last query in place of the linearised model they are thrown about.

use std::collections::VecDeque;

use palpate::device::{Emulation, Interpolation, Keyframe, MotionPath};
use palpate::glam::{DQuat, DVec3};
use palpate::settings::{
    ContactSettings, CouplingSettings, DetailSettings, DeviceSettings, SearchSettings, ToolSettings,
};
use palpate::{HapticRenderer, Object, Pose, Scene, Settings};
use palpate_tests::{first_touch, model, penalties, smooth};

const STEP: f64 = 1e-3;

/// Depth at which an object counts as lost, m.
const LOST_DEPTH: f64 = 5e-3;

/// Task of the hand: it comes down, presses, rubs, and holds still; in metres at the device.
#[derive(Clone, Copy)]
struct Task {
    /// Depth beyond the touch that the hand aims at, m.
    press: f64,
    /// Amplitudes of rubbing, m, and twisting, rad, and their frequency, Hz.
    rub: f64,
    twist: f64,
    frequency: f64,
}

/// Times at which the hand starts, has pressed down, has rubbed, and ends, s.
const TIMES: [f64; 4] = [0.2, 0.7, 2.2, 3.0];

/// Observations.
#[derive(Clone, Copy, Debug, Default)]
struct Seen {
    /// Deepest penetration that a query found, m.
    depth: f64,
    /// Largest distance of the object from its mean position in the last half second, m.
    wander: f64,
    /// Mean force at the device in the last half second, N, and the largest difference from it.
    force: DVec3,
    unrest: f64,
}

fn intended(touch: DVec3, task: &Task) -> MotionPath {
    let [start, pressed, rubbed, end] = TIMES;
    let keyframe = |sample: usize| {
        let time = sample as f64 * 0.01;
        let down = smooth(start, pressed, time);
        let phase = std::f64::consts::TAU * task.frequency * (time.clamp(pressed, rubbed) - pressed);
        let height = 2e-3 - (2e-3 + task.press) * down;
        let place = touch + DVec3::new(task.rub * phase.sin(), 0.0, height);
        let pose = Pose::new(place, DQuat::from_rotation_z(task.twist * phase.sin()));
        Keyframe { time, pose }
    };
    let samples = (0..=(end / 0.01) as usize + 10).map(keyframe).collect();
    MotionPath::new(samples, Interpolation::Smooth).expect("a path")
}

/// Renders the task with queries at `rate` (Hz), each of which takes its whole period. With `hold`, the force
/// is frozen at the state that the query saw.
fn render(probe: &Object, scene: &Object, settings: Settings, task: &Task, rate: f64, hold: bool) -> Seen {
    let touch = first_touch(probe, scene);
    let placed = Scene::new().with(scene.clone(), Pose::IDENTITY);
    // The position of the touch in the world does not depend on the scale.
    let scale = settings.device.workspace_scale;
    let settings = Settings {
        device: DeviceSettings { frame: Pose::from_translation(touch * (1.0 - scale)), ..settings.device },
        ..settings
    };
    let device = Emulation::default().open(intended(touch, task)).expect("an emulation");
    let renderer = HapticRenderer::new(probe.clone(), placed, Box::new(device), settings).expect("a session");
    let (mut haptic, mut contact, mut device) = renderer.into_loops();
    let every = (1.0 / (rate * STEP)).round() as usize;
    let mut pending = VecDeque::new();
    let mut seen = Seen::default();
    let mut rows = Vec::new();
    for step in 0..(TIMES[3] / STEP) as usize {
        let now = (step + 1) as f64 * STEP;
        if step % every == 0 {
            if let Some(update) = pending.pop_front() {
                haptic.update_contacts(&update);
            }
            let mut update = contact.step(haptic.body_state(), now - STEP);
            seen.depth = seen.depth.max(update.depth);
            if seen.depth > LOST_DEPTH {
                return seen;
            }
            if hold {
                update.model = palpate_measure::frozen(&update.model, haptic.body_state());
            }
            pending.push_back(update);
        }
        let record = haptic.step_device(device.as_mut(), now, STEP);
        if now > TIMES[3] - 0.5 {
            rows.push((record.object.translation, record.coupling.force));
        }
    }
    let count = rows.len() as f64;
    let place = rows.iter().map(|row| row.0).sum::<DVec3>() / count;
    seen.force = rows.iter().map(|row| row.1).sum::<DVec3>() / count;
    for (object, force) in rows {
        seen.wander = seen.wander.max(object.distance(place));
        seen.unrest = seen.unrest.max(force.distance(seen.force));
    }
    seen
}

#[test]
fn spoon_in_cup_is_shallow_and_at_rest() {
    let (spoon, cup) = (model("spoon@1344"), model("cup@4000"));
    let task = Task { press: 12e-3, rub: 5e-3, twist: 0.05, frequency: 1.0 };
    // The dissertation's cases, of which the second oscillated, and one more.
    for (mass, contact_stiffness, bound) in [(0.01, 2e3, 6e-4), (0.1, 1e4, 2e-4), (0.01, 1e4, 2e-4)] {
        for rate in [1000.0, 500.0, 200.0] {
            let settings = Settings {
                tool: ToolSettings { mass, ..ToolSettings::default() },
                contact: ContactSettings { stiffness: contact_stiffness, ..penalties().contact },
                coupling: CouplingSettings {
                    stiffness: Some(200.0),
                    angular_stiffness: Some(0.6),
                    ..CouplingSettings::default()
                },
                search: SearchSettings { tolerance: Some(1e-4), ..SearchSettings::default() },
                ..penalties()
            };
            let seen = render(&spoon, &cup, settings, &task, rate, false);
            let context = format!("{mass} kg, {contact_stiffness} N/m, {rate} Hz: {seen:?}");
            assert!(seen.force.z > 0.6, "never pressed: {context}");
            assert!(seen.depth < bound, "{context}");
            assert!(seen.wander < 2e-5 && seen.unrest < 0.02, "{context}");
        }
    }
}

/// The slower contacts are found, the further teeth pass one another between queries, unknown to the planes.
/// Light jaws then go in deeper and oscillate by as much, but by no more.
#[test]
fn jaws_stay_in_place_at_slow_contact_rates_by_the_linearised_model_alone() {
    let (upper, lower) = (model("upper-jaw@5000"), model("lower-jaw@5000"));
    let settings = Settings {
        tool: ToolSettings { mass: 0.01, ..ToolSettings::default() },
        contact: ContactSettings { stiffness: 5e3, ..penalties().contact },
        coupling: CouplingSettings { stiffness: Some(500.0), ..CouplingSettings::default() },
        device: DeviceSettings { workspace_scale: 0.4, ..DeviceSettings::default() },
        detail: DetailSettings { error: 0.004 * upper.bounding_radius(), ..DetailSettings::default() },
        search: SearchSettings { clusters: 16, ..SearchSettings::default() },
        ..penalties()
    };
    let task = Task { press: 3e-3, rub: 1e-3, twist: 0.0, frequency: 1.0 };
    for (rate, depth, wander) in [(500.0, 1e-4, 5e-5), (50.0, 1e-3, 1e-3)] {
        let seen = render(&upper, &lower, settings, &task, rate, false);
        let context = format!("{rate} Hz: {seen:?}");
        assert!(seen.force.length() > 0.1, "never pressed: {context}");
        assert!(seen.depth < depth && seen.wander < wander, "{context}");
        let held = render(&upper, &lower, settings, &task, rate, true);
        assert!(
            held.depth > LOST_DEPTH,
            "stable without the model as well, and nothing is shown: {rate} Hz: {held:?}"
        );
    }
}

/// Objects with many small faces, pressed on a flat surface and on one with dimples, come to rest on some of
/// the faces.
#[test]
fn objects_with_facets_come_to_rest() {
    let probe = model("ellipsoid@500");
    let task = Task { press: 12e-3, rub: 0.0, twist: 0.0, frequency: 0.0 };
    for scene in ["block@300", "golf-ball@5000"].map(model) {
        for (mass, tolerance) in [0.01, 0.1, 1.0].into_iter().flat_map(|m| [(m, 2e-4), (m, 5e-4), (m, 1e-3)])
        {
            let settings = Settings {
                tool: ToolSettings { mass, ..ToolSettings::default() },
                search: SearchSettings { tolerance: Some(tolerance), ..SearchSettings::default() },
                coupling: CouplingSettings { stiffness: Some(500.0), ..CouplingSettings::default() },
                ..penalties()
            };
            let Seen { force, unrest, .. } = render(&probe, &scene, settings, &task, 500.0, false);
            let context =
                format!("{}, {mass} kg, d = {tolerance} m: {unrest:.1e} N of {force:.4}", scene.name);
            assert!(force.length() > 1.0 && unrest < 1e-6 * force.length(), "{context}");
        }
    }
}
