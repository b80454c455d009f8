//! One haptic frame of a tool of two bodies with a hinge: semi-implicit backward Euler in seven unknowns
//! (§5.2.2, §6.2.3).
//!
//! As in the step of [one body](crate::semi_implicit_step), momenta and placements are taken at the end of
//! the step: with M the tool's mass, L and p the momenta of [the two bodies](super) about their centre of
//! mass and the hinge's,
//!
//! M (V_n − V_0) = h F_n,  L_n − L_0 = h T_n,  p_n − p_0 = h (Q_n + T_q),  R_n = exp(h ω_n*) R_0,  q_n = q_0
//! + h q̇_n,
//!
//! and the centre of mass moves by h V_n. Linearised in (V, ω, q̇), this is a 7×7 system. L_n is carried
//! along like the momentum of one body, with the inertia at the angle q_0 + h q̇: so the linear momentum of a
//! free tool is conserved exactly, the angular momentum to second order.
//!
//! T_q is the derivative of the kinetic energy by the angle, the centrifugal torque. It is evaluated in the
//! middle of the step, at q_0 + h q̇_0/2, where it is close to the difference quotient ½ uᵀ (M_n − M_0) u/(h
//! q̇) of the inertia M(q) for u = (ω, q̇) at the end. With the quotient a free tool would gain no energy E:
//!
//! 2 E_n = uᵀ M_0 u_0 + h q̇ T_q ≤ ½ uᵀ M_0 u + E_0 + ½ uᵀ (M_n − M_0) u = E_n + E_0,
//!
//! by the Cauchy–Schwarz inequality. The remaining error is that of the linearisation and of the midpoint
//! (the test in `tests/articulated.rs` allows 1e-6 of it a step, at up to 50 rad/s).
//!
//! # Forces
//!
//! Contacts, and the virtual coupling on the first body, make the same 6×6 systems as for a single body: A_i
//! for the change of its twist, and a right-hand side. With J_i the 6×7 matrix that takes (V, ω, q̇) to the
//! body's twist, and S_i the derivative of J_i u_0 by the placement (the centres of mass move on arcs), the
//! change of the body's twist over the step is (J_i + h S_i) Δu + h S_i u_0, and the tool gets
//! J_iᵀ A_i (J_i + h S_i). The turning of J_i itself under the forces at the start is geometric stiffness. It
//! is dropped, with S_i, if the matrix is no prediction with it, like the geometric stiffness of one body.
//!
//! A body's displacement over the step is h times its twist at the end. If its centre of mass moves on an
//! arc, this differs from the displacement by h (V, ω, q̇) in second order.
//!
//! The hinge's stops are springs of one coordinate, in the system if they are closed at the end of the step.
//! The active set of contacts and stops is found as for one body: after a few solves they only leave it.

use arrayvec::ArrayVec;
use glam::{DMat3, DVec3};
use palpate_core::{Pose, Wrench};

use super::tool_system::{ToolSolution, ToolSystem, stop_torque};
use super::{ArticulatedBody, ArticulatedState, GripperCoupling, GripperMotion};
use crate::body::{Body, BodyState};
use crate::coupling::{DeviceMotion, VirtualCoupling};
use crate::penalty::LinearContactModel;
use crate::step::{Frame, StepFailure, StepStatus, System};

/// The tool and all that acts on it during a step.
#[derive(Clone, Copy, Debug)]
pub struct ArticulatedFrame<'a> {
    /// The tool.
    pub tool: &'a ArticulatedBody,
    /// The device, taken to keep this pose and velocity for the whole step.
    pub device: &'a DeviceMotion,
    /// Virtual coupling of the device to the first body; the grasp is in that body's axes, from its centre
    /// of mass.
    pub coupling: &'a VirtualCoupling,
    /// The gripper, taken to keep this angle and rate for the whole step.
    pub gripper: &'a GripperMotion,
    /// Coupling of the gripper to the hinge.
    pub grip: &'a GripperCoupling,
    /// The contacts of the first body and of the second.
    pub contacts: [&'a LinearContactModel; 2],
    /// Gravity, m/s², world axes.
    pub gravity: DVec3,
}

/// The outcome of one haptic frame of a tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArticulatedStep {
    /// The tool at the end of the step.
    pub state: ArticulatedState,
    /// The virtual coupling's wrench **on the device**, about the handle's origin, at the new state.
    pub coupling: Wrench,
    /// The virtual coupling's wrench **on the first body**, about its centre of mass, at the new state.
    pub coupling_on_body: Wrench,
    /// The torque **on the gripper** about the hinge's axis, at the new state, N·m: positive towards larger
    /// angles.
    pub gripper: f64,
    /// The torque of the hinge's stops on the second body about the hinge's axis, at the new state, N·m.
    pub stop: f64,
    /// The contacts' wrench on each body, about its own centre of mass, at the new state.
    pub contacts: [Wrench; 2],
    /// Bit i of each is set if contact i of that body pushed during the step.
    pub active: [u64; 2],
    /// Status of the step; its solves are of 7×7 systems, at most
    /// [`MAX_ARTICULATED_SOLVES`](crate::MAX_ARTICULATED_SOLVES).
    pub status: StepStatus,
}

