//! The linear systems of a tool's step, and the search for the set of contacts and stops that push.

use glam::{DMat3, DVec3};
use palpate_core::{Pose, Twist, Wrench};

use super::coordinates::{Follower, Linear7, Motion, seven};
use super::inertia::CompositeInertia;
use super::linkage::Linkage;
use super::{ArticulatedBody, ArticulatedFrame, ArticulatedState};
use crate::algebra::linear_solve::is_positive_definite;
use crate::algebra::rotation::{cross_columns, exponential};
use crate::body::BodyState;
use crate::jacobian::outer;
use crate::penalty::MAX_PENALTY_CONTACTS;
use crate::step::{FREE_SOLVES, StepStatus, System};
use crate::system::cross_sum;

/// Largest number of 7×7 systems that one step solves: the free ones, one for each contact and stop that
/// may leave, and the last.
pub const MAX_ARTICULATED_SOLVES: u32 = FREE_SOLVES + 2 * MAX_PENALTY_CONTACTS as u32 + 2 + 1;

/// One of the hinge's two stops.
#[derive(Clone, Copy)]
struct Stop {
    /// Sign of the angle beyond the stop: −1 for the low one.
    side: f64,
    /// Angle beyond the stop at the end of the step if the rate does not change, rad.
    overlap: f64,
    /// Stiffness, N·m/rad.
    stiffness: f64,
    closed_at_start: bool,
}

impl Stop {
    /// The two stops of a tool, `dt` (s) after a state.
    fn both(tool: &ArticulatedBody, state: &ArticulatedState, dt: f64) -> [Self; 2] {
        let limits = &tool.joint.limits;
        [(-1.0, limits.low), (1.0, limits.high)].map(|(side, limit)| {
            let now = side * (state.angle - limit);
            let overlap = now + dt * side * state.rate;
            Self { side, overlap, stiffness: limits.stiffness, closed_at_start: now > 0.0 }
        })
    }

    /// Torque on the hinge, N·m.
    fn torque(&self) -> f64 {
        if self.overlap > 0.0 { -self.side * self.stiffness * self.overlap } else { 0.0 }
    }
}

/// Torque of the hinge's stops on the second body, N·m.
pub(super) fn stop_torque(tool: &ArticulatedBody, state: &ArticulatedState) -> f64 {
    Stop::both(tool, state, 0.0).iter().map(Stop::torque).sum()
}

/// Set of contacts of the two bodies and of stops, one bit each.
#[derive(Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Active {
    pub bodies: [u64; 2],
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

/// Outcome of a search.
pub(super) struct ToolSolution {
    /// Change of the velocities.
    pub change: Motion,
    pub active: Active,
    /// Matrix of the active set's system.
    pub matrix: [[f64; 7]; 7],
    pub status: StepStatus,
}

/// The terms of one step's linear systems, from which the system of any active set is assembled.
pub(super) struct ToolSystem<'a> {
    systems: [System<'a>; 2],
    followers: [Follower; 2],
    stops: [Stop; 2],
    start: Motion,
    dt: f64,
    /// e.
    axis: DVec3,
    mass: f64,
    /// Inertia for (ω, q̇) at the start, that the matrix is tested against.
    inertia: (DMat3, DVec3, f64),
    /// Left: carried momentum and the gripper's spring and damper.
    matrix: [[f64; 7]; 7],
    /// Right: the same and gravity.
    right: [f64; 7],
    /// The virtual coupling's wrench on the first body.
    held: Wrench,
}

