//! Parameters of tasks: how fast and how far a nut is turned, and how the held object is tilted.

use std::f64::consts::TAU;

use glam::{DQuat, DVec3};
use palpate_core::Pose;
use serde::{Deserialize, Serialize};

use super::{CLEARANCE, Task, TaskSite, smooth_step};
use crate::{IntendedPath, PathError};

/// Times in which the hand comes down or withdraws, and in which it changes from pressing to pulling, s.
const APPROACH: f64 = 1.0;
const REVERSAL: f64 = 0.5;
/// Time in which turning gets up to its rate, and comes to rest, s.
const SPEED_UP: f64 = 0.2;
/// Depth of a push or a pull along the axis, below which a hand with the default stiffness exerts 1 N, m.
const PRESS: f64 = 3e-3;

/// How an emulated hand does its task. Values out of range count as the nearest in range.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TaskParameters {
    /// Number of turns in which [`Task::TurnNut`] turns on, and off again; 0.01 to 100.
    pub turns: f64,
    /// Rate of turning, turns a second; 0.01 to 10.
    pub turn_rate: f64,
    /// Travel of the intended position along the axis in a turn, m; −0.1 to 0.1, negative for a left-handed
    /// thread.
    pub pitch: f64,
    /// How far the hand intends to be ahead of the pitch, on and off, m; 0 to 0.1.
    pub press: f64,
    /// Rotation about y in which the object is held throughout a task, about the site's pivot, rad; −1 to 1.
    pub tilt: f64,
}

impl Default for TaskParameters {
    /// Three turns of a nut M16, a turn a second, pressed by 1 N in a relaxed grip; upright.
    fn default() -> Self {
        Self { turns: 3.0, turn_rate: 1.0, pitch: 2e-3, press: PRESS, tilt: 0.0 }
    }
}

impl TaskParameters {
    /// The parameters, each within its range.
    fn in_range(&self) -> Self {
        let Self { turns, turn_rate, pitch, press, tilt } = Self::default();
        let within = |value: f64, low: f64, high: f64, default: f64| {
            if value.is_nan() { default } else { value.clamp(low, high) }
        };
        Self {
            turns: within(self.turns, 0.01, 100.0, turns),
            turn_rate: within(self.turn_rate, 0.01, 10.0, turn_rate),
            pitch: within(self.pitch, -0.1, 0.1, pitch),
            press: within(self.press, 0.0, 0.1, press),
            tilt: within(self.tilt, -1.0, 1.0, tilt),
        }
    }

    /// Period of a task, s.
    pub fn cycle(&self, task: Task) -> f64 {
        match task {
            Task::Explore | Task::Scrub => 10.0,
            Task::Press | Task::Stroke => 4.0,
            Task::Tap => 0.5,
            Task::PegInsertion => 8.0,
            Task::File => 6.0,
            Task::TurnNut => 2.0 * (APPROACH + self.in_range().turning_time()) + REVERSAL,
        }
    }

    /// Times (s) at which [`Task::TurnNut`] begins to turn on and has turned on, and at which it begins to
    /// turn off and has turned off.
    pub fn turning(&self) -> [f64; 4] {
        let turning = self.in_range().turning_time();
        let on = APPROACH + turning;
        [APPROACH, on, on + REVERSAL, on + REVERSAL + turning]
    }

    /// Intended pose of the handle at a time (s).
    pub fn pose(&self, task: Task, time: f64, site: &TaskSite) -> Pose {
        let parameters = self.in_range();
        let cycle = parameters.cycle(task);
        let (offset, angle) = match task {
            Task::TurnNut => parameters.nut(time.rem_euclid(cycle), site.size),
            _ => {
                let (offset, angle) = task.movement((time / cycle).rem_euclid(1.0));
                (offset * site.size, angle)
            }
        };
        let rotation = DQuat::from_rotation_y(parameters.tilt) * DQuat::from_rotation_z(angle);
        let translation = site.touch + offset + site.pivot - rotation * site.pivot;
        Pose::new(translation, rotation)
    }

    /// A task as a path for a hand, repeated without end.
    ///
    /// # Errors
    /// If the site is so large or so far away that a pose is out of a path's range.
    pub fn path(&self, task: Task, site: &TaskSite) -> Result<IntendedPath, PathError> {
        IntendedPath::cycle(self.cycle(task), |time| self.pose(task, time, site))
    }

    /// Time in which the nut is turned on or off, s.
    fn turning_time(&self) -> f64 {
        self.turns / self.turn_rate + SPEED_UP
    }

    /// Turns so many seconds after the beginning of turning: at rest before and after, at the rate between.
    fn turned(&self, time: f64) -> f64 {
        // Integral of a smooth step over the time of speeding up.
        let since = |time: f64| {
            let x = (time / SPEED_UP).clamp(0.0, 1.0);
            SPEED_UP * (x * x * x - 0.5 * x * x * x * x) + (time - SPEED_UP).max(0.0)
        };
        self.turn_rate * (since(time) - since(time - self.turns / self.turn_rate))
    }

