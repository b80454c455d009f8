//! Tasks of an emulated hand without a path: movements that are common in haptic experiments.
//!
//! A task is defined in the frame of a [`TaskSite`]: up is z, lengths are multiples of the site's size, and
//! heights are above first touch. A hand that intends to be below it presses; how hard depends on its
//! stiffness.

mod parameters;

use std::f64::consts::TAU;

use glam::{DQuat, DVec3};
use palpate_core::Pose;

pub use self::parameters::TaskParameters;
use crate::{IntendedPath, PathError};

/// Height above first touch in free motion, and intended depth below it when pressing, in sizes.
const CLEARANCE: f64 = 0.1;
const PRESS_DEPTH: f64 = 0.03;
/// Amplitude of scrubbing and stroking to either side, in sizes.
const STROKE_AMPLITUDE: f64 = 0.1;
/// Amplitude of the rotation about the vertical, rad.
const TWIST_AMPLITUDE: f64 = 0.05;
/// Offset from the hole at which a peg first touches, and depth of insertion, in sizes.
const HOLE_OFFSET: f64 = 0.05;
const INSERTION_DEPTH: f64 = 0.5;
/// Number of strokes of a file in a cycle, and intended depth on the way back, in sizes.
const FILE_STROKES: f64 = 4.0;
const FILE_RETURN_DEPTH: f64 = 0.005;

/// A movement that an emulated hand repeats.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Task {
    /// Comes down, presses, scrubs along two axes while it twists, and withdraws.
    #[default]
    Explore,
    /// Comes down, presses, holds, and withdraws.
    Press,
    /// Strokes along x, lifts, and goes back through the air.
    Stroke,
    /// Presses and rubs to and fro along x, twice a second.
    Scrub,
    /// Taps, twice a second.
    Tap,
    /// Touches down beside a hole, searches it in a spiral, pushes in, twists, and pulls out.
    PegInsertion,
    /// Turns a nut on and off again: presses lightly along the axis while it turns clockwise, seen from
    /// above, and pulls lightly while it turns back. The intended position goes along the axis with the
    /// pitch.
    TurnNut,
    /// Files along x: strokes forward under pressure, and back on the surface, lightly.
    File,
}

/// Location and scale of a task.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TaskSite {
    /// Position of the handle, unrotated, at which the held object first touches on its way down, m.
    pub touch: DVec3,
    /// Centre of the task's rotations, from the handle's origin, m.
    pub pivot: DVec3,
    /// Unit of the task's lengths, m: for instance the bounding radius of the held object.
    pub size: f64,
}

impl Task {
    /// All tasks with their names.
    pub const ALL: [(&'static str, Self); 8] = [
        ("explore", Self::Explore),
        ("press", Self::Press),
        ("stroke", Self::Stroke),
        ("scrub", Self::Scrub),
        ("tap", Self::Tap),
        ("peg-insertion", Self::PegInsertion),
        ("turn-nut", Self::TurnNut),
        ("file", Self::File),
    ];

    /// The task with this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.iter().find(|(known, _)| *known == name).map(|&(_, task)| task)
    }

    /// Period of the task with the default parameters, s.
    pub fn cycle(self) -> f64 {
        TaskParameters::default().cycle(self)
    }

    /// Horizontal offset from the site at which the task first touches, in sizes: [`TaskSite::touch`] must be
    /// found there.
    pub fn beside(self) -> DVec3 {
        match self {
            Self::PegInsertion => DVec3::X * HOLE_OFFSET,
            _ => DVec3::ZERO,
        }
    }

    /// Intended pose of the handle at a time (s), with the default parameters.
    pub fn pose(self, time: f64, site: &TaskSite) -> Pose {
        TaskParameters::default().pose(self, time, site)
    }

    /// The task as a path for a hand, repeated without end, with the default parameters.
    ///
    /// # Errors
    /// If the site is so large or so far away that a pose is out of a path's range.
    pub fn path(self, site: &TaskSite) -> Result<IntendedPath, PathError> {
        TaskParameters::default().path(self, site)
    }

