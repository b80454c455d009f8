//! The linear systems of a step, and the search for the set of contacts that push.

use arrayvec::ArrayVec;
use glam::{DMat3, DVec3};
use palpate_core::{Twist, Wrench};

use super::active_contact::ActiveContact;
use super::frame::Frame;
use super::outcome::StepStatus;
use crate::algebra::linear_solve::is_positive_definite;
use crate::algebra::rotation::{cross_columns, exponential};
use crate::body::BodyState;
use crate::jacobian::outer;
use crate::penalty::{LinearContactModel, MAX_PENALTY_CONTACTS, PenaltyContact, Strain};
use crate::system::{Lateral, Linear, cross_sum, six};

/// Number of solves in which contacts may both join and leave the active set. With fewer, contacts that close
/// in the step are more often left to the next.
pub(crate) const FREE_SOLVES: u32 = 6;

/// Largest number of 6×6 systems that one step solves: the free ones, one for each contact that may leave,
/// and the last.
pub const MAX_SOLVES: u32 = FREE_SOLVES + MAX_PENALTY_CONTACTS as u32 + 1;

/// Relative change of a friction share, from solve to solve, below which it has converged. With less, steps
/// with sliding contacts take more solves.
const SHARE_TOLERANCE: f64 = 0.01;

/// Outcome of a search.
pub(crate) struct Solution {
    /// Change of the velocity.
    pub change: Twist,
    /// The active set.
    pub active: u64,
    /// Matrix of its system.
    pub matrix: [[f64; 6]; 6],
    pub status: StepStatus,
}

/// The terms of one step's linear systems, from which the system of any active set is assembled.
pub(crate) struct System<'a> {
    contacts: &'a LinearContactModel,
    rotation: DMat3,
    state: &'a BodyState,
    /// All contacts, from which the active set is chosen. Stored by the caller, since it is large.
    candidates: &'a mut ArrayVec<ActiveContact, MAX_PENALTY_CONTACTS>,
    /// Bit i is set if contact i is closed at the start.
    pub closed_at_start: u64,
    dt: f64,
    mass: f64,
    inertia: DMat3,
    /// Left: the mass, and the coupling's spring and damper at the grasp, with the spring's secant stiffness
    /// in all directions.
    held: Lateral,
    /// Left: softening of that spring along its deviation, as a column and a row.
    softening: Option<([f64; 6], [f64; 6])>,
    /// Left: carried momentum and the coupling's angular spring and damper.
    spin: DMat3,
    /// Right: coupling, carried momentum and gravity.
    right: [f64; 6],
    /// The coupling's geometric stiffness (force, torque) by φ.
    turning: (DMat3, DMat3),
    /// Whether geometric stiffness is in the systems.
    pub geometric: bool,
    /// Whether the friction shares that follow from the last solve are those that it was made with.
    pub shares_converged: bool,
}

impl<'a> System<'a> {
    #[inline]
    pub fn new(
        &Frame { body, device, coupling, contacts, gravity }: &Frame<'a>,
        state: &'a BodyState,
        dt: f64,
        candidates: &'a mut ArrayVec<ActiveContact, MAX_PENALTY_CONTACTS>,
    ) -> Self {
        let rotation = DMat3::from_quat(state.pose.rotation);
        let inertia = rotation * body.inertia * rotation.transpose();
        // A spring k and a damper b add h (h k + b) at the grasp to the matrix.
        let spring = coupling.linearise(state, device);
        let mut held = Lateral::at_centre(body.mass);
        held.add(dt * (dt * spring.stiffness + spring.damping), spring.arm);
        let (softening, axis) = spring.softening;
        let softening = (softening != 0.0).then(|| {
            let (gain, lever) = (dt * dt * softening, spring.arm.cross(axis));
            (six(axis, lever), six(axis * gain, lever * gain))
        });
        let (gained, momentum_by_spin) = carried_momentum(&inertia, state.twist.angular, dt);
        let damping = DMat3::from_diagonal(DVec3::splat(spring.angular_damping));
        let spin = momentum_by_spin + (spring.angular_stiffness * dt + damping) * dt;
        // Right-hand side: h (f_0 + h ∂f/∂(x, φ) (v_0, ω_0)) − (0, (E − 1) I_0 ω_0).
        let drift = spring.drift(&state.twist);
        let force = spring.on_body.force + gravity * body.mass + drift.force * dt;
        let torque = spring.on_body.torque + drift.torque * dt;

        Self {
            contacts,
            rotation,
            state,
            candidates,
            closed_at_start: 0,
            dt,
            mass: body.mass,
            inertia,
            held,
            softening,
            spin,
            right: six(force * dt, torque * dt - gained),
            turning: spring.geometric,
            geometric: true,
            shares_converged: true,
        }
    }

