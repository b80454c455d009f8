//! An emulated gripper and the fingers that hold it.
//!
//! The fingers follow an intended angle as the hand follows its path: a spring and a damper about the
//! gripper's axis, by the step of [`mechanics`](crate::mechanics), which is passive. A constant torque τ
//! therefore deflects the gripper by τ / stiffness. There is no end stop.

use glam::DVec3;
use palpate_core::{Pose, Twist};
use serde::{Deserialize, Serialize};

use super::hand_path::HandPath;
use super::parameters::{Emulation, MAX_PARAMETER, within};
use super::stepping::{Delayed, Substeps};
use crate::angle_path::MAX_ANGLE;
use crate::gripper::{Gripper, GripperHandle, GripperSpecification, GripperState};
use crate::hand::IntendedPath;
use crate::mechanics::Impedance;
use crate::{AnglePath, DeviceError, Status};

/// Parameters of an emulated gripper and of the fingers that hold it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GripperEmulation {
    /// The gripper's specification; the emulation keeps to its peak, encoder step and handle. Without a
    /// handle it moves with the fingers alone.
    pub specification: GripperSpecification,
    /// The fingers that hold it.
    pub fingers: Fingers,
}

/// Passive impedance of the fingers about the gripper's axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fingers {
    /// Inertia that turns with the gripper, kg·m².
    pub inertia: f64,
    /// Damping towards the intended rate, N·m·s/rad.
    pub damping: f64,
    /// Stiffness towards the intended angle, N·m/rad.
    pub stiffness: f64,
}

impl Fingers {
    /// No fingers: the gripper is released.
    pub const NONE: Self = Self { inertia: 0.0, damping: 0.0, stiffness: 0.0 };
}

impl Default for Fingers {
    fn default() -> Self {
        Self { inertia: 1e-5, damping: 0.01, stiffness: 1.5 }
    }
}

impl Default for GripperEmulation {
    /// A gripper that a thumb and a finger close, with plausible figures: not those of a product.
    fn default() -> Self {
        let handle = GripperHandle { inertia: 1e-5, damping: 1e-3, friction: 1e-3 };
        let specification = GripperSpecification {
            peak_torque: 0.5,
            stiffness: 2.0,
            damping: 0.01,
            encoder_step: 1e-4,
            handle: Some(handle),
        };
        Self { specification, fingers: Fingers::default() }
    }
}

impl GripperEmulation {
    /// Mechanics of the gripper; zero if they are not known.
    fn handle(&self) -> GripperHandle {
        let none = GripperHandle { inertia: 0.0, damping: 0.0, friction: 0.0 };
        self.specification.handle.unwrap_or(none)
    }

    fn check(&self) -> Result<(), DeviceError> {
        let Self { specification: s, fingers } = self;
        let handle = self.handle();
        for (parameter, value) in [
            ("gripper damping (N·m·s/rad)", handle.damping),
            ("gripper friction (N·m)", handle.friction),
            ("finger damping (N·m·s/rad)", fingers.damping),
            ("finger stiffness (N·m/rad)", fingers.stiffness),
        ] {
            within(parameter, value, 0.0, MAX_PARAMETER, true)?;
        }
        let inertia = handle.inertia + fingers.inertia;
        within("inertia of gripper and fingers (kg·m²)", inertia, 1e-9, MAX_PARAMETER, false)?;
        within("gripper peak torque (N·m)", s.peak_torque, 0.0, f64::INFINITY, true)?;
        within("gripper encoder step (rad)", s.encoder_step, 1e-9, 1.0, true)
    }
}

/// Intended angle of the fingers: rad, by time since the start (s).
#[derive(Debug, Default)]
pub struct GripperPath(
    /// The angle (rad) as a position along x (m).
    IntendedPath,
);

impl GripperPath {
    /// Follows `function`, which gives the angle (rad) and its rate (rad/s) at a time in s. A result that is
    /// not finite is ignored and the last finite one held.
    pub fn function(mut function: impl FnMut(f64) -> (f64, f64) + Send + 'static) -> Self {
        Self(IntendedPath::function(move |time| {
            let (angle, rate) = function(time);
            (Pose::from_translation(DVec3::X * angle), Twist::new(DVec3::X * rate, DVec3::ZERO))
        }))
    }
}

impl From<f64> for GripperPath {
    /// Holds one angle, rad.
    fn from(angle: f64) -> Self {
        Self(Pose::from_translation(DVec3::X * angle).into())
    }
}

impl From<AnglePath> for GripperPath {
    fn from(path: AnglePath) -> Self {
        Self(path.into_motion().into())
    }
}

/// An emulated gripper, held by emulated fingers. Made by
/// [`EmulatedDevice::with_gripper`](super::EmulatedDevice::with_gripper).
#[derive(Debug)]
pub struct EmulatedGripper {
    emulation: GripperEmulation,
    path: HandPath,
    substeps: Substeps,
    torque: Delayed<f64>,
    /// True angle, rad, and rate, rad/s.
    angle: f64,
    rate: f64,
    work: f64,
    now: f64,
    events: Status,
    closed: bool,
}

