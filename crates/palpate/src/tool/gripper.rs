//! The gripper as a port of its own: readings held and jumps refused, the rate of its angle, and the torque sent to it.

use palpate_core::glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist, Wrench};
use palpate_device::{DeviceState, Status};
use palpate_dynamics::{GripperMotion, PassivityObserver, PortAxes, SlewLimit, saturate};

use crate::haptic::output::Moment;
use crate::haptic::tracking::{Reading, Tracking};
use crate::settings::SLEW_TIME;
use crate::settings::SettingsError;
use crate::telemetry::Events;

/// A gripper and its coupling to the hinge. Angles are those of the hinge that the hand asks for: a gripper that is geared otherwise
/// is scaled by the host.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GripperSettings {
    /// What the gripper can do about its axis, N·m and rad. By default nothing limits it; a peak of 0 is for a gripper that is only
    /// sensed.
    pub port: PortAxes,
    /// Stiffness of the coupling, N·m/rad; by default what the port renders passively with a margin
    /// ([`GripperCoupling::auto`](palpate_dynamics::GripperCoupling::auto)), 0.5 N·m/rad where nothing limits it.
    pub stiffness: Option<f64>,
    /// Damping of the coupling, N·m·s/rad; by default critical for the second body about the hinge.
    pub damping: Option<f64>,
    /// Largest change of the torque, N·m/s; by default the peak in 10 ms.
    pub torque_slew: Option<f64>,
}

/// Stiffness of the coupling where nothing limits it, N·m/rad.
pub(super) const STIFFNESS: f64 = 0.5;

impl Default for GripperSettings {
    fn default() -> Self {
        let port = PortAxes {
            stiffness: f64::INFINITY,
            damping: f64::INFINITY,
            viscous: None,
            friction: None,
            peak: f64::INFINITY,
            step: 0.0,
        };
        Self { port, stiffness: None, damping: None, torque_slew: None }
    }
}

impl GripperSettings {
    /// Refuses values that no gripper can have.
    ///
    /// # Errors
    /// Names the first setting out of range.
    pub fn check(&self) -> Result<(), SettingsError> {
        let ranges = [
            ("gripper stiffness", self.stiffness, "N·m/rad from 0 to 1e6", 0.0..=1e6),
            ("gripper damping", self.damping, "N·m·s/rad from 0 to 1e6", 0.0..=1e6),
            ("gripper torque slew", self.torque_slew, "N·m/s above 0", f64::MIN_POSITIVE..=f64::INFINITY),
            ("gripper peak torque", Some(self.port.peak), "N·m, 0 or more", 0.0..=f64::INFINITY),
            ("gripper encoder step", Some(self.port.step), "rad, 0 or more", 0.0..=f64::MAX),
        ];
        for (name, value, expected, range) in ranges {
            if let Some(value) = value.filter(|value| !range.contains(value)) {
                return Err(SettingsError { name, value, expected });
            }
        }
        Ok(())
    }
}

/// The gripper while a session runs.
#[derive(Clone, Debug)]
pub(super) struct Gripper {
    /// It is tracked as a handle that turns about x by its angle.
    tracking: Tracking,
    /// The last good angle, rad.
    angle: f64,
    /// N·m.
    peak: f64,
    slew: SlewLimit,
    /// N·m, as a torque about x.
    sent: Wrench,
    observer: PassivityObserver,
}

impl Gripper {
    /// At an angle (rad), its rate taken through a lag (s).
    pub fn new(settings: &GripperSettings, angle: f64, lag: f64, period: f64) -> Self {
        let peak = settings.port.peak;
        let slew = settings.torque_slew.unwrap_or(if peak > 0.0 { peak / SLEW_TIME } else { f64::INFINITY });
        Self {
            // Its own rate is not known: differences of its angle through a period at least.
            tracking: Tracking::new(as_handle(angle), (lag.max(period), lag.max(period)), period),
            angle,
            peak,
            slew: SlewLimit { force: f64::INFINITY, torque: slew },
            sent: Wrench::ZERO,
            observer: PassivityObserver::new(settings.port.step),
        }
    }

    /// Takes a reading (rad) that comes `elapsed` seconds after the one before, or counts why it was not taken. With the energy (J) that
    /// flowed in since then.
    pub fn take(&mut self, angle: f64, elapsed: f64, events: &mut Events) -> (Reading, f64) {
        let reading = self.tracking.take(Some(&as_handle(angle)), elapsed, events);
        if matches!(reading, Reading::Good | Reading::Back) {
            self.angle = angle;
        }
        (reading, self.observer.observe(self.tracking.displacement().angular))
    }

    /// Where it is taken to be.
    pub fn motion(&self) -> GripperMotion {
        GripperMotion { angle: self.angle, rate: self.tracking.damped_state().twist.angular.x }
    }

    /// What is sent of a wanted torque (N·m): within the peak, and no further from the last than it may change.
    pub fn send(&mut self, wanted: f64, at: &Moment, events: &mut Events) {
        let wanted = Wrench::new(DVec3::ZERO, DVec3::X * wanted);
        let fitting = saturate(&wanted, 0.0, self.peak);
        let unloaded = self.slew.unload(&self.sent, &fitting, at.elapsed, (0.0, 0.0));
        let sent = self.slew.approach(&unloaded, &fitting, at.dt);
        events.saturated += u64::from(fitting != wanted);
        events.slewed += u64::from(sent != fitting);
        self.hold(sent);
    }

    /// Lets go as fast as it may.
    pub fn release(&mut self, elapsed: f64) {
        self.hold(self.slew.unload(&self.sent, &Wrench::ZERO, elapsed, (0.0, 0.0)));
    }

    fn hold(&mut self, sent: Wrench) {
        self.sent = sent;
        self.observer.hold(sent.torque);
    }

    /// What is sent, N·m.
    pub fn torque(&self) -> f64 {
        self.sent.torque.x
    }

    /// Energy that has flowed in, J.
    pub fn energy(&self) -> f64 {
        self.observer.energy()
    }
}

fn as_handle(angle: f64) -> DeviceState {
    DeviceState {
        time: 0.0,
        pose: Pose::new(DVec3::ZERO, DQuat::from_rotation_x(angle)),
        twist: Twist::ZERO,
        buttons: 0,
        status: Status::OK,
    }
}