    /// Linearises the contacts at the start of the step. Returns those that are closed and push at its end if
    /// the velocity does not change: the first guess of the active set.
    pub fn linearise_contacts(&mut self) -> u64 {
        let mut pushing = 0;
        self.closed_at_start = 0;
        self.candidates.clear();
        for (i, c) in self.contacts.contacts().iter().enumerate() {
            let at = self.contacts.at(i, self.state, &self.rotation);
            self.closed_at_start |= u64::from(c.stiffness_at(at.overlap).is_some()) << i;
            let contact = ActiveContact::new(c, &at, self.state, self.dt, self.geometric);
            pushing |= u64::from(c.stiffness_at(contact.overlap).is_some() && contact.force > 0.0) << i;
            self.candidates.push(contact);
        }
        pushing
    }

    /// The contacts of a set with their planes.
    fn active(&self, active: u64) -> impl Iterator<Item = (&PenaltyContact, &ActiveContact)> {
        let all = self.contacts.contacts().iter().zip(&*self.candidates).enumerate();
        all.filter(move |(i, _)| active & (1 << i) != 0).map(|(_, contact)| contact)
    }

    /// Wrench at the start of the step of the contacts in a set, about the centre of mass.
    pub fn wrench_at_start(&self, active: u64) -> Wrench {
        let mut wrench = Wrench::ZERO;
        for (_, p) in self.active(active) {
            let along = p.friction.as_ref().map_or(DVec3::ZERO, |friction| friction.force_at_start);
            wrench.force += along - p.direction * p.force_at_start;
            wrench.torque += p.arm.cross(along) - p.moment * p.force_at_start;
        }
        wrench
    }

    /// Assembles the linear system with the contacts of a set,
    ///
    /// (A − h ∂f/∂(v, ω) − h² ∂f/∂(x, φ)) (Δv, Δω) = h (f_0 + h ∂f/∂(x, φ) (v_0, ω_0)) − (0, (E − 1) I_0
    /// ω_0),
    ///
    /// from the terms of the coupling, each contact's spring, damper and friction, their curvature, and the
    /// geometric stiffness of all.
    #[inline(always)]
    pub fn assemble(&self, active: u64) -> Linear {
        let h = self.dt;
        let mut linear = Linear::with_right(self.right);
        let mut lateral = self.held;
        if let Some((direction, row)) = &self.softening {
            linear.add_along(direction, row);
        }
        // Σ a Fᵀ of the forces at the start, for their geometric stiffness.
        let mut turning = DMat3::ZERO;
        for (c, p) in self.active(active) {
            turning += self.add_contact(c, p, &mut linear, &mut lateral);
        }
        self.add_curvature(active, &mut linear);
        let (mut force_by_turn, mut torque_by_turn) = (DMat3::ZERO, self.spin);
        if self.geometric {
            // −h² ∂f/∂φ on the left and h² ∂f/∂φ ω_0 on the right, with ∂T/∂φ = Σ F* a* of the contacts.
            let angular = self.state.twist.angular;
            let (force, torque) = self.turning;
            let (force, torque) = (force * (h * h), (torque + cross_sum(&turning)) * (h * h));
            force_by_turn -= force;
            torque_by_turn -= torque;
            linear.add_right(force * angular, torque * angular);
        }
        linear.add_with_lateral(&lateral, &force_by_turn, &torque_by_turn);
        linear
    }

    /// Adds a contact that pushes, and returns a Fᵀ of its force at the start.
    ///
    /// With D = (n, a × n) and Δ = (Δv, Δω), the normal force at the end is λ_n = λ + (h k + b) D · Δ + h ∂(b
    /// δ̇)/∂φ · Δω, where λ is the force for an unchanged velocity: h D ((h k + b) D + h ∂(b δ̇)/∂φ)ᵀ on the
    /// left and −h λ D on the right. Friction acts in all directions of the plane with the share s of its
    /// spring and damper: the gain g = h (h k + b) s at the point in all directions, less g along n.
    #[inline(always)]
    fn add_contact(
        &self,
        c: &PenaltyContact,
        p: &ActiveContact,
        linear: &mut Linear,
        lateral: &mut Lateral,
    ) -> DMat3 {
        let h = self.dt;
        let mut along_normal = h * (h * p.stiffness + c.damping);
        let mut impulse = DVec3::ZERO;
        let mut force = c.normal * -p.force_at_start;
        if let Some(friction) = &p.friction {
            let gain = h * (h * c.stiffness + c.damping) * friction.share;
            lateral.add(gain, p.arm);
            along_normal -= gain;
            // −h s (k ξ + b v_t) at the end for an unchanged velocity.
            let Strain { along, spin } = friction.trial.scaled(-h * friction.share);
            impulse += along;
            force += friction.force_at_start;
            if c.radius > 0.0 {
                // ρ² g n nᵀ against spinning about the normal.
                linear.add(3, 3, &outer(c.normal, c.normal * (gain * c.radius * c.radius)));
                linear.add_right(DVec3::ZERO, c.normal * (c.radius * spin));
            }
        }
        let row = six(p.direction * along_normal, p.moment * along_normal + p.swept * h);
        linear.add_along(&six(p.direction, p.moment), &row);
        let torque = p.arm.cross(impulse) - p.moment * (h * p.force);
        linear.add_right(impulse - p.direction * (h * p.force), torque);
        outer(p.arm, force)
    }

