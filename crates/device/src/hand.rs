//! The hand that holds an emulated handle: a mass, damper and spring, in translation and in rotation, between
//! the handle and the path that the user intends.
//!
//! Measured hand and arm of one person: 0.554 kg, 6.45 N·s/m, 135 N/m (van Beek et al., 2015), here
//! [`Hand::ARM`]. The lighter grips and the angular values span the ranges usual in the literature on grip
//! impedance; they are not one person's.

use std::f64::consts::TAU;

use glam::DVec3;
use palpate_core::{Pose, Twist};
use serde::{Deserialize, Serialize};

use crate::PathError;
use crate::path::{Interpolation, Keyframe, MotionPath};

/// Rate at which a repeated movement is sampled, Hz.
const CYCLE_RATE: f64 = 100.0;

/// A hand's passive impedance, held rigidly to the handle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Hand {
    /// Mass that moves with the handle, kg.
    pub mass: f64,
    /// Damping towards the intended velocity, N·s/m.
    pub damping: f64,
    /// Stiffness towards the intended position, N/m.
    pub stiffness: f64,
    /// Rotational inertia that turns with the handle, kg·m², the same about every axis.
    pub inertia: f64,
    /// Angular damping towards the intended angular velocity, N·m·s/rad.
    pub angular_damping: f64,
    /// Angular stiffness towards the intended orientation, N·m/rad.
    pub angular_stiffness: f64,
    /// Radius of the circle in the device's xy plane that the intended position trembles on, m: the
    /// amplitude to each side. The twist includes the tremor's velocity.
    #[serde(default)]
    pub tremor: f64,
    /// Frequency of the tremor, Hz. Physiological tremor of the hand is at 8 to 12 Hz.
    #[serde(default = "tremor_frequency")]
    pub tremor_frequency: f64,
}

/// Time over which a tremor sets in, s, so that a handle that starts at rest is not jerked.
const TREMOR_ONSET: f64 = 0.5;

const fn tremor_frequency() -> f64 {
    8.0
}

impl Hand {
    /// No hand: the handle is released.
    pub const NONE: Self = Self {
        mass: 0.0,
        damping: 0.0,
        stiffness: 0.0,
        inertia: 0.0,
        angular_damping: 0.0,
        angular_stiffness: 0.0,
        tremor: 0.0,
        tremor_frequency: tremor_frequency(),
    };
    /// Fingertips.
    pub const LIGHT: Self = Self {
        mass: 0.05,
        damping: 2.0,
        stiffness: 100.0,
        inertia: 1e-4,
        angular_damping: 0.005,
        angular_stiffness: 0.3,
        tremor: 0.0,
        tremor_frequency: tremor_frequency(),
    };
    /// A relaxed pen grip.
    pub const GRIP: Self = Self {
        mass: 0.1,
        damping: 5.0,
        stiffness: 300.0,
        inertia: 1e-3,
        angular_damping: 0.02,
        angular_stiffness: 1.0,
        tremor: 0.0,
        tremor_frequency: tremor_frequency(),
    };
    /// A tight grip.
    pub const FIRM: Self = Self {
        mass: 0.2,
        damping: 10.0,
        stiffness: 700.0,
        inertia: 3e-3,
        angular_damping: 0.05,
        angular_stiffness: 3.0,
        tremor: 0.0,
        tremor_frequency: tremor_frequency(),
    };
    /// Hand and arm moving together.
    pub const ARM: Self = Self {
        mass: 0.554,
        damping: 6.45,
        stiffness: 135.0,
        inertia: 3e-3,
        angular_damping: 0.05,
        angular_stiffness: 3.0,
        tremor: 0.0,
        tremor_frequency: tremor_frequency(),
    };

    /// Named hands.
    pub const PRESETS: [(&'static str, Self); 5] = [
        ("none", Self::NONE),
        ("light", Self::LIGHT),
        ("grip", Self::GRIP),
        ("firm", Self::FIRM),
        ("arm", Self::ARM),
    ];

    /// The hand with this name.
    pub fn preset(name: &str) -> Option<Self> {
        Self::PRESETS.iter().find(|(known, _)| *known == name).map(|&(_, hand)| hand)
    }

    /// Displacement of the intended position by the tremor (m) and its velocity (m/s), at a time (s).
    pub(crate) fn tremble(&self, time: f64) -> (DVec3, DVec3) {
        let rate = TAU * self.tremor_frequency;
        let (sin, cos) = (rate * time).sin_cos();
        let x = (time / TREMOR_ONSET).clamp(0.0, 1.0);
        let radius = self.tremor * x * x * (3.0 - 2.0 * x);
        let growth = self.tremor * 6.0 * x * (1.0 - x) / TREMOR_ONSET;
        let (out, along) = (DVec3::new(sin, cos, 0.0), DVec3::new(cos, -sin, 0.0));
        (out * radius, out * growth + along * (radius * rate))
    }
}

impl Default for Hand {
    fn default() -> Self {
        Self::GRIP
    }
}

/// Intended path of the hand: pose by time since the start (s), in the device's axes.
pub enum IntendedPath {
    /// Stay at one pose.
    Still(Pose),
    /// Follow samples, and hold the last.
    Recorded(MotionPath),
    /// Follow a function of time that gives a pose and its derivative. A result that is not finite is ignored
    /// and the last finite one held. A function that allocates makes reading the device allocate.
    Function(Box<dyn FnMut(f64) -> (Pose, Twist) + Send>),
}

impl Default for IntendedPath {
    fn default() -> Self {
        Self::Still(Pose::IDENTITY)
    }
}

impl From<Pose> for IntendedPath {
    fn from(pose: Pose) -> Self {
        Self::Still(pose)
    }
}

impl From<MotionPath> for IntendedPath {
    fn from(path: MotionPath) -> Self {
        Self::Recorded(path)
    }
}

impl IntendedPath {
    /// Repeats a movement with a period of `seconds`: `pose` at times from 0 to `seconds`, sampled 100 times
    /// a second and interpolated with a continuous twist.
    ///
    /// # Errors
    /// If a pose is not finite or out of a path's range.
    pub fn cycle(seconds: f64, pose: impl Fn(f64) -> Pose) -> Result<Self, PathError> {
        let samples = (seconds * CYCLE_RATE).round().max(1.0) as usize;
        let keyframe = |sample: usize| {
            let time = sample as f64 / samples as f64 * seconds;
            Keyframe { time, pose: pose(time) }
        };
        let cycle = MotionPath::new((0..=samples).map(keyframe).collect(), Interpolation::Smooth)?;
        let mut segment = 0;
        Ok(Self::function(move |time| {
            let point = cycle.at_near(time.rem_euclid(seconds), &mut segment);
            (point.pose, point.twist)
        }))
    }

    /// Follows `function`, which gives the pose and its derivative at a time in s.
    pub fn function(function: impl FnMut(f64) -> (Pose, Twist) + Send + 'static) -> Self {
        Self::Function(Box::new(function))
    }
}

impl std::fmt::Debug for IntendedPath {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Still(pose) => f.debug_tuple("Still").field(pose).finish(),
            Self::Recorded(path) => f.debug_tuple("Recorded").field(&path.keyframes().len()).finish(),
            Self::Function(_) => f.write_str("Function"),
        }
    }
}
