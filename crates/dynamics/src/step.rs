//! One haptic frame of the grasped body: semi-implicit backward Euler in six unknowns (§5.2.2).
//!
//! Backward Euler on momentum and placement, with h the time step, n and 0 the end and the start of it:
//!
//! m (v_n − v_0) = h F_n,   I(R_n) ω_n − I(R_0) ω_0 = h T_n,   x_n = x_0 + h v_n,   R_n = exp(h ω_n*) R_0,
//!
//! where I(R) = R I Rᵀ. The dissertation linearises this (Eq. 5.6) in thirteen variables; here the placement
//! follows from the velocity, so (Δv, Δω) is all there is to solve for:
//!
//! (A − h ∂f/∂(v, ω) − h² ∂f/∂(x, φ)) (Δv, Δω) = h (f_0 + h ∂f/∂(x, φ) (v_0, ω_0)) − (0, (E − 1) I_0 ω_0)
//!
//! with f the wrench and E = exp(h ω_0*). On the left A is the mass for v; for ω it is the derivative of the
//! carried momentum I(R_n) ω_n = exp(h ω_n*) I_0 ω_n, for exp(h ω_n*) leaves ω_n itself in place: A_ω = E I_0
//! − (E I_0 ω_0)* h J_l(h ω_0). To first order in h this is the gyroscopic torque −ω × I ω with its Jacobian;
//! whole, it keeps the momentum of a free body to second order, and a free body gains no energy but for the
//! error of the linearisation (the test in `tests/motion.rs` allows 1e-6 of it a step, at 100 rad/s).
//!
//! # Unilateral contact
//!
//! A contact is in the system, with its spring and damper linearised at the start, if at the *end* of the
//! step it is both closed (δ + d > 0, or braking before) and pushing (λ > 0), as the linear system predicts them. The set is
//! found by iteration: guess from the motion at the start velocity, solve, compare, solve again. Two rules
//! make it end: a contact that is open at the start and that its own force would keep open is left to the
//! next step (the damper's force jumps at closing, so that neither answer is consistent); and after
//! [`FREE_SOLVES`] solves contacts only leave the set. Whatever the outcome, no contact attracts: one whose
//! predicted force is negative is never in the solution that is used.
//!
//! # Friction
//!
//! A contact in the set with friction adds its spring and damper along the plane, and about its normal, likewise
//! linearised. One that slides adds the share of them that friction holds; the shares are found by the same iteration,
//! from those of the start. So the matrix stays as definite as it is, and a contact that slides is damped by as much as
//! friction allows.
//!
//! # Bends
//!
//! Where a contact's depth [bends](crate::bend), its direction is that of the start, and the bend's stiffness is in the
//! matrix with the force at the end of the step if the velocity does not change. It adds to the definiteness of the matrix.
//!
//! # Geometric stiffness
//!
//! A force that keeps its direction while its lever arm turns makes a torque whose derivative F* a* is never
//! semidefinite: pressed along a long tool it is an inverted pendulum. Where that instability is faster than
//! the step, the linear system predicts nothing (it flips the sign of the motion). So the symmetric part of
//! the matrix is tested to exceed half the mass matrix, and if it does not, the step is taken without those
//! terms (and without the turning of the dampers' arms), which leaves springs, dampers and mass. Consistency
//! to first order does not need them.

use arrayvec::ArrayVec;
use glam::{DMat3, DVec3};
use palpate_core::{Twist, Wrench};

use crate::body::{Body, BodyState};
use crate::contact::{ContactState, LinearContactModel, MAX_CONSTRAINTS, PlaneConstraint};
use crate::coupling::{DeviceMotion, VirtualCoupling};
use crate::friction::{Hold, Strain};
use crate::integrators::Frame;
use crate::jacobian::outer;
use crate::linear_solve::is_positive_definite;
use crate::rotation::{cross_columns, exponential};
use crate::system::{Lateral, Linear, cross_sum, six};

/// Solves in which contacts may both join and leave the active set.
pub(crate) const FREE_SOLVES: u32 = 6;

/// The most 6×6 systems that one step solves: the free ones, and one for each contact that may leave, and the
/// last.
pub const MAX_SOLVES: u32 = FREE_SOLVES + MAX_CONSTRAINTS as u32 + 1;

/// Shares of friction that change by less, in a solve, have been found.
const SHARES_ALIKE: f64 = 0.01;

