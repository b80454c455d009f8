//! Place and scale of the device's workspace in the world (§5.3.3, scaling the workspace).
//!
//! Positions are scaled by s, rotations are not. "Feedback forces must undergo an inverse scaling, to ensure
//! that the coupling stiffness perceived by the user is the same as the coupling stiffness in the virtual
//! world": a force is divided by s. The text does not mention torque. It is divided by s² here, for two
//! equivalent reasons. A force F/s at a lever arm that is r/s in the hand makes the torque r × F/s². And the
//! power at the device is then that of the world divided by s², in translation and rotation alike, so that a
//! passive world stays passive in the hand; with any other factor, energy put in by turning could come out in
//! a different amount by moving. Stiffness along the axes is preserved, power and angular stiffness are
//! divided by s²: the hand feels the world s times smaller, with springs of the same stiffness.

use glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist, Wrench};

use crate::coupling::DeviceMotion;

/// Mapping of the device's motion to the world, and of wrenches back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeviceMapping {
    /// s: distance in the world of a metre at the device. Positive and finite.
    pub scale: f64,
    /// The device's axes and origin in the world.
    pub base: Pose,
    /// The world handle's orientation in the device handle's axes; the identity unless the mapping was
    /// [rebased](Self::rebased).
    pub handle: DQuat,
}

impl DeviceMapping {
    /// A device whose axes are the world's.
    pub const IDENTITY: Self = Self::new(1.0, Pose::IDENTITY);

    /// A device whose axes and origin are at `base` in the world, and whose motion is scaled by `scale`.
    pub const fn new(scale: f64, base: Pose) -> Self {
        Self { scale, base, handle: DQuat::IDENTITY }
    }

    /// The handle's pose in the world for a pose that the device reports.
    pub fn pose(&self, device: &Pose) -> Pose {
        Pose {
            translation: self.base.transform_point(device.translation * self.scale),
            rotation: (self.base.rotation * device.rotation * self.handle).normalize(),
        }
    }

    /// The twist in the world, m/s and rad/s, for a twist of the device.
    pub fn twist(&self, device: &Twist) -> Twist {
        Twist {
            linear: self.base.transform_vector(device.linear * self.scale),
            angular: self.base.transform_vector(device.angular),
        }
    }

    /// Pose and twist in the world for those of the device.
    pub fn motion(&self, device: &DeviceMotion) -> DeviceMotion {
        DeviceMotion { pose: self.pose(&device.pose), twist: self.twist(&device.twist) }
    }

    /// Wrench to send to the device for a wrench (about the handle's origin) in the world: the force divided
    /// by s, the torque by s², in the device's axes.
    pub fn wrench(&self, world: &Wrench) -> Wrench {
        let to_device = self.base.rotation.conjugate();
        Wrench {
            force: to_device * (world.force / self.scale),
            torque: to_device * (world.torque / (self.scale * self.scale)),
        }
    }

    /// The pose that the device reports for a handle at `world`: the inverse of [`Self::pose`].
    pub fn device_pose(&self, world: &Pose) -> Pose {
        let to_device = self.base.inverse();
        Pose {
            translation: to_device.transform_point(world.translation) / self.scale,
            rotation: (to_device.rotation * world.rotation * self.handle.conjugate()).normalize(),
        }
    }

    /// The mapping with the origin moved and the handle turned so that `device` maps to `world`. Axes and
    /// scale are unchanged: the hand's next motion moves and turns the object in the same directions as
    /// before.
    pub fn rebased(&self, device: &Pose, world: &Pose) -> Self {
        let rotation = self.base.rotation;
        let moved: DVec3 = rotation * (device.translation * self.scale);
        Self {
            scale: self.scale,
            base: Pose { translation: world.translation - moved, rotation },
            handle: ((rotation * device.rotation).conjugate() * world.rotation).normalize(),
        }
    }
}

impl Default for DeviceMapping {
    fn default() -> Self {
        Self::IDENTITY
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

    use super::*;
    use crate::differences::{random_pose, random_twist, random_vector};

    fn random_mapping(rng: &mut StdRng) -> DeviceMapping {
        DeviceMapping {
            scale: 10_f64.powf(rng.random_range(-2.0..2.0)),
            base: random_pose(rng, 1.0),
            handle: random_pose(rng, 1.0).rotation,
        }
    }

    fn distance(a: &Pose, b: &Pose) -> f64 {
        a.translation.distance(b.translation) + a.rotation_vector_to(b).length()
    }

    #[test]
    fn the_twist_is_the_derivative_of_the_pose() {
        let seed = 61;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..200 {
            let mapping = random_mapping(&mut rng);
            let (pose, twist) = (random_pose(&mut rng, 0.2), random_twist(&mut rng, 0.3, 2.0));
            let h = 1e-6;
            let (before, after) =
                (mapping.pose(&pose.moved(&twist, -h)), mapping.pose(&pose.moved(&twist, h)));
            let world = mapping.twist(&twist);
            let linear = (after.translation - before.translation) / (2.0 * h);
            let angular = before.rotation_vector_to(&after) / (2.0 * h);
            let error = (linear - world.linear).length() / mapping.scale + (angular - world.angular).length();
            assert!(error < 1e-7, "seed {seed}, case {case}: {error}");
        }
    }

    #[test]
    fn power_at_the_device_is_that_of_the_world_by_the_square_of_the_scale() {
        let seed = 62;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..200 {
            let mapping = random_mapping(&mut rng);
            let twist = random_twist(&mut rng, 0.3, 2.0);
            let wrench = Wrench::new(random_vector(&mut rng, 5.0), random_vector(&mut rng, 1.0));
            let device = mapping.wrench(&wrench).power(&twist);
            let world = wrench.power(&mapping.twist(&twist)) / (mapping.scale * mapping.scale);
            assert!((device - world).abs() < 1e-9 * (1.0 + world.abs()), "seed {seed}, case {case}");
        }
    }

    #[test]
    fn a_spring_in_the_world_feels_as_stiff_at_the_device() {
        let mapping = DeviceMapping::new(5.0, Pose::from_translation(DVec3::X));
        let force = |x: f64| {
            let world = mapping.pose(&Pose::from_translation(DVec3::Y * x)).translation - DVec3::X;
            mapping.wrench(&Wrench::new(world * -300.0, DVec3::ZERO)).force.y
        };
        assert!((force(0.01) - force(0.0) + 3.0).abs() < 1e-12);
    }

    #[test]
    fn device_poses_come_back_and_rebased_ones_are_where_they_are_put() {
        let seed = 63;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..200 {
            let mapping = random_mapping(&mut rng);
            let (device, world) = (random_pose(&mut rng, 0.2), random_pose(&mut rng, 2.0));
            let error = distance(&mapping.device_pose(&mapping.pose(&device)), &device);
            assert!(error < 1e-10, "seed {seed}, case {case}: {error}");
            let rebased = mapping.rebased(&device, &world);
            assert!(distance(&rebased.pose(&device), &world) < 1e-12, "seed {seed}, case {case}");
            let twist = random_twist(&mut rng, 1.0, 1.0);
            assert_eq!(rebased.twist(&twist), mapping.twist(&twist), "the axes stay");
        }
    }
}
