//! From rapier's numbers (f32, of its own version of glam) to palpate's (f64), and back.

use palpate::Pose;
use palpate::glam::{DQuat, DVec3};
use rapier3d::math;

/// A point, or components along axes.
pub fn vector(v: math::Vector) -> DVec3 {
    DVec3::new(v.x.into(), v.y.into(), v.z.into())
}

/// The same to rapier, rounded.
pub fn to_vector(v: DVec3) -> math::Vector {
    math::Vector::new(v.x as f32, v.y as f32, v.z as f32)
}

/// An orientation, of unit length to f64.
pub fn rotation(q: math::Rotation) -> DQuat {
    DQuat::from_xyzw(q.x.into(), q.y.into(), q.z.into(), q.w.into()).normalize()
}

/// A placement.
pub fn pose(pose: &math::Pose) -> Pose {
    Pose::new(vector(pose.translation), rotation(pose.rotation))
}
