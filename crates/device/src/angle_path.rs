//! Recorded motions of a gripper: its angle over time, as text with a header `t,angle` and a line a sample
//! with seconds and radians. A recording of a session with a hinged tool is read as well: of its columns, `t`
//! and `gripper`.

use std::f64::consts::TAU;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

use glam::DVec3;
use palpate_core::Pose;

use crate::path::checked;
use crate::path_file::{SampleFormat, read_samples};
use crate::sample_time::{Origin, Refusal};
use crate::{Interpolation, Keyframe, MotionPath, PathError};

/// Largest size of an angle, rad. A larger one is taken for degrees.
pub(crate) const MAX_ANGLE: f64 = TAU;

/// The first line of a recorded motion of a gripper.
pub const ANGLE_PATH_HEADER: &str = "t,angle";

const FORMAT: SampleFormat<2> = SampleFormat {
    header: ["t", "angle"],
    recording: ["t", "gripper"],
    header_remedy: "let the file begin with the line t,angle, or give a recording of a session with a hinged tool",
    sample_remedy: "give two numbers: t,angle",
};

/// Angle of a gripper over time, given by samples and interpolated as a [`MotionPath`] is, with a continuous
/// rate. Its clock starts at the first sample; before that and after the last one it is at rest.
#[derive(Clone, Debug, PartialEq)]
pub struct AnglePath(
    /// The angle (rad) as a position along x (m), which is interpolated in the same way.
    MotionPath,
);

impl AnglePath {
    /// Interpolates samples of time (s) and angle (rad): at least one, at strictly increasing times.
    ///
    /// # Errors
    /// If there is no sample, or one is not valid: the first such.
    pub fn new(samples: &[(f64, f64)]) -> Result<Self, PathError> {
        let mut keyframes: Vec<Keyframe> = Vec::with_capacity(samples.len());
        let mut origin = Origin::default();
        for (sample, &(time, angle)) in samples.iter().enumerate() {
            let previous = keyframes.last().map(|keyframe| keyframe.time);
            let keyframe = origin.time_of(time).and_then(|time| keyframe([time, angle], previous));
            keyframes.push(keyframe.map_err(|Refusal { what, remedy }| PathError::Sample {
                what,
                sample,
                remedy,
            })?);
        }
        if keyframes.is_empty() {
            return Err(PathError::Empty { file: None });
        }
        Ok(Self(MotionPath::from_checked(keyframes, Interpolation::Smooth)))
    }

    /// Reads a recorded motion from a file.
    ///
    /// # Errors
    /// If the file cannot be read, or as [`read`](Self::read).
    pub fn load(file: &Path) -> Result<Self, PathError> {
        let open =
            File::open(file).map_err(|source| PathError::Io { file: file.into(), access: "read", source })?;
        Self::read(BufReader::new(open), file)
    }

    /// Reads a recorded motion; `file` names the input in errors.
    ///
    /// # Errors
    /// If the input cannot be read or has no sample, or its header or a line is not valid: with the line and
    /// a remedy.
    pub fn read(input: impl BufRead, file: &Path) -> Result<Self, PathError> {
        let keyframes = read_samples(input, file, &FORMAT, keyframe)?;
        Ok(Self(MotionPath::from_checked(keyframes, Interpolation::Smooth)))
    }

    /// Time from the first sample to the last, s.
    pub fn duration(&self) -> f64 {
        self.0.duration()
    }

    /// Angle (rad) and rate (rad/s) `elapsed` seconds after the first sample. A NaN counts as 0.
    pub fn at(&self, elapsed: f64) -> (f64, f64) {
        let point = self.0.at(elapsed);
        (point.pose.translation.x, point.twist.linear.x)
    }

    /// The angle (rad) as a position along x (m).
    pub(crate) fn into_motion(self) -> MotionPath {
        self.0
    }
}

fn keyframe([time, angle]: [f64; 2], previous: Option<f64>) -> Result<Keyframe, Refusal> {
    if angle.is_nan() || angle.abs() > MAX_ANGLE {
        return Err(Refusal { what: format!("angle {angle} rad"), remedy: "give radians, from -2π to 2π" });
    }
    checked(Keyframe { time, pose: Pose::from_translation(DVec3::X * angle) }, previous)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<AnglePath, String> {
        AnglePath::read(text.as_bytes(), Path::new("grip.csv")).map_err(|error| error.to_string())
    }

    #[test]
    fn angles_are_met_at_the_samples_and_held_at_the_ends() {
        let path = read("t,angle\n0,0.6\n1,0.6\n2,0\n").unwrap();
        assert_eq!(path, AnglePath::new(&[(0.0, 0.6), (1.0, 0.6), (2.0, 0.0)]).unwrap());
        assert_eq!(path.duration(), 2.0);
        for (time, angle) in [(-1.0, 0.6), (0.5, 0.6), (1.0, 0.6), (3.0, 0.0)] {
            assert!((path.at(time).0 - angle).abs() < 1e-15, "{time}");
        }
        assert_eq!(path.at(3.0).1, 0.0);
        let (angle, rate) = path.at(1.5);
        let slope = (path.at(1.5 + 1e-6).0 - path.at(1.5 - 1e-6).0) / 2e-6;
        assert!(angle > 0.0 && angle < 0.6 && rate < 0.0 && (rate - slope).abs() < 1e-6);
    }

    #[test]
    fn a_recording_of_a_hinged_tool_gives_the_angles_of_its_gripper() {
        let path = read("t,device_px,gripper,angle\n0.5,9,0.25,0.2\n0.6,9,0.5,0.3\n").unwrap();
        assert_eq!(path, AnglePath::new(&[(0.5, 0.25), (0.6, 0.5)]).unwrap());
        // Time stamps count from the first.
        let stamped = AnglePath::new(&[(1_767_225_600.5, 0.25), (1_767_225_601.0, 0.5)]).unwrap();
        assert_eq!(stamped, AnglePath::new(&[(0.0, 0.25), (0.5, 0.5)]).unwrap());
        assert_eq!(read("t,angle\n1767225600.5,0.25\n1767225601,0.5\n").unwrap(), stamped);
    }

    #[test]
    fn errors_name_the_file_the_line_and_what_to_do() {
        for (text, expected) in [
            ("", "grip.csv holds no sample"),
            ("t,angle\n", "grip.csv holds no sample"),
            ("0,0.5\n", "header `0,0.5` at grip.csv:1; let the file begin with the line t,angle"),
            ("t,angle\n0,0.5\n1\n", "1 fields at grip.csv:3; give two numbers: t,angle"),
            ("t,angle\n0,half\n", "`half` is not a number at grip.csv:2"),
            ("t,angle\n0,NaN\n", "angle NaN rad at grip.csv:2; give radians"),
            ("t,angle\n0,30\n", "angle 30 rad at grip.csv:2; give radians, from -2π to 2π"),
            ("t,angle\n0,0\n0,1\n", "time 0 s after 0 s at grip.csv:3; sort"),
        ] {
            let error = read(text).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
        let error = AnglePath::new(&[(0.0, 0.0), (1.0, 40.0)]).unwrap_err().to_string();
        assert!(error.contains("angle 40 rad at sample 1"), "{error}");
        assert!(AnglePath::load(Path::new("no/such.csv")).is_err());
    }
}
