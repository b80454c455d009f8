//! Experiments of the dissertation on interlocking relief (§4.5.2): a ridged block dragged over a gear (Fig.
//! 4.14), and turned on another block (Fig. 4.15).

#![allow(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]

use std::f64::consts::{FRAC_PI_2, TAU};
use std::ops::ControlFlow;
use std::sync::atomic::AtomicBool;

use palpate::device::{Emulation, Interpolation, Keyframe, MotionPath};
use palpate::glam::{DQuat, DVec3};
use palpate::models::Model;
use palpate::settings::{SearchSettings, TextureSettings};
use palpate::texture_pd::BakeOptions;
use palpate::{ContactTiming, HapticRenderer, Object, Pose, Record, Scene, Settings, Summary};
use palpate_measure::correlation;
use palpate_tests::smooth;

/// Distance of ridges and of teeth, height of the block, and height of the gear's rim over its centre, m.
const PITCH: f64 = 8e-3;
const HEIGHT: f64 = 0.036;
const RIM: f64 = 0.0306;

/// Returns a built-in model as a coarse mesh of so many triangles, with the detail baked onto it.
fn detailed(model: Model, coarse: usize) -> Object {
    let full = model.generate(model.default_triangles()).unwrap();
    let coarse = model.generate(coarse).unwrap();
    let options = BakeOptions { texel: 4e-4, reach: None, crease: 0.6 };
    Object::detailed(model.name(), &coarse, &full, &options, &mut |_| ControlFlow::Continue(())).unwrap().0
}

/// Renders a hand that aims at a pose of the block by time (s).
fn render(
    probe: Object,
    scene: Scene,
    textures: TextureSettings,
    seconds: f64,
    intended: impl Fn(f64) -> Pose,
) -> (Vec<Record>, Summary) {
    let samples = (0..(seconds * 100.0) as usize + 20).map(|i| {
        let time = i as f64 * 0.01;
        Keyframe { time, pose: intended(time) }
    });
    let path = MotionPath::new(samples.collect(), Interpolation::Smooth).unwrap();
    let device = Box::new(Emulation::default().open(path).unwrap());
    let settings = Settings {
        search: SearchSettings { tolerance: Some(2e-4), ..SearchSettings::default() },
        textures,
        ..Settings::default()
    };
    let renderer = HapticRenderer::new(probe, scene, device, settings).unwrap();
    let mut records = Vec::new();
    let session = renderer
        .run_lockstep(seconds, ContactTiming::busy(500.0), &AtomicBool::new(false), |record| {
            records.push(*record);
            Ok::<_, std::convert::Infallible>(())
        })
        .unwrap();
    (records, session.summary())
}

/// Dragged across the gear's teeth, the block moves in steps of their distance, and up and down with them.
/// Along them it feels less than a hundredth of the force across.
#[test]
fn block_climbs_over_the_teeth_of_a_gear_and_feels_nothing_along_them() {
    let upright = Pose::new(DVec3::ZERO, DQuat::from_rotation_y(FRAC_PI_2));
    let scene = Scene::new().with(detailed(Model::Gear, 1600), upright);
    let textures = TextureSettings { half_size: Some(0.016), ..TextureSettings::default() };
    // Down until 0.8 s; across by two and a half teeth until 3 s; along them and back until 4 s.
    let intended = |time: f64| {
        let across = 2.5 * PITCH * smooth(0.8, 3.0, time);
        let along = 0.006 * (TAU * smooth(3.0, 4.0, time)).sin();
        let height = 0.5 * HEIGHT + RIM + 0.006 - 0.009 * smooth(0.2, 0.8, time);
        Pose::from_translation(DVec3::new(along, across, height))
    };
    let (records, summary) = render(detailed(Model::Block, 300), scene, textures, 4.0, intended);
    let pressed: Vec<_> = records.iter().filter(|record| record.time > 0.9).collect();
    let largest = pressed.iter().fold(DVec3::ZERO, |most, record| most.max(record.contact.force.abs()));
    println!("largest contact force {largest}, deepest {} m", summary.depth_max);
    assert!(largest.x < 0.01 * largest.y, "{largest}");
    assert!(largest.y > 0.3 && summary.depth_max < 2e-3, "{largest}, {} m", summary.depth_max);

    // The hand moves evenly, but the block stays between teeth: it spends more time in the first half of each
    // tooth's distance than in the second.
    let moving = || pressed.iter().filter(|record| record.time < 3.0);
    let heights: Vec<f64> = moving().map(|record| record.object.translation.z).collect();
    let (low, high) = heights.iter().fold((f64::MAX, f64::MIN), |(low, high), z| (low.min(*z), high.max(*z)));
    let turns = moving().map(|record| record.object.translation.z > 0.5 * (low + high)).collect::<Vec<_>>();
    let climbs = turns.windows(2).filter(|pair| !pair[0] && pair[1]).count();
    println!("up and down by {} m, {climbs} times up", high - low);
    assert!(high - low > 1e-3 && (2..=3).contains(&climbs), "{} m, {climbs}", high - low);
}

/// Turned on another block, ridges in grooves, the block rises with the angle, and a torque opposes.
#[test]
fn block_rises_as_it_is_turned_on_another_and_a_torque_opposes() {
    let block = detailed(Model::Block, 300);
    let scene = Scene::new().with(block.clone(), Pose::IDENTITY);
    let textures = TextureSettings { half_size: Some(0.05), ..TextureSettings::default() };
    let turn = |time: f64| 0.15 * (TAU * ((time - 1.2) / 2.0).clamp(0.0, 1.0)).sin();
    let intended = |time: f64| {
        let place = DVec3::Z * (HEIGHT + 0.004 - 0.007 * smooth(0.3, 1.0, time));
        Pose::new(place, DQuat::from_rotation_z(turn(time)))
    };
    let (records, summary) = render(block, scene, textures, 3.2, intended);
    let angle = |record: &Record| record.object.rotation.to_scaled_axis().z;
    let rest = records.iter().find(|record| record.time >= 1.15).unwrap().object.translation.z;
    let turning: Vec<_> = records.iter().filter(|record| record.time > 1.2).collect();
    let furthest = turning.iter().max_by(|a, b| angle(a).abs().total_cmp(&angle(b).abs())).unwrap();
    let (most, risen) = (angle(furthest), furthest.object.translation.z - rest);
    println!("turned by {most} rad, risen by {risen} m there, deepest {} m", summary.depth_max);
    assert!(most.abs() > 5e-3 && risen > 5e-5, "{most} rad, {risen} m");
    // Correlation of height and angle over the whole turn.
    let (angles, heights): (Vec<f64>, Vec<f64>) =
        turning.iter().map(|record| (angle(record).abs(), record.object.translation.z)).unzip();
    let correlation = correlation(&angles, &heights);
    let torque = |record: &&&Record| angle(record).abs() > 0.5 * most.abs();
    let opposing = turning.iter().filter(torque).all(|record| record.coupling.torque.z * angle(record) < 0.0);
    println!("height and angle correlate by {correlation}");
    assert!(correlation > 0.9 && opposing, "{correlation}, {opposing}");
    // It neither rocks nor is thrown about.
    let tilt = turning.iter().map(|record| {
        let up = record.object.rotation * DVec3::Z;
        up.x.hypot(up.y)
    });
    let tilt = tilt.fold(0.0, f64::max);
    assert!(tilt < 5e-3 && summary.depth_max < 1e-3, "tilted by {tilt}, {} m deep", summary.depth_max);
}
