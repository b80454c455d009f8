//! Differences between the wrenches of two profiles.

use palpate::Wrench;
use palpate::glam::DVec3;
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;
use serde::Serialize;

use crate::experiment::Trace;
use crate::profile::Profile;
use crate::statistics::{mean, quantile};

/// Lowest frequency that counts as vibration, Hz: the hand itself moves more slowly.
pub const VIBRATION_FREQUENCY: f64 = 20.0;

/// Deviation of forces, or torques, from exact ones, over the states in which either is not zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Deviation {
    /// Root mean square of the exact vectors, as a scale for the others, N or N·m.
    pub exact_rms: f64,
    /// Mean length of the difference, N or N·m.
    pub mean: f64,
    /// 99th percentile of the length of the difference, N or N·m.
    pub p99: f64,
    /// Correlation of the vectors; 1 if both are constant.
    pub correlation: f64,
    /// Vibration: root mean square above [`VIBRATION_FREQUENCY`], N or N·m.
    pub vibration: f64,
    /// Vibration of the exact vectors, N or N·m.
    pub exact_vibration: f64,
}

/// Difference between a profile and an exact one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Difference {
    /// Deviation of forces, N.
    pub force: Deviation,
    /// Deviation of torques about the object's centre of mass, N·m.
    pub torque: Deviation,
}

impl Difference {
    /// Compares two profiles along one path with `rate` states per second (Hz).
    pub fn of(found: &Profile, exact: &Profile, rate: f64) -> Self {
        Self::of_wrenches(&found.wrenches, &exact.wrenches, rate)
    }

    /// Compares the wrenches at the device in two traces of the same hand. One haptic rate has to be a
    /// multiple of the other. The vibration of each is computed at its own rate.
    pub fn felt(found: &Trace, exact: &Trace) -> Self {
        let rate = found.rate.min(exact.rate);
        let thinned = |trace: &Trace| -> Vec<Wrench> {
            let every = (trace.rate / rate).round() as usize;
            trace.samples.iter().skip(every - 1).step_by(every).map(|sample| sample.record.coupling).collect()
        };
        let mut difference = Self::of_wrenches(&thinned(found), &thinned(exact), rate);
        let vibration = |trace: &Trace| {
            let above = |part: fn(&Wrench) -> DVec3| {
                let vectors: Vec<DVec3> =
                    trace.samples.iter().map(|sample| part(&sample.record.coupling)).collect();
                rms_above(VIBRATION_FREQUENCY, &vectors, trace.rate)
            };
            (above(|wrench| wrench.force), above(|wrench| wrench.torque))
        };
        (difference.force.vibration, difference.torque.vibration) = vibration(found);
        (difference.force.exact_vibration, difference.torque.exact_vibration) = vibration(exact);
        difference
    }

    /// Compares two sequences of wrenches, `rate` per second (Hz), over the length of the shorter one.
    pub fn of_wrenches(found: &[Wrench], exact: &[Wrench], rate: f64) -> Self {
        let part = |of: fn(&Wrench) -> DVec3| {
            let vectors = |wrenches: &[Wrench]| wrenches.iter().map(of).collect::<Vec<_>>();
            Deviation::of(&vectors(found), &vectors(exact), rate)
        };
        Self { force: part(|wrench| wrench.force), torque: part(|wrench| wrench.torque) }
    }
}

impl Deviation {
    /// Relative deviation: the larger of the mean difference and the additional vibration, as a part of the
    /// exact vectors' root mean square. 0 if the exact vectors are zero.
    pub fn relative(&self) -> f64 {
        let deviation = self.mean.max(self.vibration - self.exact_vibration);
        if self.exact_rms > 0.0 { deviation / self.exact_rms } else { 0.0 }
    }

    fn of(found: &[DVec3], exact: &[DVec3], rate: f64) -> Self {
        let pairs: Vec<(DVec3, DVec3)> = found
            .iter()
            .copied()
            .zip(exact.iter().copied())
            .filter(|(found, exact)| *found != DVec3::ZERO || *exact != DVec3::ZERO)
            .collect();
        let lengths: Vec<f64> = pairs.iter().map(|(found, exact)| found.distance(*exact)).collect();
        Self {
            exact_rms: mean(pairs.iter().map(|(_, exact)| exact.length_squared())).sqrt(),
            mean: mean(lengths.iter().copied()),
            p99: quantile(&lengths, 0.99),
            correlation: correlation(&pairs),
            vibration: rms_above(VIBRATION_FREQUENCY, found, rate),
            exact_vibration: rms_above(VIBRATION_FREQUENCY, exact, rate),
        }
    }
}

