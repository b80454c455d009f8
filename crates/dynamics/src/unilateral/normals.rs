//! Normal impulses: p ≥ 0 with (W + c) p ≥ q and p · ((W + c) p − q) = 0, for the approach q without them and
//! W = j jᵀ in scaled rows j (see [`solver`](super::solver)).
//!
//! With y = Σ jᵀ p the impulses are p = max(0, q − j y) / c, and y is where
//!
//! φ(y) = ½ ‖y‖² + Σ max(0, q − j y)² / 2 c
//!
//! is least: six unknowns, however many contacts there are, and a matrix 1 + Σ jᵀ j / c over those that push.
//! φ is convex and quadratic between changes of that set. Newton's method takes whole steps, which mostly
//! reach the least value in a few; should it not, it goes on to the least value along each step, which ends
//! after finitely many.

use arrayvec::ArrayVec;

use super::MAX_UNILATERAL;
use super::solver::{Six, add, dot};

/// Number of whole steps. With fewer, many contacts that change at once take longer.
const WHOLE_STEPS: u32 = 10;

/// Largest number of steps. With fewer, a body that meets many surfaces at once overlaps some of them.
const MAX_STEPS: u32 = WHOLE_STEPS + 3 * MAX_UNILATERAL as u32;

/// Number of times that a search along a step halves an interval.
const HALVINGS: u32 = 30;

/// Approach that is rounding, relative to the largest without impulses.
const ROUNDING: f64 = 1e-13;

/// The normal of one contact.
#[derive(Clone, Copy)]
pub(super) struct Side {
    /// j: the scaled row.
    pub row: Six,
    /// Approach beyond its limit without any impulse, m/s.
    pub excess: f64,
    /// 1 / c.
    pub stiffness: f64,
}

/// The normals of a step's contacts.
#[derive(Default)]
pub(super) struct Normals {
    sides: ArrayVec<Side, MAX_UNILATERAL>,
    impulses: ArrayVec<f64, MAX_UNILATERAL>,
    /// Set of those that push.
    active: u64,
    /// The factors of the last matrix, and the set that it was made for.
    factors: Factors,
    factored: u64,
}

/// Factors of 1 + Σ jᵀ j / c: U of its LDLᵀ decomposition with U = D Lᵀ, and one over the pivots.
struct Factors {
    upper: [Six; 6],
    inverse: Six,
}

impl Default for Factors {
    /// Factors of the identity, the matrix of the empty set.
    fn default() -> Self {
        Self { upper: IDENTITY, inverse: [1.0; 6] }
    }
}

const IDENTITY: [Six; 6] = {
    let mut identity = [[0.0; 6]; 6];
    let mut i = 0;
    while i < 6 {
        identity[i][i] = 1.0;
        i += 1;
    }
    identity
};

impl Factors {
    /// Factorises a matrix of which only entries on and right of the diagonal are read.
    #[inline]
    fn new(mut upper: [Six; 6]) -> Self {
        let mut inverse = [0.0; 6];
        for column in 0..6 {
            let pivot_row = upper[column];
            inverse[column] = 1.0 / pivot_row[column];
            for row in column + 1..6 {
                let factor = pivot_row[row] * inverse[column];
                add(&mut upper[row], -factor, &pivot_row);
            }
        }
        Self { upper, inverse }
    }

    #[inline]
    fn solve(&self, mut right: Six) -> Six {
        for column in 0..6 {
            right[column] *= self.inverse[column];
            for row in column + 1..6 {
                right[row] -= self.upper[column][row] * right[column];
            }
        }
        for row in (0..6).rev() {
            for column in row + 1..6 {
                right[row] -= self.upper[row][column] * self.inverse[row] * right[column];
            }
        }
        right
    }
}

/// Members of a set, by index.
fn members(mut set: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let index = set.trailing_zeros() as usize;
        set &= set.wrapping_sub(1);
        (index < 64).then_some(index)
    })
}

impl Normals {
    /// Adds a contact, and whether it pushed in the last step.
    #[inline(always)]
    pub fn push(&mut self, side: Side, pushed: bool) {
        self.active |= u64::from(pushed) << self.sides.len();
        self.sides.push(side);
        self.impulses.push(0.0);
    }

    /// Impulses of the contacts, N·s.
    pub fn impulses(&self) -> &[f64] {
        &self.impulses
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
    pub fn solve(&mut self, others: &Six, size: f64) -> (Six, bool) {
        let approach = self.sides.iter().map(|side| side.excess - dot(&side.row, others));
        let approach: ArrayVec<f64, MAX_UNILATERAL> = approach.collect();
        let (mut y, mut over) = ([0.0; 6], approach.clone());
        for step in 0..MAX_STEPS {
            let wanted = self.least(&approach);
            let mut after = ArrayVec::<f64, MAX_UNILATERAL>::new();
            let (mut next, mut differs) = (0, false);
            for (index, (side, approach)) in self.sides.iter().zip(&approach).enumerate() {
                let excess = approach - dot(&side.row, &wanted);
                after.push(excess);
                next |= u64::from(excess > 0.0) << index;
                differs |=
                    (excess > 0.0) != (self.active >> index & 1 != 0) && excess.abs() > ROUNDING * size;
            }
            if !differs {
                return (self.end(&wanted, next, &after), true);
            }
            let share = if step < WHOLE_STEPS { 1.0 } else { self.share(&y, &wanted, &over, &after) };
            for (y, wanted) in y.iter_mut().zip(wanted) {
                *y += share * (wanted - *y);
            }
            self.active = 0;
            for (index, (over, after)) in over.iter_mut().zip(after).enumerate() {
                *over += share * (after - *over);
                self.active |= u64::from(*over > 0.0) << index;
            }
        }
        let (next, over) = (self.active, over);
        (self.end(&y, next, &over), false)
    }

    /// Where φ would be least if just the active contacts pushed.
    fn least(&mut self, approach: &[f64]) -> Six {
        if self.factored != self.active {
            let mut matrix = IDENTITY;
            for side in members(self.active).map(|index| &self.sides[index]) {
                for (entries, along) in matrix.iter_mut().zip(&side.row) {
                    add(entries, side.stiffness * along, &side.row);
                }
            }
            (self.factors, self.factored) = (Factors::new(matrix), self.active);
        }
        let mut right = [0.0; 6];
        for index in members(self.active) {
            let side = &self.sides[index];
            add(&mut right, side.stiffness * approach[index], &side.row);
        }
        self.factors.solve(right)
    }

    /// The share of a step from y to where the quadratic is least at which φ is least, by the slope of φ.
    fn share(&self, y: &Six, wanted: &Six, over: &[f64], after: &[f64]) -> f64 {
        let step: Six = std::array::from_fn(|k| wanted[k] - y[k]);
        let slope = |share: f64| {
            let mut slope = dot(&step, y) + share * dot(&step, &step);
            for ((side, over), after) in self.sides.iter().zip(over).zip(after) {
                let change = after - over;
                slope += side.stiffness * (over + share * change).max(0.0) * change;
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

    /// Sets the impulses of a set by approaches with them. Returns their y, which is `y` up to rounding.
    fn end(&mut self, y: &Six, set: u64, over: &[f64]) -> Six {
        let same = set == self.active;
        self.active = set;
        for ((impulse, side), over) in self.impulses.iter_mut().zip(&self.sides).zip(over) {
            *impulse = side.stiffness * over.max(0.0);
        }
        if same {
            return *y;
        }
        let mut pressed = [0.0; 6];
        for index in members(set) {
            add(&mut pressed, self.impulses[index], &self.sides[index].row);
        }
        pressed
    }
}
