//! A hand that is steered while it moves, by keys or by a mouse.

use glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist};

use crate::IntendedPath;

/// Natural frequency of the hand's approach to its target, 1/s.
const APPROACH_RATE: f64 = 15.0;
/// Speed limits of the hand: m/s and rad/s.
const MAX_SPEED: f64 = 0.5;
const MAX_ANGULAR_SPEED: f64 = 6.0;

/// Steers an emulated hand from any thread, without ever making it wait.
///
/// The hand approaches its target as a critically damped spring does, within a third of a second for a short
/// distance, at most at half a metre and one turn a second.
#[derive(Debug)]
pub struct Steering {
    input: triple_buffer::Input<Pose>,
    aim: Pose,
}

impl Steering {
    /// A steering that begins at a pose, and the path of the hand that it steers (device axes).
    pub fn new(start: Pose) -> (Self, IntendedPath) {
        let start = if start.is_valid() { start } else { Pose::IDENTITY };
        let (input, mut output) = triple_buffer::triple_buffer(&start);
        let mut hand = Hand { pose: start, twist: Twist::ZERO, time: 0.0 };
        let path = IntendedPath::function(move |time| hand.follow(output.read(), time));
        (Self { input, aim: start }, path)
    }

    /// Sets the hand's target pose (device axes). One that is not finite or not of unit length is ignored.
    pub fn aim(&mut self, pose: Pose) {
        if pose.is_valid() {
            self.aim = pose;
            self.input.write(pose);
        }
    }

    /// The target pose set last.
    pub fn aimed(&self) -> Pose {
        self.aim
    }
}

struct Hand {
    pose: Pose,
    twist: Twist,
    /// Time of the last step, s.
    time: f64,
}

impl Hand {
    fn follow(&mut self, aim: &Pose, time: f64) -> (Pose, Twist) {
        let dt = (time - std::mem::replace(&mut self.time, time)).max(0.0);
        let away = self.pose.translation - aim.translation;
        let (step, linear) = approach(away, self.twist.linear, MAX_SPEED, dt);
        let (turn, angular) =
            approach(aim.rotation_vector_to(&self.pose), self.twist.angular, MAX_ANGULAR_SPEED, dt);
        self.pose.translation += step;
        self.pose.rotation = (DQuat::from_scaled_axis(turn) * self.pose.rotation).normalize();
        self.twist = Twist::new(linear, angular);
        (self.pose, self.twist)
    }
}

/// Displacement and velocity after a time `dt` (s), from an offset `away` to the target and a velocity: the
/// exact solution of x″ + 2 r x′ + r² x = 0, with r = [`APPROACH_RATE`]. Offset and velocity are shortened so
/// that the speed stays within `fastest`.
fn approach(away: DVec3, velocity: DVec3, fastest: f64, dt: f64) -> (DVec3, DVec3) {
    // A constant offset of this length leads to a speed of APPROACH_RATE / 2 times its length.
    let away = away.clamp_length_max(2.0 * fastest / APPROACH_RATE);
    let velocity = velocity.clamp_length_max(fastest);
    let decay = (-APPROACH_RATE * dt).exp();
    let slope = (velocity + away * APPROACH_RATE) * dt;
    ((away + slope) * decay - away, (velocity - slope * APPROACH_RATE) * decay)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path() -> (Steering, impl FnMut(f64) -> (Pose, Twist)) {
        let (steering, path) = Steering::new(Pose::IDENTITY);
        let IntendedPath::Function(path) = path else { panic!("a function") };
        (steering, path)
    }

    /// The hand arrives, keeps to its speed limits and moves as its twist says, whatever the sampling times.
    #[test]
    fn the_hand_reaches_its_target() {
        let goal = Pose::new(DVec3::new(0.02, -0.1, 0.05), DQuat::from_rotation_y(1.2));
        let (mut steering, mut path) = path();
        let mut before = path(0.0);
        assert_eq!(before.0, Pose::IDENTITY);
        steering.aim(goal);
        for i in 1..=1000 {
            let (pose, twist) = path(f64::from(i) * 1e-3);
            assert!(
                twist.linear.length() <= MAX_SPEED + 1e-9
                    && twist.angular.length() <= MAX_ANGULAR_SPEED + 1e-9
            );
            let mean = (before.1.linear + twist.linear) * 0.5e-3;
            assert!((pose.translation - before.0.translation - mean).length() < 2e-6);
            let mean = (before.1.angular + twist.angular) * 0.5e-3;
            assert!((before.0.rotation_vector_to(&pose) - mean).length() < 2e-5);
            before = (pose, twist);
        }
        let (pose, twist) = before;
        assert!(pose.translation.distance(goal.translation) < 1e-5, "{pose:?}");
        assert!(pose.rotation_vector_to(&goal).length() < 1e-4 && twist.linear.length() < 1e-4);

        let (mut steering, mut coarse) = self::path();
        steering.aim(Pose::from_translation(DVec3::X * 0.05));
        let once = coarse(0.2).0;
        let (mut steering, mut fine) = self::path();
        steering.aim(Pose::from_translation(DVec3::X * 0.05));
        let often = (1..=200).map(|i| fine(f64::from(i) * 1e-3).0).last().unwrap();
        assert!(once.translation.distance(often.translation) < 1e-12);
    }

    #[test]
    fn invalid_targets_are_ignored() {
        let (mut steering, mut path) = path();
        let place = Pose::from_translation(DVec3::Y * 0.01);
        steering.aim(place);
        steering.aim(Pose::from_translation(DVec3::NAN));
        assert_eq!(steering.aimed(), place);
        for time in [1.0, 0.5, 3.0] {
            assert!(path(time).0.is_valid());
        }
        let (steering, _) = Steering::new(Pose::from_translation(DVec3::INFINITY));
        assert_eq!(steering.aimed(), Pose::IDENTITY);
    }
}
