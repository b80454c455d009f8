//! Conversions between rapier's types (f32, with its own version of glam) and palpate's (f64).

use palpate::Pose;
use palpate::glam::{DQuat, DVec3};
use rapier3d::math;

/// Converts a point, or components along axes.
pub fn vector(v: math::Vector) -> DVec3 {
    DVec3::new(v.x.into(), v.y.into(), v.z.into())
}

/// Converts to rapier, rounded.
pub fn to_vector(v: DVec3) -> math::Vector {
    math::Vector::new(v.x as f32, v.y as f32, v.z as f32)
}

/// Converts an orientation and normalises it to f64.
pub fn rotation(q: math::Rotation) -> DQuat {
    DQuat::from_xyzw(q.x.into(), q.y.into(), q.z.into(), q.w.into()).normalize()
}

/// Converts a pose.
pub fn pose(pose: &math::Pose) -> Pose {
    Pose::new(vector(pose.translation), rotation(pose.rotation))
}
