//! The one place that knows which integrators there are.

use palpate::dynamics::{
    Body, BodyState, DeviceMotion, LinearContactModel, Step, VirtualCoupling, semi_implicit_step,
};
use palpate::glam::DVec3;

/// An integrator of the grasped body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stepper {
    SemiImplicit,
}

/// Everything that one step goes by.
pub struct StepInput<'a> {
    pub body: &'a Body,
    pub state: &'a BodyState,
    pub device: &'a DeviceMotion,
    pub coupling: &'a VirtualCoupling,
    pub contacts: &'a LinearContactModel,
    /// m/s².
    pub gravity: DVec3,
    /// s.
    pub dt: f64,
}

impl Stepper {
    /// All integrators.
    pub const ALL: [Self; 1] = [Self::SemiImplicit];

    pub fn name(self) -> &'static str {
        match self {
            Self::SemiImplicit => "semi-implicit",
        }
    }

    pub fn step(self, input: &StepInput<'_>) -> Step {
        let StepInput { body, state, device, coupling, contacts, gravity, dt } = *input;
        match self {
            Self::SemiImplicit => semi_implicit_step(body, state, device, coupling, contacts, gravity, dt),
        }
    }
}
