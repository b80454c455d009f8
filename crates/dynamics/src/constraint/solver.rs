//! Contact impulses: of the normals exactly, by Newton's method; of friction by projection, in turn with
//! them.
//!
//! # Coordinates
//!
//! The mobility A⁻¹ = K Kᵀ takes impulses Σ Jᵀ p to changes of the velocity. With scaled rows j = J K and y =
//! Σ jᵀ p, a row's velocity is J v − j y, for the free velocity v: both what an impulse does and what a row
//! feels are one product with j, and all impulses together act as the six numbers y.
//!
//! Bodies that contacts push have mobilities of their own, and add six numbers each: a row then has a part
//! for the tool and one, of opposite sign, for the body that the contact pushes.

use arrayvec::ArrayVec;
use glam::DVec3;
use palpate_core::Twist;

use super::normals::{Normals, Side};
use super::overlaps::shared;
use super::pushed::Pushed;
use super::{Constraint, MAX_CONSTRAINTS};
use crate::algebra::vector::{Six, Vector, add, dot, sum};
use crate::system::six;

/// Largest number of passes over the contacts' friction. With fewer, many contacts that slide at once creep.
const MAX_PASSES: u32 = 30;

/// Velocities below this are rounding, m/s.
const MIN_VELOCITY: f64 = 1e-9;

/// Largest change of a contact velocity in a pass, relative to the largest free one, at which the passes
/// end. With more, contacts creep; with less, steps take longer.
pub(super) const ROUND_TOLERANCE: f64 = 1e-4;

/// Compliance of a contact relative to the body's own mobility along it. Without it the impulses of redundant
/// contacts are not unique and wander; with much more, contacts are felt to yield.
pub(super) const COMPLIANCE: f64 = 1e-4;

/// Share of the last step's impulse to which overlaps that are held do not yield: nothing else undoes what
/// they grow by. With less, a body that is pressed into a wedge creeps into its walls; with 1, walls that
/// squeeze it never relax.
const UNYIELDING: f64 = 0.9;

/// Depth to which this holds, m at the device; from twice as deep, overlaps yield. With less, bodies creep
/// into wedges; with more, walls that squeeze a body that starts between them drag at it.
pub(crate) const SHALLOW: f64 = 2e-5;

/// Friction of one contact that has pushed.
#[derive(Clone, Copy)]
struct Friction<const N: usize> {
    /// Index of the contact.
    contact: u8,
    /// Orthonormal tangents.
    axes: [DVec3; 2],
    /// Scaled rows along them.
    rows: [Vector<N>; 2],
    /// Velocity over the surface without impulses, m/s.
    slip: [f64; 2],
    /// The larger of the two mobilities along the surface, and one over it.
    mobility: f64,
    mass: f64,
    /// μ.
    coefficient: f64,
    impulse: [f64; 2],
}

/// Rows of the contacts of a step, stored by the caller since they are large.
#[derive(Default)]
pub(crate) struct Rows<const N: usize> {
    normals: Normals<N>,
    rubbing: ArrayVec<Friction<N>, MAX_CONSTRAINTS>,
}

/// What contacts act on, with N velocities in all: the tool and the bodies that it pushes.
pub(crate) trait Moved<const N: usize> {
    /// The scaled row of a unit velocity along an axis at a contact of the tool.
    fn row(&self, index: usize, contact: &Constraint, axis: DVec3) -> Vector<N>;

    /// Free velocity of the tool's body that a contact is on.
    fn free(&self, index: usize) -> &Twist;
}

/// Writes the part of a contact's scaled row that is of the body that it pushes. The contact's arm is from
/// `center`, m.
#[inline(always)]
pub(crate) fn push_row(
    row: &mut [f64],
    pushed: &Pushed<'_>,
    contact: &Constraint,
    (center, axis): (DVec3, DVec3),
) {
    let Some((slot, body)) = pushed.of(contact) else { return };
    if let Some(part) = row.chunks_exact_mut(6).nth(slot) {
        let felt = body.row(center + contact.arm, axis);
        for (entry, felt) in part.iter_mut().zip(felt) {
            *entry = -felt;
        }
    }
}

/// One body, and those that it pushes.
pub(super) struct Single<'a> {
    pub free: &'a Twist,
    /// K.
    pub factor: &'a [Six; 6],
    /// Centre of mass, m.
    pub center: DVec3,
    pub pushed: &'a Pushed<'a>,
}

