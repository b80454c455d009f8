//! Contact impulses: of the normals exactly, by an active-set method; of friction by projection, in turn with
//! them.

use arrayvec::ArrayVec;
use glam::DVec3;
use palpate_core::Twist;

use super::{MAX_UNILATERAL, UnilateralContact};
use crate::system::six;

/// Largest number of rounds of friction. With fewer, many contacts that slide at once creep.
const MAX_ROUNDS: u32 = 10;

/// Number of passes over the contacts' friction in a round.
const PASSES: u32 = 3;

/// Largest number of changes of the active set. With fewer, a body that meets many surfaces at once overlaps
/// some of them.
const MAX_CHANGES: u32 = 3 * MAX_UNILATERAL as u32;

/// Velocities below this are rounding, m/s.
const MIN_VELOCITY: f64 = 1e-9;

/// Largest change of a contact velocity in a round of friction, relative to the largest free one, at which the
/// rounds end. With more, contacts creep; with less, steps take longer.
const ROUND_TOLERANCE: f64 = 1e-4;

/// Compliance of a contact relative to the body's own mobility along it. Without it the impulses of redundant
/// contacts are not unique and wander; with much more, contacts are felt to yield.
const COMPLIANCE: f64 = 1e-3;

type Six = [f64; 6];

/// One contact's rows.
#[derive(Clone, Copy)]
struct Row {
    /// Orthonormal axes: normal and two tangents.
    axes: [DVec3; 3],
    /// Jacobian rows (axis, a × axis).
    jacobian: [Six; 3],
    /// A⁻¹ Jᵀ, of the contacts that have pushed.
    response: [Six; 3],
    is_ready: bool,
    /// The larger of the two diagonal entries of J A⁻¹ Jᵀ along the surface.
    tangent_mobility: f64,
    compliance: f64,
    /// Largest approach velocity along the normal, and the surface's velocity along the tangents, m/s.
    approach: f64,
    slide: [f64; 2],
    friction: f64,
    impulse: [f64; 3],
}

/// Contacts of one step, with the velocity of the body.
pub(super) struct Solver<'a> {
    rows: ArrayVec<Row, MAX_UNILATERAL>,
    velocity: Six,
    /// A⁻¹.
    inverse: &'a [Six; 6],
}

#[inline(always)]
fn dot(a: &Six, b: &Six) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] + a[4] * b[4] + a[5] * b[5]
}

#[inline(always)]
fn add(to: &mut Six, gain: f64, from: &Six) {
    for (to, from) in to.iter_mut().zip(from) {
        *to += gain * from;
    }
}

impl<'a> Solver<'a> {
    /// Prepares contacts, given the body's free velocity and the inverse of the step's matrix, for a step of
    /// `dt` (s) with a largest recovery velocity (m/s).
    pub fn new(
        contacts: &[UnilateralContact],
        free: &Twist,
        inverse: &'a [Six; 6],
        dt: f64,
        recovery: f64,
    ) -> Self {
        let rows = contacts.iter().map(|contact| Row::new(contact, dt, recovery));
        let mut rows: ArrayVec<Row, MAX_UNILATERAL> = rows.take(MAX_UNILATERAL).collect();
        rows.iter_mut().filter(|row| row.impulse != [0.0; 3]).for_each(|row| row.prepare(inverse));
        Self { rows, velocity: six(free.linear, free.angular), inverse }
    }

