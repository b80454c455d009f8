//! One haptic frame of a tool of two bodies with a hinge: semi-implicit backward Euler in seven unknowns (§5.2.2, §6.2.3).
//!
//! As in the step of [one body](crate::semi_implicit_step), momenta and placements are taken at the end of the step: with M the tool's
//! mass, L and p the momenta of [the two bodies](super) about their centre of mass and the hinge's,
//!
//! M (V_n − V_0) = h F_n,  L_n − L_0 = h T_n,  p_n − p_0 = h (Q_n + T_q),  R_n = exp(h ω_n*) R_0,  q_n = q_0 + h q̇_n,
//!
//! and the centre of mass goes on by h V_n. Linearised in (V, ω, q̇), a 7×7 system is solved. L_n is carried along as that of one body
//! is, with the inertia at the angle q_0 + h q̇: so the linear momentum of a free tool is kept exactly, the angular momentum to second
//! order.
//!
//! T_q is by what the kinetic energy grows with the angle: the centrifugal torque. It is taken in the middle of the step, at
//! q_0 + h q̇_0/2, where it is close to the difference quotient ½ uᵀ (M_n − M_0) u/(h q̇) of the inertia M(q) for u = (ω, q̇) at the end.
//! With that one a free tool would gain no energy E:
//!
//! 2 E_n = uᵀ M_0 u_0 + h q̇ T_q ≤ ½ uᵀ M_0 u + E_0 + ½ uᵀ (M_n − M_0) u = E_n + E_0,
//!
//! by the inequality of Cauchy and Schwarz. What is left is the error of the linearisation and of the middle (the test in
//! `tests/articulated.rs` allows 1e-6 of it a step, at up to 50 rad/s).
//!
//! # Forces
//!
//! Contacts, and the virtual coupling on the first body, make the same 6×6 systems that they make of one body: A_i for the change of its
//! twist, and a right-hand side. With J_i the 6×7 matrix that takes (V, ω, q̇) to the body's twist, and S_i by what J_i u_0 changes with
//! the placement (the centres of mass move on arcs), the change of the body's twist over the step is (J_i + h S_i) Δu + h S_i u_0, and
//! the tool gets J_iᵀ A_i (J_i + h S_i). The turning of J_i itself under the forces at the start is geometric stiffness. It goes, with S_i,
//! where the matrix is no prediction with it, as the geometric stiffness of one body does.
//!
//! A body's displacement over the step is h times its twist at the end: where a centre of mass moves on an arc, this differs from that
//! by h (V, ω, q̇) in second order.
//!
//! The hinge's stops are springs of one coordinate, in the system if they are closed at the end of the step. The set of all
//! is found as that of one body is: after [`FREE_SOLVES`] solves they only leave it.

use arrayvec::ArrayVec;
use glam::{DMat3, DVec3};
use palpate_core::{Pose, Twist, Wrench};

use super::{ArticulatedBody, ArticulatedState, GripperCoupling, GripperMotion, Linkage};
use crate::body::{Body, BodyState};
use crate::contact::{LinearContactModel, MAX_CONSTRAINTS};
use crate::coupling::{DeviceMotion, VirtualCoupling};
use crate::jacobian::outer;
use crate::linear_solve::{is_positive_definite, solve, solve_definite};
use crate::rotation::{cross_columns, exponential, skew, skew_skew};
use crate::step::{FREE_SOLVES, Frame, StepFailure, StepStatus, System};
use crate::system::{Linear, cross_sum, six};

/// The most 7×7 systems that one step solves: the free ones, and one for each contact and stop that may leave, and the last.
pub const MAX_ARTICULATED_SOLVES: u32 = FREE_SOLVES + 2 * MAX_CONSTRAINTS as u32 + 2 + 1;

