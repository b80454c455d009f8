//! The quasi-static body of M. Wan and W. A. McNeely, *Quasi-Static Approximation for 6 Degrees-of-Freedom
//! Haptic Rendering* (IEEE Visualization 2003).

use glam::{DMat3, DVec3};
use palpate_core::{Pose, Twist, Wrench};

use crate::algebra::linear_solve::{has_positive_minors, solve};
use crate::body::BodyState;
use crate::coupling::DeviceMotion;
use crate::integrators::Integrator;
use crate::jacobian::Block6;
use crate::step::{Frame, Step, StepFailure, StepStatus};

/// A body without dynamics: each step puts it at the equilibrium of the springs of coupling and contacts,
/// with gravity.
///
/// Neither dampers nor inertia act: only the velocity depends on the time step, as the
/// change of placement over it, and the wrenches are those of the springs alone. The equilibrium is
/// searched from the present placement by Newton's method. If the stiffness is not positive definite
/// (a saturated spring, a tool about to buckle), or a step neither brings the springs closer to balance nor
/// takes energy from them, springs to the present placement are added, of the coupling's gains times a factor
/// that grows until it does (Levenberg's method).
///
/// The search is bounded; if it ends early, the body stays at the best placement, [`StepStatus::unconverged`]
/// is set, and the next step continues from there. Both of the coupling's springs must have a positive
/// stiffness: without them there is no one equilibrium, and the step is held for [`StepFailure::Singular`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuasiStatic {
    /// Largest number of systems that a step solves.
    pub iterations: u32,
    /// Largest displacement of the body in an iteration, m.
    pub max_shift: f64,
    /// Largest rotation of the body in an iteration, rad.
    pub max_turn: f64,
    /// Largest motion of the last iteration, m; turning counts by the deviation of the linear spring that
    /// holds as much energy.
    pub tolerance: f64,
}

impl Default for QuasiStatic {
    /// 40 iterations of at most 5 cm and 0.5 rad, to 1e-9 m.
    fn default() -> Self {
        Self { iterations: 40, max_shift: 0.05, max_turn: 0.5, tolerance: 1e-9 }
    }
}

impl Integrator for QuasiStatic {
    fn name(&self) -> &'static str {
        "quasi-static"
    }

    fn step(&self, frame: &Frame<'_>, state: &BodyState, dt: f64) -> Step {
        if let Some(refused) = frame.refused(state, dt) {
            return refused;
        }
        let at_rest = DeviceMotion::at_rest(frame.device.pose);
        let frame = Frame { device: &at_rest, ..*frame };
        let Some((balance, status)) = self.search(&frame, &state.pose) else {
            return Step::failed(state, StepFailure::Singular);
        };
        let resting = BodyState::at_rest(balance.pose);
        let mut step = frame.ended(state, &resting, balance.active, status);
        if step.status.failure.is_none() {
            step.state.twist = Twist {
                linear: (balance.pose.translation - state.pose.translation) / dt,
                angular: state.pose.rotation_vector_to(&balance.pose) / dt,
            };
            if !step.state.is_valid() {
                return Step::failed(state, StepFailure::Overflow);
            }
        }
        step
    }
}

/// Smallest and first factor of the added springs. With less, more iterations are wasted on steps that are
/// too long.
const MIN_FACTOR: f64 = 1e-3;
/// Growth of the factor from one iteration to the next.
const FACTOR_GROWTH: f64 = 10.0;
/// Factor at which the search ends: the body does not move any more.
const MAX_FACTOR: f64 = 1e9;

/// Balance of the springs at a placement.
#[derive(Clone, Copy)]
struct Balance {
    pose: Pose,
    load: Wrench,
    /// The derivative of the load by the placement, negated.
    stiffness: Block6,
    active: u64,
    /// The deviation of the linear spring that would hold the energy of the load, m.
    off: f64,
    /// Energy of the springs and the weight, J.
    energy: f64,
}

