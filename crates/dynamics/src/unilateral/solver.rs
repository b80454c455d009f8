//! Contact impulses: of the normals exactly, by Newton's method; of friction by projection, in turn with
//! them.
//!
//! # Coordinates
//!
//! The mobility A⁻¹ = K Kᵀ takes impulses Σ Jᵀ p to changes of the velocity. With scaled rows j = J K and y =
//! Σ jᵀ p, a row's velocity is J v − j y, for the free velocity v: both what an impulse does and what a row
//! feels are one product with j, and all impulses together act as the six numbers y.
//!
//! Bodies that contacts push have mobilities of their own, and add six numbers each: a row then has a part for
//! the body in the hand and one, of opposite sign, for the body that the contact pushes.

use arrayvec::ArrayVec;
use glam::DVec3;
use palpate_core::Twist;

use super::normals::{Normals, Side};
use super::pushed::PushedBody;
use super::vector::{Six, Vector, add, dot, sum};
use super::{MAX_UNILATERAL, UnilateralContact};
use crate::system::six;

/// Largest number of passes over the contacts' friction. With fewer, many contacts that slide at once creep.
const MAX_PASSES: u32 = 30;

/// Velocities below this are rounding, m/s.
const MIN_VELOCITY: f64 = 1e-9;

/// Largest change of a contact velocity in a pass, relative to the largest free one, at which the passes
/// end. With more, contacts creep; with less, steps take longer.
const ROUND_TOLERANCE: f64 = 1e-4;

/// Compliance of a contact relative to the body's own mobility along it. Without it the impulses of redundant
/// contacts are not unique and wander; with much more, contacts are felt to yield.
pub(super) const COMPLIANCE: f64 = 1e-3;

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
    /// One over the larger of the two mobilities along the surface.
    mass: f64,
    /// μ.
    coefficient: f64,
    impulse: [f64; 2],
}

/// Rows of the contacts of a step, stored by the caller since they are large.
#[derive(Default)]
pub(super) struct Rows<const N: usize> {
    normals: Normals<N>,
    rubbing: ArrayVec<Friction<N>, MAX_UNILATERAL>,
}

/// The bodies that contacts act on, with N velocities in all.
pub(super) struct Bodies<'a> {
    /// K of the body in the hand.
    factor: &'a [Six; 6],
    /// Those that contacts push.
    pushed: &'a [PushedBody],
    /// Centre of mass of the body in the hand, m.
    center: DVec3,
}

impl<'a> Bodies<'a> {
    pub fn new(factor: &'a [Six; 6], center: DVec3, pushed: &'a [PushedBody]) -> Self {
        Self { factor, pushed, center }
    }

    /// The scaled row of a unit velocity along an axis at a contact.
    #[inline(always)]
    fn row<const N: usize>(&self, contact: &UnilateralContact, axis: DVec3) -> Vector<N> {
        let mut row = [0.0; N];
        let (held, others) = row.split_at_mut(6);
        held.copy_from_slice(&scaled(self.factor, contact.arm, axis));
        if N > 6
            && let Some(index) = contact.pushed
            && let Some(body) = self.pushed.get(usize::from(index))
            && let Some(part) = others.chunks_exact_mut(6).nth(usize::from(index))
        {
            let felt = body.row(self.center + contact.arm, axis);
            for (entry, felt) in part.iter_mut().zip(felt) {
                *entry = -felt;
            }
        }
        row
    }
}

/// Contacts of one step, with the velocity of the body.
pub(super) struct Solver<'a, const N: usize> {
    contacts: &'a [UnilateralContact],
    free: &'a Twist,
    bodies: &'a Bodies<'a>,
    rows: &'a mut Rows<N>,
    /// y of the normals, and of friction.
    pressed: Vector<N>,
    rubbed: Vector<N>,
    /// Set of the contacts that have friction rows.
    ready: u64,
}

/// The scaled row Kᵀ Jᵀ of a unit velocity along an axis at an arm, for a lower factor K.
#[inline(always)]
fn scaled(factor: &[Six; 6], arm: DVec3, axis: DVec3) -> Six {
    let row = six(axis, arm.cross(axis));
    let mut scaled = [0.0; 6];
    for (k, (entries, value)) in factor.iter().zip(row).enumerate() {
        // In pairs.
        for column in 0..(k + 2) & !1 {
            scaled[column] += value * entries[column];
        }
    }
    scaled
}

impl<'a, const N: usize> Solver<'a, N> {
    /// Prepares contacts, given the free velocity of the body in the hand, for a step of `dt` (s) with a
    /// largest recovery velocity (m/s).
    pub fn new(
        contacts: &'a [UnilateralContact],
        free: &'a Twist,
        bodies: &'a Bodies<'a>,
        (dt, recovery): (f64, f64),
        rows: &'a mut Rows<N>,
    ) -> Self {
        let contacts = &contacts[..contacts.len().min(MAX_UNILATERAL)];
        let mut solver = Self { contacts, free, bodies, rows, pressed: [0.0; N], rubbed: [0.0; N], ready: 0 };
        for (index, contact) in contacts.iter().enumerate() {
            let UnilateralContact { normal, impulse, .. } = *contact;
            let row = bodies.row(contact, normal);
            let excess = contact.excess(free, dt, recovery);
            let stiffness = 1.0 / (COMPLIANCE * dot(&row, &row));
            let impulse_before = normal.dot(impulse);
            solver.rows.normals.push(Side { row, excess, stiffness }, impulse_before > 0.0);
            if impulse != DVec3::ZERO {
                solver.prepare(index);
            }
        }
        solver
    }

