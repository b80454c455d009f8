//! One haptic frame of the grasped body: semi-implicit backward Euler in six unknowns (§5.2.2).
//!
//! Backward Euler on momentum and placement, with h the time step, n and 0 the end and the start of it:
//!
//! m (v_n − v_0) = h F_n,   I(R_n) ω_n − I(R_0) ω_0 = h T_n,   x_n = x_0 + h v_n,   R_n = exp(h ω_n*) R_0,
//!
//! where I(R) = R I Rᵀ. The dissertation linearises this (Eq. 5.6) in thirteen variables; here the placement
//! follows from the velocity, so the unknowns are (Δv, Δω):
//!
//! (A − h ∂f/∂(v, ω) − h² ∂f/∂(x, φ)) (Δv, Δω) = h (f_0 + h ∂f/∂(x, φ) (v_0, ω_0)) − (0, (E − 1) I_0 ω_0)
//!
//! with the wrench f and E = exp(h ω_0*). On the left, A is the mass for v; for ω it is the derivative of the
//! carried momentum I(R_n) ω_n = exp(h ω_n*) I_0 ω_n (exp(h ω_n*) does not change ω_n itself): A_ω = E I_0 −
//! (E I_0 ω_0)* h J_l(h ω_0). To first order in h this is the gyroscopic torque −ω × I ω with its Jacobian.
//! In full, it conserves the momentum of a free body to second order, and a free body gains energy only by
//! the error of the linearisation (the test in `tests/motion.rs` allows 1e-6 of it a step, at 100 rad/s).
//!
//! # Active contacts
//!
//! A contact is in the system, with its spring and damper linearised at the start, if the linear system
//! predicts that at the *end* of the step it is both closed (δ + d > 0, or braking before) and pushing (λ >
//! 0). The active set is found by iteration: guess from the motion at the start velocity, solve, compare,
//! solve again. Two rules make the iteration end. A contact that is open at the start and that its own force
//! would keep open is left to the next step (the damper's force jumps at closing, so that neither answer is
//! consistent). And after [`FREE_SOLVES`] solves contacts only leave the set. In all cases no contact
//! attracts: one whose predicted force is negative is never in the solution that is used.
//!
//! # Friction
//!
//! A contact in the set with friction adds its spring and damper along the plane and about its normal,
//! linearised likewise. One that slides adds the share of them that friction holds; the shares are found by
//! the same iteration, starting from those at the start. So friction never makes the matrix less definite,
//! and a sliding contact is damped as much as friction allows.
//!
//! # Curvature
//!
//! If a contact has curvature terms ([`CurvedContact`](crate::CurvedContact)), its direction is that at
//! the start. The stiffness of the terms is in the matrix, with the force at the end of the step for an
//! unchanged velocity; it is positive semidefinite.
//!
//! # Geometric stiffness
//!
//! A force that keeps its direction while its lever arm turns makes a torque whose derivative F* a* is
//! indefinite: a long tool pressed along its axis is an inverted pendulum. If that instability is faster than
//! the step, the linear system is no prediction (it flips the sign of the motion). So the symmetric part of
//! the matrix is tested to exceed half the mass matrix. If it does not, the step is taken without those
//! terms (and without the turning of the dampers' arms), which leaves springs, dampers and mass. Consistency
//! to first order does not need them.

mod active_contact;
mod frame;
mod outcome;
mod system;
#[cfg(test)]
mod tests;

use arrayvec::ArrayVec;
use glam::DVec3;
use palpate_core::Twist;

use crate::body::{Body, BodyState};
use crate::coupling::{DeviceMotion, VirtualCoupling};
use crate::penalty::LinearContactModel;

pub use frame::Frame;
pub use outcome::{Step, StepFailure, StepStatus};
pub use system::MAX_SOLVES;
#[cfg(feature = "integrators")]
pub(crate) use system::carried_momentum;
pub(crate) use system::{FREE_SOLVES, Solution, System};

/// Advances the body by `dt` (s) under the coupling, the contacts and `gravity` (m/s²), and evaluates the
/// wrench for the device at the new state.
///
/// The device is taken to stay at its sampled pose, with its sampled velocity, for the whole step. Nothing is
/// allocated; nothing panics. If an input is not usable or the result would not be finite, the state is
/// returned unchanged, both wrenches are zero, and [`StepStatus::failure`] has the reason; the caller decides
/// how the device's wrench fades. A state that is not finite cannot be held: the body is then put at rest
/// where the coupling is relaxed (or at the identity, if the device's pose is not usable either).
pub fn semi_implicit_step(
    body: &Body,
    state: &BodyState,
    device: &DeviceMotion,
    coupling: &VirtualCoupling,
    contacts: &LinearContactModel,
    gravity: DVec3,
    dt: f64,
) -> Step {
    let frame = Frame { body, device, coupling, contacts, gravity };
    if let Some(refused) = frame.refused(state, dt) {
        return refused;
    }

    let mut candidates = ArrayVec::new();
    let mut system = System::new(&frame, state, dt, &mut candidates);
    let Some(Solution { change, active, status, .. }) = system.solve() else {
        return Step::failed(state, StepFailure::Singular);
    };

    let twist =
        Twist { linear: state.twist.linear + change.linear, angular: state.twist.angular + change.angular };
    let next = BodyState { pose: state.pose.moved(&twist, dt), twist };
    frame.ended(state, &next, active, status)
}
