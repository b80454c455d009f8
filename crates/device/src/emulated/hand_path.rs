//! Intended path of an emulated hand, sampled in time.

use palpate_core::{Pose, Twist};

use crate::hand::IntendedPath;
use crate::{DeviceError, Status};

/// The hand's path and its last finite point.
#[derive(Debug)]
pub(super) struct HandPath {
    path: IntendedPath,
    segment: usize,
    pub pose: Pose,
    pub twist: Twist,
    pub status: Status,
}

impl HandPath {
    pub fn new(path: IntendedPath) -> Result<Self, DeviceError> {
        if let IntendedPath::Still(pose) = &path {
            // The same conditions as for a sample of a recorded path.
            let keyframe = crate::Keyframe { time: 0.0, pose: *pose };
            let path = crate::MotionPath::new(vec![keyframe], crate::Interpolation::Linear)?;
            let pose = path.keyframes()[0].pose;
            return Ok(Self {
                path: IntendedPath::Still(pose),
                segment: 0,
                pose,
                twist: Twist::ZERO,
                status: Status::OK,
            });
        }
        Ok(Self { path, segment: 0, pose: Pose::IDENTITY, twist: Twist::ZERO, status: Status::OK })
    }

    pub fn advance(&mut self, time: f64) {
        self.status = Status::OK;
        match &mut self.path {
            IntendedPath::Still(_) => {}
            IntendedPath::Recorded(path) => {
                let point = path.at_near(time, &mut self.segment);
                (self.pose, self.twist) = (point.pose, point.twist);
                if point.ended {
                    self.status = Status::ENDED;
                }
            }
            IntendedPath::Function(function) => {
                let (pose, twist) = function(time);
                if pose.is_valid() && twist.is_finite() {
                    (self.pose, self.twist) = (pose, twist);
                } else {
                    self.twist = Twist::ZERO;
                    self.status = Status::HELD;
                }
            }
        }
    }
}