/// What acts on a tool during a step.
#[derive(Clone, Copy, Debug)]
pub struct ArticulatedFrame<'a> {
    /// The tool.
    pub tool: &'a ArticulatedBody,
    /// The device, taken to stand here with this velocity for the whole step.
    pub device: &'a DeviceMotion,
    /// What joins it to the first body; the grasp is in that body's axes, from its centre of mass.
    pub coupling: &'a VirtualCoupling,
    /// The gripper, taken to stand here with this rate for the whole step.
    pub gripper: &'a GripperMotion,
    /// What joins it to the hinge.
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
    /// The same **on the first body**, about its centre of mass.
    pub coupling_on_body: Wrench,
    /// The torque **on the gripper** about the hinge's axis, at the new state, N·m: positive where it opens to larger angles.
    pub gripper: f64,
    /// The torque of the hinge's stops on the second body about the hinge's axis, at the new state, N·m.
    pub stop: f64,
    /// The contacts' wrench on each body, about its own centre of mass, at the new state.
    pub contacts: [Wrench; 2],
    /// Bit i of each is set if contact i of that body pushed during the step.
    pub active: [u64; 2],
    /// How the step went; its solves are of 7×7 systems, at most [`MAX_ARTICULATED_SOLVES`].
    pub status: StepStatus,
}

/// Advances a tool by `dt` (s) under what a frame holds, and evaluates at the new state what device and gripper are to feel.
///
/// Nothing is allocated; nothing panics. What cannot be used or computed is refused as by
/// [`semi_implicit_step`](crate::semi_implicit_step): the state is held and wrenches and torques are zero. A state that is itself
/// not finite is put, at rest, where the coupling is relaxed, with the hinge at the gripper's angle as far as its limits allow.
pub fn articulated_step(frame: &ArticulatedFrame<'_>, state: &ArticulatedState, dt: f64) -> ArticulatedStep {
    if let Some(refused) = frame.refused(state, dt) {
        return refused;
    }
    let ArticulatedFrame { tool, device, coupling, contacts, .. } = *frame;
    let bodies = [state.first, tool.second(state)];
    // Their inertia is in the tool's equations, so that of these systems only what acts on the bodies is left.
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
    let Some((change, active, status)) = system.solve() else {
        return ArticulatedStep::failed(state, StepFailure::Singular);
    };
    let next = system.moved(tool, state, &change);
    frame.ended(state, &next, active.bodies, status)
}

