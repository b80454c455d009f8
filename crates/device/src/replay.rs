//! A recorded motion as a device: the handle moves exactly as recorded, whatever wrench is written, as if a
//! hand of infinite impedance held it. The twist is the derivative of the interpolant (see [`MotionPath`]);
//! nothing is rounded or delayed.
//!
//! Playing starts at the driver's time 0 with the first sample and ends by holding the last one, with
//! [`Status::ENDED`] set.

use std::path::Path;

use palpate_core::{Pose, Twist, Wrench};

use crate::clip::finite;
use crate::{Axes, DeviceError, DeviceState, HapticDevice, Interpolation, MotionPath, Specification, Status};

/// A device that replays a recorded motion.
#[derive(Debug)]
pub struct ReplayDevice {
    specification: Specification,
    path: MotionPath,
    segment: usize,
    latest: Option<DeviceState>,
    wrench: Wrench,
    events: Status,
    closed: bool,
}

impl ReplayDevice {
    /// Replays `path` as a device with this name.
    pub fn new(name: &str, path: MotionPath) -> Self {
        let reach =
            path.keyframes().iter().map(|keyframe| keyframe.pose.translation.length()).fold(0.0, f64::max);
        let specification = Specification {
            name: name.into(),
            peak_force: f64::INFINITY,
            continuous_force: f64::INFINITY,
            peak_torque: f64::INFINITY,
            continuous_torque: f64::INFINITY,
            stiffness: f64::INFINITY,
            angular_stiffness: f64::INFINITY,
            damping: f64::INFINITY,
            angular_damping: f64::INFINITY,
            workspace_radius: reach,
            encoder_step: 0.0,
            angular_encoder_step: 0.0,
            velocity_delay: 0.0,
            delay: 0.0,
            sensed: Axes::ALL,
            actuated: Axes::ALL,
            handle: None,
        };
        Self {
            specification,
            path,
            segment: 0,
            latest: None,
            wrench: Wrench::ZERO,
            events: Status::OK,
            closed: false,
        }
    }

    /// Replays the motion recorded in `file`, with a continuous twist.
    ///
    /// # Errors
    /// If the file cannot be read or is not a path ([`MotionPath::load`]).
    pub fn open(file: &Path) -> Result<Self, DeviceError> {
        let path = MotionPath::load(file, Interpolation::Smooth)?;
        Ok(Self::new(&format!("replay of {}", file.display()), path))
    }

    /// The motion.
    pub fn path(&self) -> &MotionPath {
        &self.path
    }

    /// The wrench written last, N and N·m.
    pub fn applied_wrench(&self) -> Wrench {
        self.wrench
    }
}

impl HapticDevice for ReplayDevice {
    fn specification(&self) -> &Specification {
        &self.specification
    }

    fn read(&mut self, now: f64) -> Result<DeviceState, DeviceError> {
        if self.closed {
            return Err(DeviceError::Closed);
        }
        let earliest = self.latest.map_or(0.0, |state| state.time);
        let good = now.is_finite() && now >= earliest;
        let time = if good { now } else { earliest };
        let point = self.path.at_near(time, &mut self.segment);
        let mut status = std::mem::take(&mut self.events);
        if !good {
            status |= Status::CLOCK;
        }
        if point.ended {
            status |= Status::ENDED;
        }
        // The bounds of the samples keep the interpolant finite; this check is a second guard.
        let (pose, twist) = if point.pose.is_valid() && point.twist.is_finite() {
            (point.pose, point.twist)
        } else {
            status |= Status::HELD;
            (self.latest.map_or(Pose::IDENTITY, |state| state.pose), Twist::ZERO)
        };
        let state = DeviceState { time, pose, twist, buttons: 0, status };
        self.latest = Some(state);
        Ok(state)
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceError> {
        if self.closed {
            return Err(DeviceError::Closed);
        }
        let (wrench, events) = finite(wrench);
        self.wrench = wrench;
        self.events |= events;
        Ok(())
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        self.wrench = Wrench::ZERO;
        self.closed = true;
        Ok(())
    }
}

impl Drop for ReplayDevice {
    fn drop(&mut self) {
        // Closing a replay cannot fail.
        let _ = self.close();
    }
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};