/// Why a step was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum HeldBecause {
    /// The time step is not positive and finite.
    TimeStep,
    /// The device's pose or twist is not finite, or its quaternion not of unit length.
    Device,
    /// The body's state is not finite, or its quaternion not of unit length. The state cannot be held; see
    /// [`semi_implicit_step`].
    State,
    /// The linear system is singular, or something that went into it is not finite: a gain, a contact,
    /// gravity, the body.
    Singular,
    /// The step was computed, but the state or a wrench it leads to is not finite.
    Overflow,
}

/// How a step went.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct StepStatus {
    /// Set if no step was taken: the state is held and the wrenches are zero.
    pub held: Option<HeldBecause>,
    /// The set of pushing contacts was still changing when the step ended; no contact attracts even so, but
    /// one may have been left out for this step.
    pub active_set_unsettled: bool,
    /// The step was taken without geometric stiffness, because with it the linear system was not a
    /// prediction.
    pub geometric_stiffness_dropped: bool,
    /// An iterative integrator ended before its tolerance was reached; see there for what the step is then.
    pub unconverged: bool,
    /// Number of linear systems solved; by [`semi_implicit_step`] at most [`MAX_SOLVES`].
    pub solves: u32,
}

impl StepStatus {
    /// Whether the step was taken, its contacts settled and its iteration converged.
    pub fn is_ok(&self) -> bool {
        self.held.is_none() && !self.active_set_unsettled && !self.unconverged
    }
}

/// The outcome of one haptic frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// The body at the end of the step.
    pub state: BodyState,
    /// The coupling's wrench **on the device**, about the handle's origin, at the new state (§5.3.3): −F_c
    /// and −(k_θ u_c + b_θ (ω_h − ω)). It is what the user is to feel: pushed into a wall, it points out of
    /// the wall. [`crate::saturate`] fits it to what the device can make.
    pub coupling: Wrench,
    /// The coupling's wrench **on the body**, about its centre of mass, at the new state.
    pub coupling_on_body: Wrench,
    /// The contacts' wrench on the body, about its centre of mass, at the new state.
    pub contact: Wrench,
    /// Bit i is set if contact i pushed during the step.
    pub active: u64,
    /// How the step went.
    pub status: StepStatus,
}

/// Advances the body by `dt` (s) under the coupling, the contacts and `gravity` (m/s²), and evaluates at the
/// new state the wrench for the device.
///
/// The device is taken to stand at its sampled pose, with its sampled velocity, for the whole step. Nothing
/// is allocated; nothing panics. If an input is not usable or the result would not be finite, the state is
/// returned as it came, both wrenches are zero, and [`StepStatus::held`] says why; the caller decides how the
/// device's wrench fades. A state that is itself not finite cannot be held: the body is then put, at rest,
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

    let mut pressing = ArrayVec::new();
    let mut system = System::new(&frame, state, dt, &mut pressing);
    let Some((change, active, status)) = system.solve() else {
        return Step::held(state, HeldBecause::Singular);
    };

    let twist =
        Twist { linear: state.twist.linear + change.linear, angular: state.twist.angular + change.angular };
    let next = BodyState { pose: state.pose.moved(&twist, dt), twist };
    frame.ended(state, &next, active, status)
}

impl Step {
    pub(crate) fn held(state: &BodyState, why: HeldBecause) -> Self {
        Self {
            state: *state,
            coupling: Wrench::ZERO,
            coupling_on_body: Wrench::ZERO,
            contact: Wrench::ZERO,
            active: 0,
            status: StepStatus { held: Some(why), ..StepStatus::default() },
        }
    }
}

/// A contact as the step's linear systems see it. Its wrench is along (direction, moment), which also takes the
/// velocity to δ̇.
#[derive(Clone, Copy)]
pub(crate) struct Pressing {
    /// a.
    arm: DVec3,
    /// n, but for bends.
    direction: DVec3,
    /// a × n, but for bends.
    moment: DVec3,
    /// h ∂(b δ̇)/∂φ, or zero without geometric stiffness.
    swept: DVec3,
    /// By what λ grows with δ, N/m.
    stiffness: f64,
    /// δ + d at the end of the step if the velocity does not change, m.
    overlap: f64,
    /// λ at the end of the step if the velocity does not change, before the clamp, N.
    force: f64,
    /// λ at the start, N.
    force_at_start: f64,
    rubbing: Option<Rubbing>,
}

