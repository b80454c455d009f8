//! Coupling force that saturates at the device's limit (§5.3.3, Fig. 5.4).

use palpate::dynamics::spring_force;
use palpate_report::{Curve, Figure, draw};

use crate::reproduce::outcome::{Finding, Reproduction};
use crate::stability::page::{Table, row};

/// Coupling stiffness k_c, N/m, and largest force of the device, N.
const STIFFNESS: f64 = 200.0;
const LIMIT: f64 = 4.0;
/// Plotted range, in multiples of the deviation at which a linear spring reaches the limit, and number of
/// steps.
const MAX_DEVIATION: f64 = 2.0;
const STEPS: usize = 2000;

/// Features of a force law.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Found {
    /// Force up to which the law is linear, relative to the limit.
    linear: f64,
    /// Largest change of the slope per step, relative to the stiffness.
    jump: f64,
    /// Force at the end relative to the limit, and slope there relative to the stiffness.
    end: f64,
    slope: f64,
    /// Whether the force never decreases.
    grows: bool,
}

impl Found {
    fn of(points: &[(f64, f64)]) -> Self {
        let slopes: Vec<f64> = points
            .windows(2)
            .map(|pair| (pair[1].1 - pair[0].1) / (pair[1].0 - pair[0].0) / STIFFNESS)
            .collect();
        let linear =
            points.iter().take_while(|(deviation, force)| (force - STIFFNESS * deviation).abs() < 1e-9);
        Self {
            linear: linear.last().map_or(0.0, |(_, force)| force / LIMIT),
            jump: slopes.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max),
            end: points.last().map_or(0.0, |(_, force)| force / LIMIT),
            slope: slopes.last().copied().unwrap_or(f64::NAN),
            grows: slopes.iter().all(|slope| *slope >= -1e-9),
        }
    }

    fn is_as_claimed(&self) -> bool {
        let smooth = 10.0 * MAX_DEVIATION / STEPS as f64;
        self.grows
            && (0.5..1.0).contains(&self.linear)
            && self.jump < smooth
            && self.slope.abs() < 1e-9
            && (self.end - 1.0).abs() < 1e-9
    }
}

/// Samples a law as pairs of deviation (m) and force (N).
fn sampled(law: impl Fn(f64) -> f64) -> Vec<(f64, f64)> {
    let deviation = |step: usize| step as f64 / STEPS as f64 * MAX_DEVIATION * LIMIT / STIFFNESS;
    (0..=STEPS).map(deviation).map(|deviation| (deviation, law(deviation))).collect()
}

fn coupling(deviation: f64) -> f64 {
    spring_force(STIFFNESS, deviation, LIMIT).0
}

/// Repeats the experiment.
///
/// # Errors
/// If it cannot be drawn.
pub fn reproduce(name: &str) -> Result<Reproduction, String> {
    let points = sampled(coupling);
    let found = Found::of(&points);
    let rows = points.iter().map(|&(deviation, force)| row![deviation, force]);
    let scaled = points.iter().map(|(deviation, force)| (1e3 * deviation, *force));
    let figure = Figure {
        caption: "Non-linear coupling stiffness (Fig. 5.4).".to_owned(),
        across: "coupling deviation, mm".to_owned(),
        axis: "coupling force, N".to_owned(),
        curves: vec![Curve { name: "coupling force".to_owned(), points: scaled.collect() }],
    };
    Ok(Reproduction {
        finding: Finding {
            claim: "The coupling's force is linear for small deviations, then a cubic, and constant where it saturates."
                .to_owned(),
            measured: format!(
                "With {STIFFNESS} N/m and a device of {LIMIT} N the force is linear up to {:.1} % of that, never falls, ends at \
                 {:.3} of it with a slope of {:.1e} of the stiffness, and its slope changes by {:.2} % at most in one of {STEPS} steps.",
                100.0 * found.linear,
                found.end,
                found.slope,
                100.0 * found.jump
            ),
            condition: "It is linear up to half of the limit or more, never falls, is constant at the limit in the end, and its slope \
                        has no jumps."
                .to_owned(),
            holds: found.is_as_claimed(),
        },
        table: Table { name: name.to_owned(), columns: vec!["deviation_m", "force_n"], rows: rows.collect() },
        timing: None,
        plot: draw(&[figure]).map_err(|error| error.to_string())?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spring_that_is_cut_off_or_does_not_saturate_fails() {
        assert!(Found::of(&sampled(coupling)).is_as_claimed());
        for law in [
            |x: f64| STIFFNESS * x,
            |x: f64| (STIFFNESS * x).min(LIMIT),
            |x: f64| LIMIT * (STIFFNESS * x / LIMIT).tanh(),
        ] {
            let found = Found::of(&sampled(law));
            assert!(!found.is_as_claimed(), "{found:?}");
        }
    }
}
