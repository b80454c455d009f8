//! The gripper as a port of its own: its readings, the rate of its angle, and the torque sent to it.

use palpate_core::glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist, Wrench};
use palpate_device::{DeviceState, Status};
use palpate_dynamics::{GripperMotion, PassivityObserver, PortAxes, SlewLimit, saturate};

use super::invariants::Moment;
use super::tracking::{Reading, Tracking};
use crate::settings::SLEW_TIME;
use crate::settings::gripper::GripperSettings;
use crate::telemetry::Events;

/// The gripper while a session runs.
#[derive(Clone, Debug)]
pub(crate) struct Gripper {
    /// Tracking of the gripper as a handle that turns about x by its angle.
    tracking: Tracking,
    /// The last good angle, rad.
    angle: f64,
    /// Peak torque, N·m.
    peak: f64,
    slew: SlewLimit,
    /// The torque that the gripper holds, N·m, about x.
    sent: Wrench,
    observer: PassivityObserver,
}

impl Gripper {
    /// Makes a gripper at an angle (rad), whose rate has a lag (s), with a period of the loop (s).
    pub fn new(settings: &GripperSettings, port: &PortAxes, angle: f64, lag: f64, period: f64) -> Self {
        let peak = port.peak;
        let slew = settings.torque_slew.unwrap_or(if peak > 0.0 { peak / SLEW_TIME } else { f64::INFINITY });
        Self {
            // A gripper reports no rate: it is differentiated, with a lag of a period at least.
            tracking: Tracking::new(as_handle(angle), (lag.max(period), lag.max(period)), period),
            angle,
            peak,
            slew: SlewLimit { force: f64::INFINITY, torque: slew },
            sent: Wrench::ZERO,
            observer: PassivityObserver::new(port.step),
        }
    }

    /// Takes a reading (rad), `elapsed` seconds after the one before, or counts why it was refused. Also
    /// returns the energy (J) that flowed in since then.
    pub fn take(&mut self, angle: f64, elapsed: f64, events: &mut Events) -> (Reading, f64) {
        let reading = self.tracking.take(Some(&as_handle(angle)), elapsed, events);
        if matches!(reading, Reading::Good | Reading::Back) {
            self.angle = angle;
        }
        (reading, self.observer.observe(self.tracking.displacement().angular))
    }

    /// The last good angle and its rate.
    pub fn motion(&self) -> GripperMotion {
        GripperMotion { angle: self.angle, rate: self.tracking.damped_state().twist.angular.x }
    }

    /// Sends a wanted torque (N·m) within the peak and the slew.
    pub fn send(&mut self, wanted: f64, at: &Moment, events: &mut Events) {
        let wanted = Wrench::new(DVec3::ZERO, DVec3::X * wanted);
        let fitting = saturate(&wanted, 0.0, self.peak);
        let unloaded = self.slew.unload(&self.sent, &fitting, at.elapsed, (0.0, 0.0));
        let sent = self.slew.approach(&unloaded, &fitting, at.dt);
        events.saturated += u64::from(fitting != wanted);
        events.slewed += u64::from(sent != fitting);
        self.hold(sent);
    }

    /// Lets the torque fall to zero as fast as allowed.
    pub fn release(&mut self, elapsed: f64) {
        self.hold(self.slew.unload(&self.sent, &Wrench::ZERO, elapsed, (0.0, 0.0)));
    }

    fn hold(&mut self, sent: Wrench) {
        self.sent = sent;
        self.observer.hold(sent.torque);
    }

    /// The torque that is sent, N·m.
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
