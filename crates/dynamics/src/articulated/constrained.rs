//! One haptic frame of a tool with constraints of both bodies, as [`constrained_step`] takes it for
//! one body: with impulses p_i of the contacts of body i, in the coordinates u = (V, ω, q̇),
//!
//! A Δu = b − Σ J_iᵀ N_iᵀ p_i,
//!
//! where N_i takes a body's twist to the velocities of its contacts.
//!
//! [`constrained_step`]: crate::constrained_step

use arrayvec::ArrayVec;
use glam::DVec3;
use palpate_core::Twist;

use super::coordinates::{Follower, Motion};
use super::step::with_system;
use super::tool_system::ToolSolution;
use super::{ArticulatedFrame, ArticulatedState, ArticulatedStep};
use crate::algebra::vector::Vector;
use crate::constraint::tool::{
    Moved, Pushed, Rows, SHALLOW, Solver, allowed, changed, choose, mobility_factor, next_recovery, push_row,
    scaled, share, wrench,
};
use crate::constraint::{Constraint, MAX_CONSTRAINTS, MotionBound, PushedBody, Recovery};
use crate::step::StepFailure;
use crate::system::six;

/// Largest number of contacts of one body whose impulses a step finds.
const MOST: usize = MAX_CONSTRAINTS / 2;

/// Outcome of a step of a tool with constraints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConstrainedToolStep {
    /// The step; its contact wrenches are those of the constraints and of the penalty contacts.
    pub step: ArticulatedStep,
    /// Whether the step was shortened, by a bound on motion or for contacts that were not solved for.
    pub held_back: bool,
    /// Largest velocity with which overlaps were undone, m/s: the next step goes on from it.
    pub recovery: f64,
}

impl From<ArticulatedStep> for ConstrainedToolStep {
    /// A step without contacts, or one that was refused.
    fn from(step: ArticulatedStep) -> Self {
        Self { step, held_back: false, recovery: 0.0 }
    }
}

/// The tool, and the bodies that it pushes.
struct Linked<'a> {
    free: [Twist; 2],
    /// K.
    factor: [Vector<7>; 7],
    followers: &'a [Follower; 2],
    /// Centres of mass, m.
    centers: [DVec3; 2],
    /// Number of the contacts of the first body, which come first.
    of_first: usize,
    pushed: Pushed<'a>,
}

impl Linked<'_> {
    fn body(&self, index: usize) -> usize {
        usize::from(index >= self.of_first)
    }
}

impl<const N: usize> Moved<N> for Linked<'_> {
    fn row(&self, index: usize, contact: &Constraint, axis: DVec3) -> Vector<N> {
        let body = self.body(index);
        let mut row = [0.0; N];
        let (own, others) = row.split_at_mut(7);
        own.copy_from_slice(&scaled(&self.factor, &self.followers[body].felt(axis, contact.arm.cross(axis))));
        push_row(others, &self.pushed, contact, (self.centers[body], axis));
        row
    }

    fn free(&self, index: usize) -> &Twist {
        &self.free[self.body(index)]
    }
}

