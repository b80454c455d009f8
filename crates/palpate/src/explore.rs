//! Tasks for an emulated hand without a path: it does a [`Task`] where the probe first touches the scene.

use palpate_collide::{QuerySettings, SceneQuery};
use palpate_core::glam::DVec3;
use palpate_core::{Pose, Twist};
use palpate_device::{
    DeviceError, EmulatedHand, HapticDevice, IntendedPath, MotionPath, PathError, PathPoint, Steering, Task,
    TaskParameters, TaskSite,
};

use crate::scene::Scene;
use crate::scene::object::Object;
use crate::scene::placement::HandlePlacement;
use crate::settings::Settings;

/// Largest number of steps of the descent to first touch. With fewer, the descent may end above the scene.
const MAX_DESCENT_STEPS: usize = 4000;

/// Opens a device by its address, as [`palpate_device::open`] does, except that the hand of an emulated
/// device does its task (`emulated:PRESET,task=NAME`; [`Task::Explore`] by default) in `scene` with `probe`.
///
/// # Errors
/// If there is no such device, or it cannot be opened.
pub fn open_device(
    address: &str,
    probe: &Object,
    scene: &Scene,
) -> Result<Box<dyn HapticDevice>, DeviceError> {
    open_device_for(address, probe, scene, &Settings::default())
}

/// Opens a device as [`open_device`] does, for a session with other settings. Wherever they place the handle
/// on the probe and the device's workspace in the world, the hand moves so that the probe does its task in
/// the scene, with movements no larger than the workspace. A path from a file is that of the probe's mesh
/// frame ([`mesh_path`]).
///
/// # Errors
/// As [`open_device`].
pub fn open_device_for(
    address: &str,
    probe: &Object,
    scene: &Scene,
    settings: &Settings,
) -> Result<Box<dyn HapticDevice>, DeviceError> {
    let Some(hand) = EmulatedHand::at(address) else { return palpate_device::open(address) };
    let mut hand = hand?;
    let path = match hand.path.take() {
        Some(path) => {
            let placement = HandlePlacement::new(settings, probe, &hand.emulation.specification);
            mesh_path(path, settings, placement)
        }
        None => {
            let specification = &hand.emulation.specification;
            let placement = HandlePlacement::new(settings, probe, specification);
            let reach = specification.workspace_radius * settings.device.workspace_scale;
            let task = (hand.task.unwrap_or_default(), &hand.task_parameters);
            placed_path(task, probe, scene, (&placement, reach))?
        }
    };
    Ok(Box::new(hand.open(path)?))
}

/// Opens a device as [`open_device_for`] does, except that the hand of an emulated device whose address names
/// neither a task nor a path follows the returned steering. It starts above the middle of the scene.
///
/// # Errors
/// As [`open_device`].
pub fn open_steered_device(
    address: &str,
    probe: &Object,
    scene: &Scene,
    settings: &Settings,
) -> Result<(Box<dyn HapticDevice>, Option<Steering>), DeviceError> {
    match EmulatedHand::at(address) {
        Some(Ok(hand @ EmulatedHand { task: None, path: None, .. })) => {
            let start = Task::default().pose(0.0, &site(Task::default(), probe, scene));
            let placement = HandlePlacement::new(settings, probe, &hand.emulation.specification);
            let (steering, path) = Steering::new(placement.device_pose(&start));
            Ok((Box::new(hand.open(path)?), Some(steering)))
        }
        _ => Ok((open_device_for(address, probe, scene, settings)?, None)),
    }
}

/// Path that the hand intends for the handle, to do a task with the default settings: the probe descends
/// along the world's z axis to the middle of the scene. A task's lengths are multiples of the probe's
/// bounding radius.
///
/// # Errors
/// If an object is so large or so far away that a pose is out of a path's range.
pub fn path(task: Task, probe: &Object, scene: &Scene) -> Result<IntendedPath, PathError> {
    let handle = probe.clod.source.center_of_mass;
    let task = (task, &TaskParameters::default());
    placed_path(task, probe, scene, (&HandlePlacement::holding(&Settings::default(), handle), f64::INFINITY))
}