    /// Offset from first touch (in sizes) and rotation about the vertical (rad) at a phase of the cycle, 0 to
    /// 1.
    fn movement(self, phase: f64) -> (DVec3, f64) {
        // Rises from 0 to 1 as the phase goes from one value to the other.
        let ramp = |from: f64, to: f64| smooth_step((phase - from) / (to - from));
        // Down in the first part of the cycle, up in the last.
        let pressed = |part: f64| smooth_step(phase / part).min(smooth_step((1.0 - phase) / part));
        let height = |down: f64| CLEARANCE - (CLEARANCE + PRESS_DEPTH) * down;
        match self {
            Self::Explore => {
                let rubbing = ((phase - 0.2) / 0.6).clamp(0.0, 1.0);
                let side = |turns: f64| STROKE_AMPLITUDE * (turns * TAU * rubbing).sin();
                (
                    DVec3::new(side(2.0), side(3.0), height(pressed(0.2))),
                    TWIST_AMPLITUDE * (2.0 * TAU * rubbing).sin(),
                )
            }
            Self::Press => (DVec3::Z * height(pressed(0.3)), 0.0),
            Self::Stroke => {
                let along = STROKE_AMPLITUDE * (2.0 * (ramp(0.15, 0.6) - ramp(0.75, 1.0)) - 1.0);
                let down = ramp(0.0, 0.15) - ramp(0.6, 0.75);
                (DVec3::new(along, 0.0, height(down)), 0.0)
            }
            Self::Scrub => {
                let rubbing = ((phase - 0.1) / 0.8).clamp(0.0, 1.0);
                let along = STROKE_AMPLITUDE * (2.0 * 8.0 * TAU * rubbing).sin();
                (DVec3::new(along, 0.0, height(pressed(0.1))), 0.0)
            }
            Self::Tap => (DVec3::Z * (0.5 * CLEARANCE - (0.5 * CLEARANCE + PRESS_DEPTH) * pressed(0.5)), 0.0),
            Self::File => filing(phase, pressed(0.15)),
            // Its lengths are no multiples of the site's size.
            Self::TurnNut => (DVec3::ZERO, 0.0),
            Self::PegInsertion => {
                // The spiral begins where the peg first touches and ends at the hole; the hand retraces it in
                // the air.
                let inward = ramp(0.15, 0.5) - ramp(0.93, 1.0);
                let spiral = DQuat::from_rotation_z(2.0 * TAU * inward) * self.beside() * (1.0 - inward);
                let down = ramp(0.0, 0.15) - ramp(0.85, 0.93);
                let depth = INSERTION_DEPTH * (ramp(0.5, 0.65) - ramp(0.78, 0.88));
                let twisting = ((phase - 0.65) / 0.13).clamp(0.0, 1.0);
                let offset = spiral - self.beside() + DVec3::Z * (height(down) - depth);
                (offset, TWIST_AMPLITUDE * (2.0 * TAU * twisting).sin())
            }
        }
    }
}

/// Offset (in sizes) and rotation (rad) of a file at a phase of the cycle, while it is down from 0 to 1.
fn filing(phase: f64, down: f64) -> (DVec3, f64) {
    let working = ((phase - 0.15) / 0.7).clamp(0.0, 1.0) * FILE_STROKES;
    let stroke = working.fract();
    // Two thirds of a stroke go forward.
    let forward = smooth_step(stroke / 0.67) - smooth_step((stroke - 0.67) / 0.33);
    let bearing = smooth_step(stroke / 0.1) - smooth_step((stroke - 0.6) / 0.1);
    let along = STROKE_AMPLITUDE * (2.0 * forward - 1.0);
    let depth = FILE_RETURN_DEPTH + (PRESS_DEPTH - FILE_RETURN_DEPTH) * bearing;
    (DVec3::new(along, 0.0, CLEARANCE - (CLEARANCE + depth) * down), 0.0)
}