/// What friction adds to a contact that pushes.
#[derive(Clone, Copy)]
struct Rubbing {
    /// v_t at the start, m/s.
    slide: Strain,
    /// k ξ + b v_t at the end of the step if the velocity does not change, N.
    trial: Strain,
    /// s.
    share: f64,
    /// F_t at the start, N.
    force_at_start: DVec3,
}

impl Rubbing {
    /// `force`: λ at the end of the step if the velocity does not change, N; `at_start`: λ at the start, N.
    #[inline(always)]
    fn new(
        c: &PlaneConstraint,
        at: &ContactState,
        state: &BodyState,
        [force, at_start]: [f64; 2],
        dt: f64,
    ) -> Self {
        let Hold { force: force_at_start, trial, slide, .. } = c.hold_before(dt, state, at, at_start);
        let trial = trial.plus(&slide.scaled(c.stiffness * dt));
        Self { slide, trial, share: c.friction.share(&trial, &slide, force.max(0.0)), force_at_start }
    }

    /// s after what the contact is strained by (m/s) has `gained`, where it pushes with `force`.
    #[inline(always)]
    fn share_after(&self, gained: &Strain, c: &PlaneConstraint, force: f64, dt: f64) -> f64 {
        let trial = self.trial.plus(&gained.scaled(c.stiffness * dt + c.damping));
        c.friction.share(&trial, &self.slide.plus(gained), force)
    }
}

impl Pressing {
    #[inline(always)]
    fn new(c: &PlaneConstraint, at: &ContactState, state: &BodyState, dt: f64, geometric: bool) -> Self {
        let twist = &state.twist;
        let swept = if geometric { c.swept(at, twist.angular) * dt } else { DVec3::ZERO };
        // Planes, and where friction holds, are where they will be at the end of the step already.
        let at = &ContactState { overlap: at.overlap + dt * at.direction.dot(c.surface.velocity), ..*at };
        let overlap = at.overlap + dt * at.rate;
        let stiffness = c.stiffness_at(overlap).unwrap_or(c.stiffness);
        let force = stiffness * overlap + c.damping * at.rate + swept.dot(twist.angular);
        let force_at_start = c.normal_force(at);
        let rubs = c.friction.is_some() && (overlap > 0.0 || c.braking_time == 0.0);
        Self {
            arm: at.arm,
            direction: at.direction,
            moment: at.moment,
            swept,
            stiffness,
            overlap,
            force,
            force_at_start,
            rubbing: rubs.then(|| Rubbing::new(c, at, state, [force, c.gripping_force(at)], dt)),
        }
    }
}

/// Everything that one step's linear systems are made of.
pub(crate) struct System<'a> {
    contacts: &'a LinearContactModel,
    rotation: DMat3,
    state: &'a BodyState,
    /// Of each contact. Elsewhere: it is large.
    pressing: &'a mut ArrayVec<Pressing, MAX_CONSTRAINTS>,
    /// Bit i is set if contact i is closed at the start.
    pub closed_at_start: u64,
    dt: f64,
    mass: f64,
    inertia: DMat3,
    /// The mass, and the coupling's spring and damper at the grasp but for what the spring is softer along its deviation.
    held: Lateral,
    /// That, as a direction and a row.
    bend: Option<([f64; 6], [f64; 6])>,
    /// Carried momentum and the coupling's angular spring and damper.
    spin: DMat3,
    /// Coupling, carried momentum and gravity on the right.
    right: [f64; 6],
    /// The coupling's geometric stiffness (force, torque) by φ.
    turning: (DMat3, DMat3),
    /// Whether geometric stiffness is in.
    pub geometric: bool,
    /// Whether the shares of friction were what the last solve led to.
    pub alike: bool,
}