/// Path that the hand intends for the handle, wherever it is placed on the mesh, so that the mesh's frame
/// follows a recorded path. The recorded path is one of a device whose handle is at the mesh's origin. At its
/// end the hand stays.
pub fn mesh_path(path: MotionPath, settings: &Settings, placement: HandlePlacement) -> IntendedPath {
    let at_origin = HandlePlacement::holding(settings, DVec3::ZERO);
    let arm = placement.handle() / settings.device.workspace_scale;
    let mut segment = 0;
    IntendedPath::function(move |time| {
        let PathPoint { pose, twist, .. } = path.at_near(time, &mut segment);
        let arm = pose.rotation * arm;
        let twist = Twist { linear: twist.velocity_at(arm), ..twist };
        (placement.device_pose(&at_origin.mesh_pose(&pose)), twist)
    })
}

/// Path as [`path`], with a placement of the device and the radius (m) of its workspace in the scene. If the
/// probe is larger than the workspace, lengths are multiples of the workspace's radius, and the probe rotates
/// about the handle.
fn placed_path(
    (task, parameters): (Task, &TaskParameters),
    probe: &Object,
    scene: &Scene,
    (placement, reach): (&HandlePlacement, f64),
) -> Result<IntendedPath, PathError> {
    let mut site = site(task, probe, scene);
    if site.size > reach {
        (site.size, site.pivot) = (reach, placement.handle());
    }
    IntendedPath::cycle(parameters.cycle(task), |time| {
        placement.device_pose(&parameters.pose(task, time, &site))
    })
}

/// Site in the scene where the probe does a task.
fn site(task: Task, probe: &Object, scene: &Scene) -> TaskSite {
    let size = probe.bounding_radius();
    let touch = first_touch(probe, scene, task.beside() * size);
    TaskSite { touch, pivot: probe.clod.source.center, size }
}

/// Position of the probe's mesh frame, not rotated, at its first touch of the scene while it descends at an
/// offset from the middle of the scene.
///
/// Conservative advancement: each step is no longer than the distance that the query reports.
fn first_touch(probe: &Object, scene: &Scene, beside: DVec3) -> DVec3 {
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
    let top = DVec3::new(middle.x, middle.y, high.z + radius) + beside - center;
    let bottom = middle.z - center.z;
    let settings = QuerySettings::new(0.1 * radius);
    let mut query = SceneQuery::new(probe.shape());
    for placed in scene.objects() {
        query.add(placed.object.shape(), &placed.pose);
    }
    let mut position = top;
    for _ in 0..MAX_DESCENT_STEPS {
        let Ok(outcome) = query.run(&Pose::from_translation(position), &settings) else { break };
        let nearest = outcome.query.deepest.map_or(settings.tolerance, |depth| -depth);
        if nearest < 1e-4 * radius || position.z < bottom {
            break;
        }
        position.z -= nearest;
    }
    position
}

#[cfg(test)]
mod tests {
    use palpate_core::glam::DQuat;
    use palpate_device::{Interpolation, Keyframe};

    use super::*;
    use crate::settings::DeviceSettings;

    /// The mesh follows the recorded path with any place of the handle, and the handle's velocity is the
    /// derivative of its position.
    #[test]
    fn the_mesh_follows_a_recorded_path_with_any_handle() {
        let frame = Pose::new(DVec3::new(0.2, -0.1, 0.3), DQuat::from_rotation_z(0.4));
        let settings = Settings {
            device: DeviceSettings { workspace_scale: 2.0, frame, ..DeviceSettings::default() },
            ..Settings::default()
        };
        let keyframe = |index: u32| {
            let time = 0.1 * f64::from(index);
            let pose =
                Pose::new(DVec3::new(time, 0.3 * time * time, 0.0), DQuat::from_rotation_x(0.7 * time));
            Keyframe { time, pose }
        };
        let path = MotionPath::new((0..10).map(keyframe).collect(), Interpolation::Smooth).expect("a path");
        let at_origin = HandlePlacement::holding(&settings, DVec3::ZERO);
        let placement = HandlePlacement::holding(&settings, DVec3::new(0.1, 0.2, -0.05));
        let IntendedPath::Function(mut intended) = mesh_path(path.clone(), &settings, placement) else {
            panic!("a function");
        };
        for step in 1..80 {
            let time = 0.01 * f64::from(step);
            let wanted = at_origin.mesh_pose(&path.at(time).pose);
            let (pose, twist) = intended(time);
            let mesh = placement.mesh_pose(&pose);
            assert!(mesh.translation.distance(wanted.translation) < 1e-12, "{time} s");
            assert!(mesh.rotation_vector_to(&wanted).length() < 1e-12, "{time} s");
            let h = 1e-6;
            let shift = intended(time + h).0.translation - intended(time - h).0.translation;
            assert!((shift / (2.0 * h) - twist.linear).length() < 1e-6, "{time} s: {twist:?}");
        }
    }
}
