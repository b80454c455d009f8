//! The outcome of a step, and the reason if it was not taken.

use palpate_core::Wrench;

use crate::body::BodyState;

/// Reason for which a step was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum StepFailure {
    /// The time step is not positive and finite.
    TimeStep,
    /// The device's pose or twist is not finite, or its quaternion not of unit length.
    Device,
    /// The body's state is not finite, or its quaternion not of unit length. The state cannot be held; see
    /// [`semi_implicit_step`](crate::semi_implicit_step).
    State,
    /// The linear system is singular, or one of its inputs is not finite: a gain, a contact, gravity, the
    /// body.
    Singular,
    /// The step was computed, but the state or a wrench it leads to is not finite.
    Overflow,
}

/// Status of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct StepStatus {
    /// Set if no step was taken: the state is held and the wrenches are zero.
    pub failure: Option<StepFailure>,
    /// The set of pushing contacts was still changing when the search ended. No contact attracts, but one
    /// may have been left out of this step.
    pub active_set_unsettled: bool,
    /// The step was taken without geometric stiffness, because with it the linear system was not a
    /// prediction.
    pub geometric_stiffness_dropped: bool,
    /// An iterative integrator ended before it reached its tolerance; its documentation says which step it
    /// takes then.
    pub unconverged: bool,
    /// Number of linear systems solved; by [`semi_implicit_step`](crate::semi_implicit_step) at most
    /// [`MAX_SOLVES`](crate::MAX_SOLVES).
    pub solves: u32,
}

impl StepStatus {
    /// Whether the step was taken, its contacts settled and its iteration converged.
    pub fn is_ok(&self) -> bool {
        self.failure.is_none() && !self.active_set_unsettled && !self.unconverged
    }
}

/// The outcome of one haptic frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// The body at the end of the step.
    pub state: BodyState,
    /// The coupling's wrench **on the device**, about the handle's origin, at the new state (§5.3.3): −F_c
    /// and −(k_θ u_c + b_θ (ω_h − ω)). It is the wrench that the user should feel: pushed into a wall, it
    /// points out of the wall. [`crate::saturate`] limits it to the device's peaks.
    pub coupling: Wrench,
    /// The coupling's wrench **on the body**, about its centre of mass, at the new state.
    pub coupling_on_body: Wrench,
    /// The contacts' wrench on the body, about its centre of mass, at the new state.
    pub contact: Wrench,
    /// Bit i is set if contact i pushed during the step.
    pub active: u64,
    /// Status of the step.
    pub status: StepStatus,
}

impl Step {
    pub(crate) fn failed(state: &BodyState, why: StepFailure) -> Self {
        Self {
            state: *state,
            coupling: Wrench::ZERO,
            coupling_on_body: Wrench::ZERO,
            contact: Wrench::ZERO,
            active: 0,
            status: StepStatus { failure: Some(why), ..StepStatus::default() },
        }
    }
}
