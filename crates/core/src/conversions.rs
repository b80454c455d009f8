//! Conversions of rigid motions from and to the types of other crates.

use glam::{DAffine3, DMat4};
#[cfg(any(feature = "mint", feature = "nalgebra"))]
use glam::{DQuat, DVec3};

use crate::Pose;
#[cfg(feature = "mint")]
use crate::{Twist, Wrench};

impl From<Pose> for DAffine3 {
    fn from(pose: Pose) -> Self {
        Self::from_rotation_translation(pose.rotation, pose.translation)
    }
}

impl From<Pose> for DMat4 {
    fn from(pose: Pose) -> Self {
        Self::from_rotation_translation(pose.rotation, pose.translation)
    }
}

#[cfg(feature = "mint")]
fn vector(mint::Vector3 { x, y, z }: mint::Vector3<f64>) -> DVec3 {
    DVec3::new(x, y, z)
}

#[cfg(feature = "mint")]
fn to_mint(DVec3 { x, y, z }: DVec3) -> mint::Vector3<f64> {
    mint::Vector3 { x, y, z }
}

/// Pose from a translation (m) and a unit quaternion.
#[cfg(feature = "mint")]
impl From<(mint::Vector3<f64>, mint::Quaternion<f64>)> for Pose {
    fn from((translation, rotation): (mint::Vector3<f64>, mint::Quaternion<f64>)) -> Self {
        Self::new(vector(translation), DQuat::from_vec4(vector(rotation.v).extend(rotation.s)))
    }
}

#[cfg(feature = "mint")]
impl From<Pose> for (mint::Vector3<f64>, mint::Quaternion<f64>) {
    fn from(pose: Pose) -> Self {
        let DQuat { x, y, z, w } = pose.rotation;
        (to_mint(pose.translation), mint::Quaternion { v: mint::Vector3 { x, y, z }, s: w })
    }
}

#[cfg(feature = "mint")]
impl From<Pose> for mint::ColumnMatrix4<f64> {
    fn from(pose: Pose) -> Self {
        DMat4::from(pose).to_cols_array_2d().into()
    }
}

/// Twist from a linear (m/s) and an angular (rad/s) velocity.
#[cfg(feature = "mint")]
impl From<(mint::Vector3<f64>, mint::Vector3<f64>)> for Twist {
    fn from((linear, angular): (mint::Vector3<f64>, mint::Vector3<f64>)) -> Self {
        Self::new(vector(linear), vector(angular))
    }
}

#[cfg(feature = "mint")]
impl From<Twist> for (mint::Vector3<f64>, mint::Vector3<f64>) {
    fn from(twist: Twist) -> Self {
        (to_mint(twist.linear), to_mint(twist.angular))
    }
}

/// Wrench from a force (N) and a torque (N·m).
#[cfg(feature = "mint")]
impl From<Wrench> for (mint::Vector3<f64>, mint::Vector3<f64>) {
    fn from(wrench: Wrench) -> Self {
        (to_mint(wrench.force), to_mint(wrench.torque))
    }
}

#[cfg(feature = "nalgebra")]
impl From<nalgebra::Isometry3<f64>> for Pose {
    fn from(isometry: nalgebra::Isometry3<f64>) -> Self {
        let [x, y, z, w] = isometry.rotation.coords.into();
        let translation: [f64; 3] = isometry.translation.vector.into();
        Self::new(DVec3::from_array(translation), DQuat::from_xyzw(x, y, z, w))
    }
}

#[cfg(feature = "nalgebra")]
impl From<Pose> for nalgebra::Isometry3<f64> {
    fn from(pose: Pose) -> Self {
        let DQuat { x, y, z, w } = pose.rotation;
        let rotation = nalgebra::Unit::new_unchecked(nalgebra::Quaternion::new(w, x, y, z));
        let [x, y, z] = pose.translation.to_array();
        Self::from_parts(nalgebra::Translation3::new(x, y, z), rotation)
    }
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};

    use super::*;

    const POINT: DVec3 = DVec3::new(-0.3, 4.0, 0.7);

    fn pose() -> Pose {
        Pose::new(DVec3::new(1.0, -2.0, 0.5), DQuat::from_scaled_axis(DVec3::new(0.3, 0.4, -1.2)))
    }

    #[test]
    fn matrices_place_points_as_poses_do() {
        let wanted = pose().transform_point(POINT);
        assert!((DAffine3::from(pose()).transform_point3(POINT) - wanted).length() < 1e-15);
        assert!((DMat4::from(pose()).transform_point3(POINT) - wanted).length() < 1e-15);
    }

    #[cfg(feature = "mint")]
    #[test]
    fn poses_go_through_mint() {
        let parts: (mint::Vector3<f64>, mint::Quaternion<f64>) = pose().into();
        assert_eq!(Pose::from(parts), pose());
        let columns: mint::ColumnMatrix4<f64> = pose().into();
        assert_eq!(DVec3::new(columns.w.x, columns.w.y, columns.w.z), pose().translation);
        let twist = Twist::new(DVec3::X, DVec3::Y);
        let parts: (mint::Vector3<f64>, mint::Vector3<f64>) = twist.into();
        assert_eq!(Twist::from(parts), twist);
    }

    #[cfg(feature = "nalgebra")]
    #[test]
    fn poses_go_through_nalgebra() {
        let isometry: nalgebra::Isometry3<f64> = pose().into();
        assert_eq!(Pose::from(isometry), pose());
        let placed = isometry * nalgebra::Point3::new(POINT.x, POINT.y, POINT.z);
        let wanted = pose().transform_point(POINT);
        assert!((DVec3::new(placed.x, placed.y, placed.z) - wanted).length() < 1e-14);
    }
}
