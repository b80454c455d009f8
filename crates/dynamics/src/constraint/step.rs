//! One haptic frame with constraints.

use arrayvec::ArrayVec;
use glam::DVec3;
use palpate_core::{Pose, Twist, Wrench};

use super::pushed::{MAX_PUSHED, Pushed, PushedBody};
use super::solver::{Rows, SHALLOW, Single, Solver};
use super::working_set::{MAX_EXCHANGES, choose, exchange, share};
use super::{Constraint, MAX_CONSTRAINTS, MotionBound, RECOVERY_TIME};
use crate::algebra::linear_solve::{inverse, inverse_definite};
use crate::algebra::vector::{Vector, dot};
use crate::body::BodyState;
use crate::coupling::VirtualCoupling;
use crate::step::{Frame, Solution, Step, StepFailure, System};

/// Force in the coupling's damper, N at the device, with which an overlap is undone: less than a hand feels
/// as a push.
const RECOVERY_FORCE: f64 = 0.05;

/// Largest speed at which an overlap is undone, m/s at the device.
const MAX_RECOVERY: f64 = 0.02;

/// Outcome of a step with constraints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConstrainedStep {
    /// The step; its contact wrench is that of the constraints and of the penalty contacts.
    pub step: Step,
    /// Whether the step was shortened, by the bound on motion or for contacts that were not solved for.
    pub held_back: bool,
    /// Largest velocity with which overlaps were undone, m/s: the next step goes on from it.
    pub recovery: f64,
}

/// Velocity with which overlaps of a tool are undone, from one step to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Recovery {
    /// Largest in the last step, m/s; 0 before the first.
    pub speed: f64,
    /// Lengths of the world for those at the device, by which its forces are weaker
    /// ([`DeviceMapping::scale`](crate::DeviceMapping::scale)).
    pub scale: f64,
}

impl Recovery {
    /// The start of a tool whose device moves in the world by a scale.
    pub fn at_scale(scale: f64) -> Self {
        Self { speed: 0.0, scale }
    }
}

impl From<Step> for ConstrainedStep {
    /// A step without contacts, or one that was refused.
    fn from(step: Step) -> Self {
        Self { step, held_back: false, recovery: 0.0 }
    }
}

/// Advances the body by `dt` (s) as [`semi_implicit_step`](crate::semi_implicit_step) does, without passing
/// the surfaces of `contacts` that are constraints, and no further than a `bound`. Updates the contacts'
/// impulses. Of the bodies that contacts push, those from the fourth on do not give way in this step.
///
/// Overlaps are undone with at most the recovery velocity, which sets in over some milliseconds: `recovery`
/// is that of the last step.
///
/// Where there are more than [`MAX_CONSTRAINTS`](super::MAX_CONSTRAINTS) contacts, their order changes.
///
/// Refuses the same inputs, and keeps the same rules: nothing is allocated and nothing panics.
pub fn constrained_step(
    frame: &Frame<'_>,
    state: &BodyState,
    contacts: &mut [Constraint],
    pushed: &[PushedBody],
    bound: &MotionBound,
    recovery: &Recovery,
    dt: f64,
) -> ConstrainedStep {
    if let Some(refused) = frame.refused(state, dt) {
        return refused.into();
    }
    let mut candidates = ArrayVec::new();
    let mut system = System::new(frame, state, dt, &mut candidates);
    let Some(Solution { change, active, matrix, mut status }) = system.solve() else {
        return Step::failed(state, StepFailure::Singular).into();
    };
    let mut twist = Twist::new(state.twist.linear + change.linear, state.twist.angular + change.angular);
    let mut shortened = false;
    let shallow = SHALLOW * recovery.scale;
    let recovery = next_recovery(recovery, &*contacts, frame.coupling, dt);
    if !contacts.is_empty() {
        let Some(factor) = mobility_factor(matrix) else {
            return Step::failed(state, StepFailure::Singular).into();
        };
        let pushed = Pushed::new(pushed, &*contacts);
        let moved = Single { free: &twist, factor: &factor, center: state.pose.translation, pushed: &pushed };
        let solve = match pushed.len() {
            0 => solved::<6>,
            1 => solved::<12>,
            _ => solved::<{ 6 + 6 * MAX_PUSHED }>,
        };
        let (held, share, converged) = solve(contacts, &moved, (dt, recovery, shallow));
        status.unconverged = !converged;
        shortened = share < 1.0;
        twist = Twist::new(held.linear * share, held.angular * share);
    }
    let moved = |share: f64| {
        let twist = Twist::new(twist.linear * share, twist.angular * share);
        BodyState { pose: state.pose.moved(&twist, dt), twist }
    };
    let mut next = moved(1.0);
    let within = allowed(bound, (&state.pose, &next.pose), &twist, dt);
    let held_back = within < 1.0;
    if held_back {
        next = moved(within);
    }
    let mut step = frame.ended(state, &next, active, status);
    step.contact += wrench(contacts, dt);
    if step.status.failure.is_some() || !step.contact.is_finite() {
        // Impulses that are not finite would make the next step fail too.
        contacts.iter_mut().for_each(|contact| contact.impulse = DVec3::ZERO);
        return Step::failed(state, StepFailure::Overflow).into();
    }
    ConstrainedStep { step, held_back: held_back || shortened, recovery }
}