    /// Makes the friction rows of a contact, from its impulse in the last step.
    fn prepare(&mut self, index: usize) {
        let UnilateralContact { arm, normal, velocity, friction, impulse, .. } = self.contacts[index];
        if friction.is_nan() || friction <= 0.0 || self.ready & 1 << index != 0 {
            return;
        }
        self.ready |= 1 << index;
        let (first, second) = normal.any_orthonormal_pair();
        let axes = [first, second];
        let rows = axes.map(|axis| self.bodies.row(&self.contacts[index], axis));
        let over = self.free.velocity_at(arm) - velocity;
        let mobility = dot(&rows[0], &rows[0]).max(dot(&rows[1], &rows[1]));
        let impulse = [first.dot(impulse), second.dot(impulse)];
        add(&mut self.rubbed, impulse[0], &rows[0]);
        add(&mut self.rubbed, impulse[1], &rows[1]);
        self.rows.rubbing.push(Friction {
            contact: index as u8,
            axes,
            rows,
            slip: [first.dot(over), second.dot(over)],
            mass: 1.0 / mobility,
            coefficient: friction,
            impulse,
        });
    }

    /// Finds the impulses. Returns the body's velocity with them, and whether they converged.
    pub fn solve(&mut self) -> (Twist, bool) {
        let size = self.rows.normals.largest_excess().max(MIN_VELOCITY);
        let mut converged = self.push(size);
        let mut passes = 0;
        while converged && !self.rows.rubbing.is_empty() {
            let change = self.rub();
            converged = self.push(size);
            passes += 1;
            if change <= ROUND_TOLERANCE * size {
                break;
            }
            if passes == MAX_PASSES {
                converged = false;
            }
        }
        let felt = sum(&self.pressed, &self.rubbed);
        let held: Six = std::array::from_fn(|index| felt[index]);
        let mut moved = [0.0; 6];
        for (moved, entries) in moved.iter_mut().zip(self.bodies.factor) {
            *moved = dot(entries, &held);
        }
        let [vx, vy, vz, wx, wy, wz] = moved;
        let twist = Twist {
            linear: self.free.linear - DVec3::new(vx, vy, vz),
            angular: self.free.angular - DVec3::new(wx, wy, wz),
        };
        (twist, converged)
    }

    /// Finds the normal impulses for given friction. Returns whether the search ended.
    fn push(&mut self, size: f64) -> bool {
        let (pressed, ended) = self.rows.normals.solve(&self.rubbed, size);
        self.pressed = pressed;
        let mut new = self.rows.normals.active() & !self.ready;
        while new != 0 {
            self.prepare(new.trailing_zeros() as usize);
            new &= new - 1;
        }
        ended
    }

    /// Updates the friction of all contacts once, for given normal impulses. Returns the largest change of a
    /// contact's velocity, m/s.
    fn rub(&mut self) -> f64 {
        let Rows { normals, rubbing } = &mut *self.rows;
        let mut felt = sum(&self.pressed, &self.rubbed);
        let mut change: f64 = 0.0;
        for friction in rubbing {
            let pressing = normals.impulse(usize::from(friction.contact));
            let most = if pressing > 0.0 { friction.coefficient * pressing } else { 0.0 };
            change = change.max(friction.rub(most, &mut felt));
        }
        self.rubbed = felt;
        add(&mut self.rubbed, -1.0, &self.pressed);
        change
    }

    /// Writes the impulses back into the contacts.
    pub fn store(rows: &Rows<N>, contacts: &mut [UnilateralContact]) {
        for (index, contact) in contacts.iter_mut().take(MAX_UNILATERAL).enumerate() {
            contact.impulse = contact.normal * rows.normals.impulse(index);
        }
        for friction in &rows.rubbing {
            let ([first, second], [s, t]) = (friction.axes, friction.impulse);
            contacts[usize::from(friction.contact)].impulse += first * s + second * t;
        }
    }
}

impl<const N: usize> Friction<N> {
    /// Updates friction: the impulse that stops the sliding, within the cone of the normal impulse. `most` is
    /// its radius.
    #[inline(always)]
    fn rub(&mut self, most: f64, felt: &mut Vector<N>) -> f64 {
        let Self { rows, slip, mass, impulse, .. } = self;
        if most == 0.0 && *impulse == [0.0; 2] {
            return 0.0;
        }
        let wanted = [
            impulse[0] + (slip[0] - dot(&rows[0], felt)) * *mass,
            impulse[1] + (slip[1] - dot(&rows[1], felt)) * *mass,
        ];
        let square = wanted[0] * wanted[0] + wanted[1] * wanted[1];
        let share = if square > most * most { most / square.sqrt() } else { 1.0 };
        let mut largest: f64 = 0.0;
        for axis in [0, 1] {
            let step = wanted[axis] * share - impulse[axis];
            impulse[axis] += step;
            add(felt, step, &rows[axis]);
            largest = largest.max(step.abs());
        }
        largest / *mass
    }
}