impl<const N: usize> Moved<N> for Single<'_> {
    #[inline(always)]
    fn row(&self, _: usize, contact: &Constraint, axis: DVec3) -> Vector<N> {
        let mut row = [0.0; N];
        let (held, others) = row.split_at_mut(6);
        held.copy_from_slice(&scaled(self.factor, &six(axis, contact.arm.cross(axis))));
        if N > 6 {
            push_row(others, self.pushed, contact, (self.center, axis));
        }
        row
    }

    #[inline(always)]
    fn free(&self, _: usize) -> &Twist {
        self.free
    }
}

/// Contacts of one step.
pub(crate) struct Solver<'a, M: Moved<N>, const N: usize> {
    contacts: &'a [Constraint],
    moved: &'a M,
    rows: &'a mut Rows<N>,
    /// y of the normals, and of friction.
    pressed: Vector<N>,
    rubbed: Vector<N>,
    /// Set of the contacts that have friction rows.
    ready: u64,
}

/// The scaled row Kᵀ Jᵀ, for a lower factor K.
#[inline(always)]
pub(crate) fn scaled<const D: usize>(factor: &[Vector<D>; D], row: &Vector<D>) -> Vector<D> {
    let mut scaled = [0.0; D];
    for (k, (entries, value)) in factor.iter().zip(row).enumerate() {
        // In pairs.
        for column in 0..((k + 2) & !1).min(D) {
            scaled[column] += value * entries[column];
        }
    }
    scaled
}

impl<'a, M: Moved<N>, const N: usize> Solver<'a, M, N> {
    /// Prepares contacts of what they move for a step of `dt` (s) with a largest recovery velocity (m/s), and
    /// the depth of shallow overlaps (m).
    pub fn new(
        contacts: &'a [Constraint],
        moved: &'a M,
        (dt, recovery, shallow): (f64, f64, f64),
        rows: &'a mut Rows<N>,
    ) -> Self {
        let contacts = &contacts[..contacts.len().min(MAX_CONSTRAINTS)];
        let mut solver = Self { contacts, moved, rows, pressed: [0.0; N], rubbed: [0.0; N], ready: 0 };
        for (index, contact) in contacts.iter().enumerate() {
            let Constraint { normal, impulse, .. } = *contact;
            let row = moved.row(index, contact, normal);
            let over = contact.velocity_over(moved.free(index));
            let excess = contact.excess_of(over, dt, recovery);
            let stiffness = 1.0 / (COMPLIANCE * dot(&row, &row));
            let impulse_before = normal.dot(impulse);
            solver.rows.normals.push(Side { row, excess, stiffness }, impulse_before > 0.0);
            if impulse != DVec3::ZERO {
                solver.prepare(index, over);
            }
        }
        let normals = &mut solver.rows.normals;
        if let Some(velocities) = shared(contacts, normals.sides(), (dt, recovery)) {
            for (index, (contact, velocity)) in contacts.iter().zip(velocities).enumerate() {
                if contact.gap < 0.0 {
                    let wanted = contact.wanted(recovery);
                    let held = if wanted > 0.0 { 1.0 - velocity / wanted } else { 1.0 };
                    let unyielding = UNYIELDING * held * (2.0 + contact.gap / shallow).clamp(0.0, 1.0);
                    let pressed = contact.normal.dot(contact.impulse).max(0.0);
                    let yielded = pressed / normals.sides()[index].stiffness;
                    normals.change_excess(index, velocity - wanted + unyielding * yielded);
                }
            }
        }
        solver
    }

    /// Makes the friction rows of a contact, from its impulse in the last step. `over` is its velocity over
    /// the surface without impulses, m/s.
    #[inline(always)]
    fn prepare(&mut self, index: usize, over: DVec3) {
        let Constraint { normal, friction, impulse, .. } = self.contacts[index];
        if friction.is_nan() || friction <= 0.0 || self.ready & 1 << index != 0 {
            return;
        }
        self.ready |= 1 << index;
        let (first, second) = normal.any_orthonormal_pair();
        let contact = &self.contacts[index];
        let rows = [self.moved.row(index, contact, first), self.moved.row(index, contact, second)];
        let mobility = dot(&rows[0], &rows[0]).max(dot(&rows[1], &rows[1]));
        let impulse = [first.dot(impulse), second.dot(impulse)];
        add(&mut self.rubbed, impulse[0], &rows[0]);
        add(&mut self.rubbed, impulse[1], &rows[1]);
        self.rows.rubbing.push(Friction {
            contact: index as u8,
            axes: [first, second],
            rows,
            slip: [first.dot(over), second.dot(over)],
            mobility,
            mass: 1.0 / mobility,
            coefficient: friction,
            impulse,
        });
    }

