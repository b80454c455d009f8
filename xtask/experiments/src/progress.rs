//! Cases worked through in parallel with results in order.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use rayon::prelude::*;

/// The result of each case, in the order of the cases, whatever the number of threads. Progress is shown on
/// the standard error stream.
///
/// # Errors
/// The first error in the order of the cases.
pub fn each<C: Sync, R: Send>(
    name: &str,
    cases: &[C],
    run: impl Fn(&C) -> Result<R, String> + Sync,
) -> Result<Vec<R>, String> {
    let bar = ProgressBar::with_draw_target(Some(cases.len() as u64), ProgressDrawTarget::stderr_with_hz(4));
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
