//! A device emulated with the hand that holds it.
//!
//! A hand that follows an intended path holds the handle (mass, damping, Coulomb friction), which moves under
//! the wrench written last; the wrench is held between writes, as an amplifier holds it. It takes effect with
//! the specification's delay, in whole substeps: zero for the presets. Encoders round the readings, and force
//! and torque are clipped to the device's peaks, so the driver meets the delays, the rounding and the limits
//! of the real device. The figures of the presets are approximate; see [`Emulation::preset`].
//!
//! Time advances in whole substeps, counted from the driver's time 0: the states depend on the times of the
//! writes, not on how often the device is read between them, and two runs with the same calls are equal bit
//! for bit. A read simulates at most [`Emulation::catch_up`] seconds; time beyond that is left out, for the
//! handle and the hand alike, and counted in [`EmulatedDevice::skipped_time`].
//!
//! A device may have a gripper ([`EmulatedDevice::with_gripper`]), which emulated fingers hold and which
//! moves independently of the handle.
//!
//! There is no end stop: a handle that leaves the workspace sets [`Status::OUTSIDE_WORKSPACE`] and moves on.

use palpate_core::{Pose, Twist, Wrench};

use crate::clip::clipped;
use crate::hand::{Hand, IntendedPath};
use crate::mechanics;
use crate::sensing::Encoders;
use crate::{DeviceError, DeviceState, Gripper, HapticDevice, Specification, Status};

mod address;
mod gripper;
mod hand_path;
mod parameters;
mod stepping;

pub use address::EmulatedHand;
pub(crate) use address::KIND;
pub use gripper::{EmulatedGripper, Fingers, GripperEmulation, GripperPath};
use hand_path::HandPath;
pub use parameters::Emulation;
use stepping::{Delayed, Substeps};

impl Emulation {
    /// Starts the emulation with the handle at rest at the hand's intended pose at time 0.
    ///
    /// # Errors
    /// If a parameter is out of range, or a pose that the hand is to hold is not finite.
    pub fn open(self, path: impl Into<IntendedPath>) -> Result<EmulatedDevice, DeviceError> {
        self.check()?;
        let mut hand_path = HandPath::new(path.into())?;
        hand_path.advance(0.0);
        let pose = hand_path.pose;
        let encoders = Encoders::new(&self.specification, self.substep, &pose);
        Ok(EmulatedDevice {
            encoders,
            intended: (pose, hand_path.twist),
            hand_path,
            pose,
            twist: Twist::ZERO,
            wrench: Delayed::new(Wrench::ZERO, self.specification.delay, self.substep),
            gripper: None,
            work: 0.0,
            now: 0.0,
            substeps: Substeps::new(self.substep, self.catch_up),
            events: Status::OK,
            buttons: 0,
            closed: false,
            emulation: self,
        })
    }
}

/// An emulated device, held by an emulated hand. Made by [`Emulation::open`].
#[derive(Debug)]
pub struct EmulatedDevice {
    emulation: Emulation,
    encoders: Encoders,
    hand_path: HandPath,
    intended: (Pose, Twist),
    pose: Pose,
    twist: Twist,
    wrench: Delayed<Wrench>,
    gripper: Option<EmulatedGripper>,
    work: f64,
    now: f64,
    substeps: Substeps,
    events: Status,
    buttons: u32,
    closed: bool,
}

impl EmulatedDevice {
    /// Adds a gripper, at rest at the angle that the fingers intend at time 0. Like the handle, it moves when
    /// it is read, with the device's substep, catch-up and delay.
    ///
    /// # Errors
    /// If a parameter of the gripper is out of range, or an angle that the fingers are to hold is not finite.
    pub fn with_gripper(
        mut self,
        gripper: GripperEmulation,
        path: impl Into<GripperPath>,
    ) -> Result<Self, DeviceError> {
        self.gripper = Some(EmulatedGripper::new(gripper, path.into(), &self.emulation)?);
        Ok(self)
    }

    /// The gripper, if the device has one.
    pub fn emulated_gripper(&self) -> Option<&EmulatedGripper> {
        self.gripper.as_ref()
    }

    /// The parameters of the emulation.
    pub fn emulation(&self) -> &Emulation {
        &self.emulation
    }

    /// True pose and twist of the handle; what [`read`](HapticDevice::read) reports is rounded and delayed.
    pub fn handle(&self) -> (Pose, Twist) {
        (self.pose, self.twist)
    }

