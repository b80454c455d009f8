//! Where on the grasped object the device's handle is, and where both are in the world.

use palpate_core::Pose;
use palpate_core::glam::DVec3;
use palpate_device::Specification;
use palpate_dynamics::DeviceMapping;

use crate::scene::object::Object;
use crate::settings::{HandlePlace, Settings};

/// The device's workspace in the world, and the handle on the grasped object. With the handle in the middle of its workspace,
/// unturned, the mesh's frame is at the [device frame](crate::settings::DeviceSettings::frame), wherever the handle is on the object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandlePlacement {
    mapping: DeviceMapping,
    /// Where the handle is, in the mesh's frame, m.
    handle: DVec3,
}

/// Whether a device drives any axis, so that anything reaches the hand.
pub(crate) fn renders(specification: &Specification) -> bool {
    let Specification { peak_force, peak_torque, actuated, .. } = specification;
    let driven = |axes: [bool; 3], peak: f64| peak > 0.0 && axes.contains(&true);
    driven(actuated.translation, *peak_force) || driven(actuated.rotation, *peak_torque)
}

impl HandlePlacement {
    /// For an object in the hand that holds a device.
    pub fn new(settings: &Settings, probe: &Object, specification: &Specification) -> Self {
        let grasp = settings.tool.grasp.map_or(probe.clod.source.center_of_mass, |grasp| grasp.translation);
        Self::at(settings, grasp, specification)
    }

    /// With the grasp at a place in the mesh's frame (m).
    pub(crate) fn at(settings: &Settings, grasp: DVec3, specification: &Specification) -> Self {
        let handle = match settings.tool.handle {
            HandlePlace::Automatic if renders(specification) => grasp,
            HandlePlace::Grasp => grasp,
            HandlePlace::Automatic | HandlePlace::MeshOrigin => DVec3::ZERO,
        };
        Self::holding(settings, handle)
    }

    /// With the handle at a place in the mesh's frame (m).
    pub(crate) fn holding(settings: &Settings, handle: DVec3) -> Self {
        let base = settings.device.frame * Pose::from_translation(handle);
        Self { mapping: DeviceMapping::new(settings.device.workspace_scale, base), handle }
    }

    /// Takes the handle's motion to the world.
    pub fn mapping(&self) -> &DeviceMapping {
        &self.mapping
    }

    /// Where the handle is on the object, in the mesh's frame, m.
    pub fn handle(&self) -> DVec3 {
        self.handle
    }

    /// How far the grasp (in the mesh's frame) is from the handle, m at the device.
    pub(crate) fn lever(&self, grasp: &Pose) -> f64 {
        self.handle.distance(grasp.translation) / self.mapping.scale
    }

    /// Where the mesh's frame is in the world if the handle is at a pose of the device and nothing holds the object back.
    pub fn mesh_pose(&self, device: &Pose) -> Pose {
        self.mapping.pose(device) * Pose::from_translation(-self.handle)
    }

    /// Where the device has the handle for the mesh's frame to be at a pose in the world: undoes [`Self::mesh_pose`].
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
    fn the_handle_is_where_it_is_put_and_the_mesh_where_it_was() {
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
            // A turn leaves the handle's place on the mesh where it is.
            let turn = placement.mesh_pose(&Pose::new(DVec3::ZERO, turned.rotation));
            assert!(turn.transform_point(place).distance(start.transform_point(place)) < 1e-15);
            // And back.
            let back = placement.device_pose(&placement.mesh_pose(&turned));
            assert!(back.translation.distance(turned.translation) < 1e-15, "{back:?}");
            assert!(back.rotation_vector_to(&turned).length() < 1e-12);
        }
    }
}
