//! Normal impulses: p ≥ 0 with (W + c) p ≥ q and p · ((W + c) p − q) = 0, for the approach q without them and
//! W = j jᵀ in scaled rows j (see [`solver`](super::solver)).
//!
//! With y = Σ jᵀ p the impulses are p = max(0, q − j y) / c, and y is where
//!
//! φ(y) = ½ ‖y‖² + Σ max(0, q − j y)² / 2 c
//!
//! is least: as many unknowns as velocities, however many contacts there are, and a matrix 1 + Σ jᵀ j / c
//! over those that push. φ is convex and quadratic between changes of that set. Newton's method takes whole
//! steps, which mostly reach the least value in a few; should it not, it goes on to the least value along
//! each step, which ends after finitely many.

use arrayvec::ArrayVec;

use super::MAX_CONSTRAINTS;
use crate::algebra::vector::{Vector, add, dot, identity, sum};

/// Number of whole steps. With fewer, many contacts that change at once take longer.
const WHOLE_STEPS: u32 = 10;

/// Largest number of steps. With fewer, a body that meets many surfaces at once overlaps some of them.
const MAX_STEPS: u32 = WHOLE_STEPS + 3 * MAX_CONSTRAINTS as u32;

/// Number of times that a search along a step halves an interval.
const HALVINGS: u32 = 30;

/// Approach that is rounding, relative to the largest without impulses.
const ROUNDING: f64 = 1e-13;

/// The normal of one contact.
#[derive(Clone, Copy)]
pub(super) struct Side<const N: usize> {
    /// j: the scaled row.
    pub row: Vector<N>,
    /// Approach beyond its limit without any impulse, m/s.
    pub excess: f64,
    /// 1 / c.
    pub stiffness: f64,
}

/// The normals of a step's contacts.
#[derive(Default)]
pub(super) struct Normals<const N: usize> {
    sides: ArrayVec<Side<N>, MAX_CONSTRAINTS>,
    /// Approaches beyond their limits with the impulses of the last solution, m/s.
    over: ArrayVec<f64, MAX_CONSTRAINTS>,
    /// Set of those that push.
    active: u64,
    system: System<N>,
}

/// The linear system of a set: friction changes only its right-hand side.
struct System<const N: usize> {
    set: u64,
    /// 1 + Σ jᵀ j / c, only on and right of the diagonal, and its factors.
    matrix: [Vector<N>; N],
    factors: Factors<N>,
    /// Σ jᵀ q / c for the approaches q without any impulse.
    right: Vector<N>,
}

impl<const N: usize> Default for System<N> {
    /// The system of the empty set.
    fn default() -> Self {
        let factors = Factors { upper: identity(), inverse: [1.0; N] };
        Self { set: 0, matrix: identity(), factors, right: [0.0; N] }
    }
}

/// Factors of 1 + Σ jᵀ j / c: U of its LDLᵀ decomposition with U = D Lᵀ, and one over the pivots.
struct Factors<const N: usize> {
    upper: [Vector<N>; N],
    inverse: Vector<N>,
}

impl<const N: usize> Factors<N> {
    /// Factorises a matrix of which only entries on and right of the diagonal are read.
    #[inline]
    fn new(mut upper: [Vector<N>; N]) -> Self {
        let mut inverse = [0.0; N];
        for column in 0..N {
            let pivot_row = upper[column];
            inverse[column] = 1.0 / pivot_row[column];
            for row in column + 1..N {
                let factor = pivot_row[row] * inverse[column];
                add(&mut upper[row], -factor, &pivot_row);
            }
        }
        Self { upper, inverse }
    }

    #[inline]
    fn solve(&self, mut right: Vector<N>) -> Vector<N> {
        for column in 0..N {
            right[column] *= self.inverse[column];
            let value = right[column];
            for (row, entry) in self.upper[column].iter().enumerate().skip(column + 1) {
                right[row] -= entry * value;
            }
        }
        for row in (0..N).rev() {
            for column in row + 1..N {
                right[row] -= self.upper[row][column] * self.inverse[row] * right[column];
            }
        }
        right
    }
}

/// Members of a set, by index.
#[inline(always)]
fn members(mut set: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let index = set.trailing_zeros() as usize;
        set &= set.wrapping_sub(1);
        (index < 64).then_some(index)
    })
}

impl<const N: usize> System<N> {
    /// Changes the set.
    fn change(&mut self, set: u64, sides: &[Side<N>]) {
        if set == self.set {
            return;
        }
        if self.set & !set != 0 {
            *self = Self::default();
        }
        for side in members(set & !self.set).filter_map(|index| sides.get(index)) {
            for (k, entries) in self.matrix.iter_mut().enumerate() {
                let gain = side.stiffness * side.row[k];
                // In pairs.
                let from = k & !1;
                for (entry, along) in entries[from..].iter_mut().zip(&side.row[from..]) {
                    *entry += gain * along;
                }
            }
            add(&mut self.right, side.stiffness * side.excess, &side.row);
        }
        self.set = set;
        self.factors = Factors::new(self.matrix);
    }

