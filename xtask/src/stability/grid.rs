//! Grids of cases, worked through in parallel with results in order.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use rayon::prelude::*;

/// How thorough to be.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    /// Coarse grids.
    pub quick: bool,
    /// Haptic steps of the long session.
    pub steps: u64,
}

impl Plan {
    /// One of two grids.
    pub fn choose<T: Clone>(&self, full: &[T], quick: &[T]) -> Vec<T> {
        if self.quick { quick.to_vec() } else { full.to_vec() }
    }

    /// The result of each case, in the order of the cases, whatever the number of threads. Progress is shown on the
    /// standard error stream.
    ///
    /// # Errors
    /// The first error in the order of the cases.
    pub fn each<C: Sync, R: Send>(
        &self,
        name: &str,
        cases: &[C],
        run: impl Fn(&C) -> Result<R, String> + Sync,
    ) -> Result<Vec<R>, String> {
        let bar =
            ProgressBar::with_draw_target(Some(cases.len() as u64), ProgressDrawTarget::stderr_with_hz(4));
        if let Ok(style) = ProgressStyle::with_template("{msg:12} {bar:32} {pos}/{len} {eta}") {
            bar.set_style(style);
        }
        bar.set_message(name.to_owned());
        let results: Vec<Result<R, String>> = cases
            .par_iter()
            .map(|case| {
                let result = run(case);
                bar.inc(1);
                result
            })
            .collect();
        bar.finish_and_clear();
        results.into_iter().collect()
    }
}

/// `count` values from `low` to `high`, evenly spaced by logarithm.
pub fn logarithmic(low: f64, high: f64, count: usize) -> Vec<f64> {
    let last = count.saturating_sub(1).max(1) as f64;
    (0..count).map(|index| three_digits(low * (high / low).powf(index as f64 / last))).collect()
}

/// The value rounded to three significant digits, so that tables are readable.
fn three_digits(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}

/// Every pair of one of `rows` with one of `columns`, row by row: the order of a heat map's cells.
pub fn pairs<A: Clone, B: Clone>(rows: &[A], columns: &[B]) -> Vec<(A, B)> {
    rows.iter().flat_map(|row| columns.iter().map(|column| (row.clone(), column.clone()))).collect()
}