/// Finds the impulses of contacts of a body in a step of `dt` (s) with a largest recovery velocity (m/s), and
/// the depth of shallow overlaps (m). Returns its velocity with them, the share of the step that passes no
/// surface, and whether the impulses converged.
fn solved<const N: usize>(
    contacts: &mut [Constraint],
    moved: &Single<'_>,
    (dt, recovery, shallow): (f64, f64, f64),
) -> (Twist, f64, bool) {
    let passed = choose(contacts, MAX_CONSTRAINTS, moved.free, (dt, recovery));
    let mut exchanges = 0;
    loop {
        let mut rows = Rows::<N>::default();
        let (felt, converged) = Solver::new(contacts, moved, (dt, recovery, shallow), &mut rows).solve();
        rows.store(contacts);
        let [vx, vy, vz, wx, wy, wz] = changed(moved.factor, &felt);
        let held = Twist {
            linear: moved.free.linear - DVec3::new(vx, vy, vz),
            angular: moved.free.angular - DVec3::new(wx, wy, wz),
        };
        if exchanges == MAX_EXCHANGES || !exchange(contacts, &held, passed, dt) {
            return (held, share(contacts, MAX_CONSTRAINTS, &held, passed, dt), converged);
        }
        exchanges += 1;
    }
}

/// K y, for the first of the numbers y: what all impulses take off a tool's velocity.
pub(crate) fn changed<const D: usize, const N: usize>(
    factor: &[Vector<D>; D],
    felt: &Vector<N>,
) -> Vector<D> {
    let own: Vector<D> = std::array::from_fn(|index| felt[index]);
    std::array::from_fn(|row| dot(&factor[row], &own))
}

/// Recovery velocity of a tool with a coupling and contacts in a step of `dt` (s), by that of the step
/// before, m/s.
#[inline(always)]
pub(crate) fn next_recovery<'a>(
    before: &Recovery,
    contacts: impl IntoIterator<Item = &'a Constraint>,
    coupling: &VirtualCoupling,
    dt: f64,
) -> f64 {
    // Both are at the device, where lengths and forces are smaller by the scale.
    let most = before.scale * (RECOVERY_FORCE / coupling.linear_damping).min(MAX_RECOVERY);
    let depth = contacts.into_iter().fold(0.0, |depth: f64, contact| depth.max(-contact.gap));
    let [before, wanted] = [before.speed, depth / RECOVERY_TIME].map(|speed| speed.min(most).max(0.0));
    before + (dt / RECOVERY_TIME).min(1.0) * (wanted - before)
}

/// The lower factor K of the mobility, for a step's matrix; `None` if that is singular.
pub(crate) fn mobility_factor<const D: usize>(matrix: [Vector<D>; D]) -> Option<[Vector<D>; D]> {
    let mobility = inverse_definite(matrix).or_else(|| inverse(matrix))?;
    Some(cholesky(&symmetric(&mobility)))
}

/// The symmetric part of a matrix. The inverse of a step's matrix is symmetric but for geometric stiffness;
/// the search for impulses needs a form that is symmetric and positive definite, and overlaps contacts
/// otherwise.
fn symmetric<const D: usize>(matrix: &[Vector<D>; D]) -> [Vector<D>; D] {
    std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (matrix[i][j] + matrix[j][i])))
}

/// Smallest pivot of a mobility, as a fraction of its entry. The symmetric part of the inverse of a matrix
/// whose own is not definite, as of a body that spins by a radian a step, may have smaller ones.
const MIN_PIVOT: f64 = 1e-9;

/// The lower factor K of a positive definite matrix K Kᵀ.
fn cholesky<const D: usize>(matrix: &[Vector<D>; D]) -> [Vector<D>; D] {
    let mut lower = [[0.0; D]; D];
    for row in 0..D {
        for column in 0..=row {
            let left: f64 = (0..column).map(|k| lower[row][k] * lower[column][k]).sum();
            let entry = matrix[row][column] - left;
            lower[row][column] = if row == column {
                entry.max(MIN_PIVOT * matrix[row][row].abs()).sqrt()
            } else {
                entry / lower[column][column]
            };
        }
    }
    lower
}

/// Wrench of the contacts on the body, about its centre of mass.
pub(crate) fn wrench(contacts: &[Constraint], dt: f64) -> Wrench {
    contacts.iter().fold(Wrench::ZERO, |sum, contact| {
        let force = contact.impulse / -dt;
        sum + Wrench { force, torque: contact.arm.cross(force) }
    })
}

/// The share of a step of `dt` (s) with a twist, from one pose to another, that stays within a bound.
pub(crate) fn allowed(bound: &MotionBound, (from, to): (&Pose, &Pose), twist: &Twist, dt: f64) -> f64 {
    let length = dt * (twist.linear.length() + twist.angular.length() * bound.radius);
    let is_near = bound.displacement(to) <= bound.room;
    if is_near && length <= bound.step {
        return 1.0;
    }
    // Displacements add up to no more than their sum.
    let room = if is_near { bound.step } else { bound.step.min(bound.room - bound.displacement(from)) };
    (room / length).clamp(0.0, 1.0)
}
