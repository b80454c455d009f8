//! A path for an emulated hand that has been told nothing else: come from above, press, scrub and twist, withdraw.

use std::f64::consts::TAU;

use palpate_collide::{QuerySettings, SceneQuery};
use palpate_core::Pose;
use palpate_core::glam::{DQuat, DVec3};
use palpate_device::{
    DeviceError, Emulation, HapticDevice, IntendedPath, Interpolation, Keyframe, MotionPath, PathError,
};
use palpate_dynamics::DeviceMapping;

use crate::object::Object;
use crate::scene::Scene;

/// Length of one exploration, s; it is repeated for as long as the session lasts.
pub const CYCLE: f64 = 10.0;

/// Poses of one exploration.
const SAMPLES: usize = 1000;
/// Most steps of the descent to first touch.
const MAX_DESCENT: usize = 4000;

/// Lengths of the movement as fractions of the probe's bounding radius.
const CLEARANCE: f64 = 0.1;
const PRESS: f64 = 0.03;
const SCRUB: f64 = 0.1;
/// Amplitude of the twisting about the vertical, rad.
const TWIST: f64 = 0.05;

/// Opens a device by its address, as [`palpate_device::open`] does, except that the hand of an emulated one
/// (`emulated`, `emulated:PRESET`) explores `scene` with `probe`.
///
/// # Errors
/// If there is no such device, or it cannot be opened.
pub fn open_device(
    address: &str,
    probe: &Object,
    scene: &Scene,
) -> Result<Box<dyn HapticDevice>, DeviceError> {
    open_mapped_device(address, probe, scene, &DeviceMapping::IDENTITY)
}

/// [`open_device`] for a session in which the device's motion is mapped: the hand moves so that the probe explores the
/// scene all the same. A replayed path is one of the device, and stays what it is.
///
/// # Errors
/// As [`open_device`].
pub fn open_mapped_device(
    address: &str,
    probe: &Object,
    scene: &Scene,
    mapping: &DeviceMapping,
) -> Result<Box<dyn HapticDevice>, DeviceError> {
    let emulation = match address.strip_prefix("emulated") {
        Some("") => Some(Emulation::default()),
        Some(preset) => preset.strip_prefix(':').and_then(Emulation::preset),
        None => None,
    };
    match emulation {
        Some(emulation) => Ok(Box::new(emulation.open(mapped_path(probe, scene, mapping)?)?)),
        None => palpate_device::open(address),
    }
}

/// Where the hand means the probe's mesh frame to be: the probe comes down the world's z axis onto the middle of the
/// scene, presses 3 % of its radius past first touch, scrubs and twists, withdraws, and begins again.
///
/// # Errors
/// If an object is so large or so far away that a pose is out of a path's range.
pub fn path(probe: &Object, scene: &Scene) -> Result<IntendedPath, PathError> {
    mapped_path(probe, scene, &DeviceMapping::IDENTITY)
}

/// [`path`] of the device that `mapping` takes to the world.
fn mapped_path(probe: &Object, scene: &Scene, mapping: &DeviceMapping) -> Result<IntendedPath, PathError> {
    let touch = first_touch(probe, scene);
    let radius = probe.bounding_radius();
    let center = probe.clod.source.center;
    let keyframe = |sample: usize| {
        let phase = sample as f64 / SAMPLES as f64;
        // Down in the first fifth, pressed for three, up in the last.
        let down = smooth_step(phase / 0.2).min(smooth_step((1.0 - phase) / 0.2));
        let rubbing = ((phase - 0.2) / 0.6).clamp(0.0, 1.0);
        let offset = DVec3::new(
            SCRUB * (2.0 * TAU * rubbing).sin(),
            SCRUB * (3.0 * TAU * rubbing).sin(),
            CLEARANCE - (CLEARANCE + PRESS) * down,
        ) * radius;
        let rotation = DQuat::from_rotation_z(TWIST * (2.0 * TAU * rubbing).sin());
        let translation = touch + offset + center - rotation * center;
        Keyframe { time: phase * CYCLE, pose: mapping.device_pose(&Pose::new(translation, rotation)) }
    };
    let cycle = MotionPath::new((0..=SAMPLES).map(keyframe).collect(), Interpolation::Smooth)?;
    let mut segment = 0;
    Ok(IntendedPath::function(move |time| {
        let point = cycle.at_near(time.rem_euclid(CYCLE), &mut segment);
        (point.pose, point.twist)
    }))
}

/// Where the mesh frame of the probe, unrotated, is when it first touches the scene on its way down.
///
/// Conservative advancement: each step is no longer than the distance that the query reports.
fn first_touch(probe: &Object, scene: &Scene) -> DVec3 {
    let radius = probe.bounding_radius();
    let center = probe.clod.source.center;
    let spheres = scene.objects().iter().map(|placed| {
        let source = &placed.object.clod.source;
        (placed.pose.transform_point(source.center), source.bounding_radius)
    });
    let (low, high) = spheres
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), (center, radius)| {
            (low.min(center - radius), high.max(center + radius))
        });
    if !(low.is_finite() && high.is_finite()) {
        return -center;
    }
    let middle = 0.5 * (low + high);
    let top = DVec3::new(middle.x, middle.y, high.z + radius) - center;
    let bottom = middle.z - center.z;
    let settings = QuerySettings::new(0.1 * radius);
    let mut query = SceneQuery::new(probe.shape());
    for placed in scene.objects() {
        query.add(placed.object.shape(), &placed.pose);
    }
    let mut position = top;
    for _ in 0..MAX_DESCENT {
        let outcome = query.run(&Pose::from_translation(position), &settings).query;
        let nearest = outcome.deepest.map_or(settings.tolerance, |depth| -depth);
        if nearest < 1e-4 * radius || position.z < bottom {
            break;
        }
        position.z -= nearest;
    }
    position
}

/// 0 below 0, 1 above 1, smooth between.
fn smooth_step(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}