/// 0 below 0, 1 above 1, smooth between.
fn smooth_step(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SITE: TaskSite =
        TaskSite { touch: DVec3::new(0.1, 0.2, 0.3), pivot: DVec3::new(0.0, 0.01, 0.0), size: 0.05 };

    /// Each task does what its name says, and a hand can follow it: it begins and ends at one position above
    /// the site, its speed stays below that of a hand, and rotations leave the pivot in place.
    #[test]
    fn tasks_do_what_they_are_named_after() {
        for (name, task) in Task::ALL {
            assert_eq!(Task::named(name), Some(task));
            let place =
                |time: f64| task.pose(time, &SITE).transform_point(SITE.pivot) - SITE.touch - SITE.pivot;
            let steps = (task.cycle() * 1000.0) as usize;
            let places: Vec<DVec3> = (0..=steps).map(|i| place(i as f64 * 1e-3) / SITE.size).collect();
            let lowest = places.iter().fold(f64::INFINITY, |lowest, place| lowest.min(place.z));
            let sideways = places.iter().fold(0.0, |most: f64, place| most.max(place.x.abs()));
            let pressed = places.iter().filter(|place| place.z < 0.0).count();
            let fastest = places.windows(2).fold(0.0, |most: f64, pair| most.max(pair[0].distance(pair[1])));
            assert!((places[0] - places[steps]).length() < 1e-3, "{name}: {} {}", places[0], places[steps]);
            assert!(places[0].z > 0.04, "{name} begins at {}", places[0]);
            assert!(fastest < 1.1e-2, "{name}: {fastest} sizes in a millisecond");
            assert!(pressed > steps / 4 && pressed < steps * 9 / 10, "{name}: {pressed} of {steps}");
            let nut = TaskParameters::default();
            let deepest = match task {
                Task::PegInsertion => INSERTION_DEPTH + PRESS_DEPTH,
                Task::TurnNut => (nut.press + nut.turns * nut.pitch) / SITE.size,
                _ => PRESS_DEPTH,
            };
            assert!((lowest + deepest).abs() < 1e-3, "{name} goes down to {lowest}");
            let to_the_side = match task {
                Task::Press | Task::Tap | Task::TurnNut => 0.0,
                Task::PegInsertion => 2.0 * HOLE_OFFSET,
                _ => STROKE_AMPLITUDE,
            };
            assert!((sideways - to_the_side).abs() < 0.3 * to_the_side + 1e-12, "{name}: {sideways}");
        }
        assert_eq!(Task::named("Press"), None);
    }

    /// A peg is pushed in over the hole only, not beside it.
    #[test]
    fn a_peg_goes_in_where_the_hole_is() {
        let task = Task::PegInsertion;
        for i in 0..8000 {
            let place =
                (task.pose(f64::from(i) * 1e-3, &SITE).translation - SITE.touch) / SITE.size + task.beside();
            if place.z < -1.01 * PRESS_DEPTH {
                assert!(place.truncate().length() < 1e-2, "{place} at {i} ms");
            }
        }
    }

    /// A file bears on its way forward, and rests on the surface on its way back.
    #[test]
    fn a_file_presses_forward_only() {
        let place =
            |step: u32| (Task::File.pose(f64::from(step) * 1e-3, &SITE).translation - SITE.touch) / SITE.size;
        let [mut forward, mut back] = [(0.0, 0.0); 2];
        // Between coming down and withdrawing.
        for step in 900..5100 {
            let along = place(step + 1).x - place(step).x;
            let part = if along > 0.0 { &mut forward } else { &mut back };
            *part = (part.0 + along.abs(), part.1 - along.abs() * place(step).z);
        }
        let stroke = 2.0 * STROKE_AMPLITUDE * FILE_STROKES;
        assert!((forward.0 - stroke).abs() < 1e-3 && (back.0 - stroke).abs() < 1e-3, "{forward:?} {back:?}");
        let [pressed, rested] = [forward, back].map(|(length, pressed)| pressed / length);
        assert!(
            pressed > 0.8 * PRESS_DEPTH && (0.0..0.3 * PRESS_DEPTH).contains(&rested),
            "{pressed} {rested}"
        );
    }

    #[test]
    fn a_path_is_the_task_over_and_over() {
        let IntendedPath::Function(mut path) = Task::Stroke.path(&SITE).unwrap() else {
            panic!("a function")
        };
        for i in 0..10_000 {
            let time = f64::from(i) * 1e-3;
            let (pose, twist) = path(time);
            let expected = Task::Stroke.pose(time, &SITE);
            assert!(pose.translation.distance(expected.translation) < 1e-4 * SITE.size, "{time}");
            assert!(twist.is_finite() && twist.linear.length() < 0.02);
        }
        let far = TaskSite { touch: DVec3::X * 1e9, ..SITE };
        assert!(Task::Press.path(&far).is_err());
    }
}
