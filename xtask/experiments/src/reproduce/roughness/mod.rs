//! Vibration by texture spacing, compared with perceived roughness (§4.5.1, Figs. 4.8 to 4.10).

mod curve;
mod depth;
mod hand;
mod study;
#[cfg(test)]
mod tests;

pub use study::reproduce;

use curve::Curve;
use hand::Stroke;
use study::{Setup, Study};

/// Default setup of the studies, of which each varies one value: probe diameter (m), force (N) and speed
/// (m/s). The dissertation gives no values; these are ours.
const COMMON: Setup = Setup { diameter: 2e-3, stroke: Stroke { force: 0.5, speed: 0.1 } };

/// Returns the study of Fig. 4.8.
pub fn probe_diameter() -> Study {
    let setups = [1e-3, 2e-3, 3e-3].map(|diameter| Setup { diameter, ..COMMON });
    Study {
        title: "Effects of probe diameter (Fig. 4.8)",
        varied: "probe diameter",
        setups: setups.to_vec(),
        value: |setup| format!("{} mm", 1e3 * setup.diameter),
        claim: "Peaks of acceleration over texture spacing are higher and occur at smaller spacing for smaller probes; a \
                quadratic function in logarithmic scale approximates the graphs well.",
        condition: "Each curve has its maximum within the sweep, and with each smaller probe the maximum is higher and at a \
                    smaller spacing.",
        judge: smaller_probes_peak_higher_and_earlier,
        detail: |curves| {
            let fits: Vec<String> = curves.iter().map(|curve| format!("{:.3}", curve.quadratic())).collect();
            format!("Quadratic functions in logarithms leave R² of {}.", fits.join(", "))
        },
    }
}

/// Returns the study of Fig. 4.9.
pub fn applied_force() -> Study {
    let setup = |force| Setup { stroke: Stroke { force, ..COMMON.stroke }, ..COMMON };
    Study {
        title: "Effects of applied force (Fig. 4.9)",
        varied: "force",
        setups: [0.3, 0.6, 1.2].map(setup).to_vec(),
        value: |setup| format!("{} N", setup.stroke.force),
        claim: "Acceleration grows monotonically with applied force, and the location of the peak is almost insensitive to \
                it.",
        condition: "Each curve has its maximum within the sweep, at every spacing acceleration is larger with a larger force, \
                    and maxima lie within 15 % of each other.",
        judge: force_raises_and_leaves_the_peak,
        detail: |curves| {
            format!("The maxima's places differ by {:.1} %.", 100.0 * (peak_range(curves) - 1.0))
        },
    }
}

/// Returns the study of Fig. 4.10.
pub fn exploratory_speed() -> Study {
    let setup = |speed| Setup { stroke: Stroke { speed, ..COMMON.stroke }, ..COMMON };
    Study {
        title: "Effects of exploratory speed (Fig. 4.10)",
        varied: "speed",
        setups: [0.02, 0.05, 0.1].map(setup).to_vec(),
        value: |setup| format!("{} mm/s", 1e3 * setup.stroke.speed),
        claim: "At large texture spacing acceleration increases with speed; at small spacing it remains almost constant.",
        condition: "At every spacing of 4.5 mm and more acceleration is larger with a higher speed, and at 1 mm and less the \
                    largest is no more than 1.5 times the smallest.",
        judge: speed_counts_where_spacing_is_large,
        detail: |curves| {
            let last: Vec<String> = curves
                .iter()
                .filter_map(|curve| curve.acceleration.last())
                .map(|a| format!("{a:.3}"))
                .collect();
            format!(
                "At 8 mm it is {} m/s²; at 1 mm and less the largest is up to {:.2} times the smallest.",
                last.join(", "),
                curve::spread(curves, MAX_SMALL_SPACING)
            )
        },
    }
}

/// Judges curves in the order of diameters.
fn smaller_probes_peak_higher_and_earlier(curves: &[Curve]) -> bool {
    curves.iter().all(Curve::peaks_within)
        && curves.windows(2).all(|pair| {
            let [small, large] = [pair[0].peak(), pair[1].peak()];
            small.1 > large.1 && small.0 < large.0
        })
}

/// Judges curves in the order of forces.
fn force_raises_and_leaves_the_peak(curves: &[Curve]) -> bool {
    curves.iter().all(Curve::peaks_within)
        && curves.windows(2).all(|pair| pair[0].below(&pair[1], 0.0))
        && peak_range(curves) <= 1.15
}

/// Returns the largest spacing of a maximum over the smallest.
fn peak_range(curves: &[Curve]) -> f64 {
    let places = curves.iter().map(|curve| curve.peak().0);
    let (low, high) = places.fold((f64::INFINITY, 0.0_f64), |(low, high), at| (low.min(at), high.max(at)));
    high / low
}

/// Bounds of large and of small spacings, m.
const MIN_LARGE_SPACING: f64 = 4.5e-3;
const MAX_SMALL_SPACING: f64 = 1e-3;

/// Judges curves in the order of speeds.
fn speed_counts_where_spacing_is_large(curves: &[Curve]) -> bool {
    curves.windows(2).all(|pair| pair[0].below(&pair[1], MIN_LARGE_SPACING))
        && curve::spread(curves, MAX_SMALL_SPACING) <= 1.5
}
