//! Placement of the device's handle on the grasped object, and of both in the world.

use palpate_core::Pose;
use palpate_core::glam::DVec3;
use palpate_device::Specification;
use palpate_dynamics::DeviceMapping;

use crate::scene::object::Object;
use crate::settings::{HandlePlace, Settings};

/// Placement of the device's workspace in the world and of its handle on the grasped object. With the handle
/// in the middle of its workspace, not rotated, the mesh's frame is at the
/// [device frame](crate::settings::DeviceSettings::frame), wherever the handle is on the object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandlePlacement {
    mapping: DeviceMapping,
    /// Position of the handle in the mesh's frame, m.
    handle: DVec3,
}

/// Whether a device renders a force or torque along any axis.
pub(crate) fn renders(specification: &Specification) -> bool {
    let Specification { peak_force, peak_torque, actuated, .. } = specification;
    let driven = |axes: [bool; 3], peak: f64| peak > 0.0 && axes.contains(&true);
    driven(actuated.translation, *peak_force) || driven(actuated.rotation, *peak_torque)
}

impl HandlePlacement {
    /// Placement for a grasped object and a device.
    pub fn new(settings: &Settings, probe: &Object, specification: &Specification) -> Self {
        let grasp = settings.tool.grasp.map_or(probe.clod.source.center_of_mass, |grasp| grasp.translation);
        Self::at(settings, grasp, specification)
    }

    /// Placement with the grasp at a point of the mesh's frame (m).
    pub(crate) fn at(settings: &Settings, grasp: DVec3, specification: &Specification) -> Self {
        let handle = match settings.tool.handle {
            HandlePlace::Automatic if renders(specification) => grasp,
            HandlePlace::Grasp => grasp,
            HandlePlace::Automatic | HandlePlace::MeshOrigin => DVec3::ZERO,
        };
        Self::holding(settings, handle)
    }

    /// Placement with the handle at a point of the mesh's frame (m).
    pub(crate) fn holding(settings: &Settings, handle: DVec3) -> Self {
        let base = settings.device.frame * Pose::from_translation(handle);
        Self { mapping: DeviceMapping::new(settings.device.workspace_scale, base), handle }
    }

    /// Mapping of the handle's motion to the world.
    pub fn mapping(&self) -> &DeviceMapping {
        &self.mapping
    }

    /// Position of the handle on the object, in the mesh's frame, m.
    pub fn handle(&self) -> DVec3 {
        self.handle
    }

    /// Distance of the grasp (in the mesh's frame) from the handle, m at the device.
    pub(crate) fn lever(&self, grasp: &Pose) -> f64 {
        self.handle.distance(grasp.translation) / self.mapping.scale
    }

    /// Pose of the mesh's frame in the world with the handle at a device pose and the coupling relaxed.
    pub fn mesh_pose(&self, device: &Pose) -> Pose {
        self.mapping.pose(device) * Pose::from_translation(-self.handle)
    }

    /// Device pose of the handle that holds the mesh's frame at a pose in the world; the inverse of
    /// [`Self::mesh_pose`].
    pub fn device_pose(&self, mesh: &Pose) -> Pose {
        self.mapping.device_pose(&(*mesh * Pose::from_translation(self.handle)))
    }
}

#[cfg(test)]
mod tests {
    use palpate_core::glam::DQuat;
    use palpate_device::Emulation;

    use super::*;
    use crate::settings::{DeviceSettings, ToolSettings};

    #[test]
    fn the_handle_is_placed_by_the_setting_and_the_mesh_by_the_device_frame() {
        let driven = Emulation::default().specification;
        let felt = Specification { peak_force: 0.0, peak_torque: 0.0, ..driven.clone() };
        let frame = Pose::new(DVec3::new(0.3, 0.1, -0.2), DQuat::from_rotation_y(0.7));
        let grasp = DVec3::new(0.1, -0.05, 0.02);
        let placed = |handle, specification: &Specification| {
            let settings = Settings {
                tool: ToolSettings { handle, ..ToolSettings::default() },
                device: DeviceSettings { frame, workspace_scale: 2.0, ..DeviceSettings::default() },
                ..Settings::default()
            };
            HandlePlacement::at(&settings, grasp, specification)
        };
        let turned = Pose::new(DVec3::new(0.01, 0.02, 0.03), DQuat::from_rotation_z(0.5));
        for (handle, specification, place) in [
            (HandlePlace::Automatic, &driven, grasp),
            (HandlePlace::Automatic, &felt, DVec3::ZERO),
            (HandlePlace::Grasp, &felt, grasp),
            (HandlePlace::MeshOrigin, &driven, DVec3::ZERO),
        ] {
            let placement = placed(handle, specification);
            assert_eq!(placement.handle(), place, "{handle:?}");
            let start = placement.mesh_pose(&Pose::IDENTITY);
            assert!(
                start.translation.distance(frame.translation) < 1e-15 && start.rotation == frame.rotation
            );
            // A rotation of the device leaves the handle's point of the mesh in place.
            let turn = placement.mesh_pose(&Pose::new(DVec3::ZERO, turned.rotation));
            assert!(turn.transform_point(place).distance(start.transform_point(place)) < 1e-15);
            // The inverse mapping.
            let back = placement.device_pose(&placement.mesh_pose(&turned));
            assert!(back.translation.distance(turned.translation) < 1e-15, "{back:?}");
            assert!(back.rotation_vector_to(&turned).length() < 1e-12);
        }
    }
}