    /// Pose and twist that the hand intends, with its tremor.
    pub fn intended(&self) -> (Pose, Twist) {
        self.intended
    }

    /// The wrench on the hand now, after clipping and [delay](Specification::delay), N and N·m.
    pub fn applied_wrench(&self) -> Wrench {
        self.wrench.current
    }

    /// Energy that the written wrenches have given to handle and hand, J. A passive object, from rest, never
    /// gives more than it was given, so this stays below the noise of sampling.
    pub fn work(&self) -> f64 {
        self.work
    }

    /// Time left out because reads were further apart than [`Emulation::catch_up`], s.
    pub fn skipped_time(&self) -> f64 {
        self.substeps.skipped as f64 * self.emulation.substep
    }

    /// Lets another hand hold the handle, or none ([`Hand::NONE`]).
    ///
    /// # Errors
    /// If a parameter of the hand is out of range; the handle is then held as before.
    pub fn hold_with(&mut self, hand: Hand) -> Result<(), DeviceError> {
        let emulation = Emulation { hand, ..self.emulation.clone() };
        emulation.check()?;
        self.emulation = emulation;
        Ok(())
    }

    /// Presses the buttons whose bits are set and releases the others.
    pub fn set_buttons(&mut self, buttons: u32) {
        self.buttons = buttons;
    }

    /// Simulates up to a time (s), and leaves out what is beyond the longest time that a read simulates.
    fn advance(&mut self, now: f64) {
        let (steps, gap) = self.substeps.due(now);
        if gap {
            self.events |= Status::GAP;
            self.wrench.arrive(self.substeps.count);
        }
        for _ in 0..steps {
            self.substeps.count += 1;
            self.substep(self.substeps.length);
            self.wrench.arrive(self.substeps.count);
        }
    }

    /// One integration step: the hand's intention at its end, then handle and hand, then the encoders.
    fn substep(&mut self, dt: f64) {
        let time = self.substeps.simulated_time();
        self.hand_path.advance(time);
        self.events |= self.hand_path.status;
        let Emulation { handle, hand, .. } = &self.emulation;
        let (offset, velocity) = hand.tremble(time);
        self.intended = (self.hand_path.pose, self.hand_path.twist);
        self.intended.0.translation += offset;
        self.intended.1.linear += velocity;
        let intended = (&self.intended.0, &self.intended.1);
        let (pose, twist) =
            mechanics::step(handle, hand, (&self.pose, &self.twist), &self.wrench.current, intended, dt);
        if pose.is_valid() && twist.is_finite() {
            (self.pose, self.twist) = (pose, twist);
            // Backward Euler: the power is that of the velocity at the end of the step.
            self.work += self.wrench.current.power(&twist) * dt;
        } else {
            self.twist = Twist::ZERO;
            self.events |= Status::HELD;
        }
        self.encoders.sample(&self.pose);
    }
}

impl HapticDevice for EmulatedDevice {
    fn specification(&self) -> &Specification {
        &self.emulation.specification
    }

    fn read(&mut self, now: f64) -> Result<DeviceState, DeviceError> {
        if self.closed {
            return Err(DeviceError::Closed);
        }
        if now.is_finite() && now >= self.now {
            self.now = now;
            self.advance(now);
        } else {
            self.events |= Status::CLOCK;
        }
        let mut status = std::mem::take(&mut self.events) | self.hand_path.status;
        if self.pose.translation.length() > self.emulation.specification.workspace_radius {
            status |= Status::OUTSIDE_WORKSPACE;
        }
        let (pose, twist) = self.encoders.reading();
        let time = self.substeps.time().min(self.now);
        Ok(DeviceState { time, pose, twist, buttons: self.buttons, status })
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceError> {
        if self.closed {
            return Err(DeviceError::Closed);
        }
        let (wrench, events) = clipped(wrench, &self.emulation.specification);
        self.wrench.write(wrench, self.substeps.count);
        self.events |= events;
        Ok(())
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        self.wrench.replace(Wrench::ZERO);
        if let Some(gripper) = &mut self.gripper {
            gripper.close();
        }
        self.closed = true;
        Ok(())
    }

    fn gripper(&mut self) -> Option<&mut dyn Gripper> {
        self.gripper.as_mut().map(|gripper| gripper as _)
    }
}

impl Drop for EmulatedDevice {
    fn drop(&mut self) {
        // Closing an emulated device cannot fail.
        let _ = self.close();
    }
}

#[cfg(test)]
mod tests;