    /// Adds the curvature terms of contacts that push: h² λ κ b bᵀ on the left for a term of curvature κ with
    /// ∂s = b, and −h² λ κ b ṡ with ṡ = b · (v_0, ω_0) on the right.
    #[inline(always)]
    fn add_curvature(&self, active: u64, linear: &mut Linear) {
        let h = self.dt;
        let terms = self.contacts.curvature_terms().iter();
        for term in terms.filter(|term| active & (1 << term.contact) != 0) {
            let at = term.at(self.state);
            let gain = h * h * at.curvature * self.candidates[term.contact].force.max(0.0);
            let row = six(at.linear * gain, at.angular * gain);
            linear.add_along(&six(at.linear, at.angular), &row);
            let rate = at.rate(&self.state.twist);
            linear.add_right(at.linear * (-gain * rate), at.angular * (-gain * rate));
        }
    }

    /// Whether the linear system is a prediction: the symmetric part of its matrix exceeds half the mass
    /// matrix, K + Kᵀ − M > 0.
    #[inline(always)]
    fn predicts(&self, matrix: &[[f64; 6]; 6]) -> bool {
        let mut symmetric: [[f64; 6]; 6] =
            std::array::from_fn(|i| std::array::from_fn(|j| matrix[i][j] + matrix[j][i]));
        for (i, entries) in self.inertia.to_cols_array_2d().iter().enumerate() {
            symmetric[i][i] -= self.mass;
            for (j, value) in entries.iter().enumerate() {
                symmetric[3 + i][3 + j] -= value;
            }
        }
        is_positive_definite(symmetric)
    }

    /// Predicts from a change of velocity Δ which contacts are closed and push at the end of the step, and
    /// which are closed: δ_n = δ + h D · Δ and λ_n = λ + (h k + b) D · Δ + h ∂(b δ̇)/∂φ · Δω. Updates the
    /// friction shares to those that follow.
    pub fn predict(&mut self, change: &Twist) -> (u64, u64) {
        let (mut pushing, mut closed) = (0, 0);
        self.shares_converged = true;
        for (i, (c, p)) in self.contacts.contacts().iter().zip(&mut *self.candidates).enumerate() {
            let rate = p.rate_of(change);
            let gain = self.dt * p.stiffness + c.damping;
            let is_closed = c.stiffness_at(p.overlap + self.dt * rate).is_some();
            let force = p.force + gain * rate + p.swept.dot(change.angular);
            let pushes = is_closed && force > 0.0;
            closed |= u64::from(is_closed) << i;
            pushing |= u64::from(pushes) << i;
            if let Some(friction) = p.friction.as_mut().filter(|_| pushes) {
                let velocity = change.velocity_at(p.arm);
                let gained = c.velocity_strain(velocity, c.normal.dot(velocity), change.angular);
                let share = friction.share_after(&gained, c, force, self.dt);
                self.shares_converged &= (share - friction.share).abs() <= SHARE_TOLERANCE * friction.share;
                friction.share = share;
            }
        }
        (pushing, closed)
    }

    /// Searches the active set; `None` if a system is singular.
    ///
    /// The set of the next solve is the predicted one, without the contacts left to the next step. From
    /// [`FREE_SOLVES`] on it is also a subset of the present one, so that the search ends.
    #[inline(always)]
    pub(crate) fn solve(&mut self) -> Option<Solution> {
        let mut status = StepStatus::default();
        let mut left_for_next = 0_u64;
        let mut active = self.linearise_contacts();
        loop {
            let mut linear = self.assemble(active);
            if self.geometric && !self.predicts(&linear.matrix) {
                self.geometric = false;
                status.geometric_stiffness_dropped = true;
                self.linearise_contacts();
                linear = self.assemble(active);
            }
            status.solves += 1;
            let [vx, vy, vz, wx, wy, wz] = linear.solution(self.geometric)?;
            let change = Twist { linear: DVec3::new(vx, vy, vz), angular: DVec3::new(wx, wy, wz) };
            let (pushing, closed) = self.predict(&change);
            left_for_next |= active & !closed & !self.closed_at_start;
            let wanted = pushing & !left_for_next;
            let next = if status.solves < FREE_SOLVES { wanted } else { wanted & active };
            let settled = next == active && (self.shares_converged || status.solves >= FREE_SOLVES);
            if settled || status.solves >= MAX_SOLVES {
                status.active_set_unsettled = wanted != active;
                return Some(Solution { change, active, matrix: linear.matrix, status });
            }
            active = next;
        }
    }
}

/// Change (E − 1) I ω, E = exp(h ω*), of the momentum that a body spinning at ω carries over the step, and
/// the derivative of E I ω by ω: E I − (E I ω)* h J_l(h ω).
#[inline(always)]
pub(crate) fn carried_momentum(inertia: &DMat3, angular: DVec3, dt: f64) -> (DVec3, DMat3) {
    let (turn, left) = exponential(angular * dt);
    let momentum = *inertia * angular;
    let gained = turn * momentum;
    let derivative = *inertia + turn * *inertia - cross_columns((momentum + gained) * dt, &left);
    (gained, derivative)
}