impl<'a> System<'a> {
    #[inline]
    pub fn new(
        &Frame { body, device, coupling, contacts, gravity }: &Frame<'a>,
        state: &'a BodyState,
        dt: f64,
        pressing: &'a mut ArrayVec<Pressing, MAX_CONSTRAINTS>,
    ) -> Self {
        let rotation = DMat3::from_quat(state.pose.rotation);
        let inertia = rotation * body.inertia * rotation.transpose();
        let held_by = coupling.linearise(state, device);
        let mut held = Lateral::at_centre(body.mass);
        held.add(dt * (dt * held_by.stiffness + held_by.damping), held_by.arm);
        let (bend, axis) = held_by.bend;
        let bend = (bend != 0.0).then(|| {
            let (gain, lever) = (dt * dt * bend, held_by.arm.cross(axis));
            (six(axis, lever), six(axis * gain, lever * gain))
        });
        let (gained, momentum_by_spin) = carried_momentum(&inertia, state.twist.angular, dt);
        let damping = DMat3::from_diagonal(DVec3::splat(held_by.angular_damping));
        let spin = momentum_by_spin + (held_by.angular_stiffness * dt + damping) * dt;
        let drift = held_by.drift(&state.twist);
        let force = held_by.on_body.force + gravity * body.mass + drift.force * dt;
        let torque = held_by.on_body.torque + drift.torque * dt;

        Self {
            contacts,
            rotation,
            state,
            pressing,
            closed_at_start: 0,
            dt,
            mass: body.mass,
            inertia,
            held,
            bend,
            spin,
            right: six(force * dt, torque * dt - gained),
            turning: held_by.geometric,
            geometric: true,
            alike: true,
        }
    }

    /// Looks at the contacts from the start of the step. Those that are closed and push at the end of it if the velocity
    /// does not change.
    pub fn see_contacts(&mut self) -> u64 {
        let mut pushing = 0;
        self.closed_at_start = 0;
        self.pressing.clear();
        for (i, c) in self.contacts.constraints().iter().enumerate() {
            let at = self.contacts.at(i, self.state, &self.rotation);
            self.closed_at_start |= u64::from(c.stiffness_at(at.overlap).is_some()) << i;
            let pressing = Pressing::new(c, &at, self.state, self.dt, self.geometric);
            pushing |= u64::from(c.stiffness_at(pressing.overlap).is_some() && pressing.force > 0.0) << i;
            self.pressing.push(pressing);
        }
        pushing
    }

    /// The contacts with the planes they are with.
    fn pressing(&self) -> impl Iterator<Item = (usize, (&PlaneConstraint, &Pressing))> {
        self.contacts.constraints().iter().zip(&*self.pressing).enumerate()
    }

    /// The wrench at the start of the step of contacts in the set, about the centre of mass.
    pub fn wrench_at_start(&self, active: u64) -> Wrench {
        let mut wrench = Wrench::ZERO;
        for (_, (_, p)) in self.pressing().filter(|(i, _)| active & (1 << i) != 0) {
            let along = p.rubbing.as_ref().map_or(DVec3::ZERO, |rubbing| rubbing.force_at_start);
            wrench.force += along - p.direction * p.force_at_start;
            wrench.torque += p.arm.cross(along) - p.moment * p.force_at_start;
        }
        wrench
    }

