//! Encoders of an emulated device: position and orientation rounded to whole steps, and a velocity estimated
//! from them.
//!
//! Position is rounded along each axis of the device, orientation along each component of its rotation
//! vector, which moves it by at most √3/2 steps. A real device rounds its joint angles; the size of the error
//! is the same, its pattern is not.
//!
//! The velocity is the difference of successive rounded readings through a [`LowPass`].

use glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist};

use crate::specification::{Axes, Specification};
use crate::velocity::LowPass;

/// Encoders with a velocity filter.
#[derive(Clone, Debug)]
pub(crate) struct Encoders {
    step: f64,
    angular_step: f64,
    sensed: Axes,
    dt: f64,
    reading: Pose,
    linear: LowPass,
    angular: LowPass,
}

impl Encoders {
    /// Encoders read every `dt` seconds, first at `pose`, at rest.
    pub fn new(specification: &Specification, dt: f64, pose: &Pose) -> Self {
        let mut encoders = Self {
            step: specification.encoder_step,
            angular_step: specification.angular_encoder_step,
            sensed: specification.sensed,
            dt,
            reading: Pose::IDENTITY,
            linear: LowPass::new(specification.velocity_delay),
            angular: LowPass::new(specification.velocity_delay),
        };
        encoders.reading = encoders.encode(pose);
        encoders
    }

    pub fn reading(&self) -> (Pose, Twist) {
        (self.reading, Twist::new(self.linear.velocity(), self.angular.velocity()))
    }

    /// The next reading, `dt` after the last.
    pub fn sample(&mut self, pose: &Pose) {
        let reading = self.encode(pose);
        self.linear.push(reading.translation - self.reading.translation, self.dt);
        self.angular.push(self.reading.rotation_vector_to(&reading), self.dt);
        self.reading = reading;
    }

    fn encode(&self, pose: &Pose) -> Pose {
        let translation = rounded(pose.translation, self.step, self.sensed.translation);
        let rotation = if self.angular_step == 0.0 && self.sensed.rotation == [true; 3] {
            pose.rotation
        } else {
            let turn = Pose::IDENTITY.rotation_vector_to(pose);
            DQuat::from_scaled_axis(rounded(turn, self.angular_step, self.sensed.rotation))
        };
        Pose { translation, rotation }
    }
}

fn rounded(vector: DVec3, step: f64, sensed: [bool; 3]) -> DVec3 {
    let vector = if step > 0.0 { (vector / step).round() * step } else { vector };
    DVec3::select(sensed.into(), vector, DVec3::ZERO)
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;
    use crate::emulated::Emulation;

    fn specification() -> Specification {
        Specification {
            encoder_step: 3e-5,
            angular_encoder_step: 1e-3,
            velocity_delay: 2e-3,
            delay: 0.0,
            ..Emulation::default().specification
        }
    }

    #[test]
    fn readings_are_whole_steps_and_near() {
        let mut rng = StdRng::seed_from_u64(31);
        for _ in 0..5000 {
            let mut number = || rng.random_range(-1.0..1.0);
            let pose = Pose::new(
                DVec3::new(number(), number(), number()) * 0.1,
                DQuat::from_xyzw(number(), number(), number(), number()).normalize(),
            );
            let (reading, twist) = Encoders::new(&specification(), 1e-4, &pose).reading();
            assert_eq!(twist, Twist::ZERO);
            for i in 0..3 {
                let steps = reading.translation[i] / 3e-5;
                assert!((steps - steps.round()).abs() < 1e-9);
                assert!((reading.translation[i] - pose.translation[i]).abs() <= 1.5e-5 * (1.0 + 1e-9));
            }
            assert!(reading.rotation_vector_to(&pose).length() <= 0.5 * 3_f64.sqrt() * 1e-3 * (1.0 + 1e-6));
            assert!(reading.is_valid());
        }
    }

    #[test]
    fn velocity_lags_a_steady_acceleration_by_the_stated_delay() {
        let unrounded = Specification { encoder_step: 0.0, angular_encoder_step: 0.0, ..specification() };
        let (dt, acceleration) = (1e-5, 2.0);
        let at = |t: f64| {
            let travel = 0.5 * acceleration * t * t;
            Pose::new(DVec3::Y * travel, DQuat::from_rotation_z(travel))
        };
        let mut encoders = Encoders::new(&unrounded, dt, &at(0.0));
        for i in 1..=5000 {
            encoders.sample(&at(f64::from(i) * dt));
        }
        let expected = acceleration * (0.05 - unrounded.velocity_delay);
        let (_, twist) = encoders.reading();
        assert!((twist.linear.y - expected).abs() < 2.0 * acceleration * dt, "{} m/s", twist.linear.y);
        assert!((twist.angular.z - expected).abs() < 2.0 * acceleration * dt);
    }

    #[test]
    fn a_single_step_of_the_encoder_shows_as_its_size_over_the_delay() {
        let mut encoders = Encoders::new(&specification(), 1e-4, &Pose::IDENTITY);
        encoders.sample(&Pose::from_translation(DVec3::X * 2e-5));
        let height = encoders.reading().1.linear.x;
        assert!((height - 3e-5 / 2.1e-3).abs() < 1e-12, "{height}");
        for _ in 0..1000 {
            encoders.sample(&Pose::from_translation(DVec3::X * 2e-5));
        }
        assert!(encoders.reading().1.linear.x < 1e-9);
    }

    #[test]
    fn axes_that_are_not_sensed_read_zero() {
        let partial = Specification {
            sensed: Axes { translation: [true, false, true], rotation: [false; 3] },
            ..specification()
        };
        let pose = Pose::new(DVec3::splat(0.1), DQuat::from_rotation_x(0.5));
        let (reading, _) = Encoders::new(&partial, 1e-4, &pose).reading();
        assert_eq!((reading.translation.y, reading.rotation), (0.0, DQuat::IDENTITY));
        assert!(reading.translation.x > 0.09);
    }
}
