//! Evaluation of all contacts at a state of the body: wrench, Jacobian, reactions on the scene's objects and
//! energy.

use std::num::NonZeroU32;

use glam::DMat3;
use palpate_core::{Pose, Wrench};

use super::contact::{ContactState, PenaltyContact};
use super::friction::FrictionForce;
use super::model::LinearContactModel;
use crate::algebra::rotation::{skew, skew_skew};
use crate::body::BodyState;
use crate::jacobian::{Block6, WrenchJacobian};

/// The wrench of the contacts at one state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactResponse {
    /// Sum of F_p and T_p on the body, about its centre of mass.
    pub wrench: Wrench,
    /// Derivatives of the wrench; contacts without force add nothing.
    pub jacobian: WrenchJacobian,
    /// Bit i is set if contact i pushes.
    pub active: u64,
}

/// Parts of a contact's wrench on the body.
#[derive(Clone, Copy, Debug, Default)]
struct ContactForce {
    /// λ, N.
    normal: f64,
    friction: FrictionForce,
}

impl PenaltyContact {
    /// Normal force and friction at a state.
    #[inline(always)]
    fn force(&self, state: &BodyState, at: &ContactState) -> ContactForce {
        let normal = self.normal_force(at);
        let grips = normal > 0.0 && at.overlap > 0.0 && self.friction.is_some();
        let friction = if grips { self.friction_force(state, at, normal) } else { FrictionForce::default() };
        ContactForce { normal, friction }
    }

    /// Wrench on the body, about its centre of mass: F = F_t − λ ∂δ/∂x, T = a × F_t + T_n n − λ ∂δ/∂φ.
    #[inline(always)]
    fn wrench(&self, at: &ContactState, ContactForce { normal, friction }: &ContactForce) -> Wrench {
        let torque = at.arm.cross(friction.force) + self.normal * friction.moment;
        Wrench { force: friction.force - at.direction * *normal, torque: torque - at.moment * *normal }
    }
}

impl LinearContactModel {
    /// Wrench of the contacts on the body at a state, about the centre of mass, without derivatives.
    pub fn wrench(&self, state: &BodyState) -> Wrench {
        let rotation = DMat3::from_quat(state.pose.rotation);
        let mut sum = Wrench::ZERO;
        for (i, c) in self.contacts().iter().enumerate() {
            let at = self.at(i, state, &rotation);
            let force = c.force(state, &at);
            if force.normal > 0.0 {
                sum += c.wrench(&at, &force);
            }
        }
        sum
    }

    /// Largest normal force with which one contact pushes the body at a state, N.
    pub fn largest_force(&self, state: &BodyState) -> f64 {
        let rotation = DMat3::from_quat(state.pose.rotation);
        let forces = self.contacts().iter().enumerate();
        forces.map(|(i, c)| c.normal_force(&self.at(i, state, &rotation))).fold(0.0, f64::max)
    }

    /// Wrench and derivatives at a state (Eq. 5.37–5.46, corrected, by rotation vector).
    pub fn evaluate(&self, state: &BodyState) -> ContactResponse {
        let rotation = DMat3::from_quat(state.pose.rotation);
        let mut response =
            ContactResponse { wrench: Wrench::ZERO, jacobian: WrenchJacobian::ZERO, active: 0 };
        for (i, c) in self.contacts().iter().enumerate() {
            let at = self.at(i, state, &rotation);
            let force = c.force(state, &at);
            let ContactForce { normal, friction } = force;
            if normal <= 0.0 {
                continue;
            }
            response.active |= 1 << i;
            response.wrench += c.wrench(&at, &force);
            response.jacobian += self.normal_jacobian(i, state, &at, normal);
            if c.friction.is_some() && at.overlap > 0.0 {
                response.jacobian += c.friction_jacobian(state, &at, normal, &friction);
            }
        }
        response
    }

    /// Derivatives of the wrench −λ ∇δ of the normal force λ (N) of one contact: −∇δ ∂λ − λ ∂∇δ.
    fn normal_jacobian(
        &self,
        index: usize,
        state: &BodyState,
        at: &ContactState,
        normal: f64,
    ) -> WrenchJacobian {
        let c = &self.contacts()[index];
        let direction = (-at.direction, -at.moment);
        // ∂λ = k ∂δ + b ∂δ̇ by placement and b ∇δ by velocity.
        let stiffness = c.stiffness_at(at.overlap).unwrap_or(0.0);
        let by_turn = at.moment * stiffness + c.swept(at, state.twist.angular);
        let mut pose = Block6::outer(direction, (at.direction * stiffness, by_turn));
        // The arm turns: −λ ∂(a × n)/∂φ.
        pose.torque_angular += skew_skew(c.normal * -normal, at.arm);
        for term in self.terms_of(index) {
            // A term of s with gradient b = ∂s adds curvature · b bᵀ to the second derivative of δ, which
            // enters by −λ ∂∇δ and by the rate of ∇δ in ∂δ̇.
            let term = term.at(state);
            let (along, turn) = (term.linear * term.curvature, term.angular * term.curvature);
            pose += Block6::outer((term.linear * -normal, term.angular * -normal), (along, turn));
            let swept = c.damping * term.rate(&state.twist);
            pose += Block6::outer(direction, (along * swept, turn * swept));
            pose.torque_angular += skew(term.angular) * (0.5 * normal * term.slope);
        }
        let twist = Block6::outer(direction, (at.direction * c.damping, at.moment * c.damping));
        WrenchJacobian { pose, twist }
    }

    /// Wrenches **on the scene's objects** that receive reactions, one for each contact, about the world's
    /// origin, with the body at a state. Together with those on the other objects, which are left out, their
    /// sum is the opposite of [`wrench`](Self::wrench).
    pub fn reactions(&self, state: &BodyState) -> impl Iterator<Item = (NonZeroU32, Wrench)> {
        let rotation = DMat3::from_quat(state.pose.rotation);
        let state = *state;
        self.contacts().iter().enumerate().filter(|_| self.reacts()).filter_map(move |(i, c)| {
            let object = c.surface.object?;
            let at = self.at(i, &state, &rotation);
            let force = c.force(&state, &at);
            (force.normal > 0.0).then(|| {
                let on_body = c.wrench(&at, &force).about(-state.pose.translation);
                (object, Wrench { force: -on_body.force, torque: -on_body.torque })
            })
        })
    }

    /// Energy stored in the contact springs, J.
    pub fn potential_energy(&self, pose: &Pose) -> f64 {
        let state = BodyState::at_rest(*pose);
        let rotation = DMat3::from_quat(pose.rotation);
        let energy = |(i, c): (usize, &PenaltyContact)| {
            0.5 * c.stiffness * self.at(i, &state, &rotation).overlap.max(0.0).powi(2)
        };
        self.contacts().iter().enumerate().map(energy).sum()
    }
}