impl ArticulatedFrame<'_> {
    /// The step that is not taken for its inputs, or `None` if they will do.
    fn refused(&self, state: &ArticulatedState, dt: f64) -> Option<ArticulatedStep> {
        if !state.is_valid() {
            let relaxed = self.coupling.relaxed_pose(&self.device.pose);
            let pose = if relaxed.is_valid() { relaxed } else { Pose::IDENTITY };
            let limits = &self.tool.joint.limits;
            let asked = if self.gripper.angle.is_finite() { self.gripper.angle } else { 0.0 };
            let angle = asked.max(limits.low).min(limits.high);
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

    /// The step from `start` to `next` with what acts there, or one that is held if that is not finite.
    fn ended(
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
        let stop = Stop::of(self.tool, next, 0.0).iter().map(Stop::torque).sum::<f64>();
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
    fn failed(state: &ArticulatedState, why: StepFailure) -> Self {
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

/// One of the hinge's two stops.
#[derive(Clone, Copy)]
struct Stop {
    /// Of the angle when it goes beyond: −1 for the low one.
    side: f64,
    /// How far beyond it is at the end of the step if the rate does not change, rad.
    overlap: f64,
    /// N·m/rad.
    stiffness: f64,
    closed_at_start: bool,
}

impl Stop {
    /// The two of a tool, `dt` (s) after a state.
    fn of(tool: &ArticulatedBody, state: &ArticulatedState, dt: f64) -> [Self; 2] {
        let limits = &tool.joint.limits;
        [(-1.0, limits.low), (1.0, limits.high)].map(|(side, limit)| {
            let now = side * (state.angle - limit);
            let overlap = now + dt * side * state.rate;
            Self { side, overlap, stiffness: limits.stiffness, closed_at_start: now > 0.0 }
        })
    }

    /// On the hinge, N·m.
    fn torque(&self) -> f64 {
        if self.overlap > 0.0 { -self.side * self.stiffness * self.overlap } else { 0.0 }
    }
}

/// What pushes, one bit each: contacts of the two bodies, and stops.
#[derive(Clone, Copy, Default, PartialEq, Eq)]
struct Active {
    bodies: [u64; 2],
    stops: u64,
}

impl Active {
    fn map(self, other: Self, f: impl Fn(u64, u64) -> u64) -> Self {
        Self {
            bodies: [f(self.bodies[0], other.bodies[0]), f(self.bodies[1], other.bodies[1])],
            stops: f(self.stops, other.stops),
        }
    }
}

/// By V, ω and q̇.
type Columns = [[f64; 7]; 6];

/// A tool's velocities or their changes.
#[derive(Clone, Copy)]
struct Motion {
    linear: DVec3,
    angular: DVec3,
    rate: f64,
}

impl Motion {
    fn from_array([vx, vy, vz, wx, wy, wz, rate]: [f64; 7]) -> Self {
        Self { linear: DVec3::new(vx, vy, vz), angular: DVec3::new(wx, wy, wz), rate }
    }
}

/// How one body of the tool follows its coordinates.
#[derive(Clone, Copy)]
struct Follower {
    /// c.
    centre: DVec3,
    /// What the rate of the hinge moves its centre of mass by: a share of e × b.
    sweep: DVec3,
    /// e for the second body, none for the first.
    axis: DVec3,
    /// J.
    columns: Columns,
    /// By what J u_0 changes with the placement, (ω, q̇): of its linear part by turning, and by the angle; of its angular part by
    /// turning.
    bent: (DMat3, DVec3, DMat3),
}

impl Follower {
    fn new(linkage: &Linkage, [centre, sweep, axis]: [DVec3; 3], start: &Motion) -> Self {
        let (angular, rate) = (start.angular, start.rate);
        let mut columns = [[0.0; 7]; 6];
        for (i, unit) in DVec3::AXES.into_iter().enumerate() {
            let by_turn = unit.cross(centre);
            for (j, row) in columns.iter_mut().enumerate().take(3) {
                row[i] = f64::from(i == j);
                row[3 + i] = by_turn[j];
            }
            columns[3 + i][3 + i] = 1.0;
            columns[i][6] = sweep[i];
            columns[3 + i][6] = axis[i];
        }
        // ω × (φ × c) + q̇ φ × s, and q̇ φ × e.
        let by_turn = skew_skew(angular, centre) * -1.0 - skew(sweep) * rate;
        let by_angle = angular.cross(sweep) + linkage.axis.cross(sweep) * rate;
        let spin_by_turn = skew(axis) * -rate;
        Self { centre, sweep, axis, columns, bent: (by_turn, by_angle, spin_by_turn) }
    }

    /// h S u.
    fn arc(&self, motion: &Motion, dt: f64) -> Twist {
        let (by_turn, by_angle, spin_by_turn) = &self.bent;
        Twist {
            linear: (*by_turn * motion.angular + *by_angle * motion.rate) * dt,
            angular: *spin_by_turn * motion.angular * dt,
        }
    }

    /// J + h S.
    fn columns_at_end(&self, dt: f64) -> Columns {
        let (by_turn, by_angle, spin_by_turn) = &self.bent;
        let mut columns = self.columns;
        for i in 0..3 {
            for j in 0..3 {
                columns[i][3 + j] += dt * by_turn.col(j)[i];
                columns[3 + i][3 + j] += dt * spin_by_turn.col(j)[i];
            }
            columns[i][6] += dt * by_angle[i];
        }
        columns
    }

    /// J u.
    fn follow(&self, motion: &Motion) -> Twist {
        Twist {
            linear: motion.linear + motion.angular.cross(self.centre) + self.sweep * motion.rate,
            angular: motion.angular + self.axis * motion.rate,
        }
    }
}

/// Everything that one step's linear systems are made of.
struct ToolSystem<'a> {
    systems: [System<'a>; 2],
    followers: [Follower; 2],
    stops: [Stop; 2],
    start: Motion,
    dt: f64,
    /// e.
    axis: DVec3,
    mass: f64,
    /// At the start, for (ω, q̇): to hold the matrix against.
    inertia: (DMat3, DVec3, f64),
    /// Carried momentum and the gripper's spring and damper.
    matrix: [[f64; 7]; 7],
    /// The same with gravity on the right.
    right: [f64; 7],
    /// The virtual coupling's wrench on the first body.
    held: Wrench,
}

impl<'a> ToolSystem<'a> {
    fn new(
        frame: &ArticulatedFrame<'a>,
        state: &ArticulatedState,
        bodies: &[BodyState; 2],
        systems: [System<'a>; 2],
        dt: f64,
    ) -> Self {
        let ArticulatedFrame { tool, device, coupling, gripper, grip, gravity, .. } = *frame;
        let rotation = state.first.pose.rotation;
        let linkage = tool.linkage(rotation, state.angle);
        let shares = tool.shares();
        let angular = state.first.twist.angular;
        let linear = (bodies[0].twist.linear * tool.first.mass + bodies[1].twist.linear * tool.second.mass)
            / tool.mass();
        let start = Motion { linear, angular, rate: state.rate };
        let [first, second] = linkage.centres;
        let followers = [
            Follower::new(&linkage, [first, linkage.sweep * shares[0], DVec3::ZERO], &start),
            Follower::new(&linkage, [second, linkage.sweep * shares[1], linkage.axis], &start),
        ];

        let turn = DMat3::from_quat(rotation);
        let own = turn * tool.first.inertia * turn.transpose();
        let at = |angle: f64| tool.inertia(&own, &tool.linkage(rotation, angle));
        let now = tool.inertia(&own, &linkage);
        let half_way = at(state.angle + 0.5 * dt * state.rate);
        let end = at(state.angle + dt * state.rate);
        let rate = state.rate;
        let mut system = Linear7 { matrix: [[0.0; 7]; 7], right: [0.0; 7] };
        for (i, row) in system.matrix.iter_mut().enumerate().take(3) {
            row[i] = tool.mass();
        }
        // L_n: that of the angle at the end, turned on.
        let (carried, left) = exponential(angular * dt);
        let momentum = end.momentum(angular, rate);
        let carried_on = carried * momentum;
        let by_spin = end.whole + carried * end.whole - cross_columns((momentum + carried_on) * dt, &left);
        let by_rate = end.shared + end.momentum_slope(angular, rate) * dt;
        let gained = carried_on + (momentum - now.momentum(angular, rate));
        // p_n less h T_q.
        let hinge_gained = end.hinge_momentum(angular, rate)
            - now.hinge_momentum(angular, rate)
            - dt * half_way.energy_slope(angular, rate);
        let hinge_by_spin = end.shared - half_way.momentum_slope(angular, rate) * dt;
        let hinge_by_rate = end.hinge + dt * (end.shared_slope(angular) - half_way.shared_slope(angular));
        system.add_turning(&by_spin, by_rate + carried * by_rate, hinge_by_spin, hinge_by_rate);
        let weight = gravity * (tool.mass() * dt);
        system.right = seven(weight, -gained, -hinge_gained);

        let joint = grip.at(state, gripper);
        system.matrix[6][6] += dt * (grip.damping + dt * joint.slope);
        system.right[6] += dt * (joint.torque - dt * joint.slope * rate);
        Self {
            systems,
            followers,
            stops: Stop::of(tool, state, dt),
            start,
            dt,
            axis: linkage.axis,
            mass: tool.mass(),
            inertia: (now.whole, now.shared, now.hinge),
            matrix: system.matrix,
            right: system.right,
            held: coupling.wrenches(&state.first, device).0,
        }
    }

    fn geometric(&self) -> bool {
        self.systems[0].geometric
    }

    /// What pushes at the end of the step if no velocity changes.
    fn see(&mut self) -> Active {
        let mut stops = 0;
        for (i, stop) in self.stops.iter().enumerate() {
            stops |= u64::from(stop.overlap > 0.0) << i;
        }
        let [first, second] = &mut self.systems;
        Active { bodies: [first.linearise_contacts(), second.linearise_contacts()], stops }
    }

    fn assemble(&self, active: Active) -> Linear7 {
        let dt = self.dt;
        let mut system = Linear7 { matrix: self.matrix, right: self.right };
        let geometric = self.geometric();
        let loads = [self.held, Wrench::ZERO];
        for (i, follower) in self.followers.iter().enumerate() {
            let body = self.systems[i].assemble(active.bodies[i]);
            if geometric {
                let arc = follower.arc(&self.start, dt);
                system.add_follower(&body, &follower.columns, &follower.columns_at_end(dt), &arc);
                let load = loads[i] + self.systems[i].wrench_at_start(active.bodies[i]);
                self.add_geometric(&mut system, follower, &load);
            } else {
                system.add_follower(&body, &follower.columns, &follower.columns, &Twist::ZERO);
            }
        }
        for (i, stop) in self.stops.iter().enumerate() {
            if active.stops & (1 << i) != 0 {
                system.matrix[6][6] += dt * dt * stop.stiffness;
                system.right[6] -= dt * stop.side * stop.stiffness * stop.overlap;
            }
        }
        system
    }

    /// Adds how the tool's share of a body's load turns with it.
    fn add_geometric(&self, system: &mut Linear7, follower: &Follower, load: &Wrench) {
        let Wrench { force, torque } = *load;
        let Follower { centre, sweep, axis, .. } = *follower;
        let gain = self.dt * self.dt;
        // Of c × f by turning and by the angle, and of (e × b) · f + e · τ.
        let turning = cross_sum(&outer(centre, force)) * gain;
        let by_angle = sweep.cross(force) * gain;
        let hinge_by_turn = (sweep.cross(force) + axis.cross(torque)) * gain;
        let hinge_by_angle = self.axis.cross(sweep).dot(force) * gain;
        let Motion { angular, rate, .. } = self.start;
        system.add_turning(&(turning * -1.0), -by_angle, -hinge_by_turn, -hinge_by_angle);
        let right = turning * angular + by_angle * rate;
        for (entry, value) in system.right[3..].iter_mut().zip(right.to_array()) {
            *entry += value;
        }
        system.right[6] += hinge_by_turn.dot(angular) + hinge_by_angle * rate;
    }

    /// Whether the symmetric part of the matrix exceeds half the mass matrix.
    fn predicts(&self, matrix: &[[f64; 7]; 7]) -> bool {
        let symmetric = std::array::from_fn(|i| std::array::from_fn(|j| matrix[i][j] + matrix[j][i]));
        let mut difference = Linear7 { matrix: symmetric, right: [0.0; 7] };
        for (i, row) in difference.matrix.iter_mut().enumerate().take(3) {
            row[i] -= self.mass;
        }
        let (whole, shared, hinge) = &self.inertia;
        difference.add_turning(&(*whole * -1.0), -*shared, -*shared, -hinge);
        is_positive_definite(difference.matrix)
    }

    /// What pushes at the end of the step for a change of the velocities, and what of it is closed.
    fn predict(&mut self, change: &Motion) -> (Active, Active) {
        let (mut pushing, mut closed) = (Active::default(), Active::default());
        let total = Motion {
            linear: DVec3::ZERO,
            angular: self.start.angular + change.angular,
            rate: self.start.rate + change.rate,
        };
        let geometric = self.geometric();
        for (i, (system, follower)) in self.systems.iter_mut().zip(&self.followers).enumerate() {
            let mut twist = follower.follow(change);
            if geometric {
                let arc = follower.arc(&total, self.dt);
                twist.linear += arc.linear;
                twist.angular += arc.angular;
            }
            (pushing.bodies[i], closed.bodies[i]) = system.predict(&twist);
        }
        for (i, stop) in self.stops.iter().enumerate() {
            closed.stops |= u64::from(stop.overlap + self.dt * stop.side * change.rate > 0.0) << i;
        }
        pushing.stops = closed.stops;
        (pushing, closed)
    }

    fn closed_at_start(&self) -> Active {
        let mut stops = 0;
        for (i, stop) in self.stops.iter().enumerate() {
            stops |= u64::from(stop.closed_at_start) << i;
        }
        let [first, second] = &self.systems;
        Active { bodies: [first.closed_at_start, second.closed_at_start], stops }
    }

    /// As for one body: see there.
    fn solve(&mut self) -> Option<(Motion, Active, StepStatus)> {
        let mut status = StepStatus::default();
        let mut left_for_next = Active::default();
        let mut active = self.see();
        loop {
            let mut system = self.assemble(active);
            if self.geometric() && !self.predicts(&system.matrix) {
                self.systems.iter_mut().for_each(|system| system.geometric = false);
                status.geometric_stiffness_dropped = true;
                self.see();
                system = self.assemble(active);
            }
            status.solves += 1;
            let change = Motion::from_array(system.solution(self.geometric())?);
            let (pushing, closed) = self.predict(&change);
            let opened = active.map(closed, |active, closed| active & !closed);
            let opened = opened.map(self.closed_at_start(), |opened, closed| opened & !closed);
            left_for_next = left_for_next.map(opened, |left, opened| left | opened);
            let wanted = pushing.map(left_for_next, |pushing, left| pushing & !left);
            let free = status.solves < FREE_SOLVES;
            let next = if free { wanted } else { wanted.map(active, |wanted, active| wanted & active) };
            let converged = self.systems.iter().all(|system| system.shares_converged);
            let settled = next == active && (converged || !free);
            if settled || status.solves >= MAX_ARTICULATED_SOLVES {
                status.active_set_unsettled = wanted != active;
                return Some((change, active, status));
            }
            active = next;
        }
    }

    /// The tool at the end of the step.
    fn moved(&self, tool: &ArticulatedBody, state: &ArticulatedState, change: &Motion) -> ArticulatedState {
        let dt = self.dt;
        let linear = self.start.linear + change.linear;
        let angular = self.start.angular + change.angular;
        let rate = self.start.rate + change.rate;
        let angle = state.angle + dt * rate;
        let start = &state.first.pose;
        let centre = start.translation - self.followers[0].centre + linear * dt;
        let rotation = start.moved(&Twist::new(DVec3::ZERO, angular), dt).rotation;
        let linkage = tool.linkage(rotation, angle);
        let arm = linkage.centres[0];
        let twist = Twist {
            linear: linear + angular.cross(arm) + linkage.sweep * (tool.shares()[0] * rate),
            angular,
        };
        let first = BodyState { pose: Pose::new(centre + arm, rotation), twist };
        ArticulatedState { first, angle, rate }
    }
}

/// The matrix and right-hand side of a linear system in (V, ω, q̇).
struct Linear7 {
    matrix: [[f64; 7]; 7],
    right: [f64; 7],
}

impl Linear7 {
    /// Adds to the rows and columns of ω and q̇.
    fn add_turning(&mut self, turning: &DMat3, by_rate: DVec3, hinge_by_turn: DVec3, hinge: f64) {
        for i in 0..3 {
            for j in 0..3 {
                self.matrix[3 + i][3 + j] += turning.col(j)[i];
            }
            self.matrix[3 + i][6] += by_rate[i];
            self.matrix[6][3 + i] += hinge_by_turn[i];
        }
        self.matrix[6][6] += hinge;
    }

    /// Adds Jᵀ A J′ of a body's system, and Jᵀ (r − A · arc) on the right.
    fn add_follower(&mut self, body: &Linear, columns: &Columns, at_end: &Columns, arc: &Twist) {
        let arc = six(arc.linear, arc.angular);
        let mut product = [[0.0; 7]; 6];
        let mut load = body.right;
        for (i, row) in body.matrix.iter().enumerate() {
            for (value, along) in row.iter().zip(at_end) {
                for (entry, column) in product[i].iter_mut().zip(along) {
                    *entry += value * column;
                }
            }
            load[i] -= row.iter().zip(arc).map(|(value, along)| value * along).sum::<f64>();
        }
        for (column, (row, load)) in columns.iter().zip(product.iter().zip(load)) {
            for (i, share) in column.iter().enumerate() {
                for (entry, value) in self.matrix[i].iter_mut().zip(row) {
                    *entry += share * value;
                }
                self.right[i] += share * load;
            }
        }
    }

    fn solution(&self, definite: bool) -> Option<[f64; 7]> {
        let quick = if definite { solve_definite(self.matrix, self.right) } else { None };
        quick.or_else(|| solve(self.matrix, self.right))
    }
}

fn seven(linear: DVec3, angular: DVec3, hinge: f64) -> [f64; 7] {
    let [a, b, c, d, e, f] = six(linear, angular);
    [a, b, c, d, e, f, hinge]
}