/// Advances a tool by `dt` (s) as [`articulated_step`](super::articulated_step) does, without passing the
/// surfaces of `contacts` that are constraints of the first body and of the second, and no further than their
/// `bounds`. Updates the contacts' impulses. The contacts' arms are from their body's centre of mass.
/// `recovery` is as in [`constrained_step`](crate::constrained_step).
///
/// Refuses the same inputs, and keeps the same rules: nothing is allocated and nothing panics.
pub fn constrained_articulated_step(
    frame: &ArticulatedFrame<'_>,
    state: &ArticulatedState,
    contacts: [&mut [Constraint]; 2],
    pushed: &[PushedBody],
    bounds: &[MotionBound; 2],
    recovery: &Recovery,
    dt: f64,
) -> ConstrainedToolStep {
    if let Some(refused) = frame.refused(state, dt) {
        return refused.into();
    }
    let [first, second] = contacts;
    with_system(frame, state, dt, |system, bodies| {
        let singular = || ArticulatedStep::failed(state, StepFailure::Singular).into();
        let Some(ToolSolution { change, active, matrix, mut status }) = system.solve() else {
            return singular();
        };
        let start = *system.start();
        let mut motion = start.plus(&change, 1.0);
        let mut held_back = false;
        let shallow = SHALLOW * recovery.scale;
        let recovery = next_recovery(recovery, first.iter().chain(&*second), frame.coupling, dt);
        if !(first.is_empty() && second.is_empty()) {
            let Some(factor) = mobility_factor(matrix) else { return singular() };
            let free = system.twists(&motion);
            let times = (dt, recovery);
            let passed = [choose(first, MOST, &free[0], times), choose(second, MOST, &free[1], times)];
            let (of_first, of_second) = (first.len().min(MOST), second.len().min(MOST));
            let mut solved = ArrayVec::<Constraint, MAX_CONSTRAINTS>::new();
            solved.extend(first[..of_first].iter().chain(&second[..of_second]).copied());
            let moved = Linked {
                free,
                factor,
                followers: system.followers(),
                centers: bodies.map(|body| body.pose.translation),
                of_first,
                pushed: Pushed::new(pushed, &solved),
            };
            let solve = match moved.pushed.len() {
                0 => find::<7>,
                1 => find::<13>,
                _ => find::<25>,
            };
            let (taken, converged) = solve(&mut solved, &moved, (dt, recovery, shallow));
            status.unconverged = !converged;
            for (contact, solved) in first[..of_first].iter_mut().chain(&mut second[..of_second]).zip(&solved)
            {
                contact.impulse = solved.impulse;
            }
            motion = motion.plus(&taken, -1.0);
            let held = system.twists(&motion);
            let left =
                share(first, MOST, &held[0], passed[0], dt).min(share(second, MOST, &held[1], passed[1], dt));
            held_back = left < 1.0;
            motion = Motion::default().plus(&motion, left);
        }
        let tool = frame.tool;
        let next = system.moved(tool, state, &motion.plus(&start, -1.0));
        let ends = [next.first.pose, tool.second(&next).pose];
        let twists = system.twists(&motion);
        let within = (0..2).map(|i| allowed(&bounds[i], (&bodies[i].pose, &ends[i]), &twists[i], dt));
        let within = within.fold(1.0, f64::min);
        let next = if within < 1.0 {
            held_back = true;
            system.moved(tool, state, &Motion::default().plus(&motion, within).plus(&start, -1.0))
        } else {
            next
        };
        let mut step = frame.ended(state, &next, active.bodies, status);
        for (sum, contacts) in step.contacts.iter_mut().zip([&*first, &*second]) {
            *sum += wrench(contacts, dt);
        }
        if step.status.failure.is_some() || !step.contacts.iter().all(|wrench| wrench.is_finite()) {
            // Impulses that are not finite would make the next step fail too.
            first.iter_mut().chain(&mut *second).for_each(|contact| contact.impulse = DVec3::ZERO);
            return ArticulatedStep::failed(state, StepFailure::Overflow).into();
        }
        ConstrainedToolStep { step, held_back, recovery }
    })
}

/// Finds the impulses of contacts in a step of `dt` (s) with a largest recovery velocity (m/s), and the depth
/// of shallow overlaps (m). Returns what they take off the tool's motion, and whether they converged.
fn find<const N: usize>(
    contacts: &mut [Constraint],
    moved: &Linked<'_>,
    times: (f64, f64, f64),
) -> (Motion, bool) {
    let mut rows = Rows::<N>::default();
    let (felt, converged) = Solver::new(contacts, moved, times, &mut rows).solve();
    rows.store(contacts);
    (Motion::from_array(changed(&moved.factor, &felt)), converged)
}

impl Follower {
    /// Jᵀ of a force and a torque on the body about its centre of mass.
    fn felt(&self, force: DVec3, torque: DVec3) -> [f64; 7] {
        let load = six(force, torque);
        std::array::from_fn(|k| self.columns.iter().zip(load).map(|(row, load)| row[k] * load).sum())
    }
}
