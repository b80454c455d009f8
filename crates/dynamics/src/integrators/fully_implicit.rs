//! Backward Euler by Newton iteration.

use glam::{DMat3, DVec3};
use palpate_core::Twist;

use crate::body::BodyState;
use crate::contact::LinearContactModel;
use crate::integrators::{Frame, Integrator, SemiImplicit};
use crate::jacobian::{Block6, WrenchJacobian};
use crate::linear_solve::solve;
use crate::rotation::left_jacobian;
use crate::step::{Step, carried_momentum};

/// Backward Euler on momentum and placement, solved by Newton iteration from the semi-implicit step.
///
/// Unknown is the velocity (v, ω) at the end of the step, for which
///
/// m (v − v_0) = h F,   exp(h ω*) I_0 ω − I_0 ω_0 = h T,   x = x_0 + h v,   R = exp(h ω*) R_0,
///
/// with F and T at the end of the step. The derivatives are exact: of the carried momentum as in
/// [`semi_implicit_step`](crate::semi_implicit_step), of the wrench by ω through the turn as well, ∂φ = h J_l(h ω)
/// ∂ω. Contacts are looked at anew in each iterate.
///
/// Newton steps are shortened until the simplified Newton step that follows is shorter than the last (the
/// natural monotonicity test of P. Deuflhard, *Newton Methods for Nonlinear Problems*, 2004, §3.3), which does
/// not depend on units. A damper acts at once when its contact closes, so that there may be no solution with a
/// contact or without; contacts that are open at the start and that the iteration flipped are then left to the
/// next step, as the semi-implicit step leaves them, and the iteration is run once more. If that does not
/// converge either, the step is the semi-implicit one, with
/// [`StepStatus::unconverged`](crate::StepStatus::unconverged) set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FullyImplicit {
    /// The most Newton iterations of one run, of which there are at most two.
    pub iterations: u32,
    /// What the last Newton step may change, m/s: the root mean square velocity over the body's mass.
    pub tolerance: f64,
}

impl Default for FullyImplicit {
    /// 20 iterations, 1e-9 m/s.
    fn default() -> Self {
        Self { iterations: 20, tolerance: 1e-9 }
    }
}

/// A Newton step is shortened at most to this part of it.
const SHORTEST: f64 = 1.0 / 64.0;

/// What rounding leaves of a velocity, relative to it.
const ROUNDING: f64 = 1e-12;

impl Integrator for FullyImplicit {
    fn step(&self, frame: &Frame<'_>, state: &BodyState, dt: f64) -> Step {
        let mut first = SemiImplicit.step(frame, state, dt);
        if first.status.held.is_some() {
            return first;
        }
        let mut run = Iteration::new(frame, state, frame.contacts, dt);
        let mut found = run.solve(first.state.twist, self);
        let left_out = run.flipped() & open(frame.contacts, state);
        let (fewer, kept);
        if found.is_none() && left_out != 0 {
            (fewer, kept) = without(frame.contacts, left_out);
            let solves = run.solves;
            run = Iteration::new(frame, state, &fewer, dt);
            run.solves = solves;
            found = run.solve(first.state.twist, self);
            run.pushed = renumbered(run.pushed, &kept);
        }
        first.status.solves += run.solves;
        first.status.unconverged = found.is_none();
        let Some(twist) = found else { return first };
        first.status.active_set_unsettled = false;
        first.status.geometric_stiffness_dropped = false;
        let next = BodyState { pose: state.pose.moved(&twist, dt), twist };
        frame.ended(state, &next, run.pushed, first.status)
    }
}

/// The contacts that are open at a state.
fn open(contacts: &LinearContactModel, state: &BodyState) -> u32 {
    contacts.constraints().iter().enumerate().fold(0, |open, (i, c)| {
        let depth = c.normal.dot(state.pose.transform_point(c.point) - c.scene_point);
        open | u32::from(depth + c.tolerance <= 0.0) << i
    })
}

/// The model without some of its contacts, and the places that the others had in it.
fn without(
    contacts: &LinearContactModel,
    left_out: u32,
) -> (LinearContactModel, [u8; crate::contact::MAX_CLUSTERS]) {
    let mut fewer = LinearContactModel::empty(contacts.pose(), contacts.time());
    let mut places = [0; crate::contact::MAX_CLUSTERS];
    let kept = (0_u8..).zip(contacts.constraints()).filter(|(i, _)| left_out & (1 << i) == 0);
    for (place, (i, c)) in places.iter_mut().zip(kept) {
        fewer.push(*c);
        *place = i;
    }
    (fewer, places)
}

fn renumbered(active: u32, places: &[u8]) -> u32 {
    places.iter().enumerate().fold(0, |all, (i, place)| all | (active >> i & 1) << place)
}