    #[inline(always)]
    pub fn assemble(&self, active: u64) -> Linear {
        let h = self.dt;
        let mut linear = Linear::with_right(self.right);
        let mut lateral = self.held;
        if let Some((direction, row)) = &self.bend {
            linear.add_along(direction, row);
        }
        // Of the products arm · forceᵀ at the start.
        let mut turning = DMat3::ZERO;
        for (i, (c, p)) in self.pressing() {
            if active & (1 << i) == 0 {
                continue;
            }
            let mut along_normal = h * (h * p.stiffness + c.damping);
            let mut impulse = DVec3::ZERO;
            let mut force = c.normal * -p.force_at_start;
            if let Some(rubbing) = &p.rubbing {
                let gain = h * (h * c.stiffness + c.damping) * rubbing.share;
                lateral.add(gain, p.arm);
                // Along the normal the contact has its own gains.
                along_normal -= gain;
                let Strain { along, spin } = rubbing.trial.scaled(-h * rubbing.share);
                impulse += along;
                force += rubbing.force_at_start;
                if c.radius > 0.0 {
                    linear.add(3, 3, &outer(c.normal, c.normal * (gain * c.radius * c.radius)));
                    linear.add_right(DVec3::ZERO, c.normal * (c.radius * spin));
                }
            }
            let row = six(p.direction * along_normal, p.moment * along_normal + p.swept * h);
            linear.add_along(&six(p.direction, p.moment), &row);
            let torque = p.arm.cross(impulse) - p.moment * (h * p.force);
            linear.add_right(impulse - p.direction * (h * p.force), torque);
            turning += outer(p.arm, force);
        }
        for bend in self.contacts.bends().iter().filter(|bend| active & (1 << bend.constraint) != 0) {
            let bent = bend.at(self.state);
            let gain = h * h * bent.curvature * self.pressing[bend.constraint].force.max(0.0);
            let row = six(bent.linear * gain, bent.angular * gain);
            linear.add_along(&six(bent.linear, bent.angular), &row);
            let rate = bent.rate(&self.state.twist);
            linear.add_right(bent.linear * (-gain * rate), bent.angular * (-gain * rate));
        }
        let (mut force_by_turn, mut torque_by_turn) = (DMat3::ZERO, self.spin);
        if self.geometric {
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

    /// Whether the symmetric part of the matrix exceeds half the mass matrix.
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

    /// The contacts that are closed and pushing at the end of the step for a velocity change, and those of
    /// them that are closed. Takes over the shares of friction that follow; [`Self::alike`] tells whether these were
    /// what they have been.
    pub fn predict(&mut self, change: &Twist) -> (u64, u64) {
        let (mut pushing, mut closed) = (0, 0);
        self.alike = true;
        for (i, (c, p)) in self.contacts.constraints().iter().zip(&mut *self.pressing).enumerate() {
            let rate = p.direction.dot(change.linear) + p.moment.dot(change.angular);
            let gain = self.dt * p.stiffness + c.damping;
            let is_closed = c.stiffness_at(p.overlap + self.dt * rate).is_some();
            let force = p.force + gain * rate + p.swept.dot(change.angular);
            let pushes = is_closed && force > 0.0;
            closed |= u64::from(is_closed) << i;
            pushing |= u64::from(pushes) << i;
            if let Some(rubbing) = p.rubbing.as_mut().filter(|_| pushes) {
                let velocity = change.velocity_at(p.arm);
                let gained = c.velocity_strain(velocity, c.normal.dot(velocity), change.angular);
                let share = rubbing.share_after(&gained, c, force, self.dt);
                self.alike &= (share - rubbing.share).abs() <= SHARES_ALIKE * rubbing.share;
                rubbing.share = share;
            }
        }
        (pushing, closed)
    }

    fn solve(&mut self) -> Option<(Twist, u64, StepStatus)> {
        let mut status = StepStatus::default();
        let mut left_for_next = 0_u64;
        let mut active = self.see_contacts();
        loop {
            let mut linear = self.assemble(active);
            if self.geometric && !self.predicts(&linear.matrix) {
                self.geometric = false;
                status.geometric_stiffness_dropped = true;
                self.see_contacts();
                linear = self.assemble(active);
            }
            status.solves += 1;
            let [vx, vy, vz, wx, wy, wz] = linear.solution(self.geometric)?;
            let change = Twist { linear: DVec3::new(vx, vy, vz), angular: DVec3::new(wx, wy, wz) };
            let (pushing, closed) = self.predict(&change);
            left_for_next |= active & !closed & !self.closed_at_start;
            let wanted = pushing & !left_for_next;
            let next = if status.solves < FREE_SOLVES { wanted } else { wanted & active };
            let settled = next == active && (self.alike || status.solves >= FREE_SOLVES);
            if settled || status.solves >= MAX_SOLVES {
                status.active_set_unsettled = wanted != active;
                return Some((change, active, status));
            }
            active = next;
        }
    }
}

/// The momentum exp(h ω*) I ω that a body spinning at ω carries over the step, less I ω, and the derivative
/// of the former by ω.
#[inline(always)]
pub(crate) fn carried_momentum(inertia: &DMat3, angular: DVec3, dt: f64) -> (DVec3, DMat3) {
    let (turn, left) = exponential(angular * dt);
    let momentum = *inertia * angular;
    let gained = turn * momentum;
    let derivative = *inertia + turn * *inertia - cross_columns((momentum + gained) * dt, &left);
    (gained, derivative)
}

#[cfg(test)]
mod tests {
    use glam::DQuat;
    use palpate_core::Contact;
    use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

    use super::*;
    use crate::contact::{ContactParameters, MAX_CLUSTERS};
    use crate::differences::{derivative, largest, random_pose, random_twist, random_vector};
    use crate::friction::Friction;
    use crate::rotation::skew;

    /// An inertia like that of a solid of uneven shape, turned to arbitrary axes.
    fn random_inertia(rng: &mut StdRng, size: f64) -> DMat3 {
        let r = DMat3::from_quat(random_pose(rng, 1.0).rotation);
        let squares = DVec3::from_array(std::array::from_fn(|_| rng.random_range(0.1..1.0) * size));
        let moments = DVec3::new(squares.y + squares.z, squares.z + squares.x, squares.x + squares.y);
        r * DMat3::from_diagonal(moments) * r.transpose()
    }

    #[test]
    fn derivative_of_the_carried_momentum_equals_central_differences() {
        let seed = 51;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..300 {
            let inertia = random_inertia(&mut rng, 1e-4);
            let angular = random_vector(&mut rng, [0.1, 10.0, 300.0, 3000.0][case % 4]);
            let dt = 1e-3;
            let (gained, found) = carried_momentum(&inertia, angular, dt);
            let carried = DQuat::from_scaled_axis(angular * dt) * (inertia * angular);
            assert!((inertia * angular + gained - carried).length() < 1e-14 * carried.length() * 10.0);
            let columns = DVec3::AXES.map(|e| {
                let momentum = |s: f64| {
                    let w = angular + e * s;
                    Wrench::new(DQuat::from_scaled_axis(w * dt) * (inertia * w), DVec3::ZERO)
                };
                derivative(momentum, 1e-3 * (1.0 + angular.length())).force
            });
            let expected = DMat3::from_cols(columns[0], columns[1], columns[2]);
            let error = largest(&(found - expected)) / largest(&expected);
            assert!(error < 1e-6, "seed {seed}, case {case}: relative error {error}");
        }
    }

    #[test]
    fn carried_momentum_is_the_gyroscopic_torque_to_first_order() {
        let mut rng = StdRng::seed_from_u64(52);
        let inertia = random_inertia(&mut rng, 1e-4);
        let angular = DVec3::new(3.0, -7.0, 2.0);
        let gyroscopic = angular.cross(inertia * angular);
        let by_spin = skew(angular) * inertia - skew(inertia * angular);
        let mut previous = f64::INFINITY;
        for dt in [1e-3, 1e-4, 1e-5] {
            let (gained, derivative) = carried_momentum(&inertia, angular, dt);
            let error = (gained / dt - gyroscopic).length() / gyroscopic.length();
            assert!(error < 10.0 * dt && error < previous / 5.0);
            let error = largest(&((derivative - inertia) * (1.0 / dt) - by_spin)) / largest(&by_spin);
            assert!(error < 20.0 * dt);
            previous = error;
        }
    }

    /// The plain way to the same system: the full public Jacobians, put together entry by entry.
    #[test]
    fn system_equals_the_one_from_the_public_jacobians() {
        let seed = 53;
        let mut rng = StdRng::seed_from_u64(seed);
        let mut with_contact = 0;
        for case in 0..500 {
            let body = Body::new(rng.random_range(0.01..0.5), random_inertia(&mut rng, 1e-4)).unwrap();
            let mut coupling =
                VirtualCoupling::critically_damped(&body, random_pose(&mut rng, 0.05), 300.0, 0.5);
            // Linear, and in the bend before the limit.
            (coupling.max_force, coupling.max_torque) =
                [(f64::INFINITY, f64::INFINITY), (1.5, 0.1)][case % 2];
            let state =
                BodyState { pose: random_pose(&mut rng, 0.5), twist: random_twist(&mut rng, 0.2, 2.0) };
            let grasp = state.pose * coupling.grasp;
            let device = DeviceMotion {
                pose: grasp.moved(&random_twist(&mut rng, 0.01, 0.4), 1.0),
                twist: random_twist(&mut rng, 0.1, 1.0),
            };
            let contacts: Vec<_> = (0..4)
                .map(|_| Contact {
                    point: state.pose.translation + random_vector(&mut rng, 0.05),
                    scene_point: DVec3::ZERO,
                    normal: random_vector(&mut rng, 1.0).normalize(),
                    depth: 0.003,
                })
                .collect();
            let parameters = ContactParameters {
                stiffness: 500.0,
                damping: 0.5,
                tolerance: 0.001,
                friction: Friction::NONE,
            };
            let model = LinearContactModel::from_contacts(contacts, &state.pose, &parameters, 0.0);
            let gravity = DVec3::NEG_Z * 9.81;
            let dt = 1e-3;
            let step = semi_implicit_step(&body, &state, &device, &coupling, &model, gravity, dt);
            let now = model.evaluate(&state);
            if step.active != now.active || step.status.geometric_stiffness_dropped {
                continue;
            }
            with_contact += 1;

            let held = coupling.evaluate(&state, &device);
            let mut jacobian = held.jacobian;
            jacobian += now.jacobian;
            let rotation = DMat3::from_quat(state.pose.rotation);
            let inertia = rotation * body.inertia * rotation.transpose();
            let (gained, by_spin) = carried_momentum(&inertia, state.twist.angular, dt);
            let force = held.on_body + now.wrench + Wrench::new(gravity * body.mass, DVec3::ZERO);
            // The system's residual at the velocity that the step found, by the formula of the module doc.
            let change = Twist::new(
                step.state.twist.linear - state.twist.linear,
                step.state.twist.angular - state.twist.angular,
            );
            let total = force + jacobian.pose.apply(&step.state.twist) * dt + jacobian.twist.apply(&change);
            let linear = change.linear * body.mass - total.force * dt;
            let angular = by_spin * change.angular + gained - total.torque * dt;
            assert!(
                linear.length() < 1e-12 * (1.0 + force.force.length() * dt),
                "seed {seed}, case {case}: {linear}"
            );
            assert!(
                angular.length() < 1e-12 * (1.0 + force.torque.length() * dt),
                "seed {seed}, case {case}"
            );
        }
        assert!(with_contact > 100, "only {with_contact} cases kept their contacts");
    }

    #[test]
    #[expect(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]
    fn active_set_never_attracts_and_always_ends() {
        let seed = 54;
        let mut rng = StdRng::seed_from_u64(seed);
        let (mut most, mut unsettled, mut dropped) = (0, 0, 0);
        let cases = 20_000;
        for case in 0..cases {
            let body = Body::new(rng.random_range(0.001..0.2), random_inertia(&mut rng, 1e-5)).unwrap();
            let coupling = VirtualCoupling::critically_damped(&body, random_pose(&mut rng, 0.1), 200.0, 0.6);
            let state =
                BodyState { pose: random_pose(&mut rng, 0.5), twist: random_twist(&mut rng, 1.0, 30.0) };
            let device = DeviceMotion::at_rest(
                (state.pose * coupling.grasp).moved(&random_twist(&mut rng, 0.03, 1.0), 1.0),
            );
            let contacts: Vec<_> = (0..rng.random_range(1..=MAX_CLUSTERS))
                .map(|_| Contact {
                    point: state.pose.translation + random_vector(&mut rng, 0.1),
                    scene_point: DVec3::ZERO,
                    normal: random_vector(&mut rng, 1.0).normalize(),
                    depth: rng.random_range(-0.003..0.003),
                })
                .collect();
            let parameters = ContactParameters {
                stiffness: rng.random_range(100.0..20_000.0),
                damping: rng.random_range(0.0..30.0),
                tolerance: 0.001,
                friction: Friction::coulomb([0.0, 0.4, 2.0][case % 3]),
            };
            let model = LinearContactModel::from_contacts(contacts, &state.pose, &parameters, 0.0);
            let frame = Frame {
                body: &body,
                device: &device,
                coupling: &coupling,
                contacts: &model,
                gravity: DVec3::ZERO,
            };
            let mut pressing = ArrayVec::new();
            let mut system = System::new(&frame, &state, 1e-3, &mut pressing);
            let (change, active, status) = system.solve().expect("regular");
            let (pushing, _) = system.predict(&change);
            assert_eq!(active & !pushing, 0, "seed {seed}, case {case}: an active contact attracts");
            most = most.max(status.solves);
            unsettled += usize::from(status.active_set_unsettled);
            dropped += usize::from(status.geometric_stiffness_dropped);
        }
        println!(
            "most solves {most}, unsettled {unsettled} and geometric stiffness dropped {dropped} of {cases}"
        );
        assert!(most <= MAX_SOLVES);
        // The bound is for the record: random heaps of stiff contacts are harsher than any that a query
        // reports.
        assert!(unsettled * 50 < cases, "{unsettled} of {cases} active sets did not settle");
    }
}