    /// Finds the impulses. Returns the body's velocity with them, and whether they converged.
    pub fn solve(&mut self) -> (Twist, bool) {
        let mut size = MIN_VELOCITY;
        for row in &self.rows {
            size = size.max((dot(&row.jacobian[0], &self.velocity) - row.approach).abs());
            for axis in [1, 2] {
                add(&mut self.velocity, -row.impulse[axis], &row.response[axis]);
            }
        }
        let mut converged = self.push(1e-3 * ROUND_TOLERANCE * size);
        let rubs = self.rows.iter().any(|row| row.friction > 0.0);
        let mut round = 0;
        while rubs && converged {
            let change = (0..PASSES).fold(0.0, |_, _| self.rub());
            for Row { impulse, response, .. } in &self.rows {
                add(&mut self.velocity, impulse[0], &response[0]);
            }
            converged = self.push(1e-3 * ROUND_TOLERANCE * size);
            round += 1;
            if change <= ROUND_TOLERANCE * size {
                break;
            }
            if round == MAX_ROUNDS {
                converged = false;
            }
        }
        let [vx, vy, vz, wx, wy, wz] = self.velocity;
        (Twist { linear: DVec3::new(vx, vy, vz), angular: DVec3::new(wx, wy, wz) }, converged)
    }

    /// Finds the normal impulses for given friction, and updates the velocity. The impulses p ≥ 0 minimise
    /// ½ pᵀ (W + c) p − qᵀ p with W = J A⁻¹ Jᵀ and the approach q = J v − limit without them (Lawson and
    /// Hanson 1974, *Solving Least Squares Problems*, ch. 23). Approaches below `tolerance` (m/s) are allowed.
    /// Returns whether the search ended.
    fn push(&mut self, tolerance: f64) -> bool {
        // `velocity` holds no normal impulses while `without` is solved for.
        let without = self.velocity;
        let mut active: ArrayVec<usize, MAX_UNILATERAL> =
            (0..self.rows.len()).filter(|&index| self.rows[index].impulse[0] > 0.0).collect();
        for row in &mut self.rows {
            row.impulse[0] = row.impulse[0].max(0.0);
        }
        for _ in 0..MAX_CHANGES {
            let wanted = self.balanced(&active, &without);
            // The way to the wanted impulses on which none pulls.
            let mut share: f64 = 1.0;
            for (&index, &wanted) in active.iter().zip(&wanted) {
                if wanted <= 0.0 {
                    let impulse = self.rows[index].impulse[0];
                    share = share.min(impulse / (impulse - wanted).max(f64::MIN_POSITIVE));
                }
            }
            for (&index, &wanted) in active.iter().zip(&wanted) {
                let impulse = &mut self.rows[index].impulse[0];
                *impulse += share * (wanted - *impulse);
            }
            if share < 1.0 {
                let mut kept = ArrayVec::new();
                for (&index, &wanted) in active.iter().zip(&wanted) {
                    let impulse = &mut self.rows[index].impulse[0];
                    if wanted <= 0.0 && *impulse <= f64::EPSILON * wanted.abs() + f64::MIN_POSITIVE {
                        *impulse = 0.0;
                    } else {
                        kept.push(index);
                    }
                }
                active = kept;
                continue;
            }
            self.velocity = without;
            for &index in &active {
                let Row { impulse, response, .. } = &self.rows[index];
                add(&mut self.velocity, -impulse[0], &response[0]);
            }
            match self.fastest(&active, tolerance) {
                Some(index) => {
                    self.rows[index].prepare(self.inverse);
                    active.push(index);
                }
                None => return true,
            }
        }
        false
    }

    /// The contact outside a set that approaches fastest, by more than a tolerance, m/s.
    fn fastest(&self, active: &[usize], tolerance: f64) -> Option<usize> {
        let mut found = (tolerance, None);
        for (index, row) in self.rows.iter().enumerate() {
            let excess = dot(&row.jacobian[0], &self.velocity) - row.approach;
            if excess > found.0 && !active.contains(&index) {
                found = (excess, Some(index));
            }
        }
        found.1
    }