/// One run of Newton's iteration.
struct Iteration<'a> {
    frame: &'a Frame<'a>,
    contacts: &'a LinearContactModel,
    start: &'a BodyState,
    /// I_0.
    inertia: DMat3,
    dt: f64,
    solves: u32,
    /// The contacts that pushed in the last iterate, in any, and in all.
    pushed: u32,
    ever: u32,
    always: u32,
}

/// The derivative of the residual, and the residual.
type System = ([[f64; 6]; 6], [f64; 6]);

impl<'a> Iteration<'a> {
    fn new(frame: &'a Frame<'a>, start: &'a BodyState, contacts: &'a LinearContactModel, dt: f64) -> Self {
        let rotation = DMat3::from_quat(start.pose.rotation);
        let inertia = rotation * frame.body.inertia * rotation.transpose();
        Self { frame, contacts, start, inertia, dt, solves: 0, pushed: 0, ever: 0, always: u32::MAX }
    }

    /// The contacts that pushed in some iterates and not in others.
    fn flipped(&self) -> u32 {
        self.ever & !self.always
    }

    /// The velocity that solves the equations, from a guess.
    fn solve(&mut self, guess: Twist, settings: &FullyImplicit) -> Option<Twist> {
        let mut twist = guess;
        let mut system = self.system(&twist);
        for _ in 0..settings.iterations {
            let matrix = system.0;
            let change = self.newton_step(&matrix, &system.1)?;
            let length = self.speed(&change);
            let enough = settings.tolerance + ROUNDING * self.speed(&twist);
            if length <= enough {
                return Some(sum(&twist, &change, 1.0)).filter(Twist::is_finite);
            }
            let mut part = 1.0;
            loop {
                let trial = sum(&twist, &change, part);
                system = self.system(&trial);
                let next = self.newton_step(&matrix, &system.1)?;
                if self.speed(&next) <= (1.0 - 0.25 * part) * length {
                    twist = trial;
                    break;
                }
                part *= 0.5;
                if part < SHORTEST {
                    return None;
                }
            }
        }
        None
    }

    fn newton_step(&mut self, matrix: &[[f64; 6]; 6], residual: &[f64; 6]) -> Option<Twist> {
        self.solves += 1;
        let [vx, vy, vz, wx, wy, wz] = solve(*matrix, residual.map(|r| -r))?;
        Some(Twist { linear: DVec3::new(vx, vy, vz), angular: DVec3::new(wx, wy, wz) })
    }

    /// The root mean square velocity over the body's mass, m/s.
    fn speed(&self, twist: &Twist) -> f64 {
        let spinning = twist.angular.dot(self.inertia * twist.angular) / self.frame.body.mass;
        (twist.linear.length_squared() + spinning).sqrt()
    }

    fn system(&mut self, twist: &Twist) -> System {
        let Self { start, inertia, dt, .. } = *self;
        let Frame { body, device, coupling, gravity, .. } = *self.frame;
        let end = BodyState { pose: start.pose.moved(twist, dt), twist: *twist };
        let held = coupling.evaluate(&end, device);
        let touch = self.contacts.evaluate(&end);
        self.pushed = touch.active;
        self.ever |= touch.active;
        self.always &= touch.active;

        let wrench = held.on_body + touch.wrench;
        let (gained, momentum_by_spin) = carried_momentum(&inertia, twist.angular, dt);
        let force = wrench.force + gravity * body.mass;
        let linear = (twist.linear - start.twist.linear) * body.mass - force * dt;
        let turned = inertia * (twist.angular - start.twist.angular) + gained;
        let angular = turned - wrench.torque * dt;

        let mut jacobian = held.jacobian;
        jacobian += touch.jacobian;
        let by_twist = end_derivative(&jacobian, &left_jacobian(twist.angular * dt), dt);
        let mut matrix = by_twist.scaled(-dt);
        matrix.force_linear += DMat3::from_diagonal(DVec3::splat(body.mass));
        matrix.torque_angular += momentum_by_spin;
        (matrix.to_rows(), [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z])
    }
}

/// The derivative of the wrench at the end of a step by the velocity there.
fn end_derivative(jacobian: &WrenchJacobian, turn: &DMat3, dt: f64) -> Block6 {
    let pose = jacobian.pose;
    let moved = Block6 {
        force_linear: pose.force_linear,
        force_angular: pose.force_angular * *turn,
        torque_linear: pose.torque_linear,
        torque_angular: pose.torque_angular * *turn,
    };
    jacobian.twist + moved.scaled(dt)
}

fn sum(twist: &Twist, change: &Twist, part: f64) -> Twist {
    Twist { linear: twist.linear + change.linear * part, angular: twist.angular + change.angular * part }
}