    /// Where φ would be least, given y of all others, if just the contacts of the set pushed: with q − j
    /// y_others in place of q, the right-hand side is Σ jᵀ q / c less the matrix without its 1 times
    /// y_others.
    fn least(&self, others: &Vector<N>) -> Vector<N> {
        let mut right = self.right;
        for row in 0..N {
            right[row] += others[row];
            for (column, other) in others.iter().enumerate() {
                right[row] -= self.matrix[row.min(column)][row.max(column)] * other;
            }
        }
        self.factors.solve(right)
    }
}

impl<const N: usize> Normals<N> {
    /// Adds a contact, and whether it pushed in the last step.
    #[inline(always)]
    pub fn push(&mut self, side: Side<N>, pushed: bool) {
        self.active |= u64::from(pushed) << self.sides.len();
        self.over.push(0.0);
        self.sides.push(side);
    }

    /// The contacts.
    pub fn sides(&self) -> &[Side<N>] {
        &self.sides
    }

    /// Changes the approach of a contact beyond its limit, before the first search, m/s.
    pub fn change_excess(&mut self, index: usize, by: f64) {
        if let Some(side) = self.sides.get_mut(index) {
            side.excess += by;
        }
    }

    /// Impulse of a contact, N·s.
    #[inline(always)]
    pub fn impulse(&self, index: usize) -> f64 {
        self.sides[index].stiffness * self.over[index].max(0.0)
    }

    /// Set of the contacts that push.
    pub fn active(&self) -> u64 {
        self.active
    }

    /// Largest size of an approach beyond its limit without any impulse, m/s.
    pub fn largest_excess(&self) -> f64 {
        self.sides.iter().fold(0.0, |most, side| most.max(side.excess.abs()))
    }

    /// Finds the impulses, given y of all others, where the largest approach is about `size` (m/s). Returns y
    /// of the normals, and whether the search ended.
    pub fn solve(&mut self, others: &Vector<N>, size: f64) -> (Vector<N>, bool) {
        for _ in 0..WHOLE_STEPS {
            self.system.change(self.active, &self.sides);
            let y = self.system.least(others);
            let (next, differs) = self.approach(&sum(&y, others), size);
            let before = std::mem::replace(&mut self.active, next);
            if !differs {
                return (if next == before { y } else { self.pressed() }, true);
            }
        }
        self.search(others, size)
    }

    /// Finds the impulses by steps along which φ falls.
    #[cold]
    fn search(&mut self, others: &Vector<N>, size: f64) -> (Vector<N>, bool) {
        let mut y = self.system.least(others);
        for _ in 0..MAX_STEPS {
            let before = self.over.clone();
            self.system.change(self.active, &self.sides);
            let wanted = self.system.least(others);
            let (next, differs) = self.approach(&sum(&wanted, others), size);
            if !differs {
                self.active = next;
                return (self.pressed(), true);
            }
            let share = self.share(&y, &wanted, &before);
            for (y, wanted) in y.iter_mut().zip(wanted) {
                *y += share * (wanted - *y);
            }
            self.active = 0;
            for (index, (over, before)) in self.over.iter_mut().zip(before).enumerate() {
                *over = before + share * (*over - before);
                self.active |= u64::from(*over > 0.0) << index;
            }
        }
        (self.pressed(), false)
    }

    /// Finds the approaches with y of all impulses. Returns the set of those beyond their limits, and whether
    /// it differs from the active set by more than rounding.
    #[inline(always)]
    fn approach(&mut self, y: &Vector<N>, size: f64) -> (u64, bool) {
        let (mut set, mut differs) = (0, false);
        for (index, (side, over)) in self.sides.iter().zip(&mut self.over).enumerate() {
            *over = side.excess - dot(&side.row, y);
            let is_over = u64::from(*over > 0.0);
            set |= is_over << index;
            differs |= is_over != self.active >> index & 1 && over.abs() > ROUNDING * size;
        }
        (set, differs)
    }

    /// The share of a step from y to where the quadratic is least at which φ is least, by the slope of φ;
    /// `before` are the approaches at its start.
    fn share(&self, y: &Vector<N>, wanted: &Vector<N>, before: &[f64]) -> f64 {
        let mut step = *wanted;
        add(&mut step, -1.0, y);
        let slope = |share: f64| {
            let mut slope = dot(&step, y) + share * dot(&step, &step);
            for ((side, over), before) in self.sides.iter().zip(&self.over).zip(before) {
                let change = over - before;
                slope += side.stiffness * (before + share * change).max(0.0) * change;
            }
            slope
        };
        if slope(1.0) <= 0.0 {
            return 1.0;
        }
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if slope(middle) > 0.0 { high = middle } else { low = middle }
        }
        high
    }

    /// y of the impulses.
    fn pressed(&self) -> Vector<N> {
        let mut pressed = [0.0; N];
        for index in members(self.active) {
            add(&mut pressed, self.impulse(index), &self.sides[index].row);
        }
        pressed
    }
}

#[cfg(test)]
mod tests;
