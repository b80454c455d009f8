//! A wall pressed at haptic rates from 1 to 10 kHz with the coupling that is chosen for the rate: stable,
//! settled, and as stiff as the device allows.

use std::convert::Infallible;
use std::sync::atomic::AtomicBool;

use palpate::device::{Emulation, Hand, IntendedPath};
use palpate::glam::DVec3;
use palpate::settings::{TimingSettings, ToolSettings};
use palpate::{ContactTiming, HapticRenderer, Object, Pose, Scene, Session, Settings, Twist};
use palpate_tests::{model, penalties};

/// Length of a session, s: a rest in which the wrench comes up, half a second of approach, then held 4 mm
/// inside.
const SECONDS: f64 = 1.8;
const REST: f64 = 0.3;

/// Returns the hand's intended motion: after a rest down by `travel` along z within half a second.
fn intended(top: DVec3, travel: f64, time: f64) -> (Pose, Twist) {
    let x = ((time - REST) / 0.5).clamp(0.0, 1.0);
    let (share, rate) = (x * x * (3.0 - 2.0 * x), 6.0 * x * (1.0 - x) / 0.5);
    (
        Pose::from_translation(top + DVec3::NEG_Z * (travel * share)),
        Twist::new(DVec3::NEG_Z * travel * rate, DVec3::ZERO),
    )
}

/// Presses the probe onto a block; returns the forces on the hand in the last fifth of a second.
fn press(preset: &str, probe: &Object, wall: &Object, settings: Settings) -> (Vec<DVec3>, Session) {
    let mut emulation = Emulation::preset(preset).expect("a preset");
    emulation.hand = Hand::GRIP;
    let (source, body) = (&wall.clod.source, &probe.clod.source);
    let reach = source.bounding_radius + body.bounding_radius;
    let travel = 6e-3;
    // The floor is placed so that the probe touches it after a third of the travel.
    let scene = Scene::new().with(wall.clone(), Pose::from_translation(floor_under(probe, wall, 2e-3)));
    let path = IntendedPath::function(move |time| intended(DVec3::ZERO, travel, time));
    let device = emulation.open(path).expect("an emulation");
    let renderer = HapticRenderer::new(probe.clone(), scene, Box::new(device), settings).expect("renderer");
    let mut held = Vec::new();
    let session = renderer
        .run_lockstep(SECONDS, ContactTiming::busy(1000.0), &AtomicBool::new(false), |row| {
            assert!(
                row.object.is_valid() && row.coupling.is_finite() && row.object.translation.length() < reach
            );
            if row.time > SECONDS - 0.2 {
                held.push(row.coupling.force);
            }
            Ok::<_, Infallible>(())
        })
        .expect("the sink never fails");
    (held, session)
}

/// Returns the position of the wall's frame at which its top is `gap` under the lowest point of a probe at
/// the origin.
fn floor_under(probe: &Object, wall: &Object, gap: f64) -> DVec3 {
    let lowest = |object: &Object, sign: f64| {
        let leaves = object.clod.leaves();
        leaves
            .iter()
            .flat_map(|leaf| object.clod.hull(leaf))
            .map(|p| sign * p.z)
            .fold(f64::INFINITY, f64::min)
    };
    let (bottom, top) = (lowest(probe, 1.0), -lowest(wall, -1.0));
    DVec3::new(0.0, 0.0, bottom - gap - top)
}

#[test]
fn a_wall_is_stable_from_one_to_ten_kilohertz() {
    let (probe, wall) = (model("ellipsoid@500"), model("golf-ball@2000"));
    for preset in ["premium-1.5", "omega", "virtuose-6d"] {
        for rate in [1000.0, 2500.0, 5000.0, 10_000.0] {
            for mass in [1e-3, 0.1, 5.0] {
                let context = format!("{preset} at {rate} Hz with {mass} kg");
                let settings = Settings {
                    timing: TimingSettings { rate, ..TimingSettings::default() },
                    tool: ToolSettings { mass, ..ToolSettings::default() },
                    ..penalties()
                };
                let (held, session) = press(preset, &probe, &wall, settings);
                let summary = session.summary();
                assert_eq!(summary.haptic.steps as f64, SECONDS * rate, "{context}");
                let mean = held.iter().sum::<DVec3>() / held.len() as f64;
                let spread = held.iter().map(|f| f.distance(mean)).fold(0.0, f64::max);
                assert!(mean.z > 0.3, "{context}: pushed back with {mean} N");
                // A body of 5 kg is still slow to settle on the wall.
                let allowed = if mass > 1.0 { 0.25 } else { 0.05 };
                assert!(
                    spread < allowed * mean.z,
                    "{context}: the force wanders by {spread} N about {mean} N"
                );
                assert_eq!((summary.events.step_refused, summary.events.faded), (0, 0), "{context}");
                // The rounding of the encoders hides the work of the largest force over one or two of their
                // steps.
                let step = Emulation::preset(preset).expect("a preset").specification.encoder_step;
                let hidden = 2.0 * step * summary.coupling_force_max;
                assert!(
                    summary.energy_min_j > -hidden,
                    "{context}: {} J of {hidden} J",
                    summary.energy_min_j
                );
            }
        }
    }
}
