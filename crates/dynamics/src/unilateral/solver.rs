//! Projected Gauss–Seidel for contact impulses.

use glam::DVec3;
use palpate_core::Twist;

use super::{MAX_UNILATERAL, UnilateralContact};
use crate::system::six;

/// Largest number of sweeps. With fewer, many contacts at once may overlap by more than rounding.
const MAX_SWEEPS: u32 = 30;

/// Largest change of a contact velocity in a sweep, relative to the largest free one, at which the sweeps
/// end. With more, contacts overlap by more; with less, steps take longer.
const SWEEP_TOLERANCE: f64 = 1e-4;

/// Compliance of a contact relative to the body's own mobility along it. Without it the impulses of redundant
/// contacts are not unique and wander; with much more, contacts are felt to yield.
const COMPLIANCE: f64 = 1e-3;

/// One contact's rows.
#[derive(Clone, Copy)]
struct Row {
    /// Orthonormal axes: normal and two tangents.
    axes: [DVec3; 3],
    /// Jacobian rows (axis, a × axis).
    jacobian: [[f64; 6]; 3],
    /// A⁻¹ Jᵀ.
    response: [[f64; 6]; 3],
    /// Diagonal of J A⁻¹ Jᵀ, of the normal with compliance; of the tangents the larger.
    normal_mobility: f64,
    tangent_mobility: f64,
    compliance: f64,
    /// Largest approach velocity along the normal, m/s, and the surface's velocity along the tangents.
    approach: f64,
    slide: [f64; 2],
    impulse: [f64; 3],
}

/// Contacts of one step, ready to be swept.
pub(super) struct Solver {
    rows: arrayvec::ArrayVec<Row, MAX_UNILATERAL>,
}

#[inline(always)]
fn dot(a: &[f64; 6], b: &[f64; 6]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] + a[4] * b[4] + a[5] * b[5]
}

#[inline(always)]
fn add(to: &mut [f64; 6], gain: f64, from: &[f64; 6]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to += gain * from;
    }
}

impl Solver {
    /// Prepares contacts, given the inverse of the step's matrix, for a step of `dt` (s) with a largest
    /// recovery velocity (m/s).
    pub fn new(contacts: &[UnilateralContact], inverse: &[[f64; 6]; 6], dt: f64, recovery: f64) -> Self {
        let rows = contacts.iter().map(|contact| Row::new(contact, inverse, dt, recovery));
        Self { rows: rows.take(MAX_UNILATERAL).collect() }
    }

    /// Finds the impulses, starting from a free velocity of the body. Returns the velocity with them.
    pub fn solve(&mut self, free: &Twist, contacts: &[UnilateralContact]) -> (Twist, bool) {
        let mut velocity = six(free.linear, free.angular);
        let mut size: f64 = 1e-9;
        for row in &self.rows {
            size = size.max((dot(&row.jacobian[0], &velocity) - row.approach).abs());
            for (impulse, response) in row.impulse.iter().zip(&row.response) {
                add(&mut velocity, -impulse, response);
            }
        }
        let mut converged = self.rows.is_empty();
        for _ in 0..MAX_SWEEPS {
            let mut change: f64 = 0.0;
            for (row, contact) in self.rows.iter_mut().zip(contacts) {
                change = change.max(row.sweep(&mut velocity, contact.friction));
            }
            if change <= SWEEP_TOLERANCE * size {
                converged = true;
                break;
            }
        }
        let [vx, vy, vz, wx, wy, wz] = velocity;
        (Twist { linear: DVec3::new(vx, vy, vz), angular: DVec3::new(wx, wy, wz) }, converged)
    }

    /// Writes the impulses back into the contacts.
    pub fn store(&self, contacts: &mut [UnilateralContact]) {
        for (row, contact) in self.rows.iter().zip(contacts) {
            let [n, s, t] = row.impulse;
            contact.impulse = row.axes[0] * n + row.axes[1] * s + row.axes[2] * t;
        }
    }
}

impl Row {
    #[inline(always)]
    fn new(contact: &UnilateralContact, inverse: &[[f64; 6]; 6], dt: f64, recovery: f64) -> Self {
        let UnilateralContact { arm, normal, gap, velocity, friction, impulse } = *contact;
        let (first, second) = normal.any_orthonormal_pair();
        let axes = [normal, first, second];
        let jacobian = axes.map(|axis| six(axis, arm.cross(axis)));
        let used = if friction > 0.0 { 3 } else { 1 };
        let mut response = [[0.0; 6]; 3];
        for (response, row) in response.iter_mut().zip(&jacobian).take(used) {
            *response = std::array::from_fn(|i| dot(&inverse[i], row));
        }
        let mobility = |axis: usize| dot(&jacobian[axis], &response[axis]);
        let along = mobility(0);
        let compliance = COMPLIANCE * along;
        // The impulse on the surface that the body ended the last step with.
        let before =
            if friction > 0.0 { axes.map(|axis| axis.dot(impulse)) } else { [normal.dot(impulse), 0.0, 0.0] };
        Self {
            axes,
            jacobian,
            response,
            normal_mobility: along + compliance,
            tangent_mobility: mobility(1).max(mobility(2)),
            compliance,
            approach: normal.dot(velocity) + (gap / dt).max(-recovery),
            slide: [first.dot(velocity), second.dot(velocity)],
            impulse: [before[0].max(0.0), before[1], before[2]],
        }
    }

    /// Updates the impulses of this contact and the body's velocity. Returns the change in contact velocity,
    /// m/s.
    #[inline(always)]
    fn sweep(&mut self, velocity: &mut [f64; 6], friction: f64) -> f64 {
        let excess = dot(&self.jacobian[0], velocity) - self.approach - self.compliance * self.impulse[0];
        let next = (self.impulse[0] + excess / self.normal_mobility).max(0.0);
        let step = next - self.impulse[0];
        self.impulse[0] = next;
        if step != 0.0 {
            add(velocity, -step, &self.response[0]);
        }
        let mut change = step.abs() * self.normal_mobility;
        if friction > 0.0 && (next > 0.0 || self.impulse[1] != 0.0 || self.impulse[2] != 0.0) {
            let wanted = [1, 2].map(|axis| {
                let slip = dot(&self.jacobian[axis], velocity) - self.slide[axis - 1];
                self.impulse[axis] + slip / self.tangent_mobility
            });
            let (most, size) = (friction * next, wanted[0].hypot(wanted[1]));
            let share = if size > most { most / size } else { 1.0 };
            for axis in [1, 2] {
                let next = wanted[axis - 1] * share;
                let step = next - self.impulse[axis];
                self.impulse[axis] = next;
                add(velocity, -step, &self.response[axis]);
                change = change.max(step.abs() * self.tangent_mobility);
            }
        }
        change
    }
}
