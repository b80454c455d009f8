//! Backward Euler by Newton iteration.

use glam::{DMat3, DVec3};
use palpate_core::Twist;

use crate::algebra::linear_solve::solve;
use crate::algebra::rotation::exponential;
use crate::body::BodyState;
use crate::integrators::{Integrator, SemiImplicit};
use crate::jacobian::{Block6, WrenchJacobian};
use crate::penalty::LinearContactModel;
use crate::step::{Frame, Step, carried_momentum};

/// Backward Euler on momentum and placement, solved by Newton iteration from the semi-implicit step.
///
/// Unknown is the velocity (v, ω) at the end of the step, for which
///
/// m (v − v_0) = h F,   exp(h ω*) I_0 ω − I_0 ω_0 = h T,   x = x_0 + h v,   R = exp(h ω*) R_0,
///
/// with F and T at the end of the step. The derivatives are exact: of the carried momentum as in
/// [`semi_implicit_step`](crate::semi_implicit_step), of the wrench by ω through the turn as well, ∂φ = h
/// J_l(h ω) ∂ω. Contacts are evaluated anew in each iteration.
///
/// Newton steps are shortened until the simplified Newton step that follows is shorter than the last (the
/// natural monotonicity test of P. Deuflhard, *Newton Methods for Nonlinear Problems*, 2004, §3.3), which
/// does not depend on units. A damper acts at once when its contact closes, so that there may be no solution
/// with a contact or without; contacts that are open at the start and that the iteration flipped are then
/// left to the next step, as the semi-implicit step leaves them, and the iteration is run once more. If that
/// does not converge either, the step is the semi-implicit one, with
/// [`StepStatus::unconverged`](crate::StepStatus::unconverged) set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FullyImplicit {
    /// Largest number of Newton iterations of one run, of which there are at most two.
    pub iterations: u32,
    /// Largest change by the last Newton step, m/s: the root mean square velocity over the body's mass.
    pub tolerance: f64,
}

impl Default for FullyImplicit {
    /// 20 iterations, 1e-9 m/s.
    fn default() -> Self {
        Self { iterations: 20, tolerance: 1e-9 }
    }
}

/// Smallest fraction to which a Newton step is shortened. With less, iterations that do not converge take
/// longer.
const MIN_STEP: f64 = 1.0 / 64.0;

/// Rounding error of a velocity, relative to it.
const ROUNDING: f64 = 1e-12;