    /// Finds the impulses. Returns y of all of them, and whether they converged.
    pub fn solve(&mut self) -> (Vector<N>, bool) {
        let size = self.rows.normals.largest_excess().max(MIN_VELOCITY);
        let mut converged = self.push(size);
        let mut passes = 0;
        while converged && !self.rows.rubbing.is_empty() && self.rub() > ROUND_TOLERANCE * size {
            passes += 1;
            converged = self.push(size) && passes < MAX_PASSES;
        }
        (sum(&self.pressed, &self.rubbed), converged)
    }

    /// Finds the normal impulses for given friction. Returns whether the search ended.
    fn push(&mut self, size: f64) -> bool {
        let (pressed, ended) = self.rows.normals.solve(&self.rubbed, size);
        self.pressed = pressed;
        let new = self.rows.normals.active() & !self.ready;
        if new != 0 {
            self.prepare_all(new);
        }
        ended
    }

    /// Makes the friction rows of a set of contacts.
    #[cold]
    fn prepare_all(&mut self, mut set: u64) {
        while set != 0 {
            let index = set.trailing_zeros() as usize;
            self.prepare(index, self.contacts[index].velocity_over(self.moved.free(index)));
            set &= set - 1;
        }
    }

    /// Updates the friction of all contacts once, for given normal impulses. Returns the largest change of a
    /// contact's velocity, m/s.
    fn rub(&mut self) -> f64 {
        let Rows { normals, rubbing } = &mut *self.rows;
        let mut felt = Felt { base: sum(&self.pressed, &self.rubbed), along: [0.0; N], share: 0.0 };
        let mut change: f64 = 0.0;
        for friction in rubbing {
            let pressing = normals.impulse(usize::from(friction.contact));
            let most = if pressing > 0.0 { friction.coefficient * pressing } else { 0.0 };
            change = change.max(friction.rub(most, &mut felt));
        }
        self.rubbed = felt.sum();
        add(&mut self.rubbed, -1.0, &self.pressed);
        change
    }
}

impl<const N: usize> Rows<N> {
    /// Writes the impulses back into the contacts.
    pub fn store(&self, contacts: &mut [Constraint]) {
        for (index, contact) in contacts.iter_mut().take(MAX_CONSTRAINTS).enumerate() {
            contact.impulse = contact.normal * self.normals.impulse(index);
        }
        for friction in &self.rubbing {
            let ([first, second], [s, t]) = (friction.axes, friction.impulse);
            contacts[usize::from(friction.contact)].impulse += first * s + second * t;
        }
    }
}

/// y of all impulses, as a sum with a share that is known late: products with the rest do not wait for it.
struct Felt<const N: usize> {
    base: Vector<N>,
    along: Vector<N>,
    share: f64,
}

impl<const N: usize> Felt<N> {
    #[inline(always)]
    fn sum(&self) -> Vector<N> {
        let mut sum = self.base;
        add(&mut sum, self.share, &self.along);
        sum
    }

    /// What a row feels.
    #[inline(always)]
    fn dot(&self, row: &Vector<N>) -> f64 {
        dot(row, &self.base) + self.share * dot(row, &self.along)
    }
}

impl<const N: usize> Friction<N> {
    /// Updates friction: the impulse that stops the sliding, within the cone of the normal impulse. `most` is
    /// its radius.
    #[inline(always)]
    fn rub(&mut self, most: f64, felt: &mut Felt<N>) -> f64 {
        let Self { rows: [first, second], slip, mobility, mass, impulse, .. } = self;
        if most == 0.0 && *impulse == [0.0; 2] {
            return 0.0;
        }
        let [s, t] = *impulse;
        let wanted =
            [s + slip[0] * *mass - felt.dot(first) * *mass, t + slip[1] * *mass - felt.dot(second) * *mass];
        let square = wanted[0] * wanted[0] + wanted[1] * wanted[1];
        // Division and root run at the same time.
        let share = if square > most * most { square.sqrt() * (most / square) } else { 1.0 };
        let (mut base, mut along) = (felt.sum(), [0.0; N]);
        add(&mut base, -s, first);
        add(&mut base, -t, second);
        add(&mut along, wanted[0], first);
        add(&mut along, wanted[1], second);
        *felt = Felt { base, along, share };
        *impulse = [wanted[0] * share, wanted[1] * share];
        (impulse[0] - s).abs().max((impulse[1] - t).abs()) * *mobility
    }
}
