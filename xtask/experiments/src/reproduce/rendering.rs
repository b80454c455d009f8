//! Built-in models and paths that the experiments render.

use palpate::device::{Interpolation, Keyframe, MotionPath};
use palpate::{Object, Pose};

/// Opens a built-in model by its name, with its hierarchy.
///
/// # Errors
/// If there is no such model.
pub fn open(name: &str) -> Result<Object, String> {
    Object::model(name).map_err(|error| error.to_string())
}

/// Returns a path of so many seconds, with a hundred poses in each.
///
/// # Errors
/// If a pose is out of range.
pub fn path(seconds: f64, pose: impl Fn(f64) -> Pose) -> Result<MotionPath, String> {
    let keyframe = |sample: usize| {
        let time = sample as f64 / 100.0;
        Keyframe { time, pose: pose(time) }
    };
    let keyframes = (0..=(seconds * 100.0).ceil() as usize).map(keyframe).collect();
    MotionPath::new(keyframes, Interpolation::Smooth).map_err(|error| error.to_string())
}