impl<'a> ToolSystem<'a> {
    pub fn new(
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

        let (mut system, now) = momenta(tool, &linkage, state, gravity, dt);
        let joint = grip.at(state, gripper);
        // A spring k and a damper b on the hinge: h (h k + b) on the left, h (T_0 − h k q̇_0) on the right.
        system.matrix[6][6] += dt * (grip.damping + dt * joint.slope);
        system.right[6] += dt * (joint.torque - dt * joint.slope * state.rate);
        Self {
            systems,
            followers,
            stops: Stop::both(tool, state, dt),
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

    /// Motion at the start of the step.
    pub fn start(&self) -> &Motion {
        &self.start
    }

    pub fn followers(&self) -> &[Follower; 2] {
        &self.followers
    }

    /// Twists of the two bodies with a motion of the tool.
    pub fn twists(&self, motion: &Motion) -> [Twist; 2] {
        let [first, second] = &self.followers;
        [first.follow(motion), second.follow(motion)]
    }

    fn geometric(&self) -> bool {
        self.systems[0].geometric
    }

    /// Linearises the contacts at the start of the step. Returns the contacts and stops that push at its end
    /// if no velocity changes.
    fn linearise(&mut self) -> Active {
        let mut stops = 0;
        for (i, stop) in self.stops.iter().enumerate() {
            stops |= u64::from(stop.overlap > 0.0) << i;
        }
        let [first, second] = &mut self.systems;
        Active { bodies: [first.linearise_contacts(), second.linearise_contacts()], stops }
    }

    /// Assembles the linear system with the contacts and stops of a set: Σ J_iᵀ A_i (J_i + h S_i) of the
    /// bodies, the geometric stiffness of their loads, and h² k of each stop.
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

    /// Adds the geometric stiffness of a body's load (f, τ), −h² ∂(Jᵀ (f, τ))/∂(φ, q) on the left and its
    /// product with −(ω_0, q̇_0) on the right.
    fn add_geometric(&self, system: &mut Linear7, follower: &Follower, load: &Wrench) {
        let Wrench { force, torque } = *load;
        let Follower { centre, sweep, axis, .. } = *follower;
        let gain = self.dt * self.dt;
        // Derivatives of the torque c × f by φ and q, and of the hinge's torque s · f + e · τ.
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

    /// Whether the linear system is a prediction: the symmetric part of its matrix exceeds half the mass
    /// matrix.
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

    /// Predicts from a change of the velocities which contacts and stops push at the end of the step, and
    /// which are closed.
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

    /// Searches the active set as for one body; `None` if a system is singular.
    pub fn solve(&mut self) -> Option<ToolSolution> {
        let mut status = StepStatus::default();
        let mut left_for_next = Active::default();
        let mut active = self.linearise();
        loop {
            let mut system = self.assemble(active);
            if self.geometric() && !self.predicts(&system.matrix) {
                self.systems.iter_mut().for_each(|system| system.geometric = false);
                status.geometric_stiffness_dropped = true;
                self.linearise();
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
                return Some(ToolSolution { change, active, matrix: system.matrix, status });
            }
            active = next;
        }
    }

    /// The tool at the end of the step.
    pub fn moved(
        &self,
        tool: &ArticulatedBody,
        state: &ArticulatedState,
        change: &Motion,
    ) -> ArticulatedState {
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

/// Momentum and gravity over the step as a linear system in the changes of (V, ω, q̇), and the inertia at the
/// start.
///
/// With L(q) and p(q) the momenta at the angle q, the matrix is the derivative of (M V, exp(h ω*) L_n, p_n −
/// h T_q), and the right-hand side is h M g minus their change for an unchanged velocity.
fn momenta(
    tool: &ArticulatedBody,
    linkage: &Linkage,
    state: &ArticulatedState,
    gravity: DVec3,
    dt: f64,
) -> (Linear7, CompositeInertia) {
    let rotation = state.first.pose.rotation;
    let (angular, rate) = (state.first.twist.angular, state.rate);
    let turn = DMat3::from_quat(rotation);
    let own = turn * tool.first.inertia * turn.transpose();
    let at = |angle: f64| tool.inertia(&own, &tool.linkage(rotation, angle));
    let now = tool.inertia(&own, linkage);
    let half_way = at(state.angle + 0.5 * dt * state.rate);
    let end = at(state.angle + dt * state.rate);
    let mut system = Linear7 { matrix: [[0.0; 7]; 7], right: [0.0; 7] };
    for (i, row) in system.matrix.iter_mut().enumerate().take(3) {
        row[i] = tool.mass();
    }
    // exp(h ω*) L_n, with L_n at the angle of the end.
    let (carried, left) = exponential(angular * dt);
    let momentum = end.momentum(angular, rate);
    let carried_on = carried * momentum;
    let by_spin = end.whole + carried * end.whole - cross_columns((momentum + carried_on) * dt, &left);
    let by_rate = end.shared + end.momentum_slope(angular, rate) * dt;
    let gained = carried_on + (momentum - now.momentum(angular, rate));
    // p_n − h T_q.
    let hinge_gained = end.hinge_momentum(angular, rate)
        - now.hinge_momentum(angular, rate)
        - dt * half_way.energy_slope(angular, rate);
    let hinge_by_spin = end.shared - half_way.momentum_slope(angular, rate) * dt;
    let hinge_by_rate = end.hinge + dt * (end.shared_slope(angular) - half_way.shared_slope(angular));
    system.add_turning(&by_spin, by_rate + carried * by_rate, hinge_by_spin, hinge_by_rate);
    let weight = gravity * (tool.mass() * dt);
    system.right = seven(weight, -gained, -hinge_gained);
    (system, now)
}
