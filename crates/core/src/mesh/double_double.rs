//! Numbers of twice the precision of f64 (some 32 digits) as unevaluated sums of two of them, with Dekker's
//! and Knuth's error-free transformations (Dekker, *A floating-point technique for extending the available
//! precision*, 1971).
//!
//! The terms of a polyhedral integral are as large as the extent of the mesh to the third to fifth power,
//! however little volume it encloses; twice the digits keep the small difference that is left of them. No
//! fused multiply-add is used: on targets without the instruction it is a slow library call.

use std::ops::{Add, AddAssign, Mul, Sub};

/// A sum of two f64, the second no larger than half a unit in the last place of the first.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct DoubleDouble {
    high: f64,
    low: f64,
}

impl DoubleDouble {
    /// `a + b` without error.
    pub(super) fn sum(a: f64, b: f64) -> Self {
        let high = a + b;
        let b_part = high - a;
        Self { high, low: (a - (high - b_part)) + (b - b_part) }
    }

    /// `a − b` without error.
    pub(super) fn difference(a: f64, b: f64) -> Self {
        Self::sum(a, -b)
    }

    /// The nearest f64.
    pub(super) fn value(self) -> f64 {
        self.high + self.low
    }

    /// The product with a power of two, which is exact unless it leaves the range of f64.
    pub(super) fn scaled(self, power_of_two: f64) -> Self {
        Self { high: self.high * power_of_two, low: self.low * power_of_two }
    }

    /// `high + low`, where `|low| ≤ |high|` or `high` is 0.
    fn normalized(high: f64, low: f64) -> Self {
        let sum = high + low;
        Self { high: sum, low: low - (sum - high) }
    }
}

/// The upper 26 bits of the significand and the rest (Veltkamp); `a` must be below 2⁹⁹⁶.
fn split(a: f64) -> (f64, f64) {
    const FACTOR: f64 = 134_217_729.0; // 2²⁷ + 1
    let scaled = FACTOR * a;
    let upper = scaled - (scaled - a);
    (upper, a - upper)
}

impl Add for DoubleDouble {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        let high = Self::sum(self.high, other.high);
        let low = Self::sum(self.low, other.low);
        let partial = Self::normalized(high.high, high.low + low.high);
        Self::normalized(partial.high, partial.low + low.low)
    }
}

impl AddAssign for DoubleDouble {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Sub for DoubleDouble {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        self + Self { high: -other.high, low: -other.low }
    }
}

impl Mul for DoubleDouble {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        let product = self.high * other.high;
        let (a, a_rest) = split(self.high);
        let (b, b_rest) = split(other.high);
        let error = ((a * b - product) + a * b_rest + a_rest * b) + a_rest * b_rest;
        Self::normalized(product, error + (self.high * other.low + self.low * other.high))
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    use super::*;

    /// A double-double as an integer multiple of 2⁻¹²⁰; exact for the sizes used here.
    fn units(x: DoubleDouble) -> i128 {
        let part = |f: f64| {
            let scaled = f * 2f64.powi(120);
            assert!(scaled.abs() < 2f64.powi(126));
            scaled as i128
        };
        part(x.high) + part(x.low)
    }

    #[test]
    fn arithmetic_agrees_with_integers() {
        const SEED: u64 = 7;
        let mut random = StdRng::seed_from_u64(SEED);
        for _ in 0..100_000 {
            // 40-bit integers in units of 2⁻⁶⁰, so that sums of products are integers in units of 2⁻¹²⁰.
            let mut integer = || random.random_range(-(1i64 << 40)..1 << 40);
            let (a, b, c, d) = (integer(), integer(), integer(), integer());
            let number = |i: i64| DoubleDouble::difference(i as f64 * 2f64.powi(-60), 0.0);
            let exact = i128::from(a) * i128::from(b) - i128::from(c) * i128::from(d);
            let ours = number(a) * number(b) - number(c) * number(d);
            assert_eq!(units(ours), exact, "seed {SEED}: {a} {b} {c} {d}");
        }
    }

    #[test]
    fn differences_keep_digits_that_f64_loses() {
        let far = DoubleDouble::difference(1e16, 1.0) - DoubleDouble::difference(1e16, 0.0);
        assert_eq!(far.value(), -1.0);
        assert_eq!((far * far).scaled(0.5).value(), 0.5);
    }
}
