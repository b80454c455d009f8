//! Haply's Inverse3, with or without a VerseGrip, through its maker's WebSocket service
//! (`ws://localhost:10001`).
//!
//! The service answers each message with the state of all devices; a message may carry a force. Each answer
//! is converted to a report of fixed size, so that the device is a [`Link`]. Messages are as in the maker's
//! documentation of service 3.5 and 3.1; not tried with a unit here.

mod message;
#[cfg(feature = "haply")]
mod service;

use std::time::Duration;

use glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist, Wrench};

use crate::link::{Codec, Link, Malformed, Motion, Report};
use crate::{Axes, Specification};

pub use message::{Dialect, Inverse3State, force_message, parse_state};
#[cfg(feature = "haply")]
pub(crate) use service::{ADDRESS, open};

/// Middle of the workspace in the device's frame, m (as in the maker's examples).
const CENTER: DVec3 = DVec3::new(0.04, -0.17, 0.16);
/// Size of the report that carries a force, bytes.
const FORCE_BYTES: usize = 12;

/// Codec of the reports that carry messages.
#[derive(Clone, Copy, Debug, Default)]
pub struct Inverse3Codec;

impl Codec for Inverse3Codec {
    type Sample = Inverse3State;

    fn decode(&mut self, report: &[u8], sample: &mut Inverse3State) -> Result<(), Malformed> {
        *sample = Inverse3State::from_report(report).ok_or(Malformed)?;
        Ok(())
    }

    fn is_enabled(&self, sample: &Inverse3State) -> bool {
        sample.ready
    }

    fn encode(&mut self, wrench: &Wrench, sample: &Inverse3State, say: &mut dyn FnMut(Report)) {
        // A device that is not ready gets zero force.
        let force = if sample.ready { wrench.force } else { DVec3::ZERO };
        let mut bytes = [0; FORCE_BYTES];
        let words = bytes.as_chunks_mut::<4>().0;
        words.iter_mut().zip(force.to_array()).for_each(|(to, part)| *to = (part as f32).to_le_bytes());
        say(Report::new(&bytes, FORCE_BYTES));
    }
}

/// Motion of the handle from the service's states.
#[derive(Clone, Debug, Default)]
pub struct Inverse3Motion {
    pose: Pose,
    twist: Twist,
    /// Driver's time of the last report, s.
    reported: Option<f64>,
}

impl Motion for Inverse3Motion {
    type Sample = Inverse3State;

    fn advance(&mut self, sample: &Inverse3State, came: Option<f64>, _: f64) -> (Pose, Twist, u32) {
        if let Some(now) = came {
            let turned = DQuat::from_array(sample.orientation.map(f64::from)).normalize();
            let place = DVec3::from_array(sample.position.map(f64::from)) - CENTER;
            let before = std::mem::replace(&mut self.pose, Pose::new(place, turned));
            let time = now - self.reported.replace(now).unwrap_or(now);
            let angular = if time > 0.0 { before.rotation_vector_to(&self.pose) / time } else { DVec3::ZERO };
            self.twist = Twist::new(DVec3::from_array(sample.velocity.map(f64::from)), angular);
        }
        (self.pose, self.twist, sample.buttons)
    }

    fn restart(&mut self) {
        self.reported = None;
    }
}

/// Link for an Inverse3 over any transport of its reports. Workspace and forces are the maker's figures, the
/// rest typical ones.
pub fn inverse3() -> Link<Inverse3Codec, Inverse3Motion> {
    Link {
        codec: Inverse3Codec,
        motion: Inverse3Motion::default(),
        specification: Specification {
            name: "Haply Inverse3".into(),
            peak_force: 10.0,
            continuous_force: 2.4,
            peak_torque: 0.0,
            continuous_torque: 0.0,
            stiffness: 1000.0,
            angular_stiffness: 0.0,
            damping: 2.0,
            angular_damping: 0.0,
            workspace_radius: 0.1,
            encoder_step: 1e-5,
            angular_encoder_step: 1e-3,
            velocity_delay: 2e-3,
            // One message a millisecond, and one more until the device has the answer.
            delay: 2e-3,
            sensed: Axes::ALL,
            actuated: Axes::TRANSLATION,
            handle: None,
        },
        read_timeout: Duration::from_millis(5),
        silence: 0.02,
    }
}