/// Returns the correlation of vectors about their means: Σ a·b / √(Σ a² Σ b²). 1 if neither varies, 0 if only
/// one does.
fn correlation(pairs: &[(DVec3, DVec3)]) -> f64 {
    let count = pairs.len().max(1) as f64;
    let (sum_a, sum_b) =
        pairs.iter().fold((DVec3::ZERO, DVec3::ZERO), |(sum_a, sum_b), (a, b)| (sum_a + *a, sum_b + *b));
    let (mean_a, mean_b) = (sum_a / count, sum_b / count);
    let (mut both, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (a, b) in pairs {
        let (a, b) = (*a - mean_a, *b - mean_b);
        both += a.dot(b);
        aa += a.length_squared();
        bb += b.length_squared();
    }
    match (aa > 0.0, bb > 0.0) {
        (true, true) => both / (aa * bb).sqrt(),
        (false, false) => 1.0,
        _ => 0.0,
    }
}

/// Returns the root mean square above a frequency (Hz) of vectors sampled at `rate` (Hz), with a Hann window;
/// 0 for fewer than four vectors.
pub fn rms_above(frequency: f64, vectors: &[DVec3], rate: f64) -> f64 {
    let count = vectors.len();
    if count < 4 {
        return 0.0;
    }
    let window = |index: usize| 0.5 - 0.5 * (std::f64::consts::TAU * index as f64 / count as f64).cos();
    let power: f64 = (0..count).map(|index| window(index).powi(2)).sum();
    let transform = FftPlanner::new().plan_fft_forward(count);
    let mut square = 0.0;
    for axis in 0..3 {
        let middle = mean(vectors.iter().map(|vector| vector[axis]));
        let windowed =
            vectors.iter().enumerate().map(|(index, vector)| window(index) * (vector[axis] - middle));
        let mut spectrum: Vec<Complex<f64>> = windowed.map(Complex::from).collect();
        transform.process(&mut spectrum);
        // Samples are real, so the other half of the spectrum repeats this one.
        for (bin, value) in spectrum[..=count / 2].iter().enumerate() {
            if bin as f64 * rate / count as f64 > frequency {
                // Every bin but the last of an even count stands for two.
                let weight = if 2 * bin == count { 1.0 } else { 2.0 };
                square += weight * value.norm_sqr();
            }
        }
    }
    (square / (count as f64 * power)).sqrt()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    fn sine(frequency: f64, amplitude: f64) -> Vec<DVec3> {
        (0..1000)
            .map(|sample| DVec3::Y * (amplitude * (TAU * frequency * 1e-3 * f64::from(sample)).sin()))
            .collect()
    }

    #[test]
    fn vibration_is_the_fast_part() {
        assert!(rms_above(VIBRATION_FREQUENCY, &sine(5.0, 1.0), 1000.0) < 1e-3);
        let fast = rms_above(VIBRATION_FREQUENCY, &sine(80.0, 2.0), 1000.0);
        assert!((fast - 2.0_f64.sqrt()).abs() < 1e-3, "{fast}");
        // An offset is not vibration.
        let offset: Vec<DVec3> = sine(80.0, 2.0).iter().map(|vector| *vector + DVec3::X).collect();
        assert!((rms_above(VIBRATION_FREQUENCY, &offset, 1000.0) - fast).abs() < 1e-9);
        assert_eq!(rms_above(VIBRATION_FREQUENCY, &[DVec3::X; 3], 1000.0), 0.0);
    }

    #[test]
    fn deviation_is_over_states_with_contact() {
        let forces = |vectors: &[DVec3]| -> Vec<Wrench> {
            vectors.iter().map(|force| Wrench { force: *force, torque: DVec3::ZERO }).collect()
        };
        let exact = [DVec3::ZERO, DVec3::X, DVec3::X, DVec3::new(3.0, 0.0, 0.0)];
        let found = [DVec3::ZERO, DVec3::X, DVec3::new(1.0, 0.3, 0.0), DVec3::new(3.0, 0.0, 0.0)];
        let Difference { force, torque } = Difference::of_wrenches(&forces(&found), &forces(&exact), 100.0);
        assert!((force.mean - 0.1).abs() < 1e-12 && (force.p99 - 0.3).abs() < 1e-12, "{force:?}");
        assert!((force.exact_rms - (11.0_f64 / 3.0).sqrt()).abs() < 1e-12, "{force:?}");
        assert!(force.correlation > 0.95 && force.correlation < 1.0, "{force:?}");
        assert_eq!((torque.mean, torque.correlation), (0.0, 1.0), "{torque:?}");
        let opposed: Vec<DVec3> = exact.iter().map(|force| -*force).collect();
        let opposed = Difference::of_wrenches(&forces(&opposed), &forces(&exact), 100.0);
        assert!((opposed.force.correlation + 1.0).abs() < 1e-12, "{opposed:?}");
    }
}
