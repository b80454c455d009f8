//! Vibration that a session sends to the hand, in each [`Phase`] of it, against what a hand can feel.
//!
//! **Above 20 Hz.** Each axis passes a Butterworth high-pass of fourth order (two biquads by the bilinear
//! transform, matched at the cut), once forwards and once backwards: no phase, half the amplitude at the cut,
//! and 3 Hz lowered by 10⁻⁶. The filter runs over the whole session; a level is the root mean square of what
//! is left over the steps of a phase.
//!
//! **Third octaves.** Bands of base ten from 20 to 500 Hz (IEC 61260-1), by Fourier transforms of windows of
//! half a second (Hann, half overlapping) that lie within a phase. The level of a band is that of the window
//! in which it is strongest, since a hand feels a burst and not its average over the session.
//!
//! **Thresholds.** Israr, Choi and Tan (Detection threshold and mechanical impedance of the hand in a
//! pen-hold posture, IROS 2006) give the smallest vibration of a held stylus that hands detect, in bursts of
//! a second: 26 µm peak at 10 Hz and 8.5 µm at 20 Hz, 13 dB an octave less up to 160 Hz (0.065 µm), and 0.06
//! µm at the minimum, at 320 Hz. Here lines join these points in double-logarithmic scale. Above 320 Hz the
//! threshold rises; the minimum is kept, which is stricter. A whole hand around a cylinder feels half of that
//! at 150 Hz, 0.03 µm (Brisben, Hsiao and Johnson, J. Neurophysiol. 81, 1999). These are displacements. The
//! force of a band is felt if it moves handle and hand so far: F = |k_h − ω² (m + m_h) + jω (b + b_h)| x, the
//! impedance of the emulated [`Handle`] and [`Hand`], without the handle's friction, which would hide small
//! forces. The mass of a real hand does not follow a handle above some 30 Hz: with [`Hand::NONE`], thresholds
//! are those of the bare handle, which are lower.

use std::f64::consts::{SQRT_2, TAU};

use palpate::device::{Hand, Handle};
use palpate::glam::DVec3;
use palpate::{Pose, Record, Wrench};
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;
use serde::Serialize;

use crate::difference::VIBRATION_FREQUENCY;
use crate::phase::{Held, Phase, phases};
use crate::statistics::mean;

/// Number of third octaves, with centres 10^(n/10) Hz, and n of the first, 20 Hz. The last is 500 Hz.
const BANDS: usize = 15;
const FIRST_BAND: usize = 13;
/// Length of a window of the third octaves, s. A shorter one does not resolve the lowest band, 4.6 Hz wide.
const WINDOW: f64 = 0.5;
/// Frequency (Hz) and detected peak displacement (m) of a stylus, in rising order.
const DETECTED: [(f64, f64); 3] = [(20.0, 8.5e-6), (160.0, 0.065e-6), (320.0, 0.06e-6)];
/// Quality factors of the two biquads of a Butterworth filter of fourth order, 1/(2 cos(π/8)) and
/// 1/(2 cos(3π/8)).
const BUTTERWORTH: [f64; 2] = [0.541_196_100_146_197, 1.306_562_964_876_376_6];
/// Periods of the cut by which a signal is extended at both ends, so that the filter settles before it.
const PADDING: f64 = 3.0;

/// Vibration in the phases of a session.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Vibration {
    /// Away from contact.
    pub free: Level,
    /// Around touch-downs and releases.
    pub onset: Level,
    /// In contact, with the hand at rest.
    pub rest: Level,
    /// In contact, with the hand in motion.
    pub sliding: Level,
}

/// Vibration of the wrench sent to the device, over the steps of a phase.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Level {
    /// Duration of the phase, s.
    pub seconds: f64,
    /// Root mean square of the force above 20 Hz, N; 0 if the phase does not occur.
    pub force: f64,
    /// Root mean square of the torque above 20 Hz, N·m.
    pub torque: f64,
    /// Third octaves of the force; none if the phase never lasts for half a second.
    pub bands: Vec<Band>,
}