impl EmulatedGripper {
    /// Starts at rest at the intended angle at time 0, with the device's substep, catch-up and delay.
    pub(super) fn new(
        emulation: GripperEmulation,
        GripperPath(path): GripperPath,
        device: &Emulation,
    ) -> Result<Self, DeviceError> {
        emulation.check()?;
        if let IntendedPath::Still(pose) = &path {
            within("gripper angle (rad)", pose.translation.x, -MAX_ANGLE, MAX_ANGLE, false)?;
        }
        let mut path = HandPath::new(path)?;
        path.advance(0.0);
        Ok(Self {
            emulation,
            angle: path.pose.translation.x,
            path,
            substeps: Substeps::new(device.substep, device.catch_up),
            torque: Delayed::new(0.0, device.specification.delay, device.substep),
            rate: 0.0,
            work: 0.0,
            now: 0.0,
            events: Status::OK,
            closed: false,
        })
    }

    /// The parameters of the emulation.
    pub fn emulation(&self) -> &GripperEmulation {
        &self.emulation
    }

    /// True angle (rad) and rate (rad/s); what [`read`](Gripper::read) reports is rounded.
    pub fn motion(&self) -> (f64, f64) {
        (self.angle, self.rate)
    }

    /// Angle (rad) and rate (rad/s) that the fingers intend.
    pub fn intended(&self) -> (f64, f64) {
        (self.path.pose.translation.x, self.path.twist.linear.x)
    }

    /// The torque on the fingers now, after clipping and delay, N·m.
    pub fn applied_torque(&self) -> f64 {
        self.torque.current
    }

    /// Energy that the written torques have given to gripper and fingers, J.
    pub fn work(&self) -> f64 {
        self.work
    }

    fn advance(&mut self, now: f64) {
        let (steps, gap) = self.substeps.due(now);
        if gap {
            self.events |= Status::GAP;
            self.torque.arrive(self.substeps.count);
        }
        for _ in 0..steps {
            self.substeps.count += 1;
            self.substep();
            self.torque.arrive(self.substeps.count);
        }
    }

    fn substep(&mut self) {
        self.path.advance(self.substeps.simulated_time());
        self.events |= self.path.status;
        let GripperEmulation { fingers, .. } = self.emulation;
        let handle = self.emulation.handle();
        let impedance = Impedance {
            inertia: handle.inertia + fingers.inertia,
            damping: handle.damping,
            friction: handle.friction,
            hand_damping: fingers.damping,
            hand_stiffness: fingers.stiffness,
        };
        let (intended, intended_rate) = self.intended();
        let torque = self.torque.current;
        let dt = self.substeps.length;
        // The step in one dimension, along x.
        let rate = impedance.velocity_after(
            DVec3::X * self.rate,
            DVec3::X * torque,
            DVec3::X * (intended - self.angle),
            DVec3::X * intended_rate,
            dt,
        );
        let angle = self.angle + rate.x * dt;
        if angle.is_finite() && rate.is_finite() {
            (self.angle, self.rate) = (angle, rate.x);
            self.work += torque * rate.x * dt;
        } else {
            self.rate = 0.0;
            self.events |= Status::HELD;
        }
    }

    /// Sets the torque to zero; reading and writing then fail.
    pub(super) fn close(&mut self) {
        self.torque.replace(0.0);
        self.closed = true;
    }
}

impl Gripper for EmulatedGripper {
    fn specification(&self) -> &GripperSpecification {
        &self.emulation.specification
    }

    fn read(&mut self, now: f64) -> Result<GripperState, DeviceError> {
        if self.closed {
            return Err(DeviceError::Closed);
        }
        if now.is_finite() && now >= self.now {
            self.now = now;
            self.advance(now);
        } else {
            self.events |= Status::CLOCK;
        }
        let status = std::mem::take(&mut self.events) | self.path.status;
        let step = self.emulation.specification.encoder_step;
        let angle = if step > 0.0 { (self.angle / step).round() * step } else { self.angle };
        Ok(GripperState { time: self.substeps.time().min(self.now), angle, status })
    }

    fn write(&mut self, torque: f64) -> Result<(), DeviceError> {
        if self.closed {
            return Err(DeviceError::Closed);
        }
        let finite = if torque.is_finite() { torque } else { 0.0 };
        let peak = self.emulation.specification.peak_torque;
        let clipped = finite.clamp(-peak, peak);
        if !torque.is_finite() {
            self.events |= Status::WRENCH_REFUSED;
        }
        if clipped != finite {
            self.events |= Status::TORQUE_CLIPPED;
        }
        self.torque.write(clipped, self.substeps.count);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