impl Integrator for FullyImplicit {
    fn name(&self) -> &'static str {
        "fully-implicit"
    }

    fn step(&self, frame: &Frame<'_>, state: &BodyState, dt: f64) -> Step {
        let mut first = SemiImplicit.step(frame, state, dt);
        if first.status.failure.is_some() {
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
fn open(contacts: &LinearContactModel, state: &BodyState) -> u64 {
    let rotation = DMat3::from_quat(state.pose.rotation);
    contacts.contacts().iter().enumerate().fold(0, |open, (i, c)| {
        let overlap = contacts.at(i, state, &rotation).overlap;
        open | u64::from(c.stiffness_at(overlap).is_none()) << i
    })
}

/// The places of a set of contacts.
const PLACES: usize = u64::BITS as usize;

/// The model without some of its contacts, and the places that the others had in it.
fn without(contacts: &LinearContactModel, left_out: u64) -> (LinearContactModel, [u8; PLACES]) {
    let mut fewer = LinearContactModel::empty(contacts.pose(), contacts.time());
    fewer.extend(contacts, !left_out);
    let mut places = [0; PLACES];
    let kept = (0..contacts.contacts().len() as u8).filter(|i| left_out & (1 << i) == 0);
    for (place, i) in places.iter_mut().zip(kept) {
        *place = i;
    }
    (fewer, places)
}

fn renumbered(active: u64, places: &[u8]) -> u64 {
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
    pushed: u64,
    ever: u64,
    always: u64,
}

/// The derivative of the residual, and the residual.
type System = ([[f64; 6]; 6], [f64; 6]);

impl<'a> Iteration<'a> {
    fn new(frame: &'a Frame<'a>, start: &'a BodyState, contacts: &'a LinearContactModel, dt: f64) -> Self {
        let rotation = DMat3::from_quat(start.pose.rotation);
        let inertia = rotation * frame.body.inertia * rotation.transpose();
        Self { frame, contacts, start, inertia, dt, solves: 0, pushed: 0, ever: 0, always: u64::MAX }
    }

    /// The contacts that pushed in some iterates and not in others.
    fn flipped(&self) -> u64 {
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
                if part < MIN_STEP {
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
        let by_twist = end_derivative(&jacobian, &exponential(twist.angular * dt).1, dt);
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

#[cfg(test)]
mod tests {
    use palpate_core::{Contact, Pose};
    use rand::{SeedableRng as _, rngs::StdRng};

    use super::*;
    use crate::body::Body;
    use crate::coupling::{DeviceMotion, VirtualCoupling};
    use crate::differences::{random_pose, random_twist, random_vector};
    use crate::penalty::ContactParameters;
    use crate::penalty::Friction;

    const PARAMETERS: ContactParameters =
        ContactParameters { stiffness: 2000.0, damping: 3.0, tolerance: 0.001, friction: Friction::NONE };

    #[test]
    fn derivative_of_the_residual_equals_central_differences() {
        let seed = 93;
        let mut rng = StdRng::seed_from_u64(seed);
        let mut pressed = 0;
        for case in 0..300 {
            let body = Body::new(0.05, DMat3::from_diagonal(DVec3::new(1e-5, 2e-5, 2.5e-5))).unwrap();
            let mut coupling =
                VirtualCoupling::critically_damped(&body, random_pose(&mut rng, 0.05), 300.0, 0.5);
            if case % 2 == 1 {
                (coupling.max_force, coupling.max_torque) = (5.0, 0.5);
            }
            let start =
                BodyState { pose: random_pose(&mut rng, 0.5), twist: random_twist(&mut rng, 0.2, 20.0) };
            let pull = random_twist(&mut rng, 0.01, 0.4);
            let device = DeviceMotion::at_rest((start.pose * coupling.grasp).moved(&pull, 1.0));
            let contacts = (0..3).map(|_| Contact {
                point: start.pose.translation + random_vector(&mut rng, 0.05),
                scene_point: DVec3::ZERO,
                normal: random_vector(&mut rng, 1.0).normalize(),
                depth: 0.02,
            });
            let contacts: Vec<_> = contacts.collect();
            let model = LinearContactModel::from_contacts(contacts, &start.pose, &PARAMETERS, 0.0);
            let frame = Frame {
                body: &body,
                device: &device,
                coupling: &coupling,
                contacts: &model,
                gravity: DVec3::NEG_Z,
            };
            let dt = [1e-3, 1e-2][case % 2];
            let mut run = Iteration::new(&frame, &start, &model, dt);
            let at = Twist::new(random_vector(&mut rng, 0.2), random_vector(&mut rng, 20.0));
            let (matrix, _) = run.system(&at);
            pressed += run.pushed.count_ones();
            for column in 0..6 {
                let mut axis = [0.0; 6];
                axis[column] = 1.0;
                let change = Twist::new(DVec3::from_slice(&axis[..3]), DVec3::from_slice(&axis[3..]));
                let h = if column < 3 { 1e-4 } else { 1e-2 };
                let mut residual = |s: f64| run.system(&sum(&at, &change, s * h)).1;
                let ends = [residual(1.0), residual(-1.0), residual(2.0), residual(-2.0)];
                let size = matrix.iter().fold(0.0, |m: f64, row| m.max(row[column].abs()));
                for (i, row) in matrix.iter().enumerate() {
                    let expected = ((ends[0][i] - ends[1][i]) * 8.0 - (ends[2][i] - ends[3][i])) / (12.0 * h);
                    let error = (row[column] - expected).abs() / size;
                    assert!(error < 1e-7, "seed {seed}, case {case}, entry {i}, {column}: {error}");
                }
            }
        }
        assert!(pressed > 300, "only {pressed} contacts pressed");
    }

    /// A body just outside a wall with a hard damper: without contact it would end inside, and with it
    /// outside.
    #[test]
    fn a_contact_that_can_neither_open_nor_close_is_left_to_the_next_step() {
        let body = Body::new(0.02, DMat3::from_diagonal(DVec3::splat(1e-5))).unwrap();
        let mut coupling = VirtualCoupling::critically_damped(&body, Pose::IDENTITY, 200.0, 0.6);
        coupling.linear_damping = 0.0;
        let touch =
            |point: DVec3, normal: DVec3, depth: f64| Contact { point, scene_point: point, normal, depth };
        // The other wall pushes throughout.
        let contacts = [touch(DVec3::ZERO, DVec3::X, -1e-4 - 1e-3), touch(DVec3::ZERO, DVec3::Y, 0.001)];
        let hard = ContactParameters { damping: 1000.0, ..PARAMETERS };
        let mut model = LinearContactModel::empty(&Pose::IDENTITY, 0.0);
        for (contact, parameters) in contacts.into_iter().zip([hard, PARAMETERS]) {
            let one = LinearContactModel::from_contacts([contact], &Pose::IDENTITY, &parameters, 0.0);
            model.push_contact(one.contacts()[0]);
        }
        let device = DeviceMotion::default();
        let frame = Frame {
            body: &body,
            device: &device,
            coupling: &coupling,
            contacts: &model,
            gravity: DVec3::ZERO,
        };
        let start = BodyState { pose: Pose::IDENTITY, twist: Twist::new(DVec3::X * 0.5, DVec3::ZERO) };
        let step = FullyImplicit::default().step(&frame, &start, 1e-3);
        assert!(step.status.is_ok(), "{:?}", step.status);
        assert_eq!(step.active, 0b10);
        assert!(step.state.pose.translation.x > 1e-4, "it is in the wall: {}", step.state.pose.translation);
        let next = FullyImplicit::default().step(&frame, &step.state, 1e-3);
        assert_eq!(next.active & 1, 1);
        assert!(next.status.is_ok() && next.state.twist.linear.x.abs() < 0.1);
    }
}
