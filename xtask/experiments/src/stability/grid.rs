//! Grids of cases.

use crate::progress::each;

/// Resolution of the maps.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    /// Whether to use coarse grids.
    pub quick: bool,
    /// Number of haptic steps in the long session.
    pub steps: u64,
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