    /// Offset of the nut from its first touch (m) and its rotation about the vertical (rad).
    fn nut(&self, time: f64, size: f64) -> (DVec3, f64) {
        let [on, turned_on, off, turned_off] = self.turning();
        let turns = self.turned(time - on) - self.turned(time - off);
        let free = CLEARANCE * size;
        let down = smooth_step(time / APPROACH);
        let pulled = smooth_step((time - turned_on) / REVERSAL);
        let up = smooth_step((time - turned_off) / APPROACH);
        let ahead = free - (free + self.press) * down + 2.0 * self.press * pulled + (free - self.press) * up;
        (DVec3::Z * (ahead - self.pitch * turns), -TAU * turns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SITE: TaskSite =
        TaskSite { touch: DVec3::new(0.1, 0.2, 0.3), pivot: DVec3::new(0.0, 0.01, 0.0), size: 0.02 };

    /// Turns (on is positive) and height over first touch at a time, from the pose.
    fn nut(parameters: &TaskParameters, time: f64) -> (f64, f64) {
        let pose = parameters.pose(Task::TurnNut, time, &SITE);
        let (axis, angle) = pose.rotation.to_axis_angle();
        (-angle * axis.z / TAU, pose.transform_point(SITE.pivot).z - SITE.touch.z)
    }

    #[test]
    fn a_nut_goes_by_its_pitch_in_each_turn() {
        for (turns, turn_rate, pitch) in [(3.0, 0.5, 2e-3), (1.5, 2.0, 1.25e-3), (4.0, 1.0, -3e-3)] {
            let parameters = TaskParameters { turns, turn_rate, pitch, ..TaskParameters::default() };
            let [on, turned_on, off, turned_off] = parameters.turning();
            // At its full rate, on and off.
            for (from, to, sign) in [(on, turned_on, 1.0), (off, turned_off, -1.0)] {
                let middle = 0.5 * (from + to);
                let quarter = 0.25 / turn_rate;
                let (a, b) =
                    (nut(&parameters, middle - 0.5 * quarter), nut(&parameters, middle + 0.5 * quarter));
                let turned = (b.0 - a.0 - (b.0 - a.0).round()) * sign;
                assert!((turned - 0.25).abs() < 1e-9, "{turned} turns in a quarter of a turn's time");
                assert!((b.1 - a.1 + sign * 0.25 * pitch).abs() < 1e-12, "{} m", b.1 - a.1);
            }
            let travel = nut(&parameters, on).1 - nut(&parameters, turned_on).1;
            assert!((travel - turns * pitch).abs() < 1e-12, "{travel} m");
            let pulled = nut(&parameters, off).1 - nut(&parameters, turned_on).1;
            assert!((pulled - 2.0 * parameters.press).abs() < 1e-12, "{pulled} m");
            let (angle, height) = nut(&parameters, parameters.cycle(Task::TurnNut) - 1e-9);
            assert!(angle.abs() < 1e-9 && (height - CLEARANCE * SITE.size).abs() < 1e-9, "{angle} {height}");
        }
    }

    #[test]
    fn turning_is_smooth() {
        let parameters = TaskParameters { turn_rate: 2.0, ..TaskParameters::default() };
        let step = 1e-3;
        let count = (parameters.cycle(Task::TurnNut) / step) as usize;
        let poses: Vec<Pose> =
            (0..=count).map(|i| parameters.pose(Task::TurnNut, i as f64 * step, &SITE)).collect();
        let spins: Vec<f64> =
            poses.windows(2).map(|pair| pair[0].rotation_vector_to(&pair[1]).z / step).collect();
        let fastest = spins.iter().fold(0.0, |most: f64, spin| most.max(spin.abs()));
        assert!((fastest - 2.0 * TAU).abs() < 1e-6, "{fastest} rad/s");
        let jerkiest =
            spins.windows(2).fold(0.0, |most: f64, pair| most.max((pair[1] - pair[0]).abs() / step));
        // A smooth step's slope is 3/2 of a straight one's.
        assert!(jerkiest < 1.6 * fastest / SPEED_UP, "{jerkiest} rad/s²");
        let heights: Vec<f64> = poses.iter().map(|pose| pose.transform_point(SITE.pivot).z).collect();
        let fastest =
            heights.windows(2).fold(0.0, |most: f64, pair| most.max((pair[1] - pair[0]).abs() / step));
        assert!(fastest < 0.02, "{fastest} m/s along the axis");
    }

    #[test]
    fn a_tilt_is_held_about_the_pivot() {
        let parameters = TaskParameters { tilt: 2.0_f64.to_radians(), ..TaskParameters::default() };
        for (_, task) in Task::ALL {
            for step in 0..200 {
                let time = 0.05 * f64::from(step);
                let (pose, upright) = (parameters.pose(task, time, &SITE), task.pose(time, &SITE));
                let leaning = (pose.rotation * DVec3::Z).angle_between(DVec3::Z);
                assert!((leaning - parameters.tilt).abs() < 1e-9, "{task:?}: {leaning} rad");
                let moved = pose.transform_point(SITE.pivot).distance(upright.transform_point(SITE.pivot));
                assert!(moved < 1e-12, "{task:?}: {moved} m");
            }
        }
    }

    #[test]
    fn parameters_out_of_range_are_limited() {
        let wild =
            TaskParameters { turns: f64::INFINITY, turn_rate: 0.0, pitch: f64::NAN, press: -1.0, tilt: 9.0 };
        assert_eq!(wild.cycle(Task::TurnNut), 2.0 * (1.0 + 100.0 / 0.01 + 0.2) + 0.5);
        assert!(wild.pose(Task::TurnNut, 3.0, &SITE).is_valid());
    }
}
