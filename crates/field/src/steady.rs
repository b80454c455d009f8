//! Extrapolation of steady motion.

use palpate_core::Pose;
use palpate_core::glam::{DQuat, DVec3};

use crate::body::FieldBody;
use crate::slack::motion_bound;

/// Motion of a probe relative to a scene object, with the velocity from the last pose to this one, about the
/// probe's centre.
pub struct Steady {
    pub pose: Pose,
    center: DVec3,
    /// Displacement of the centre in each query, m, and rotation vector, rad, both in the scene object's
    /// frame.
    shift: DVec3,
    turn: DVec3,
    /// Upper bound of the change of any distance between the surfaces in each query, m.
    pub step: f64,
}

impl Steady {
    /// The motion from one pose to the next, probe to scene object. If the first is not known, the probe
    /// stays where it is, and the step is infinite.
    pub fn new(last: Option<Pose>, pose: &Pose, probe: &FieldBody) -> Self {
        let center = pose.transform_point(probe.center);
        let Some(last) = last else {
            return Self { pose: *pose, center, shift: DVec3::ZERO, turn: DVec3::ZERO, step: f64::INFINITY };
        };
        Self {
            pose: *pose,
            center,
            shift: center - last.transform_point(probe.center),
            turn: (pose.rotation * last.rotation.inverse()).normalize().to_scaled_axis(),
            step: motion_bound(&last, pose, probe.center, probe.radius),
        }
    }

    /// The pose after a number of queries.
    pub fn after(&self, queries: f64) -> Pose {
        let turn = DQuat::from_scaled_axis(queries * self.turn);
        let arm = turn * (self.pose.translation - self.center);
        Pose::new(self.center + queries * self.shift + arm, (turn * self.pose.rotation).normalize())
    }
}

#[cfg(test)]
mod tests {
    use palpate_models::Model;

    use super::*;
    use crate::body::FieldOptions;

    #[test]
    fn steady_motion_goes_on() {
        let mesh = Model::Torus.generate(500).expect("in range");
        let radius = mesh.bounding_sphere().radius;
        let options = FieldOptions { memory: 1_000_000, ..FieldOptions::new(0.1 * radius) };
        let probe = FieldBody::new(&mesh, &options);
        let pose = |time: f64| {
            let turn = DQuat::from_scaled_axis(0.02 * time * DVec3::new(0.6, 0.0, 0.8));
            let center = DVec3::new(1.0, 2.0, 3.0) + 0.1 * time * DVec3::X;
            Pose::new(center - turn * probe.center, turn)
        };
        let motion = Steady::new(Some(pose(4.0)), &pose(5.0), &probe);
        for queries in [0.0, 0.5, 1.0, 20.0] {
            let (found, wanted) = (motion.after(queries), pose(5.0 + queries));
            assert!(found.translation.distance(wanted.translation) < 1e-9, "{found:?} for {wanted:?}");
            assert!(found.rotation.angle_between(wanted.rotation) < 1e-7, "{found:?} for {wanted:?}");
        }
        assert_eq!(Steady::new(None, &pose(1.0), &probe).after(9.0), pose(1.0), "at rest");
    }
}