    /// Normal impulses with which the contacts of a set approach at their limits, given the velocity without
    /// them: (W + c) p = q, by Cholesky factorisation.
    fn balanced(&self, active: &[usize], without: &Six) -> ArrayVec<f64, MAX_UNILATERAL> {
        let mut lower = [[0.0; MAX_UNILATERAL]; MAX_UNILATERAL];
        let mut solution = ArrayVec::new();
        for (i, &index) in active.iter().enumerate() {
            let row = &self.rows[index];
            let mut right = dot(&row.jacobian[0], without) - row.approach;
            for (j, &other) in active[..=i].iter().enumerate() {
                let mut entry = dot(&row.jacobian[0], &self.rows[other].response[0]);
                for k in 0..j {
                    entry -= lower[i][k] * lower[j][k];
                }
                if i == j {
                    lower[i][i] = (entry + row.compliance).max(row.compliance).sqrt();
                } else {
                    lower[i][j] = entry / lower[j][j];
                    right -= lower[i][j] * solution[j];
                }
            }
            solution.push(right / lower[i][i]);
        }
        for i in (0..active.len()).rev() {
            solution[i] /= lower[i][i];
            for j in 0..i {
                solution[j] -= lower[i][j] * solution[i];
            }
        }
        solution
    }

    /// Updates the friction of all contacts once, for given normal impulses. Returns the largest change of a
    /// contact's velocity, m/s.
    fn rub(&mut self) -> f64 {
        let Self { rows, velocity, .. } = self;
        let mut change: f64 = 0.0;
        for row in rows {
            change = change.max(row.rub(velocity));
        }
        change
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
    fn new(contact: &UnilateralContact, dt: f64, recovery: f64) -> Self {
        let UnilateralContact { arm, normal, gap, velocity, friction, impulse } = *contact;
        let (first, second) = normal.any_orthonormal_pair();
        let axes = [normal, first, second];
        let jacobian = axes.map(|axis| six(axis, arm.cross(axis)));
        let used = if friction > 0.0 { 3 } else { 1 };
        let along = |axis: usize| if axis < used { axes[axis].dot(impulse) } else { 0.0 };
        Self {
            axes,
            jacobian,
            response: [[0.0; 6]; 3],
            is_ready: false,
            tangent_mobility: 0.0,
            compliance: 0.0,
            approach: normal.dot(velocity) + (gap / dt).max(-recovery),
            slide: [first.dot(velocity), second.dot(velocity)],
            friction,
            impulse: [along(0).max(0.0), along(1), along(2)],
        }
    }

    /// Computes the responses.
    #[inline(always)]
    fn prepare(&mut self, inverse: &[Six; 6]) {
        if self.is_ready {
            return;
        }
        self.is_ready = true;
        let used = if self.friction > 0.0 { 3 } else { 1 };
        for (response, row) in self.response.iter_mut().zip(&self.jacobian).take(used) {
            *response = std::array::from_fn(|i| dot(&inverse[i], row));
        }
        let mobility = |axis: usize| dot(&self.jacobian[axis], &self.response[axis]);
        self.tangent_mobility = mobility(1).max(mobility(2));
        self.compliance = COMPLIANCE * mobility(0);
    }

    /// Updates friction: the impulse that stops the sliding, within the cone of the normal impulse.
    #[inline(always)]
    fn rub(&mut self, velocity: &mut Six) -> f64 {
        if self.friction <= 0.0 || !self.is_ready {
            return 0.0;
        }
        let wanted = [1, 2].map(|axis| {
            let slip = dot(&self.jacobian[axis], velocity) - self.slide[axis - 1];
            self.impulse[axis] + slip / self.tangent_mobility
        });
        let (most, size) = (self.friction * self.impulse[0], wanted[0].hypot(wanted[1]));
        let share = if size > most { most / size } else { 1.0 };
        let mut change: f64 = 0.0;
        for axis in [1, 2] {
            let step = wanted[axis - 1] * share - self.impulse[axis];
            self.impulse[axis] += step;
            add(velocity, -step, &self.response[axis]);
            change = change.max(step.abs() * self.tangent_mobility);
        }
        change
    }
}
