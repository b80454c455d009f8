//! The handle's motion as a maker's library tells it.

use glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist};

use super::report::SdkState;
use crate::Specification;
use crate::link::Motion;
use crate::velocity::AdaptiveWindow;

/// The handle's motion: velocities that the library does not tell are estimated over adaptive windows.
#[derive(Clone, Debug)]
pub struct SdkMotion {
    /// The middle of the workspace from the maker's origin, m; none before it is known.
    center: Option<DVec3>,
    pose: Pose,
    /// Turned so far about the device's axes, rad.
    turned: DVec3,
    linear: AdaptiveWindow,
    angular: AdaptiveWindow,
    twist: Twist,
}

impl SdkMotion {
    /// Of a device whose origin is the middle of its workspace.
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

    /// Of a device that takes the place at which its handle is first seen for the middle of its workspace.
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
