//! Tests of the studies on coarse sweeps, and of depths against the analytic ones of a disk.

use std::f64::consts::TAU;

use super::curve::Curve;
use super::depth::{HEIGHT, Profile, Sampling};
use super::hand::Hand;
use super::study::{Study, Sweep};

const COARSE: Sampling = Sampling { positions: 48, grid: 96 };

/// Depth and gradient of a disk at `place`, by brute force over its points.
fn exact(diameter: f64, spacing: f64, place: f64) -> (f64, f64) {
    let radius = 0.5 * diameter;
    let overlap = |at: f64| {
        let height = 0.5 * HEIGHT * (TAU * (place + at) / spacing).cos();
        height - radius + (radius * radius - at * at).sqrt()
    };
    let points = (-20_000..=20_000).map(|index| radius * f64::from(index) / 20_000.0);
    let best = points.max_by(|a, b| overlap(*a).total_cmp(&overlap(*b))).unwrap();
    (overlap(best), -TAU / spacing * 0.5 * HEIGHT * (TAU * (place + best) / spacing).sin())
}

#[test]
fn depths_equal_those_of_a_disk() {
    for (diameter, spacing) in [(1e-3, 0.5e-3), (1e-3, 2e-3), (2e-3, 1e-3), (3e-3, 0.7e-3), (3e-3, 8e-3)] {
        let profile = Profile::new(diameter, spacing, &COARSE).unwrap();
        let last = COARSE.positions as f64;
        for (index, (depth, gradient)) in profile.depths.iter().zip(&profile.gradients).enumerate() {
            let place = spacing * index as f64 / last;
            let exact = exact(diameter, spacing, place);
            let case = format!("diameter {diameter}, spacing {spacing}, place {place}: {exact:?}");
            assert!((depth - exact.0).abs() < 5e-6, "{case}, not {depth}");
            // The gradient is discontinuous in the middle of a groove.
            if (place / spacing - 0.5).abs() > 0.06 {
                assert!((gradient - exact.1).abs() < 0.02, "{case}, not {gradient}");
            }
        }
    }
}

fn curves(study: &Study) -> Vec<Curve> {
    let sweep = Sweep::new(13, COARSE);
    study.run("test", &sweep, &[Hand::REFERENCE]).unwrap().remove(0).curves
}

/// The study's condition holds for its curves, and does not for the same curves in the opposite order.
fn check(study: &Study) {
    let mut curves = curves(study);
    assert!((study.judge)(&curves), "{}: {curves:?}", study.title);
    curves.reverse();
    assert!(!(study.judge)(&curves), "{}: {curves:?}", study.title);
}

#[test]
fn smaller_probes_vibrate_more_and_at_smaller_spacing() {
    check(&super::probe_diameter());
}

#[test]
fn force_raises_vibration_and_does_not_move_its_peak() {
    check(&super::applied_force());
}

#[test]
fn speed_raises_vibration_at_large_spacing() {
    check(&super::exploratory_speed());
}