/// Third octave of a force.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Band {
    /// Centre, Hz.
    pub center: f64,
    /// Root mean square, N.
    pub level: f64,
    /// Root mean square from which a hand feels it, N.
    pub threshold: f64,
}

impl Band {
    /// Level over threshold; above 1 it is felt.
    pub fn ratio(&self) -> f64 {
        self.level / self.threshold
    }
}

impl Level {
    /// The third octave that is felt most.
    pub fn worst(&self) -> Option<&Band> {
        self.bands.iter().max_by(|a, b| a.ratio().total_cmp(&b.ratio()))
    }
}

impl Vibration {
    /// Measures a session with `rate` records per second (Hz). `hand` holds the poses that the hand intends,
    /// as for [`phases`].
    pub fn of(records: &[Record], hand: &[Pose], rate: f64, held: &Held) -> Self {
        let phases = phases(records, hand, rate, held);
        let part = |of: fn(&Wrench) -> DVec3| -> Vec<DVec3> {
            records.iter().map(|record| of(&record.coupling)).collect()
        };
        let (force, torque) = (part(|wrench| wrench.force), part(|wrench| wrench.torque));
        let above = |vectors: &[DVec3]| high_passed(vectors, VIBRATION_FREQUENCY, rate);
        let (fast_force, fast_torque) = (above(&force), above(&torque));
        let level = |phase: Phase| {
            let rms = |vectors: &[DVec3]| {
                let within = vectors.iter().zip(&phases).filter(|(_, found)| **found == phase);
                mean(within.map(|(vector, _)| vector.length_squared())).sqrt()
            };
            Level {
                seconds: phases.iter().filter(|found| **found == phase).count() as f64 / rate,
                force: rms(&fast_force),
                torque: rms(&fast_torque),
                bands: third_octaves(&force, rate, |step| phases.get(step) == Some(&phase), held),
            }
        };
        Self {
            free: level(Phase::Free),
            onset: level(Phase::Onset),
            rest: level(Phase::Rest),
            sliding: level(Phase::Sliding),
        }
    }
}

/// Returns the part of vectors, sampled at `rate` (Hz), above a frequency (Hz), without a shift in time.
pub fn high_passed(vectors: &[DVec3], frequency: f64, rate: f64) -> Vec<DVec3> {
    let Some((first, last)) = vectors.first().zip(vectors.last()) else { return Vec::new() };
    let padding = ((PADDING * rate / frequency) as usize).min(vectors.len() - 1);
    // The ends are continued point-symmetrically, so that neither value nor slope jumps there.
    let before = vectors[1..=padding].iter().rev().map(|vector| 2.0 * *first - *vector);
    let after = vectors[vectors.len() - 1 - padding..vectors.len() - 1].iter().rev();
    let after = after.map(|vector| 2.0 * *last - *vector);
    let mut signal: Vec<DVec3> = before.chain(vectors.iter().copied()).chain(after).collect();
    for _ in 0..2 {
        for quality in BUTTERWORTH {
            Biquad::high_pass(frequency, quality, rate).run(&mut signal);
        }
        signal.reverse();
    }
    signal[padding..padding + vectors.len()].to_vec()
}

/// Digital filter of second order, normalised to a₀ = 1.
struct Biquad {
    b: [f64; 3],
    a: [f64; 2],
}

impl Biquad {
    /// High-pass by the bilinear transform, matched at its cut (Hz).
    fn high_pass(cut: f64, quality: f64, rate: f64) -> Self {
        let (sin, cos) = (TAU * cut / rate).sin_cos();
        let alpha = sin / (2.0 * quality);
        let (scale, half) = (1.0 / (1.0 + alpha), 0.5 * (1.0 + cos));
        Self {
            b: [half * scale, -2.0 * half * scale, half * scale],
            a: [-2.0 * cos * scale, (1.0 - alpha) * scale],
        }
    }

