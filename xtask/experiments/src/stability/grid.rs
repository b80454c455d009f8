//! Grids of cases.

use std::fmt;
use std::str::FromStr;

use crate::progress::each;

/// Resolution of the maps.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Whether to use coarse grids.
    pub quick: bool,
    /// Number of haptic steps in the long session.
    pub steps: u64,
    /// The only cases of scans, or all if there are none here.
    pub scans: Vec<ScanCase>,
}

/// A case of scans, as in the table of their map: files of the held object and of what it touches, mass (kg)
/// and contact rate (Hz).
#[derive(Clone, Debug, PartialEq)]
pub struct ScanCase {
    pub held: String,
    pub touched: String,
    pub mass: f64,
    pub rate: f64,
}

impl fmt::Display for ScanCase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { held, touched, mass, rate } = self;
        write!(f, "{held},{touched},{mass},{rate}")
    }
}

impl FromStr for ScanCase {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts: Vec<&str> = text.split(',').collect();
        let [held, touched, mass, rate] = parts[..] else {
            return Err(format!("{text}: give HELD,TOUCHED,KG,HZ"));
        };
        let number = |text: &str| text.parse().map_err(|_| format!("{text} is not a number"));
        Ok(Self { held: held.into(), touched: touched.into(), mass: number(mass)?, rate: number(rate)? })
    }
}

impl Plan {
    /// Returns one of two grids.
    pub fn choose<T: Clone>(&self, full: &[T], quick: &[T]) -> Vec<T> {
        if self.quick { quick.to_vec() } else { full.to_vec() }
    }

    /// Runs each case ([`each`]) and returns the results in their order.
    ///
    /// # Errors
    /// The first error in the order of the cases.
    pub fn each<C: Sync, R: Send>(
        &self,
        name: &str,
        cases: &[C],
        run: impl Fn(&C) -> Result<R, String> + Sync,
    ) -> Result<Vec<R>, String> {
        each(name, cases, run)
    }
}

/// Returns `count` values from `low` to `high` with evenly spaced logarithms.
pub fn logarithmic(low: f64, high: f64, count: usize) -> Vec<f64> {
    let last = count.saturating_sub(1).max(1) as f64;
    (0..count).map(|index| three_digits(low * (high / low).powf(index as f64 / last))).collect()
}

/// Rounds a value to three significant digits, so that tables are readable.
fn three_digits(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}

/// Returns every pair of one of `rows` with one of `columns`, row by row: the order of a heat map's cells.
pub fn pairs<A: Clone, B: Clone>(rows: &[A], columns: &[B]) -> Vec<(A, B)> {
    rows.iter().flat_map(|row| columns.iter().map(|column| (row.clone(), column.clone()))).collect()
}
