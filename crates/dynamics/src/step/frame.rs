//! The loads on the body during a step, and the checks that every integrator makes of them.

use glam::DVec3;
use palpate_core::Pose;

use super::outcome::{Step, StepFailure, StepStatus};
use crate::body::{Body, BodyState};
use crate::coupling::{DeviceMotion, VirtualCoupling};
use crate::penalty::LinearContactModel;

/// The body and all that acts on it during a step.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// The body.
    pub body: &'a Body,
    /// The device, taken to keep this pose and velocity for the whole step.
    pub device: &'a DeviceMotion,
    /// Virtual coupling between the two.
    pub coupling: &'a VirtualCoupling,
    /// The contacts.
    pub contacts: &'a LinearContactModel,
    /// Gravity, m/s², world axes.
    pub gravity: DVec3,
}

impl Frame<'_> {
    /// Returns the failed step for unusable inputs, or `None` if they are usable, by the rules of
    /// [`semi_implicit_step`](crate::semi_implicit_step), which hold for every integrator.
    pub(crate) fn refused(&self, state: &BodyState, dt: f64) -> Option<Step> {
        if !state.is_valid() {
            let relaxed = self.coupling.relaxed_pose(&self.device.pose);
            let pose = if relaxed.is_valid() { relaxed } else { Pose::IDENTITY };
            return Some(Step::failed(&BodyState::at_rest(pose), StepFailure::State));
        }
        if !self.device.is_valid() {
            return Some(Step::failed(state, StepFailure::Device));
        }
        if !(dt > 0.0 && dt.is_finite()) {
            return Some(Step::failed(state, StepFailure::TimeStep));
        }
        None
    }

    /// Makes the step from `start` to `next` with the wrenches at `next`, or a failed one if they are not
    /// finite.
    pub(crate) fn ended(&self, start: &BodyState, next: &BodyState, active: u64, status: StepStatus) -> Step {
        if !next.is_valid() {
            return Step::failed(start, StepFailure::Overflow);
        }
        let (coupling_on_body, on_device) = self.coupling.wrenches(next, self.device);
        let contact = self.contacts.wrench(next);
        if !(coupling_on_body.is_finite() && on_device.is_finite() && contact.is_finite()) {
            return Step::failed(start, StepFailure::Overflow);
        }
        Step { state: *next, coupling: on_device, coupling_on_body, contact, active, status }
    }
}