    /// Filters a signal in place, as if its first value had lasted for ever.
    fn run(&self, signal: &mut [DVec3]) {
        let first = signal.first().copied().unwrap_or(DVec3::ZERO);
        let (mut x, mut y) = ([first; 2], [DVec3::ZERO; 2]);
        for value in signal {
            let input = *value;
            *value =
                self.b[0] * input + self.b[1] * x[0] + self.b[2] * x[1] - self.a[0] * y[0] - self.a[1] * y[1];
            (x, y) = ([input, x[0]], [*value, y[0]]);
        }
    }
}

/// Returns the third octaves of forces over the windows that `within` accepts every step of.
fn third_octaves(forces: &[DVec3], rate: f64, within: impl Fn(usize) -> bool, held: &Held) -> Vec<Band> {
    let length = (WINDOW * rate).round() as usize;
    let transform = FftPlanner::new().plan_fft_forward(length);
    let weights: Vec<f64> =
        (0..length).map(|index| 0.5 - 0.5 * (TAU * index as f64 / length as f64).cos()).collect();
    let power: f64 = weights.iter().map(|weight| weight * weight).sum();
    let mut squares = [0.0_f64; BANDS];
    let (mut any, mut start) = (false, 0);
    while start + length <= forces.len() {
        if let Some(outside) = (start..start + length).rev().find(|step| !within(*step)) {
            start = outside + 1;
            continue;
        }
        any = true;
        let mut found = [0.0; BANDS];
        for axis in 0..3 {
            let values = || forces[start..start + length].iter().map(|force| force[axis]);
            let middle = mean(values());
            let mut spectrum: Vec<Complex<f64>> =
                values().zip(&weights).map(|(value, weight)| (weight * (value - middle)).into()).collect();
            transform.process(&mut spectrum);
            for (bin, value) in spectrum[..length / 2].iter().enumerate() {
                if let Some(square) = band(bin as f64 * rate / length as f64).and_then(|i| found.get_mut(i)) {
                    *square += 2.0 * value.norm_sqr() / (length as f64 * power);
                }
            }
        }
        squares.iter_mut().zip(found).for_each(|(most, square)| *most = most.max(square));
        start += length / 2;
    }
    let center = |band: usize| 10.0_f64.powf(0.1 * (FIRST_BAND + band) as f64);
    let bands = squares.into_iter().enumerate().filter(|_| any);
    bands.map(|(band, square)| Band::at(center(band), square.sqrt(), held)).collect()
}

/// Returns the index of the third octave that a frequency (Hz) is in.
fn band(frequency: f64) -> Option<usize> {
    // Zero and whatever lies below the first band saturate to 0.
    let n = (10.0 * frequency.log10()).round() as usize;
    n.checked_sub(FIRST_BAND).filter(|band| *band < BANDS)
}

impl Band {
    fn at(center: f64, level: f64, held: &Held) -> Self {
        let threshold = detected(center) / SQRT_2 * stiffness(center, &held.handle, &held.hand);
        Self { center, level, threshold }
    }
}

/// Returns the peak displacement (m) of a stylus that hands detect, at a frequency (Hz).
fn detected(frequency: f64) -> f64 {
    let [.., last] = DETECTED;
    let segment = DETECTED.windows(2).find(|pair| frequency < pair[1].0);
    let Some([(f0, x0), (f1, x1)]) = segment else { return last.1 };
    x0 * (x1 / x0).powf((frequency / f0).ln() / (f1 / f0).ln())
}

/// Returns the dynamic stiffness of handle and hand at a frequency (Hz), N/m.
fn stiffness(frequency: f64, handle: &Handle, hand: &Hand) -> f64 {
    let angular = TAU * frequency;
    let elastic = hand.stiffness - (handle.mass + hand.mass) * angular * angular;
    elastic.hypot((handle.damping + hand.damping) * angular)
}

#[cfg(test)]
mod tests;