impl QuasiStatic {
    fn search(&self, frame: &Frame<'_>, start: &Pose) -> Option<(Balance, StepStatus)> {
        let gains = (frame.coupling.linear_stiffness, frame.coupling.angular_stiffness);
        if !(gains.0 > 0.0 && gains.1 > 0.0) {
            return None;
        }
        let mut status = StepStatus { unconverged: true, ..StepStatus::default() };
        let mut here = Balance::new(frame, *start, gains);
        let mut added = 0.0;
        while status.solves < self.iterations {
            status.solves += 1;
            let Some(change) = here.newton_step(added, gains) else {
                let Some(next) = more(added) else { break };
                added = next;
                continue;
            };
            let length = (change.linear.length_squared()
                + change.angular.length_squared() * (gains.1 / gains.0))
                .sqrt();
            let next = Balance::new(frame, here.pose.moved(&self.limited(&change), 1.0), gains);
            // The last step may be rounding only.
            if length <= self.tolerance && added == 0.0 {
                status.unconverged = false;
                let better = next.off < here.off;
                return Some((if better { next } else { here }, status));
            }
            // With a saturated spring only the energy falls.
            if next.off < here.off || next.energy < here.energy {
                here = next;
                added = if added > MIN_FACTOR { added / FACTOR_GROWTH } else { 0.0 };
            } else {
                let Some(next) = more(added) else { break };
                added = next;
            }
        }
        here.off.is_finite().then_some((here, status))
    }

    fn limited(&self, change: &Twist) -> Twist {
        let excess =
            (change.linear.length() / self.max_shift).max(change.angular.length() / self.max_turn).max(1.0);
        Twist { linear: change.linear / excess, angular: change.angular / excess }
    }
}

/// The next factor of the added springs; `None` beyond the largest.
fn more(added: f64) -> Option<f64> {
    Some(if added == 0.0 { MIN_FACTOR } else { added * FACTOR_GROWTH }).filter(|added| *added < MAX_FACTOR)
}

impl Balance {
    fn new(frame: &Frame<'_>, pose: Pose, gains: (f64, f64)) -> Self {
        let state = BodyState::at_rest(pose);
        let held = frame.coupling.evaluate(&state, frame.device);
        let touch = frame.contacts.evaluate(&state);
        let weight = Wrench::new(frame.gravity * frame.body.mass, DVec3::ZERO);
        let load = held.on_body + touch.wrench + weight;
        let square =
            load.force.length_squared() / gains.0.powi(2) + load.torque.length_squared() / gains.0 / gains.1;
        Self {
            pose,
            load,
            stiffness: (held.jacobian.pose + touch.jacobian.pose).scaled(-1.0),
            active: touch.active,
            off: square.sqrt(),
            energy: frame.coupling.potential_energy(&state, frame.device)
                + frame.contacts.potential_energy(&pose)
                - weight.force.dot(pose.translation),
        }
    }

    /// The change of placement that balances the springs to first order, with `added` times the gains as
    /// springs to the present placement; `None` if the stiffness is not positive definite. Of one that is not
    /// symmetric, which a load off balance makes it, the leading minors have to be positive: with a symmetric
    /// one that is the same.
    fn newton_step(&self, added: f64, gains: (f64, f64)) -> Option<Twist> {
        let mut stiffness = self.stiffness;
        stiffness.force_linear += DMat3::from_diagonal(DVec3::splat(added * gains.0));
        stiffness.torque_angular += DMat3::from_diagonal(DVec3::splat(added * gains.1));
        let matrix = stiffness.to_rows();
        if !has_positive_minors(matrix) {
            return None;
        }
        let Wrench { force, torque } = self.load;
        let [x, y, z, a, b, c] = solve(matrix, [force.x, force.y, force.z, torque.x, torque.y, torque.z])?;
        Some(Twist { linear: DVec3::new(x, y, z), angular: DVec3::new(a, b, c) })
    }
}