/// Advances a tool by `dt` (s) under the loads of a frame, and evaluates the wrench for the device and the
/// torque for the gripper at the new state.
///
/// Nothing is allocated; nothing panics. Unusable inputs and results that are not finite are refused as by
/// [`semi_implicit_step`](crate::semi_implicit_step): the state is held and wrenches and torques are zero. A
/// state that is not finite is replaced by one at rest where the coupling is relaxed, with the hinge at the
/// gripper's angle within its limits.
pub fn articulated_step(frame: &ArticulatedFrame<'_>, state: &ArticulatedState, dt: f64) -> ArticulatedStep {
    if let Some(refused) = frame.refused(state, dt) {
        return refused;
    }
    with_system(frame, state, dt, |system, _| {
        let Some(ToolSolution { change, active, status, .. }) = system.solve() else {
            return ArticulatedStep::failed(state, StepFailure::Singular);
        };
        let next = system.moved(frame.tool, state, &change);
        frame.ended(state, &next, active.bodies, status)
    })
}

/// Makes the system of a step of `dt` (s) and the states of the two bodies, and takes the step with them.
pub(super) fn with_system<R>(
    frame: &ArticulatedFrame<'_>,
    state: &ArticulatedState,
    dt: f64,
    step: impl FnOnce(&mut ToolSystem<'_>, &[BodyState; 2]) -> R,
) -> R {
    let ArticulatedFrame { tool, device, coupling, contacts, .. } = *frame;
    let bodies = [state.first, tool.second(state)];
    // The bodies' inertia is in the tool's equations, so their own systems have only the loads.
    let massless = Body { mass: 0.0, inertia: DMat3::ZERO };
    let nothing = VirtualCoupling {
        linear_stiffness: 0.0,
        linear_damping: 0.0,
        angular_stiffness: 0.0,
        angular_damping: 0.0,
        grasp: Pose::IDENTITY,
        max_force: f64::INFINITY,
        max_torque: f64::INFINITY,
    };
    let [first, second] = [(coupling, contacts[0]), (&nothing, contacts[1])].map(|(coupling, contacts)| {
        Frame { body: &massless, device, coupling, contacts, gravity: DVec3::ZERO }
    });
    let mut candidates = [ArrayVec::new(), ArrayVec::new()];
    let [of_first, of_second] = &mut candidates;
    let systems =
        [System::new(&first, &bodies[0], dt, of_first), System::new(&second, &bodies[1], dt, of_second)];
    let mut system = ToolSystem::new(frame, state, &bodies, systems, dt);
    step(&mut system, &bodies)
}

impl ArticulatedFrame<'_> {
    /// Returns the failed step for unusable inputs, or `None` if they are usable.
    pub(super) fn refused(&self, state: &ArticulatedState, dt: f64) -> Option<ArticulatedStep> {
        if !state.is_valid() {
            let relaxed = self.coupling.relaxed_pose(&self.device.pose);
            let pose = if relaxed.is_valid() { relaxed } else { Pose::IDENTITY };
            let limits = &self.tool.joint.limits;
            let commanded = if self.gripper.angle.is_finite() { self.gripper.angle } else { 0.0 };
            let angle = commanded.max(limits.low).min(limits.high);
            return Some(ArticulatedStep::failed(
                &ArticulatedState::at_rest(pose, angle),
                StepFailure::State,
            ));
        }
        if !(self.device.is_valid() && self.gripper.is_valid()) {
            return Some(ArticulatedStep::failed(state, StepFailure::Device));
        }
        if !(dt > 0.0 && dt.is_finite()) {
            return Some(ArticulatedStep::failed(state, StepFailure::TimeStep));
        }
        None
    }

    /// Makes the step from `start` to `next` with the wrenches at `next`, or a failed one if they are not
    /// finite.
    pub(super) fn ended(
        &self,
        start: &ArticulatedState,
        next: &ArticulatedState,
        active: [u64; 2],
        status: StepStatus,
    ) -> ArticulatedStep {
        let overflow = ArticulatedStep::failed(start, StepFailure::Overflow);
        if !next.is_valid() {
            return overflow;
        }
        let (coupling_on_body, on_device) = self.coupling.wrenches(&next.first, self.device);
        let contacts =
            [self.contacts[0].wrench(&next.first), self.contacts[1].wrench(&self.tool.second(next))];
        let gripper = -self.grip.torque(next, self.gripper);
        let stop = stop_torque(self.tool, next);
        let wrenches = [coupling_on_body, on_device, contacts[0], contacts[1]];
        if !(wrenches.iter().all(Wrench::is_finite) && gripper.is_finite() && stop.is_finite()) {
            return overflow;
        }
        ArticulatedStep {
            state: *next,
            coupling: on_device,
            coupling_on_body,
            gripper,
            stop,
            contacts,
            active,
            status,
        }
    }
}

impl ArticulatedStep {
    pub(super) fn failed(state: &ArticulatedState, why: StepFailure) -> Self {
        Self {
            state: *state,
            coupling: Wrench::ZERO,
            coupling_on_body: Wrench::ZERO,
            gripper: 0.0,
            stop: 0.0,
            contacts: [Wrench::ZERO; 2],
            active: [0; 2],
            status: StepStatus { failure: Some(why), ..StepStatus::default() },
        }
    }
}