    use super::*;
    use crate::Keyframe;

    /// A circle with a turn, sampled at 1 kHz for 1 s.
    fn circle() -> (impl Fn(f64) -> Pose, ReplayDevice) {
        let motion = |t: f64| {
            let (sine, cosine) = (4.0 * t).sin_cos();
            Pose::new(DVec3::new(cosine, sine, 0.0) * 0.05, DQuat::from_rotation_z(4.0 * t))
        };
        let keyframes = (0..=1000)
            .map(|i| Keyframe { time: f64::from(i) / 1000.0, pose: motion(f64::from(i) / 1000.0) })
            .collect();
        (motion, ReplayDevice::new("circle", MotionPath::new(keyframes, Interpolation::Smooth).unwrap()))
    }

    #[test]
    fn the_handle_moves_as_recorded_whatever_is_written() {
        let (motion, mut device) = circle();
        for i in 0..2000 {
            let now = f64::from(i) * 0.0005;
            let state = device.read(now).unwrap();
            device.write(&Wrench::new(DVec3::splat(1e6), DVec3::X)).unwrap();
            let expected = motion(now);
            assert_eq!((state.time, state.status), (now, Status::OK));
            // On the first and the last segment the curve bends less than the circle does: a sample there has
            // one neighbour.
            let inside = (2..1998).contains(&i);
            let tolerance = if inside { 1e-9 } else { 2e-7 };
            assert!((state.pose.translation - expected.translation).length() < tolerance, "{i}");
            assert!(state.pose.rotation_vector_to(&expected).length() < tolerance, "{i}");
            if inside {
                // 4 rad/s about z: 0.2 m/s across the radius.
                let velocity = DVec3::Z.cross(expected.translation) * 4.0;
                assert!((state.twist.linear - velocity).length() < 1e-5, "{i}");
                assert!((state.twist.angular - DVec3::Z * 4.0).length() < 1e-5, "{i}");
            }
        }
        assert_eq!(device.applied_wrench().torque, DVec3::X);
    }

    #[test]
    fn the_end_holds_the_last_pose_and_says_so() {
        let (motion, mut device) = circle();
        let state = device.read(7.0).unwrap();
        assert_eq!((state.status, state.twist, state.time), (Status::ENDED, Twist::ZERO, 7.0));
        assert!((state.pose.translation - motion(1.0).translation).length() < 1e-12);
    }

    #[test]
    fn a_bad_clock_or_wrench_sets_a_flag_and_moves_nothing() {
        let (_, mut device) = circle();
        let before = device.read(0.5).unwrap();
        for now in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.4, -1.0] {
            let state = device.read(now).unwrap();
            assert_eq!((state.pose, state.time, state.status), (before.pose, 0.5, Status::CLOCK), "{now}");
        }
        device.write(&Wrench::new(DVec3::NAN, DVec3::ZERO)).unwrap();
        assert_eq!(device.applied_wrench(), Wrench::ZERO);
        assert_eq!(device.read(0.6).unwrap().status, Status::WRENCH_REFUSED);
        assert_eq!(device.read(0.6).unwrap().status, Status::OK);
    }

    #[test]
    fn closing_zeroes_the_wrench_and_ends_the_device() {
        let (_, mut device) = circle();
        device.write(&Wrench::new(DVec3::X, DVec3::X)).unwrap();
        device.close().unwrap();
        device.close().unwrap();
        assert_eq!(device.applied_wrench(), Wrench::ZERO);
        assert!(matches!(device.read(0.0), Err(DeviceError::Closed)));
        assert!(matches!(device.write(&Wrench::ZERO), Err(DeviceError::Closed)));
    }
}
