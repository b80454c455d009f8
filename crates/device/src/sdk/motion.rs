//! The handle's motion, from the states of a maker's library.

use glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist};

use super::report::SdkState;
use crate::Specification;
use crate::link::Motion;
use crate::velocity::AdaptiveWindow;

/// Motion of the handle; velocities that the library does not report are estimated over adaptive windows.
#[derive(Clone, Debug)]
pub struct SdkMotion {
    /// Middle of the workspace in the maker's frame, m; `None` until it is known.
    center: Option<DVec3>,
    pose: Pose,
    /// Rotation accumulated about the device's axes, rad.
    turned: DVec3,
    linear: AdaptiveWindow,
    angular: AdaptiveWindow,
    twist: Twist,
}

impl SdkMotion {
    /// Motion of a device whose origin is the middle of its workspace.
    pub fn new(specification: &Specification) -> Self {
        Self {
            center: Some(DVec3::ZERO),
            pose: Pose::IDENTITY,
            turned: DVec3::ZERO,
            linear: AdaptiveWindow::new(specification.encoder_step),
            angular: AdaptiveWindow::new(specification.angular_encoder_step),
            twist: Twist::ZERO,
        }
    }

    /// Motion of a device whose first reported position is taken for the middle of its workspace.
    pub fn from_here(specification: &Specification) -> Self {
        Self { center: None, ..Self::new(specification) }
    }
}

impl Motion for SdkMotion {
    type Sample = SdkState;

    fn advance(&mut self, sample: &SdkState, came: Option<f64>, _: f64) -> (Pose, Twist, u32) {
        if let Some(now) = came {
            let place = DVec3::from_array(sample.position);
            let center = *self.center.get_or_insert(place);
            let rotation = DQuat::from_array(sample.orientation).normalize();
            let before = std::mem::replace(&mut self.pose, Pose::new(place - center, rotation));
            // Rotations do not add, but the small one between two reports does nearly: its rate is estimated
            // from the sum.
            self.turned += before.rotation_vector_to(&self.pose);
            let estimated =
                (self.linear.push(now, self.pose.translation), self.angular.push(now, self.turned));
            self.twist = Twist::new(
                sample.linear.map_or(estimated.0, DVec3::from_array),
                sample.angular.map_or(estimated.1, DVec3::from_array),
            );
        }
        (self.pose, self.twist, sample.buttons)
    }

    fn restart(&mut self) {
        self.linear.clear();
        self.angular.clear();
    }
}
